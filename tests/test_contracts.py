"""The house's plan, held by tests: import contracts that a break does break, and no circle between files."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("calibration", "immersion", "tcdyn")


def lint(folder: Path) -> str:
    """What import-linter says of the packages in ``folder``."""
    pytest.importorskip("importlinter")
    run = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    call = [sys.executable, "-c", run, "--no-cache"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "COLUMNS": "200"}
    return subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, check=False).stdout


def verdicts(said: str) -> dict[str, str]:
    """KEPT or BROKEN by the contract's name."""
    ends = (line.rpartition(" ") for line in said.splitlines() if line.endswith((" KEPT", " BROKEN")))
    return {name: verdict for name, _, verdict in ends}


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the library and its contracts, to be broken."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def append(path: Path, line: str) -> None:
    """Put ``line`` at the end of a file."""
    path.write_text(path.read_text(encoding="utf-8") + "\n" + line + "\n", encoding="utf-8")


@pytest.mark.xfail(reason="circles of version 0.1 are being undone", strict=False)
def test_the_house_keeps_its_contracts() -> None:
    said = lint(ROOT)
    assert set(verdicts(said).values()) == {"KEPT"}, said


def test_a_fit_that_borrows_the_synthetic_rig_s_solver_is_caught(copy: Path) -> None:
    append(copy / "tcdyn/partition/window.py", "from tcdyn.simulate.implicit import *")
    append(copy / "tcdyn/plunge/model.py", "from tcdyn.simulate.plunge import simulate_plunge")
    said = lint(copy)
    crime = [verdict for name, verdict in verdicts(said).items() if name.startswith("No inverse crime")]
    assert crime == ["BROKEN"], said
    for borrower, lender in (("partition.window", "implicit"), ("plunge.model", "plunge")):
        assert f"tcdyn.{borrower} -> tcdyn.simulate.{lender}" in said


def test_every_contract_can_be_broken(copy: Path) -> None:
    append(copy / "calibration/disk.py", "import tcdyn.chain")
    append(copy / "tcdyn/contact.py", "import matplotlib")
    append(copy / "tcdyn/simulate/mesh.py", "import tcdyn.conduction.rim")
    append(copy / "tcdyn/chain/chain.py", "def later() -> None:\n    import tcdyn.simulate.mesh")
    (copy / "tcdyn/attic.py").write_text('"""A room that no plan shows."""\n', encoding="utf-8")
    said = lint(copy)
    assert set(verdicts(said).values()) == {"BROKEN"}, said
    assert "attic" in said


def imports() -> dict[str, set[str]]:
    """Library files by module, and which of them each imports, also inside functions and for types only."""
    files = {module(path): path for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    return {name: {used for used in imported(path) if used in files and used != name} for name, path in files.items()}


def module(path: Path) -> str:
    """Dotted name of a file of the library."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path) -> Iterator[str]:
    """Every dotted name that a file may import."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module, f"{path}: an import relative to its package"
            below = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from below
            yield node.module


@pytest.mark.xfail(reason="circles of version 0.1 are being undone", strict=False)
def test_no_circle_between_files() -> None:
    try:
        TopologicalSorter(imports()).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@pytest.mark.xfail(reason="rooms are still being rebuilt", strict=False)
def test_the_house_stays_small_enough_to_know() -> None:
    """A folder's listing reads as its table of contents, a file is one concept, a name means one thing."""
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    assert len(files) <= 160
    crowded = {f: n for f, n in Counter(str(path.parent.relative_to(ROOT)) for path in files).items() if n > 15}
    assert crowded == {}
    text = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in files}
    assert {name: n for name, source in text.items() if (n := source.count("\n")) > 300} == {}
    classes: dict[str, list[str]] = {}
    for name, source in text.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, []).append(name)
    assert {name: where for name, where in classes.items() if len(where) > 1} == {}
