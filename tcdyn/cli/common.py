"""What the commands share: options, progress and how numbers are printed."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

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
RecordFiles = Annotated[list[Path], typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")]

OptionalRecordFiles = Annotated[
    list[Path] | None, typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")
]

TYPICAL: dict[str, dict[str, float]] = {  # seconds of each stage, in order, measured once: their ratios are what counts
    "calibrate": {"static lines": 0.1, "plunge": 0.2, "grey-box fit": 7.5, "other chain": 11.0},
    "compensate": {"reading": 1.3, "common lags": 4.4, "junctions": 4.5, "writing": 1.4, "report": 2.2},
    "deconvolve": {"reading": 1.7, "common lags": 4.5, "junctions": 70, "writing": 0.6, "report": 2.2},
    "beta": {"reading": 5.0, "sensor map": 4.6, "steady": 0.3, "joint fits": 2.2, "other structures": 0.6,
             "compensation": 0.9, "cooling fit, fast": 0.9, "cooling fit, slow": 4.0, "writing the report": 15.0},
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


@contextmanager
def stages(quiet: bool, verbose: bool = False, command: str = "", page: bool = True) -> Iterator[Callable[[str], None]]:
    """A function to call with each stage's name; on a terminal it shows as a spinner with time gone by and time left.

    With ``verbose`` every stage stays on a line of its own, and the last one says how long all took. ``command``: whose
    stages these are, of ``TYPICAL``; ``page``: whether it writes a report.
    """
    console = Console(stderr=True, quiet=quiet)
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
    if quiet or not console.is_terminal:
        yield (lambda what: None) if quiet else (lambda what: print(f"... {printable(what)}", file=sys.stderr))
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
    console = Console(stderr=True, quiet=quiet)
    if quiet or not console.is_terminal:
        yield (
            (lambda *_: None)
            if quiet
            else (lambda name, n, m: print(f"... {n} of {m}: {printable(name)}", file=sys.stderr))
        )
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )  # fmt: skip

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, transient=True) as bar:
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


def say(text: str, quiet: bool = False) -> None:
    """Print plain words unless quiet."""
    if not quiet:
        print("\n".join(map(printable, text.split("\n"))))


def warn(findings: Iterable[Finding], quiet: bool = False) -> None:
    """Print each finding on standard error, its grade in front: note, look or refuse."""
    from calibration.finding import once

    for found in () if quiet else once(findings):
        sentence = printable(in_options(found.sentence))
        print(f"{found.grade.value}: {sentence}", file=sys.stderr)


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
    from calibration.result import jsonable

    return json.dumps(jsonable(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


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
