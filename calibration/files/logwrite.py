"""Logs written with their metadata, whole or not at all, in the form their ending names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from nptdms import ChannelObject, RootObject, TdmsWriter
from pyarrow import csv as pacsv
from pyarrow import parquet as pq

from calibration.errors import InputError
from calibration.files.write import atomic_path


def write_log(frame: pd.DataFrame, path: str | Path, metadata: Mapping[str, str] | None = None) -> Path:
    """Write the columns of ``frame`` to ``path``: .csv, .parquet or .tdms; numbers keep all their digits.

    ``metadata`` goes to ``# key: value`` lines above the header (CSV), the file's key-value pairs (Parquet) or the
    root properties (TDMS); ``read_log`` gives it back. Raises InputError for another ending or an unwritable
    place.
    """
    target = Path(path)
    notes = {_one_line(k).replace(":", " "): _one_line(v) for k, v in (metadata or {}).items()}
    writers = {".csv": _csv, ".parquet": _parquet, ".tdms": _tdms}
    writer = writers.get(target.suffix.lower())
    if writer is None:
        raise InputError(
            f"ending {target.suffix!r}", where=str(target), expected="an output ending in .csv, .parquet or .tdms"
        )
    with atomic_path(target) as beside:
        writer(frame, beside, notes)
    return target


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


def _arrow(frame: pd.DataFrame) -> pa.Table:
    return pa.table({str(n): pa.array(frame[n].to_numpy(), from_pandas=True) for n in frame.columns})


def _csv(frame: pd.DataFrame, path: Path, notes: Mapping[str, str]) -> None:
    head = "".join(f"# {key}: {value}\n" for key, value in notes.items())
    head += ",".join(str(n) for n in frame.columns) + "\n"
    with open(path, "wb") as stream:
        stream.write(head.encode("utf-8"))
        pacsv.write_csv(_arrow(frame), stream, pacsv.WriteOptions(include_header=False))


def _parquet(frame: pd.DataFrame, path: Path, notes: Mapping[str, str]) -> None:
    pq.write_table(_arrow(frame).replace_schema_metadata(dict(notes)), path)


def _tdms(frame: pd.DataFrame, path: Path, notes: Mapping[str, str]) -> None:
    channels = [
        ChannelObject("log", str(n), np.ascontiguousarray(frame[n].to_numpy(dtype=float))) for n in frame.columns
    ]
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject(properties=dict(notes)), *channels])
