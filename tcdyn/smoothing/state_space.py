"""A record as a linear model on cells of time, and its states: filtered, smoothed, with their likelihood."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tcdyn.chain import Sensor
from tcdyn.core import Array, Flags
from tcdyn.smoothing.intervals import FINE, STEPS, knots_for, pieces
from tcdyn.smoothing.noise_levels import Intensity, jumps_at, levels_at, levels_between
from tcdyn.smoothing.record import Stretch
from tcdyn.smoothing.rts import Cells, swept

DIFFUSE = 10.0  # prior sd of level, slope and slope jumps, in ranges of the record (per lag): wide, yet well scaled


def ranges(record: Stretch) -> Array:
    """Range of the good samples of each channel (M,) [K], 1 where there are none."""
    seen = [y[w > 0] for y, w in zip(record.y.T, record.weight.T)]
    return np.array([np.ptp(y) if len(y) else 1.0 for y in seen])


def cells_for(
    record: Stretch,
    noise_var: Array,
    proposals: Sequence[Sequence[Intensity]],
    knots: Array,
    span: Array,
) -> Cells:
    """The cells between ``knots``, some of or all that ``knots_for`` gives; samples in no cell are left out.

    ``span`` (M,): the ``ranges`` of the whole record.
    """
    dt = record.dt_s
    total = len(record.y)
    keys = np.round(np.column_stack([np.diff(knots) / dt, (knots[:-1] / dt) % 1.0]), 6)
    keys[:, 1] %= 1.0
    _, example, kind = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    kind = kind.reshape(-1)
    event: Flags = np.isin(knots[:-1], record.events_s)
    channels: list[tuple[Array, ...]] = []
    rows = []
    for c, s in enumerate(record.sensors):
        first = np.ceil((knots + s.delay_s) / dt - 1e-6).astype(int)
        low, high = np.clip(first[[0, -1]], 0, total)
        weight = record.weight[low:high, c]
        trace = record.y[low:high, c]
        n = len(s.output)
        w = np.append(weight / noise_var[c], 0.0)
        y = np.append(trace, 0.0)
        info_c = np.zeros((len(kind), n, n))
        score_c = np.zeros((len(kind), n))
        rows_c = []
        for k, j in enumerate(example):
            if first[j + 1] <= first[j]:
                continue
            ahead = first[j] * dt - s.delay_s - knots[j]
            read = s.output @ flow(s.drift, ahead) @ flows(s.drift, dt)[: first[j + 1] - first[j]]
            where = np.flatnonzero(kind == k)
            sample = first[where][:, None] + np.arange(len(read))
            inside = (sample >= low) & (sample < high)
            at = np.where(inside, sample - low, high - low)
            info_c[where] = (w[at] @ _squares(read)).reshape(-1, n, n)
            score_c[where] = (w[at] * y[at]) @ read
            rows_c.append((where, read, np.where(inside, sample, total)))
        seen = trace[weight > 0]
        level = float(seen[0]) if len(seen) else 0.0
        added = levels_between(proposals[c], knots).T
        least = 10 * float(np.sqrt(noise_var[c]))
        begun = levels_at(proposals[c], np.maximum(knots[:1], 0.0))[:, 0]
        mean, cov, jump_var = prior(s, level, max(float(span[c]), least), dt, begun)
        at_knot = 0.5 * (added + np.concatenate([np.zeros_like(added[:1]), added[:-1]]))
        at_knot[event] += jump_var
        jumps = jumps_at(proposals[c], knots[:-1])
        jumps[..., 1] += at_knot
        channels.append(
            (np.tile(mean, (len(cov), 1)), cov, info_c[:, None], score_c[:, None], jumps)
        )
        rows.append(tuple(rows_c))
    lengths = np.diff(knots)[example]
    across = np.stack(
        [np.stack([flow(s.drift, float(h)) for s in record.sensors]) for h in lengths]
    )[:, :, None]
    mean0, cov0, information, score, jumps_var = zip(*channels)
    return Cells(
        knots,
        kind,
        np.stack(mean0),
        np.stack(cov0),
        across,
        np.stack(information, axis=1),
        np.stack(score, axis=1),
        np.stack(jumps_var, axis=1),
        tuple(rows),
    )


def _squares(rows: Array) -> Array:
    """o o' of each row o of ``rows`` (R, n), flat (R, n n)."""
    return (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)


def all_cells(
    record: Stretch, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> Cells:
    """Cells of the whole record."""
    return cells_for(
        record,
        noise_var,
        proposals,
        knots_for(record, noise_var, proposals, fine),
        ranges(record),
    )


def prior(
    s: Sensor, level: float, span: float, dt_s: float, intensity: Array
) -> tuple[Array, Array, float]:
    """Mean (n,) and covariances (Q, n, n) of the state of a chain that has followed a ramp for ever.

    Its level [degC] is about ``level``, its slope about zero, as loosely as a record asks that covers ``span`` [K]; the
    stages scatter about the ramp as slope noise of ``intensity`` (Q,) [K2/s3] lets them. Last, the slope's variance.
    """
    wide = DIFFUSE * span * np.array([1.0, 1.0 / (s.lag_s + 4 * dt_s)])
    cov = s.ramp * wide**2 @ s.ramp.T + intensity[:, None, None] * s.scatter
    return level * s.ramp[:, 0], cov, float(wide[1] ** 2)


def flow(drift: Array, time_s: float) -> Array:
    """expm(drift time_s), remembered: channels and windows share their chains and their cells."""
    return _flow(drift.tobytes(), len(drift), round(time_s, 12))


def flows(drift: Array, dt_s: float) -> Array:
    """expm(drift k dt_s) for every k (K, n, n) that a cell has samples, remembered."""
    return _flows(drift.tobytes(), len(drift), dt_s)


@lru_cache(maxsize=200)
def _flows(drift: bytes, n: int, dt_s: float) -> Array:
    one = flow(np.frombuffer(drift).reshape(n, n), dt_s)
    powers = [np.eye(n)]
    while len(powers) <= STEPS[-1] + 1:
        powers.append(powers[-1] @ one)
    return np.array(powers)


@lru_cache(maxsize=20_000)
def _flow(drift: bytes, n: int, time_s: float) -> Array:
    result = np.asarray(expm(np.frombuffer(drift).reshape(n, n) * time_s))
    result.setflags(write=False)
    return result


def filtered(cells: Cells) -> Iterator[tuple[Array, ...]]:
    """The information-form Kalman filter, cell by cell: P+ = (I + P L)^-1 P, m+ = m + P+ (s - L m).

    Yields, for all channels and proposals (M, Q): mean before the cell's samples, its step, I + P L, and the surprise
    s - L m.
    """
    mean = cells.mean0
    cov = cells.cov0.copy()
    # what all proposals share is one product
    eye = np.eye(cov.shape[-1])
    rows = (len(cov), -1, cov.shape[-1])
    for j, kind in enumerate(cells.kind):
        cov[..., 0, 0] += cells.jump_var[j, ..., 0]
        cov[..., 1, 1] += cells.jump_var[j, ..., 1]
        info = cells.information[j, :, 0]
        back = cells.transition[kind, :, 0].swapaxes(-1, -2)
        gain = (cov.reshape(rows) @ info).reshape(cov.shape) + eye
        surprise = cells.score[j] - mean @ info
        cov = np.linalg.inv(gain) @ cov
        step = (cov @ surprise[..., None])[..., 0]
        yield mean, step, gain, surprise
        mean = (mean + step) @ back
        for _ in range(2):  # A P A' = ((P A')' A')', which is symmetric
            cov = (cov.swapaxes(-1, -2).reshape(rows) @ back).reshape(cov.shape)


def likelihood(
    record: Stretch, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> tuple[Array, Array]:
    """Log likelihood (M, Q) at the given noise, and the ratio (M, Q) by which each would scale the noise variance."""
    cells = all_cells(record, noise_var, proposals, fine)
    log_det = np.zeros(cells.mean0.shape[:2])
    quad = np.zeros(cells.mean0.shape[:2])
    for (mean, step, gain, surprise), score in zip(filtered(cells), cells.score):
        sign, size = np.linalg.slogdet(gain)
        log_det += np.where(
            sign > 0, size, np.inf
        )  # lost to rounding: an intensity that no data ask for
        quad -= ((score + surprise) * mean + surprise * step).sum(axis=-1)
    used = (record.weight > 0).sum(axis=0)
    total = quad + ((record.weight * record.y**2).sum(axis=0) / noise_var)[:, None]
    value = -0.5 * (log_det + total + (used * np.log(noise_var))[:, None])
    return value, total / np.maximum(used - 2 - len(record.events_s), 1)[:, None]


@dataclass(frozen=True)
class Smoothed:
    """A record, its noise variance (M,), intensities, and what it says at ``knots_s`` and samples given all of it.

    At the knots but the last, (J, M): ``knot_slope`` [K/s]; ``jump_chi2``: score test for a jump of level, slope or
    both, chi-square of two degrees of freedom when there is none. At the samples, (N, M): ``temperature`` [degC], its
    ``slope`` [K/s], ``sd`` [K], ``lag_sensitivity`` [K/s] and ``bend`` [K/s2], see ``Sensor``; ``read``, ``read_var``:
    what the logger would have written without noise [degC], and its variance [K2].
    """

    record: Stretch
    noise_var: Array
    chosen: tuple[Intensity, ...]
    knots_s: Array
    knot_slope: Array
    jump_chi2: Array
    temperature: Array
    slope: Array
    sd: Array
    lag_sensitivity: Array
    bend: Array
    read: Array
    read_var: Array


def _along(out: Array, powers: Sequence[Array], cell: NDArray[np.intp], along: Array) -> None:
    """Put polynomials of the time ``along`` cells, ``powers`` (J, M) from the highest on, at samples into ``out``."""
    np.take(np.ascontiguousarray(powers[0]), cell, axis=0, out=out, mode="clip")
    for coefficients in powers[1:]:
        out *= along
        out += np.ascontiguousarray(coefficients)[cell]


def _rises(at_knot: Array, knots_s: Array) -> Array:
    """Slopes (J, M) to the next of values (J, M) at the knots but the last."""
    return np.asarray(np.diff(at_knot, axis=0, append=at_knot[-1:]) / np.diff(knots_s)[:, None])


def smoothed(
    record: Stretch, noise_var: Array, chosen: Sequence[Intensity], fine: float = FINE
) -> Smoothed:
    """States given the whole record, its noise variance (M,) and one intensity a channel.

    Long stretches go in pieces of cells, each with neighbours on both sides that settle both sweeps: the answer is that
    of the whole to a millionth of a kelvin, the memory that of a piece. The score test for jumps comes with
    ``swept``'s way back.
    """
    proposals = [[q] for q in chosen]
    knots = knots_for(record, noise_var, proposals, fine)
    span = ranges(record)
    (total, batch) = record.y.shape
    count = len(knots) - 1
    knot_slope, chi2 = np.empty((2, count, batch))
    at_samples = np.empty((5, total, batch))
    read, read_var = np.zeros((2, total + 1, batch))
    lag_rows, bend_rows = (
        np.stack(rows) for rows in zip(*((s.lag_row, s.bend_row) for s in record.sensors))
    )
    for low, first, last, high in pieces(record, noise_var, chosen, knots):
        cells = cells_for(record, noise_var, proposals, knots[low : high + 1], span)
        found = swept(cells)
        keep = slice(first - low, last - low)
        mean = found.mean
        cov = found.cov
        weights = found.weight[keep]
        (a, b) = np.moveaxis(found.pull[keep], -1, 0)
        own = weights[..., [0, 1], [0, 1]]
        det = np.maximum(
            np.prod(own, axis=-1) - weights[..., 0, 1] ** 2, 1e-9 * np.prod(own, axis=-1) + 1e-300
        )
        chi2[first:last] = (
            a**2 * own[..., 1] - 2 * a * b * weights[..., 0, 1] + b**2 * own[..., 0]
        ) / det
        knot_slope[first:last] = mean[keep, :, 1]
        for c, kinds in enumerate(cells.rows):
            for where, rows, sample in kinds:
                kept = (where >= keep.start) & (where < keep.stop)
                where = where[kept]
                sample = sample[kept]
                read[sample, c] = mean[where, c] @ rows.T
                read_var[sample, c] = (
                    cov[where, c].reshape(len(where), rows.shape[1] ** 2) @ _squares(rows).T
                )
        begin = 0 if first == 0 else int(np.ceil(knots[first] / record.dt_s - 1e-6))
        end = total if last == count else int(np.ceil(knots[last] / record.dt_s - 1e-6))
        t = np.arange(begin, end) * record.dt_s
        cell = np.searchsorted(knots[low : high + 1], t + 1e-6 * record.dt_s, side="right") - 1
        cell = np.clip(cell, 0, len(mean) - 1)
        along = (t - knots[low + cell])[:, None]
        lagging, bent = (np.einsum("jmn,mn->jm", mean, rows) for rows in (lag_rows, bend_rows))
        temperature, slope, sd, sensitivity, bend = at_samples[:, begin:end]
        for out, powers in (
            (slope, [mean[..., 1]]),
            (temperature, [mean[..., 1], mean[..., 0]]),
            (sd, [cov[..., 1, 1], 2 * cov[..., 0, 1], cov[..., 0, 0]]),
            *(
                (to, [_rises(at, knots[low : high + 1]), at])
                for to, at in ((sensitivity, lagging), (bend, bent))
            ),
        ):
            _along(out, powers, cell, along)
        np.sqrt(np.maximum(sd, 0.0, out=sd), out=sd)
    temperature, slope, sd, sensitivity, bend = at_samples
    return Smoothed(
        record,
        noise_var,
        tuple(chosen),
        knots,
        knot_slope,
        chi2,
        temperature,
        slope,
        sd,
        sensitivity,
        bend,
        read[:-1],
        read_var[:-1],
    )
