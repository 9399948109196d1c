"""Every public name has an example that runs: in a docstring, on a page, or in a script of the gallery."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent.parent
ROOMS = (
    "tcdyn",
    "tcdyn.chain",
    "tcdyn.smoothing",
    "tcdyn.identify",
    "tcdyn.sensors",
    "tcdyn.estimation",
    "tcdyn.campaign",
    "tcdyn.workflows",
    "tcdyn.plots",
)
PACKAGES = ("calibration", "immersion", "tcdyn")


def public() -> dict[str, Any]:
    """What the rooms offer, by the first name that offers it; types of arguments alone are no names to call."""
    found: dict[int, tuple[str, Any]] = {}
    for room in ROOMS:
        module = import_module(room)
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                found.setdefault(id(thing), (f"{room}.{name}", thing))
    return dict(found.values())


def examples() -> Iterator[str]:
    """Lines of code that the tests run."""
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            yield from re.findall(
                r"^\s*(?:>>>|\.\.\.) (.+)$", path.read_text(encoding="utf-8"), re.M
            )
    for path in (ROOT / "docs").rglob("*.md"):
        yield from re.findall(
            r"^```python\n(.*?)^```$", path.read_text(encoding="utf-8"), re.S | re.M
        )
    for path in (ROOT / "docs" / "gallery").glob("*.py"):
        yield path.read_text(encoding="utf-8")


def test_every_public_name_is_called_by_an_example() -> None:
    called = set(re.findall(r"\b[A-Za-z_]\w*\b", "\n".join(examples())))
    given = set()  # classes that a called function returns need no example of their own
    for thing in public().values():
        if inspect.isfunction(thing) and thing.__name__ in called:
            given |= set(re.findall(r"\w+", str(thing.__annotations__.get("return", ""))))
    assert [name for name, thing in public().items() if thing.__name__ not in called | given] == []
