"""Coverage of gain and lag, and false alarms, where the noise is not white or the input is measured with noise.

Run by hand: ``python -m disturbance_study [RUNS] [KINDS] [WORLDS]`` in this folder (comma between names). The noisy
records are simulated on a grid ten times finer by first-order recursions, with nothing that the fit uses.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from identify_cases import CASE_A, case_a_input
from scipy.signal import lfilter

from tcdyn.identify import IOData, fit, process
from tcdyn.identify.models import Model
from tcdyn.rig.disk import Conditioning

DT_S = 0.05
FINER = 10
AUTO = {"noise": "auto", "baseline": "auto"}
FILTER = Conditioning(4.0, 2)  # that is stated; the true one has a pole more
WORLDS: dict[str, dict[str, object]] = {  # what is asked for in each
    "noisy input": {"input_sd": 0.5},
    **dict.fromkeys(("white", "ar0.9", "ar0.99", "walk", "drift"), AUTO),
    "outliers": {"loss": "huber"},
    "filter": {**AUTO, "model": process("P2D", known=FILTER)},
}


def fine(
    kind: str, rng: np.random.Generator, n: int = 800, more: tuple[float, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Input and case A's output (n,) behind ``more`` lags [s], neither with noise."""
    t = np.arange(n * FINER) * DT_S / FINER
    h = DT_S / FINER
    if kind == "plunge":
        u = 25 + 155 * (1 - np.exp(-np.clip(t - 2, 0, None) / 3))
    else:
        u = np.repeat(case_a_input("PRBS", rng, n)[0], FINER)
    late = round(CASE_A["Td"] / h)
    y = np.concatenate([np.full(late, u[0]), u[:-late]])
    for k, tau in enumerate((CASE_A["Tp1"], CASE_A["Tp2"], *more)):
        held = np.concatenate(
            [y[:1], y[:-1] if kind == "PRBS" and k == 0 else 0.5 * (y[1:] + y[:-1])]
        )
        a = np.exp(-h / tau)
        y = lfilter([1 - a], [1.0, -a], held, zi=[a * held[0]])[0]
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
    lags = (1 / (2 * np.pi * FILTER.cutoff_Hz),) * (FILTER.poles + 1) if name == "filter" else ()
    u, y = fine(kind, rng, more=lags)
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
    """Share of runs whose 95 % interval holds gain and lag, share of alarms (1 % level), and the noise models found."""
    rows = []
    kinds = Counter()
    truth = 2.87 + (3 / (2 * np.pi * FILTER.cutoff_Hz) if name == "filter" else 0.0)
    asked = {"start": CASE_A, "check": False, "intervals": "quadratic", **options}
    for seed in seeds:
        found = fit(record(kind, seed, name, input_sd), model, **asked)
        s = found.identified.statistics
        lag = found.identified.lag_s
        held = found.estimates["Kp"].contains(1.0), lag.contains(truth)
        rows.append((*held, s["p_white"] < 0.01, s["p_input"] < 0.01, lag.value, lag.u))
        noise = found.noise
        kinds["slow" if noise.averaged else (*noise.order, found.disturbance["baseline"])] += 1
    table = np.array(rows, dtype=float)
    share = dict(zip(("Kp", "lag", "white", "input"), table[:, :4].mean(axis=0).round(3).tolist()))
    said = {
        "bias_s": table[:, 4].mean() - truth,
        "sd_s": table[:, 4].std(),
        "u_s": np.sqrt(np.mean(table[:, 5] ** 2)),
    }
    return {**share, **{k: round(float(v), 5) for k, v in said.items()}, "noise": dict(kinds)}


if __name__ == "__main__":
    asked = [word.split(",") for word in sys.argv[2:]]
    for kind in asked[0] if asked else ("plunge", "PRBS"):
        for name in asked[1] if asked[1:] else WORLDS:
            runs = range(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
            print(kind, name, study(kind, runs, name, **WORLDS[name]), flush=True)
