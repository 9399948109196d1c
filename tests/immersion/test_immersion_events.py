"""Entry events: switch and probe, alone, together, bouncing, missing, and contradictory."""

import numpy as np
import pytest

from immersion.entry import (
    RISE_DELAY_U_S,
    EntryEvent,
    find_entry,
    junction_time,
    probe_time,
    reconcile_entry,
    switch_time,
    useful_end,
)
from tcdyn.core.errors import InputError

T = np.arange(0, 60, 1 / 75)
ENTRY = 20.004


def probe(lag: float = 0.3, noise: float = 0.1, seed: int = 0) -> np.ndarray:
    """Reading of a free probe."""
    time_since_entry = np.clip(T - ENTRY, 0, None)
    return (
        27
        + 83 * (1 - np.exp(-time_since_entry / lag))
        + noise * np.random.default_rng(seed).standard_normal(len(T))
    )


def switch_signal(close_s: float, is_held: bool = True, bounces: int = 0) -> np.ndarray:
    """Switch signal, closed from ``close_s`` on; held, or released after 0.6 s; with bounces of 20
    ms."""
    on = (close_s <= T) & (is_held | (close_s + 0.6 > T))
    for k in range(bounces):
        start = close_s + 0.04 * (k + 1)
        on &= ~((start <= T) & (start + 0.02 > T))
    return on.astype(float)


@pytest.mark.parametrize("is_held", [True, False])
@pytest.mark.parametrize("bounces", [0, 3])
def test_switch_gives_its_first_closing(is_held: bool, bounces: int) -> None:
    time, bounced = switch_time(T, switch_signal(ENTRY, is_held, bounces))
    assert time == pytest.approx(ENTRY, abs=1 / 150 + 1e-9)  # half a sample
    assert bounced == (bounces > 0)


@pytest.mark.parametrize("lag", [0.1, 0.3, 0.6, 1.5, 4.0])
def test_probe_gives_the_entry_well_within_its_own_lag(lag: float) -> None:
    """A straight line through a first-order response meets the initial level 0.06 lag too early: a
    quarter of a second at 4 s."""
    estimates = np.array([probe_time(T, probe(lag, seed=s)) for s in range(10)], dtype=float)
    # the ends of the line fall on whole samples
    assert abs(np.mean(estimates[:, 0]) - ENTRY) < 0.01 * lag + 0.01
    assert (np.abs(estimates[:, 0] - ENTRY) < 2 * estimates[:, 1]).all()


def test_combined_entry_time_of_switch_and_probe_has_an_honest_uncertainty() -> None:
    errors = []
    rng = np.random.default_rng(3)
    for s in range(60):
        event = find_entry(
            T, switch_signal(ENTRY + 0.10 * rng.standard_normal()), probe(0.3, 0.1, s)
        )
        errors.append((event.time_s - ENTRY) / event.u_s)
    assert np.mean(np.abs(errors) < 2) > 0.9


def test_single_event_source_is_used_with_a_warning() -> None:
    probe_only = find_entry(T, np.zeros_like(T), probe())
    assert probe_only.source == "probe"
    assert [f.code for f in probe_only.findings] == ["entry.no_switch"]
    switch_only = find_entry(T, switch_signal(ENTRY), np.full_like(T, 27.0))
    assert switch_only.source == "switch"
    assert [f.code for f in switch_only.findings] == ["entry.no_probe"]
    assert switch_only.u_s > 0.1


def test_disagreement_increases_the_uncertainty_and_contradiction_raises() -> None:
    disagreeing = reconcile_entry(20.0, 20.6)
    agreeing = reconcile_entry(20.0, 20.05)
    assert disagreeing.u_s > 2 * agreeing.u_s
    assert [(f.code, round(f.numbers["difference_s"], 9)) for f in disagreeing.findings] == [
        ("entry.apart", 0.6)
    ]
    assert agreeing.findings == ()
    with pytest.raises(InputError, match=r"20\.00 s and 31\.00 s"):
        reconcile_entry(20.0, 31.0)
    with pytest.raises(InputError, match="no entry found"):
        find_entry(T, None, None)


def test_record_ends_when_the_disk_is_taken_out() -> None:
    t = np.arange(0, 200, 0.1)
    y = 26 + 84 * (1 - np.exp(-np.clip(t - 10, 0, None) / 60))
    taken_out = np.where(t > 120, y[np.searchsorted(t, 120)] * np.exp(-(t - 120) / 30), y)
    bath = np.full(len(t), 110.0)
    assert useful_end(t, y[:, None], bath, 10.0) == pytest.approx(200, abs=0.2)
    # means over one second
    assert useful_end(t, taken_out[:, None], bath, 10.0) == pytest.approx(120, abs=1.5)


def junctions(disk_s: float, entry_s: float, lag_s: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Six junctions of a disk that warms from 27 to 107 degC, with a lag; 600 s at 75 Hz with
    noise."""
    t = np.arange(0, 600, 1 / 75)
    time_since_entry = np.clip(t - entry_s, 0, None)
    progress = 1 - (
        disk_s * np.exp(-time_since_entry / disk_s) - lag_s * np.exp(-time_since_entry / lag_s)
    ) / (disk_s - lag_s)
    return t, 27 + 80 * progress[:, None] + 0.12 * np.random.default_rng(1).standard_normal(
        (len(t), 6)
    )


@pytest.mark.parametrize("disk_s", [60.0, 120.0])
@pytest.mark.parametrize("entry_s", [1.5, 3.0, 12.0, 40.0])
def test_junctions_give_an_entry_shortly_after_the_start_of_the_log(
    disk_s: float, entry_s: float
) -> None:
    t, readings = junctions(disk_s, entry_s)
    event = find_entry(t, None, None, np.full(len(t), 107.0), readings_degC=readings)
    assert event.source == "junctions"
    assert abs(event.time_s - entry_s) < 1.5 * RISE_DELAY_U_S


@pytest.mark.parametrize("entry_s", [-5.0, 0.0])
def test_junctions_that_rise_within_the_first_second_give_no_entry(entry_s: float) -> None:
    t, readings = junctions(120.0, entry_s)
    with pytest.raises(InputError, match="no entry found"):
        find_entry(t, None, None, np.full(len(t), 107.0), readings_degC=readings)


def test_junction_time_is_insensitive_to_noise() -> None:
    """Noise of 0.5 K: the mean over a fifth of a second has a sd of 0.07 K, one row 0.3 K; a disk
    of 120 s starts at 0.5 K/s."""
    t, noise_free = junctions(120.0, 12.0)
    bath = np.full(len(t), 107.0)
    rng = np.random.default_rng(2)
    expected = junction_time(t, noise_free, bath)
    assert expected is not None
    estimates = [
        junction_time(t, noise_free + rng.normal(0, 0.5, noise_free.shape), bath) for _ in range(5)
    ]
    assert np.abs(np.array(estimates, dtype=float) - expected).mean() < 0.3


def test_two_event_times_are_weighted_by_their_variances() -> None:
    """0.3 and 0.4 s: weights 0.64 and 0.36, combined 0.24 s, 0.5 s of the difference."""

    def entry_of(difference_s: float, **overrides: float) -> EntryEvent:
        return reconcile_entry(
            20.0,
            20.0 + difference_s,
            **{"switch_u_s": 0.3, "probe_u_s": 0.4, "sample_s": 0.0, **overrides},
        )

    for d, u, severities in (
        (0.5, 0.24, []),
        (1.5, 0.36, ["info"]),
        (-1.5, 0.36, ["info"]),
        (2.1, 0.504, ["warning"]),
    ):
        event = entry_of(d)
        assert (event.time_s, event.u_s) == pytest.approx((20.0 + 0.36 * d, u))
        assert [f.severity.value for f in event.findings] == severities
    assert entry_of(2.99).u_s == pytest.approx(0.24 * 2.99)
    with pytest.raises(InputError, match="agreement within 3 s"):
        entry_of(3.01)
    # within six combined standard uncertainties of 1 s
    assert entry_of(5.9, switch_u_s=0.6, probe_u_s=0.8).source == "switch and probe"
    with pytest.raises(InputError, match="agreement"):
        entry_of(6.1, switch_u_s=0.6, probe_u_s=0.8)


def test_single_event_time_has_an_enlarged_uncertainty_and_includes_the_sampling() -> None:
    """0.3 s, and rows of 0.4 s times the root of twelve: 0.5 s."""
    rows = {"switch_u_s": 0.3, "probe_u_s": 0.3, "sample_s": 0.4 * 12**0.5}
    assert reconcile_entry(20.0, None, **rows).u_s == pytest.approx(1.5 * 0.5)
    assert reconcile_entry(None, 20.0, **rows).u_s == pytest.approx(2 * 0.5)
    assert reconcile_entry(20.0, 20.0, **rows).u_s == pytest.approx(0.5 / 2**0.5)


def test_second_press_one_second_later_is_not_a_bounce() -> None:
    first_press, second_press = (
        switch_signal(ENTRY + after, is_held=False) for after in (0.0, 1.1)
    )
    assert switch_time(T, np.maximum(first_press, second_press))[1] is False
    assert (
        switch_time(T, np.maximum(first_press, switch_signal(ENTRY + 0.9, is_held=False)))[1]
        is True
    )


def test_uncertainty_of_a_probe_grows_with_its_rise_time_and_a_step_adds_none() -> None:
    """From 5 to 50 % a lag takes ln(0.95/0.5) of itself; a step gives the middle of its sample."""
    for lag in (0.5, 4.0):
        entry = probe_time(T, probe(lag, noise=0.0))
        assert entry is not None
        rise_s = lag * np.log(0.95 / 0.5)
        assert entry[1] == pytest.approx(np.hypot(0.05, 0.05 * rise_s), rel=0.02)  # integer rows
    of_step = probe_time(T, np.where(T < ENTRY, 27.0, 110.0))
    assert of_step == (pytest.approx(ENTRY, abs=1 / 150 + 1e-9), 0.05)


def test_probe_that_moves_by_less_than_three_kelvin_gives_no_entry() -> None:
    time_since_entry = np.clip(T - ENTRY, 0, None)
    for step, is_found in ((2.9, False), (3.1, True), (-2.9, False), (-3.1, True)):
        assert (
            probe_time(T, 27 + step * (1 - np.exp(-time_since_entry / 0.3))) is not None
        ) == is_found
    assert probe_time(T[:19], np.linspace(20, 90, 19)) is None  # too few rows
    falling = probe_time(T, 110 - 60 * (1 - np.exp(-time_since_entry / 0.3)))
    assert falling is not None
    assert falling[0] == pytest.approx(ENTRY, abs=0.02)


def test_record_ends_at_two_percent_or_where_the_disk_starts_to_return() -> None:
    t = np.arange(0, 400, 0.1)
    bath = np.full(len(t), 110.0)
    remaining_share = np.exp(-np.clip(t - 10, 0, None) / 60)
    # means over one second lie half a second after their start, including the first
    assert useful_end(t, (110 - 80 * remaining_share)[:, None], bath, 10.0) == pytest.approx(
        10.5 + 60 * np.log(50), abs=0.11
    )
    # 0.37 at 70 s; a return of less than two hundredths is noise
    for return_share, end in ((0.015, 399.9), (0.025, 70.5)):
        returning = np.where(
            t < 70, remaining_share, np.exp(-1.0) + return_share * (1 - np.exp(-(t - 70) / 10))
        )
        assert useful_end(t, (110 - 80 * returning)[:, None], bath, 10.0) == pytest.approx(
            end, abs=1.1
        )
    assert useful_end(t, (110 - 80 * remaining_share)[:, None], bath, 399.95) == t[-1]


def test_level_before_the_jump_of_a_probe_is_taken_from_the_last_ten_seconds() -> None:
    """The air warms by 3 K eight seconds before entry; relative to the level at the start the jump
    seems 0.2 s early."""
    warmer = np.where(T < 12, 27.0, 30.0) + 80 * (1 - np.exp(-np.clip(T - ENTRY, 0, None) / 4.0))
    entry = probe_time(1000 + T, warmer)
    assert entry is not None
    assert abs(entry[0] - 1000 - ENTRY) < entry[1] < 0.15
