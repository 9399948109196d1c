"""Every block of the README runs, in its order, and prints what it says."""

from __future__ import annotations

import contextlib
import glob
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(sh|python)\n(.+?)\n```", TEXT, re.S)


def commands(block: str) -> list[list[str]]:
    """Command lines of a shell block, continued lines joined."""
    return [shlex.split(line) for line in block.replace("\\\n", " ").splitlines() if line.strip()]


def test_the_two_commands_are_marked_and_single() -> None:
    for name in ("demo-command", "test-command"):
        found = re.search(rf"<!-- {name} -->\n```sh\n(.+?)\n```", TEXT, re.S)
        assert found
        assert "\n" not in found.group(1)


@pytest.mark.slow
def test_every_block_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ran = 0
    for language, block in BLOCKS:
        if "venv" in block:  # the two commands themselves; CI calls them
            continue
        if language == "sh":
            for words in commands(block):
                assert words[0] == "tcdyn"
                words = [path for word in words for path in sorted(glob.glob(word)) or [word]]  # as a shell does
                call = [sys.executable, "-m", "tcdyn.cli.app", *words[1:]]
                done = subprocess.run(call, capture_output=True, text=True, timeout=300, check=False)
                # `record check` exits 1 when it has something to ask
                assert done.returncode in ((0, 1) if words[1:3] == ["record", "check"] else (0,)), done.stderr
        else:
            said = io.StringIO()
            with contextlib.redirect_stdout(said):
                exec(compile(block, "README.md", "exec"), {})
            for promised in re.findall(r"^# (.+)$", block, re.M):
                assert promised in said.getvalue()
        ran += 1
    assert ran >= 5


def test_glossary_names_the_columns_the_layouts_ask_for() -> None:
    from calibration.columns import LAYOUTS

    for kind in ("oven", "immersion", "ehl"):
        for column in LAYOUTS[kind].required:
            short = re.sub(r"^(fast_|slow_)?[a-f]_degC$", "a_degC", column)
            assert short in TEXT, column
