"""A pipe or a device is refused at once; ISO 8601 stamps with an offset are read."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tcdyn.campaign.stored_results import read_given_result
from tcdyn.core.errors import InputError
from tcdyn.identification import read_identified
from tcdyn.io.read import open_table, read_all_rows, sha256_of_file
from tcdyn.rig.record import read_record
from tcdyn.rig.rigfile import load_rig
from tcdyn.sensors import read_sensor
from tests.cli.test_main_job import tcdyn

READERS = [open_table, sha256_of_file, read_record, load_rig, read_sensor, read_identified]


@pytest.mark.parametrize("read", [*READERS, lambda path: read_given_result(path, "", "")])
def test_no_reader_waits_for_a_pipe(tmp_path: Path, read: object) -> None:
    pipe = tmp_path / "log.csv"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="is a pipe or a device"):
        read(pipe)  # type: ignore[operator]
    with pytest.raises(InputError, match="is a pipe or a device"):
        read(Path("/dev/zero"))  # type: ignore[operator]


@pytest.mark.parametrize(
    "words",
    [
        "identify {pipe} --input a --output b",
        "sensor noise {pipe} --column T",
        "rig calibrate --disk fast --immersion {pipe} --reading-u-K 1",
        "rig record show {pipe}",
        "rig beta {pipe} --record {pipe}",
        "rig campaign {pipe} --record {pipe} --out {out}",
    ],
)
def test_a_pipe_as_input_is_bad_input(
    tmp_path: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "log.csv"
    os.mkfifo(pipe)
    assert tcdyn(*words.format(pipe=pipe, out=tmp_path / "o").split()) == 2
    assert "is a pipe or a device" in capsys.readouterr().err


@pytest.mark.parametrize(
    "offset", ["+00:00", "+05:30", "-05:00", "\u221205:00", "+0100", "+01", "Z", " +01:00"]
)
@pytest.mark.parametrize("fraction", ["", ".5", ".123456", ".123456789"])
def test_iso_stamps_with_an_offset_are_read(tmp_path: Path, offset: str, fraction: str) -> None:
    rows = [f"2026-11-27T04:15:{k:02d}{fraction}{offset},2{k}" for k in range(5)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,T1_degC", *rows]) + "\n", encoding="utf-8")
    columns = read_all_rows(open_table(path), ["time", "T1_degC"])
    assert columns.data["time"] == pytest.approx(np.arange(5.0))
    assert list(columns.data["T1_degC"]) == [20, 21, 22, 23, 24]
