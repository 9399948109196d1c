"""Metadata of a CSV table are in a file beside it, of that table or of none."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.metadata import (
    check_not_compensated,
    compensated_pair,
    metadata_path,
    read_metadata,
)
from tcdyn.io.read import open_table, read_all_rows
from tcdyn.io.write import OutputStyle, log_writer, write_log

FRAME = pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "T [°C]": [20.0, 20.5, 21.25]})
NOTES = {"operator": "A: B", "bath": "Öl", "tcdyn": "compensated"}


def findings(path: Path) -> list[str]:
    table = open_table(path)
    return [f.code for f in read_all_rows(table, list(table.names)).findings]


def test_a_table_begins_with_its_header_and_keeps_its_metadata(tmp_path):
    path = write_log(FRAME, tmp_path / "a.csv", NOTES)
    pd.testing.assert_frame_equal(pd.read_csv(path), FRAME, check_dtype=False)
    assert open_table(path).metadata == NOTES
    assert findings(path) == []
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "a.csv.meta.json"]


def test_metadata_as_comments_need_no_file(tmp_path):
    write_log(FRAME, tmp_path / "a.csv", NOTES)
    path = write_log(FRAME, tmp_path / "a.csv", NOTES, style=OutputStyle(comments=True))
    assert open_table(path).metadata == NOTES
    assert list(tmp_path.iterdir()) == [path]  # the file of the table before is gone
    pd.testing.assert_frame_equal(pd.read_csv(path, comment="#"), FRAME, check_dtype=False)


def test_metadata_of_a_table_before_never_stay_beside_a_new_one(tmp_path):
    path = write_log(FRAME, tmp_path / "a.csv", NOTES)
    write_log(FRAME, path)
    assert open_table(path).metadata == {}
    write_log(FRAME, path, {"operator": "C"})
    assert open_table(path).metadata == {"operator": "C"}


def test_a_failing_writer_leaves_table_and_metadata_before(tmp_path):
    path = write_log(FRAME, tmp_path / "a.csv", NOTES)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    def half() -> None:
        with log_writer(path, list(FRAME), {"operator": "C"}) as write:
            write(FRAME)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        half()
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("content", "code"),
    [
        ("{", "metadata.damaged"),
        ("[]", "metadata.damaged"),
        ('{"schema": "tcdyn.table/2"}', "metadata.damaged"),
        ('{"schema": "tcdyn.table/1"}', "metadata.damaged"),
        (
            '{"schema": "tcdyn.table/2", "columns": ["t", "T"], "metadata": {"a": "b"}}',
            "metadata.other_table",
        ),
    ],
)
def test_a_file_that_is_damaged_or_of_another_table_is_reported_and_not_used(
    tmp_path, content, code
):
    path = write_log(FRAME, tmp_path / "a.csv", NOTES)
    metadata_path(path).write_text(content, encoding="utf-8")
    assert open_table(path).metadata == {}
    assert findings(path) == [code]


def test_metadata_of_the_first_schema_are_read_and_replaced(tmp_path):
    path = write_log(FRAME, tmp_path / "a.csv", NOTES)
    file = metadata_path(path)
    first = json.loads(file.read_text(encoding="utf-8")) | {"schema": "tcdyn.table/1"}
    file.write_text(json.dumps(first), encoding="utf-8")
    assert open_table(path).metadata == NOTES
    write_log(FRAME, path, NOTES)
    assert json.loads(file.read_text(encoding="utf-8"))["schema"] == "tcdyn.table/2"


def test_a_file_of_another_program_is_neither_used_nor_replaced(tmp_path):
    path = tmp_path / "a.csv"
    other = metadata_path(path)
    other.write_text(json.dumps({"license": "CC0"}), encoding="utf-8")
    with pytest.raises(InputError, match="no file of metadata of tcdyn"):
        write_log(FRAME, path, NOTES)
    assert json.loads(other.read_text()) == {"license": "CC0"}
    FRAME.to_csv(path, index=False)
    assert open_table(path).metadata == {}
    assert findings(path) == []


def test_names_with_separators_and_quotes_are_recognised(tmp_path):
    frame = FRAME.rename(columns={"T [°C]": '5"  probe'})
    path = write_log(frame, tmp_path / "a.csv", NOTES)
    assert read_metadata(path, ["time_s", '5" probe']) == (NOTES, [])


def test_rows_may_be_cut_off_and_files_renamed_together(tmp_path):
    path = write_log(FRAME, tmp_path / "a.csv", NOTES)
    moved = tmp_path / "b.csv"
    moved.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    metadata_path(path).rename(metadata_path(moved))
    assert open_table(moved).metadata == NOTES


@pytest.mark.parametrize(
    ("names", "pair"),
    [
        (["time_s", "T1_degC", "T1_u_K"], ("T1_degC", "T1_u_K")),
        (["time", "T1", "T1_u_K"], ("T1", "T1_u_K")),
        (["time", "T1 (°F)", "T1_u_degF"], ("T1 (°F)", "T1_u_degF")),
        (["time", "a_degF", "a_u_degF"], ("a_degF", "a_u_degF")),
        (["time", "T1", "T2_u_K"], None),
        (["time", "T1", "u_K"], None),
        (["time", "menu_K", "T_K"], None),
        (["T_logged_degC", "T_degC", "T_u_K"], ("T_degC", "T_logged_degC")),
        (["T_logged_degC", "T_degC"], ("T_degC", "T_logged_degC")),
        (["T1_degC", "T1_logged_mV"], ("T1_degC", "T1_logged_mV")),
        (["T1_logged [°C]", "T1 [°C]"], ("T1 [°C]", "T1_logged [°C]")),
        (["x_logged_ppm", "x_ppm"], ("x_ppm", "x_logged_ppm")),
        (["x_logged_ppm", "x_u_ppm"], ("x_logged_ppm", "x_u_ppm")),
        (["T_logged_degC", "T_rate_K_s"], ("T_logged_degC", "T_rate_K_s")),
        (["x_rate_ppm_s", "x_rate_u_ppm_s"], ("x_rate_ppm_s", "x_rate_u_ppm_s")),
        (["time_s", "T_logged_degC"], None),  # the readings alone are raw
        (["gas_logged_degC", "gas_kW"], None),
        (["air_degC", "air_rate_kg_s"], None),
    ],
)
def test_columns_that_only_a_compensation_makes_are_recognised(names, pair):
    assert compensated_pair(names) == pair
    if pair is None:
        check_not_compensated(names, {}, "a.csv")
    else:
        with pytest.raises(InputError, match="compensated already: it has columns") as error:
            check_not_compensated(names, {}, "a.csv")
        assert pair[1] in str(error.value)


WRITER = """
import sys
import numpy as np, pandas as pd
from tcdyn.io.write import write_log
frames = {n: pd.DataFrame({"time_s": np.arange(n), "x": np.arange(n)}) for n in (20_000, 30_000)}
print("ready", flush=True)
while True:
    for n, frame in frames.items():
        write_log(frame, sys.argv[1], {"rows": str(n)})
"""


@pytest.mark.e2e
def test_a_killed_writer_leaves_no_metadata_of_another_table(tmp_path):
    path = tmp_path / "a.csv"
    for delay_s in np.random.default_rng(5).uniform(0.0, 0.2, 8):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path)],
            stdout=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(float(delay_s))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        if path.exists():
            stated = open_table(path).metadata.get("rows")
            assert stated in (None, str(len(pd.read_csv(path))))
