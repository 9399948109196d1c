"""Bands of the smoother for temperatures that its first prior does not describe.

The readings come from :mod:`tests.smoothing.band_study`, which shares no solver with the smoother.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.smoother import likeliest, smooth
from tests.smoothing import long_record_study
from tests.smoothing.band_study import ROWS, judge, simulate, stage_polynomials

ROW = {row.name: row for row in ROWS}


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["Brownian", "drift", "steps of 0.5 K, swing"])
def test_the_band_of_a_rough_or_rounded_temperature_holds(name: str) -> None:
    """One record: 86 % leaves room for the few independent errors in it."""
    cover, worst, *_ = judge(ROW[name], 0, 4711)
    assert cover > 0.86
    assert worst < 8


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["OU of 0.2 s", "Kaimal", "pink"])
def test_what_no_reading_shows_of_a_rough_temperature_is_in_the_band(name: str) -> None:
    """One record of each sensor; without it 68 to 87 % are covered."""
    results = [judge(ROW[name], index, 4711) for index in range(4)]
    cover, _, square, _, _, _, u, _ = np.array(results).T
    assert cover.mean() > 0.89
    assert np.sqrt(np.mean(u**2)) < 1.3 * np.sqrt(square.mean())


def test_a_record_shows_whether_noise_drives_the_temperature() -> None:
    probabilities = []
    for name in ("Brownian", "sine"):
        setup, _, y, _ = simulate(ROW[name], 0, 4711)
        chain = Chain(setup.lags_s[0], conditioning=NO_CONDITIONING)
        record = record_of(y[:1500], setup.dt_s, chain)
        fit = likeliest(record, False)
        probabilities.append(fit.smooth_probability[0])
    assert probabilities[0] < 1e-3
    assert probabilities[1] > 0.6


@pytest.mark.e2e
@pytest.mark.parametrize("period_s", [1.0, 0.7, 0.5])
def test_a_wave_faster_than_the_lag_is_followed_or_in_the_band(period_s: float) -> None:
    """1 K behind a lag of 1 s in noise of 0.05 K: it was a constant with u of 3 mK, without a word.
    One likelihood has two maxima, and where no intensity is worth it, a line remains."""
    dt_s = 0.1
    t = dt_s * np.arange(2000)
    w = 2 * np.pi / period_s
    for seed in range(3):
        rng = np.random.default_rng(seed)
        phase = rng.uniform(0, 6)
        lagged = np.sin(w * t + phase - np.arctan(w)) / np.hypot(1.0, w)
        result = smooth(80 + lagged + rng.normal(0, 0.05, len(t)), dt_s, 1.0)
        error = result.temperature[:, 0] - (80 + np.sin(w * t + phase))
        assert np.mean(np.abs(error) < 1.96 * result.sd[:, 0]) > 0.9


def test_the_band_of_a_record_that_becomes_rough_is_narrow_before() -> None:
    """A random walk from two thirds of the record on; the quiet part had its band, too."""
    dt_s, quiet = 0.1, 1300
    rng = np.random.default_rng(3)
    walk = np.concatenate([np.zeros(quiet), np.cumsum(rng.normal(0, 0.3, 700))])
    b, a = stage_polynomials(1.0, dt_s)
    y = lfilter(b, a, walk) + rng.normal(0, 0.05, len(walk))
    result = smooth(80 + y, dt_s, 1.0)
    error = result.temperature[:, 0] - 80 - walk
    covered = np.abs(error) < 1.96 * result.sd[:, 0]
    assert np.median(result.sd[: quiet - 100]) < 0.03
    assert np.mean(covered[: quiet - 100]) > 0.9
    assert np.mean(covered[quiet + 100 :]) > 0.9


@pytest.mark.e2e
def test_a_rough_time_across_the_middle_of_a_record_is_covered() -> None:
    """Both halves of the record are equally rough, so that they do not disagree."""
    dt_s, first, last = 0.1, 9_000, 11_000
    b, a = stage_polynomials(1.0, dt_s)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x = np.zeros(20_000)
        x[first:last] = np.cumsum(rng.normal(0, 0.3, last - first))
        x[last:] = x[last - 1]
        y = lfilter(b, a, x) + rng.normal(0, 0.05, len(x))
        result = smooth(80 + y, dt_s, 1.0, find_events=False)
        covered = np.abs(result.temperature[:, 0] - 80 - x) < 1.96 * result.sd[:, 0]
        assert np.mean(covered[first:last]) > 0.88
        assert np.median(result.sd[:first]) < 0.03


@pytest.mark.e2e
@pytest.mark.long
@pytest.mark.parametrize("name", ["sines", "random walk"])
def test_parts_of_a_long_record_give_the_result_of_all_of_it(name: str) -> None:
    square, u, cover, _ = long_record_study.figures(name, 5, from_all=False)
    square_of_all, u_of_all, _, _ = long_record_study.figures(name, 5, from_all=True)
    assert np.sqrt(square) == pytest.approx(np.sqrt(square_of_all), rel=0.05)
    assert u == pytest.approx(u_of_all, rel=0.05)
    assert cover > 0.9


def test_a_wave_in_one_slow_channel_is_no_hum_and_no_noise() -> None:
    """5 K with a period of one lag: the error was 3.5 K."""
    _, worst, square, *_ = judge(ROW["sine"], 2, 4711)
    assert np.sqrt(square) < 0.5
    assert worst < 8


@pytest.mark.study
def test_a_short_ramp_that_looks_like_a_step_stays_in_the_band() -> None:
    """3 K in 0.05 s: the samples inside it were wrong by hundreds of standard deviations."""
    _, worst, *_ = judge(ROW["slope change"], 3, 4711)
    assert worst < 8


@pytest.mark.study
def test_listed_events_that_did_not_happen_do_not_replace_those_that_did() -> None:
    setup, truth, y, events = simulate(ROW["slope change"], 0, 4713)
    chain = Chain(setup.lags_s[0], conditioning=NO_CONDITIONING)
    wrong = [event + 1.5 for event in events]
    given = smooth(y, setup.dt_s, chain, events_s=wrong)
    alone = smooth(y, setup.dt_s, chain)
    errors = [np.sqrt(np.mean((r.temperature - truth) ** 2)) for r in (given, alone)]
    assert errors[0] < 1.5 * errors[1]
    assert any(f.code == "trace.events" for f in given.findings)


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("name", list(ROW))
def test_coverage_of_a_row(name: str, draws) -> None:
    """The mean coverage; pink noise and drift are the lowest (see the page "Validation")."""
    count = draws(16)
    cover = [judge(ROW[name], index, 99)[0] for index in range(count)]
    assert np.mean(cover) > 0.8
