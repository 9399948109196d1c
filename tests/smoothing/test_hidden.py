"""Events that nobody announced: found, told from none, and inside the band whatever they are."""

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.smoothing import Change, Intensity, smooth
from tests.smoothing.event_study import CHAIN, RATE_HZ, WORLDS, judged, logged


def test_a_jump_of_the_temperature_is_told_from_a_kink_and_its_time_is_found() -> None:
    t, truth, y, (at,) = logged(WORLDS["jump"], np.random.default_rng(1), seconds=20.0)
    done = smooth(y, 1 / RATE_HZ, CHAIN)
    ((found, u),) = done.events_s
    assert abs(found - at) < max(3 * u, 0.03)
    assert max(b.level_sd for b in done.intensities[0].changes) > 0
    off = done.temperature[:, 0] - truth
    assert (
        np.sqrt(np.mean(off[np.abs(t - at) > 2 / RATE_HZ] ** 2)) < 0.1
    )  # 0.6 K with a kink for it
    assert np.mean(np.abs(off) < 1.96 * done.sd[:, 0]) > 0.9


@pytest.mark.e2e
@pytest.mark.parametrize("world", ["quiet", "wave", "wandering"])
def test_smooth_motion_has_no_events(world: str) -> None:
    _, held, _, found, _ = judged(WORLDS[world], 3, seconds=30.0)
    assert found == 0
    assert np.mean(held) > 0.85  # one record: its samples move together, some ten of them are free


def test_given_a_jump_the_temperature_jumps_between_two_samples() -> None:
    _, truth, y, (at,) = logged(WORLDS["jump"], np.random.default_rng(2), seconds=20.0)
    free = Change(at, level_sd=10.0, slope_sd=10.0)
    kink, jump = (
        smooth(
            y,
            1 / RATE_HZ,
            CHAIN,
            noise_sd=0.12,
            intensity=Intensity((0.0,), (1e-6,), changes),
            events_s=(at,),
        )
        for changes in ((), (free,))
    )
    assert np.abs(jump.temperature[:, 0] - truth).max() < 0.2
    assert np.abs(kink.temperature[:, 0] - truth).max() > 2.0


@pytest.mark.e2e
def test_a_chain_without_lag_and_a_late_spike_do_no_harm() -> None:
    """No lag: a step is told within the noise. A spike that only the answer shows does not rouse
    the whole record."""
    rng = np.random.default_rng(3)
    y = np.where(np.arange(1500) < 700, 20.0, 30.0) + 0.1 * rng.standard_normal(1500)
    done = smooth(y, 1 / RATE_HZ, Chain((), conditioning=NO_CONDITIONING))
    assert np.abs(done.temperature[:, 0] - np.round(y, -1)).max() < 0.5
    calm = 20 + 0.1 * rng.standard_normal(5000)
    done = smooth(calm + 20.0 * (np.arange(5000) == 2500), 1 / RATE_HZ, CHAIN)
    assert np.sqrt(np.mean((done.temperature[:, 0] - 20.0) ** 2)) < 0.02


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("world", list(WORLDS))
def test_what_nobody_announced_stays_inside_the_band(world: str, draws) -> None:
    """95 % intervals within 3 s after and 1 s before each event; samples move together, hence the
    wide limits."""
    runs = [judged(WORLDS[world], seed) for seed in range(200, 200 + draws(8))]
    where = [near if near.any() else ~near for _, _, near, _, _ in runs]
    assert np.mean(np.concatenate([held[near] for (_, held, *_), near in zip(runs, where)])) > 0.9


def test_both_edges_of_a_short_pulse_are_found() -> None:
    """A pulse of 20 K for 0.4 lags."""
    dt = 1 / 75
    t = dt * np.arange(3000)
    truth = 80.0 + 20.0 * ((t >= 15.36) & (t < 15.56))
    chain = Chain((0.5,), conditioning=NO_CONDITIONING)
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(t))
    ours = smooth(chain.response(truth, dt, "zoh") + noise, dt, chain)
    error = np.abs(ours.temperature[:, 0] - truth)
    edge = np.abs(t - 15.56) < 0.03
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert (error[edge] / ours.sd[edge, 0]).max() < 3.0


@pytest.mark.e2e
def test_band_of_a_slow_drift_includes_the_uncertainty_of_its_intensity() -> None:
    """A random walk by 0.03 K below noise of 0.05 K: few degrees of freedom determine it."""
    dt = 1 / 75
    chain = Chain((0.5,), conditioning=NO_CONDITIONING)
    coverage = []
    for seed in range(12):
        rng = np.random.default_rng([17, seed])
        truth = 80.0 + 0.03 * np.cumsum(rng.standard_normal(3000)) / np.sqrt(3000)
        y = chain.response(truth, dt) + 0.05 * rng.standard_normal(3000)
        ours = smooth(y, dt, chain)
        coverage.append(np.mean(np.abs(ours.temperature[:, 0] - truth) < 1.96 * ours.sd[:, 0]))
    assert 0.88 < np.mean(coverage) < 0.99


@pytest.mark.e2e
def test_listed_edges_of_a_square_wave_are_jumps_without_noise_about_them() -> None:
    """Levels 10 K apart for one lag each; the first edge is after the first sample."""
    dt = 1 / 75
    t = dt * np.arange(1125)
    edges = np.arange(0.004, t[-1], 0.5)
    fine = dt / 16 * np.arange(16 * len(t))
    truth = 80.0 + 10.0 * (np.searchsorted(edges, fine, side="right") % 2)
    chain = Chain((0.5,), conditioning=NO_CONDITIONING)
    noise = 0.05 * np.random.default_rng(8).standard_normal(len(t))
    ours = smooth(chain.response(truth, dt / 16, "zoh")[::16] + noise, dt, chain, events_s=edges)
    error = ours.temperature[:, 0] - truth[::16]
    assert np.sqrt(np.mean(error**2)) < 0.3
    assert np.abs(error / ours.sd[:, 0]).max() < 6.0
    assert not ours.flags.any()


def test_a_record_that_ends_soon_after_an_event_is_determined() -> None:
    """A rise from 5 s on; the record ends 0.35 lags later, as a block of live compensation does."""
    dt = 0.05
    t = dt * np.arange(107)
    truth = 25.0 - 155.0 * np.expm1(-np.maximum(t - 5.0, 0.0) / 3.0)
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    clean = chain.response(truth, dt)
    for seed in (8, 24):
        y = clean + 0.2 * np.random.default_rng(seed).standard_normal(len(t))
        undetermined = smooth(y, dt, chain).undetermined
        assert undetermined is not None
        assert undetermined[:-2].sum() <= 2
