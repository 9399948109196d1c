"""Command ``tcdyn sensor``: state or measure the lag of any thermocouple; writes a sensor file.

Each command is one method to determine a lag (:mod:`tcdyn.sensors`) and writes the same kind of
file. Tests: ``tests/sensors``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import (
    OptionalPicture,
    Reporter,
    check_choice,
    check_outputs,
    check_picture,
    number_option,
    options_from_docstring,
    save_picture,
)
from tcdyn.cli.tables import TableReading, value_and_u
from tcdyn.core.errors import InputError, utf8
from tcdyn.io.endings import JSON

if TYPE_CHECKING:
    from tcdyn.rig.disk import Conditioning
    from tcdyn.sensors import SensorFile

UNIX_LIMIT = 1e12  # largest instant [s]: Unix times may be in milliseconds

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="State or measure the lag of a thermocouple, or of a sensor of another quantity; the file "
    "is for compensate and follow.",
)
Log = Annotated[Path, typer.Argument(help="table with a time column: CSV, LVM, TDMS or Parquet")]
OneColumn = Annotated[str, typer.Option(help="column of the sensor")]
Columns = Annotated[list[str], typer.Option(help="column of the table; * matches any text")]


@dataclass(frozen=True)
class SensorOutput:
    """Options for the sensor file to write.

    Attributes
    ----------
    out
        *.sensor.json to write (default: the result is only printed)
    name
        name of the sensor (default: name of the file)
    """

    out: Path | None = None
    name: str | None = None

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

    def write(self, sensor: SensorFile, reporter: Reporter) -> None:
        """Write the file if one is requested, and report its content.

        Parameters
        ----------
        sensor
            Content of the file.
        reporter
            Output of the command.

        Notes
        -----
        The file is read back, so that a file that cannot be read is an error of this command and
        not of a later one.
        """
        from tcdyn.sensors import read_sensor, write_sensor

        if self.out is not None:
            write_sensor(sensor, self.out)
            read_sensor(self.out)
        _report(sensor, reporter, self.out)


@dataclass(frozen=True)
class FilterOptions:
    """Options for a known filter after the sensor.

    Attributes
    ----------
    cutoff_Hz
        cutoff of a known low-pass filter after the sensor [Hz] (default: no filter)
    poles
        poles of that filter (default: 2)
    shape
        shape of that filter: cascade (of first-order lags, the default) or butterworth
    """

    cutoff_Hz: Annotated[float | None, number_option(1e-6, 1e9)] = None
    poles: Annotated[int | None, typer.Option(min=1, max=6)] = None
    shape: str | None = None

    def conditioning(self) -> Conditioning:
        """The filter; ``NO_CONDITIONING`` if none is specified."""
        from tcdyn.chain import NO_CONDITIONING
        from tcdyn.rig.disk import FILTER_SHAPES, Conditioning

        if self.cutoff_Hz is None:
            _check_needed("--poles", self.poles, "--cutoff-Hz")
            _check_needed("--shape", self.shape, "--cutoff-Hz")
            return NO_CONDITIONING
        shape = self.shape or "cascade"
        check_choice("--shape", shape, FILTER_SHAPES)
        return Conditioning(self.cutoff_Hz, self.poles or 2, shape)  # type: ignore[arg-type]


def _check_needed(option: str, value: object, needed: str) -> None:
    """Raise InputError if ``option`` has a value that has no effect without ``needed``."""
    if value is not None:
        raise InputError(f"{option} is given without {needed}", remedy="give both, or none")


@app.command()
@options_from_docstring
def new(
    tau_s: Annotated[list[str], typer.Option()],
    column: Columns,
    dead_time_s: str = "0",
    *,
    output: SensorOutput,
    known_filter: FilterOptions,
    reporter: Reporter,
) -> None:
    """Write a sensor file from a known lag, for example from a data sheet.

    Example: tcdyn sensor new --tau-s 1.5+-0.1 --column T1 --out probe.sensor.json

    Parameters
    ----------
    tau_s
        a lag in seconds with its standard uncertainty: 1.5+-0.1; repeat for several lags
    dead_time_s
        dead time in seconds with its standard uncertainty: 0.2+-0.05
    """
    from tcdyn.sensors import specified_sensor

    output.check(reporter)
    sensor = specified_sensor(
        output.sensor_name,
        column,
        [value_and_u(text, "--tau-s") for text in tau_s],
        known_filter.conditioning(),
        value_and_u(dead_time_s, "--dead-time-s"),
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
    entry_s: list[str] | None = None,
    medium_s: str = "0.02+-0.02",
    medium: str | None = None,
    diameter_mm: float | None = None,
    speed_m_s: float | None = None,
    junction: str = "axis",
    *,
    output: SensorOutput,
    known_filter: FilterOptions,
    reading: TableReading,
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
        table with a time column: CSV, LVM, TDMS or Parquet; one for each dip
    entry_s
        instant of entry on the clock of the table in seconds, with its standard uncertainty:
        12.3+-0.02; with several dips once for each, in their order
    medium_s
        time constant of the temperature step itself in seconds; it is not part of the lag
    medium
        water (0.4 m/s) or air (3 m/s), the reference streams of VDI/VDE 3522
    diameter_mm
        with --medium: diameter of the sheath
    speed_m_s
        with --medium: another speed of the stream
    junction
        axis (insulated, in the axis of the sheath) or sheath (welded to it)
    """
    from tcdyn.sensors import sensor_from_dip

    output.check(reporter, logs)
    sensor = sensor_from_dip(
        list(logs),
        column,
        name=output.sensor_name,
        entry_s=[value_and_u(text, "--entry-s", UNIX_LIMIT) for text in entry_s]
        if entry_s
        else None,
        medium_s=value_and_u(medium_s, "--medium-s"),
        medium=medium,
        diameter_mm=diameter_mm,
        speed_m_s=speed_m_s,
        junction=junction,  # type: ignore[arg-type]
        conditioning=known_filter.conditioning(),
        **reading.options(),
    )
    output.write(sensor, reporter)


@app.command()
@options_from_docstring
def pair(
    log: Log,
    column: Annotated[list[str], typer.Option()],
    speed: str | None = None,
    exponent: str | None = None,
    flow_step_s: list[float] | None = None,
    bare: bool = False,
    *,
    output: SensorOutput,
    reading: TableReading,
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
    speed
        column of the flow speed v: lags are proportional to v^-n, n about 0.5
    exponent
        with --speed: n and its standard uncertainty (default: 0.5+-0.1)
    flow_step_s
        instant of a step of the flow in seconds; lags are constant between steps; repeat for
        several
    bare
        both are bare wires, which have one lag each
    """
    from tcdyn.sensors import sensor_from_pair

    output.check(reporter, [log])
    sensor = sensor_from_pair(
        log,
        column,
        name=output.sensor_name,
        speed=speed,
        exponent=None if exponent is None else value_and_u(exponent, "--exponent"),
        flow_steps_s=flow_step_s or (),
        bare=bare,
        **reading.options(),
    )
    output.write(sensor, reporter)


@app.command()
@options_from_docstring
def current(
    log: Log,
    column: OneColumn,
    current: Annotated[str, typer.Option()],
    off_only: bool = False,
    *,
    output: SensorOutput,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Measure the lag in place from a loop current step (LCSR): heating, cooling or both.

    The lag is converted to that of a plunge.

    Example: tcdyn sensor current lcsr.csv --column R1 --current I_mA --out pipe.sensor.json

    Parameters
    ----------
    current
        column of the heating current, in any unit
    off_only
        use only rows without current, as a thermocouple cannot be read while heated
    """
    from tcdyn.sensors import sensor_from_current

    output.check(reporter, [log])
    sensor = sensor_from_current(
        log, column, current, name=output.sensor_name, off_only=off_only, **reading.options()
    )
    output.write(sensor, reporter)


@app.command()
@options_from_docstring
def noise(
    log: Log,
    column: OneColumn,
    *,
    output: SensorOutput,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Measure the lag in place from the noise of the process at constant conditions.

    Warnings report conditions that are not constant.

    Example: tcdyn sensor noise steady.csv --column T1 --out pipe.sensor.json
    """
    from tcdyn.sensors import sensor_from_noise

    output.check(reporter, [log])
    sensor = sensor_from_noise(log, column, name=output.sensor_name, **reading.options())
    output.write(sensor, reporter)


@app.command()
@options_from_docstring
def touch(
    log: Log,
    column: Columns,
    order: list[str] | None = None,
    touch_s: Annotated[float, number_option(0.01, 600)] = 2.0,
    picture: OptionalPicture = None,
    *,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Report which column responds when the sensors are touched one after the other.

    Touch the place of each sensor for two seconds with a soldering iron or a warm finger, and wait
    ten seconds before the next. With --order, a warning reports each touch to which another column
    responded.

    Example: tcdyn sensor touch touch.csv --column "slow_*_degC" --order slow_a --order slow_b
    --picture t.png

    Parameters
    ----------
    order
        column that was touched; repeat for each in the order of touching (default: not stated)
    touch_s
        duration of a touch in seconds
    """
    from functools import partial

    import numpy as np

    from tcdyn.sensors.measure import check_temperatures, read_readings
    from tcdyn.sensors.touch import find_touches
    from tcdyn.series.units import match_columns

    check_picture(picture, [log], reporter.overwrite)
    table = read_readings(log, column, several=True, **reading.options())
    check_temperatures(table, "touches")
    stated = []
    for word in order or ():
        stated += match_columns(word, table.names, str(log))
    t = table.time_s
    names = table.names
    readings = np.column_stack(table.values)
    result = find_touches(t, readings, names, touch_s=touch_s, order=stated)
    if picture is not None:
        from tcdyn.plots.calibration import draw_touches
        from tcdyn.plots.style import panel_figure

        save_picture(panel_figure(partial(draw_touches, result, t, readings, names)), picture)
    reporter.json(result.to_dict)
    reporter.summary(result.summary())
    reporter.files(picture=picture)
    reporter.finish(log.name, [*table.findings, *result.findings])


def _report(sensor: SensorFile, reporter: Reporter, out: Path | None = None) -> None:
    """Print a sensor, the file that was written, and the findings.

    Parameters
    ----------
    sensor
        Content of the file.
    reporter
        Output of the command.
    out
        File that was written; None: none.
    """
    reporter.json(sensor.to_dict)
    reporter.summary(sensor.summary())
    reporter.files(sensor=out)
    reporter.finish(sensor.sensor, sensor.findings)
