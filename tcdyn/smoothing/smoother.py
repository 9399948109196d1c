"""The fixed-interval smoother: the temperature at the junction with a standard deviation for every sample.

Regularised deconvolution is the same smoother with a weight by another criterion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation.trace_noise import SPIKES, bridged
from tcdyn.smoothing.hidden_events import Hidden, about, averaged, with_hidden
from tcdyn.smoothing.intervals import FINE, corner_rad_s
from tcdyn.smoothing.noise_levels import Intensity
from tcdyn.smoothing.process_noise import Criterion, Tradeoff, by_criterion, choose, cut_out
from tcdyn.smoothing.record import SPIKE, Compensated, Stretch, stretch_of
from tcdyn.smoothing.rts import swept
from tcdyn.smoothing.state_space import Smoothed, all_cells, smoothed

# of Student's t; the fourth reweighting moves nothing by a tenth of the sd
FREEDOM = 4.0
REWEIGHTINGS = 4
DIFFERENCE = 4.0  # longer cells than an answer's tell what two answers differ by
MARGIN = 12.0  # corner periods (1/rad) beyond a window that are smoothed along with it: exp(-12) of an end is left


@one_blas_thread
def smooth(
    y: ArrayLike | Stretch,
    dt_s: float,
    chains: float | Chain | Sequence[Chain],
    *,
    noise_sd: ArrayLike | None = None,
    intensity: float | Intensity | Sequence[float | Intensity] | None = None,
    events_s: Sequence[float] = (),
    event_u_s: float | Sequence[float] = 0.0,
    find_events: bool | None = None,
    heavy_tails: bool = False,
    lag_covariance: ArrayLike | None = None,
    split_u_s: ArrayLike = 0.0,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> Compensated:
    """What the junctions did, given what their chains wrote: posterior mean and standard deviation, sample by sample.

    y = G x + noise; dx'/dt = white noise of intensity q(t) [K2/s3], x' free to jump at ``events_s``.

    Args:
        y: (N,) or (N, M) logged temperatures after the static line [degC], NaN where missing; or what ``stretch_of``
            made of them, with these ``chains``, noise and events.
        dt_s: sampling interval [s].
        chains: one for all channels, or one per channel; a number is one lag [s].
        noise_sd: per channel [K]; estimated when left out.
        intensity: q, a number or an ``Intensity`` per channel; by likelihood when left out.
        events_s: times from the first sample [s] at which the slope of x may jump (unloading), between samples too.
        event_u_s: standard uncertainty of those times [s], one or one per event.
        find_events: look for events that nobody announced, by default only when none is given; without ``intensity``
            only. At each place where one would help, nothing, a kink and a jump of the temperature itself, at several
            times, are weighed by their likelihood; the answer is their mean, and the standard deviation holds what
            they differ by.
        heavy_tails: noise of Student's t with four degrees of freedom instead of a normal one, for slip rings that
            spit without spiking; by reweighting.
        lag_covariance: (M, M) covariance of the channels' lags [s2].
        split_u_s: standard uncertainty of how much of each lag is its largest lag's [s], one or (M,).
        static_u: standard uncertainty of the static line [K], scalar, (M,) or (N, M).
        names: what errors and warnings call the channels (M,); "channel 1" and so on when left out.

    Returns:
        ``Compensated`` with arrays (N, M).

    Raises:
        InputError: shapes that do not agree, a channel without samples.
    """
    record = y if isinstance(y, Stretch) else stretch_of(y, dt_s, chains, events_s, noise_sd, names)
    start_var = record.noise_sd**2
    known = record.noise_known
    u_s = np.broadcast_to(np.asarray(event_u_s, dtype=float), len(events_s)).tolist()
    if intensity is None:
        chosen, noise_var = choose(record, start_var, known)
    else:
        listed = (
            intensity
            if isinstance(intensity, Sequence | np.ndarray)
            else [intensity] * len(start_var)
        )
        chosen = [q if isinstance(q, Intensity) else Intensity.constant(q) for q in listed]
        noise_var = start_var
    if not (np.isfinite(noise_var) & (noise_var > 0)).all():
        lag_s = max(c.lag_s for c in record.chains)
        raise InputError(
            f"the noise cannot be estimated: rows every {record.dt_s:.4g} s are too slow for a lag of {lag_s:.4g} s",
            expected="several rows in one lag",
        )
    told = dict(zip(map(float, events_s), u_s))
    fit = smoothed(record, noise_var, chosen)
    events = {at: told[at] for at in record.events_s}
    # Beside a bend or in quick motion the rule of medians is blind to spikes: now they are judged against the answer
    rule = SPIKES["answer"]
    w = record.weight
    far = (np.abs(record.y - fit.read) > rule.sigmas * np.sqrt(noise_var)) & (w > 0)
    crowd = np.stack(
        [np.convolve(column, np.ones(rule.width), mode="same") for column in far.T], axis=1
    )
    if (spikes := far & (crowd <= rule.longest)).any():
        flags = record.flags | np.where(spikes, SPIKE, 0).astype(np.uint8)
        w = np.where(spikes, 0.0, w)
        straight = np.stack([bridged(x, kept > 0) for x, kept in zip(record.y.T, w.T)], axis=1)
        fit = smoothed(replace(record, y=straight, weight=w, flags=flags), noise_var, chosen)
    hidden: list[Hidden] = []
    if intensity is None and (not events_s if find_events is None else find_events):
        fit, hidden = with_hidden(fit, start_var, known)
        chosen = list(fit.chosen)
        noise_var = fit.noise_var
    for _ in range(REWEIGHTINGS if heavy_tails else 0):
        student = (FREEDOM + 1) / (
            FREEDOM + (record.y - fit.read) ** 2 / noise_var
        )  # turns least squares into it
        weight = np.where(fit.record.weight > 0, student, 0.0)
        fit = smoothed(replace(fit.record, weight=weight), noise_var, chosen)
    for found in hidden:
        fit = averaged(fit, found)
    sd = fit.sd
    static_u = np.hypot(0.0 if static_u is None else static_u, record.folded_u_K)
    doubts = tuple(_by_event(fit, event, u) for event, u in events.items() if u > 0)
    for moved in doubts:
        sd = np.hypot(sd, moved)
    split = np.broadcast_to(np.asarray(split_u_s, dtype=float), len(noise_var)).tolist()
    split_K = fit.bend * [c.split_s2(u) for c, u in zip(record.chains, split)]
    time = np.arange(len(sd)) * dt_s
    done = Compensated.of(
        fit.temperature,
        sd,
        fit.slope,
        fit.lag_sensitivity,
        lag_covariance,
        static_u,
        dt_s,
        split_K,
        noise_sd=np.sqrt(noise_var),
        intensity=np.array(
            [float(np.median(q.at(time[:: max(len(time) // 2000, 1)]))) for q in chosen]
        ),
        flags=fit.record.flags,
        method="fixed-interval smoother",
        findings=record.findings,
        by_event_K=doubts,
        events_s=tuple(
            sorted([*events.items(), *((h.at_s, h.u_s) for h in hidden if h.log_odds > 0)])
        ),
        intensities=tuple(chosen),
    )
    called = [f"channel {c + 1}" for c in range(sd.shape[1])] if names is None else list(names)
    return done.checked(record.y, called)


def _by_event(fit: Smoothed, event_s: float, u_s: float) -> Array:
    """Half the change of the answer (N, M) when the event moves from one standard uncertainty early to one late."""
    record = fit.record
    dt = fit.record.dt_s
    time = np.arange(len(record.y)) * dt
    ratios = [
        np.array(np.min(q.at(time)) / (var * dt)) for q, var in zip(fit.chosen, fit.noise_var)
    ]
    corner = min(float(corner_rad_s(chain, ratio)) for chain, ratio in zip(record.chains, ratios))
    first, last = about(record, event_s)
    extra = int(MARGIN / corner / dt)
    first = max(first - extra, 0)
    last = min(last + extra, len(time))
    window = cut_out(record, first, last, record.events_s)
    shift = first * dt
    answers = []
    for to in (event_s - u_s, event_s + u_s):
        events = tuple(sorted(to - shift if e == event_s - shift else e for e in window.events_s))
        moved = [q.moved(event_s, to).moved(shift_s=shift) for q in fit.chosen]
        answers.append(
            smoothed(
                replace(window, events_s=events), fit.noise_var, moved, DIFFERENCE * FINE
            ).temperature
        )
    half = np.zeros_like(fit.sd)
    half[first:last] = 0.5 * (answers[1] - answers[0])
    return half


@one_blas_thread
def deconvolve(
    y: ArrayLike,
    dt_s: float,
    chains: float | Chain | Sequence[Chain],
    *,
    criterion: Criterion = "gcv",
    noise_sd: ArrayLike | None = None,
    lag_covariance: ArrayLike | None = None,
    split_u_s: ArrayLike = 0.0,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    trials: int = 25,
) -> tuple[Compensated, Tradeoff]:
    """Minimise sum (y - G x)^2 + weight integral x''^2 dt, a filter without phase, edges exact.

    ``discrepancy``: mean square residual equal to the noise variance; ``gcv``: least generalised cross-validation
    score, which need not know the noise; ``l-curve``: largest curvature of log misfit against log roughness. The
    standard deviation is the Bayesian one of the same penalty (Wahba 1983), which holds noise and average bias.

    Args:
        y: (N,) or (N, M) logged temperatures after the static line [degC], NaN where missing.
        dt_s: sampling interval [s].
        chains: one for all channels or one per channel; a number is one lag [s].
        noise_sd: per channel [K]; estimated when left out.
        lag_covariance, split_u_s, static_u, names: as in ``smooth``.
        trials: number of weights tried, evenly in their logarithm.
    """
    record = stretch_of(y, dt_s, chains, (), noise_sd, names)
    tradeoff = by_criterion(record, criterion, trials)
    result = smooth(
        record,
        dt_s,
        record.chains,
        intensity=list(tradeoff.chosen),
        lag_covariance=lag_covariance,
        split_u_s=split_u_s,
        static_u=static_u,
    )
    return replace(result, method=f"regularised deconvolution, weight by {criterion}"), tradeoff


@one_blas_thread
def window_covariance(
    y: ArrayLike,
    dt_s: float,
    chain: Chain,
    result: Compensated,
    channel: int,
    first: int,
    last: int,
) -> Array:
    """Covariance (n, n) [K2] of the temperatures at samples ``first`` .. ``last`` - 1 of one channel.

    Noise and regularisation by C(j, k) = J_j C(j+1, k), J_j = P_j F' (P-_{j+1})^-1 of the same smoother on the window
    and a margin, so that no N x N matrix is needed; the lag adds lag_sensitivity_i lag_sensitivity_k u(lag)^2, how it
    divides likewise. The static line's part, the same error at all times, is left to the user, who knows whether it
    cancels.

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
            f"window_covariance: samples {first} to {last} of {len(data)}",
            expected="a window inside a smoothed record",
        )
    noise_sd = result.noise_sd[channel : channel + 1]
    q = result.intensities[channel]
    least = np.min(q.at(result.time_s[first:last]))
    corner = float(corner_rad_s(chain, np.array(least / (noise_sd[0] ** 2 * dt_s))))
    extra = int(np.ceil((MARGIN / corner + 5 * chain.lag_s) / dt_s))
    a = max(first - extra, 0)
    b = min(last + extra, len(data))
    part = np.where(result.flags[a:b, channel] == 0, data[a:b], np.nan)[:, None]
    own = {
        b.start_s for b in q.bursts if b.slope_sd > 0
    }  # found, not given: their jumps are the intensity's
    record = stretch_of(
        part, dt_s, chain, [e - a * dt_s for e, _ in result.events_s if e not in own], noise_sd
    )
    cells = all_cells(record, noise_sd**2, [[q.moved(shift_s=a * dt_s)]])
    states = swept(cells)
    t = np.arange(first - a, last - a) * dt_s
    cell = np.searchsorted(cells.knots_s[:-1], t + 1e-6 * dt_s, side="right") - 1
    low = int(cell[0])
    count = int(cell[-1] - cell[0]) + 1
    n = states.mean.shape[2]
    between = np.zeros((count, count, n, n))
    for j in range(count - 1, -1, -1):
        between[j, j] = states.cov[low + j, 0]
        if j == count - 1:
            continue
        across = cells.transition[cells.kind[low + j], 0, 0]
        kept = states.past[low + j, 0]
        ahead = across @ kept @ across.T
        ahead[[0, 1], [0, 1]] += cells.jump_var[low + j + 1, 0, 0]
        gain = np.linalg.lstsq(ahead, across @ kept)[0].T  # quick stages hang on the slow ones
        between[j, j + 1 :] = gain @ between[j + 1, j + 1 :]
        between[j + 1 :, j] = between[j, j + 1 :].transpose(0, 2, 1)
    row = np.zeros((len(t), n))
    row[:, 0], row[:, 1] = 1.0, t - cells.knots_s[cell]
    pairs = between[(cell - low)[:, None], (cell - low)[None, :]]
    out = np.einsum("ia,ijab,jb->ij", row, pairs, row, optimize=True)
    s = result.lag_sensitivity[first:last, channel]
    d = result.split_K[first:last, channel]
    return np.asarray(
        out + np.outer(s, s) * result.lag_covariance[channel, channel] + np.outer(d, d)
    )
