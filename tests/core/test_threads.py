"""Linear algebra runs on one thread within the public functions; the setting is restored
afterwards."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import ThreadpoolController, threadpool_info, threadpool_limits

import tcdyn
from tcdyn.core import threads
from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread
from tcdyn.identification import IOData
from tcdyn.smoothing import deconvolve

INITIAL = 2  # threads of each library before a call, on any machine
DT_S = 0.05


def blas_threads() -> set[int]:
    """Numbers of threads of the loaded BLAS libraries."""
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    limit = threadpool_limits(INITIAL, user_api="blas")
    for library in ThreadpoolController().lib_controllers:
        # otherwise only one thread may set limits
        release = getattr(library, "clear_controlling_thread", None)
        if release is not None:
            release()
    if blas_threads() != {INITIAL}:
        pytest.skip("a BLAS library whose threads cannot be set")
    yield
    limit.restore_original_limits()


def steps() -> np.ndarray:
    return np.repeat([20.0, 80.0, 20.0], 60)


def test_call_runs_on_one_thread_and_restores_the_setting() -> None:
    @one_blas_thread
    def inner() -> set[int]:
        return blas_threads()

    assert inner() == {1}
    assert blas_threads() == {INITIAL}


def test_setting_is_restored_after_an_exception_but_not_by_a_nested_call() -> None:
    def fails() -> None:
        with pytest.raises(KeyError), one_blas_thread:
            raise KeyError
        assert blas_threads() == {1}
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        one_blas_thread(fails)()
    assert blas_threads() == {INITIAL}


def test_overlapping_calls_in_two_threads_restore_the_initial_setting() -> None:
    barrier = threading.Barrier(2, timeout=20)
    threads_within: list[set[int]] = []

    def first() -> None:
        with one_blas_thread:
            barrier.wait()  # both are within the block
        barrier.wait()  # the first has left the block, the second has not

    def second() -> None:
        with one_blas_thread:
            barrier.wait()
            barrier.wait()
            threads_within.append(blas_threads())

    workers = [threading.Thread(target=target) for target in (first, second)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(20)
    assert threads_within == [{1}]
    assert blas_threads() == {INITIAL}


@pytest.fixture
def threads_at_calls(monkeypatch: pytest.MonkeyPatch) -> list[set[int]]:
    """Numbers of threads at each call of linear algebra of NumPy."""
    numbers: list[set[int]] = []

    def record_calls(name: str) -> None:
        original = getattr(np.linalg, name)

        def function(*arguments: object, **options: object) -> object:
            numbers.append(blas_threads())
            return original(*arguments, **options)

        monkeypatch.setattr(np.linalg, name, function)

    for name in ("qr", "solve", "inv", "lstsq", "svd", "eigh", "eigvals", "cholesky", "norm"):
        record_calls(name)
    return numbers


@pytest.mark.e2e
def test_fit_and_compare_run_on_one_thread(threads_at_calls: list[set[int]]) -> None:
    data = IOData.from_arrays(
        steps(), steps() + np.random.default_rng(0).normal(0, 0.1, 180), DT_S, hold="zoh"
    )
    tcdyn.fit(data, "P1")
    assert blas_threads() == {INITIAL}
    tcdyn.compare(data, "P1", "P1D")
    assert blas_threads() == {INITIAL}
    assert len(threads_at_calls) > 0
    assert {frozenset(numbers) for numbers in threads_at_calls} == {frozenset({1})}


def test_smooth_and_deconvolve_run_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threads_within: list[set[int]] = []
    original = tcdyn.smoothing.smoother.record_of

    def recording(*arguments: object, **options: object) -> object:
        threads_within.append(blas_threads())
        return original(*arguments, **options)

    monkeypatch.setattr("tcdyn.smoothing.smoother.record_of", recording)
    y = steps() + np.random.default_rng(0).normal(0, 0.1, 180)
    tcdyn.smooth(y, DT_S, 0.5)
    assert blas_threads() == {INITIAL}
    deconvolve(y, DT_S, 0.5)
    assert blas_threads() == {INITIAL}
    assert threads_within == [{1}] * len(threads_within) != []


def test_workflows_run_on_one_thread_and_restore_the_setting_on_bad_input(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    threads_within: list[set[int]] = []

    def progress(stage: str) -> None:
        threads_within.append(blas_threads())

    missing = Path("absent.csv")
    rig = tcdyn.load_rig()
    with pytest.raises(InputError):
        tcdyn.calibrate_disk(rig, "fast", missing, [missing], ["water"], progress=progress)
    with pytest.raises(InputError):
        tcdyn.estimate_beta(missing, rig, {}, progress=progress)
    with pytest.raises(InputError):
        tcdyn.compensate_log(missing, {}, rig, progress=progress)
    assert threads_within == [{1}] * len(threads_within) != []
    assert blas_threads() == {INITIAL}


def test_published_numbers_are_computed_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """With two threads ``tcdyn verify`` takes three times as much processor time."""
    threads_within: list[set[int]] = []

    def recording() -> list[object]:
        threads_within.append(blas_threads())
        return []

    monkeypatch.setattr("tcdyn.verify.table_rows.table_rows", recording)
    monkeypatch.setattr("tcdyn.verify.CHAPTERS", (("table_rows", "table_rows"),))
    assert tcdyn.verify.verify_rows() == []
    assert threads_within == [{1}]
    assert blas_threads() == {INITIAL}


def test_library_that_is_loaded_later_is_limited_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Libraries are searched again if modules were imported since the last call."""
    assert scipy.linalg is not None
    state = threads.one_blas_thread
    with one_blas_thread:
        pass
    controller = state._controller
    with one_blas_thread:
        assert state._controller is controller
    monkeypatch.setitem(sys.modules, "a_module_imported_since", threads)
    with one_blas_thread:
        assert state._controller is not controller
