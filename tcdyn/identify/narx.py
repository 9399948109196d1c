"""Is the chain linear? Its lag against the level by simulation; NARX by FROLS (sysidentpy), scored by free simulation,
for the rest."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares, newton

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import correlation_length
from tcdyn.identify.iodata import IOData
from tcdyn.identify.level_lag import LevelLag, level_lag

# of a weight, for slopes; of the bootstrap
STEP = 1e-5
DRAWS = 200


@dataclass(frozen=True)
class Narx:
    """y_t = sum_i theta_i prod(terms_i): each term a tuple of (signal, lag) with signal "y" or "u"; () is the
    constant.

    Signals are scaled by ``u_scale``, ``y_scale`` = (centre, spread). ``held_out_percent`` is a free-simulation
    score; ``draws`` are other ``theta`` that the noise could have given.
    """

    terms: tuple[tuple[tuple[str, int], ...], ...]
    theta: tuple[float, ...]
    u_scale: tuple[float, float]
    y_scale: tuple[float, float]
    dt_s: float
    one_step_percent: float = float("nan")
    simulated_percent: float = float("nan")
    held_out_percent: float = float("nan")
    draws: tuple[tuple[float, ...], ...] = ()

    @property
    def intervals(self) -> tuple[Estimate | None, ...]:
        """Each of ``theta`` with its interval from the bootstrap ``draws``."""
        return tuple(
            spanned(value, [d[k] for d in self.draws]) for k, value in enumerate(self.theta)
        )

    def lag_s(self, level: float) -> Estimate | None:
        """:meth:`local_lag_s` with its interval from the bootstrap."""
        return spanned(
            self.local_lag_s(level),
            [replace(self, theta=one, draws=()).local_lag_s(level) for one in self.draws],
        )

    @property
    def order(self) -> int:
        """Largest lag of any term, in samples."""
        return max((lag for term in self.terms for _, lag in term), default=1)

    def value(self, of: Callable[[str, int], Any], theta: Iterable[Any] | None = None) -> Any:
        """sum_i theta_i prod(terms_i) where a signal at a lag is ``of(signal, lag)``; other weights may be given."""
        products = (
            math.prod((of(name, lag) for name, lag in term), start=1.0) for term in self.terms
        )
        return sum(
            weight * product
            for weight, product in zip(self.theta if theta is None else theta, products)
        )

    def simulate(self, u: Array, y0: Array) -> Array:
        """Free simulation: only the first ``order`` outputs ``y0`` are measured. NaN once it diverges."""
        return (
            self.runs(u, y0, np.array(self.theta)[:, None])[:, 0] * self.y_scale[1]
            + self.y_scale[0]
        )

    def runs(self, u: Array, y0: Array, theta: Array) -> Array:
        """Free simulations, scaled, side by side (N, M) with the weights ``theta`` (terms, M)."""
        us = (np.asarray(u) - self.u_scale[0]) / self.u_scale[1]
        ys = np.full((len(u), theta.shape[1]), np.nan)
        k = self.order
        ys[:k] = ((np.asarray(y0)[:k] - self.y_scale[0]) / self.y_scale[1])[:, None]
        signals = {"u": us, "y": ys}

        def before(signal: str, lag: int) -> Any:
            return signals[signal][t - lag]

        for t in range(k, len(u)):
            value = self.value(before, theta)
            ys[t] = np.where(np.abs(value) < 1e3, value, np.nan)
            if np.isnan(ys[t]).all():
                break
        return ys

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
            u0, state = newton(
                excess, y0 - 0.1, x1=y0 + 0.1, tol=1e-10, disp=False, full_output=True
            )
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
    sentence: str
    lag: LevelLag
    run: str = ""

    @property
    def depends(self) -> bool:
        """Whether the lag changes with the level (99 %)."""
        return self.lag.depends

    def to_dict(self) -> dict[str, Any]:
        """The sentence and its numbers: levels in the output's unit, lags [s], held-out scores of simulation [%]."""
        lag = self.lag
        ends = {"low": lag.low, "high": lag.high}
        return {
            "sentence": self.sentence,
            "run": self.run,
            "depends": lag.depends,
            "levels": list(lag.levels),
            **{f"lag_{end}_s": e.value for end, e in ends.items()},
            **{f"lag_{end}_95_s": [e.low95, e.high95] for end, e in ends.items()},
            "bend": {"value": lag.bend.value, "u": lag.bend.u},
            "narx_lag_s": jsonable([*map(self.nonlinear.lag_s, lag.levels)]),
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
    """A polynomial NARX whose terms FROLS chooses with BIC on the first part of the record, their weights by the error
    of free simulation (:func:`refined`), scored on the rest by simulation.

    ``dead_samples`` are taken off the input first. The one-step score is reported only to show how much it
    flatters: predicting a slow output from its last value is easy. Raises InputError for short or gappy records.
    """
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    run = data.runs[0]
    if any(np.isnan(r.u).any() or np.isnan(r.y).any() for r in data.runs):
        raise InputError(
            "narx: samples are missing",
            where=data.name or "IOData",
            remedy="use fit(), which tolerates gaps",
        )
    u = np.concatenate([np.full(dead_samples, run.u[0, 0]), run.u[: run.n - dead_samples, 0]])
    y = run.y[:, 0]
    edge = int(len(y) * (1 - held_out))
    if edge < 20 * lags:
        raise InputError(
            f"narx: {edge} training samples", where=data.name, expected=f"at least {20 * lags}"
        )
    us = (float(u.mean()), float(u.std()) or 1.0)
    ys = (float(y.mean()), float(y.std()) or 1.0)
    x = ((u - us[0]) / us[1])[:, None]
    z = ((y - ys[0]) / ys[1])[:, None]
    with warnings.catch_warnings(action="ignore"):
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
    codes = (
        np.atleast_2d(model.final_model).astype(int).tolist()
    )  # 1003 stands for y(k-3) and 2003 for the input's
    terms = tuple(
        tuple(("y" if code < 2000 else "u", code % 1000) for code in row if code) for row in codes
    )
    theta = tuple(float(v) for v in np.asarray(model.theta).ravel())
    found = refined(Narx(terms, theta, us, ys, data.dt_s), u[:edge], y[:edge])
    simulated = found.simulate(u, y)
    return replace(
        found,
        one_step_percent=percent(
            y[:edge], found.one_step(x[:edge, 0], z[:edge, 0]) * ys[1] + ys[0]
        ),
        simulated_percent=percent(y[:edge], simulated[:edge]),
        held_out_percent=percent(y[edge:], simulated[edge:]),
    )


def refined(found: Narx, u: Array, y: Array) -> Narx:
    """``found`` with the weights of its terms that simulate ``y`` (N,) best, and ``draws`` of them by the bootstrap.

    One-step least squares takes noise of the output for dynamics; least is here the sum of squares of free simulation,
    begun at it. The residuals are drawn anew in blocks as long as they are correlated, twice over, and each draw moves
    the weights by (J'J)^-1 J'e. ``found`` itself where it does not simulate at all.
    """
    k, size, seen = found.order, len(found.theta), (y - found.y_scale[0]) / found.y_scale[1]

    def simulated(table: Array) -> Array:
        return np.nan_to_num(found.runs(u, y, table), nan=1e3)[k:]

    def slopes(theta: Array) -> Array:
        table = simulated(np.column_stack([theta, theta[:, None] + STEP * np.eye(size)]))
        return (table[:, 1:] - table[:, :1]) / STEP

    begun = np.array(found.theta)
    if not np.isfinite(found.runs(u, y, begun[:, None])).all():
        return found
    best = least_squares(
        lambda theta: simulated(theta[:, None])[:, 0] - seen[k:],
        begun,
        jac=slopes,
        max_nfev=30,
        x_scale="jac",
    )
    e = -best.fun - np.mean(-best.fun)
    rng = np.random.default_rng(0)
    e = e * np.sqrt(len(e) / max(len(e) - size, 1))
    block = int(np.clip(2 * correlation_length(e), 1, len(e) // 4))
    starts = rng.integers(0, len(e) - block + 1, (DRAWS, -(-len(e) // block)))
    drawn = e[(starts[:, :, None] + np.arange(block)).reshape(DRAWS, -1)[:, : len(e)]]
    draws = best.x + np.linalg.lstsq(best.jac, drawn.T, rcond=1e-10)[0].T
    return replace(found, theta=tuple(best.x.tolist()), draws=tuple(map(tuple, draws.tolist())))


def spanned(value: float, draws: Sequence[float]) -> Estimate | None:
    """``value`` with the spread and the 95 % interval of its bootstrap ``draws``; None where there are none."""
    good = np.array([d for d in draws if np.isfinite(d)])
    if not np.isfinite(value) or len(good) < 0.9 * len(draws) or not len(good):
        return None
    low, high = np.quantile(good, [0.025, 0.975])
    return Estimate(value=value, u=float(np.std(good)), low95=float(low), high95=float(high))


def percent(y: Array, model: Array) -> float:
    """NRMSE fit in percent where the model has a value; minus infinity when it diverged."""
    ok = np.isfinite(model)
    if ok.mean() < 0.9:
        return float("-inf")
    return 100 * (1 - float(np.linalg.norm((y - model)[ok]) / np.linalg.norm(y[ok] - y[ok].mean())))


@one_blas_thread
def temperature_dependence(
    data: IOData, *, lags: int = 3, dead_samples: int = 0, held_out: float = 0.3
) -> TemperatureDependence:
    """Does the lag depend on the level? By simulation with a lag that follows it (:func:`level_lag`).

    A dependence is claimed where the interval of the lag's bend (99 %) leaves nought out. Degree 1 and degree 2 of a
    NARX, by held-out simulation, tell of what else is not linear. Of several recordings the first is asked, and the
    sentence says so.
    """
    one, two = (
        narx(data, degree=k, lags=lags, dead_samples=dead_samples, held_out=held_out)
        for k in (1, 2)
    )
    found = level_lag(data.run(0))
    unit = data.output_units[0] or "units"
    better = 100 - two.held_out_percent < 0.9 * (100 - one.held_out_percent)
    two_said = f"{two.held_out_percent:.1f} %"
    one_said = f"{one.held_out_percent:.1f} %"
    at = [
        f"{e.value:.3g} s ({e.low95:.3g} to {e.high95:.3g} s) at {level:.4g}"
        for e, level in zip((found.low, found.high), found.levels)
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
    return TemperatureDependence(one, two, words, found, run)
