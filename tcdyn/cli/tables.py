"""Options for tables without a rig, and the compensation of a table by ``compensate --sensor``.

Used by the commands ``compensate``, ``follow`` and ``sensor``. The compensation itself is
:mod:`tcdyn.workflows.compensate_table`. Tests: ``tests/sensors/test_sensor_file.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import Reporter, stage_progress
from tcdyn.core.errors import InputError
from tcdyn.series.options import ReadingOptions

if TYPE_CHECKING:
    from tcdyn.workflows.raw_log import Calibrations

SensorFiles = Annotated[
    list[Path] | None,
    typer.Option(
        help="*.sensor.json, or the JSON of identify, for any table; repeat for each sensor",
    ),
]
TableColumns = Annotated[
    list[str] | None,
    typer.Option(help="with --sensor: column of the sensor, instead of the one in its file"),
]
CsvDialect = Annotated[
    str,
    typer.Option(
        help="of CSV: standard (UTF-8, commas, decimal points) or input (separator, decimal mark, "
        "encoding and line ends of the log)",
    ),
]
CsvComments = Annotated[
    bool,
    typer.Option(
        help="of CSV: metadata as lines '# key: value' above the header, instead of in "
        "OUT.meta.json",
    ),
]


@dataclass(frozen=True)
class TableReading(ReadingOptions):
    """How the rows of a table are read, and the units of its columns.

    Attributes
    ----------
    unit
        of a table: degC, K, degF, mV, or another quantity's such as ppm, %RH, Pa or V, if the names
        do not state it; T1=K for one column
    couple
        with mV: thermocouple type E, J, K, N or T (ITS-90), or none for another voltage
    cold_junction
        with mV: temperature of the reference junction in degC, or its column
    """

    unit: list[str] | None = None
    couple: str | None = None
    cold_junction: str = "0"

    @property
    def rows(self) -> ReadingOptions:
        """How the rows are read, without the units.

        >>> TableReading("t", unit=["K"]).rows == ReadingOptions("t")
        True
        """
        return ReadingOptions(
            **{each.name: getattr(self, each.name) for each in fields(ReadingOptions)}
        )

    def options(self) -> dict[str, Any]:
        """Keyword arguments of ``compensate_table``.

        >>> options = TableReading("t", "ms", unit=["K"]).options()
        >>> options["time"], options["time_unit"], options["unit"], options["cold"]
        ('t', 'ms', 'K', 0.0)
        >>> TableReading(unit=["T1=mV"], cold_junction="cj").options()["cold"]
        'cj'
        """
        parts = [text.rpartition("=") for text in self.unit or []]
        unit_of_column = {name: unit for name, _, unit in parts if name}
        units_of_all = [unit for name, _, unit in parts if not name]
        unit: str | dict[str, str] = unit_of_column
        if units_of_all:
            if len(parts) > 1:
                raise InputError(
                    "--unit is given more than once",
                    expected="one for all columns, or T1=K for each",
                )
            unit = units_of_all[0]
        try:
            cold: float | str = float(self.cold_junction)
        except ValueError:
            cold = self.cold_junction
        return {**asdict(self.rows), "unit": unit, "couple": self.couple or "", "cold": cold}


def value_and_u(text: str, option: str, limit: float = 1e9) -> tuple[float, float]:
    """A number and its standard uncertainty from text such as "1.5+-0.1".

    Parameters
    ----------
    text
        "1.5+-0.1", "1.5 ± 0.1" or "1.5".
    option
        Name of the option, for the message.
    limit
        Largest absolute value.

    Returns
    -------
    value, u
        u is zero where none is given.

    Raises
    ------
    InputError
        Another text, or numbers out of range.

    Examples
    --------
    >>> value_and_u("1.5+-0.1", "--tau-s"), value_and_u("2", "--tau-s")
    ((1.5, 0.1), (2.0, 0.0))
    """
    value_text, _, u_text = text.replace("±", "+-").replace("+/-", "+-").partition("+-")
    try:
        value = float(value_text)
        u = float(u_text) if u_text.strip() else 0.0
    except ValueError:
        raise InputError(
            f"{option} is {text!r:.60}",
            expected="a number, or a number with its uncertainty: 1.5+-0.1",
        ) from None
    if not (abs(value) <= limit and 0 <= u <= limit):
        raise InputError(
            f"{option} is {text!r:.60}",
            expected=f"a number within {limit:g}, its uncertainty not negative",
        )
    return value, u


def only_with_records(options: Mapping[str, object]) -> None:
    """Raise InputError if one of ``options``, which need disk records, has a value."""
    for option, value in options.items():
        if value:
            raise InputError(
                f"{option} with --sensor",
                remedy="leave one of them out: the first needs records of disks, --sensor is for "
                "any table",
            )


def compensate_any_table(
    log: Path,
    calibrations: Calibrations,
    out: Path,
    options: dict[str, Any],
    reporter: Reporter,
    verbose: bool,
) -> None:
    """Compensate a table and report the result.

    Parameters
    ----------
    log
        The table.
    calibrations
        Sensors, or with a delay records by disk.
    out
        File to write, which the caller has checked.
    options
        Keyword arguments of ``compensate_table``.
    reporter
        Output of the command.
    verbose
        Print a line for each stage.
    """
    from tcdyn.core.findings import unique_by_subject
    from tcdyn.workflows.compensate_table import compensate_table

    with stage_progress(reporter.is_silent, verbose) as progress:
        done = compensate_table(log, calibrations, out, progress=progress, **options)
    given = calibrations.values() if isinstance(calibrations, Mapping) else calibrations
    from_files = [finding for calibration in given for finding in calibration.findings]
    findings = unique_by_subject([*from_files, *done.findings])
    reporter.json(done.to_dict)
    reporter.summary(done.summary())
    reporter.finish(log.name, findings)
