"""Heat partition: from an EHL log and two records to beta by all methods, and beta.json.

``estimate_beta`` is the command ``tcdyn rig beta``, for a log of one or both disks. Guarded by
``tests/partition/test_left_out.py``, ``tests/partition/test_as_logged.py`` and ``tests/behaviour``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from tcdyn import campaign
from tcdyn.campaign.stages import read_stage
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.options import options_of
from tcdyn.core.progress import Progress, no_progress
from tcdyn.core.result import Result, estimates_frame
from tcdyn.core.threads import one_blas_thread
from tcdyn.io.checksum import with_checksum
from tcdyn.partition.analyse import (
    Partition,
    analyse_corrected,
    apply_corrections,
    check_sensors_or_power,
    unusable_channel,
)
from tcdyn.partition.beta_file import beta_file
from tcdyn.partition.events import EhlTest
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.sensor_check import SensorCheck
from tcdyn.rig.columns import junction_columns
from tcdyn.rig.disk import DISKS, channels_left_out
from tcdyn.rig.log import Log, iter_log
from tcdyn.rig.opened_log import column_names, missing_columns, rig_from_records
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig
from tcdyn.workflows.beta_tables import estimates_table
from tcdyn.workflows.rig_options import BetaOptions


@dataclass(frozen=True, repr=False)
class BetaRun(Result):
    """Result of one analysed test, with the log and the records that it came from.

    Parameters
    ----------
    log
        The log.
    partition
        The estimates.
    rig_sha256
        Fingerprint of rig and records; tests of a campaign must have the same.
    stages
        Number of tests in the log.
    records
        Record of each disk.
    with_profiles
        Whether beta.json holds the likelihood profiles of the joint fits, some 200 constrained
        fits.
    """

    log: Log
    partition: Partition
    rig_sha256: str
    stages: int = 1
    records: Mapping[str, DiskRecord] = field(default_factory=dict)
    with_profiles: bool = False

    @one_blas_thread
    def to_dict(self) -> dict[str, Any]:
        """The content of ``beta.json``, with its checksum.

        Its keys are those of ``tcdyn.partition.beta_file.beta_file`` and ``kept``, the sufficient
        statistics that a campaign combines, which needs both disks.
        """
        source = {"file": self.log.path.name, "sha256": self.log.sha256}
        data = beta_file(self.partition, source, self.with_profiles)
        data["kept"] = None
        if not self.partition.single_disk:
            data["kept"] = campaign.sufficient_statistics_of(
                self.log.path.stem, self.rig_sha256, self.partition
            )
        return with_checksum(data)

    def summary(self) -> str:
        """The recommended estimate and those by every method, in a few lines."""
        return summary_of(self.partition)

    def headline(self) -> str:
        """Name of the log and the recommended estimate."""
        return f"{self.log.path.name}: {self.partition.recommendation.sentence}"

    def to_frame(self) -> pd.DataFrame:
        """beta of the fast disk and h [W/m2K] by every method; without impossible estimates."""
        p = self.partition
        estimates = {f"both {name}": e for name, e in p.combined.estimates.items()}
        estimates |= {**p.beta_by_estimator, **p.estimates}
        kept = {}
        units = []
        for name, estimate in estimates.items():
            is_h = name.removeprefix("both ").startswith("h")
            is_beta = name in p.beta_by_estimator or name == "both beta"
            if (is_h or is_beta) and name not in p.impossible:
                kept[name] = estimate
                units.append("W/m2K" if is_h else "1")
        return estimates_frame(kept, units)

    def card(self) -> pd.DataFrame:
        """Table of the estimates of beta by every method."""
        return estimates_table(self.partition)


@with_named_arguments
@one_blas_thread
def estimate_beta(
    log: str | Path,
    rig: Rig | None,
    records: Mapping[str, DiskRecord],
    *,
    progress: Progress = no_progress,
    **options: Any,
) -> BetaRun:
    """Read one EHL log and estimate beta by the speed law, the cooling fits and the joint fits.

    Parameters
    ----------
    log, rig, records
        The log, the rig (None: the one that the records were made with) and a record of each disk.
        For a log of one disk give its record only; speed law and fit of both disks are then
        missing.
    progress
        Called with the name of each stage.
    **options
        Fields of :class:`tcdyn.workflows.rig_options.BetaOptions`: ``without``, ``window_s``,
        ``seed``, ``sensor_check``, ``bearing``, ``stage`` and ``profiles``. Without ``stage`` the
        longest of several loadings in the log is analysed.

    Raises
    ------
    InputError
        For a log, rig or record that does not fit. The message names the log.

    Notes
    -----
    A channel that is dead, missing or lost for long is left out too, with a finding, as long as the
    remaining channels determine beta. Both speeds are needed for one disk, too: the heat is
    friction times sliding speed.

    Examples
    --------
    >>> from tcdyn import load_rig, read_record  # doctest: +SKIP
    >>> rig = load_rig("rig.toml")  # doctest: +SKIP
    >>> fast = read_record("fast.disk.json")  # doctest: +SKIP
    >>> slow = read_record("slow.disk.json")  # doctest: +SKIP
    >>> records = {"fast": fast, "slow": slow}  # doctest: +SKIP

    >>> run = estimate_beta("EHL_B3.csv", rig, records)  # doctest: +SKIP
    >>> list(run.to_frame().loc["both beta"].index)  # doctest: +SKIP
    ['value', 'u', 'low95', 'high95', 'unit']
    """
    settings = options_of(BetaOptions, options, "estimate_beta")
    rig = rig or rig_from_records(records)
    skipped = _columns_without_record(log, rig, records)
    left_out = LeftOut.by_user(settings.without, rig)
    bearing = settings.bearing_file
    progress("reading the log")
    table, count, left_out = _read_without_lost_channels(
        log, rig, settings.stage, skipped, left_out
    )

    def corrected_test(left_out: LeftOut) -> EhlTest:
        """The test without the channels left out, ready for the fits."""
        added = bearing.friction_added if bearing else None
        return apply_corrections(prepare_test(table, rig, records, added, left_out.reasons))

    test = corrected_test(left_out)
    sensors = None
    try:
        if settings.sensor_check:
            progress("sensor map")
            test, sensors = _without_unusable_channels(test, corrected_test, left_out, rig)
        partition = analyse_corrected(
            test, sensors, window_s=settings.window_s, seed=settings.seed, progress=progress
        )
    except InputError as problem:
        raise problem.at(table.path.name) from None
    logged_disks = [d for d in DISKS if d in records]
    fingerprint = campaign.rig_fingerprint(rig, records, logged_disks)
    return BetaRun(table, partition, fingerprint, count, records, settings.profiles)


def _columns_without_record(
    log: str | Path, rig: Rig, records: Mapping[str, DiskRecord]
) -> list[str]:
    """Channels of the disk without a record, which a log of one disk must not have.

    Parameters
    ----------
    log, rig, records
        As for :func:`estimate_beta`.

    Raises
    ------
    InputError
        If the log has such a column.
    """
    others = [d for d in DISKS if d not in records]
    if len(others) != 1:
        return []
    (other,) = others
    columns = [*junction_columns(rig.disk_setup(other).channels, other)]
    if missing_columns(column_names(log, rig), rig, columns) != columns:
        raise InputError(
            f"no record of the {other} disk, whose columns the log holds",
            where=Path(log).name,
            remedy="add {records}",
            parameters={"records": f"{other}.disk.json"},
        )
    return columns


@dataclass(frozen=True)
class LeftOut:
    """Channels that an analysis does not use.

    Parameters
    ----------
    reasons
        Reason for each channel such as "fast_c"; empty where the user asked for it.
    first_problem
        The error of the first channel that was lost.
    """

    reasons: Mapping[str, str]
    first_problem: InputError | None = None

    @classmethod
    def by_user(cls, without: Sequence[str], rig: Rig) -> LeftOut:
        """The channels that the user does not want.

        Parameters
        ----------
        without
            Channels such as "fast_c" or "fast_c_degC".
        rig
            The rig.

        Raises
        ------
        InputError
            For a channel that does not exist, or too few channels left.
        """
        channels_left_out(without, rig.setups)
        return cls(dict.fromkeys((name.removesuffix("_degC") for name in without), ""))

    def with_channel_of(self, problem: InputError, rig: Rig) -> LeftOut:
        """Leave out the channel that an error names, too.

        Parameters
        ----------
        problem
            The error.
        rig
            The rig.

        Raises
        ------
        InputError
            If it names no channel, or if the others do not determine beta: then the first error,
            which names the cause best.
        """
        lost_channel = problem.column.removesuffix("_degC")
        disk, _, channel = lost_channel.rpartition("_")
        first_problem = self.first_problem or problem
        if not problem.column:
            raise problem
        if lost_channel in self.reasons or disk not in DISKS:
            raise first_problem
        missing = (*channels_left_out(self.reasons, rig.setups).get(disk, ()), channel)
        if not rig.disk_setup(disk).determines_beta(missing):
            raise first_problem
        return LeftOut({**self.reasons, lost_channel: problem.what}, first_problem)


def _read_without_lost_channels(
    log: str | Path, rig: Rig, stage: int | None, skipped: Sequence[str], left_out: LeftOut
) -> tuple[Log, int, LeftOut]:
    """Read a log, without each channel that the reader cannot use.

    Parameters
    ----------
    log, rig, stage
        As for :func:`estimate_beta`.
    skipped
        Columns that are not read.
    left_out
        Channels that the user leaves out.

    Returns
    -------
    log, count
        The test, and the number of tests in the log.
    left_out
        The channels left out.

    Raises
    ------
    InputError
        As the reader does, if the error names no channel, or too many are lost.

    Notes
    -----
    The reader checks a log while it reads it, and stops at the first channel that is missing, dead
    or lost for long. Guarded by ``tests/partition/test_left_out.py``.
    """
    while True:
        columns = [f"{name}_degC" for name in left_out.reasons]
        try:
            table, count = read_stage(
                iter_log(log, "ehl", rig, without=[*skipped, *columns]), stage
            )
        except InputError as problem:
            left_out = left_out.with_channel_of(problem, rig)
        else:
            return table, count, left_out


def _without_unusable_channels(
    test: EhlTest, corrected_test: Callable[[LeftOut], EhlTest], left_out: LeftOut, rig: Rig
) -> tuple[EhlTest, SensorCheck]:
    """A test without each channel that the sensor check finds unusable, and its sensor check.

    Parameters
    ----------
    test
        The test with all channels but ``left_out``.
    corrected_test
        Makes the test without other channels.
    left_out
        The channels left out so far.
    rig
        The rig.

    Raises
    ------
    InputError
        If the others do not determine beta.
    """
    sensors = check_sensors_or_power(test)
    problem = unusable_channel(sensors)
    while problem is not None:
        left_out = left_out.with_channel_of(problem, rig)
        test = corrected_test(left_out)
        sensors = check_sensors_or_power(test)
        problem = unusable_channel(sensors)
    return test, sensors


def estimate_stages(
    log: str | Path,
    rig: Rig | None,
    records: Mapping[str, DiskRecord],
    *,
    progress: Progress = no_progress,
    **options: Any,
) -> tuple[BetaRun, ...]:
    """Analyse the loadings of one log that an unloading follows, in order.

    Parameters
    ----------
    log, rig, records, progress
        As for ``estimate_beta``.
    **options
        Options of ``estimate_beta``; with ``stage`` only this loading is analysed.

    Returns
    -------
    tuple
        One run for each test.
    """
    settings = options_of(BetaOptions, options, "estimate_stages")
    given = {**settings.stated, "bearing": settings.bearing_file}
    if settings.stage is not None:
        return (estimate_beta(log, rig, records, progress=progress, **given),)
    first = estimate_beta(log, rig, records, progress=progress, **{**given, "stage": 1})
    runs = [first]
    for k in range(2, first.stages + 1):
        prefix = f"test {k} of {first.stages}"

        def report(what: str, prefix: str = prefix) -> None:
            """Report a stage with the number of its test in front."""
            progress(f"{prefix}: {what}")

        runs.append(estimate_beta(log, rig, records, progress=report, **{**given, "stage": k}))
    return tuple(runs)


def summary_of(partition: Partition) -> str:
    """Recommended estimate, beta, h and lag by every method, and the cross-check, as text."""
    lines = {}
    if not partition.single_disk:
        pair = "beta {}   h_fast {}   h_slow {} W/m2K"
        combined = partition.combined.estimates
        lines["both beta"] = (
            "both disks",
            pair.format(combined["beta"], combined["h_fast"], combined["h_slow"]),
        )
        lines["speed law"] = (
            "speed law",
            pair.format(
                partition.estimates["speed law"],
                partition.estimates["h_fast"],
                partition.estimates["h_slow"],
            ),
        )
    for kind in ("cooling", "joint"):
        for d, fit in partition.joint.items():
            key = f"{kind} {d}"
            text = f"beta {partition.estimates[key]}   h {partition.estimates[f'h {key}']} W/m2K"
            if kind == "joint":
                text += f"   lag {fit.estimates['lag_s']} s"
            lines[key] = (key, text)
    rows = [
        f"{word:14}{'withheld' if key in partition.impossible else text}"
        for key, (word, text) in lines.items()
    ]
    return "\n".join([partition.recommendation.sentence, *rows, partition.crosscheck.sentence])
