"""Options and output of ``compensate --sensor``: any table, without a rig."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from tcdyn.cli.common import Told, end, spare_inputs, stages
from tcdyn.core.errors import InputError

SensorFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--sensor",
        help="*.sensor.json, or the JSON of identify: for any table; once for each sensor",
    ),
]
TableColumns = Annotated[
    list[str] | None,
    typer.Option(
        "--column", help="with --sensor: column that it covers, instead of its file's own"
    ),
]


@dataclass(frozen=True)
class TableReading:
    """What tells the time and the units of any table where its names do not."""

    time: Annotated[
        str | None, typer.Option(help="of a table: the time column, if not found by itself")
    ] = None
    time_unit: Annotated[
        str | None,
        typer.Option(
            "--time-unit", help="of a table: unit of its time, where its header does not say it"
        ),
    ] = None
    unit: Annotated[
        list[str] | None,
        typer.Option(
            help="of a table: degC, K, degF or mV, where names do not say it; T1=K for one column"
        ),
    ] = None
    couple: Annotated[
        str | None, typer.Option(help="of millivolts: type E, J, K, N or T (ITS-90)")
    ] = None
    cold_junction: Annotated[
        str, typer.Option(help="of millivolts: reference junction in degC, or its column")
    ] = "0"

    def options(self) -> dict[str, Any]:
        """As ``compensate_table`` takes them.

        >>> TableReading("t", "ms", ["K"]).options()
        {'time': 't', 'time_unit': 'ms', 'unit': 'K', 'couple': '', 'cold': 0.0}
        >>> TableReading(unit=["T1=mV"], cold_junction="cj").options()["cold"]
        'cj'
        """
        parts = [text.rpartition("=") for text in self.unit or []]
        plain = [unit for name, _, unit in parts if not name]
        if len(plain) > 1 or (plain and len(parts) > 1):
            raise InputError(
                "--unit is given more than once", expected="one for all columns, or T1=K for each"
            )
        try:
            cold: float | str = float(self.cold_junction)
        except ValueError:
            cold = self.cold_junction
        unit = plain[0] if plain else {n: u for n, _, u in parts}
        return {
            "time": self.time,
            "time_unit": self.time_unit,
            "unit": unit,
            "couple": self.couple or "",
            "cold": cold,
        }


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
            f"{option} is {text!r:.60}",
            expected="a number, or a number with its uncertainty: 1.5+-0.1",
        ) from None
    if not (abs(found[0]) <= 1e9 and 0 <= found[1] <= 1e9):
        raise InputError(
            f"{option} is {text!r:.60}",
            expected="a number within 1e9, its uncertainty not negative",
        )
    return found


def only_with_records(options: list[str]) -> None:
    """Refuse what belongs to the rig's logs."""
    if options:
        remedy = (
            "leave one of them out: the first needs records of disks, --sensor is for any table"
        )
        raise InputError(f"{options[0]} with --sensor", remedy=remedy)


def of_table(
    log: Path, files: list[Path], out: Path, options: dict[str, Any], tell: Told, verbose: bool
) -> None:
    """Compensate a table, say what came of it; exit 1 where something asks to be looked at."""
    from tcdyn.sensors import read_sensor
    from tcdyn.sensors.table import once_each
    from tcdyn.workflows.compensate_table import compensate_table

    spare_inputs([log, *files], out=out)
    sensors = [read_sensor(path) for path in files]
    with stages(tell.silent, verbose) as progress:
        done = compensate_table(log, sensors, out, progress=progress, **options)
    found = once_each([*(f for s in sensors for f in s.findings), *done.findings])
    tell.json(done.to_dict)
    tell.warn(found)
    tell.say(done.summary())
    end(log.name, found)
