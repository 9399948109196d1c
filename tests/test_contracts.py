"""Import contracts between the packages: each can be broken, and no file imports itself through
others."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("calibration", "immersion", "tcdyn")


def lint(folder: Path) -> str:
    """Report of import-linter on the packages in ``folder``."""
    pytest.importorskip("importlinter")
    run = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    call = [sys.executable, "-c", run, "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "COLUMNS": "200"}
    return subprocess.run(
        call, cwd=folder, env=environment, capture_output=True, text=True, check=False
    ).stdout


def verdicts(report: str) -> dict[str, str]:
    """KEPT or BROKEN by the contract's name."""
    ends = (
        line.rpartition(" ") for line in report.splitlines() if line.endswith((" KEPT", " BROKEN"))
    )
    return {name: verdict for name, _, verdict in ends}


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the library and its contracts, to be broken."""
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def append(path: Path, line: str) -> None:
    """Put ``line`` at the end of a file."""
    path.write_text(path.read_text(encoding="utf-8") + "\n" + line + "\n", encoding="utf-8")


def test_the_library_keeps_its_contracts() -> None:
    report = lint(ROOT)
    assert set(verdicts(report).values()) == {"KEPT"}, report


def test_an_estimator_that_imports_the_simulator_is_caught(copy: Path) -> None:
    """Directly (partition, immersion), and through a package that estimators may import
    (smoothing)."""
    sabotage = {
        "tcdyn.partition": "from tcdyn.simulate.implicit import *",
        "immersion": "from tcdyn.simulate.plunge import simulate_plunge",
        "tcdyn.smoothing": "def later() -> None:\n    from tcdyn.simulate.measure import "
        "through_chains",
    }
    expected_arrows = {}
    for package, line in sabotage.items():
        folder = copy.joinpath(*package.split("."))
        path = min(p for p in folder.glob("*.py") if p.name != "__init__.py")
        append(path, line)
        expected_arrows[package] = f"{package}.{path.stem} -> tcdyn.simulate"
    report = lint(copy)
    inverse_crime = [
        verdict for name, verdict in verdicts(report).items() if name.startswith("No inverse crime")
    ]
    assert inverse_crime == ["BROKEN"], report
    missing = [package for package, arrow in expected_arrows.items() if arrow not in report]
    assert missing == []


def test_every_contract_can_be_broken(copy: Path) -> None:
    append(copy / "tcdyn/rig/disk.py", "import tcdyn.chain")
    append(copy / "tcdyn/rig/contact.py", "import matplotlib")
    append(copy / "tcdyn/simulate/mesh.py", "import tcdyn.heat.rim")
    append(copy / "tcdyn/chain/__init__.py", "def later() -> None:\n    import tcdyn.simulate.mesh")
    (copy / "tcdyn/unplanned.py").write_text('"""A module without a layer."""\n', encoding="utf-8")
    report = lint(copy)
    assert set(verdicts(report).values()) == {"BROKEN"}, report
    assert "unplanned" in report


def imports() -> dict[str, set[str]]:
    """Library files by module, and which of them each imports, also inside functions and for types
    only."""
    files = {module(path): path for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    arrows: dict[str, set[str]] = {}
    for name, path in files.items():
        arrows[name] = set()
        for package, thing in imported(path):  # a file of that package, or a name in it
            used = f"{package}.{thing}" if f"{package}.{thing}" in files else package
            if used in files:
                arrows[name].add(used)
    return arrows


def module(path: Path) -> str:
    """Dotted name of a file of the library."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Every (package or module, name) that a file imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module, f"{path}: an import relative to its package"
            yield from ((node.module, alias.name) for alias in node.names)


@pytest.mark.e2e
def test_no_import_cycle_between_files() -> None:
    try:
        TopologicalSorter(imports()).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


# Limits of a function of a command or a flow; options belong into a dataclass (tcdyn.core.options).
MOST_PARAMETERS = 12
MOST_LINES = 80


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Every function of a file, also inside classes and other functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


@pytest.mark.parametrize("package", ["tcdyn/cli", "tcdyn/workflows"])
def test_functions_of_commands_and_flows_are_short(package: str) -> None:
    """At most 12 parameters, and 80 lines with the docstring."""
    too_long = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        for function in functions(path):
            given = function.args
            named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
            count = len(named) + (given.vararg is not None) + (given.kwarg is not None)
            lines = (function.end_lineno or 0) - function.lineno + 1
            if count > MOST_PARAMETERS or lines > MOST_LINES:
                too_long[f"{path.name}: {function.name}"] = (count, lines)
    assert too_long == {}
