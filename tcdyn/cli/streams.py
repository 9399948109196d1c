"""Standard error of a command, on which a command does not depend, and its standard output.

Used by :mod:`tcdyn.cli.app`. Test: ``tests/cli/test_streams.py``.
"""

from __future__ import annotations

import io
import json
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


def result_stream(stream: TextIO | None) -> TextIO:
    """A stream for results in the place of standard output.

    Characters that its encoding does not have are written as escapes. Windows redirects to a file
    in the encoding of its language, in which a name or a unit may be missing; Python would raise an
    exception.

    Parameters
    ----------
    stream
        Standard output; one that a caller replaced is not changed. None if it is closed.

    Examples
    --------
    >>> stream = result_stream(io.TextIOWrapper(io.BytesIO(), encoding="cp1252"))
    >>> stream.write("β in °C")
    7
    >>> stream.flush()
    >>> stream.buffer.getvalue()
    b'\\\\u03b2 in \\xb0C'
    """
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="backslashreplace")
    return stream


def json_for_stream(text: str, stream: TextIO) -> str:
    """JSON that the stream can encode: non-ASCII characters escaped where it is necessary.

    Parameters
    ----------
    text
        JSON.
    stream
        Stream that it is written to.

    Examples
    --------
    >>> json_for_stream('{"name": "β"}', io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    '{\\n  "name": "\\\\u03b2"\\n}\\n'
    """
    try:
        text.encode(stream.encoding or "utf-8")
    except UnicodeEncodeError:
        return json.dumps(json.loads(text), indent=2) + "\n"
    return text
