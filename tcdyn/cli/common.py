"""Options, output on the terminal, progress and exit codes that the commands share.

Used by every command. ``Reporter`` decides what goes to standard output and what to standard error.
Tests: ``tests/cli/test_progress.py`` and ``tests/cli/test_options.py``.
"""

from __future__ import annotations

import inspect
import os
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
from tcdyn.core.findings import Finding, unique, warnings_and_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OPTIONS = {  # option of a parameter, where it is not --NAME with dashes
    "records": "--record",
    "sensors": "--sensor",
    "taus_s": "--tau-s",
    "dt_s": "--dt",
    "resample_s": "--resample",
    "start_s": "--covariance-from-s",
}
# Endings of pictures that matplotlib writes and the commands allow, and their option.
PICTURES = (".png", ".svg", ".pdf")
Picture = typer.Option(help="picture to write: .png, .svg or .pdf")
RigFile = Annotated[
    Path | None, typer.Option("--rig", help="rig.toml; without it the defaults are used")
]
RigFileOrRecords = Annotated[
    Path | None,
    typer.Option("--rig", help="rig.toml; without it the rig stored in the records is used"),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print errors only")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="print a line for each stage, with the elapsed time")
]
Json = Annotated[bool, typer.Option("--json", help="print the result as JSON")]
# The option of disk records, required or not.
RECORD = typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")
RecordFiles = Annotated[list[Path], RECORD]
OptionalRecordFiles = Annotated[list[Path] | None, RECORD]


def as_option(name: str, value: str | bool | None = None) -> str:
    """A parameter of a message as the option of a command.

    Parameters
    ----------
    name
        Name of a parameter in a message.
    value
        Its value; None: the option without a value.

    Notes
    -----
    ``OPTIONS`` has the options whose name is not that of the parameter; a new one that differs must
    be added there, or messages name an option that does not exist.

    Examples
    --------
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


def option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Decorator: parameters of a command that are dataclasses become one option for each field.

    Parameters
    ----------
    command
        Function with dataclass parameters.

    Returns
    -------
    command
        Function with one option for each field, for Typer.

    Notes
    -----
    Typer makes options from the signature of a command. The signature given here has the fields of
    each dataclass in place of the dataclass; a call builds the dataclasses from them.
    """
    parameters = inspect.signature(command, eval_str=True).parameters.values()
    signature = [p for p in parameters if not is_dataclass(p.annotation)]
    groups: dict[str, Any] = {
        p.name: p.annotation for p in parameters if is_dataclass(p.annotation)
    }
    fields = {
        name: inspect.signature(group, eval_str=True).parameters for name, group in groups.items()
    }

    @wraps(command)
    def call_with_groups(*arguments: Any, **options: Any) -> None:
        """Build the dataclasses from the options and call the command."""
        for name, group in groups.items():
            values = {field: options.pop(field) for field in fields[name] if field in options}
            options[name] = group(**values)
        command(*arguments, **options)

    for members in fields.values():
        for field in members.values():
            signature.append(field.replace(kind=inspect.Parameter.KEYWORD_ONLY))
    call_with_groups.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    return call_with_groups


@dataclass(frozen=True)
class Reporter:
    """Output of a command: text, JSON, or nothing but errors.

    Attributes
    ----------
    json_
        Print the result as JSON.
    quiet
        Print errors only.
    """

    json_: Json = False
    quiet: Quiet = False

    @property
    def is_silent(self) -> bool:
        """Whether no text is printed."""
        return self.json_ or self.quiet

    def text(self, text: str) -> None:
        """Print text, unless silent.

        Parameters
        ----------
        text
            Lines; control characters are replaced.
        """
        if not self.is_silent:
            print("\n".join(map(printable, text.split("\n"))))

    def json(self, data: Callable[[], Any]) -> None:
        """Print the value of ``data()`` as JSON, with ``--json``.

        Parameters
        ----------
        data
            Function that is called only with ``--json``, since its value may take time.
        """
        if self.json_:
            print(dump(data()), end="")

    def findings(self, findings: Iterable[Finding]) -> None:
        """Print each finding on standard error, its severity in front, unless silent."""
        if self.is_silent:
            return
        for finding in unique(findings):
            message = printable(finding.message(as_option))
            print(f"{finding.severity.value}: {message}", file=sys.stderr)

    def files(self, **written: Path | None) -> None:
        """Print the paths of the files that were written, each after what it contains."""
        for content, path in written.items():
            if path is not None:
                self.text(f"{content}: {path}")


def in_range(
    low: float, high: float, *, ends: bool = True
) -> Callable[[typer.CallbackParam, Any], Any]:
    """Callback of an option: its numbers must lie from ``low`` to ``high``, and not be NaN.

    Parameters
    ----------
    low, high
        Limits.
    ends
        Whether the limits themselves are allowed.

    Returns
    -------
    callback
        For ``typer.Option``; it raises InputError for a number out of range.
    """

    def is_allowed(number: float) -> bool:
        """Whether a number is within the limits; False for NaN."""
        return low <= number <= high if ends else low < number < high

    def check(param: typer.CallbackParam, value: Any) -> Any:
        """Check one number or a list of them, and return it."""
        numbers = value if isinstance(value, list | tuple) else [value]
        for number in numbers:
            if number is not None and not is_allowed(number):
                expected = f"{low:g} to {high:g}" if ends else f"above {low:g} and below {high:g}"
                raise InputError(f"{param.opts[0]} is {number:g}", expected=expected)
        return value

    return check


def number_option(
    option: str, help_text: str, low: float, high: float, *other_names: str, ends: bool = True
) -> Any:
    """An option whose numbers must lie within limits.

    Parameters
    ----------
    option
        Name of the option, with dashes.
    help_text
        Its help.
    low, high
        Limits.
    *other_names
        Other names of the option, with dashes.
    ends
        Whether the limits themselves are allowed.

    Returns
    -------
    option
        Option with the callback of :func:`in_range`.
    """
    callback = in_range(low, high, ends=ends)
    return typer.Option(option, *other_names, help=help_text, callback=callback)


def check_choice(option: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise InputError for a value that is none of ``allowed``.

    Parameters
    ----------
    option
        Name of the option, with dashes.
    value
        What the user wrote.
    allowed
        Possible values.
    """
    if value not in allowed:
        raise InputError(f"{option} is {value!r}", expected=" or ".join(allowed))


def _check_disk(value: str) -> str:
    """Callback of an option that names a disk of the rig."""
    from tcdyn.rig.disk import DISKS

    check_choice("--disk", value, DISKS)
    return value


Disk = Annotated[str, typer.Option(help="fast or slow", callback=_check_disk)]


def _terminal() -> Any:
    """Standard error where it is a terminal, None elsewhere."""
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        return console
    return None


@contextmanager
def stage_progress(quiet: bool, verbose: bool = False) -> Iterator[Callable[[str], None]]:
    """Yield a function to call with the name of each stage when it begins.

    Parameters
    ----------
    quiet
        Print nothing.
    verbose
        Print each stage on a line of its own with the time at which it began, and at the end the
        total time. Otherwise a terminal shows the current stage and the elapsed time, and anything
        else gets a line for each stage.
    """
    if quiet:
        yield lambda stage: None
        return
    if verbose:
        start_s = monotonic()

        def print_line(stage: str) -> None:
            """Print a stage with the elapsed time."""
            print(f"... {monotonic() - start_s:6.1f} s  {printable(stage)}", file=sys.stderr)

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
def count_progress(
    total: int | None, quiet: bool = False
) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function of (name, number done, total number).

    A terminal shows a bar with the remaining time, anything else gets a line for each call.

    Parameters
    ----------
    total
        Total number; None: not known.
    quiet
        Print nothing.
    """
    if quiet:
        yield lambda name, done, count: None
        return
    console = _terminal()
    if console is None:
        yield lambda name, done, count: print(
            f"... {done} of {count}: {printable(name)}", file=sys.stderr
        )
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=total)
        yield lambda name, done, count: bar.update(
            task, completed=done, total=count, description=name
        )


def check_outputs(inputs: Iterable[Path | str | None], **outputs: Path | None) -> None:
    """Check, before any work, that no output is an input under any name, or another output.

    Parameters
    ----------
    inputs
        Files that are read; None where an option was not given.
    **outputs
        Files to write, by their options without the dashes; None where an option was not given.

    Raises
    ------
    InputError
        If an output is one of the other files, or has no name.

    Examples
    --------
    >>> check_outputs([None, "log.csv"], out=Path("done.csv"), report=None)
    """
    # realpath and not resolve, which raises RuntimeError for links in a circle
    uses = {os.path.realpath(path): "which is read" for path in inputs if path is not None}
    for option, path in outputs.items():
        if path is None:
            continue
        file = os.path.realpath(path)
        if not path.name:
            raise InputError(f"--{option} is {path}, a folder", expected="a file to write")
        if file in uses:
            raise InputError(
                f"--{option} would write over {path}, {uses[file]}",
                expected="another file",
                remedy=f"change --{option}",
            )
        uses[file] = f"which is --{option}"


def beside(file: Path, ending: str) -> Path:
    """The default output: the name of the input with another ending.

    Parameters
    ----------
    file
        File that is read.
    ending
        What replaces its ending.

    Raises
    ------
    InputError
        If it has no name.

    Examples
    --------
    >>> beside(Path("log.csv"), ".identified.json").name
    'log.identified.json'
    """
    if not file.name:
        raise InputError(f"{file} is a folder", expected="a file")
    return file.with_suffix(ending)


def print_first_warning(name: str, findings: Iterable[Finding]) -> bool:
    """Print the first warning or error on standard error, also under --quiet and --json.

    Parameters
    ----------
    name
        Name of the log or record, in front of the message.
    findings
        Findings of the command.

    Returns
    -------
    bool
        Whether there is a finding more serious than an info.
    """
    serious = warnings_and_errors(unique(findings))
    if not serious:
        return False
    message = printable(serious[0].message(as_option))
    others = f" (and {len(serious) - 1} more)" if len(serious) > 1 else ""
    print(f"tcdyn: {name}: warning: {message}{others}", file=sys.stderr)
    return True


def exit_status(name: str, findings: Iterable[Finding]) -> None:
    """Exit with code 1 if there is a warning or an error; the first one is printed.

    Parameters
    ----------
    name
        Name of the log or record, in front of the message.
    findings
        Findings of the command.
    """
    if print_first_warning(name, findings):
        raise typer.Exit(1)


def dump(data: Any) -> str:
    """Text of a JSON file, as for all files and ``--json``; NaN is null."""
    from tcdyn.core.result import json_text

    return json_text(data)


def check_picture(out: Path | None, inputs: Iterable[Path | None]) -> None:
    """Raise InputError for a picture of another format, or one that is an input.

    Parameters
    ----------
    out
        Picture to write; None: none.
    inputs
        Files that the command reads.
    """
    if out is None:
        return
    if out.suffix.lower() not in PICTURES:
        raise InputError(f"--out is {out}", expected=f"a name ending in {', '.join(PICTURES)}")
    check_outputs(inputs, out=out)


def save_picture(picture: Figure, out: Path) -> None:
    """Save a picture; an interrupted write leaves the old file.

    Parameters
    ----------
    picture
        The figure.
    out
        File to write.
    """
    from tcdyn.io.write import atomic_path

    with atomic_path(out) as temporary:
        picture.savefig(temporary, dpi=150)
