"""One sensor from several dips: lag and percent times, with the spread between dips.

``tcdyn sensor plunge`` with several tables uses it. ``tests/sensors/test_dips.py`` and
``python -m tests.sensors.dips_study`` check the coverage of the intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tcdyn.chain.law import FlowLaw
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.unit_names import is_same_name
from tcdyn.sensors.dip_flows import (
    DipFlows,
    FlowEffects,
    flow_effects,
    law_of_chain,
    without_zero,
)
from tcdyn.sensors.file import SensorFile, sensor_file, step_size
from tcdyn.sensors.moved_dips import MovedDip, moved_dip, pool_moved, quantities_of
from tcdyn.sensors.plunge import MEDIUM_LIMIT, TAIL_LIMIT
from tcdyn.sensors.random_effects import RandomEffects, random_effects, with_one_spread
from tcdyn.sensors.surface_h import BoundaryLayer

DIRECTIONS = ("cooling", "heating")
OTHER_DIRECTIONS = ("falling", "rising")  # of another quantity than temperature
# Least number of dips of which each is compared with the others
LEAST_TO_COMPARE = 3
# Probability with which one of the dips of a set is reported to depart from the others by chance.
# Each of K dips is tested at this probability over K (Bonferroni).
FALSE_DEPARTURE = 0.05
# Increase of an inner share, in its standard uncertainties, from which it is reported: by judgement
SHARE_MOVE_U = 1.0
SPREAD_LIMIT = "the spread between dips"
WITHIN_LIMIT = "noise and model of a dip"
LAW_LIMIT = "exponent and inner share, which dips at more flows would determine"


def pool_dips(
    dips: Sequence[SensorFile],
    sensor: str = "sensor",
    film: BoundaryLayer | None = None,
    flows: DipFlows | None = None,
) -> SensorFile:
    """Combine several plunges of one sensor.

    Parameters
    ----------
    dips
        Results of :func:`~tcdyn.sensors.plunge.plunge_sensor`, at least two.
    sensor
        Name of the sensor.
    film
        The boundary layer; its h goes into the file.
    flows
        Flow of each dip; None: all dips are at one flow.

    Returns
    -------
    SensorFile
        Lag and percent times are those of one further dip or use: their uncertainty includes the
        spread between dips. The mean of many dips is ``fit["mean_lag_s"]``. With ``flows`` they are
        those at ``flows.at``, and the file has the law of the lag.

    Raises
    ------
    InputError
        For less than two dips, a dip that is given twice, and dips of different columns, filters
        or methods.

    Notes
    -----
    The scale of all times of a dip differs by one factor from that of the next, of which the
    logarithm has the standard deviation tau. Lag and percent times share tau; it is estimated from
    the one that determines it best, see
    :func:`~tcdyn.sensors.random_effects.with_one_spread`; with ``flows`` from the lag.

    The chain is that of the dip with the smallest relative uncertainty, with all its times scaled
    to the combined lag. Dips of one thermocouple may be in different units, each with the unit in
    the name of its column; the sensor has the column of the first.
    """
    _check_same_sensor(dips)
    column = dips[0].columns[0]
    lags = [Estimate(**dip.fit["lag_s"]) for dip in dips]
    # a dip whose best structure has no short lags does not show that there are none
    common_u_s = max(dip.fit.get("tail_u_s", 0.0) for dip in dips)
    effects = None if flows is None else flow_effects(lags, flows, common_u_s)
    moved = [moved_dip(dip, effects, k) for k, dip in enumerate(dips)]
    pooled = pool_moved(moved, common_u_s, effects)
    lag = pooled.lag.next_estimate()
    largest_shares = [max(dip.chain.taus_s) / dip.chain.lag_s for dip in moved]
    within_split_u_s = np.sqrt(np.mean([dip.split_u_s[0] ** 2 for dip in dips]))
    split_u_s = np.hypot(within_split_u_s, lag.value * np.std(largest_shares, ddof=1))
    split_u_s = float(np.hypot(split_u_s, pooled.split_u_s))
    unit = dips[0].fit.get("unit", "K")
    directions = DIRECTIONS if unit == "K" else OTHER_DIRECTIONS
    heating = [int(step_size(dip.fit) > 0) for dip in dips]
    rows: list[dict[str, Any]] = [
        {
            "file": ", ".join(source.file for source in dip.inputs),
            "direction": directions[is_heating],
            "lag_s": dip_lag.model_dump(),
        }
        for dip, dip_lag, is_heating in zip(dips, lags, heating)
    ]
    by_cause = _uncertainty_by_cause(dips, lags, pooled.lag, effects)
    fit: dict[str, Any] = {
        "lag_s": lag.model_dump(),
        "mean_lag_s": pooled.lag.mean_estimate().model_dump(),
        "between_dips_s": pooled.lag.median_spread * lag.value,
        "within_dip_s": by_cause[WITHIN_LIMIT] * lag.value,
        "limited_by": max(by_cause, key=lambda cause: by_cause[cause]),
        "dips": rows,
    }
    if common_u_s > 0:
        fit["tail_u_s"] = common_u_s
    findings: list[Finding] = []
    if flows is not None and effects is not None:
        of_flows, flow_findings = _results_of_flows(rows, effects, pooled.law, column)
        fit |= of_flows
        findings += flow_findings
    findings += _compare_dips(rows, moved, lags, common_u_s, flows, column)
    moved_lags = [dip.lag for dip in moved]
    of_directions, direction_findings = _compare_directions(
        moved_lags, heating, pooled.lag.common_u, unit, column
    )
    fit |= of_directions
    findings += direction_findings
    if film is not None:
        fit |= film.to_fit(lag)
    for dip in dips:
        findings += [f.at(dip.inputs[0].file) if dip.inputs else f for f in dip.findings]
    return sensor_file(
        sensor,
        {column: pooled.chain},
        "plunge",
        np.array([[lag.u**2]]),
        [min(split_u_s, lag.value)],
        structure=dips[pooled.best].chain.structure,
        lags={column: lag},
        times={column: pooled.times},
        inputs=[source for dip in dips for source in dip.inputs],
        fit=fit,
        findings=findings,
        law=pooled.law,
    )


def _uncertainty_by_cause(
    dips: Sequence[SensorFile],
    lags: Sequence[Estimate],
    pooled: RandomEffects,
    effects: FlowEffects | None,
) -> dict[str, float]:
    """Relative standard uncertainty of the lag by its cause.

    Parameters
    ----------
    dips, lags
        The dips and their lags [s].
    pooled
        The combined lag.
    effects
        Posterior of the law of the lag; None: all dips are at one flow.
    """
    relative_u = [lag.u / lag.value for lag in lags]
    within = float(np.sqrt(max(np.mean(np.square(relative_u)) - pooled.common_u**2, 0.0)))
    by_medium = any(dip.fit.get("limited_by") == MEDIUM_LIMIT for dip in dips)
    shared_limit = MEDIUM_LIMIT if by_medium else TAIL_LIMIT
    return {
        SPREAD_LIMIT: pooled.median_spread,
        WITHIN_LIMIT: within,
        shared_limit: pooled.common_u,
        LAW_LIMIT: 0.0 if effects is None else effects.lag_u_of_law,
    }


def _compare_dips(
    rows: Sequence[dict[str, Any]],
    moved: Sequence[MovedDip],
    lags: Sequence[Estimate],
    common_u_s: float,
    flows: DipFlows | None,
    column: str,
) -> list[Finding]:
    """Compare each dip with the others: the lag without it, and a warning for one that departs.

    Parameters
    ----------
    rows
        Entry of each dip in ``fit``, which gets the lag of one further dip without it,
        ``without_s``.
    moved
        The dips at the flow of the result.
    lags
        Lag of each dip at its own flow [s].
    common_u_s
        Standard uncertainty that all dips share [s].
    flows
        Flow of each dip; None: all are at one flow.
    column
        The sensor's column.

    Notes
    -----
    The p-value of each dip is that of the predictive distribution of the others. The smallest of K
    is below ``FALSE_DEPARTURE`` / K with at most that probability if all dips are of one sensor.
    ``python -m tests.sensors.dips_study dips`` prints how often.
    """
    if len(lags) < LEAST_TO_COMPARE:
        return []
    p_values = []
    for k, lag in enumerate(lags):
        others = [j for j in range(len(lags)) if j != k]
        if flows is None:
            quantities = quantities_of([moved[j] for j in others], common_u_s)
            without = predicted = with_one_spread(*quantities)[0]
        else:
            effects = flow_effects([lags[j] for j in others], flows.of(others), common_u_s)
            without = effects.lag_at(flows.at)
            predicted = effects.lag_at(flows.values[k])
        rows[k]["without_s"] = without.next_estimate().model_dump()
        p_values.append(predicted.departure_p(lag))
    k = int(np.argmin(p_values))
    if p_values[k] >= FALSE_DEPARTURE / len(lags):
        return []
    finding = warning(
        "sensor.dip_departs",
        subject=column,
        dip=rows[k]["file"] or f"dip {k + 1}",
        lag_s=lags[k].value,
        u_s=lags[k].u,
        without_s=rows[k]["without_s"]["value"],
        without_u_s=rows[k]["without_s"]["u"],
        p_value=p_values[k],
    )
    return [finding]


def _compare_directions(
    lags: Sequence[Estimate],
    heating: Sequence[int],
    common_u: float,
    unit: str,
    column: str,
) -> tuple[dict[str, Any], list[Finding]]:
    """Compare the lags of heated and cooled dips: entries of ``fit``, and a warning.

    Parameters
    ----------
    lags
        Lag of each dip at the flow of the result [s].
    heating
        1 for each dip that was heated, 0 for one that was cooled.
    common_u
        Relative standard uncertainty that all dips share.
    unit
        Unit of differences of the readings.
    column
        The sensor's column.
    """
    if len(set(heating)) < 2:
        return {}, []
    by_direction = random_effects(lags, heating, common_u)
    if not by_direction.groups_differ():
        return {}, []
    falling, rising = DIRECTIONS if unit == "K" else OTHER_DIRECTIONS
    cooling_lag = by_direction.mean_estimate(0)
    heating_lag = by_direction.mean_estimate(1)
    entries = {
        f"{rising}_lag_s": heating_lag.model_dump(),
        f"{falling}_lag_s": cooling_lag.model_dump(),
    }
    finding = warning(
        "sensor.directions",
        subject=column,
        heating_s=heating_lag.value,
        cooling_s=cooling_lag.value,
    )
    return entries, [finding.in_unit(unit)]


def _results_of_flows(
    rows: Sequence[dict[str, Any]], effects: FlowEffects, law: FlowLaw | None, column: str
) -> tuple[dict[str, Any], list[Finding]]:
    """How the lag follows the flow: entries of ``fit``, and findings.

    Parameters
    ----------
    rows
        Entry of each dip in ``fit``, which gets its ``flow``.
    effects
        Posterior of the law of the lag.
    law
        The law of the file; None: its chain cannot have one.
    column
        The sensor's column.
    """
    flows = effects.flows
    for row, value in zip(rows, flows.values):
        row["flow"] = value
    film, inner = effects.parts_s()
    entries = {
        "flow": flows.at,
        "exponent": effects.exponent.model_dump(),
        "inner_share": effects.inner_share.model_dump(),
        "film_s": film.model_dump(),
        "inner_s": inner.model_dump(),
    }
    findings = []
    if effects.contradicts:
        finding = warning(
            "sensor.dips_law",
            subject=column,
            quantity=flows.quantity,
            exponent=flows.exponent[0],
            exponent_u=flows.exponent[1],
            p_value=effects.misfit_p,
        )
        findings.append(finding)
    if law is None:
        findings.append(_no_law(column, flows))
    return entries, findings


def dip_with_law(dip: SensorFile, flows: DipFlows) -> SensorFile:
    """The sensor of one dip, with the law of its lag as it is known without further dips.

    Parameters
    ----------
    dip
        Result of :func:`~tcdyn.sensors.plunge.plunge_sensor`.
    flows
        Its flow, and what is known of exponent and inner share.

    Returns
    -------
    SensorFile
        The sensor. A warning says where the response does not allow a film as large as that of
        the inner share.
    """
    column = dip.columns[0]
    chain = without_zero(dip.chains[0])
    if chain is None:
        return dip.model_copy(update={"findings": [*dip.findings, _no_law(column, flows)]})
    stated = flows.prior_law
    law = law_of_chain(stated, chain)
    sensor_s = chain.lag_s - chain.conditioning.lag_s
    share = 1 - (1 - law.inner_share) * sum(chain.taus_s) / sensor_s
    findings = list(dip.findings)
    if share - stated.inner_share > SHARE_MOVE_U * stated.inner_share_u:
        finding = info("sensor.dip_film", subject=column, share=share, stated=stated.inner_share)
        findings.append(finding)
    channel = dip.chain.channels[column].model_copy(
        update={"taus_s": chain.taus_s, "zero_s": chain.zero_s}
    )
    chains = dip.chain.model_copy(update={"channels": {column: channel}})
    return dip.model_copy(update={"law": law, "chain": chains, "findings": findings})


def _no_law(column: str, flows: DipFlows) -> Finding:
    """The warning that the chain of a dip cannot follow a flow."""
    return warning("sensor.dip_no_law", subject=column, quantity=flows.quantity, value=flows.at)


def _check_same_sensor(dips: Sequence[SensorFile]) -> None:
    """Check that at least two different dips are plunges of one column with one filter.

    Raises
    ------
    InputError
        Otherwise.
    """
    if len(dips) < 2:
        raise InputError(f"{len(dips)} dips to combine", expected="at least two")
    if any(dip.method != "plunge" or len(dip.columns) != 1 for dip in dips):
        raise InputError("a dip is not the result of a plunge", expected="plunges of one column")
    columns = list(dict.fromkeys(dip.columns[0] for dip in dips))
    if any(not is_same_name(columns[0], name) for name in columns):
        raise InputError(
            f"the dips have the columns {', '.join(columns)}",
            expected="one sensor, so one column, whatever its unit",
        )
    units = list(dict.fromkeys(dip.fit.get("unit", "K") for dip in dips))
    if len(units) > 1:
        raise InputError(
            f"the dips are in {' and '.join(units)}", expected="one quantity, such as temperature"
        )
    if any(dip.conditioning != dips[0].conditioning for dip in dips):
        raise InputError("the dips have different filters", expected="one filter")
    checksums = [source.sha256 for dip in dips for source in dip.inputs]
    # of data in memory the results tell: two records never have the same noise
    results = [repr(dip.fit) for dip in dips if "entry_s" in dip.fit]
    if len(set(checksums)) < len(checksums) or len(set(results)) < len(results):
        raise InputError(
            "two of the dips are one file, or have the same content",
            expected="different dips",
            remedy="give each dip once",
        )
