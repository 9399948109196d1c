"""What the commands share: options, answers, and progress."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from functools import wraps
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.core.errors import InputError, printable

if TYPE_CHECKING:
    from tcdyn.core.findings import Finding

OPTIONS = {  # of parameters, where it is not the name with dashes
    "records": "--record",
    "sensors": "--sensor",
    "taus_s": "--tau-s",
    "dt_s": "--dt",
    "resample_s": "--resample",
    "start_s": "--covariance-from-s",
}
RigFile = Annotated[
    Path | None, typer.Option("--rig", help="rig.toml; without it the design's defaults")
]
OWN_RIG = typer.Option("--rig", help="rig.toml; without it the one that the records were made with")
OwnRigFile = Annotated[Path | None, OWN_RIG]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="a line for each stage, with the time gone by")
]
Json = Annotated[bool, typer.Option("--json", help="print the result as JSON instead of words")]
RECORD = typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")
RecordFiles = Annotated[list[Path], RECORD]
OptionalRecordFiles = Annotated[list[Path] | None, RECORD]


def as_option(name: str, value: str | bool | None = None) -> str:
    """A parameter of a message as the option of a command.

    >>> as_option("window_s", "4.2"), as_option("sensor_check", False), as_option("overwrite", True)
    ('--window-s 4.2', '--no-sensor-check', '--overwrite')
    >>> as_option("records", "fast.disk.json"), as_option("out"), as_option("loss", "huber")
    ('--record fast.disk.json', '--out', '--robust')
    """
    if (name, value) == ("loss", "huber"):
        return "--robust"
    option = OPTIONS.get(name, f"--{name.replace('_', '-')}")
    if value is False:
        return option.replace("--", "--no-", 1)
    if value is None or value is True:
        return option
    return f"{option} {value}"


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameters that are dataclasses become options, one for each of their fields.

    Typer makes options of the parameters in a command's signature. The signature given here has the fields of each
    dataclass in the place of the dataclass; a call makes the dataclasses of them again.
    """
    parameters = inspect.signature(command, eval_str=True).parameters.values()
    plain = [p for p in parameters if not is_dataclass(p.annotation)]
    groups: dict[str, Any] = {
        p.name: p.annotation for p in parameters if is_dataclass(p.annotation)
    }
    fields = {
        name: inspect.signature(group, eval_str=True).parameters for name, group in groups.items()
    }

    @wraps(command)
    def with_groups(*arguments: Any, **options: Any) -> None:
        for name, group in groups.items():
            own = {field: options.pop(field) for field in fields[name] if field in options}
            options[name] = group(**own)
        command(*arguments, **options)

    for members in fields.values():
        plain += [field.replace(kind=inspect.Parameter.KEYWORD_ONLY) for field in members.values()]
    with_groups.__signature__ = inspect.Signature(plain)  # type: ignore[attr-defined]
    return with_groups


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
        """Print each finding on standard error, its severity in front: info, warning or error."""
        from tcdyn.core.findings import unique

        for found in () if self.silent else unique(findings):
            print(f"{found.severity.value}: {printable(found.message(as_option))}", file=sys.stderr)

    def files(self, **written: Path | None) -> None:
        """Name the files that were written, by what they hold."""
        for what, path in written.items():
            if path is not None:
                self.say(f"{what}: {path}")


def within(
    low: float, high: float, *, ends: bool = True
) -> Callable[[typer.CallbackParam, Any], Any]:
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


def one_disk(value: str) -> str:
    """Callback of an option that names a disk of the rig."""
    from tcdyn.rig.disk import DISKS

    check_choice("--disk", value, DISKS)
    return value


Disk = Annotated[str, typer.Option(help="fast or slow", callback=one_disk)]


def _terminal() -> Any:
    """Standard error where it is a terminal, None elsewhere."""
    from rich.console import Console

    console = Console(stderr=True)
    return console if console.is_terminal else None


@contextmanager
def stages(quiet: bool, verbose: bool = False) -> Iterator[Callable[[str], None]]:
    """A function to call with the name of each stage as it begins.

    On a terminal the stage shows beside the elapsed time. With ``verbose``, every stage stays on a line of its own with
    the time at which it began, and a last line says how long all took. Elsewhere each stage is a line.
    """
    if quiet:
        yield lambda stage: None
        return
    if verbose:
        begin = monotonic()

        def print_line(stage: str) -> None:
            print(f"... {monotonic() - begin:6.1f} s  {printable(stage)}", file=sys.stderr)

        yield print_line
        print_line("done")
        return
    console = _terminal()
    if console is None:
        yield lambda stage: print(f"... {printable(stage)}", file=sys.stderr)
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda stage: bar.update(task, description=stage)


@contextmanager
def counted(total: int | None, quiet: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A function of (name, done, in all): on a terminal a bar with the time left, a line for each elsewhere."""
    if quiet:
        yield lambda name, n, m: None
        return
    console = _terminal()
    if console is None:
        yield lambda name, n, m: print(f"... {n} of {m}: {printable(name)}", file=sys.stderr)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(
        *columns, TextColumn("left"), Remaining(), console=console, transient=True
    ) as bar:
        task = bar.add_task("starting", total=total)
        yield lambda name, n, m: bar.update(task, completed=n, total=m, description=name)


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


def in_one_line(what: str, findings: Iterable[Finding]) -> bool:
    """Whether a finding is above a note; one line on standard error tells the first, also under --quiet and --json."""
    from tcdyn.core.findings import unique, warnings_and_errors

    asking = warnings_and_errors(unique(findings))
    if asking:
        more = f" (and {len(asking) - 1} more)" if len(asking) > 1 else ""
        print(
            f"tcdyn: {what}: warning: {printable(asking[0].message(as_option))}{more}",
            file=sys.stderr,
        )
    return bool(asking)


def end(what: str, findings: Iterable[Finding]) -> None:
    """End with 1 where something asks for a look, told in one line on standard error; with 0 otherwise."""
    if in_one_line(what, findings):
        raise typer.Exit(1)


def dump(data: Any) -> str:
    """JSON as all files and ``--json`` write it: what is not a number is null."""
    from tcdyn.core.result import json_text

    return json_text(data)
