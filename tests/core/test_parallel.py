"""Parallel map, and calls of the library from worker processes and threads of the caller."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from joblib import Parallel, delayed
from joblib.externals.loky import get_reusable_executor
from threadpoolctl import threadpool_info

from tcdyn.core.errors import InputError
from tcdyn.core.parallel import parallel_map, worker_processes_end
from tcdyn.identification import IOData, fit, process, profile, simulate

WAIT_S = 60.0  # upper bound of each wait, far above the usual duration
NOWHERE = "tcp://127.0.0.1:9"  # the discard port: no Dask scheduler


@pytest.fixture
def workers_ended() -> Iterator[None]:
    """End joblib's worker processes after the test."""
    yield
    get_reusable_executor().shutdown(wait=True)


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a Dask scheduler with one worker in this process."""
    distributed = pytest.importorskip("dask.distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="tcp"
    ) as local:
        yield local.scheduler_address


def kill_process_of_job_1(job: int) -> int:
    if job == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return job


def wait_for_other_job(folder: Path, job: int) -> int:
    """Job 0 ends a second after job 1, also on a busy machine."""
    until = time.monotonic() + WAIT_S
    while job == 0 and not (folder / "1").exists() and time.monotonic() < until:
        time.sleep(0.005)
    if job == 0:
        time.sleep(1.0)
    (folder / str(job)).touch()
    return job


def blas_threads(_: object) -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def interval_of_lag(seed: int) -> tuple[float, float, float]:
    """Lag [s] of a simulated record with its profile interval."""
    u = np.repeat([20.0, 80.0, 20.0], 60)
    model = process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12})
    noise = np.random.default_rng(seed).normal(0, 0.2, len(u))
    data = IOData.from_arrays(u, simulate(model, u, 0.05, "zoh") + noise, 0.05, hold="zoh")
    estimate, _ = profile(fit(data, "P1D"), "Tp1")
    return estimate.value, estimate.low95, estimate.high95


def lag_and_environment(seed: int) -> tuple[tuple[float, float, float], bool]:
    """The interval, and whether the call left the environment of its process unchanged."""
    before = dict(os.environ)
    return interval_of_lag(seed), dict(os.environ) == before


@pytest.mark.e2e
@pytest.mark.usefixtures("workers_ended")
def test_one_worker_two_workers_and_dask_give_the_same_results(cluster: str) -> None:
    jobs = [float(x) for x in range(7)]
    expected = dict(parallel_map(np.cosh, jobs))
    assert dict(parallel_map(np.cosh, jobs, workers=2)) == expected
    assert dict(parallel_map(np.cosh, jobs, dask=cluster)) == expected


@pytest.mark.e2e
@pytest.mark.usefixtures("workers_ended")
def test_results_are_returned_in_order_of_completion(tmp_path: Path) -> None:
    assert [*parallel_map(partial(wait_for_other_job, tmp_path), [0, 1], workers=2)] == [
        (1, 1),
        (0, 0),
    ]


@pytest.mark.usefixtures("workers_ended")
def test_number_of_processes_is_at_most_that_of_workers() -> None:
    def process_id(_: int) -> int:
        return os.getpid()

    assert {pid for _, pid in parallel_map(process_id, range(4))} == {os.getpid()}
    pids = {pid for _, pid in parallel_map(process_id, range(8), workers=2)}
    assert os.getpid() not in pids
    assert len(pids) <= 2
    assert [*parallel_map(process_id, [], workers=2)] == []


@pytest.mark.usefixtures("workers_ended")
def test_worker_processes_end_after_their_last_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tcdyn.core.parallel.IDLE_S", 0.1)
    get_reusable_executor().shutdown(wait=True)  # those of other tests have a longer time
    before = {child.pid for child in multiprocessing.active_children()}
    assert dict(parallel_map(abs, [-1, 2, -3], workers=2)) == {0: 1, 1: 2, 2: 3}
    until = time.monotonic() + WAIT_S
    while {child.pid for child in multiprocessing.active_children()} - before:
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.usefixtures("workers_ended")
def test_a_handler_of_the_program_does_not_run_in_its_worker_processes(tmp_path: Path) -> None:
    """Version 0.2 ran it in forked copies, where it deleted the temporary files of the program."""
    previous = signal.signal(signal.SIGTERM, lambda *_: (tmp_path / "ran").touch())
    try:
        assert dict(parallel_map(abs, [-1, 2, -3], workers=2)) == {0: 1, 1: 2, 2: 3}
        workers = multiprocessing.active_children()
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.join(WAIT_S)
    finally:
        signal.signal(signal.SIGTERM, previous)
    assert workers
    assert not (tmp_path / "ran").exists()


def sizes_without_a_warning(workers: int) -> dict[int, object]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return dict(parallel_map(abs, [-1, 2, -3], workers=workers))


@pytest.mark.skipif(sys.platform != "linux", reason="a forked pool is quick")
def test_a_daemonic_process_computes_the_jobs_itself() -> None:
    """A worker of multiprocessing.Pool may not have children; 0.2 ended in AssertionError."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert pool.apply(sizes_without_a_warning, (2,)) == {0: 1, 1: 2, 2: 3}


@pytest.mark.e2e
@pytest.mark.usefixtures("workers_ended")
def test_workers_use_one_blas_thread(cluster: str) -> None:
    assert [threads for _, threads in parallel_map(blas_threads, range(2), workers=2)] == [{1}, {1}]
    assert [threads for _, threads in parallel_map(blas_threads, range(2), dask=cluster)] == [
        {1},
        {1},
    ]


@pytest.mark.usefixtures("workers_ended")
def test_exception_in_a_worker_process_is_raised() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        list(parallel_map(int, ["7", "x"], workers=2))


@pytest.mark.e2e
@pytest.mark.usefixtures("workers_ended")
@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_killed_worker_process_raises_with_advice() -> None:
    with pytest.raises(InputError, match=r"worker process was killed.*fewer workers"):
        list(parallel_map(kill_process_of_job_1, range(3), workers=2))


def test_less_than_one_worker_raises() -> None:
    with pytest.raises(InputError, match="at least 1"):
        list(parallel_map(abs, [1], workers=0))


def test_exception_in_a_dask_worker_is_the_result_of_its_job(cluster: str) -> None:
    results = dict(parallel_map(int, ["7", "x"], dask=cluster))
    assert results[0] == 7
    assert isinstance(results[1], ValueError)


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_killed_dask_worker_fails_its_own_job_only() -> None:
    distributed = pytest.importorskip("dask.distributed")
    dask = pytest.importorskip("dask")
    no_retry = {"distributed.scheduler.allowed-failures": 0}
    with (
        dask.config.set(no_retry),
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=":0"
        ) as local,
    ):
        results = dict(parallel_map(kill_process_of_job_1, [1, 2], dask=local.scheduler_address))
    assert isinstance(results[0], distributed.KilledWorker)
    assert len(results) == 2


def test_unreachable_scheduler_raises_with_advice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("dask.distributed")
    monkeypatch.setattr("tcdyn.core.parallel.CONNECT_S", 0.5)
    with pytest.raises(InputError, match=f"no Dask scheduler answers at {NOWHERE}"):
        list(parallel_map(abs, [1], dask=NOWHERE))


def test_missing_dask_raises_with_advice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    with pytest.raises(InputError, match="not installed"):
        list(parallel_map(abs, [1], dask=NOWHERE))


@pytest.mark.e2e
@pytest.mark.usefixtures("workers_ended")
def test_processes_and_threads_of_the_caller_give_the_same_numbers() -> None:
    """Workers of multiprocessing.Pool are daemonic and may not start processes of their own."""
    before = dict(os.environ)
    interval = interval_of_lag(1)
    assert np.isfinite(interval).all()
    expected = (interval, True)
    fork = multiprocessing.get_context("fork" if sys.platform == "linux" else None)
    with fork.Pool(1) as pool:
        assert pool.apply(lag_and_environment, (1,)) == expected
    with ProcessPoolExecutor(1, mp_context=fork) as processes:
        assert processes.submit(lag_and_environment, 1).result() == expected
    assert Parallel(n_jobs=2)(delayed(lag_and_environment)(1) for _ in range(2)) == [
        expected,
        expected,
    ]
    with ThreadPoolExecutor(2) as threads:
        assert [*threads.map(interval_of_lag, [1, 1])] == [interval, interval]
    assert dict(os.environ) == before


def test_library_starts_no_process_and_no_thread() -> None:
    threads = threading.active_count()
    children = {child.pid for child in multiprocessing.active_children()}
    interval_of_lag(1)
    assert threading.active_count() == threads
    assert {child.pid for child in multiprocessing.active_children()} == children


@pytest.mark.usefixtures("workers_ended")
def test_a_command_ends_its_worker_processes() -> None:
    before = {child.pid for child in multiprocessing.active_children()}
    with worker_processes_end():
        assert dict(parallel_map(abs, [-1, 2, -3], workers=2)) == {0: 1, 1: 2, 2: 3}
    assert {child.pid for child in multiprocessing.active_children()} <= before
