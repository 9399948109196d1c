"""A run that falls behind its log says so, one that works off an old log does not."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from tcdyn.workflows.follow_pace import LOOK_EVERY_S, Pace


def told(waiting: Sequence[int]) -> tuple[list[int], Pace]:
    """What is told when so many rows wait at looks one after the other."""
    messages = list[int]()
    pace = Pace(messages.append)
    for k, rows in enumerate(waiting):
        pace.look(k * (LOOK_EVERY_S + 0.1), rows)
        pace.look(k * (LOOK_EVERY_S + 0.1) + 1.0, 10**6)  # too soon to look again
    return messages, pace


@pytest.mark.parametrize(
    "waiting",
    [[150, 151, 149, 150, 152, 150], [90_000, 60_000, 30_000, 150, 150], [100, 200, 300, 100, 200]],
    ids=["keeps up", "works off", "a pause of the machine"],
)
def test_a_run_that_keeps_up_says_nothing(waiting: list[int]) -> None:
    messages, pace = told(waiting)
    assert messages == []
    assert pace.most == 0


def test_a_run_that_falls_behind_says_it_once_with_the_rows_that_wait() -> None:
    messages, pace = told([150, 500, 900, 1300, 1700, 2100])
    assert messages == [1300]
    assert pace.most == 2100


def test_a_run_that_falls_behind_again_says_it_again() -> None:
    messages, pace = told([150, 500, 900, 1300, 200, 600, 1000, 1400])
    assert messages == [1300, 1400]
    assert pace.most == 1400
