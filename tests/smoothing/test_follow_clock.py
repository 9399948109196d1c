"""A followed log whose clock jumps; and its last rows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core.errors import InputError
from tcdyn.io.csv_dialect import HEAD_BYTES
from tcdyn.io.read import open_table
from tcdyn.sensors import specified_sensor
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import FollowRun, follow
from tests.sensors.sensor_world import Array, logged, write, written

Change = Callable[[Array], Array]


def followed(folder: Path, change: Change, delay_s: float = 4.0) -> tuple[FollowRun, Array, Array]:
    """The run, the times logged and the times written."""
    t = 0.05 * np.arange(400)
    y = 200 + t + 0.1 * np.random.default_rng(2).standard_normal(400)  # no event: quick to smooth
    times = np.round(change(t), 3)
    log, out = write(folder / "log.csv", time_s=times, T1_degC=y), folder / "out.csv"
    run = follow(
        log,
        [specified_sensor("s", ["T1"], [(0.5, 0.02)])],
        out,
        delay_s=delay_s,
        idle_s=0.0,
        poll_s=0.01,
    )
    done = written(out)
    assert np.isfinite(done.drop(columns="time_s")).all(axis=None)
    return run, times, done["time_s"].to_numpy()


def at(place: int | slice, time_s: float) -> Change:
    def change(t: Array) -> Array:
        t = t.copy()
        t[place] = time_s
        return t

    return change


@pytest.mark.e2e
@pytest.mark.parametrize("later_s", [0.0, 2.0, 100.0])
def test_rows_before_and_after_a_gap_are_all_written(tmp_path: Path, later_s: float) -> None:
    run, logged_s, written_s = followed(tmp_path, lambda t: t + later_s * (t > 15))
    assert written_s.tolist() == logged_s.tolist()
    assert {f.code for f in run.findings} <= {"series.lost"}


def test_a_clock_that_counts_from_1970_is_followed_as_one_that_begins_at_zero(
    tmp_path: Path,
) -> None:
    """The even grid begins at the first row, not at the clock's zero.

    Such a clock tells times to 0.2 us only: where two intensities are nearly equally likely, a
    block may get the other one.
    """
    temperatures = []
    for k, since in enumerate((0.0, 1.7e9)):
        (tmp_path / str(k)).mkdir()
        run, logged_s, written_s = followed(tmp_path / str(k), lambda t, since=since: t + since)
        assert written_s.tolist() == logged_s.tolist()
        assert {f.code for f in run.findings} <= {"series.lost"}
        temperatures.append(
            written(tmp_path / str(k) / "out.csv").drop(columns="time_s").to_numpy()
        )
    difference = np.abs(temperatures[0] - temperatures[1])[:, 0]
    assert np.median(difference) < 1e-4
    assert (difference < 0.5 * temperatures[0][:, 1]).all()


@pytest.mark.e2e
@pytest.mark.parametrize("delay_s", [2.0, 5.0])
@pytest.mark.parametrize(
    ("change", "lost"),
    [
        (at(300, -1e9), 1),
        (at(300, np.nan), 1),
        (lambda t: t - 3.0 * (t > 15), 59),
        (at(3, -1e9), 1),
        (lambda t: np.where(t > 15, t - 3600, t), 99),
    ],
    ids=["one row long ago", "one row without", "back 3 s", "at the start", "back an hour"],
)
def test_a_clock_that_jumps_back_is_told(
    tmp_path: Path, change: Change, lost: int, delay_s: float
) -> None:
    run, logged_s, written_s = followed(tmp_path, change, delay_s)
    assert [f.numbers["count"] for f in run.findings if f.code == "delay.backward"] == [lost]
    rising = np.fmax.accumulate(np.concatenate([[-np.inf], logged_s]))
    assert written_s.tolist() == logged_s[logged_s >= rising[:-1]].tolist()
    assert run.rows_written == len(logged_s) - lost


@pytest.mark.e2e
@pytest.mark.parametrize(
    "delay_s", [0.05, *(pytest.param(x, marks=pytest.mark.long) for x in (0.0, 0.02, 0.133))]
)
def test_a_dead_time_of_part_of_a_sample_is_taken_out(tmp_path: Path, delay_s: float) -> None:
    dt_s, chain = 0.05, Chain((0.5,), delay_s=delay_s, conditioning=NO_CONDITIONING)
    t = dt_s * np.arange(600)
    true = 50 + 10 * np.sin(2 * np.pi * t / 20)  # 3 K/s: a tenth of a sample is 0.016 K
    y = np.ravel(chain.response(true, dt_s)) + 0.003 * np.random.default_rng(1).standard_normal(
        len(t)
    )
    log, out = write(tmp_path / "log.csv", time_s=np.round(t, 3), T1_degC=y), tmp_path / "out.csv"
    sensor = specified_sensor("s", ["T1"], [(0.5, 0.001)], delay_s=(delay_s, 0.0))
    follow(
        log,
        [sensor],
        out,
        delay_s=5.0,
        idle_s=0.0,
        poll_s=0.01,
    )
    off = (written(out)["T1_degC"].to_numpy() - true)[t < 25.0][200:]
    assert np.sqrt(np.mean(off**2)) < 0.016


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("form", "start"),
    [("%d.%m.%Y %H:%M:%S.%f", "2026-03-09T23:59:58"), ("%H:%M:%S.%f", None)],
    ids=["with the date", "time of day"],
)
def test_a_log_with_clock_stamps_is_followed_over_midnight_and_over_a_restart(
    tmp_path: Path, form: str, start: str | None
) -> None:
    """The rows of a run with the same delay over the finished log, stamps to the letter."""
    rng = np.random.default_rng(5)
    t = 0.05 * np.arange(700)
    stamps = (pd.Timestamp("2026-03-09 23:59:58") + pd.to_timedelta(t, "s")).strftime(form)
    y = 200 + t + 0.1 * rng.standard_normal(700)
    finished = tmp_path / "finished.csv"
    log = tmp_path / "log.csv"
    live = tmp_path / "live.csv"
    pd.DataFrame({"time": stamps, "T1_degC": y}).to_csv(finished, index=False)
    lines = finished.read_text(encoding="utf-8").splitlines(keepends=True)
    sensors = [specified_sensor("s", ["T1"], [(0.5, 0.02)])]
    for rows in (600, 700):  # the second run reads from a row after midnight on
        log.write_text("".join(lines[: rows + 1]), encoding="utf-8")
        state = tmp_path / "state.json"
        follow(log, sensors, live, delay_s=4.0, idle_s=0.0, poll_s=0.01, state=state)
    batch = compensate_table(finished, sensors, tmp_path / "batch.csv", delay_s=4.0)
    assert live.read_bytes() == batch.path.read_bytes()
    assert written(live)["time"].tolist() == stamps.tolist()
    assert open_table(live).metadata.get("start_time") == start
    assert open_table(batch.path).metadata.get("start_time") == start


def test_a_head_is_waited_for_while_the_log_is_short_and_refused_when_it_is_long(
    tmp_path: Path,
) -> None:
    t, _, y = logged((0.5,), 0.05, 300, 0.1, 2, rise_K=0.0)
    whole = write(tmp_path / "whole.csv", time_s=np.round(t, 3), T1_degC=y).read_text(
        encoding="utf-8"
    )
    sensors, log, out = (
        [specified_sensor("s", ["T1"], [(0.5, 0.02)])],
        tmp_path / "log.csv",
        tmp_path / "out.csv",
    )
    log.write_text(whole[:10], encoding="utf-8")  # "time_s,T1_": the logger has not got further

    def goes_on(_: float) -> None:
        log.write_text(whole, encoding="utf-8")

    run = follow(
        log,
        sensors,
        out,
        delay_s=6.0,
        idle_s=0.2,
        poll_s=0.01,
        sleep=goes_on,
    )
    assert run.rows_written == 300

    def waits(_: float) -> None:
        raise AssertionError("waits for a head that is there")

    log.write_text(whole.replace("T1", "X") * 20, encoding="utf-8")
    assert log.stat().st_size > HEAD_BYTES
    with pytest.raises(InputError):
        follow(log, sensors, tmp_path / "other.csv", idle_s=60.0, poll_s=0.01, sleep=waits)
