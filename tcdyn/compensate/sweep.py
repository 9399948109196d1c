"""A stretch of record as a linear Gaussian model on cells, filtered and smoothed, all channels together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import Array
from calibration.errors import InputError
from calibration.finding import Finding
from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.compensate.grid import FINE, Grid, Intensity, corner_rad_s, gather, make_grid, transitions
from tcdyn.compensate.result import flags_of, judged, spoken
from tcdyn.traces import bridged

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
    def longest_lag_s(self) -> float:
        """The largest of the channels' lags [s]."""
        return max(s.lag_s for s in self.sensors)

    def window(self, first: int, last: int, events: Sequence[float]) -> Stretch:
        """Samples first..last-1 as a stretch of its own, its clock starting at zero, with those of ``events`` in it."""
        shift, length = first * self.dt_s, (last - first) * self.dt_s
        inside = tuple(e - shift for e in events if 0 <= e - shift < length)
        return Stretch(self.y[first:last], self.weight[first:last], self.dt_s, self.chains, self.sensors, inside)


def stretch_of(
    data: Array,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    events_s: Sequence[float],
    noise_sd: Array,
    names: Sequence[str] | None = None,
) -> tuple[Stretch, NDArray[np.uint8], tuple[Finding, ...]]:
    """The record ``data (N, M)`` as a stretch whose bad samples carry no weight, their flags, and findings."""
    n, m = data.shape
    listed = [chains] * m if isinstance(chains, Chain) else list(chains)
    if len(listed) != m:
        raise InputError(f"smooth: {m} channels but {len(listed)} chains", expected="one chain, or one per channel")
    if n < 8 or not dt_s > 0:
        raise InputError(f"smooth: {n} samples every {dt_s:g} s", expected="at least 8 samples and a positive interval")
    flags = flags_of(data, noise_sd)
    findings, good = judged(flags, names), flags == 0
    if np.any(good.sum(axis=0) < 8):
        name = spoken(names, m)[int(np.argmin(good.sum(axis=0)))]
        raise InputError(f"smooth: {name} has fewer than 8 good samples", remedy="leave this channel out")
    y = np.stack([bridged(data[:, c], good[:, c]) for c in range(m)], axis=1)
    events = tuple(sorted({float(e) for e in events_s if 0 < e < (n - 1) * dt_s}))
    return Stretch(y, np.where(good, 1.0, 0.0), dt_s, tuple(listed), tuple(sensors(listed)), events), flags, findings


@dataclass(frozen=True)
class LinearModel:
    """A linear Gaussian model on J cells for M channels times Q proposals, with n states.

    ``mean0 (M, Q, n)``, ``cov0 (M, Q, n, n)``: prior at the first knot. ``transition (K, M, 1, n, n)`` and
    ``kind (J,)``: how the state crosses cell j. ``information (J, M, 1, n, n)``, ``score (J, M, 1, n)``: sum over the
    samples of cell j of w o o' and w o y, o the row that reads the sample from the state at the knot.
    ``slope_var (J, M, Q)``: variance added to the slope at knot j [K2/s2].
    """

    mean0: Array
    cov0: Array
    transition: Array
    kind: NDArray[np.intp]
    information: Array
    score: Array
    slope_var: Array


def grid_for(
    stretch: Stretch, intensities: Sequence[Sequence[Intensity]], noise_var: Array, fine: float = FINE
) -> Grid:
    """A grid fine enough for every intensity proposed for every channel (outer sequence: channels).

    Its first knot lies before the first sample by the longest dead time, a multiple of dt.
    """
    end, dt = stretch.end_s, stretch.dt_s
    start = -float(np.ceil(max(s.delay_s for s in stretch.sensors) / dt - 1e-9)) * dt
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


def model_for(
    stretch: Stretch, grid: Grid, noise_var: Array, intensities: Sequence[Sequence[Intensity]]
) -> LinearModel:
    """The model of all channels and, for each, its proposed intensities (as many for every channel)."""
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
        at_knot[grid.event] += wide[1]
        slope_var.append(at_knot)
    return LinearModel(
        np.array(mean0),
        np.array(cov0),
        transitions(grid, stretch.sensors)[:, :, None],
        grid.kind,
        np.stack(information, axis=1),
        np.stack(score, axis=1),
        np.stack(slope_var, axis=1),
    )


def _filtered(model: LinearModel) -> Iterator[tuple[Array, ...]]:
    """The information-form Kalman filter, cell by cell: P+ = (I + P L)^-1 P, m+ = m + P+ (s - L m).

    Yields, for all channels and proposals (M, Q): mean before the cell's samples, its step, covariance after them,
    I + P L and its inverse, and the surprise s - L m.
    """
    mean, cov = model.mean0[..., None].copy(), model.cov0.copy()
    eye = np.eye(mean.shape[-2])
    for j, kind in enumerate(model.kind):
        cov[..., 1, 1] += model.slope_var[j]
        info = model.information[j]
        gain = cov @ info + eye
        surprise = model.score[j][..., None] - info @ mean
        shrink = np.linalg.inv(gain)
        cov = shrink @ cov
        step = cov @ surprise
        yield mean, step, cov, gain, shrink, surprise
        across = model.transition[kind]
        mean, cov = across @ (mean + step), across @ cov @ across.swapaxes(-1, -2)


def likelihood(
    stretch: Stretch, noise_var: Array, intensities: Sequence[Sequence[Intensity]], fine: float = FINE
) -> tuple[Array, Array]:
    """Log likelihood (M, Q) at the given noise, and the ratio (M, Q) by which each would scale the noise variance."""
    grid = grid_for(stretch, intensities, noise_var, fine)
    model = model_for(stretch, grid, noise_var, intensities)
    log_det, quad = np.zeros(model.mean0.shape[:2]), np.zeros(model.mean0.shape[:2])
    for (mean, step, _, gain, _, surprise), score in zip(_filtered(model), model.score):
        log_det += np.log(np.maximum(np.linalg.det(gain), 1e-300))
        quad -= ((score[..., None] + surprise) * mean + surprise * step).sum(axis=(-2, -1))
    used = (stretch.weight > 0).sum(axis=0)
    total = quad + ((stretch.weight * stretch.y**2).sum(axis=0) / noise_var)[:, None]
    value = -0.5 * (log_det + total + (used * np.log(noise_var))[:, None])
    return value, total / np.maximum(used - 2 - len(stretch.events_s), 1)[:, None]


@dataclass(frozen=True)
class Filtered:
    """Per cell: state at its knot given all samples up to the end of the cell, and what the smoother needs."""

    mean: Array
    cov: Array
    shrink: Array
    surprise: Array


@dataclass(frozen=True)
class Smoothed:
    """States at the knots given the whole record, mean (J, M, n) and covariance (J, M, n, n).

    ``jump_z (J, M)``: score test for a slope jump at each knot, standard normal when there is none.
    """

    mean: Array
    cov: Array
    jump_z: Array


def swept(stretch: Stretch, noise_var: Array, chosen: Sequence[Intensity]) -> tuple[Grid, Smoothed]:
    """States at the knots given the whole stretch, its noise variance (M,) and one intensity a channel."""
    proposals = [[q] for q in chosen]
    grid = grid_for(stretch, proposals, noise_var)
    model = model_for(stretch, grid, noise_var, proposals)
    return grid, backward(model, forward(model))


def forward(model: LinearModel) -> Filtered:
    """The filter of the first proposal, kept for the smoother."""
    cells = [
        ((mean + step)[:, 0, :, 0], cov[:, 0], shrink[:, 0], surprise[:, 0, :, 0])
        for mean, step, cov, _, shrink, surprise in _filtered(model)
    ]
    return Filtered(*(np.stack(kept) for kept in zip(*cells)))


def backward(model: LinearModel, done: Filtered) -> Smoothed:
    """The smoother in Bryson-Frazier form: no inverse, and the test for slope jumps comes with it."""
    cells, batch, n = done.mean.shape
    pull, weight = np.zeros((batch, n, 1)), np.zeros((batch, n, n))
    mean, cov, z = np.empty_like(done.mean), np.empty_like(done.cov), np.zeros((cells, batch))
    for j in range(cells - 1, -1, -1):
        if j < cells - 1:
            across = model.transition[model.kind[j], :, 0]
            back = across.transpose(0, 2, 1)
            pull, weight = back @ pull, back @ weight @ across
        p = done.cov[j]
        mean[j] = done.mean[j] + (p @ pull)[..., 0]
        cov[j] = p - p @ weight @ p
        shrink = done.shrink[j]
        back = shrink.transpose(0, 2, 1)
        pull = back @ (done.surprise[j][..., None] + pull)
        weight = back @ weight @ shrink + model.information[j, :, 0] @ shrink
        z[j] = pull[:, 1, 0] / np.sqrt(np.maximum(weight[:, 1, 1], 1e-300))
    return Smoothed(mean, cov, z)
