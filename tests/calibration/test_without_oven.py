"""Calibration of a disk without an oven, or with plunges that have neither switch nor free
thermocouple."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from immersion.entry import RISE_DELAY_U_S, find_entry
from tcdyn.core.errors import InputError
from tcdyn.io.write import write_log
from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import load_rig
from tcdyn.rig.static_line import identity_lines, static_u
from tcdyn.simulate.plunge import simulate_plunge
from tcdyn.workflows import calibrate_disk

DISK = [f"{c}_degC" for c in "abcdef"]


@pytest.mark.e2e
@pytest.mark.parametrize("fluid", ["mobil-jet-ii", "water"])
@pytest.mark.parametrize("seed", [21, 22, 23])
def test_rise_of_the_junctions_gives_the_entry_within_its_uncertainty(
    fluid: str, seed: int
) -> None:
    frame, true_values = simulate_plunge("slow", seed, fluid, 110.0 if fluid != "water" else 80.0)
    entry = find_entry(frame["time_s"], None, None, frame["fluid_degC"], readings_degC=frame[DISK])
    assert abs(entry.time_s - true_values["entry_s"]) < 2 * RISE_DELAY_U_S
    assert entry.u_s == RISE_DELAY_U_S
    assert [f.code for f in entry.findings] == ["entry.by_junctions"]


def test_plunge_without_switch_is_read_and_a_misspelled_switch_raises(
    tmp_path: Path,
) -> None:
    frame, true_values = simulate_plunge("fast", 1)
    log = read_log(write_log(frame.drop(columns="switch"), tmp_path / "a.csv"), "immersion")
    assert [f.subject for f in log.findings if f.code == "column.not_there"] == ["switch"]
    entry = find_entry(log.frame["time_s"], None, log.frame["probe_degC"], log.frame["fluid_degC"])
    assert abs(entry.time_s - true_values["entry_s"]) < 3 * entry.u_s
    with pytest.raises(
        InputError, match=r"switch: column is missing; .*did you mean 'Switch \(V\)'"
    ):
        read_log(
            write_log(frame.rename(columns={"switch": "Switch (V)"}), tmp_path / "b.csv"),
            "immersion",
        )


def test_identity_line_has_the_specified_uncertainty() -> None:
    line = identity_lines(0.9)["e"]
    assert (line.gain, line.offset) == (1.0, 0.0)
    u = static_u(line, np.linspace(-40, 300, 35))
    assert u.min() == pytest.approx(0.9, rel=0.01)  # never less than specified
    assert static_u(line, np.array([20.0, 150.0])) == pytest.approx(0.9, rel=0.2)


def test_either_an_oven_log_or_a_specified_uncertainty_is_required(tmp_path: Path) -> None:
    for oven, u in ((None, None), ("oven.csv", 0.9)):
        with pytest.raises(InputError, match="one of them"):
            calibrate_disk(load_rig(), "fast", oven, [tmp_path / "P.csv"], ["water"], reading_u_K=u)


@pytest.mark.e2e
def test_lags_cover_and_differences_stay_accurate_without_oven_switch_and_probe(
    tmp_path: Path,
) -> None:
    paths = []
    lags = {}
    for run in (1, 2):
        frame, true_values = simulate_plunge("fast", 5, run=run)
        lags = true_values["lag_s"]
        paths.append(
            write_log(frame.drop(columns=["switch", "probe_degC"]), tmp_path / f"P{run}.csv")
        )
    calibration = calibrate_disk(load_rig(), "fast", None, paths, ["mobil-jet-ii"], reading_u_K=0.9)
    chain = calibration.record.chain
    assert chain is not None
    common = float(np.mean(list(lags.values())))
    assert abs(chain.common_lag_s.value - common) < 2.5 * chain.common_lag_s.u
    for channel, differential in chain.differential_lag_s.items():
        assert abs(differential.value - (lags[channel] - common)) < 4 * differential.u
        assert differential.u < 0.5 * chain.common_lag_s.u
    codes = {f.code for f in calibration.findings}
    # the thermocouple wire may have a slope error as well
    assert not codes & {
        "calibrate.other_disk",
        "plunge.pull",
    }
    assert {"static.stated", "entry.by_junctions"} <= codes
    assert calibration.oven is None
