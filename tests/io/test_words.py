"""Words for no reading among numbers are told by their rarity; other notations are refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.io.read import open_table, read_all_rows
from tests.io.word_study import NOTATIONS, TEXTS, WORDS, accepts, column_of, rates

ROWS = 300
T_DEGC = np.round(20 + 60 * (1 - np.exp(-np.maximum(np.arange(ROWS) - 60, 0) / 8)), 2)


def read(
    folder: Path, cells: Sequence[object], header: str = "time_s,T1"
) -> tuple[np.ndarray, list[Finding]]:
    path = folder / "log.csv"
    rows = [f"{k},{cell}" for k, cell in enumerate(cells)]
    path.write_text(header + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    columns = read_all_rows(open_table(path), header.split(","))
    return columns.data["T1"], list(columns.findings)


def replaced(words: Sequence[str], lost: Sequence[int]) -> list[object]:
    cells: list[object] = list(T_DEGC)
    for number, k in enumerate(lost):
        cells[k] = words[number % len(words)]
    return cells


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("first", [0, 14])
def test_a_rare_word_is_no_reading_whatever_it_is(tmp_path: Path, word: str, first: int) -> None:
    lost = list(range(first, first + 12))
    values, findings = read(tmp_path, replaced([word], lost))
    assert np.flatnonzero(np.isnan(values)).tolist() == lost
    assert np.delete(values, lost) == pytest.approx(np.delete(T_DEGC, lost))
    (finding,) = findings
    assert finding.code == "text.error_word"
    assert (finding.subject, finding.numbers["count"]) == ("T1", 12)
    assert f"row {first + 2}" in str(finding)
    assert f"{word!r} (12)" in str(finding)


def test_words_of_eight_programs_in_one_column_are_named_with_their_counts(tmp_path: Path) -> None:
    words = WORDS[:8]
    lost = [*range(20, 36), 90]
    values, findings = read(tmp_path, replaced(words, lost))
    assert np.isnan(values).sum() == 17
    (finding,) = findings
    assert finding.numbers["count"] == 17
    assert f"{words[0]!r} (3)" in str(finding)
    assert f"{words[1]!r} (2)" in str(finding)


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("at_start", [True, False])
def test_a_sensor_that_is_off_for_most_of_the_record_keeps_its_readings(
    tmp_path: Path, share: float, at_start: bool
) -> None:
    count = int(share * ROWS)
    lost = list(range(count)) if at_start else list(range(ROWS - count, ROWS))
    values = T_DEGC + 0.01 * np.arange(ROWS)
    cells: list[object] = list(values.round(2))
    for k in lost:
        cells[k] = "unavailable"
    found, findings = read(tmp_path, cells)
    assert np.isnan(found).sum() == count
    assert [f.code for f in findings] == ["text.error_word"]


def test_off_is_a_state_of_a_switch_and_no_reading_among_numbers(tmp_path: Path) -> None:
    states = ["Off" if k % 40 < 20 else "On" for k in range(ROWS)]
    values, findings = read(tmp_path, states)
    assert values.tolist() == [float(state == "On") for state in states]
    assert findings == []
    values, findings = read(tmp_path, replaced(["Off"], range(10, 20)))
    assert np.isnan(values).sum() == 10
    assert [f.code for f in findings] == ["text.error_word"]


def test_a_switch_may_be_unavailable(tmp_path: Path) -> None:
    states = ["on" if k % 40 < 20 else "off" for k in range(ROWS)]
    states[50:70] = ["unavailable"] * 20
    values, findings = read(tmp_path, states)
    assert np.flatnonzero(np.isnan(values)).tolist() == list(range(50, 70))
    assert [f.code for f in findings] == ["text.error_word"]


@pytest.mark.parametrize("notation", NOTATIONS)
def test_numbers_in_another_notation_are_refused(tmp_path: Path, notation: str) -> None:
    cells: list[object] = list(T_DEGC)
    for k in range(100, 112):
        cells[k] = NOTATIONS[notation](T_DEGC[k])
    with pytest.raises(InputError, match=r"row 102: .* \(12 of 300 cells\)"):
        read(tmp_path, cells, "time_s;T1" if notation == "?" else "time_s,T1")


def test_decimal_commas_between_points_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k};{f'{t}'.replace('.', ',') if k > 200 else t}" for k, t in enumerate(T_DEGC)]
    path.write_text("time_s;T1\n" + "\n".join(rows) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"is no number.*decimal point"):
        read_all_rows(open_table(path), ["time_s", "T1"])


@pytest.mark.parametrize("kind", TEXTS)
def test_a_column_of_text_has_no_numbers(kind: str) -> None:
    assert not accepts(TEXTS[kind](np.random.default_rng(1), ROWS))


@pytest.mark.parametrize("code", [">1372", "<20", "9999 E", "-999.9*"])
def test_one_code_for_a_limit_is_a_word(tmp_path: Path, code: str) -> None:
    values, findings = read(tmp_path, replaced([code], range(30, 60)))
    assert np.isnan(values).sum() == 30
    assert [f.code for f in findings] == ["text.error_word"]


@pytest.mark.parametrize(("first", "dead"), [("TC1 (°C)", "TC8"), ("T_1_degC", "T_2_degC")])
def test_channels_may_have_units_in_their_names(tmp_path: Path, first: str, dead: str) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k},{t},OVLD,OK" for k, t in enumerate(T_DEGC)]
    header = f"time_s,{first},{dead},{first} state"
    path.write_text(header + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    columns = read_all_rows(open_table(path), header.split(","))
    assert sorted(columns.stamps) == [f"{first} state"]
    assert [(f.code, f.subject) for f in columns.findings] == [("text.error_word", dead)]


@pytest.mark.parametrize("word", ["OPEN", "unavailable"])
def test_a_channel_of_one_word_beside_others_is_without_readings(tmp_path: Path, word: str) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k},{t},{word},anna" for k, t in enumerate(T_DEGC)]
    path.write_text("time_s,TC1,TC2,Operator\n" + "\n".join(rows) + "\n", encoding="utf-8")
    columns = read_all_rows(open_table(path), ["time_s", "TC1", "TC2", "Operator"])
    assert np.isnan(columns.data["TC2"]).all()
    assert sorted(columns.stamps) == ["Operator"]
    assert [(f.code, f.subject) for f in columns.findings] == [("text.error_word", "TC2")]


def test_words_of_a_parquet_file_are_the_same(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    cells = [str(cell) for cell in replaced(["unavailable", "Pt Created"], range(30, 42))]
    pd.DataFrame({"time_s": np.arange(float(ROWS)), "T1": cells}).to_parquet(path)
    columns = read_all_rows(open_table(path), ["time_s", "T1"])
    assert np.isnan(columns.data["T1"]).sum() == 12
    assert [f.code for f in columns.findings] == ["text.error_word"]


@pytest.mark.e2e
def test_few_readings_are_refused_and_no_text_and_no_other_notation_is_accepted() -> None:
    # `python -m tests.io.word_study 400 1` prints the shares in its documentation
    refused, accepted = rates(20, 5)
    most_lost = refused.pop("1 word(s) in 80 % of the cells")
    assert most_lost <= 0.15  # such a record may have too few different numbers
    assert max(refused.values()) == 0
    assert max(accepted.values()) == 0


def test_a_reading_of_the_study_is_a_column_of_numbers() -> None:
    assert accepts(column_of(np.random.default_rng(2), ROWS))


def test_rows_of_dashes_above_the_first_reading_are_rows(tmp_path: Path) -> None:
    """A row with a stamp is one of the logger, and none of units, whatever it holds."""
    stamps = pd.date_range("2026-03-05 23:53:20", periods=60, freq="s").strftime(
        "%d.%m.%Y %H:%M:%S"
    )
    cells = ["---", "---", *(f"25,{k:02}" for k in range(58))]
    path = tmp_path / "log.csv"
    rows = [f"{stamp};{cell}" for stamp, cell in zip(stamps, cells)]
    path.write_text("Zeit;T1 [°C]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    columns = read_all_rows(open_table(path), ["Zeit", "T1 [°C]"])
    assert np.flatnonzero(np.isnan(columns.data["T1 [°C]"])).tolist() == [0, 1]
    assert columns.stamps["Zeit"][0] == "05.03.2026 23:53:20"
