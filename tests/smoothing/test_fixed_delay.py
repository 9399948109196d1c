"""A fixed delay: blocks that depend on the rows only, and a live run that gives what the batch run
gives."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.findings import Finding
from tcdyn.sensors import specified_sensor, write_sensor
from tcdyn.sensors.segments import START_ROWS, SegmentPosition, TableSegment, read_segments
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.sensors.sensor_world import Array, lagged, written

LAG_S = 25.0


class Rows:
    """A source of ``time_s`` (N,) [s] in chunks of so many rows; ``n`` is the number of the row."""

    def __init__(self, time_s: Array, sizes: Sequence[int], first: int = 0) -> None:
        self.time_s = time_s
        self.sizes = sizes
        self.first = first

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        number = np.arange(float(len(self.time_s)))
        start = self.first
        for size in (*self.sizes, len(number)):
            rows = slice(start, start + size)
            yield self.time_s[rows], dict.fromkeys(columns, number[rows]), ()
            start += size


def kept(segment: TableSegment) -> list[float]:
    return segment.data["n"][segment.keep].tolist()


def blocks(time_s: Array, sizes: Sequence[int], delay_s: float) -> list[tuple[float, ...]]:
    """First and last row that is read, and that is kept, of each block."""
    made = read_segments(Rows(time_s, sizes), ["n"], 2.0, delay_s=delay_s)
    return [(*s.data["n"][[0, -1]].tolist(), kept(s)[0], kept(s)[-1]) for s in made]


def stamps() -> Array:
    """8 rows a second; a long gap after row 1000, a short one after row 1700."""
    time_s = np.arange(2500) / 8
    time_s[1000:] += 100.0
    time_s[1700:] += 5.0
    return time_s


@pytest.mark.parametrize("delay_s", [0.0, 0.125, 1.0, 4.0, 30.0])
def test_blocks_do_not_depend_on_how_the_rows_come_and_wait_for_the_delay(delay_s: float) -> None:
    time_s = stamps()
    made = blocks(time_s, [], delay_s)
    rng = np.random.default_rng(0)
    assert blocks(time_s, [1] * 2500, delay_s) == made
    assert blocks(time_s, rng.integers(0, 60, 80).tolist(), delay_s) == made
    assert [n for _, _, a, b in made for n in range(int(a), int(b) + 1)] == list(range(2500))
    rows = delay_s * 8
    for first, last, first_kept, last_kept in made:
        assert (first < 1000) == (last < 1000)  # none over the long gap
        since = first_kept - (0 if first_kept < 1000 else 1000)
        assert first_kept - first == min(since, 400)  # 400 rows are more than ten lags of 2 s
        if last in (999, 2499):
            continue
        waits = last - first_kept
        assert waits == max(rows, START_ROWS - 1 - since)
        assert last - last_kept >= rows / 2


def test_a_reading_that_is_continued_makes_the_same_blocks() -> None:
    time_s = stamps()
    whole = list(read_segments(Rows(time_s, [50] * 60), ["n"], 2.0, delay_s=4.0))
    for k in (0, 3, 30, 58, 59, 60, 100):
        position = whole[k].position
        first = int(kept(whole[k])[-1]) + 1 - position.history_rows
        again = read_segments(
            Rows(time_s, [7] * 10, first), ["n"], 2.0, delay_s=4.0, position=position
        )
        for mine, theirs in zip(again, whole[k + 1 :], strict=True):
            assert np.array_equal(mine.data["n"], theirs.data["n"])
            assert mine.keep == theirs.keep
    assert whole[59].position != SegmentPosition(0.125, 0, 0)


def furnace(rows: int, seed: int) -> bytes:
    """A log of one row a second behind a lag of 25 s: steps of the set point, bursts, drop-outs,
    gaps."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 1.0
    x = 600 + 15 * np.sin(2 * np.pi * t / 4000)
    for at in rng.uniform(0, rows, max(rows // 3000, 1)):
        x += rng.choice([-60.0, 60.0]) * (1 - np.exp(-np.maximum(t - at, 0) / 40.0))
    y = lagged(x, (LAG_S,), 1.0) + 0.3 * rng.standard_normal(rows)
    for start in rng.integers(0, rows, rows // 1500):
        y[start : start + 4] += 8.0
    y[rng.integers(0, rows, rows // 400)] = 0.0
    text = [f"{a:.0f},{b:.2f},{c}" for a, b, c in zip(t, y, rng.integers(0, 9, rows))]
    for row in rng.integers(0, rows, rows // 300):
        stamp, _, more = text[row].split(",")
        text[row] = f"{stamp},,{more}"
    present = np.ones(rows, dtype=bool)
    for start in rng.integers(100, rows, max(rows // 5000, 1)):
        present[start : start + int(rng.choice([3, 40, 400]))] = False
    lines = [line for line, is_there in zip(text, present) if is_there]
    return ("time_s,T_degC,valve\n" + "\n".join(lines) + "\n").encode()


def growing(log: Path, content: bytes, pieces: int, seed: int) -> Callable[[float], None]:
    """A pause in which the next random piece of ``content`` is appended to the log."""
    rng = np.random.default_rng(seed)
    cuts = np.sort(rng.integers(0, len(content), pieces - 1)).tolist()
    left = [content[a:b] for a, b in zip([0, *cuts], [*cuts, len(content)])]

    def pause(_: float) -> None:
        if left:
            with log.open("ab") as stream:
                stream.write(left.pop(0))

    return pause


def live_and_batch(folder: Path, rows: int, pieces: int, seed: int) -> tuple[bytes, bytes]:
    """Rows of the live run of a log that grows in pieces, and of the batch run of the finished
    log."""
    content = furnace(rows, seed)
    finished = folder / "finished.csv"
    log = folder / "log.csv"
    finished.write_bytes(content)
    sensors = [specified_sensor("probe", ["T"], [(LAG_S, 1.0)])]
    compensate_table(finished, sensors, folder / "batch.csv", delay_s=2 * LAG_S)
    run = follow(
        log,
        sensors,
        folder / "live.csv",
        delay_s=2 * LAG_S,
        idle_s=0.2,
        sleep=growing(log, content, pieces, seed),
    )
    print(
        f"{rows} rows: {run.computing_s:.0f} s of the processor; {run.numbers.to_dict('records')}"
    )
    lines = [
        (folder / name).read_bytes().splitlines(keepends=True) for name in ("live.csv", "batch.csv")
    ]
    live, batch = (b"".join(line for line in each if line[:1] != b"#") for each in lines)
    return live, batch


@pytest.mark.long
@pytest.mark.e2e
def test_a_live_run_of_twenty_minutes_writes_what_the_batch_run_writes(tmp_path: Path) -> None:
    live, batch = live_and_batch(tmp_path, 1200, 60, 11)
    assert live == batch
    assert np.isfinite(written(tmp_path / "live.csv")["T_degC"]).all()


@pytest.mark.study
def test_a_live_run_of_a_day_writes_what_the_batch_run_writes(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """``python -m pytest -m study tests/smoothing/test_fixed_delay.py --full``."""
    if not request.config.getoption("--full"):
        pytest.skip("24 h of log: with --full")
    live, batch = live_and_batch(tmp_path, 86_400, 3000, 12)
    assert live == batch


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL is a POSIX signal")
def test_a_run_that_is_killed_and_started_again_writes_the_same_bytes(tmp_path: Path) -> None:
    """Killed while it computes, three times, the log growing in between; the last run ends by
    itself."""
    content = furnace(600, 13)
    sensor = tmp_path / "s.json"
    write_sensor(specified_sensor("probe", ["T"], [(LAG_S, 1.0)]), sensor)
    log = tmp_path / "log.csv"
    program = [sys.executable, "-m", "tcdyn", "follow", log, "--sensor", sensor]
    program += [
        "--delay-s",
        "20",
        "--out",
        tmp_path / "live.csv",
        "--state",
        tmp_path / "state.json",
    ]
    words = [*map(str, program), "--quiet", "--idle-s"]
    for share in (0.3, 0.6, 1.0):
        log.write_bytes(content[: int(share * len(content))])
        process = subprocess.Popen([*words, "100"], stderr=subprocess.DEVNULL)
        try:
            size = 0
            until = time.monotonic() + 60
            while size < share * 0.8 * len(content) * 0.5 and time.monotonic() < until:
                time.sleep(0.1)
                size = (
                    (tmp_path / "live.csv").stat().st_size
                    if (tmp_path / "live.csv").exists()
                    else 0
                )
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert (tmp_path / "state.json").exists()
    subprocess.run([*words, "0.3"], check=False, stderr=subprocess.DEVNULL)
    sensors = [specified_sensor("probe", ["T"], [(LAG_S, 1.0)])]
    follow(log, sensors, tmp_path / "once.csv", delay_s=20.0, idle_s=0.1)
    assert (tmp_path / "live.csv").read_bytes() == (tmp_path / "once.csv").read_bytes()
