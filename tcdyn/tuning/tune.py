"""The settings of a controller for a plant, checked over the draws of its parameters.

``tcdyn.identification`` calls it for identified models. Tests: ``tests/tuning/test_tune_model.py``;
true margins inside of the stated ranges: ``python -m tests.tuning.tuning_study``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tcdyn.chain.rational import Rational
from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, error, info, warning
from tcdyn.tuning.forms import Controller
from tcdyn.tuning.margins import crossover_rad_s, frequency_grid, loop_margins
from tcdyn.tuning.options import DEFAULT_MAX_MS, TuneOptions
from tcdyn.tuning.plant import Plant
from tcdyn.tuning.reduction import ReducedModel, reduce_model
from tcdyn.tuning.responses import Responses, simulate_loops
from tcdyn.tuning.result import MARGIN_TEXTS, RESPONSE_TEXTS, Spread, Tuning
from tcdyn.tuning.rules import robust, simc

# Ms above which a loop is not robust: usual values are 1.2 to 2 (Åström and Hägglund, Advanced PID
# Control, ISA 2006). Ms <= 2 implies a gain margin above 2 and a phase margin above
# 2 arcsin(1/(2 Ms)) = 29 deg, so that these need no limits of their own.
LARGEST_MS = 2.0
# Share of unstable draws above which the settings are an error: the 95 % range of the draws leaves
# 2.5 % at its bad end, so that the range itself then contains unstable loops.
MAX_UNSTABLE_SHARE = 0.025
# Samples in the rise time of the closed loop, below which a controller samples slowly: usual are 4
# to 10 (Åström and Wittenmark, Computer-Controlled Systems, 3rd ed. 1997).
MIN_SAMPLES_A_RISE = 4.0
QUANTILES = (0.025, 0.975)
HIGHER_IS_WORSE = {name: name not in ("gain_margin", "phase_margin_deg") for name in MARGIN_TEXTS}


def tune_plant(plant: Plant, options: TuneOptions) -> Tuning:
    """Settings of a controller for a plant.

    Parameters
    ----------
    plant
        The plant and its draws.
    options
        Rule, controller and speed.

    Returns
    -------
    Tuning
        The settings, with margins and responses of the plant and of its draws.

    Raises
    ------
    InputError
        For a plant without a static gain, an unstable one, and one for which the rule has no
        settings.

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> tuning = tune_plant(Plant(Chain([8.0], delay_s=1.0).rational), TuneOptions())
    >>> tuning.controller.ideal.gain, round(tuning.margins["ms"].value, 2)
    (4.0, 1.59)
    """
    _check_plant(plant)
    sample_s = options.sample_s or 0.0
    reduced: ReducedModel | None = None
    tau_c_s: float | None = None
    max_ms: float | None = None
    if options.rule == "simc":
        order = 2 if options.controller == "pid" else 1
        reduced = reduce_model(plant.rational, order, sample_s / 2)
        tau_c_s = _time_constant_s(plant, reduced, options)
        controller = simc(reduced, tau_c_s, options.derivative_filter).sampled(sample_s)
    else:
        max_ms = options.max_ms or DEFAULT_MAX_MS
        has_derivative = options.controller == "pid"
        ratio = options.derivative_filter
        controller = robust(plant.rational, has_derivative, max_ms, ratio, sample_s)
    controller = controller.weighted(options.setpoint_weight)
    crossover = crossover_rad_s(plant.rational, controller)
    margins, is_stable = _margins(plant, controller, crossover)
    responses = simulate_loops([plant.rational, *plant.draws], controller, crossover)
    tuning = Tuning(
        plant=plant,
        rule=options.rule,
        kind=options.controller,
        controller=controller,
        reduced=reduced,
        tau_c_s=tau_c_s,
        max_ms=max_ms,
        margins=margins,
        times=_times(responses),
        responses=responses,
        unstable_share=float(np.mean(~is_stable[1:])) if plant.draws else 0.0,
    )
    return replace(tuning, findings=tuple(_findings(tuning, bool(is_stable[0]), options)))


def _check_plant(plant: Plant) -> None:
    """Raise InputError for a plant that is unstable, or without a static gain."""
    g = plant.rational
    if not g.num[0]:
        raise InputError(
            f"{plant.input_name} has no lasting effect on {plant.output_name} in the model "
            f"{plant.model_name}",
            expected="a static gain, or the slope of an integrator",
        )
    if not g.is_stable or g.integrators > 1:
        raise InputError(
            f"the model {plant.model_name} is unstable", expected="a stable or integrating model"
        )


def _time_constant_s(plant: Plant, reduced: ReducedModel, options: TuneOptions) -> float:
    """Time constant of the closed loop [s].

    Parameters
    ----------
    plant, reduced
        The plant and its reduced model.
    options
        Options with the time constant, if it is given.

    Raises
    ------
    InputError
        Where none is given, and the model has neither a dead time nor a record.

    Notes
    -----
    The default of Skogestad (2003) is the effective dead time. A record with the
    interval dt shows nothing above its Nyquist frequency pi/dt; with a time constant of dt or more
    the bandwidth of the loop stays below a third of it.
    """
    if options.tau_c_s is not None:
        return options.tau_c_s
    tau_c_s = max(reduced.dead_time_s, plant.dt_s)
    if tau_c_s <= 0:
        raise InputError(
            "the reduced model has no dead time, and no time constant of the closed loop follows",
            expected="a time constant",
            remedy="give {tau_c_s}",
            parameters={"tau_c_s": f"{reduced.tau1_s / 10:.3g}" if reduced.tau1_s < 1e9 else "1"},
        )
    return tau_c_s


def _margins(
    plant: Plant, controller: Controller, crossover: float
) -> tuple[dict[str, Spread], Flags]:
    """Margins with their spread, and which loops are stable, that of the model first.

    Parameters
    ----------
    plant, controller
        The loop.
    crossover
        Its crossover frequency [rad/s].
    """
    plants: list[Rational] = [plant.rational, *plant.draws]
    omega = frequency_grid(crossover, controller.sample_s)
    found = loop_margins(plants, controller, omega)
    margins = {
        name: _spread(getattr(found, name), higher_is_worse)
        for name, higher_is_worse in HIGHER_IS_WORSE.items()
    }
    return margins, found.is_stable


def _times(responses: Responses) -> dict[str, Spread]:
    """Numbers of the responses with their spread."""
    return {name: _spread(getattr(responses, name), True) for name in RESPONSE_TEXTS}


def _spread(values: Array, higher_is_worse: bool) -> Spread:
    """The spread of a number.

    Parameters
    ----------
    values
        Value of the model, then those of the draws (1 + D,).
    higher_is_worse
        Which end is the worst.
    """
    draws = values[1:]
    if not len(draws):
        return Spread(float(values[0]))
    # no interpolation: some values are infinite
    low, high = np.quantile(draws, QUANTILES, method="inverted_cdf")
    worst = draws.max() if higher_is_worse else draws.min()
    return Spread(float(values[0]), float(low), float(high), float(worst))


def _findings(tuning: Tuning, is_stable: bool, options: TuneOptions) -> list[Finding]:
    """Findings about the settings and the model.

    Parameters
    ----------
    tuning
        The settings.
    is_stable
        Whether the loop of the model is stable.
    options
        The options.
    """
    plant = tuning.plant
    output = plant.output_name
    numbers: Mapping[str, Any] = {
        "rule": tuning.rule,
        "percent": 100 * tuning.unstable_share,
        "ms": tuning.margins["ms"].value,
        "high_ms": tuning.margins["ms"].high95,
        "slower_s": 2 * tuning.tau_c_s if tuning.tau_c_s else None,
    }
    findings = []
    if not is_stable:
        findings.append(error("tune.unstable_model", subject=output, **numbers))
    elif tuning.unstable_share > MAX_UNSTABLE_SHARE:
        findings.append(error("tune.unstable", subject=output, **numbers))
    elif tuning.margins["ms"].value > LARGEST_MS:
        findings.append(warning("tune.not_robust", subject=output, **numbers))
    elif tuning.margins["ms"].high95 > LARGEST_MS or tuning.unstable_share > 0:
        findings.append(warning("tune.undetermined", subject=output, **numbers))
    if plant.troubles:
        grade = error if plant.is_rejected else warning
        findings.append(
            grade("tune.model", subject=plant.model_name, troubles=list(plant.troubles))
        )
    findings += _sampling_findings(tuning)
    findings += _notes(tuning, options)
    return findings


def _sampling_findings(tuning: Tuning) -> list[Finding]:
    """A warning where the controller samples slowly."""
    sample_s = tuning.controller.sample_s
    rise_s = tuning.times["rise_s"].value
    if not sample_s or rise_s >= MIN_SAMPLES_A_RISE * sample_s:
        return []
    return [
        warning(
            "tune.slow_sampling",
            subject=tuning.plant.output_name,
            sample_s=sample_s,
            rise_s=rise_s,
            needed_s=rise_s / MIN_SAMPLES_A_RISE,
        )
    ]


def _notes(tuning: Tuning, options: TuneOptions) -> list[Finding]:
    """Infos about the default of the speed, a derivative, the draws, and the reading."""
    plant = tuning.plant
    reduced = tuning.reduced
    notes = []
    is_default = reduced is not None and options.tau_c_s is None
    if reduced is not None and is_default and reduced.dead_time_s < plant.dt_s:
        notes.append(
            info(
                "tune.no_dead_time",
                subject=plant.model_name,
                dead_time_s=reduced.dead_time_s,
                dt_s=plant.dt_s,
                ratio=reduced.tau1_s / plant.dt_s,
            )
        )
    if reduced is not None and tuning.kind == "pi":
        second = reduce_model(plant.rational, 2, tuning.controller.sample_s / 2)
        # a second lag above the dead time is dominant, and a derivative pays (Skogestad 2003)
        if second.tau2_s > second.dead_time_s:
            notes.append(
                info(
                    "tune.derivative",
                    subject=plant.model_name,
                    tau2_s=second.tau2_s,
                    dead_time_s=second.dead_time_s,
                )
            )
    if not plant.draws:
        notes.append(info("tune.no_distribution", subject=plant.model_name))
    if plant.is_temperature and plant.has_sensor:
        notes.append(info("tune.reading", subject=plant.output_name))
    return notes
