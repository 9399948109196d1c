"""Checks of plunges before and after their fit: at rest, given twice, order of the junctions.

Used by ``tcdyn.workflows.calibrate``. Guarded by ``tests/calibration/test_new_user_run.py`` and
``tests/cli/test_calibrate_command.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from immersion.plunge_data import PlungeRun
from immersion.plunge_result import MAX_VARIANCE_FACTOR, PlungeFit
from tcdyn.core.errors import InputError
from tcdyn.rig.log import Log
from tcdyn.rig.static_line import static_u

# Two plunges whose samples all agree within this [K] are the same plunge: a file that was saved
# again may have lost decimals.
SAME_SAMPLES_K = 0.02
# Check of a disk at rest before the entry: time [s] before the entry that is left out, fewest
# samples, and scatter [K] of a disk at one temperature. Chosen by judgement.
ENTRY_MARGIN_S = 0.5
MIN_REST_SAMPLES = 20
REST_U_K = 0.07
# What is expected, and what to do, for each finding on the order of the junctions in a plunge.
JUNCTION_ORDER = {
    "junctions.swapped": (
        "each column from the junction that rig.toml says",
        "map the columns in rig.toml [columns], or correct the depths in [thermocouples]",
    ),
    "junctions.uneven_start": (
        "a disk of one temperature before the entry",
        "let the disk rest in air until all channels agree, then plunge it again",
    ),
    "junctions.uneven_disk": (
        "a disk that warms evenly around its circumference",
        "plunge it again with the whole running surface in the bath and nothing that touches "
        "one side",
    ),
}


def deviating_at_rest(run: PlungeRun) -> set[str]:
    """Channels that deviate from the median of the disk by more than three u before the entry.

    A disk at rest has one temperature, so their static lines or columns belong to another disk. The
    set is empty for a disk that still warms or cools, whose junctions differ.

    Parameters
    ----------
    run
        The plunge with its readings and static lines.

    Notes
    -----
    u is the uncertainty of the static line and ``REST_U_K``. With a larger ``REST_U_K`` fewer
    swapped disks are reported. ``tests/calibration/test_new_user_run.py`` guards it.
    """
    before = run.readings_degC[
        run.time_s < run.entry.time_s - max(4 * run.entry.u_s, ENTRY_MARGIN_S)
    ]
    if len(before) < MIN_REST_SAMPLES or not run.lines:
        return set()
    third = len(before) // 3
    mean = np.nanmean(before, axis=0)
    if (
        abs(np.nanmedian(np.nanmean(before[-third:], axis=0) - np.nanmean(before[:third], axis=0)))
        > REST_U_K
    ):
        return set()
    u = np.array([float(static_u(run.lines[c], x)) for c, x in zip(run.channels, mean)])
    return {
        c
        for c, off in zip(run.channels, np.abs(mean - np.nanmedian(mean)) / np.hypot(u, REST_U_K))
        if off > 3
    }


def check_not_repeated(log: Log, earlier: Sequence[Log]) -> None:
    """Check that a plunge was not given before, in any file.

    Counted twice, it would make the uncertainty of the lags too small.

    Parameters
    ----------
    log
        The plunge.
    earlier
        The plunges before it.

    Raises
    ------
    InputError
        If all samples agree within ``SAME_SAMPLES_K``.
    """
    columns = [*log.channels]
    for other in earlier:
        if len(other.frame) != len(log.frame):
            continue
        difference = np.abs(other.frame[columns].to_numpy() - log.frame[columns].to_numpy())
        if not np.nanmax(difference, initial=0.0) > SAME_SAMPLES_K:
            raise InputError(
                f"holds the same samples as {other.path.name}",
                where=log.path.name,
                expected="each plunge once",
                remedy="give another plunge, or leave it out",
            )


def check_junction_order(logs: Sequence[Log], fit: PlungeFit) -> None:
    """Check that channels whose order contradicts their depths at least move together in the fit.

    Parameters
    ----------
    logs
        Plunge logs, with their findings about the order of junctions.
    fit
        Fit of the chains to them.

    Raises
    ------
    InputError
        If the log shows another order of the junctions, and the differences between channels do not
        fit (variance factor above ``immersion.plunge_result.MAX_VARIANCE_FACTOR``). The message
        names the cause: swapped channels, a disk that was not at one temperature, or one that warms
        unevenly.
    """
    for log, factor in zip(logs, fit.optimum.problem.noise):
        findings = [f for f in log.findings if f.code in JUNCTION_ORDER]
        if findings and factor.differential > MAX_VARIANCE_FACTOR:
            expected, remedy = JUNCTION_ORDER[findings[0].code]
            raise InputError(
                findings[0].sentence, where=log.path.name, expected=expected, remedy=remedy
            )
