"""Blocks that continue from the state of the filter: what one pass over all rows would give."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import Intensity
from tcdyn.smoothing.process_noise import segment
from tcdyn.smoothing.record import Record, Start, record_of
from tcdyn.smoothing.running import Running, _from_start, smooth_block
from tcdyn.smoothing.state_space import smooth_record, state_at

Array = NDArray[np.float64]
DT_S = 0.02
NOISE_K = 0.05
CHAINS = {
    "one lag": Chain(0.5),
    "two lags and a filter": Chain((0.5, 0.1), conditioning=Conditioning(4.0, 2)),
    "dead time of whole samples": Chain(0.5, delay_s=5 * DT_S),
    "dead time between samples": Chain(0.5, delay_s=5.4 * DT_S),
}


def record(chain: Chain, count: int, seed: int = 0) -> Record:
    """A walk behind a chain, with lost readings."""
    rng = np.random.default_rng(seed)
    truth = 80 + np.cumsum(np.cumsum(rng.normal(0, 0.01, count)))
    y = chain.response(truth, DT_S) + rng.normal(0, NOISE_K, count)
    y[rng.integers(0, count, count // 20)] = np.nan
    return record_of(y, DT_S, chain, (), NOISE_K)


def start_at(whole: Record, intensity: Intensity, sample: int) -> Start:
    """What the rows before a sample tell."""
    before = segment(whole, 0, sample + 1, ())
    fit = smooth_record(before, whole.noise_sd**2, [intensity])
    means, factors = state_at(fit, sample)
    return Start(means, factors, np.zeros(1), sample)


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_a_record_that_continues_is_smoothed_as_the_whole_is(chain: Chain) -> None:
    """Level, slope, their covariance and the sensitivity to the lag; to 1e-6 of a deviation."""
    whole = record(chain, 300)
    intensity = Intensity.constant(2.0)
    expected = smooth_record(whole, whole.noise_sd**2, [intensity])
    sample = 170
    # the readings of states before the sample are part of the start
    rows = sample + max(int(np.ceil(chain.delay_s / DT_S - 1e-6)), 1)
    fit = smooth_record(segment(whole, 0, rows, ()), whole.noise_sd**2, [intensity])
    means, factors = state_at(fit, sample)
    rest = _from_start(whole, sample, Start(means, factors, np.zeros(1), sample))
    found = smooth_record(rest, whole.noise_sd**2, [intensity])
    mine, theirs = found.at_samples(), expected.at_samples()
    later = slice(sample, None)
    assert np.allclose(mine.sd, theirs.sd[later], rtol=1e-6)
    assert np.all(np.abs(mine.temperature - theirs.temperature[later]) < 1e-6 * mine.sd)
    inside = slice(1, None)  # a rate at the first sample has no sample before it
    assert np.allclose(mine.slope[inside], theirs.slope[later][inside], atol=1e-6)
    assert np.allclose(mine.slope_sd[inside], theirs.slope_sd[later][inside], rtol=1e-6)


def test_the_first_part_of_a_record_that_continues_keeps_its_start_and_others_have_none() -> None:
    whole = record(Chain(0.5), 200)
    rest = _from_start(whole, 100, start_at(whole, Intensity.constant(2.0), 100))
    assert segment(rest, 0, 50, ()).start is rest.start
    assert segment(rest, 10, 50, ()).start is None
    assert rest.tested_rows == 200


def blocks(y: Array, chain: Chain, size: int, after: int) -> tuple[Array, Array, list[Running]]:
    """Results, deviations and what each block passes on; learned once, in the first block."""
    x, sd, passed = [], [], list[Running]()
    running: Running | None = None
    for first in range(0, len(y) - after - size + 1, size):
        stop = first + size
        begin = max(first - 150, 0)
        origin = max(first - 1, 0)
        result, running = smooth_block(
            y[begin : stop + after, None],
            DT_S,
            [chain],
            origin - begin,
            stop - 1 - begin,
            origin,
            running,
            first == 0,
        )
        skipped = first - origin
        x.append(result.temperature[skipped : skipped + size, 0])
        sd.append(result.sd[skipped : skipped + size, 0])
        passed.append(running)
    return np.concatenate(x), np.concatenate(sd), passed


def test_blocks_of_a_steady_record_are_within_their_band() -> None:
    """A sine behind a lag, at a delay of one lag; the truth is a closed form."""
    t = DT_S * np.arange(1500)
    chain = Chain(0.5)
    w = 2.0
    lagged = np.sin(w * t - np.arctan(w * 0.5)) / np.hypot(1.0, w * 0.5)
    y = 80 + 10 * lagged + np.random.default_rng(1).normal(0, NOISE_K, len(t))
    x, sd, _ = blocks(y, chain, 100, 50)
    error = x - (80 + 10 * np.sin(w * t[: len(x)]))
    settled = slice(100, None)
    assert np.mean(np.abs(error[settled]) < 1.96 * sd[settled]) > 0.9
    assert np.sqrt(np.mean(error[settled] ** 2)) < 1.3 * np.median(sd[settled]) < 5 * NOISE_K


def test_what_a_block_passes_on_is_the_same_numbers_after_a_file() -> None:
    rng = np.random.default_rng(2)
    chain = Chain((0.5, 0.1), conditioning=Conditioning(4.0, 2))
    y = chain.response(80 + 3 * np.sin(DT_S * np.arange(600)), DT_S)
    _, _, passed = blocks(y + rng.normal(0, NOISE_K, 600), chain, 100, 50)
    for running in passed:
        again = Running.from_dict(json.loads(json.dumps(running.to_dict())))
        assert again.to_dict() == running.to_dict()
        assert again.learned.intensities == running.learned.intensities
        for mine, theirs in zip(again.start.factors, running.start.factors, strict=True):
            assert np.array_equal(mine, theirs)


def test_a_sudden_motion_contradicts_what_was_learned() -> None:
    rng = np.random.default_rng(3)
    chain = Chain(0.5)
    truth = np.full(600, 80.0)
    truth[430:] += 20 * (1 - np.exp(-DT_S * np.arange(170) / 0.5))
    y = chain.response(truth, DT_S) + rng.normal(0, NOISE_K, 600)
    _, _, passed = blocks(y, chain, 100, 50)
    assert [running.is_contradicted for running in passed[:3]] == [False, False, False]
    assert any(running.is_contradicted for running in passed[3:])


def test_an_intensity_that_is_continued_keeps_what_is_not_over() -> None:
    intensity = Intensity((0.0, 2.0, 5.0), (1.0, 4.0, 9.0), level_noise=(0.1, 0.2, 0.3))
    later = intensity.continued(3.0)
    assert later.starts_s == (0.0, 2.0)
    assert later.levels == (4.0, 9.0)
    assert later.level_noise == (0.2, 0.3)
    assert intensity.continued(7.0) == replace(
        intensity, starts_s=(0.0,), levels=(9.0,), level_noise=(0.3,)
    )
