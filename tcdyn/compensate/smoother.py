"""The fixed-interval smoother: the temperature at the junction with a standard deviation for every sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.arrays import Array
from calibration.errors import InputError
from calibration.finding import Finding
from tcdyn.chain import Chain, sensors
from tcdyn.compensate.events import MOST, SHARP, candidate, moved_event, timed
from tcdyn.compensate.grid import Grid, readings
from tcdyn.compensate.intensity import choose
from tcdyn.compensate.model import Stretch, grid_for, problem_for
from tcdyn.compensate.noise import channel_noise_sd
from tcdyn.compensate.profile import Intensity
from tcdyn.compensate.quality import SPIKE_SD, flags_of, judged, spoken
from tcdyn.compensate.result import SPIKE, Compensated
from tcdyn.compensate.sweep import Smoothed, backward, forward

FREEDOM, REWEIGHTINGS = 4.0, 4  # of Student's t; the fourth reweighting moves nothing by a tenth of the sd


def smooth(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    *,
    noise_sd: ArrayLike | None = None,
    intensity: float | Intensity | Sequence[float | Intensity] | None = None,
    events_s: Sequence[float] = (),
    event_u_s: float | Sequence[float] = 0.0,
    find_events: bool | None = None,
    heavy_tails: bool = False,
    lag_covariance: ArrayLike | None = None,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> Compensated:
    """What the junctions did, given what their chains wrote: posterior mean and standard deviation, sample by sample.

    y = G x + noise; dx'/dt = white noise of intensity q(t) [K2/s3], x' free to jump at ``events_s``.

    Args:
        y: (N,) or (N, M) logged temperatures after the static line [degC], NaN where missing.
        dt_s: sampling interval [s].
        chains: one for all channels, or one per channel.
        noise_sd: per channel [K]; estimated when left out.
        intensity: q, a number or an ``Intensity`` per channel; by likelihood when left out.
        events_s: times from the first sample [s] at which the slope of x may jump (unloading), between samples too.
        event_u_s: standard uncertainty of those times [s], one or one per event.
        find_events: look for unannounced jumps of slope and treat them likewise, with the uncertainty of their time;
            by default only when no event is given.
        heavy_tails: noise of Student's t with four degrees of freedom instead of a normal one, for slip rings that
            spit without spiking; by reweighting.
        lag_covariance: (M, M) covariance of the channels' lags [s2].
        static_u: standard uncertainty of the static line [K], scalar, (M,) or (N, M).
        names: what errors and warnings call the channels (M,); "channel 1" and so on when left out.

    Returns:
        ``Compensated`` with arrays (N, M).

    Raises:
        InputError: shapes that do not agree, a channel without samples.
    """
    data = np.asarray(y, dtype=float)
    data = data[:, None] if data.ndim == 1 else data
    m = data.shape[1]
    start = channel_noise_sd(data, noise_sd)
    stretch, flags, findings = stretch_of(data, dt_s, chains, events_s, start, names)
    u_of = dict(zip(stretch.events_s, np.broadcast_to(np.asarray(event_u_s, dtype=float), len(stretch.events_s))))
    if intensity is None:
        chosen, noise_var = choose(stretch, start**2, noise_known=noise_sd is not None)
    else:
        chosen, noise_var = _given(intensity, m), np.asarray(start**2, dtype=np.float64)
    grid, states = _sweep(stretch, noise_var, chosen)
    outside = _outliers(stretch, grid, states, noise_var)
    if outside.any():
        flags = flags | np.where(outside, SPIKE, 0).astype(np.uint8)
        stretch = replace(stretch, weight=np.where(outside, 0.0, stretch.weight))
        grid, states = _sweep(stretch, noise_var, chosen)
    longest_lag = max(s.lag_s for s in stretch.sensors)
    seek = not events_s if find_events is None else find_events
    while seek and intensity is None and len(u_of) < len(events_s) + MOST:
        found = candidate(grid, states.jump_z, stretch.events_s, guard_s=2 * longest_lag)
        if found is None:
            break
        reach = 2.0 * float(np.diff(grid.knots_s)[np.searchsorted(grid.knots_s, found) - 1])
        tried, q, var, u = _with_event(stretch, found, reach, start**2, noise_sd is not None)
        if u > SHARP * (longest_lag + dt_s):
            break
        stretch, chosen, noise_var = tried, q, var
        u_of = {e: u_of.get(e, u) for e in stretch.events_s}
        grid, states = _sweep(stretch, noise_var, chosen)
    for _ in range(REWEIGHTINGS if heavy_tails else 0):
        stretch = replace(stretch, weight=_student_weights(stretch, grid, states, noise_var))
        grid, states = _sweep(stretch, noise_var, chosen)
    x, slope, sd, lag = _at_samples(stretch, grid, states.mean, states.cov)
    for event, u in u_of.items():
        if u > 0:
            sd = np.hypot(sd, _event_sd(stretch, event, u, noise_var, chosen))
    time = np.arange(len(x)) * dt_s
    level = np.array([float(np.median(q.at(time[:: max(len(time) // 2000, 1)]))) for q in chosen])
    return Compensated.of(
        x, sd, slope, lag, lag_covariance, static_u, dt_s,
        noise_sd=np.sqrt(noise_var),
        intensity=level,
        flags=flags,
        method="fixed-interval smoother",
        findings=findings,
        events_s=tuple(u_of.items()),
        intensities=tuple(chosen),
    )  # fmt: skip


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
    findings = judged(flags, names)
    if np.any((flags == 0).sum(axis=0) < 8):
        c = int(np.argmin((flags == 0).sum(axis=0)))
        raise InputError(
            f"smooth: {spoken(names, m)[c]} has fewer than 8 good samples", remedy="leave this channel out"
        )
    y = np.stack([_bridged(data[:, c], flags[:, c] == 0) for c in range(m)], axis=1)
    weight = np.where(flags == 0, 1.0, 0.0)
    events = tuple(sorted({float(e) for e in events_s if 0 < e < (n - 1) * dt_s}))
    return Stretch(y, weight, dt_s, tuple(listed), tuple(sensors(listed)), events), flags, findings


def _bridged(y: Array, good: NDArray[np.bool_]) -> Array:
    """Straight lines across the bad samples: they carry no weight, but spectra need a value there."""
    at = np.arange(len(y))
    return y if good.all() else np.interp(at, at[good], y[good])


def _sweep(stretch: Stretch, noise_var: Array, chosen: Sequence[Intensity]) -> tuple[Grid, Smoothed]:
    proposals = [[q] for q in chosen]
    grid = grid_for(stretch, proposals, noise_var)
    problem = problem_for(stretch, grid, noise_var, proposals)
    return grid, backward(problem, forward(problem))


def _outliers(stretch: Stretch, grid: Grid, states: Smoothed, noise_var: Array) -> NDArray[np.bool_]:
    """Samples (N, M) beyond six standard deviations of a fit that is otherwise good, three or fewer together."""
    out = np.zeros(stretch.y.shape, dtype=bool)
    for c, s in enumerate(stretch.sensors):
        residual = stretch.y[:, c] - readings(grid, s, states.mean[:, c], len(stretch.y), stretch.dt_s)
        far = (np.abs(residual) > SPIKE_SD * np.sqrt(noise_var[c])) & (stretch.weight[:, c] > 0)
        crowd = np.convolve(far, np.ones(7), mode="same")
        out[:, c] = far & (crowd <= 3)
    return out


def _student_weights(stretch: Stretch, grid: Grid, states: Smoothed, noise_var: Array) -> Array:
    """(nu + 1) / (nu + residual2 / variance), (N, M), nought where a sample carried no weight."""
    weight = np.zeros_like(stretch.weight)
    for c, s in enumerate(stretch.sensors):
        residual = stretch.y[:, c] - readings(grid, s, states.mean[:, c], len(stretch.y), stretch.dt_s)
        weight[:, c] = (FREEDOM + 1) / (FREEDOM + residual**2 / noise_var[c])
    return np.where(stretch.weight > 0, weight, 0.0)


def _with_event(
    stretch: Stretch, found_s: float, reach_s: float, start_var: Array, noise_known: bool
) -> tuple[Stretch, list[Intensity], Array, float]:
    """The record with an event found near ``found_s``: its time by likelihood, the intensities chosen anew."""
    rough = replace(stretch, events_s=tuple(sorted((*stretch.events_s, found_s))))
    chosen, noise_var = choose(rough, start_var, noise_known)
    at, u = timed(rough, found_s, reach_s, noise_var, chosen)
    sharp = replace(stretch, events_s=tuple(sorted((*stretch.events_s, at))))
    chosen, noise_var = choose(sharp, start_var, noise_known)
    return sharp, chosen, noise_var, u


def _event_sd(stretch: Stretch, event_s: float, u_s: float, noise_var: Array, chosen: Sequence[Intensity]) -> Array:
    """Half the change of the answer (N, M) when the event moves from one standard uncertainty early to one late."""
    answers = []
    for to in (event_s - u_s, event_s + u_s):
        moved = replace(stretch, events_s=tuple(sorted(to if e == event_s else e for e in stretch.events_s)))
        grid, states = _sweep(moved, noise_var, [moved_event(q, event_s, to) for q in chosen])
        answers.append(_at_samples(moved, grid, states.mean, states.cov)[0])
    return np.asarray(0.5 * np.abs(answers[1] - answers[0]))


def _given(intensity: float | Intensity | Sequence[float | Intensity], m: int) -> list[Intensity]:
    if isinstance(intensity, Intensity):
        listed: list[float | Intensity] = [intensity] * m
    else:
        listed = list(np.broadcast_to(np.asarray(intensity, dtype=object), (m,)))
    return [q if isinstance(q, Intensity) else Intensity.constant(q) for q in listed]


def _at_samples(stretch: Stretch, grid: Grid, mean: Array, cov: Array) -> tuple[Array, Array, Array, Array]:
    """Temperature, slope, sd and lag sensitivity (N, M) at the sample times from the states at the knots."""
    n = len(stretch.y)
    t = np.arange(n) * stretch.dt_s
    cell = np.clip(np.searchsorted(grid.knots_s, t + 1e-6 * stretch.dt_s, side="right") - 1, 0, grid.cells - 1)
    along = (t - grid.knots_s[cell])[:, None]
    x, slope = mean[cell, :, 0] + along * mean[cell, :, 1], mean[cell, :, 1]
    var = cov[cell, :, 0, 0] + 2 * along * cov[cell, :, 0, 1] + along**2 * cov[cell, :, 1, 1]
    rows = np.stack([s.lag_row for s in stretch.sensors])
    at_knot = np.einsum("jmn,mn->jm", mean, rows)
    following = np.concatenate([at_knot[1:], at_knot[-1:]])
    part = np.clip(along / np.diff(grid.knots_s)[cell][:, None], 0, 1)
    lag = (1 - part) * at_knot[cell] + part * following[cell]
    return x, slope, np.sqrt(np.maximum(var, 0.0)), lag
