"""What explains the response of a plunged sensor beside its lags, and whether a record can tell.

``tcdyn.sensors.plunge`` uses it. Tests: ``tests/sensors/test_step_causes.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.sensors.step_stages import Fin
from tcdyn.sensors.step_structures import FittedStructure, StepStructure

CHAIN = "chain"
# Probability from which an explanation is named alone, and below which it is not named; by
# judgement: they decide what is said, not the result.
DECIDED = 0.95
POSSIBLE = 0.05
# Share of the variance of the lag that differences between explanations have, from which they are
# named; half of it means that they limit the result
LIMITING_SHARE = 0.5
MOST_NAMED = 3
# Parameters that are zero without an effect, and least departure in standard uncertainties: 5 %
SIZES = {"film": "film_change", "bath": "bath_share"}
SIGNIFICANT = 2.0


def cause(structure: StepStructure) -> str:
    """Return what a structure has beside lags: a ``slow`` path, a stage, or ``chain`` for none.

    A film that settles beside a slow path hardly changes the lag: it counts as the path.
    """
    if structure.slow:
        return "slow"
    return structure.stage or CHAIN


def cause_findings(
    column: str, fitted: Sequence[FittedStructure], weights: Array, lags_s: Array, u_s: float
) -> list[Finding]:
    """Return the explanation that the record shows, or those that it does not distinguish.

    Parameters
    ----------
    column
        The sensor's column.
    fitted, weights, lags_s
        The structures (K), their probabilities (K,) and lags (K,) [s].
    u_s
        Standard uncertainty of the averaged lag [s].

    Returns
    -------
    list of Finding
        Empty, or one: an info for an explanation that is certain, a warning for several that limit
        the result.
    """
    names = np.array([cause(f.structure) for f in fitted])
    probability = {name: float(weights[names == name].sum()) for name in dict.fromkeys(names)}
    likeliest = max(probability, key=lambda name: probability[name])
    if probability[likeliest] > DECIDED:
        if likeliest == CHAIN:
            return []
        of_it = np.flatnonzero(names == likeliest)
        best = fitted[int(of_it[np.argmax(weights[of_it])])].fit
        size = SIZES.get(likeliest)
        if size is not None and abs(best.theta[size]) < SIGNIFICANT * best.u(size):
            return []
        return [_certain(column, likeliest, best.theta)]
    mean_s = float(weights @ lags_s)
    between = 0.0
    for name, share in probability.items():
        if share > 0:
            group_s = float(weights[names == name] @ lags_s[names == name]) / share
            between += share * (group_s - mean_s) ** 2
    if between < LIMITING_SHARE * u_s**2:
        return []
    ranked = sorted(probability, key=lambda name: -probability[name])
    possible = [name for name in ranked if probability[name] > POSSIBLE][:MOST_NAMED]
    return [warning("sensor.causes", subject=column, causes=possible)]


def _certain(column: str, name: str, theta: Mapping[str, float]) -> Finding:
    """Return the finding of an explanation other than a chain of lags."""
    if name == "film":
        ratio = 1 + theta["film_change"]
        return info("sensor.settles", subject=column, ratio=ratio, settling_s=theta["settling_s"])
    if name == "bath":
        bath_s = theta["tau1_s"] * float(np.exp(theta["log_bath"]))
        percent = -100 * theta["bath_share"]
        return info("sensor.bath", subject=column, percent=percent, bath_s=bath_s)
    if name == "fin":
        return info("sensor.fin", subject=column, percent=100 * Fin().gain(theta))
    percent = 100 * slow_share_of_step(theta)
    return info("sensor.slow_path", subject=column, percent=percent, slow_s=theta["slow_s"])


def cause_entries(best: FittedStructure) -> dict[str, Any]:
    """Return the entries of ``fit`` in a sensor file that describe the most probable structure."""
    theta = best.fit.theta
    name = best.structure.stage
    entries: dict[str, Any] = {}
    if best.structure.slow:
        entries |= {"slow_share": slow_share_of_step(theta), "slow_s": theta["slow_s"]}
    if name == "film":
        entries |= {"film_ratio": 1 + theta["film_change"], "settling_s": theta["settling_s"]}
    if name == "bath":
        bath_s = theta["tau1_s"] * float(np.exp(theta["log_bath"]))
        entries |= {"bath_share": -theta["bath_share"], "bath_s": bath_s}
    if name == "fin":
        names = best.structure.names

        def reached(values: Array) -> Array:
            """Share of the bath's step that the reading reaches (1,)."""
            return np.array([Fin().gain(dict(zip(names, values.tolist())))])

        value, covariance = best.fit.propagate(reached)
        share = Estimate.normal(float(value[0]), float(np.sqrt(covariance[0, 0])))
        entries["reached_share"] = share.model_dump()
    return entries


def slow_share_of_step(theta: Mapping[str, float]) -> float:
    """Share of the slow exponential in the step response [1].

    The parameter ``slow_share`` is that of a heat path that ends at the sensor, behind its lag.
    """
    slow_s = theta["slow_s"]
    return theta["slow_share"] * slow_s / (slow_s - theta["tau1_s"])
