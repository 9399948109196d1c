"""Where cells of time begin, and where a long stretch may be cut: with so much beside it that sweeps settle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain, Sensor
from tcdyn.core import Array
from tcdyn.smoothing.noise_levels import Intensity, levels_at
from tcdyn.smoothing.record import Stretch

STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128])  # samples per cell
FINE = 0.5  # cell length times the local corner of the smoother [rad]: halving it moves nothing by 1 % of the sd
PIECE = 4000  # cells that are swept at once
SETTLING = 18.0  # memories of the smoother beside a piece: exp(-18) of what is known worse at its ends is left


def corner_rad_s(chain: Chain, ratio: Array) -> Array:
    """Where the signal sinks into the noise: |G(w)|^2 q / w^4 = R, for ``ratio`` = q / R [1/s4]; same shape."""
    w = np.geomspace(1e-4, 1e4, 400)
    needed = np.maximum.accumulate(
        4 * np.log(w) - 2 * np.log(np.abs(chain.frequency_response(w / 2 / np.pi)) + 1e-30)
    )
    return np.asarray(np.exp(np.interp(np.log(ratio), needed, np.log(w))))


def knots_for(
    stretch: Stretch, noise_var: Array, proposals: Sequence[Sequence[Intensity]], fine: float = FINE
) -> Array:
    """Knots (J+1,) of cells fine enough for every intensity proposed for every channel, as many for each.

    The first lies before the first sample by the longest dead time, a multiple of dt.
    """
    dt = stretch.dt_s
    total = len(stretch.y)
    end = (total - 1) * dt
    start = -float(np.ceil(max(s.delay_s for s in stretch.sensors) / dt - 1e-9)) * dt
    times = [np.linspace(start, end, max(int((end - start) / 1.0), 8))]
    starts = {b.start_s for proposed in proposals for q in proposed for b in q.bursts}
    inside = sorted(e for e in {*stretch.events_s, *starts} if start < e < end)
    for e in inside:
        after = e + np.geomspace(0.1 * dt, max(end - e, dt), 60)
        times += [np.array([e - 1e-6 * dt, e]), after[after < end]]
    t = np.unique(np.concatenate(times))
    longest = np.full(len(t), np.inf)
    for chain, proposed, var in zip(stretch.chains, proposals, noise_var):
        most = levels_at(proposed, t).max(axis=0)
        longest = np.minimum(longest, fine / corner_rad_s(chain, most / (var * dt)))
    begin = round(start / dt)
    cells = np.maximum(np.interp(np.arange(begin, total) * dt, t, longest) / dt, 1.0)
    return _knots(
        begin, dt, [*inside, end + 0.5 * dt], np.searchsorted(STEPS, cells + 1e-9, side="right") - 1
    )


def _knots(begin: int, dt_s: float, stops_s: Sequence[float], most: NDArray[np.intp]) -> Array:
    """Knots from sample ``begin`` (none, before the first) past the last of ``stops_s``: every other stop, an event, is
    a knot, further knots are on the sample times.

    ``most`` (from ``begin`` on): place in ``STEPS`` of the longest cell wanted from a sample on; cells grow by at most
    a half from one to the next.
    """
    knots = [begin * dt_s]
    index = begin
    size = len(STEPS) - 1
    longest = most.tolist()
    for number, stop in enumerate(stops_s, start=1):
        if number > 1:
            index = int(np.floor(knots[-1] / dt_s + 1 + 1e-6))
            size = 0
            knots.append(index * dt_s)
        while index * dt_s < stop - 1e-6 * dt_s:
            size = min(size + 1, longest[index - begin])
            index += int(STEPS[size])
            knots.append(index * dt_s)
        if number < len(stops_s):
            while knots[-1] > stop - 1e-6 * dt_s:
                knots.pop()
            knots.append(stop)
    return np.array(knots)


def pieces(
    stretch: Stretch, noise_var: Array, chosen: Sequence[Intensity], knots: Array
) -> Iterator[tuple[int, int, int, int]]:
    """First knot to sweep from, first and last of the cells to keep, last knot to sweep to, piece by piece.

    What lies between is ``SETTLING`` times the memory of the slowest channel, in time with samples of all channels.
    """
    count = len(knots) - 1
    size = PIECE
    dt = stretch.dt_s
    if count <= 2 * size:
        yield 0, 0, count, count
        return
    rows = settled_s(stretch.sensors, np.sqrt(noise_var), dt, chosen) / dt
    told = np.concatenate([[0], np.cumsum((stretch.weight > 0).all(axis=1))])
    at = np.clip(np.ceil(knots / dt).astype(int), 0, len(stretch.y))
    while True:
        edges = np.append(np.arange(0, count - size // 2, size), count)
        before = np.searchsorted(told, told[at[edges[:-1]]] - rows, side="right") - 1
        after = np.searchsorted(told, told[at[edges[1:]]] + rows)
        low = np.searchsorted(at, np.maximum(before, 0), side="right") - 1
        high = np.searchsorted(at, np.minimum(after, len(stretch.y)))
        low[0] = 0
        high[-1] = count
        low = np.clip(low, 0, edges[:-1])
        high = np.clip(high, edges[1:], count)
        if len(edges) == 2 or max(np.max(edges[:-1] - low), np.max(high - edges[1:])) <= size:
            yield from zip(*(column.tolist() for column in (low, edges[:-1], edges[1:], high)))
            return
        size *= 2


def settled_s(
    sensors: Sequence[Sensor], noise_sd: Array, dt_s: float, chosen: Sequence[Intensity]
) -> float:
    """Time [s] with samples beside a piece in which both sweeps of every channel settle."""
    least = [min(q.levels) / (sd**2 * dt_s) for q, sd in zip(chosen, noise_sd)]
    return max(s.delay_s + SETTLING * memory_s(s, ratio) for s, ratio in zip(sensors, least))


def memory_s(sensor: Sensor, ratio: float) -> float:
    """Time [s] in which the smoother forgets a state to 1/e, for ``ratio`` = q / (R dt) [1/s4]; both ways alike.

    One over the slowest of the eigenvalues of its Hamiltonian ((A, Q), (C'C/R, -A')).
    """
    noise = np.zeros_like(sensor.drift)
    noise[1, 1] = ratio
    both = np.block(
        [[sensor.drift, noise], [np.outer(sensor.output, sensor.output), -sensor.drift.T]]
    )
    return 1.0 / float(np.abs(np.linalg.eigvals(both).real).min())
