"""Options, output on the terminal, progress and exit codes that the commands share.

Used by every command. ``options_from_docstring`` makes the options of a command from its signature
and docstring. ``Reporter`` decides what goes to standard output and what to standard error. Tests:
``tests/cli/test_progress.py`` and ``tests/cli/test_options.py``.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.models import OptionInfo

from tcdyn.cli import debug
from tcdyn.cli.streams import json_for_stream
from tcdyn.core.errors import InputError, Value, printable
from tcdyn.core.findings import Finding, Severity, unique
from tcdyn.core.options import PANELS, default_of, option, option_kind, split_docstring, texts_of
from tcdyn.io.endings import PICTURE, FileKind, check_ending

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOT_TRUSTED = 1  # exit code without a result to be trusted
OPTIONS = {  # option of a parameter, where it is not --NAME with dashes
    "records": "--record",
    "sensors": "--sensor",
    "dates": "--date",
    "taus_s": "--tau-s",
    "start_s": "--covariance-from-s",
    "models": "--model",
}
_PICTURE = typer.Option(help="picture to write: .png, .svg or .pdf", rich_help_panel="Output")
Picture = Annotated[Path, _PICTURE]
OptionalPicture = Annotated[Path | None, _PICTURE]
# Limits of temperatures [degC] that fluids and thermocouples of the rig stand.
LOWEST_DEGC, HIGHEST_DEGC = -60.0, 400.0
# A file to write; the docstring of the command states what it contains.
OutFile = Annotated[Path | None, typer.Option(rich_help_panel="Output")]
RigFile = Annotated[
    Path | None,
    typer.Option(help="rig.toml; without it the defaults are used", rich_help_panel="Two-disk rig"),
]
RigFileOrRecords = Annotated[
    Path | None,
    typer.Option(
        help="rig.toml; without it the rig stored in the records is used",
        rich_help_panel="Two-disk rig",
    ),
]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        help="print a line for each stage, with the elapsed time",
        rich_help_panel="Output",
    ),
]
RecordFiles = Annotated[
    list[Path],
    typer.Option(
        help="*.disk.json of a disk; give it once for each disk", rich_help_panel="Two-disk rig"
    ),
]


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
    >>> as_option("where", "Channel=CH 1")
    '--where "Channel=CH 1"'
    """
    if (name, value) == ("loss", "huber"):
        return "--robust"
    option = OPTIONS.get(name, f"--{name.replace('_', '-')}")
    if value is False:
        return option.replace("--", "--no-", 1)
    if value is None or value is True:
        return option
    if isinstance(value, list):
        return " ".join(f"{option} {_quoted(each)}" for each in value)
    return f"{option} {_quoted(str(value))}"


def _quoted(word: str) -> str:
    """A word of a command as a shell takes it for one.

    Double quotes do so in all shells; characters that a shell replaces within them need single
    quotes.

    >>> _quoted("T1 [K]"), _quoted("T$1"), _quoted("T1=K")
    ('"T1 [K]"', "'T$1'", 'T1=K')
    """
    quoted = shlex.quote(word)
    if quoted == word or re.fullmatch(r"[\w=.,:/+-]+", word):
        return word
    if re.search(r"[\"$`\\!]", word):
        return quoted
    return f'"{word}"'


def _with_options(text: str) -> str:
    """A text with options instead of parameters in braces, and without "[s]", a style of rich.

    >>> _with_options("interval [s]; without {time_unit}")
    'interval in seconds; without --time-unit'
    """
    text = text.replace("[s]", "in seconds")
    return re.sub(r"{(\w+)}", lambda match: as_option(match[1]), text)


def _as_typer_parameter(
    parameter: inspect.Parameter, help_texts: dict[str, str]
) -> inspect.Parameter:
    """A parameter of a command with its name and its text on the command line.

    A parameter without a default is an argument, unless its annotation has a ``typer.Option``.
    """
    name = parameter.name
    kind = parameter.annotation
    is_required = parameter.default is parameter.empty
    info = typer.Argument() if is_required else typer.Option()
    if get_origin(kind) is Annotated:
        kind, info = get_args(kind)
        info = copy(info)
    if info.default is ... and isinstance(info, OptionInfo):  # no name is given
        option_name = f"--{name.strip('_').replace('_', '-')}"
        info.param_decls = (_with_opposite(option_name, parameter.default),)
    info.help = info.help or help_texts[name]
    place = parameter.kind
    if isinstance(info, OptionInfo):
        place = inspect.Parameter.KEYWORD_ONLY
    return parameter.replace(annotation=Annotated[kind, info], kind=place)


def _place_in_help(parameter: inspect.Parameter) -> tuple[int, int]:
    """Key by which the parameters of a command are sorted: arguments first, then by panel."""
    _, info = get_args(parameter.annotation)
    panel = info.rich_help_panel
    return parameter.kind, PANELS.index(panel) if panel in PANELS else len(PANELS)


def _with_opposite(option_name: str, default: object) -> str:
    """The name of an option, with that of its opposite if it is on by default."""
    if default is True:
        return f"{option_name}/{option_name.replace('--', '--no-', 1)}"
    return option_name


def _field_as_parameter(each: Field[Any], annotation: Any, text: str) -> inspect.Parameter:
    """A field of a dataclass of options as a parameter of a command.

    Parameters
    ----------
    each
        The field.
    annotation
        Its type.
    text
        Its text.
    """
    kind = option_kind(each)
    default = default_of(each)
    if kind.takes is not None:
        annotation = kind.takes
        if default is not None:
            default = None if isinstance(default, tuple | dict) else str(default)
        if default is None or default == "":
            default = None
            annotation = annotation | None
    names = [_with_opposite(as_option(kind.name or each.name), default)]
    names += filter(None, [kind.short])
    info = typer.Option(*names, help=_with_options(text), rich_help_panel=kind.panel)
    is_required = default is MISSING
    return inspect.Parameter(
        each.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if is_required else default,
        annotation=Annotated[annotation, info],
    )


def options_from_docstring(command: Callable[..., None]) -> Callable[..., None]:
    """Decorator: a function with a docstring as of numpydoc becomes a command for Typer.

    Parameters
    ----------
    command
        Function whose docstring describes its parameters. A parameter that is a dataclass of
        options (:mod:`tcdyn.core.options`) becomes one option for each field.

    Returns
    -------
    command
        Function with the options of the command.

    Notes
    -----
    Typer makes options from the signature of a command. The signature given here has the fields of
    each dataclass in place of the dataclass, the name of each option, and its help from the
    docstring; a call builds the dataclasses. A field that two dataclasses share is one option.
    ``typer.Option`` in the annotation of a parameter states what its text does not.
    """
    text, help_texts = split_docstring(command)
    signature: dict[str, inspect.Parameter] = {}
    groups: dict[str, type[Any]] = {}
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        group: type[Any] = parameter.annotation
        if not is_dataclass(group):
            signature[parameter.name] = _as_typer_parameter(parameter, help_texts)
            continue
        groups[parameter.name] = group
        types = get_type_hints(group)
        texts = texts_of(group)
        for each in fields(group):
            parameter_of_field = _field_as_parameter(each, types[each.name], texts[each.name])
            signature.setdefault(each.name, parameter_of_field)

    @wraps(command)
    def call_with_groups(*arguments: Any, **options: Any) -> None:
        """Build the dataclasses from the options and call the command."""
        given = dict(options)
        for name, group in groups.items():
            values = {}
            for each in fields(group):
                options.pop(each.name, None)
                value = given.get(each.name)
                if value is not None and value != signature[each.name].default:
                    values[each.name] = value
            options[name] = group(**values)
        command(*arguments, **options)

    call_with_groups.__doc__ = text
    ordered = sorted(signature.values(), key=_place_in_help)
    call_with_groups.__signature__ = inspect.Signature(ordered)  # type: ignore[attr-defined]
    return call_with_groups


@dataclass(frozen=True)
class Reporter:
    """Output of a command: text, JSON, or nothing but warnings and errors; and its exit code.

    Attributes
    ----------
    json_
        print the result as JSON
    quiet
        print warnings and errors only
    strict
        exit with code 1 if there is a warning
    overwrite
        replace an existing output also if it was not made from this input
    debug
        after an internal error, write a file with what its report needs
    """

    json_: bool = option(False, "Output", name="json")
    quiet: bool = option(False, "Output", short="-q")
    strict: bool = option(False, "Output")
    overwrite: bool = option(False, "Output")
    debug: bool = option(False, "Output")

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
            from tcdyn.core.result import json_text

            print(json_for_stream(json_text(data()), sys.stdout), end="")

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


def _check_disk(value: str) -> str:
    """Callback of an option that names a disk of the rig."""
    from tcdyn.rig.disk import DISKS

    if value not in DISKS:
        raise InputError(f"--disk is {value!r}", expected=" or ".join(DISKS))
    return value


Disk = Annotated[
    str,
    typer.Option(help="fast or slow", callback=_check_disk, rich_help_panel="Two-disk rig"),
]


def _terminal_console() -> Any:
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
    console = _terminal_console()
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
    """Yield a function of (name, number done, total number); a total of 0 is not known.

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
    console = _terminal_console()
    if console is None:
        yield lambda name, done, count: print(
            f"... {done}{f' of {count}' if count else ''}: {printable(name)}", file=sys.stderr
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
            task, completed=done, total=count or None, description=escape(printable(name))
        )


def check_outputs(
    inputs: Iterable[Path | str | None],
    overwrite: bool,
    **outputs: tuple[Path | None, FileKind],
) -> None:
    """Check, before any work, that no output is an input, another output, or a file to protect.

    Its ending must also be one of the kind of file that will be written.

    Parameters
    ----------
    inputs
        Files that are read; None where an option was not given.
    overwrite
        Whether an output may replace a file that was not made from the inputs.
    **outputs
        Files to write and their kinds, by their options without the dashes; None for the file where
        an option was not given.

    Raises
    ------
    InputError
        If an output is one of the other files under any name, has no name, may not be replaced
        (``tcdyn.io.write.check_may_replace``), or has an ending of another kind.

    Examples
    --------
    >>> from tcdyn.io.endings import CSV, PAGE
    >>> check_outputs([None, "log.csv"], False, out=(Path("done.csv"), CSV), report=(None, PAGE))
    """
    from tcdyn.io.write import check_may_replace, file_identity

    files = [path for path in inputs if path is not None]
    uses = {file_identity(path): "which is read" for path in files}
    for name, (path, _) in outputs.items():
        if path is None:
            continue
        if not path.name:
            raise InputError(f"--{name} is {path}, a folder", expected="a file to write")
        file = file_identity(path)
        if file in uses:
            raise InputError(
                f"--{name} would write over {path}, {uses[file]}",
                expected="another file",
                remedy=f"change --{name}",
            )
        uses[file] = f"which is --{name}"
        check_may_replace(path, files, overwrite)
    for name, (path, kind) in outputs.items():
        if path is not None:
            check_ending(path, kind, f"--{name}")


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


def default_output_path(file: Path, ending: str) -> Path:
    """Path of the output of a command that is called without ``--out``.

    Parameters
    ----------
    file
        File that is read.
    ending
        What replaces its last suffix, with the dot.

    Returns
    -------
    path
        Path in the folder of the input. Only the last suffix is replaced.

    Raises
    ------
    InputError
        If the path has no file name.

    Examples
    --------
    >>> default_output_path(Path("log.csv"), ".identified.json").name
    'log.identified.json'
    >>> default_output_path(Path("log.filtered.csv"), ".identified.json").name
    'log.filtered.identified.json'
    """
    if not file.name:
        raise InputError(f"{file} is a folder", expected="a file")
    return file.with_suffix(ending)


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file, with the text that ``--json`` prints; NaN is null.

    Parameters
    ----------
    path
        The file.
    data
        Its content.
    """
    from tcdyn.core.result import json_text
    from tcdyn.io.write import write_text

    write_text(path, json_text(data))


def source_entry(path: Path) -> dict[str, str]:
    """The entry "source" of a JSON result: name and checksum of the file that it was made from."""
    from tcdyn.io.read import sha256_of_file

    return {"file": path.name, "sha256": sha256_of_file(path)}


def source_entries(paths: Sequence[Path]) -> dict[str, Any]:
    """The entry "source" of a JSON result, and with several files "sources" with all of them."""
    entries: dict[str, Any] = {"source": source_entry(paths[0])}
    if len(paths) > 1:
        entries["sources"] = [source_entry(path) for path in paths]
    return entries


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
    check_outputs(inputs, overwrite, picture=(picture, PICTURE))


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
