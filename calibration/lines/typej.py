"""Type J thermocouples (iron against constantan): millivolts and degrees Celsius on ITS-90, both ways."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.files.table import PIECE_ROWS, Columns, Table

LOW_DEGC, HIGH_DEGC = -210.0, 1200.0
_JOIN_DEGC = 760.0
SLACK_mV = 1e-7  # of rounding, at either end

# NIST ITS-90 Thermocouple Database (Monograph 175), type J: E [mV] in ascending powers of T [degC]
_BELOW = Polynomial(
    [
        0.0, 0.503811878150e-01, 0.304758369300e-04, -0.856810657200e-07, 0.132281952950e-09, -0.170529583370e-12,
        0.209480906970e-15, -0.125383953360e-18, 0.156317256970e-22,
    ]
)  # fmt: skip
_ABOVE = Polynomial(
    [
        0.296456256810e03, -0.149761277860e01, 0.317871039240e-02, -0.318476867010e-05, 0.157208190040e-08,
        -0.306913690560e-12,
    ]
)  # fmt: skip
_GRID_DEGC = np.arange(LOW_DEGC, HIGH_DEGC + 1.0)  # where Newton's steps start


def emf_mV(temperature_degC: ArrayLike) -> Array:
    """E(T) [mV] of a type J couple with its reference junction at 0 degC; E = sum c_i T^i (ITS-90).

    ``temperature_degC`` of any shape [degC], -210 to 1200; NaN stays NaN. Raises InputError that names the first value
    outside.

    >>> emf_mV([25.0, 100.0]).round(5).tolist()
    [1.27729, 5.26892]
    """
    t = np.asarray(temperature_degC, dtype=float)
    _refuse_outside(t, LOW_DEGC, HIGH_DEGC, "degC")
    return np.asarray(np.where(t > _JOIN_DEGC, _ABOVE(t), _BELOW(t)))


def temperature_degC(
    measured_mV: ArrayLike, cold_junction_degC: float = 0.0, *, outside: Literal["refuse", "inf"] = "refuse"
) -> Array:
    """T [degC] of the hot junction from the measured emf [mV], any shape: E(T) = measured + E(cold junction).

    Straight lines through ``emf_mV`` at every degree, then Newton steps on it, so that both ways agree to 1e-9 degC.
    Raises InputError that names the first value outside -210 to 1200 degC, or gives it as infinite.

    >>> round(float(temperature_degC(5.26892 - 1.27729, cold_junction_degC=25.0)), 3)
    100.0
    """
    e = np.asarray(measured_mV, dtype=float) + emf_mV(cold_junction_degC)
    grid = emf_mV(_GRID_DEGC)
    if outside == "refuse":
        _refuse_outside(e, float(grid[0]), float(grid[-1]), "mV")
    t = np.interp(e, grid, _GRID_DEGC)
    for _ in range(3):
        slope = np.where(t > _JOIN_DEGC, _ABOVE.deriv()(t), _BELOW.deriv()(t))
        t = np.clip(t - (emf_mV(t) - e) / slope, LOW_DEGC, HIGH_DEGC)
    beyond = (e < grid[0] - SLACK_mV) | (e > grid[-1] + SLACK_mV)
    return np.asarray(np.where(beyond, np.copysign(np.inf, e), t))


@dataclass(frozen=True)
class MillivoltTable:
    """A table whose ``couples`` (names in the file) hold millivolts of type J: its pieces hold degrees Celsius.

    What no couple gives becomes infinite, and is marked by the checks as impossible.
    """

    table: Table
    couples: frozenset[str]
    cold_junction_degC: float

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names as the file has them."""
        return self.table.names

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says about itself."""
        return self.table.metadata

    def pieces(self, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """The wanted columns piece by piece."""
        for part in self.table.pieces(wanted, rows):
            converted = {
                n: temperature_degC(part.data[n], self.cold_junction_degC, outside="inf")
                for n in self.couples & part.data.keys()
            }
            yield replace(part, data=part.data | converted)


def _refuse_outside(x: Array, low: float, high: float, unit: str) -> None:
    bad = (x < low - SLACK_mV) | (x > high + SLACK_mV)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"type J: {x[first]:.6g} {unit}" + (f" at index {first[0] if len(first) == 1 else first}" if first else ""),
            expected=f"{low:.6g} to {high:.6g} {unit}",
            remedy="check the unit and the wiring",
        )
