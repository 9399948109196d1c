"""How far a command is: its stages by name with the time that is left, or how many of how many are done."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import monotonic

from rich.console import Console

from calibration.errors import printable

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
