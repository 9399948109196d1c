"""Calibration of the force transducers by dead weights, and friction of the shafts' bearings.

Used by ``tcdyn rig transducer`` (``tcdyn.cli.record``), the operating conditions of a test
(:mod:`tcdyn.partition.operating_conditions`) and ``tcdyn verify``. Figures 2.21 and
2.25 of the thesis. Tests: ``tests/calibration/test_transducers.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtrc

from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, labelled_messages, messages, warning
from tcdyn.core.result import Result, estimates_frame
from tcdyn.estimation.line_fit import LineFit, fit_line

# Level of the F test of a common slope of all sessions.
SLOPE_SIGNIFICANCE = 0.01
# Speeds within this relative distance belong to one family of the pure-rolling test.
SAME_SPEED = 0.02


@dataclass(frozen=True, repr=False)
class TransducerLine(Result):
    """Calibration line force_N = slope_N_V * volts + intercept_N[session] (figure 2.21).

    Parameters
    ----------
    slope_N_V, intercept_N
        Gain, and the zero of each session.
    residual_sd_V, r_squared
        Scatter about the line.
    slopes_differ_p
        p of the test of one slope for all sessions; None for one session.
    shift_N
        Largest intercept minus the smallest; None for one session.
    range_N
        Smallest and largest weight.
    findings
        Findings about the line.
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
        """Force from a reading of the transducer [N].

        Parameters
        ----------
        volts
            Readings of any shape [V].
        zero_V
            Reading before loading [V].

        Returns
        -------
        force
            [N], of the shape of ``volts``.
        """
        return np.asarray(self.slope_N_V.value * (np.asarray(volts, dtype=float) - zero_V))

    def gain_u_rel(self, weights_rel: float) -> float:
        """Relative standard uncertainty of a force, from gain, weights and lever.

        The zero does not contribute: it is measured before each test (section 2.8).

        Parameters
        ----------
        weights_rel
            Common relative standard uncertainty of the weights and the lever.
        """
        return float(np.hypot(self.slope_N_V.u / self.slope_N_V.value, weights_rel))

    def summary(self) -> str:
        """Gain and zeros with their 95 % intervals, and the findings."""
        low, high = self.range_N
        gain = self.slope_N_V
        lines = [
            f"force = {gain.text('N/V')} x volts + zero, {low:g} to {high:g} N; "
            f"gain {_interval_text(gain)}"
        ]
        for name, zero in self.intercept_N.items():
            lines.append(f"session {name}: zero {zero.text('N')}; {_interval_text(zero)}")
        if self.shift_N is not None:
            lines.append(
                f"the zeros lie up to {self.shift_N.text('N')} apart: "
                "take the zero anew before each test"
            )
        lines.append(f"scatter {self.residual_sd_V:.2g} V, r squared {self.r_squared:.6f}")
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def to_frame(self) -> pd.DataFrame:
        """Gain, and the zero of each session."""
        zeros = {f"zero {session}": e for session, e in self.intercept_N.items()}
        units = ["N/V"] + ["N"] * len(zeros)
        return estimates_frame({"gain": self.slope_N_V, **zeros}, units)

    def to_dict(self) -> dict[str, Any]:
        """Every estimate, the tests and the warnings."""
        return {**super().to_dict(), "warnings": list(messages(self.findings))}


def _interval_text(estimate: Estimate) -> str:
    """The 95 % interval as text."""
    return f"95 %: {estimate.low95:.6g} to {estimate.high95:.6g}"


def fit_transducer(volts: ArrayLike, force_N: ArrayLike, session: ArrayLike) -> TransducerLine:
    """Fit the line of a dead-weight calibration, arrays of shape (N,).

    Parameters
    ----------
    volts
        Readings of the transducer [V].
    force_N
        Force of the weights.
    session
        Session of each point; the zero may differ between sessions.

    Returns
    -------
    line
        Gain, zeros and findings.

    Raises
    ------
    InputError
        Fewer than 3 points, or a session with fewer than 2.

    Notes
    -----
    The weights are exact and the volts have errors, so volts = a_session + b force is fitted and
    inverted: slope = 1/b, intercept = -a/b.

    ``SLOPE_SIGNIFICANCE`` decides a warning only; the common slope is used in any case.

    Examples
    --------
    >>> line = fit_transducer([0.1, 0.2, 0.3, 0.15, 0.25], [0, 100, 200, 0, 100], [1, 1, 1, 2, 2])
    >>> round(line.slope_N_V.value), round(line.shift_N.value)
    (1000, 50)
    """
    v = np.asarray(volts, dtype=float)
    f = np.asarray(force_N, dtype=float)
    names, group = np.unique(np.asarray(session).astype(str), return_inverse=True)
    n = len(v)
    k = len(names)
    ok = np.isfinite(v) & np.isfinite(f)
    if not ok.all():
        raise InputError(
            f"point {int(np.argmin(ok)) + 1} of the transducer's calibration is no number"
        )
    if n < k + 2 or (np.bincount(group) < 2).any():
        raise InputError(
            f"{n} points in {k} session(s)", expected="at least 2 a session and 2 to spare"
        )
    line = fit_line(f, v, groups=group)
    b = line.slope
    a = line.intercepts
    if b == 0.0:
        raise InputError(
            "the transducer's volts do not follow the force", expected="different weights"
        )
    jacobian = np.diag([-1 / b**2, *np.full(k, -1 / b)])  # d(1/b, -a/b) / d(b, a)
    jacobian[1:, 0] = a / b**2
    covariance = jacobian @ line.covariance_95 @ jacobian.T
    zero = -a / b
    u = np.sqrt(np.diag(covariance))
    p = _slopes_differ_p(line, group)
    findings: tuple[Finding, ...] = ()
    if p is not None and p < SLOPE_SIGNIFICANCE:
        findings = (warning("transducer.slopes_differ", p=p),)
    return TransducerLine(
        slope_N_V=Estimate.normal(1 / b, u[0]),
        intercept_N={str(name): Estimate.normal(*pair) for name, *pair in zip(names, zero, u[1:])},
        residual_sd_V=line.sd,
        r_squared=line.r_squared,
        slopes_differ_p=p,
        shift_N=_largest_shift(zero, covariance) if k > 1 else None,
        range_N=(float(f.min()), float(f.max())),
        findings=findings,
    )


def _largest_shift(zero: Array, covariance: Array) -> Estimate:
    """Largest zero minus the smallest, with its uncertainty [N].

    Parameters
    ----------
    zero
        Zeros of the sessions (K,) [N].
    covariance
        Of slope and zeros (K + 1, K + 1).
    """
    low = int(np.argmin(zero))
    high = int(np.argmax(zero))
    difference = np.zeros(len(zero) + 1)
    difference[1 + low] = -1.0
    difference[1 + high] = 1.0
    u = float(np.sqrt(difference @ covariance @ difference))
    return Estimate.normal(zero[high] - zero[low], u)


def _slopes_differ_p(line: LineFit, group: NDArray[np.intp]) -> float | None:
    """p of the F test of one slope for each group against one for all; None if impossible.

    Parameters
    ----------
    line
        Line with one slope.
    group
        Session of each point (N,).

    Returns
    -------
    p
        None for one group, without a degree of freedom, or without scatter.
    """
    k = len(line.intercepts)
    dof = len(line.x) - 2 * k
    if k < 2 or dof < 1:
        return None
    separate_sum = 0.0  # residual sum of squares with one slope for each group
    for j in range(k):
        x = line.x[group == j] - line.x[group == j].mean()
        y = line.y[group == j] - line.y[group == j].mean()
        if not x @ x > 0:
            return None
        separate_sum += float(y @ y - (x @ y) ** 2 / (x @ x))
    if not separate_sum > 0:
        return None
    reduction = max(line.sd**2 * line.dof - separate_sum, 0.0)
    f_ratio = reduction / (line.dof - dof) / (separate_sum / dof)
    return float(fdtrc(k - 1, dof, f_ratio))


@dataclass(frozen=True, repr=False)
class BearingFriction(Result):
    """Friction of the bearings of both shafts: a line against load for each slow-shaft speed.

    Attributes
    ----------
    speeds_rpm
        Mean speed of the slow shaft of each family, rising.
    lines
        Line of friction [N] over load [N] of each family.
    """

    speeds_rpm: tuple[float, ...]
    lines: tuple[LineFit, ...]

    def summary(self) -> str:
        """The line of each speed."""
        return "\n".join(
            f"{rpm:.0f} rpm: friction = {row.slope:.4g} x load + {row.intercept_N:.3g} N"
            for rpm, row in zip(self.speeds_rpm, self.to_frame().itertuples())
        )

    def to_frame(self) -> pd.DataFrame:
        """The line of each speed: slope [1] and intercept with their standard uncertainties."""
        rows = []
        for line in self.lines:
            slope_u, intercept_u = np.sqrt(np.diag(line.covariance_95))
            rows.append((line.slope, slope_u, line.intercept, intercept_u))
        columns = ["slope", "slope_u", "intercept_N", "intercept_u_N"]
        return pd.DataFrame(rows, pd.Index(self.speeds_rpm, name="speed_rpm"), columns)

    @property
    def load_range_N(self) -> tuple[float, float]:
        """Loads that every family covers [N].

        Returns
        -------
        low, high
            [N].
        """
        low = max(float(line.x.min()) for line in self.lines)
        high = min(float(line.x.max()) for line in self.lines)
        return low, high

    def correction_N(self, load_N: ArrayLike, speed_slow_rpm: ArrayLike) -> tuple[Array, Array]:
        """Correction to add to the measured friction, and its standard uncertainty.

        EHL friction = transducer + (intercept_n + slope_n load) / 2, linear between neighbouring
        speeds, with the nearest family beyond them. The pure-rolling test measured both shafts,
        whose bearings are equal, hence half of the measured lines.

        Parameters
        ----------
        load_N
            Loads of any shape [N].
        speed_slow_rpm
            Speed of the slow shaft [rpm]; shapes that broadcast.

        Returns
        -------
        correction, u
            [N], of the common shape.

        Notes
        -----
        The factor one half holds for equal bearings on both shafts. Test:
        ``tests/calibration/test_transducers.py``.
        """
        load, rpm = np.broadcast_arrays(
            np.asarray(load_N, dtype=float), np.asarray(speed_slow_rpm, dtype=float)
        )
        friction = np.zeros(load.shape)
        variance = np.zeros(load.shape)
        for line, hat_function in zip(self.lines, np.eye(len(self.lines))):
            weight = np.interp(rpm, self.speeds_rpm, hat_function)
            (ss, sa), (_, aa) = line.covariance_95
            friction = friction + weight * (line.intercept + line.slope * load)
            variance = variance + weight**2 * (ss * load**2 + 2 * sa * load + aa)
        return np.asarray(0.5 * friction), np.asarray(0.5 * np.sqrt(variance))

    def outside(self, load_N: ArrayLike, speed_slow_rpm: ArrayLike) -> Flags:
        """Where load or speed is outside the measured range, and the correction is extrapolated.

        Parameters
        ----------
        load_N, speed_slow_rpm
            As in :meth:`correction_N`.

        Returns
        -------
        flags
            Of the common shape.
        """
        load = np.asarray(load_N, dtype=float)
        rpm = np.asarray(speed_slow_rpm, dtype=float)
        low, high = self.load_range_N
        slow = min(self.speeds_rpm) * (1 - SAME_SPEED)
        fast = max(self.speeds_rpm) * (1 + SAME_SPEED)
        return np.asarray((load < low) | (load > high) | (rpm < slow) | (rpm > fast))


def fit_bearing_friction(
    load_N: ArrayLike, friction_N: ArrayLike, speed_slow_rpm: ArrayLike
) -> BearingFriction:
    """Fit the lines of the pure-rolling test, arrays of shape (N,).

    Points within 2 % of one speed make a family.

    Parameters
    ----------
    load_N
        Loads (N,) [N].
    friction_N
        Friction of both shafts (N,) [N].
    speed_slow_rpm
        Speed of the slow shaft (N,) [rpm].

    Raises
    ------
    InputError
        A family has fewer than 3 points.

    Notes
    -----
    ``SAME_SPEED`` must be smaller than the distance of the speeds of the test.

    Examples
    --------
    >>> load = [800.0, 1500.0, 2300.0] * 2
    >>> friction = [5.0, 6.0, 7.14, 8.0, 9.0, 10.14]
    >>> both = fit_bearing_friction(load, friction, [774.0] * 3 + [1546.0] * 3)
    >>> round(float(both.correction_N(1500.0, 774.0)[0]), 2)
    3.0
    """
    load = np.asarray(load_N, dtype=float)
    friction = np.asarray(friction_N, dtype=float)
    rpm = np.asarray(speed_slow_rpm, dtype=float)
    order = np.argsort(rpm, kind="stable")
    edges = np.flatnonzero(np.diff(rpm[order]) > SAME_SPEED * rpm[order][:-1]) + 1
    families = np.split(order, edges)
    for family in families:
        if len(family) < 3:
            raise InputError(
                f"{len(family)} points at {rpm[family].mean():.4g} rpm",
                expected="at least 3 loads a speed",
            )
    speeds = tuple(float(rpm[family].mean()) for family in families)
    lines = tuple(fit_line(load[family], friction[family]) for family in families)
    return BearingFriction(speeds, lines)
