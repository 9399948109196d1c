"""Compilation of the few functions whose loops over samples cost most of the time.

A function is written in plain Python and NumPy. Numba compiles it when it is first called, and
keeps the result beside the source or in the user's cache. Without Numba, or with the environment
variable ``NUMBA_DISABLE_JIT=1``, the same source runs as it is: slower, with the same results.
Used by :mod:`tcdyn.estimation.kalman`. Tests: ``tests/estimation/test_kalman.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

njit: Callable[..., Any] | None
try:
    from numba import njit
except ImportError as problem:  # not installed, or too old for this NumPy
    njit = None
    print(f"tcdyn: computes slowly, because Numba cannot be used: {problem}", file=sys.stderr)


def compiled(function: Function) -> Function:
    """The function, to be compiled when it is first called.

    Parameters
    ----------
    function
        Function of numbers and arrays that Numba can compile.

    Returns
    -------
    callable
        The compiled function; the same function where Numba cannot be used.

    Notes
    -----
    Where no folder for the cache can be written to, Numba refuses to cache. Then each process
    compiles once, and says so in one line.

    Examples
    --------
    >>> import numpy as np
    >>> @compiled
    ... def total(values):
    ...     out = 0.0
    ...     for value in values:
    ...         out += value
    ...     return out
    >>> total(np.array([1.0, 2.0]))
    3.0
    """
    if njit is None:
        return function
    made: Function
    try:
        made = njit(function, cache=True, error_model="numpy")
    except RuntimeError:  # "no locator available"
        _report_no_cache()
        made = njit(function, error_model="numpy")
    return made


@cache
def _report_no_cache() -> None:
    """Say once that each process compiles."""
    print(
        "tcdyn: compiles in each process, because no folder for compiled functions can be written "
        "to; the environment variable NUMBA_CACHE_DIR names one",
        file=sys.stderr,
    )
