"""Writing the synthetic rig's files: compact CSV logs, Parquet traces, truth as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv, parquet

from calibration.files.write import atomic_path, write_text

_DECIMALS = {"time_s": 6, "friction_N": 4, "load_N": 3}
_WHOLE = ("contact", "switch", "repeat")


def write_log(frame: pd.DataFrame, path: Path) -> None:
    """Write a log as CSV, temperatures to 0.1 mK, times to a microsecond."""
    columns = {}
    for name in frame.columns:
        values = frame[name].to_numpy()
        columns[name] = (
            values.astype(np.int64) if name in _WHOLE else np.round(values.astype(float), _DECIMALS.get(name, 4))
        )
    with atomic_path(path) as beside, beside.open("wb") as stream:
        stream.write((",".join(columns) + "\n").encode())
        csv.write_csv(pa.table(columns), stream, csv.WriteOptions(include_header=False))


def write_traces(frame: pd.DataFrame, path: Path) -> None:
    """Write truth traces as Parquet in single precision (0.01 mK), times in double."""
    columns = {name: frame[name].to_numpy().astype(float if name == "time_s" else np.float32) for name in frame.columns}
    with atomic_path(path) as beside:
        parquet.write_table(pa.table(columns), beside)


def write_json(data: dict[str, Any], path: Path) -> None:
    """Write plain or numpy numbers as JSON; a key called ``traces`` is left out."""
    write_text(path, json.dumps(_plain(data), indent=1) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items() if k != "traces"}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value
