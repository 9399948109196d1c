"""Every public name has an example that runs: in a docstring, on a page, or in a script of the
gallery."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent.parent
MODULES = (
    "tcdyn",
    "tcdyn.chain",
    "tcdyn.smoothing",
    "tcdyn.identification",
    "tcdyn.sensors",
    "tcdyn.estimation",
    "tcdyn.campaign",
    "tcdyn.workflows",
    "tcdyn.plots",
)
PACKAGES = ("calibration", "immersion", "tcdyn")


def public_names() -> dict[str, Any]:
    """Public functions and classes by the first name that exports them; type aliases are not
    callable."""
    by_id: dict[int, tuple[str, Any]] = {}
    for module_name in MODULES:
        module = import_module(module_name)
        for name in module.__all__:
            item = getattr(module, name)
            if inspect.isclass(item) or inspect.isfunction(item):
                by_id.setdefault(id(item), (f"{module_name}.{name}", item))
    return dict(by_id.values())


def examples() -> Iterator[str]:
    """Lines of code that the tests run."""
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            yield from re.findall(
                r"^\s*(?:>>>|\.\.\.) (.+)$", path.read_text(encoding="utf-8"), re.M
            )
    for path in (ROOT / "docs").rglob("*.md"):
        yield from re.findall(
            r"^```(?:python|\{code-cell\} ipython3)\n(.*?)^```$",
            path.read_text(encoding="utf-8"),
            re.S | re.M,
        )
    for path in (ROOT / "docs" / "gallery").rglob("*.py"):
        yield path.read_text(encoding="utf-8")


def test_functions_of_the_usual_modules_have_an_example_in_their_docstring() -> None:
    for module_name in ("tcdyn", "tcdyn.smoothing", "tcdyn.identification", "tcdyn.sensors"):
        module = import_module(module_name)
        functions = [getattr(module, name) for name in module.__all__]
        functions = [function for function in functions if inspect.isfunction(function)]
        assert [f.__name__ for f in functions if ">>>" not in (f.__doc__ or "")] == []


def test_every_public_name_is_used_in_an_example() -> None:
    called = set(re.findall(r"\b[A-Za-z_]\w*\b", "\n".join(examples())))
    returned_classes = set()  # classes that a called function returns need no example of their own
    for item in public_names().values():
        if inspect.isfunction(item) and item.__name__ in called:
            returned_classes |= set(re.findall(r"\w+", str(item.__annotations__.get("return", ""))))
    assert [
        name
        for name, item in public_names().items()
        if item.__name__ not in called | returned_classes
    ] == []
