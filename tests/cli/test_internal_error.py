"""An exception that no command expects ends with exit code 70, its traceback and one sentence."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
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


def test_debug_writes_a_file_for_the_report(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("tcdyn.verify.verify_rows", broken)
    monkeypatch.setattr("sys.argv", ["tcdyn", "verify", "--out", "a b.csv", "--debug"])
    requirements = ["numpy<3,>=2.0", "dask>=2024.5; extra == 'dask'", "no-such-package>=1"]
    monkeypatch.setattr("tcdyn.cli.debug.requires", lambda name: requirements)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run(lambda: app(["verify", "--debug"])) == 70
    sentence = capsys.readouterr().err.splitlines()[-1]
    (file,) = tmp_path.iterdir()
    assert str(file) in sentence
    text = file.read_text(encoding="utf-8")
    assert text.startswith("command: tcdyn verify --out 'a b.csv' --debug\ntcdyn ")
    assert f"\nnumpy {np.__version__}, no-such-package missing\n" in text
    assert text.endswith("\nZeroDivisionError: of the command\n")
    assert run(lambda: app(["verify"])) == 70  # the option of the previous call does not remain
    assert "--debug writes a file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [file]


def test_a_file_of_debug_that_cannot_be_written_changes_nothing_else(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("tcdyn.verify.verify_rows", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    assert run(lambda: app(["verify", "--debug"])) == 70
    assert "could not write a file (No such file" in capsys.readouterr().err


def test_input_that_is_refused_writes_no_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run(lambda: app(["rig", "check", "missing.toml", "--debug"])) == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.e2e
def test_the_process_of_the_command_ends_with_70(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "import tcdyn.verify\n"
        "from tcdyn.cli import app\n"
        "def broken() -> None: raise ZeroDivisionError('of the command')\n"
        "tcdyn.verify.verify_rows = broken\n"
        "sys.argv = ['tcdyn', 'verify']\n"
        "app.main()\n"
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
