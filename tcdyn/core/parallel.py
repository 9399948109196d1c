"""Parallel map over independent jobs, in worker processes or on a Dask scheduler.

``tcdyn.workflows.campaign`` analyses logs with it, ``tcdyn.simulate.campaign`` simulates them.
Guarded by ``tests/core/test_parallel.py``: the results are the same with one process, several, and
Dask.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import current_process
from typing import TypeVar

from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread

Job = TypeVar("Job")
Value = TypeVar("Value")
# Worker processes end so long after their last job [s]; joblib keeps them for 300 s.
IDLE_S = 5.0
# time limit for the connection to the Dask scheduler, which takes well below a second
CONNECT_S = 10.0


def parallel_map(
    function: Callable[[Job], Value], jobs: Sequence[Job], workers: int = 1, dask: str | None = None
) -> Iterator[tuple[int, Value | Exception]]:
    """Yield the index and the result of each job, in the order in which the results are ready.

    Parameters
    ----------
    function : callable
        Function of one job. With worker processes or Dask, cloudpickle must be able to pickle it,
        the jobs and the results. It should return its failures: an exception in a Dask worker is
        yielded as the result of its job, any other is raised here and ends the iteration.
    jobs : sequence
        Arguments of ``function``, one for each call.
    workers : int
        Number of worker processes. With 1, the jobs run in this process, one after the other; also
        in a worker of ``multiprocessing.Pool``, which may not start processes.
    dask : str, optional
        Address of a Dask scheduler, for example "tcp://host:8786". ``workers`` is then not used.

    Yields
    ------
    tuple of int and result
        Position of the job in ``jobs``, and what ``function`` returned.

    Raises
    ------
    InputError
        If ``workers`` is below 1, a worker process was killed, dask.distributed is not installed,
        or no Dask scheduler answers at the address.

    Notes
    -----
    BLAS libraries use one thread in each worker. The worker processes end ``IDLE_S`` after the last
    job.

    Dask is used through its client. joblib's Dask backend does not report a killed worker: the
    iteration over its results does not end (joblib 1.6 with dask 2026.8).

    Examples
    --------
    >>> sorted(parallel_map(abs, [-3, 2]))
    [(0, 3), (1, 2)]
    """
    if dask is not None:
        return _on_dask(function, jobs, dask)
    if workers < 1:
        raise InputError(f"{workers} workers", expected="at least 1")
    if workers == 1 or len(jobs) < 2 or current_process().daemon:
        return ((index, function(job)) for index, job in enumerate(jobs))
    return _in_processes(function, jobs, min(workers, len(jobs)))


@contextmanager
def worker_processes_end() -> Iterator[None]:
    """End joblib's worker processes after the block, busy or not.

    For a command, which ends soon after: Python waits for them at its end, where a signal would
    print a traceback. Programs that use joblib themselves keep theirs.
    """
    try:
        yield
    finally:
        from joblib.externals.loky import get_reusable_executor

        get_reusable_executor().shutdown(wait=True, kill_workers=True)


def _in_processes(
    function: Callable[[Job], Value], jobs: Sequence[Job], workers: int
) -> Iterator[tuple[int, Value | Exception]]:
    """Yield index and result of each job from joblib's worker processes.

    Parameters
    ----------
    function
        Function of one job.
    jobs
        Arguments of ``function``.
    workers
        Number of worker processes.

    Yields
    ------
    index, result
        Position of the job, and what ``function`` returned.

    Raises
    ------
    InputError
        A worker process was killed.

    Notes
    -----
    One job is sent at a time (``batch_size=1``): a job takes seconds, so the cost of sending it
    does not matter.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    def run(index: int, job: Job) -> tuple[int, Value]:
        """Result of one job with its index, in the worker process."""
        return index, _on_one_blas_thread(function, job)

    pool = Parallel(
        n_jobs=workers,
        batch_size=1,
        return_as="generator_unordered",
        idle_worker_timeout=IDLE_S,
    )
    try:
        yield from pool(delayed(run)(index, job) for index, job in enumerate(jobs))
    except TerminatedWorkerError:
        raise InputError(
            "a worker process was killed, perhaps because memory was full",
            remedy="run the same command with fewer workers; finished results are stored",
        ) from None


def _on_dask(
    function: Callable[[Job], Value], jobs: Sequence[Job], address: str
) -> Iterator[tuple[int, Value | Exception]]:
    """Yield index and result of each job from the workers of a Dask scheduler.

    Parameters
    ----------
    function
        Function of one job.
    jobs
        Arguments of ``function``.
    address
        Address of the scheduler.

    Yields
    ------
    index, result
        Position of the job, and what ``function`` returned or the exception that it raised.

    Raises
    ------
    InputError
        dask.distributed is not installed, or no scheduler answers.
    """
    try:
        from dask.distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "dask.distributed is not installed",
            remedy="pip install 'tcdyn[dask]', or use {workers}",
            parameters={"workers": None},
        ) from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as problem:
        raise InputError(
            f"no Dask scheduler answers at {address} ({type(problem).__name__})",
            expected="an address such as tcp://host:8786",
            remedy="start one with `dask scheduler` and `dask worker`, or use {workers}",
            parameters={"workers": "2"},
        ) from None
    with client:
        indices = {}
        for index, job in enumerate(jobs):
            future = client.submit(_on_one_blas_thread, function, job, pure=False)
            indices[future] = index
        for future in as_completed(indices, loop=client.loop):
            try:
                result = future.result()
            except Exception as problem:
                result = problem
            yield indices[future], result


def _on_one_blas_thread(function: Callable[[Job], Value], job: Job) -> Value:
    """Result of ``function(job)``, with one BLAS thread in the worker."""
    with one_blas_thread:
        return function(job)
