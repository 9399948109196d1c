"""Linearity test: lag against level by simulation, and polynomial NARX models.

NARX terms are selected by FROLS (sysidentpy); the models are scored by free simulation. ``tcdyn
identify`` uses it. ``tests/identify/test_identify_narx.py`` checks bias and simulation;
``tests/identify/test_identify_results.py`` the conclusion.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread
from tcdyn.identification.iodata import IOData
from tcdyn.identification.level_lag import LevelLag, level_lag
from tcdyn.identification.validation import nrmse_percent

STEP = 1e-5  # of a weight, for numerical derivatives; chosen by judgement
DIVERGED = 1e3  # scaled output above which a simulation has diverged (chosen by judgement)
MIN_FINITE_SHARE = 0.9  # of samples, below which a result is not used (by judgement)
# Held-out error of the quadratic over that of the linear model, below which it is better (chosen
# by judgement).
MAX_QUADRATIC_RATIO = 0.9


@dataclass(frozen=True)
class Narx:
    """A polynomial NARX model y_t = sum_i theta_i prod(terms_i).

    Parameters
    ----------
    terms
        Each term is a tuple of (signal, lag) with the signal "y" or "u"; () is the constant.
    theta
        Weight of each term.
    u_scale, y_scale
        (centre, spread) by which the signals are scaled.
    one_step_percent
        Fit percent of one-step predictions of the training data.
    simulated_percent, held_out_percent
        Fit percent of free simulation of the training data and of the held-out data.
    """

    terms: tuple[tuple[tuple[str, int], ...], ...]
    theta: tuple[float, ...]
    u_scale: tuple[float, float]
    y_scale: tuple[float, float]
    one_step_percent: float = float("nan")
    simulated_percent: float = float("nan")
    held_out_percent: float = float("nan")

    @property
    def order(self) -> int:
        """Largest lag of any term, in samples."""
        return max((lag for term in self.terms for _, lag in term), default=1)

    def predict(self, signal: Callable[[str, int], Any], theta: Iterable[Any]) -> Any:
        """Return sum_i theta_i prod(terms_i).

        Parameters
        ----------
        signal
            Value of a signal at a lag, from its name and the lag.
        theta
            The weights.

        Returns
        -------
        number or array
            Of the type that ``signal`` returns.
        """
        total: Any = 0
        for weight, term in zip(theta, self.terms):
            total = total + weight * math.prod((signal(*factor) for factor in term), start=1.0)
        return total

    def simulate(self, u: Array, y0: Array) -> Array:
        """Return the free simulation from the first measured outputs.

        NaN after it diverges.

        Parameters
        ----------
        u
            Input (N,).
        y0
            Outputs, of which the first ``order`` are used.

        Returns
        -------
        array
            Output (N,), NaN after it diverges.
        """
        scaled = self.simulate_scaled(u, y0, np.array(self.theta)[:, None])[:, 0]
        return scaled * self.y_scale[1] + self.y_scale[0]

    def simulate_scaled(self, u: Array, y0: Array, theta: Array) -> Array:
        """Return scaled free simulations for several sets of weights.

        Parameters
        ----------
        u
            Input (N,) in its unit.
        y0
            Outputs in their unit, of which the first ``order`` are used.
        theta
            Weights (terms, M).

        Returns
        -------
        array
            Scaled outputs (N, M), NaN after they diverge.
        """
        u_scaled = (u - self.u_scale[0]) / self.u_scale[1]
        y_scaled = np.full((len(u), theta.shape[1]), np.nan)
        k = self.order
        y_scaled[:k] = ((y0[:k] - self.y_scale[0]) / self.y_scale[1])[:, None]
        signals = {"u": u_scaled, "y": y_scaled}

        def lagged(signal: str, lag: int) -> Any:
            """Return a scaled signal at time t - lag."""
            return signals[signal][t - lag]

        for t in range(k, len(u)):
            value = self.predict(lagged, theta)
            y_scaled[t] = np.where(np.abs(value) < DIVERGED, value, np.nan)
            if np.isnan(y_scaled[t]).all():
                break
        return y_scaled

    def one_step(self, u: Array, y: Array) -> Array:
        """Return one-step predictions of scaled signals.

        Parameters
        ----------
        u, y
            Scaled input and output (N,).

        Returns
        -------
        array
            Scaled predictions (N,), NaN for the first ``order`` samples.
        """
        signals = {"u": u, "y": y}
        k = self.order
        predicted = self.predict(
            lambda name, lag: signals[name][k - lag : len(y) - lag], self.theta
        )
        return np.concatenate([np.full(k, np.nan), np.broadcast_to(predicted, len(y) - k)])


@dataclass(frozen=True)
class TemperatureDependence:
    """Whether the lag depends on the level, and whether the system is linear otherwise.

    Parameters
    ----------
    linear, nonlinear
        Linear and quadratic NARX.
    sentence
        The conclusion.
    lag
        The lag at a low and a high level with its intervals, by simulation.
    run
        Name of the run that was used; empty where there is only one.
    """

    linear: Narx
    nonlinear: Narx
    sentence: str
    lag: LevelLag
    run: str = ""

    @property
    def depends(self) -> bool:
        """Whether the lag depends on the level (99 %)."""
        return self.lag.depends

    def to_dict(self) -> dict[str, Any]:
        """The conclusion and its numbers.

        Levels in the output's unit, lags [s], fit percent of the held-out simulation [%].
        """
        lag = self.lag
        return {
            "sentence": self.sentence,
            "run": self.run,
            "depends": lag.depends,
            "levels": list(lag.levels),
            "lag_low_s": lag.low.value,
            "lag_high_s": lag.high.value,
            "lag_low_95_s": [lag.low.low95, lag.low.high95],
            "lag_high_95_s": [lag.high.low95, lag.high.high95],
            "bend": {"value": lag.bend.value, "u": lag.bend.u},
            "held_out_percent_linear": self.linear.held_out_percent,
            "held_out_percent_quadratic": self.nonlinear.held_out_percent,
        }


def narx(
    data: IOData,
    *,
    degree: int = 2,
    lags: int = 3,
    held_out: float = 0.3,
    max_terms: int = 10,
) -> Narx:
    """A polynomial NARX model of the first run.

    FROLS selects the terms by BIC on the first part of the record. The weights minimise the error
    of free simulation (:func:`refine_weights`). The model is scored by simulation of the rest.

    Parameters
    ----------
    data
        One input and one output, without gaps.
    degree
        Degree of the polynomial.
    lags
        Largest lag of input and output, in samples.
    held_out
        Last share of the record that is not used for the fit.
    max_terms
        Largest number of terms.

    Returns
    -------
    Narx
        The model with its scores.

    Raises
    ------
    InputError
        For short records or records with gaps.

    Notes
    -----
    The one-step score shows only how optimistic it is: it is easy to predict a slow output from
    its last value.

    More lags or a higher degree give more candidate terms.
    """
    frols = frols_with_polynomials()
    run = data.runs[0]
    if any(np.isnan(r.u).any() or np.isnan(r.y).any() for r in data.runs):
        raise InputError(
            "narx: samples are missing",
            where=data.name or "IOData",
            remedy="use fit(), which tolerates gaps",
        )
    u = run.u[:, 0]
    y = run.y[:, 0]
    n_train = int(len(y) * (1 - held_out))
    if n_train < 20 * lags:
        raise InputError(
            f"narx: {n_train} training samples", where=data.name, expected=f"at least {20 * lags}"
        )
    u_scale = (float(u.mean()), float(u.std()) or 1.0)
    y_scale = (float(y.mean()), float(y.std()) or 1.0)
    x = ((u - u_scale[0]) / u_scale[1])[:, None]
    z = ((y - y_scale[0]) / y_scale[1])[:, None]
    with warnings.catch_warnings(action="ignore"):
        model = frols(degree, lags, max_terms)
        model.fit(X=x[:n_train], y=z[:n_train])
    codes = np.atleast_2d(model.final_model).astype(int).tolist()
    terms = tuple(tuple(_signal_and_lag(code) for code in row if code) for row in codes)
    theta = tuple(float(v) for v in np.asarray(model.theta).ravel())
    result = Narx(terms, theta, u_scale, y_scale)
    result = refine_weights(result, u[:n_train], y[:n_train])
    simulated = result.simulate(u, y)
    one_step = result.one_step(x[:n_train, 0], z[:n_train, 0]) * y_scale[1] + y_scale[0]
    return replace(
        result,
        one_step_percent=finite_percent(y[:n_train], one_step),
        simulated_percent=finite_percent(y[:n_train], simulated[:n_train]),
        held_out_percent=finite_percent(y[n_train:], simulated[n_train:]),
    )


def frols_with_polynomials() -> Callable[[int, int, int], Any]:
    """A function of degree, lags and number of terms that returns a FROLS model of sysidentpy.

    Raises
    ------
    InputError
        If sysidentpy cannot be imported, here or with this version of numpy.

    Notes
    -----
    sysidentpy limits the version of numpy; everything else works without it. It is imported here
    only. Test: ``tests/identify/test_without_sysidentpy.py``.
    """
    try:
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.model_structure_selection import FROLS
        from sysidentpy.parameter_estimation import LeastSquares
    except (ImportError, AttributeError, ValueError) as problem:
        raise InputError(
            f"NARX models need sysidentpy, which cannot be imported ({problem})",
            where="narx",
            remedy="install it (python -m pip install sysidentpy), or leave out {narx}",
            parameters={"narx": None},
        ) from None

    def model(degree: int, lags: int, max_terms: int) -> Any:
        """Return a polynomial NARX model of sysidentpy whose terms are selected by BIC."""
        return FROLS(
            ylag=lags,
            xlag=lags,
            order_selection=True,
            info_criteria="bic",
            n_info_values=max_terms,
            estimator=LeastSquares(),
            basis_function=Polynomial(degree=degree),
            model_type="NARMAX",
        )

    return model


def _signal_and_lag(code: int) -> tuple[str, int]:
    """Return signal and lag of sysidentpy's code: 1003 is y(k-3), 2003 is u(k-3)."""
    return ("y" if code < 2000 else "u", code % 1000)


def refine_weights(model: Narx, u: Array, y: Array) -> Narx:
    """The model with the weights of least free-simulation error.

    Parameters
    ----------
    model
        Where to start; returned unchanged where it cannot be simulated.
    u, y
        Input and output (N,).

    Returns
    -------
    Narx
        The model with refined weights.

    Notes
    -----
    One-step least squares mistakes noise of the output for dynamics. Here the sum of squares of the
    free simulation is minimised. ``tests/identify/test_identify_narx.py`` checks that the weights
    are unbiased.
    """
    k = model.order
    n_terms = len(model.theta)
    measured = (y - model.y_scale[0]) / model.y_scale[1]

    def simulated(weights: Array) -> Array:
        """Return scaled simulations after the first samples; diverged ones are ``DIVERGED``."""
        return np.nan_to_num(model.simulate_scaled(u, y, weights), nan=DIVERGED)[k:]

    def residuals(theta: Array) -> Array:
        """Return simulated minus measured output, scaled."""
        return simulated(theta[:, None])[:, 0] - measured[k:]

    def jacobian(theta: Array) -> Array:
        """Return the derivatives (N, terms) of the simulation with the weights."""
        steps = theta[:, None] + STEP * np.eye(n_terms)
        outputs = simulated(np.column_stack([theta, steps]))
        return (outputs[:, 1:] - outputs[:, :1]) / STEP

    start = np.array(model.theta)
    if not np.isfinite(model.simulate_scaled(u, y, start[:, None])).all():
        return model
    best = least_squares(residuals, start, jac=jacobian, max_nfev=30, x_scale="jac")
    return replace(model, theta=tuple(best.x.tolist()))


def finite_percent(y: Array, model: Array) -> float:
    """Return the NRMSE fit percent where the model has a value.

    Parameters
    ----------
    y
        Measured output (N,).
    model
        Its model (N,), NaN where it has no value.

    Returns
    -------
    float
        100 is perfect, 0 as bad as the mean; minus infinity where too few values are finite.
    """
    finite = np.isfinite(model)
    if finite.mean() < MIN_FINITE_SHARE:
        return float("-inf")
    return nrmse_percent([(y - model)[finite]], [y[finite]])


@one_blas_thread
def temperature_dependence(
    data: IOData, *, lags: int = 3, held_out: float = 0.3
) -> TemperatureDependence:
    """Whether the lag depends on the level, by simulation (:func:`level_lag`).

    Parameters
    ----------
    data
        One input and one output; of several runs the first is used, and the sentence says so.
    lags, held_out
        As for :func:`narx`.

    Returns
    -------
    TemperatureDependence
        The conclusion, the lags at both levels and the NARX models.

    Notes
    -----
    The lag depends on the level where the 99 % interval of the lag's bend does not include zero.
    A linear and a quadratic NARX, by held-out simulation, show whether something else is not
    linear.
    """
    linear = narx(data, degree=1, lags=lags, held_out=held_out)
    quadratic = narx(data, degree=2, lags=lags, held_out=held_out)
    lag = level_lag(data.run(0))
    sentence = _conclusion_text(lag, linear, quadratic, data.output_units[0] or "units")
    run = ""
    if len(data.runs) > 1:
        run = data.runs[0].name or "1"
        sentence = f"Run {run}, the first of {len(data.runs)}: {sentence}"
    return TemperatureDependence(linear, quadratic, sentence, lag, run)


def _conclusion_text(lag: LevelLag, linear: Narx, quadratic: Narx, unit: str) -> str:
    """The conclusion of :func:`temperature_dependence` as text.

    Parameters
    ----------
    lag
        The lag at both levels.
    linear, quadratic
        The NARX models.
    unit
        Unit of the output.

    Returns
    -------
    str
        One or two sentences.
    """
    low, high = (
        f"{e.value:.3g} s ({e.low95:.3g} to {e.high95:.3g} s) at {level:.4g}"
        for e, level in zip((lag.low, lag.high), lag.levels)
    )
    if lag.depends:
        return (
            f"The lag depends on the level: {low} and {high} {unit} "
            f"(95 %; simulated, {lag.model} bent)."
        )
    linear_percent = f"{linear.held_out_percent:.1f} %"
    quadratic_percent = f"{quadratic.held_out_percent:.1f} %"
    max_error = MAX_QUADRATIC_RATIO * (100 - linear.held_out_percent)
    if 100 - quadratic.held_out_percent < max_error:
        return (
            f"No sign that the lag depends on the level ({low}, {high} {unit}). A quadratic NARX "
            f"simulates better ({quadratic_percent} against {linear_percent}): look at the static "
            "line."
        )
    return (
        f"No sign that the lag depends on the level: {low}, {high} {unit}. Held out, a quadratic "
        f"NARX simulates to {quadratic_percent}, a linear one to {linear_percent} (one step ahead "
        f"both look like {linear.one_step_percent:.1f} %)."
    )
