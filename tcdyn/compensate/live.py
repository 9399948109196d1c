"""A smoother for live displays: temperature a fixed small lag behind the present, or at it, with its band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from calibration.errors import InputError
from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.compensate.model import DIFFUSE
from tcdyn.compensate.result import MISSING, SPIKE

Array = NDArray[np.float64]
SPIKE_SD = 6.0
FORGET, ALARM = 0.6, 2.1  # running mean of normalised surprises (sd 0.5) and the level that means an event
HELD = 2  # samples in a row that may be taken for a spike


@dataclass(frozen=True)
class LiveState:
    """All that is needed to go on: states, covariances, the lagged estimates, how surprised each channel is."""

    mean: Array
    cov: Array
    lagged: Array
    lagged_var: Array
    lagged_cov: Array
    surprise: Array
    restless: Array
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
    """A Kalman filter on the chain with slope noise, and the last ``lag_samples`` estimates kept up to date.

    A jump of slope is noticed by the run of surprises it makes and followed with a burst of intensity; a lone sample
    beyond six standard deviations is flagged and skipped; a missing one is skipped. The answer at sample k is for
    time k dt - delay - lag_samples dt.
    """

    sensors: tuple[Sensor, ...]
    dt_s: float
    noise_sd: Array
    intensity: Array
    lag_samples: int

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        dt_s: float,
        noise_sd: ArrayLike,
        intensity: ArrayLike,
        lag_samples: int = 0,
    ) -> LiveSmoother:
        """For ``chains`` (M), noise (M,) [K] and quiet slope intensity (M,) [K2/s3], one number for all allowed."""
        m = len(chains)
        noise = np.broadcast_to(np.asarray(noise_sd, dtype=float), (m,)).copy()
        level = np.broadcast_to(np.asarray(intensity, dtype=float), (m,)).copy()
        if lag_samples < 0 or np.any(noise <= 0) or np.any(level <= 0):
            raise InputError("live smoother: lag_samples must not be negative, noise and intensity must be positive")
        return cls(tuple(sensors(chains)), dt_s, noise, level, lag_samples)

    def start(self, first: ArrayLike) -> LiveState:
        """State that knows only the first sample ``first (M,)`` [degC], the chain's past taken as a ramp."""
        first = np.asarray(first, dtype=float)
        if first.shape != (len(self.sensors),) or not np.all(np.isfinite(first)):
            raise InputError(
                f"live smoother: the first sample must have {len(self.sensors)} finite temperatures; got {first}",
                remedy="start at the first complete row",
            )
        m, n, keep = len(first), self.sensors[0].size, self.lag_samples + 1
        ramps = [s.ramp() for s in self.sensors]
        mean = np.stack([r[:, 0] * y for r, y in zip(ramps, first)])
        wide = [
            np.array([10 * sd, 10 * sd / (s.lag_s + 4 * self.dt_s)]) * DIFFUSE
            for s, sd in zip(self.sensors, self.noise_sd)
        ]
        cov = np.stack(
            [r * w**2 @ r.T + q * s.ramp_scatter() for r, w, q, s in zip(ramps, wide, self.intensity, self.sensors)]
        )
        return LiveState(
            mean, cov, np.tile(mean[:, 0], (keep, 1)), np.tile(cov[:, 0, 0], (keep, 1)), np.zeros((keep, m, n)),
            np.zeros(m), np.zeros(m), np.zeros(m),
        )  # fmt: skip

    def run(self, state: LiveState, chunk: ArrayLike) -> tuple[LiveState, Array, Array, NDArray[np.uint8]]:
        """Temperature [degC] and sd [K] (n, M), lagged, and the flags of the samples of ``chunk (n, M)`` [degC]."""
        y = np.asarray(chunk, dtype=float)
        steps = np.stack([expm(s.drift * self.dt_s) for s in self.sensors])
        rows = np.stack([s.output for s in self.sensors])
        lags = np.array([s.lag_s for s in self.sensors]) + self.dt_s
        calm = np.exp(-self.dt_s / lags)
        ago = np.maximum(4 * self.dt_s, 0.15 * lags)
        kick = np.stack([expm(s.drift * d)[:, 1] for s, d in zip(self.sensors, ago)])
        x, sd, flags = np.empty(y.shape), np.empty(y.shape), np.zeros(y.shape, dtype=np.uint8)
        back = steps.transpose(0, 2, 1)
        now = state
        for k in range(len(y)):
            now, flags[k] = self._one(now, y[k], steps, back, rows, lags, calm, kick)
            x[k], sd[k] = now.lagged[-1], np.sqrt(now.lagged_var[-1])
        return replace(now, done=state.done + len(y)), x, sd, flags

    def _one(
        self, now: LiveState, y: Array, steps: Array, back: Array, rows: Array, lags: Array, calm: Array, kick: Array
    ) -> tuple[LiveState, NDArray[np.uint8]]:
        if now.done == 0 and not now.lagged_cov.any():
            mean, cov, lagged_cov = now.mean, now.cov, now.lagged_cov
        else:
            mean = (steps @ now.mean[..., None])[..., 0]
            cov = steps @ now.cov @ back
            lagged_cov = np.einsum("kmi,mij->kmj", now.lagged_cov, back)
        cov = cov.copy()
        cov[:, 1, 1] += (self.intensity + now.restless) * self.dt_s
        missing = ~np.isfinite(y)
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
        spike = (np.abs(nu) > SPIKE_SD * np.sqrt(spread)) & (now.held < HELD) & ~event
        used = ~(missing | spike)
        gain = np.where(used[:, None], across / spread[:, None], 0.0)
        mean = mean + gain * nu[:, None]
        cov = cov - gain[:, :, None] * across[:, None, :]
        pulls = np.einsum("kmi,mi->km", lagged_cov, rows)
        share = np.where(used, pulls / spread, 0.0)
        lagged = np.concatenate([mean[None, :, 0], (now.lagged + share * nu)[:-1]])
        lagged_var = np.concatenate([cov[None, :, 0, 0], (now.lagged_var - share * pulls)[:-1]])
        lagged_cov = np.concatenate([cov[None, :, 0], (lagged_cov - pulls[..., None] * gain)[:-1]])
        restless = np.where(event, 0.3 * jump**2 / lags, now.restless) * calm
        flags = np.where(missing, MISSING, 0) | np.where(spike, SPIKE, 0)
        held = np.where(spike, now.held + 1, np.where(missing, now.held, 0))
        state = LiveState(
            mean, cov, lagged, np.maximum(lagged_var, 0.0), lagged_cov, surprise, restless, held, now.done + 1
        )
        return state, flags.astype(np.uint8)
