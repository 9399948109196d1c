"""Where a long stretch may be cut: pieces with so much on either side that both sweeps have settled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calibration import Array
from tcdyn.chain import Sensor
from tcdyn.compensate.record import Intensity, Stretch

PIECE = 4000  # cells that are swept at once
SETTLING = 18.0  # memories of the smoother beside a piece: exp(-18) of what is known worse at its ends is left


def pieces(
    stretch: Stretch, noise_var: Array, chosen: Sequence[Intensity], knots: Array
) -> Iterator[tuple[int, int, int, int]]:
    """First knot to sweep from, first and last of the cells to keep, last knot to sweep to, piece by piece.

    What lies between is ``SETTLING`` times the memory of the slowest channel, in time with samples of all channels.
    """
    count, size, dt = len(knots) - 1, PIECE, stretch.dt_s
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
        low[0], high[-1] = 0, count
        low, high = np.clip(low, 0, edges[:-1]), np.clip(high, edges[1:], count)
        if len(edges) == 2 or max(np.max(edges[:-1] - low), np.max(high - edges[1:])) <= size:
            yield from zip(*(column.tolist() for column in (low, edges[:-1], edges[1:], high)))
            return
        size *= 2


def settled_s(sensors: Sequence[Sensor], noise_sd: Array, dt_s: float, chosen: Sequence[Intensity]) -> float:
    """Time [s] with samples beside a piece in which both sweeps of every channel settle."""
    least = [min(q.levels) / (sd**2 * dt_s) for q, sd in zip(chosen, noise_sd)]
    return max(s.delay_s + SETTLING * memory_s(s, ratio) for s, ratio in zip(sensors, least))


def memory_s(sensor: Sensor, ratio: float) -> float:
    """Time [s] in which the smoother forgets a state to 1/e, for ``ratio`` = q / (R dt) [1/s4]; both ways alike.

    One over the slowest of the eigenvalues of its Hamiltonian ((A, Q), (C'C/R, -A')).
    """
    noise = np.zeros_like(sensor.drift)
    noise[1, 1] = ratio
    both = np.block([[sensor.drift, noise], [np.outer(sensor.output, sensor.output), -sensor.drift.T]])
    return 1.0 / float(np.abs(np.linalg.eigvals(both).real).min())
