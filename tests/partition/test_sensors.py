"""Swapped, dead, misplaced and offset channels are found and named; sound rigs raise no alarm (section 6.4)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.findings import warnings_and_errors
from tcdyn.partition.angular_harmonic import harmonic_at_junctions
from tcdyn.partition.at_rest import cables_exchanged, faults_at_rest
from tcdyn.partition.disk_features import AFTER_LOADING_S, AFTER_UNLOADING_S, disk_features
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import nominal_parameters
from tcdyn.partition.sensor_check import SensorCheck, angle_groups, check_sensors, hotter_junction
from tcdyn.partition.steady import with_inner_row_at_one_radius
from tcdyn.partition.window import Perturbation
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.log import read_log
from tcdyn.rig.record import read_record, write_record
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.truth import draw_truth
from tcdyn.smoothing.traces import DiskTraces
from tcdyn.workflows.beta import prepare_test
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
def sound(b3: EhlTest) -> SensorCheck:
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


def stated_elsewhere(test: EhlTest, name: str, channel: str, deeper_m: float) -> EhlTest:
    """The junction lies ``deeper_m`` deeper than the rig file then says."""
    setup = test.disks[name].setup
    place = setup.junctions[channel]
    junctions = {**setup.junctions, channel: replace(place, depth_m=place.depth_m - deeper_m)}
    return with_disk(test, replace(test.disks[name], setup=replace(setup, junctions=junctions)))


@pytest.mark.study
def test_a_sound_rig_raises_no_alarm_and_no_pair_is_illogical(sound: SensorCheck) -> None:
    assert sound.sound
    assert {f.code for found in sound.findings.values() for f in found} == {"sensors.sound"}
    assert "illogical" not in set(sound.table["steady"]) | set(sound.table["unloading"])
    assert sound.bulk_degC["fast"] > sound.bulk_degC["slow"]  # figure 6.17


def test_nearer_the_surface_answers_sooner_and_more(b3: EhlTest) -> None:
    for disk in b3.disks.values():
        f = disk_features(b3, disk)
        for answer in (
            -f.levels[f.event == "unloading"][1],
            f.levels[f.event == "loading"][0],
        ):  # fall and rise of a..f
            a, b, c, _, e, _ = answer
            assert e > a > c > b


def test_a_kelvin_on_all_thermocouples_is_an_ambient_read_a_kelvin_too_low(b3: EhlTest) -> None:
    """What conduction predicts depends on differences alone: to rounding, for a steady rim."""
    for disk in b3.disks.values():
        f = disk_features(b3, disk)
        known = dict(
            zip(
                [what.name for what in nominal_parameters(f.setup)],
                f.effects(f.as_wired, 700.0, 0.6)[:, :3],
            )
        )  # a, c, e, steady
        all_six = np.sum([known[f"static {c}"] for c in CHANNELS], axis=0)
        np.testing.assert_allclose(all_six, known["ambient"], atol=1e-9)
        assert (known["static a"][0], known["static a"][1]) == (1.0, 0.0)
        assert (
            known["depth e"] * [0, 0, 1] == known["depth e"]
        ).all()  # no other junction is where it is
        assert known["depth e"][2] < 0  # deeper is colder


def test_effects_on_the_features_are_differences_of_their_answers(b3: EhlTest) -> None:
    """Of the share and the flux's place; a later load answers later: by less heat the steeper the rise is."""
    f = replace(disk_features(b3, b3.disks["fast"]), shift_u_m=3e-4)
    unloading, loading = f.event == "unloading", f.event == "loading"
    assert f.after_s[unloading] == pytest.approx(np.mean(AFTER_UNLOADING_S, axis=1))
    assert f.after_s[loading] == pytest.approx(np.mean(AFTER_LOADING_S, axis=1))

    def shown(share: float, shift_m: float = 0.0) -> np.ndarray:
        rest, power = f.response(f.as_wired, ((700.0, Perturbation(shift_m=shift_m)),))
        return np.asarray(rest + share * power)[0]

    effects = dict(
        zip(("beside", "film", "lag", "later", "power"), f.effects(f.as_wired, 700.0, 0.6)[-5:])
    )
    assert effects["power"] == pytest.approx((shown(0.7) - shown(0.5))[f.observed] / 0.2)
    beside = (shown(0.6, 5e-5) - shown(0.6, -5e-5))[f.observed] * 3e-4 / 1e-4
    assert effects["beside"] == pytest.approx(beside, abs=1e-2 * np.abs(beside).max())
    full = np.zeros(f.observed.shape)
    full[f.observed] = effects["lag"]
    power = 0.6 * f.response(f.as_wired, ((700.0, Perturbation()),))[1][0, :, :3]  # outer row
    first, second, third, _ = np.flatnonzero(unloading)
    rate = (power[third] - power[first]) / (f.after_s[third] - f.after_s[first])
    assert full[second, :3] == pytest.approx(
        -rate, rel=0.5
    )  # straight between windows that are a second apart
    full[f.observed] -= effects["later"]
    assert not full[loading].any()
    assert np.abs(full[unloading, :3]).min() > 0


@pytest.mark.study
@pytest.mark.parametrize(
    ("disk", "pair"),
    [
        ("fast", "cd"),
        ("slow", "be"),
        *(
            pytest.param(*both, marks=pytest.mark.study)
            for both in (
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
def test_two_swapped_channels_are_named(b3: EhlTest, disk: str, pair: str) -> None:
    one, other = pair
    wrong = with_readings(b3, disk, {one: column(b3, disk, other), other: column(b3, disk, one)})
    (suspect,) = check_sensors(wrong).suspects
    assert (suspect.disk, suspect.kind, set(suspect.channels)) == (disk, "swapped", {one, other})
    assert f"{disk}_{one}_degC" in suspect.columns


@pytest.mark.study
@pytest.mark.parametrize("channel", CHANNELS)
def test_a_flat_channel_is_dead(b3: EhlTest, channel: str) -> None:
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
        *(pytest.param(*both, marks=pytest.mark.study) for both in (("a", -1.5), ("c", 1.5))),
        ("e", -1.5),
    ],
)
def test_a_misplaced_junction_of_the_outer_row_is_named_with_its_depth(
    b3: EhlTest, channel: str, deeper_mm: float
) -> None:
    (suspect,) = check_sensors(stated_elsewhere(b3, "fast", channel, deeper_mm * 1e-3)).suspects
    assert (suspect.kind, suspect.channels) == ("misplaced", (channel,))
    assert suspect.size is not None
    assert suspect.size.value * 1e3 == pytest.approx(
        deeper_mm, abs=0.3
    )  # 3 u of a depth known to 0.1 mm


@pytest.mark.study
def test_a_wrong_static_line_is_not_taken_for_a_wrong_depth(b3: EhlTest) -> None:
    """An offset leaves the transients as they were; a wrong depth does not."""
    for channel in ("a", "e"):
        (suspect,) = check_sensors(
            with_readings(b3, "fast", {channel: column(b3, "fast", channel) + 4.0})
        ).suspects
        assert (suspect.kind, suspect.channels) == ("offset", (channel,))
        assert suspect.size is not None
        assert suspect.size.value == pytest.approx(
            4.0, abs=1.5
        )  # prior of 5 K, and 3 u of the model's level


@pytest.mark.study
@pytest.mark.parametrize("channel", CHANNELS)
def test_an_offset_shows_before_the_load_in_every_channel(b3: EhlTest, channel: str) -> None:
    """An inner one under load is nearly another h and an uneven fit; at rest all junctions read alike."""
    (suspect,) = check_sensors(
        with_readings(b3, "fast", {channel: column(b3, "fast", channel) + 2.0})
    ).suspects
    assert (suspect.kind, suspect.channels) == ("offset", (channel,))
    assert suspect.size is not None
    assert suspect.size.value == pytest.approx(
        2.0, abs=0.3
    )  # lines known to 0.06 K, noise of 0.12 K


def test_a_disk_that_is_warm_before_the_load_is_not_asked_for_offsets(b3: EhlTest) -> None:
    rest = b3.time_s < b3.events.load_on_s
    warm = {c: column(b3, "fast", c) + rest * (20.0 + 2.0 * (c == "b")) for c in CHANNELS}
    moved = with_readings(b3, "fast", warm)
    assert faults_at_rest(moved)["fast"] == []
    assert not any(faults_at_rest(b3).values())


@pytest.mark.study
def test_two_of_the_inner_row_exchanged_are_told_by_their_static_lines_at_rest(b3: EhlTest) -> None:
    """Under load they read nearly alike; each read through the other's line does not."""
    lines = b3.disks["fast"].lines
    for one, other in (("b", "d"), ("d", "f")):
        i, j = CHANNELS.index(one), CHANNELS.index(other)
        raw = {
            c: (column(b3, "fast", c) - lines[k].offset) / lines[k].gain
            for c, k in ((one, i), (other, j))
        }
        moved = {
            one: lines[i].offset + lines[i].gain * raw[other],
            other: lines[j].offset + lines[j].gain * raw[one],
        }
        (suspect,) = check_sensors(with_readings(b3, "fast", moved)).suspects
        assert (suspect.kind, suspect.channels) == ("swapped", (one, other))


@pytest.mark.parametrize("off_K", [0.3, 0.45, 0.6, 0.7])
@pytest.mark.parametrize("channel", CHANNELS)
def test_a_channel_that_drifted_a_little_is_not_called_exchanged(
    b3: EhlTest, channel: str, off_K: float
) -> None:
    for sign in (1, -1):
        moved = with_readings(b3, "fast", {channel: column(b3, "fast", channel) + sign * off_K})
        assert "swapped" not in [fault.kind for fault, _, _ in faults_at_rest(moved)["fast"]]


@pytest.mark.study
@pytest.mark.parametrize(("channel", "late_s"), [("e", 0.5), ("a", 0.5), ("e", -0.4)])
def test_a_column_that_is_much_shifted_in_time_is_named_with_its_shift(
    b3: EhlTest, channel: str, late_s: float
) -> None:
    """Half a second is most of the lag: the first look, which is linear, said half of it, or another channel."""
    moved = np.interp(b3.time_s - late_s, b3.time_s, column(b3, "fast", channel))
    (suspect,) = check_sensors(with_readings(b3, "fast", {channel: moved})).suspects
    assert (suspect.kind, suspect.channels) == ("late", (channel,))
    assert suspect.size is not None
    assert suspect.size.value == pytest.approx(late_s, abs=0.06)  # 3 u of a shift known to 0.02 s


def test_cables_exchanged_as_a_whole_read_alike_through_each_other_s_lines(b3: EhlTest) -> None:
    fast, slow = b3.disks["fast"], b3.disks["slow"]

    def read(by: DiskTraces, of: DiskTraces) -> DiskTraces:
        lines = zip(by.lines, of.lines, of.readings_degC.T)
        read = [mine.offset + mine.gain * (y - own.offset) / own.gain for mine, own, y in lines]
        return replace(by, readings_degC=np.column_stack(read))

    exchanged = replace(b3, disks={"fast": read(fast, slow), "slow": read(slow, fast)})
    assert cables_exchanged(exchanged)
    assert not any(faults_at_rest(exchanged).values())
    assert not cables_exchanged(b3)
    off = with_readings(
        b3, "fast", {"b": column(b3, "fast", "b") + 5.0}
    )  # as far off through any line
    assert not cables_exchanged(off)


def test_a_hotter_side_is_the_press_fit_s_and_no_fault_of_a_channel(b3: EhlTest) -> None:
    """Poor contact with the shaft on one side (6.4.3) warms it over minutes: the first harmonic, as the rim has it."""
    t, setup = b3.time_s, b3.disks["slow"].setup
    slow_rise = 3.0 * (1 - np.exp(-np.clip(t - b3.events.load_on_s, 0, None) / 60.0))
    reads = (
        harmonic_at_junctions(setup, 280.0, CHANNELS)[1] * 0.5
        + harmonic_at_junctions(setup, 280.0, CHANNELS)[0]
    )
    moved = {c: column(b3, "slow", c) + k * slow_rise for c, k in zip(CHANNELS, reads)}
    check = check_sensors(with_readings(b3, "slow", moved))
    assert check.sound, check.texts
    assert "illogical" in set(check.table.query("disk == 'slow' and not same_group")["steady"])
    assert "illogical" not in set(check.table.query("disk == 'slow' and same_group")["steady"])


def test_swaps_that_cannot_be_told_are_said(sound: SensorCheck) -> None:
    assert ("d", "f") in sound.indistinguishable[
        "fast"
    ]  # the same depth and distance from the centre
    assert not any({"a", "e"} == set(pair) for pair in sound.indistinguishable["fast"])


def test_demand_of_conduction_on_the_default_layout() -> None:
    setup = load_rig().disk_setup("slow")
    assert hotter_junction(setup, "e", "a") == 1
    assert hotter_junction(setup, "d", "b") == -1
    assert hotter_junction(setup, "d", "f") == 0
    assert (
        hotter_junction(setup, "b", "c") is None
    )  # deeper but nearer the centre: table 6.2 says N.A.
    assert angle_groups(setup) == (("a", "e", "f"), ("b", "c", "d"))  # table 6.2


def test_matrix_is_the_upper_triangle_in_groups(sound: SensorCheck) -> None:
    matrix = sound.matrix("fast")
    assert list(matrix.columns) == ["a", "e", "f", "b", "c", "d"]
    assert (matrix.to_numpy() != "").sum() == 15
    assert matrix.loc["b", "c"] == "N.A."


def test_log_that_ends_soon_after_unloading_is_still_checked(b3: EhlTest) -> None:
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
@pytest.mark.parametrize("seed", range(20, 23))
def test_rigs_drawn_from_their_uncertainties_raise_no_alarm(seed: int, tmp_path: Path) -> None:
    from tcdyn.simulate.campaign import simulate_campaign
    from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions
    from tcdyn.workflows import calibrate_disk

    options = EhlOptions(load_on_s=30.0, unload_s=330.0, duration_s=345.0, mesh=STUDY_MESH)
    files = simulate_campaign(tmp_path, seed, ("A1", "D4"), ehl_options=options, uncertain=True)
    rig = load_rig(files.rig)
    records = {}
    for d in ("fast", "slow"):
        made = calibrate_disk(rig, d, files.ovens[d], files.plunges[d], ["mobil-jet-ii"]).record
        records[d] = read_record(write_record(made, tmp_path / f"{d}.disk.json"))
    for log in files.ehl.values():
        check = check_sensors(prepare_test(read_log(log, "ehl", rig), rig, records))
        assert check.sound, check.texts


@pytest.mark.study
@pytest.mark.parametrize(
    ("channel", "deeper_mm"), [("b", 1.5), ("b", -1.5), ("d", 1.5), ("d", -1.5), ("f", -1.5)]
)
def test_a_misplaced_junction_of_the_inner_row_is_named(
    campaign: Campaign, tmp_path: Path, channel: str, deeper_mm: float
) -> None:
    """The true disks have the junction elsewhere, so that the whole field is right; the rig file does not know."""
    from tcdyn.simulate.campaign import write_log
    from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions, simulate_ehl
    from tcdyn.simulate.truth import draw_truth

    true = draw_truth(3, campaign.rig)  # the fixture's rig
    setup = true.fast.setup
    place = setup.junctions[channel]
    junctions = {
        **setup.junctions,
        channel: replace(place, depth_m=place.depth_m + deeper_mm * 1e-3),
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
    if (
        suspect.kind == "swapped"
    ):  # a cold d explains the outer row as well when it sits at f: c is on d's side alone
        assert set(suspect.channels) == {"d", "f"}
        return
    assert (suspect.kind, suspect.channels) == ("misplaced", (channel,))
    assert suspect.size is not None
    assert np.sign(suspect.size.value) == np.sign(deeper_mm)


@pytest.mark.parametrize(
    ("fast", "slow"),
    [pytest.param(*both, marks=pytest.mark.study) for both in (("a", "a"), ("e", "c"), ("b", "d"))],
)
def test_channels_swapped_between_the_disks_are_named(b3: EhlTest, fast: str, slow: str) -> None:
    wrong = with_readings(b3, "fast", {fast: column(b3, "slow", slow)})
    wrong = with_readings(wrong, "slow", {slow: column(b3, "fast", fast)})
    (suspect,) = check_sensors(wrong).suspects
    assert suspect.kind == "swapped"
    assert suspect.columns == (f"fast_{fast}_degC", f"slow_{slow}_degC")


@pytest.mark.study
def test_channels_swapped_between_the_disks_are_named_though_their_lines_are_far_apart(
    b3: EhlTest,
) -> None:
    """Each then is off at rest, too, which is no offset."""
    off_K = {"fast": 1.5, "slow": -1.5}  # of the line of e; the readings are those of sound lines
    lines = {
        d: tuple(
            line.model_copy(update={"offset": line.offset + off_K[d] * (c == "e")})
            for c, line in zip(CHANNELS, b3.disks[d].lines)
        )
        for d in ("fast", "slow")
    }
    apart = replace(b3, disks={d: replace(b3.disks[d], lines=lines[d]) for d in lines})
    wrong = with_readings(apart, "fast", {"e": column(b3, "slow", "e") + 3.0})
    wrong = with_readings(wrong, "slow", {"e": column(b3, "fast", "e") - 3.0})
    (suspect,) = check_sensors(wrong).suspects
    assert (suspect.kind, suspect.columns) == ("swapped", ("fast_e_degC", "slow_e_degC"))


@pytest.mark.study
def test_a_stated_doubt_of_the_flux_s_place_is_heeded() -> None:
    """A millimetre beside the centre is otherwise taken for a misplaced junction."""
    test = with_inner_row_at_one_radius(world_rig(7202, "flux 1 mm").test)
    assert check_sensors(test).suspects

    def unsure(disk: DiskTraces) -> DiskTraces:
        return replace(disk, uncertainty=disk.uncertainty.model_copy(update={"flux_shift_mm": 0.5}))

    assert check_sensors(
        replace(test, disks={d: unsure(disk) for d, disk in test.disks.items()})
    ).sound


@pytest.mark.study
def test_whole_cables_are_told_from_rest_where_the_exponent_is_no_opposite() -> None:
    """Where the two disks' static lines differ, the exchanged fit finds no power law at all (seed 7301: n = 0.0)."""
    case = CASES["whole cables"]
    made = study_rig(
        7301, truth=draw_truth(7301, load_rig(), uncertain=True), disturbed=case.disturbed
    )
    first = warnings_and_errors(made.analyse().findings)[0]
    assert first.code == "cables.exchanged"
    assert first.numbers["at_rest"]
