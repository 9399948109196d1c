"""What a compensator will do to a trace, said before it is applied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from calibration.finding import Finding, look, sentences
from calibration.result import Result
from tcdyn.chain import Chain
from tcdyn.compensate.grid import corner_rad_s
from tcdyn.compensate.inverse import InverseFilter, proper_inverse
from tcdyn.compensate.live import LiveSmoother

Array = NDArray[np.float64]
MOST_GAIN = 10.0  # noise out over noise in, beyond which the answer of a live smoother is of little use


@dataclass(frozen=True)
class BeforeUse(Result):
    """Chain times compensator, before use.

    ``noise_gain``: sd out over sd in; ``noise_out_K``: sd of the answer; ``bandwidth_Hz`` where chain times compensator
    falls to 1/sqrt 2; ``raw_bandwidth_Hz`` of the chain alone; ``rise_s`` from 10 to 90 % of a step, after and
    ``raw_rise_s`` before; ``overshoot`` share of a step; ``remaining_shift_s`` by which the answer comes late;
    ``bias_K_per_K_s``: error on a ramp of 1 K/s; ``step_time_s``, ``step`` and ``raw_step`` the step responses.
    """

    noise_gain: float
    noise_out_K: float
    bandwidth_Hz: float
    raw_bandwidth_Hz: float
    rise_s: float
    raw_rise_s: float
    overshoot: float
    remaining_shift_s: float
    bias_K_per_K_s: float
    step_time_s: Array
    step: Array
    raw_step: Array
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know first, in words."""
        return sentences(self.findings)

    def summary(self) -> str:
        """The report in words."""
        return "\n".join([*self.lines(), *self.warnings])

    def lines(self) -> list[str]:
        """The report in words without its warnings."""
        return [
            f"noise gain {self.noise_gain:.3g}: the answer has a noise of {self.noise_out_K:.3g} K",
            f"bandwidth {self.bandwidth_Hz:.3g} Hz (uncompensated {self.raw_bandwidth_Hz:.3g} Hz)",
            f"step response, 10 to 90 %: {self.rise_s:.3g} s (uncompensated {self.raw_rise_s:.3g} s), "
            f"overshoot {100 * self.overshoot:.2g} %",
            f"remaining shift {self.remaining_shift_s:.3g} s: on a ramp of 1 K/s the answer is "
            f"{self.bias_K_per_K_s if abs(self.bias_K_per_K_s) > 1e-6 else 0.0:.3g} K behind",
        ]


def before_use(f: InverseFilter, noise_sd: float, wanted_K: float | None = None) -> BeforeUse:
    """The report on a proper inverse for a trace with white noise ``noise_sd`` [K].

    A warning comes when the answer would be noisier than ``wanted_K`` [K] (left out: than a hundred times the trace),
    with the bandwidth that can be had; and when the sampling is too slow for the bandwidth.
    """
    dt, chain, noise_out = f.dt_s, f.chain, f.noise_gain * noise_sd
    limit = 100.0 * noise_sd if wanted_K is None else wanted_K
    found = []
    if noise_out > limit:
        best = widest_bandwidth_Hz(chain, dt, noise_sd, limit)
        found.append(look("inverse.noisy", bandwidth_Hz=f.bandwidth_Hz, noise_K=noise_out, limit_K=limit, best_Hz=best))
    if f.bandwidth_Hz > 0.2 / dt:
        found.append(look("inverse.near_nyquist", bandwidth_Hz=f.bandwidth_Hz, rate_Hz=1 / dt))
    span = 12 * (chain.lag_s + f.remaining_shift_s) + 20 * dt
    rows = int(min(max(span / dt, 64), 400_000))
    raw = _step(chain, dt, rows, max(int(np.ceil(400 / rows)), 1))
    freq = np.geomspace(1e-4, 0.499, 3000) / dt
    through = np.abs(f.frequency_response(freq) * chain.frequency_response(freq))
    return _report(
        chain, dt, raw, np.asarray(signal.lfilter(f.b, f.a, raw)), (f.noise_gain, noise_out),
        _first_below(freq, through), f.remaining_shift_s, f.remaining_shift_s, found,
    )  # fmt: skip


def live_before_use(engine: LiveSmoother, chains: Sequence[Chain]) -> BeforeUse:
    """The report on the channel of a live smoother whose answer is noisiest.

    At rest the smoother is a linear filter; its impulse response h is had by giving it one sample of one standard
    deviation, too little to be taken for an event: noise gain sqrt(sum h^2), bandwidth of |H G|, step of h * chain.
    """
    dt, span = engine.dt_s, max(s.lag_s for s in engine.sensors)
    rows = int(min(8 * span / dt + 4 * engine.lag_samples + 200, 4000))
    y = np.zeros((2 * rows, len(chains)))
    y[rows] = engine.noise_sd
    _, x, _, _ = engine.run(engine.start(np.zeros(len(chains))), y)
    pulses = x[rows:] / engine.noise_sd
    gains = np.sqrt(np.sum(pulses**2, axis=0))
    worst = int(np.argmax(gains * engine.noise_sd))
    h, chain, gain = pulses[:, worst], chains[worst], float(gains[worst])
    found = [look("live.noisy", gain=gain)] if gain > MOST_GAIN else []
    raw = _step(chain, dt, rows, 1)
    freq = np.geomspace(1e-3 / span, 0.499 / dt, 1500)
    own = np.exp(-2j * np.pi * freq[:, None] * dt * np.arange(rows)) @ h
    through = np.abs(own * chain.frequency_response(freq))
    ramp = float(np.sum(np.arange(rows) * h) * dt + chain.lag_s)
    step = np.asarray(np.convolve(raw, h)[:rows], dtype=np.float64)
    return _report(
        chain, dt, raw, step, (gain, gain * float(engine.noise_sd[worst])),
        _first_below(freq, through), chain.delay_s + engine.lag_samples * dt, ramp, found,
    )  # fmt: skip


def _step(chain: Chain, dt_s: float, rows: int, fine: int) -> Array:
    """What the chain makes of a step at the second of ``rows`` samples, simulated ``fine`` times as finely."""
    u = np.zeros(rows * fine)
    u[fine:] = 1.0
    return np.asarray(chain.response(u, dt_s / fine, hold="zoh")[::fine], dtype=np.float64)


def _report(
    chain: Chain, dt_s: float, raw: Array, step: Array, noise: tuple[float, float], bandwidth_Hz: float,
    shift_s: float, ramp_s: float, found: Sequence[Finding],
) -> BeforeUse:  # fmt: skip
    """The figures that every compensator has; ``noise``: gain, and what comes out [K]."""
    t = np.asarray((np.arange(len(raw)) - 1.0) * dt_s, dtype=np.float64)
    freq = np.geomspace(1e-4, 1e3, 4000) / max(chain.lag_s, 1e-6)
    alone = _first_below(freq, np.abs(chain.frequency_response(freq)))
    late = [look("inverse.dead_time")] if chain.delay_s > 0 or chain.zero_s < 0 else []
    return BeforeUse(
        *noise, bandwidth_Hz, alone, _rise(t, step), _rise(t, raw), float(max(step.max() - 1.0, 0.0)), shift_s, ramp_s,
        t, step, raw, (*found, *late),
    )  # fmt: skip


def widest_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, wanted_K: float) -> float:
    """Largest bandwidth [Hz] of the proper inverse whose answer has at most ``wanted_K`` of noise; 0 if none."""
    tried = np.geomspace(1e-3, 0.45, 40) / dt_s
    fits = [bw for bw in tried if proper_inverse(chain, dt_s, float(bw)).noise_gain * noise_sd <= wanted_K]
    return float(max(fits)) if fits else 0.0


def smoother_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, intensity: float) -> float:
    """Where the smoother hands over from data to prior [Hz]: |G|^2 q / w^4 equals the noise density."""
    return float(corner_rad_s(chain, np.array(intensity / (noise_sd**2 * dt_s)))) / (2 * np.pi)


def _first_below(freq: Array, gain: Array) -> float:
    """The first of the frequencies (N,) [Hz] at which a gain (N,) is below 1/sqrt 2; the last where none is."""
    below = np.flatnonzero(gain < np.sqrt(0.5))
    return float(freq[below[0]]) if len(below) else float(freq[-1])


def _rise(t: Array, step: Array) -> float:
    """Time from 10 to 90 % of a step response (N,) at times (N,) [s], first crossings."""
    start, end = (
        float(np.interp(level, step[max(k - 1, 0) : k + 1], t[max(k - 1, 0) : k + 1]))
        for level, k in ((level, int(np.argmax(step >= level))) for level in (0.1, 0.9))
    )
    return end - start
