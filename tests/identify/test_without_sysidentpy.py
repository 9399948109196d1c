"""Where sysidentpy cannot be imported, everything but NARX works, and NARX says so."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification.narx import narx
from tests.cli.fault_commands import small_files
from tests.cli.test_main_job import tcdyn
from tests.identify.identify_cases import case_a

IMPORT_ALL = """
import importlib, pkgutil, sys
sys.modules["sysidentpy"] = None
import calibration, immersion, tcdyn
for package in (calibration, immersion, tcdyn):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
from tcdyn.cli.app import app, run
sys.exit(run(lambda: app(sys.argv[1:])))
"""


@pytest.fixture
def blocked(monkeypatch: pytest.MonkeyPatch) -> None:
    """No module of sysidentpy can be imported."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "sysidentpy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "sysidentpy", None)


def test_narx_without_sysidentpy_says_what_to_install(
    blocked: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="pip install sysidentpy"):
        narx(case_a("prbs", 1))
    table = small_files(tmp_path)["table"]
    words = ["identify", table, "--input", "u", "--output", "T1_degC", "--narx", "-q"]
    assert tcdyn(*words) == 2
    assert "leave out --narx" in capsys.readouterr().err


@pytest.mark.e2e
def test_all_modules_and_identify_work_without_sysidentpy(tmp_path: Path) -> None:
    table = small_files(tmp_path)["table"]
    words = ["identify", table, "--input", "u", "--output", "T1_degC", "--model", "P1", "-q"]
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL, *map(str, words)], capture_output=True, text=True
    )
    assert done.returncode in (0, 1), done.stderr
    assert table.with_suffix(".identified.json").exists()
