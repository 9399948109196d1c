"""Is the chain linear? Its lag against the level by simulation; NARX by FROLS (sysidentpy), scored by free simulation,
for the rest."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import newton

from calibration import Array
from calibration.errors import InputError
from tcdyn.identify.data import IOData
from tcdyn.identify.level import LevelLag, level_lag


@dataclass(frozen=True)
class Narx:
    """y_t = sum_i theta_i prod(terms_i): each term a tuple of (signal, lag) with signal "y" or "u"; () is the
    constant.

    Signals are scaled by ``u_scale``, ``y_scale`` = (centre, spread). ``held_out_percent`` is a free-simulation
    score.
    """

    terms: tuple[tuple[tuple[str, int], ...], ...]
    theta: tuple[float, ...]
    u_scale: tuple[float, float]
    y_scale: tuple[float, float]
    dt_s: float
    degree: int
    one_step_percent: float = float("nan")
    simulated_percent: float = float("nan")
    held_out_percent: float = float("nan")

    @property
    def order(self) -> int:
        """Largest lag of any term, in samples."""
        return max((lag for term in self.terms for _, lag in term), default=1)

    def value(self, of: Callable[[str, int], Any]) -> Any:
        """sum_i theta_i prod(terms_i) where a signal at a lag is ``of(signal, lag)``."""
        products = (math.prod((of(name, lag) for name, lag in term), start=1.0) for term in self.terms)
        return sum(weight * product for weight, product in zip(self.theta, products))

    def simulate(self, u: Array, y0: Array) -> Array:
        """Free simulation: only the first ``order`` outputs ``y0`` are measured. NaN once it diverges."""
        us, ys = (np.asarray(u) - self.u_scale[0]) / self.u_scale[1], np.full(len(u), np.nan)
        k = self.order
        ys[:k] = (np.asarray(y0)[:k] - self.y_scale[0]) / self.y_scale[1]
        signals = {"u": us, "y": ys}
        for t in range(k, len(u)):
            value = self.value(lambda name, lag: signals[name][t - lag])  # noqa: B023
            if not abs(value) < 1e3:
                break
            ys[t] = value
        return np.asarray(ys * self.y_scale[1] + self.y_scale[0])

    def one_step(self, u: Array, y: Array) -> Array:
        """One-step predictions of scaled signals, NaN for the first samples."""
        signals, k = {"u": u, "y": y}, self.order
        predicted = self.value(lambda name, lag: signals[name][k - lag : len(y) - lag])
        return np.concatenate([np.full(k, np.nan), np.broadcast_to(predicted, len(y) - k)])

    def local_lag_s(self, level: float) -> float:
        """First moment [s] of the model linearised about the steady state at output ``level``; NaN if not
        stable."""
        y0 = (level - self.y_scale[0]) / self.y_scale[1]

        def excess(u: float) -> float:
            return float(self.value(lambda name, lag: u if name == "u" else y0)) - y0

        with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
            u0, state = newton(excess, y0 - 0.1, x1=y0 + 0.1, tol=1e-10, disp=False, full_output=True)
        if not (state.converged and abs(u0) < 1e3):
            return float("nan")
        point, k, step = {"u": u0, "y": y0}, self.order, 1e-30

        def slope(signal: str, lag: int) -> float:
            moved = self.value(lambda *at: point[at[0]] + 1j * step * (at == (signal, lag)))
            return float(np.imag(moved)) / step

        b, past = (np.array([slope(signal, lag) for lag in range(k + 1)]) for signal in ("u", "y"))
        a = np.eye(k + 1)[0] - past
        if np.max(np.abs(np.roots(a)), initial=0.0) >= 1 or b.sum() == 0:
            return float("nan")
        n = np.arange(k + 1)
        return float(self.dt_s * ((n @ b) / b.sum() - (n @ a) / a.sum()))


@dataclass(frozen=True)
class TemperatureDependence:
    """Linear and quadratic NARX side by side, their lags at a low and a high level, and the sentence.

    ``lag`` is the lag at both levels with its intervals, by simulation; ``run`` the name of the recording that was
    asked, empty where there is but one.
    """

    linear: Narx
    nonlinear: Narx
    levels: tuple[float, float]
    lag_low_s: float
    lag_high_s: float
    depends: bool
    sentence: str
    lag: LevelLag
    run: str = ""

    def to_dict(self) -> dict[str, Any]:
        """The sentence and its numbers: levels in the output's unit, lags [s], held-out scores of simulation [%]."""
        return {
            "sentence": self.sentence,
            "run": self.run,
            "depends": self.depends,
            "levels": list(self.levels),
            "lag_low_s": self.lag_low_s,
            "lag_high_s": self.lag_high_s,
            "lag_low_95_s": [self.lag.low.low95, self.lag.low.high95],
            "lag_high_95_s": [self.lag.high.low95, self.lag.high.high95],
            "bend": {"value": self.lag.bend.value, "u": self.lag.bend.u},
            "held_out_percent_linear": self.linear.held_out_percent,
            "held_out_percent_quadratic": self.nonlinear.held_out_percent,
        }


def narx(
    data: IOData,
    *,
    degree: int = 2,
    lags: int = 3,
    dead_samples: int = 0,
    held_out: float = 0.3,
    max_terms: int = 10,
) -> Narx:
    """A polynomial NARX chosen by FROLS with BIC on the first part of the record, scored on the rest by
    simulation.

    ``dead_samples`` are taken off the input first. The one-step score is reported only to show how much it
    flatters: predicting a slow output from its last value is easy. Raises InputError for short or incomplete
    records.
    """
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    run = data.runs[0]
    if any(np.isnan(r.u).any() or np.isnan(r.y).any() for r in data.runs):
        raise InputError(
            "narx: samples are missing", where=data.name or "IOData", remedy="use fit(), which tolerates gaps"
        )
    u = np.concatenate([np.full(dead_samples, run.u[0, 0]), run.u[: run.n - dead_samples, 0]])
    y = run.y[:, 0]
    edge = int(len(y) * (1 - held_out))
    if edge < 20 * lags:
        raise InputError(f"narx: {edge} training samples", where=data.name, expected=f"at least {20 * lags}")
    us, ys = (float(u.mean()), float(u.std()) or 1.0), (float(y.mean()), float(y.std()) or 1.0)
    x, z = ((u - us[0]) / us[1])[:, None], ((y - ys[0]) / ys[1])[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = FROLS(
            ylag=lags,
            xlag=lags,
            order_selection=True,
            info_criteria="bic",
            n_info_values=max_terms,
            estimator=LeastSquares(),
            basis_function=Polynomial(degree=degree),
            model_type="NARMAX",
        )
        model.fit(X=x[:edge], y=z[:edge])
    terms = tuple(tuple(signal_of(int(code)) for code in row if code) for row in np.atleast_2d(model.final_model))
    theta = tuple(float(v) for v in np.asarray(model.theta).ravel())
    found = Narx(terms, theta, us, ys, data.dt_s, degree)
    simulated = found.simulate(u, y)
    return replace(
        found,
        one_step_percent=percent(y[:edge], found.one_step(x[:edge, 0], z[:edge, 0]) * ys[1] + ys[0]),
        simulated_percent=percent(y[:edge], simulated[:edge]),
        held_out_percent=percent(y[edge:], simulated[edge:]),
    )


def signal_of(code: int) -> tuple[str, int]:
    """FROLS writes 1003 for y(k-3) and 2003 for the input's."""
    return ("y" if code < 2000 else "u", code % 1000)


def percent(y: Array, model: Array) -> float:
    """NRMSE fit in percent where the model has a value; minus infinity when it diverged."""
    ok = np.isfinite(model)
    if ok.mean() < 0.9:
        return float("-inf")
    return 100 * (1 - float(np.linalg.norm((y - model)[ok]) / np.linalg.norm(y[ok] - y[ok].mean())))


def temperature_dependence(
    data: IOData, *, lags: int = 3, dead_samples: int = 0, held_out: float = 0.3
) -> TemperatureDependence:
    """Does the lag depend on the level? By simulation with a lag that follows it (:func:`level_lag`).

    A dependence is claimed where the interval of the lag's bend (99 %) leaves nought out. Degree 1 and degree 2 of a
    NARX, by held-out simulation, tell of what else is not linear. Of several recordings the first is asked, and the
    sentence says so.
    """
    one = narx(data, degree=1, lags=lags, dead_samples=dead_samples, held_out=held_out)
    two = narx(data, degree=2, lags=lags, dead_samples=dead_samples, held_out=held_out)
    found = level_lag(data.run(0))
    (low, high), unit = found.levels, data.output_units[0] or "units"
    better = 100 - two.held_out_percent < 0.9 * (100 - one.held_out_percent)
    two_said, one_said = f"{two.held_out_percent:.1f} %", f"{one.held_out_percent:.1f} %"
    at = [
        f"{e.value:.3g} s ({e.low95:.3g} to {e.high95:.3g} s) at {level:.4g}"
        for e, level in ((found.low, low), (found.high, high))
    ]
    if found.depends:
        words = f"The lag depends on the level: {at[0]} and {at[1]} {unit} (95 %; simulated, {found.model} bent)."
    elif better:
        words = (
            f"No sign that the lag depends on the level ({at[0]}, {at[1]} {unit}). A quadratic NARX simulates better "
            f"({two_said} against {one_said}): look at the static line."
        )
    else:
        words = (
            f"No sign that the lag depends on the level: {at[0]}, {at[1]} {unit}. Held out, a quadratic NARX simulates "
            f"to {two_said}, a linear one to {one_said} (one step ahead both look like {one.one_step_percent:.1f} %)."
        )
    run = ""
    if len(data.runs) > 1:
        run = data.runs[0].name or "1"
        words = f"Run {run}, the first of {len(data.runs)}: {words}"
    lags_s = (found.low.value, found.high.value)
    return TemperatureDependence(one, two, (low, high), *lags_s, found.depends, words, found, run)
