"""The fixed-interval smoother: the temperature at the junction with a standard deviation for every sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from calibration import Array, Flags
from calibration.errors import InputError
from calibration.noise import SPIKES
from tcdyn.chain import Chain
from tcdyn.compensate.grid import Grid, Intensity, corner_rad_s, readings
from tcdyn.compensate.intensity import MOST, SHARP, candidate, choose, timed
from tcdyn.compensate.result import SPIKE, Compensated, channel_noise_sd, columns_of
from tcdyn.compensate.sweep import Smoothed, Stretch, backward, forward, grid_for, model_for, stretch_of, swept

FREEDOM, REWEIGHTINGS = 4.0, 4  # of Student's t; the fourth reweighting moves nothing by a tenth of the sd
MARGIN = 12.0  # corner periods (1/rad) beyond a window that are smoothed along with it: exp(-12) of an end is left


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
    data = columns_of(y)
    start = channel_noise_sd(data, noise_sd)
    stretch, flags, findings = stretch_of(data, dt_s, chains, events_s, start, names)
    u_s = np.broadcast_to(np.asarray(event_u_s, dtype=float), len(stretch.events_s))
    given = None if intensity is None else _given(intensity, data.shape[1])
    fit = _SmoothedStretch.of(stretch, start**2, noise_sd is not None, given, dict(zip(stretch.events_s, u_s.tolist())))
    if (spikes := fit.outliers()).any():
        flags = flags | np.where(spikes, SPIKE, 0).astype(np.uint8)
        fit = fit.weighted(np.where(spikes, 0.0, fit.stretch.weight))
    if given is None and (not events_s if find_events is None else find_events):
        fit = fit.with_events_found(start**2, noise_sd is not None, len(events_s) + MOST)
    for _ in range(REWEIGHTINGS if heavy_tails else 0):
        fit = fit.weighted(fit.student_weights())
    x, slope, sd, lag = fit.at_samples()
    for event, u in fit.events.items():
        if u > 0:
            sd = np.hypot(sd, fit.event_sd(event, u))
    time = np.arange(len(x)) * dt_s
    return Compensated.of(
        x, sd, slope, lag, lag_covariance, static_u, dt_s,
        noise_sd=np.sqrt(fit.noise_var),
        intensity=np.array([float(np.median(q.at(time[:: max(len(time) // 2000, 1)]))) for q in fit.chosen]),
        flags=flags,
        method="fixed-interval smoother",
        findings=findings,
        events_s=tuple(fit.events.items()),
        intensities=fit.chosen,
    )  # fmt: skip


@dataclass(frozen=True)
class _SmoothedStretch:
    """A smoothed stretch: noise variance (M,), intensities chosen, events with their uncertainty [s], and states."""

    stretch: Stretch
    noise_var: Array
    chosen: tuple[Intensity, ...]
    events: dict[float, float]
    grid: Grid = field(init=False)
    states: Smoothed = field(init=False)

    def __post_init__(self) -> None:
        for name, value in zip(("grid", "states"), swept(self.stretch, self.noise_var, self.chosen)):
            object.__setattr__(self, name, value)

    @classmethod
    def of(
        cls,
        stretch: Stretch,
        start_var: Array,
        noise_known: bool,
        given: Sequence[Intensity] | None,
        events: dict[float, float],
    ) -> _SmoothedStretch:
        """With the intensities ``given``, or by likelihood, the noise variance then along with them."""
        chosen, noise_var = choose(stretch, start_var, noise_known) if given is None else (given, start_var)
        return cls(stretch, noise_var, tuple(chosen), events)

    def weighted(self, weight: Array) -> _SmoothedStretch:
        """With other weights (N, M) of the samples, intensities as they are."""
        return replace(self, stretch=replace(self.stretch, weight=weight))

    def residual(self) -> Array:
        """Samples less what the chain would have written (N, M)."""
        s = self.stretch
        fitted = [
            readings(self.grid, sensor, self.states.mean[:, c], len(s.y), s.dt_s) for c, sensor in enumerate(s.sensors)
        ]
        return s.y - np.stack(fitted, axis=1)

    def outliers(self) -> Flags:
        """Samples (N, M) far from a fit that is otherwise good, a few together.

        Beside a bend or in quick motion the rule of medians is blind to them: they are judged against the answer.
        """
        rule = SPIKES["answer"]
        far = (np.abs(self.residual()) > rule.sigmas * np.sqrt(self.noise_var)) & (self.stretch.weight > 0)
        crowd = np.stack([np.convolve(column, np.ones(rule.width), mode="same") for column in far.T], axis=1)
        return far & (crowd <= rule.longest)

    def student_weights(self) -> Array:
        """Weights (N, M) that turn least squares into Student's t."""
        weight = (FREEDOM + 1) / (FREEDOM + self.residual() ** 2 / self.noise_var)
        return np.where(self.stretch.weight > 0, weight, 0.0)

    def with_events_found(self, start_var: Array, noise_known: bool, most: int) -> _SmoothedStretch:
        """With jumps of slope that nobody announced as events, the most significant first, as long as they are sharp.

        Each gets its time by likelihood, and the intensities are chosen anew, before and after.
        """
        fit, longest = self, self.stretch.longest_lag_s
        while len(fit.events) < most:
            found = candidate(fit.grid, fit.states.jump_z, fit.stretch.events_s, guard_s=2 * longest)
            if found is None:
                break
            knots = fit.grid.knots_s
            reach = 2.0 * float(np.diff(knots)[np.searchsorted(knots, found) - 1])
            rough = replace(fit.stretch, events_s=tuple(sorted((*fit.stretch.events_s, found))))
            chosen, noise_var = choose(rough, start_var, noise_known)
            at, u = timed(rough, found, reach, noise_var, chosen)
            if u > SHARP * (longest + fit.stretch.dt_s):
                break
            sharp = replace(fit.stretch, events_s=tuple(sorted((*fit.stretch.events_s, at))))
            events = {e: fit.events.get(e, u) for e in sharp.events_s}
            fit = _SmoothedStretch.of(sharp, start_var, noise_known, None, events)
        return fit

    def event_sd(self, event_s: float, u_s: float) -> Array:
        """Half the change of the answer (N, M) when the event moves from one standard uncertainty early to one late."""
        answers = []
        for to in (event_s - u_s, event_s + u_s):
            events = tuple(sorted(to if e == event_s else e for e in self.stretch.events_s))
            moved = tuple(q.moved(event_s, to) for q in self.chosen)
            answers.append(replace(self, stretch=replace(self.stretch, events_s=events), chosen=moved).at_samples()[0])
        return np.asarray(0.5 * np.abs(answers[1] - answers[0]))

    def at_samples(self) -> tuple[Array, Array, Array, Array]:
        """Temperature, slope, sd and lag sensitivity (N, M) at the sample times from the states at the knots."""
        mean, cov, dt = self.states.mean, self.states.cov, self.stretch.dt_s
        t = np.arange(len(self.stretch.y)) * dt
        cell = self.grid.cell_at(t, dt)
        along = (t - self.grid.knots_s[cell])[:, None]
        slope = mean[cell, :, 1]
        var = cov[cell, :, 0, 0] + 2 * along * cov[cell, :, 0, 1] + along**2 * cov[cell, :, 1, 1]
        at_knot = np.einsum("jmn,mn->jm", mean, np.stack([s.lag_row for s in self.stretch.sensors]))
        following = np.concatenate([at_knot[1:], at_knot[-1:]])
        part = np.clip(along / np.diff(self.grid.knots_s)[cell][:, None], 0, 1)
        lag = (1 - part) * at_knot[cell] + part * following[cell]
        return mean[cell, :, 0] + along * slope, slope, np.sqrt(np.maximum(var, 0.0)), lag


def _given(intensity: float | Intensity | Sequence[float | Intensity], m: int) -> list[Intensity]:
    listed = intensity if isinstance(intensity, Sequence | np.ndarray) else [intensity] * m
    return [q if isinstance(q, Intensity) else Intensity.constant(q) for q in listed]


def window_covariance(
    y: ArrayLike, dt_s: float, chain: Chain, result: Compensated, channel: int, first: int, last: int
) -> Array:
    """Covariance (n, n) [K2] of the temperatures at samples ``first`` .. ``last`` - 1 of one channel.

    Noise and regularisation by C(j, k) = J_j C(j+1, k), J_j = P_j F' (P-_{j+1})^-1 of the same smoother on the window
    and a margin, so that no N x N matrix is needed; the lag adds lag_sensitivity_i lag_sensitivity_k u(lag)^2. The
    static line's part, the same error at all times, is left to the user, who knows whether it cancels.

    Args:
        y: (N,) the logged trace that ``result`` was made from [degC].
        dt_s, chain: as given to ``smooth``.
        result: what ``smooth`` returned.
        channel: column of ``result``.
        first, last: window, in samples.
    """
    data = np.asarray(y, dtype=float)
    if not 0 <= first < last <= len(data) or not result.intensities:
        raise InputError(
            f"window_covariance: samples {first} to {last} of {len(data)}", expected="a window inside a smoothed record"
        )
    noise_sd, q = result.noise_sd[channel : channel + 1], result.intensities[channel]
    least = np.min(q.at(result.time_s[first:last]))
    corner = float(corner_rad_s(chain, np.array(least / (noise_sd[0] ** 2 * dt_s))))
    extra = int(np.ceil((MARGIN / corner + 5 * chain.lag_s) / dt_s))
    a, b = max(first - extra, 0), min(last + extra, len(data))
    part = np.where(result.flags[a:b, channel] == 0, data[a:b], np.nan)[:, None]
    events = [e - a * dt_s for e, _ in result.events_s]
    stretch, _, _ = stretch_of(part, dt_s, chain, events, noise_sd)
    proposals = [[q.shifted(a * dt_s)]]
    grid = grid_for(stretch, proposals, noise_sd**2)
    model = model_for(stretch, grid, noise_sd**2, proposals)
    done = forward(model)
    states = backward(model, done)
    t = np.arange(first - a, last - a) * dt_s
    cell = grid.cell_at(t, dt_s)
    low, count, n = int(cell[0]), int(cell[-1] - cell[0]) + 1, states.mean.shape[2]
    between = np.zeros((count, count, n, n))
    for j in range(count - 1, -1, -1):
        between[j, j] = states.cov[low + j, 0]
        if j == count - 1:
            continue
        across, kept = model.transition[model.kind[low + j], 0, 0], done.cov[low + j, 0]
        ahead = across @ kept @ across.T
        ahead[1, 1] += model.slope_var[low + j + 1, 0, 0]
        gain = np.linalg.solve(ahead, across @ kept).T
        between[j, j + 1 :] = gain @ between[j + 1, j + 1 :]
        between[j + 1 :, j] = between[j, j + 1 :].transpose(0, 2, 1)
    row = np.zeros((len(t), n))
    row[:, 0], row[:, 1] = 1.0, t - grid.knots_s[cell]
    pairs = between[(cell - low)[:, None], (cell - low)[None, :]]
    out = np.einsum("ia,ijab,jb->ij", row, pairs, row, optimize=True)
    s = result.lag_sensitivity[first:last, channel]
    return np.asarray(out + np.outer(s, s) * result.lag_covariance[channel, channel])
