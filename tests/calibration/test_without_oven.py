"""A disk calibrated without an oven, or with plunges that hold neither switch nor free thermocouple."""

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


@pytest.mark.parametrize("fluid", ["mobil-jet-ii", "water"])
@pytest.mark.parametrize("seed", [21, 22, 23])
def test_the_junctions_own_rise_tells_the_entry_within_its_uncertainty(
    fluid: str, seed: int
) -> None:
    frame, truth = simulate_plunge("slow", seed, fluid, 110.0 if fluid != "water" else 80.0)
    entry = find_entry(frame["time_s"], None, None, frame["fluid_degC"], readings_degC=frame[DISK])
    assert abs(entry.time_s - truth["entry_s"]) < 2 * RISE_DELAY_U_S
    assert entry.u_s == RISE_DELAY_U_S
    assert [f.code for f in entry.findings] == ["entry.by_junctions"]


def test_a_plunge_without_a_switch_is_read_and_one_with_a_switch_of_another_name_is_asked_for(
    tmp_path: Path,
) -> None:
    frame, truth = simulate_plunge("fast", 1)
    log = read_log(write_log(frame.drop(columns="switch"), tmp_path / "a.csv"), "immersion")
    assert [f.subject for f in log.findings if f.code == "column.not_there"] == ["switch"]
    entry = find_entry(log.frame["time_s"], None, log.frame["probe_degC"], log.frame["fluid_degC"])
    assert abs(entry.time_s - truth["entry_s"]) < 3 * entry.u_s
    with pytest.raises(
        InputError, match=r"switch: column is missing; .*did you mean 'Switch \(V\)'"
    ):
        read_log(
            write_log(frame.rename(columns={"switch": "Switch (V)"}), tmp_path / "b.csv"),
            "immersion",
        )


def test_a_stated_line_is_the_reading_itself_as_uncertain_as_stated() -> None:
    line = identity_lines(0.9)["e"]
    assert (line.gain, line.offset) == (1.0, 0.0)
    u = static_u(line, np.linspace(-40, 300, 35))
    assert u.min() == pytest.approx(0.9, rel=0.01)  # nowhere less than stated
    assert static_u(line, np.array([20.0, 150.0])) == pytest.approx(0.9, rel=0.2)


def test_an_oven_log_or_a_stated_line_is_needed_and_not_both(tmp_path: Path) -> None:
    for oven, u in ((None, None), ("oven.csv", 0.9)):
        with pytest.raises(InputError, match="one of them"):
            calibrate_disk(load_rig(), "fast", oven, [tmp_path / "P.csv"], ["water"], line_u_K=u)


@pytest.mark.e2e
def test_without_oven_switch_and_probe_the_lags_hold_the_truth_and_differences_stay_sharp(
    tmp_path: Path,
) -> None:
    paths = []
    lags = {}
    for run in (1, 2):
        frame, truth = simulate_plunge("fast", 5, run=run)
        lags = truth["lag_s"]
        paths.append(
            write_log(frame.drop(columns=["switch", "probe_degC"]), tmp_path / f"P{run}.csv")
        )
    found = calibrate_disk(load_rig(), "fast", None, paths, ["mobil-jet-ii"], line_u_K=0.9)
    chain = found.record.chain
    assert chain is not None
    common = float(np.mean(list(lags.values())))
    assert abs(chain.common_lag_s.value - common) < 2.5 * chain.common_lag_s.u
    for channel, rest in chain.differential_lag_s.items():
        assert abs(rest.value - (lags[channel] - common)) < 4 * rest.u
        assert rest.u < 0.5 * chain.common_lag_s.u
    codes = {f.code for f in found.findings}
    assert not codes & {"calibrate.other_disk", "plunge.pull"}  # wire may be off by a slope as well
    assert {"static.stated", "entry.by_junctions"} <= codes
    assert found.oven is None
