"""Limit the BLAS libraries to one thread during a call.

Many functions that users call are decorated with ``one_blas_thread``. Guarded by
``tests/core/test_threads.py``.
"""

from __future__ import annotations

import os
import sys
import threading
from contextlib import ContextDecorator
from importlib import import_module
from types import TracebackType
from typing import Any

from threadpoolctl import ThreadpoolController


class _OneBlasThread(ContextDecorator):
    """Context manager and decorator: BLAS libraries use one thread inside.

    Notes
    -----
    The matrices of this package are small: distributing them over threads costs 5 to 20 times what
    it saves.

    The limit is that of the BLAS libraries, so it applies to the whole process: linear algebra in
    other threads of the caller also runs on one thread meanwhile. Calls may be nested and may
    overlap in several threads; the first one sets the limit, the last one restores the previous
    setting, also on an exception. A limit that another thread of the caller set by
    ``threadpoolctl`` remains.

    Measured: 40 us for a call, 1.5 us for a nested one, 1 ms for a call after modules were
    imported.
    """

    def __init__(self) -> None:
        """Start without a limit; a forked child gets a new lock."""
        self._lock = threading.RLock()  # a signal handler may also call the package
        self._calls = 0
        self._limit: Any = None
        self._controller: ThreadpoolController | None = None
        self._module_count = 0
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._renew_lock)

    def __enter__(self) -> None:
        """Set the limit in the first of nested or overlapping calls."""
        with self._lock:
            if self._calls == 0:
                self._limit = self._blas_libraries().limit(limits=1, user_api="blas")
                self._allow_all_threads()
            self._calls += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Restore the setting at the end of the last of nested or overlapping calls."""
        with self._lock:
            self._calls -= 1
            if self._calls == 0:
                self._limit.restore_original_limits()
                self._limit = None
                self._allow_all_threads()

    def _blas_libraries(self) -> ThreadpoolController:
        """The BLAS libraries in memory; searched again only if modules were imported meanwhile."""
        import_module("scipy.linalg")  # loads SciPy's own BLAS
        if self._controller is None or len(sys.modules) != self._module_count:
            self._controller = ThreadpoolController()
            self._module_count = len(sys.modules)
        return self._controller

    def _allow_all_threads(self) -> None:
        """Let any thread change the limit.

        Newer versions of threadpoolctl allow this only to the thread that set it, but the last call
        to end may be in another thread.
        """
        if self._controller is None:
            return
        for library in self._controller.lib_controllers:
            release = getattr(library, "clear_controlling_thread", None)
            if release is not None:
                release()

    def _renew_lock(self) -> None:
        """In a forked child: a thread of the parent that held the lock does not exist here."""
        self._lock = threading.RLock()


# The one instance: it counts the calls of the whole process.
one_blas_thread = _OneBlasThread()
