"""Jobs side by side: their answers are those of one core, whatever becomes of the copies that work on them."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import Progress

from tcdyn import cores
from tcdyn.cores import side_by_side
from tcdyn.pipeline import compensate_log, estimate_beta
from tcdyn.pipeline.beta import BetaRun
from tests.conftest import Campaign

ASKED = 3


@pytest.fixture
def several(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three cores, and none of the threads that the test run itself has."""
    monkeypatch.setenv(cores.CORES, str(ASKED))
    monkeypatch.setattr(cores.threading, "enumerate", lambda: [threading.current_thread()])


def where(_: object) -> int:
    return os.getpid()


@pytest.mark.usefixtures("several")
def test_answers_come_in_the_order_of_the_jobs_from_as_many_processes_as_asked() -> None:
    found = side_by_side(lambda k: (k**2, os.getpid()), range(7))
    assert [square for square, _ in found] == [k**2 for k in range(7)]
    assert len({pid for _, pid in found}) == ASKED
    assert len(set(side_by_side(where, range(7), most=2))) == 2
    assert side_by_side(where, []) == []


@pytest.mark.usefixtures("several")
def test_who_is_done_first_takes_what_is_left(tmp_path: Path) -> None:
    def job(k: int) -> int:
        until = time.monotonic() + 20
        if k == 0:  # done when all others are
            while len(list(tmp_path.iterdir())) < 9 and time.monotonic() < until:
                time.sleep(0.005)
        (tmp_path / str(k)).touch()
        return os.getpid()

    home, *others = side_by_side(job, range(10), most=2)
    assert home not in others
    many = cores.TURNS + 5  # more than there are turns to give: some turns are two jobs
    assert side_by_side(lambda k: k, range(many)) == [*range(many)]


@pytest.mark.usefixtures("several")
def test_a_job_does_not_divide_again() -> None:
    for inner in side_by_side(lambda _: (os.getpid(), side_by_side(where, range(4))), range(3)):
        assert set(inner[1]) == {inner[0]}
    assert os.environ[cores.CORES] == str(ASKED)


def killed(home: int) -> Callable[[int], int]:
    def job(k: int) -> int:
        if os.getpid() != home:
            os._exit(3)
        return k

    return job


def interrupted(home: int) -> Callable[[int], int]:
    def job(k: int) -> int:
        if os.getpid() != home:
            raise KeyboardInterrupt
        return k

    return job


@pytest.mark.usefixtures("several")
@pytest.mark.parametrize("fails", [killed, interrupted])
def test_what_a_copy_does_not_answer_is_done_here(fails: Callable[[int], Callable[[int], int]]) -> None:
    assert side_by_side(fails(os.getpid()), range(5)) == [*range(5)]


@pytest.mark.usefixtures("several")
def test_what_cannot_be_pickled_is_done_here() -> None:
    assert [f(2) for f in side_by_side(lambda k: lambda x: k * x, range(4))] == [0, 2, 4, 6]


@pytest.mark.usefixtures("several")
def test_an_error_is_raised_where_it_was_asked_for() -> None:
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda k: 1 / (k - 1), range(4))  # job 1 is a copy's


@pytest.mark.usefixtures("several")
def test_without_a_copy_to_be_had_all_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused() -> int:
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", refused)
    assert set(side_by_side(where, range(4))) == {os.getpid()}


@pytest.mark.usefixtures("several")
def test_nothing_is_left_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        side_by_side(where, range(4))
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("asked", ["1", "0"])
def test_one_core_means_one_process(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores.threading, "enumerate", lambda: [threading.current_thread()])
    monkeypatch.setenv(cores.CORES, asked)
    assert set(side_by_side(where, range(4))) == {os.getpid()}


def test_a_process_with_threads_is_not_copied_unless_they_only_redraw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(cores.CORES, "2")
    strangers = [t for t in threading.enumerate() if t is not threading.current_thread()]
    every = threading.enumerate
    monkeypatch.setattr(cores.threading, "enumerate", lambda: [t for t in every() if t not in strangers])
    with Progress(console=Console(file=StringIO(), force_terminal=True)):
        assert len(every()) > len(strangers) + 1
        assert len(set(side_by_side(where, range(2)))) == 2
    done = threading.Event()
    other = threading.Thread(target=done.wait)
    other.start()
    try:
        assert len(set(side_by_side(where, range(2)))) == 1
    finally:
        done.set()
        other.join()


@pytest.mark.usefixtures("several")
def test_the_numbers_are_those_of_one_core(
    campaign: Campaign, beta_run: BetaRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, frames = campaign.files.ehl["B3"], []  # that run was made on one
    for asked in ("2", "1"):
        monkeypatch.setenv(cores.CORES, asked)
        frames.append(compensate_log(log, campaign.records, campaign.rig).frame)
    assert frames[0].equals(frames[1])
    monkeypatch.setenv(cores.CORES, "2")
    assert estimate_beta(log, campaign.rig, campaign.records).to_dict() == beta_run.to_dict()
