"""The clock of a log: interval, samples and deviations of stamps that other code made."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tcdyn.series import fit_clock
from tests.series.clock_study import CASES, Case, make_stamps, n_misplaced

EXACT = [name for name, case in CASES.items() if case.jitter <= 0.1 and not case.tick_s]
ROUNDED = ["75 Hz in ms", "75 Hz in ms, 1 % lost", "10 Hz in s", "9.7 Hz in s"]
STRAYING = [name for name, case in CASES.items() if case.jitter > 0.1 and not case.tick_s]


@pytest.mark.parametrize("name", EXACT)
def test_no_row_is_misplaced_where_stamps_stray_by_at_most_a_tenth(name: str) -> None:
    # 0.5 intervals are five standard deviations
    stamps_s, samples, interval_s = make_stamps(CASES[name], np.random.default_rng(1))
    clock = fit_clock(stamps_s)
    assert n_misplaced(clock.index, samples)[0] <= (3 if CASES[name].lost > 0.1 else 0)
    assert clock.interval_s == pytest.approx(interval_s, rel=2e-4 if CASES[name].wander else 1e-5)


@pytest.mark.parametrize("name", STRAYING)
def test_rows_that_stray_more_are_misplaced_by_one_sample_next_to_a_lost_row(name: str) -> None:
    stamps_s, samples, interval_s = make_stamps(CASES[name], np.random.default_rng(2))
    clock = fit_clock(stamps_s)
    count, size = n_misplaced(clock.index, samples)
    assert count <= 0.003 * len(samples)
    assert size <= 1
    error = clock.index - samples - np.median(clock.index - samples)
    beside_lost = np.diff(samples, prepend=-2, append=samples[-1] + 2) > 1
    near_lost = np.convolve(beside_lost, np.ones(5), "same")[: len(samples)] > 0
    assert np.all(near_lost[error != 0])
    assert clock.interval_s == pytest.approx(interval_s, rel=1e-4)


@pytest.mark.parametrize("name", ROUNDED)
def test_rounded_stamps_lie_within_one_tick_of_their_samples(name: str) -> None:
    case = CASES[name]
    stamps_s, samples, interval_s = make_stamps(case, np.random.default_rng(3))
    clock = fit_clock(stamps_s)
    assert clock.interval_s == pytest.approx(interval_s, rel=1e-4)
    assert clock.is_coarse == (case.tick_s > interval_s)
    true_s = stamps_s[0] + interval_s * samples
    error_s = clock.even_s - true_s
    assert np.ptp(error_s) <= case.tick_s
    assert n_misplaced(clock.index, samples)[0] == 0


def test_rows_that_stand_twice_are_one_sample() -> None:
    rng = np.random.default_rng(4)
    samples = np.sort(np.concatenate([np.arange(3000), rng.choice(3000, 240, replace=False)]))
    clock = fit_clock(1.0 * samples)
    assert not clock.is_coarse
    assert np.array_equal(clock.index, samples)
    assert clock.n_repeated == 240
    assert clock.n_lost == 0


def test_a_batch_with_one_stamp_holds_one_sample_after_the_other() -> None:
    # eight rows of 0.5 s arrive together, and the time of arrival strays by 20 ms
    rng = np.random.default_rng(5)
    arrival_s = 4.0 * np.arange(1, 101) + rng.normal(0, 0.02, 100)
    clock = fit_clock(np.repeat(np.round(arrival_s, 3), 8))
    assert clock.is_coarse
    assert clock.interval_s == pytest.approx(0.5, rel=1e-3)
    assert np.array_equal(clock.index, np.arange(800))


def test_the_uncertainty_of_the_interval_covers_its_error() -> None:
    pulls = []
    for record in range(40):
        rng = np.random.default_rng([6, record])
        stamps_s, _, interval_s = make_stamps(Case(jitter=0.15, lost=0.01), rng, 1000)
        clock = fit_clock(stamps_s)
        pulls.append((clock.interval_s - interval_s) / clock.u_interval_s)
    # 40 intervals of 95 %: fewer than 34 hold with a probability of 1 %
    assert np.count_nonzero(np.abs(pulls) < 1.96) >= 34
    # the sandwich estimate from 16 pieces must not be wide either
    assert np.sqrt(np.mean(np.square(pulls))) > 0.6


def test_a_known_interval_is_kept() -> None:
    stamps_s, samples, interval_s = make_stamps(CASES["jitter 10 %"], np.random.default_rng(7))
    clock = fit_clock(stamps_s[:20], interval_s)
    assert clock.interval_s == interval_s
    assert np.array_equal(clock.index, samples[:20])


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_few_even_stamps_have_their_interval(n: int) -> None:
    clock = fit_clock(10 + 0.25 * np.arange(n))
    assert clock.interval_s == pytest.approx(0.25)
    assert np.array_equal(clock.index, np.arange(n))


@pytest.mark.parametrize(
    "stamps_s", [[0.0, 1.0, np.nan], [0.0, 2.0, 1.0], [3.0, 3.0, 3.0], [1.0], []]
)
def test_stamps_without_an_order_are_refused(stamps_s: list[float]) -> None:
    with pytest.raises(ValueError, match="stamps must be finite"):
        fit_clock(np.array(stamps_s))


def test_time_of_sample_zero_and_deviations_give_the_stamps() -> None:
    stamps_s, _, _ = make_stamps(CASES["jitter 25 %, 1 % lost"], np.random.default_rng(8))
    clock = fit_clock(stamps_s)
    assert np.allclose(clock.even_s + clock.deviation_s, stamps_s, atol=1e-9)
    assert clock.stray_s == pytest.approx(0.25 * 0.01, rel=0.05)


@pytest.mark.parametrize("rate_Hz", [1.2, 3.3, 4.0, 10.0, 75.0])
@pytest.mark.parametrize("phase", [0.0, 0.37, 0.81])
def test_whole_second_stamps_of_a_faster_log_give_its_rate(rate_Hz: float, phase: float) -> None:
    """Within 4 standard uncertainties: the rows' errors are uniform, so the fit's error is nearly
    normal."""
    stamps_s = np.floor(np.arange(int(40 * rate_Hz)) / rate_Hz + phase)
    even = fit_clock(stamps_s)
    assert abs(even.interval_s - 1 / rate_Hz) < 4 * even.u_interval_s + 1e-12
    assert even.u_interval_s < 0.01 / rate_Hz
    assert even.index.tolist() == list(range(len(stamps_s)))


@pytest.mark.parametrize("lost", [9, 20, 45, 3000])
def test_rows_that_a_logger_lost_leave_rate_and_places_as_they_are(lost: int) -> None:
    """10 Hz, stamps of whole seconds; only the rows of the second in which some are lost may be
    misplaced."""
    rows = np.r_[np.arange(3004), np.arange(3004 + lost, 6000 + lost)]
    even = fit_clock(np.floor(rows / 10))
    assert even.interval_s == pytest.approx(0.1, rel=1e-3)
    assert np.count_nonzero(even.index != rows) <= 10


@pytest.mark.parametrize("interval_s", [1.05, 1.2, 1.5, 1.7, 2.2, 2.5])
@pytest.mark.parametrize("phase", [0.0, 0.37, 0.81])
def test_whole_second_stamps_of_a_slower_log_give_its_interval(
    interval_s: float, phase: float
) -> None:
    rows = np.r_[0:300, 302:500]  # the logger lost two
    even = fit_clock(np.floor(1e9 + interval_s * rows + phase))
    assert abs(even.interval_s - interval_s) < 4 * even.u_interval_s + 1e-12
    assert even.index[:300].tolist() == list(range(300))
    assert np.abs(even.index - rows).max() <= 1  # a gap is known to one unit


@pytest.mark.e2e
def test_rows_lost_at_random_are_no_coarse_clock() -> None:
    for seed in range(50):
        rows = np.flatnonzero(np.random.default_rng(seed).random(400) > 0.1)
        clock = fit_clock(2.0 * rows)
        assert clock.index.tolist() == (rows - rows[0]).tolist()
        assert clock.interval_s == pytest.approx(2.0)


def test_an_hour_that_comes_twice_is_no_clock_of_few_decimals() -> None:
    """Rows every 15 minutes; the hour of the end of daylight saving time is there twice, sorted."""
    quarter_h = np.concatenate([np.arange(14), np.repeat(np.arange(14, 18), 2), np.arange(18, 93)])
    clock = fit_clock(900.0 * quarter_h)
    assert not clock.is_coarse
    assert clock.index.tolist() == quarter_h.tolist()


@pytest.mark.parametrize("kind", ["pairs", "random pairs", "sparse", "powers", "two gaps"])
def test_odd_stamps_are_placed_in_bounded_time(kind: str) -> None:
    rng = np.random.default_rng(9)
    steps = {
        "pairs": np.where(np.arange(3000) % 2, 1e-6, 1.0),
        "random pairs": np.where(rng.random(3000) < 0.5, 1e-6, 1.0),
        "sparse": 0.01 * rng.integers(1, 400, 3000),
        "powers": 10.0 ** rng.uniform(-6, 3, 3000),
        "two gaps": np.array([1e-6, 1e6]),
    }[kind]
    stamps_s = np.cumsum(steps)
    started_s = time.process_time()
    clock = fit_clock(stamps_s)
    assert time.process_time() - started_s < 10  # it takes 1 s
    assert np.all(np.diff(clock.index) >= 0)
    assert np.allclose(clock.even_s + clock.deviation_s, stamps_s)


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("shortest_s", "longest_s", "tick_s"),
    [
        (1.01, 1.01, 1.0),
        (1.005, 1.025, 1.0),
        (1.02, 1.05, 1.0),
        (1.05, 1.07, 1.0),
        (0.101, 0.106, 0.1),
        (0.1005, 0.102, 0.1),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_a_loop_a_little_slower_than_its_clock_loses_no_row(
    shortest_s: float, longest_s: float, tick_s: float, seed: int
) -> None:
    """It skips a stamp at regular distances; the stamps alone could be those of lost rows."""
    rng = np.random.default_rng([10, seed])
    taken_s = 0.4 + np.cumsum(rng.uniform(shortest_s, longest_s, 3000))
    clock = fit_clock(np.floor(taken_s / tick_s) * tick_s)
    assert clock.n_lost == 0
    mean_s = (taken_s[-1] - taken_s[0]) / 2999
    assert clock.interval_s == pytest.approx(mean_s, rel=2e-4)


@pytest.mark.e2e
@pytest.mark.parametrize("share", [0.005, 0.015, 0.05])
def test_rows_lost_at_random_are_no_slow_loop(share: float) -> None:
    for seed in range(8):
        samples = np.flatnonzero(np.random.default_rng([11, seed]).random(3000) > share)
        clock = fit_clock(1.0 * samples)
        assert clock.index.tolist() == (samples - samples[0]).tolist()


def test_sparse_rows_before_dense_ones_keep_their_distance() -> None:
    samples = np.concatenate([60 * np.arange(11), np.arange(601, 900)])
    clock = fit_clock(1.0 * samples)
    assert clock.index.tolist() == samples.tolist()
