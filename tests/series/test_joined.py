"""Several files of one log as one table."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn import inspect, sensor_from_noise, view
from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.io.metadata import metadata_path, metadata_text
from tcdyn.io.read import sha256_of_file
from tcdyn.io.write import write_log
from tcdyn.sensors import sensor_file
from tcdyn.series import open_source
from tcdyn.series.read import read_all
from tcdyn.workflows.compensate_table import compensate_table

ROWS = 400
PARTS = (slice(0, 150), slice(150, 280), slice(280, ROWS))


@pytest.fixture
def frame() -> pd.DataFrame:
    """A log of one row a second, over midnight."""
    rng = np.random.default_rng(4)
    stamps = pd.date_range("2026-03-01 23:57", periods=ROWS, freq="s")
    return pd.DataFrame(
        {
            "time": stamps.strftime("%Y-%m-%d %H:%M:%S"),
            "T1_degC": (20 + np.cumsum(rng.normal(0, 0.2, ROWS))).round(3),
            "level": rng.integers(0, 100, ROWS).astype(float),
            "note": [f"row {k}" for k in range(ROWS)],
        }
    )


def write_parts(frame: pd.DataFrame, folder: Path, **options) -> list[Path]:
    """Three files of the log; the later ones come first."""
    paths = []
    for number, rows in zip((1, 2, 10), PARTS):
        path = folder / f"day{number}.csv"
        frame[rows].to_csv(path, index=False, **options)
        paths.append(path)
    return paths[::-1]


def read(paths, *columns):
    source = open_source(paths, columns)
    return read_all(source, columns or source.value_columns), source


def by_pandas(paths: list[Path]) -> pd.DataFrame:
    """The rows of the files in time, by another reader."""
    joined = pd.concat([pd.read_csv(path) for path in paths], ignore_index=True)
    joined["instant"] = pd.to_datetime(joined["time"])
    return joined.sort_values("instant", ignore_index=True)


def test_rows_are_those_of_pandas_in_the_order_of_their_times(frame, tmp_path):
    paths = write_parts(frame, tmp_path)
    expected = by_pandas(paths)
    (time_s, columns, findings), source = read(paths)
    since_first = (expected["instant"] - expected["instant"][0]).dt.total_seconds()
    np.testing.assert_array_equal(time_s, since_first)
    for name in ("T1_degC", "level"):
        np.testing.assert_array_equal(columns[name], expected[name])
    assert columns["note"].tolist() == expected["note"].tolist()
    assert columns["time"].tolist() == expected["time"].tolist()
    assert findings == ()
    assert [(s.file, s.first_row, s.rows) for s in source.table.sources] == [
        ("day1.csv", 1, 150),
        ("day2.csv", 151, 130),
        ("day10.csv", 281, 120),
    ]
    assert source.table.sources[0].sha256 == sha256_of_file(tmp_path / "day1.csv")


@pytest.mark.parametrize("rows", [7, 100, 50_000])
def test_rows_do_not_depend_on_the_chunks(frame, tmp_path, rows):
    paths = write_parts(frame, tmp_path)
    source = open_source(paths)
    chunks = list(source.read_chunks(["level"], rows))
    np.testing.assert_array_equal(np.concatenate([c[1]["level"] for c in chunks]), frame["level"])
    assert np.array_equal(np.concatenate([c[0] for c in chunks]), np.arange(ROWS))


def test_each_file_has_its_own_dialect_units_and_order_of_columns(frame, tmp_path):
    paths = []
    first, second, third = (frame[rows].copy() for rows in PARTS)
    first.to_csv(tmp_path / "a.csv", index=False)
    second["time"] = pd.to_datetime(second["time"]).dt.strftime("%d.%m.%Y %H:%M:%S")
    second.to_csv(tmp_path / "b.csv", index=False, sep=";", decimal=",")
    third["T1_degF"] = 1.8 * third.pop("T1_degC") + 32
    third[["note", "T1_degF", "time", "level"]].to_csv(tmp_path / "c.csv", index=False)
    paths = [tmp_path / name for name in ("a.csv", "b.csv", "c.csv")]
    (time_s, columns, findings), source = read(paths)
    assert source.table.names == ("time", "T1_degC", "level", "note")
    np.testing.assert_array_equal(time_s, np.arange(ROWS))
    np.testing.assert_allclose(columns["T1_degC"], frame["T1_degC"], atol=1e-9)
    np.testing.assert_array_equal(columns["level"], frame["level"])
    # the forms of the stamps differ, so that all are written in one
    iso = pd.to_datetime(frame["time"]).dt.strftime("%Y-%m-%dT%H:%M:%S")
    assert columns["time"].tolist() == iso.tolist()
    assert [finding.code for finding in findings] == ["files.stamps"]


@pytest.mark.e2e
@pytest.mark.parametrize("dialect", ["standard", "input"])
def test_the_joined_log_compensated_is_the_single_file_compensated(frame, tmp_path, dialect):
    probe = sensor_file("probe", {"T1_degC": Chain(5.0)}, "stated", np.array([[0.01]]), [0.0])
    # a gap of rows between two files is as a gap in one file
    frame = frame.drop(range(145, 160)).reset_index(drop=True)
    frame.to_csv(tmp_path / "all.csv", index=False, sep=";")
    paths = []
    for number, rows in enumerate((slice(0, 145), slice(145, 200), slice(200, None))):
        paths.insert(0, tmp_path / f"part{number}.csv")
        frame[rows].to_csv(paths[0], index=False, sep=";")
    one = compensate_table(tmp_path / "all.csv", [probe], tmp_path / "one.csv", dialect=dialect)
    many = compensate_table(paths, [probe], tmp_path / "many.csv", dialect=dialect)
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "many.csv").read_bytes()
    pd.testing.assert_frame_equal(one.to_frame(), many.to_frame())
    assert many.reading.places == one.reading.places == 1
    assert many.metadata["source"] == "part0.csv, part1.csv, part2.csv"
    assert "source_sha256" not in many.metadata
    sources = many.to_dict()["sources"]
    assert [source["first_row"] for source in sources] == [1, 146, 201]
    assert sources[1]["sha256"] == sha256_of_file(tmp_path / "part1.csv")
    assert sources[1]["sha256"] in metadata_path(tmp_path / "many.csv").read_text()
    assert one.to_dict()["sources"][0]["rows"] == len(frame)


def test_an_output_that_is_one_of_the_files_is_refused(frame, tmp_path):
    probe = sensor_file("probe", {"T1_degC": Chain(5.0)}, "stated", np.array([[0.01]]), [0.0])
    paths = write_parts(frame, tmp_path)
    with pytest.raises(InputError, match="the file that is read"):
        compensate_table(paths, [probe], tmp_path / "day2.csv")


def test_findings_and_errors_name_file_and_row_of_the_file(frame, tmp_path):
    frame.loc[200, "time"] = ""
    paths = write_parts(frame, tmp_path)
    found = inspect(paths)
    (finding,) = [f for f in found.findings if f.code == "series.filled_time"]
    assert finding.where == "day2.csv"
    assert finding.numbers["row"] == 51
    assert "day2.csv: 130 rows, from row 151" in found.summary()
    assert found.to_dict()["sources"][1]["first_row"] == 151
    frame.loc[300, "time"] = frame.loc[290, "time"]
    with pytest.raises(InputError, match=r"backward at row 21 below the header of day10\.csv"):
        inspect(write_parts(frame, tmp_path))


def test_cells_that_are_no_numbers_name_their_file(frame, tmp_path):
    cells = frame["level"].astype(object)
    cells[170] = "Err"
    paths = write_parts(frame.assign(level=cells), tmp_path)
    (_, columns, findings), _ = read(paths, "level")
    assert np.isnan(columns["level"][170])
    assert {finding.where for finding in findings} == {"day2.csv"}


def test_a_channel_that_is_dead_in_one_file_has_no_numbers_there(frame, tmp_path):
    cells = frame["T1_degC"].astype(object)
    cells[150:280] = "unavailable"
    paths = write_parts(frame.assign(T1_degC=cells), tmp_path)
    (_, columns, findings), _ = read(paths, "T1_degC")
    assert np.isnan(columns["T1_degC"][150:280]).all()
    np.testing.assert_array_equal(columns["T1_degC"][:150], frame["T1_degC"][:150])
    assert any(finding.where == "day2.csv" for finding in findings)


def test_files_that_overlap_are_refused_with_names_and_times(frame, tmp_path):
    paths = write_parts(frame, tmp_path)
    frame[270:300].to_csv(tmp_path / "extra.csv", index=False)
    with pytest.raises(InputError, match="overlap in time") as caught:
        open_source([*paths, tmp_path / "extra.csv"])
    for text in ("day2.csv", "extra.csv", "2026-03-02 00:01:30", "2026-03-02 00:01:39", "each"):
        assert text in str(caught.value)
    with pytest.raises(InputError, match="overlap in time"):
        open_source([paths[0], paths[0]])


def test_a_row_that_ends_one_file_and_begins_the_next_is_no_overlap(frame, tmp_path):
    frame[:151].to_csv(tmp_path / "a.csv", index=False)
    frame[150:].to_csv(tmp_path / "b.csv", index=False)
    found = inspect([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert found.reading.rows == ROWS + 1
    assert "series.repeated_time" in [finding.code for finding in found.findings]


def write_numbers(tmp_path: Path, starts, time: str = "time_s", scale: float = 1.0) -> list[Path]:
    paths = []
    for k, start in enumerate(starts):
        rows = {time: (start + np.arange(50.0)) / scale, "T1_degC": 20.0 + np.arange(50) % 7}
        paths.append(write_log(pd.DataFrame(rows), tmp_path / f"part{k}.csv"))
    return paths


def test_times_that_restart_are_refused_with_what_would_help(tmp_path):
    with pytest.raises(InputError, match="nothing states when each file was logged") as caught:
        open_source(write_numbers(tmp_path, (0, 0)))
    assert "start_time" in str(caught.value)
    assert "each" in str(caught.value)


def test_times_that_go_on_from_file_to_file_are_one_clock(tmp_path):
    (time_s, _, findings), _ = read(write_numbers(tmp_path, (60, 0))[::-1])
    np.testing.assert_array_equal(time_s, [*range(50), *range(60, 110)])
    assert [finding.code for finding in findings] == ["files.counted"]


def test_start_times_in_the_metadata_place_files_whose_times_restart(tmp_path):
    paths = write_numbers(tmp_path, (0, 0))
    for path, start in zip(paths, ("2026-03-01T10:01:00", "2026-03-01T10:00:00")):
        names = ["time_s", "T1_degC"]
        metadata_path(path).write_text(metadata_text(names, {"start_time": start}))
    (time_s, _, findings), source = read(paths)
    np.testing.assert_array_equal(time_s, [*range(50), *range(60, 110)])
    assert source.table.metadata["start_time"] == "2026-03-01T10:00:00"
    assert findings == ()


def test_numbers_of_time_are_converted_to_the_unit_of_the_first_file(tmp_path):
    first = write_numbers(tmp_path, (0,), "Time [ms]", 1e-3)
    rows = {"Time [s]": 50.0 + np.arange(50.0), "T1_degC": np.full(50, 21.0)}
    later = [write_log(pd.DataFrame(rows), tmp_path / "later.csv")]
    (time_s, columns, _), source = read([*later, *first], "Time [ms]", "T1_degC")
    np.testing.assert_allclose(time_s, np.arange(100.0))
    np.testing.assert_allclose(columns["Time [ms]"], 1e3 * np.arange(100.0))
    assert source.time == "Time [ms]"


def test_epochs_and_zones_tell_the_order(tmp_path):
    paths = write_numbers(tmp_path, (1.7e9 + 100, 1.7e9))
    (time_s, _, findings), _ = read(paths)
    assert time_s[0] == 1.7e9
    assert time_s[50] == 1.7e9 + 100
    assert findings == ()
    for k, zone in enumerate(("+02:00", "+01:00")):
        stamps = pd.date_range("2026-03-29 01:00", periods=30, freq="s").strftime("%F %T")
        rows = {"time": stamps + zone, "T1_degC": np.arange(30.0)}
        pd.DataFrame(rows).to_csv(tmp_path / f"zone{k}.csv", index=False)
    (time_s, _, _), source = read([tmp_path / "zone1.csv", tmp_path / "zone0.csv"])
    assert [source.file for source in source.table.sources] == ["zone0.csv", "zone1.csv"]
    assert time_s[30] == 3600


def test_times_of_day_without_a_date_are_refused(tmp_path):
    for k in range(2):
        stamps = pd.date_range("2026-03-01 10:00", periods=30, freq="s").strftime("%T")
        rows = {"time": stamps, "T1_degC": np.arange(30.0)}
        pd.DataFrame(rows).to_csv(tmp_path / f"day{k}.csv", index=False)
    with pytest.raises(InputError, match="nothing states the day"):
        open_source([tmp_path / "day0.csv", tmp_path / "day1.csv"])


def test_a_date_column_tells_the_day(tmp_path):
    for k in range(2):
        stamps = pd.date_range(f"2026-03-0{2 - k} 10:00", periods=30, freq="s")
        rows = {
            "Date": stamps.strftime("%d.%m.%Y"),
            "Time": stamps.strftime("%T"),
            "T1_degC": np.arange(30.0),
        }
        pd.DataFrame(rows).to_csv(tmp_path / f"day{k}.csv", index=False)
    (time_s, columns, _), _ = read([tmp_path / "day0.csv", tmp_path / "day1.csv"])
    assert time_s[30] == 86400
    assert columns["Date"][0] == "01.03.2026"


def test_dates_that_may_be_read_in_two_ways_are_decided_by_all_files(tmp_path):
    paths = []
    for k, day in enumerate(("2026-02-28", "2026-03-01")):
        stamps = pd.date_range(f"{day} 10:00", periods=30, freq="s").strftime("%m/%d/%Y %T")
        paths.append(tmp_path / f"day{k}.csv")
        rows = {"time": stamps, "T1_degC": np.arange(30.0)}
        pd.DataFrame(rows).to_csv(paths[-1], index=False)
    (time_s, _, _), _ = read(paths)
    assert time_s[30] == 86400


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda frame: frame.drop(columns="level"), "without 'level'"),
        (lambda frame: frame.assign(T2_degC=1.0), "with 'T2_degC'"),
        (lambda frame: frame.rename(columns={"T1_degC": "T1_mV"}), "without 'T1_degC'"),
        (lambda frame: frame.assign(time=np.arange(len(frame))), "one kind of clock"),
    ],
)
def test_other_columns_and_clocks_are_refused_by_name(frame, tmp_path, change, text):
    paths = write_parts(frame, tmp_path)
    change(frame[150:280].copy()).to_csv(tmp_path / "day2.csv", index=False)
    with pytest.raises(InputError, match=text) as caught:
        open_source(paths)
    assert "day2.csv" in str(caught.value)


def test_compensated_files_and_a_sampling_interval_without_times_are_refused(frame, tmp_path):
    paths = write_parts(frame, tmp_path)
    with pytest.raises(InputError, match="the time between them is not known"):
        inspect(paths, dt_s=1.0)
    frame[150:280].assign(T1_u_K=0.1).to_csv(tmp_path / "day2.csv", index=False)
    with pytest.raises(InputError, match="compensated already"):
        open_source(paths)


def test_rows_of_one_cell_are_selected_in_all_files(frame, tmp_path):
    frame["phase"] = np.where(np.arange(ROWS) % 100 < 50, "hot", "cold")
    source = open_source(write_parts(frame, tmp_path), options=None)
    found = inspect(write_parts(frame, tmp_path), ["T1_degC"], where="phase=hot")
    assert found.reading.rows == 200
    assert source.table.place(151) == ("day2.csv", 1)
    assert {each.first_row for each in found.sources} == {0}


@pytest.mark.e2e
def test_a_page_and_a_lag_from_noise_of_several_files(tmp_path):
    rng = np.random.default_rng(1)
    n = 9000
    logged = 290 + Chain([2.0, 0.3]).response(rng.normal(0, 1.5, n), 0.1) + rng.normal(0, 0.01, n)
    stamps = pd.date_range("2026-03-01 10:00", periods=n, freq="100ms").strftime("%F %H:%M:%S.%f")
    table = pd.DataFrame({"time": stamps, "T1_degC": logged.round(4)})
    table.to_csv(tmp_path / "all.csv", index=False)
    for k in range(3):
        table[3000 * k : 3000 * (k + 1)].to_csv(tmp_path / f"hour{k}.csv", index=False)
    paths = [tmp_path / f"hour{k}.csv" for k in (1, 0, 2)]
    one = sensor_from_noise(tmp_path / "all.csv")
    many = sensor_from_noise(paths)
    assert many.chain == one.chain
    assert len(many.inputs) == 3
    page, _ = view(paths, out=tmp_path / "page.html", open_browser=False)
    text = page.read_text(encoding="utf-8")
    assert "9,000 rows" in text
    assert "hour2.csv" in text
