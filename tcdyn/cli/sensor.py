"""``tcdyn sensor``: the lag of any thermocouple, stated or found, as a file that ``compensate`` and ``follow`` take."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import (
    Reporter,
    check_choice,
    check_outputs,
    exit_status,
    number_option,
    option_groups,
)
from tcdyn.cli.tables import TableReading, value_and_u
from tcdyn.core.errors import InputError

if TYPE_CHECKING:
    from tcdyn.core.findings import Finding
    from tcdyn.rig.disk import Conditioning
    from tcdyn.rig.record import InputFile
    from tcdyn.sensors import SensorFile

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="The lag of any thermocouple, as a file that compensate and follow take.",
)
Log = Annotated[Path, typer.Argument(help="table with a time column: CSV, LVM, TDMS or Parquet")]
OneColumn = Annotated[str, typer.Option("--column", help="the sensor's column")]
Columns = Annotated[
    list[str], typer.Option("--column", help="column of a table; * stands for any text")
]


@dataclass(frozen=True)
class Made:
    """The file of the sensor that was found."""

    out: Annotated[Path, typer.Option(help="*.sensor.json to write")]
    name: Annotated[
        str | None, typer.Option(help="what the sensor is called; default: the file's name")
    ] = None

    @property
    def called(self) -> str:
        """The sensor's name, by its file's where none was given."""
        return self.name or self.out.name.removesuffix(".json").removesuffix(".sensor") or "sensor"

    def finish(self, sensor: SensorFile, reporter: Reporter, log: Path | None = None) -> None:
        """Write the file, say what it holds; exit 1 where something asks to be looked at."""
        from tcdyn.sensors import read_sensor, write_sensor

        check_outputs([log], out=self.out)
        write_sensor(sensor, self.out)
        read_sensor(self.out)
        reporter.json(sensor.to_dict)
        reporter.text(sensor.summary().split("\nwarning:")[0].split("\ninfo:")[0])
        reporter.findings(sensor.findings)
        reporter.text(f"wrote {self.out}")
        exit_status(str(self.out), sensor.findings)


@dataclass(frozen=True)
class Filter:
    """A known filter behind the sensor."""

    cutoff_hz: Annotated[
        float | None,
        number_option(
            "--cutoff-Hz",
            "a known low-pass filter behind the sensor [Hz]; none unless stated",
            1e-6,
            1e9,
        ),
    ] = None
    poles: Annotated[int, typer.Option(min=1, max=6, help="poles of that filter")] = 2
    shape: Annotated[
        str, typer.Option(help="its shape: cascade (of single lags) or butterworth")
    ] = "cascade"

    def conditioning(self) -> Conditioning:
        """The filter that was stated, none if it was not."""
        from tcdyn.chain import NO_CONDITIONING
        from tcdyn.rig.disk import FILTER_SHAPES, Conditioning

        check_choice("--shape", self.shape, FILTER_SHAPES)
        if self.cutoff_hz is None:
            return NO_CONDITIONING
        return Conditioning(self.cutoff_hz, self.poles, self.shape)  # type: ignore[arg-type]


@app.command()
@option_groups
def new(
    tau_s: Annotated[
        list[str],
        typer.Option(
            "--tau-s", help="a lag in seconds and its uncertainty: 1.5+-0.1; once for each"
        ),
    ],
    column: Columns,
    delay_s: Annotated[
        str, typer.Option("--delay-s", help="dead time in seconds: 0.2+-0.05")
    ] = "0",
    *,
    to: Made,
    behind: Filter,
    reporter: Reporter,
) -> None:
    """Write the file of a sensor whose lag is known from elsewhere.

    Example: tcdyn sensor new --tau-s 1.5+-0.1 --column T1 --out probe.sensor.json
    """
    from tcdyn.sensors import stated

    made = stated(
        to.called,
        column,
        [value_and_u(text, "--tau-s") for text in tau_s],
        behind.conditioning(),
        value_and_u(delay_s, "--delay-s"),
    )
    to.finish(made, reporter)


@app.command()
@option_groups
def show(
    file: Annotated[Path, typer.Argument(help="*.sensor.json, or the JSON of tcdyn identify")],
    *,
    reporter: Reporter,
) -> None:
    """What a sensor file says: lag, times of its step response, how it was found.

    Example: tcdyn sensor show probe.sensor.json
    """
    from tcdyn.sensors import read_sensor

    sensor = read_sensor(file)
    reporter.json(sensor.to_dict)
    reporter.text(sensor.summary())


@app.command()
@option_groups
def plunge(
    log: Log,
    column: OneColumn,
    entry_s: Annotated[
        str | None,
        typer.Option(
            "--entry-s", help="when it entered, on the table's clock in seconds: 12.3+-0.02"
        ),
    ] = None,
    medium_s: Annotated[
        str,
        typer.Option(
            "--medium-s",
            help="time constant of the surroundings' own step in seconds, no part of the lag",
        ),
    ] = "0.02+-0.02",
    medium: Annotated[
        str | None,
        typer.Option(help="water (0.4 m/s) or air (3 m/s), the reference streams of VDI/VDE 3522"),
    ] = None,
    diameter_mm: Annotated[
        float | None, typer.Option("--diameter-mm", help="with --medium: of the sheath")
    ] = None,
    speed_m_s: Annotated[
        float | None, typer.Option("--speed-m-s", help="with --medium: another speed")
    ] = None,
    *,
    to: Made,
    behind: Filter,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """The lag from one step of the surroundings: t50, t63.2, t90 and the chain, entry instant unknown.

    Example: tcdyn sensor plunge dip.csv --column T1 --out probe.sensor.json --medium water --diameter-mm 3
    """
    from tcdyn.sensors.plunge import plunge_sensor
    from tcdyn.sensors.surface_h import Film

    if (medium is None) != (diameter_mm is None):
        raise InputError("--medium and --diameter-mm go together", remedy="give both, or none")
    film = Film(medium, 1e-3 * diameter_mm, speed_m_s) if medium and diameter_mm else None
    t, values, found, names = read(log, [column], reading)
    made = plunge_sensor(
        t,
        values[0],
        names[0],
        sensor=to.called,
        conditioning=behind.conditioning(),
        entry_s=None if entry_s is None else value_and_u(entry_s, "--entry-s"),
        medium_s=value_and_u(medium_s, "--medium-s"),
        film=film,
        inputs=[source(log)],
    )
    to.finish(with_findings(made, found, float(t[-1] - t[0])), reporter, log)


@app.command()
@option_groups
def pair(
    log: Log,
    columns: Annotated[str, typer.Option("--columns", help="the two columns: T1,T2")],
    speed: Annotated[
        str | None,
        typer.Option(
            "--speed", help="column of the flow's speed: lags go as its -n-th power, n about 0.5"
        ),
    ] = None,
    exponent: Annotated[
        str, typer.Option("--exponent", help="with --speed: n and its standard deviation")
    ] = "0.5+-0.1",
    change_s: Annotated[
        list[float] | None,
        typer.Option(
            "--change-s", help="when the flow stepped, in seconds; lags constant between; repeat"
        ),
    ] = None,
    *,
    to: Made,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """The lags of two thermocouples of different size in one fluid, without a reference, noise on both.

    Both columns of a row are taken as sampled at one instant. A column that is repeated or blank between new values is
    used at its new values.

    Example: tcdyn sensor pair exhaust.csv --columns T1,T2 --speed flow_m_s --out pair.sensor.json
    """
    from tcdyn.sensors.pair import pair_sensor

    wanted = [c.strip() for c in columns.split(",")]
    if len(wanted) != 2 or wanted[0] == wanted[1]:
        raise InputError(f"--columns is {columns!r}", expected="two columns with a comma: T1,T2")
    t, values, found, names = read(log, wanted, reading, (speed,) if speed else ())
    made = pair_sensor(
        t,
        values[0],
        values[1],
        (names[0], names[1]),
        sensor=to.called,
        speed=values[2] if speed else None,
        changes_s=change_s or (),
        exponent=value_and_u(exponent, "--exponent"),
        inputs=[source(log)],
    )
    to.finish(with_findings(made, found, float(t[-1] - t[0])), reporter, log)


@app.command()
@option_groups
def current(
    log: Log,
    column: OneColumn,
    current: Annotated[
        str,
        typer.Option("--current", help="column of the heating current; its unit does not matter"),
    ],
    off_only: Annotated[
        bool,
        typer.Option(
            "--off-only",
            help="use rows without current only: a thermocouple is not read while heated",
        ),
    ] = False,
    *,
    to: Made,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """The lag in place from a loop current step (LCSR), heating, cooling or both, converted to that of a plunge.

    Example: tcdyn sensor current lcsr.csv --column R1 --current I_mA --out pipe.sensor.json
    """
    from tcdyn.sensors.current import current_sensor

    t, values, found, names = read(log, [column], reading, (current,))
    made = current_sensor(
        t, values[0], values[1], names[0], sensor=to.called, off_only=off_only, inputs=[source(log)]
    )
    to.finish(with_findings(made, found, float(t[-1] - t[0])), reporter, log)


@app.command()
@option_groups
def noise(
    log: Log,
    column: OneColumn,
    *,
    to: Made,
    reading: TableReading,
    reporter: Reporter,
) -> None:
    """The lag in place from the process's own noise at constant conditions, and whether the conditions hold.

    Example: tcdyn sensor noise steady.csv --column T1 --out pipe.sensor.json
    """
    from tcdyn.sensors.noise import noise_sensor

    t, values, found, names = read(log, [column], reading)
    made = noise_sensor(t, values[0], names[0], sensor=to.called, inputs=[source(log)])
    to.finish(with_findings(made, found, float(t[-1] - t[0])), reporter, log)


def read(
    log: Path, columns: list[str], reading: TableReading, plain: tuple[str, ...] = ()
) -> tuple[Any, list[Any], list[Finding], list[str]]:
    """Even times [s], columns (temperatures [degC] first, then the ``plain`` ones as logged), findings, their names."""
    from tcdyn.sensors.table import open_source, read_columns
    from tcdyn.sensors.units import cold_column, matching, units_of

    options = reading.options()
    opened = open_source(log, reading.time, [*columns, *plain], reading.time_unit)
    names = []
    for wanted in (*columns, *plain):
        hits = matching(
            wanted, [n for n in opened.table.names if n != opened.time], opened.table.where
        )
        if len(hits) > 1:
            raise InputError(
                f"{wanted!r} means {len(hits)} columns",
                where=str(log),
                expected="one",
                remedy=f"name {hits[0]!r}",
            )
        names += hits
    cold = cold_column(options["cold"], opened.table.names, opened.table.where)
    found_units, told = units_of(
        names[: len(columns)], options["unit"], options["couple"], cold, opened.table.units
    )
    t, values, found = read_columns(log, names, found_units, opened.time, reading.time_unit)
    return t, [values[n] for n in names], [*told, *found], names


def source(log: Path) -> InputFile:
    """What the file says of the table it was made from."""
    from tcdyn.io.read import sha256
    from tcdyn.rig.record import InputFile

    return InputFile(file=log.name, sha256=sha256(log))


def with_findings(sensor: SensorFile, found: list[Finding], duration_s: float) -> SensorFile:
    """The sensor with the findings of the reader before those of the fit, and a warning for each lag whose standard
    uncertainty exceeds ``duration_s`` of the record [s]."""
    from tcdyn.core.findings import warning
    from tcdyn.sensors.table import once_each

    for column, channel in sensor.chain.channels.items():
        if channel.lag_s.u > duration_s:
            found.append(
                warning(
                    "sensor.undetermined",
                    subject=column,
                    u_s=channel.lag_s.u,
                    duration_s=duration_s,
                )
            )
    return sensor.model_copy(update={"findings": [*once_each(found), *sensor.findings]})
