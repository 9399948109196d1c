"""Linear algebra runs on one thread within the public functions, and as before afterwards."""

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
from tcdyn.identify import IOData
from tcdyn.smoothing import deconvolve

BEFORE = 2  # threads of each library before a call, whatever the machine has
DT_S = 0.05


def blas_threads() -> set[int]:
    """Thread numbers of the BLAS libraries that are loaded."""
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    limit = threadpool_limits(BEFORE, user_api="blas")
    for library in ThreadpoolController().lib_controllers:
        release = getattr(
            library, "clear_controlling_thread", None
        )  # else other threads could set none
        if release is not None:
            release()
    if blas_threads() != {BEFORE}:
        pytest.skip("a BLAS library whose threads cannot be set")
    yield
    limit.restore_original_limits()


def steps() -> np.ndarray:
    return np.repeat([20.0, 80.0, 20.0], 60)


def test_a_call_runs_on_one_thread_and_restores_the_setting() -> None:
    @one_blas_thread
    def inner() -> set[int]:
        return blas_threads()

    assert inner() == {1}
    assert blas_threads() == {BEFORE}


def test_the_setting_is_restored_after_an_exception_and_not_within_a_nested_call() -> None:
    def fails() -> None:
        with pytest.raises(KeyError), one_blas_thread:
            raise KeyError
        assert blas_threads() == {1}
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        one_blas_thread(fails)()
    assert blas_threads() == {BEFORE}


def test_calls_that_overlap_in_two_threads_restore_what_was_before_the_first() -> None:
    together = threading.Barrier(2, timeout=20)
    within: list[set[int]] = []

    def first() -> None:
        with one_blas_thread:
            together.wait()  # both are within
        together.wait()  # the first is out, the second still within

    def second() -> None:
        with one_blas_thread:
            together.wait()
            together.wait()
            within.append(blas_threads())

    both = [threading.Thread(target=one) for one in (first, second)]
    for one in both:
        one.start()
    for one in both:
        one.join(20)
    assert within == [{1}]
    assert blas_threads() == {BEFORE}


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[set[int]]:
    """Thread numbers at each call of NumPy's linear algebra."""
    numbers: list[set[int]] = []

    def watched(name: str) -> None:
        plain = getattr(np.linalg, name)

        def function(*arguments: object, **options: object) -> object:
            numbers.append(blas_threads())
            return plain(*arguments, **options)

        monkeypatch.setattr(np.linalg, name, function)

    for name in ("qr", "solve", "inv", "lstsq", "svd", "eigh", "eigvals", "cholesky", "norm"):
        watched(name)
    return numbers


@pytest.mark.e2e
def test_fit_and_compare_run_on_one_thread(seen: list[set[int]]) -> None:
    data = IOData.from_arrays(
        steps(), steps() + np.random.default_rng(0).normal(0, 0.1, 180), DT_S, hold="zoh"
    )
    tcdyn.fit(data, "P1")
    assert blas_threads() == {BEFORE}
    tcdyn.compare(data, "P1", "P1D")
    assert blas_threads() == {BEFORE}
    assert len(seen) > 0
    assert {frozenset(one) for one in seen} == {frozenset({1})}


def test_smooth_and_deconvolve_run_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    within: list[set[int]] = []
    plain = tcdyn.smoothing.smoother.record_of

    def watched(*arguments: object) -> object:
        within.append(blas_threads())
        return plain(*arguments)

    monkeypatch.setattr("tcdyn.smoothing.smoother.record_of", watched)
    y = steps() + np.random.default_rng(0).normal(0, 0.1, 180)
    tcdyn.smooth(y, DT_S, 0.5)
    assert blas_threads() == {BEFORE}
    deconvolve(y, DT_S, 0.5)
    assert blas_threads() == {BEFORE}
    assert within == [{1}] * len(within) != []


def test_stages_run_on_one_thread_and_restore_the_setting_on_bad_input(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    within: list[set[int]] = []

    def progress(what: str) -> None:
        within.append(blas_threads())

    missing = Path("absent.csv")
    rig = tcdyn.load_rig()
    with pytest.raises(InputError):
        tcdyn.calibrate_disk(rig, "fast", missing, [missing], ["water"], progress=progress)
    with pytest.raises(InputError):
        tcdyn.estimate_beta(missing, rig, {}, progress=progress)
    with pytest.raises(InputError):
        tcdyn.compensate_log(missing, {}, rig, progress=progress)
    assert within == [{1}] * len(within) != []
    assert blas_threads() == {BEFORE}


def test_the_published_numbers_are_computed_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """With two threads ``tcdyn verify`` took three times the processor time."""
    within: list[set[int]] = []

    def watched() -> list[object]:
        within.append(blas_threads())
        return []

    monkeypatch.setattr("tcdyn.verify.table_rows.table_rows", watched)
    monkeypatch.setattr("tcdyn.verify.CHAPTERS", (("table_rows", "table_rows"),))
    assert tcdyn.verify.verify_rows() == []
    assert within == [{1}]
    assert blas_threads() == {BEFORE}


def test_a_library_that_is_loaded_later_is_limited_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The libraries are searched again where modules were imported since the last call."""
    assert scipy.linalg is not None
    state = threads.one_blas_thread
    with one_blas_thread:
        pass
    kept = state._controller
    with one_blas_thread:
        assert state._controller is kept
    monkeypatch.setitem(sys.modules, "a_module_imported_since", threads)
    with one_blas_thread:
        assert state._controller is not kept
