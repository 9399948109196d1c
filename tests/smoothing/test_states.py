"""The states of a stretch: their likelihood against dense Gaussian algebra, cells and knots, where
it may be cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from tcdyn.chain import NO_CONDITIONING, Chain, sensors
from tcdyn.smoothing import Intensity
from tcdyn.smoothing import intervals as pieces
from tcdyn.smoothing.intervals import STEPS, corner_rad_s, knots_for
from tcdyn.smoothing.record import Record, record_of
from tcdyn.smoothing.state_space import channel_ranges, likelihood, ramp_prior

DT, N = 0.1, 60


def stretch(seed: int = 0, lost: tuple[int, ...] = (), delay_s: float = 0.0) -> Record:
    rng = np.random.default_rng(seed)
    x = 20 + 5 * np.sin(np.arange(N) * DT / 2)
    chain = Chain((0.3,), delay_s=delay_s, conditioning=NO_CONDITIONING)
    y = chain.response(x, DT) + 0.1 * rng.standard_normal(N)
    y[list(lost)] = np.nan
    return record_of(y, DT, chain, noise_sd=0.1)


def dense(of: Record, noise_var: float, q: float) -> tuple[float, float]:
    """ln likelihood of the seen samples, and their squares about the mean over ``noise_var``, per
    degree of freedom.

    The state at the first knot as wide as the prior; the slope's jump at every sample is q dt, half
    of it at the first.
    """
    (s,) = of.sensors
    mean, cov, slope_var = ramp_prior(
        s, float(of.y[of.weight[:, 0] > 0, 0][0]), float(channel_ranges(of)[0]), DT, np.array([q])
    )
    a = expm(s.drift * DT)
    rows, centre = [], []
    sources = [np.linalg.cholesky(cov[0])]
    state, blocks = mean, [sources[0]]
    for k in range(N):
        if k:
            state, blocks = a @ state, [a @ b for b in blocks]
        jump = np.zeros((len(mean), 1))
        jump[1] = np.sqrt(
            q * DT * (0.5 if k == 0 else 1.0) + slope_var * (round(k * DT, 9) in of.events_s)
        )
        blocks.append(jump)
        centre.append(float(s.output @ state))
        rows.append(np.concatenate([s.output @ b for b in blocks]))
    table = np.zeros((N, len(rows[-1])))
    for k, row in enumerate(rows):
        table[k, : len(row)] = row
    seen = of.weight[:, 0] > 0
    spread = table[seen] @ table[seen].T + noise_var * np.eye(seen.sum())
    y, m = of.y[seen, 0], np.array(centre)[seen]
    ln = float(multivariate_normal(m, spread).logpdf(y)) + 0.5 * seen.sum() * np.log(2 * np.pi)
    return ln, float((y - m) @ np.linalg.solve(spread, y - m)) / (seen.sum() - 2 - len(of.events_s))


@pytest.mark.parametrize(("lost", "events"), [((), ()), ((10, 11, 30), ()), ((), (2.5,))])
def test_the_likelihood_is_that_of_all_samples_together(
    lost: tuple[int, ...], events: tuple[float, ...]
) -> None:
    """Up to what does not hang on noise and intensity: the quadratic form leaves the prior's mean
    out."""
    of, found, exact, ratios = replace(stretch(0, lost), events_s=events), [], [], []
    for noise_var, q in ((0.01, 1.0), (0.01, 30.0), (0.04, 1.0), (0.0025, 0.1)):
        value, ratio = likelihood(of, np.array([noise_var]), [[Intensity.constant(q)]], fine=1e-6)
        ln, expected = dense(of, noise_var, q)
        found.append(float(value[0, 0]))
        exact.append(ln)
        ratios.append((float(ratio[0, 0]), expected))
    assert np.diff(found) == pytest.approx(
        np.diff(exact), abs=1e-5
    )  # rounding: the prior is ten times the range wide
    for got, expected in ratios:
        assert got == pytest.approx(expected, rel=1e-6)


def test_the_corner_is_where_the_signal_sinks_into_the_noise() -> None:
    """Without a lag w^4 = q/R; behind a long one w^6 = q/(R tau^2)."""
    ratio = np.array([1e-2, 1.0, 1e4])
    none, long = (
        corner_rad_s(Chain(taus, conditioning=NO_CONDITIONING), ratio) for taus in ((), (1e3,))
    )
    assert none == pytest.approx(
        ratio**0.25, rel=2e-3
    )  # straight lines between 400 points of eight decades
    assert long == pytest.approx((ratio / 1e6) ** (1 / 6), rel=2e-3)


@pytest.mark.parametrize("delay_s", [0.0, 0.25])
@pytest.mark.parametrize("q", [0.01, 100.0])
def test_cells_begin_before_the_dead_time_end_on_samples_and_are_as_short_as_the_smoother_asks(
    delay_s: float, q: float
) -> None:
    of = stretch(1, delay_s=delay_s)
    event = 2.53
    at = Record(**{**vars(of), "events_s": (event,)})
    knots = knots_for(at, np.array([0.01]), [[Intensity.constant(q)]])
    assert knots[0] == pytest.approx(-0.3 if delay_s else 0.0, abs=1e-12)
    assert knots[-2] < (N - 1) * DT + 1e-9 <= knots[-1] + 1e-9
    assert event in knots
    others = knots[knots != event] / DT
    assert others == pytest.approx(np.rint(others), abs=1e-9)
    (corner,) = corner_rad_s(of.chains[0], np.array([q / (0.01 * DT)]))
    long, cells = max(0.5 / corner, DT), np.diff(knots)
    assert cells.max() <= long * (1 + 1e-9)
    assert cells.max() > 0.6 * min(long, 0.4)  # the next step of STEPS is at most twice the last
    usual = DT * max(n for n in STEPS if n * DT <= long * (1 + 1e-9))
    away = knots[:-1][cells < 0.99 * usual]
    assert all(
        min(abs(k - e) for e in (knots[0], event)) < 3 * long for k in away[away < knots[-3]]
    )


def test_before_a_record_level_and_slope_are_as_unknown_as_ten_of_its_ranges() -> None:
    """The slope: ten ranges in the chain's lag and four samples."""
    of = stretch(0)
    (s,) = of.sensors
    mean, cov, slope_var = ramp_prior(s, 20.0, 3.0, DT, np.zeros(1))
    assert slope_var == pytest.approx((30.0 / (0.3 + 4 * DT)) ** 2)
    assert float(s.output @ mean) == pytest.approx(20.0)
    assert float(mean[0]) == pytest.approx(20.0)
    assert cov[0][0, 0] == pytest.approx(30.0**2)
    assert cov[0][1, 1] == pytest.approx(slope_var)
    assert float(s.output @ cov[0] @ s.output) == pytest.approx(
        30.0**2 + 0.3**2 * slope_var
    )  # a ramp comes 0.3 s late


def test_a_piece_has_so_many_samples_beside_it_and_no_cell_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those that carry weight; a gap of 40 samples puts the end of what is swept further off."""
    rng, dt, n, gap = np.random.default_rng(6), 0.02, 6000, range(2500, 2540)
    y = 50 + 3 * np.sin(np.arange(n) * dt / 5) + 0.1 * rng.standard_normal(n)
    y[list(gap)] = np.nan
    of = record_of(y, dt, Chain((0.1,), conditioning=NO_CONDITIONING), noise_sd=0.1)
    chosen = [Intensity.constant(5.0)]
    knots = knots_for(of, of.noise_sd**2, [chosen])
    count = len(knots) - 1
    rows = pieces.settling_time_s(of.sensors, of.noise_sd, dt, chosen) / dt
    monkeypatch.setattr(pieces, "CHUNK_INTERVALS", count // 2 + 1)
    assert list(pieces.chunks(of, of.noise_sd**2, chosen, knots)) == [
        (0, 0, count, count)
    ]  # not worth a cut
    monkeypatch.setattr(pieces, "CHUNK_INTERVALS", count // 6)
    at = np.clip(np.ceil(knots / dt - 1e-9).astype(int), 0, n)
    seen = np.concatenate([[0], np.cumsum(of.weight[:, 0] > 0)])[
        at
    ]  # samples with weight before each knot
    cuts = list(pieces.chunks(of, of.noise_sd**2, chosen, knots))
    assert len(cuts) > 3
    assert (cuts[0][0], cuts[-1][-1]) == (0, count)
    for low, first, last, high in cuts:
        assert low <= first < last <= high
        if low > 0:
            assert seen[first] - seen[low] >= rows - 1e-9
            assert seen[first] - seen[low + 1] <= rows + 1
        if high < count:
            assert seen[high] - seen[last] >= rows - 1e-9
            assert seen[high - 1] - seen[last] <= rows + 1


@pytest.mark.parametrize("taus", [(), (0.4,)])
def test_the_smoother_forgets_within_its_own_corner(taus: tuple[float, ...]) -> None:
    """Without a lag the slowest root of s^4 = -q/(R dt) is (q/(R dt))^(1/4)/sqrt(2); a lag only
    makes it slower."""
    (s,) = sensors([Chain(taus, conditioning=NO_CONDITIONING)])
    found = pieces.memory_s(s, 16.0)
    assert found == pytest.approx(np.sqrt(2) / 2, rel=1e-6) or (taus and found > np.sqrt(2) / 2)
    later = sensors([Chain(taus, delay_s=0.7, conditioning=NO_CONDITIONING)])
    took = pieces.settling_time_s(
        later, np.array([0.5]), 0.25, [Intensity((0.0, 1.0), (99.0, 1.0))]
    )
    assert took == pytest.approx(
        0.7 + pieces.SETTLING * found
    )  # 1/(0.25 0.25) = 16, the least intensity
