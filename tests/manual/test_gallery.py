"""The page of the gallery shows the picture of every script; CI draws them for the manual."""

from __future__ import annotations

import re
from pathlib import Path

GALLERY = Path(__file__).parent.parent.parent / "docs" / "gallery"
SCRIPTS = sorted(path.stem for path in GALLERY.glob("*.py") if path.stem not in ("common", "make"))


def test_page_shows_every_picture_with_its_script_and_its_docstring() -> None:
    page = (GALLERY / "index.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| .*_pictures/(\w+)\.png\) \| (.*) \{download\}`(\w+)\.py` \|$", page, re.M
    )
    assert sorted(name for name, _, _ in rows) == SCRIPTS
    for name, what, script in rows:
        assert name == script
        assert f'"""{what}"""' in (GALLERY / f"{name}.py").read_text(encoding="utf-8")
