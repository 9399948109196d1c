"""Linear algebra on one thread for the length of a call."""

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
    """Context manager and decorator: BLAS libraries use one thread within, and their own setting again afterwards.

    Notes
    -----
    The matrices of this package are small: handing them out to threads costs 5 to 20 times what it saves.

    The limit is that of the BLAS libraries, so it holds for the whole process: linear algebra of the caller's other
    threads also runs on one thread meanwhile. Calls may be nested and may overlap in several threads; the first one
    sets the limit, the last one restores what was before, also on an exception. Where another thread of the caller
    holds a limit of its own by ``threadpoolctl``, that one stays.

    Measured: 40 us for a call, 1.5 us for a nested one, 1 ms for a call after modules were imported.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # a signal handler may call the package, too
        self._calls = 0
        self._limit: Any = None
        self._controller: ThreadpoolController | None = None
        self._modules = 0
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._unlock)

    def __enter__(self) -> None:
        with self._lock:
            if self._calls == 0:
                self._limit = self._libraries().limit(limits=1, user_api="blas")
                self._release()
            self._calls += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._lock:
            self._calls -= 1
            if self._calls == 0:
                self._limit.restore_original_limits()
                self._limit = None
                self._release()

    def _libraries(self) -> ThreadpoolController:
        """The BLAS libraries that are loaded; searched again only where a module was imported since the last search."""
        import_module(
            "scipy.linalg"
        )  # SciPy has a BLAS of its own, which is loaded with this module
        if self._controller is None or len(sys.modules) != self._modules:
            self._controller = ThreadpoolController()
            self._modules = len(sys.modules)
        return self._controller

    def _release(self) -> None:
        """Let any thread change the limit: newer threadpoolctl reserves this to the thread that set it, where the last
        call to end may be another thread's."""
        for library in self._controller.lib_controllers if self._controller else ():
            release = getattr(library, "clear_controlling_thread", None)
            if release is not None:
                release()

    def _unlock(self) -> None:
        """In a forked child: another thread of the parent may have held the lock, and does not exist here."""
        self._lock = threading.RLock()


one_blas_thread = _OneBlasThread()
