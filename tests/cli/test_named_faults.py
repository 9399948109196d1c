"""Faults of version 0.2 that have no other test: a traceback or a wrong result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.cli.identify import _files_of_outputs
from tcdyn.core.errors import InputError
from tcdyn.identification import read_identified
from tcdyn.io.stored import IDENTIFIED
from tcdyn.workflows.campaign import _check_names
from tests.cli.fault_commands import small_files
from tests.cli.test_main_job import tcdyn


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return small_files(tmp_path_factory.mktemp("small"))


def test_an_exponent_of_the_speed_needs_the_speed(
    small: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    columns = ("--column", "T1_degC", "--column", "T2_degC")
    assert tcdyn("sensor", "pair", small["table"], *columns, "--exponent", "0.5") == 2
    assert "--exponent is given without --speed" in capsys.readouterr().err


def test_an_unknown_column_of_the_reference_junction_is_named(
    small: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--sensor", small["sensor"], "--cold-junction", "CJ", "--out", tmp_path / "o.csv")
    assert tcdyn("compensate", small["table"], *words) == 2
    assert "column 'CJ' is missing" in capsys.readouterr().err


@pytest.mark.parametrize("model", ["P1", "P1D", "P2", "TF(1,2)"])
def test_an_exact_first_order_response_is_fitted(tmp_path: Path, model: str) -> None:
    f = np.geomspace(0.01, 2, 15)
    g = 1 / (1 + 2j * np.pi * f * 0.8)
    table = {"frequency_Hz": f, "gain": np.abs(g), "phase": np.degrees(np.angle(g))}
    pd.DataFrame(table).to_csv(tmp_path / "bode.csv", index=False)
    words = ("--column", "gain", "--column", "phase", "--model", model, "-q")
    out = tmp_path / "r.json"
    assert tcdyn("response", tmp_path / "bode.csv", *words, "--out", out) in (0, 1)


@pytest.mark.parametrize(
    "names",
    [
        ("a/EHL_A1.csv", "b/EHL_A1.csv"),
        ("a/EHL_A1.csv", "b/ehl_a1.csv"),  # one file on Windows
        ("EHL_A1.csv", "EHL_A1.beta.json"),
        ("EHL_A1.csv", "EHL_A1.2.csv"),  # as the second loading of the first log
    ],
)
def test_results_of_two_logs_never_have_one_name(names: tuple[str, str]) -> None:
    with pytest.raises(InputError, match="rename one"):
        _check_names([Path(name) for name in names])
    _check_names([Path("EHL_A1.csv"), Path("EHL_A2.1.csv"), Path("EHL_A2.2.csv")])


def test_files_of_two_outputs_differ_on_any_system() -> None:
    with pytest.raises(InputError, match="one name"):
        _files_of_outputs(Path("o.json"), ["T1", "t1"])


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"{", "not readable as JSON"),
        (b"\xff\xfe{", "not readable as JSON"),
        (b"[]", "is not an identified model"),
        (b'{"schema": "SCHEMA"}', "is damaged"),
    ],
)
def test_a_damaged_identified_model_is_named_with_its_file(
    tmp_path: Path, content: bytes, reason: str
) -> None:
    path = tmp_path / "m.identified.json"
    path.write_bytes(content.replace(b"SCHEMA", IDENTIFIED.schema.encode()))
    with pytest.raises(InputError, match=reason) as problem:
        read_identified(path)
    assert str(problem.value).startswith(str(path))
    assert "\n" not in str(problem.value)
