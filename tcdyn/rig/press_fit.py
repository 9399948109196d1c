"""The press fit of a disk on its shaft: interference, surfaces, keyways and patches ([fit]).

Used by the rig file, by :mod:`tcdyn.partition.press_fit` (harmonics of the conductance as prior),
by the simulator and by ``tcdyn rig circumference fit``. Equations (6.1) and (6.2) themselves are in
:mod:`tcdyn.rig.contact`. Tests: ``tests/partition/test_stated_fit.py``,
``tests/partition/test_uneven.py`` and ``tests/cli/test_circumference_command.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from tcdyn.core import Array
from tcdyn.rig.tables import STRICT

Angle = Annotated[float, Field(ge=0, le=360)]
Share = Annotated[float, Field(ge=0, le=1)]
Sectors = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Keyway:
    """A slot in the bore or the shaft.

    ``share``: its conductance relative to that of the contact outside it.

    Attributes
    ----------
    angle_deg
        Centre.
    width_deg, width_mm
        Width along the bore; one of them.
    share
        Conductance relative to that of the contact outside it.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    angle_deg: Angle
    width_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    width_mm: Annotated[float, Field(ge=0)] = 0.0
    share: Share = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError unless exactly one width is given."""
        if (self.width_deg > 0) == (self.width_mm > 0):
            raise ValueError("a keyway needs one of width_deg and width_mm above zero")


@dataclass(frozen=True)
class Patch:
    """A sector of poor contact from ``from_deg`` to ``to_deg``, which may contain zero.

    ``share``: its conductance relative to that of the contact outside it.

    Attributes
    ----------
    from_deg, to_deg
        Start and end; the sector may contain zero.
    share
        Conductance relative to that of the contact outside it.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    from_deg: Angle
    to_deg: Angle
    share: Share = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for a patch without width, or all around."""
        if (self.to_deg - self.from_deg) % 360.0 == 0:
            raise ValueError(
                f"a patch from {self.from_deg:g} to {self.to_deg:g} degrees has no width, "
                "or is all round"
            )


@dataclass(frozen=True)
class PressFit:
    """[fit] of a rig file (sections 6.4.3, (6.1), (6.2)).

    Hardness, roughness, slope and conductivity of the joint are assumed: together they give table
    6.6.

    Parameters
    ----------
    interference_um
        Diametral interference; zero for no press fit.
    hardness_GPa, roughness_um, slope
        Micro-hardness, roughness and asperity slope of the surfaces.
    conductivity_W_mK
        Conductivity of the joint.
    uneven_rel
        Standard uncertainty of the cosine and sine of the first harmonic of the conductance, beyond
        keyways and patches, as a share of its mean.
    keyways, patches
        Sectors of poor contact; angles as the junctions' ``angle_deg``.
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
        """Check that keyways and patches have an interference.

        Raises
        ------
        ValueError
            There are keyways or patches, and no interference. A plain ValueError is enough: the
            reader of the rig file gets it through pydantic and raises an InputError that names file
            and table.
        """
        if (self.keyways or self.patches) and not self.is_specified:
            raise ValueError("keyways and patches need an interference_um above zero")

    @property
    def is_specified(self) -> bool:
        """Whether the rig file has a press fit."""
        return self.interference_um > 0

    def sectors(self, bore_radius_mm: float) -> Sectors:
        """(from, to, share) [deg] of all keyways and patches, ascending from 0 to 360.

        Outside them the share is one. Raises ValueError where two overlap, or no contact remains.

        Parameters
        ----------
        bore_radius_mm
            Radius of the bore, for widths in mm.

        Raises
        ------
        ValueError
            Two sectors overlap, or no contact remains.

        Examples
        --------
        >>> PressFit(20.0, keyways=(Keyway(0.0, width_deg=20.0, share=0.1),)).sectors(20.5)
        ((0.0, 10.0, 0.1), (350.0, 360.0, 0.1))
        """
        sectors: list[tuple[float, float, float]] = []
        for keyway in self.keyways:
            half_width = 0.5 * _width_deg(keyway, bore_radius_mm)
            start = keyway.angle_deg - half_width
            sectors += _split_at_zero(start, keyway.angle_deg + half_width, keyway.share)
        for patch in self.patches:
            end = patch.to_deg
            if end < patch.from_deg:
                end += 360.0
            sectors += _split_at_zero(patch.from_deg, end, patch.share)
        sectors.sort()
        for (_, end, _), (next_start, next_end, _) in pairwise(sectors):
            if next_start < end - 1e-9:
                raise ValueError(
                    f"fit: keyways and patches overlap from {next_start:g} to "
                    f"{min(end, next_end):g} degrees; expected each angle in one of them at most"
                )
        if self.is_specified and not harmonics(tuple(sectors), 0)[0].real > 1e-6:
            raise ValueError("fit: keyways and patches leave nothing of the contact")
        return tuple(sectors)


# A rig file without [fit].
NO_FIT = PressFit()


def _width_deg(keyway: Keyway, bore_radius_mm: float) -> float:
    """Angular width of a keyway [deg]; ValueError if it is wider than the bore.

    Parameters
    ----------
    keyway
        The keyway.
    bore_radius_mm
        Radius of the bore.
    """
    if keyway.width_deg:
        return keyway.width_deg
    angle_rad = keyway.width_mm / bore_radius_mm if bore_radius_mm else np.inf
    width_deg = float(np.rad2deg(angle_rad))
    if not width_deg < 360:
        raise ValueError(
            f"fit.keyways: width_mm {keyway.width_mm:g} is more than the bore's circumference"
        )
    return width_deg


def _split_at_zero(start: float, end: float, share: float) -> list[tuple[float, float, float]]:
    """A sector within 0 to 360 degrees; two sectors if it contains zero.

    Parameters
    ----------
    start, end
        Angles [deg], with ``start`` below ``end``.
    share
        Its conductance share.
    """
    first = start % 360.0
    last = first + end - start
    if last <= 360.0:
        return [(first, last, share)]
    return [(0.0, last - 360.0, share), (first, 360.0, share)]


def harmonics(sectors: Sectors, up_to: int) -> NDArray[np.complex128]:
    """Fourier coefficients c_0 ... c_n of the share along the bore.

    Parameters
    ----------
    sectors
        Sectors of :meth:`PressFit.sectors`; one outside them.
    up_to
        Largest n.

    Returns
    -------
    coefficients
        (n + 1,), with s(theta) = c_0 + 2 Re sum c_n exp(i n theta).

    Examples
    --------
    Half the bore without contact gives 1/2 and i/pi:

    >>> np.round(harmonics(((0.0, 180.0, 0.0),), 1), 4)
    array([ 0.5+0.j    , -0. +0.3183j])
    """
    coefficients = np.zeros(up_to + 1, dtype=complex)
    coefficients[0] = 1.0
    n = np.arange(1, up_to + 1)
    for start, end, share in sectors:
        a, b = np.deg2rad([start, end])
        coefficients[0] += (share - 1) * (b - a) / (2 * np.pi)
        difference = np.exp(-1j * n * a) - np.exp(-1j * n * b)
        coefficients[1:] += (share - 1) * difference / (2j * np.pi * n)
    return coefficients


def amplitude_and_angle(coefficients: NDArray[np.complex128], n: int) -> tuple[float, float]:
    """Relative amplitude of harmonic ``n``, and the first angle of its maximum [deg].

    Parameters
    ----------
    coefficients
        Coefficients of :func:`harmonics`.
    n
        Number of the harmonic, at least 1.

    Returns
    -------
    amplitude
        Over the mean [1].
    angle_deg
        0 for a zero amplitude.

    Examples
    --------
    >>> amplitude, angle = amplitude_and_angle(harmonics(((0.0, 180.0, 0.0),), 1), 1)
    >>> round(amplitude, 3), round(angle)  # 4/pi, on the side that touches
    (1.273, 270)
    """
    amplitude = float(2 * abs(coefficients[n]) / coefficients[0].real)
    if not amplitude > 1e-12:
        return amplitude, 0.0
    return amplitude, float(np.rad2deg(-np.angle(coefficients[n]) / n) % (360.0 / n))


def mean_shares(sectors: Sectors, edges_deg: Array) -> Array:
    """Mean share between each two of ``edges_deg`` (N + 1,), ascending within two turns, (N,).

    Parameters
    ----------
    sectors
        Sectors of :meth:`PressFit.sectors`.
    edges_deg
        Edges of the intervals (N + 1,).

    Returns
    -------
    shares
        (N,).

    Examples
    --------
    >>> mean_shares(((0.0, 10.0, 0.0),), np.array([0.0, 5.0, 15.0, 25.0]))
    array([0. , 0.5, 1. ])
    """
    boundaries_deg = [0.0]
    losses_deg = [0.0]  # integral of one minus the share since the last boundary
    for start, end, share in sectors:
        boundaries_deg += [start, end]
        losses_deg += [0.0, (1 - share) * (end - start)]
    boundaries_deg.append(360.0)
    losses_deg.append(0.0)
    total_loss = np.cumsum(losses_deg)
    rotations, angle_deg = np.divmod(edges_deg, 360.0)
    loss = rotations * total_loss[-1] + np.interp(angle_deg, boundaries_deg, total_loss)
    return np.diff(edges_deg - loss) / np.diff(edges_deg)
