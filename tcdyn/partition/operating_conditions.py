"""Operating conditions of a test: forces, speeds and air from the log, else from rig.toml.

Steps of ``tcdyn.partition.prepare.prepare_test``. Guarded by ``tests/partition/test_running.py``
and ``tests/partition/test_as_logged.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.transducers import BearingFriction, fit_bearing_friction
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.io.read import read_numbers, sha256_of_file
from tcdyn.partition.events import DiskAir
from tcdyn.rig.columns import junction_columns_in
from tcdyn.rig.contact import Events, FrictionCorrection, contact_force
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig
from tcdyn.rig.tables import Constant, air_name
from tcdyn.smoothing.traces import interpolate_gaps

# columns of the table of the bearing friction, in the order of ``fit_bearing_friction``
BEARING_COLUMNS = ("load_N", "friction_N", "speed_slow_rpm")


@dataclass(frozen=True)
class BearingFile:
    """Lines of the bearing friction (figure 2.25) and the file that they came from.

    Parameters
    ----------
    friction
        The lines.
    file, sha256
        Name and SHA-256 of the file.
    """

    friction: BearingFriction
    file: str
    sha256: str

    def friction_added(self, load_N: float, speed_rpm: float) -> FrictionCorrection:
        """Half of the bearing friction of both shafts, for ``prepare_test``.

        Parameters
        ----------
        load_N
            Load [N].
        speed_rpm
            Speed of the slow shaft [rpm].

        Returns
        -------
        FrictionCorrection
            Value and uncertainty [N]; with a warning where load or speed lies outside what was
            measured.
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
    """Read a table of the bearing friction: load_N, friction_N and speed_slow_rpm.

    The friction is that of both shafts in pure rolling.

    Raises
    ------
    InputError
        For an unreadable file, a missing column, a value that is no number, or too few loads for a
        speed.
    """
    values = read_numbers(path, BEARING_COLUMNS)
    try:
        lines = fit_bearing_friction(*(values[name] for name in BEARING_COLUMNS))
    except InputError as problem:
        raise problem.at(str(path)) from None
    return BearingFile(lines, Path(path).name, sha256_of_file(path))


# mask (N,) of the rows of a log
RowMask = NDArray[np.bool_]


def rig_constants(frame: pd.DataFrame, rig: Rig) -> tuple[dict[str, Constant], list[Finding]]:
    """The ``[constants]`` of columns that the log does not have; a logged column has priority.

    Parameters
    ----------
    frame
        Table of the log.
    rig
        The rig.

    Returns
    -------
    used
        Constants that replace a column.
    findings
        A finding for each constant.
    """
    used: dict[str, Constant] = {
        name: c for name, c in rig.common.constants.items() if name not in frame
    }
    findings = [
        info("constant.used", subject=name, value=c.value, u=c.u) for name, c in used.items()
    ]
    return used, findings + [
        info("constant.logged", subject=n) for n in rig.common.constants if n not in used
    ]


def forces_N(
    frame: pd.DataFrame, events: Events, steady: RowMask, constants: Mapping[str, Constant]
) -> tuple[Array, Array]:
    """Load and friction during contact, zero elsewhere.

    Parameters
    ----------
    frame
        Table of the log.
    events
        Loading and unloading.
    steady
        Mask (N,) of the steady rows.
    constants
        Constants of rig.toml that replace columns.

    Returns
    -------
    load, friction
        Forces (N,) [N].

    Notes
    -----
    A constant load is scaled with the friction, so that it is its mean over the steady rows: the
    coefficient of friction is assumed constant.
    """
    t = frame["time_s"].to_numpy(dtype=float)
    friction = contact_force(t, frame["friction_N"].to_numpy(dtype=float), events)
    if "load_N" not in constants:
        return contact_force(t, frame["load_N"].to_numpy(dtype=float), events), friction
    return constants["load_N"].value * friction / float(np.mean(friction[steady])), friction


def speeds_rpm(
    frame: pd.DataFrame, under_load: RowMask, constants: Mapping[str, Constant]
) -> tuple[list[float], list[float]]:
    """Speeds of both shafts under load, and their standard uncertainties.

    Parameters
    ----------
    frame
        Table of the log.
    under_load
        Mask (N,) of the rows under load, whose median is used.
    constants
        Constants of rig.toml that replace columns.

    Returns
    -------
    rpm
        Speed of the fast and of the slow shaft [rpm].
    u
        Their standard uncertainties [rpm]; zero for a logged speed.
    """
    names = [f"speed_{d}_rpm" for d in DISKS]
    logged = {
        n: float(np.nanmedian(frame[n].to_numpy(dtype=float)[under_load]))
        for n in names
        if n not in constants
    }
    rpm = [constants[n].value if n in constants else logged[n] for n in names]
    return rpm, [constants[n].u if n in constants else 0.0 for n in names]


def constants_rel_u(
    rpm: Sequence[float], rpm_u: Sequence[float], constants: Mapping[str, Constant]
) -> tuple[float, float, float]:
    """Relative uncertainties of load, sliding speed and speed ratio due to constants of rig.toml.

    Parameters
    ----------
    rpm, rpm_u
        Speeds of both shafts and their standard uncertainties [rpm].
    constants
        Constants of rig.toml that replace columns.

    Returns
    -------
    load, sliding, ratio
        Relative standard uncertainties [1].

    Notes
    -----
    The radii of the disks are taken as equal.
    """
    load = constants["load_N"].u / constants["load_N"].value if "load_N" in constants else 0.0
    sliding = math.hypot(*rpm_u) / abs(rpm[0] - rpm[1])
    return load, sliding, math.hypot(*(u / n for u, n in zip(rpm_u, rpm)))


def disk_air(
    frame: pd.DataFrame, disk: str, rig: Rig, steady: RowMask, constants: Mapping[str, Constant]
) -> tuple[DiskAir, list[Finding]]:
    """The air around a disk, and findings about its channels.

    Parameters
    ----------
    frame
        Table of the log.
    disk
        Name of the disk.
    rig
        The rig, whose ``[ambient]`` names channels at the surface and at the faces.
    steady
        Mask (N,) of the steady rows.
    constants
        Constants of rig.toml that replace columns.

    Returns
    -------
    air
        Temperature (N,) [degC] at surface and faces, and its uncertainty [K].
    findings
        One for each location with channels.

    Raises
    ------
    InputError
        If there is neither a channel that changes nor an ambient temperature.

    Notes
    -----
    The temperature is the mean of the channels. A location without channels has the ambient
    temperature that was logged or stated, or without one the air of the other location. A channel
    that never changes is left out. The mean of n channels whose means in steady state have the
    standard deviation s has the standard uncertainty s / sqrt(n).
    """
    channels = rig.tables(disk).ambient
    ambient: Array | None = None
    if "ambient_degC" in frame:
        logged = frame["ambient_degC"].to_numpy(dtype=float)
        ambient = interpolate_gaps(logged, np.isfinite(logged))
    elif "ambient_degC" in constants:
        ambient = np.full(len(frame), constants["ambient_degC"].value)
    means = dict[str, Array]()
    air_u_K = 0.0
    findings = list[Finding]()
    for location, columns in (("surface", channels.surface), ("faces", channels.faces)):
        changing = [
            x for c in columns if np.nanstd(x := frame[air_name(c)].to_numpy(dtype=float)) > 0
        ]
        if not changing:
            continue
        traces = np.stack([interpolate_gaps(x, np.isfinite(x)) for x in changing])
        means[location], levels = traces.mean(axis=0), traces[:, steady].mean(axis=1)
        spread = float(np.std(levels, ddof=1)) if len(levels) > 1 else 0.0
        air_u_K = max(air_u_K, spread / len(levels) ** 0.5)
        rows = np.flatnonzero(steady)
        drift = float(np.polyfit(rows, means[location][rows], 1)[0] * len(rows))
        details: dict[str, Any] = {
            "mean_degC": float(levels.mean()),
            "drift_K": drift,
            "spread_K": spread,
        }
        findings.append(
            info("ambient.channels", subject=disk, at=location, count=len(levels), **details)
        )
    faces = means.get("faces", ambient)
    surface = means.get("surface", ambient)
    faces = surface if faces is None else faces
    surface = faces if surface is None else surface
    if faces is None or surface is None:
        raise InputError(
            f"no channel of the air about the {disk} disk is alive",
            expected="one that changes, or ambient_degC",
            remedy="state ambient_degC in rig.toml [constants], or log it",
        )
    return DiskAir(faces, surface, air_u_K), findings


def check_no_copies(frame: pd.DataFrame, left_out: Mapping[str, str], where: str) -> None:
    """Check that no two junctions have the same numbers: one of them would not be measured.

    Parameters
    ----------
    frame
        Table of the log.
    left_out
        Channels that are not used.
    where
        The log, for messages.

    Raises
    ------
    InputError
        If two columns are equal in every row and not constant.
    """
    names = [n for n in junction_columns_in(frame) if n.removesuffix("_degC") not in left_out]
    for first, second in combinations(names, 2):
        if frame[first].equals(frame[second]) and frame[first].nunique() > 1:
            raise InputError(
                f"columns {first} and {second} hold the same numbers in every row: one is a copy",
                where=where,
                remedy="map it in rig.toml [columns], or {without}",
                parameters={"without": second.removesuffix("_degC")},
            )
