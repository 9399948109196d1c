"""Treat many files one by one, shared among worker processes or the workers of Dask.

:func:`each_file` runs any function of one file; a file that fails does not stop the others.
:func:`compensate_each` and :func:`sensor_each` are used by ``tcdyn compensate --each`` and ``tcdyn
sensor --each``. Memory does not grow with the number of files but for one row of each. Tests:
``tests/cli/test_each.py``.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from tcdyn.core.errors import InputError, Spelling, as_argument, utf8
from tcdyn.core.findings import Finding, Severity
from tcdyn.core.options import options_of
from tcdyn.core.parallel import parallel_map
from tcdyn.core.result import Result, json_text, jsonable
from tcdyn.estimation.kalman import compile_functions
from tcdyn.io.checksum import CHECKSUM_KEY
from tcdyn.io.endings import CSV, check_ending
from tcdyn.io.metadata import RESULTS, metadata_path
from tcdyn.io.read import sha256_of_file
from tcdyn.io.write import (
    check_may_replace,
    file_identity,
    write_log,
    write_text,
)
from tcdyn.sensors import measure
from tcdyn.sensors.file import SensorFile
from tcdyn.version import __version__
from tcdyn.workflows.compensate_table import CompensatedTable, compensate_table
from tcdyn.workflows.options import CompensateOptions

COMPENSATED_ENDING = ".compensated.csv"  # behind the stem of a log
SENSOR_ENDING = ".sensor.json"
MAX_MESSAGES = 5  # of a file that are kept: memory. The output of a file has all of them.
SETTINGS_KEY = "settings_sha256"  # entry of an output with the checksum of what it was made with
RESULT_KEY = "result"  # entry of an output with its row in the table of results

FileProgress = Callable[[str, int, int], None]  # (file, files done, files in all)


@dataclass(frozen=True)
class FileResult:
    """What a function of one file returns.

    Attributes
    ----------
    numbers
        Numbers and texts of the row of the file, by name with unit.
    findings
        Findings about the file. One that is an error means that the file failed.
    from_earlier_run
        Whether the output of an earlier run was kept.
    """

    numbers: Mapping[str, Any]
    findings: Sequence[Finding] = ()
    from_earlier_run: bool = False


@dataclass(frozen=True)
class FileOutcome:
    """Result of one file, or the message of its failure.

    Attributes
    ----------
    file
        The file.
    numbers
        As in ``FileResult``; empty after a failure.
    n_warnings, messages
        Number of warnings, and the first of them.
    error
        Message of the failure; empty without one.
    seconds
        Time that it took [s].
    from_earlier_run
        Whether the output of an earlier run was kept.
    """

    file: Path
    numbers: Mapping[str, Any]
    n_warnings: int = 0
    messages: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0
    from_earlier_run: bool = False


@dataclass(frozen=True, repr=False)
class EachRun(Result):
    """Outcomes of all files, in their order.

    Attributes
    ----------
    outcomes
        One for each file.
    """

    outcomes: tuple[FileOutcome, ...] = field(repr=False)

    @property
    def failed(self) -> tuple[FileOutcome, ...]:
        """The files that failed."""
        return tuple(each for each in self.outcomes if each.error)

    @property
    def exit_code(self) -> int:
        """0, or 1 if a file failed."""
        return 1 if self.failed else 0

    @property
    def table(self) -> pd.DataFrame:
        """One row a file: its numbers, number of warnings, seconds, and the error if it failed."""
        names = dict.fromkeys(name for each in self.outcomes for name in each.numbers)
        rows = [
            {
                "file": utf8(each.file.name),
                **{name: each.numbers.get(name) for name in names},
                "warnings": each.n_warnings,
                "seconds": round(each.seconds, 3),
                "error": each.error,
            }
            for each in self.outcomes
        ]
        return pd.DataFrame(rows, columns=["file", *names, "warnings", "seconds", "error"])

    def summary(self) -> str:
        """Numbers of files done and failed, the table, and the errors."""
        kept = sum(each.from_earlier_run for each in self.outcomes)
        done = len(self.outcomes) - len(self.failed)
        text = f"{len(self.outcomes)} files: {done} done"
        text += f" ({kept} kept from before)" if kept else ""
        text += f", {len(self.failed)} failed"
        table = self.table.drop(columns=["seconds", "error"])
        of_done = table[[not each.error for each in self.outcomes]]
        lines = [text]
        if len(of_done):
            lines.append(of_done.to_string(index=False, float_format="{:.4g}".format, na_rep="-"))
        # the message of a file begins with its name
        lines += [f"error: {each.error}" for each in self.failed]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The table, with the first warnings of each file."""
        rows = jsonable(self.table.to_dict("records"))
        for row, each in zip(rows, self.outcomes):
            row["messages"] = list(each.messages)
            row["kept"] = each.from_earlier_run
        return {"files": len(self.outcomes), "failed": len(self.failed), "results": rows}

    def to_frame(self) -> pd.DataFrame:
        """The table by file."""
        return self.table.set_index("file")

    def write(self, path: str | Path) -> Path:
        """Write the table as CSV; its metadata say that it holds results and is no log."""
        target = Path(path)
        check_ending(target, CSV)
        return write_log(self.table, target, {"tcdyn": RESULTS})


def each_file(
    function: Callable[[Path], FileResult],
    files: Sequence[str | Path],
    *,
    workers: int = 1,
    dask: str | None = None,
    spelling: Spelling = as_argument,
    progress: FileProgress = lambda *_: None,
) -> EachRun:
    """Call a function for each file; one that fails does not stop the others.

    Parameters
    ----------
    function
        Function of the path of one file. With worker processes or Dask, cloudpickle must be able to
        pickle it.
    files
        The files.
    workers
        Number of worker processes; 1: this process.
    dask
        Address of a scheduler of Dask; its workers must have the files under the same paths.
    spelling
        How messages write a parameter.
    progress
        Called with the name of a file, the number of files done, and the number of all.

    Returns
    -------
    EachRun
        Outcomes in the order of ``files``.

    Raises
    ------
    InputError
        Without files, and as ``tcdyn.core.parallel.parallel_map`` does.

    Examples
    --------
    >>> def size(path):
    ...     return FileResult({"bytes": path.stat().st_size})
    >>> run = each_file(size, [__file__, "missing.csv"])
    >>> len(run.failed), run.exit_code, list(run.table.columns)
    (1, 1, ['file', 'bytes', 'warnings', 'seconds', 'error'])
    """
    paths = [Path(path) for path in files]
    if not paths:
        raise InputError("no files", expected="at least one")
    outcomes: dict[int, FileOutcome] = {}
    work = partial(_outcome, function, spelling)
    jobs = [path.absolute() for path in paths]
    for index, answer in parallel_map(work, jobs, workers, dask):
        if isinstance(answer, Exception):  # of a worker of Dask
            error = f"{paths[index].name}: the worker failed, {type(answer).__name__}: {answer}"
            answer = FileOutcome(paths[index], {}, error=utf8(error))
        outcomes[index] = replace(answer, file=paths[index])
        progress(paths[index].name, len(outcomes), len(paths))
    return EachRun(tuple(outcomes[index] for index in range(len(paths))))


def _outcome(function: Callable[[Path], FileResult], spelling: Spelling, path: Path) -> FileOutcome:
    """The outcome of one file; a failure is a message."""
    start_s = time.perf_counter()
    error = ""
    result = FileResult({})
    try:
        result = function(path)
    except InputError as problem:
        error = utf8(problem.message(spelling))
        if path.name not in error:
            error = f"{utf8(path.name)}: {error}"
    except Exception as problem:  # a fault in one file must not stop the others
        error = utf8(f"{path.name}: failed with {type(problem).__name__}: {problem}")
    errors = [each for each in result.findings if each.severity is Severity.ERROR]
    if errors:
        error = f"{utf8(path.name)}: {errors[0].message(spelling)}"
    warnings = [each for each in result.findings if each.severity is Severity.WARNING]
    return FileOutcome(
        path,
        {} if error else result.numbers,
        len(warnings),
        tuple(each.message(spelling) for each in warnings[:MAX_MESSAGES]),
        " ".join(error.split()),
        time.perf_counter() - start_s,
        result.from_earlier_run,
    )


def outputs_of(
    files: Sequence[str | Path], ending: str, out: str | Path | None = None
) -> list[Path]:
    """The output of each file: its stem with an ending, beside it or in a folder.

    Parameters
    ----------
    files
        The files.
    ending
        What follows the stem.
    out
        The folder; None: that of each file.

    Raises
    ------
    InputError
        For two files with the same output, and an output that is one of the files.

    Examples
    --------
    >>> [path.name for path in outputs_of(["day1.csv", "day2.lvm"], ".compensated.csv")]
    ['day1.compensated.csv', 'day2.compensated.csv']
    """
    paths = [Path(file) for file in files]
    outputs = [(path.parent if out is None else Path(out)) / (path.stem + ending) for path in paths]
    source_of: dict[str, Path] = {}
    inputs = {file_identity(path): path for path in paths}
    for path, output in zip(paths, outputs):
        # names that differ in upper and lower case only are one file on Windows and macOS
        first = source_of.setdefault(str(output.absolute()).casefold(), path)
        if first is not path:
            raise InputError(
                f"{first} and {path} would both be written to {output}",
                expected="files whose names differ before the ending",
                remedy="rename one of them",
            )
        if output.exists() and file_identity(output) in inputs:
            raise InputError(
                "is the output of one of the files, and one of them",
                where=str(output),
                remedy="leave it out",
            )
    return outputs


def _folder(out: str | Path | None) -> Path | None:
    """The folder of outputs, which is made where it is missing; None: there is none.

    Raises
    ------
    InputError
        For a file of that name.
    """
    if out is None:
        return None
    folder = Path(out).absolute()
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file", where=str(out), expected="a folder for the outputs")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def compensate_each(
    files: Sequence[str | Path],
    sensors: Sequence[SensorFile],
    out: str | Path | None = None,
    *,
    overwrite: bool = False,
    workers: int = 1,
    dask: str | None = None,
    spelling: Spelling = as_argument,
    progress: FileProgress = lambda *_: None,
    **options: Any,
) -> EachRun:
    """Compensate each of many tables on its own.

    Parameters
    ----------
    files
        The tables.
    sensors
        Sensor files; each column belongs to one.
    out
        Folder of the outputs ``<stem>.compensated.csv``; None: beside each file.
    overwrite
        Whether an output may replace a file that was not made from the same table.
    workers, dask, spelling, progress
        As for :func:`each_file`.
    **options
        How the tables are read, compensated and written: the fields of
        :class:`tcdyn.workflows.options.CompensateOptions`.

    Returns
    -------
    EachRun
        Of each file the rows, columns compensated, and of the columns the largest noise, typical
        and largest standard deviation.

    Raises
    ------
    InputError
        For two files with the same output. What is wrong with one file is in its outcome.

    Notes
    -----
    An output that states the checksum of its table, and that it was made with the same sensors,
    options and version, is kept: a run that was stopped goes on where it was. With ``comments``
    all are written again.
    """
    outputs_of(files, COMPENSATED_ENDING, out)  # two files with one output are an error
    folder = _folder(out)
    stated = options_of(CompensateOptions, options, "compensate_each").stated
    settings = {
        "version": __version__,
        "sensors": [_without_creation(sensor) for sensor in sensors],
        **stated,
    }
    fingerprint = hashlib.sha256(json_text(settings).encode()).hexdigest()
    work = partial(
        _compensate_one,
        sensors=list(sensors),
        folder=folder,
        fingerprint=fingerprint,
        overwrite=overwrite,
        options=stated,
    )
    if workers > 1:
        compile_functions()
    return each_file(work, files, workers=workers, dask=dask, spelling=spelling, progress=progress)


def _without_creation(sensor: SensorFile) -> dict[str, Any]:
    """Content of a sensor file without the time of its creation, which changes no result."""
    of_creation = ("created", CHECKSUM_KEY)
    return {key: value for key, value in sensor.to_dict().items() if key not in of_creation}


def _compensate_one(
    path: Path,
    sensors: Sequence[SensorFile],
    folder: Path | None,
    fingerprint: str,
    overwrite: bool,
    options: Mapping[str, Any],
) -> FileResult:
    """Compensate one table, or keep the output of an earlier run.

    Parameters
    ----------
    path
        The table.
    sensors
        The sensors.
    folder
        Folder of the output; None: that of the table.
    fingerprint
        Checksum of all that the output depends on but the table.
    overwrite
        As for ``compensate_each``.
    options
        Keyword arguments of ``compensate_table``.
    """
    output = outputs_of([path], COMPENSATED_ENDING, folder)[0]
    stored = _stored_result(output, path, fingerprint)
    if stored is not None:
        return stored
    check_may_replace(output, [path], overwrite)
    done = compensate_table(path, sensors, output, **options)
    numbers = _numbers_of(done)
    warnings = [f.to_dict() for f in done.findings if f.severity is not Severity.INFO]
    metadata = metadata_path(output)
    if metadata.exists():
        content = json.loads(metadata.read_text(encoding="utf-8"))
        row = json.dumps({"numbers": jsonable(numbers), "findings": warnings}, ensure_ascii=False)
        content["metadata"] |= {SETTINGS_KEY: fingerprint, RESULT_KEY: row}
        write_text(metadata, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    return FileResult(numbers, done.findings)


def _numbers_of(done: CompensatedTable) -> dict[str, Any]:
    """Row of a compensated table; of several columns the largest numbers."""
    numbers: dict[str, Any] = {"rows": done.rows, "columns": len(done.columns)}
    if done.reading is not None:
        numbers["interval_s"] = float(f"{done.reading.interval_s:.6g}")
    for name in done.numbers.columns[1:4]:
        numbers[str(name)] = float(f"{done.numbers[name].max():.6g}")
    if done.means_s is not None:
        numbers["means_s"] = float(f"{done.means_s:.6g}")
    numbers["out"] = utf8(done.path.name)
    return numbers


def _stored_result(output: Path, path: Path, fingerprint: str) -> FileResult | None:
    """Result of an earlier run with the same table and settings; None without one."""
    try:
        content = json.loads(metadata_path(output).read_text(encoding="utf-8"))
        notes = content["metadata"]
        row = json.loads(notes[RESULT_KEY])
        is_same = notes[SETTINGS_KEY] == fingerprint
        if not is_same or not output.is_file():
            return None
        if notes["source_sha256"] != sha256_of_file(path):
            return None
        findings = [Finding.from_dict(each) for each in row["findings"]]
        return FileResult(dict(row["numbers"]), findings, from_earlier_run=True)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def sensor_each(
    files: Sequence[str | Path],
    method: Literal["plunge", "noise"],
    column: str | None = None,
    out: str | Path | None = None,
    *,
    overwrite: bool = False,
    workers: int = 1,
    dask: str | None = None,
    spelling: Spelling = as_argument,
    progress: FileProgress = lambda *_: None,
    **options: Any,
) -> EachRun:
    """Measure a lag from each of many tables on its own.

    Parameters
    ----------
    files
        The tables.
    method
        "plunge": each holds one dip (:func:`tcdyn.sensor_from_dip`); "noise": each was logged at
        constant conditions (:func:`tcdyn.sensor_from_noise`).
    column
        Column of the sensor; None: the only one.
    out
        Folder of the sensor files ``<stem>.sensor.json``; None: none are written.
    overwrite
        Whether a sensor file may replace one that was not made from the same table.
    workers, dask, spelling, progress
        As for :func:`each_file`.
    **options
        Keyword arguments of the function of the method.

    Returns
    -------
    EachRun
        Of each file the column, structure, lag, and times of the step response, with standard
        uncertainties.

    Raises
    ------
    InputError
        For an unknown method, and two files with the same output.
    """
    if method not in ("plunge", "noise"):
        raise InputError(f"method {method!r}", expected="plunge or noise")
    if out is not None:
        outputs_of(files, SENSOR_ENDING, out)  # two files with one output are an error
    folder = _folder(out)
    work = partial(
        _measure_one,
        method=method,
        column=column,
        folder=folder,
        overwrite=overwrite,
        options=options,
    )
    return each_file(work, files, workers=workers, dask=dask, spelling=spelling, progress=progress)


def _measure_one(
    path: Path,
    method: str,
    column: str | None,
    folder: Path | None,
    overwrite: bool,
    options: Mapping[str, Any],
) -> FileResult:
    """Measure the lag from one table; parameters as for ``sensor_each``."""
    function: Any = measure.sensor_from_dip if method == "plunge" else measure.sensor_from_noise
    output = None
    if folder is not None:
        output = outputs_of([path], SENSOR_ENDING, folder)[0]
        check_may_replace(output, [path], overwrite)
    sensor: SensorFile = function(path, column, name=path.stem, **options)
    if output is not None:
        sensor.write(output)
    frame = sensor.to_frame()
    numbers: dict[str, Any] = {"column": sensor.columns[0], "structure": sensor.chain.structure}
    for name, value in frame.iloc[0].items():
        if isinstance(value, float) and not str(name).endswith(("low95", "high95")):
            numbers[str(name)] = float(f"{value:.6g}")
    return FileResult(numbers, sensor.findings)
