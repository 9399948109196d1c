"""The commands and options that the pages name exist. That they run, and what they print, is proved
by the build of the manual, which executes its pages."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer

from tcdyn.cli.app import app

DOCS = Path(__file__).parent.parent.parent / "docs"
PAGES = [
    path
    for path in sorted(DOCS.rglob("*.md"))
    if not {"packages", "_build", "auto_gallery"} & set(path.relative_to(DOCS).parts)
]
PAGE_NAMES = [str(path.relative_to(DOCS)) for path in PAGES]
ROOT_COMMAND = typer.main.get_command(app)
BLOCK = re.compile(r"^```.*?^```$", re.S | re.M)


def named_commands(text: str) -> list[list[str]]:
    """Arguments of every call of ``tcdyn`` in a block of commands or in the text, without pipes."""
    blocks = "\n".join(BLOCK.findall(text)).replace("\\\n", " ")
    calls = re.findall(r"^(?:\$ )?(tcdyn .+)$", blocks, re.M)
    calls += re.findall(r"`(tcdyn [^`]+)`", BLOCK.sub("", text))
    return [shlex.split(re.split(r" (?:\||>>?) ", call)[0])[1:] for call in calls]


@pytest.mark.parametrize("page", PAGES, ids=PAGE_NAMES)
def test_every_named_command_and_option_exists(page: Path) -> None:
    for arguments in named_commands(page.read_text(encoding="utf-8")):
        command = ROOT_COMMAND
        for word in arguments:
            subcommands = getattr(command, "commands", {})
            if word == "COMMAND" or word.startswith("-") or not subcommands:
                break
            assert word in subcommands, f"tcdyn {' '.join(arguments)}: no command {word}"
            command = subcommands[word]
            assert not command.hidden, f"tcdyn {' '.join(arguments)}: {word} is an old name"
        options = {option for parameter in command.params for option in parameter.opts}
        named = {word for word in arguments if word.startswith("--")}
        assert named <= options | {"--help"}, f"tcdyn {' '.join(arguments)}"


@pytest.mark.parametrize("page", PAGES, ids=PAGE_NAMES)
def test_code_of_a_page_is_executed_when_the_manual_is_built(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"^```(?:python|sh)$", text, re.M)
    assert ("```{code-cell}" in text) == text.startswith("---\nfile_format: mystnb\n")
