"""A followed log or output that is replaced, rewritten, renamed or deleted; outputs that exist;
damaged state files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.checksum import CHECKSUM_KEY, checksum
from tcdyn.sensors import specified_sensor
from tcdyn.workflows.follow import FollowRun, follow
from tests.cli.test_main_job import tcdyn
from tests.sensors.sensor_world import logged, written

SENSORS = [specified_sensor("s", ["T1"], [(0.5, 0.02)])]
DELAY_S = 4.0
HEADER = "time_s,T1_degC,T2_degC\n"
Sleep = Callable[[float], None]


def rows(first: int, last: int, *, offset: float = 0.0) -> str:
    """Rows of two channels; the second one lies 100 K higher."""
    t = 0.05 * np.arange(900)
    y = 200 + t + 0.1 * np.random.default_rng(2).standard_normal(900)  # no event: quick to smooth
    return "".join(f"{t[k]:.2f},{y[k] + offset:.3f},{y[k] + 100:.3f}\n" for k in range(first, last))


def run(folder: Path, sleep: Sleep = lambda _: None, state: str = "", **options: bool) -> FollowRun:
    """Follow ``log.csv`` to ``out.csv``; ``sleep`` is called whenever nothing new is there."""
    kept = folder / state if state else None
    return follow(
        folder / "log.csv",
        SENSORS,
        folder / "out.csv",
        delay_s=DELAY_S,
        idle_s=0.05,
        state=kept,
        sleep=sleep,
        **options,
    )


def once(action: Callable[[], object]) -> Sleep:
    """A pause in which ``action`` happens the first time."""
    left = [action]

    def pause(_: float) -> None:
        if left:
            left.pop()()

    return pause


def start(folder: Path, count: int = 150) -> Path:
    log = folder / "log.csv"
    log.write_text(HEADER + rows(0, count), encoding="utf-8")
    return log


@pytest.mark.parametrize("state", ["", "new.json"])
def test_an_output_that_exists_is_refused_before_anything_is_read_or_written(
    tmp_path: Path, state: str
) -> None:
    start(tmp_path)
    out = tmp_path / "out.csv"
    out.write_text("precious\n", encoding="utf-8")
    with pytest.raises(
        InputError, match=r"exists already.*another out=FILE.*overwrite=True.*state=FILE"
    ):
        run(tmp_path, state=state)
    assert out.read_text(encoding="utf-8") == "precious\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.csv", "out.csv"]
    assert run(tmp_path, state=state, overwrite=True).rows_written == 150
    assert len(written(out)) == 150


def test_an_output_that_appears_while_the_header_is_waited_for_is_not_overwritten(
    tmp_path: Path,
) -> None:
    log = start(tmp_path, 1)
    out = tmp_path / "out.csv"

    def appears() -> None:
        out.write_text("precious\n", encoding="utf-8")
        with log.open("a", encoding="utf-8") as stream:
            stream.write(rows(1, 150))

    with pytest.raises(InputError, match="exists already"):
        follow(log, SENSORS, out, delay_s=DELAY_S, idle_s=1.0, sleep=once(appears))
    assert out.read_text(encoding="utf-8") == "precious\n"


def test_the_command_refuses_an_existing_output_and_overwrites_it_only_when_asked_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = start(tmp_path)
    out = tmp_path / "out.csv"
    sensor = tmp_path / "s.json"
    assert (
        tcdyn("sensor", "new", "--tau-s", "0.5+-0.02", "--column", "T1", "--out", sensor, "-q") == 0
    )
    words = [
        "follow",
        log,
        "--sensor",
        sensor,
        "--out",
        out,
        "--delay-s",
        "4",
        "--idle-s",
        "0",
        "-q",
    ]
    assert tcdyn(*words) == 0
    before = out.read_bytes()
    capsys.readouterr()
    assert tcdyn(*words) == 2
    error = capsys.readouterr().err
    for option in ("another --out FILE", "--overwrite", "--state FILE"):
        assert option in error
    assert out.read_bytes() == before
    assert tcdyn(*words, "--overwrite") == 0


def test_a_state_file_does_not_continue_another_output(tmp_path: Path) -> None:
    log = start(tmp_path)
    run(tmp_path, state="s.json")
    with log.open("a", encoding="utf-8") as stream:
        stream.write(rows(150, 200))
    other = "precious line\n" * 10_000  # longer than the output that the state file remembers
    (tmp_path / "out.csv").write_text(other, encoding="utf-8")
    with pytest.raises(InputError, match="not the output that the state file remembers"):
        run(tmp_path, state="s.json")
    assert (tmp_path / "out.csv").read_text(encoding="utf-8") == other


def rotated(log: Path, text: str) -> None:
    """As log rotation does it: the log is renamed and a new one takes its name."""
    log.rename(log.with_suffix(".1"))
    log.write_text(text, encoding="utf-8")


def exchanged(log: Path, text: str) -> None:
    """Rewritten in place: the same inode, never seen shorter."""
    log.write_text(text, encoding="utf-8")


SWAPPED = HEADER.replace("T1_degC,T2_degC", "T2_degC,T1_degC")
REPLACEMENTS = {
    "rotated, channels exchanged": (rotated, SWAPPED + rows(0, 300)),
    "rotated, the same header": (rotated, HEADER + rows(0, 300, offset=1.0)),
    "rotated, still short": (rotated, HEADER),
    "copied and truncated": (exchanged, HEADER),
    "truncated and grown again": (exchanged, HEADER + rows(0, 300, offset=1.0)),
    "rewritten with another header of the same length": (exchanged, SWAPPED + rows(0, 300)),
    "deleted": (lambda log, _: log.unlink(), ""),
}


@pytest.mark.e2e
@pytest.mark.parametrize("kind", REPLACEMENTS)
def test_a_log_that_is_replaced_or_rewritten_stops_the_run_and_keeps_its_rows(
    tmp_path: Path, kind: str
) -> None:
    log = start(tmp_path)
    original = log.read_text(encoding="utf-8")
    change, text = REPLACEMENTS[kind]
    with pytest.raises(InputError, match="150 rows before that are in") as error:
        run(tmp_path, once(lambda: change(log, text)), "s.json")
    assert "replaced, rotated or rewritten" in str(error.value)
    done = written(tmp_path / "out.csv")
    assert len(done) == 150
    # Output and state are whole: with the log as it was, the run goes on to what an uninterrupted
    # one writes.
    log.unlink(missing_ok=True)
    log.write_text(original + rows(150, 230), encoding="utf-8")
    assert run(tmp_path, state="s.json").rows_written == 230
    whole = tmp_path / "whole"
    whole.mkdir()
    (whole / "log.csv").write_text(original + rows(150, 230), encoding="utf-8")
    run(whole)
    assert (tmp_path / "out.csv").read_bytes() == (whole / "out.csv").read_bytes()


def test_a_copy_of_the_log_with_more_rows_may_take_its_place(tmp_path: Path) -> None:
    """As programs that synchronise folders write it: beside, then renamed."""
    log = start(tmp_path)

    def synchronised() -> None:
        beside = tmp_path / "beside"
        beside.write_text(HEADER + rows(0, 230), encoding="utf-8")
        os.replace(beside, log)

    assert (
        follow(
            log,
            SENSORS,
            tmp_path / "out.csv",
            delay_s=DELAY_S,
            idle_s=0.1,
            sleep=once(synchronised),
        ).rows_written
        == 230
    )


def renamed(out: Path) -> None:
    out.rename(out.with_name("moved.csv"))


def replaced(out: Path) -> None:
    text = out.read_bytes()
    out.unlink()
    out.with_name("hold").touch()  # so that the inode is not used again
    out.write_bytes(text)


def appended(out: Path) -> None:
    with out.open("a", encoding="utf-8") as stream:
        stream.write("a note\n")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (renamed, "renamed or deleted"),
        (lambda out: out.unlink(), "renamed or deleted"),
        (replaced, "replaced"),
        (appended, "changed by another program"),
        (lambda out: os.truncate(out, 50), "changed by another program"),
    ],
    ids=["renamed", "deleted", "replaced", "appended to", "truncated"],
)
@pytest.mark.parametrize("grows", [False, True])
def test_an_output_that_is_renamed_deleted_or_changed_stops_the_run_and_names_the_rows(
    tmp_path: Path, change: Callable[[Path], object], reason: str, grows: bool
) -> None:
    log = start(tmp_path)

    def both() -> None:
        change(tmp_path / "out.csv")
        if grows:
            with log.open("a", encoding="utf-8") as stream:
                stream.write(rows(150, 230))

    with pytest.raises(InputError, match=f"{reason}.*rows 1 to 82"):
        follow(log, SENSORS, tmp_path / "out.csv", delay_s=DELAY_S, idle_s=0.1, sleep=once(both))


def test_names_with_commas_and_quotes_come_back_from_a_semicolon_log(tmp_path: Path) -> None:
    t, _, y = logged((0.5,), 0.05, 150, 0.1, 2)
    lines = "".join(f"{a:.2f};{b:.3f};5\n" for a, b in zip(t, y))
    log = tmp_path / "log.csv"
    log.write_text('time_s;"gas, left_degC";the "old" one\n' + lines, encoding="utf-8")
    sensors = [specified_sensor("s", ["gas, left"], [(0.5, 0.02)])]
    follow(log, sensors, tmp_path / "out.csv", delay_s=DELAY_S, idle_s=0.0, sleep=lambda _: None)
    done = written(tmp_path / "out.csv")
    results = ["gas, left_logged_degC", "gas, left_degC", "gas, left_u_K"]
    assert list(done) == ["time_s", *results, 'the "old" one']
    assert done["time_s"].to_numpy() == pytest.approx(t)
    assert (done['the "old" one'] == 5).all()


@pytest.mark.e2e
@pytest.mark.parametrize("character", ["\u0085", "\u20ac\u0145", "\x0b", "\x0c", "\x1c", "\u2028"])
def test_a_character_that_only_python_takes_for_a_line_end_cuts_no_row(
    tmp_path: Path, character: str
) -> None:
    """U+0145 is C5 85 in UTF-8: its second byte is a line end in latin-1, for str.splitlines."""
    t, _, y = logged((0.5,), 0.05, 150, 0.1, 2)
    lines = "".join(f"{a:.2f};{b:.3f};x{character}y\r\n" for a, b in zip(t, y))
    log = tmp_path / "log.csv"
    log.write_text("time_s;T1_degC;remark\r\n" + lines, encoding="utf-8", newline="")
    done = follow(
        log, SENSORS, tmp_path / "out.csv", delay_s=DELAY_S, idle_s=0.0, sleep=lambda _: None
    )
    assert (done.rows_written, done.bad_lines) == (150, 0)


def damaged(change: Callable[[dict], object]) -> Callable[[Path], None]:
    """A change of the content of a state file, its checksum made to fit: the worst case."""

    def write(path: Path) -> None:
        data = json.loads(path.read_text(encoding="utf-8"))
        change(data)
        plain = {k: v for k, v in data.items() if k != CHECKSUM_KEY}
        path.write_text(json.dumps({**plain, CHECKSUM_KEY: checksum(plain)}), encoding="utf-8")

    return write


def flipped(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    at = text.index('"interval_s"') + 14
    digit = next(k for k in range(at, len(text)) if text[k].isdigit())
    path.write_text(text[:digit] + str(9 - int(text[digit])) + text[digit + 1 :], encoding="utf-8")


@pytest.mark.parametrize(
    "change",
    [
        flipped,
        lambda path: path.write_bytes(path.read_bytes()[:300]),
        lambda path: path.write_bytes(b"\xff\xfe\x00"),
        damaged(lambda data: data.pop("position")),
        damaged(lambda data: data.update(position=5)),
        damaged(lambda data: data.update(position={})),
        damaged(lambda data: data["position"].update(interval_s="x")),
        damaged(lambda data: data.update(written="x")),
        damaged(lambda data: data.update(read=[])),
        damaged(lambda data: data.update(offset=None)),
        damaged(lambda data: data.pop("out_sha256")),
    ],
)
def test_a_damaged_state_file_is_named_with_a_remedy_and_nothing_is_changed(
    tmp_path: Path, change: Callable[[Path], object]
) -> None:
    start(tmp_path)
    run(tmp_path, state="s.json")
    before = (tmp_path / "out.csv").read_bytes()
    change(tmp_path / "s.json")
    with pytest.raises(InputError, match=r"s\.json.*delete .*s\.json and give another out=FILE"):
        run(tmp_path, state="s.json")
    assert (tmp_path / "out.csv").read_bytes() == before


def test_rows_are_the_same_with_and_without_the_checks(tmp_path: Path) -> None:
    start(tmp_path)
    assert {f.code for f in run(tmp_path).findings} <= {"sensor.carried"}
    assert np.isfinite(written(tmp_path / "out.csv")).all(axis=None)
