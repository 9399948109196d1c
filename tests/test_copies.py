"""Copies of the process are made by the command line only, and a copy runs none of its parent's signal handlers."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from joblib import Parallel, delayed
from joblib.externals.loky import get_reusable_executor

from tcdyn import cores
from tcdyn.cores import begun, side_by_side
from tcdyn.identify import IOData, fit, process, profile, simulate

WAIT_S = 60.0  # upper bound of each subprocess, far above what it takes


def process_of(_: object) -> int:
    return os.getpid()


def processes_used(jobs: int) -> int:
    """Number of processes that side_by_side used for ``jobs`` jobs."""
    return len(set(side_by_side(process_of, range(jobs))))


def interval_of_lag(seed: int) -> tuple[float, float, float]:
    """Lag [s] of a simulated record with its profile interval, whose two sides are independent jobs."""
    u = np.repeat([20.0, 80.0, 20.0], 60)
    model = process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12})
    noise = np.random.default_rng(seed).normal(0, 0.2, len(u))
    data = IOData.from_arrays(u, simulate(model, u, 0.05, "zoh") + noise, 0.05, hold="zoh")
    estimate, _ = profile(fit(data, "P1D"), "Tp1")
    return estimate.value, estimate.low95, estimate.high95


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cores allowed by the environment, and no thread of the test run is visible."""
    monkeypatch.setenv(cores.CORES, "2")
    monkeypatch.setattr(cores.threading, "enumerate", lambda: [threading.current_thread()])


@pytest.fixture
def copies(two_cores: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in the command line's own process."""
    monkeypatch.setattr(cores, "_copies_of", None)
    cores.allow_copies()


def script(code: str, folder: Path) -> str:
    """Standard output of a Python script in a process of its own, with two cores."""
    environment = {**os.environ, cores.CORES: "2"}
    call = [sys.executable, "-c", code]
    done = subprocess.run(
        call, capture_output=True, text=True, env=environment, cwd=folder, timeout=WAIT_S, start_new_session=True
    )
    assert done.stderr == ""
    assert done.returncode == 0
    return done.stdout


@pytest.mark.usefixtures("two_cores")
def test_the_imported_library_is_serial() -> None:
    assert processes_used(4) == 1
    assert begun(process_of, 1)(1) == os.getpid()


@pytest.mark.usefixtures("copies")
def test_the_permission_ends_with_the_process_that_has_it() -> None:
    assert processes_used(4) == 2
    pool = multiprocessing.get_context("fork").Pool(1)  # a daemonic worker, forked from the permitted process
    with pool:
        assert pool.apply(processes_used, (4,)) == 1
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork")) as executor:
        assert executor.submit(processes_used, 4).result() == 1


@pytest.mark.usefixtures("copies")
def test_the_environment_is_left_as_it_is() -> None:
    before = dict(os.environ)
    assert side_by_side(lambda _: os.environ.get(cores.CORES), range(3)) == ["2", "2", "2"]
    assert begun(os.getenv, cores.CORES)(cores.CORES) == "2"
    assert dict(os.environ) == before


def test_threads_leave_the_environment_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two calls that overlap had left TCDYN_CORES=1 behind."""
    monkeypatch.delenv(cores.CORES, raising=False)
    before = dict(os.environ)
    together = threading.Barrier(2, timeout=WAIT_S)

    def long_and_short(name: str) -> None:
        """Calls that overlap, of which the first to enter is the first to leave."""
        if name == "first":
            side_by_side(lambda _: (together.wait(), together.wait()), [0])
            together.wait()
        else:
            together.wait()
            side_by_side(lambda _: (together.wait(), together.wait()), [0])

    threads = [threading.Thread(target=long_and_short, args=(name,)) for name in ("first", "second")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(WAIT_S)
    assert dict(os.environ) == before


@pytest.mark.skipif(sys.platform != "linux", reason="copies are made on Linux only")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGUSR1"])
def test_no_handler_of_the_caller_runs_in_a_copy(name: str, tmp_path: Path) -> None:
    """Neither for a signal that comes while the copy is made, nor when the copy is ended."""
    code = (
        "import os, signal, sys, time\n"
        "from pathlib import Path\n"
        "from tcdyn.cores import allow_copies, begun, side_by_side\n"
        "home = os.getpid()\n"
        "def handler(number, frame):\n"
        "    with open('ran.txt', 'a') as file:\n"
        "        file.write(f'{os.getpid() == home}\\n')\n"
        f"signal.signal(signal.{name}, handler)\n"
        "allow_copies()\n"
        "os.register_at_fork(after_in_child=lambda: os.kill(os.getpid(), signal." + name + "))\n"
        "print(len(set(side_by_side(lambda _: (time.sleep(0.1), os.getpid())[1], range(4)))))\n"
        "answer = begun(time.sleep, 60)\n"
        "del answer\n"
        "time.sleep(0.2)\n"
        "print(Path('ran.txt').exists())\n"
        f"os.kill(home, signal.{name})\n"
        "print(Path('ran.txt').read_text().split())\n"
    )
    # The copy ends by the signal and its jobs are done in the parent, whose own handler works afterwards.
    assert script(code, tmp_path).splitlines() == ["1", "False", "['True']"]


@pytest.mark.skipif(sys.platform != "linux", reason="copies are made on Linux only")
def test_an_ignored_hangup_stays_ignored_in_a_copy(tmp_path: Path) -> None:
    code = (
        "import os, signal\n"
        "from tcdyn.cores import allow_copies, side_by_side\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "allow_copies()\n"
        "kept = side_by_side(lambda _: (os.getpid(), signal.getsignal(signal.SIGHUP) is signal.SIG_IGN), range(2))\n"
        "print(len(set(kept)), all(ignored for _, ignored in kept))\n"
    )
    assert script(code, tmp_path) == "2 True\n"


def test_pool_workers_give_the_numbers_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pool workers are daemonic; they had ended with an AssertionError."""
    here = interval_of_lag(1)
    assert np.isfinite(here).all()
    monkeypatch.delenv(cores.CORES, raising=False)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply(interval_of_lag, (1,)) == here
    workers = Parallel(n_jobs=2)
    assert workers(delayed(interval_of_lag)(1) for _ in range(2)) == [here, here]
    get_reusable_executor().shutdown(wait=True)


def test_a_script_that_calls_main_is_serial_and_the_command_is_not(tmp_path: Path) -> None:
    code = (
        "import os, sys\n"
        "from tcdyn.cli import app\n"
        "from tcdyn.cores import side_by_side\n"
        "app.run = lambda _: print(len(set(side_by_side(lambda _: os.getpid(), range(4))))) or 0\n"
        "try: app.main()\n"
        "except SystemExit: pass\n"
        "app.command()\n"
    )
    assert script(code, tmp_path).split() == ["1", "2"]
