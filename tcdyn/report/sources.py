"""Table of the source files of a page: logs, records and rig, with their checksums.

Used by the pages of tests, campaigns, compensations and identifications. Test:
``tests/report/test_page.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

import pandas as pd

from tcdyn.io.checksum import CHECKSUM_KEY
from tcdyn.io.write import CHECKSUM_DIGITS
from tcdyn.rig.log import Log
from tcdyn.rig.record import DiskRecord
from tcdyn.workflows.beta import BetaRun

Row = tuple[str, str, str, str]  # kind, file, size or day, SHA-256


def source_table(
    runs: Sequence[BetaRun], files: Sequence[Path] = (), rig: Path | None = None
) -> pd.DataFrame:
    """Return the table of the logs, records and rig of one or more tests.

    Parameters
    ----------
    runs
        Results of tests; records and rig are those of the first.
    files
        Files of the records, in their order.
    rig
        Path of rig.toml, if it was given.
    """
    rig_name = rig.name if rig else "as the records keep it"
    rows = [log_row(run.log) for run in runs]
    rows += record_rows(runs[0].records, files)
    rows.append(("rig", rig_name, "", runs[0].rig_sha256))
    return to_table(rows)


def log_row(log: Log) -> Row:
    """Return the row of a log. A test of a log with several has the name of that log.

    Parameters
    ----------
    log
        The log.
    """
    time_s = log.frame["time_s"]
    path = log.path
    name = path.name
    stem, dot, number = path.stem.rpartition(".")
    if dot and number.isdigit() and not path.is_file():
        name = f"{stem}{path.suffix}, test {number}"
    duration_s = time_s.iloc[-1] - time_s.iloc[0]
    return "log", name, f"{len(time_s)} rows, {duration_s:.0f} s", log.sha256


def record_rows(records: Mapping[str, DiskRecord], files: Sequence[Path] = ()) -> list[Row]:
    """Return the rows of the records: file, logs that they were made from, day, checksum.

    Parameters
    ----------
    records
        Records by disk.
    files
        Files of the records, in their order; missing ones are named by their logs.

    Returns
    -------
    rows
        One row a record.
    """
    rows = []
    for (disk, record), file in zip_longest(records.items(), files[: len(records)]):
        logs = ", ".join(source.file for source in record.inputs)
        name = f"{file.name}, of {logs}" if file else logs
        checksum = record.to_dict()[CHECKSUM_KEY]
        rows.append((f"record, {disk} disk", name, f"made {record.created[:10]}", checksum))
    return rows


def to_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return the rows as a table, with the first digits of the checksums.

    Parameters
    ----------
    rows
        Rows of the table.
    """
    short = [(*row, checksum[:CHECKSUM_DIGITS]) for *row, checksum in rows]
    return pd.DataFrame(short, columns=["what", "file", "size or day", "SHA-256 begins"])
