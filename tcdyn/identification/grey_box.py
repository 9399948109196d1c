"""Least-squares fit of a user's simulation function (grey-box model).

``tests/identify/test_identify_interop.py`` compares it with the fit of a process model and with a
nonlinear simulation by another integrator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding
from tcdyn.core.result import Result, estimates_frame, jsonable
from tcdyn.estimation import Optimum, Problem, Status, minimise
from tcdyn.identification.intervals import innovation_covariance
from tcdyn.identification.iodata import IOData
from tcdyn.identification.search import search_findings
from tcdyn.identification.segments import row_slices
from tcdyn.identification.validation import nrmse_percent

# Outputs of all runs, from the parameters by name and the data.
SimulationFunction = Callable[[dict[str, float], IOData], Sequence[ArrayLike]]

# Relative step of the numerical derivatives: a simulation that is accurate to 1e-8 gives them to
# about 1e-3.
STEP = 1e-5


@dataclass(frozen=True, repr=False)
class FunctionFit(Result):
    """Result of :func:`fit_function`.

    Parameters
    ----------
    estimates
        Parameters by name, with 95 % intervals.
    covariance
        Covariance of the parameters (P, P), in the order of ``estimates``.
    output
        Simulated output of each run (N,).
    fit_percent
        NRMSE fit percent of the simulation; 100 is perfect, 0 as bad as the mean.
    rms
        Rms of the residuals, in the output's unit.
    findings
        Findings about the parameters and the search.
    optimum
        The optimum.
    """

    estimates: Mapping[str, Estimate]
    covariance: Array
    output: tuple[Array, ...]
    fit_percent: float
    rms: float
    findings: tuple[Finding, ...]
    optimum: Optimum

    def summary(self) -> str:
        """Parameters, fit and findings as text."""
        lines = [f"{name} = {e.text()}" for name, e in self.estimates.items()]
        lines.append(f"fit {self.fit_percent:.2f} %, rms {self.rms:.4g}")
        return "\n".join([*lines, *self.warnings])

    def to_dict(self) -> dict[str, Any]:
        """Parameters, their covariance, fit and findings."""
        names = ("estimates", "covariance", "fit_percent", "rms", "findings")
        return {name: jsonable(getattr(self, name)) for name in names}

    def to_frame(self) -> pd.DataFrame:
        """Parameters with their standard uncertainties and intervals, in the units of the model."""
        return estimates_frame(self.estimates)


@with_named_arguments
def fit_function(
    data: IOData,
    model: SimulationFunction,
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> FunctionFit:
    """Least-squares fit of the parameters of a simulation function.

    Parameters
    ----------
    data
        One output; the inputs that ``model`` uses.
    model
        ``model(parameters, data)`` returns the simulated output (N,) of each run, in a list. The
        search avoids parameters at which it is not finite.
    start
        Parameters by name to start from. Offsets and initial states are parameters too.
    bounds
        Lower and upper bounds of parameters by name.

    Returns
    -------
    FunctionFit
        Estimates with intervals, simulated output and findings.

    Raises
    ------
    InputError
        For several outputs, outputs of another shape, bounds of unknown parameters, or a model that
        cannot be computed at the start.

    Notes
    -----
    Minimises the sum of squares of measured minus simulated output by Levenberg-Marquardt steps
    with forward differences, from ``start`` only. Give the parameters units in which they are of
    similar size, and an integrator of differential equations a relative tolerance of 1e-8. The
    covariance is robust where the residuals are correlated.

    Examples
    --------
    >>> u = np.repeat([0.0, 1.0, 0.0], 60)
    >>> data = IOData.from_arrays(u, 3 * u**2 + 5, dt_s=0.1, hold="zoh")
    >>> def square(p, data):
    ...     return [p["a"] * run.u[:, 0] ** 2 + p["b"] for run in data.runs]
    >>> result = fit_function(data, square, {"a": 1.0, "b": 0.0})
    >>> {name: round(e.value, 6) for name, e in result.estimates.items()}
    {'a': 3.0, 'b': 5.0}
    """
    where = data.name or "fit_function"
    names = tuple(start)
    limits = dict(bounds or {})
    unknown = set(limits) - set(names)
    if len(data.output_names) != 1 or unknown:
        raise InputError(
            f"{len(data.output_names)} outputs, bounds of {sorted(limits)}",
            where=where,
            expected=f"one output, and bounds of {', '.join(names)}",
        )
    ends = np.array([limits.get(name, (-np.inf, np.inf)) for name in names], dtype=float)
    x = np.array(list(start.values()), dtype=float)
    scale = np.where(x == 0, 1.0, np.abs(x))
    residual = partial(_residual, data=data, model=model, names=names)
    evaluate = partial(_residual_and_jacobian, residual=residual, scale=scale, upper=ends[:, 1])
    problem = Problem(names, evaluate, lower=ends[:, 0], upper=ends[:, 1])
    optimum = minimise(problem, x, limit=100, tolerance=0.0, relative=1e-10)
    if optimum.status is Status.NOWHERE:
        raise InputError(
            "the model cannot be computed at the start",
            where=where,
            expected="finite outputs, and a start within the bounds",
        )
    # a gap between the runs, so that their residuals are not taken as consecutive
    with_gaps = np.concatenate([np.append(run.y[:, 0], np.nan) for run in data.runs])
    measured = np.isfinite(with_gaps)
    slices = row_slices(measured)
    innovation = -optimum.residual
    covariance, _ = innovation_covariance(
        innovation, optimum.jacobian, slices, data.dt_s, np.zeros(len(names))
    )
    u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    estimates = {n: Estimate.normal(float(v), float(s)) for n, v, s in zip(names, optimum.theta, u)}
    findings = search_findings(optimum, estimates, "the model")
    outputs = _simulated_outputs(optimum.theta, data, model, names)
    rms = float(np.sqrt(np.mean(innovation**2)))
    percent = nrmse_percent([innovation], [with_gaps[measured]])
    return FunctionFit(estimates, covariance, tuple(outputs), percent, rms, findings, optimum)


def _simulated_outputs(
    x: Array, data: IOData, model: SimulationFunction, names: tuple[str, ...]
) -> list[Array]:
    """Return the simulated outputs (N,) of the runs at a vector x (P,).

    Raises
    ------
    InputError
        For another number of outputs, or outputs of another length.
    """
    outputs = [np.asarray(y, dtype=float) for y in model(dict(zip(names, x.tolist())), data)]
    if [y.shape for y in outputs] != [(run.n,) for run in data.runs]:
        raise InputError(
            f"the model returns outputs of shapes {[y.shape for y in outputs]}",
            where="fit_function",
            expected=f"one of each run: {[(run.n,) for run in data.runs]}",
        )
    return outputs


def _residual(
    x: Array, data: IOData, model: SimulationFunction, names: tuple[str, ...]
) -> Array | None:
    """Return simulated minus measured output (N,) at x; None where it is not finite."""
    simulated = np.concatenate(_simulated_outputs(x, data, model, names))
    measured = data.outputs[:, 0]
    residual = (simulated - measured)[np.isfinite(measured)]
    return residual if np.isfinite(residual).all() else None


def _residual_and_jacobian(
    x: Array, residual: Callable[[Array], Array | None], scale: Array, upper: Array
) -> tuple[Array, Array] | None:
    """Return residual (N,) and Jacobian (N, P) by forward differences.

    Parameters
    ----------
    x
        Parameters (P,).
    residual
        Gives the residual at x, or None where it is not finite; then the result is None.
    scale
        Magnitude of each parameter (P,), for the step of one that is near zero.
    upper
        Upper bounds (P,). The difference is backward where a step would pass them.
    """
    r = residual(x)
    if r is None:
        return None
    columns = []
    for k in range(len(x)):
        step = STEP * max(abs(x[k]), STEP * scale[k])
        if x[k] + step > upper[k]:
            step = -step
        shifted = x.copy()
        shifted[k] += step
        r_shifted = residual(shifted)
        if r_shifted is None:
            return None
        columns.append((r_shifted - r) / step)
    return r, np.column_stack(columns)
