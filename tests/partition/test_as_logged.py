"""Logs without a switch, speeds, load or ambient, or in other units, still give beta."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign.compress import loading_of, unit_of
from tcdyn.campaign.sufficient_statistics import Loading
from tcdyn.core.errors import InputError
from tcdyn.core.findings import warnings_and_errors
from tcdyn.partition.analyse import Partition, refine_lags
from tcdyn.partition.events import EhlTest, find_events
from tcdyn.partition.nuisance import (
    DISK_AIR,
    nominal_parameters,
    nuisance_effects,
    parameters_of_test,
)
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.window import fit_rows, lagged_window
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import load_rig, parse_rig
from tcdyn.rig.tables import air_name
from tcdyn.simulate.truth import draw_truth
from tests.partition import as_logged_study as forms
from tests.partition.study_rigs import StudyRig, study_rig
from tests.partition.test_events import DT, simulated_log

SEED = 7000


@pytest.fixture(scope="module")
def study() -> StudyRig:
    return study_rig(SEED)


@pytest.fixture(scope="module")
def full_analysis(study: StudyRig) -> Partition:
    return forms.analyse_form(study, "full", SEED, sensor_check=False)


@pytest.mark.study
@pytest.mark.parametrize(
    "form", [pytest.param("ambient_channels", marks=pytest.mark.long), "minimal"]
)
def test_beta_is_within_1_5_u_of_the_full_log_without_warnings(
    form: str, study: StudyRig, full_analysis: Partition
) -> None:
    result = forms.analyse_form(study, form, SEED, sensor_check=False)
    beta = result.combined.estimates["beta"]
    full = full_analysis.combined.estimates["beta"]
    assert abs(beta.value - full.value) < 1.5 * beta.u
    assert abs(beta.value - study.true_values["beta"]) < 3 * beta.u
    assert beta.u > 0.98 * full.u  # the log has less information
    assert warnings_and_errors(result.findings) == ()
    codes = {f.code for f in result.findings}
    assert all(f.sentence for f in result.findings)
    assert ("ambient.channels" if form == "ambient_channels" else "constant.used") in codes


def prepared(study: StudyRig, form: forms.Form, tmp_path) -> EhlTest:
    frame, tables = form
    rig = parse_rig(tables, "rig.toml")
    frame.to_csv(tmp_path / "log.csv", index=False)
    return prepare_test(read_log(tmp_path / "log.csv", "ehl", rig), rig, study.records)


@pytest.mark.study
def test_torque_and_kelvin_give_the_same_test(study: StudyRig, tmp_path) -> None:
    test = prepared(
        study, forms.torque_and_kelvin(study.log.frame, np.random.default_rng(0)), tmp_path
    )
    reference = prepared(study, forms.full(study.log.frame, np.random.default_rng(0)), tmp_path)
    assert test.power_W == pytest.approx(reference.power_W, abs=1e-6)
    for d in DISKS:
        assert test.disks[d].readings_degC == pytest.approx(
            reference.disks[d].readings_degC, abs=1e-6
        )


@pytest.mark.e2e
def test_constants_widen_the_dependent_uncertainties(study: StudyRig, tmp_path) -> None:
    u = {"load_N": 100.0, "speed_fast_rpm": 60.0, "speed_slow_rpm": 80.0, "ambient_degC": 3.0}
    test = prepared(
        study, forms.with_constants(study.log.frame, np.random.default_rng(0), u), tmp_path
    )
    full = study.test
    sliding_rpm = (
        study.log.frame["speed_fast_rpm"].median() - study.log.frame["speed_slow_rpm"].median()
    )
    for d in DISKS:
        uncertainty = test.disks[d].uncertainty
        full_uncertainty = full.disks[d].uncertainty
        assert uncertainty.ambient_K == pytest.approx(np.hypot(full_uncertainty.ambient_K, 3.0))
        assert uncertainty.friction_rel == pytest.approx(
            np.hypot(full_uncertainty.friction_rel, 100.0 / sliding_rpm), rel=0.05
        )
        assert uncertainty.half_width_rel == pytest.approx(
            np.hypot(full_uncertainty.half_width_rel, 100.0 / test.load_N / 3)
        )
    assert test.exponent_half_range > full.exponent_half_range
    assert np.ptp(test.ambient_degC) == 0
    steady = (test.time_s > test.events.unload_s - 100) & (test.time_s < test.events.unload_s - 1)
    assert test.load_N == pytest.approx(full.load_N, abs=300)
    assert test.power_W[steady].mean() == pytest.approx(full.power_W[steady].mean(), rel=0.1)
    expected_u = {
        "half-width": 100.0 / test.load_N / 3,
        "ambient": 3.0,
        "friction": 100.0 / sliding_rpm,
    }
    setup = full.disks["fast"].setup
    for parameter in (
        *nominal_parameters(setup),
        *parameters_of_test(setup),
    ):
        # in a campaign, a constant is specific to the test; the shared part of the rig is unchanged
        if parameter.name not in expected_u:
            continue
        with_columns, with_constants = (rig_and_test_u(parameter, t) for t in (full, test))
        assert with_constants[0] == pytest.approx(with_columns[0], rel=1e-3)
        assert with_constants[1] == pytest.approx(
            np.hypot(with_columns[1], expected_u.pop(parameter.name)), rel=0.05
        )
    assert expected_u == {}


def rig_and_test_u(parameter: NuisanceParameter, test: EhlTest) -> tuple[float, float]:
    """Shared uncertainty of the rig and specific uncertainty of the test, of a nuisance parameter
    of both disks.

    In the unit of the parameter. None of these parameters depends on a fit, so no fit is given.
    """
    assert parameter.shared
    loading = loading_of(parameter, "", test, None, 300.0) or Loading({parameter.name: 1.0})  # type: ignore[arg-type]
    size = unit_of(parameter, DISKS[0], test)
    assert size is not None
    return size * loading.shared[parameter.name], size * loading.specific


@pytest.mark.study
def test_ambient_channels_of_a_disk_give_its_air_and_uncertainty(study: StudyRig, tmp_path) -> None:
    frame = study.log.frame
    rising = frame["ambient_degC"] + 0.01 * frame["time_s"]
    channels = {"S1": rising - 6.0, "S2": rising - 4.0, "F1": rising, "stuck": 20.0}
    tables = {"fast": {"ambient": {"surface": ["S1", "S2"], "faces": ["F1", "stuck"]}}}
    test = prepared(study, (frame.assign(**channels), tables), tmp_path)
    assert test.air["fast"].surface == pytest.approx(rising.to_numpy() - 5.0, abs=1e-6)
    # without the constant channel
    assert test.ambient_of("fast") == pytest.approx(rising.to_numpy(), abs=1e-6)
    assert test.ambient_of("slow") == pytest.approx(frame["ambient_degC"].to_numpy(), abs=1e-6)
    # they differ by 2 K: 2 / sqrt(2) / sqrt(2)
    assert test.air["fast"].own_u_K == pytest.approx(1.0)
    channel_findings = {
        (f.subject, f.numbers["at"]): f.numbers
        for f in test.findings
        if f.code == "ambient.channels"
    }
    assert channel_findings["fast", "surface"]["count"] == 2
    assert channel_findings["fast", "surface"]["spread_K"] == pytest.approx(2**0.5)
    assert channel_findings["fast", "faces"]["count"] == 1
    # 0.01 K/s over 150 s, and the drift of the ambient
    assert channel_findings["fast", "faces"]["drift_K"] == pytest.approx(1.5, abs=0.7)
    effects = nuisance_effects(
        test,
        test.disks["fast"],
        lagged_window(test, test.disks["fast"], fit_rows(test, 5.0)),
        0.7,
        500.0,
    )
    assert DISK_AIR in effects.parameters


def test_unloading_without_a_switch_is_located_with_a_larger_uncertainty() -> None:
    full = find_events(simulated_log())
    no_switch = find_events(simulated_log().drop(columns="contact"))
    assert abs(no_switch.unload_s - 80.0073) <= DT
    assert no_switch.load_on_s == pytest.approx(10.0, abs=2 * DT)
    assert no_switch.unload_u_s > 2 * full.unload_u_s
    friction_only = find_events(simulated_log().drop(columns=["contact", "load_N"]))
    assert abs(friction_only.unload_s - 80.0073) <= DT
    assert friction_only.unload_u_s == pytest.approx(0.05 / 3**0.5, rel=0.02)
    assert friction_only.findings == ()


@pytest.mark.parametrize("missing", [["contact"], ["contact", "load_N"], ["load_N"]])
def test_second_contact_is_detected_with_missing_columns(missing: list[str]) -> None:
    frame = simulated_log()
    second_contact = frame["time_s"].between(81.0, 81.2)
    frame.loc[second_contact, "friction_N"] += 20.0
    frame.loc[second_contact, "load_N"] += 1850.0
    frame.loc[second_contact, "contact"] = 1
    events = find_events(frame.drop(columns=missing))
    assert len(events.later_contacts) == 1
    assert events.later_contacts[0] == pytest.approx((81.0, 81.2), abs=0.05)


def test_friction_without_load_or_unloading_raises() -> None:
    idle = simulated_log().assign(
        friction_N=0.3 + 0.1 * np.random.default_rng(0).standard_normal(7500), load_N=0.0
    )
    with pytest.raises(InputError, match="neither load nor friction shows a loaded stretch"):
        find_events(idle.drop(columns="contact"))
    never_unloaded: pd.DataFrame = simulated_log()[lambda f: f["time_s"] < 79.0].drop(
        columns="contact"
    )
    with pytest.raises(InputError, match="no unloading: the disks still touch at the last row"):
        find_events(never_unloaded)


@pytest.mark.study
def test_surface_air_channels_remove_the_bias_of_colder_surface_air() -> None:
    """With one thermometer in the room, air 8 K colder at the running surfaces appears as a higher
    h."""
    study = study_rig(SEED + 100, truth=draw_truth(SEED + 100, load_rig()).with_film_air(-8.0))
    room = study.log.frame["ambient_degC"]
    rng = np.random.default_rng(0)
    air_columns = dict[str, pd.Series]()
    channels = {
        location: [f"{location} {k}" for k in range(4)] for location in ("surface", "faces")
    }
    for location, names in channels.items():
        air_columns |= {
            air_name(n): room - 8.0 * (location == "surface") + rng.standard_normal() for n in names
        }
    frame = study.log.frame.assign(**air_columns).drop(columns="ambient_degC")
    test = prepare_test(
        replace(study.log, frame=frame), parse_rig({"ambient": channels}, "rig.toml"), study.records
    )
    with_channels = refine_lags(test)["fast"].estimates["h"]
    without = refine_lags(study.test)["fast"].estimates["h"]
    assert abs(with_channels.value - study.true_values["h_fast"]) < 2.5 * with_channels.u
    # W/m2K: 8 K of the 70 K between surface and air
    assert without.value - with_channels.value > 50.0
