"""What the commands share: options, answers, and how far a command is."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from functools import wraps
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.errors import InputError, printable

if TYPE_CHECKING:
    from calibration.finding import Finding

OPTIONS = {  # of parameters, where it is not the name with dashes
    "records": "--record", "dt_s": "--dt", "resample_s": "--resample", "start_s": "--covariance-from-s",
    "loss=huber": "--robust",
}  # fmt: skip
RigFile = Annotated[Path | None, typer.Option("--rig", help="rig.toml; without it the design's defaults")]
OWN_RIG = typer.Option("--rig", help="rig.toml; without it the one that the records were made with")
OwnRigFile = Annotated[Path | None, OWN_RIG]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="a line for each stage, with the time gone by")]
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


def one_disk(value: str) -> str:
    """Callback of an option that names a disk of the rig."""
    from calibration.disk import DISKS

    check_choice("--disk", value, DISKS)
    return value


Disk = Annotated[str, typer.Option(help="fast or slow", callback=one_disk)]

TYPICAL: dict[str, dict[str, float]] = {  # seconds of each stage, in order, measured once: their ratios are what counts
    "calibrate": {"static lines": 0.05, "plunge": 0.05, "grey-box fit": 0.7, "other chain": 0.7},
    "compensate": {"reading": 0.25, "common lags": 0.6, "junctions": 0.85, "writing": 0.3, "report": 0.7},
    "deconvolve": {"reading": 1.7, "common lags": 4.5, "junctions": 70, "writing": 0.6, "report": 2.2},
    "beta": {"reading": 0.75, "sensor map": 0.3, "steady": 0.1, "joint fits": 0.2, "other structures": 0.35,
             "writing the report": 1.5},
    "one disk": {"reading": 3.1, "sensor map": 2.2, "joint fit": 2.9, "cooling fit": 1.6, "writing the report": 5.0},
    "demo": {"simulat": 15.0, "calibrating": 50.0, "compensating": 38.0, "writing the report": 20.0},
}  # fmt: skip
LEAST_DONE = 0.05  # share of a command that must be done before the rest can be told from it


class TimeLeft:
    """What a command still takes, by what its stages ``typically`` take [s] against what those done took here.

    Stages are known by how their names begin; ``test 2 of 3: joint fits`` tells that one more test follows. Of a log
    with several tests the others are not yet known during the first.
    """

    def __init__(self, typically: Mapping[str, float], clock: Callable[[], float] = monotonic) -> None:
        self.typically, self.clock = typically, clock
        self.stage, self.begun, self.took, self.worth, self.tests = "", clock(), 0.0, 0.0, 0

    def begin(self, what: str) -> None:
        """Tell that the stage ``what`` begins."""
        test = re.match(r"test (\d+) of (\d+): ", what)
        name = what[test.end() :] if test else what
        stage = next((s for s in self.typically if name.startswith(s)), self.stage)
        self.tests = int(test[2]) - int(test[1]) if test else self.tests
        if stage != self.stage:
            if self.stage:
                self.took, self.worth = self.took + self.clock() - self.begun, self.worth + self.typically[self.stage]
            self.stage, self.begun = stage, self.clock()

    def left_s(self) -> float | None:
        """Seconds that are left; None while too little is done to tell."""
        if self.worth <= LEAST_DONE * sum(self.typically.values()):
            return None
        rate, names = self.took / self.worth, list(self.typically)
        ahead = sum(self.typically[s] for s in names[names.index(self.stage) + 1 :])
        again = self.tests * sum(t for s, t in self.typically.items() if "report" not in s)
        return rate * (ahead + again) + max(rate * self.typically[self.stage] - self.clock() + self.begun, 0.0)

    def __str__(self) -> str:
        """What is left in words, to five seconds; empty while nothing can be told."""
        left = self.left_s()
        if left is None:
            return ""
        return f"about {left / 60:.0f} min left" if left > 100 else f"about {max(5 * round(left / 5), 5)} s left"


def _terminal() -> Any:
    """Standard error where it is a terminal, None elsewhere."""
    from rich.console import Console

    console = Console(stderr=True)
    return console if console.is_terminal else None


@contextmanager
def stages(quiet: bool, verbose: bool = False, command: str = "", page: bool = True) -> Iterator[Callable[[str], None]]:
    """A function to call with each stage's name; on a terminal it shows as a spinner with time gone by and time left.

    With ``verbose`` every stage stays on a line of its own, and the last one says how long all took. ``command``: whose
    stages these are, of ``TYPICAL``; ``page``: whether it writes a report.
    """
    left = TimeLeft({s: t for s, t in TYPICAL.get(command, {}).items() if page or "report" not in s})
    if verbose and not quiet:
        begin = monotonic()

        def line(what: str) -> None:
            left.begin(what)
            said = ", ".join(x for x in (what, str(left)) if x)
            print(f"... {monotonic() - begin:6.1f} s  {printable(said)}", file=sys.stderr)

        yield line
        print(f"... {monotonic() - begin:6.1f} s  done", file=sys.stderr)
        return
    if quiet or (console := _terminal()) is None:
        yield lambda what: None if quiet else print(f"... {printable(what)}", file=sys.stderr)
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[left]}"), console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None, left=left)  # asked anew at each refresh

        def shown(what: str) -> None:
            left.begin(what)
            bar.update(task, description=what)

        yield shown


@contextmanager
def counted(total: int | None, quiet: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A function of (name, done, in all): on a terminal a bar with the time left, a line for each elsewhere."""
    if quiet or (console := _terminal()) is None:
        yield lambda name, n, m: None if quiet else print(f"... {n} of {m}: {printable(name)}", file=sys.stderr)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("left"), Remaining(), console=console, transient=True) as bar:
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


def in_one_line(what: str, findings: Iterable[Finding]) -> bool:
    """Whether a finding is above a note; one line on standard error tells the first, also under --quiet and --json."""
    from calibration.finding import doubts, once

    if asking := doubts(once(findings)):
        more = f" (and {len(asking) - 1} more)" if len(asking) > 1 else ""
        print(f"tcdyn: {what}: look: {printable(in_options(asking[0].sentence))}{more}", file=sys.stderr)
    return bool(asking)


def end(what: str, findings: Iterable[Finding]) -> None:
    """End with 1 where something asks for a look, told in one line on standard error; with 0 otherwise."""
    if in_one_line(what, findings):
        raise typer.Exit(1)


def dump(data: Any) -> str:
    """JSON as all files and ``--json`` write it: what is not a number is null."""
    from calibration.result import json_text

    return json_text(data)
