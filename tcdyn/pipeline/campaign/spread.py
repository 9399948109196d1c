"""A function over many jobs, on processes of this machine or a Dask scheduler's workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import TerminatedWorkerError

from calibration.errors import InputError

Job = TypeVar("Job")
Answer = TypeVar("Answer")
CONNECT_S = 10.0  # to a Dask scheduler


def spread(
    function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int = 1, dask: str | None = None
) -> Iterator[tuple[int, Answer | Exception]]:
    """Yield (position in ``jobs``, answer) in the order in which they are ready.

    ``dask``: address of a scheduler, e.g. "tcp://host:8786"; without it ``workers`` processes of this machine, or
    this process for one. ``function`` should return its failures: an exception that a Dask worker raises comes as
    the answer, any other is raised here. Raises InputError for no worker, or a scheduler that does not answer.

    >>> sorted(spread(abs, [-3, 2]))
    [(0, 3), (1, 2)]
    """
    if dask is not None:
        return _on_dask(function, jobs, dask)
    if workers < 1:
        raise InputError(f"{workers} workers", expected="at least 1")
    if workers == 1 or len(jobs) < 2:
        return ((i, function(job)) for i, job in enumerate(jobs))
    return _in_processes(function, jobs, min(workers, len(jobs)))


def _in_processes(
    function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int
) -> Iterator[tuple[int, Answer | Exception]]:
    pool = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")
    try:
        yield from pool(delayed(lambda i, job: (i, function(job)))(i, job) for i, job in enumerate(jobs))
    except TerminatedWorkerError:
        raise InputError(
            "a worker process was killed, perhaps for want of memory",
            remedy="run the same command with fewer workers; what is finished is kept",
        ) from None


def _on_dask(
    function: Callable[[Job], Answer], jobs: Sequence[Job], address: str
) -> Iterator[tuple[int, Answer | Exception]]:
    try:
        from dask.distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "dask.distributed is not installed",
            remedy="pip install 'tcdyn[dask]', or use workers",
            parameters=("workers",),
        ) from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as problem:
        raise InputError(
            f"no Dask scheduler answers at {address} ({type(problem).__name__})",
            expected="an address such as tcp://host:8786",
            remedy="start one with `dask scheduler` and `dask worker`, or use workers=2",
            parameters=("workers=2",),
        ) from None
    with client:
        place = {client.submit(function, job, pure=False): i for i, job in enumerate(jobs)}
        for future in as_completed(place, loop=client.loop):
            try:
                yield place[future], future.result()
            except Exception as problem:
                yield place[future], problem
