"""What the commands share: options, and how numbers are printed."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.errors import InputError, printable

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from calibration.finding import Finding
    from tcdyn.simulate.truth import BoreContact

OPTIONS = {  # of parameters, where it is not the name with dashes
    "records": "--record", "dt_s": "--dt", "resample_s": "--resample", "start_s": "--covariance-from-s",
    "loss=huber": "--robust",
}  # fmt: skip
RigFile = Annotated[Path | None, typer.Option("--rig", help="rig.toml; without it the design's defaults")]
OwnRigFile = Annotated[
    Path | None, typer.Option("--rig", help="rig.toml; without it the one that the records were made with")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="each stage on a line of its own, with the time gone by")
]
Json = Annotated[bool, typer.Option("--json", help="print the result as JSON instead of words")]
RECORD = typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")
RecordFiles = Annotated[list[Path], RECORD]
OptionalRecordFiles = Annotated[list[Path] | None, RECORD]


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the fields of those of its parameters that are dataclasses of options as options of its own."""
    own = inspect.signature(command, eval_str=True).parameters.values()
    groups: dict[str, Any] = {p.name: p.annotation for p in own if is_dataclass(p.annotation)}
    fields = {n: inspect.signature(group, eval_str=True).parameters for n, group in groups.items()}

    @wraps(command)
    def called(*arguments: Any, **options: Any) -> None:
        for name, group in groups.items():
            options[name] = group(**{f: options.pop(f) for f in fields[name] if f in options})
        command(*arguments, **options)

    spread = [f.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in fields.values() for f in each.values()]
    signature = inspect.Signature([*(p for p in own if p.name not in groups), *spread])
    called.__signature__ = signature  # type: ignore[attr-defined]
    return called


@dataclass(frozen=True)
class Told:
    """How a command answers: in words, as JSON, or not at all."""

    json_: Json = False
    quiet: Quiet = False

    @property
    def silent(self) -> bool:
        """Whether no words are printed."""
        return self.json_ or self.quiet

    def say(self, text: str) -> None:
        """Print plain words."""
        if not self.silent:
            print("\n".join(map(printable, text.split("\n"))))

    def json(self, data: Callable[[], Any]) -> None:
        """Print what ``data`` gives, where JSON was asked for."""
        if self.json_:
            print(dump(data()), end="")

    def warn(self, findings: Iterable[Finding]) -> None:
        """Print each finding on standard error, its grade in front: note, look or refuse."""
        from calibration.finding import once

        for found in () if self.silent else once(findings):
            print(f"{found.grade.value}: {printable(in_options(found.sentence))}", file=sys.stderr)

    def files(self, **written: Path | None) -> None:
        """Name the files that were written, by what they hold."""
        for what, path in written.items():
            if path is not None:
                self.say(f"{what}: {path}")


def within(low: float, high: float, *, ends: bool = True) -> Callable[[typer.CallbackParam, Any], Any]:
    """Callback of an option whose numbers lie from ``low`` to ``high`` (between them without ``ends``), not NaN."""

    def check(param: typer.CallbackParam, value: Any) -> Any:
        for number in value if isinstance(value, list | tuple) else [value]:
            if number is not None and not (low <= number <= high if ends else low < number < high):
                expected = f"{low:g} to {high:g}" if ends else f"above {low:g} and below {high:g}"
                raise InputError(f"{param.opts[0]} is {number:g}", expected=expected)
        return value

    return check


def bounded(option: str, help_: str, low: float, high: float, *, ends: bool = True) -> Any:
    """An option whose numbers lie from ``low`` to ``high``."""
    return typer.Option(option, help=help_, callback=within(low, high, ends=ends))


def check_choice(option: str, value: str, allowed: tuple[str, ...]) -> None:
    """Refuse a value that is none of ``allowed``."""
    if value not in allowed:
        raise InputError(f"{option} is {value!r}", expected=" or ".join(allowed))


def contacts(said: list[str] | None) -> dict[str, BoreContact]:
    """What ``--uneven`` says of each disk's bore."""
    from calibration.disk import DISKS
    from tcdyn.simulate.truth import BoreContact

    contacts: dict[str, BoreContact] = {}
    for text in said or ():
        name, _, numbers = text.rpartition(":")
        amplitude, _, angle = numbers.partition("@")
        try:
            size, at = float(amplitude), float(angle)
        except ValueError:
            raise InputError(
                f"--uneven {text!r}", expected="amplitude@degrees, such as 0.5@30 or fast:0.5@30"
            ) from None
        if name:
            check_choice("the disk of --uneven", name, DISKS)
        contacts |= dict.fromkeys((name,) if name else DISKS, BoreContact(size, at))
    return contacts


def spare_inputs(inputs: Iterable[Path | str | None], **outputs: Path | None) -> None:
    """Refuse, before anything is done, an output that is an input under any name, or another output.

    ``outputs``: by their options without the dashes; None where nothing was given. Raises InputError.

    >>> spare_inputs([None, "log.csv"], out=Path("done.csv"), report=None)
    """
    taken = {Path(path).resolve(): "which is read" for path in inputs if path is not None}
    for option, path in outputs.items():
        if path is None:
            continue
        if path.resolve() in taken:
            raise InputError(
                f"--{option} would write over {path}, {taken[path.resolve()]}",
                expected="a file of its own",
                remedy=f"give another --{option}",
            )
        taken[path.resolve()] = f"which is --{option}"


def in_options(text: str, parameters: Iterable[str] | None = None) -> str:
    """A sentence with each of its ``parameters``, named as a caller in Python writes them, as an option of a command.

    Without ``parameters`` those that findings name. A parameter that ends with its "=" stands before any value.

    >>> in_options("ask for window_s=4.2, or go on with sensor_check=False", ["window_s=4.2", "sensor_check=False"])
    'ask for --window-s 4.2, or go on with --no-sensor-check'
    >>> in_options("compare others (models=P3,P3D)", ["models="])
    'compare others (--models P3,P3D)'
    """
    from calibration.words import SPOKEN

    for parameter in SPOKEN if parameters is None else parameters:
        name, _, value = parameter.partition("=")
        option = OPTIONS.get(parameter) or OPTIONS.get(name) or f"--{name.replace('_', '-')}"
        if value == "False":
            option = option.replace("--", "--no-", 1)
        elif parameter not in OPTIONS and value != "True":
            option = f"{option} {value}"
        told = option if parameter.endswith("=") else option.rstrip()
        alone = rf"(?<![\w/.-]){re.escape(parameter)}" + ("" if parameter.endswith("=") else r"(?!\w)")  # not of a path
        text = re.sub(alone, lambda _, told=told: told, text)  # type: ignore[misc]
    return text


def in_one_line(what: str, findings: Iterable[Finding]) -> None:
    """One line on standard error that tells of the first finding above a note, also under --quiet and --json."""
    from calibration.finding import doubts, once

    asking = doubts(once(findings))
    if asking:
        more = f" (and {len(asking) - 1} more)" if len(asking) > 1 else ""
        print(f"tcdyn: {what}: look: {printable(in_options(asking[0].sentence))}{more}", file=sys.stderr)


def end(what: str, findings: Iterable[Finding]) -> None:
    """End with 1 where something asks for a look, told in one line on standard error; with 0 otherwise."""
    from calibration.finding import doubts

    asking = doubts(findings)
    if asking:
        in_one_line(what, asking)
        raise typer.Exit(1)


def dump(data: Any) -> str:
    """JSON as all files and ``--json`` write it: what is not a number is null."""
    from calibration.result import json_text

    return json_text(data)


def rich_table(rows: pd.DataFrame, title: str = "") -> Table:
    """A table for the terminal: words left, numbers right."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for k, name in enumerate(rows.columns):
        table.add_column(escape(str(name)), justify="left" if k == 0 else "right")
    for row in rows.itertuples(index=False):
        table.add_row(*(escape(str(v)) for v in row))
    return table
