"""What the numbers of a page were made of: logs, records and rig, with their days and checksums."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

import pandas as pd

from tcdyn.io.checksum import SEAL
from tcdyn.rig.log import Log
from tcdyn.rig.record import DiskRecord
from tcdyn.workflows.beta import BetaRun
from tcdyn.workflows.single_disk import OneDiskRun

SHOWN = 16  # hexadecimal digits of a checksum


def sources_of(
    runs: Sequence[BetaRun | OneDiskRun], files: Sequence[Path] = (), rig: Path | None = None
) -> pd.DataFrame:
    """Logs, records and rig of one test or several; ``files`` of the records in their order, ``rig`` where given."""
    rows = [log_row(run.log) for run in runs] + record_rows(runs[0].records, files)
    return table(
        [*rows, ("rig", rig.name if rig else "as the records keep it", "", runs[0].rig_sha256)]
    )


def log_row(log: Log) -> tuple[str, str, str, str]:
    """Name, length and checksum of a log; of one of several tests in a log, that log's."""
    t = log.frame["time_s"]
    path = log.path
    stem, dot, number = path.stem.rpartition(".")
    part = dot and number.isdigit() and not path.is_file()
    return (
        "log",
        f"{stem}{path.suffix}, test {number}" if part else path.name,
        f"{len(t)} rows, {t.iloc[-1] - t.iloc[0]:.0f} s",
        log.sha256,
    )


def record_rows(
    records: Mapping[str, DiskRecord], files: Sequence[Path] = ()
) -> list[tuple[str, str, str, str]]:
    """The records: their ``files``, in their order, the logs that they were made from, when, and their checksums."""
    rows = []
    for (disk, record), file in zip_longest(records.items(), files[: len(records)]):
        logs = ", ".join(f.file for f in record.inputs)
        name = f"{file.name}, of {logs}" if file else logs
        rows.append(
            (f"record, {disk} disk", name, f"made {record.created[:10]}", record.to_dict()[SEAL])
        )
    return rows


def table(rows: Sequence[tuple[str, str, str, str]]) -> pd.DataFrame:
    """As a page shows them, of checksums the first digits."""
    short = [(*row, checksum[:SHOWN]) for *row, checksum in rows]
    return pd.DataFrame(short, columns=["what", "file", "size or day", "SHA-256 begins"])
