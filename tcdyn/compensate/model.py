"""From samples, chains and intensities to a sweep: the model of one stretch of record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain, Sensor
from tcdyn.compensate.grid import FINE, Grid, corner_rad_s, gather, make_grid, transitions
from tcdyn.compensate.profile import Intensity
from tcdyn.compensate.sweep import Problem, log_likelihood_terms

Array = NDArray[np.float64]
DIFFUSE = 10.0  # prior sd of level, slope and slope jumps, in ranges of the record (per lag): wide, yet well scaled


@dataclass(frozen=True)
class Stretch:
    """Samples ``y (N, M)`` (finite; weight 0 where missing) every ``dt_s``, their chains and event times [s]."""

    y: Array
    weight: Array
    dt_s: float
    chains: tuple[Chain, ...]
    sensors: tuple[Sensor, ...]
    events_s: tuple[float, ...]

    @property
    def end_s(self) -> float:
        """Time of the last sample [s]."""
        return (len(self.y) - 1) * self.dt_s

    @property
    def start_s(self) -> float:
        """Time of the first knot [s]: before the first sample by the longest dead time, a multiple of dt."""
        longest = max(s.delay_s for s in self.sensors)
        return -float(np.ceil(longest / self.dt_s - 1e-9)) * self.dt_s

    def window(self, first: int, last: int, events: Sequence[float] | None = None) -> Stretch:
        """Samples first..last-1 as a stretch of its own, its clock starting at zero."""
        shift = first * self.dt_s
        kept = self.events_s if events is None else events
        length = (last - first) * self.dt_s
        inside = tuple(e - shift for e in kept if 0 <= e - shift < length)
        return Stretch(self.y[first:last], self.weight[first:last], self.dt_s, self.chains, self.sensors, inside)


def grid_for(
    stretch: Stretch, intensities: Sequence[Sequence[Intensity]], noise_var: Array, fine: float = FINE
) -> Grid:
    """A grid fine enough for every intensity proposed for every channel (outer sequence: channels)."""
    start, end, dt = stretch.start_s, stretch.end_s, stretch.dt_s
    times = [np.linspace(start, end, max(int((end - start) / 1.0), 8))]
    for event in stretch.events_s:
        after = event + np.geomspace(0.1 * dt, max(end - event, dt), 60)
        times += [np.array([event - 1e-6 * dt, event]), after[after < end]]
    t = np.unique(np.concatenate(times))
    cell = np.full(len(t), np.inf)
    for chain, proposed, var in zip(stretch.chains, intensities, noise_var):
        most = np.max([q.at(t) for q in proposed], axis=0)
        cell = np.minimum(cell, fine / corner_rad_s(chain, most / (var * dt)))
    return make_grid(start, end, dt, stretch.events_s, lambda at: float(np.interp(at, t, cell)))


def problem_for(stretch: Stretch, grid: Grid, noise_var: Array, intensities: Sequence[Sequence[Intensity]]) -> Problem:
    """The sweep for all channels and, for each, its proposed intensities (as many for every channel)."""
    dt = stretch.dt_s
    information, score, mean0, cov0, slope_var = [], [], [], [], []
    for c, s in enumerate(stretch.sensors):
        w = stretch.weight[:, c] / noise_var[c]
        info_c, score_c = gather(grid, s, stretch.y[:, c], w, dt)
        information.append(info_c[:, None])
        score.append(score_c[:, None])
        seen = stretch.y[stretch.weight[:, c] > 0, c]
        level, span = (float(seen[0]), float(np.ptp(seen))) if len(seen) else (0.0, 1.0)
        span = max(span, 10 * float(np.sqrt(noise_var[c])))
        ramp, scatter = s.ramp(), s.ramp_scatter()
        wide = np.array([DIFFUSE * span, DIFFUSE * span / (s.lag_s + 4 * dt)]) ** 2
        before = np.array([float(q.at(0.0)) for q in intensities[c]])
        mean0.append(np.tile(level * ramp[:, 0], (len(before), 1)))
        cov0.append(ramp * wide @ ramp.T + before[:, None, None] * scatter)
        inside = np.stack([q.between(grid.knots_s) for q in intensities[c]], axis=1)
        at_knot = 0.5 * (inside + np.concatenate([np.zeros_like(inside[:1]), inside[:-1]]))
        at_knot[grid.event > 0] += wide[1]
        slope_var.append(at_knot)
    return Problem(
        np.array(mean0),
        np.array(cov0),
        transitions(grid, stretch.sensors)[:, :, None],
        grid.kind,
        np.stack(information, axis=1),
        np.stack(score, axis=1),
        np.stack(slope_var, axis=1),
    )


def likelihood(
    stretch: Stretch, noise_var: Array, intensities: Sequence[Sequence[Intensity]], fine: float = FINE
) -> tuple[Array, Array]:
    """Log likelihood (M, Q) at the given noise, and the ratio (M, Q) by which each would scale the noise variance."""
    grid = grid_for(stretch, intensities, noise_var, fine)
    log_det, quad = log_likelihood_terms(problem_for(stretch, grid, noise_var, intensities))
    used = (stretch.weight > 0).sum(axis=0)
    total = quad + ((stretch.weight * stretch.y**2).sum(axis=0) / noise_var)[:, None]
    value = -0.5 * (log_det + total + (used * np.log(noise_var))[:, None])
    return value, total / np.maximum(used - 2 - len(stretch.events_s), 1)[:, None]
