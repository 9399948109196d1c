"""Means of a smoothed record, and the shortest time whose means are determined."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tcdyn import Chain
from tcdyn.chain import NO_CONDITIONING, FlowLaw
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.smoothing import Compensated, Intensity, smooth
from tcdyn.smoothing.resolution import DETERMINED, MeanSpectra
from tcdyn.smoothing.smoother import window_covariance
from tcdyn.smoothing.time_means import MeanTimes, TimeMeans

DT, N = 0.1, 400
CHAIN = Chain((1.0,), conditioning=NO_CONDITIONING)


def readings(seed: int = 0, n: int = N) -> Array:
    rng = np.random.default_rng(seed)
    true = 20 + np.cumsum(rng.normal(0, 0.1, n))
    return CHAIN.response(true, DT) + rng.normal(0, 0.02, n)


def means_of(result: Compensated) -> TimeMeans:
    assert result.means is not None
    return result.means


def smoothed(y: Array, length_s: float | MeanTimes | str, **options: object) -> Compensated:
    return smooth(y, DT, CHAIN, noise_sd=0.02, means=length_s, **options)


def test_mean_has_the_variance_of_the_covariance_of_all_its_samples() -> None:
    y = readings()
    q = Intensity.constant(0.5)
    result = smoothed(y, 2.0, intensity=q)
    means = means_of(result)
    k = 8
    first = int(means.sample[k]) - 10
    weight = np.full(21, 1 / 20)
    weight[[0, -1]] /= 2
    covariance = window_covariance(y, DT, CHAIN, result, 0, first, first + 21)
    expected = weight @ covariance @ weight
    assert means.sd_noise[k, 0] ** 2 == pytest.approx(expected, rel=0.03)
    at_samples = weight @ result.temperature[first : first + 21, 0]
    assert means.mean[k, 0] == pytest.approx(at_samples, abs=1e-3)
    both = np.zeros(41)
    both[:21] += weight
    both[20:] += weight
    covariance = window_covariance(y, DT, CHAIN, result, 0, first, first + 41)
    of_both = both @ covariance @ both
    alone = means.sd_noise[k, 0] ** 2 + means.sd_noise[k + 1, 0] ** 2
    assert means.covariance_next[k, 0] == pytest.approx(0.5 * (of_both - alone), abs=0.01 * alone)


def test_errors_of_the_whole_record_are_averaged_with_their_sign() -> None:
    y = readings()
    wave = y + 2 * np.sin(np.arange(N) * DT * 2 * np.pi / 2)
    result = smoothed(wave, 2.0, intensity=5.0, lag_covariance=[[0.01]], static_u=0.3)
    means = means_of(result)
    k = 5
    rows = slice(int(means.sample[k]) - 10, int(means.sample[k]) + 10)
    of_lag = 0.1 * result.lag_sensitivity[rows, 0].mean()
    assert means.sd_record[k, 0] == pytest.approx(np.hypot(of_lag, 0.3), rel=0.05)
    # over a period of the wave the lag hardly matters, sample by sample it does
    assert 0.1 * np.abs(result.lag_sensitivity[rows, 0]).mean() > 5 * abs(of_lag)


def test_means_are_better_known_than_rows_and_longer_ones_better_still() -> None:
    result = smoothed(readings(), 1.0)
    short = means_of(result).sd_noise
    assert np.median(short) < np.median(result.sd_noise)
    longer = means_of(smoothed(readings(), 4.0))
    assert np.median(longer.sd_noise) < 0.7 * np.median(short)
    assert longer.length_s == pytest.approx(4.0)
    assert np.diff(longer.sample).tolist() == [40] * (len(longer.sample) - 1)


def test_a_row_that_is_missing_in_the_middle_is_replaced_by_the_next_one() -> None:
    rows = np.delete(np.arange(N), [20, 60, 61])
    means = means_of(smoothed(readings(), MeanTimes(4.0, 0.0, rows)))
    assert means.sample[:3].tolist() == [20, 60, 100]
    assert means.row[:3].tolist() == [19, 59, 100]


def test_means_after_a_gap_are_as_certain_as_before() -> None:
    """A gap of ten lags behind a slow sensor: in it the covariances become large."""
    rng = np.random.default_rng(2)
    rows = 6000
    slow = Chain((200.0,), conditioning=NO_CONDITIONING)
    true = 20 + np.cumsum(rng.normal(0, 0.02, rows))
    y = slow.response(true, 1.0) + rng.normal(0, 0.01, rows)
    y[2000:3800] = np.nan
    result = smooth(y, 1.0, slow, means=100.0)
    means = means_of(result)
    of_true = np.array([true[k - 50 : k + 51].mean() for k in means.sample])
    z = (means.mean[:, 0] - of_true) / means.sd[:, 0]
    far = (means.sample < 1800) | (means.sample > 4000)
    assert np.mean(np.abs(z[far]) < 1.96) > 0.85
    before = np.median(means.sd[(means.sample > 300) & (means.sample < 1800)])
    after = np.median(means.sd[(means.sample > 4500) & (means.sample < 5700)])
    assert after == pytest.approx(before, rel=0.3)


def test_gap_has_means_with_a_wide_band() -> None:
    y = readings()
    y[150:190] = np.nan
    means = means_of(smoothed(y, 2.0))
    in_gap = np.abs(means.sample - 170) < 15
    assert means.sd_noise[in_gap].min() > 3 * np.median(means.sd_noise)


def test_means_of_a_lag_that_follows_a_flow() -> None:
    y = readings()
    law = FlowLaw(at=2.0, exponent=0.5, exponent_u=0.05)
    flow = np.where(np.arange(N) < 200, 2.0, 8.0)
    result = smoothed(y, 2.0, laws=law, flow=flow)
    means = means_of(result)
    constant = means_of(smoothed(y, 2.0, intensity=result.intensities))
    early = means.sample < 150
    assert means.mean[early] == pytest.approx(constant.mean[early], abs=0.1)
    assert means.sd_noise[~early].mean() < constant.sd_noise[~early].mean()


def test_dead_time_and_means_of_the_logger() -> None:
    y = readings()
    for chain in (Chain((1.0,), delay_s=0.25), Chain((1.0,), mean_s=0.3)):
        result = smooth(y, DT, chain, noise_sd=0.02, means=2.0)
        means = means_of(result)
        rows = result.temperature[means.sample[4] - 10 : means.sample[4] + 11, 0]
        assert means.mean[4, 0] == pytest.approx(rows.mean(), abs=0.1)


def test_auto_is_the_resolution_and_is_determined() -> None:
    rng = np.random.default_rng(3)
    true = 20 + np.cumsum(rng.normal(0, 0.3, 1200))
    y = CHAIN.response(true, DT) + rng.normal(0, 0.05, 1200)
    result = smooth(y, DT, CHAIN, means="auto")
    means = means_of(result)
    assert result.resolution_s is not None
    assert DT < result.resolution_s[0] < 5
    assert means.length_s == pytest.approx(result.resolution_s[0], abs=2 * DT)
    half = round(means.length_s / DT / 2)
    of_true = np.array([true[k - half : k + half + 1].mean() for k in means.sample])
    error = np.diff(means.mean[:, 0] - of_true, 2)
    assert np.mean(error**2) < 2 * (1 - DETERMINED) * np.mean(np.diff(of_true, 2) ** 2)


def test_explained_share_is_that_of_the_smoother() -> None:
    y = readings(1, 2000)
    slope, level = 0.3, 0.1
    q = Intensity((0.0,), (slope,), level_noise=(level,))
    result = smoothed(y, 0.4, intensity=q)
    means = means_of(result)
    spectra = MeanSpectra.of(np.array([0.4, 4.0]))
    density = 0.02**2 * DT
    _, mean_var = spectra.explained_share(CHAIN, density, np.array([[slope, level]]))
    middle = slice(100, -100)
    assert np.sqrt(mean_var[0, 0]) == pytest.approx(means.sd_noise[middle, 0].mean(), rel=0.03)


def test_prior_variance_of_changes_is_that_of_the_spectrum() -> None:
    # without readings (huge noise) nothing is explained: the error has the prior variance
    spectra = MeanSpectra.of(np.array([1.0, 3.0]))
    for pair in ([1.0, 0.0], [0.0, 1.0]):
        share, _ = spectra.explained_share(CHAIN, 1e12, np.array([pair]))
        assert np.abs(share).max() < 0.01


@pytest.mark.parametrize("given", [-1.0, "soon", 0.05, np.nan])
def test_impossible_times_are_refused(given: float) -> None:
    with pytest.raises(InputError, match="means over"):
        smoothed(readings(), given)


def test_table_of_means_has_the_index_of_the_readings() -> None:
    index = pd.date_range("2026-03-01 10:00", periods=N, freq="100ms")
    series = pd.Series(readings(), index, name="T_degC")
    result = smooth(series, None, CHAIN, noise_sd=0.02, means=2.0)
    table = result.to_frame()
    assert list(table) == ["T_degC", "T_u_K"]
    assert table.index[0] == index[10]
    assert table["T_degC"].to_numpy() == pytest.approx(means_of(result).mean[:, 0])


def test_a_time_longer_than_the_record_is_refused() -> None:
    with pytest.raises(InputError, match="means over 1e"):
        smoothed(readings(), 1e4)


def test_rows_at_uneven_times_have_means_between_even_ones() -> None:
    """A ramp in steady state, read up to 0.4 rows early or late."""
    rng = np.random.default_rng(5)
    rows = np.arange(600.0)
    late_s = rng.uniform(-0.4, 0.4, 600)
    y = 0.2 * (rows + late_s) - 2 + 0.05 * rng.normal(size=600)
    chain = Chain((10.0,), conditioning=NO_CONDITIONING)
    means = means_of(smooth(y, 1.0, chain, late_s=late_s, means=4.0))
    error = means.mean[:, 0] - 0.2 * means.sample
    assert np.mean(np.abs(error) < 1.96 * means.sd[:, 0]) > 0.9
