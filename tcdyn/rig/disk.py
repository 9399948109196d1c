"""An instrumented disk in SI units: its steel, its junctions and the rows that these stand in."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import ConfigDict, Field

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.flux_profile import HERTZ_FLUX, FluxProfile
from tcdyn.rig.layout import CHANNELS as CHANNELS
from tcdyn.rig.press_fit import NO_FIT, PressFit
from tcdyn.rig.steel import EVEN_STEEL, SteelSlopes
from tcdyn.rig.strict import STRICT
from tcdyn.rig.surface_flux import NO_FLUX, SurfaceFlux

DISKS = ("fast", "slow")
LEFT_OUT = "left out"  # in tables, where a channel has no numbers
# of a disk's channels; of its inner row, whose profile needs them
MOST_LEFT_OUT = 1 / 3
LEAST_INNER = 2
FilterShape = Literal[
    "cascade", "butterworth"
]  # of the signal conditioning; the simulator has poles of its own
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
                f"conditioning: no filter has the shape {self.shape!r}",
                expected=" or ".join(FILTER_SHAPES),
            )

    @cached_property
    def factors(self) -> tuple[tuple[float, ...], ...]:
        """Factors of 1/B(s), ascending coefficients in s: lags (1, tau) and sections (1, 2 zeta/wc, 1/wc^2).

        The poles of a Butterworth filter of order n stand on a circle: zeta_k = sin((2k - 1) pi/2n), k = 1..n/2, and
        a real pole where n is odd.

        >>> Conditioning(0.5 / math.pi, 2).factors
        ((1.0, 1.0), (1.0, 1.0))
        """
        tau = 1.0 / (2 * math.pi * self.cutoff_Hz)
        n = self.poles
        if self.shape == "cascade":
            return ((1.0, tau),) * n
        sections = tuple(
            (1.0, 2 * tau * math.sin((2 * k - 1) * math.pi / (2 * n)), tau**2)
            for k in range(1, n // 2 + 1)
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
    """One disk as ``rig.toml`` describes it; all lengths in m, section 3 of the design gives the defaults.

    ``junctions`` in the order of their names, of any number; ``inner``: the deepest of them in the order of z, which
    drive the rim model, see :func:`tcdyn.rig.layout.inner_row`.
    """

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
    inner: tuple[str, ...]
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
    def channels(self) -> tuple[str, ...]:
        """Names of all junctions, in order."""
        return tuple(self.junctions)

    @property
    def outer(self) -> tuple[str, ...]:
        """The junctions nearer the surface, which the rim model is compared with."""
        return tuple(c for c in self.junctions if c not in self.inner)

    @property
    def rows(self) -> tuple[str, ...]:
        """The outer row, then the inner row.

        >>> from tcdyn.rig.rigfile import load_rig
        >>> load_rig().disk_setup("fast").rows
        ('a', 'c', 'e', 'd', 'b', 'f')
        """
        return (*self.outer, *self.inner)

    def places(self, names: Iterable[str]) -> list[int]:
        """Where channels stand among all, such as the inner row."""
        return [self.channels.index(c) for c in names]

    @property
    def edge(self) -> str:
        """The inner row's junction nearest the centre plane, such as b: the rim begins at its depth."""
        return min(self.inner, key=self.off_centre_m)

    @property
    def edge_m(self) -> float:
        """Depth at which the rim begins [m]."""
        return self.junctions[self.edge].depth_m

    @property
    def shallowest(self) -> str:
        """The junction nearest the running surface, such as e."""
        return min(self.junctions, key=lambda c: self.junctions[c].depth_m)

    @property
    def deeper_than_edge_m(self) -> Array:
        """How much deeper the inner row is stated to lie than the rim's edge, (k,) [m]."""
        return np.array([self.junctions[c].depth_m - self.edge_m for c in self.inner])

    def off_centre_m(self, name: str) -> float:
        """How far a junction lies from the centre plane [m]."""
        return round(abs(self.junctions[name].z_m - 0.5 * self.width_m), 12)

    def tells_beta(self, left_out: Collection[str] = ()) -> bool:
        """Whether the disk without these channels still tells beta: one of the outer row, two places of the inner one.

        >>> from tcdyn.rig.rigfile import load_rig
        >>> disk = load_rig().disk_setup("fast")
        >>> disk.tells_beta("ac"), disk.tells_beta("bd"), disk.tells_beta("ace")
        (True, False, False)
        """
        outer, inner = (
            [self.junctions[c] for c in row if c not in left_out]
            for row in (self.outer, self.inner)
        )
        enough = len(left_out) <= MOST_LEFT_OUT * len(self.junctions)
        return enough and len(outer) > 0 and len({j.z_m for j in inner}) >= LEAST_INNER

    def check_rows(self) -> None:
        """InputError for a disk whose junctions do not tell heat partition, with what to add."""
        if not self.tells_beta():
            row = ", ".join(self.inner)
            raise InputError(
                f"the {self.name} disk has {len(self.outer)} junction(s) nearer the surface than {row} by 1 mm or more",
                where="rig.toml [thermocouples]",
                expected="two junctions or more of the greatest depth, at different z_mm, and one nearer the surface",
                remedy="add what is missing; `compensate` needs none of them",
            )

    def stand_ins(self, left_out: Collection[str]) -> dict[str, dict[str, float]]:
        """For each channel left out the channels that stand in for it, with their weights, which add to one.

        In the inner row: what is read on the straight line between its neighbours; beyond the last of them, the one
        that lies most alike about the centre plane, as d and f do. The others of the outer row stand in evenly: only so
        that there are numbers, nothing is compared with it.

        >>> from tcdyn.rig.rigfile import load_rig
        >>> load_rig().disk_setup("fast").stand_ins("bc")
        {'b': {'d': 0.5, 'f': 0.5}, 'c': {'a': 0.5, 'e': 0.5}}
        """
        inner, outer = ([c for c in row if c not in left_out] for row in (self.inner, self.outer))
        out: dict[str, dict[str, float]] = {}
        for c in left_out:
            z = self.junctions[c].z_m
            below, above = (
                [s for s in inner if (self.junctions[s].z_m - z) * sign > 0] for sign in (-1, 1)
            )
            if c not in self.inner:
                out[c] = dict.fromkeys(outer, 1.0 / len(outer))
            elif below and above:
                low = self.junctions[below[-1]].z_m
                high = self.junctions[above[0]].z_m
                part = round((z - low) / (high - low), 12)
                out[c] = {below[-1]: 1.0 - part, above[0]: part}
            else:
                off = {s: abs(self.off_centre_m(s) - self.off_centre_m(c)) for s in inner}
                out[c] = {min(off, key=off.__getitem__): 1.0}
        return out

    def made_of(self, left_out: Collection[str]) -> Array:
        """How much of each channel's readings (row) is that of each channel used (column), (C, C) in their order."""
        out = np.eye(len(self.junctions))
        for c, weights in self.stand_ins(left_out).items():
            out[self.channels.index(c)] = [weights.get(s, 0.0) for s in self.channels]
        return out

    def with_stand_ins(self, left_out: Collection[str]) -> DiskSetup:
        """The disk whose inner row left out lies as deep, and at the angle if of one alone, of what stands in for
        it."""
        j = dict(self.junctions)
        for c, weights in self.stand_ins([c for c in left_out if c in self.inner]).items():
            (first, *more) = weights
            depth_m = sum(w * self.junctions[s].depth_m for s, w in weights.items())
            j[c] = replace(j[c], depth_m=depth_m, angle_deg=(j[c] if more else j[first]).angle_deg)
        return replace(self, junctions=j)


def left_out_of(names: Iterable[str], disks: Mapping[str, DiskSetup]) -> dict[str, tuple[str, ...]]:
    """Channels left out of each disk, from names such as "fast_c". Raises InputError for another name, or too many.

    >>> from tcdyn.rig.rigfile import load_rig
    >>> left_out_of(["slow_f", "slow_c_degC"], load_rig().setups)
    {'fast': (), 'slow': ('c', 'f')}
    """
    wanted = {name.removesuffix("_degC"): name for name in names}
    known = {disk: [f"{disk}_{c}" for c in setup.channels] for disk, setup in disks.items()}
    if unknown := [
        name
        for short, name in wanted.items()
        if not any(short in every for every in known.values())
    ]:
        spans = [f"{every[0]} to {every[-1]}" for every in known.values()]
        raise InputError(
            f"without: there is no channel {unknown[0]!r}", expected=" or ".join(spans)
        )
    out = {
        disk: tuple(c for c in setup.channels if f"{disk}_{c}" in wanted)
        for disk, setup in disks.items()
    }
    for disk, channels in out.items():
        setup = disks[disk]
        if channels and not setup.tells_beta(channels):
            raise InputError(
                f"without {', '.join(f'{disk}_{c}' for c in channels)} too little is left of the {disk} disk",
                expected=f"at most a third of its {len(setup.channels)} left out, and one of {', '.join(setup.outer)} "
                f"and two of {', '.join(setup.inner)} kept",
            )
    return out
