"""A smoother for live displays: temperature a fixed small lag behind the present, or at it, with its band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from calibration.finding import look
from calibration.noise import SPIKES, SpikeRule
from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.compensate.inverse import BeforeUse, InverseFilter, filter_report
from tcdyn.compensate.record import MISSING, SPIKE
from tcdyn.compensate.states import flow, prior

Array = NDArray[np.float64]
FORGET, ALARM = 0.6, 2.1  # running mean of normalised surprises (sd 0.5) and the level that means an event
MOST_GAIN = 10.0  # noise out over noise in, beyond which the answer of a live smoother is of little use
NO_COARSE_SPIKES = SpikeRule(np.inf, 5)


@dataclass(frozen=True)
class LiveState:
    """All that is needed to go on: states, covariances, the lagged estimates, how surprised each channel is.

    ``recent`` (``coarse.width``, M): the last samples; ``high`` and ``held`` (M,): spikes in a row by either rule.
    """

    mean: Array
    cov: Array
    lagged: Array
    lagged_var: Array
    lagged_cov: Array
    surprise: Array
    restless: Array
    held: Array
    recent: Array
    high: Array
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
    """A Kalman filter on the chain with slope noise, and the last ``lag_samples`` estimates kept up to date.

    A jump of slope is noticed by the run of surprises it makes and followed with a burst of intensity; a sample far
    from its prediction is flagged and skipped, and so is one that is by the rule ``coarse`` far from the median of
    those before it, which would pass for a jump (nobody knows yet what comes after it, so the rules for whole logs do
    not serve), unless more in a row do so than a spike has; a missing one is skipped. The answer at sample k is for
    time k dt - delay - lag_samples dt.
    """

    sensors: tuple[Sensor, ...]
    dt_s: float
    noise_sd: Array
    intensity: Array
    lag_samples: int
    coarse: SpikeRule
    steps: Array  # how the states move in one sample (M, n, n)
    rows: Array  # how they are read (M, n)
    kick: Array  # what a unit jump of slope some samples ago has done to them by now (M, n)
    lags_s: Array

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        dt_s: float,
        noise_sd: ArrayLike,
        intensity: ArrayLike,
        lag_samples: int = 0,
        coarse: SpikeRule = NO_COARSE_SPIKES,
    ) -> LiveSmoother:
        """For ``chains``, noise [K] and quiet slope intensity [K2/s3]: (M,) or one number for all."""
        noise, level = (
            np.broadcast_to(np.asarray(v, dtype=float), (len(chains),)).copy() for v in (noise_sd, intensity)
        )
        if lag_samples < 0 or np.any(noise <= 0) or np.any(level <= 0):
            raise InputError("live smoother: lag_samples must not be negative, noise and intensity must be positive")
        each = tuple(sensors(chains))
        steps = np.stack([flow(s.drift, dt_s) for s in each])
        lags = np.array([s.lag_s for s in each]) + dt_s
        ago = np.maximum(4 * dt_s, 0.15 * lags)
        kick = np.stack([flow(s.drift, float(d))[:, 1] for s, d in zip(each, ago)])
        rows = np.stack([s.output for s in each])
        return cls(each, dt_s, noise, level, lag_samples, coarse, steps, rows, kick, lags)

    def start(self, first: ArrayLike) -> LiveState:
        """State that knows only the first sample ``first (M,)`` [degC], the chain's past taken as a ramp."""
        first = np.asarray(first, dtype=float)
        if first.shape != (len(self.sensors),) or not np.all(np.isfinite(first)):
            raise InputError(
                f"live smoother: the first sample must have {len(self.sensors)} finite temperatures; got {first}",
                remedy="start at the first complete row",
            )
        m, n, keep = len(first), len(self.sensors[0].output), self.lag_samples + 1
        each = zip(self.sensors, first, self.noise_sd, self.intensity)
        priors = [prior(s, y, 10 * sd, self.dt_s, np.array([q])) for s, y, sd, q in each]
        mean, cov = np.stack([m0 for m0, _, _ in priors]), np.concatenate([c0 for _, c0, _ in priors])
        return LiveState(
            mean, cov, np.tile(mean[:, 0], (keep, 1)), np.tile(cov[:, 0, 0], (keep, 1)), np.zeros((keep, m, n)),
            np.zeros(m), np.zeros(m), np.zeros(m), np.tile(first, (self.coarse.width, 1)), np.zeros(m),
        )  # fmt: skip

    def run(self, state: LiveState, chunk: ArrayLike) -> tuple[LiveState, Array, Array, NDArray[np.uint8]]:
        """Temperature [degC] and sd [K] (n, M), lagged, and the flags of the samples of ``chunk (n, M)`` [degC]."""
        y = np.asarray(chunk, dtype=float)
        x, sd, flags = np.empty(y.shape), np.empty(y.shape), np.zeros(y.shape, dtype=np.uint8)
        now = state
        for k in range(len(y)):
            now, flags[k] = self._one(now, y[k])
            x[k], sd[k] = now.lagged[-1], np.sqrt(now.lagged_var[-1])
        return replace(now, done=state.done + len(y)), x, sd, flags

    def _one(self, now: LiveState, y: Array) -> tuple[LiveState, NDArray[np.uint8]]:
        """The state after one more sample (M,), and its flags."""
        steps, rows, kick, lags = self.steps, self.rows, self.kick, self.lags_s
        back = steps.transpose(0, 2, 1)
        absent = ~np.isfinite(y)
        middle = np.sort(now.recent, axis=0)[len(now.recent) // 2]
        limit = np.maximum(self.coarse.sigmas * self.noise_sd, self.coarse.floor)
        far = ~absent & (np.abs(y - middle) > limit) & (now.high < self.coarse.longest)
        high = np.where(far, now.high + 1, np.where(absent, now.high, 0.0))
        recent = np.concatenate([now.recent[1:], np.where(absent, middle, y)[None]])
        if now.done == 0 and not now.lagged_cov.any():
            mean, cov, lagged_cov = now.mean, now.cov, now.lagged_cov
        else:
            mean = (steps @ now.mean[..., None])[..., 0]
            cov = steps @ now.cov @ back
            lagged_cov = np.einsum("kmi,mij->kmj", now.lagged_cov, back)
        cov = cov.copy()
        cov[:, 1, 1] += (self.intensity + now.restless) * self.dt_s
        missing = absent | far
        nu = np.where(missing, 0.0, y - (rows * mean).sum(axis=1))
        across = (cov @ rows[..., None])[..., 0]
        spread = (rows * across).sum(axis=1) + self.noise_sd**2
        score = nu / np.sqrt(spread)
        surprise = FORGET * now.surprise + (1 - FORGET) * np.clip(score, -4, 4)
        event = np.abs(surprise) > ALARM
        jump = 1.5 * np.abs(nu) / np.maximum((rows * kick).sum(axis=1), 1e-12)
        if event.any():
            extra = np.where(event, jump**2, 0.0)
            cov += extra[:, None, None] * kick[:, :, None] * kick[:, None, :]
            across = (cov @ rows[..., None])[..., 0]
            spread = (rows * across).sum(axis=1) + self.noise_sd**2
            surprise = np.where(event, 0.0, surprise)
        rule = SPIKES["prediction"]
        spike = (np.abs(nu) > rule.sigmas * np.sqrt(spread)) & (now.held < rule.longest) & ~event
        used = ~(missing | spike)
        gain = np.where(used[:, None], across / spread[:, None], 0.0)
        mean = mean + gain * nu[:, None]
        cov = cov - gain[:, :, None] * across[:, None, :]
        pulls = np.einsum("kmi,mi->km", lagged_cov, rows)
        share = np.where(used, pulls / spread, 0.0)
        lagged = np.concatenate([mean[None, :, 0], (now.lagged + share * nu)[:-1]])
        lagged_var = np.concatenate([cov[None, :, 0, 0], (now.lagged_var - share * pulls)[:-1]])
        lagged_cov = np.concatenate([cov[None, :, 0], (lagged_cov - pulls[..., None] * gain)[:-1]])
        restless = np.where(event, 0.3 * jump**2 / lags, now.restless) * np.exp(-self.dt_s / lags)
        flags = np.where(absent, MISSING, 0) | np.where(spike | far, SPIKE, 0)
        held = np.where(spike, now.held + 1, np.where(missing, now.held, 0))
        state = LiveState(
            mean, cov, lagged, np.maximum(lagged_var, 0.0), lagged_cov, surprise, restless, held, recent, high,
            now.done + 1,
        )  # fmt: skip
        return state, flags.astype(np.uint8)


def live_before_use(engine: LiveSmoother, chains: Sequence[Chain]) -> BeforeUse:
    """The report on the channel of a live smoother whose answer is noisiest.

    At rest the smoother is a linear filter; its impulse response is had by giving it one sample of one standard
    deviation, too little to be taken for an event.
    """
    dt = engine.dt_s
    rows = int(min(8 * max(s.lag_s for s in engine.sensors) / dt + 4 * engine.lag_samples + 200, 4000))
    y = np.zeros((2 * rows, len(chains)))
    y[rows] = engine.noise_sd
    _, x, _, _ = engine.run(engine.start(np.zeros(len(chains))), y)
    pulses = x[rows:] / engine.noise_sd
    worst = int(np.argmax(np.sum(pulses**2, axis=0) * engine.noise_sd**2))
    chain, one = chains[worst], np.array([1.0])
    f = InverseFilter(pulses[:, worst], one, dt, np.nan, chain.delay_s + engine.lag_samples * dt, chain)
    noisy = [look("live.noisy", gain=f.noise_gain)] if f.noise_gain > MOST_GAIN else []
    return filter_report(f, float(engine.noise_sd[worst]), noisy)
