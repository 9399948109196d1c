"""What a caller knows besides the record: bounds and priors of parameters, weights of samples.

``tcdyn.identification.fit`` checks them with these functions.
``tests/identify/test_identify_interop.py`` compares their effect with closed forms.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, prior_departure
from tcdyn.core.findings import Finding, warning
from tcdyn.identification.iodata import IOData
from tcdyn.identification.models import Model
from tcdyn.identification.problem import IdentificationProblem

# Difference of prior and data, in its standard uncertainties, beyond which there is a warning: by
# chance in 0.3 % of fits. Least standard uncertainty of what the data add, over that of the prior;
# chosen by judgement.
CONFLICT_U = 3.0
MIN_LEARNED_U = 0.3


def check_knowledge(
    model: Model,
    bounds: Mapping[str, tuple[float, float]],
    prior: Mapping[str, tuple[float, float]],
) -> None:
    """Check that bounds and priors are possible and belong to free parameters of the model.

    Parameters
    ----------
    model
        The model.
    bounds
        Lower and upper bound by parameter.
    prior
        Mean and standard uncertainty by parameter.

    Raises
    ------
    InputError
        For a name that is no free parameter, a lower bound above the upper, an uncertainty that is
        not above zero, or a mean of a positive parameter that is not.
    """
    expected = ", ".join(model.free)
    for name in (*bounds, *prior):
        if name not in model.free:
            raise InputError(
                f"bounds or prior of {name!r}", where=model.name, expected=f"one of {expected}"
            )
    for name, (low, high) in bounds.items():
        if not low < high:
            raise InputError(f"bounds of {name} are {low} and {high}", expected="low < high")
    for name, (mean, u) in prior.items():
        if not u > 0 or (model.is_positive(name) and not mean > 0):
            raise InputError(
                f"prior of {name} is {mean} +- {u}",
                expected="an uncertainty above zero, and a mean above zero of a time constant",
            )


def prior_conflicts(
    model: Model, estimates: Mapping[str, Estimate], prior: Mapping[str, tuple[float, float]]
) -> list[Finding]:
    """Return a warning for each parameter whose prior the data contradict.

    Parameters
    ----------
    model
        The model.
    estimates
        The estimates by parameter, which include the priors.
    prior
        Mean and standard uncertainty by parameter.

    Returns
    -------
    list of Finding
        Empty where prior and data agree.

    Notes
    -----
    See :func:`tcdyn.core.estimate.prior_departure`. It is that of the logarithms where the prior is
    of the logarithm, that is, of a positive parameter.
    """
    findings = []
    for name, (mean, u) in prior.items():
        estimate = estimates[name]
        if model.is_positive(name):
            shift = float(np.log(estimate.value / mean))
            relative_u = estimate.u / estimate.value
            ratio = prior_departure(shift, relative_u, u / mean, MIN_LEARNED_U)
        else:
            ratio = prior_departure(estimate.value - mean, estimate.u, u, MIN_LEARNED_U)
        if ratio > CONFLICT_U:
            conflict = warning(
                "fit.prior_conflict",
                subject=name,
                mean=mean,
                u=u,
                value=estimate.value,
                ratio=ratio,
            )
            findings.append(conflict)
    return findings


def checked_weights(data: IOData, weights: ArrayLike) -> Array:
    """Return the weights as an array after a check of their number and sign.

    Parameters
    ----------
    data
        The record.
    weights
        Weights (N,) of all samples of all runs, in the order of the runs. They are proportional to
        the inverse variance of the samples; 0 leaves a sample out.

    Returns
    -------
    weights
        The weights (N,).

    Raises
    ------
    InputError
        For another number of weights, or weights that are negative or not finite.
    """
    values = np.asarray(weights, dtype=float)
    if values.shape != (data.n_samples,) or not (np.isfinite(values) & (values >= 0)).all():
        raise InputError(
            f"weights of shape {values.shape}",
            where=data.name or "identify",
            expected=f"({data.n_samples},), zero or more: one for each sample of all runs",
        )
    return values


def measured_rows(
    problem: IdentificationProblem, data: IOData, values: NDArray[Any]
) -> NDArray[Any]:
    """Return the values of the measured samples of all segments, from those of all samples (N,)."""
    first_of_run = np.cumsum([0, *(run.n for run in data.runs)])
    rows = []
    for s in problem.segments:
        first = int(first_of_run[s.run]) + s.first
        rows.append(values[first : first + len(s.y)][s.measured])
    return np.concatenate(rows)
