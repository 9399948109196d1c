"""Do the tests detect faults? Random operators of the library are swapped one at a time: + and -, *
and /, < and >.

Run ``python -m tests.benchmarks.mutants N [SEED [COVERAGE]]``. Each mutant is made in a copy of the
source. First the tests run that import its module, then those of its package, then the behaviour
suite and the main job; of all test groups, as in CI. A test that does not end counts as a failure.

COVERAGE is a folder with the files ``.coverage`` and ``tests.xml`` of
``pytest -m "" --cov --cov-context=test --junitxml=COVERAGE/tests.xml``. Then only the tests run
that execute the line of the mutant, the quick ones first, for a few minutes.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from itertools import accumulate
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import pytest
from coverage import CoverageData

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = (
    "pandas",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "matplotlib.pyplot",
    "pyarrow.parquet",
    "typer",
)
PACKAGES = ("calibration", "immersion", "tcdyn")
SIGNS = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Lt: "<",
    ast.Gt: ">",
    ast.LtE: "<=",
    ast.GtE: ">=",
}
SWAPPED = {**dict(zip(SIGNS, "-+/*><")), ast.LtE: ">=", ast.GtE: "<="}
TEST_FOLDER_OF = {"design": "immersion", "workflows": "cli", "plots": "report"}
LIMIT_s = 1500.0  # of one stage
MOST_s = 90.0


def operator_locations(path: Path) -> Iterator[tuple[int, int, type]]:
    """Offset in the text, length and kind of each operator between two operands on one line."""
    text = path.read_text(encoding="utf-8")
    starts = [0, *(m.end() for m in re.finditer("\n", text))]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.BinOp) and type(node.op) in SWAPPED:
            pairs = [(node.left, type(node.op), node.right)]
        elif isinstance(node, ast.Compare):
            neighbours = zip([node.left, *node.comparators], node.ops, node.comparators)
            pairs = [
                (left, type(op), right) for left, op, right in neighbours if type(op) in SWAPPED
            ]
        else:
            continue
        for left, kind, right in pairs:
            if left.end_lineno is None or left.end_col_offset is None:
                continue
            line = text[starts[left.end_lineno - 1] :].split("\n", 1)[0].encode()
            start = starts[left.end_lineno - 1] + len(line[: left.end_col_offset].decode())
            end = starts[right.lineno - 1] + len(
                text[starts[right.lineno - 1] :]
                .split("\n", 1)[0]
                .encode()[: right.col_offset]
                .decode()
            )
            match = re.search(rf"(?<![*/<>]){re.escape(SIGNS[kind])}(?![*/=])", text[start:end])
            if match:
                yield start + match.start(), len(SIGNS[kind]), kind


def stages(file: str) -> list[list[str]]:
    """Tests that import the module, those of its package, and the main job."""
    path_parts = Path(file).with_suffix("").parts
    module = ".".join(p for p in path_parts if p != "__init__")
    direct = [
        str(p.relative_to(ROOT))
        for p in sorted((ROOT / "tests").rglob("test_*.py"))
        if re.search(rf"\b{re.escape(module)}\b", p.read_text(encoding="utf-8"))
    ]
    package = Path(path_parts[1 if path_parts[0] == "tcdyn" else 0]).stem
    package_tests = [
        f"tests/{name}"
        for name in (TEST_FOLDER_OF.get(package), package)
        if name and (ROOT / "tests" / name).is_dir()
    ][:1]
    return [
        [file, *direct[:8]],
        package_tests,
        ["tests/behaviour", "tests/cli/test_main_job.py", "tests/core/test_results.py"],
    ]


def stages_by_coverage(folder: Path, file: str, row: int) -> list[list[str]]:
    """The tests that execute a line: first those without the simulated campaign, then the others,
    the quick ones first.

    Of each as many as took ``MOST_s`` in the complete run; then the tests of the numbers of this
    version, and for a line that a fixture executes the complete job.
    """
    data = CoverageData(str(folder / ".coverage"))
    data.read()
    (measured,) = [path for path in data.measured_files() if path.endswith(f"/{file}")]
    every = [c.rpartition("|") for c in data.contexts_by_lineno(measured).get(row, []) if c]
    contexts = {test for test, _, _ in every}
    shared = any(when == "setup" for _, _, when in every)
    took = {}
    for case in ElementTree.parse(folder / "tests.xml").iter("testcase"):
        file_of = case.attrib["classname"].replace(".", "/")
        took[f"{file_of}.py::{case.attrib['name']}"] = float(case.attrib["time"])
    with_campaign = {
        name: "campaign" in (ROOT / name).read_text("utf-8")
        for name in {t.split("::")[0] for t in contexts}
    }
    package_tests = tuple(name for group in stages(file)[:2] for name in group if name != file)
    quick = sorted(
        contexts,
        key=lambda test: (
            with_campaign[test.split("::")[0]],
            not test.startswith(package_tests),
            took.get(test, 1.0),
        ),
    )
    without_campaign = [test for test in quick if not with_campaign[test.split("::")[0]]]
    test_groups = []
    for group in (without_campaign, quick[len(without_campaign) :]):
        until = accumulate(took.get(test, 1.0) for test in group)
        test_groups.append([test for test, end in zip(group, until) if end < MOST_s] or group[:1])
    return [*test_groups, stages(file)[-1] if shared else ["tests/behaviour/test_behaviour.py"]]


def detected_by(copy: Path, test_groups: list[list[str]]) -> str:
    """The stage that detected the mutant, or an empty text."""
    for name, tests in zip(("module", "package", "job"), test_groups):
        if not tests:
            continue
        # a fork has all libraries imported
        run = get_context("fork").Process(target=run_in, args=(copy, tests))
        run.start()
        run.join(LIMIT_s)
        if run.is_alive():
            run.kill()
            run.join()
            return f"{name}, without end"
        if run.exitcode not in (0, 5):
            return name
    return ""


def run_in(copy: Path, tests: list[str]) -> None:
    """Ends this process with pytest's exit code of ``tests`` in ``copy``."""
    for name in [name for name in sys.modules if name.partition(".")[0] in (*PACKAGES, "tests")]:
        del sys.modules[name]
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    os.environ |= {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    with open(os.devnull, "wb") as null:
        for stream in (1, 2):
            os.dup2(null.fileno(), stream)
    sys.exit(
        int(pytest.main(["-x", "-q", "-m", "", "-p", "no:cacheprovider", "-p", "no:xdist", *tests]))
    )


def main(count: int, seed: int, coverage: Path | None = None) -> None:
    """Sample ``count`` operators; print for each the stage that detected it, and the total."""
    for name in LIBRARIES:
        import_module(name)
    rng = Random(seed)
    files = [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]
    locations = [(p, *location) for p in files for location in operator_locations(p)]
    detected = 0
    with TemporaryDirectory() as folder:
        copy = Path(folder)
        for folder_name in (*PACKAGES, "tests", "docs"):
            shutil.copytree(
                ROOT / folder_name, copy / folder_name, ignore=shutil.ignore_patterns("__pycache__")
            )
        for name in ("pyproject.toml", "README.md", "CHANGELOG.md"):
            shutil.copy(ROOT / name, copy / name)
        if detected_by(
            copy, [["tests/estimation", "tests/immersion", "tests/behaviour/test_behaviour.py"]]
        ):
            sys.exit("tests fail without a swapped operator")
        for k, (path, offset, length, kind) in enumerate(rng.sample(locations, count), 1):
            file = str(path.relative_to(ROOT))
            text = path.read_text(encoding="utf-8")
            mutant = text[:offset] + SWAPPED[kind] + text[offset + length :]
            (copy / file).write_text(mutant, encoding="utf-8")
            line_no = text.count("\n", 0, offset) + 1
            test_groups = stages_by_coverage(coverage, file, line_no) if coverage else []
            stage = detected_by(copy, test_groups if any(test_groups) else stages(file))
            (copy / file).write_text(text, encoding="utf-8")
            detected += bool(stage)
            line = text.splitlines()[line_no - 1].strip()
            print(
                f"{k} {file}:{line_no} {SIGNS[kind]} -> {SWAPPED[kind]}: "
                f"{stage or 'NOT DETECTED'}: {line}",
                flush=True,
            )
    print(f"{detected} of {count} detected")


if __name__ == "__main__":
    main(
        int(sys.argv[1]),
        int(sys.argv[2]) if len(sys.argv) > 2 else 0,
        Path(sys.argv[3]) if len(sys.argv) > 3 else None,
    )
