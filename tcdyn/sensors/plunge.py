"""Lag of a bare sensor from one plunge or step, with unknown entry and a non-ideal medium.

``tcdyn sensor`` uses it. The structures of ``tcdyn.sensors.step_structures`` are averaged by BIC.
``tests/sensors/test_sensor_plunge.py`` checks chains of lags, ``tests/sensors/layered_study.py``
sheathed sensors and ``tests/sensors/test_long_lags.py`` long records.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tcdyn.chain import NO_CONDITIONING
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, prior_departure
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.trace_noise import SPIKES, find_spikes
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.file import SHARES, SensorFile, sensor_file
from tcdyn.sensors.step import MAX_ROWS_IN_RISE, block_means, find_step
from tcdyn.sensors.step_causes import cause_entries, cause_findings
from tcdyn.sensors.step_fits import CurveFit, model_average, white_noise_K
from tcdyn.sensors.step_structures import (
    MAX_SLOW_SHARE,
    FittedStructure,
    Junction,
    StepRecord,
    exact_u_s,
    fit_structures,
    later_response,
)
from tcdyn.sensors.surface_h import BoundaryLayer
from tcdyn.series.plausible import LOWEST_DEGC

# Time constant of the medium's own step and its standard uncertainty [s]: 10 mm pass a surface at
# 0.5 m/s in this time.
MEDIUM_S = (0.02, 0.02)
# Half-width of the part of the reading that is compared with the fitted curve, over the time since
# the entry; noises by which they must differ; share of the standard uncertainty of the time, which
# includes the difference, from which there is a warning (chosen by judgement).
CROSSING_WINDOW = 0.1
CROSSING_NOISES = 3.0
CROSSING_LIMIT = 0.7
# Hotter end of a step [degC], and ratio of the radiative heat transfer coefficients at the final
# and at the first temperature or its inverse, from which radiation in a gas changes the lag clearly
# within the step (chosen by judgement).
RADIATION_DEGC = 300.0
RADIATION_RATIO = 1.5
# Largest standard uncertainty of the medium's lag over the lag: beyond it the response may be that
# of the medium; chosen by judgement.
MEDIUM_SHARE = 0.1
# Difference of specified and fitted entry, in standard uncertainties, beyond which a warning is
# given: by chance in 0.3 % of records.
CONFLICT_U = 3.0
# Least standard uncertainty of that difference over the specified u: below it the convergence of
# the fit decides how far the entry moves.
MIN_SHIFT_U = 0.5
# Shortest interval [s]: a lag may be 1e-6 s (`tcdyn sensor new`); a shorter interval is time in
# another unit.
SHORTEST_ROW_S = 1e-7
# Standard uncertainty of lag and times by the model, over the lag: rms error of junctions at the
# sheath in `python -m tests.sensors.layered_study sheath`.
MODEL_U = {"insulated": 0.0, "grounded": 0.012, "exposed": 0.0}
TAIL_LIMIT = "the short lags of the sensor, which a known instant of entry would determine"
MEDIUM_LIMIT = (
    "a short lag that is the sensor's or the medium's, which a specified lag of the medium "
    "(--medium-s) would determine"
)
MISFIT_SHARE = 0.005  # of the step: rms of the residuals that is always acceptable; by judgement


@one_blas_thread
def plunge_sensor(
    time_s: Array,
    y_degC: Array,
    column: str,
    *,
    sensor: str = "sensor",
    conditioning: Conditioning = NO_CONDITIONING,
    entry_s: tuple[float, float] | None = None,
    medium_s: tuple[float, float] = MEDIUM_S,
    film: BoundaryLayer | None = None,
    junction: Junction = "insulated",
    mean_s: float = 0.0,
    unit: str = "K",
    **more: Any,
) -> SensorFile:
    """The sensor's chain from one step of its surroundings.

    Parameters
    ----------
    time_s, y_degC
        Even times (N,) [s] and readings [degC], NaN where missing.
    column
        The sensor's column.
    sensor
        Name of the sensor.
    conditioning
        Filter after the sensor, which is not estimated.
    entry_s
        Entry on the clock of ``time_s`` and its standard uncertainty [s]; None: unknown.
    medium_s
        Time constant of the medium's own step and its standard uncertainty [s].
    film
        The boundary layer; its h goes into the file, and its diameter narrows the second lag where
        the data do not resolve it.
    junction
        Place of the junction: ``insulated`` in the axis, ``grounded`` on the sheath, or
        ``exposed``, a bare wire or bead.
    mean_s
        Time before each row over which it is a mean [s], as a logger writes; it is not part of the
        lag. Zero: rows are readings of their instant.
    unit
        Unit of differences of the readings: K, or that of another quantity than temperature.
    more
        Other fields of the file.

    Returns
    -------
    SensorFile
        The file with the chain of the most probable structure; lag and times are averages.

    Raises
    ------
    InputError
        No step above the noise, one that is cut off, or fewer than ten readings.

    Notes
    -----
    y = level + drift t + size R(t - t_e), with R the unit step response of the sensor after the
    medium's own lag and before the filter. t_e is free, or has the normal prior ``entry_s``. The
    medium's lag, a transition through the surface or a mixing, has the normal prior ``medium_s``,
    is not negative, and is not part of the result.

    Heat that is conducted to the axis of a cylinder passes through infinitely many first-order
    lags (Carslaw and Jaeger 1959, section 7.7). One to three of them are fitted. The sum of the
    others, which acts as a dead time, is ``tail`` times the last one that is fitted, with the
    normal prior ``TAIL``. Where the data do not resolve a second lag, it takes values on a grid. If
    t_e is unknown, the data do not determine the tail: to first order it is a later entry. The
    prior then gives its uncertainty. A junction at the sheath leads instead: the tail is negative.
    The response is symmetric in the medium's lag and those of the sensor, so that both assignments
    are fitted where the medium can be so slow.

    The stages of ``tcdyn.sensors.step_stages`` replace the first lag, each as a structure of its
    own beside that without: a film coefficient that settles after the entry, as where a hand moves
    the sensor and then holds it; a bath that relaxes; a stem that conducts along itself. The lag
    is that of the settled flow, as a compensation needs it; t50, t63.2 and t90 are those of this
    dip, in a bath that stays.

    A slow second heat path (stem, fitting) divides the step: ``share`` of it arrives after a
    further lag, a factor (1 + (1 - share) slow s)/(1 + slow s). It competes with the drift, which
    has a normal prior of ``DRIFT_SHARE``. If the entry is specified, a dead time is fitted too.

    ``MEDIUM_S`` is a prior: a medium that is slower than it says makes the lag too long. The grid
    and the start shares may be refined, which costs time. ``tests/sensors/test_sensor_plunge.py``
    checks a slow medium and a known entry.
    """
    dt = float(time_s[1] - time_s[0])
    _check_times(time_s, entry_s, medium_s)
    spikes = find_spikes(y_degC, SPIKES["plunge"], white_noise_K(y_degC))
    y_degC = np.where(spikes, np.nan, y_degC)
    step = find_step(y_degC, dt, None if entry_s is None else entry_s[0] - time_s[0], unit)
    block = max(round(step.rise_s / dt) // MAX_ROWS_IN_RISE, 1)
    y = block_means(y_degC[step.first : step.last], block)
    start_s = float(time_s[step.first]) + 0.5 * (block - 1) * dt
    if entry_s is not None:
        entry_s = (entry_s[0], max(entry_s[1], exact_u_s(dt)))
    record = StepRecord(
        t=np.arange(len(y), dtype=np.float64) * (block * dt),
        y=y,
        dt_s=block * dt,
        step=step,
        entry_s=step.entry_s + float(time_s[0]) - start_s,
        entry_prior_s=None if entry_s is None else (entry_s[0] - start_s, entry_s[1]),
        medium_s=medium_s,
        conditioning=conditioning,
        diameter_m=None if film is None else film.diameter_m,
        junction=junction,
        mean_s=mean_s,
    )
    fitted, weights = fit_structures(record)
    estimates = [f.fit.propagate(f.structure.times) for f in fitted]
    values = np.transpose([value for value, _ in estimates])
    variances = np.transpose([np.maximum(np.diag(covariance), 0.0) for _, covariance in estimates])
    best = fitted[int(np.argmax(weights))]
    us = np.hypot(best.fit.student_factor * np.sqrt(variances), MODEL_U[junction] * values[1])
    crossing_errors_s = _crossing_errors_s(record, best.fit)
    us[-len(SHARES) :] = np.hypot(us[-len(SHARES) :], crossing_errors_s[:, None])
    shorter_lags, lag, *times = (model_average(v, u, weights) for v, u in zip(values, us))
    theta = best.fit.theta
    chain = best.structure.chain(theta)
    fit_values: dict[str, Any] = {
        "entry_s": theta["entry_s"] + start_s,
        "entry_u_s": best.fit.u("entry_s"),
        "step_K": theta["size"],
        "noise_K": best.fit.noise_K,
        "lag_s": lag.model_dump(),
    }
    fit_values |= _short_lags(best, values[1], weights, lag)
    fit_values |= cause_entries(best)
    if film is not None:
        fit_values |= film.to_fit(lag)
    limit_K = MISFIT_SHARE * abs(step.size_K)
    findings = best.fit.residual_findings(column, white_noise_K(y), limit_K)
    if spikes.any():
        count = int(np.count_nonzero(spikes))
        findings.append(info("sensor.spikes", subject=column, count=count))
    if step.earlier_K:
        starts_s = float(time_s[step.first])
        findings.append(
            warning(
                "sensor.earlier_event", subject=column, change_K=step.earlier_K, time_s=starts_s
            )
        )
    if step.has_next_event:
        ends_s = float(time_s[step.last])
        findings.append(info("sensor.next_event", subject=column, time_s=ends_s))
    findings += cause_findings(column, fitted, weights, values[1], lag.u)
    findings += _structure_findings(column, record, best)
    if unit == "K":
        findings += _radiation_findings(column, theta["level"], theta["level"] + theta["size"])
    findings += _crossing_findings(column, times, crossing_errors_s)
    if entry_s is not None:
        # a film that settles can explain a wrong instant, too
        without = [k for k, f in enumerate(fitted) if not f.structure.stage]
        plain = fitted[max(without, key=lambda k: weights[k])] if without else best
        findings += _entry_findings(column, record, best, plain, entry_s)
    elif step.first == 0 and theta["entry_s"] < 2 * max(record.dt_s, best.fit.u("entry_s")):
        findings.append(warning("sensor.no_rows_before", subject=column))
    if dt > lag.value:
        findings.append(warning("sensor.slow", subject=column, dt_s=dt, lag_s=lag.value))
    if medium_s[1] > MEDIUM_SHARE * lag.value:
        findings.append(
            warning(
                "sensor.medium",
                subject=column,
                medium_s=medium_s[0],
                medium_u_s=medium_s[1],
                lag_s=lag.value,
            )
        )
    # for use of the chain: that of the best structure, whose lag differs from the average
    lag_u = float(np.hypot(lag.u, lag.value + conditioning.lag_s - chain.lag_s))
    return sensor_file(
        sensor,
        {column: chain},
        "plunge",
        np.array([[lag_u**2]]),
        [min(shorter_lags.u, lag.value)],
        structure=best.structure.name,
        lags={column: lag},
        times={column: dict(zip(SHARES, times))},
        fit=fit_values,
        findings=findings,
        **more,
    )


def _short_lags(
    best: FittedStructure, lags_s: Array, weights: Array, lag: Estimate
) -> dict[str, Any]:
    """Return the uncertainty that all dips of the sensor share, and whether it limits the lag.

    Parameters
    ----------
    best
        The most probable structure.
    lags_s, weights
        Lag [s] and probability of each structure (K,).
    lag
        Their average.

    Returns
    -------
    dict
        ``tail_u_s`` [s] and ``limited_by``, where there is such an uncertainty.

    Notes
    -----
    The sum of the shorter lags that are not fitted has the prior of the tail. Where the data show a
    short lag that may be the medium's, the structures differ by whose lag it is, which another dip
    does not tell.
    """
    tail_u_s = 0.0
    if "tail" in best.fit.theta:
        tail_u_s = best.fit.u("tail") * min(best.structure.chain(best.fit.theta).taus_s)
    medium_u_s = 0.0
    if best.structure.sharp or best.fit.is_resolved(["medium_s"]):
        medium_u_s = float(np.sqrt(weights @ (lags_s - weights @ lags_s) ** 2))
    shared_u_s = float(np.hypot(tail_u_s, medium_u_s))
    shared_part: dict[str, Any] = {}
    if shared_u_s > 0:
        shared_part["tail_u_s"] = shared_u_s
    if shared_u_s**2 > 0.5 * lag.u**2:
        shared_part["limited_by"] = MEDIUM_LIMIT if medium_u_s > tail_u_s else TAIL_LIMIT
    return shared_part


def _check_times(
    time_s: Array, entry_s: tuple[float, float] | None, medium_s: tuple[float, float]
) -> None:
    """Raise InputError for an interval, a medium's lag or an entry that is not possible.

    Parameters
    ----------
    time_s
        Even times (N,) [s].
    entry_s
        Entry and its standard uncertainty [s], or None.
    medium_s
        Medium's lag and its standard uncertainty [s].

    Raises
    ------
    InputError
        With the possible range.
    """
    dt = float(time_s[1] - time_s[0])
    first_s = float(time_s[0])
    last_s = float(time_s[-1])
    length_s = float(time_s[-1] - time_s[0])
    if not dt >= SHORTEST_ROW_S:
        raise InputError(
            f"rows every {dt:.3g} s",
            expected=f"at least {SHORTEST_ROW_S:g} s",
            remedy="give the time in seconds",
        )
    if not (0 <= medium_s[0] <= length_s and 0 <= medium_s[1] <= length_s):
        source = "assumed without {medium_s}" if medium_s == MEDIUM_S else "specified"
        raise InputError(
            f"the medium's lag is {source}: {medium_s[0]:g} +- {medium_s[1]:g} s",
            expected=f"0 to {length_s:g} s, the record's length",
            remedy="specify how fast the medium steps at the sensor",
            parameters={"medium_s": "1e-6+-1e-6" if length_s < MEDIUM_S[0] else None},
        )
    if entry_s is not None and not first_s <= entry_s[0] <= last_s:
        expected = f"{first_s:g} to {last_s:g} s, the range of the record"
        raise InputError(f"the entry is at {entry_s[0]:g} s", expected=expected)


def _structure_findings(column: str, record: StepRecord, best: FittedStructure) -> list[Finding]:
    """Return what the most probable structure says about its bound and the record's length.

    Parameters
    ----------
    column
        The sensor's column.
    record
        Data of the fit.
    best
        The structure.

    Returns
    -------
    list of Finding
        Findings; empty for a record that is long enough for all of the response.
    """
    findings = list[Finding]()
    limit = MAX_SLOW_SHARE[record.junction]
    longest_s = max(best.structure.chain(best.fit.theta).taus_s)
    if best.fit.theta.get("slow_share", 0.0) > 0.99 * limit:
        findings.append(warning("sensor.structure_bound", subject=column, percent=100 * limit))
    after_s = float(record.t[-1]) - record.entry_s
    if after_s < 4 * longest_s:
        findings.append(warning("sensor.cut_off", subject=column, after_s=after_s, lag_s=longest_s))
    return findings


def _crossing_errors_s(record: StepRecord, fit: CurveFit) -> Array:
    """Return how much later than the fitted curve the reading passes each of ``SHARES`` (3,) [s].

    Zero where the noise explains it. A chain of lags cannot describe a lag that changes with the
    temperature, but its residuals show where it does not.
    """
    theta = fit.theta
    finite = np.isfinite(record.y)
    t = record.t[finite]
    curve = record.y[finite] + fit.residual
    reached = (curve - theta["level"]) / theta["size"]
    slopes = np.gradient(curve, t)
    errors_s = []
    for share in SHARES.values():
        row = int(np.argmax((reached >= share) & (t >= theta["entry_s"])))
        half_s = max(CROSSING_WINDOW * (t[row] - theta["entry_s"]), 2 * record.dt_s)
        near = np.abs(t - t[row]) <= half_s
        slope = float(slopes[row])
        if slope == 0.0:
            errors_s.append(0.0)
            continue
        later_s = float(np.mean(fit.residual[near])) / slope
        noise_s = fit.noise_K / np.sqrt(np.count_nonzero(near)) / abs(slope)
        errors_s.append(later_s if abs(later_s) > CROSSING_NOISES * noise_s else 0.0)
    return np.array(errors_s)


def _crossing_findings(column: str, times: Sequence[Estimate], errors_s: Array) -> list[Finding]:
    """Return a warning if the reading passes one of ``SHARES`` clearly off the fitted curve.

    Parameters
    ----------
    column
        The sensor's column.
    times
        Times at which the step response passes them, which include the errors (3,) [s].
    errors_s
        The errors (3,) [s].
    """
    ratios = [abs(error_s) / time.u for error_s, time in zip(errors_s.tolist(), times)]
    worst = int(np.argmax(ratios))
    if ratios[worst] < CROSSING_LIMIT:
        return []
    percent = 100 * list(SHARES.values())[worst]
    time_s = times[worst].value
    later_s = float(errors_s[worst])
    return [
        warning("sensor.crossing", subject=column, percent=percent, time_s=time_s, later_s=later_s)
    ]


def _radiation_findings(column: str, first_degC: float, last_degC: float) -> list[Finding]:
    """Return a warning for a step between temperatures at which radiation differs clearly.

    Parameters
    ----------
    column
        The sensor's column.
    first_degC, last_degC
        Temperatures before and after the step.

    Notes
    -----
    A small body at T in black surroundings at T_s has the radiative heat transfer coefficient
    emissivity sigma (T_s^2 + T^2) (T_s + T) (Incropera and DeWitt, Fundamentals of Heat and Mass
    Transfer, section 1.2). From T to T_s it changes by the factor
    4 T_s^3 / ((T_s^2 + T^2) (T_s + T)), and the lag, where radiation dominates, inversely.
    """
    first_K = first_degC - LOWEST_DEGC
    last_K = last_degC - LOWEST_DEGC
    ratio = 4 * last_K**3 / ((last_K**2 + first_K**2) * (last_K + first_K))
    is_hot = max(first_degC, last_degC) > RADIATION_DEGC
    if not is_hot or max(ratio, 1 / ratio) < RADIATION_RATIO:
        return []
    return [
        warning(
            "sensor.radiation",
            subject=column,
            first_degC=first_degC,
            last_degC=last_degC,
            ratio=ratio,
        )
    ]


def _entry_findings(
    column: str,
    record: StepRecord,
    fitted: FittedStructure,
    plain: FittedStructure,
    specified_s: tuple[float, float],
) -> list[Finding]:
    """Return a warning if the data contradict a specified entry instant, or show a dead time.

    Parameters
    ----------
    column
        The sensor's column.
    record
        Data of the fit.
    fitted
        The most probable structure.
    plain
        The most probable one without a stage.
    specified_s
        Entry instant and its standard uncertainty [s].

    Returns
    -------
    list of Finding
        Empty, or one warning.

    Notes
    -----
    The specified instant is the prior of :func:`tcdyn.core.estimate.prior_departure`. An exact
    instant cannot move in the fit: there the shift is what a linear step asks for, and the
    root of its gain its ratio to the standard uncertainty.

    ``tests/sensors/test_sensor_plunge.py`` checks an entry that is right and one that is
    wrong.
    """
    if fitted.structure.dead:
        dead_s = fitted.fit.theta["dead_s"]
        return [
            warning("sensor.dead_time", subject=column, dead_s=dead_s, specified_s=specified_s[0])
        ]
    if specified_s[1] <= exact_u_s(record.dt_s):
        shift_s, gain = later_response(record, plain)
        ratio = float(np.sqrt(gain))
    else:
        shift_s = fitted.fit.theta["entry_s"] - (record.entry_prior_s or specified_s)[0]
        ratio = prior_departure(shift_s, fitted.fit.u("entry_s"), specified_s[1], MIN_SHIFT_U)
    if ratio <= CONFLICT_U:
        return []
    conflict = warning(
        "sensor.entry_conflict",
        subject=column,
        specified_s=specified_s[0],
        specified_u_s=specified_s[1],
        fitted_s=specified_s[0] + shift_s,
        ratio=ratio,
    )
    return [conflict]
