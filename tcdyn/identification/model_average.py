"""Gain, lag and dead time averaged over the models of a comparison (Bayesian model averaging).

``tcdyn.identification.comparison`` uses it. Weights are exp(-BIC/2) (Raftery 1995).
``tests/identify/test_identify_ladder.py`` checks the weights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from tcdyn.core.estimate import Estimate, mixture
from tcdyn.identification.identified import Identified
from tcdyn.identification.search import Fit

MIN_WEIGHT = 0.01  # of a model, below which it is left out of the average


def likely_models(table: pd.DataFrame, fits: Mapping[str, Fit]) -> dict[str, float]:
    """Weights of models without integrator by their BIC, relative to that of the likeliest.

    Parameters
    ----------
    table
        A row for each model.
    fits
        Fits by name.

    Returns
    -------
    dict
        Weight exp(-BIC/2) by name, of those above ``MIN_WEIGHT``.
    """
    rows = table.set_index("model")["BIC"].dropna()
    settling = [n for n in rows.index if n in fits and not fits[n].identified.model.integrators]
    scores = rows[settling]
    weights = np.exp(-0.5 * (scores - scores.min()))
    return {str(name): float(w) for name, w in weights.items() if w >= MIN_WEIGHT}


def average_gain_and_lag(
    table: pd.DataFrame, fits: Mapping[str, Fit], recommended: str
) -> Mapping[str, Mapping[str, Estimate]]:
    """Average gain, lag and dead time over models by their BIC.

    Parameters
    ----------
    table
        A row for each model; BIC there is that under the common setting.
    fits
        Fits by name; those of other rows than the recommended one are left out, and those whose lag
        the record does not determine.
    recommended
        Name of the recommended model, which counts as much as the likeliest.

    Returns
    -------
    mapping
        By input, "gain", "lag_s" and "dead_time_s"; empty for an integrator.
    """
    best = fits[recommended]
    if best.identified.model.integrators:
        return {}
    n = best.problem.n_measured
    weights = {
        name: weight
        for name, weight in likely_models(table, fits).items()
        if not any(f.code == "fit.lag_unbounded" for f in fits[name].findings)
    }
    weights[recommended] = 1.0
    initial = best.problem.initial
    likely = [
        (weight, fits[name].identified.by_input)
        for name, weight in weights.items()
        if fits[name].problem.n_measured == n and fits[name].problem.initial == initial
    ]
    averages: dict[str, dict[str, Estimate]] = {}
    for name in best.identified.by_input:
        used = [(weight, models[name]) for weight, models in likely if models[name].gain]
        if used:
            used_weights = [weight for weight, _ in used]
            averages[name] = {
                "gain": mixed([model.gain_parts for _, model in used], used_weights),
                "lag_s": mixed([model.lag_parts for _, model in used], used_weights),
                "dead_time_s": mixture([dead_time_s(model) for _, model in used], used_weights),
            }
    return averages


def mixed(
    distributions: Sequence[tuple[list[Estimate], list[float]]], weights: Sequence[float]
) -> Estimate:
    """The mixture of mixtures of normal distributions with the weights of each."""
    parts = []
    part_weights = []
    for (estimates, shares), weight in zip(distributions, weights):
        parts += estimates
        part_weights += [weight * share / sum(shares) for share in shares]
    return mixture(parts, part_weights)


def dead_time_s(model: Identified) -> Estimate:
    """Dead time of a model of one input [s]; zero with the uncertainty of the times without one.

    Where the data do not determine it, it is any part of the lag, all equally probable.
    """
    found = model.estimates.get("Td")
    if found is not None:
        lag_s = abs(model.lag_s.value)
        largest_u_s = lag_s / np.sqrt(12)
        return found if found.u < largest_u_s else Estimate.normal(lag_s / 2, largest_u_s)
    return Estimate.normal(model.theta.get("Td", 0.0), model.timing_u_s)
