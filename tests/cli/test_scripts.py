"""Shell scripts of the three main flows, with ``set -e``: they run to the end."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import Campaign

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash"),
]
ANY_THERMOCOUPLE = """
tcdyn sensor new --tau-s 2+-0.1 --column T1 --out data_sheet.sensor.json
tcdyn sensor plunge dip.csv --column T1 --out probe.sensor.json
tcdyn sensor show probe.sensor.json
tcdyn compensate furnace.csv --sensor probe.sensor.json --out done.csv
tcdyn compensate furnace.csv --sensor data_sheet.sensor.json --out done.parquet --quiet
tcdyn follow furnace.csv --sensor probe.sensor.json --out live.csv --idle-s 0.1
"""
IDENTIFICATION = """
tcdyn identify heater.csv --input power_percent --output T1 --model P1D --model P2D --out model.json
tcdyn compensate furnace.csv --sensor model.json --column T1 --out done.csv
"""
RIG = """
tcdyn rig check rig.toml --quiet
for disk in fast slow; do
  tcdyn rig calibrate --rig rig.toml --disk $disk --oven oven_$disk.csv \\
    --immersion plunge_${disk}_1.csv --immersion plunge_${disk}_2.csv
  tcdyn rig record check $disk.disk.json
done
records="--record fast.disk.json --record slow.disk.json"
tcdyn rig beta EHL_B3.csv --rig rig.toml $records --out beta.json --report beta.html
tcdyn compensate EHL_B3.csv $records --out done.csv
tcdyn rig campaign EHL_B3.csv --rig rig.toml $records --out results --workers 1
"""


def run_script(script: str, folder: Path) -> str:
    """Run a script with ``set -euo pipefail``; what it printed on standard output."""
    define = f'tcdyn() {{ "{sys.executable}" -m tcdyn "$@"; }}\n'
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", define + script + "\necho end\n"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        check=False,
        timeout=500,
    )
    assert ended.returncode == 0, ended.stderr
    for line in ended.stdout.splitlines():
        assert len(line) < 60 or line not in ended.stderr, "printed twice"
    return ended.stdout


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    """A dip, a slow furnace and a heater, of a first-order sensor with a lag of 2 s."""
    rng = np.random.default_rng(47)
    time_s = np.arange(1200) * 0.05
    step = np.where(time_s < 10.0, 0.0, 1.0 - np.exp(-np.maximum(time_s - 10.0, 0.0) / 2.0))
    noise = 0.02 * rng.standard_normal((3, len(time_s)))
    dip = pd.DataFrame({"time_s": time_s, "T1": 20.0 + 60.0 * step + noise[0]})
    dip.to_csv(tmp_path / "dip.csv", index=False)
    furnace = pd.DataFrame({"time_s": time_s, "T1": 400.0 + 3.0 * time_s + noise[1]})
    furnace.to_csv(tmp_path / "furnace.csv", index=False)
    power = np.where((time_s // 7) % 2 == 0, 20.0, 60.0)
    reading = np.empty_like(time_s)
    reading[0] = 60.0
    keep = np.exp(-0.05 / 2.0)
    for k in range(1, len(time_s)):
        reading[k] = keep * reading[k - 1] + (1.0 - keep) * (50.0 + 0.5 * power[k - 1])
    heater = pd.DataFrame({"time_s": time_s, "power_percent": power, "T1": reading + noise[2]})
    heater.to_csv(tmp_path / "heater.csv", index=False)
    return tmp_path


@pytest.mark.parametrize("script", [ANY_THERMOCOUPLE, IDENTIFICATION], ids=["any", "identify"])
def test_scripts_for_any_thermocouple_run_to_the_end(script: str, tables: Path) -> None:
    assert run_script(script, tables).endswith("end\n")
    done = pd.read_csv(tables / "done.csv")
    true = 400.0 + 3.0 * done["time_s"]
    middle = done["time_s"].between(20.0, 40.0)
    if script == ANY_THERMOCOUPLE:  # the lag of 2 s is removed
        assert (done["T1"] - true)[middle].mean() == pytest.approx(6.0, abs=0.5)


# The tutorial "From the oven to beta" runs these commands whenever the manual is built.
@pytest.mark.long
def test_script_for_the_rig_runs_to_the_end(campaign: Campaign, tmp_path: Path) -> None:
    for path in campaign.files.rig.parent.glob("*"):
        if path.suffix in (".csv", ".toml"):
            shutil.copy(path, tmp_path)
    assert run_script(RIG, tmp_path).endswith("end\n")
    assert (tmp_path / "results" / "campaign.csv").exists()
