"""Command ``tcdyn sensor``: state or measure the lag of any thermocouple; writes a sensor file.

Each command is one method to determine a lag (:mod:`tcdyn.sensors`) and writes the same kind of
file. Tests: ``tests/sensors``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import (
    Picture,
    Reporter,
    check_choice,
    check_outputs,
    check_picture,
    exit_status,
    number_option,
    option_groups,
    save_picture,
)
from tcdyn.cli.tables import TableReading, value_and_u
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.findings import Finding, warning

if TYPE_CHECKING:
    from tcdyn.rig.disk import Conditioning
    from tcdyn.rig.record import InputFile
    from tcdyn.sensors import SensorFile

UNIX_LIMIT = 1e12  # largest instant [s]: Unix times may be in milliseconds

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="State or measure the lag of a thermocouple; the file is for compensate and follow.",
)
Log = Annotated[Path, typer.Argument(help="table with a time column: CSV, LVM, TDMS or Parquet")]
OneColumn = Annotated[str, typer.Option("--column", help="column of the sensor")]
Columns = Annotated[
    list[str], typer.Option("--column", help="column of the table; * matches any text")
]


@dataclass(frozen=True)
class SensorOutput:
    """Options for the sensor file to write."""

    out: Annotated[
        Path | None,
        typer.Option(help="*.sensor.json to write (default: the result is only printed)"),
    ] = None
    name: Annotated[
        str | None, typer.Option(help="name of the sensor (default: name of the file)")
    ] = None

    @property
    def sensor_name(self) -> str:
        """Name of the sensor, by default that of its file."""
        from tcdyn.sensors.file import MAX_NAME

        file_name = "" if self.out is None else self.out.name
        file_name = file_name.removesuffix(".json").removesuffix(".sensor")
        return self.name or utf8(file_name)[:MAX_NAME] or "sensor"

    def write(self, sensor: SensorFile, reporter: Reporter, logs: Sequence[Path] = ()) -> None:
        """Write the file if one is requested, and report its content; exit code 1 for a warning.

        Parameters
        ----------
        sensor
            Content of the file.
        reporter
            Output of the command.
        logs
            Tables that were read; they must not be the output.

        Notes
        -----
        The file is read back, so that a file that cannot be read is an error of this command and
        not of a later one.
        """
        from tcdyn.sensors import read_sensor, write_sensor

        if self.out is not None:
            check_outputs(logs, out=self.out)
            write_sensor(sensor, self.out)
            read_sensor(self.out)
        reporter.json(sensor.to_dict)
        reporter.text(sensor.summary().split("\nwarning:")[0].split("\ninfo:")[0])
        reporter.findings(sensor.findings)
        if self.out is not None:
            reporter.text(f"wrote {self.out}")
        exit_status(str(self.out or sensor.sensor), sensor.findings)


@dataclass(frozen=True)
class FilterOptions:
    """Options for a known filter after the sensor."""

    cutoff_hz: Annotated[
        float | None,
        number_option(
            "--cutoff-Hz",
            "cutoff of a known low-pass filter after the sensor [Hz] (default: no filter)",
            1e-6,
            1e9,
        ),
    ] = None
    poles: Annotated[
        int | None, typer.Option(min=1, max=6, help="poles of that filter (default: 2)")
    ] = None
    shape: Annotated[
        str | None,
        typer.Option(
            help="shape of that filter: cascade (of first-order lags, the default) or butterworth"
        ),
    ] = None

    def conditioning(self) -> Conditioning:
        """The filter; ``NO_CONDITIONING`` if none is specified."""
        from tcdyn.chain import NO_CONDITIONING
        from tcdyn.rig.disk import FILTER_SHAPES, Conditioning

        if self.cutoff_hz is None:
            _check_needed("--poles", self.poles, "--cutoff-Hz")
            _check_needed("--shape", self.shape, "--cutoff-Hz")
            return NO_CONDITIONING
        shape = self.shape or "cascade"
        check_choice("--shape", shape, FILTER_SHAPES)
        return Conditioning(self.cutoff_hz, self.poles or 2, shape)  # type: ignore[arg-type]


def _check_needed(option: str, value: object, needed: str) -> None:
    """Raise InputError if ``option`` has a value that has no effect without ``needed``."""
    if value is not None:
        raise InputError(f"{option} is given without {needed}", remedy="give both, or none")


@app.command()
@option_groups
def new(
    tau_s: Annotated[
        list[str],
        typer.Option(
            "--tau-s",
            help="a lag in seconds with its standard uncertainty: 1.5+-0.1; repeat for several "
            "lags",
        ),
    ],
    column: Columns,
    delay_s: Annotated[
        str,
        typer.Option(
            "--delay-s", help="dead time in seconds with its standard uncertainty: 0.2+-0.05"
        ),
    ] = "0",
    *,
    output: SensorOutput,
    known_filter: FilterOptions,
    reporter: Reporter,
) -> None:
    """Write a sensor file from a known lag, for example from a data sheet.

    Example: tcdyn sensor new --tau-s 1.5+-0.1 --column T1 --out probe.sensor.json
    """
    from tcdyn.sensors import specified_sensor

    sensor = specified_sensor(
        output.sensor_name,
        column,
        [value_and_u(text, "--tau-s") for text in tau_s],
        known_filter.conditioning(),
        value_and_u(delay_s, "--delay-s"),
    )
    output.write(sensor, reporter)


@app.command()
@option_groups
def show(
    file: Annotated[Path, typer.Argument(help="*.sensor.json, or the JSON of tcdyn identify")],
    *,
    reporter: Reporter,
) -> None:
    """Print a sensor file: lag, times of the step response, how the lag was determined.

    Example: tcdyn sensor show probe.sensor.json
    """
    from tcdyn.sensors import read_sensor

    sensor = read_sensor(file)
    reporter.json(sensor.to_dict)
    reporter.text(sensor.summary())


@app.command()
@option_groups
def plunge(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="table with a time column: CSV, LVM, TDMS or Parquet; one for each dip",
        ),
    ],
    column: OneColumn,
    entry_s: Annotated[
        list[str] | None,
        typer.Option(
            "--entry-s",
            help="instant of entry on the clock of the table in seconds, with its standard "
            "uncertainty: 12.3+-0.02; with several dips once for each, in their order",
        ),
    ] = None,
    medium_s: Annotated[
        str,
        typer.Option(
            "--medium-s",
            help="time constant of the temperature step itself in seconds; it is not part of the "
            "lag",
        ),
    ] = "0.02+-0.02",
    medium: Annotated[
        str | None,
        typer.Option(help="water (0.4 m/s) or air (3 m/s), the reference streams of VDI/VDE 3522"),
    ] = None,
    diameter_mm: Annotated[
        float | None, typer.Option("--diameter-mm", help="with --medium: diameter of the sheath")
    ] = None,
    speed_m_s: Annotated[
        float | None, typer.Option("--speed-m-s", help="with --medium: another speed of the stream")
    ] = None,
    junction: Annotated[
        str,
        typer.Option(help="axis (insulated, in the axis of the sheath) or sheath (welded to it)"),
    ] = "axis",
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
    """
    from tcdyn.sensors.dips import pool_dips
    from tcdyn.sensors.plunge import plunge_sensor
    from tcdyn.sensors.step_structures import JUNCTIONS
    from tcdyn.sensors.surface_h import BoundaryLayer

    check_choice("--junction", junction, JUNCTIONS)
    if (medium is None) != (diameter_mm is None):
        raise InputError("--medium and --diameter-mm go together", remedy="give both, or none")
    if medium is None:
        _check_needed("--speed-m-s", speed_m_s, "--medium")
    film = None
    if medium is not None and diameter_mm is not None:
        film = BoundaryLayer(medium, 1e-3 * diameter_mm, speed_m_s)
    entries = entry_s or []
    if entries and len(entries) != len(logs):
        raise InputError(
            f"--entry-s is given {len(entries)} times for {len(logs)} dips",
            expected="once for each dip, or not at all",
        )
    dips = []
    for number, log in enumerate(logs):
        t, values, findings, names = _read(log, [column], reading)
        try:
            dip = plunge_sensor(
                t,
                values[0],
                names[0],
                sensor=output.sensor_name,
                conditioning=known_filter.conditioning(),
                entry_s=value_and_u(entries[number], "--entry-s", UNIX_LIMIT) if entries else None,
                medium_s=value_and_u(medium_s, "--medium-s"),
                film=film,
                junction=junction,  # type: ignore[arg-type]
                inputs=[_input_file(log)],
            )
        except InputError as problem:
            raise problem.at(str(log)) from None
        dips.append(_with_findings(dip, findings, float(t[-1] - t[0])))
    sensor = dips[0] if len(dips) == 1 else pool_dips(dips, output.sensor_name, film)
    output.write(sensor, reporter, logs)


@app.command()
@option_groups
def pair(
    log: Log,
    columns: Annotated[
        str, typer.Option("--columns", help="the two columns, separated by a comma: T1,T2")
    ],
    speed: Annotated[
        str | None,
        typer.Option(
            "--speed", help="column of the flow speed v: lags are proportional to v^-n, n about 0.5"
        ),
    ] = None,
    exponent: Annotated[
        str | None,
        typer.Option(
            "--exponent",
            help="with --speed: n and its standard uncertainty (default: 0.5+-0.1)",
        ),
    ] = None,
    change_s: Annotated[
        list[float] | None,
        typer.Option(
            "--change-s",
            help="instant of a step of the flow in seconds; lags are constant between steps; "
            "repeat for "
            "several",
        ),
    ] = None,
    bare: Annotated[
        bool, typer.Option("--bare", help="both are bare wires, which have one lag each")
    ] = False,
    *,
    output: SensorOutput,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Measure the lags of two thermocouples of different size in one fluid, without a reference.

    Noise on both is modelled. Both columns of a row are taken as sampled at one instant. If a
    column is repeated or blank between new values, only its new values are used.

    Example: tcdyn sensor pair exhaust.csv --columns T1,T2 --speed flow_m_s --out pair.sensor.json
    """
    from tcdyn.sensors.pair import EXPONENT, pair_sensor

    if speed is None:
        _check_needed("--exponent", exponent, "--speed")
    pair_names = [name.strip() for name in columns.split(",")]
    if len(pair_names) != 2 or pair_names[0] == pair_names[1]:
        raise InputError(f"--columns is {columns!r}", expected="two columns with a comma: T1,T2")
    t, values, findings, names = _read(log, pair_names, reading, (speed,) if speed else ())
    sensor = pair_sensor(
        t,
        values[0],
        values[1],
        (names[0], names[1]),
        sensor=output.sensor_name,
        speed=values[2] if speed else None,
        changes_s=change_s or (),
        exponent=EXPONENT if exponent is None else value_and_u(exponent, "--exponent"),
        bare=bare,
        inputs=[_input_file(log)],
    )
    output.write(_with_findings(sensor, findings, float(t[-1] - t[0])), reporter, [log])


@app.command()
@option_groups
def current(
    log: Log,
    column: OneColumn,
    current: Annotated[
        str,
        typer.Option("--current", help="column of the heating current, in any unit"),
    ],
    off_only: Annotated[
        bool,
        typer.Option(
            "--off-only",
            help="use only rows without current, as a thermocouple cannot be read while heated",
        ),
    ] = False,
    *,
    output: SensorOutput,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Measure the lag in place from a loop current step (LCSR): heating, cooling or both.

    The lag is converted to that of a plunge.

    Example: tcdyn sensor current lcsr.csv --column R1 --current I_mA --out pipe.sensor.json
    """
    from tcdyn.sensors.current import current_sensor

    t, values, findings, names = _read(log, [column], reading, (current,))
    sensor = current_sensor(
        t,
        values[0],
        values[1],
        names[0],
        sensor=output.sensor_name,
        off_only=off_only,
        inputs=[_input_file(log)],
    )
    output.write(_with_findings(sensor, findings, float(t[-1] - t[0])), reporter, [log])


@app.command()
@option_groups
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
    from tcdyn.sensors.noise import noise_sensor

    t, values, findings, names = _read(log, [column], reading)
    sensor = noise_sensor(
        t, values[0], names[0], sensor=output.sensor_name, inputs=[_input_file(log)]
    )
    output.write(_with_findings(sensor, findings, float(t[-1] - t[0])), reporter, [log])


@app.command()
@option_groups
def touch(
    log: Log,
    column: Columns,
    order: Annotated[
        str | None,
        typer.Option(
            help="columns in the order of touching, separated by commas: T2,T1,T3 (default: not "
            "stated)"
        ),
    ] = None,
    touch_s: Annotated[
        float, number_option("--touch-s", "duration of a touch in seconds", 0.01, 600)
    ] = 2.0,
    out: Annotated[Path | None, Picture] = None,
    *,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """Report which column responds when the sensors are touched one after the other.

    Touch the place of each sensor for two seconds with a soldering iron or a warm finger, and wait
    ten seconds before the next. With --order, a warning reports each touch to which another column
    responded.

    Example: tcdyn sensor touch touch.csv --column "slow_*_degC" --order slow_a,slow_b --out t.png
    """
    from functools import partial

    import numpy as np

    from tcdyn.sensors.touch import find_touches
    from tcdyn.sensors.units import match_columns

    check_picture(out, [log])
    t, values, findings, names = _read(log, column, reading, several=True)
    stated = []
    for word in (order or "").split(","):
        if word.strip():
            stated += match_columns(word.strip(), names, str(log))
    readings = np.column_stack(values)
    result = find_touches(t, readings, names, touch_s=touch_s, order=stated)
    if out is not None:
        from tcdyn.plots.calibration import draw_touches
        from tcdyn.plots.style import panel_figure

        save_picture(panel_figure(partial(draw_touches, result, t, readings, names)), out)
    reporter.json(result.to_dict)
    reporter.text(result.summary())
    reporter.findings([*findings, *result.findings])
    reporter.files(picture=out)
    exit_status(str(log), [*findings, *result.findings])


def _read(
    log: Path,
    columns: list[str],
    reading: TableReading,
    plain: tuple[str, ...] = (),
    *,
    several: bool = False,
) -> tuple[Any, list[Any], list[Finding], list[str]]:
    """Read columns of a table.

    Parameters
    ----------
    log
        The table.
    columns
        Columns of temperatures, or patterns that match one each.
    reading
        Options for time and units.
    plain
        Columns that are not temperatures.
    several
        Whether a pattern of ``columns`` may match several.

    Returns
    -------
    tuple
        Even times [s]; the ``columns`` as temperatures [degC], followed by the columns ``plain`` as
        logged; findings; names of the columns.
    """
    from tcdyn.sensors.table import open_source, read_columns
    from tcdyn.sensors.units import cold_column, match_columns, units_of

    options = reading.options()
    opened = open_source(log, reading.time, [*columns, *plain], reading.time_unit)
    candidates = [name for name in opened.table.names if name != opened.time]
    names = []
    for pattern in (*columns, *plain):
        matches = match_columns(pattern, candidates, opened.table.where)
        if len(matches) > 1 and not several:
            raise InputError(
                f"{pattern!r} matches {len(matches)} columns",
                where=str(log),
                expected="one",
                remedy=f"for example name {matches[0]!r}",
            )
        names += matches
    if several:
        names = list(dict.fromkeys(names))
    cold = cold_column(options["cold"], opened.table.names, opened.table.where)
    units, unit_findings = units_of(
        names[: len(names) - len(plain)],
        options["unit"],
        options["couple"],
        cold,
        opened.table.units,
    )
    t, values, findings = read_columns(log, names, units, opened.time, reading.time_unit)
    return t, [values[name] for name in names], [*unit_findings, *findings], names


def _input_file(log: Path) -> InputFile:
    """Name and checksum of the table, for the sensor file."""
    from tcdyn.io.read import sha256
    from tcdyn.rig.record import InputFile

    return InputFile.of_path(log, sha256(log))


def _with_findings(sensor: SensorFile, findings: list[Finding], duration_s: float) -> SensorFile:
    """The sensor with the findings of the reader in front of those of the fit.

    A warning is added for each lag whose standard uncertainty exceeds the length of the record,
    ``duration_s``.

    Parameters
    ----------
    sensor
        Result of the fit.
    findings
        Findings of the reader.
    duration_s
        Length of the record.
    """
    from tcdyn.sensors.table import unique_by_subject

    all_findings = list(findings)
    for column, channel in sensor.chain.channels.items():
        u_s = channel.lag_s.u
        if u_s > duration_s:
            all_findings.append(
                warning("sensor.undetermined", subject=column, u_s=u_s, duration_s=duration_s)
            )
    return sensor.model_copy(
        update={"findings": [*unique_by_subject(all_findings), *sensor.findings]}
    )
