"""What the commands share: options, progress and how numbers are printed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

RigFile = Annotated[Path | None, typer.Option("--rig", help="rig.toml; without it the design's defaults")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]
Json = Annotated[bool, typer.Option("--json", help="print the result as JSON instead of words")]
RecordFiles = Annotated[list[Path], typer.Option("--record", help="*.disk.json of a disk; give it once for each disk")]


@contextmanager
def stages(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A function to call with each stage's name; on a terminal it shows as a spinner with the time gone by."""
    console = Console(stderr=True, quiet=quiet)
    if quiet or not console.is_terminal:
        yield (lambda what: None) if quiet else (lambda what: print(f"... {what}", file=sys.stderr))
        return
    with Progress(
        SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console, transient=True
    ) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda what: bar.update(task, description=what)


def say(text: str, quiet: bool = False) -> None:
    """Print plain words unless quiet."""
    if not quiet:
        print(text)


def warn(warnings: Any, quiet: bool = False) -> None:
    """Print each warning on standard error."""
    if not quiet:
        for warning in warnings:
            print(f"warning: {warning}", file=sys.stderr)


def dump(data: Any) -> str:
    """JSON as all files and ``--json`` write it."""
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"
