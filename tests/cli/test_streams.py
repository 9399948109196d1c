"""Exit code and standard output do not depend on whether standard error can be written."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tcdyn.cli.app import app, run
from tcdyn.cli.streams import message_stream, result_stream
from tests.cli.fault_commands import small_files

COMMAND = [sys.executable, "-m", "tcdyn"]
FULL = Path("/dev/full")


def words_of(folder: Path) -> dict[str, list[str]]:
    """A command that warns, one with bad input and one with a wrong option, by name."""
    files = small_files(folder)
    table = str(files["table"])
    return {
        "warns": ["sensor", "new", "--tau-s", "1.5", "--column", "T1"],  # without an uncertainty
        "bad input": ["compensate", table, "--sensor", "none.json"],
        "wrong option": ["compensate", table, "--no-such-option"],
    }


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this machine")
@pytest.mark.parametrize("name", ["warns", "bad input"])
def test_a_full_standard_error_changes_nothing(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = words_of(tmp_path)[name]
    code = run(lambda: app(words))
    sound = capsys.readouterr()
    assert sound.err
    with FULL.open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stderr", message_stream(full))
        assert run(lambda: app(words)) == code
    assert capsys.readouterr().out == sound.out


def test_names_that_the_encoding_of_the_output_lacks_are_escaped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows, where a file has the encoding of the language."""
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="cp1252")
    assert result_stream(stream) is stream
    monkeypatch.setattr(sys, "stdout", stream)
    name = "\u03b2 \U0001f321 \xb0"
    words = ["sensor", "new", "--tau-s", "1+-0.1", "--column", "T1", "--name", name]
    assert run(lambda: app([*words, "--out", str(tmp_path / "s.sensor.json")])) == 0
    assert "\\u03b2 \\U0001f321 \xb0" in raw.getvalue().decode("cp1252")
    raw.truncate(0)
    raw.seek(0)
    assert run(lambda: app([*words, "--json"])) == 0
    assert json.loads(raw.getvalue().decode("cp1252"))["sensor"] == name


@pytest.mark.e2e
@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this machine")
@pytest.mark.parametrize("name", ["warns", "bad input", "wrong option"])
@pytest.mark.parametrize(
    "redirection", ["2>/dev/full", pytest.param("2>&-", marks=pytest.mark.long)]
)
def test_a_process_with_a_full_or_closed_standard_error_ends_as_without(
    name: str, redirection: str, tmp_path: Path
) -> None:
    words = [*COMMAND, *words_of(tmp_path)[name]]
    sound = subprocess.run(words, capture_output=True, text=True)
    shell = ["bash", "-c", f'"$@" {redirection}', "bash", *words]
    faulty = subprocess.run(shell, stdout=subprocess.PIPE, text=True)
    assert (faulty.returncode, faulty.stdout) == (sound.returncode, sound.stdout)


@pytest.mark.e2e
@pytest.mark.parametrize(
    "redirection", [pytest.param(">&-", marks=pytest.mark.long), ">&- 2>&- <&-"]
)
def test_a_process_with_closed_streams_ends_as_without(redirection: str, tmp_path: Path) -> None:
    words = [*COMMAND, *words_of(tmp_path)["warns"]]
    sound = subprocess.run(words, capture_output=True, text=True)
    shell = ["bash", "-c", f'"$@" {redirection}', "bash", *words]
    faulty = subprocess.run(shell, stderr=subprocess.PIPE, text=True)
    assert faulty.returncode == sound.returncode
    assert faulty.stderr == ("" if "2>&-" in redirection else sound.stderr)
