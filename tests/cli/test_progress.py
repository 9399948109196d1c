"""The time that a command still takes: told from what is done, by a clock of the test's own."""

from __future__ import annotations

from time import sleep

import pytest

from calibration.finding import look
from tcdyn.cli.common import TYPICAL, TimeLeft, in_one_line, stages

TYPICALLY = {"reading": 2.0, "fit": 6.0, "report": 2.0}


class Clock:
    """A clock that stands still until it is moved."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_nothing_is_told_before_a_stage_is_done(clock: Clock) -> None:
    left = TimeLeft(TYPICALLY, clock)
    left.begin("reading the log")
    clock.now = 100.0
    assert left.left_s() is None
    assert str(left) == ""


def test_a_machine_three_times_slower_takes_three_times_longer(clock: Clock) -> None:
    left = TimeLeft(TYPICALLY, clock)
    left.begin("reading the log")
    clock.now = 6.0
    left.begin("fits of both disks")
    assert left.left_s() == pytest.approx(3 * (6 + 2))
    assert str(left) == "about 25 s left"
    clock.now += 10.0
    left.begin("going on without fast_c")  # no stage of its own
    assert left.left_s() == pytest.approx(3 * (6 + 2) - 10)
    clock.now += 90.0  # longer than thought: what comes after is still ahead
    assert left.left_s() == pytest.approx(3 * 2)
    left.begin("report")
    assert left.left_s() == pytest.approx((6 + 100) / (2 + 6) * 2)  # and the rate has learnt of it


@pytest.mark.parametrize(
    ("reading_s", "said"), [(60.0, "about 4 min left"), (25.5, "about 2 min left"), (24.0, "about 95 s left"),
                            (0.25, "about 5 s left")],
)  # fmt: skip
def test_more_than_100_seconds_are_told_in_minutes_and_never_less_than_five(
    clock: Clock, reading_s: float, said: str
) -> None:
    """Fit and report take four times the reading."""
    left = TimeLeft(TYPICALLY, clock)
    left.begin("reading")
    clock.now = reading_s
    left.begin("fit")
    assert str(left) == said


def test_an_end_that_asks_for_a_look_tells_the_first_and_counts_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    found = [look("said", text="odd"), look("said", text="odder"), look("said", text="oddest")]
    for count, said in ((1, "odd\n"), (3, "odd (and 2 more)\n")):
        in_one_line("B3", found[:count])
        assert capsys.readouterr().err == f"tcdyn: B3: look: {said}"


def test_tests_still_to_come_count_without_their_report(clock: Clock) -> None:
    left = TimeLeft(TYPICALLY, clock)
    for what, s in (("reading", 2), ("fit", 6)):
        left.begin(what)
        clock.now += s
    left.begin("test 2 of 3: reading")
    assert left.left_s() == pytest.approx(10 + 8)
    assert str(TimeLeft({}, clock)) == ""


def test_an_unknown_command_tells_no_time(capsys: pytest.CaptureFixture[str]) -> None:
    with stages(False, verbose=True) as progress:
        progress("reading")
        progress("fit")
    assert "left" not in capsys.readouterr().err
    assert set(TYPICAL) >= {"beta", "calibrate", "compensate", "demo"}


def test_with_verbose_every_line_tells_the_time_gone_by(capsys: pytest.CaptureFixture[str]) -> None:
    with stages(quiet=False, verbose=True) as begin:
        begin("reading the log")
        sleep(0.2)
        begin("fit")
    lines = [line.split(maxsplit=3) for line in capsys.readouterr().err.splitlines()]
    assert [what for *_, what in lines] == ["reading the log", "fit", "done"]
    seconds = [float(s) for _, s, _, _ in lines]
    assert seconds == sorted(seconds)
    assert 0.1 < seconds[-1] < 5.0
