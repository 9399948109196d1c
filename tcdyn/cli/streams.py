"""Standard error of a command, on which a command does not depend.

Used by :mod:`tcdyn.cli.app`. Test: ``tests/cli/test_streams.py``.
"""

from __future__ import annotations

import io
import os
from typing import TextIO


class MessageStream(io.TextIOWrapper):
    """A stream whose text is lost, without an error, once it cannot be written (a full disk)."""

    def write(self, text: str) -> int:
        """Write the text, or discard it and all that follows."""
        try:
            return super().write(text)
        except OSError:
            self._discard()
            return len(text)

    def flush(self) -> None:
        """Write what is buffered, or discard it and all that follows."""
        try:
            super().flush()
        except OSError:
            self._discard()

    def _discard(self) -> None:
        """Let the file descriptor lead nowhere, so that what is buffered can be written."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def message_stream(stream: TextIO | None) -> TextIO:
    """A stream for messages in the place of standard error.

    Parameters
    ----------
    stream
        Standard error; None if it is closed, where ``print`` would write to standard output.
    """
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper):  # replaced by the caller, for example by a test
        return stream
    return MessageStream(
        stream.buffer, encoding=stream.encoding, errors=stream.errors, line_buffering=True
    )
