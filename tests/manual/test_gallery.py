"""Every script of the gallery draws the picture of its name, and the page shows them all."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GALLERY = Path(__file__).parent.parent.parent / "docs" / "gallery"
SCRIPTS = sorted(path.stem for path in GALLERY.glob("*.py") if path.stem not in ("common", "make"))


def test_the_page_shows_every_picture_with_its_script_and_what_its_docstring_says() -> None:
    page = (GALLERY / "index.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| .*_pictures/(\w+)\.png\) \| (.*) \{download\}`(\w+)\.py` \|$", page, re.M
    )
    assert sorted(name for name, _, _ in rows) == SCRIPTS
    for name, what, script in rows:
        assert name == script
        assert f'"""{what}"""' in (GALLERY / f"{name}.py").read_text(encoding="utf-8")


@pytest.mark.e2e
def test_every_script_draws(tmp_path: Path) -> None:
    """In one process of their own, as CI makes them, into a folder of the test's."""
    call = [sys.executable, str(GALLERY / "make.py"), "--out", str(tmp_path)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == SCRIPTS
