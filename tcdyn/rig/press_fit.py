"""The press fit of a disk on its shaft as ``rig.toml`` states it: interference, surfaces, keyways, poor patches."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from tcdyn.core import Array
from tcdyn.rig.strict import STRICT

Angle = Annotated[float, Field(ge=0, le=360)]
Share = Annotated[float, Field(ge=0, le=1)]
Sectors = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Keyway:
    """A slot centred at ``angle_deg``, ``width_deg`` or ``width_mm`` wide along the bore; ``share`` of the conductance
    beside it is left."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    angle_deg: Angle
    width_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    width_mm: Annotated[float, Field(ge=0)] = 0.0
    share: Share = 0.0

    def __post_init__(self) -> None:
        if (self.width_deg > 0) == (self.width_mm > 0):
            raise ValueError("a keyway needs one of width_deg and width_mm above zero")


@dataclass(frozen=True)
class Patch:
    """A stretch of poor contact ``from_deg`` ``to_deg``, through zero where the second is smaller; ``share`` is left of
    the conductance beside it."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    from_deg: Angle
    to_deg: Angle
    share: Share = 0.0

    def __post_init__(self) -> None:
        if (self.to_deg - self.from_deg) % 360.0 == 0:
            raise ValueError(
                f"a patch from {self.from_deg:g} to {self.to_deg:g} degrees has no width, or is all round"
            )


@dataclass(frozen=True)
class PressFit:
    """[fit] of a rig file (sections 6.4.3, (6.1), (6.2)); ``interference_um`` is diametral, zero where none is stated.

    Hardness, roughness and slope of the surfaces and the conductivity of the joint are assumed: with each other they
    give table 6.6. ``uneven_rel``: standard uncertainty, beyond what is stated, of cos and sin of the first harmonic of
    the conductance, as a share of its mean. Angles are those of the junctions' ``angle_deg``.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    interference_um: Annotated[float, Field(ge=0, lt=1000)] = 0.0
    hardness_GPa: Annotated[float, Field(gt=0, lt=100)] = 4.66
    roughness_um: Annotated[float, Field(gt=0, lt=100)] = 1.0
    slope: Annotated[float, Field(gt=0, lt=2)] = 0.1
    conductivity_W_mK: Annotated[float, Field(gt=0.1, lt=2500)] = 16.0
    uneven_rel: Annotated[float, Field(gt=0, le=2)] = 0.1
    keyways: tuple[Keyway, ...] = ()
    patches: tuple[Patch, ...] = ()

    def __post_init__(self) -> None:
        if (self.keyways or self.patches) and not self.stated:
            raise ValueError("keyways and patches need an interference_um above zero")

    @property
    def stated(self) -> bool:
        """Whether there is such a fit."""
        return self.interference_um > 0

    def sectors(self, bore_radius_mm: float) -> Sectors:
        """(from, to, share) [deg] of all keyways and patches, ascending within 0 to 360; beside them the share is one.

        Raises ValueError where two overlap, or nothing is left of the contact.

        >>> PressFit(20.0, keyways=(Keyway(0.0, width_deg=20.0, share=0.1),)).sectors(20.5)
        ((0.0, 10.0, 0.1), (350.0, 360.0, 0.1))
        """
        out = []
        for key in self.keyways:
            width = key.width_deg or float(
                np.rad2deg(key.width_mm / bore_radius_mm if bore_radius_mm else np.inf)
            )
            if not width < 360:
                raise ValueError(
                    f"fit.keyways: width_mm {key.width_mm:g} is more than the bore's circumference"
                )
            out += _unrolled(key.angle_deg - 0.5 * width, key.angle_deg + 0.5 * width, key.share)
        for patch in self.patches:
            out += _unrolled(
                patch.from_deg, patch.to_deg + 360.0 * (patch.to_deg < patch.from_deg), patch.share
            )
        out = sorted(out)
        for (_, end, _), (start, beyond, _) in pairwise(out):
            if start < end - 1e-9:
                raise ValueError(
                    f"fit: keyways and patches overlap from {start:g} to {min(end, beyond):g} degrees; expected each "
                    "angle in one of them at most"
                )
        if self.stated and not harmonics(tuple(out), 0)[0].real > 1e-6:
            raise ValueError("fit: keyways and patches leave nothing of the contact")
        return tuple(out)


NO_FIT = PressFit()


def _unrolled(start: float, end: float, share: float) -> list[tuple[float, float, float]]:
    first = start % 360.0
    beyond = first + end - start
    if beyond <= 360.0:
        return [(first, beyond, share)]
    return [(0.0, beyond - 360.0, share), (first, 360.0, share)]


def harmonics(sectors: Sectors, up_to: int) -> NDArray[np.complex128]:
    """Fourier coefficients c_0 ... c_n of the share round the bore, s = sum of c_n exp(i n theta), (up_to + 1,).

    >>> np.round(harmonics(((0.0, 180.0, 0.0),), 1), 4)  # half the bore without contact: 1/2 and i/pi
    array([ 0.5+0.j    , -0. +0.3183j])
    """
    out = np.zeros(up_to + 1, dtype=complex)
    out[0] = 1.0
    n = np.arange(1, up_to + 1)
    for start, end, share in sectors:
        a, b = np.deg2rad([start, end])
        out[0] += (share - 1) * (b - a) / (2 * np.pi)
        out[1:] += (share - 1) * (np.exp(-1j * n * a) - np.exp(-1j * n * b)) / (2j * np.pi * n)
    return out


def amplitude_and_angle(coefficients: NDArray[np.complex128], n: int) -> tuple[float, float]:
    """Of harmonic ``n``: its amplitude as a share of the mean, and the first angle at which it is greatest [deg].

    >>> size, at = amplitude_and_angle(harmonics(((0.0, 180.0, 0.0),), 1), 1)
    >>> round(size, 3), round(at)  # 4/pi, on the side that touches
    (1.273, 270)
    """
    c = coefficients[n]
    size = float(2 * abs(c) / coefficients[0].real)
    return size, float(np.rad2deg(-np.angle(c) / n) % (360.0 / n)) if size > 1e-12 else 0.0


def mean_shares(sectors: Sectors, edges_deg: Array) -> Array:
    """Mean share between each two of ``edges_deg`` (N + 1,), ascending within a turn or two, (N,).

    >>> mean_shares(((0.0, 10.0, 0.0),), np.array([0.0, 5.0, 15.0, 25.0]))
    array([0. , 0.5, 1. ])
    """
    ends = np.array([0.0, *(x for a, b, _ in sectors for x in (a, b)), 360.0])
    lost = np.array(
        [0.0, *(x for a, b, s in sectors for x in (0.0, (1 - s) * (b - a))), 0.0]
    ).cumsum()
    turns, at = np.divmod(edges_deg, 360.0)
    total = np.asarray(edges_deg) - turns * lost[-1] - np.interp(at, ends, lost)
    return np.asarray(np.diff(total) / np.diff(edges_deg))
