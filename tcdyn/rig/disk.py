"""An instrumented disk in SI units: material, junctions and their rows, and surrogate channels.

``DiskSetup`` is made by :meth:`tcdyn.rig.rigfile.RigTables.disk_setup` and used by all estimators.
``Conditioning`` is the known filter in every chain. Tests: ``tests/rig/test_record.py`` (filter),
``tests/partition/test_left_out.py``, ``tests/partition/test_any_junctions.py`` and
``tests/partition/test_inner_row.py``.
"""

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
from tcdyn.rig.press_fit import NO_FIT, PressFit
from tcdyn.rig.steel import EVEN_STEEL, SteelSlopes
from tcdyn.rig.tables import CHANNELS as CHANNELS
from tcdyn.rig.tables import HERTZ_FLUX, NO_FLUX, STRICT, FluxProfile, SurfaceFlux

# The disks of the rig, named by their speed.
DISKS = ("fast", "slow")
LEFT_OUT_TEXT = "left out"  # in tables, for a channel without results
# Largest share of the channels of a disk that may be left out. Chosen by judgement.
MAX_SHARE_LEFT_OUT = 1 / 3
# Axial positions of the inner row that the profile along R_i needs.
MIN_INNER_POSITIONS = 2
# of the signal conditioning; the simulator has its own filters
FilterShape = Literal["cascade", "butterworth"]
FILTER_SHAPES: tuple[FilterShape, ...] = get_args(FilterShape)


@dataclass(frozen=True)
class Junction:
    """Position of a junction: depth below the running surface, distance from one face, angle.

    Attributes
    ----------
    depth_m
        Depth below the running surface.
    z_m
        Distance from one face.
    angle_deg
        Angle around the shaft.
    """

    depth_m: float
    z_m: float
    angle_deg: float = 0.0


@dataclass(frozen=True)
class Conditioning:
    """[conditioning]: the known low-pass filter B(s) of the signal conditioning.

    Parameters
    ----------
    cutoff_Hz
        Cut-off frequency; the default is from the data sheet of a 5B module.
    poles
        Order; 0 means no filter.
    shape
        "cascade": B = 1/(1 + s/(2 pi cutoff_Hz))^poles; "butterworth": maximally flat.

    Notes
    -----
    The simulator has its own filters (``tcdyn/simulate/measure.py``); a new shape needs an entry
    there, too, for a test. Test: ``tests/rig/test_record.py``.

    Examples
    --------
    >>> round(Conditioning(cutoff_Hz=4.0, poles=2).lag_s, 4)
    0.0796
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    cutoff_Hz: Annotated[float, Field(gt=0)] = 4.0
    poles: Annotated[int, Field(ge=0, le=6)] = 2
    shape: FilterShape = "cascade"

    def __post_init__(self) -> None:
        """Raise InputError for an unknown shape."""
        if self.shape not in FILTER_SHAPES:
            raise InputError(
                f"conditioning: no filter has the shape {self.shape!r}",
                expected=" or ".join(FILTER_SHAPES),
            )

    @cached_property
    def factors(self) -> tuple[tuple[float, ...], ...]:
        """Factors of 1/B(s), ascending coefficients in s.

        They are lags (1, tau) and sections (1, 2 zeta/wc, 1/wc^2).

        The poles of a Butterworth filter of order n lie on a circle: zeta_k = sin((2k - 1) pi/2n),
        k = 1..n/2, and a real pole where n is odd.

        Returns
        -------
        factors
            One tuple (1, a, b) or (1, a) of coefficients for each factor.

        Examples
        --------
        >>> Conditioning(0.5 / math.pi, 2).factors
        ((1.0, 1.0), (1.0, 1.0))
        """
        tau = 1.0 / (2 * math.pi * self.cutoff_Hz)
        n = self.poles
        if self.shape == "cascade":
            return ((1.0, tau),) * n
        damping = [math.sin((2 * k - 1) * math.pi / (2 * n)) for k in range(1, n // 2 + 1)]
        sections = tuple((1.0, 2 * tau * zeta, tau**2) for zeta in damping)
        return sections + ((1.0, tau),) * (n % 2)

    @property
    def numerator(self) -> tuple[float, ...]:
        """Numerator of B, ascending in s."""
        return (1.0,)

    @cached_property
    def lag_s(self) -> float:
        """First moment of the impulse response of B [s].

        poles/wc (cascade) or 1/(wc sin(pi/2n)) (Butterworth of order n).

        >>> round(Conditioning(4.0, 2).lag_s, 4)
        0.0796
        """
        return sum(factor[1] for factor in self.factors)


@dataclass(frozen=True)
class DiskSetup:
    """One disk of ``rig.toml`` in SI units; section 3 of the design gives the defaults.

    Parameters
    ----------
    junctions
        Any number of junctions in the order of their names.
    inner
        The deepest junctions in the order of z, the boundary condition of the rim model; see
        :func:`tcdyn.rig.tables.inner_row`.
    conditioning
        Filter of the signal conditioning.
    flux
        Profile of the heat flux across the track.
    steel
        Temperature dependence of the material.
    surface
        Measured heat loss of the running surface.
    press_fit
        Press fit on the shaft.
    name
        Name of the disk.
    outer_radius_m, bore_radius_m, width_m, crown_radius_m
        Dimensions.
    conductivity_W_mK, density_kg_m3, specific_heat_J_kgK
        Steel at its reference temperature.
    washer_conductivity_W_mK, washer_thickness_m
        Washers at both faces.
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
    press_fit: PressFit = NO_FIT

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
        """The junctions nearer the surface, with which the rim model is compared."""
        return tuple(c for c in self.junctions if c not in self.inner)

    @property
    def rows(self) -> tuple[str, ...]:
        """The outer row, then the inner row.

        >>> from tcdyn.rig.rigfile import load_rig
        >>> load_rig().disk_setup("fast").rows
        ('a', 'c', 'e', 'd', 'b', 'f')
        """
        return (*self.outer, *self.inner)

    def channel_indices(self, names: Iterable[str]) -> list[int]:
        """Indices of channels among all channels."""
        return [self.channels.index(c) for c in names]

    @property
    def edge(self) -> str:
        """The junction of the inner row nearest the centre plane; the rim begins at its depth."""
        return min(self.inner, key=self.distance_from_centre_m)

    @property
    def edge_m(self) -> float:
        """Depth at which the rim begins [m]."""
        return self.junctions[self.edge].depth_m

    @property
    def shallowest(self) -> str:
        """The junction nearest the running surface, such as e."""
        return min(self.junctions, key=lambda c: self.junctions[c].depth_m)

    @property
    def depth_below_edge_m(self) -> Array:
        """Nominal depth of the inner row below the edge of the rim, (k,) [m]."""
        return np.array([self.junctions[c].depth_m - self.edge_m for c in self.inner])

    def distance_from_centre_m(self, name: str) -> float:
        """Distance of a junction from the centre plane [m]."""
        return round(abs(self.junctions[name].z_m - 0.5 * self.width_m), 12)

    def determines_beta(self, left_out: Collection[str] = ()) -> bool:
        """Whether beta can be estimated from the disk without these channels.

        Needed are one junction of the outer row, and two axial positions in the inner row.

        Parameters
        ----------
        left_out
            Channels without readings.

        Notes
        -----
        ``MAX_SHARE_LEFT_OUT`` and ``MIN_INNER_POSITIONS`` are minimal conditions of the rim model,
        not of accuracy. Tests: ``tests/partition/test_left_out.py``,
        ``tests/partition/test_any_junctions.py``.

        Examples
        --------
        >>> from tcdyn.rig.rigfile import load_rig
        >>> disk = load_rig().disk_setup("fast")
        >>> disk.determines_beta("ac"), disk.determines_beta("bd"), disk.determines_beta("ace")
        (True, False, False)
        """
        if len(left_out) > MAX_SHARE_LEFT_OUT * len(self.junctions):
            return False
        if all(c in left_out for c in self.outer):
            return False
        positions = {self.junctions[c].z_m for c in self.inner if c not in left_out}
        return len(positions) >= MIN_INNER_POSITIONS

    def check_junction_rows(self) -> None:
        """Raise InputError for a disk whose junctions do not allow an estimate of beta."""
        if not self.determines_beta():
            row = ", ".join(self.inner)
            raise InputError(
                f"the {self.name} disk has {len(self.outer)} junction(s) nearer the surface than "
                f"{row} by 1 mm or more",
                where="rig.toml [thermocouples]",
                expected="two junctions or more of the greatest depth, at different z_mm, "
                "and one nearer the surface",
                remedy="add what is missing; `compensate` needs none of them",
            )

    def surrogate_weights(self, left_out: Collection[str]) -> dict[str, dict[str, float]]:
        """Surrogate channels of each channel left out, with their weights, which sum to one.

        In the inner row: linear interpolation between the neighbours; beyond the last junction, the
        junction whose distance from the centre plane is most similar, such as d and f. In the outer
        row: the mean of the others. This only supplies numbers: nothing is compared with it.

        Parameters
        ----------
        left_out
            Channels without readings; ``determines_beta`` must hold.

        Returns
        -------
        weights
            By channel left out, then by surrogate.

        Notes
        -----
        :meth:`with_surrogates` must use the same weights, so that readings and depths belong
        together.

        Examples
        --------
        >>> from tcdyn.rig.rigfile import load_rig
        >>> load_rig().disk_setup("fast").surrogate_weights("bc")
        {'b': {'d': 0.5, 'f': 0.5}, 'c': {'a': 0.5, 'e': 0.5}}
        """
        inner = [c for c in self.inner if c not in left_out]
        outer = [c for c in self.outer if c not in left_out]
        weights: dict[str, dict[str, float]] = {}
        for c in left_out:
            if c in self.inner:
                weights[c] = self._inner_surrogate(c, inner)
            else:
                weights[c] = dict.fromkeys(outer, 1.0 / len(outer))
        return weights

    def _inner_surrogate(self, channel: str, available: list[str]) -> dict[str, float]:
        """Weights of the available junctions of the inner row (in order of z) for a missing one.

        Parameters
        ----------
        channel
            Channel without readings.
        available
            Channels of the inner row with readings, in the order of z.
        """
        z = self.junctions[channel].z_m
        below = [c for c in available if self.junctions[c].z_m < z]
        above = [c for c in available if self.junctions[c].z_m > z]
        if below and above:
            low = self.junctions[below[-1]].z_m
            high = self.junctions[above[0]].z_m
            weight = round((z - low) / (high - low), 12)
            return {below[-1]: 1.0 - weight, above[0]: weight}
        offset = self.distance_from_centre_m(channel)
        nearest = min(available, key=lambda c: abs(self.distance_from_centre_m(c) - offset))
        return {nearest: 1.0}

    def surrogate_matrix(self, left_out: Collection[str]) -> Array:
        """Matrix (C, C) that replaces the readings left out by those of their surrogates.

        Parameters
        ----------
        left_out
            Channels without readings.

        Returns
        -------
        matrix
            (C, C), the identity for all other channels.
        """
        matrix = np.eye(len(self.junctions))
        for c, weights in self.surrogate_weights(left_out).items():
            matrix[self.channels.index(c)] = [weights.get(s, 0.0) for s in self.channels]
        return matrix

    def with_surrogates(self, left_out: Collection[str]) -> DiskSetup:
        """The disk with the channels left out at the depth of their surrogates.

        Only channels of the inner row are moved. A channel with a single surrogate gets its angle,
        too.

        Parameters
        ----------
        left_out
            Channels without readings.
        """
        junctions = dict(self.junctions)
        inner = [c for c in left_out if c in self.inner]
        for c, weights in self.surrogate_weights(inner).items():
            depth_m = sum(w * self.junctions[s].depth_m for s, w in weights.items())
            only_surrogate = next(iter(weights)) if len(weights) == 1 else c
            angle_deg = junctions[only_surrogate].angle_deg
            junctions[c] = replace(junctions[c], depth_m=depth_m, angle_deg=angle_deg)
        return replace(self, junctions=junctions)


def channels_left_out(
    names: Iterable[str], disks: Mapping[str, DiskSetup]
) -> dict[str, tuple[str, ...]]:
    """Channels left out of each disk, from names such as "fast_c".

    Parameters
    ----------
    names
        Names such as "fast_c" or "fast_c_degC".
    disks
        Both disks.

    Returns
    -------
    channels
        By disk, in the order of the junctions.

    Raises
    ------
    InputError
        An unknown name, or too few channels left.

    Examples
    --------
    >>> from tcdyn.rig.rigfile import load_rig
    >>> channels_left_out(["slow_f", "slow_c_degC"], load_rig().setups)
    {'fast': (), 'slow': ('c', 'f')}
    """
    requested = {name.removesuffix("_degC"): name for name in names}
    channels = {disk: [f"{disk}_{c}" for c in setup.channels] for disk, setup in disks.items()}
    known = {name for of_disk in channels.values() for name in of_disk}
    for short, name in requested.items():
        if short not in known:
            ranges = [f"{of_disk[0]} to {of_disk[-1]}" for of_disk in channels.values()]
            raise InputError(f"without: there is no channel {name!r}", expected=" or ".join(ranges))
    result: dict[str, tuple[str, ...]] = {}
    for disk, setup in disks.items():
        left_out = tuple(c for c in setup.channels if f"{disk}_{c}" in requested)
        result[disk] = left_out
        if left_out and not setup.determines_beta(left_out):
            raise InputError(
                f"without {', '.join(f'{disk}_{c}' for c in left_out)} too little is left of the "
                f"{disk} disk",
                expected=f"at most a third of its {len(setup.channels)} left out, and one of "
                f"{', '.join(setup.outer)} and two of {', '.join(setup.inner)} kept",
            )
    return result
