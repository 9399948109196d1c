"""The filters that every command needs are those of scipy.signal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from calibration.noise import local_polynomial
from tcdyn.chain.filters import BLOCK, LONG, first_order, largest_match, peaks

EXACT = 1e-12  # of unit numbers: rounding


@pytest.mark.parametrize("decay", [0.0, 1e-30, 0.3, -0.9, 0.9999, 1.0, 0.9 * np.exp(0.2j)])
@pytest.mark.parametrize("n", [1, 2, BLOCK, LONG - 1, LONG, LONG + BLOCK + 1, 70_001])
def test_first_order_is_lfilter(decay, n):
    drive = np.random.default_rng(n).standard_normal(n) + (0j if np.iscomplexobj(decay) else 0.0)
    expected = signal.lfilter([1.0], [1.0, -decay], drive)
    assert first_order(decay, drive) == pytest.approx(
        expected, abs=EXACT * np.max(np.abs(expected))
    )


@pytest.mark.parametrize(("window", "order"), [(1, 0), (3, 1), (3, 2), (75, 2), (299, 1), (401, 2)])
def test_local_polynomial_is_savgol_filter(window, order):
    y = np.cumsum(np.random.default_rng(0).standard_normal(401))
    expected = signal.savgol_filter(y, window, order)
    assert local_polynomial(y, window, order) == pytest.approx(expected, abs=EXACT * np.ptp(y))


@pytest.mark.parametrize(("n", "length"), [(40, 40), (41, 1), (500, 61), (12_345, 201)])
def test_largest_match_is_the_largest_correlation(n, length):
    random = np.random.default_rng(n)
    y, shapes = random.standard_normal(n), random.standard_normal((5, length)) / length**0.5
    expected = np.max(np.abs([np.correlate(y, shape, "valid") for shape in shapes]), axis=0)
    assert largest_match(y, shapes) == pytest.approx(expected, abs=EXACT * np.max(expected))


@pytest.mark.parametrize("distance", [1, 7, 200])
def test_peaks_are_those_of_find_peaks_highest_first(distance):
    y = signal.lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(5000))
    found = list(peaks(y, 1.5, distance))
    assert sorted(found) == signal.find_peaks(y, height=1.5, distance=distance)[0].tolist()
    assert np.all(np.diff(y[found]) <= 0)
    assert list(peaks(y, 100.0, distance)) == []


def test_flat_tops_are_peaks_in_their_middle_as_in_scipy() -> None:
    y = np.array(
        [0.0, 1.0, 1.0, 0.0, 3.0, 3.0, 3.0, 3.0, 0.0, 2.0, 2.0, 2.5]
    )  # the last rises to the end
    assert sorted(peaks(y, 0.5, 1)) == list(signal.find_peaks(y, height=0.5)[0]) == [1, 5]


def test_what_is_not_finite_reaches_no_sample_before_it() -> None:
    drive = np.ones(LONG + 900)
    drive[LONG + 10] = np.nan
    assert np.flatnonzero(np.isnan(first_order(0.9, drive)))[0] == LONG + 10
