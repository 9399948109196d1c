"""Bearing friction of the slow shaft (section 2.10) and shaft speed (section 2.11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from calibration.lines.linefit import LineFit, fit_line

FloatArray = NDArray[np.float64]
PULSES_PER_TURN = 120


@dataclass(frozen=True)
class BearingFriction:
    """Lines of measured friction against load, one for each slow-shaft speed [rpm]; bearings of both shafts."""

    speeds_rpm: tuple[float, ...]
    lines: tuple[LineFit, ...]

    @property
    def load_range_N(self) -> tuple[float, float]:
        """Loads that every family covers [N]."""
        return max(float(k.x.min()) for k in self.lines), min(float(k.x.max()) for k in self.lines)

    def correction_N(self, load_N: ArrayLike, speed_slow_rpm: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """What to add to the measured friction [N], and its standard uncertainty [N]: half of the measured lines.

        EHL friction = transducer + (intercept_n + slope_n load) / 2, straight between neighbouring speeds, the
        nearest family beyond them. The pure-rolling test measured both shafts; their bearings are alike, hence
        half.
        """
        load, rpm = np.broadcast_arrays(np.asarray(load_N, dtype=float), np.asarray(speed_slow_rpm, dtype=float))
        speeds = np.array(self.speeds_rpm)
        if len(speeds) == 1:
            lower, part = np.zeros(rpm.shape, dtype=int), np.zeros(rpm.shape)
        else:
            lower = np.clip(np.searchsorted(speeds, rpm) - 1, 0, len(speeds) - 2)
            part = np.clip((rpm - speeds[lower]) / (speeds[lower + 1] - speeds[lower]), 0.0, 1.0)
        upper = np.minimum(lower + 1, len(speeds) - 1)
        value = np.array([k.intercept + k.slope * load for k in self.lines])
        spread = np.array(
            [
                k.covariance_95[0, 0] * load**2 + 2 * k.covariance_95[0, 1] * load + k.covariance_95[1, 1]
                for k in self.lines
            ]
        )
        friction = (1 - part) * _pick(value, lower) + part * _pick(value, upper)
        variance = (1 - part) ** 2 * _pick(spread, lower) + part**2 * _pick(spread, upper)
        return np.asarray(0.5 * friction), np.asarray(0.5 * np.sqrt(variance))

    def outside(self, load_N: ArrayLike, speed_slow_rpm: ArrayLike) -> NDArray[np.bool_]:
        """Where load or speed lies outside what was measured: the correction is extrapolated there."""
        load, rpm = np.asarray(load_N, dtype=float), np.asarray(speed_slow_rpm, dtype=float)
        low, high = self.load_range_N
        slow, fast = min(self.speeds_rpm) * 0.98, max(self.speeds_rpm) * 1.02
        return np.asarray((load < low) | (load > high) | (rpm < slow) | (rpm > fast))


def fit_bearing_friction(load_N: ArrayLike, friction_N: ArrayLike, speed_slow_rpm: ArrayLike) -> BearingFriction:
    """Lines of the pure-rolling test, arrays of shape (N,); points within 2 % of one speed make a family.

    Raises InputError for a family with fewer than 3 points.

    >>> load = [800.0, 1500.0, 2300.0] * 2
    >>> both = fit_bearing_friction(load, [5.0, 6.0, 7.14, 8.0, 9.0, 10.14], [774.0] * 3 + [1546.0] * 3)
    >>> round(float(both.correction_N(1500.0, 774.0)[0]), 2)
    3.0
    """
    load, friction = np.asarray(load_N, dtype=float), np.asarray(friction_N, dtype=float)
    rpm = np.asarray(speed_slow_rpm, dtype=float)
    order = np.argsort(rpm, kind="stable")
    edges = np.flatnonzero(np.diff(rpm[order]) > 0.02 * rpm[order][:-1]) + 1
    speeds, lines = [], []
    for family in np.split(order, edges):
        if len(family) < 3:
            raise InputError(
                f"{len(family)} points at {rpm[family].mean():.4g} rpm", expected="at least 3 loads a speed"
            )
        speeds.append(float(rpm[family].mean()))
        lines.append(fit_line(load[family], friction[family]))
    return BearingFriction(tuple(speeds), tuple(lines))


def _pick(table: FloatArray, index: NDArray[np.intp]) -> FloatArray:
    return np.asarray(np.take_along_axis(table, index[None, ...], axis=0)[0])


def speed_from_counts_rpm(counts: ArrayLike, gate_s: float) -> tuple[FloatArray, float]:
    """Speed [rpm] from pulses counted in a gate [s], 120 a turn, and its standard uncertainty [rpm].

    n = 60 counts / (120 gate); a gate begins and ends anywhere between two pulses, so u = (one pulse) / sqrt(6).

    >>> speed_from_counts_rpm(200, 0.1)[0]
    array(1000.)
    """
    if gate_s <= 0:
        raise InputError(f"gate_s must be above 0; got {gate_s}")
    one = 60.0 / (PULSES_PER_TURN * gate_s)
    return np.asarray(np.asarray(counts, dtype=float) * one), one / float(np.sqrt(6.0))


def speed_from_pulses_rpm(pulse_s: ArrayLike) -> FloatArray:
    """Speed [rpm] over each whole turn that ends at a pulse; NaN for the first 120.

    ``pulse_s`` (N,) are the rising times [s], increasing. Whole turns cancel the unequal pitch of the slots.
    Raises InputError for times that do not rise, or fewer than 121 pulses.
    """
    t = np.asarray(pulse_s, dtype=float)
    if len(t) <= PULSES_PER_TURN:
        raise InputError(f"{len(t)} pulses", expected=f"more than one turn ({PULSES_PER_TURN})")
    if not (np.diff(t) > 0).all():
        raise InputError(f"pulse {int(np.argmin(np.diff(t) > 0)) + 2} does not come after the one before it")
    out = np.full(len(t), np.nan)
    out[PULSES_PER_TURN:] = 60.0 / (t[PULSES_PER_TURN:] - t[:-PULSES_PER_TURN])
    return out
