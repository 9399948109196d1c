"""Hole and cement comparison (section 5.4): extra lag of cemented over clamped sensors.

Used by the command ``tcdyn rig holes`` (``tcdyn.cli.calibrate``) and drawn by
``tcdyn.plots.draw_holes``. All junctions have the same depth, so the difference of their lags does
not depend on the bath, h or the entry. Thresholds are chosen by judgement. Tests:
``tests/immersion/test_plunge_hole.py``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from immersion.cylinder import lag_on_grid
from immersion.entry import EntryEvent, find_entry
from immersion.plunge_data import block_sd, make_averages, variance_factors, without_spikes
from immersion.radial import GridInterpolation, plunge_grid
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Problem, minimise
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.rig.rigfile import load_rig

MIN_LAG_S = 0.02  # lower bound of a lag [s]; chosen by judgement
MAX_STEP_S = 0.3  # largest step of an extra lag in one iteration [s]; chosen by judgement
BEFORE_S = 5.0  # record before the entry that is used [s]; chosen by judgement
LONGEST_BLOCK_S = 1.0  # longest block of samples that are averaged [s]; chosen by judgement
# Knots of x: first spacing [s]; end of the uniform knots after the entry [s]; growth from knot to
# knot after it; longest spacing [s]. The bath changes x fast only after the entry. By judgement.
FIRST_KNOT_STEP_S = 0.06
UNIFORM_KNOTS_S = 1.5
KNOT_STEP_GROWTH = 1.08
LAST_KNOT_STEP_S = 3.0
# Difference of two ideal channels over its u, beyond which there is a warning.
IDEAL_DIFFERENCE_U = 2.0
OTHER_COLUMNS = ("probe", "fluid", "prt", "ambient", "oil")  # temperatures that are no junctions
Verdict = Literal["as good as ideal", "acceptable", "too slow", "undecided"]


@dataclass(frozen=True)
class Hole:
    """One cemented thermocouple: extra lag over the clamped ones [s], verdict, and a sentence.

    Attributes
    ----------
    name
        Name of the channel.
    diameter_mm
        Diameter of the hole from the name; None where the name has none.
    extra_lag_s
        Extra lag over the mean of the clamped thermocouples [s].
    verdict
        Result of the comparison with the limit.
    sentence
        The result in words.
    """

    name: str
    diameter_mm: float | None
    extra_lag_s: Estimate
    verdict: Verdict
    sentence: str


@dataclass(frozen=True, repr=False)
class HoleComparison(Result):
    """Cemented thermocouples relative to the clamped ones, and those relative to each other.

    Attributes
    ----------
    holes
        One result for each cemented thermocouple.
    ideal_spread_s
        Difference of the lags of the first two clamped thermocouples; None for one.
    limit_s
        Largest acceptable extra lag [s].
    u_depth_s
        Standard uncertainty of an extra lag from the depths of the junctions [s].
    entry
        Entry into the bath.
    names
        Channels, the clamped ones first (C).
    block_time_s, readings_degC, fitted_degC
        Block means (B,), (B, C) and their fit (B, C).
    findings
        Warnings and infos.
    """

    holes: tuple[Hole, ...]
    ideal_spread_s: Estimate | None
    limit_s: float
    u_depth_s: float
    entry: EntryEvent
    names: tuple[str, ...]
    block_time_s: Array
    readings_degC: Array
    fitted_degC: Array
    findings: tuple[Finding, ...]

    def to_frame(self) -> pd.DataFrame:
        """The table by hole."""
        return self.table().set_index("hole")

    def table(self) -> pd.DataFrame:
        """One row a hole."""
        return pd.DataFrame(
            {
                "hole": h.name,
                "diameter_mm": h.diameter_mm,
                "extra_lag_s": h.extra_lag_s.value,
                "u_s": h.extra_lag_s.u,
                "low95_s": h.extra_lag_s.low95,
                "high95_s": h.extra_lag_s.high95,
                "verdict": h.verdict,
            }
            for h in self.holes
        )

    def summary(self) -> str:
        """A sentence a hole."""
        return "\n".join(h.sentence for h in self.holes)

    def to_dict(self) -> dict[str, Any]:
        """Extra lags with their verdicts, the limit and the warnings."""
        return {
            "holes": jsonable(self.table()),
            "limit_s": self.limit_s,
            "warnings": list(self.warnings),
        }

    def card(self) -> pd.DataFrame:
        """One row a hole, formatted for display."""
        return pd.DataFrame(
            {
                "hole": h.name,
                "diameter [mm]": h.diameter_mm,
                "extra lag [s]": h.extra_lag_s,
                "95 % interval [s]": f"{h.extra_lag_s.low95:.3f} to {h.extra_lag_s.high95:.3f}",
                "verdict": h.verdict,
            }
            for h in self.holes
        )


@one_blas_thread
def compare_holes(
    frame: pd.DataFrame,
    *,
    ideal: Sequence[str] | None = None,
    limit_s: float = 0.20,
    reference_lag_s: float = 0.25,
    depth_m: float = 3e-3,
    depth_u_m: float = 5e-5,
    diffusivity_m2_s: float | None = None,
    gain_u: float = 1e-3,
    entry: EntryEvent | None = None,
    where: str = "hole log",
) -> HoleComparison:
    """Extra lags of cemented thermocouples relative to clamped (ideal) ones in one plunge.

    Parameters
    ----------
    frame
        Log with ``time_s`` and the ``*_degC`` columns of the junctions; probe, fluid, PRT, ambient
        and oil are not junctions.
    ideal
        Names of the ideal channels without unit; None: those that start with "ideal".
    limit_s
        Largest acceptable extra lag [s].
    reference_lag_s
        Lag of the ideal channels [s]. It sets how sharp the features of x are.
    depth_m, depth_u_m
        Depth of the junctions and its standard uncertainty [m].
    diffusivity_m2_s
        Thermal diffusivity alpha; None: that of the default rig.
    gain_u
        Standard uncertainty of the gain of a channel.
    entry
        Entry into the bath; None: found from switch and probe.
    where
        Name of the log, for messages.

    Returns
    -------
    comparison
        One result a hole, and the fitted blocks.

    Raises
    ------
    InputError
        For fewer than one ideal and one other channel, or no entry in the record.

    Notes
    -----
    All junctions have the same depth, so they have the same temperature x(t), whatever the bath
    does. Model: channel k reads L_k x + offset + gain error, with L_k a lag of reference_lag_s +
    extra_k, where extra is zero on average over the ideal channels. x is piecewise linear and
    fitted with all other parameters, so noise of the ideal channels gives no bias. An uncertainty
    of the depths shifts the result by depth_u depth / alpha, which is added to u.

    A hole is too slow when its interval is above ``limit_s``, acceptable when it is below,
    undecided when it contains the limit.

    ``limit_s`` and the verdicts change no lag. ``reference_lag_s`` hardly matters, because only
    differences of lags are estimated. The steps of the spike filter, blocks and noise are those of
    :mod:`immersion.plunge_data`. Test: ``tests/immersion/test_plunge_hole.py``.
    """
    names = [c.removesuffix("_degC") for c in frame.columns if c.endswith("_degC")]
    names = [n for n in names if n not in OTHER_COLUMNS]
    ideals = [n for n in names if n.startswith("ideal")] if ideal is None else list(ideal)
    cemented = [n for n in names if n not in ideals]
    if not ideals or not cemented or any(n not in names for n in ideals):
        raise InputError(
            f"{len(ideals)} ideal and {len(cemented)} other channels",
            where=where,
            expected="columns such as ideal_1_degC, ideal_2_degC, d1p3_degC",
        )
    order = [*ideals, *cemented]
    t = frame["time_s"].to_numpy(dtype=float)
    if entry is None:
        entry = find_entry(
            t,
            _column_or_none(frame, "switch"),
            _column_or_none(frame, "probe_degC"),
            _column_or_none(frame, "fluid_degC"),
            where,
        )
    readings = frame[[f"{n}_degC" for n in order]].to_numpy(dtype=float)
    used = t >= entry.time_s - BEFORE_S
    clean, spikes = without_spikes(readings[used])
    dt_s = float(np.median(np.diff(t)))
    time, mean, count = make_averages(t[used] - entry.time_s, clean, dt_s, LONGEST_BLOCK_S)
    noise = white_noise_sd(clean)
    extra, covariance, fitted = _fit_blocks(
        time, mean, count, noise, len(ideals), reference_lag_s, gain_u
    )
    findings = [*entry.findings]
    if spikes:
        findings.append(info("plunge.spikes", count=spikes))
    alpha = diffusivity_m2_s
    if alpha is None:
        alpha = load_rig().disk_setup("").diffusivity_m2_s
    depth_shift_s = depth_u_m * depth_m / alpha
    u_depth = depth_shift_s * float(np.sqrt(1 + 1 / len(ideals)))
    variance = np.diag(covariance)
    cemented_rows = zip(cemented, extra[len(ideals) :], variance[len(ideals) :])
    holes = tuple(_result_of_hole(n, value, v, u_depth, limit_s) for n, value, v in cemented_rows)
    spread = None
    if len(ideals) >= 2:
        u = np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
        spread = Estimate.normal(float(extra[0] - extra[1]), float(u))
        allowed = IDEAL_DIFFERENCE_U * float(np.hypot(spread.u, np.sqrt(2) * depth_shift_s))
        if abs(spread.value) > allowed:
            findings.append(warning("hole.ideal", apart_s=abs(spread.value)))
    return HoleComparison(
        holes, spread, limit_s, u_depth, entry, tuple(order), time, mean, fitted, tuple(findings)
    )


def _column_or_none(frame: pd.DataFrame, column: str) -> Array | None:
    """A column as numbers (N,); None where the log has none."""
    return frame[column].to_numpy(dtype=float) if column in frame else None


def _knots(end: float) -> Array:
    """Knots of x after the entry [s], close together at first.

    Parameters
    ----------
    end
        Last time [s].

    Returns
    -------
    knots
        (K,) [s], from 0 to ``end`` or beyond.

    Notes
    -----
    The spacing limits how fast x can change. More knots cost time.
    """
    knots = [0.0]
    step = FIRST_KNOT_STEP_S
    while knots[-1] < end:
        knots.append(knots[-1] + step)
        if knots[-1] > UNIFORM_KNOTS_S:
            step = min(step * KNOT_STEP_GROWTH, LAST_KNOT_STEP_S)
    return np.array(knots)


def _fit_blocks(
    time: Array, mean: Array, count: Array, noise: Array, ideals: int, base_s: float, gain_u: float
) -> tuple[Array, Array, Array]:
    """Fit the common temperature x and the extra lag of each channel to the blocks.

    Parameters are the knots of x, then offset, gain error and extra lag of each channel. Extra lags
    and gain errors of the ideal channels are zero on average.

    Parameters
    ----------
    time
        Mean times of the blocks after the entry (B,) [s].
    mean, count
        Mean readings and number of samples (B, C).
    noise
        White noise of one sample (C,) [K].
    ideals
        Number of ideal channels; they come first.
    base_s
        Lag of the ideal channels [s].
    gain_u
        Standard uncertainty of the gain of a channel [1].

    Returns
    -------
    extra
        Extra lags (C,) [s].
    covariance
        (C, C) [s2].
    fitted
        Fitted blocks (B, C) [degC].

    Notes
    -----
    The first pass fits x and the offsets only. Three passes with all parameters follow; each
    estimates one variance factor, at least one, from the residuals of the pass before.
    """
    c = mean.shape[1]
    grid = plunge_grid(float(time[-1]) + 1.0, longest_s=1.0)
    dt = np.diff(grid)
    reading = GridInterpolation.at(grid, time)
    knots = _knots(float(time[-1]))
    hats = np.column_stack([np.interp(grid, knots, row) for row in np.eye(len(knots))[1:]])
    m = hats.shape[1]
    offset = slice(m, m + c)
    gain = slice(m + c, m + 2 * c)
    extra = slice(m + 2 * c, m + 3 * c)
    names = (
        *(f"x_{k}" for k in range(m)),
        *(f"{kind}_{k}" for kind in ("offset", "gain", "extra") for k in range(c)),
    )
    n = len(names)

    def model(theta: Array) -> tuple[Array, Array]:
        """Blocks (B, C) and their Jacobian (B, C, P)."""
        y = np.empty((len(time), c))
        jacobian = np.zeros((len(time), c, n))
        for k in range(c):
            tau = base_s + theta[extra][k]
            lagged = lag_on_grid(hats, dt, 1 / tau)
            lagged_twice = lag_on_grid(lagged, dt, 1 / tau)
            factor = 1 + theta[gain][k]
            shape = reading.value(lagged.T).T
            by_tau = reading.value((lagged_twice - lagged).T / tau).T
            response = shape @ theta[:m]
            y[:, k] = factor * response + theta[offset][k]
            jacobian[:, k, :m] = factor * shape
            jacobian[:, k, offset.start + k] = 1.0
            jacobian[:, k, gain.start + k] = response
            jacobian[:, k, extra.start + k] = factor * (by_tau @ theta[:m])
        return y, jacobian

    gauge = np.zeros((2, n))
    gauge[0, gain.start : gain.start + ideals] = 1.0
    gauge[1, extra.start : extra.start + ideals] = 1.0
    prior_sd = np.full(n, np.inf)
    prior_sd[gain] = gain_u
    lower = np.full(n, -np.inf)
    lower[extra] = MIN_LAG_S - base_s
    largest = np.full(n, np.inf)
    largest[extra] = MAX_STEP_S
    theta = np.zeros(n)
    variance_factor = 1.0
    only_x_and_offsets = np.eye(n)[gain.start :]
    for fixed in (only_x_and_offsets, None, None, None):
        sd = block_sd(noise, count) * np.sqrt(variance_factor)

        def evaluate(theta: Array, sd: Array = sd) -> tuple[Array, Array]:
            """Standardised residuals (B C,) and their Jacobian (B C, P), for ``Problem``."""
            y, jacobian = model(theta)
            return ((y - mean) / sd).ravel(), (jacobian / sd[:, :, None]).reshape(-1, n)

        problem = Problem(
            names, evaluate, np.zeros(n), prior_sd, lower=lower, max_step=largest, fixed=gauge
        )
        best = minimise(problem, theta, fixed=fixed)
        theta = best.theta
        if fixed is None:
            z = best.residual.reshape(-1, c) * np.sqrt(variance_factor)
            variance_factor = max(variance_factors(z, m, 3 * c)[1], 1.0)
    return theta[extra], best.covariance[extra, extra], model(theta)[0]


def _result_of_hole(name: str, extra: float, variance: float, u_depth: float, limit: float) -> Hole:
    """Result for one cemented thermocouple; a name such as d1p3 contains the diameter 1.3 mm.

    Parameters
    ----------
    name
        Name of the channel.
    extra, variance
        Extra lag [s] and its variance from the fit [s2].
    u_depth
        Standard uncertainty from the depths [s].
    limit
        Largest acceptable extra lag [s].
    """
    estimate = Estimate.normal(float(extra), float(np.hypot(np.sqrt(variance), u_depth)))
    match = re.search(r"(\d+)[p.](\d+)", name)
    diameter = float(f"{match[1]}.{match[2]}") if match else None
    verdict = _verdict(estimate, limit)
    label = f"{diameter:g} mm hole" if diameter else name
    sentence = (
        f"{label}: {estimate.value:+.3f} s against the clamped thermocouples (95 %: "
        f"{estimate.low95:.3f} to {estimate.high95:.3f} s; limit {limit:g} s): {verdict}."
    )
    return Hole(name, diameter, estimate, verdict, sentence)


def _verdict(extra_lag: Estimate, limit_s: float) -> Verdict:
    """Compare the 95 % interval of an extra lag with the limit and with zero."""
    if extra_lag.low95 > limit_s:
        return "too slow"
    if extra_lag.high95 >= limit_s:
        return "undecided"
    return "as good as ideal" if extra_lag.low95 <= 0 else "acceptable"
