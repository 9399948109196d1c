"""Long logs piece by piece: the same table in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cal_cases import ehl_frame, immersion_frame, lvm_text, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration.errors import InputError
from calibration.logs import read_log, write_log
from calibration.stream import iter_log


def together(path, kind, rows):
    pieces = list(iter_log(path, kind, rows=rows))
    assert len(pieces) > 1
    return pd.concat([p.frame for p in pieces], ignore_index=True), [w for p in pieces for w in p.warnings]


@pytest.mark.parametrize("ending", ["csv", "parquet", "tdms", "lvm"])
def test_the_pieces_are_the_whole(tmp_path, ending):
    frame = ehl_frame()
    path = tmp_path / f"log.{ending}"
    if ending == "lvm":
        write(tmp_path, "log.lvm", lvm_text(frame))
    else:
        write_log(frame, path)
    found, said = together(path, "ehl", 700)
    assert np.array_equal(found.to_numpy(), frame.to_numpy())
    assert said == []


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(100, 2800), lost=st.integers(1, 20), spike=st.integers(100, 2800))
def test_gaps_and_spikes_at_any_seam_are_found(tmp_path, at, lost, spike):
    frame = ehl_frame()
    frame.loc[spike, "fast_e_degC"] = 400.0
    path = write_log(frame.drop(index=range(at, at + lost)), tmp_path / "log.csv")
    whole = read_log(path, "ehl").frame
    found, _ = together(path, "ehl", 400)
    assert np.array_equal(found.to_numpy(), whole.to_numpy(), equal_nan=True)


@pytest.mark.parametrize("rows", [400, 1000])
def test_what_only_the_whole_test_shows_is_checked_at_its_end(tmp_path, rows):
    for frame, kind, words in (
        (ehl_frame().iloc[:2000], "ehl", "no unloading"),
        (immersion_frame().assign(switch=0.0), "immersion", "never moves"),
        (ehl_frame().iloc[::-1], "ehl", "backward"),
    ):
        path = write_log(frame, tmp_path / "log.csv")
        with pytest.raises(InputError, match=words):
            list(iter_log(path, kind, rows=rows))


def test_oven_logs_are_not_read_in_pieces(tmp_path):
    with pytest.raises(InputError, match="whole"):
        next(iter_log(tmp_path / "x.csv", "oven"))


PEAK = """
import sys
from calibration.stream import iter_log
rows = sum(len(piece.frame) for piece in iter_log(sys.argv[1], "ehl"))
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(rows, int(peak.split()[1]) // 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc")
def test_a_log_of_a_gigabyte_is_read_in_bounded_memory(tmp_path):
    size, path, k = 0, tmp_path / "long.csv", 0
    frame = ehl_frame(60_000).round(4)
    step = len(frame) / 75
    text = "\n".join(",".join(map(str, row)) for row in frame.drop(columns="time_s").to_numpy().tolist()).split("\n")
    with open(path, "w") as stream:
        stream.write(",".join(frame.columns) + "\n")
        while size < 1e9:
            times = k * step + np.arange(len(text)) / 75
            block = "\n".join(f"{t:.6f},{rest}" for t, rest in zip(times.tolist(), text)) + "\n"
            size, k = size + stream.write(block), k + 1
    out = subprocess.run([sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True)
    rows, peak_MB = map(int, out.stdout.split())
    assert rows == k * len(frame)
    assert peak_MB < 500, peak_MB  # the log's numbers alone are 900 MB, the interpreter and its libraries 130
