"""Intensity of the slope noise, per segment and in bursts at events, by likelihood or a criterion; hidden events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise, product
from typing import Literal

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.smoothing.intervals import FINE, corner_rad_s
from tcdyn.smoothing.noise_levels import Burst, Intensity
from tcdyn.smoothing.record import Stretch
from tcdyn.smoothing.state_space import likelihood, smoothed

Criterion = Literal["gcv", "discrepancy", "l-curve"]
LEFT_OUT = 3  # slowest waves of a spectrum: what a straight line is taken from says little of them
CLEAR = 100.0  # floors: bends three times as quick
FEW = 20  # waves in a stretch: no more stand out of the noise where its spectrum shows none
LONG = 4096  # samples from which on the spectral likelihood replaces the exact one
DECAYS_S = (0.1, 0.6, 3.6)
EXPONENTIAL = 50.0  # a power as good as an exponential
NEARBY = tuple(product((3.0, EXPONENTIAL), (0.55, 1.0, 1.8), (0.1, 0.32, 1.0, 3.2, 10.0)))
AFTER_S = 30.0  # length of the window in which a burst is sought
NEAR = 0.4  # spectra count from this part of the corner on: the error is made there, not at the slow end
PAST = 20.0  # nats: a likelihood that has fallen by so much does not rise again
ALIKE = 1e-4  # nats within which the first of several bursts is as likely as any
BANDS = 1500  # of a spectrum, evenly in the logarithm of the frequency: of nearly one shape each
JUMPS_EACH = 3  # of so many bursts tried, one is tried with a jump, too
MOST_BENT = 3.0  # ranges of a trace within one decay of a burst: no intensity bends it more
FLOOR = 1e-6  # least intensity, in noise variances per second cubed: a trace may always bend over some ten seconds


def spectral_level(y: Array, dt_s: float, chain: Chain, noise_var: float) -> float:
    """Level q [K2/s3] of a long quiet stretch ``y (N,)`` by Whittle's likelihood at a given noise variance.

    Expected periodogram: noise_var + q |G|^2 / (w^4 dt), Hann taper, straight line removed.
    """
    n = len(y)
    t = np.linspace(-1, 1, n)
    power = np.abs(np.fft.rfft((y - y.mean() - t @ y / (t @ t) * t) * _taper(n))) ** 2
    keep = slice(LEFT_OUT, int(0.45 * n))
    power = power[keep]
    w = 2 * np.pi * np.asarray(np.fft.rfftfreq(n, dt_s), dtype=float)[keep]
    level = _whittle(power, w, dt_s, chain, noise_var)
    for _ in range(3):
        band = NEAR * float(corner_rad_s(chain, np.array(level / (noise_var * dt_s))))
        near = int(np.searchsorted(w, band, side="right"))
        if len(w) - near < 100:
            break
        refined = _whittle(power[near:], w[near:], dt_s, chain, noise_var)
        if float(corner_rad_s(chain, np.array(refined / (noise_var * dt_s)))) < band:
            break  # noise only is left there: what the trace does stands below, in a line, say
        level = refined
    return level


@lru_cache(maxsize=2)
def _taper(n: int) -> Array:
    """Hann's taper (n,) of unit energy, remembered for the other channels."""
    taper = np.hanning(n + 1)[:-1]
    return np.asarray(taper / np.linalg.norm(taper))


def _whittle(power: Array, w: Array, dt_s: float, chain: Chain, noise_var: float) -> float:
    """The q that maximises -sum(log e + power / e), e = noise_var + q shape, over bands of nearly one shape.

    ``power`` (F,) at ``w`` (F,) [rad/s].
    """
    logs = np.linspace(np.log(FLOOR * noise_var), np.log(1e9 * noise_var), 60)
    edges = np.unique(np.geomspace(1, len(w) + 1, BANDS).astype(int) - 1)[:-1]
    ends = np.append(edges[1:], len(w))
    count = ends - edges
    middle_w = np.sqrt(w[edges] * w[ends - 1])
    middle = np.abs(chain.frequency_response(middle_w / (2 * np.pi))) ** 2 / (middle_w**4 * dt_s)
    mean = np.add.reduceat(power, edges) / count
    for _ in range(3):
        expected = noise_var + np.exp(logs)[:, None] * middle
        best = int(np.argmin((np.log(expected) + mean / expected) @ count))
        logs = np.linspace(logs[max(best - 1, 0)], logs[min(best + 1, len(logs) - 1)], 9)
    return float(np.exp(logs[4]))


def exact_levels(
    stretch: Stretch, noise_var: Array, noise_known: bool, most: float = 1e8, trials: int = 14
) -> tuple[Array, Array]:
    """Level q (M,) [K2/s3] and noise variance (M,) of a short stretch by the exact likelihood, noise profiled out.

    ``trials`` levels up to ``most``, in noise variances per second cubed, are tried first.
    """
    logs = np.tile(np.linspace(np.log(FLOOR), np.log(most), trials), (len(noise_var), 1))

    def tried(logs: Array, fine: float) -> tuple[Array, Array]:
        proposed = [
            [Intensity((0.0,), (v * r,)) for v in np.exp(row)] for row, r in zip(logs, noise_var)
        ]
        value, ratio = likelihood(stretch, noise_var, proposed, fine)
        if not noise_known:
            used = (stretch.weight > 0).sum(axis=0)[:, None]
            free = used - 2 - len(stretch.events_s)
            value = value + 0.5 * ratio * free - 0.5 * free * (1 + np.log(np.maximum(ratio, 1e-12)))
        return value, ratio

    for turn in range(3):
        parts: list[
            tuple[Array, Array]
        ] = []  # the highest levels need the shortest cells: not where all is past
        for some in np.array_split(logs, 3 if turn == 0 else 1, axis=1):
            parts.append(tried(some, FINE if turn else 4 * FINE))
            value, ratio = (np.concatenate(of, axis=1) for of in zip(*parts))
            if np.all(value[:, -1] < value.max(axis=1) - PAST):
                break
        best = np.argmax(value, axis=1)
        rows = np.arange(len(best))
        scale = np.ones(len(best)) if noise_known else ratio[rows, best]
        step = logs[:, 1] - logs[:, 0]
        top = logs[rows, best]
        logs = np.clip(
            top[:, None] + step[:, None] * np.linspace(-0.8, 0.8, 7), np.log(FLOOR), None
        )
    return np.exp(top) * noise_var * scale, noise_var * scale


def choose(
    stretch: Stretch, noise_var: Array, noise_known: bool = False
) -> tuple[list[Intensity], Array]:
    """The intensity of each channel and its noise variance (M,), both by likelihood.

    ``levels_of`` its segments; then each event gets the burst that the samples around it make likely, and a jump of the
    temperature itself where that is likelier still.
    """
    chosen, noise_var = levels_of(stretch, noise_var, noise_known)
    for event in stretch.events_s:
        window, shift = _around(stretch, event)
        base = [replace(q, bursts=()).moved(shift_s=shift) for q in chosen]
        found = likeliest_burst(
            window, noise_var, base, [Burst(event - shift, 0.0, 1.0)] * len(base), jumps=True
        )
        chosen = [
            replace(q, bursts=(*q.bursts, replace(b, start_s=event))) for q, b in zip(chosen, found)
        ]
    return chosen, noise_var


def levels_of(
    stretch: Stretch, noise_var: Array, noise_known: bool
) -> tuple[list[Intensity], Array]:
    """Intensity of each channel without bursts, and its noise variance (M,).

    Segments lie between events. Long ones get their level from the spectrum, beyond the burst that follows an event,
    short ones from the exact likelihood.
    """
    n = len(stretch.y)
    dt = stretch.dt_s
    starts = [0.0, *stretch.events_s]
    cuts = [int(np.ceil(t / dt)) for t in starts] + [n]
    levels = np.full((len(starts), len(noise_var)), np.nan)
    if n < LONG and len(starts) == 1:
        levels[0], noise_var = exact_levels(stretch, noise_var, noise_known)
    else:
        for k, (a, b) in enumerate(pairwise(cuts)):
            skip = 0 if k == 0 else int(min(AFTER_S / dt, (b - a) / 2))
            if b - a - skip < 64:
                continue
            if b - a - skip >= LONG:
                window = cut_out(stretch, a + skip, b, ())
                found = [
                    spectral_level(window.y[:, c], dt, s, noise_var[c])
                    for c, s in enumerate(stretch.chains)
                ]
                levels[k] = found
                whole = 2 * np.pi / (len(window.y) * dt)
                least = levels[k] < dt * (FEW * whole) ** 4 * noise_var
                if (
                    least.any() and (LEFT_OUT * whole) ** 4 > FLOOR / dt
                ):  # what it does may stand in waves left out
                    exactly, _ = exact_levels(
                        window, noise_var, True, 16 * (FEW * whole) ** 4 * dt, 8
                    )
                    levels[k] = np.where(
                        least & (exactly > CLEAR * FLOOR * noise_var), exactly, levels[k]
                    )
            else:
                levels[k], _ = exact_levels(cut_out(stretch, a + skip, b, ()), noise_var, True)
        most = np.where(np.isfinite(levels), levels, -np.inf).max(axis=0)
        most = np.where(np.isfinite(most), most, noise_var)
        levels = np.where(
            np.isfinite(levels), levels, most
        )  # too short a segment takes the largest of the others
    return [
        Intensity(tuple(starts), tuple(levels[:, c])) for c in range(levels.shape[1])
    ], noise_var


def cut_out(stretch: Stretch, first: int, last: int, events: Sequence[float]) -> Stretch:
    """Samples first..last-1 as a stretch of its own, its clock starting at zero, with those of ``events`` in it."""
    shift = first * stretch.dt_s
    length = (last - first) * stretch.dt_s
    rows = slice(first, last)
    inside = tuple(e - shift for e in events if 0 <= e - shift < length)
    cut = {name: getattr(stretch, name)[rows] for name in ("y", "weight", "flags")}
    return replace(stretch, **cut, events_s=inside)


def likeliest_burst(
    window: Stretch,
    noise_var: Array,
    base: Sequence[Intensity],
    nothing: Sequence[Burst],
    near: bool = False,
    jumps: bool = False,
) -> list[Burst]:
    """For each channel the likeliest burst on top of ``base``, like ``nothing`` but in height, decay and power.

    ``nothing`` itself if none makes the data likelier; ``near``: ``nothing`` is a burst, and those near it are tried
    only; ``jumps``: one that jumps by the range of the trace is tried, too.
    """
    tried = []
    for none, var, span in zip(nothing, noise_var, spans(window, noise_var)):
        heights = np.geomspace(1e-3, 1e8, 12) * var
        sizes = [
            (h, d) for d in DECAYS_S for h in np.minimum(heights, (MOST_BENT * span) ** 2 / d**3)
        ]
        bursts = [none, *(replace(none, height=h, decay_s=d) for h, d in sizes)]
        tried.append([*bursts, *(replace(b, level_sd=span) for b in bursts[::JUMPS_EACH] if jumps)])
    best = list(nothing)
    for nearby in (
        (True,) if near else (False, True)
    ):  # where about it is, longer cells tell as well
        if nearby:
            tried = [
                [
                    replace(b, height=b.height * h, decay_s=b.decay_s * d, power=p)
                    for p, d, h in NEARBY
                ]
                for b in best
            ]
        proposed = [
            [replace(q, bursts=(*q.bursts, b)) for b in bursts] for q, bursts in zip(base, tried)
        ]
        value, _ = likelihood(
            window, noise_var, proposed, fine=(8 if not nearby else 4 if jumps else 2) * FINE
        )
        first = np.argmax(value > value.max(axis=1, keepdims=True) - ALIKE, axis=1)
        best = [bursts[k] for bursts, k in zip(tried, first)]
    return best


def smeared_s(stretch: Stretch) -> float:
    """Time over which the slowest chain, and the sampling, smear what happens at one instant [s]."""
    return max(0.0, *(s.lag_s for s in stretch.sensors)) + 4 * stretch.dt_s


def spans(stretch: Stretch, noise_var: Array) -> Array:
    """Range of each channel (M,), ten noises at least [K]."""
    return np.asarray(np.maximum(np.ptp(stretch.y, axis=0), 10 * np.sqrt(noise_var)))


def _around(stretch: Stretch, event: float) -> tuple[Stretch, float]:
    """The samples that an event can touch, no other event among them, and the time at which they start [s]."""
    dt = stretch.dt_s
    n = len(stretch.y)
    lag = max(s.lag_s for s in stretch.sensors)
    before = max([e for e in stretch.events_s if e < event], default=0.0)
    after = min([e for e in stretch.events_s if e > event], default=(n - 1) * dt)
    first = int(np.ceil(max(before, event - 10.0 - 5 * lag) / dt))
    last = min(int(min(after, event + AFTER_S + 5 * lag) / dt) + 1, n)
    return cut_out(stretch, first, last, (event,)), first * dt


@dataclass(frozen=True)
class Tradeoff:
    """The choice of weight as data, one row a trial: ``intensity (L, M)`` = noise variance / weight [K2/s3],

    ``misfit (L, M)`` mean square residual [K2], ``roughness (L, M)`` integral of x''2 [K2/s3], ``freedom (L, M)``
    trace of the influence matrix, ``chosen (M,)`` [K2/s3].
    """

    intensity: Array
    misfit: Array
    roughness: Array
    freedom: Array
    chosen: Array
    criterion: str


def by_criterion(stretch: Stretch, criterion: Criterion, trials: int) -> Tradeoff:
    """Misfit against roughness over ``trials`` intensities, evenly in their logarithm, and the one that is chosen."""
    noise_var = stretch.noise_sd**2
    levels = np.geomspace(1e-4, 1e7, trials)
    rows = []
    w = stretch.weight
    used = (stretch.weight > 0).sum(axis=0)
    for level in levels:
        states = smoothed(
            stretch, noise_var, [Intensity.constant(level * var) for var in noise_var]
        )
        misfit = np.sum(w * (stretch.y - states.read) ** 2, axis=0) / np.sum(w, axis=0)
        bends = np.diff(states.knot_slope, axis=0) ** 2 / np.diff(states.knots_s)[1:, None]
        rows.append(
            (misfit, np.sum(bends, axis=0), np.sum(w * states.read_var, axis=0) / noise_var)
        )
    misfits, roughness, freedom = (np.array(column) for column in zip(*rows))
    chosen = [
        _pick(criterion, levels, *columns)
        for columns in zip(misfits.T, roughness.T, freedom.T, used.tolist(), noise_var.tolist())
    ]
    return Tradeoff(
        levels[:, None] * noise_var,
        misfits,
        roughness,
        freedom,
        np.array(chosen) * noise_var,
        criterion,
    )


def _pick(
    criterion: Criterion,
    levels: Array,
    misfit: Array,
    roughness: Array,
    freedom: Array,
    used: int,
    noise_var: float,
) -> float:
    """Intensity over noise variance that meets the criterion, between the trials by a parabola or a straight line."""
    logs = np.log(levels)
    if criterion == "discrepancy":  # the misfit falls as the intensity rises
        return float(np.exp(np.interp(-np.log(noise_var), -np.log(misfit), logs)))
    if criterion == "gcv":
        score = np.log(misfit / (1 - freedom / used) ** 2)
    else:
        a = np.log(misfit)
        b = np.log(np.maximum(roughness, 1e-300))
        da = np.gradient(a, logs)
        db = np.gradient(b, logs)
        bend = (da * np.gradient(db, logs) - db * np.gradient(da, logs)) / (da**2 + db**2) ** 1.5
        score = -np.abs(bend)
        score[:2] = score[-2:] = np.inf
    k = int(np.argmin(score))
    if criterion == "l-curve" or k in (0, len(levels) - 1):
        return float(levels[k])
    c2, c1, _ = np.polyfit(logs[k - 1 : k + 2] - logs[k], score[k - 1 : k + 2], 2)
    return float(levels[k] * np.exp(np.clip(-c1 / (2 * c2), -1, 1)))
