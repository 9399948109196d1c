"""Sensor check: swapped, dead, misplaced and offset channels are identified; intact rigs are not
(section 6.4)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.findings import warnings_and_errors
from tcdyn.partition import analyse
from tcdyn.partition.angular_harmonic import harmonic_at_junctions
from tcdyn.partition.at_rest import cables_exchanged, disks_differ, faults_at_rest
from tcdyn.partition.events import EhlTest
from tcdyn.partition.model_forms import POWER_SCALE_TOLERANCE
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.sensor_check import SensorCheck, angle_groups, check_sensors, hotter_junction
from tcdyn.partition.sensor_window import AFTER_LOADING_S, AFTER_UNLOADING_S, sensor_window
from tcdyn.partition.steady import with_inner_row_at_one_radius
from tcdyn.partition.window import Perturbation, fit_rows, lagged_window
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import read_log
from tcdyn.rig.record import read_record, write_record
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import draw_truth
from tcdyn.smoothing.traces import DiskTraces
from tests.conftest import Campaign
from tests.partition.fault_study import CASES
from tests.partition.study_rigs import study_rig
from tests.partition.world_study import world_rig


@pytest.fixture(scope="module")
def b3(campaign: Campaign) -> EhlTest:
    return prepare_test(
        read_log(campaign.files.ehl["B3"], "ehl", campaign.rig), campaign.rig, campaign.records
    )


@pytest.fixture(scope="module")
def intact_check(b3: EhlTest) -> SensorCheck:
    return check_sensors(b3)


def with_disk(test: EhlTest, disk: DiskTraces) -> EhlTest:
    return replace(test, disks={**test.disks, disk.name: disk})


def with_readings(test: EhlTest, name: str, change: dict[str, np.ndarray]) -> EhlTest:
    y = test.disks[name].readings_degC.copy()
    for channel, values in change.items():
        y[:, CHANNELS.index(channel)] = values
    return with_disk(test, replace(test.disks[name], readings_degC=y))


def column(test: EhlTest, name: str, channel: str) -> np.ndarray:
    return test.disks[name].readings_degC[:, CHANNELS.index(channel)]


def with_specified_depth(test: EhlTest, name: str, channel: str, deeper_m: float) -> EhlTest:
    """Return the test whose junction lies ``deeper_m`` deeper than the rig file says."""
    setup = test.disks[name].setup
    junction = setup.junctions[channel]
    junctions = {**setup.junctions, channel: replace(junction, depth_m=junction.depth_m - deeper_m)}
    return with_disk(test, replace(test.disks[name], setup=replace(setup, junctions=junctions)))


@pytest.mark.study
def test_intact_rig_has_no_findings_and_no_illogical_pairs(intact_check: SensorCheck) -> None:
    assert intact_check.sound
    assert {f.code for disk_findings in intact_check.findings.values() for f in disk_findings} == {
        "sensors.sound"
    }
    assert "illogical" not in set(intact_check.table["steady"]) | set(
        intact_check.table["unloading"]
    )
    assert intact_check.bulk_degC["fast"] > intact_check.bulk_degC["slow"]  # figure 6.17


def checked_powers(
    test: EhlTest, monkeypatch: pytest.MonkeyPatch, sound_above: float
) -> tuple[list[float], bool]:
    """Largest powers that ``check_sensors_or_power`` checks [W], and whether its result is sound.

    The check of the channels is replaced by one of the power: sound below ``sound_above``.
    """
    powers_W: list[float] = []

    def check(checked: EhlTest) -> SimpleNamespace:
        powers_W.append(float(checked.power_W.max()))
        return SimpleNamespace(sound=powers_W[-1] > sound_above)

    monkeypatch.setattr(analyse, "check_sensors", check)
    return powers_W, analyse.check_sensors_or_power(test).sound


@pytest.mark.e2e
def test_power_in_a_wrong_unit_is_scaled_before_channels_are_suspected(
    b3: EhlTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter is about a force in pounds. The tolerance is ``POWER_SCALE_TOLERANCE``: the
    disks' shares may differ by that much from a sum of one."""
    power_W = float(b3.power_W.max())
    in_wrong_unit = replace(b3, power_W=0.25 * b3.power_W)
    powers_W, sound = checked_powers(in_wrong_unit, monkeypatch, 0.5 * power_W)
    assert powers_W == pytest.approx([0.25 * power_W, power_W], rel=POWER_SCALE_TOLERANCE)
    assert sound
    # the scaled power does not explain the suspects: the first check stands
    powers_W, sound = checked_powers(in_wrong_unit, monkeypatch, np.inf)
    assert len(powers_W) == 2
    assert not sound


def test_sensor_check_is_not_repeated_where_the_power_is_right_or_its_scale_unknown(
    b3: EhlTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(checked_powers(b3, monkeypatch, np.inf)[0]) == 1
    in_wrong_unit = replace(b3, power_W=0.25 * b3.power_W)
    one_disk = replace(in_wrong_unit, disks={"fast": b3.disks["fast"]})
    assert len(checked_powers(one_disk, monkeypatch, np.inf)[0]) == 1

    def stop(*args: object) -> None:
        raise InputError("the log ends too early")

    monkeypatch.setattr(analyse, "steady_lines", stop)
    assert len(checked_powers(in_wrong_unit, monkeypatch, np.inf)[0]) == 1


def test_response_is_larger_nearer_the_running_surface(b3: EhlTest) -> None:
    for disk in b3.disks.values():
        f = sensor_window(b3, disk)
        levels = f.by_channel(f.levels)
        fall = -levels[f.event == "unloading"][1]
        rise = levels[f.event == "loading"][0]
        for change in (fall, rise):
            a, b, c, _, e, _ = change
            assert e > a > c > b


def test_one_kelvin_on_all_thermocouples_equals_one_kelvin_less_ambient(b3: EhlTest) -> None:
    """The conduction model depends on temperature differences only, so both agree to rounding for a
    steady rim."""
    for disk in b3.disks.values():
        table = sensor_window(b3, disk).effects(0.6, 700.0)
        steady_outer_row = table.change[:, :3]  # a, c, e
        effects = dict(zip(table.names, steady_outer_row))
        all_six = np.sum([effects[f"static {c}"] for c in CHANNELS], axis=0)
        np.testing.assert_allclose(all_six, effects["ambient"], atol=1e-9)
        np.testing.assert_allclose(effects["static a"][:2], [1.0, 0.0], atol=1e-12)
        # the depth of e changes no other junction
        assert (effects["depth e"] * [0, 0, 1] == effects["depth e"]).all()
        assert effects["depth e"][2] < 0  # deeper is colder


def test_outer_row_is_predicted_as_in_the_joint_fit(b3: EhlTest) -> None:
    """Other blocks, a longer filter bank and the whole record do not change the prediction after
    unloading."""
    disk = b3.disks["slow"]
    blocks = sensor_window(b3, disk).blocks
    joint = lagged_window(b3, disk, fit_rows(b3, 8.0))
    times_s = b3.events.unload_s + np.array([0.5, 1.0, 2.0, 4.0, 7.0])
    predicted = []
    for window in (blocks, joint):
        boundary, power = window.rim.response(500.0)
        outer_row = (boundary + 0.4 * power)[:, :3].T
        predicted.append([np.interp(times_s, window.block_time_s, y) for y in outer_row])
    # half the noise of a block of 0.1 s; the prediction falls by 20 K
    np.testing.assert_allclose(*predicted, atol=0.02)


def test_effects_match_finite_differences_of_the_response(b3: EhlTest) -> None:
    """Flux position and heat share are compared with central differences of the response.

    A late channel reads less in proportion to the rate of change of its temperature.
    """
    disk = b3.disks["fast"]
    shift_u = disk.uncertainty.model_copy(update={"flux_shift_mm": 0.3})
    f = sensor_window(b3, replace(disk, uncertainty=shift_u))
    unloading = f.event == "unloading"
    loading = f.event == "loading"
    assert f.after_s[unloading] == pytest.approx(np.mean(AFTER_UNLOADING_S, axis=1))
    assert f.after_s[loading] == pytest.approx(np.mean(AFTER_LOADING_S, axis=1))

    def predicted(share: float, shift_m: float = 0.0) -> np.ndarray:
        boundary, power = f.rim.response(700.0, Perturbation(shift_m=shift_m))
        return np.asarray(boundary + share * power)

    table = f.effects(0.6, 700.0)
    effects = dict(zip(table.names, table.change))
    assert effects["share"] == pytest.approx((predicted(0.7) - predicted(0.5))[f.observed] / 0.2)
    flux_shift_effect = (predicted(0.6, 5e-5) - predicted(0.6, -5e-5))[f.observed] * 3e-4 / 1e-4
    assert effects["flux shift"] == pytest.approx(
        flux_shift_effect, abs=1e-2 * np.abs(flux_shift_effect).max()
    )
    lag_effect = np.zeros(f.observed.shape)
    lag_effect[f.observed] = effects["common lag"]
    power = 0.6 * f.rim.response(700.0)[1][:, :3]  # outer row
    first, second, third, _ = np.flatnonzero(unloading)
    rate = (power[third] - power[first]) / (f.after_s[third] - f.after_s[first])
    # the windows are one second apart: a finite difference of the rate
    assert lag_effect[second, :3] == pytest.approx(-rate, rel=0.5)
    lag_effect[f.observed] -= effects["loading"]
    assert not lag_effect[loading].any()
    assert np.abs(lag_effect[unloading, :3]).min() > 0


@pytest.mark.study
@pytest.mark.parametrize(
    ("disk", "pair"),
    [
        ("fast", "cd"),
        ("slow", "be"),
        *(
            pytest.param(*case, marks=[pytest.mark.study, pytest.mark.long])
            for case in (
                ("fast", "ae"),
                ("fast", "ab"),
                ("fast", "be"),
                ("slow", "ae"),
                ("slow", "cd"),
                ("slow", "ab"),
            )
        ),
    ],
)
def test_two_swapped_channels_are_identified(b3: EhlTest, disk: str, pair: str) -> None:
    first, second = pair
    swapped = with_readings(
        b3, disk, {first: column(b3, disk, second), second: column(b3, disk, first)}
    )
    (suspect,) = check_sensors(swapped).suspects
    assert (suspect.disk, suspect.kind, set(suspect.channels)) == (disk, "swapped", {first, second})
    assert f"{disk}_{first}_degC" in suspect.columns


@pytest.mark.study
@pytest.mark.parametrize("channel", CHANNELS)
def test_constant_channel_is_reported_as_dead(b3: EhlTest, channel: str) -> None:
    rng = np.random.default_rng(1)
    flat = 61.0 + 0.13 * rng.standard_normal(len(b3.time_s))
    (suspect,) = check_sensors(with_readings(b3, "slow", {channel: flat})).suspects
    assert (suspect.kind, suspect.channels) == ("dead", (channel,))


@pytest.mark.study
@pytest.mark.parametrize(
    ("channel", "deeper_mm"),
    [
        ("a", 1.5),
        ("c", -1.5),
        *(pytest.param(*case, marks=pytest.mark.study) for case in (("a", -1.5), ("c", 1.5))),
        ("e", -1.5),
    ],
)
def test_misplaced_junction_of_the_outer_row_is_identified_with_its_depth(
    b3: EhlTest, channel: str, deeper_mm: float
) -> None:
    (suspect,) = check_sensors(with_specified_depth(b3, "fast", channel, deeper_mm * 1e-3)).suspects
    assert (suspect.kind, suspect.channels) == ("misplaced", (channel,))
    assert suspect.size is not None
    # 3 u of the true depth about the nominal one, u = 0.1 mm
    assert suspect.size.value * 1e3 == pytest.approx(deeper_mm, abs=0.3)


@pytest.mark.study
@pytest.mark.parametrize("seed", [32, 37])
def test_depth_of_a_misplaced_junction_has_the_uncertainty_of_the_test(seed: int) -> None:
    """In these rigs full steps alternate about the depth without an end."""
    study = study_rig(seed)
    test = with_specified_depth(study.test, "slow", "e", -1.2e-3)
    (suspect,) = check_sensors(test).suspects
    assert (suspect.kind, suspect.channels) == ("misplaced", ("e",))
    assert suspect.size is not None
    true_depth_m = study.truth.slow.setup.junctions["e"].depth_m
    deeper_m = true_depth_m - test.disks["slow"].setup.junctions["e"].depth_m
    assert abs(suspect.size.value - deeper_m) < 3 * suspect.size.u
    assert suspect.size.u < 0.1e-3  # of a nominal depth


@pytest.mark.study
def test_wrong_static_line_is_reported_as_offset_not_as_wrong_depth(b3: EhlTest) -> None:
    """An offset leaves the transients unchanged; a wrong depth does not."""
    for channel in ("a", "e"):
        (suspect,) = check_sensors(
            with_readings(b3, "fast", {channel: column(b3, "fast", channel) + 4.0})
        ).suspects
        assert (suspect.kind, suspect.channels) == ("offset", (channel,))
        assert suspect.size is not None
        # prior of 5 K and 3 u of the model level
        assert suspect.size.value == pytest.approx(4.0, abs=1.5)


@pytest.mark.study
@pytest.mark.parametrize("channel", CHANNELS)
def test_offset_is_identified_from_readings_before_loading(b3: EhlTest, channel: str) -> None:
    """At rest all junctions read alike. Under load, an offset of the inner row resembles another
    h."""
    (suspect,) = check_sensors(
        with_readings(b3, "fast", {channel: column(b3, "fast", channel) + 2.0})
    ).suspects
    assert (suspect.kind, suspect.channels) == ("offset", (channel,))
    assert suspect.size is not None
    # static lines have u = 0.06 K, the noise is 0.12 K
    assert suspect.size.value == pytest.approx(2.0, abs=0.3)


def test_disk_that_is_warm_before_loading_is_not_checked_for_offsets(b3: EhlTest) -> None:
    before_load = b3.time_s < b3.events.load_on_s
    warm_readings = {
        c: column(b3, "fast", c) + before_load * (20.0 + 2.0 * (c == "b")) for c in CHANNELS
    }
    warm_test = with_readings(b3, "fast", warm_readings)
    assert not faults_at_rest(warm_test)["fast"]
    assert not any(faults_at_rest(b3).values())


@pytest.mark.study
def test_swapped_inner_row_channels_are_identified_by_static_lines_at_rest(b3: EhlTest) -> None:
    """Under load both channels read nearly alike; through the static line of the other channel they
    do not."""
    lines = b3.disks["fast"].lines
    for first, second in (("b", "d"), ("d", "f")):
        i = CHANNELS.index(first)
        j = CHANNELS.index(second)
        raw = {
            c: (column(b3, "fast", c) - lines[k].offset) / lines[k].gain
            for c, k in ((first, i), (second, j))
        }
        swapped = {
            first: lines[i].offset + lines[i].gain * raw[second],
            second: lines[j].offset + lines[j].gain * raw[first],
        }
        (suspect,) = check_sensors(with_readings(b3, "fast", swapped)).suspects
        assert (suspect.kind, suspect.channels) == ("swapped", (first, second))


@pytest.mark.parametrize("off_K", [0.3, 0.45, 0.6, 0.7])
@pytest.mark.parametrize("channel", CHANNELS)
def test_small_drift_of_a_channel_is_not_reported_as_swap(
    b3: EhlTest, channel: str, off_K: float
) -> None:
    for sign in (1, -1):
        drifted = with_readings(b3, "fast", {channel: column(b3, "fast", channel) + sign * off_K})
        assert "swapped" not in [fault.kind for fault in faults_at_rest(drifted)["fast"]]


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(("channel", "shift_s"), [("e", 0.5), ("a", 0.5), ("e", -0.4)])
def test_large_time_shift_of_a_column_is_identified_with_its_size(
    b3: EhlTest, channel: str, shift_s: float
) -> None:
    """A shift of 0.5 s is most of the lag, so the linear first estimate is not sufficient."""
    shifted = np.interp(b3.time_s - shift_s, b3.time_s, column(b3, "fast", channel))
    (suspect,) = check_sensors(with_readings(b3, "fast", {channel: shifted})).suspects
    assert (suspect.kind, suspect.channels) == ("late", (channel,))
    assert suspect.size is not None
    assert suspect.size.value == pytest.approx(shift_s, abs=0.06)  # 3 u of a shift with u = 0.02 s


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(("channel", "lag_s"), [("e", 0.6), ("a", 0.6), ("e", 1.0), ("c", 0.3)])
def test_bubble_in_the_cement_is_identified_with_its_lag(
    b3: EhlTest, channel: str, lag_s: float
) -> None:
    """A first-order lag in addition to that of the record; its linear effect is half of the true
    one."""
    keep = float(np.exp(-b3.dt_s / lag_s))
    y = column(b3, "fast", channel)
    lagged = lfilter([1 - keep], [1, -keep], y, zi=[keep * y[0]])[0]
    (suspect,) = check_sensors(with_readings(b3, "fast", {channel: lagged})).suspects
    assert (suspect.kind, suspect.channels) == ("late", (channel,))
    assert suspect.size is not None
    # 3 u, and u of the lag within this disk is 0.05 to 0.06 s
    assert suspect.size.value == pytest.approx(lag_s, abs=0.17)


def test_exchanged_cables_are_detected_through_the_other_disks_static_lines(b3: EhlTest) -> None:
    fast = b3.disks["fast"]
    slow = b3.disks["slow"]

    def read_through(disk: DiskTraces, source: DiskTraces) -> DiskTraces:
        """Readings of ``source`` converted with the static lines of ``disk``."""
        columns = []
        for line, source_line, y in zip(disk.lines, source.lines, source.readings_degC.T):
            raw = (y - source_line.offset) / source_line.gain
            columns.append(line.offset + line.gain * raw)
        return replace(disk, readings_degC=np.column_stack(columns))

    exchanged = replace(
        b3, disks={"fast": read_through(fast, slow), "slow": read_through(slow, fast)}
    )
    assert cables_exchanged(exchanged)
    assert not any(faults_at_rest(exchanged).values())
    assert not cables_exchanged(b3)
    # this offset is the same through either line
    offset_test = with_readings(b3, "fast", {"b": column(b3, "fast", "b") + 5.0})
    assert not cables_exchanged(offset_test)


def test_circumferential_press_fit_heating_is_not_a_channel_fault(b3: EhlTest) -> None:
    """Poor contact with the shaft on one side (6.4.3) heats that side within minutes: a first
    harmonic of the rim."""
    t = b3.time_s
    setup = b3.disks["slow"].setup
    slow_rise = 3.0 * (1 - np.exp(-np.clip(t - b3.events.load_on_s, 0, None) / 60.0))
    pattern = (
        harmonic_at_junctions(setup, 280.0, CHANNELS)[1] * 0.5
        + harmonic_at_junctions(setup, 280.0, CHANNELS)[0]
    )
    readings = {c: column(b3, "slow", c) + k * slow_rise for c, k in zip(CHANNELS, pattern)}
    check = check_sensors(with_readings(b3, "slow", readings))
    assert check.sound, check.texts
    assert "illogical" in set(check.table.query("disk == 'slow' and not same_group")["steady"])
    assert "illogical" not in set(check.table.query("disk == 'slow' and same_group")["steady"])


def test_indistinguishable_swaps_are_listed(intact_check: SensorCheck) -> None:
    # d and f have the same depth and radius
    assert ("d", "f") in intact_check.indistinguishable["fast"]
    assert not any({"a", "e"} == set(pair) for pair in intact_check.indistinguishable["fast"])


def test_expected_order_of_junction_temperatures_on_the_default_layout() -> None:
    setup = load_rig().disk_setup("slow")
    assert hotter_junction(setup, "e", "a") == 1
    assert hotter_junction(setup, "d", "b") == -1
    assert hotter_junction(setup, "d", "f") == 0
    # deeper but nearer the centre: table 6.2 says N.A.
    assert hotter_junction(setup, "b", "c") is None
    assert angle_groups(setup) == (("a", "e", "f"), ("b", "c", "d"))  # table 6.2


def test_pair_matrix_is_upper_triangular_and_grouped_by_angle(intact_check: SensorCheck) -> None:
    matrix = intact_check.matrix("fast")
    assert list(matrix.columns) == ["a", "e", "f", "b", "c", "d"]
    assert (matrix.to_numpy() != "").sum() == 15
    assert matrix.loc["b", "c"] == "N.A."


def test_log_that_ends_soon_after_unloading_is_checked(b3: EhlTest) -> None:
    keep = b3.time_s < b3.events.unload_s + 2.5
    short = replace(
        b3,
        time_s=b3.time_s[keep],
        power_W=b3.power_W[keep],
        ambient_degC=b3.ambient_degC[keep],
        disks={n: replace(d, readings_degC=d.readings_degC[keep]) for n, d in b3.disks.items()},
    )
    assert check_sensors(short).sound


@pytest.mark.study
def test_log_without_a_sample_in_the_first_window_is_checked(b3: EhlTest) -> None:
    """One sample a second, 0.1 and 1.1 s after the unloading."""
    first = np.searchsorted(b3.time_s, (b3.events.unload_s + 0.1) % 1.0)
    rows = slice(int(first), None, 75)
    disks = {
        name: replace(
            disk,
            readings_degC=disk.readings_degC[rows],
            missing=disk.missing[rows],
            inner_offset_K=disk.inner_offset_K[rows],
        )
        for name, disk in b3.disks.items()
    }
    slow = replace(
        b3,
        dt_s=1.0,
        time_s=b3.time_s[rows],
        power_W=b3.power_W[rows],
        ambient_degC=b3.ambient_degC[rows],
        disks=disks,
    )
    check = check_sensors(slow)
    assert check.sound, check.texts


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("seed", range(20, 23))
def test_rigs_drawn_from_their_uncertainties_have_no_findings(seed: int, tmp_path: Path) -> None:
    from tcdyn.simulate.campaign import simulate_campaign
    from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions
    from tcdyn.workflows import calibrate_disk

    options = EhlOptions(load_on_s=30.0, unload_s=330.0, duration_s=345.0, mesh=STUDY_MESH)
    files = simulate_campaign(tmp_path, seed, ("A1", "D4"), ehl_options=options, uncertain=True)
    rig = load_rig(files.rig)
    records = {}
    for d in ("fast", "slow"):
        record = calibrate_disk(rig, d, files.ovens[d], files.plunges[d], ["mobil-jet-ii"]).record
        records[d] = read_record(write_record(record, tmp_path / f"{d}.disk.json"))
    for log in files.ehl.values():
        check = check_sensors(prepare_test(read_log(log, "ehl", rig), rig, records))
        assert check.sound, check.texts


@pytest.mark.study
@pytest.mark.parametrize(
    ("channel", "deeper_mm"), [("b", 1.5), ("b", -1.5), ("d", 1.5), ("d", -1.5), ("f", -1.5)]
)
def test_misplaced_junction_of_the_inner_row_is_identified(
    campaign: Campaign, tmp_path: Path, channel: str, deeper_mm: float
) -> None:
    """The simulated disk has the junction elsewhere, so its temperature field is consistent; the
    rig file is wrong."""
    from tcdyn.simulate.campaign import write_log
    from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions, simulate_ehl
    from tcdyn.simulate.truth import draw_truth

    true = draw_truth(3, campaign.rig)  # the rig of the campaign fixture
    setup = true.fast.setup
    junction = setup.junctions[channel]
    junctions = {
        **setup.junctions,
        channel: replace(junction, depth_m=junction.depth_m + deeper_mm * 1e-3),
    }
    true = replace(true, fast=replace(true.fast, setup=replace(setup, junctions=junctions)))
    options = EhlOptions(load_on_s=30.0, unload_s=330.0, duration_s=345.0, mesh=STUDY_MESH)
    write_log(simulate_ehl("B3", 3, true, options)[0], tmp_path / "x.csv")
    test = prepare_test(
        read_log(tmp_path / "x.csv", "ehl", campaign.rig), campaign.rig, campaign.records
    )
    (suspect,) = check_sensors(test).suspects
    assert suspect.disk == "fast"
    assert channel in suspect.channels
    # a low d explains the outer row as well if it sits at f, because c is on the side of d
    if suspect.kind == "swapped":
        assert set(suspect.channels) == {"d", "f"}
        return
    assert (suspect.kind, suspect.channels) == ("misplaced", (channel,))
    assert suspect.size is not None
    assert np.sign(suspect.size.value) == np.sign(deeper_mm)


@pytest.mark.parametrize(
    ("fast", "slow"),
    [
        pytest.param("a", "a", marks=pytest.mark.study),
        pytest.param("e", "c", marks=[pytest.mark.study, pytest.mark.long]),
        pytest.param("b", "d", marks=[pytest.mark.study, pytest.mark.long]),
    ],
)
def test_channels_swapped_between_disks_are_identified(b3: EhlTest, fast: str, slow: str) -> None:
    swapped = with_readings(b3, "fast", {fast: column(b3, "slow", slow)})
    swapped = with_readings(swapped, "slow", {slow: column(b3, "fast", fast)})
    (suspect,) = check_sensors(swapped).suspects
    assert suspect.kind == "swapped"
    assert suspect.columns == (f"fast_{fast}_degC", f"slow_{slow}_degC")


@pytest.mark.long
@pytest.mark.study
def test_channels_swapped_between_disks_are_identified_when_their_lines_differ(
    b3: EhlTest,
) -> None:
    """Each channel then also deviates at rest, which must not be reported as an offset."""
    # of the static line of e; the readings are those of correct lines
    line_offset_K = {
        "fast": 1.5,
        "slow": -1.5,
    }
    lines = {
        d: tuple(
            line.model_copy(update={"offset": line.offset + line_offset_K[d] * (c == "e")})
            for c, line in zip(CHANNELS, b3.disks[d].lines)
        )
        for d in ("fast", "slow")
    }
    separated = replace(b3, disks={d: replace(b3.disks[d], lines=lines[d]) for d in lines})
    swapped = with_readings(separated, "fast", {"e": column(b3, "slow", "e") + 3.0})
    swapped = with_readings(swapped, "slow", {"e": column(b3, "fast", "e") - 3.0})
    (suspect,) = check_sensors(swapped).suspects
    assert (suspect.kind, suspect.columns) == ("swapped", ("fast_e_degC", "slow_e_degC"))


@pytest.mark.study
def test_nominal_flux_position_uncertainty_prevents_a_false_suspect() -> None:
    """A flux 1 mm off centre without this uncertainty is reported as a misplaced junction."""
    test = with_inner_row_at_one_radius(world_rig(7202, "flux 1 mm").test)
    assert check_sensors(test).suspects

    def with_flux_uncertainty(disk: DiskTraces) -> DiskTraces:
        return replace(disk, uncertainty=disk.uncertainty.model_copy(update={"flux_shift_mm": 0.5}))

    assert check_sensors(
        replace(test, disks={d: with_flux_uncertainty(disk) for d, disk in test.disks.items()})
    ).sound


@pytest.mark.long
@pytest.mark.study
def test_exchanged_cables_are_detected_at_rest_when_no_speed_exponent_fits() -> None:
    """If the static lines of the disks differ, the fit of the exchanged log finds no power law
    (seed 7301: n = 0.0)."""
    case = CASES["all cables"]
    study = study_rig(
        7301, truth=draw_truth(7301, load_rig(), uncertain=True), log_change=case.log_change
    )
    first = warnings_and_errors(study.analyse().findings)[0]
    assert first.code == "cables.exchanged"
    assert first.numbers["at_rest"]


def with_gains(frame: pd.DataFrame, gains: dict[str, float]) -> pd.DataFrame:
    """A log whose channels read another share of the temperature, by disk."""
    return frame.assign(
        **{
            column: gains[column.partition("_")[0]] * frame[column]
            for column in frame
            if column.partition("_")[0] in gains and column.endswith("_degC")
        }
    )


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("gains", "count"), [({}, 0), ({"fast": 1.03, "slow": 0.97}, 1), ({"fast": 1.005}, 0)]
)
def test_disks_that_read_different_temperatures_at_rest_are_reported(
    gains: dict[str, float], count: int
) -> None:
    study = study_rig(4, log_change=lambda frame: with_gains(frame, gains))
    findings = disks_differ(study.test)
    assert len(findings) == count
    if findings:
        assert (findings[0].code, findings[0].numbers["higher"]) == ("rest.disks_differ", "fast")
        assert 2.0 < findings[0].numbers["difference_K"] < 5.0
        assert "calibrate again" in findings[0].sentence
