"""Pure-rolling test of the bearings (section 2.10). Half of its friction is added to the
friction that the transducer measures.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calibration.transducers import BearingFriction, fit_bearing_friction
from tcdyn.core.errors import InputError
from tcdyn.core.findings import warning
from tcdyn.io.read import read_numbers, sha256
from tcdyn.rig.contact import FrictionCorrection

BEARING_COLUMNS = ("load_N", "friction_N", "speed_slow_rpm")


@dataclass(frozen=True)
class BearingFile:
    """Lines of figure 2.25 and the file they came from."""

    friction: BearingFriction
    file: str
    sha256: str

    def friction_added(self, load_N: float, speed_rpm: float) -> FrictionCorrection:
        """Half of both shafts' bearing friction at a load [N] and a speed of the slow shaft [rpm],
        for ``prepare``.

        Says so when load or speed lies outside what was measured.
        """
        value, u = (float(x) for x in self.friction.correction_N(load_N, speed_rpm))
        if not bool(self.friction.outside(load_N, speed_rpm)):
            return FrictionCorrection(value, u)
        speeds = self.friction.speeds_rpm
        finding = warning(
            "bearing.extrapolated",
            file=self.file,
            load_N=load_N,
            speed_rpm=speed_rpm,
            loads_N=self.friction.load_range_N,
            speeds_rpm=(min(speeds), max(speeds)),
        )
        return FrictionCorrection(value, u, (finding,))


def read_bearing(path: str | Path) -> BearingFile:
    """Read a table with the columns load_N, friction_N (both shafts, pure rolling) and
    speed_slow_rpm.

    Raises InputError for an unreadable file, a missing column, a value that is no number, or too
    few loads a speed.
    """
    values = read_numbers(path, BEARING_COLUMNS)
    try:
        lines = fit_bearing_friction(*(values[name] for name in BEARING_COLUMNS))
    except InputError as problem:
        raise problem.at(str(path)) from None
    return BearingFile(lines, Path(path).name, sha256(path))
