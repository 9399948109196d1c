"""The commands, code and links of README work."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest
import typer

from tcdyn.cli.app import app
from tests.cli.test_main_job import tcdyn

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.+?)\n```", TEXT, re.S)
INLINE_COMMANDS = re.findall(r"`(tcdyn [^`]+)`", re.sub(r"```.+?```", "", TEXT, flags=re.S))
COMMANDS = {  # old names are hidden
    name: command
    for name, command in typer.main.get_command(app).commands.items()
    if not command.hidden
}
MARKED_COMMANDS = ("demo-command", "test-command")


def command_lines(block: str) -> list[list[str]]:
    """Arguments of the command lines of a shell block, with continued lines joined."""
    return [shlex.split(line) for line in block.replace("\\\n", " ").splitlines() if line.strip()]


def commands() -> list[list[str]]:
    """Arguments of every call of ``tcdyn`` in a code block or in the text."""
    blocks = [
        arguments
        for language, block in BLOCKS
        if language == "sh"
        for arguments in command_lines(block)
    ]
    calls = [arguments for arguments in blocks if arguments[0] == "tcdyn"]
    return calls + [shlex.split(line) for line in INLINE_COMMANDS]


@pytest.mark.parametrize("name", MARKED_COMMANDS)
def test_marked_command_is_one_line_directly_after_its_marker(name: str) -> None:
    assert TEXT.count(f"<!-- {name} -->") == 1
    marked = re.search(rf"<!-- {name} -->\n```sh\n(.+?)\n```", TEXT, re.S)
    assert marked is not None
    assert "\n" not in marked.group(1)


@pytest.mark.e2e
def test_every_block_runs_and_prints_what_its_comments_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    pages = []
    monkeypatch.setattr("webbrowser.open", pages.append)
    languages = []
    for language, block in BLOCKS:
        if "venv" in block:  # the installation and the two marked commands: CI runs the marked ones
            continue
        languages.append(language)
        if language == "sh":
            for arguments in command_lines(block):
                assert arguments[0] == "tcdyn"
                assert tcdyn(*arguments[1:]) == 0, " ".join(arguments)
        else:
            assert language == "python"
            output = io.StringIO()
            with contextlib.redirect_stdout(output):
                exec(compile(block, "README.md", "exec"), {})
            for expected in re.findall(r"^# (.+)$", block, re.M):
                assert expected in output.getvalue()
    assert languages == ["python", "sh", "python"]
    assert len(pages) == 1  # of tcdyn view


@pytest.mark.parametrize("arguments", commands(), ids=" ".join)
def test_every_named_command_and_option_exists(arguments: list[str]) -> None:
    if arguments[1] == "COMMAND":
        assert arguments[2:] == ["--help"]
        return
    assert arguments[1] in COMMANDS
    command = COMMANDS[arguments[1]]
    subcommands = getattr(command, "commands", {})
    if subcommands:
        command = subcommands[arguments[2]]
    options = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in arguments if word.startswith("--")} <= options


def test_table_lists_every_command_with_a_task_of_its_own() -> None:
    named = {arguments[1] for arguments in commands()}
    assert set(COMMANDS) <= named | {"demo"}


def test_every_link_leads_to_a_file() -> None:
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", TEXT) if not link.startswith("http")]
    assert len(links) > 5
    for link in links:
        assert (ROOT / link.partition("#")[0]).exists(), link


NUMBER = r"(\d+(?:\.\d+)?)"
# Where the page Validation states the figures of each row of README's table, N for the figure.
SOURCES_OF_FIGURES = {
    "compensation of a benchmark step": (
        "As logged, the temperature is N K wrong (rms)",
        "| smoother, event given or detected | N |",
    ),
    "lag and percent times from a dip": (
        "| plunge, chain of lags: coverage, lowest of lag, t50, t63.2, t90 | N % |",
        "| the same, highest | N % | 60 sensors of one to three lags |",
    ),
    "beta of a two-disk test": ("| coverage, joint fit | N % | 300 rigs",),
}


def test_each_figure_of_the_table_of_trust_is_in_validation() -> None:
    validation = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    table = re.search(r"\| quantity \| result \|\n\|---\|---\|\n((?:\|.+\n)+)", TEXT)
    assert table is not None
    rows = [row.strip("|").split("|") for row in table[1].splitlines()]
    assert len(rows) == len(SOURCES_OF_FIGURES)
    for quantity, result in rows:
        (name,) = [name for name in SOURCES_OF_FIGURES if name in quantity]
        validated = []
        for source in SOURCES_OF_FIGURES[name]:
            (figure,) = re.findall(re.escape(source).replace("N", NUMBER, 1), validation)
            validated.append(float(figure))
        assert [float(figure) for figure in re.findall(NUMBER, result)] == validated, quantity


def test_no_page_of_the_manual_includes_text_of_readme() -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        assert "{include}" not in page.read_text(encoding="utf-8"), page.name
