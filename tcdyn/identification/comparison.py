"""Comparison of models on one record: BIC and held-out error in one table, and all fits.

``tcdyn identify`` and ``tcdyn.plots.pick`` use it. The candidates come from
``tcdyn.identification.ladder``, the choice among them from ``tcdyn.identification.recommendation``.
``tests/identify/test_identify_choose.py``, ``test_identify_advice.py`` and
``test_identify_results.py`` in that folder guard it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.chain import NO_CONDITIONING
from tcdyn.core.arguments import check_keywords, with_named_arguments
from tcdyn.core.errors import InputError, Spelling, as_argument
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, Severity
from tcdyn.core.options import options_of
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.identification.closed_loop import check_closed_loop, closed_loop
from tcdyn.identification.disturbance import Baseline
from tcdyn.identification.even_input import check_even_inputs
from tcdyn.identification.excitation import excitation
from tcdyn.identification.fitting import add_findings, fit
from tcdyn.identification.heldout import Progress, block_held_out_rms, split_held_out
from tcdyn.identification.identified import Identified, from_control
from tcdyn.identification.iodata import IOData, as_iodata
from tcdyn.identification.ladder import (
    N_REFERENCES,
    Ladder,
    common_setting,
    select_structures,
)
from tcdyn.identification.large_records import (
    SearchRecord,
    block_means,
    fit_all_rows,
    search_record,
)
from tcdyn.identification.model_average import average_gain_and_lag, likely_models
from tcdyn.identification.models import (
    Model,
    as_model,
    behind_known,
    process,
    several,
    with_known,
)
from tcdyn.identification.needless import needless_elements, overdamped_models
from tcdyn.identification.options import RecordOptions
from tcdyn.identification.other_hold import check_holds
from tcdyn.identification.plant import KnownSensor, without_sensor
from tcdyn.identification.recommendation import (
    CLEAR_GAIN_RATIO,
    DECISIVE_BIC,
    HELD_OUT_GAIN_RATIO,
    TABLE_LEGEND,
    chain_advice,
    comparison_table,
    conclude,
    recommend,
    responds_at_once,
)
from tcdyn.identification.recordings import from_csv, from_frame, with_hold
from tcdyn.identification.search import Fit
from tcdyn.identification.setting import Setting, bic
from tcdyn.identification.shared_poles import best_common_pole_fit
from tcdyn.identification.validation import (
    Validation,
    centred_fit_percent,
    explains_little,
    has_clean_residuals,
    has_coloured_residuals,
    is_adequate,
    nrmse_percent,
    validate,
)
from tcdyn.rig.disk import Conditioning
from tcdyn.series.joined import files_of_log

# What a caller may compare; a ``control`` system has no type without importing that package.
Entry = Model | str | Fit | Identified | Any

# Usual models: the default of ``tcdyn response``, and the examples of an error message.
CANDIDATES = ("P1", "P1D", "P2", "P2D", "P2Z", "P2DZ", "P2U", "P2DU", "P3", "P3D")
# Models that the advice names where none of the models compared is good enough.
ADVISED_MODELS = (*CANDIDATES, "P1I", "P1DI")
N_HELD_OUT = 6  # models of least BIC that are scored on held-out data (chosen by judgement)
# Models of least error on blocks that are scored too, where BIC does not decide (by judgement).
N_BLOCKS = 4
ALWAYS_HELD_OUT = ("P1D", "P2D")  # models, behind each input, that are scored in any case
NOT_SCORED = (np.nan, np.nan, np.nan)  # held-out statistics of the others
HELD_OUT_COLUMNS = ("held_out_rms", "held_out_percent", "p_held_out")
# Findings of the final fit about the record that count against the recommended model.
RECORD_TROUBLES = (
    "record.closed_loop",
    "record.thermostat",
    "record.other_hold",
    "record.one_frequency",
    "record.inseparable",
    "fit.prior_conflict",
)
# Findings of a fit that do not mean that the record leaves its parameters undetermined.
NOT_OF_THE_MODEL = ("fit.prior_conflict", "record.thermostat")
# Range of the estimated drift or slow wave over that of the output, above which it may cause as
# much of the output as the input does.
MAX_WAVE_SHARE = 0.5


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """The result of :func:`compare`.

    Parameters
    ----------
    table
        One row for each model, best BIC first. All have the same initial state and noise model.
    fits
        Fits by name. That of the recommended model is to all rows; so are the others, unless the
        record is large (:mod:`tcdyn.identification.large_records`).
    recommended
        Name of the recommended model.
    reason
        Why it is recommended.
    are_given
        Whether the caller has named the models; then there are others to try.
    """

    table: pd.DataFrame
    fits: Mapping[str, Fit]
    recommended: str
    reason: Finding
    are_given: bool = False

    @property
    def reason_text(self) -> str:
        """The reason as text."""
        return self.reason.sentence

    @property
    def best_row(self) -> Mapping[str, Any]:
        """The recommended model's row of the table."""
        return dict(self.table[self.table["model"] == self.recommended].iloc[0])

    @property
    def best(self) -> Fit:
        """The fit of the recommended model."""
        return self.fits[self.recommended]

    @property
    def lag_s(self) -> Estimate:
        """The lag of the recommended model [s]; ``averaged`` has that of all likely models."""
        return self.best.lag_s

    @cached_property
    def averaged(self) -> Mapping[str, Mapping[str, Estimate]]:
        """Gain, lag and dead time of each input, averaged over the models.

        Returns
        -------
        mapping
            By input, "gain" (output over input unit), "lag_s" and "dead_time_s" [s]; a model
            without a dead time counts with zero.

        Notes
        -----
        Weights exp(-BIC/2) (Raftery 1995), normalised over models without integrator; those below
        ``MIN_WEIGHT`` are left out. The intervals include the choice of the structure; not so of a
        large record, where only the recommended model is fitted to all rows.
        """
        return average_gain_and_lag(self.table, self.fits, self.recommended)

    def summary(self, spelling: Spelling = as_argument) -> str:
        """The conclusion, the recommended model and the table, as text.

        Parameters
        ----------
        spelling
            Spelling of the parameters that the advice and the findings name.
        """
        advice = self.conclusion.message(spelling)
        best = replace(self.best.identified, sentence=self.validation.message(spelling))
        table = comparison_table(self.table, best.output_unit).to_string(index=False)
        averages = []
        for name, estimates in self.averaged.items():
            gain = estimates["gain"].text()
            lag = estimates["lag_s"].text("s")
            dead_time = estimates["dead_time_s"].text("s")
            averages.append(
                f"Averaged over these models, {name}: gain {gain}, lag {lag}, of which dead time "
                f"{dead_time}."
            )
        return "\n".join(
            [advice, "", best.summary(spelling), "", *averages, "", table, "", TABLE_LEGEND]
        )

    @cached_property
    def validation(self) -> Validation:
        """Residual tests of the recommended model."""
        return validate(self.best)

    @property
    def conclusion(self) -> Finding:
        """Which model to use and why, or that none of them is good enough and what to try."""
        untried = []
        if self.are_given:
            compared = set(self.table["model"])
            untried = [name for name in ADVISED_MODELS if name not in compared]
        codes = {f.code for f in self.best.findings}
        troubles = [code for code in RECORD_TROUBLES if code in codes]
        has_closed_loop = bool({"record.closed_loop", "record.thermostat"} & codes)
        if not has_closed_loop and responds_at_once(self.best):
            troubles.append("model.at_once")
            has_closed_loop = True
        for code in self.validation.record_problems:
            # feedback says the same as a closed loop
            if has_closed_loop and code == "record.feedback":
                continue
            is_on_off = code == "record.nonlinear" and has_two_levels(self.best)
            troubles.append("record.rise_and_fall" if is_on_off else code)
        if self.reason.code == "models.foresees":
            troubles.append("model.general")
        if self.best.identified.statistics.get("wave", 0.0) > MAX_WAVE_SHARE:
            troubles.append("model.wave")
        percent = centred_fit_percent(self.best)
        return conclude(self.table, self.recommended, self.reason, untried, troubles, percent)

    def lag_removal_advice(self, conditioning: Conditioning = NO_CONDITIONING) -> str:
        """How to remove the lag from other traces; empty where no model can be used.

        See :func:`tcdyn.identification.recommendation.chain_advice`.
        """
        if self.conclusion.severity is Severity.ERROR:
            return ""
        return chain_advice(self.best.identified, conditioning)

    @property
    def advice(self) -> str:
        """The conclusion in words: the model to use, or why none is recommended and what to try."""
        return self.conclusion.sentence

    def to_dict(self) -> dict[str, Any]:
        """The recommended model as in its JSON file, the reason, and the table."""
        return {
            **self.best.to_dict(),
            "recommended": self.recommended,
            "why": self.reason_text,
            "averaged": jsonable(self.averaged),
            "comparison": jsonable(self.table),
        }

    def headline(self) -> str:
        """The recommended model, and the number of models."""
        return f"{self.recommended} recommended of {len(self.table)} models; {self.best.headline()}"

    def to_frame(self) -> pd.DataFrame:
        """The table by model, without remarks; rms in the output's unit."""
        return self.table.drop(columns=["remark", "determined"]).set_index("model")


@with_named_arguments
@one_blas_thread
def compare(
    data: IOData | tuple[Any, ...],
    *models: Entry | Sequence[Entry],
    like: Model | None = None,
    sensor: Any = None,
    held_out: IOData | float = 0.3,
    progress: Progress = lambda name, number, count: None,
    **options: Any,
) -> Comparison:
    """Fit every model to all of the data, and score it on data that it has not used.

    Parameters
    ----------
    data
        One output, one or several inputs; or a tuple (u, y, dt_s), as for :func:`fit`.
    models
        Models, or one list of them: names or models to fit, or existing ones (a :class:`Fit`, an
        :class:`Identified` or a ``control`` system; :func:`tcdyn.identification.from_control` adds
        a dead time), of which only the offset is fitted. Two of one name are numbered. A fitted
        model of sysidentpy (``predict`` and ``max_lag``) is scored by free simulation and never
        recommended.
        Without any, they are the process models of :mod:`tcdyn.identification.ladder`, and with
        several inputs the inputs that matter.
    like
        Model whose known factor, offset and fixed gain all models of the ladder have.
    sensor
        The sensor that measures the output: a lag [s], alone or with its standard uncertainty, a
        Chain, or a column of a sensor file. The models are then those of the plant without it, and
        their uncertainties contain that of the sensor.
    held_out
        Another record, or the last share of this one (with several runs: the last run). Held-out
        scores come from a second fit to the rest.
    progress
        Called with each model before it is fitted.
    options
        Options of :func:`fit`, without ``start`` and ``weights``.

    Returns
    -------
    Comparison
        Table, fits, and the recommended model with its reason.

    Raises
    ------
    InputError
        For data from which no model can be identified.

    Notes
    -----
    All models of the table share one setting: the initial state, and the disturbance that is
    likeliest with the best of the first models, as far as ``options`` do not give them
    (:func:`tcdyn.identification.ladder.common_setting`). Where the residuals of the recommended
    model are clearly coloured or follow the input, or it reproduces little, the models with white
    noise and transfer functions with common poles replace it if they simulate data left out of the
    fit better; the final fit then has white noise and robust intervals. Common poles are tried with
    several inputs in any case but that of noise with a memory beyond the record. The recommended
    model, and those about as likely, are fitted once more, with the average over slow noise
    (:mod:`tcdyn.estimation.noise_average`). For the recommendation see
    :func:`tcdyn.identification.recommendation.recommend`.

    Examples
    --------
    >>> from tcdyn.identification import simulate
    >>> u = np.repeat([20.0, 80.0, 20.0], 60)
    >>> truth = process("P1").rational({"Kp": 1.0, "Tp1": 0.75})
    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.2, len(u))
    >>> data = IOData.from_arrays(u, y, 0.05, hold="zoh")

    >>> comparison = compare(data, "P1", "P1D")
    >>> comparison.recommended, [*comparison.to_frame().index]
    ('P1', ['P1', 'P1D'])
    """
    data = as_iodata(data)
    check_keywords("compare", options, list(signature(fit).parameters)[2:])
    for name in {"weights", "start"} & set(options):
        raise InputError(
            f"{name} is given, which is of one model and one record",
            where="compare",
            remedy=f"pass fit(data, model, {name}=..) as a model: it is compared as it stands",
        )
    entries: list[Entry] = []
    for m in models:
        entries += m if isinstance(m, list | tuple) else [m]

    simulators = [m for m in entries if hasattr(m, "predict") and hasattr(m, "max_lag")]
    entries = [m for m in entries if not any(m is s for s in simulators)]
    if options.get("check", True):
        loops = check_closed_loop(data, data.name or "identify")
    else:
        loops = closed_loop(data)
    data = replace(data, findings=(*data.findings, *loops, *excitation(data)))
    template = like or process("P1")
    known_sensor = None if sensor is None else KnownSensor.of(sensor)
    if known_sensor is not None:
        template = behind_known(template, known_sensor.known)
    given = {name: v for name, v in options.items() if v != "auto" or name == "input_noise"}
    ladder = Ladder(replace(data, findings=()), template, given, progress, held_out)
    given_models = [resolve_entry(m, data) for m in entries]
    if known_sensor is not None:
        given_models = [behind_known(model, known_sensor.known) for model in given_models]
    record = search_record(ladder)
    if options.get("check", True):
        check_even_inputs(record.data, data.name or "identify")
    if isinstance(held_out, IOData):
        held_out = block_means(held_out, record.block)
    searched = replace(ladder, data=record.data, held_out=held_out)
    result = search_models(searched, given_models)
    result = finish(ladder, data, result, record)
    if known_sensor is not None:
        result = of_plants(ladder, result, known_sensor, like or process("P1"))
    rows = [
        simulator_row(m, f"{type(m).__name__}, {k}", data, held_out)
        for k, m in enumerate(simulators, 1)
    ]
    if not rows:
        return result
    return replace(result, table=pd.concat([result.table, pd.DataFrame(rows)], ignore_index=True))


@with_named_arguments
def identify(
    data: IOData | pd.DataFrame | str | Path | Sequence[str | Path] | tuple[Any, ...],
    *models: Entry | Sequence[Entry],
    input: str | Sequence[str] = (),
    output: str | Sequence[str] = (),
    **options: Any,
) -> Comparison:
    """Compare models of the dynamics between two columns, validate them, and recommend one.

    Parameters
    ----------
    data
        A table with one row for each sample: a DataFrame, or a file (CSV, LVM, TDMS, Parquet, .xlsx
        or .mat), of which ``input`` and ``output`` name columns; of several files each is a run. Or
        a tuple (u, y, dt_s) of arrays or Series, or IOData.
    models
        Models to compare; without any, process models of one to three lags.
    input, output
        Columns of the inputs and of the outputs; only of a table.
    options
        How a table is read, the fields of :class:`tcdyn.identification.options.RecordOptions`; and
        those of :func:`compare`. ``hold`` may be given for other data, too.

    Returns
    -------
    Comparison
        ``best`` is the fit of the recommended model, ``summary()`` the conclusion.

    Raises
    ------
    InputError
        For data from which no model can be identified.

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> heater = np.repeat([0.0, 1.0, 0.0, 1.0], 50)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.01, 200)
    >>> reading = Chain(0.8).response(heater, 0.1, "zoh") + noise
    >>> index = pd.Index(0.1 * np.arange(200), name="time_s")
    >>> table = pd.DataFrame({"heater": heater, "T_degC": reading}, index)
    >>> result = identify(table, "P1", "P1D", input="heater", output="T_degC")
    >>> result.recommended, round(result.best.identified.theta["Tp1"], 1)
    ('P1', 0.8)
    """
    of_record = [each.name for each in fields(RecordOptions)]
    given = {name: options.pop(name) for name in of_record if name in options}
    of_compare = ["like", "sensor", "held_out", "progress"]
    known = [*of_record, *list(signature(fit).parameters)[2:], *of_compare]
    check_keywords("identify", options, ["input", "output", *known])
    settings = options_of(RecordOptions, given, "identify")
    hold = None if settings.hold is None else settings.holds
    columns = {name: value for name, value in settings.stated.items() if name != "hold"}
    files = files_of_log(data)
    if files:
        data = from_csv(files, input=input, output=output, hold=hold or "auto", **columns)
    elif isinstance(data, pd.DataFrame):
        data = from_frame(data, input=input, output=output, hold=hold or "auto", **columns)
    elif isinstance(data, IOData):
        data = with_hold(data, hold) if hold else data
    else:
        data = with_hold(as_iodata(data), hold or "auto")
    return compare(data, *models, **options)


def search_models(ladder: Ladder, given_models: Sequence[Model]) -> Comparison:
    """Compare the models on the record of the search.

    Parameters
    ----------
    ladder
        The record of the search and the options.
    given_models
        The models that the caller has named; none for the ladder.

    Returns
    -------
    Comparison
        Table, fits and recommendation.
    """

    def compared(ladder: Ladder) -> Comparison:
        """Compare the given models, or those of the ladder, under the noise of its options."""
        fits: Mapping[str, Fit | InputError]
        if given_models:
            fits, setting = fit_given(ladder, given_models)
        else:
            fits, setting = select_structures(ladder)
        return score(ladder, fits, setting)

    result = compared(ladder)
    if ladder.setting.is_averaged and is_doubtful(result.best):
        result = prefer_held_out(result, compared(ladder.with_white_noise()))
    if given_models:
        return replace(result, are_given=True)
    has_several_inputs = len(ladder.data.input_names) > 1
    if is_doubtful(result.best):
        result = add_common_pole_model(ladder, result)
    elif has_several_inputs and result.best.noise.time_constant < ladder.data.n_samples:
        # the errors on left-out blocks of a record with a random walk contain the walk
        result = add_common_pole_model(ladder, result, CLEAR_GAIN_RATIO)
    return result


def of_plants(ladder: Ladder, result: Comparison, sensor: KnownSensor, like: Model) -> Comparison:
    """Return the comparison with the plants without the sensor as its models.

    Parameters
    ----------
    ladder
        The record and the options.
    result
        The comparison of plants behind the sensor.
    sensor
        The sensor.
    like
        The template of the plants, with the known factor that is not the sensor.
    """

    def fit_near(model: Model, near: Fit) -> Fit | None:
        """Return the fit of a model from the parameters and under the setting of another fit."""
        setting = replace(ladder.setting, initial=near.problem.initial)
        if near.noise.averaged:
            setting = setting.at_likeliest_noise(near)
        return ladder.fit_model(model, setting, [near.identified.theta])

    used = {result.recommended, *likely_models(result.table, result.fits)}
    fits = {}
    for name, fitted in result.fits.items():
        plant = with_known(fitted.identified.model, like.known)
        changed = sensor if name in used else KnownSensor(sensor.chain)
        fits[name] = without_sensor(fitted, changed, plant, fit_near)
    return replace(result, fits=fits)


def simulator_row(model: Any, name: str, data: IOData, held_out: IOData | float) -> dict[str, Any]:
    """Return the row of a fitted model of sysidentpy, scored by free simulation.

    Parameters
    ----------
    model
        The model, fitted to inputs and output in the units of the data.
    name
        Its name in the table.
    data, held_out
        As in :func:`compare`.

    Returns
    -------
    dict
        Values by column; no criteria, for the model may have been fitted to other data.

    Notes
    -----
    Each run starts with its first ``max_lag`` measured outputs, which are not scored.
    """
    row = {"model": name, "remark": "as given, scored by free simulation", "determined": False}
    _, test, from_s = split_held_out(data, held_out)
    scores = []
    for record, first_s in ((data, -np.inf), (test, from_s)):
        if any(np.isnan(run.u).any() or np.isnan(run.y).any() for run in record.runs):
            return {**row, "remark": "not scored: samples are missing"}
        errors = []
        outputs = []
        for k, run in enumerate(record.runs):
            lag = model.max_lag
            simulated = np.ravel(model.predict(X=run.u, y=run.y[:lag]))
            is_scored = (record.times_s(k) >= first_s) & (np.arange(run.n) >= lag)
            outputs.append(run.y[is_scored, 0])
            errors.append(run.y[is_scored, 0] - simulated[is_scored])
        rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
        scores += [rms, nrmse_percent(errors, outputs)]
    columns = ("rms", "fit_percent", "held_out_rms", "held_out_percent")
    return {**row, "parameters": len(np.ravel(model.theta)), **dict(zip(columns, scores))}


def resolve_entry(given: Entry, data: IOData) -> Model:
    """The model to compare: by name or value, or with all parameters fixed to an existing model.

    With several inputs a model of one input is taken for each of them.

    Parameters
    ----------
    given
        Name, model, fit, identified model or ``control`` system.
    data
        The record, for the names of its inputs.

    Returns
    -------
    Model
        The model; that of a fit has all its parameters fixed and the name "... as given".
    """
    identified = given.identified if isinstance(given, Fit) else given
    if hasattr(given, "dcgain"):
        identified = from_control(given)
    inputs = data.input_names
    if isinstance(identified, Identified):
        model = identified.model
        theta = identified.theta
        default_labels = tuple(f"u[{k}]" for k in range(len(inputs)))
        if model.inputs == default_labels:  # of the control package: inputs by their position
            model = several(model.submodels, inputs)
            theta = {}
            for k, name in enumerate(inputs):
                for n, full in identified.model.branch(k)[1].items():
                    theta[f"{n}.{name}"] = identified.theta[full]
        return replace(model, name=f"{model.name} as given", fixed=theta)
    model = as_model(identified)
    if model.submodels or len(inputs) == 1:
        return model
    return several([model] * len(inputs), inputs)


def distinct_models(models: Sequence[Model]) -> list[Model]:
    """The models without repeats; different ones of the same name are numbered."""
    named: dict[str, Model] = {}
    for model in models:
        pattern = re.escape(model.name) + r"(, \d+)?"
        same_name = [n for n in named if re.fullmatch(pattern, n)]
        if any(replace(named[n], name=model.name) == model for n in same_name):
            continue
        name = f"{model.name}, {len(same_name) + 1}" if same_name else model.name
        named[name] = replace(model, name=name)
    return list(named.values())


def fit_given(
    ladder: Ladder, models: Sequence[Model]
) -> tuple[dict[str, Fit | InputError], Setting]:
    """Fit the models that the caller has named, under one selected setting.

    Parameters
    ----------
    ladder
        The record and the options.
    models
        The models.

    Returns
    -------
    fits
        Fits by name, or the error of a model that cannot be fitted.
    setting
        The setting.

    Raises
    ------
    InputError
        Where no model can be fitted.
    """
    distinct = distinct_models(models)

    def fit_all(setting: Setting) -> dict[str, Fit | InputError]:
        """Return the fit, or the error, of each model."""
        results: dict[str, Fit | InputError] = {}
        for number, model in enumerate(distinct, 1):
            ladder.progress(model.name, number, len(distinct))
            try:
                results[model.name] = ladder.checked_fit(model, setting)
            except InputError as error:
                results[model.name] = error
        return results

    target = ladder.setting
    first = target.with_white_noise if target.is_averaged else target
    fits = fit_all(first)
    fitted = [f for f in fits.values() if isinstance(f, Fit)]
    if not fitted:
        raise next(f for f in fits.values() if isinstance(f, InputError))
    references = sorted(fitted, key=bic)[:N_REFERENCES]
    setting = common_setting(ladder, references, target)
    if setting != first:
        fits = fit_all(setting)
    return fits, setting


def score(ladder: Ladder, fits: Mapping[str, Fit | InputError], setting: Setting) -> Comparison:
    """Score fits on held-out data, and recommend one.

    Parameters
    ----------
    ladder
        The record and the options.
    fits
        Fits by name under one setting, or errors.
    setting
        The setting.

    Returns
    -------
    Comparison
        Table, fits and recommendation. A model that cannot be fitted has a row with a remark.
    """
    fitted = {name: f for name, f in fits.items() if isinstance(f, Fit)}
    ranked = sorted(fitted, key=lambda name: bic(fitted[name]))
    overdamped = overdamped_models(fitted)
    needless = needless_elements(fitted)
    rows = {name: _table_row(name, fitted[name]) for name in ranked}
    unscored = pd.DataFrame(list(rows.values()))
    best_by_bic = recommend(unscored, overdamped, needless)[0]
    n_inputs = len(ladder.data.input_names)
    simple = [" + ".join([name] * n_inputs) for name in ALWAYS_HELD_OUT]
    scored = {*ranked[:N_HELD_OUT], *simple, best_by_bic}
    if not has_clean_residuals(fitted[best_by_bic]):
        scored |= set(unscored.sort_values("block_rms")["model"][:N_BLOCKS])
    for name, result in fits.items():
        if isinstance(result, InputError):
            rows[name] = {"model": name, "remark": str(result), "determined": False}
        elif name in scored:
            held_out = ladder.held_out_error(result, setting)
            rows[name] |= dict(zip(HELD_OUT_COLUMNS, held_out))
    table = pd.DataFrame([rows[name] for name in fits]).sort_values(
        "BIC", key=lambda b: b.round(6), kind="stable", ignore_index=True
    )
    recommended, reason = recommend(table, overdamped, needless)
    return Comparison(table, fitted, recommended, reason)


def _table_row(
    name: str, full: Fit, held_out: tuple[float, float, float] = NOT_SCORED
) -> dict[str, Any]:
    """Return the row of a model: statistics of the fit and of the held-out simulation.

    Parameters
    ----------
    name
        Name of the model.
    full
        Fit to all of the data.
    held_out
        Rms error, fit percent and p value of the held-out simulation.

    Returns
    -------
    dict
        Values by column. ``tcdyn.identification.recommendation`` reads these names.
    """
    statistics = full.identified.statistics
    return {
        "model": name,
        "parameters": int(statistics["parameters"]),
        "fit_percent": statistics["fit_percent"],
        "rms": statistics["rms"],
        "AICc": statistics["aicc"],
        "BIC": statistics["bic"],
        **dict(zip(HELD_OUT_COLUMNS, held_out)),
        "block_rms": block_held_out_rms(full),
        **_conclusion_columns(full),
    }


def _conclusion_columns(full: Fit) -> dict[str, Any]:
    """Values of the columns of the table on which the conclusion is based, by column."""
    findings = [f for f in full.findings if f.code not in NOT_OF_THE_MODEL]
    return {
        "p_white": full.identified.statistics["p_white"],
        "p_input": full.identified.statistics["p_input"],
        "remark": "; ".join(full.warnings),
        "determined": not findings,
    }


def has_two_levels(result: Fit) -> bool:
    """Whether each input has two values only, so that there is no step between other levels."""
    inputs = np.concatenate([s.inputs for s in result.problem.segments])
    return all(len(np.unique(u)) <= 2 for u in inputs.T)


def is_doubtful(result: Fit) -> bool:
    """Whether other kinds of model are to be tried: clear residual dynamics, or a poor fit."""
    return not is_adequate(result) or explains_little(result)


def prefer_held_out(result: Comparison, other: Comparison) -> Comparison:
    """Return the other comparison where its model simulates the held-out data better.

    Their disturbances differ, so the errors on left-out blocks cannot be compared: that of a random
    walk contains the walk.
    """
    error = result.best_row["held_out_rms"]
    other_error = other.best_row["held_out_rms"]
    return other if other_error < HELD_OUT_GAIN_RATIO * error else result


def add_common_pole_model(ladder: Ladder, result: Comparison, limit: float = 1.0) -> Comparison:
    """Add a transfer function whose inputs share their poles, if it is better.

    See :func:`tcdyn.identification.shared_poles.best_common_pole_fit`.

    Parameters
    ----------
    ladder
        The record and the options.
    result
        The comparison so far.
    limit
        Largest error of that model over that of the recommended one.

    Returns
    -------
    Comparison
        With that model as the recommended one, or ``result`` unchanged.
    """
    if ladder.options.get("loss", "linear") != "linear":
        return result
    ladder.progress("common poles", 1, 1)
    # the best that process models about as likely do on unseen data
    table = result.table
    is_near = table["BIC"] < result.best_row["BIC"] + DECISIVE_BIC
    held_out_rms = float(table["held_out_rms"][is_near].min())
    better = best_common_pole_fit(ladder, result.best, held_out_rms, limit)
    if better is None:
        return result
    fit_of_poles, ratio, error = better
    name = fit_of_poles.problem.model.name
    row = _table_row(name, fit_of_poles, error)
    table = pd.concat([pd.DataFrame([row]), result.table], ignore_index=True)
    reason = replace(
        result.reason,
        code="models.foresees",
        subject=name,
        numbers={
            "white": not has_coloured_residuals(fit_of_poles),
            "other": result.recommended,
            "ratio": ratio,
        },
    )
    return Comparison(table, {name: fit_of_poles, **result.fits}, name, reason)


def finish(ladder: Ladder, data: IOData, result: Comparison, record: SearchRecord) -> Comparison:
    """Fit the likely models once more with the average over noise, the best with its intervals.

    A large record is fitted to all rows (:func:`tcdyn.identification.large_records.fit_all_rows`).

    Parameters
    ----------
    ladder
        The record and the options.
    data
        The record with its findings.
    result
        The comparison.
    record
        The record of the search.

    Returns
    -------
    Comparison
        With the final fit, the findings of the record, and the disturbance in its reason.
    """
    best = result.best
    initial = best.problem.initial
    model = best.problem.model
    is_part = record.data is not ladder.data
    fits = dict(result.fits)
    if ladder.setting.is_averaged and not best.noise.averaged:
        # unseen data have preferred white noise
        ladder = ladder.with_white_noise()
    if is_part:
        final = fit_all_rows(ladder, best, record)
    else:
        final = final_fit(ladder, best)
        for name in likely_models(result.table, fits):
            if fits[name] is not best:
                fits[name] = averaged_fit(ladder, fits[name])
    numbers = dict(result.reason.numbers)
    if is_part:
        n_measured = record.data.n_samples - record.data.n_missing
        share = n_measured * record.block / max(data.n_samples - data.n_missing, 1)
        numbers |= {"block": record.block, "share": min(share, 1.0)}
    # the conclusion is about the final fit
    table = result.table.copy()
    is_recommended = table["model"] == result.recommended
    for column, value in _conclusion_columns(final).items():
        table.loc[is_recommended, column] = value
    result = replace(result, table=table)
    if "initial" not in ladder.options:
        has_free_state = initial == "level" and model.integrators > 0
        numbers["initial"] = "estimated" if has_free_state else initial
    noise = final.noise
    if noise.averaged:
        is_finite = noise.time_constant < len(final.residual)
        numbers["order"] = list(noise.order)
        numbers["memory_s"] = noise.time_constant * data.dt_s if is_finite else None
        statistics = final.identified.statistics
        numbers |= {name: statistics[name] for name in ("p_walk", "wave") if name in statistics}
    elif not noise.white or final.problem.trend:
        numbers["order"] = list(noise.order)
        numbers["baseline"] = baseline_of(final)
    final = add_findings(final, tuple(check_holds(ladder, final)))
    fits[result.recommended] = final
    fits = {name: add_findings(f, data.findings) for name, f in fits.items()}
    reason = replace(result.reason, numbers=numbers)
    return replace(result, fits=fits, reason=reason)


def final_fit(ladder: Ladder, best: Fit) -> Fit:
    """Fit the recommended model with the average over noise and its intervals.

    Parameters
    ----------
    ladder
        The record and the options.
    best
        The fit of the model under the common setting, with quadratic intervals.

    Returns
    -------
    Fit
        The final fit; ``best`` for a model without free parameters, or with noise of its own poles.
    """
    model = best.problem.model
    if model.arx or not model.free:
        return best
    options = {**ladder.options, "initial": best.problem.initial, "check": False}
    try:
        return fit(ladder.data, model, **options, start=best.identified.theta)
    except InputError:
        return best


def averaged_fit(ladder: Ladder, likely: Fit) -> Fit:
    """Return the fit of a likely model averaged over noise, or as it is where that is given."""
    target = replace(ladder.setting, initial=likely.problem.initial)
    if not target.is_averaged:
        return likely
    start = [likely.identified.theta]
    return ladder.fit_model(likely.problem.model, target, start) or likely


def baseline_of(result: Fit) -> Baseline:
    """Baseline of a fit that is not averaged over noise."""
    if result.noise.is_random_walk:
        return "walk"
    return "trend" if result.problem.trend else "none"


@with_named_arguments
def joint_table(comparisons: Mapping[str, Comparison]) -> pd.DataFrame:
    """Return the recommended models of several outputs: a row for each output and input.

    Parameters
    ----------
    comparisons
        Comparison of each output.

    Returns
    -------
    DataFrame
        Model, gain, lag, scores and severity of the conclusion, as texts.

    Examples
    --------
    >>> from tcdyn.identification import simulate
    >>> u = np.repeat([20.0, 80.0, 20.0], 60)
    >>> truth = process("P1").rational({"Kp": 1.0, "Tp1": 0.75})
    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.2, len(u))
    >>> data = IOData.from_arrays(u, y, 0.05, hold="zoh")

    >>> joint_table({"y": compare(data, "P1")})["model"].tolist()
    ['P1']
    """
    rows = []
    for output, comparison in comparisons.items():
        best = comparison.best.identified
        for name, model in best.by_input.items():
            has_lag = model.gain and not best.model.integrators
            rows.append(
                {
                    "output": output,
                    "input": name,
                    "model": model.model.name,
                    "gain": f"{model.gain:.4g}",
                    "lag": model.lag_s.text("s") if has_lag else "",
                    "fit [%]": f"{comparison.best_row['fit_percent']:.2f}",
                    "held out [%]": f"{comparison.best_row['held_out_percent']:.2f}",
                    "grade": comparison.conclusion.severity.name.lower(),
                }
            )
    return pd.DataFrame(rows)
