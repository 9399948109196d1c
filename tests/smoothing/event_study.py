"""Events that nobody announced: what the batch smoother makes of them, world by world, on records
of its own making.

`python -m tests.smoothing.event_study 10 100` prints, for ten seeds from 100 on, rms error and
coverage of the 95 % intervals from 1 s before to 3 s after each event, the same elsewhere, events
found, and seconds of CPU a record.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing.smoother import smooth
from tests.partition.noise_study import before_the_filter

RATE_HZ, FINE, SECONDS, NOISE_K = 75, 16, 50.0, 0.12
LAGS_S, CUTOFF_HZ = (0.55, 0.12), 4.0
CHAIN = Chain(LAGS_S, conditioning=Conditioning(CUTOFF_HZ, 2, "cascade"))
World = Callable[[Array, np.random.Generator], tuple[Array, list[float]]]


def kinks(heights_K: tuple[float, ...], decay_s: float, apart_s: float = 8.0) -> World:
    """Towards a new level by ``heights_K`` every ``apart_s``, each with the time constant
    ``decay_s``; 0: jumps."""

    def world(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
        first = rng.uniform(10.0, 14.0)
        at = [first + k * apart_s for k in range(len(heights_K))]
        x = np.full(len(t), 80.0)
        for height, start in zip(heights_K, at):
            age = np.maximum(t - start, 0.0)
            x += height * (-np.expm1(-age / decay_s) if decay_s else t >= start)
        return x, at

    return world


def wave(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    return 80 + 3 * np.sin(2 * np.pi * t / 20 + rng.uniform(0, 6)), []


def wandering(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    """Flux that forgets itself over 3 s: the temperature wanders by some kelvin."""
    step = t[1] - t[0]
    flux = lfilter([1.0], [1.0, -np.exp(-step / 3.0)], rng.standard_normal(len(t)) * np.sqrt(step))
    return 80 + 0.3 * np.cumsum(flux) * step, []


def upon_wandering(t: Array, rng: np.random.Generator) -> tuple[Array, list[float]]:
    (x, at), base = kinks((12.0,), 1.0)(t, rng), wandering(t, rng)[0]
    return x + base - 80, at


WORLDS: dict[str, World] = {
    **{
        f"kink {h:g} K {tau:g} s": kinks((h,), tau)
        for h in (3.0, 12.0)
        for tau in (0.05, 0.3, 1.0, 5.0)
    },
    "two kinks": kinks((8.0, -8.0), 1.0),
    "four kinks": kinks((6.0, 6.0, -6.0, -6.0), 0.5),
    "jump": kinks((6.0,), 0.0),
    "square wave": kinks((5.0, -5.0) * 4, 0.0, 5.0),
    "kink, wandering": upon_wandering,
    "quiet": kinks((), 1.0),
    "wave": wave,
    "wandering": wandering,
}


def logged(
    world: World, rng: np.random.Generator, noise: str = "white", seconds: float = SECONDS
) -> tuple[Array, Array, Array, list[float]]:
    """Times, truth and noisy reading (N,), and the events, by first-order recursions on a grid
    sixteen times finer."""
    step = 1 / (RATE_HZ * FINE)
    t = np.arange(int(seconds * RATE_HZ) * FINE + 1) * step
    truth, at = world(t, rng)
    y = truth
    for tau in (*LAGS_S, *(1 / (2 * np.pi * CUTOFF_HZ),) * 2):
        keep = np.exp(-step / tau)
        share = tau / step * (1 - keep)
        y = lfilter([1 - share, share - keep], [1, -keep], y - y[0]) + y[0]
    t, truth, y = t[::FINE], truth[::FINE], y[::FINE]
    added = (
        NOISE_K * rng.standard_normal(len(t))
        if noise == "white"
        else before_the_filter(rng, len(t), NOISE_K)
    )
    return t, truth, y + added, at


def judged(
    world: World, seed: int, noise: str = "white", given: bool = False, seconds: float = SECONDS
) -> tuple[Array, Array, Array, int, float]:
    """Errors and whether their 95 % intervals hold (N,), which samples lie round events, events
    found, CPU [s]."""
    t, truth, y, at = logged(world, np.random.default_rng(seed), noise, seconds)
    begun = time.process_time()
    done = smooth(y, 1 / RATE_HZ, CHAIN, events_s=at if given else ())
    spent = time.process_time() - begun
    off, near = done.temperature[:, 0] - truth, np.zeros(len(t), dtype=bool)
    for event in at:
        near |= (t > event - 1) & (t < event + 3)
    return off, np.abs(off) < 1.96 * done.sd[:, 0], near, len(done.events_s), spent


def report(names: list[str], seeds: range, noise: str, given: bool) -> None:
    print("world               near: rms K, cover   worst   far: rms K, cover   found    CPU s")
    for name in names:
        off, held, near, found, spent = zip(
            *(judged(WORLDS[name], seed, noise, given) for seed in seeds)
        )
        e, h, close = np.concatenate(off), np.concatenate(held), np.concatenate(near)
        columns = []
        for where in (close, ~close):
            some = where.any()
            columns += (
                [np.sqrt(np.mean(e[where] ** 2)), 100 * h[where].mean()]
                if some
                else [np.nan, np.nan]
            )
        worst = min((100 * x[n].mean() for x, n in zip(held, near) if n.any()), default=np.nan)
        print(
            f"{name:18s}  {columns[0]:10.3f} {columns[1]:6.1f} % {worst:6.1f}   {columns[2]:8.3f} "
            f"{columns[3]:6.1f} %   {np.mean(found):5.1f}  {np.mean(spent):7.2f}",
            flush=True,
        )


if __name__ == "__main__":
    words = [a for a in sys.argv[1:] if not a.isdigit()]
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    count, first = [*numbers, *(8, 0)[len(numbers) :]]
    chosen = [
        name for name in WORLDS if any(w in name for w in words if w not in ("before", "given"))
    ] or list(WORLDS)
    report(
        chosen,
        range(first, first + count),
        "before" if "before" in words else "white",
        "given" in words,
    )
