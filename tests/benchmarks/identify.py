"""Identification on case A: this library, a plain least-squares model (lmfit where installed),
sysidentpy, ERA.

Run: ``python -m tests.benchmarks.identify [seeds]``. Prints one table for each case: mean and
spread of the parameters, coverage of the 95 % intervals, simulated fit, lost runs, median seconds,
and the time relative to this library.
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

from tcdyn.identification import IOData, fit, process, simulate
from tcdyn.identification.narx import narx

START = np.array([1.0, 1.0, 1.0, 0.1])  # for the tools without start values of their own
# parameters, standard uncertainties, simulated fit percent
ToolResult = tuple[dict[str, float], dict[str, float], float]


def percent(y: np.ndarray, model: np.ndarray) -> float:
    """NRMSE fit in percent; minus infinity when the simulation diverged."""
    if not np.all(np.isfinite(model)):
        return float("-inf")
    return 100 * (1 - float(np.linalg.norm(y - model) / np.linalg.norm(y - y.mean())))


def tcdyn_fit(data: IOData) -> ToolResult:
    """fit(data, "P2D") without start values."""
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


def plain_least_squares(data: IOData) -> ToolResult:
    """The same simulation in least_squares of scipy with finite differences, as a user would write
    it by hand."""
    box = ([-np.inf, 1e-3, 1e-3, 0.0], np.inf)
    optimum = least_squares(residual, START, args=(data,), x_scale=[1, 1, 1, 0.1], bounds=box)
    covariance = np.linalg.pinv(optimum.jac.T @ optimum.jac) * 2 * optimum.cost / (800 - 4)
    y = data.runs[0].y[:, 0]
    x = optimum.x if optimum.x[1] >= optimum.x[2] else optimum.x[[0, 2, 1, 3]]
    u = np.sqrt(np.diag(covariance))
    u = u if optimum.x[1] >= optimum.x[2] else u[[0, 2, 1, 3]]
    return dict(zip(CASE_A, x)), dict(zip(CASE_A, u)), percent(y, optimum.fun + y)


def with_lmfit(data: IOData) -> ToolResult:
    """The same model in lmfit."""
    import lmfit

    p = lmfit.Parameters()
    for name, value in zip(CASE_A, START):
        p.add(name, value=value, min=-np.inf if name == "Kp" else 0.0 if name == "Td" else 1e-3)
    result = lmfit.minimize(lambda q: residual(np.array([q[n].value for n in CASE_A]), data), p)
    theta = {n: result.params[n].value for n in CASE_A}
    u = {n: result.params[n].stderr or np.nan for n in CASE_A}
    if theta["Tp1"] < theta["Tp2"]:
        for d in (theta, u):
            first = d["Tp1"]
            d["Tp1"] = d["Tp2"]
            d["Tp2"] = first
    y = data.runs[0].y[:, 0]
    return theta, u, percent(y, result.residual + y)


def frols(data: IOData) -> ToolResult:
    """sysidentpy FROLS, linear terms, BIC, on the complete record; the fit is of its free
    simulation."""
    m = narx(data, degree=1, lags=12, held_out=1e-9)
    return {}, {}, m.simulated_percent


def era(data: IOData) -> ToolResult:
    """control.markov and the eigensystem realisation of order 2."""
    import control

    u = data.runs[0].u[:, 0]
    y = data.runs[0].y[:, 0]
    markov = control.markov(y - y[0], u - u[0], 100, dt=0.05)
    system, _ = control.eigensys_realization(markov, 2, dt=0.05)
    with np.errstate(all="ignore"):
        simulated = control.forced_response(system, U=u - u[0]).outputs + y[0]
    return {}, {}, percent(y, np.asarray(simulated).ravel())


TOOLS: dict[str, Callable[[IOData], ToolResult]] = {
    "tcdyn fit P2D": tcdyn_fit,
    "plain least_squares": plain_least_squares,
    "lmfit": with_lmfit,
    "sysidentpy FROLS": frols,
    "control markov + ERA": era,
}


def study(kind: str, seeds: int) -> pd.DataFrame:
    """One row for each tool."""
    rows = []
    base = np.nan
    for name, tool in TOOLS.items():
        if name == "lmfit":
            try:
                import lmfit  # noqa: F401
            except ImportError:
                print(
                    "lmfit is not installed: its row is left out (plain least_squares is the "
                    "same method)"
                )
                continue
        results = []
        seconds = []
        lost = 0
        for seed in range(seeds):
            data = case_a(kind, seed)
            t_start_s = time.perf_counter()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    results.append(tool(data))
            except Exception:
                lost += 1
            seconds.append(time.perf_counter() - t_start_s)
        fits = np.array([a[2] for a in results])
        good = [a for a in results if a[2] > 0 and abs(a[0].get("Tp1", 2.0) - 2.0) < 1.0]
        lost += len(results) - len(good)
        median = float(np.median(seconds))
        base = median if name == "tcdyn fit P2D" else base
        row = {"tool": name}
        for p, true_value in CASE_A.items():
            values = np.array([a[0][p] for a in good if p in a[0]])
            row[p] = f"{values.mean():.4f} +- {values.std():.4f}" if len(values) else "-"
            covered = [abs(a[0][p] - true_value) < 1.96 * a[1][p] for a in good if p in a[1]]
            row[f"cover {p}"] = f"{100 * np.mean(covered):.0f}" if covered else "-"
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
