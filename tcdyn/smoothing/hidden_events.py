"""Events that nobody announced: where a jump would help, what it may have been, and the mean over all it may be."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from tcdyn.core import Array
from tcdyn.smoothing.intervals import FINE
from tcdyn.smoothing.noise_levels import Burst, Intensity
from tcdyn.smoothing.process_noise import (
    AFTER_S,
    DECAYS_S,
    cut_out,
    levels_of,
    likeliest_burst,
    smeared_s,
    spans,
)
from tcdyn.smoothing.record import Stretch
from tcdyn.smoothing.state_space import DIFFUSE, Smoothed, likelihood, smoothed

# false candidates in a record: without events, and where there are some
CHANCE = 0.05
AGAIN = 1.0
ALONE = 6.0  # lags about an event within which the score test sees that event only
BEYOND = 1.0  # lags: a window ends soon after the next event, unless that is as near as this
NEVER = -5.0  # log odds below which what came up is a doubt before all others are in place
# of search; events sought in one record
ROUNDS = 8
MOST = 24
COST = 3.0  # nats that fitting the height, decay and power of a burst to noise gains
PRIOR = (0.5, 0.4, 0.1)  # in a channel at an event: nothing, a kink, a jump of the temperature
# times tried at first; later, over so many standard deviations either side
WIDE = 13
NODES = 7
REACH = 2.5
FEWEST = 0.01  # weights below this part are left out


@dataclass(frozen=True)
class Hidden:
    """An event that nobody announced: likeliest time and its standard uncertainty [s], log odds that there is one.

    ``kinds``: each channel's burst (M,) if it was a kink, and if a jump; ``likeliest`` (M,) of these; ``may_be``:
    times, bursts (M,) and weights (M,) of all that may have been; ``level (M,)`` [K2/s3] of the intensity before and
    after if nothing was.
    """

    at_s: float
    u_s: float
    log_odds: float
    kinds: tuple[tuple[Burst, ...], ...]
    likeliest: tuple[Burst, ...]
    may_be: tuple[tuple[float, tuple[Burst, ...], Array], ...]
    level: Array

    def put(
        self, chosen: Sequence[Intensity], at_s: float, bursts: Sequence[Burst]
    ) -> list[Intensity]:
        """Intensities with these ``bursts`` at ``at_s`` instead of what they have at the event."""
        rest = [q.moved(self.at_s, at_s) for q in _bare(chosen, self.at_s)]
        return [replace(q, bursts=(*q.bursts, b)) for q, b in zip(rest, bursts)]

    def without(self, chosen: Sequence[Intensity]) -> list[Intensity]:
        """Intensities as if nothing had been."""
        return [_merged(q, self.at_s, v) for q, v in zip(_bare(chosen, self.at_s), self.level)]


def _bare(chosen: Sequence[Intensity], at_s: float) -> list[Intensity]:
    """Without the bursts that start at ``at_s``."""
    return [replace(q, bursts=tuple(b for b in q.bursts if b.start_s != at_s)) for q in chosen]


def _merged(q: Intensity, at_s: float, level: float) -> Intensity:
    """With one ``level`` before and after the segment boundary at ``at_s``, if there is one."""
    where = q.starts_s.index(at_s) if at_s in q.starts_s else -9
    return replace(
        q, levels=tuple(level if i in (where - 1, where) else v for i, v in enumerate(q.levels))
    )


def candidates(fit: Smoothed, events: Sequence[float]) -> list[float]:
    """Times [s], none near ``events``, at which a jump would help more than chance does: the best of each place."""
    knots = fit.knots_s[:-1]
    lag = smeared_s(fit.record)
    score = np.max(fit.jump_chi2, axis=1)
    score[:3] = score[-3:] = 0.0
    least = 2 * np.log(fit.jump_chi2.size / (AGAIN if events else CHANCE))
    found: list[float] = []
    for event in events:
        score[np.abs(knots - event) < ALONE * lag] = 0.0
    while score.max() > least:
        found.append(float(knots[int(np.argmax(score))]))
        score[np.abs(knots - found[-1]) < ALONE * lag] = 0.0
    return found


def with_hidden(
    fit: Smoothed, start_var: Array, noise_known: bool
) -> tuple[Smoothed, list[Hidden]]:
    """``fit`` with the events that its data ask for, each as it most likely was, and all that they may have been.

    All candidates are put in at once and weighed in turn, so that none hides another in a level that is too high;
    then again until no more come up; what the data do not ask for once all others are in place is a doubt.
    """
    record = fit.record
    plain = fit.chosen
    noise_var = fit.noise_var
    lag = smeared_s(record)
    told = set(record.events_s)
    sure: list[Hidden] = []
    doubts: list[Hidden] = []
    original = fit
    settled = False
    hopeful = True
    for _ in range(ROUNDS):
        known = [*told, *(h.at_s for h in (*sure, *doubts))]
        new = candidates(fit, known)[: MOST - len(sure)] if hopeful else []
        if not new and (settled or not sure):
            break
        settled = not new
        final = not new
        early = [
            max(c - 0.5 * lag, 2 * record.dt_s) for c in new
        ]  # rough at first: from before it, anything goes
        bursts = [[b for b in q.bursts if b.start_s in told] for q in fit.chosen]
        for c, span in enumerate(spans(record, noise_var)):
            bursts[c] += [
                Burst(at, 100 * span**2 / lag**3, lag, slope_sd=span / lag) for at in early
            ]
            bursts[c] += [h.likeliest[c] for h in sure]
        times = sorted([*(h.at_s for h in sure), *early])
        cuts: dict[
            float, float
        ] = {}  # what begins may have begun a little earlier, though not before what went before
        for at in times:
            last = max([0.0, *cuts, *(e for e in told if e < at)])
            cuts[min(max(at - lag, last + record.dt_s), at)] = at
        apart = replace(record, events_s=tuple(sorted((*told, *cuts))))
        levels, noise_var = levels_of(apart, start_var, noise_known)
        starts = tuple(cuts.get(s, s) for s in levels[0].starts_s)
        chosen = [replace(q, starts_s=starts, bursts=tuple(b)) for q, b in zip(levels, bursts)]
        before = {h.at_s: h for h in sure}
        sure = []
        for at in times:
            if not final and at in before and min(abs(at - e) for e in early) > ALONE * lag:
                sure.append(before[at])
                continue
            h = weigh(
                record, noise_var, chosen, at, [float(q.at(at)) for q in plain], before.get(at)
            )
            chosen = [q.moved(at, h.at_s) for q in chosen]
            if h.log_odds > (0 if final else NEVER):
                sure.append(h)
                chosen = h.put(chosen, h.at_s, h.likeliest)
            else:
                doubts.append(h)
                chosen = h.without(chosen)
                settled = False
        hopeful = final or len(sure) > len(before)
        fit = smoothed(record, noise_var, chosen) if sure else original
    return fit, [h for h in (*sure, *doubts) if h.may_be]


def about(record: Stretch, at_s: float, others_s: Iterable[float] = ()) -> tuple[int, int]:
    """First sample that an event at ``at_s`` touches, and the one after the last; not far beyond the next event."""
    dt = record.dt_s
    lag = smeared_s(record)
    first = max(int(np.ceil((at_s - 5.0 - 5 * lag) / dt)), 0)
    after = min([at_s + AFTER_S, *(e for e in others_s if e > at_s + BEYOND * lag)])
    return first, min(int((after + 5 * lag) / dt) + 1, len(record.y))


def weigh(
    record: Stretch,
    noise_var: Array,
    chosen: Sequence[Intensity],
    at_s: float,
    plain: Sequence[float],
    known: Hidden | None = None,
) -> Hidden:
    """What happened at about ``at_s``: nothing, a kink, or a jump of the temperature, and at which time.

    ``chosen`` has a segment that begins there; its level, had nothing happened, lies between those of the two segments
    and ``plain`` (M,). Jumps are normal, by the range of the trace, those of the slope by ten ranges per lag, each with
    the likeliest burst; what time it was has the same chance anywhere in the record. ``known``: what was said of it
    before; all is sought near it.
    """
    first, last = about(record, at_s, chosen[0].starts_s)
    shift = first * record.dt_s
    lag = smeared_s(record)
    window = cut_out(record, first, last, record.events_s)
    base = [q.moved(shift_s=shift) for q in _bare(chosen, at_s)]
    begins = at_s - shift
    ranges = spans(window, noise_var)
    kinds = [
        [Burst(begins, 0.0, 1.0, level_sd=jump * s, slope_sd=DIFFUSE * s / lag) for s in ranges]
        for jump in (0.0, 1.0)
    ]

    def values(times: Array, options: Sequence[Sequence[Burst]]) -> Array:
        """Log likelihood (M, times, options), the event moved to each time."""
        proposed = [
            [replace(q, bursts=(*q.bursts, b)).moved(begins, t) for t in times for b in bursts]
            for q, bursts in zip(base, zip(*options))
        ]
        return likelihood(window, noise_var, proposed, 2 * FINE)[0].reshape(
            len(base), len(times), -1
        )

    dt = record.dt_s
    lowest = max([e for e in chosen[0].starts_s if e < at_s], default=0.0) - shift + dt
    highest = (
        min([e for e in chosen[0].starts_s if e > at_s], default=dt * len(record.y)) - shift - dt
    )

    def between(nodes: ArrayLike) -> Array:
        """Such of ``nodes`` [s] as lie between what happened before and after, none too near another."""
        return np.asarray(
            np.unique(np.round(np.clip(nodes, lowest, max(lowest, highest)) / (1e-4 * dt)))
            * (1e-4 * dt)
        )

    if known is None:
        sizes = [(0.0, 1.0), *((0.1 / d**3, d) for d in DECAYS_S)]
        rough = [
            [replace(b, height=h * s**2, decay_s=d) for b, s in zip(kind, ranges)]
            for kind in kinds
            for h, d in sizes
        ]
        step = 2 * lag / (WIDE - 1)
        nodes = between(begins + step * (np.arange(WIDE) - WIDE // 2))
        value = values(nodes, rough).reshape(len(base), len(nodes), 2, -1)
        top = np.argmax(logsumexp(value, axis=3).sum(axis=0), axis=0)
        kinds = [
            [
                rough[k * len(sizes) + int(np.argmax(value[c, top[k], k]))][c]
                for c in range(len(base))
            ]
            for k in (0, 1)
        ]
        best = [float(t) for t in nodes[top]]
        u = [0.5 * step] * 2
    else:
        kinds = [[replace(b, start_s=begins) for b in kind] for kind in known.kinds]
        best = [begins] * 2
        u = [2 * known.u_s + 0.02 * lag] * 2
    bursts = []
    for kind, t in zip(kinds, best):
        there = [q.moved(begins, t) for q in base]
        nothing = [replace(b, start_s=t) for b in kind]
        near = known is not None and min(b.height for b in kind) > 0
        found = likeliest_burst(window, noise_var, there, nothing, near)
        bursts.append([replace(b, start_s=begins) for b in found])
    for _ in range(3):
        nodes = between(
            np.ravel([np.linspace(t - REACH * h, t + REACH * h, NODES) for t, h in zip(best, u)])
        )
        # a kink and a jump may lie apart
        value = values(nodes, bursts)
        widest = 2 * REACH * max(u) / (NODES - 1)
        gaps = np.minimum(
            np.diff(nodes, prepend=nodes[0] - widest, append=nodes[-1] + widest), widest
        )
        width = 0.5 * (gaps[:-1] + gaps[1:])
        for k, total in enumerate(value.sum(axis=0).T):
            share = np.exp(total - total.max()) * width
            best[k] = float(share @ nodes / share.sum())
            spread = float(np.sqrt(share @ (nodes - best[k]) ** 2 / share.sum()))
            u[k] = float(np.clip(spread, 0.01 * record.dt_s, lag))

    some = np.stack([[*_levels_about(q, begins), p] for q, p in zip(base, plain)])
    levels = np.geomspace(some.min(axis=1), some.max(axis=1), NODES, axis=1)
    merged = [[_merged(q, begins, v) for v in row] for q, row in zip(base, levels)]
    without = likelihood(window, noise_var, merged, 2 * FINE)[0]
    level = np.take_along_axis(levels, np.argmax(without, axis=1)[:, None], axis=1)[:, 0]
    gain = value - COST - without.max(axis=1)[:, None, None]
    each = np.concatenate([np.zeros_like(gain[..., :1]), gain], axis=2) + np.log(PRIOR)
    density = logsumexp(each, axis=2)
    log_p = density.sum(axis=0) + np.log(width / (len(record.y) * record.dt_s))
    log_odds = float(logsumexp(log_p))
    p = np.exp(log_p - log_odds)
    weight = (
        np.exp(each - density[..., None]) * (p / (1 + np.exp(-log_odds)))[:, None]
    )  # (M, times, kinds)
    likely = int(np.argmax(log_p))
    placed = [
        [tuple(replace(b, start_s=float(t) + shift) for b in kind) for kind in bursts]
        for t in nodes
    ]
    return Hidden(
        at_s=float(nodes[likely]) + shift,
        u_s=float(np.sqrt(p @ (nodes - p @ nodes) ** 2)),
        log_odds=log_odds,
        kinds=tuple(placed[likely]),
        likeliest=tuple(
            placed[likely][k][c] for c, k in enumerate(np.argmax(weight[:, likely, 1:], axis=1))
        ),
        may_be=tuple(
            (float(t) + shift, placed[i][k], weight[:, i, k + 1])
            for i, t in enumerate(nodes)
            for k in range(2)
            if weight[:, i, k + 1].max() > FEWEST
        ),
        level=level,
    )


def _levels_about(q: Intensity, at_s: float) -> tuple[float, ...]:
    """Levels before and after the segment boundary at ``at_s``."""
    where = q.starts_s.index(at_s)
    return q.levels[where - 1 : where + 1]


def averaged(fit: Smoothed, hidden: Hidden) -> Smoothed:
    """``fit`` with its temperature, slope and sd averaged over all that ``hidden`` may be, by total variance."""
    first, last = about(fit.record, hidden.at_s)
    window, shift = (
        cut_out(fit.record, first, last, fit.record.events_s),
        first * fit.record.dt_s,
    )

    def run(chosen: Sequence[Intensity]) -> Array:
        part = smoothed(window, fit.noise_var, [q.moved(shift_s=shift) for q in chosen])
        return np.stack([part.temperature, part.slope, part.lag_sensitivity, part.sd**2])

    start = run(fit.chosen)
    weights = [w for _, _, w in hidden.may_be]
    runs = [run(hidden.put(fit.chosen, at, bursts)) for at, bursts, _ in hidden.may_be]
    if np.max(nothing := 1 - np.sum(weights, axis=0)) > 2 * FEWEST:
        runs = [*runs, run(hidden.without(fit.chosen))]
        weights = [*weights, nothing]
    weight = np.array(weights) / np.sum(weights, axis=0)
    mean = np.einsum("hm,hknm->knm", weight, np.array(runs))
    answers = [fit.temperature.copy(), fit.slope.copy(), fit.lag_sensitivity.copy(), fit.sd**2]
    for whole, change in zip(answers, mean - start):
        whole[first:last] += change
    spread = np.einsum("hm,hnm->nm", weight, (np.array(runs)[:, 0] - mean[0]) ** 2)
    var = answers[3]
    var[first:last] = np.maximum(var[first:last] + spread, 0.25 * fit.sd[first:last] ** 2)
    return replace(
        fit,
        temperature=answers[0],
        slope=answers[1],
        lag_sensitivity=answers[2],
        sd=np.asarray(np.sqrt(var)),
    )
