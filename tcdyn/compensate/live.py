"""A smoother for live displays: temperature a fixed small lag behind the present, or at it, with its band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag, solve_continuous_lyapunov

from calibration.errors import InputError
from calibration.finding import look
from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.compensate.inverse import BeforeUse, InverseFilter, filter_report
from tcdyn.compensate.record import MISSING, SPIKE
from tcdyn.compensate.states import flow, prior

Array = NDArray[np.float64]
QUIET, RESTLESS, BURST = 0, 1, 2  # what may be going on at a sample
KINKS_S, BURSTS_S = 60.0, 20.0  # between two jumps of slope, and between two bursts, on the average
BURST_FOR_S, LONGEST_BURST_S, RESTLESS_LAGS = 0.12, 0.4, 8.0  # how long they last, on the average
BURST_NOISES, BURST_LEAK_S, BURST_WALK = 12.0, 0.3, 0.2  # sd of an offset in noises; it fades, and walks by its share
SLOPE_NOISES, SLOPE_QUIETS = 200.0, 2.0  # sd of a jump of slope: noises, or quiet wanders of the slope, in a lag
LEVEL_JUMP = 0.1  # sd of a jump of the temperature: share of what that slope makes in a lag
SETTLING = 0.2  # how far slope and temperature wander in a lag after a jump: share of it
PARTED_LAGS = 0.08  # for which hypotheses are followed apart: the filter hides for as long what has begun
IMPOSSIBLE = 6.0  # standard deviations of the prediction in a burst: no reading at all
MOST_OPENED = 5.0  # doublings of the jumps of slope and temperature, once a burst lasts too long to be one
SHOWN = 0.2  # share of a step of the junction that stands in the readings after the time over which their range counts
TINY = 1e-3  # noises
MOST_GAIN = 10.0  # noise out over noise in, beyond which the answer of a live smoother is of little use


@dataclass(frozen=True)
class LiveState:
    """All that is needed to go on, for M channels and the three hypotheses.

    ``mean`` (M, 3, n + L), ``cov`` (M, 3, n + L, n): states, then the temperatures of the last L samples, and their
    covariance with the states; ``var`` (M, 3, L): of those temperatures; ``weight`` (M, 3) of the hypotheses;
    ``recent`` (W, M): the last readings that were no spikes [degC]; ``held`` (M,):
    readings in a row that were spikes.
    """

    mean: Array
    cov: Array
    var: Array
    weight: Array
    recent: Array
    held: Array
    done: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers, exact to the last bit in JSON."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> LiveState:
        """The state that ``to_json`` wrote."""
        arrays = {k: np.asarray(v, dtype=float) for k, v in data.items() if k != "done"}
        return cls(**arrays, done=int(data["done"]))


@dataclass(frozen=True)
class LiveSmoother:
    """Three Kalman filters a channel, averaged by what the readings say of them, and the last temperatures kept up.

    Quiet: the slope wanders with the intensity given. Restless: it has jumped, and settles. Burst: a slip ring adds an
    offset before the conditioning filter, or a lone sample is out; once it is over, only what the filter still holds of
    it is left. They follow one another as a Markov chain; every few samples their states are merged by weight
    (interacting multiple models, Blom and Bar-Shalom 1988; merged at each, a small burst would be forgotten before the
    filter has shown it), so the band holds while nobody can know yet what has happened. Noise from before the filter
    has states of its own. A missing sample is skipped, and so is one that no hypothesis explains. The answer at sample
    k is for time k dt - delay - lag_samples dt. It stays in the range of the last readings, widened by what the chain
    may not have shown yet; where that binds, the sd covers what was cut off.
    """

    sensors: tuple[Sensor, ...]
    dt_s: float
    noise_sd: Array  # of a sample: behind the filter, and from before it as it comes out (M,)
    intensity: Array
    lag_samples: int
    after_var: Array  # (M,)
    steps: Array  # how the states move in one sample (M, 1, n, n)
    rows: Array  # how they are read (M, 1, n)
    scatter: Array  # what one sample adds to their covariance under each hypothesis (M, 3, n, n)
    begun: Array  # what is added where a hypothesis begins: jump of slope and temperature, offset (M, 3, n)
    before: Array  # stationary covariance of what the filter holds of the noise (M, n, n)
    switch: Array  # probability of going from one hypothesis to another in ``every`` samples (3, 3)
    every: int
    shown: Array  # of a step of the junction, in ``window`` samples (M,)
    window: int

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        dt_s: float,
        noise_sd: ArrayLike,
        intensity: ArrayLike,
        lag_samples: int = 0,
        before_sd: ArrayLike = 0.0,
    ) -> LiveSmoother:
        """For ``chains``, noise [K] and quiet slope intensity [K2/s3]: (M,) or one number for all.

        ``noise_sd``: of what is white; ``before_sd``: of what each chain's filter has coloured, as it comes out of it.
        """
        after, level, before = (
            np.broadcast_to(np.asarray(v, dtype=float), (len(chains),)).copy() for v in (noise_sd, intensity, before_sd)
        )
        if lag_samples < 0 or np.any(after <= 0) or np.any(level <= 0) or np.any(before < 0):
            raise InputError("live smoother: lag_samples must not be negative, noise and intensity must be positive")
        each = tuple(sensors(chains))
        noise = np.hypot(after, before)
        lags = np.array([s.lag_s for s in each]) + dt_s
        jump = np.maximum(SLOPE_NOISES * noise / lags, SLOPE_QUIETS * np.sqrt(level * lags))
        models = [_with_noise(s, b, dt_s) for s, b in zip(each, _noise_paths(chains))]
        steps, rows, held = (np.stack(part) for part in zip(*models))
        held *= before[:, None, None] ** 2
        scatter = np.repeat((held - steps @ held @ steps.transpose(0, 2, 1))[:, None], 3, axis=1)
        scatter[:, :, 1, 1] += (level * dt_s)[:, None]
        first = len(each[0].output)
        begun = np.zeros(scatter.shape[:3])
        begun[:, RESTLESS, 0], begun[:, RESTLESS, 1] = (LEVEL_JUMP * jump * lags) ** 2, jump**2
        begun[:, BURST, first] = (BURST_NOISES * noise) ** 2
        scatter[:, RESTLESS, [0, 1], [0, 1]] += SETTLING**2 * begun[:, RESTLESS, :2] * (dt_s / lags)[:, None]
        scatter[:, BURST, first, first] += BURST_WALK**2 * begun[:, BURST, first]
        kink, burst = dt_s / KINKS_S, dt_s / BURSTS_S
        calm, over = (min(dt_s / t, 0.7) for t in (RESTLESS_LAGS * lags.mean(), BURST_FOR_S))
        switch = np.array([[0.0, kink, burst], [calm, 0.0, burst], [over, over * kink, 0.0]])
        switch[range(3), range(3)] = 1 - switch.sum(axis=1)
        every = max(round(PARTED_LAGS * lags.mean() / dt_s), 1)
        unit = np.append(0.0, np.ones(int(2 * lags.max() / dt_s) + 8))
        step = np.stack([c.response(unit, dt_s, "zoh") for c in chains])
        window = int(np.max(np.argmax(step >= SHOWN, axis=1)))
        return cls(
            each, dt_s, noise, level, lag_samples, after**2, steps[:, None], rows[:, None], scatter, begun, held,
            np.linalg.matrix_power(switch, every), every, step[:, window], window,
        )  # fmt: skip

    def start(self, first: ArrayLike) -> LiveState:
        """State that knows only the first sample ``first (M,)`` [degC], the chain's past taken as a ramp."""
        first = np.asarray(first, dtype=float)
        if first.shape != (len(self.sensors),) or not np.all(np.isfinite(first)):
            raise InputError(
                f"live smoother: the first sample must have {len(self.sensors)} finite temperatures; got {first}",
                remedy="start at the first complete row",
            )
        m, n, lag = len(first), self.rows.shape[-1], self.lag_samples
        mean, cov, var = np.zeros((m, 3, n + lag)), np.zeros((m, 3, n + lag, n)), np.zeros((m, 3, lag))
        cov[:, :, :n] = self.before[:, None]
        for i, (s, y, sd, q) in enumerate(zip(self.sensors, first, self.noise_sd, self.intensity)):
            own = len(s.output)
            mean[i, :, :own], here, _ = prior(s, y, 10 * sd, self.dt_s, np.array([q]))
            mean[i, :, n:], var[i], cov[i, :, :own, :own] = y, here[0, 0, 0], here[0]
        weight = np.tile(np.append(1 - self.switch[0, 1:].sum(), self.switch[0, 1:]), (m, 1))
        return LiveState(mean, cov, var, weight, np.tile(first, (self.window + lag + 1, 1)), np.zeros(m))

    def run(self, state: LiveState, chunk: ArrayLike) -> tuple[LiveState, Array, Array, NDArray[np.uint8]]:
        """Temperature [degC] and sd [K] (n, M), lagged, and the flags of the samples of ``chunk (n, M)`` [degC]."""
        y = np.asarray(chunk, dtype=float)
        x, sd, flags = np.empty(y.shape), np.empty(y.shape), np.zeros(y.shape, dtype=np.uint8)
        for k in range(len(y)):
            state, flags[k] = self._one(state, y[k])
            x[k], sd[k] = self._answer(state)
        return state, x, sd, flags

    def _one(self, now: LiveState, y: Array) -> tuple[LiveState, NDArray[np.uint8]]:
        """The state after one more sample (M,), and its flags."""
        n = self.rows.shape[-1]
        mean, cov, var, prior_weight = self._ahead(now) if now.done else (now.mean, now.cov, now.var, now.weight)
        pulls = (cov @ self.rows[..., None])[..., 0]
        spread = (self.rows * pulls[..., :n]).sum(axis=-1) + self.after_var[:, None]
        nu = y[:, None] - (self.rows * mean[..., :n]).sum(axis=-1)
        absent = ~np.isfinite(y)
        out = ~absent & (np.abs(nu) > IMPOSSIBLE * np.sqrt(spread)).all(axis=1)
        nu = np.where((absent | out)[:, None], 0.0, nu)
        likelihood = np.where((absent | out)[:, None], 0.0, -0.5 * (nu**2 / spread + np.log(spread)))
        likelihood -= likelihood.max(axis=1, keepdims=True)
        weight = np.maximum(prior_weight * np.exp(likelihood), 1e-12)
        weight /= weight.sum(axis=1, keepdims=True)
        gain = np.where((absent | out)[:, None, None], 0.0, pulls / spread[..., None])
        mean = mean + gain * nu[..., None]
        cov = cov - gain[..., None] * pulls[..., None, :n]
        var = np.maximum(var - gain[..., n:] * pulls[..., n:], 0.0)
        spike = out | (~absent & (weight[:, BURST] > 0.5))
        held = np.where(spike, now.held + 1, np.where(absent, now.held, 0.0))
        recent = np.concatenate([now.recent[1:], np.where(absent | spike, now.recent[-1], y)[None]])
        flags = np.where(absent, MISSING, 0) | np.where(spike, SPIKE, 0)
        return LiveState(mean, cov, var, weight, recent, held, now.done + 1), flags.astype(np.uint8)

    def _ahead(self, now: LiveState) -> tuple[Array, Array, Array, Array]:
        """Mean, covariances and weights at the next sample, before it is seen."""
        n = self.rows.shape[-1]
        was, covered, past_var, weight = self._merged(now)
        crossed = covered @ self.steps.swapaxes(-1, -2)
        mean, cov, var = was.copy(), crossed.copy(), past_var.copy()
        mean[..., :n] = (self.steps @ was[..., :n, None])[..., 0]
        cov[..., :n, :] = self.steps @ crossed[..., :n, :] + self._scatter(now.held)
        if self.lag_samples:
            mean[..., n], mean[..., n + 1 :] = was[..., 0], was[..., n:-1]
            cov[..., n, :], cov[..., n + 1 :, :] = crossed[..., 0, :], crossed[..., n:-1, :]
            var[..., 0], var[..., 1:] = covered[..., 0, 0], past_var[..., :-1]
        return mean, cov, var, weight

    def _merged(self, now: LiveState) -> tuple[Array, Array, Array, Array]:
        """Mean, covariances and weights before the next sample, where each hypothesis may give way to another."""
        if now.done % self.every:
            return now.mean, now.cov, now.var, now.weight
        m, n, first = len(now.weight), self.rows.shape[-1], len(self.sensors[0].output)
        joint = now.weight[:, :, None] * self.switch
        weight = joint.sum(axis=1)
        share = (joint / weight[:, None]).swapaxes(1, 2)  # (M, to, from)
        apart = now.mean - now.mean[:, :1]
        square = now.cov + apart[..., None] * apart[..., None, :n]
        var = share @ (now.var + apart[..., n:] ** 2)
        apart = share @ apart
        cov = (share @ square.reshape(m, 3, -1)).reshape(square.shape) - apart[..., None] * apart[..., None, :n]
        mean = now.mean[:, :1] + apart
        mean[:, :BURST, first] = 0.0  # the offset is there in a burst only
        cov[:, :BURST, first], cov[:, :BURST, :, first] = 0.0, 0.0
        states = np.arange(n)
        cov[:, :, states, states] += (1 - share.diagonal(axis1=1, axis2=2))[..., None] * self.begun
        return mean, cov, var - apart[..., n:] ** 2, weight

    def _scatter(self, held: Array) -> Array:
        """What a sample adds to the covariances (M, 3, n, n): the more to a restless slope the longer a burst seems."""
        beyond = np.clip(held - LONGEST_BURST_S / self.dt_s, 0.0, MOST_OPENED)
        if not beyond.any():
            return self.scatter
        out = self.scatter.copy()
        out[:, RESTLESS, [0, 1], [0, 1]] *= (4.0**beyond)[:, None]
        return out

    def _answer(self, now: LiveState) -> tuple[Array, Array]:
        """Temperature [degC] and its sd [K] (M,), ``lag_samples`` behind the last sample."""
        x, var = (now.mean[..., -1], now.var[..., -1]) if self.lag_samples else (now.mean[..., 0], now.cov[..., 0, 0])
        mean = (now.weight * x).sum(axis=1)
        var = (now.weight * (var + (x - mean[:, None]) ** 2)).sum(axis=1)
        low, high = now.recent.min(axis=0), now.recent.max(axis=0)
        unseen = np.maximum(high - low, IMPOSSIBLE * self.noise_sd) / self.shown
        held = np.clip(mean, low - unseen, high + unseen)
        return held, np.sqrt(np.maximum(var, 0.0) + (mean - held) ** 2)


def live_before_use(engine: LiveSmoother, chains: Sequence[Chain]) -> BeforeUse:
    """The report on the channel of a live smoother whose answer is noisiest.

    At rest the smoother is a linear filter; its impulse response is had by giving it one sample, too little to be taken
    for anything else than noise.
    """
    dt = engine.dt_s
    rows = int(min(8 * max(s.lag_s for s in engine.sensors) / dt + 4 * engine.lag_samples + 200, 4000))
    y = np.zeros((2 * rows, len(chains)))
    y[rows] = TINY * engine.noise_sd
    _, x, _, _ = engine.run(engine.start(np.zeros(len(chains))), y)
    pulses = x[rows:] / (TINY * engine.noise_sd)
    worst = int(np.argmax(np.sum(pulses**2, axis=0) * engine.noise_sd**2))
    chain, one = chains[worst], np.array([1.0])
    f = InverseFilter(pulses[:, worst], one, dt, np.nan, chain.delay_s + engine.lag_samples * dt, chain)
    noisy = [look("live.noisy", gain=f.noise_gain)] if f.noise_gain > MOST_GAIN else []
    return filter_report(f, float(engine.noise_sd[worst]), noisy)


def _noise_paths(chains: Sequence[Chain]) -> list[Sensor]:
    """The filter of each chain alone, its input standing where a sensor has the temperature of the junction."""
    return sensors([Chain((), conditioning=c.conditioning) for c in chains])


def _with_noise(s: Sensor, path: Sensor, dt_s: float) -> tuple[Array, Array, Array]:
    """Step (n, n) and row (n,) of sensor and noise, and what white noise that comes out with sd 1 leaves in the states.

    States: those of the sensor, the offset of a burst, those of the filter it passes with the noise.
    """
    keep = np.r_[0, 2 : len(path.output)]
    drift, row = path.drift[np.ix_(keep, keep)], path.output[keep]
    held: Array = np.zeros((len(s.output) + len(keep),) * 2)
    if np.any(row[1:]):
        stages = solve_continuous_lyapunov(drift[1:, 1:], -np.outer(drift[1:, 0], drift[1:, 0]))
        held[len(s.output) + 1 :, len(s.output) + 1 :] = stages / (row[1:] @ stages @ row[1:])
    drift[0, 0] = -1.0 / BURST_LEAK_S
    return flow(block_diag(s.drift, drift), dt_s), np.append(s.output, row), held
