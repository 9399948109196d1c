"""Entry events: switch and probe, alone, together, bouncing, missing, contradicting."""

import numpy as np
import pytest

from immersion.entry import (
    RISE_DELAY_U_S,
    EntryEvent,
    find_entry,
    probe_time,
    reconcile_entry,
    rise_time,
    switch_time,
    useful_end,
)
from tcdyn.core.errors import InputError

T = np.arange(0, 60, 1 / 75)
ENTRY = 20.004


def probe(lag: float = 0.3, noise: float = 0.1, seed: int = 0) -> np.ndarray:
    since = np.clip(T - ENTRY, 0, None)
    return (
        27
        + 83 * (1 - np.exp(-since / lag))
        + noise * np.random.default_rng(seed).standard_normal(len(T))
    )


def pressed(at: float, held: bool = True, bounces: int = 0) -> np.ndarray:
    on = (at <= T) & (held | (at + 0.6 > T))
    for k in range(bounces):
        start = at + 0.04 * (k + 1)
        on &= ~((start <= T) & (start + 0.02 > T))
    return on.astype(float)


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("bounces", [0, 3])
def test_the_switch_tells_its_first_closing(held: bool, bounces: int) -> None:
    time, bounced = switch_time(T, pressed(ENTRY, held, bounces))
    assert time == pytest.approx(ENTRY, abs=1 / 150 + 1e-9)  # half a sample
    assert bounced == (bounces > 0)


@pytest.mark.parametrize("lag", [0.1, 0.3, 0.6, 1.5, 4.0])
def test_the_probe_tells_the_entry_well_within_its_own_lag(lag: float) -> None:
    """A line through a first-order answer met the level before 0.06 lag too early: a quarter of a second at 4 s."""
    found = np.array([probe_time(T, probe(lag, seed=s)) for s in range(10)], dtype=float)
    assert (
        abs(np.mean(found[:, 0]) - ENTRY) < 0.01 * lag + 0.01
    )  # ends of the line fall on whole samples
    assert (np.abs(found[:, 0] - ENTRY) < 2 * found[:, 1]).all()


def test_both_witnesses_are_weighted_and_their_uncertainty_is_honest() -> None:
    errors = []
    rng = np.random.default_rng(3)
    for s in range(60):
        event = find_entry(T, pressed(ENTRY + 0.10 * rng.standard_normal()), probe(0.3, 0.1, s))
        errors.append((event.time_s - ENTRY) / event.u_s)
    assert np.mean(np.abs(errors) < 2) > 0.9


def test_one_witness_serves_with_a_warning() -> None:
    alone = find_entry(T, np.zeros_like(T), probe())
    assert alone.source == "probe"
    assert [f.code for f in alone.findings] == ["entry.no_switch"]
    by_hand = find_entry(T, pressed(ENTRY), np.full_like(T, 27.0))
    assert by_hand.source == "switch"
    assert [f.code for f in by_hand.findings] == ["entry.no_probe"]
    assert by_hand.u_s > 0.1


def test_disagreement_widens_and_contradiction_is_refused() -> None:
    apart = reconcile_entry(20.0, 20.6)
    together = reconcile_entry(20.0, 20.05)
    assert apart.u_s > 2 * together.u_s
    assert [(f.code, round(f.numbers["difference_s"], 9)) for f in apart.findings] == [
        ("entry.apart", 0.6)
    ]
    assert together.findings == ()
    with pytest.raises(InputError, match=r"20\.00 s and 31\.00 s"):
        reconcile_entry(20.0, 31.0)
    with pytest.raises(InputError, match="no entry found"):
        find_entry(T, None, None)


def test_the_record_ends_when_the_disk_is_taken_out() -> None:
    t = np.arange(0, 200, 0.1)
    y = 26 + 84 * (1 - np.exp(-np.clip(t - 10, 0, None) / 60))
    out = np.where(t > 120, y[np.searchsorted(t, 120)] * np.exp(-(t - 120) / 30), y)
    bath = np.full(len(t), 110.0)
    assert useful_end(t, y[:, None], bath, 10.0) == pytest.approx(200, abs=0.2)
    assert useful_end(t, out[:, None], bath, 10.0) == pytest.approx(
        120, abs=1.5
    )  # one-second means


def junctions(own_s: float, entry_s: float, lag_s: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Six junctions of a disk on its way from 27 to 107 degC behind a lag, 600 s at 75 Hz with noise."""
    t = np.arange(0, 600, 1 / 75)
    since = np.clip(t - entry_s, 0, None)
    way = 1 - (own_s * np.exp(-since / own_s) - lag_s * np.exp(-since / lag_s)) / (own_s - lag_s)
    return t, 27 + 80 * way[:, None] + 0.12 * np.random.default_rng(1).standard_normal((len(t), 6))


@pytest.mark.parametrize("own_s", [60.0, 120.0])
@pytest.mark.parametrize("entry_s", [1.5, 3.0, 12.0, 40.0])
def test_the_junctions_tell_an_entry_shortly_after_the_log_begins(
    own_s: float, entry_s: float
) -> None:
    t, readings = junctions(own_s, entry_s)
    event = find_entry(t, None, None, np.full(len(t), 107.0), readings_degC=readings)
    assert event.source == "junctions"
    assert abs(event.time_s - entry_s) < 1.5 * RISE_DELAY_U_S


@pytest.mark.parametrize("entry_s", [-5.0, 0.0])
def test_junctions_that_rise_within_the_first_second_tell_no_entry(entry_s: float) -> None:
    t, readings = junctions(120.0, entry_s)
    with pytest.raises(InputError, match="no entry found"):
        find_entry(t, None, None, np.full(len(t), 107.0), readings_degC=readings)


def test_noise_moves_the_rise_of_the_junctions_by_little_since_it_is_averaged_over_a_fifth_of_a_second() -> (
    None
):
    """Readings of 0.5 K noise: sd 0.07 K of the mean, 0.3 K of one row, where a disk of 120 s begins by 0.5 K/s."""
    t, quiet = junctions(120.0, 12.0)
    bath = np.full(len(t), 107.0)
    rng = np.random.default_rng(2)
    clear = rise_time(t, quiet, bath)
    assert clear is not None
    found = [rise_time(t, quiet + rng.normal(0, 0.5, quiet.shape), bath) for _ in range(5)]
    assert np.abs(np.array(found, dtype=float) - clear).mean() < 0.3


def test_two_witnesses_are_weighed_by_their_variances_to_the_last_digit() -> None:
    """0.3 and 0.4 s: weights 0.64 and 0.36, 0.24 s together, 0.5 s of the difference."""

    def of(difference_s: float, **more: float) -> EntryEvent:
        return reconcile_entry(
            20.0,
            20.0 + difference_s,
            **{"switch_u_s": 0.3, "probe_u_s": 0.4, "sample_s": 0.0, **more},
        )

    for d, u, grades in (
        (0.5, 0.24, []),
        (1.5, 0.36, ["info"]),
        (-1.5, 0.36, ["info"]),
        (2.1, 0.504, ["warning"]),
    ):
        event = of(d)
        assert (event.time_s, event.u_s) == pytest.approx((20.0 + 0.36 * d, u))
        assert [f.severity.value for f in event.findings] == grades
    assert of(2.99).u_s == pytest.approx(0.24 * 2.99)
    with pytest.raises(InputError, match="agreement within 3 s"):
        of(3.01)
    assert of(5.9, switch_u_s=0.6, probe_u_s=0.8).source == "switch and probe"  # within six of 1 s
    with pytest.raises(InputError, match="agreement"):
        of(6.1, switch_u_s=0.6, probe_u_s=0.8)


def test_one_witness_is_less_sure_than_it_says_and_as_coarse_as_the_rows() -> None:
    """0.3 s and rows of 0.4 s times the root of twelve: 0.5 s."""
    rows = {"switch_u_s": 0.3, "probe_u_s": 0.3, "sample_s": 0.4 * 12**0.5}
    assert reconcile_entry(20.0, None, **rows).u_s == pytest.approx(1.5 * 0.5)
    assert reconcile_entry(None, 20.0, **rows).u_s == pytest.approx(2 * 0.5)
    assert reconcile_entry(20.0, 20.0, **rows).u_s == pytest.approx(0.5 / 2**0.5)


def test_a_second_press_a_second_later_is_no_bounce() -> None:
    first, again = (pressed(ENTRY + after, held=False) for after in (0.0, 1.1))
    assert switch_time(T, np.maximum(first, again))[1] is False
    assert switch_time(T, np.maximum(first, pressed(ENTRY + 0.9, held=False)))[1] is True


def test_a_probe_s_uncertainty_grows_with_the_time_it_takes_and_a_sudden_one_has_none_of_that() -> (
    None
):
    """From 5 to 50 % a lag takes ln(0.95/0.5) of itself; a step tells the middle of its sample."""
    for lag in (0.5, 4.0):
        found = probe_time(T, probe(lag, noise=0.0))
        assert found is not None
        assert found[1] == pytest.approx(
            np.hypot(0.05, 0.05 * lag * np.log(0.95 / 0.5)), rel=0.02
        )  # whole rows
    sudden = probe_time(T, np.where(T < ENTRY, 27.0, 110.0))
    assert sudden == (pytest.approx(ENTRY, abs=1 / 150 + 1e-9), 0.05)


def test_a_probe_that_moves_by_less_than_three_kelvin_tells_nothing() -> None:
    since = np.clip(T - ENTRY, 0, None)
    for step, told in ((2.9, False), (3.1, True), (-2.9, False), (-3.1, True)):
        assert (probe_time(T, 27 + step * (1 - np.exp(-since / 0.3))) is not None) == told
    assert probe_time(T[:19], np.linspace(20, 90, 19)) is None  # too few rows
    falling = probe_time(T, 110 - 60 * (1 - np.exp(-since / 0.3)))
    assert falling is not None
    assert falling[0] == pytest.approx(ENTRY, abs=0.02)


def test_the_record_ends_at_two_percent_or_where_the_disk_began_to_go_back() -> None:
    t = np.arange(0, 400, 0.1)
    bath = np.full(len(t), 110.0)
    share = np.exp(-np.clip(t - 10, 0, None) / 60)
    # means over a second lie half a second later than they begin, the first one, too
    assert useful_end(t, (110 - 80 * share)[:, None], bath, 10.0) == pytest.approx(
        10.5 + 60 * np.log(50), abs=0.11
    )
    for back, end in (
        (0.015, 399.9),
        (0.025, 70.5),
    ):  # 0.37 at 70 s; less than two hundredths back is noise
        gone = np.where(t < 70, share, np.exp(-1.0) + back * (1 - np.exp(-(t - 70) / 10)))
        assert useful_end(t, (110 - 80 * gone)[:, None], bath, 10.0) == pytest.approx(end, abs=1.1)
    assert useful_end(t, (110 - 80 * share)[:, None], bath, 399.95) == t[-1]


def test_the_level_before_a_probe_s_jump_is_that_of_the_last_ten_seconds() -> None:
    """Air that became 3 K warmer eight seconds before the entry; by the level at the start it seems 0.2 s ago."""
    warmer = np.where(T < 12, 27.0, 30.0) + 80 * (1 - np.exp(-np.clip(T - ENTRY, 0, None) / 4.0))
    found = probe_time(1000 + T, warmer)
    assert found is not None
    assert abs(found[0] - 1000 - ENTRY) < found[1] < 0.15
