"""Events that nobody announced: found, told from none, and inside the band whatever they are."""

import numpy as np
import pytest

from tcdyn.compensate import Burst, Intensity, smooth
from tests.compensate.event_study import CHAIN, RATE_HZ, WORLDS, judged, logged


def test_a_jump_of_the_temperature_is_told_from_a_kink_and_its_time_is_found() -> None:
    t, truth, y, (at,) = logged(WORLDS["jump"], np.random.default_rng(1), seconds=20.0)
    done = smooth(y, 1 / RATE_HZ, CHAIN)
    ((found, u),) = done.events_s
    assert abs(found - at) < max(3 * u, 0.03)
    assert max(b.level_sd for b in done.intensities[0].bursts) > 0
    off = done.temperature[:, 0] - truth
    assert np.sqrt(np.mean(off[np.abs(t - at) > 2 / RATE_HZ] ** 2)) < 0.1  # 0.6 K with a kink for it
    assert np.mean(np.abs(off) < 1.96 * done.sd[:, 0]) > 0.9


@pytest.mark.parametrize("world", ["quiet", "wave", "wandering"])
def test_smooth_motion_has_no_events(world: str) -> None:
    _, held, _, found, _ = judged(WORLDS[world], 3, seconds=30.0)
    assert found == 0
    assert np.mean(held) > 0.85


def test_given_a_jump_the_temperature_jumps_between_two_samples() -> None:
    _, truth, y, (at,) = logged(WORLDS["jump"], np.random.default_rng(2), seconds=20.0)
    free = Burst(at, 0.0, 1.0, level_sd=10.0, slope_sd=10.0)
    kink, jump = (
        smooth(y, 1 / RATE_HZ, CHAIN, noise_sd=0.12, intensity=Intensity((0.0,), (1e-6,), bursts), events_s=(at,))
        for bursts in ((), (free,))
    )
    assert np.abs(jump.temperature[:, 0] - truth).max() < 0.2
    assert np.abs(kink.temperature[:, 0] - truth).max() > 2.0


@pytest.mark.slow
@pytest.mark.parametrize("world", list(WORLDS))
def test_what_nobody_announced_stays_inside_the_band(world: str, draws) -> None:
    """95 % intervals within 3 s after and 1 s before each event; samples move together, hence the wide limits."""
    runs = [judged(WORLDS[world], seed) for seed in range(200, 200 + draws(8))]
    where = [near if near.any() else ~near for _, _, near, _, _ in runs]
    assert np.mean(np.concatenate([held[near] for (_, held, *_), near in zip(runs, where)])) > 0.9
