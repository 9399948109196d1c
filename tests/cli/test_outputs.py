"""No command writes over what it reads, nor two of its outputs onto one file."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_main_job import records, tcdyn
from tests.conftest import Campaign


@pytest.fixture
def files(campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Inputs by short names, a folder below the present one to reach them by another way."""
    monkeypatch.chdir(tmp_path)
    f = campaign.files
    sources = {"log": f.ehl["B3"], "oven": f.ovens["fast"], "plunge": f.plunges["fast"][0], "rig": f.rig}
    found = {}
    for name, source in sources.items():
        found[name] = Path("..") / tmp_path.name / source.name
        found[name].write_bytes(source.read_bytes())
    return found


@pytest.mark.parametrize(
    ("words", "spared"),
    [
        ("compensate {log} {records} --out EHL_B3.csv", "log"),
        ("compensate {log} {records} --out EHL_B3.csv --noise-only", "log"),
        ("compensate {log} {records} --covariance EHL_B3.csv", "log"),
        ("follow {log} {records} --out EHL_B3.csv", "log"),
        ("compensate {log} {records} --report EHL_B3.csv", "log"),
        ("compensate {log} {records} --rig {rig} --report rig.toml", "rig"),
        ("calibrate --disk fast --oven {oven} --immersion {plunge} --out oven_fast.csv", "oven"),
        ("calibrate --disk fast --oven {oven} --immersion {plunge} --report plunge_fast_1.csv", "plunge"),
        ("calibrate --disk fast --oven {oven} --immersion {plunge} --rig {rig} --out rig.toml", "rig"),
        ("calibrate --disk fast --oven {oven} --immersion {plunge} --fluid {log} --out EHL_B3.csv", "log"),
        ("calibrate --disk fast --oven {oven} --immersion {plunge} --out x.json --report x.json", "oven"),
        ("identify {plunge} --input probe_degC --output a_degC --out plunge_fast_1.csv", "plunge"),
        ("identify {plunge} --input probe_degC --output a_degC --out x.html", "plunge"),
        ("hole {log} --out EHL_B3.csv", "log"),
        ("hole {log} --rig {rig} --report rig.toml", "rig"),
        ("design --rig {rig} --out rig.toml", "rig"),
        ("design --fluid {oven} --out oven_fast.csv", "oven"),
        ("verify --csv x --report x", "log"),
    ],
)
def test_an_input_is_never_written_over(
    words: str, spared: str, files: dict[str, Path], campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {p.name: p.read_bytes() for p in Path().iterdir()}
    said = words.format(records=" ".join(map(str, records(campaign))), **files).split()
    assert tcdyn(*said) == 2
    error = capsys.readouterr().err
    assert "would write over" in error
    assert error.count("\n") == 1
    assert {p.name: p.read_bytes() for p in Path().iterdir()} == before, spared
