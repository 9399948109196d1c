"""Jobs side by side: their answers are those of one core, whatever becomes of the copies that work on them."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

from tcdyn import cores
from tcdyn.cores import begun, side_by_side
from tcdyn.pipeline import compensate_log, estimate_beta
from tcdyn.pipeline.beta import BetaRun
from tests.conftest import Campaign

ASKED = 3


def allow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow copies of this process for the length of a test."""
    monkeypatch.setattr(cores, "_copies_of", None)
    cores.allow_copies()


@pytest.fixture
def several(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies allowed, three cores, and none of the threads that the test run itself has."""
    allow(monkeypatch)
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
    # the switch is back on after each call
    assert len({pid for pid, _ in side_by_side(lambda _: (os.getpid(), None), range(3))}) == ASKED
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
    def left() -> int:
        until = time.monotonic() + 20
        while (
            multiprocessing.active_children() and time.monotonic() < until
        ):  # gives back what those that are done held
            time.sleep(0.005)
        return len(os.listdir("/proc/self/fd"))

    gc.collect()  # of other tests
    before = left()
    for _ in range(3):
        side_by_side(where, range(4))
    assert left() <= before


@pytest.mark.parametrize("asked", ["1", "0"])
def test_one_core_means_one_process(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    allow(monkeypatch)
    monkeypatch.setattr(cores.threading, "enumerate", lambda: [threading.current_thread()])
    monkeypatch.setenv(cores.CORES, asked)
    assert set(side_by_side(where, range(4))) == {os.getpid()}


def test_a_process_with_threads_is_not_copied_unless_they_only_redraw(monkeypatch: pytest.MonkeyPatch) -> None:
    allow(monkeypatch)
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


@pytest.mark.usefixtures("several")
def test_large_arrays_come_back_as_they_were_and_may_be_written_to() -> None:
    """Where they lie in memory that was a copy's; small ones, slices and others come in the message."""
    rng = np.random.default_rng(0)
    made = [rng.normal(size=(40_000, 3)), rng.normal(size=(3, 40_000)).T, rng.integers(0, 9, 70_000, dtype=np.uint8)]
    made += [np.zeros(0), np.arange(5.0), rng.normal(size=90_000)[::2], np.asfortranarray(rng.normal(size=(9_000, 2)))]
    home = os.getpid()
    first, second = side_by_side(lambda _: (os.getpid(), {"of": made}), range(2))
    assert first[0] == home != second[0]
    for one, other in zip(made, second[1]["of"]):
        assert other.dtype == one.dtype
        assert np.array_equal(one, other)
        other += 1
        assert np.array_equal(one + 1, other)


@pytest.mark.usefixtures("several")
def test_without_memory_to_share_all_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> int:
        raise OSError("no memory")

    monkeypatch.setattr(os, "memfd_create", refused)
    assert set(side_by_side(where, range(4))) == {os.getpid()}
    assert begun(where, 1)(1) == os.getpid()
    monkeypatch.undo()


@pytest.mark.usefixtures("several")
def test_what_was_begun_is_answered_once_by_a_copy_and_then_as_ever() -> None:
    home, ask = os.getpid(), begun(lambda x, y=1: (os.getpid(), x + y), 2, y=3)
    assert ask(2) == (home, 3)  # of other arguments
    pid, found = ask(2, y=3)
    assert (pid != home, found) == (True, 5)
    assert ask(2, y=3) == (home, 5)


@pytest.mark.usefixtures("several")
def test_an_error_of_what_was_begun_is_raised_where_it_is_asked_for() -> None:
    ask = begun(lambda x: 1 / x, 0)
    with pytest.raises(ZeroDivisionError):
        ask(0)
    with pytest.raises(ZeroDivisionError):
        ask(0)


@pytest.mark.usefixtures("several")
def test_what_nobody_can_ask_for_any_more_is_ended_and_holds_nothing() -> None:
    gc.collect()
    others = {child.pid for child in multiprocessing.active_children()}  # of other tests
    before = len(os.listdir("/proc/self/fd"))
    ask = begun(time.sleep, 60)
    [child] = [child for child in multiprocessing.active_children() if child.pid not in others]
    del ask
    child.join(10)
    assert child.exitcode == -signal.SIGTERM
    child.close()
    assert len(os.listdir("/proc/self/fd")) <= before


@pytest.mark.usefixtures("several")
def test_a_copy_that_forgets_what_was_begun_does_not_stop_it() -> None:
    home, held = os.getpid(), [begun(lambda _: time.sleep(0.3) or os.getpid(), 1)]
    side_by_side(lambda _: time.sleep(0.2) if os.getpid() == home else held.clear(), range(2))
    assert held.pop()(1) != home


def test_an_interrupt_during_a_fork_is_not_lost_and_the_copy_says_nothing_of_it() -> None:
    code = (
        "import os, signal, time\n"
        "from tcdyn.cores import allow_copies, begun\n"
        "allow_copies()\n"
        "os.register_at_fork(after_in_parent=lambda: os.kill(0, signal.SIGINT))\n"  # of both
        "try: begun(time.sleep, 60); print('lost')\n"
        "except KeyboardInterrupt: print('told')\n"
    )
    env = {**os.environ, cores.CORES: "2"}
    call = [sys.executable, "-c", code]
    done = subprocess.run(call, capture_output=True, text=True, env=env, start_new_session=True, timeout=30, check=True)
    assert (done.stdout, done.stderr) == ("told\n", "")


def test_on_one_core_nothing_is_begun_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    allow(monkeypatch)
    monkeypatch.setenv(cores.CORES, "1")
    seen: list[int] = []
    ask = begun(seen.append, 1)
    assert seen == []
    ask(1)
    assert seen == [1]


@pytest.mark.usefixtures("several")
def test_without_a_pipe_to_be_had_what_was_begun_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(**_: object) -> int:
        raise OSError(24, "too many open files")

    before = len(os.listdir("/proc/self/fd"))
    monkeypatch.setattr(cores.multiprocessing, "Pipe", refused)
    assert begun(where, 1)(1) == os.getpid()
    assert set(side_by_side(where, range(4))) == {os.getpid()}
    assert len(os.listdir("/proc/self/fd")) <= before
