"""Identification from a table: the record of each output, the comparison of models, the file.

The command ``tcdyn identify`` calls it. The models and fits are :mod:`tcdyn.identification`. Tests:
``tests/identify/test_identify_results.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tcdyn.chain import NO_CONDITIONING
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, Severity
from tcdyn.core.options import options_of
from tcdyn.identification import (
    Comparison,
    IOData,
    KnownDynamics,
    Model,
    compare,
    from_csv,
    several,
)
from tcdyn.identification.models import as_model
from tcdyn.identification.options import IdentifyOptions
from tcdyn.identification.plant import KnownSensor
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.file import SensorFile
from tcdyn.sensors.given import UNNAMED, sensor_files
from tcdyn.series.units import is_match

# Infos about how the table was read, which are no part of a result.
ABOUT_READING = ("time.taken", "series.averages")
Progress = Callable[[str, int, int], None]  # (model, number done, number in all)


@dataclass(frozen=True)
class IdentifiedOutput:
    """What was identified for one output.

    Attributes
    ----------
    record
        The input-output data.
    comparison
        The compared models, and the recommended one.
    known_filter
        The known filter behind the sensor.
    level_dependence
        Sentence about the dependence of the lag on the level; empty if it was not tested.
    narx
        Result of that test; empty if it was not made.
    """

    record: IOData
    comparison: Comparison
    known_filter: Conditioning
    level_dependence: str
    narx: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Content of an identified file, without its source.

        A conclusion that is a warning or an error is one of the findings of the file, so that a
        later use of the model knows it.
        """
        identified = self.comparison.best.identified
        conclusion = self.comparison.conclusion
        if conclusion.severity is not Severity.INFO:
            identified = replace(identified, findings=(*identified.findings, conclusion))
        content = identified.to_dict()
        content["averaged"] = self.comparison.averaged
        content["reading"] = [each.to_dict() for each in self.record.reading]
        if self.narx:
            content["narx"] = self.narx
        return content

    @property
    def findings(self) -> list[Finding]:
        """Findings of the recommended model, after infos about how the table was read."""
        of_best = self.comparison.best.findings
        of_reading = [
            finding
            for finding in self.record.findings
            if finding.code in ABOUT_READING and finding not in of_best
        ]
        return [*of_reading, *of_best]


def identify(
    data: str | Path | Sequence[str | Path],
    input: str | Sequence[str],
    output: str | Sequence[str],
    *,
    progress: Callable[[int], AbstractContextManager[Progress]] | None = None,
    done: Callable[[str, IdentifiedOutput], None] | None = None,
    **options: Any,
) -> dict[str, IdentifiedOutput]:
    """Identify the dynamics between columns of a table.

    Parameters
    ----------
    data
        Table with one row for each sample: CSV, LVM, TDMS, Parquet, .xlsx or .mat; or several
        files, each of which is a run.
    input
        Column of the input, or several; names may lack their unit.
    output
        Column of the output, or several; each gets a model.
    progress
        Function of the number of models (0 if it is not known) that makes a context with a function
        to call for each model.
    done
        Called with each output and its result, as soon as it is there.
    options
        Fields of :class:`tcdyn.identification.options.IdentifyOptions`.

    Returns
    -------
    dict
        Result by output.

    Raises
    ------
    InputError
        For options that contradict each other, columns that are missing, and data from which no
        model can be identified.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> path = Path(tempfile.mkdtemp()) / "step.csv"
    >>> t = 0.5 * np.arange(240)
    >>> u = np.where(t > 20, 80.0, 20.0)
    >>> y = 20 + 60 * np.where(t > 20, 1 - np.exp(-(t - 20) / 5), 0.0)
    >>> y += np.random.default_rng(0).normal(0.0, 0.2, len(t))
    >>> rows = np.column_stack([t, u, y])
    >>> np.savetxt(path, rows, delimiter=",", header="time_s,u_degC,y_degC", comments="")
    >>> found = identify(path, "u", "y", model="P1")
    >>> [*found], found["y"].comparison.recommended
    (['y'], 'P1')
    """
    settings = options_of(IdentifyOptions, options, "identify")
    inputs = _columns("input", input)
    outputs = _columns("output", output)
    _check_options_of_one_input(settings, inputs)
    known_filter = settings.conditioning
    record = _read_record(data, inputs, outputs, settings)
    names = list(record.input_names)  # with the units that the file states
    sensors = None if settings.sensor is None else sensor_files(_given_sensor(settings.sensor))
    known = known_filter if sensors is None else NO_CONDITIONING
    models = [_model(name, names, settings, known) for name in settings.models]
    fit_settings = settings.fit_settings
    fit_settings["like"] = _model("P1", names[:1], settings, known)
    results = {}
    for column in outputs:
        if sensors is not None:
            fit_settings["sensor"] = _sensor_of(sensors, column, known_filter)
        one = record.select(output=column)
        with progress(len(models)) if progress else nullcontext(_no_progress) as report:
            comparison = compare(
                one, models, held_out=settings.held_out, progress=report, **fit_settings
            )
        sentence, narx = _level_dependence(one, settings)
        results[column] = IdentifiedOutput(one, comparison, known_filter, sentence, narx)
        if done is not None:
            done(column, results[column])
    return results


def _given_sensor(given: Any) -> Any:
    """The sensor that a caller gave; the command gives a lag such as 25+-1 as a path."""
    return str(given) if isinstance(given, Path) else given


def _sensor_of(files: Sequence[SensorFile], column: str, known_filter: Conditioning) -> KnownSensor:
    """The sensor of an output, with the filter behind it.

    Parameters
    ----------
    files
        Sensors.
    column
        Column of the output.
    known_filter
        The filter of the options.

    Raises
    ------
    InputError
        For a column that no sensor covers, and for a filter beside that of the sensor file.
    """
    found = [
        (file, name)
        for file in files
        for name in file.columns
        if name == UNNAMED or is_match(name, column)
    ]
    if not found:
        listed = ", ".join(name for file in files for name in file.columns)
        raise InputError(
            f"{{sensor}} has no sensor for {column}",
            expected=f"one of its columns: {listed}",
            parameters={"sensor": None},
        )
    file, name = found[0]
    if file.law is not None:
        raise InputError(
            "{sensor} has a lag that follows another column",
            expected="one lag",
            remedy="give the lag at the conditions of the record, such as 25+-1",
            parameters={"sensor": None},
        )
    k = file.columns.index(name)
    chain = file.chains[k]
    if known_filter.poles:
        if chain.conditioning.poles:
            raise InputError(
                f"{{cutoff_Hz}} is given, and {{sensor}} has a filter of "
                f"{chain.conditioning.cutoff_Hz:g} Hz",
                remedy="leave one of them out",
                parameters={"cutoff_Hz": None, "sensor": None},
            )
        chain = replace(chain, conditioning=known_filter)
    lag_u_s = file.chain.channels[name].lag_s.u
    return KnownSensor(chain, lag_u_s, file.chain.channels[name].split_u_s)


def _check_options_of_one_input(settings: IdentifyOptions, inputs: Sequence[str]) -> None:
    """Check the options that only a model of one input has, before the work.

    Parameters
    ----------
    settings
        The options.
    inputs
        Columns of the inputs.

    Raises
    ------
    InputError
        For one of them with several inputs, and if the package for ``narx`` is not installed.
    """
    if len(inputs) > 1 and (settings.narx or settings.gain is not None):
        name = "narx" if settings.narx else "gain"
        raise InputError(
            f"{{{name}}} with {len(inputs)} inputs",
            expected="one input",
            remedy="leave it out",
            parameters={name: None},
        )
    if settings.narx:
        from tcdyn.identification.narx import frols_with_polynomials

        frols_with_polynomials()


def _read_record(
    data: str | Path | Sequence[str | Path],
    inputs: Sequence[str],
    outputs: Sequence[str],
    settings: IdentifyOptions,
) -> IOData:
    """The record of all inputs and outputs of a table.

    Parameters
    ----------
    data
        The table, or several files, each of which is a run.
    inputs, outputs
        Columns of the inputs and the outputs.
    settings
        How the rows are read.
    """
    return from_csv(
        data,
        input=inputs,
        output=outputs,
        run=settings.run,
        resample_s=settings.resample_s,
        hold=settings.holds,
        **asdict(settings.rows),
    )


def _no_progress(name: str, number: int, count: int) -> None:
    """Report nothing."""


def _level_dependence(record: IOData, settings: IdentifyOptions) -> tuple[str, dict[str, Any]]:
    """Sentence and result of the test whether the lag depends on the level; empty without it."""
    if not settings.narx:
        return "", {}
    from tcdyn.identification.narx import temperature_dependence

    dependence = temperature_dependence(record, held_out=settings.held_out)
    return dependence.sentence, dependence.to_dict()


def _columns(role: str, names: str | Sequence[str]) -> list[str]:
    """The names of columns, checked.

    Parameters
    ----------
    role
        Name of the parameter, for the message.
    names
        What the user wrote.

    Raises
    ------
    InputError
        An empty or a repeated name.
    """
    listed = [names] if isinstance(names, str) else list(names)
    if not listed or not all(listed) or len(set(listed)) < len(listed):
        raise InputError(
            f"{{{role}}} is {' and '.join(map(str, listed)) or 'empty'}",
            expected="different columns",
            parameters={role: None},
        )
    return listed


def _model(
    name: str, inputs: Sequence[str], settings: IdentifyOptions, known_filter: Conditioning
) -> Model:
    """The named model with the constraints of the options.

    With several inputs, one model for all, or models separated by plus signs, one for each input.

    Parameters
    ----------
    name
        Name of a model, or several joined by plus signs.
    inputs
        Columns of the inputs.
    settings
        The options.
    known_filter
        The known filter behind the sensor.
    """
    parts = [part.strip() for part in name.split("+")]
    offset = "none" if settings.no_offset else "free"
    if len(inputs) > 1:
        each = parts if len(parts) > 1 else parts * len(inputs)
        return several(each, inputs, offset=offset, known=known_filter)
    if len(parts) > 1:
        raise InputError(
            f"{{model}} {name} names {len(parts)} parts",
            expected="one model for one input",
            parameters={"model": None},
        )
    model = as_model(name)
    fixed = dict(model.fixed)
    if settings.gain is not None and "Kp" in model.names:
        fixed["Kp"] = settings.gain
    return replace(model, fixed=fixed, offset=offset, known=KnownDynamics.of(known_filter))
