"""Hole and cement comparison (section 5.4): how much later cemented thermocouples answer than clamped ones."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.estimate import Estimate
from calibration.finding import Finding, look, note, sentences
from calibration.noise import white_noise_sd
from calibration.result import Result, jsonable
from calibration.rig import load_rig
from immersion.events import EntryEvent, find_entry
from immersion.radial import plunge_grid
from tcdyn.plunge.model import Reading, lag_on_grid
from tcdyn.plunge.posterior import block_sd, inflation
from tcdyn.plunge.run import despiked, make_averages

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
        return sentences(self.findings)

    def table(self) -> pd.DataFrame:
        """One row a hole."""
        return pd.DataFrame(
            {
                "hole": [h.name for h in self.holes],
                "diameter_mm": [h.diameter_mm for h in self.holes],
                "extra_lag_s": [h.extra_lag_s.value for h in self.holes],
                "u_s": [h.extra_lag_s.u for h in self.holes],
                "low95_s": [h.extra_lag_s.low95 for h in self.holes],
                "high95_s": [h.extra_lag_s.high95 for h in self.holes],
                "verdict": [h.verdict for h in self.holes],
            }
        )

    def summary(self) -> str:
        """A sentence a hole."""
        return "\n".join(h.sentence for h in self.holes)

    def to_dict(self) -> dict[str, Any]:
        """Extra lags with their verdicts, the limit and the warnings."""
        return {"holes": jsonable(self.table()), "limit_s": self.limit_s, "warnings": list(self.warnings)}

    def card(self) -> pd.DataFrame:
        """One row a hole."""
        return self.table()


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
        columns = {c: frame[c].to_numpy(dtype=float) for c in ("switch", "probe_degC", "fluid_degC") if c in frame}
        entry = find_entry(t, columns.get("switch"), columns.get("probe_degC"), columns.get("fluid_degC"), where)
    readings = np.column_stack([frame[f"{n}_degC"].to_numpy(dtype=float) for n in order])
    keep = t >= entry.time_s - 5.0
    clean, spikes = despiked(readings[keep])
    time, mean, count = make_averages(t[keep] - entry.time_s, clean, float(np.median(np.diff(t))), 1.0)
    fit = _fit(time, mean, count, white_noise_sd(clean), len(good), reference_lag_s, gain_u)
    findings = [*entry.findings]
    if spikes:
        findings.append(note("plunge.spikes", count=spikes))
    alpha = load_rig().disk_setup("").diffusivity_m2_s if diffusivity_m2_s is None else diffusivity_m2_s
    shift = depth_u_m * depth_m / alpha
    u_depth = shift * float(np.sqrt(1 + 1 / len(good)))
    holes = tuple(
        _hole(n, fit.extra[k], fit.covariance[k, k], u_depth, limit_s) for k, n in enumerate(order) if k >= len(good)
    )
    spread = None
    if len(good) >= 2:
        c = fit.covariance
        spread = Estimate.normal(fit.extra[0] - fit.extra[1], float(np.sqrt(c[0, 0] + c[1, 1] - 2 * c[0, 1])))
        allowed = 2 * float(np.hypot(spread.u, np.sqrt(2) * shift))
        if abs(spread.value) > allowed:
            findings.append(look("hole.ideal", apart_s=abs(spread.value)))
    return HoleComparison(holes, spread, limit_s, u_depth, entry, tuple(order), time, mean, fit.fitted, tuple(findings))


@dataclass(frozen=True)
class _Fit:
    extra: Array  # (C,)
    covariance: Array  # (C, C)
    fitted: Array


def _knots(end: float) -> Array:
    knots, step = [0.0], 0.06
    while knots[-1] < end:
        knots.append(knots[-1] + step)
        if knots[-1] > 1.5:
            step = min(step * 1.08, 3.0)
    return np.array(knots)


def _fit(time: Array, mean: Array, count: Array, noise: Array, ideals: int, base_s: float, gain_u: float) -> _Fit:
    """Gauss-Newton over extra lags; knots of x, offsets and gain errors come out linearly at each step."""
    c = mean.shape[1]
    grid = plunge_grid(float(time[-1]) + 1.0, longest_s=1.0)
    dt = np.diff(grid)
    knots = _knots(float(time[-1]))
    hats = np.column_stack([np.interp(grid, knots, row) for row in np.eye(len(knots))[1:]])
    reading = Reading.at(grid, time)
    sd = block_sd(noise, count)
    values = np.where(count > 0, mean, 0.0)
    extra, m = np.zeros(c), hats.shape[1]
    factor, weights = np.ones(c), 1 / sd
    hessian = np.eye(m + 3 * c)
    theta = np.zeros(m + 3 * c)
    for _ in range(12):
        rows, target = [], []
        for k in range(c):
            tau = max(base_s + extra[k], 0.01)
            y = lag_on_grid(hats, dt, 1 / tau)
            again = lag_on_grid(np.asarray(y), dt, 1 / tau)
            shape, by_tau = reading.value(np.asarray(y)), reading.value((np.asarray(again) - y) / tau)
            x = theta[:m]
            block = np.zeros((len(time), m + 3 * c))
            block[:, :m] = shape
            block[:, m + k] = 1.0
            block[:, m + c + k] = shape @ x
            block[:, m + 2 * c + k] = by_tau @ x
            rows.append(block * (weights[:, k] / np.sqrt(factor[k]))[:, None])
            target.append((values[:, k] + block[:, m + 2 * c + k] * extra[k]) * weights[:, k] / np.sqrt(factor[k]))
        prior = np.zeros((c + 2, m + 3 * c))
        prior[:c, m + c : m + 2 * c] = np.eye(c) / gain_u
        prior[c, m + 2 * c : m + 2 * c + ideals] = 1e5 / ideals  # gauge: ideal ones lag by base_s on the average
        prior[c + 1, m + c : m + c + ideals] = 1e6 / ideals
        a, b = np.vstack([*rows, prior]), np.concatenate([*target, np.zeros(c + 2)])
        if not np.any(theta[:m]):  # first pass: shape of x alone
            a = np.delete(a, np.s_[m + c :], axis=1)
            theta[: m + c] = np.linalg.lstsq(a, b, rcond=None)[0]
            continue
        theta = np.linalg.lstsq(a, b, rcond=None)[0]
        new = np.clip(theta[m + 2 * c :], extra - 0.3, extra + 0.3)
        residual = np.concatenate(target) - np.vstack(rows) @ theta
        z = residual.reshape(c, -1).T * np.sqrt(factor)
        change = float(np.max(np.abs(new - extra)))
        extra = np.maximum(new, 0.02 - base_s)
        hessian = a.T @ a
        if change < 1e-4:
            break
        factor = np.full(c, max(inflation(z, m, 3 * c)[1], 1.0))
    covariance = np.linalg.inv(hessian)[m + 2 * c :, m + 2 * c :]
    fitted = np.column_stack([values[:, k] - z[:, k] * sd[:, k] for k in range(c)])
    return _Fit(extra, np.asarray(covariance, dtype=float), fitted)


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
