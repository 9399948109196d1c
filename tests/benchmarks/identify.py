"""Identification side by side on case A: ours, a plain least-squares model (lmfit where installed), sysidentpy, ERA.

Run: ``python -m tests.benchmarks.identify [seeds]``. Prints one table a case: mean and spread of the recovered
parameters, coverage of the 95 % intervals, simulated fit, runs lost, median seconds, the time relative to ours.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "identify"))
from identify_cases import CASE_A, case_a

from tcdyn.identify import IOData, fit, process, simulate
from tcdyn.identify.narx import narx

START = np.array([1.0, 1.0, 1.0, 0.1])  # what the tools without a start of their own are given
Answer = tuple[
    dict[str, float], dict[str, float], float
]  # parameters, standard uncertainties, simulated fit percent


def percent(y: np.ndarray, model: np.ndarray) -> float:
    """NRMSE fit in percent; minus infinity when the simulation diverged."""
    if not np.all(np.isfinite(model)):
        return float("-inf")
    return 100 * (1 - float(np.linalg.norm(y - model) / np.linalg.norm(y - y.mean())))


def ours(data: IOData) -> Answer:
    """fit(data, "P2D"), start-free."""
    m = fit(data, "P2D")
    return (
        dict(m.identified.theta),
        {n: e.u for n, e in m.estimates.items()},
        m.identified.statistics["fit_percent"],
    )


def residual(x: np.ndarray, data: IOData) -> np.ndarray:
    """Simulation error of two lags and a dead time."""
    theta = dict(zip(CASE_A, np.maximum(x, [-np.inf, 1e-3, 1e-3, 0.0])))
    u = data.runs[0].u[:, 0]
    y = data.runs[0].y[:, 0]
    return simulate(process("P2D").rational(theta), u, 0.05, data.hold) - y


def plain(data: IOData) -> Answer:
    """The same simulation in scipy's least_squares with finite differences: what a user writes by hand."""
    box = ([-np.inf, 1e-3, 1e-3, 0.0], np.inf)
    found = least_squares(residual, START, args=(data,), x_scale=[1, 1, 1, 0.1], bounds=box)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * 2 * found.cost / (800 - 4)
    y = data.runs[0].y[:, 0]
    x = found.x if found.x[1] >= found.x[2] else found.x[[0, 2, 1, 3]]
    u = np.sqrt(np.diag(covariance))
    u = u if found.x[1] >= found.x[2] else u[[0, 2, 1, 3]]
    return dict(zip(CASE_A, x)), dict(zip(CASE_A, u)), percent(y, found.fun + y)


def with_lmfit(data: IOData) -> Answer:
    """The same model in lmfit."""
    import lmfit

    p = lmfit.Parameters()
    for name, value in zip(CASE_A, START):
        p.add(name, value=value, min=-np.inf if name == "Kp" else 0.0 if name == "Td" else 1e-3)
    found = lmfit.minimize(lambda q: residual(np.array([q[n].value for n in CASE_A]), data), p)
    theta = {n: found.params[n].value for n in CASE_A}
    u = {n: found.params[n].stderr or np.nan for n in CASE_A}
    if theta["Tp1"] < theta["Tp2"]:
        for d in (theta, u):
            d["Tp1"], d["Tp2"] = d["Tp2"], d["Tp1"]
    y = data.runs[0].y[:, 0]
    return theta, u, percent(y, found.residual + y)


def frols(data: IOData) -> Answer:
    """sysidentpy FROLS, linear terms, BIC, on all of the record; the fit is of its free simulation."""
    m = narx(data, degree=1, lags=12, held_out=1e-9)
    return {}, {}, m.simulated_percent


def era(data: IOData) -> Answer:
    """control.markov and the eigensystem realisation of order 2."""
    import control

    u = data.runs[0].u[:, 0]
    y = data.runs[0].y[:, 0]
    markov = control.markov(y - y[0], u - u[0], 100, dt=0.05)
    system, _ = control.eigensys_realization(markov, 2, dt=0.05)
    with np.errstate(all="ignore"):
        simulated = control.forced_response(system, U=u - u[0]).outputs + y[0]
    return {}, {}, percent(y, np.asarray(simulated).ravel())


TOOLS: dict[str, Callable[[IOData], Answer]] = {
    "tcdyn fit P2D": ours,
    "plain least_squares": plain,
    "lmfit": with_lmfit,
    "sysidentpy FROLS": frols,
    "control markov + ERA": era,
}


def study(kind: str, seeds: int) -> pd.DataFrame:
    """One row a tool."""
    rows = []
    base = np.nan
    for name, tool in TOOLS.items():
        if name == "lmfit":
            try:
                import lmfit  # noqa: F401
            except ImportError:
                print(
                    "lmfit is not installed: its row is left out (plain least_squares is the same method)"
                )
                continue
        answers = []
        seconds = []
        lost = 0
        for seed in range(seeds):
            data = case_a(kind, seed)
            began = time.perf_counter()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    answers.append(tool(data))
            except Exception:
                lost += 1
            seconds.append(time.perf_counter() - began)
        fits = np.array([a[2] for a in answers])
        good = [a for a in answers if a[2] > 0 and abs(a[0].get("Tp1", 2.0) - 2.0) < 1.0]
        lost += len(answers) - len(good)
        median = float(np.median(seconds))
        base = median if name == "tcdyn fit P2D" else base
        row = {"tool": name}
        for p, truth in CASE_A.items():
            values = np.array([a[0][p] for a in good if p in a[0]])
            row[p] = f"{values.mean():.4f} +- {values.std():.4f}" if len(values) else "-"
            inside = [abs(a[0][p] - truth) < 1.96 * a[1][p] for a in good if p in a[1]]
            row[f"cover {p}"] = f"{100 * np.mean(inside):.0f}" if inside else "-"
        row |= {
            "fit %": ("< -150" if np.median(fits) < -150 else f"{np.median(fits):.2f}")
            if len(fits)
            else "-",
            "lost": f"{lost}/{seeds}",
            "median s": f"{median:.3f}",
            "time ratio": f"{median / base:.2f}",
        }
        rows.append(row)
    return pd.DataFrame(rows)


def main(seeds: int = 200) -> None:
    """Print both tables."""
    for kind in ("plunge", "PRBS"):
        print(f"\nCase A, {kind}, {seeds} seeds; truth {CASE_A}")
        print(study(kind, seeds).to_string(index=False))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
