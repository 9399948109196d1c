"""Signals that ask a command to stop, on any operating system.

Used by :mod:`tcdyn.cli.app` and :mod:`tcdyn.cli.follow`. Test: ``tests/cli/test_signals.py``.
"""

from __future__ import annotations

import signal

# Ctrl-C, ``kill``, a closed terminal; Ctrl-Break and a closed console window on Windows, which has
# no SIGHUP.
NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


def stop_signals() -> list[int]:
    """The numbers of those signals that this operating system has.

    >>> signal.SIGINT in stop_signals()
    True
    """
    numbers = []
    for name in NAMES:
        number = getattr(signal, name, None)
        if number is not None:
            numbers.append(number)
    return numbers
