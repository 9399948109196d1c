"""An EHL log and two records to beta by every way, and the file that keeps it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from calibration.disk import DISKS
from calibration.errors import InputError
from calibration.files import read_numbers, sha256
from calibration.finding import look
from calibration.lines.transducers import BearingFriction, fit_bearing_friction
from calibration.log import Log, read_log
from calibration.record import DiskRecord
from calibration.result import Result
from calibration.rig import Rig
from tcdyn.partition.analyse import WINDOW_S, Partition, analyse, beta_file
from tcdyn.partition.prepare import FrictionAdded, prepare
from tcdyn.partition.tables import ways_table
from tcdyn.traces import rig_of

BEARING_COLUMNS = ("load_N", "friction_N", "speed_slow_rpm")


@dataclass(frozen=True)
class BetaRun(Result):
    """One analysed test: the numbers, and the log they came from."""

    log: Log
    partition: Partition

    def __repr__(self) -> str:
        return f"<BetaRun of {self.log.path.name}; summary() says it in words>"

    def to_dict(self) -> dict[str, Any]:
        """The content of ``beta.json`` (design, section 8)."""
        return beta_file(self.partition, {"file": self.log.path.name, "sha256": self.log.sha256})

    def summary(self) -> str:
        """The answer in a few lines."""
        return summary_of(self.partition)

    def card(self) -> pd.DataFrame:
        """The ways to beta."""
        return ways_table(self.partition)


def estimate_beta(
    log: str | Path,
    rig: Rig | None,
    records: Mapping[str, DiskRecord],
    *,
    window_s: float = WINDOW_S,
    seed: int = 0,
    sensor_check: bool = True,
    bearing: BearingFile | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> BetaRun:
    """Read one EHL log and find beta by the speed law, the cooling fits and the joint fits.

    ``rig`` None is the one that the records were made with; ``window_s``: cooling used by the h-only fit [s];
    ``bearing``: the pure-rolling test whose friction is added (section 2.10). Raises InputError for a log, rig or
    record that does not fit, naming the log.
    """
    progress("reading the log")
    rig = rig or rig_of(records)
    table = read_log(log, "ehl", rig)
    test = prepare(table, rig, records, bearing.added if bearing else None)
    try:
        found = analyse(test, window_s=window_s, seed=seed, sensor_check=sensor_check, progress=progress)
    except InputError as problem:
        raise problem.at(table.path.name) from None
    return BetaRun(table, found)


def summary_of(p: Partition) -> str:
    """beta, h and lag by every way, and the verdict."""
    a = p.answers
    lines = [f"speed law     beta {a['speed law']}   h_fast {a['h_fast']}   h_slow {a['h_slow']} W/m2K"]
    lines += [f"cooling {d}  beta {a[f'cooling {d}']}   h {a[f'h cooling {d}']} W/m2K" for d in DISKS]
    for d, fit in p.joint.items():
        lines.append(
            f"joint {d}    beta {a[f'joint {d}']}   h {a[f'h joint {d}']} W/m2K   lag {fit.estimates['lag_s']} s"
        )
    return "\n".join([*lines, p.crosscheck.sentence])


@dataclass(frozen=True)
class BearingFile:
    """Lines of figure 2.25 and the file they came from."""

    friction: BearingFriction
    file: str
    sha256: str

    def added(self, load_N: float, speed_rpm: float) -> FrictionAdded:
        """Half of both shafts' bearing friction at a load [N] and a speed of the slow shaft [rpm], for ``prepare``.

        Says so when load or speed lies outside what was measured.
        """
        value, u = (float(x) for x in self.friction.correction_N(load_N, speed_rpm))
        if not bool(self.friction.outside(load_N, speed_rpm)):
            return FrictionAdded(value, u)
        speeds = self.friction.speeds_rpm
        said = look(
            "bearing.extrapolated", file=self.file, load_N=load_N, speed_rpm=speed_rpm,
            loads_N=self.friction.load_range_N, speeds_rpm=(min(speeds), max(speeds)),
        )  # fmt: skip
        return FrictionAdded(value, u, (said,))


def read_bearing(path: str | Path) -> BearingFile:
    """Read a table with the columns load_N, friction_N (both shafts, pure rolling) and speed_slow_rpm.

    Raises InputError for an unreadable file, a missing column, a value that is no number, or too few loads a speed.
    """
    values = read_numbers(path, BEARING_COLUMNS)
    try:
        lines = fit_bearing_friction(*(values[name] for name in BEARING_COLUMNS))
    except InputError as problem:
        raise problem.at(str(path)) from None
    return BearingFile(lines, Path(path).name, sha256(path))
