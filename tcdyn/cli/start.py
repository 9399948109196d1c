"""The entry point of the command ``tcdyn``, which imports nothing before it is ready for Ctrl-C.

Test: ``tests/cli/test_signals.py``.
"""

from __future__ import annotations

import signal


def command() -> None:
    """Run the command of ``sys.argv``; ends with SystemExit.

    While the libraries are imported, Ctrl-C ends the process at once: there is nothing to clean up,
    and Python would print a traceback. Where it is ignored, it stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from tcdyn.cli.app import main

    main()
