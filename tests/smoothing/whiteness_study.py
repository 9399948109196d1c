"""Whether the innovations of the smoother show that the chain is wrong.

`python -m tests.smoothing.whiteness_study [RECORDS] [SEED]` prints one line for each temperature
and error of the chain: coverage of the 95 % band, rms error, rms of the standard uncertainties, and
of the innovations over their standard deviations the variance, the correlation of neighbours and
the power in the lowest fiftieth of all frequencies (1, 0 and 1 for the right model).

The readings come from ``tests.smoothing.event_fault_study``. The innovations are those of a Kalman
filter in dense matrices, with the intensities and events of the result.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.estimation.kalman import _noise_factor
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.smoother import likeliest, smooth
from tcdyn.smoothing.state_space import Smoothed, channel_ranges, point_models
from tests.smoothing.event_fault_study import DT_S, FINE, World, jump, plain, readings_of

# true lags [s], and the one that the chain has, "known"
CHAINS = {
    "right": ((2.0,), 2.0),
    "lag 10 % long": ((2.0,), 2.2),
    "lag 10 % short": ((2.0,), 1.8),
    "2 and 0.5 s as 2.5 s": ((2.0, 0.5), 2.5),
    "1 and 1 s as 2 s": ((1.0, 1.0), 2.0),
}
KINDS = {"ramp": 1, "wave": 2, "Ornstein-Uhlenbeck": 3, "heating": 4}


class Seen(NamedTuple):
    """What one record shows."""

    coverage: float
    square_K2: float
    var_K2: float
    variance: float
    neighbours: float
    low: float


def innovations(fit: Smoothed) -> Array:
    """Innovations of the first channel, each over its standard deviation."""
    span = float(channel_ranges(fit.record)[0])
    variance = float(fit.noise_var[0])
    _, (model,) = point_models(fit.record, 0, variance, [fit.intensities[0]], span)
    mean = model.mean.copy()
    covariance = model.factor @ model.factor.T
    factor = np.zeros_like(covariance)
    found = []
    for p, kind in enumerate(model.kind.tolist()):
        if model.variance[p] > 0:
            var = model.row @ covariance @ model.row + model.variance[p]
            error = model.reading[p] - model.row @ mean
            found.append(error / np.sqrt(var))
            gain = covariance @ model.row / var
            mean = mean + gain * error
            covariance = covariance - var * np.outer(gain, gain)
        if p < len(model.kind) - 1:
            step = model.transition[kind]
            _noise_factor(model, p, factor)
            mean = step @ mean
            covariance = step @ covariance @ step.T + factor @ factor.T
    return np.array(found)


def world_of(kind: str, rng: np.random.Generator) -> World:
    """A temperature of a kind."""
    return jump(rng) if kind == "jump" else plain(rng, (KINDS[kind],))


def judge(kind: str, chain_name: str, index: int, seed: int) -> Seen:
    """One record."""
    rng = np.random.default_rng([seed, index])
    world = world_of(kind, rng)
    lags_s, assumed_s = CHAINS[chain_name]
    y = readings_of(world, lags_s, rng)
    chain = Chain((assumed_s,), conditioning=NO_CONDITIONING)
    result = smooth(y, DT_S, chain)
    error = result.temperature[:, 0] - world.temperature[::FINE]
    scaled = innovations(likeliest(record_of(y, DT_S, chain), True).fit)
    power = np.abs(np.fft.rfft(scaled)) ** 2 / len(scaled)
    return Seen(
        float(np.mean(np.abs(error) < 1.96 * result.sd[:, 0])),
        float(np.mean(error**2)),
        float(np.mean(result.sd[:, 0] ** 2)),
        float(np.mean(scaled**2)),
        float(np.mean(scaled[1:] * scaled[:-1])),
        float(power[1 : max(len(power) // 50, 2)].mean()),
    )


def report(records: int, seed: int) -> None:
    """Print the table."""
    print(f"{'temperature':20s} {'chain':22s} cover %  rms K    u K  variance  neighbours   low")
    for kind in (*KINDS, "jump"):
        for name in CHAINS:
            seen = Seen(*np.mean([judge(kind, name, k, seed) for k in range(records)], axis=0))
            print(
                f"{kind:20s} {name:22s} {100 * seen.coverage:7.1f} {seen.square_K2**0.5:6.3f} "
                f"{seen.var_K2**0.5:6.3f}  {seen.variance:8.2f}  {seen.neighbours:+10.3f} "
                f"{seen.low:5.2f}",
                flush=True,
            )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:]]
    report(*[*numbers, *(20, 94301)[len(numbers) :]])
