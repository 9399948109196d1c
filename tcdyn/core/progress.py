"""Progress of long calculations: a function that is called with the name of each stage."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str], None]


def no_progress(stage: str) -> None:
    """Report nothing."""
