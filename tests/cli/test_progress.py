"""The progress of a command: the name of each stage, and the elapsed time."""

from __future__ import annotations

import io
from time import sleep

import pytest
import typer
from rich.console import Console

from tcdyn.cli import common
from tcdyn.cli.common import Reporter, count_progress, stage_progress
from tcdyn.core.findings import error, info, warning


def test_silent_output_has_the_warnings_and_the_exit_code_follows_them(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = [
        info("from_file", text="fine"),
        warning("from_file", text="odd"),
        warning("from_file", text="B3: odd"),
    ]
    for reporter in (Reporter(json_=True), Reporter(quiet=True)):
        reporter.finish("B3", found)
        assert capsys.readouterr().err == "warning: B3: odd\nwarning: B3: odd\n"
    Reporter(strict=True).finish("B3", found[:1])
    assert capsys.readouterr().err == "info: B3: fine\n"
    for reporter, findings in (
        (Reporter(strict=True), found),
        (Reporter(), [error("from_file", text="no use")]),
    ):
        with pytest.raises(typer.Exit) as ended:
            reporter.finish("B3", findings)
        assert ended.value.exit_code == 1


def test_without_a_terminal_each_stage_is_a_line_unless_quiet(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for quiet, lines in ((False, "... reading\n... fit\n"), (True, "")):
        with stage_progress(quiet) as progress:
            progress("reading")
            progress("fit")
        assert capsys.readouterr().err == lines


def test_a_count_that_is_not_known_is_not_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with count_progress(None) as progress:
        progress("P1", 1, 0)
        progress("P2", 2, 5)
    assert capsys.readouterr().err == "... 1: P1\n... 2 of 5: P2\n"


def test_a_terminal_shows_the_stage_and_the_elapsed_time(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.StringIO()
    monkeypatch.setattr(
        common, "_terminal_console", lambda: Console(file=written, force_terminal=True, width=80)
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
