"""Steady temperature of each junction of a test, without and with the circumferential harmonic.

Used by ``tcdyn.workflows.campaign_log``. Guarded by ``tests/core/test_results.py`` and
``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from tcdyn.partition.events import EhlTest
from tcdyn.partition.window import rows_between, steady_start_s
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.static_line import apply_static


def steady_degC(test: EhlTest) -> dict[str, dict[str, float | None]]:
    """Mean reading of each junction in steady state [degC], None for one that is left out.

    By disk and channel. The mean of a disk is its bulk temperature (section 6.4.1). The last half
    second before the unloading is left out.
    """
    rows = rows_between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    means = {d: test.disks[d].readings_degC[rows].mean(axis=0) for d in DISKS}
    return {
        d: {
            c: None if c in test.disks[d].excluded else float(x)
            for c, x in zip(test.disks[d].setup.channels, means[d])
        }
        for d in DISKS
    }


def logged_map_degC(
    test: EhlTest, frame: pd.DataFrame, records: Mapping[str, DiskRecord]
) -> dict[str, dict[str, float | None]]:
    """Reading of each junction in steady state, with its static line and nothing else [degC].

    By disk and channel, None for one that is left out. ``steady_degC`` is without the harmonic
    around the disk, whose estimate takes over errors of single channels. Median, against spikes.

    Parameters
    ----------
    test
        The test.
    frame
        Table of its log.
    records
        Record of each disk.
    """
    times_s = frame["time_s"].to_numpy(dtype=float)
    rows = rows_between(times_s, steady_start_s(test), test.events.unload_s - 0.5)
    readings: dict[str, dict[str, float | None]] = {}
    for d, disk in test.disks.items():
        readings[d] = {}
        for c in disk.setup.channels:
            readings[d][c] = None
            if c not in disk.excluded:
                logged = np.nanmedian(frame[f"{d}_{c}_degC"].to_numpy(dtype=float)[rows])
                readings[d][c] = float(apply_static(logged, records[d].static[c]))
    return readings
