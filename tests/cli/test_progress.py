"""The progress of a command: the name of each stage, and the elapsed time."""

from __future__ import annotations

import io
from time import sleep

import pytest
from rich.console import Console

from tcdyn.cli import common
from tcdyn.cli.common import print_first_warning, stage_progress
from tcdyn.core.findings import warning


def test_an_end_that_asks_for_a_look_tells_the_first_and_counts_the_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = [
        warning("said", text="odd"),
        warning("said", text="odder"),
        warning("said", text="oddest"),
    ]
    for count, said in ((1, "odd\n"), (3, "odd (and 2 more)\n")):
        print_first_warning("B3", found[:count])
        assert capsys.readouterr().err == f"tcdyn: B3: warning: {said}"


def test_without_a_terminal_each_stage_is_a_line_unless_quiet(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for quiet, lines in ((False, "... reading\n... fit\n"), (True, "")):
        with stage_progress(quiet) as progress:
            progress("reading")
            progress("fit")
        assert capsys.readouterr().err == lines


def test_a_terminal_shows_the_stage_and_the_elapsed_time(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    monkeypatch.setattr(
        common, "_terminal", lambda: Console(file=written, force_terminal=True, width=80)
    )
    with stage_progress(quiet=False) as progress:
        progress("reading the log")
    assert "reading the log" in written.getvalue()
    assert "0:00:00" in written.getvalue()


def test_with_verbose_every_line_tells_the_elapsed_time(capsys: pytest.CaptureFixture[str]) -> None:
    with stage_progress(quiet=False, verbose=True) as begin:
        begin("reading the log")
        sleep(0.2)
        begin("fit")
    lines = [line.split(maxsplit=3) for line in capsys.readouterr().err.splitlines()]
    assert [what for *_, what in lines] == ["reading the log", "fit", "done"]
    seconds = [float(s) for _, s, _, _ in lines]
    assert seconds == sorted(seconds)
    assert 0.1 < seconds[-1] < 5.0
