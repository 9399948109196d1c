"""Hole and cement comparison (section 5.4): how much later cemented thermocouples answer than clamped ones."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from immersion.cylinder import lag_on_grid
from immersion.entry import EntryEvent, find_entry
from immersion.plunge_data import block_sd, inflation, make_averages, without_spikes
from immersion.radial import Reading, plunge_grid
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, messages, warning
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Problem, minimise
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.rig.rigfile import load_rig

Verdict = Literal["as good as ideal", "acceptable", "too slow", "undecided"]


@dataclass(frozen=True)
class Hole:
    """One cemented thermocouple: extra lag against the clamped ones [s], its verdict, and a sentence."""

    name: str
    diameter_mm: float | None
    extra_lag_s: Estimate
    verdict: Verdict
    sentence: str


@dataclass(frozen=True)
class HoleComparison(Result):
    """Every cemented thermocouple against the clamped ones, and the clamped ones against each other."""

    holes: tuple[Hole, ...]
    ideal_spread_s: Estimate | None
    limit_s: float
    u_depth_s: float
    entry: EntryEvent
    names: tuple[str, ...]
    block_time_s: Array
    readings_degC: Array  # (B, C)
    fitted_degC: Array  # (B, C)
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return messages(self.findings)

    def table(self) -> pd.DataFrame:
        """One row a hole."""
        lag = {"value": "extra_lag_s", "u": "u_s", "low95": "low95_s", "high95": "high95_s"}
        return pd.DataFrame(
            {
                "hole": h.name,
                "diameter_mm": h.diameter_mm,
                **{column: getattr(h.extra_lag_s, part) for part, column in lag.items()},
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
        """One row a hole, as people read it."""
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
    """Extra lags of all ``*_degC`` columns (but probe, fluid, PRT) against the ``ideal`` ones (names without unit).

    All junctions lie equally deep, so they see one temperature x(t), whatever the bath does. Model: channel k reads
    L_k x + offset + gain error, L_k a lag of reference_lag_s + extra_k, with extra zero on the average of the ideal
    ones; x is a chain of straight lines fitted with everything else, so noise in the ideal channels does no harm.
    ``reference_lag_s`` only sets how rough x is. Junction depths uncertain by ``depth_u_m`` move the answer by
    depth_u depth / alpha, which is added to u; alpha is ``diffusivity_m2_s``, where None that of the default rig.
    A hole is too slow when its interval lies above ``limit_s``, acceptable
    when it lies below, undecided when it straddles.

    Raises InputError for fewer than one ideal and one other channel, or no entry in the record.
    """
    names = [c.removesuffix("_degC") for c in frame.columns if c.endswith("_degC")]
    names = [n for n in names if n not in ("probe", "fluid", "prt", "ambient", "oil")]
    good = [n for n in names if n.startswith("ideal")] if ideal is None else list(ideal)
    others = [n for n in names if n not in good]
    if not good or not others or any(g not in names for g in good):
        raise InputError(
            f"{len(good)} ideal and {len(others)} other channels",
            where=where,
            expected="columns such as ideal_1_degC, ideal_2_degC, d1p3_degC",
        )
    order = [*good, *others]
    t = frame["time_s"].to_numpy(dtype=float)
    if entry is None:
        columns = {
            c: frame[c].to_numpy(dtype=float)
            for c in ("switch", "probe_degC", "fluid_degC")
            if c in frame
        }
        entry = find_entry(
            t, columns.get("switch"), columns.get("probe_degC"), columns.get("fluid_degC"), where
        )
    readings = np.column_stack([frame[f"{n}_degC"].to_numpy(dtype=float) for n in order])
    keep = t >= entry.time_s - 5.0
    clean, spikes = without_spikes(readings[keep])
    time, mean, count = make_averages(
        t[keep] - entry.time_s, clean, float(np.median(np.diff(t))), 1.0
    )
    extra, covariance, fitted = _fit(
        time, mean, count, white_noise_sd(clean), len(good), reference_lag_s, gain_u
    )
    findings = [*entry.findings]
    if spikes:
        findings.append(info("plunge.spikes", count=spikes))
    alpha = (
        load_rig().disk_setup("").diffusivity_m2_s if diffusivity_m2_s is None else diffusivity_m2_s
    )
    shift = depth_u_m * depth_m / alpha
    u_depth = shift * float(np.sqrt(1 + 1 / len(good)))
    holes = tuple(
        _hole(n, extra[k], covariance[k, k], u_depth, limit_s)
        for k, n in enumerate(order)
        if k >= len(good)
    )
    spread = None
    if len(good) >= 2:
        u = np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
        spread = Estimate.normal(float(extra[0] - extra[1]), float(u))
        allowed = 2 * float(np.hypot(spread.u, np.sqrt(2) * shift))
        if abs(spread.value) > allowed:
            findings.append(warning("hole.ideal", apart_s=abs(spread.value)))
    return HoleComparison(
        holes, spread, limit_s, u_depth, entry, tuple(order), time, mean, fitted, tuple(findings)
    )


def _knots(end: float) -> Array:
    knots = [0.0]
    step = 0.06
    while knots[-1] < end:
        knots.append(knots[-1] + step)
        if knots[-1] > 1.5:
            step = min(step * 1.08, 3.0)
    return np.array(knots)


def _fit(
    time: Array, mean: Array, count: Array, noise: Array, ideals: int, base_s: float, gain_u: float
) -> tuple[Array, Array, Array]:
    """Extra lags (C,), their covariance (C, C) and the fitted blocks (B, C).

    Parameters are the knots of x, then each channel's offset, gain error and extra lag. Extra lags and gain errors of
    the ideal ones are zero on the average.
    """
    c = mean.shape[1]
    grid = plunge_grid(float(time[-1]) + 1.0, longest_s=1.0)
    dt, reading = np.diff(grid), Reading.at(grid, time)
    knots = _knots(float(time[-1]))
    hats = np.column_stack([np.interp(grid, knots, row) for row in np.eye(len(knots))[1:]])
    m = hats.shape[1]
    offset, gain, extra = (slice(m + k * c, m + (k + 1) * c) for k in range(3))
    names = tuple(
        f"{kind}_{k}"
        for kind, n in (("x", m), ("offset", c), ("gain", c), ("extra", c))
        for k in range(n)
    )

    def model(theta: Array) -> tuple[Array, Array]:
        """Blocks (B, C) and their Jacobian (B, C, P)."""
        y = np.empty((len(time), c))
        jacobian = np.zeros((len(time), c, len(names)))
        for k in range(c):
            tau = base_s + theta[extra][k]
            lagged = np.asarray(lag_on_grid(hats, dt, 1 / tau), dtype=float)
            again = np.asarray(lag_on_grid(lagged, dt, 1 / tau), dtype=float)
            size = 1 + theta[gain][k]
            shape = reading.value(lagged.T).T
            by_tau = reading.value((again - lagged).T / tau).T
            seen = shape @ theta[:m]
            y[:, k] = size * seen + theta[offset][k]
            jacobian[:, k, :m] = size * shape
            jacobian[:, k, m + k] = 1.0
            jacobian[:, k, gain.start + k] = seen
            jacobian[:, k, extra.start + k] = size * (by_tau @ theta[:m])
        return y, jacobian

    gauge = np.zeros((2, len(names)))
    gauge[0, gain.start : gain.start + ideals] = gauge[1, extra.start : extra.start + ideals] = 1.0
    prior_sd, least, largest = (np.full(len(names), end) for end in (np.inf, -np.inf, np.inf))
    prior_sd[gain] = gain_u
    least[extra] = 0.02 - base_s
    largest[extra] = 0.3
    theta = np.zeros(len(names))
    factor = 1.0
    for kept in (np.eye(len(names))[gain.start :], None, None, None):  # the shape of x alone first
        sd = block_sd(noise, count) * np.sqrt(factor)

        def evaluate(theta: Array, sd: Array = sd) -> tuple[Array, Array]:
            y, jacobian = model(theta)
            return ((y - mean) / sd).ravel(), (jacobian / sd[:, :, None]).reshape(-1, len(names))

        zero = np.zeros(len(names))
        problem = Problem(
            names, evaluate, zero, prior_sd, lower=least, largest=largest, fixed=gauge
        )
        best = minimise(problem, theta, fixed=kept)
        theta = best.theta
        if kept is None:
            z = best.residual.reshape(-1, c) * np.sqrt(factor)
            factor = max(inflation(z, m, 3 * c)[1], 1.0)
    return theta[extra], best.covariance[extra, extra], model(theta)[0]


def _hole(name: str, extra: float, variance: float, u_depth: float, limit: float) -> Hole:
    estimate = Estimate.normal(float(extra), float(np.hypot(np.sqrt(variance), u_depth)))
    match = re.search(r"(\d+)[p.](\d+)", name)
    diameter = float(f"{match[1]}.{match[2]}") if match else None
    verdict: Verdict
    if estimate.low95 > limit:
        verdict = "too slow"
    elif estimate.high95 < limit:
        verdict = "as good as ideal" if estimate.low95 <= 0 else "acceptable"
    else:
        verdict = "undecided"
    label = f"{diameter:g} mm hole" if diameter else name
    sentence = (
        f"{label}: {estimate.value:+.3f} s against the clamped thermocouples (95 %: {estimate.low95:.3f} to "
        f"{estimate.high95:.3f} s; limit {limit:g} s): {verdict}."
    )
    return Hole(name, diameter, estimate, verdict, sentence)
