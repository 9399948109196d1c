"""Many files one by one."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.io.files import files_of
from tcdyn.io.metadata import metadata_path
from tcdyn.sensors import SensorFile, read_sensor, sensor_file
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.each import (
    FileResult,
    compensate_each,
    each_file,
    outputs_of,
    sensor_each,
)


def probe(lag_s: float = 2.0) -> SensorFile:
    return sensor_file("probe", {"T1_degC": Chain(lag_s)}, "stated", np.array([[0.01]]), [0.0])


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    """Three logs, of which the second is damaged."""
    rng = np.random.default_rng(0)
    paths = []
    for k in range(3):
        reading = 20 + np.cumsum(rng.normal(0, 0.1, 80))
        table = pd.DataFrame({"time_s": np.arange(80), "T1_degC": reading.round(3)})
        paths.append(tmp_path / f"log{k}.csv")
        table.to_csv(paths[-1], index=False)
    with open(paths[1], "a", encoding="utf-8") as stream:
        stream.write("80,20,5,7\n81,20\n")
    return paths


def rows_of(path: Path) -> FileResult:
    """A function of one file that a worker process can call."""
    text = path.read_text(encoding="utf-8")
    if "5,7" in text:
        raise ValueError("no such number")
    return FileResult({"rows": text.count("\n") - 1})


@pytest.mark.e2e
@pytest.mark.parametrize("workers", [1, 2])
def test_a_function_that_fails_for_one_file_does_not_stop_the_others(logs, workers):
    seen = []
    run = each_file(rows_of, logs, workers=workers, progress=lambda *each: seen.append(each))
    assert [each.file for each in run.outcomes] == logs
    assert run.exit_code == 1
    assert run.table["rows"].tolist()[::2] == [80, 80]
    assert run.table["error"][1] == "log1.csv: failed with ValueError: no such number"
    assert sorted(done for _, done, _ in seen) == [1, 2, 3]
    assert "3 files: 2 done, 1 failed" in run.summary()


def test_outputs_are_those_of_compensate_table_and_a_damaged_file_is_told(logs, tmp_path):
    run = compensate_each(logs, [probe()], tmp_path / "done")
    assert [each.error for each in run.outcomes][::2] == ["", ""]
    assert "row 82 has 4 fields" in run.outcomes[1].error
    alone = compensate_table(logs[0], [probe()], tmp_path / "alone.csv")
    output = tmp_path / "done" / "log0.compensated.csv"
    assert output.read_bytes() == (tmp_path / "alone.csv").read_bytes()
    assert not (tmp_path / "done" / "log1.compensated.csv").exists()
    row = run.table.iloc[0]
    assert (row["rows"], row["columns"], row["out"]) == (80, 1, output.name)
    expected = alone.numbers.iloc[0]
    assert row["noise_sd_K"] == pytest.approx(expected["noise_sd_K"], rel=1e-5)
    assert row["sd_typical_K"] == pytest.approx(expected["sd_typical_K"], rel=1e-5)
    content = run.to_dict()
    assert json.loads(json.dumps(content))["failed"] == 1
    table = pd.read_csv(run.write(tmp_path / "results.csv"))
    assert table["file"].tolist() == ["log0.csv", "log1.csv", "log2.csv"]
    # neither outputs nor the table of results are logs of a next run
    again, _ = files_of([tmp_path, tmp_path / "done" / ".." / "*.csv"])
    assert [path.name for path in again] == ["log0.csv", "log1.csv", "log2.csv"]


def test_outputs_of_the_same_table_and_settings_are_kept(logs, tmp_path):
    first = compensate_each(logs, [probe()])
    output = tmp_path / "log0.compensated.csv"
    written = output.stat().st_mtime_ns
    second = compensate_each(logs, [probe()])
    assert [each.from_earlier_run for each in second.outcomes] == [True, False, True]
    assert output.stat().st_mtime_ns == written
    columns = ["rows", "noise_sd_K", "sd_max_K", "warnings"]
    pd.testing.assert_frame_equal(first.table[columns], second.table[columns])
    assert "(2 kept from before)" in second.headline()
    # another table, another sensor, or a lost output: made again
    text = logs[0].read_text(encoding="utf-8")
    logs[0].write_text(text.replace("20.", "21."), encoding="utf-8")
    (tmp_path / "log2.compensated.csv").unlink()
    third = compensate_each(logs, [probe()], overwrite=True)
    assert not any(each.from_earlier_run for each in third.outcomes)
    fourth = compensate_each(logs, [probe(3.0)])
    assert not any(each.from_earlier_run for each in fourth.outcomes)


def test_a_file_that_is_no_output_of_the_table_is_not_replaced(logs, tmp_path):
    output = tmp_path / "log0.compensated.csv"
    output.write_text("mine\n", encoding="utf-8")
    run = compensate_each(logs, [probe()])
    assert "exists already" in run.outcomes[0].error
    assert output.read_text(encoding="utf-8") == "mine\n"
    run = compensate_each(logs, [probe()], overwrite=True)
    assert run.outcomes[0].error == ""
    assert metadata_path(output).exists()


def test_two_files_with_one_output_are_refused_before_the_work(logs, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "log0.csv").write_bytes(logs[0].read_bytes())
    with pytest.raises(InputError, match="would both be written to"):
        compensate_each([logs[0], other / "log0.csv"], [probe()], tmp_path / "done")
    assert len(outputs_of([logs[0], other / "log0.csv"], ".x.csv")) == 2
    with pytest.raises(InputError, match="is a file"):
        compensate_each(logs, [probe()], logs[0])
    with pytest.raises(InputError, match="no files"):
        compensate_each([], [probe()])


@pytest.mark.long
@pytest.mark.e2e
def test_a_table_of_lags(tmp_path):
    paths = []
    for k, lag_s in enumerate((3.0, 5.0)):
        rng = np.random.default_rng(k)
        t = 0.2 * np.arange(250)
        rise = np.where(t > 5, 1 - np.exp(-(t - 5) / lag_s), 0.0)
        table = pd.DataFrame({"time_s": t, "T1_degC": 20 + 60 * rise + rng.normal(0, 0.05, 250)})
        paths.append(tmp_path / f"dip{k}.csv")
        table.to_csv(paths[-1], index=False)
    (tmp_path / "empty.csv").write_text("", encoding="utf-8")
    run = sensor_each([*paths, tmp_path / "empty.csv"], "plunge", "T1", tmp_path / "sensors")
    np.testing.assert_allclose(run.table["lag_s"][:2], [3.0, 5.0], rtol=0.02)
    assert run.exit_code == 1
    assert "empty" in run.table["error"][2]
    stored = read_sensor(tmp_path / "sensors" / "dip1.sensor.json")
    assert stored.sensor == "dip1"
    lag = stored.chain.channels["T1_degC"].lag_s
    assert run.table["lag_s"][1] == pytest.approx(lag.value, rel=1e-5)
    with pytest.raises(InputError, match="plunge or noise"):
        sensor_each(paths, "dip")
