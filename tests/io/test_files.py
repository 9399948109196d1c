"""Files, folders and patterns of a call."""

from pathlib import Path

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.io.files import files_of, natural_key
from tcdyn.sensors import sensor_file
from tcdyn.workflows.compensate_table import compensate_table

TABLE = "time_s,T1_degC\n" + "".join(f"{k},{20 + k % 3}\n" for k in range(60))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with three logs and other files."""
    for name in ("day10.csv", "day2.csv", "Day1.csv", ".day3.csv", "photo.png", "rig.toml"):
        (tmp_path / name).write_text(TABLE, encoding="utf-8")
    (tmp_path / "deeper").mkdir()
    (tmp_path / "deeper" / "day4.csv").write_text(TABLE, encoding="utf-8")
    return tmp_path


def names(found: tuple[list[Path], list]) -> list[str]:
    return [path.name for path in found[0]]


def test_files_of_a_folder_are_its_tables_in_natural_order(folder):
    assert names(files_of([folder])) == ["Day1.csv", "day2.csv", "day10.csv"]


def test_patterns_are_expanded_and_each_file_comes_once(folder):
    pattern = str(folder / "day*.csv")
    assert names(files_of([pattern])) == ["day2.csv", "day10.csv"]
    assert names(files_of([folder / "day10.csv", pattern, folder])) == [
        "day10.csv",
        "day2.csv",
        "Day1.csv",
    ]
    assert names(files_of([str(folder / "**" / "day4.csv")])) == ["day4.csv"]


def test_a_file_whose_name_looks_like_a_pattern_is_that_file(folder):
    (folder / "log[1].csv").write_text(TABLE, encoding="utf-8")
    (folder / "log1.csv").write_text(TABLE, encoding="utf-8")
    assert names(files_of([folder / "log[1].csv"])) == ["log[1].csv"]


def test_outputs_of_tcdyn_are_left_out_and_told(folder):
    probe = sensor_file("probe", {"T1_degC": Chain(2.0)}, "stated", np.array([[0.01]]), [0.0])
    compensate_table(folder / "day2.csv", [probe], folder / "result.csv")
    (folder / "renamed.csv").write_bytes((folder / "result.csv").read_bytes())
    probe.write(folder / "probe.sensor.json")
    files, findings = files_of([folder])
    assert [path.name for path in files] == ["Day1.csv", "day2.csv", "day10.csv"]
    (finding,) = findings
    left_out = ("probe.sensor.json", "renamed.csv", "result.csv", "result.csv.meta.json")
    assert set(left_out) <= set(finding.numbers["files"])
    assert "result.csv" in finding.sentence
    # by a pattern too, but not by name: the reader then says why it cannot be used
    assert "result.csv" not in names(files_of([str(folder / "*.csv")]))
    assert names(files_of([folder / "result.csv"])) == ["result.csv"]


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("deeper/none", "no such file"),
        ("deeper/*.lvm", "no file has such a name"),
        ("empty", "holds no tables"),
    ],
)
def test_nothing_found_is_an_error_that_names_the_path(folder, path, text):
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match=text) as caught:
        files_of([folder / path])
    assert path.split("/")[-1] in str(caught.value)


def test_no_paths_are_an_error():
    with pytest.raises(InputError, match="no files"):
        files_of([])


def test_natural_order_compares_numbers_and_text():
    texts = ["a", "a1b", "a01", "10", "9", "B2", "b10"]
    assert sorted(texts, key=natural_key) == ["9", "10", "a", "a01", "a1b", "B2", "b10"]
