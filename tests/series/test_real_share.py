"""How much of the deviations of the stamps is real, and readings at the times of the grid."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.series import at_grid_times, fit_clock, real_share
from tests.series.clock_study import Case, make_stamps
from tests.series.real_share_study import found_share

SCATTER = 0.1  # of the stamps, in intervals
NOISE_K = 0.02


def reading_degC(time_s: np.ndarray, noise_K: float, rng: np.random.Generator) -> np.ndarray:
    """A temperature that changes by up to 25 K/s, with noise."""
    return 60 + 8 * np.sin(2 * np.pi * time_s / 2) + rng.normal(0, noise_K, len(time_s))


@pytest.mark.parametrize("true_share", [0.0, 0.5, 1.0])
def test_the_share_is_recovered_within_its_uncertainty(true_share: float) -> None:
    pulls = []
    for record in range(20):
        rng = np.random.default_rng([1, record])
        stamps_s, samples, interval_s = make_stamps(Case(jitter=SCATTER), rng, 2000)
        even_s = stamps_s[0] + interval_s * samples
        taken_s = even_s + true_share * (stamps_s - even_s)
        clock = fit_clock(stamps_s)
        share = real_share(clock, [reading_degC(taken_s, NOISE_K, rng)])
        assert share.u < 0.05
        pulls.append((share.value - true_share) / share.u)
    # of 20 intervals of 95 %, fewer than 16 hold with a probability below 1 %; a share of 0 or 1
    # is at the end of its range
    assert np.count_nonzero(np.abs(pulls) < 1.96) >= 16


def test_readings_that_do_not_change_leave_the_prior() -> None:
    rng = np.random.default_rng(2)
    stamps_s, _, _ = make_stamps(Case(jitter=SCATTER), rng, 1000)
    share = real_share(fit_clock(stamps_s), [rng.normal(20, NOISE_K, 1000)])
    assert share.u > 0.3


def test_missing_readings_and_short_records_are_no_fault() -> None:
    rng = np.random.default_rng(3)
    stamps_s, _, _ = make_stamps(Case(jitter=SCATTER), rng, 1000)
    clock = fit_clock(stamps_s)
    empty = np.full(1000, np.nan)
    assert real_share(clock, [empty]).u == pytest.approx(0.5)
    assert real_share(clock, []).value == 1.0
    short = fit_clock(stamps_s[:12])
    assert real_share(short, [np.arange(12.0)]).u == pytest.approx(0.5)


def test_shifted_readings_are_those_of_the_grid() -> None:
    rng = np.random.default_rng(4)
    stamps_s, _, _ = make_stamps(Case(jitter=SCATTER), rng, 4000)
    clock = fit_clock(stamps_s)
    true_K = reading_degC(clock.even_s, 0.0, rng)
    readings = reading_degC(stamps_s, NOISE_K, rng)
    late_s = real_share(clock, [readings]).value * clock.jitter_s
    shifted = at_grid_times(readings, clock.even_s, late_s)
    as_read = float(np.std(readings - true_K))
    rest = float(np.std(shifted - true_K))
    assert as_read > 0.5 * SCATTER * clock.interval_s * 8 * np.pi / np.sqrt(2)
    # noise grows by the leverage of the slope: 1 % in variance for seven rows
    assert rest == pytest.approx(NOISE_K, rel=0.05)


def test_a_missing_reading_stays_missing_and_changes_its_neighbours_little() -> None:
    rng = np.random.default_rng(5)
    stamps_s, _, _ = make_stamps(Case(jitter=SCATTER), rng, 500)
    clock = fit_clock(stamps_s)
    readings = reading_degC(stamps_s, 0.0, rng)
    late_s = real_share(clock, [readings]).value * clock.jitter_s
    gap = readings.copy()
    gap[250] = np.nan
    shifted = at_grid_times(gap, clock.even_s, late_s)
    assert np.isnan(shifted[250])
    assert np.count_nonzero(np.isnan(shifted)) == 1
    whole = at_grid_times(readings, clock.even_s, late_s)
    assert np.nanmax(np.abs(shifted - whole)) < 0.01


@pytest.mark.parametrize("kind", ["counter", "switch", "valve with decimals"])
def test_columns_without_information_leave_the_prior(kind: str) -> None:
    for record in range(5):
        share = found_share(kind, 0.0, 400, [6, record])
        assert (share.value, share.u) == (1.0, 0.5)


def test_a_counter_beside_a_temperature_changes_nothing() -> None:
    for record in range(10):
        alone = found_share("ramp", 1.0, 400, [7, record])
        both = found_share("ramp and counter", 1.0, 400, [7, record])
        assert both == alone
        assert both.value > 0.9
        assert both.u < 0.05


@pytest.mark.parametrize("kind", ["mostly at rest", "quantised ramp"])
@pytest.mark.parametrize("true_share", [0.0, 1.0])
def test_readings_of_few_decimals_are_not_certain_and_wrong(kind: str, true_share: float) -> None:
    found = [found_share(kind, true_share, 400, [8, record]) for record in range(20)]
    assert min(each.u for each in found) > 0.1
    n_held = sum(abs(each.value - true_share) <= 2 * each.u for each in found)
    # of 20 intervals of 95 %, fewer than 16 hold with a probability below 1 %
    assert n_held >= 16
