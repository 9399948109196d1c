"""A function over many jobs: few and short ones side by side on the cores of this machine, many long ones on worker
processes, here or a Dask scheduler's."""

from __future__ import annotations

import mmap
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import accumulate
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar
from weakref import finalize

from calibration.errors import InputError

Job = TypeVar("Job")
Answer = TypeVar("Answer")
Given = ParamSpec("Given")
CONNECT_S = 10.0  # to a Dask scheduler
REDRAWS = {"rich.live"}  # whose threads draw on the terminal and hold no lock that a copy wants
LARGE = 1 << 16  # bytes of an array from which on it is handed over where it is, not in a message
TURNS = 256  # that jobs are given out in, a byte for each
CORES = "TCDYN_CORES"  # environment variable: how many cores side_by_side may use; if not set, all of this process's

_copies_of: int | None = None  # process that may copy itself; its copies and other children have another id
_divided: ContextVar[bool] = ContextVar("divided", default=False)  # True inside side_by_side: calls within are serial


def allow_copies() -> None:
    """Let ``side_by_side`` and ``begun`` work with copies (forks) of this process.

    Notes
    -----
    Off by default: an imported library must not fork its caller, which may have signal handlers, open connections or
    threads of its own. The command line calls this in its own process. The permission is bound to this process: copies
    of it, and workers that it forks, work serially.
    """
    global _copies_of
    _copies_of = os.getpid()


def side_by_side(function: Callable[[Job], Answer], jobs: Sequence[Job], most: int | None = None) -> list[Answer]:
    """``function`` of each of ``jobs``, which are independent of each other, in their order.

    Copies of this process (fork) work with it, ``most`` processes in all; each takes the next job when it is done with
    one. They know all that it knows, and give back nothing but their answers, pickled. What a copy fails to answer, for
    whatever reason, is done here, and told here. All is done here, one after the other, unless ``allow_copies`` was
    called in this process, where one core is to be used (``CORES`` in the environment), where the system is not Linux
    or this process has threads, which cannot be copied safely (one that redraws a line of progress can), in a daemonic
    process, and within another ``side_by_side``. In a copy, no signal handler of this process runs. Large arrays come
    back in memory that both share, uncopied: a file descriptor for each copy is held as long as one of them is kept.

    >>> side_by_side(lambda x: x**2, [3, 1, 2])
    [9, 1, 4]
    """
    hands = max(min(_hands(), len(jobs), most or len(jobs), TURNS), 1)
    if hands == 1:
        with _serial_within():
            return [function(job) for job in jobs]
    turns, (next_turn, giver) = min(len(jobs), TURNS), os.pipe()
    os.write(giver, bytes(range(hands, turns)))
    os.close(giver)

    def answers(turn: int) -> dict[int, Answer]:
        done: dict[int, Answer] = {}
        with _serial_within():
            while True:
                done |= {k: function(jobs[k]) for k in range(turn, len(jobs), turns)}
                if not (token := os.read(next_turn, 1)):
                    return done
                turn = token[0]

    copies = [_copied(answers, k) for k in range(1, hands)]
    try:
        found = answers(0)
        for copy in filter(None, copies):
            found |= copy.answers()
        with _serial_within():
            return [found[k] if k in found else function(job) for k, job in enumerate(jobs)]
    finally:
        os.close(next_turn)
        for copy in filter(None, copies):
            copy.end()


def begun(function: Callable[Given, Answer], *args: Given.args, **options: Given.kwargs) -> Callable[Given, Answer]:
    """``function``, whose answer to these arguments a copy of this process works out from now on.

    The first call with equal arguments waits for that answer; it is ``function``'s own, made here, for any other call,
    for what the copy fails to answer, and where ``side_by_side`` would do all here.

    >>> begun(pow, 2, 3)(2, 3)
    8
    """

    def begin(_: int) -> dict[int, Answer]:
        return {0: function(*args, **options)}

    copy = _copied(begin, 0) if _hands() > 1 else None

    def answer(*now: Given.args, **said: Given.kwargs) -> Answer:
        found: dict[int, Answer] = {}
        if copy is not None and end.alive and (now, said) == (args, options):
            found = copy.answers()
            end()
        return found[0] if found else function(*now, **said)

    end = finalize(answer, copy.end if copy is not None else lambda: None)  # or where nobody asks for it any more
    return answer


def _hands() -> int:
    """How many processes may work side by side here."""
    if _copies_of != os.getpid() or _divided.get() or multiprocessing.current_process().daemon:
        return 1
    threads = {type(t).__module__ for t in threading.enumerate() if t is not threading.current_thread()}
    if sys.platform != "linux" or threads - REDRAWS:  # a copy holds the locks of threads that it has not
        return 1
    asked = os.environ.get(CORES, "")
    return int(asked) if asked.isdecimal() else len(os.sched_getaffinity(0))


@contextmanager
def _serial_within() -> Iterator[None]:
    """Calls of ``side_by_side`` and ``begun`` within are serial."""
    token = _divided.set(True)
    try:
        yield
    finally:
        _divided.reset(token)


@dataclass(frozen=True)
class _Copy:
    """A copy of process ``of``: it writes its answers to a file in ``memory``, then tells where each part stands."""

    process: BaseProcess
    told: Connection
    memory: int
    of: int

    def answers(self) -> dict[int, Any]:
        """Its answers by the place of their jobs; none if it ended without them."""
        try:
            places = pickle.loads(self.told.recv_bytes())
            whole = memoryview(mmap.mmap(self.memory, 0, access=mmap.ACCESS_COPY))
            first, *arrays = (whole[start:stop] for start, stop in places)
            found: dict[int, Any] = pickle.loads(first, buffers=arrays)
        except (EOFError, OSError, MemoryError):
            return {}
        return found

    def end(self) -> None:
        """Stop it, whether or not it is done; the system takes its memory back while this process goes on."""
        if self.of == os.getpid():  # a copy of this process forgets what it knows of others
            self.process.terminate()
        self.told.close()
        os.close(self.memory)


def _copied(answers: Callable[[int], dict[int, Any]], turn: int) -> _Copy | None:
    """A copy of this process that begins with ``turn``; None if none is to be had."""
    try:
        told, teller = multiprocessing.Pipe(duplex=False)
    except OSError:
        return None
    try:
        memory = os.memfd_create("answers")
    except OSError:
        told.close()
        teller.close()
        return None

    def work() -> None:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)  # the caller's handlers are not for its copies
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__  # not a drawing thread's
        with suppress(BaseException):
            parts = _parts(answers(turn))
            *starts, length = accumulate((-(-len(part) // 64) * 64 for part in parts), initial=0)
            os.ftruncate(memory, length)
            with mmap.mmap(memory, length) as shared:
                for start, part in zip(starts, parts):
                    shared[start : start + len(part)] = part
            places = [(start, start + len(part)) for start, part in zip(starts, parts)]
            teller.send_bytes(pickle.dumps(places))

    process = multiprocessing.get_context("fork").Process(target=work, daemon=True)
    made = None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    handled = _handled_signals()
    try:
        # Blocked over the fork: the copy resets the handlers first, and in this process a library's own function that
        # runs at a fork would swallow the exception of a handler.
        signal.pthread_sigmask(signal.SIG_BLOCK, handled)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of libraries' own threads, which heed a fork
            process.start()
        made = _Copy(process, told, memory, os.getpid())
    except OSError:
        told.close()
        os.close(memory)
    finally:
        teller.close()
        try:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        except BaseException:  # of a handler: KeyboardInterrupt, or what the caller's own raises
            if made is not None:
                made.end()
            raise
    return made


def _handled_signals() -> set[int]:
    """Signals to which a copy must return to the default: those with a Python function as handler, and SIGTERM.

    SIGTERM is always among them because it is what ends a copy. An ignored SIGHUP (nohup) or SIGINT stays ignored.
    """
    handled: set[int] = {signal.SIGTERM}
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            handled.add(number)
    return handled


def _parts(found: object) -> list[memoryview]:
    """What ``found`` is made of, pickled, and then the bytes of each large array in it."""
    arrays: list[memoryview] = []

    def in_place(array: pickle.PickleBuffer) -> bool:
        large = (whole := array.raw()).nbytes >= LARGE
        arrays.extend([whole] if large else [])
        return not large

    first = pickle.dumps(found, pickle.HIGHEST_PROTOCOL, buffer_callback=in_place)
    return [memoryview(first), *arrays]


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
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    def answered(i: int, job: Job) -> tuple[int, Answer]:
        return i, function(job)

    pool = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")
    try:
        yield from pool(delayed(answered)(i, job) for i, job in enumerate(jobs))
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
