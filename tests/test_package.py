"""What ``import tcdyn`` offers, that it is quick to offer it, and that every public name says what
it is."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tcdyn

ROOT = Path(__file__).parent.parent
Function = ast.FunctionDef | ast.AsyncFunctionDef

# an argument by one of these names is a physical quantity whose name does not say its unit
QUANTITIES = {
    "alpha",
    "conductivity",
    "density",
    "depth",
    "diameter",
    "dt",
    "duration",
    "frequency",
    "h",
    "lag",
    "length",
    "load",
    "power",
    "pressure",
    "radius",
    "specific_heat",
    "speed",
    "t",
    "temperature",
    "thickness",
    "time",
    "viscosity",
    "width",
}
NUMBER = re.compile(r"float|Array|ndarray")
UNIT = re.compile(
    r"\[[^\]]*\]|\b(seconds?|metres?|kelvin|K|degC|Pa|SI|N|W|Hz|s|m|mm|samples|dimensionless|unit|rpm)\b|m/s|m2/s|/K"
)


def public_definitions() -> Iterator[tuple[str, ast.AST, str]]:
    """(place, node, docstring) of every public module, class, function and method of the three
    packages."""
    for package in ("calibration", "immersion", "tcdyn"):
        for path in sorted((ROOT / package).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            where = str(path.relative_to(ROOT))
            yield where, tree, ast.get_docstring(tree) or ""
            todo: list[tuple[str, ast.AST]] = [(where, tree)]
            while todo:
                place, parent = todo.pop()
                for node in ast.iter_child_nodes(parent):
                    if not isinstance(node, ast.ClassDef | Function) or node.name.startswith("_"):
                        continue
                    name = f"{place}:{node.name}"
                    yield name, node, ast.get_docstring(node) or ""
                    if isinstance(node, ast.ClassDef):
                        todo.append((name, node))


@pytest.mark.e2e
def test_every_public_name_is_there_with_a_docstring() -> None:
    for name in tcdyn.__all__:
        thing = getattr(tcdyn, name)
        assert name == "__version__" or thing.__doc__
    silent = [name for name, node, text in public_definitions() if not text and not overload(node)]
    assert silent == []


def overload(node: ast.AST) -> bool:
    """Whether this is one of several typed faces of a function, whose last one carries the
    words."""
    return isinstance(node, Function) and any(
        "overload" in ast.dump(d) for d in node.decorator_list
    )


@pytest.mark.e2e
def test_rooms_are_reached_without_another_import_and_told_by_tab_completion() -> None:
    said = (
        "import tcdyn; "
        "print(tcdyn.plots.draw.__name__, tcdyn.partition.__name__, {'plots', 'fit'} <= "
        "set(dir(tcdyn)))"
    )
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["draw", "tcdyn.partition", "True"]


@pytest.mark.e2e
def test_in_a_notebook_a_result_shows_its_picture() -> None:
    said = """
import sys, types
asked = {}
class Html:
    def for_type_by_name(self, module, name, show): asked[module, name] = show
html = Html()
formatter = types.SimpleNamespace(formatters={"text/html": html})
shell = types.SimpleNamespace(display_formatter=formatter)
sys.modules["IPython"] = types.SimpleNamespace(get_ipython=lambda: shell)
import tcdyn
del sys.modules["IPython"]
show = asked["tcdyn.core.result", "Result"]
card = show(tcdyn.Chain([0.7]))
print(card.count("data:image/png"), card.startswith(tcdyn.Chain([0.7])._repr_html_()))
print(show(tcdyn.load_rig()).count("<img"))
"""
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "True", "1"]


@pytest.mark.e2e
def test_quantities_are_given_with_their_unit_by_name_or_in_the_docstring() -> None:
    """An argument called ``time_s`` says its unit; one called ``time`` has it in the docstring."""
    found = []
    for name, node, text in public_definitions():
        if isinstance(node, Function):
            arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            numbers = [
                a.arg
                for a in arguments
                if a.annotation and NUMBER.search(ast.unparse(a.annotation))
            ]
            bare = [a for a in numbers if a in QUANTITIES]
            if bare and not UNIT.search(text):
                found.append(f"{name}({', '.join(bare)})")
    assert found == []


def test_import_brings_no_heavy_library() -> None:
    """Counted rather than timed: none of the slow libraries is loaded by the import alone."""
    heavy = "numpy scipy pandas control matplotlib pydantic"
    code = f"import sys, tcdyn; print([m for m in {heavy.split()} if m in sys.modules])"
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert said.strip() == "[]"
