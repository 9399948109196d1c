"""The manual agrees with the program: its commands run and print what it shows, and its links are
valid."""

from __future__ import annotations

import contextlib
import glob
import io
import re
import shlex
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from tcdyn.cli.app import app, run

DOCS = Path(__file__).parent.parent.parent / "docs"
# these pages share the folder that the first of them makes, in this order
RIG = ("calibrate", "compensate", "beta", "campaign")
SINGLE_PAGES = [
    "start",
    *(f"howto/{p.stem}" for p in sorted((DOCS / "howto").glob("*.md")) if p.stem not in RIG),
]
SINGLE_PAGES += ["coming-from"]
# commands that end with exit code 1, a warning
WARNING_COMMANDS = ("sensor noise", "sensor touch", "record check", "campaign")
NUMBER = re.compile(r"\d+(?:\.\d+)?")
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.S | re.M)


def blocks(page: str) -> list[tuple[str, str]]:
    """(language, text) of the code blocks of a page, in order."""
    return FENCE.findall((DOCS / f"{page}.md").read_text(encoding="utf-8"))


def lines_agree(expected: str, printed: str) -> bool:
    """Whether two lines agree: text exactly, numbers to 2 % or 3 in the last digit shown."""
    if [w.strip() for w in NUMBER.split(expected)] != [w.strip() for w in NUMBER.split(printed)]:
        return False
    for shown_number, printed_number in zip(
        NUMBER.findall(expected), NUMBER.findall(printed), strict=True
    ):
        last_digit = 10.0 ** -len(shown_number.partition(".")[2])
        if abs(float(shown_number) - float(printed_number)) > max(
            0.02 * abs(float(shown_number)), 3 * last_digit if "." in shown_number else 0.5
        ):
            return False
    return True


def run_page(page: str) -> None:
    """Run the commands of a page in the working folder; every text block must have been printed
    before it."""
    output = ""
    for language, text in blocks(page):
        if language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(text, page, "exec"), {})
            plt.close("all")
            output += out.getvalue()
        elif language == "sh":
            for line in text.replace("\\\n", " ").splitlines():
                words = shlex.split(line)
                assert words[0] == "tcdyn", line
                # expand patterns as a shell does
                arguments = [
                    path for word in words[1:] for path in sorted(glob.glob(word)) or [word]
                ]
                stream = io.StringIO()
                with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
                    exit_code = run(lambda arguments=arguments: app(arguments))
                is_warning = " ".join(arguments).startswith(WARNING_COMMANDS) and exit_code != 0
                assert exit_code == int(is_warning), stream.getvalue()
                output += stream.getvalue()
        elif language == "text":
            printed = output.splitlines()
            expected = [line for line in text.splitlines() if line.strip()]
            missing = [
                line
                for line in expected
                if not any(lines_agree(line, printed_line) for printed_line in printed)
            ]
            assert not missing, f"{page} shows what nothing printed: {missing}"


@pytest.mark.e2e
@pytest.mark.parametrize("page", SINGLE_PAGES)
def test_page_runs_and_prints_what_it_shows(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(page)


@pytest.mark.e2e
def test_pages_of_the_rig_run_and_print_what_they_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for page in RIG:
        run_page(f"howto/{page}")


def test_every_how_to_page_is_run_by_a_test() -> None:
    assert {f"howto/{p.stem}" for p in (DOCS / "howto").glob("*.md")} == {
        *(page for page in SINGLE_PAGES if page.startswith("howto")),
        *(f"howto/{page}" for page in RIG),
    }


def anchors(page: Path) -> set[str]:
    """Headings of a page in the form used by links."""
    headings = re.findall(r"^#{1,3} (.+)$", page.read_text(encoding="utf-8"), re.M)
    plain_headings = (re.sub(r"[`*]", "", heading).lower() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain_headings}


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda p: str(p.relative_to(DOCS)))
def test_links_lead_to_existing_pages_headings_and_pictures(page: Path) -> None:
    if "packages" in page.parts:  # made by the build from docstrings
        return
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http", "mailto")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if target.parent.name == "_pictures":
            target = DOCS / "gallery" / f"{target.stem}.py"  # the script that draws it
        assert target.exists(), f"{page.name}: {link}"
        if anchor:
            assert anchor in anchors(target), f"{page.name}: {link}"
