"""The manual says what the program does: its commands run and print what it shows, its links lead somewhere."""

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
RIG = (
    "calibrate",
    "compensate",
    "beta",
    "campaign",
)  # share the folder that the first of them makes, in this order
ALONE = [
    "start",
    *(f"howto/{p.stem}" for p in sorted((DOCS / "howto").glob("*.md")) if p.stem not in RIG),
]
ALONE += ["coming-from"]
LOOKS = (
    "sensor noise",
    "record check",
    "campaign",
)  # end with exit code 1: something asks to be looked at
NUMBER = re.compile(r"\d+(?:\.\d+)?")
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.S | re.M)


def blocks(page: str) -> list[tuple[str, str]]:
    """(language, text) of the code on a page, in its order."""
    return FENCE.findall((DOCS / f"{page}.md").read_text(encoding="utf-8"))


def same(shown: str, printed: str) -> bool:
    """Whether two lines say the same: words to the letter, numbers to 2 % or 3 in the last place shown."""
    if [w.strip() for w in NUMBER.split(shown)] != [w.strip() for w in NUMBER.split(printed)]:
        return False
    for one, other in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True):
        last = 10.0 ** -len(one.partition(".")[2])
        if abs(float(one) - float(other)) > max(
            0.02 * abs(float(one)), 3 * last if "." in one else 0.5
        ):
            return False
    return True


def follow(page: str) -> None:
    """Do what a page says, in the working folder; what it shows must have been printed since the block before."""
    said = ""
    for language, text in blocks(page):
        if language == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(text, page, "exec"), {})
            plt.close("all")
            said += out.getvalue()
        elif language == "sh":
            for line in text.replace("\\\n", " ").splitlines():
                words = shlex.split(line)
                assert words[0] == "tcdyn", line
                words = [
                    path for word in words[1:] for path in sorted(glob.glob(word)) or [word]
                ]  # as a shell does
                told = io.StringIO()
                with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
                    code = run(lambda words=words: app(words))
                assert code == int(" ".join(words).startswith(LOOKS) and code != 0), told.getvalue()
                said += told.getvalue()
        elif language == "text":
            printed = said.splitlines()
            shown = [line for line in text.splitlines() if line.strip()]
            missing = [line for line in shown if not any(same(line, other) for other in printed)]
            assert not missing, f"{page} shows what nothing printed: {missing}"


@pytest.mark.e2e
@pytest.mark.parametrize("page", ALONE)
def test_a_page_does_what_it_says(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    follow(page)


@pytest.mark.e2e
def test_the_pages_of_the_rig_do_what_they_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for page in RIG:
        follow(f"howto/{page}")


def test_every_page_of_the_how_to_is_run_by_a_test() -> None:
    assert {f"howto/{p.stem}" for p in (DOCS / "howto").glob("*.md")} == {
        *(page for page in ALONE if page.startswith("howto")),
        *(f"howto/{page}" for page in RIG),
    }


def anchors(page: Path) -> set[str]:
    """Headings of a page, as links name them."""
    found = re.findall(r"^#{1,3} (.+)$", page.read_text(encoding="utf-8"), re.M)
    plain = (re.sub(r"[`*]", "", heading).lower() for heading in found)
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda p: str(p.relative_to(DOCS)))
def test_links_lead_to_pages_headings_and_pictures_that_are_there(page: Path) -> None:
    if "packages" in page.parts:  # made by the build, of docstrings
        return
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http", "mailto")):
            continue
        path, _, anchor = link.partition("#")
        there = (page.parent / path).resolve() if path else page
        if there.parent.name == "_pictures":
            there = DOCS / "gallery" / f"{there.stem}.py"  # which makes it
        assert there.exists(), f"{page.name}: {link}"
        if anchor:
            assert anchor in anchors(there), f"{page.name}: {link}"
