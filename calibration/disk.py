"""An instrumented disk: its tables in ``rig.toml``, in the units people write, and the same in SI."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from calibration import Array
from calibration.errors import InputError
from calibration.stated.fit import NO_FIT, PressFit
from calibration.stated.flux import HERTZ_FLUX, FluxKind, FluxProfile
from calibration.stated.steel import EVEN_STEEL, SteelSlopes
from calibration.stated.surface import NO_FLUX, SurfaceFlux

STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
CHANNELS = ("a", "b", "c", "d", "e", "f")
INNER_ROW = ("d", "b", "f")  # 6 mm deep: the boundary of the rim model, in the order of z
OUTER_ROW = ("a", "c", "e")  # nearer the surface: what the rim model is compared with
DISKS = ("fast", "slow")
LEFT_OUT = "left out"  # in tables, where a channel has no numbers
MOST_LEFT_OUT, LEAST_INNER = 2, 2  # of a disk's six channels; of its inner row, whose profile needs them
FilterShape = Literal["cascade", "butterworth"]  # of the signal conditioning; the simulator has poles of its own
FILTER_SHAPES: tuple[FilterShape, ...] = get_args(FilterShape)


@dataclass(frozen=True)
class Junction:
    """Where a thermocouple junction sits: depth below the running surface and axial place from one face, in m."""

    depth_m: float
    z_m: float
    angle_deg: float = 0.0


@dataclass(frozen=True)
class Conditioning:
    """[conditioning]: the known low-pass filter B(s) of the signal conditioning; ``poles = 0`` means none.

    ``cascade``: B = 1/(1 + s/(2 pi cutoff_Hz))^poles; ``butterworth``: maximally flat; cut-off of a 5B data sheet.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    cutoff_Hz: Annotated[float, Field(gt=0)] = 4.0
    poles: Annotated[int, Field(ge=0, le=6)] = 2
    shape: FilterShape = "cascade"

    def __post_init__(self) -> None:
        if self.shape not in FILTER_SHAPES:
            raise InputError(
                f"conditioning: no filter has the shape {self.shape!r}", expected=" or ".join(FILTER_SHAPES)
            )

    @cached_property
    def factors(self) -> tuple[tuple[float, ...], ...]:
        """Factors of 1/B(s), ascending coefficients in s: lags (1, tau) and sections (1, 2 zeta/wc, 1/wc^2).

        The poles of a Butterworth filter of order n stand on a circle: zeta_k = sin((2k - 1) pi/2n), k = 1..n/2, and
        a real pole where n is odd.

        >>> Conditioning(0.5 / math.pi, 2).factors
        ((1.0, 1.0), (1.0, 1.0))
        """
        tau, n = 1.0 / (2 * math.pi * self.cutoff_Hz), self.poles
        if self.shape == "cascade":
            return ((1.0, tau),) * n
        sections = tuple(
            (1.0, 2 * tau * math.sin((2 * k - 1) * math.pi / (2 * n)), tau**2) for k in range(1, n // 2 + 1)
        )
        return sections + ((1.0, tau),) * (n % 2)

    @property
    def numerator(self) -> tuple[float, ...]:
        """Of B, ascending in s."""
        return (1.0,)

    @cached_property
    def lag_s(self) -> float:
        """First moment of B's impulse response [s]: poles/wc (cascade) or 1/(wc sin(pi/2n)) (Butterworth of order n).

        >>> round(Conditioning(4.0, 2).lag_s, 4)
        0.0796
        """
        return sum(f[1] for f in self.factors)


@dataclass(frozen=True)
class DiskSetup:
    """One disk as ``rig.toml`` describes it; all lengths in m, section 3 of the design gives the defaults."""

    name: str
    outer_radius_m: float
    bore_radius_m: float
    width_m: float
    crown_radius_m: float
    conductivity_W_mK: float
    density_kg_m3: float
    specific_heat_J_kgK: float
    washer_conductivity_W_mK: float
    washer_thickness_m: float
    junctions: Mapping[str, Junction]
    conditioning: Conditioning
    flux: FluxProfile = HERTZ_FLUX
    steel: SteelSlopes = EVEN_STEEL
    surface: SurfaceFlux = NO_FLUX
    fit: PressFit = NO_FIT

    @property
    def diffusivity_m2_s(self) -> float:
        """alpha = K / (rho c) [m2/s]."""
        return self.conductivity_W_mK / (self.density_kg_m3 * self.specific_heat_J_kgK)

    @property
    def deeper_than_b_m(self) -> Array:
        """How much deeper d, b and f are stated to lie than b, (3,) [m]."""
        return np.array([self.junctions[c].depth_m - self.junctions["b"].depth_m for c in INNER_ROW])

    def stand_ins(self, left_out: Collection[str]) -> dict[str, dict[str, float]]:
        """For each channel left out the channels that stand in for it, with their weights, which add to one.

        d and f lie alike about the centre plane and stand in for each other; b is read on the straight line between
        them. The others of the outer row stand in evenly: only so that there are numbers, nothing is compared with it.

        >>> from calibration.rig import load_rig
        >>> load_rig().disk_setup("fast").stand_ins("bc")
        {'b': {'d': 0.5, 'f': 0.5}, 'c': {'a': 0.5, 'e': 0.5}}
        """
        low, middle, high = (self.junctions[c].z_m for c in INNER_ROW)
        part = round((middle - low) / (high - low), 12)
        inner = {"d": {"f": 1.0}, "b": {"d": 1.0 - part, "f": part}, "f": {"d": 1.0}}
        rest = [c for c in OUTER_ROW if c not in left_out]
        return {c: inner.get(c) or dict.fromkeys(rest, 1.0 / len(rest)) for c in left_out}

    def made_of(self, left_out: Collection[str]) -> Array:
        """How much of each channel's readings (row) is that of each channel used (column), (6, 6) in the order a..f."""
        out = np.eye(len(CHANNELS))
        for c, weights in self.stand_ins(left_out).items():
            out[CHANNELS.index(c)] = [weights.get(s, 0.0) for s in CHANNELS]
        return out

    def with_stand_ins(self, left_out: Collection[str]) -> DiskSetup:
        """The disk whose inner row left out lies as deep, and for d and f at the angle, of what stands in for it."""
        j = dict(self.junctions)
        for c, weights in self.stand_ins([c for c in left_out if c in INNER_ROW]).items():
            (first, *more), depth_m = weights, sum(w * self.junctions[s].depth_m for s, w in weights.items())
            j[c] = replace(j[c], depth_m=depth_m, angle_deg=(j[c] if more else j[first]).angle_deg)
        return replace(self, junctions=j)


def still_told(left_out: Collection[str]) -> bool:
    """Whether a disk without these of its channels still tells beta: one of a, c, e and two of d, b, f at least.

    >>> still_told("ac"), still_told("bd"), still_told("ace")
    (True, False, False)
    """
    outer, inner = (sum(c not in left_out for c in row) for row in (OUTER_ROW, INNER_ROW))
    return len(left_out) <= MOST_LEFT_OUT and outer > 0 and inner >= LEAST_INNER


def left_out_of(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Channels left out of each disk, from names such as "fast_c". Raises InputError for another name, or too many.

    >>> left_out_of(["slow_f", "slow_c_degC"])
    {'fast': (), 'slow': ('c', 'f')}
    """
    wanted = {name.removesuffix("_degC"): name for name in names}
    known = {f"{disk}_{c}": (disk, c) for disk in DISKS for c in CHANNELS}
    if unknown := [name for short, name in wanted.items() if short not in known]:
        raise InputError(
            f"without: there is no channel {unknown[0]!r}", expected="fast_a to fast_f or slow_a to slow_f"
        )
    out = {disk: tuple(c for c in CHANNELS if f"{disk}_{c}" in wanted) for disk in DISKS}
    for disk, channels in out.items():
        if not still_told(channels):
            raise InputError(
                f"without {', '.join(f'{disk}_{c}' for c in channels)} too little is left of the {disk} disk",
                expected="at most two of its six left out, and one of a, c, e and two of d, b, f kept",
            )
    return out


class RigTable(BaseModel):
    """A table of ``rig.toml``: unknown keys and numbers out of range are refused."""

    model_config = STRICT


class DiskTable(RigTable):
    """[disk]; bore radius and steel are assumptions, not the thesis's (design, section 3)."""

    outer_radius_mm: float = Field(default=38.1, gt=5, lt=500)
    bore_radius_mm: float = Field(default=20.5, ge=0, lt=500)
    width_mm: float = Field(default=9.53, gt=1, lt=200)
    crown_radius_mm: float = Field(default=304.8, gt=1, lt=1e5)
    conductivity_W_mK: float = Field(default=41.0, gt=0.1, lt=2500)
    density_kg_m3: float = Field(default=7850.0, gt=100, lt=25000)
    specific_heat_J_kgK: float = Field(default=470.0, gt=50, lt=6000)
    conductivity_slope_per_K: float = Field(default=0.0, gt=-0.002, lt=0.005)
    specific_heat_slope_per_K: float = Field(default=0.0, gt=-0.002, lt=0.005)
    reference_degC: float = Field(default=20.0, ge=-100, le=400)

    @model_validator(mode="after")
    def _bore_inside(self) -> DiskTable:
        if 0.0 < self.bore_radius_mm < 0.5:
            raise ValueError(f"bore_radius_mm: {self.bore_radius_mm} mm is no bore; is it in metres?")
        if self.bore_radius_mm >= self.outer_radius_mm:
            raise ValueError("bore_radius_mm must be below outer_radius_mm")
        if self.crown_radius_mm <= self.outer_radius_mm:
            raise ValueError(
                f"crown_radius_mm is {self.crown_radius_mm:g}; expected more than outer_radius_mm, "
                f"{self.outer_radius_mm:g}: give the radius across the running surface, which is nearly flat"
            )
        return self


class WasherTable(RigTable):
    """[washer]; the thickness is assumed."""

    conductivity_W_mK: float = Field(default=1.46, ge=0, lt=500)
    thickness_mm: float = Field(default=8.0, gt=0.1, lt=200)


class JunctionTable(RigTable):
    """[thermocouples] a = { depth_mm, z_mm, angle_deg }."""

    depth_mm: float = Field(gt=0.05, lt=100)  # a depth below 50 um is one given in metres
    z_mm: float = Field(gt=0.05, lt=200)
    angle_deg: float = Field(default=0.0, ge=-360, le=360)


class ContactTable(RigTable):
    """[contact]; ``flux_...``: how the heat falls across the track (section 8.3), see :class:`FluxProfile`."""

    gear_ratio: float = Field(default=4.24, ge=1, lt=100)
    speed_exponent: float = Field(default=0.667, ge=0, le=2)
    flux_profile: FluxKind = "hertz"
    flux_shift_mm: float = Field(default=0.0, gt=-100, lt=100)
    flux_barus_per_GPa: float = Field(default=11.0, ge=0, le=60)
    flux_table_mm: tuple[float, ...] = ()
    flux_table_weight: tuple[Annotated[float, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _table_told(self) -> ContactTable:
        at, weight = self.flux_table_mm, self.flux_table_weight
        if (self.flux_profile == "table") != (len(at) > 1):
            raise ValueError(f'flux_table_mm has {len(at)} places; expected two or more, and flux_profile = "table"')
        if len(at) != len(weight):
            raise ValueError(f"flux_table_mm has {len(at)} places, flux_table_weight {len(weight)}; expected as many")
        if any(b <= a for a, b in pairwise(at)) or (at and not sum(weight) > 0):
            raise ValueError("flux_table_mm must rise, and some flux_table_weight be above zero")
        return self

    @property
    def flux(self) -> FluxProfile:
        """How the heat falls across the track, in SI units."""
        kind, shift_m = self.flux_profile, 1e-3 * self.flux_shift_mm
        if kind == "barus":
            return FluxProfile(kind, shift_m, viscosity_per_Pa=1e-9 * self.flux_barus_per_GPa)
        if kind == "table":
            at = tuple(1e-3 * x for x in self.flux_table_mm)
            return FluxProfile(kind, shift_m, at_m=at, weight=self.flux_table_weight)
        return FluxProfile(kind, shift_m)


class UncertaintyTable(RigTable):
    """[uncertainty]: standard uncertainties of what nobody measured here; they feed the budget.

    ``bath_...``: of a plunge: its thermometer, and h's scale and form, see :class:`tcdyn.plunge.PlungePriors`.
    """

    depth_mm: float = Field(default=0.1, ge=0, lt=5)
    conductivity_rel: float = Field(default=0.03, ge=0, lt=0.5)
    heat_capacity_rel: float = Field(default=0.02, ge=0, lt=0.5)
    washer_rel: float = Field(default=0.20, ge=0, lt=1)
    half_width_rel: float = Field(default=0.03, ge=0, lt=0.5)
    flux_shift_mm: float = Field(default=0.0, ge=0, lt=10)
    conductivity_slope_per_K: float = Field(default=0.0, ge=0, lt=0.005)
    specific_heat_slope_per_K: float = Field(default=0.0, ge=0, lt=0.005)
    friction_rel: float = Field(default=0.01, ge=0, lt=0.5)
    ambient_K: float = Field(default=1.0, ge=0, lt=50)
    film_along_rel: float = Field(default=0.15, ge=0, lt=1)
    bath_K: float = Field(default=0.5, ge=0, lt=50)
    bath_h_rel: float = Field(default=0.30, ge=0, lt=2)
    bath_h_exponent: float = Field(default=0.06, ge=0, lt=1)
    bath_h_viscosity: float = Field(default=0.10, ge=0, lt=1)
    speed_exponent_low: float = Field(default=0.571, ge=0, le=2)
    speed_exponent_high: float = Field(default=0.8, ge=0, le=2)

    @model_validator(mode="after")
    def _exponents_in_order(self) -> UncertaintyTable:
        if (low := self.speed_exponent_low) > (high := self.speed_exponent_high):
            raise ValueError(f"speed_exponent_low {low:g} lies above speed_exponent_high {high:g}; exchange them")
        return self
