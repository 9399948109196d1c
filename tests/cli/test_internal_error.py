"""An exception that no command expects ends with exit code 70, its traceback and one sentence."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from tcdyn.cli.app import app, run


def broken() -> None:
    raise ZeroDivisionError("of the command")


def test_an_uncaught_exception_of_a_command_ends_with_70(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tcdyn.verify.verify_rows", broken)
    assert run(lambda: app(["verify"], standalone_mode=True)) == 70
    told = capsys.readouterr()
    *trace, sentence = told.err.splitlines()
    assert told.out == ""
    assert trace[0] == "Traceback (most recent call last):"
    assert trace[-1] == "ZeroDivisionError: of the command"
    assert sentence.startswith("tcdyn: internal error (ZeroDivisionError)")
    assert "issue tracker" in sentence


def test_the_process_of_the_command_ends_with_70(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "import tcdyn.verify\n"
        "from tcdyn.cli import app\n"
        "def broken() -> None: raise ZeroDivisionError('of the command')\n"
        "tcdyn.verify.verify_rows = broken\n"
        "sys.argv = ['tcdyn', 'verify']\n"
        "app.command()\n"
    )
    environment = {**os.environ, "_TYPER_STANDARD_TRACEBACK": ""}
    call = [sys.executable, "-c", code]
    done = subprocess.run(
        call, capture_output=True, text=True, env=environment, cwd=tmp_path, check=False
    )
    assert done.returncode == 70
    assert done.stderr.startswith("Traceback (most recent call last):\n")
    assert (
        "\nZeroDivisionError: of the command\ntcdyn: internal error (ZeroDivisionError)"
        in done.stderr
    )


def test_an_exit_that_a_command_asks_for_is_no_internal_error() -> None:
    def leaves() -> None:
        raise typer.Exit(1)

    assert run(lambda: app(["--version"], standalone_mode=False)) == 0
    assert run(lambda: app(["--version"], standalone_mode=True)) == 0
    assert run(lambda: sys.exit(3)) == 3
    single = typer.Typer()
    single.command()(leaves)
    assert run(lambda: single([], standalone_mode=False)) == 1
