"""``tcdyn sensor``: the lag of any thermocouple, stated or found, as a file that ``compensate`` and ``follow`` take."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from calibration.disk import FILTER_SHAPES, Conditioning
from calibration.errors import InputError
from calibration.finding import doubts
from calibration.result import jsonable
from tcdyn.chain import NO_CONDITIONING
from tcdyn.cli.common import Json, Quiet, bounded, check_choice, dump, in_one_line, say, spare_inputs, warn
from tcdyn.sensor import SensorFile, read_sensor, stated, write_sensor

app = typer.Typer(no_args_is_help=True, help="The lag of any thermocouple, as a file that compensate and follow take.")
Columns = Annotated[list[str], typer.Option("--column", help="column of a table; * stands for any text")]
Out = Annotated[Path, typer.Option(help="*.sensor.json to write")]
Name = Annotated[str | None, typer.Option("--name", help="what the sensor is called; default: the file's name")]
Cutoff = Annotated[
    float | None,
    bounded("--cutoff-Hz", "a known low-pass filter behind the sensor [Hz]; none unless stated", 0, 1e9, ends=False),
]
Poles = Annotated[int, typer.Option(min=1, max=6, help="poles of that filter")]
Shape = Annotated[str, typer.Option(help="its shape: cascade (of single lags) or butterworth")]


@app.callback()
def _sensor() -> None:
    """The lag of any thermocouple, as a file that compensate and follow take."""


@app.command()
def new(
    tau_s: Annotated[list[str], typer.Option("--tau-s", help="a lag [s] and its uncertainty: 1.5+-0.1; once for each")],
    column: Columns,
    out: Out,
    delay_s: Annotated[str, typer.Option("--delay-s", help="dead time [s]: 0.2+-0.05")] = "0",
    cutoff_hz: Cutoff = None,
    poles: Poles = 2,
    shape: Shape = "cascade",
    name: Name = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the file of a sensor whose lag is known from elsewhere.

    Example: tcdyn sensor new --tau-s 1.5+-0.1 --column T1 --out probe.sensor.json
    """
    made = stated(
        name or named(out), column, [value_and_u(text, "--tau-s") for text in tau_s],
        filter_of(cutoff_hz, poles, shape), value_and_u(delay_s, "--delay-s"),
    )  # fmt: skip
    finish(made, out, json_, quiet)


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="*.sensor.json, or the JSON of tcdyn identify")],
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """What a sensor file says: lag, times of its step response, how it was found.

    Example: tcdyn sensor show probe.sensor.json
    """
    sensor = read_sensor(file)
    print(dump(sensor.to_dict()), end="") if json_ else say(sensor.summary(), quiet)


def value_and_u(text: str, option: str) -> tuple[float, float]:
    """A number and its standard uncertainty as people write them: "1.5+-0.1", "1.5 ± 0.1", "1.5".

    >>> value_and_u("1.5+-0.1", "--tau-s"), value_and_u("2", "--tau-s")
    ((1.5, 0.1), (2.0, 0.0))
    """
    value, _, u = text.replace("±", "+-").replace("+/-", "+-").partition("+-")
    try:
        found = float(value), float(u) if u.strip() else 0.0
    except ValueError:
        raise InputError(
            f"{option} is {text!r}", expected="a number, or a number with its uncertainty: 1.5+-0.1"
        ) from None
    if not all(math.isfinite(x) for x in found):
        raise InputError(f"{option} is {text!r}", expected="finite numbers")
    return found


def filter_of(cutoff_Hz: float | None, poles: int, shape: str) -> Conditioning:
    """The filter that was stated, none if it was not."""
    check_choice("--shape", shape, FILTER_SHAPES)
    return NO_CONDITIONING if cutoff_Hz is None else Conditioning(cutoff_Hz, poles, shape)  # type: ignore[arg-type]


def named(out: Path) -> str:
    """A sensor's name by its file's."""
    return out.name.removesuffix(".json").removesuffix(".sensor") or "sensor"


def finish(sensor: SensorFile, out: Path, json_: bool, quiet: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Write the file, say what it holds; exit 1 where something asks to be looked at."""
    spare_inputs(inputs, out=out)
    write_sensor(sensor, out)
    read_sensor(out)
    if json_:
        print(dump(jsonable(sensor.to_dict())), end="")
    else:
        say(sensor.summary().split("\nlook:")[0].split("\nnote:")[0], quiet)
        warn(sensor.findings, quiet)
        say(f"wrote {out}", quiet)
    if doubts(sensor.findings):
        in_one_line(str(out), sensor.findings)
        raise typer.Exit(1)
