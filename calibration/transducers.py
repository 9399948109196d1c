"""What the volts of sensors mean: load cells against dead weights, bearings of the shafts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import scipy  # scipy.special with its first use: who reads a log need not wait for it
from numpy.typing import ArrayLike, NDArray

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, labelled_messages, messages, warning
from tcdyn.core.result import Result
from tcdyn.estimation.line_fit import LineFit, fit_line


@dataclass(frozen=True)
class TransducerLine(Result):
    """force_N = slope_N_V * volts + intercept_N[session] (figure 2.21).

    ``slopes_differ_p`` tests whether the sessions share one slope (None for one session); ``shift_N`` is the
    largest intercept minus the smallest.
    """

    slope_N_V: Estimate
    intercept_N: dict[str, Estimate]
    residual_sd_V: float
    r_squared: float
    slopes_differ_p: float | None
    shift_N: Estimate | None
    range_N: tuple[float, float]
    findings: tuple[Finding, ...] = ()

    def force_N(self, volts: ArrayLike, zero_V: float) -> Array:
        """Force [N] from volts of any shape, with the zero taken at ``zero_V`` before loading."""
        return np.asarray(self.slope_N_V.value * (np.asarray(volts, dtype=float) - zero_V))

    def gain_u_rel(self, weights_rel: float) -> float:
        """Relative standard uncertainty of a force: of the gain, and of all weights and the lever in common.

        The zero does not count: it is taken anew before each test (section 2.8).
        """
        return float(np.hypot(self.slope_N_V.u / self.slope_N_V.value, weights_rel))

    def summary(self) -> str:
        """Gain and the zero of each session with their 95 % intervals, and what was noticed."""
        held = f"{self.range_N[0]:g} to {self.range_N[1]:g} N"
        lines = [
            f"force = {self.slope_N_V.text('N/V')} x volts + zero, {held}; gain {_interval(self.slope_N_V)}"
        ]
        lines += [
            f"session {name}: zero {z.text('N')}; {_interval(z)}"
            for name, z in self.intercept_N.items()
        ]
        if self.shift_N is not None:
            lines.append(
                f"the zeros lie up to {self.shift_N.text('N')} apart: take the zero anew before each test"
            )
        lines.append(f"scatter {self.residual_sd_V:.2g} V, r squared {self.r_squared:.6f}")
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def card(self) -> pd.DataFrame:
        """The zero of each session."""
        return pd.DataFrame(
            {
                "session": [*self.intercept_N],
                "zero [N]": [str(e) for e in self.intercept_N.values()],
            }
        )

    def to_dict(self) -> dict[str, Any]:
        """Every estimate, the tests and the warnings."""
        return {**super().to_dict(), "warnings": list(messages(self.findings))}


def _interval(e: Estimate) -> str:
    return f"95 %: {e.low95:.6g} to {e.high95:.6g}"


def fit_transducer(volts: ArrayLike, force_N: ArrayLike, session: ArrayLike) -> TransducerLine:
    """The line of a dead-weight calibration: arrays of shape (N,), ``session`` names the occasion of each point.

    Weights are known and volts err, so volts = a_session + b force is fitted and turned round: slope = 1/b,
    intercept = -a/b. Raises InputError for fewer than 3 points, or sessions with fewer than 2.

    >>> line = fit_transducer([0.1, 0.2, 0.3, 0.15, 0.25], [0, 100, 200, 0, 100], [1, 1, 1, 2, 2])
    >>> round(line.slope_N_V.value), round(line.shift_N.value)
    (1000, 50)
    """
    v = np.asarray(volts, dtype=float)
    f = np.asarray(force_N, dtype=float)
    names, at = np.unique(np.asarray(session).astype(str), return_inverse=True)
    n = len(v)
    k = len(names)
    ok = np.isfinite(v) & np.isfinite(f)
    if not ok.all():
        raise InputError(
            f"point {int(np.argmin(ok)) + 1} of the transducer's calibration is no number"
        )
    if n < k + 2 or (np.bincount(at) < 2).any():
        raise InputError(
            f"{n} points in {k} session(s)", expected="at least 2 a session and 2 to spare"
        )
    line = fit_line(f, v, groups=at)
    b = line.slope
    a = line.intercepts
    if b == 0.0:
        raise InputError(
            "the transducer's volts do not follow the force", expected="different weights"
        )
    turned = np.diag([-1 / b**2, *np.full(k, -1 / b)])  # d(1/b, -a/b) / d(b, a)
    turned[1:, 0] = a / b**2
    covariance = turned @ line.covariance_95 @ turned.T
    zero = -a / b
    u = np.sqrt(np.diag(covariance))
    low = int(np.argmin(zero))
    high = int(np.argmax(zero))
    apart = np.zeros(k + 1)
    apart[[1 + low, 1 + high]] = -1.0, 1.0
    shift = (
        Estimate.normal(zero[high] - zero[low], float(np.sqrt(apart @ covariance @ apart)))
        if k > 1
        else None
    )
    p = _slopes_differ_p(line, at)
    return TransducerLine(
        Estimate.normal(1 / b, u[0]),
        {str(name): Estimate.normal(*pair) for name, *pair in zip(names, zero, u[1:])},
        line.sd,
        line.r_squared,
        p,
        shift,
        (float(f.min()), float(f.max())),
        (warning("transducer.slopes_differ", p=p),) if p is not None and p < 0.01 else (),
    )


def _slopes_differ_p(line: LineFit, at: NDArray[np.intp]) -> float | None:
    """p of the F test of a slope for each group against one for all; None where it cannot be made."""
    k = len(line.intercepts)
    dof = len(line.x) - 2 * k
    if k < 2 or dof < 1:
        return None
    own = 0.0
    for j in range(k):
        df, dv = (x[at == j] - x[at == j].mean() for x in (line.x, line.y))
        if not df @ df > 0:
            return None
        own += float(dv @ dv - (df @ dv) ** 2 / (df @ df))
    gained = max(line.sd**2 * line.dof - own, 0.0)
    return (
        float(scipy.special.fdtrc(k - 1, dof, gained / (line.dof - dof) / (own / dof)))
        if own > 0
        else None
    )


@dataclass(frozen=True)
class BearingFriction:
    """Lines of measured friction against load, one for each slow-shaft speed [rpm]; bearings of both shafts."""

    speeds_rpm: tuple[float, ...]
    lines: tuple[LineFit, ...]

    @property
    def load_range_N(self) -> tuple[float, float]:
        """Loads that every family covers [N]."""
        return max(float(k.x.min()) for k in self.lines), min(float(k.x.max()) for k in self.lines)

    def correction_N(self, load_N: ArrayLike, speed_slow_rpm: ArrayLike) -> tuple[Array, Array]:
        """What to add to the measured friction [N], and its standard uncertainty [N]: half of the measured lines.

        EHL friction = transducer + (intercept_n + slope_n load) / 2, straight between neighbouring speeds, the
        nearest family beyond them. The pure-rolling test measured both shafts; their bearings are alike, hence
        half.
        """
        load, rpm = np.broadcast_arrays(
            np.asarray(load_N, dtype=float), np.asarray(speed_slow_rpm, dtype=float)
        )
        friction = np.zeros(load.shape)
        variance = np.zeros(load.shape)
        for line, hat in zip(self.lines, np.eye(len(self.lines))):
            part = np.interp(rpm, self.speeds_rpm, hat)
            (ss, sa), (_, aa) = line.covariance_95
            friction = friction + part * (line.intercept + line.slope * load)
            variance = variance + part**2 * (ss * load**2 + 2 * sa * load + aa)
        return np.asarray(0.5 * friction), np.asarray(0.5 * np.sqrt(variance))

    def outside(self, load_N: ArrayLike, speed_slow_rpm: ArrayLike) -> Flags:
        """Where load or speed lies outside what was measured: the correction is extrapolated there."""
        load = np.asarray(load_N, dtype=float)
        rpm = np.asarray(speed_slow_rpm, dtype=float)
        low, high = self.load_range_N
        slow = min(self.speeds_rpm) * 0.98
        fast = max(self.speeds_rpm) * 1.02
        return np.asarray((load < low) | (load > high) | (rpm < slow) | (rpm > fast))


def fit_bearing_friction(
    load_N: ArrayLike, friction_N: ArrayLike, speed_slow_rpm: ArrayLike
) -> BearingFriction:
    """Lines of the pure-rolling test, arrays of shape (N,); points within 2 % of one speed make a family.

    Raises InputError for a family with fewer than 3 points.

    >>> load = [800.0, 1500.0, 2300.0] * 2
    >>> both = fit_bearing_friction(load, [5.0, 6.0, 7.14, 8.0, 9.0, 10.14], [774.0] * 3 + [1546.0] * 3)
    >>> round(float(both.correction_N(1500.0, 774.0)[0]), 2)
    3.0
    """
    load = np.asarray(load_N, dtype=float)
    friction = np.asarray(friction_N, dtype=float)
    rpm = np.asarray(speed_slow_rpm, dtype=float)
    order = np.argsort(rpm, kind="stable")
    edges = np.flatnonzero(np.diff(rpm[order]) > 0.02 * rpm[order][:-1]) + 1
    families = np.split(order, edges)
    for family in families:
        if len(family) < 3:
            raise InputError(
                f"{len(family)} points at {rpm[family].mean():.4g} rpm",
                expected="at least 3 loads a speed",
            )
    speeds = tuple(float(rpm[family].mean()) for family in families)
    return BearingFriction(
        speeds, tuple(fit_line(load[family], friction[family]) for family in families)
    )
