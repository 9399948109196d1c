"""From files to a certificate as a new user does it, and damaged files through the real
commands."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from calibration.transducers import fit_transducer
from tcdyn.cli.app import app, run
from tcdyn.report.certificate import plunge_sections
from tcdyn.rig.log import write_log
from tcdyn.rig.record import read_record, write_record
from tests.calibration.test_transducers import sessions
from tests.io.damaged_corpus import CORPUS, REFUSED
from tests.rig.log_cases import immersion_frame, oven_frame
from tests.rig.test_record import RECORD


def tcdyn(*arguments) -> int:
    """The exit code of ``tcdyn ARGUMENTS``."""
    return run(lambda: app([str(a) for a in arguments]))


@pytest.mark.e2e
def test_simulated_oven_and_plunges_give_a_certificate_in_two_commands(tmp_path):
    campaign = tmp_path / "rig"
    assert tcdyn("simulate", "campaign", "--out", campaign, "--test", "B3", "--seed", 4) == 0
    plunges = [w for k in (1, 2) for w in ("--immersion", campaign / f"plunge_fast_{k}.csv")]
    record = tmp_path / "fast.disk.json"
    page = tmp_path / "fast.html"
    oven = campaign / "oven_fast.csv"
    code = tcdyn(
        "rig",
        "calibrate",
        "--rig",
        campaign / "rig.toml",
        "--disk",
        "fast",
        "--oven",
        oven,
        *plunges,
        "--fluid",
        "mobil-jet-ii",
        "--out",
        record,
        "--report",
        page,
        "--quiet",
    )
    assert code == 0
    stored_record = read_record(record)
    true_values = json.loads((campaign / "truth" / "truth.json").read_text())
    assert {i.file for i in stored_record.inputs} == {
        "oven_fast.csv",
        "plunge_fast_1.csv",
        "plunge_fast_2.csv",
    }
    assert "thermocouples fit to use" in page.read_text()
    assert true_values
    assert tcdyn("rig", "record", "show", record) == 0


@pytest.mark.long
@pytest.mark.e2e
def test_damaged_files_end_every_command_with_exit_code_2_and_no_output(tmp_path, capsys):
    record = write_record(RECORD, tmp_path / "fast.disk.json")
    oven = write_log(oven_frame(), tmp_path / "oven.csv")
    plunge = write_log(immersion_frame(), tmp_path / "plunge.csv")
    before = set(tmp_path.iterdir())
    for damage in (
        d for d in CORPUS if d.fate == REFUSED and "zero byte in the path" not in d.name
    ):
        folder = tmp_path / "damaged"
        folder.mkdir()
        path = damage.build(folder)
        out = tmp_path / "out.json"
        arguments = {
            "oven": (
                "rig",
                "calibrate",
                "--disk",
                "fast",
                "--oven",
                path,
                "--immersion",
                plunge,
                "--out",
                out,
            ),
            "immersion": (
                "rig",
                "calibrate",
                "--disk",
                "fast",
                "--oven",
                oven,
                "--immersion",
                path,
                "--out",
                out,
            ),
            "ehl": ("compensate", path, "--record", record, "--out", tmp_path / "out.csv"),
        }[damage.kind]
        # `compensate` accepts plunges, logs without unloading and logs without friction; `beta`
        # does not
        if damage.name == "a plunge as an EHL log" or damage.words in (
            "no unloading",
            "friction_N: column is missing",
        ):
            arguments = ("rig", "beta", path, "--record", record, "--out", tmp_path / "out.json")
        assert tcdyn(*arguments) == 2, damage.name
        messages = capsys.readouterr().err
        assert "Traceback" not in messages, damage.name
        shutil.rmtree(folder)
        assert set(tmp_path.iterdir()) == before, damage.name


@pytest.mark.e2e
@pytest.mark.parametrize("cause", ["not at one temperature", "warms unevenly"])
def test_plunge_of_an_uneven_disk_is_refused_with_its_cause(tmp_path, cause):
    """The surface starts 6 K warmer than 3 mm below, and becomes even in 8 s; or one side warms by
    a tenth more."""
    from tcdyn.core.errors import InputError
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.simulate.campaign import write_log as write_rig_log
    from tcdyn.simulate.measure import simulate_oven
    from tcdyn.simulate.plunge import simulate_plunge
    from tcdyn.workflows import calibrate_disk

    rig = load_rig()
    plunge, true = simulate_plunge("fast", seed=6)
    # the junctions respond to the entry one lag later
    since_s = np.clip(plunge["time_s"].to_numpy() - true["entry_s"] - true["common_lag_s"], 0, None)
    for channel, junction in rig.tables("fast").thermocouples.items():
        y = plunge[f"{channel}_degC"]
        if cause == "warms unevenly":
            side = 0.1 * np.cos(np.deg2rad(junction.angle_deg)) * np.exp(-since_s / 36.0)
            change = side * (y - y.iloc[:300].mean())
        else:
            change = -2.0 * (junction.depth_mm - 3.0) * np.exp(-since_s / 8.0)
        plunge[f"{channel}_degC"] = y + change
    write_rig_log(simulate_oven("fast", seed=6)[0], tmp_path / "oven.csv")
    write_rig_log(plunge, tmp_path / "p.csv")
    with pytest.raises(InputError, match=cause):
        calibrate_disk(rig, "fast", tmp_path / "oven.csv", [tmp_path / "p.csv"], ["mobil-jet-ii"])


@pytest.mark.e2e
def test_certificate_shows_the_plunges(tmp_path):
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.simulate.campaign import write_log as write_rig_log
    from tcdyn.simulate.measure import simulate_oven
    from tcdyn.simulate.plunge import simulate_plunge
    from tcdyn.workflows import calibrate_disk

    write_rig_log(simulate_oven("fast", seed=3)[0], tmp_path / "oven.csv")
    write_rig_log(simulate_plunge("fast", seed=3, bath_degC=95.0)[0], tmp_path / "p.csv")
    calibration = calibrate_disk(
        load_rig(), "fast", tmp_path / "oven.csv", [tmp_path / "p.csv"], ["mobil-jet-ii"]
    )
    traces, residuals = plunge_sections(calibration.fit)
    assert traces.render().image.startswith("data:image/png")
    assert residuals.render().image.startswith("data:image/png")
    # the remaining noise of a single sample is the simulated 0.1 to 0.15 degC
    assert all(float(residuals.table[f"{c} [K]"].iloc[0]) < 0.2 for c in "abcdef")


def test_gain_and_zero_of_a_transducer_are_printed_and_written(tmp_path, capsys):
    volts, force, session = sessions(0)
    path = tmp_path / "weights.csv"
    out = tmp_path / "cell.json"
    pd.DataFrame({"volts": volts, "force_N": force, "session": session}).to_csv(path, index=False)
    assert tcdyn("rig", "transducer", path, "--out", out) == 0
    printed = capsys.readouterr().out
    stored = json.loads(out.read_text())
    line = fit_transducer(volts, force, session)
    assert stored["slope_N_V"]["value"] == pytest.approx(line.slope_N_V.value, rel=1e-12)
    assert stored["intercept_N"]["2"]["u"] == pytest.approx(line.intercept_N["2"].u, rel=1e-12)
    assert line.slope_N_V.text("N/V") in printed
    assert f"{line.slope_N_V.low95:.6g} to {line.slope_N_V.high95:.6g}" in printed
    path.write_text("volts,force_N\n0.1,0\n0.2,\n0.3,200\n")
    assert tcdyn("rig", "transducer", path) == 2
    assert "column force_N, row 3: no number" in capsys.readouterr().err


def test_gain_of_a_friction_transducer_gives_the_uncertainty_of_the_rig_file(tmp_path, capsys):
    from tcdyn.rig.rigfile import load_rig, rig_toml

    volts, force, session = sessions(0)
    path = tmp_path / "torque.csv"
    rig = tmp_path / "rig.toml"
    pd.DataFrame({"volts": volts, "force_N": force, "session": session}).to_csv(path, index=False)
    assert (
        tcdyn("rig", "transducer", path, "--quantity", "friction", "--weight-u-rel", "0.002") == 0
    )
    printed = capsys.readouterr().out
    assert "under [uncertainty]" in printed
    rig_text = rig_toml(load_rig())
    uncertainty_line = printed.splitlines()[-1]
    assert rig_text.count("\nfriction_rel = ") == 1
    rig.write_text(
        "\n".join(
            uncertainty_line if line.startswith("friction_rel = ") else line
            for line in rig_text.splitlines()
        )
    )
    line = fit_transducer(volts, force, session)
    expected = np.hypot(line.slope_N_V.u / line.slope_N_V.value, 0.002)
    assert load_rig(rig).disk_setup("fast") == load_rig().disk_setup("fast")
    # printed with three digits
    assert load_rig(rig).common.uncertainty.friction_rel == pytest.approx(expected, rel=5e-3)
    assert tcdyn("rig", "transducer", path, "--quantity", "load") == 0
    printed = capsys.readouterr().out
    assert "half_width_rel" in printed
    # only comments: nothing of it changes a rig file
    assert all(printed_line.startswith("# ") for printed_line in printed.splitlines())
    assert (
        tcdyn("rig", "transducer", path, "--quantity", "load", "--weight-u-rel", "0.002", "--json")
        == 0
    )
    assert json.loads(capsys.readouterr().out) == {
        "half_width_rel_by_load": pytest.approx(expected / 3)
    }
    assert tcdyn("rig", "transducer", path, "--quantity", "speed") == 2
    assert "load or friction" in capsys.readouterr().err


def test_sessions_with_different_gains_end_with_a_warning(tmp_path, capsys):
    volts, force, session = sessions(0, twist=0.01)
    path = tmp_path / "weights.csv"
    pd.DataFrame({"volts": volts, "force_N": force, "session": session}).to_csv(path, index=False)
    assert tcdyn("rig", "transducer", path, "-q") == 0
    assert capsys.readouterr().err.startswith("warning: weights.csv: ")
    assert tcdyn("rig", "transducer", path, "-q", "--strict") == 1


def test_channels_that_deviate_before_a_plunge_are_named_only_for_a_disk_at_rest():
    from immersion.entry import EntryEvent
    from immersion.fluids import fluid
    from immersion.plunge_checks import deviating_at_rest
    from immersion.plunge_data import PlungeRun
    from tcdyn.rig.static_line import StaticLine

    t = np.arange(0.0, 12.0, 1 / 75)
    rng = np.random.default_rng(0)
    line = StaticLine(
        gain=1.0, offset=0.0, covariance=((1e-8, 0.0), (0.0, 0.03**2)), range_degC=(20.0, 160.0)
    )

    def deviating_channels(offset_K, slope_K_s=0.0):
        shape = np.where(t < 10, 25 + slope_K_s * t, 90.0)[:, None] + np.array(
            [0, 0, offset_K, 0, -offset_K, 0]
        )
        readings = shape + 0.1 * rng.standard_normal(shape.shape)
        entry = EntryEvent(10.0, 0.01, 10.0, 10.0, "both")
        channels = tuple("abcdef")
        bath = np.full(len(t), 110.0)
        return deviating_at_rest(
            PlungeRun(
                t,
                readings,
                channels,
                fluid("water"),
                bath,
                entry,
                lines=dict.fromkeys(channels, line),
            )
        )

    assert deviating_channels(0.0) == set()
    # twice the uncertainty of the lines (0.03 K) and of a disk at rest (0.07 K)
    assert deviating_channels(0.15) == set()
    assert deviating_channels(0.4) == {"c", "e"}
    assert deviating_channels(0.4, slope_K_s=-0.1) == set()
