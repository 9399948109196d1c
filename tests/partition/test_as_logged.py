"""A test that was logged without a switch, without speeds, load or ambient, or in other units, still tells beta."""

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
from tcdyn.partition.window import fit_rows, lagged_window
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import read_log
from tcdyn.rig.rigfile import load_rig, parse_rig
from tcdyn.rig.tables import air_name
from tcdyn.simulate.truth import draw_truth
from tcdyn.workflows.beta import prepare_test
from tests.partition import as_logged_study as forms
from tests.partition.study_rigs import StudyRig, study_rig
from tests.partition.test_events import DT, log

SEED = 7000


@pytest.fixture(scope="module")
def made() -> StudyRig:
    return study_rig(SEED)


@pytest.fixture(scope="module")
def whole(made: StudyRig) -> Partition:
    return forms.analysed(made, "full", SEED, sensor_check=False)


@pytest.mark.study
@pytest.mark.parametrize(
    "form", [pytest.param("ambient_channels", marks=pytest.mark.study), "least"]
)
def test_beta_is_within_1_5_u_of_the_full_log_s_and_asks_for_nothing(
    form: str, made: StudyRig, whole: Partition
) -> None:
    found = forms.analysed(made, form, SEED, sensor_check=False)
    beta, full = found.both.estimates["beta"], whole.both.estimates["beta"]
    assert abs(beta.value - full.value) < 1.5 * beta.u
    assert abs(beta.value - made.told["beta"]) < 3 * beta.u
    assert beta.u > 0.98 * full.u  # it knows less
    assert warnings_and_errors(found.findings) == ()
    codes = {f.code for f in found.findings}
    assert all(f.sentence for f in found.findings)
    assert ("ambient.channels" if form == "ambient_channels" else "constant.used") in codes


def prepared(made: StudyRig, form: forms.Form, tmp_path) -> EhlTest:
    frame, tables = form
    rig = parse_rig(tables, "rig.toml")
    frame.to_csv(tmp_path / "log.csv", index=False)
    return prepare_test(read_log(tmp_path / "log.csv", "ehl", rig), rig, made.records)


@pytest.mark.study
def test_torque_and_kelvin_are_the_same_test(made: StudyRig, tmp_path) -> None:
    test = prepared(
        made, forms.torque_and_kelvin(made.log.frame, np.random.default_rng(0)), tmp_path
    )
    plain = prepared(made, forms.full(made.log.frame, np.random.default_rng(0)), tmp_path)
    assert test.power_W == pytest.approx(plain.power_W, abs=1e-6)
    for d in DISKS:
        assert test.disks[d].readings_degC == pytest.approx(plain.disks[d].readings_degC, abs=1e-6)


def test_what_is_stated_widens_what_hangs_on_it(made: StudyRig, tmp_path) -> None:
    u = {"load_N": 100.0, "speed_fast_rpm": 60.0, "speed_slow_rpm": 80.0, "ambient_degC": 3.0}
    test, full = (
        prepared(made, forms.stated(made.log.frame, np.random.default_rng(0), u), tmp_path),
        made.test,
    )
    sliding_rpm = (
        made.log.frame["speed_fast_rpm"].median() - made.log.frame["speed_slow_rpm"].median()
    )
    for d in DISKS:
        own, was = test.disks[d].uncertainty, full.disks[d].uncertainty
        assert own.ambient_K == pytest.approx(np.hypot(was.ambient_K, 3.0))
        assert own.friction_rel == pytest.approx(
            np.hypot(was.friction_rel, 100.0 / sliding_rpm), rel=0.05
        )
        assert own.half_width_rel == pytest.approx(
            np.hypot(was.half_width_rel, 100.0 / test.load_N / 3)
        )
    assert test.exponent_half_range > full.exponent_half_range
    assert np.ptp(test.ambient_degC) == 0
    steady = (test.time_s > test.events.unload_s - 100) & (test.time_s < test.events.unload_s - 1)
    assert test.load_N == pytest.approx(full.load_N, abs=300)
    assert test.power_W[steady].mean() == pytest.approx(full.power_W[steady].mean(), rel=0.1)
    theirs = {
        "half-width": 100.0 / test.load_N / 3,
        "ambient": 3.0,
        "friction": 100.0 / sliding_rpm,
    }
    setup = full.disks["fast"].setup
    for what in (
        *nominal_parameters(setup),
        *parameters_of_test(setup),
    ):  # to a campaign what is stated is the test's own, the rest as much the rig's as ever
        if what.name not in theirs:
            continue
        before, now = (_shared_and_own(what, t) for t in (full, test))
        assert now[0] == pytest.approx(before[0], rel=1e-3)
        assert now[1] == pytest.approx(np.hypot(before[1], theirs.pop(what.name)), rel=0.05)
    assert theirs == {}


def _shared_and_own(what: NuisanceParameter, test: EhlTest) -> tuple[float, float]:
    """Of an unmeasured quantity that both disks have in common, the rig's uncertainty and the test's own, in its unit.

    None of these hangs on a fit, so none is given.
    """
    assert what.shared
    loading = loading_of(what, "", test, None, 300.0) or Loading({what.name: 1.0})  # type: ignore[arg-type]
    size = unit_of(what, DISKS[0], test)
    assert size is not None
    return size * loading.shared[what.name], size * loading.specific


@pytest.mark.study
def test_channels_of_a_disk_s_own_give_its_air_and_its_uncertainty(
    made: StudyRig, tmp_path
) -> None:
    frame = made.log.frame
    rising = frame["ambient_degC"] + 0.01 * frame["time_s"]
    more = {"S1": rising - 6.0, "S2": rising - 4.0, "F1": rising, "stuck": 20.0}
    tables = {"fast": {"ambient": {"surface": ["S1", "S2"], "faces": ["F1", "stuck"]}}}
    test = prepared(made, (frame.assign(**more), tables), tmp_path)
    assert test.air["fast"].surface == pytest.approx(rising.to_numpy() - 5.0, abs=1e-6)
    assert test.ambient_of("fast") == pytest.approx(
        rising.to_numpy(), abs=1e-6
    )  # without the one that stands still
    assert test.ambient_of("slow") == pytest.approx(frame["ambient_degC"].to_numpy(), abs=1e-6)
    assert test.air["fast"].own_u_K == pytest.approx(1.0)  # 2 K apart: 2 / sqrt(2) / sqrt(2)
    told = {
        (f.subject, f.numbers["at"]): f.numbers
        for f in test.findings
        if f.code == "ambient.channels"
    }
    assert told["fast", "surface"]["count"] == 2
    assert told["fast", "surface"]["spread_K"] == pytest.approx(2**0.5)
    assert told["fast", "faces"]["count"] == 1
    assert told["fast", "faces"]["drift_K"] == pytest.approx(
        1.5, abs=0.7
    )  # 0.01 K/s over 150 s, and its own
    known = nuisance_effects(
        test,
        test.disks["fast"],
        lagged_window(test, test.disks["fast"], fit_rows(test, 5.0)),
        0.7,
        500.0,
    )
    assert DISK_AIR in known.parameters


def test_without_a_switch_the_parting_is_found_and_known_less_well() -> None:
    full, bare = find_events(log()), find_events(log().drop(columns="contact"))
    assert abs(bare.unload_s - 80.0073) <= DT
    assert bare.load_on_s == pytest.approx(10.0, abs=2 * DT)
    assert bare.unload_u_s > 2 * full.unload_u_s
    alone = find_events(log().drop(columns=["contact", "load_N"]))
    assert abs(alone.unload_s - 80.0073) <= DT
    assert alone.unload_u_s == pytest.approx(0.05 / 3**0.5, rel=0.02)
    assert alone.findings == ()


@pytest.mark.parametrize("gone", [["contact"], ["contact", "load_N"], ["load_N"]])
def test_a_touch_after_the_parting_is_seen_without_them_too(gone: list[str]) -> None:
    frame = log()
    again = frame["time_s"].between(81.0, 81.2)
    frame.loc[again, "friction_N"] += 20.0
    frame.loc[again, "load_N"] += 1850.0
    frame.loc[again, "contact"] = 1
    found = find_events(frame.drop(columns=gone))
    assert len(found.later_contacts) == 1
    assert found.later_contacts[0] == pytest.approx((81.0, 81.2), abs=0.05)


def test_a_friction_without_a_load_is_no_test() -> None:
    idle = log().assign(
        friction_N=0.3 + 0.1 * np.random.default_rng(0).standard_normal(7500), load_N=0.0
    )
    with pytest.raises(InputError, match="neither load nor friction shows a loaded stretch"):
        find_events(idle.drop(columns="contact"))
    both: pd.DataFrame = log()[lambda f: f["time_s"] < 79.0].drop(columns="contact")
    with pytest.raises(InputError, match="no unloading: the disks still touch at the last row"):
        find_events(both)


@pytest.mark.study
def test_channels_at_the_running_surface_take_out_that_its_air_is_colder() -> None:
    """An air 8 K colder at the running surfaces is read as a higher h by one thermometer in the room."""
    cold = study_rig(SEED + 100, truth=draw_truth(SEED + 100, load_rig()).with_film_air(-8.0))
    room, rng, more = (
        cold.log.frame["ambient_degC"],
        np.random.default_rng(0),
        dict[str, pd.Series](),
    )
    channels = {place: [f"{place} {k}" for k in range(4)] for place in ("surface", "faces")}
    for place, names in channels.items():
        more |= {
            air_name(n): room - 8.0 * (place == "surface") + rng.standard_normal() for n in names
        }
    frame = cold.log.frame.assign(**more).drop(columns="ambient_degC")
    test = prepare_test(
        replace(cold.log, frame=frame), parse_rig({"ambient": channels}, "rig.toml"), cold.records
    )
    found, without = (refine_lags(t)["fast"].estimates["h"] for t in (test, cold.test))
    assert abs(found.value - cold.told["h_fast"]) < 2.5 * found.u
    assert without.value - found.value > 50.0  # W/m2K: 8 K of the 70 K between surface and air
