"""Loading and parting are found to better than a sample; logs without them are refused in a sentence."""

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.partition.events import find_events
from tcdyn.rig.contact import Events, contact_force, relative_speed

DT = 1 / 75


def log(
    off_s: float = 80.0073,
    parting_s: float = 0.0,
    switch_late_s: float = 0.0,
    seed: int = 0,
    noise_N: float = 0.1,
) -> pd.DataFrame:
    t = np.arange(0, 100, DT)
    share = (
        np.clip((off_s + parting_s / 2 - t) / parting_s, 0, 1)
        if parting_s
        else (t < off_s).astype(float)
    )
    loaded = (t >= 10.0) * share
    noise = noise_N * np.random.default_rng(seed).standard_normal(len(t))
    contact = ((t >= 10.0) & (t < off_s + switch_late_s)).astype(int)
    return pd.DataFrame(
        {
            "time_s": t,
            "contact": contact,
            "friction_N": 0.3 + 20 * loaded + noise,
            "load_N": 1850 * loaded,
        }
    )


def codes(events: Events) -> set[str]:
    return {f.code for f in events.findings}


def test_a_step_is_placed_within_its_sample() -> None:
    events = find_events(log())
    assert abs(events.unload_s - 80.0073) <= DT / 2 + 1e-9
    assert 0.005 < events.unload_u_s < 0.0144  # three signals, each known to 0.05 s / sqrt(12)
    assert events.load_on_s == pytest.approx(10.0, abs=DT)


def test_a_ramp_of_1_5_s_is_measured_and_its_middle_found() -> None:
    events = find_events(log(parting_s=1.5))
    assert events.fall_time_s == pytest.approx(1.2, abs=0.05)  # 90-10 % of a straight fall of 1.5 s
    assert events.unload_s == pytest.approx(80.0073, abs=0.02)
    calm = find_events(log(parting_s=1.5, noise_N=0.0))  # straight between its samples
    assert (calm.fall_time_s, calm.unload_s) == pytest.approx((1.2, 80.0073), abs=1e-6)


def test_a_late_switch_moves_the_mean_by_its_third_and_widens_the_uncertainty() -> None:
    near, far = find_events(log()), find_events(log(switch_late_s=0.08))
    assert far.unload_s - near.unload_s == pytest.approx(0.08 / 3, abs=DT / 3)
    assert far.unload_u_s > 1.5 * near.unload_u_s
    assert abs(far.unload_s - 80.0073) < 2 * far.unload_u_s


def test_a_switch_that_is_far_off_is_not_believed() -> None:
    events = find_events(log(switch_late_s=0.5))
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.disagree" in codes(events)


@pytest.mark.parametrize("late_s", [-4.0, 2.0, 8.0])
def test_a_switch_that_is_seconds_off_does_not_hide_the_fall_of_the_friction(late_s: float) -> None:
    frame = log()
    frame["contact"] = ((frame["time_s"] >= 10.0) & (frame["time_s"] < 80.0073 + late_s)).astype(
        int
    )
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.disagree" in codes(events)


def test_a_noisy_friction_shows_a_slow_fall_all_the_same() -> None:
    """Noise of 6 % puts samples above and below 90, 50 and 10 % in disorder about each crossing."""
    frame = log(parting_s=1.5)
    frame["friction_N"] += 1.2 * np.random.default_rng(5).standard_normal(len(frame))
    events = find_events(frame.drop(columns="load_N"))
    assert "parting.no_friction" not in codes(events)
    assert "parting.switch_alone" not in codes(events)
    assert events.fall_time_s == pytest.approx(
        1.2, abs=0.15
    )  # a sample of 6 % is 0.09 s of such a fall
    assert events.unload_s == pytest.approx(80.0073, abs=0.09)


def test_a_friction_too_noisy_to_show_its_fall_leaves_the_word_to_the_load_cell() -> None:
    frame = log(switch_late_s=2.0)
    frame["friction_N"] += 5.0 * np.random.default_rng(1).standard_normal(len(frame))
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.no_friction" in codes(events)


def test_a_friction_with_a_gap_at_its_fall_leaves_the_word_to_the_load_cell() -> None:
    frame = log()
    frame.loc[frame["time_s"].between(79.7, 80.1), "friction_N"] = np.nan
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT  # halfway across the gap would be 0.1 s early
    assert events.fall_time_s < 2 * DT


def test_a_contact_that_drops_out_under_load_is_no_unloading() -> None:
    frame = log()
    frame.loc[frame["time_s"].between(40.0, 43.0), "contact"] = 0
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) <= DT
    assert events.load_on_s == pytest.approx(10.0, abs=DT)
    assert "contact.dropout" in codes(events)


def test_two_contacts_with_an_unloading_between_stay_two() -> None:
    frame = log()
    second = frame.assign(time_s=frame["time_s"] + 100.0)
    events = find_events(
        pd.concat([frame, second[second["time_s"] < 150.0].assign(contact=0)], ignore_index=True)
    )
    assert abs(events.unload_s - 80.0073) <= DT
    both = find_events(pd.concat([log(off_s=30.0), second], ignore_index=True))
    assert both.load_on_s == pytest.approx(110.0, abs=DT)  # the longer of the two
    assert "contact.dropout" not in codes(both)


def test_a_slow_parting_has_a_kink_at_each_end_and_a_quick_one_a_single_kink() -> None:
    slow, quick = find_events(log(parting_s=1.5)), find_events(log())
    # the 90-10 % time is good to 0.05 s (above), its ends to the half of 0.05 / 0.8
    assert slow.slope_changes_s == pytest.approx((80.0073 - 0.75, 80.0073 + 0.75), abs=0.05)
    assert quick.slope_changes_s == (quick.unload_s,)


def test_a_bouncing_contact_is_bridged_and_said() -> None:
    frame = log()
    frame.loc[3000:3005, "contact"] = 0
    events = find_events(frame)
    assert "contact.bounced" in codes(events)
    assert abs(events.unload_s - 80.0073) <= DT


@pytest.mark.parametrize(
    ("contact", "sentence"),
    [(0, "contact never goes to 1"), (1, "no unloading")],
    ids=["never", "always"],
)
def test_logs_without_the_event_are_refused(contact: int, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        find_events(log().assign(contact=contact))


def test_force_is_not_smeared_over_the_parting() -> None:
    frame = log()
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
    last = force[(t > 79.0) & (t < 80.0)]
    # zero of 0.3 N taken out; a two-second mean of 0.1 N noise is good to 0.01 N
    assert np.abs(last - 20.0).max() < 0.05
    assert force[t > 80.02].max() == 0.0
    assert force[t < 9.9].max() == 0.0


@pytest.mark.parametrize("trend_per_s", [0.0, -0.02])
def test_the_force_just_before_the_parting_does_not_follow_the_transducers_noise(
    trend_per_s: float,
) -> None:
    """Noise of a tenth of the force: what is left of it at the edge would scale beta one to one."""
    off, wrong = [], []
    for seed in range(20):
        frame = log(seed=seed)
        t = frame["time_s"].to_numpy()
        true = np.where(frame["load_N"] > 0, 20.0 + trend_per_s * (t - 80.0), 0.0)
        frame["friction_N"] = 0.3 + true + 2.0 * np.random.default_rng(seed).standard_normal(len(t))
        force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
        last = (t > 79.5) & (t < 79.9)
        off.append(float(np.mean(force[last] - true[last])))
        wrong.append(np.std(force[(t > 30) & (t < 79.9)] - true[(t > 30) & (t < 79.9)]))
    # the end of a line through 3000 samples: 2 * 2 N / sqrt(3000) = 0.073 N; 20 draws tell its rms to 16 %
    assert np.sqrt(np.mean(np.square(off))) < 0.073 * 1.5
    assert abs(np.mean(off)) < 3 * 0.073 / np.sqrt(20)
    assert np.mean(wrong) < 0.073


def test_the_force_of_a_slow_parting_falls_straight_from_its_first_kink_to_its_second() -> None:
    frame = log(parting_s=1.5)
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
    for after_s, share in ((-0.9, 1.0), (-0.6, 0.9), (0.0, 0.5), (0.6, 0.1), (0.9, 0.0)):
        # the 90-10 % time of 1.2 s is good to 0.05 s, the middle to 0.02 s, the level to 0.05 N
        assert np.interp(80.0073 + after_s, t, force) == pytest.approx(
            20 * share, abs=20 * (0.03 + 0.02) / 1.5 + 0.05
        )


def test_a_speed_that_comes_back_had_not_stopped_and_one_that_stays_at_zero_had() -> None:
    t = np.arange(0.0, 60.0, DT)
    slowing = 3000.0 * np.clip(1 - (t - 30.0) / 10.0, 0.0, 1.0)  # to rest in 10 s
    lost = slowing.copy()
    lost[(t > 33.0) & (t < 33.4)] = 0.0
    whole, seen = (relative_speed(t, x, 30.0, 3000.0) for x in (slowing, lost))
    assert whole is not None
    assert seen is not None
    np.testing.assert_allclose(seen, whole, atol=1e-3)  # a straight line in place of the gap in one
    assert np.interp([29.0, 33.2, 35.0, 45.0], t, seen) == pytest.approx(
        [1.0, 0.68, 0.5, 0.0], abs=1e-3
    )
    assert relative_speed(t, slowing, 59.95, 3000.0) is None  # too few rows to tell
    most = np.where((t > 32.0) & (t < 49.0), np.nan, slowing)
    assert relative_speed(t, most, 30.0, 3000.0) is None


def test_a_speed_is_smoothed_over_a_second_so_that_its_noise_alone_is_no_change() -> None:
    """Noise of 2 %: medians of 5 leave 1.1 %, a parabola over 75 samples a sixth to a third of that; also in the few
    samples of a log that ends at once."""
    t = np.arange(0.0, 60.0, DT)
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(t))
    kept = relative_speed(t, 3000.0 * (1 + noise), 30.0, 3000.0)
    assert kept is not None
    assert (kept == 1).all()
    for end_s in (60.0, 30.25, 30.265):  # an even number of samples left, and an odd one
        x = 3000.0 * np.where(t < 30.0, 1.0, 0.9 + noise)
        slower = relative_speed(t[t < end_s], x[t < end_s], 30.0, 3000.0)
        assert slower is not None
        assert slower[t[t < end_s] >= 30.0] == pytest.approx(0.9, abs=0.03)


def touched(at_s: float = 81.0, length_s: float = 0.2, switch: bool = True) -> pd.DataFrame:
    """The log of a test whose disks touch again at ``at_s``."""
    frame = log()
    again = frame["time_s"].between(at_s, at_s + length_s)
    frame.loc[again, "friction_N"] += 12.0
    frame.loc[again, "load_N"] += 1100.0
    frame.loc[again, "contact"] = int(switch)
    return frame


@pytest.mark.parametrize("switch", [True, False], ids=["seen by the switch", "unseen by it"])
@pytest.mark.parametrize(
    ("after_s", "length_s"),
    [(0.15, 0.1), (0.15, 0.4), (1.0, 0.1), (1.0, 0.4), (1.0, 6.0), (5.0, 0.1), (5.0, 6.0)],
)
def test_disks_that_touch_again_are_heated_by_the_logged_friction(
    switch: bool, length_s: float, after_s: float
) -> None:
    frame = touched(80.0073 + after_s, length_s, switch)
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT  # the parting is the first one
    ((start, stop),) = events.later_contacts
    assert 0 <= 80.0073 + after_s - start < 4 * DT  # two samples of margin at either end
    assert 0 <= stop - (80.0073 + after_s + length_s) < 4 * DT
    assert events.slope_changes_s[-2:] == (start, stop)
    assert codes(events) == {"contact.again"}
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), events)
    assert force[t > stop].max() == 0.0
    # noise of 0.1 N in each of n samples of DT, and of two samples at the ends that the pulse only partly fills
    n = length_s / DT
    pulse = force[(t >= start) & (t <= stop)].sum() * DT
    assert pulse == pytest.approx(12.0 * length_s, abs=12.0 * DT + 3 * 0.1 * DT * np.sqrt(n))


def test_a_touch_is_no_part_of_the_transducer_s_zero() -> None:
    frame = touched(82.0, 17.0)  # most of what follows the parting
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
    assert np.mean(force[(t > 70) & (t < 79.9)]) == pytest.approx(20.0, abs=0.05)  # as without it


def test_an_inverted_switch_is_read_the_other_way_round() -> None:
    right, wrong = log(), log()
    wrong["contact"] = 1 - wrong["contact"]
    events, told = find_events(right), find_events(wrong)
    assert (told.load_on_s, told.unload_s, told.unload_u_s) == (
        events.load_on_s,
        events.unload_s,
        events.unload_u_s,
    )
    assert codes(told) == {"contact.inverted"}


def test_forces_with_their_signs_turned_do_not_invert_the_switch() -> None:
    frame = log()
    events = find_events(frame.assign(load_N=-frame["load_N"], friction_N=-frame["friction_N"]))
    assert "contact.inverted" not in codes(events)
    assert events.load_on_s == pytest.approx(10.0, abs=DT)


@pytest.mark.parametrize("late_s", [-8.0, -2.0, 3.0, 15.0])
def test_a_switch_that_is_seconds_off_at_loading_is_outvoted(late_s: float) -> None:
    frame = log()
    frame["contact"] = ((frame["time_s"] >= 10.0 + late_s) & (frame["time_s"] < 80.0073)).astype(
        int
    )
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(10.0, abs=DT)
    assert codes(events) == {"loading.disagree"}


def test_a_switch_within_half_a_second_of_the_forces_tells_the_loading() -> None:
    frame = log()
    frame["contact"] = ((frame["time_s"] >= 9.8) & (frame["time_s"] < 80.0073)).astype(int)
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(9.8, abs=DT)
    assert codes(events) == set()


def test_a_switch_that_flickers_throughout_is_outvoted() -> None:
    frame = log()
    frame["contact"] = np.random.default_rng(0).integers(0, 2, len(frame))
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(10.0, abs=0.5)
    assert abs(events.unload_s - 80.0073) < 2 * DT
    assert "contact.bounced" in codes(events)


def test_a_switch_that_sticks_for_most_of_the_test_is_outvoted() -> None:
    frame = log()
    frame["contact"] = ((frame["time_s"] >= 10.0) & (frame["time_s"] < 15.0)).astype(int)
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.disagree" in codes(events)
