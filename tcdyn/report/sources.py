"""What the numbers of a page were made of: logs, records and rig, with their days and checksums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from calibration.files.seal import SEAL
from calibration.log import Log
from calibration.record import DiskRecord
from tcdyn.pipeline.beta import BetaRun
from tcdyn.pipeline.one_disk import OneDiskRun

SHOWN = 16  # hexadecimal digits of a checksum


def sources_of(runs: Sequence[BetaRun | OneDiskRun]) -> pd.DataFrame:
    """Logs, records and rig of one test or several."""
    rows = [log_row(run.log) for run in runs] + record_rows(runs[0].records)
    return table([*rows, ("rig", "rig.toml or, without one, the records'", "", runs[0].rig_sha256)])


def log_row(log: Log) -> tuple[str, str, str, str]:
    """Name, length and checksum of a log."""
    t = log.frame["time_s"]
    return "log", log.path.name, f"{len(t)} rows, {t.iloc[-1] - t.iloc[0]:.0f} s", log.sha256


def record_rows(records: Mapping[str, DiskRecord]) -> list[tuple[str, str, str, str]]:
    """The records: the logs that they were made from, when, and the checksum of their content."""
    return [
        (f"record, {d} disk", ", ".join(f.file for f in r.inputs), f"made {r.created[:10]}", r.to_dict()[SEAL])
        for d, r in records.items()
    ]


def table(rows: Sequence[tuple[str, str, str, str]]) -> pd.DataFrame:
    """As a page shows them, of checksums the first digits."""
    short = [(*row, checksum[:SHOWN]) for *row, checksum in rows]
    return pd.DataFrame(short, columns=["what", "file", "size or day", "SHA-256 begins"])
