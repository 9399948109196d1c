"""Loading and unloading instants are located to better than a sample; logs without them raise an
InputError."""

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.partition.events import find_events
from tcdyn.rig.contact import Events, contact_force, relative_speed

DT = 1 / 75


def simulated_log(
    unload_s: float = 80.0073,
    unload_duration_s: float = 0.0,
    switch_delay_s: float = 0.0,
    seed: int = 0,
    noise_N: float = 0.1,
) -> pd.DataFrame:
    t = np.arange(0, 100, DT)
    load_fraction = (
        np.clip((unload_s + unload_duration_s / 2 - t) / unload_duration_s, 0, 1)
        if unload_duration_s
        else (t < unload_s).astype(float)
    )
    loaded = (t >= 10.0) * load_fraction
    noise = noise_N * np.random.default_rng(seed).standard_normal(len(t))
    contact = ((t >= 10.0) & (t < unload_s + switch_delay_s)).astype(int)
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


def test_step_is_located_within_its_sample() -> None:
    events = find_events(simulated_log())
    assert abs(events.unload_s - 80.0073) <= DT / 2 + 1e-9
    # mean of three signals, each with u = 0.05 s / sqrt(12)
    assert 0.005 < events.unload_u_s < 0.0144
    assert events.load_on_s == pytest.approx(10.0, abs=DT)


def test_ramp_of_1_5_s_is_measured_and_its_middle_located() -> None:
    events = find_events(simulated_log(unload_duration_s=1.5))
    # 90 to 10 % of a linear fall of 1.5 s
    assert events.fall_time_s == pytest.approx(1.2, abs=0.05)
    assert events.unload_s == pytest.approx(80.0073, abs=0.02)
    # without noise, linear interpolation is exact
    noiseless = find_events(simulated_log(unload_duration_s=1.5, noise_N=0.0))
    assert (noiseless.fall_time_s, noiseless.unload_s) == pytest.approx((1.2, 80.0073), abs=1e-6)


def test_late_switch_shifts_the_mean_by_a_third_and_increases_the_uncertainty() -> None:
    reference = find_events(simulated_log())
    delayed = find_events(simulated_log(switch_delay_s=0.08))
    assert delayed.unload_s - reference.unload_s == pytest.approx(0.08 / 3, abs=DT / 3)
    assert delayed.unload_u_s > 1.5 * reference.unload_u_s
    assert abs(delayed.unload_s - 80.0073) < 2 * delayed.unload_u_s


def test_switch_half_a_second_off_is_outvoted() -> None:
    events = find_events(simulated_log(switch_delay_s=0.5))
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.disagree" in codes(events)


@pytest.mark.parametrize("delay_s", [-4.0, 2.0, 8.0])
def test_switch_seconds_off_does_not_hide_the_fall_of_friction(delay_s: float) -> None:
    frame = simulated_log()
    frame["contact"] = ((frame["time_s"] >= 10.0) & (frame["time_s"] < 80.0073 + delay_s)).astype(
        int
    )
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.disagree" in codes(events)


def test_noisy_friction_still_shows_a_slow_fall() -> None:
    """Noise of 6 % crosses the 90, 50 and 10 % levels several times."""
    frame = simulated_log(unload_duration_s=1.5)
    frame["friction_N"] += 1.2 * np.random.default_rng(5).standard_normal(len(frame))
    events = find_events(frame.drop(columns="load_N"))
    assert "parting.no_friction" not in codes(events)
    assert "parting.switch_alone" not in codes(events)
    # noise of 6 % is 0.09 s of such a fall
    assert events.fall_time_s == pytest.approx(1.2, abs=0.15)
    assert events.unload_s == pytest.approx(80.0073, abs=0.09)


def test_friction_too_noisy_to_show_its_fall_is_replaced_by_the_load_cell() -> None:
    frame = simulated_log(switch_delay_s=2.0)
    frame["friction_N"] += 5.0 * np.random.default_rng(1).standard_normal(len(frame))
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.no_friction" in codes(events)


def test_friction_with_a_gap_at_its_fall_is_replaced_by_the_load_cell() -> None:
    frame = simulated_log()
    frame.loc[frame["time_s"].between(79.7, 80.1), "friction_N"] = np.nan
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT  # the middle of the gap would be 0.1 s early
    assert events.fall_time_s < 2 * DT


def test_contact_dropout_under_load_is_not_an_unloading() -> None:
    frame = simulated_log()
    frame.loc[frame["time_s"].between(40.0, 43.0), "contact"] = 0
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) <= DT
    assert events.load_on_s == pytest.approx(10.0, abs=DT)
    assert "contact.dropout" in codes(events)


def test_two_contacts_with_an_unloading_between_stay_separate() -> None:
    frame = simulated_log()
    second = frame.assign(time_s=frame["time_s"] + 100.0)
    events = find_events(
        pd.concat([frame, second[second["time_s"] < 150.0].assign(contact=0)], ignore_index=True)
    )
    assert abs(events.unload_s - 80.0073) <= DT
    longer = find_events(pd.concat([simulated_log(unload_s=30.0), second], ignore_index=True))
    assert longer.load_on_s == pytest.approx(110.0, abs=DT)  # the longer contact
    assert "contact.dropout" not in codes(longer)


def test_slow_unloading_has_two_slope_changes_and_a_quick_one_has_one() -> None:
    slow = find_events(simulated_log(unload_duration_s=1.5))
    quick = find_events(simulated_log())
    # the 90 to 10 % time has a tolerance of 0.05 s (above), each end half of 0.05 / 0.8
    assert slow.slope_changes_s == pytest.approx((80.0073 - 0.75, 80.0073 + 0.75), abs=0.05)
    assert quick.slope_changes_s == (quick.unload_s,)


def test_bouncing_contact_is_bridged_and_reported() -> None:
    frame = simulated_log()
    frame.loc[3000:3005, "contact"] = 0
    events = find_events(frame)
    assert "contact.bounced" in codes(events)
    assert abs(events.unload_s - 80.0073) <= DT


@pytest.mark.parametrize("contact", [0, 1])
def test_a_switch_that_never_moves_is_not_used(contact: int) -> None:
    frame = simulated_log()
    stuck = find_events(frame.assign(contact=contact))
    without = find_events(frame.drop(columns="contact"))
    assert (stuck.load_on_s, stuck.unload_s) == (without.load_on_s, without.unload_s)


@pytest.mark.parametrize("contact", [0, 1])
def test_logs_without_contact_or_unloading_raise(contact: int) -> None:
    unloaded = simulated_log().assign(contact=contact, load_N=0.0, friction_N=0.0)
    with pytest.raises(
        InputError, match="neither load nor friction shows a loaded stretch and an unloading"
    ):
        find_events(unloaded)
    loaded = simulated_log().assign(contact=contact)
    with pytest.raises(InputError, match="no unloading"):
        find_events(loaded[loaded["time_s"] < 60.0])


def test_a_switch_that_closes_late_does_not_decide_the_loading() -> None:
    frame = simulated_log()
    frame.loc[frame["time_s"] < 10.4, "contact"] = 0
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(10.0, abs=DT)
    assert "loading.disagree" in codes(events)


def test_force_is_not_smeared_over_the_unloading() -> None:
    frame = simulated_log()
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
    loaded = force[(t > 79.0) & (t < 80.0)]
    # zero of 0.3 N removed; a two-second mean of 0.1 N noise has a standard deviation of 0.01 N
    assert np.abs(loaded - 20.0).max() < 0.05
    assert force[t > 80.02].max() == 0.0
    assert force[t < 9.9].max() == 0.0


@pytest.mark.parametrize("trend_per_s", [0.0, -0.02])
def test_force_just_before_unloading_does_not_follow_the_transducer_noise(
    trend_per_s: float,
) -> None:
    """Noise of a tenth of the force. The remaining error at the edge scales beta one to one."""
    edge_error = []
    rms_error = []
    for seed in range(20):
        frame = simulated_log(seed=seed)
        t = frame["time_s"].to_numpy()
        true = np.where(frame["load_N"] > 0, 20.0 + trend_per_s * (t - 80.0), 0.0)
        frame["friction_N"] = 0.3 + true + 2.0 * np.random.default_rng(seed).standard_normal(len(t))
        force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
        before_unloading = (t > 79.5) & (t < 79.9)
        edge_error.append(float(np.mean(force[before_unloading] - true[before_unloading])))
        rms_error.append(np.std(force[(t > 30) & (t < 79.9)] - true[(t > 30) & (t < 79.9)]))
    # the end of a line through 3000 samples: 2 * 2 N / sqrt(3000) = 0.073 N; the rms of 20 draws is
    # known to 16 %
    assert np.sqrt(np.mean(np.square(edge_error))) < 0.073 * 1.5
    assert abs(np.mean(edge_error)) < 3 * 0.073 / np.sqrt(20)
    assert np.mean(rms_error) < 0.073


def test_force_of_a_slow_unloading_falls_linearly_between_its_slope_changes() -> None:
    frame = simulated_log(unload_duration_s=1.5)
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
    for after_s, share in ((-0.9, 1.0), (-0.6, 0.9), (0.0, 0.5), (0.6, 0.1), (0.9, 0.0)):
        # tolerances: 0.05 s of the 90 to 10 % time of 1.2 s, 0.02 s of its middle, 0.05 N of the
        # level
        assert np.interp(80.0073 + after_s, t, force) == pytest.approx(
            20 * share, abs=20 * (0.03 + 0.02) / 1.5 + 0.05
        )


def test_short_zero_speed_is_interpolated_and_a_lasting_stop_is_kept() -> None:
    t = np.arange(0.0, 60.0, DT)
    slowing = 3000.0 * np.clip(1 - (t - 30.0) / 10.0, 0.0, 1.0)  # stops within 10 s
    with_dropout = slowing.copy()
    with_dropout[(t > 33.0) & (t < 33.4)] = 0.0
    expected = relative_speed(t, slowing, 30.0, 3000.0)
    result = relative_speed(t, with_dropout, 30.0, 3000.0)
    assert expected is not None
    assert result is not None
    np.testing.assert_allclose(result, expected, atol=1e-3)  # the dropout is interpolated linearly
    assert np.interp([29.0, 33.2, 35.0, 45.0], t, result) == pytest.approx(
        [1.0, 0.68, 0.5, 0.0], abs=1e-3
    )
    assert relative_speed(t, slowing, 59.95, 3000.0) is None  # too few rows
    mostly_missing = np.where((t > 32.0) & (t < 49.0), np.nan, slowing)
    assert relative_speed(t, mostly_missing, 30.0, 3000.0) is None


def test_speed_noise_alone_is_not_a_speed_change() -> None:
    """Noise of 2 %: medians of five samples leave 1.1 %, a parabola over 75 samples a sixth to a
    third of that.

    Also checked in the few samples of a log that ends soon after unloading.
    """
    t = np.arange(0.0, 60.0, DT)
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(t))
    constant = relative_speed(t, 3000.0 * (1 + noise), 30.0, 3000.0)
    assert constant is not None
    assert (constant == 1).all()
    for end_s in (60.0, 30.25, 30.265):  # an even and an odd number of remaining samples
        speed_rpm = 3000.0 * np.where(t < 30.0, 1.0, 0.9 + noise)
        slower = relative_speed(t[t < end_s], speed_rpm[t < end_s], 30.0, 3000.0)
        assert slower is not None
        assert slower[t[t < end_s] >= 30.0] == pytest.approx(0.9, abs=0.03)


def log_with_second_contact(
    at_s: float = 81.0, length_s: float = 0.2, switch: bool = True
) -> pd.DataFrame:
    """Log of a test whose disks touch again at ``at_s``."""
    frame = simulated_log()
    second_contact = frame["time_s"].between(at_s, at_s + length_s)
    frame.loc[second_contact, "friction_N"] += 12.0
    frame.loc[second_contact, "load_N"] += 1100.0
    frame.loc[second_contact, "contact"] = int(switch)
    return frame


@pytest.mark.parametrize("switch", [True, False], ids=["switch closes", "switch stays open"])
@pytest.mark.parametrize(
    ("after_s", "length_s"),
    [(0.15, 0.1), (0.15, 0.4), (1.0, 0.1), (1.0, 0.4), (1.0, 6.0), (5.0, 0.1), (5.0, 6.0)],
)
def test_second_contact_is_heated_by_the_logged_friction(
    switch: bool, length_s: float, after_s: float
) -> None:
    frame = log_with_second_contact(80.0073 + after_s, length_s, switch)
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT  # the first unloading counts
    ((start, stop),) = events.later_contacts
    assert 0 <= 80.0073 + after_s - start < 4 * DT  # a margin of two samples at either end
    assert 0 <= stop - (80.0073 + after_s + length_s) < 4 * DT
    assert events.slope_changes_s[-2:] == (start, stop)
    assert codes(events) == {"contact.again"}
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), events)
    assert force[t > stop].max() == 0.0
    # noise of 0.1 N in each of n samples of DT, and two partly filled samples at the ends
    n = length_s / DT
    pulse = force[(t >= start) & (t <= stop)].sum() * DT
    assert pulse == pytest.approx(12.0 * length_s, abs=12.0 * DT + 3 * 0.1 * DT * np.sqrt(n))


def test_second_contact_does_not_change_the_transducer_zero() -> None:
    frame = log_with_second_contact(82.0, 17.0)  # most of the log after unloading
    t = frame["time_s"].to_numpy()
    force = contact_force(t, frame["friction_N"].to_numpy(), find_events(frame))
    # as without the second contact
    assert np.mean(force[(t > 70) & (t < 79.9)]) == pytest.approx(20.0, abs=0.05)


def test_inverted_switch_gives_the_events_of_the_correct_one() -> None:
    correct_log = simulated_log()
    inverted_log = simulated_log()
    inverted_log["contact"] = 1 - inverted_log["contact"]
    events = find_events(correct_log)
    result = find_events(inverted_log)
    assert (result.load_on_s, result.unload_s, result.unload_u_s) == (
        events.load_on_s,
        events.unload_s,
        events.unload_u_s,
    )
    assert codes(result) == {"contact.inverted"}


def test_negated_forces_do_not_invert_the_switch() -> None:
    frame = simulated_log()
    events = find_events(frame.assign(load_N=-frame["load_N"], friction_N=-frame["friction_N"]))
    assert "contact.inverted" not in codes(events)
    assert events.load_on_s == pytest.approx(10.0, abs=DT)


@pytest.mark.parametrize("delay_s", [-8.0, -2.0, 3.0, 15.0])
def test_switch_seconds_off_at_loading_is_outvoted(delay_s: float) -> None:
    frame = simulated_log()
    frame["contact"] = ((frame["time_s"] >= 10.0 + delay_s) & (frame["time_s"] < 80.0073)).astype(
        int
    )
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(10.0, abs=DT)
    assert codes(events) == {"loading.disagree"}


@pytest.mark.parametrize("with_switch", [True, False])
@pytest.mark.parametrize("loading_s", [0.3, 1.0, 10.0, 60.0, 300.0])
@pytest.mark.parametrize("loaded_s", [302.0, 600.0])
def test_slow_loading_begins_where_the_forces_leave_their_zeros(
    loading_s: float, loaded_s: float, with_switch: bool
) -> None:
    """The force at the end must not depend on how the load was applied: its zero is that before the
    loading."""
    t = np.arange(0, 40.0 + loaded_s, DT)
    share = np.clip((t - 20.0) / loading_s, 0, 1) * (t < 20.0 + loaded_s)
    rng = np.random.default_rng(2)
    frame = pd.DataFrame(
        {
            "time_s": t,
            "contact": ((t >= 20.0) & (t < 20.0 + loaded_s)).astype(int),
            "friction_N": 0.3 + 20 * share + 0.15 * rng.standard_normal(len(t)),
            "load_N": 3.0 + 1850 * share + 2.0 * rng.standard_normal(len(t)),
        }
    )
    events = find_events(frame if with_switch else frame.drop(columns="contact"))
    # the line through a tenth and half of the rise: noise of 0.3 % of the force, hence 1.5 % of the
    # rise
    tolerance_s = DT if with_switch else DT + 0.015 * loading_s
    assert events.load_on_s == pytest.approx(20.0, abs=tolerance_s)
    assert codes(events) == set()
    force = contact_force(t, frame["friction_N"].to_numpy(), events)
    for at_s in (20.0 + 0.6 * loading_s, 10.0 + loaded_s, 19.0 + loaded_s):
        if at_s < 20.0 + loading_s and loading_s < 10.0:  # a kink within 4 s of the straight line
            continue
        # 4 s of that noise, twice as much at the end of the line, and zeros known to 0.01 N
        assert np.interp(at_s, t, force) == pytest.approx(20 * np.interp(at_s, t, share), abs=0.06)


def test_switch_within_a_fifth_of_a_second_of_the_forces_sets_the_loading_time() -> None:
    frame = simulated_log()
    frame["contact"] = ((frame["time_s"] >= 9.87) & (frame["time_s"] < 80.0073)).astype(int)
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(9.87, abs=DT)
    assert codes(events) == set()


def test_flickering_switch_is_outvoted() -> None:
    frame = simulated_log()
    frame["contact"] = np.random.default_rng(0).integers(0, 2, len(frame))
    events = find_events(frame)
    assert events.load_on_s == pytest.approx(10.0, abs=0.5)
    assert abs(events.unload_s - 80.0073) < 2 * DT
    assert "contact.bounced" in codes(events)


def test_switch_open_for_most_of_the_test_is_outvoted() -> None:
    frame = simulated_log()
    frame["contact"] = ((frame["time_s"] >= 10.0) & (frame["time_s"] < 15.0)).astype(int)
    events = find_events(frame)
    assert abs(events.unload_s - 80.0073) < DT
    assert "parting.disagree" in codes(events)
