"""Text in a file can neither control a terminal nor become a formula; a flipped bit is found."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.result import json_text
from tcdyn.io.read import open_table, read_all_rows
from tcdyn.io.write import log_writer, table_csv, write_log
from tcdyn.rig.record import write_record
from tests.cli.test_main_job import tcdyn
from tests.rig.test_record import RECORD

RED = "\x1b[31m[bold]owner\x9b2J"
FORMULAS = ["=1+1", "+1+1", "-1+1", "@SUM(A1)"]


@pytest.mark.parametrize("command", ["show", "check"])
@pytest.mark.parametrize("option", [(), ("--json",)])
def test_escape_sequences_of_a_record_are_printed_escaped(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    option: tuple[str, ...],
) -> None:
    inputs = [{"file": f"{RED}.csv", "sha256": "0" * 64}]
    record = RECORD.model_copy(update={"created_by": RED}).model_dump(mode="json", by_alias=True)
    record = type(RECORD).model_validate({**record, "inputs": inputs, "warnings": [RED]})
    path = write_record(record, tmp_path / "fast.disk.json")
    tcdyn("rig", "record", command, path, *option)
    said = capsys.readouterr()
    assert command == "check" or "owner" in said.out
    assert not {"\x1b", "\x9b"} & set(said.out + said.err)


def test_json_is_the_same_after_its_control_characters_are_escaped() -> None:
    assert json.loads(json_text({RED: ["\u202e", "µ °C"]})) == {RED: ["\u202e", "µ °C"]}
    assert "µ °C" in json_text("µ °C")


def test_no_cell_and_no_header_of_a_table_begins_as_a_formula(tmp_path: Path) -> None:
    table = pd.DataFrame({"log": FORMULAS, "=beta": [-0.5, 0.1, 0.2, np.nan]})
    lines = table_csv(table).splitlines()
    assert lines[0] == "log,'=beta"
    assert [line.partition(",")[0] for line in lines[1:]] == [f"'{text}" for text in FORMULAS]
    assert lines[1].endswith(",-0.5")
    path = write_log(
        pd.DataFrame({"time_s": [0.0], **dict.fromkeys(FORMULAS, 1.0)}), tmp_path / "a.csv"
    )
    names = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    assert names == ["time_s", *(f"'{text}" for text in FORMULAS)]


def test_metadata_of_a_table_with_a_neutralised_header_are_read(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time_s": [0.0, 1.0], "=T": [20.0, 21.0]})
    path = write_log(frame, tmp_path / "a.csv", {"note": "x"})
    assert open_table(path).metadata == {"note": "x"}


@pytest.mark.parametrize("by_parts", [False, True])
def test_a_flipped_bit_of_parquet_changes_no_value_in_silence(
    tmp_path: Path, by_parts: bool
) -> None:
    """200 bits; version 0.2 read other values after about two thirds of them."""
    rng = np.random.default_rng(3)
    frame = pd.DataFrame({"time_s": np.arange(3000) * 0.1, "T1_degC": rng.normal(20, 1, 3000)})
    path = tmp_path / "a.parquet"
    if by_parts:
        with log_writer(path, list(frame), {}) as write:
            write(frame)
    else:
        write_log(frame, path)
    sound = path.read_bytes()
    n_silent = 0
    for bit in rng.integers(0, 8 * len(sound), 200):
        damaged = bytearray(sound)
        damaged[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(damaged)
        try:
            table = open_table(path)
            data = read_all_rows(table, list(frame)).data
        except (InputError, KeyError):
            continue
        n_silent += any(not np.array_equal(data[name], frame[name]) for name in frame)
    assert n_silent == 0
