"""Signals to stop: exit codes, what remains, and systems that have other signals."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from tcdyn.cli import follow, start, stop_signals
from tcdyn.cli.app import _stop_as_with_ctrl_c
from tcdyn.version import __version__
from tests.cli.fuzz import World
from tests.cli.signal_study import (
    COMMANDS,
    SHARED_MEMORY,
    STOPPED,
    StoppedCommand,
    shared_memory_of,
    stopped_campaign,
)

ON_LINUX = pytest.mark.skipif(not SHARED_MEMORY.is_dir(), reason="looks at /proc and /dev/shm")
CAMPAIGN_S = 15.0  # of LOGS logs in two processes on an idle machine


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    return World.made(tmp_path_factory.mktemp("signals"))


@ON_LINUX
@pytest.mark.e2e
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.long) for s in (1, 2))])
def test_a_campaign_that_is_stopped_leaves_no_worker_and_no_shared_memory(
    world: World, tmp_path: Path, seed: int
) -> None:
    """50 trials: `python -m tests.cli.signal_study workers 50 1`."""
    rng = np.random.default_rng(seed)
    done = stopped_campaign(world, tmp_path / "campaign", rng, CAMPAIGN_S)
    assert not done.wrong, (done.code, done.error)


@ON_LINUX
@pytest.mark.e2e
@pytest.mark.parametrize("name", COMMANDS[:3])
def test_a_command_that_is_stopped_leaves_no_part_of_an_output(world: World, name: str) -> None:
    """100 trials: `python -m tests.cli.signal_study commands 100 1`."""
    command = StoppedCommand(world, name)
    done = command.stop(np.random.default_rng(len(name)))
    assert not done.wrong, (done.code, done.error)


@ON_LINUX
def test_the_study_finds_processes_and_memory_that_remain(tmp_path: Path) -> None:
    """A shell whose child outlives it, and an entry of shared memory in its name."""
    from tests.cli.signal_study import processes_of_session

    child = subprocess.Popen(["sleep", "60"], start_new_session=True)
    entry = SHARED_MEMORY / f"sem.test-{child.pid}-x"
    entry.touch()
    try:
        assert processes_of_session(child.pid) == {child.pid}
        assert shared_memory_of({child.pid}) == [entry.name]
    finally:
        entry.unlink()
        child.kill()
        child.wait()
    assert processes_of_session(child.pid) == set()


@pytest.fixture
def handlers() -> object:
    """Restore the handlers of signals after the test."""
    previous = {number: signal.getsignal(number) for number in stop_signals.stop_signals()}
    yield
    for number, handler in previous.items():
        signal.signal(number, handler)


def test_a_system_without_sighup_stops_by_the_other_signals(
    monkeypatch: pytest.MonkeyPatch, handlers: object
) -> None:
    """As Windows; its SIGBREAK is simulated by a signal that this system has."""
    monkeypatch.delattr(signal, "SIGHUP", raising=False)
    monkeypatch.setattr(signal, "SIGBREAK", signal.SIGABRT, raising=False)
    numbers = {signal.SIGINT, signal.SIGTERM, signal.SIGABRT}
    assert set(stop_signals.stop_signals()) == numbers
    before = signal.getsignal(signal.SIGABRT)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        _stop_as_with_ctrl_c()
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
        assert signal.getsignal(signal.SIGABRT) is signal.default_int_handler
        with follow._watch_stop_signals() as is_requested:
            signal.raise_signal(signal.SIGABRT)
            assert is_requested()
        assert signal.getsignal(signal.SIGABRT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGABRT, before)


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there is no SIGHUP")
def test_follow_ends_at_every_signal_but_those_that_are_ignored(handlers: object) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
        with follow._watch_stop_signals() as is_requested:
            assert not is_requested()
            signal.raise_signal(number)
            assert is_requested()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    _stop_as_with_ctrl_c()
    with follow._watch_stop_signals() as is_requested:
        signal.raise_signal(signal.SIGHUP)
        assert not is_requested()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_follow_in_a_thread_changes_no_handler() -> None:
    before = [signal.getsignal(number) for number in stop_signals.stop_signals()]
    within = []

    def target() -> None:
        with follow._watch_stop_signals():
            within.append([signal.getsignal(number) for number in stop_signals.stop_signals()])

    thread = threading.Thread(target=target)
    thread.start()
    thread.join()
    assert within == [before]


def test_ctrl_c_while_libraries_are_imported_prints_nothing(
    monkeypatch: pytest.MonkeyPatch, handlers: object
) -> None:
    seen = []
    monkeypatch.setattr("tcdyn.cli.app.main", lambda: seen.append(signal.getsignal(signal.SIGINT)))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    start.command()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # in the background of a shell
    start.command()
    assert seen == [signal.SIG_DFL, signal.SIG_IGN]


@pytest.mark.e2e
@ON_LINUX
def test_ctrl_c_where_python_cannot_raise_it_ends_the_command_with_one_line() -> None:
    """Here in a destructor; Python would print "Exception ignored in" and go on."""
    code = """
import signal, time
from tcdyn.cli import app

class Interrupted:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def command():
    Interrupted()
    for _ in range(100):
        time.sleep(0.1)
    print("went on")

signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
app.app = command
app.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", STOPPED)


@pytest.mark.e2e
def test_python_m_is_the_command() -> None:
    words = [sys.executable, "-m", "tcdyn", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout == f"tcdyn {__version__}\n"


def test_the_entry_point_imports_no_library_first() -> None:
    code = "import sys, tcdyn.cli.start; print('numpy' in sys.modules, 'typer' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
