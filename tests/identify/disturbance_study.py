"""Coverage of gain and lag, and false alarms, where the noise is not white or the input is measured
with noise.

Run by hand: ``python -m disturbance_study [RUNS] [KINDS] [DISTURBANCES]`` in this folder (comma
between names). The noisy records are simulated on a grid ten times finer by first-order recursions,
independently of the fit.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from identify_cases import CASE_A, case_a_input
from scipy.signal import lfilter

from tcdyn.identification import IOData, fit, process
from tcdyn.identification.comparison import baseline_of
from tcdyn.identification.models import Model
from tcdyn.rig.disk import Conditioning

DT_S = 0.05
FINER = 10
AUTO = {"noise": "auto", "baseline": "auto"}
FILTER = Conditioning(4.0, 2)  # as specified to the fit; the true one has one more pole
DISTURBANCES: dict[str, dict[str, object]] = {  # options of each study
    "noisy input": {"input_sd": 0.5},
    **dict.fromkeys(("white", "ar0.9", "ar0.99", "walk", "drift"), AUTO),
    "outliers": {"loss": "huber"},
    "filter": {**AUTO, "model": process("P2D", known=FILTER)},
}


def fine(
    kind: str, rng: np.random.Generator, n: int = 800, extra_lags: tuple[float, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Input and output of case A (n,) with ``more`` additional lags [s], both without noise."""
    t = np.arange(n * FINER) * DT_S / FINER
    h = DT_S / FINER
    if kind == "plunge":
        u = 25 + 155 * (1 - np.exp(-np.clip(t - 2, 0, None) / 3))
    else:
        u = np.repeat(case_a_input("PRBS", rng, n)[0], FINER)
    delay_samples = round(CASE_A["Td"] / h)
    y = np.concatenate([np.full(delay_samples, u[0]), u[:-delay_samples]])
    for k, tau in enumerate((CASE_A["Tp1"], CASE_A["Tp2"], *extra_lags)):
        segment_input = np.concatenate(
            [y[:1], y[:-1] if kind == "PRBS" and k == 0 else 0.5 * (y[1:] + y[:-1])]
        )
        a = np.exp(-h / tau)
        y = lfilter([1 - a], [1.0, -a], segment_input, zi=[a * segment_input[0]])[0]
    return u[::FINER], y[::FINER]


def disturbance(name: str, rng: np.random.Generator, n: int = 800) -> np.ndarray:
    """Noise of the output (n,)."""
    white = rng.normal(size=n)
    if name.startswith("ar"):
        a = float(name[2:])
        return 0.5 * lfilter([np.sqrt(1 - a**2)], [1.0, -a], rng.normal(size=n + 3000))[3000:]
    if name == "outliers":
        return 0.5 * white + np.where(rng.random(n) < 0.03, 10 * rng.normal(size=n), 0.0)
    if name == "walk":
        return 0.3 * white + np.cumsum(0.05 * rng.normal(size=n))
    return 0.5 * white + (3.0 * np.linspace(0, 1, n) if name == "drift" else 0.0)


def record(kind: str, seed: int, name: str = "white", input_sd: float = 0.0) -> IOData:
    """One test: ``kind`` of input, noise of the output, sd of the input's noise."""
    rng = np.random.default_rng(seed)
    filter_lags = (1 / (2 * np.pi * FILTER.cutoff_Hz),) * (FILTER.poles + 1)
    lags = filter_lags if name == "filter" else ()
    u, y = fine(kind, rng, extra_lags=lags)
    u = u + input_sd * rng.normal(size=len(u))
    hold = "foh" if kind == "plunge" else "zoh"
    return IOData.from_arrays(u, y + disturbance(name, rng), DT_S, hold=hold)


def study(
    kind: str,
    seeds: range,
    name: str = "white",
    input_sd: float = 0.0,
    model: Model | str = "P2D",
    **options: object,
) -> dict[str, object]:
    """Coverage of gain and lag by 95 % intervals, share of alarms (1 % level), and the selected
    noise models."""
    rows = []
    kinds = Counter()
    true_lag = 2.87 + (3 / (2 * np.pi * FILTER.cutoff_Hz) if name == "filter" else 0.0)
    fit_options = {"start": CASE_A, "check": False, "intervals": "quadratic", **options}
    for seed in seeds:
        result = fit(record(kind, seed, name, input_sd), model, **fit_options)
        s = result.identified.statistics
        lag = result.identified.lag_s
        covered = result.estimates["Kp"].contains(1.0), lag.contains(true_lag)
        rows.append((*covered, s["p_white"] < 0.01, s["p_input"] < 0.01, lag.value, lag.u))
        noise = result.noise
        kinds["slow" if noise.averaged else (*noise.order, baseline_of(result))] += 1
    table = np.array(rows, dtype=float)
    share = dict(zip(("Kp", "lag", "white", "input"), table[:, :4].mean(axis=0).round(3).tolist()))
    errors = {
        "bias_s": table[:, 4].mean() - true_lag,
        "sd_s": table[:, 4].std(),
        "u_s": np.sqrt(np.mean(table[:, 5] ** 2)),
    }
    return {**share, **{k: round(float(v), 5) for k, v in errors.items()}, "noise": dict(kinds)}


if __name__ == "__main__":
    arguments = [word.split(",") for word in sys.argv[2:]]
    for kind in arguments[0] if arguments else ("plunge", "PRBS"):
        for name in arguments[1] if arguments[1:] else DISTURBANCES:
            runs = range(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
            print(kind, name, study(kind, runs, name, **DISTURBANCES[name]), flush=True)
