"""Command ``tcdyn sensor``: state or measure the lag of any thermocouple; writes a sensor file.

Each command is one method to determine a lag (:mod:`tcdyn.sensors`) and writes the same kind of
file. Tests: ``tests/sensors``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tcdyn.chain.known_filter import FilterOptions
from tcdyn.cli.common import (
    OptionalPicture,
    Reporter,
    check_folder,
    check_outputs,
    check_picture,
    options_from_docstring,
    save_picture,
)
from tcdyn.cli.tables import EachOptions, TableFiles, files_of_tables
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.options import Options, number_with_u, option
from tcdyn.io.endings import JSON
from tcdyn.sensors.options import (
    CurrentOptions,
    DipOptions,
    LawOptions,
    PairOptions,
    PredictOptions,
)
from tcdyn.series.options import TableOptions

if TYPE_CHECKING:
    from tcdyn.core.findings import Finding
    from tcdyn.sensors import SensorFile

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="State or measure the lag of a thermocouple, or of a sensor of another quantity; the file "
    "is for compensate and follow.",
)
OneColumn = Annotated[str, typer.Option(help="column of the sensor", rich_help_panel="Input")]
Columns = Annotated[
    list[str],
    typer.Option(help="column of the table; * matches any text", rich_help_panel="Input"),
]


@dataclass(frozen=True)
class SensorOutput(Options):
    """Options for the sensor file to write.

    Attributes
    ----------
    out
        *.sensor.json to write (default: the result is only printed)
    name
        name of the sensor (default: name of the file)
    """

    out: Path | None = option(None, "Output")
    name: str | None = option(None, "Output")

    @property
    def sensor_name(self) -> str:
        """Name of the sensor, by default that of its file."""
        from tcdyn.sensors.file import MAX_NAME

        file_name = "" if self.out is None else self.out.name
        file_name = file_name.removesuffix(".json").removesuffix(".sensor")
        return self.name or utf8(file_name)[:MAX_NAME] or "sensor"

    def check(self, reporter: Reporter, logs: Sequence[Path] = ()) -> None:
        """Check before any work that the file may be written.

        Parameters
        ----------
        reporter
            Output of the command.
        logs
            Tables that are read.

        Raises
        ------
        InputError
            If it may not: see ``check_outputs``. ``tests/cli/test_replaced_outputs.py`` guards it.
        """
        check_outputs(logs, reporter.overwrite, out=(self.out, JSON))

    def write(
        self, sensor: SensorFile, reporter: Reporter, findings: Sequence[Finding] = ()
    ) -> None:
        """Write the file if one is requested, and report its content.

        Parameters
        ----------
        sensor
            Content of the file.
        reporter
            Output of the command.
        findings
            Findings about the files that were read.

        Notes
        -----
        The file is read back, so that a file that cannot be read is an error of this command and
        not of a later one.
        """
        from tcdyn.sensors import read_sensor, write_sensor

        if self.out is not None:
            write_sensor(sensor, self.out)
            read_sensor(self.out)
        _report(sensor, reporter, self.out, findings)


@app.command()
@options_from_docstring
def new(
    column: Columns,
    tau_s: Annotated[list[str] | None, typer.Option(rich_help_panel="Sensor")] = None,
    t63_s: Annotated[str | None, typer.Option(rich_help_panel="Sensor")] = None,
    dead_time_s: Annotated[str, typer.Option(rich_help_panel="Sensor")] = "0",
    bare: Annotated[bool, typer.Option("--bare", rich_help_panel="Sensor")] = False,
    *,
    output: SensorOutput,
    known_filter: FilterOptions,
    of_law: LawOptions,
    reporter: Reporter,
) -> None:
    """Write a sensor file from a known lag, for example from a data sheet.

    One number does not say how the lag is divided: part of it may be a dead time or a second lag.
    The uncertainties of temperatures include what that would change, but not with --bare.

    Example: tcdyn sensor new --tau-s 1.5+-0.1 --column T1 --out probe.sensor.json

    Parameters
    ----------
    tau_s
        a lag in seconds with its standard uncertainty: 1.5+-0.1; repeat for several lags, whose
        division then is known
    t63_s
        instead of a lag, the time in which the reading passes 63.2 % of a step: 1.5+-0.1
    dead_time_s
        dead time in seconds with its standard uncertainty: 0.2+-0.05
    bare
        the sensor is a bare wire: one lag and no dead time
    """
    from tcdyn.sensors import specified_sensor

    output.check(reporter)
    law = of_law.law
    sensor = specified_sensor(
        output.sensor_name,
        column,
        [number_with_u(text, "tau_s") for text in tau_s or of_law.lags_of_table],
        known_filter.conditioning,
        number_with_u(dead_time_s, "dead_time_s"),
        t63_s=None if t63_s is None else number_with_u(t63_s, "t63_s"),
        is_bare=bare,
        law=law,
    )
    output.write(sensor, reporter)


@app.command()
@options_from_docstring
def predict(
    diameter_mm: Annotated[float, typer.Option(rich_help_panel="Sensor")],
    medium: Annotated[str, typer.Option(rich_help_panel="Sensor")],
    column: Annotated[list[str] | None, typer.Option(rich_help_panel="Input")] = None,
    *,
    options: PredictOptions,
    output: SensorOutput,
    reporter: Reporter,
) -> None:
    """Predict lag, t50, t63.2 and t90 of a sheathed thermocouple before it is bought.

    The result follows from conduction in the sensor and heat transfer at its surface. Its
    uncertainty, 15 to 40 %, includes what a catalogue does not state of the construction.

    Example: tcdyn sensor predict --diameter-mm 3 --junction insulated --medium water --speed-m-s
    0.4 --out probe.sensor.json

    Parameters
    ----------
    diameter_mm
        diameter of the sheath
    medium
        water, air, oil, or a table of properties (.csv with T_degC, rho_kg_m3, c_J_kgK, k_W_mK,
        nu_m2_s)
    column
        column of a table to which the file applies; * matches any text (default: all)
    """
    from tcdyn.sensors import predict_sensor

    output.check(reporter)
    sensor = predict_sensor(
        diameter_mm,
        medium,
        name=output.sensor_name,
        columns=column or ["*"],
        **options.stated,
    )
    output.write(sensor, reporter)


@app.command()
@options_from_docstring
def show(
    file: Path,
    *,
    reporter: Reporter,
) -> None:
    """Print a sensor file: lag, times of the step response, how the lag was determined.

    Example: tcdyn sensor show probe.sensor.json

    Parameters
    ----------
    file
        *.sensor.json, or the JSON of tcdyn identify
    """
    from tcdyn.sensors import read_sensor

    sensor = read_sensor(file)
    _report(sensor, reporter)


@app.command()
@options_from_docstring
def plunge(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...")],
    column: OneColumn,
    *,
    options: DipOptions,
    output: SensorOutput,
    each: EachOptions,
    reporter: Reporter,
) -> None:
    """Measure the lag from one temperature step (a plunge): t50, t63.2, t90 and the chain.

    The instant of entry is estimated too. Several dips of one sensor, one table each, are combined:
    the uncertainty then includes the spread between dips.

    Example: tcdyn sensor plunge dip.csv --column T1 --out probe.sensor.json --medium water
    --diameter-mm 3

    Parameters
    ----------
    logs
        table with a column of time: CSV, LVM, TDMS, Parquet, .xlsx or .mat; one for each dip; a
        folder or a pattern is a list of files
    """
    from tcdyn.sensors import sensor_from_dip

    paths, left_out = files_of_tables(logs)
    if each.each:
        _measure_each(paths, "plunge", column, options, output, each, reporter)
        return
    output.check(reporter, paths)
    sensor = sensor_from_dip(paths, column, name=output.sensor_name, **options.stated)
    output.write(sensor, reporter, left_out)


@app.command()
@options_from_docstring
def pair(
    logs: TableFiles,
    column: Annotated[list[str], typer.Option(rich_help_panel="Input")],
    *,
    options: PairOptions,
    output: SensorOutput,
    reporter: Reporter,
) -> None:
    """Measure the lags of two thermocouples of different size in one fluid, without a reference.

    Noise on both is modelled. Both columns of a row are taken as sampled at one instant. If a
    column is repeated or blank between new values, only its new values are used.

    Example: tcdyn sensor pair exhaust.csv --column T1 --column T2 --speed flow_m_s --out
    pair.sensor.json

    Parameters
    ----------
    column
        one of the two columns; give it twice
    """
    from tcdyn.sensors import sensor_from_pair

    paths, left_out = files_of_tables(logs)
    output.check(reporter, paths)
    sensor = sensor_from_pair(paths, column, name=output.sensor_name, **options.stated)
    output.write(sensor, reporter, left_out)


@app.command()
@options_from_docstring
def current(
    logs: TableFiles,
    column: OneColumn,
    current: Annotated[str, typer.Option(rich_help_panel="Input")],
    *,
    options: CurrentOptions,
    output: SensorOutput,
    reporter: Reporter,
) -> None:
    """Measure the lag in place from a loop current step (LCSR): heating, cooling or both.

    The lag is converted to that of a plunge.

    Example: tcdyn sensor current lcsr.csv --column R1 --current I_mA --out pipe.sensor.json

    Parameters
    ----------
    current
        column of the heating current, in any unit
    """
    from tcdyn.sensors import sensor_from_current

    paths, left_out = files_of_tables(logs)
    output.check(reporter, paths)
    sensor = sensor_from_current(paths, column, current, name=output.sensor_name, **options.stated)
    output.write(sensor, reporter, left_out)


@app.command()
@options_from_docstring
def noise(
    logs: TableFiles,
    column: OneColumn,
    *,
    options: TableOptions,
    output: SensorOutput,
    each: EachOptions,
    reporter: Reporter,
) -> None:
    """Measure the lag in place from the noise of the process at constant conditions.

    Warnings report conditions that are not constant.

    Example: tcdyn sensor noise steady.csv --column T1 --out pipe.sensor.json
    """
    from tcdyn.sensors import sensor_from_noise

    paths, left_out = files_of_tables(logs)
    if each.each:
        _measure_each(paths, "noise", column, options, output, each, reporter)
        return
    output.check(reporter, paths)
    sensor = sensor_from_noise(paths, column, name=output.sensor_name, **options.stated)
    output.write(sensor, reporter, left_out)


@dataclass(frozen=True)
class TouchOptions(TableOptions):
    """How touches are found.

    Attributes
    ----------
    order
        column that was touched; repeat for each in the order of touching (default: not stated)
    touch_s
        duration of a touch in seconds
    """

    order: Sequence[str] = option((), "Sensor", takes=list[str])
    touch_s: float = option(2.0, "Sensor", low=0.01, high=600)


@app.command()
@options_from_docstring
def touch(
    logs: TableFiles,
    column: Columns,
    picture: OptionalPicture = None,
    *,
    options: TouchOptions,
    reporter: Reporter,
) -> None:
    """Report which column responds when the sensors are touched one after the other.

    Touch the place of each sensor for two seconds with a soldering iron or a warm finger, and wait
    ten seconds before the next. With --order, a warning reports each touch to which another column
    responded.

    Example: tcdyn sensor touch touch.csv --column "slow_*_degC" --order slow_a --order slow_b
    --picture t.png
    """
    from functools import partial

    import numpy as np

    from tcdyn.sensors.measure import check_temperatures, read_readings
    from tcdyn.sensors.touch import find_touches
    from tcdyn.series.units import match_columns

    paths, left_out = files_of_tables(logs)
    check_picture(picture, paths, reporter.overwrite)
    table = read_readings(paths, column, options=options, several=True)
    check_temperatures(table, "touches")
    stated = []
    for word in options.order:
        stated += match_columns(word, table.names, str(paths[0]))
    t = table.time_s
    names = table.names
    readings = np.column_stack(table.values)
    result = find_touches(t, readings, names, touch_s=options.touch_s, order=stated)
    if picture is not None:
        from tcdyn.plots.calibration import draw_touches
        from tcdyn.plots.style import panel_figure

        save_picture(panel_figure(partial(draw_touches, result, t, readings, names)), picture)
    reporter.json(result.to_dict)
    reporter.summary(result.summary())
    reporter.files(picture=picture)
    reporter.finish(paths[0].name, [*left_out, *table.findings, *result.findings])


def _measure_each(
    paths: Sequence[Path],
    method: Literal["plunge", "noise"],
    column: str,
    options: TableOptions,
    output: SensorOutput,
    each: EachOptions,
    reporter: Reporter,
) -> None:
    """Measure the lag from each of many tables on its own: ``--each``.

    Parameters
    ----------
    paths
        The tables.
    method
        How the lag is measured.
    column
        Column of the sensor.
    options, output, each, reporter
        As in the command.
    """
    from functools import partial

    from tcdyn.workflows.each import sensor_each

    each.check(paths, reporter)
    if output.name is not None:
        raise InputError("--name with --each", remedy="leave it out: each has the name of its file")
    if output.out is not None:
        check_folder(output.out)
    work = partial(
        sensor_each,
        paths,
        method,
        column,
        output.out,
        overwrite=reporter.overwrite,
        **options.stated,
    )
    each.run(paths, reporter, work)


def _report(
    sensor: SensorFile,
    reporter: Reporter,
    out: Path | None = None,
    findings: Sequence[Finding] = (),
) -> None:
    """Print a sensor, the file that was written, and the findings.

    Parameters
    ----------
    sensor
        Content of the file.
    reporter
        Output of the command.
    out
        File that was written; None: none.
    findings
        Findings about the files that were read.
    """
    reporter.json(sensor.to_dict)
    reporter.summary(sensor.summary())
    reporter.files(sensor=out)
    reporter.finish(sensor.sensor, [*findings, *sensor.findings])
