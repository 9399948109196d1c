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

from tcdyn.cli import debug
from tcdyn.cli.streams import json_for_stream
from tcdyn.core.errors import InputError, Value, printable
from tcdyn.core.findings import Finding, Severity, unique

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOT_TRUSTED = 1  # exit code without a result to be trusted
OPTIONS = {  # option of a parameter, where it is not --NAME with dashes
    "records": "--record",
    "sensors": "--sensor",
    "taus_s": "--tau-s",
    "start_s": "--covariance-from-s",
    "models": "--model",
}
# Endings of pictures that matplotlib writes and the commands allow, and their option.
PICTURES = (".png", ".svg", ".pdf")
_PICTURE = typer.Option("--picture", help="picture to write: .png, .svg or .pdf")
Picture = Annotated[Path, _PICTURE]
OptionalPicture = Annotated[Path | None, _PICTURE]
RigFile = Annotated[
    Path | None, typer.Option("--rig", help="rig.toml; without it the defaults are used")
]
RigFileOrRecords = Annotated[
    Path | None,
    typer.Option("--rig", help="rig.toml; without it the rig stored in the records is used"),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print warnings and errors only")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="print a line for each stage, with the elapsed time")
]
Json = Annotated[bool, typer.Option("--json", help="print the result as JSON")]
Strict = Annotated[bool, typer.Option("--strict", help="exit with code 1 if there is a warning")]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite", help="replace an existing output also if it was not made from this input"
    ),
]
Debug = Annotated[
    bool,
    typer.Option(
        "--debug", help="after an internal error, write a file with what its report needs"
    ),
]
# The option of disk records, required or not.
RECORD = typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")
RecordFiles = Annotated[list[Path], RECORD]
OptionalRecordFiles = Annotated[list[Path] | None, RECORD]


def as_option(name: str, value: Value = None) -> str:
    """A parameter of a message as the option of a command.

    Parameters
    ----------
    name
        Name of a parameter in a message.
    value
        Its value, or several for a repeated option; None: the option without a value.

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
    if isinstance(value, list):
        return " ".join(f"{option} {each}" for each in value)
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
    """Output of a command: text, JSON, or nothing but warnings and errors; and its exit code.

    Attributes
    ----------
    json_
        Print the result as JSON.
    quiet
        Print warnings and errors only.
    strict
        Exit with code 1 if there is a warning.
    overwrite
        Whether the command may replace files that were not made from its inputs.
    debug
        Whether an internal error writes a file (:mod:`tcdyn.cli.debug`).
    """

    json_: Json = False
    quiet: Quiet = False
    strict: Strict = False
    overwrite: Overwrite = False
    debug: Debug = False

    def __post_init__(self) -> None:
        """Let ``tcdyn.cli.app.run`` know of ``--debug``."""
        debug.is_on.set(self.debug)

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
            print(json_for_stream(dump(data()), sys.stdout), end="")

    def summary(self, text: str) -> None:
        """Print the summary of a result without its findings, which :meth:`report` prints.

        Parameters
        ----------
        text
            Lines; those of findings begin with their severity.
        """
        labels = tuple(f"{severity.value}: " for severity in Severity)
        lines = text.split("\n")
        self.text("\n".join(line for line in lines if not line.lstrip().startswith(labels)))

    def report(
        self, name: str, findings: Iterable[Finding], conclusions: Iterable[Finding] = ()
    ) -> bool:
        """Print each finding on standard error; silent output leaves out the infos.

        Parameters
        ----------
        name
            Log, record or disk that the findings are about.
        findings
            Findings of the command.
        conclusions
            Findings that the summary contains; they are printed only if it is not.

        Returns
        -------
        bool
            Whether the result is to be trusted: no error, and with ``--strict`` no warning.
        """
        if self.is_silent:
            findings = (*findings, *conclusions)
            conclusions = ()
        printed = unique(findings)
        for finding in printed:
            if finding.severity is Severity.INFO and self.is_silent:
                continue
            message = finding.message(as_option)
            subject = "" if name in message else f"{name}: "
            print(f"{finding.severity.value}: {printable(subject + message)}", file=sys.stderr)
        severities = {finding.severity for finding in (*printed, *conclusions)}
        if self.strict and Severity.WARNING in severities:
            return False
        return Severity.ERROR not in severities

    def finish(
        self, name: str, findings: Iterable[Finding], conclusions: Iterable[Finding] = ()
    ) -> None:
        """Print the findings; exit with code 1 if the result is not to be trusted.

        Parameters
        ----------
        name, findings, conclusions
            As of :meth:`report`.

        Raises
        ------
        typer.Exit
            With code 1.
        """
        if not self.report(name, findings, conclusions):
            raise typer.Exit(NOT_TRUSTED)

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

    # not Console.is_terminal: notebooks set FORCE_COLOR, which it takes for a terminal
    return Console(stderr=True) if sys.stderr.isatty() else None


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
    from rich.markup import escape
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda stage: bar.update(task, description=escape(printable(stage)))


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
    from rich.markup import escape
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
            task, completed=done, total=count, description=escape(printable(name))
        )


def check_outputs(
    inputs: Iterable[Path | str | None], overwrite: bool, **outputs: Path | None
) -> None:
    """Check, before any work, that no output is an input, another output, or a file to protect.

    Parameters
    ----------
    inputs
        Files that are read; None where an option was not given.
    overwrite
        Whether an output may replace a file that was not made from the inputs.
    **outputs
        Files to write, by their options without the dashes; None where an option was not given.

    Raises
    ------
    InputError
        If an output is one of the other files under any name, has no name, or may not be replaced
        (``tcdyn.io.write.check_may_replace``).

    Examples
    --------
    >>> check_outputs([None, "log.csv"], False, out=Path("done.csv"), report=None)
    """
    from tcdyn.io.write import check_may_replace, file_identity

    files = [path for path in inputs if path is not None]
    uses = {file_identity(path): "which is read" for path in files}
    for option, path in outputs.items():
        if path is None:
            continue
        if not path.name:
            raise InputError(f"--{option} is {path}, a folder", expected="a file to write")
        file = file_identity(path)
        if file in uses:
            raise InputError(
                f"--{option} would write over {path}, {uses[file]}",
                expected="another file",
                remedy=f"change --{option}",
            )
        uses[file] = f"which is --{option}"
        check_may_replace(path, files, overwrite)


def check_folder(out: Path) -> None:
    """Check that the folder of a campaign is no file, and not the root of a file system.

    Parameters
    ----------
    out
        Folder to write; it need not exist.

    Raises
    ------
    InputError
        For another path.

    Examples
    --------
    >>> check_folder(Path("results"))
    """
    full = Path(os.path.abspath(out))
    if full == Path(full.anchor):
        raise InputError(
            f"--out is {out}, the root of the file system",
            expected="a folder for the files of this command",
        )
    if full.exists() and not full.is_dir():
        raise InputError(f"--out is {out}, which is not a folder", expected="a folder to write")


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


def dump(data: Any) -> str:
    """Text of a JSON file, as for all files and ``--json``; NaN is null."""
    from tcdyn.core.result import json_text

    return json_text(data)


def source_entry(path: Path) -> dict[str, str]:
    """The entry "source" of a JSON result: name and checksum of the file that it was made from."""
    from tcdyn.io.read import sha256

    return {"file": path.name, "sha256": sha256(path)}


def check_picture(picture: Path | None, inputs: Iterable[Path | None], overwrite: bool) -> None:
    """Raise InputError for a picture of another format, or one that is an input.

    Parameters
    ----------
    picture
        Picture to write; None: none.
    inputs
        Files that the command reads.
    overwrite
        Whether it may replace a file.
    """
    if picture is None:
        return
    if picture.suffix.lower() not in PICTURES:
        raise InputError(
            f"--picture is {picture}", expected=f"a name ending in {', '.join(PICTURES)}"
        )
    check_outputs(inputs, overwrite, picture=picture)


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
