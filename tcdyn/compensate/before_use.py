"""What a compensator will do to a trace, said before it is applied."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from calibration.result import Result
from tcdyn.chain import Chain
from tcdyn.compensate.grid import corner_rad_s
from tcdyn.compensate.inverse import InverseFilter, proper_inverse

Array = NDArray[np.float64]


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
    warnings: tuple[str, ...]

    def summary(self) -> str:
        """The report in words."""
        return "\n".join(
            [
                f"noise gain {self.noise_gain:.3g}: the answer has a noise of {self.noise_out_K:.3g} K",
                f"bandwidth {self.bandwidth_Hz:.3g} Hz (uncompensated {self.raw_bandwidth_Hz:.3g} Hz)",
                f"step response, 10 to 90 %: {self.rise_s:.3g} s (uncompensated {self.raw_rise_s:.3g} s), "
                f"overshoot {100 * self.overshoot:.2g} %",
                f"remaining shift {self.remaining_shift_s:.3g} s: on a ramp of 1 K/s the answer is "
                f"{self.bias_K_per_K_s if abs(self.bias_K_per_K_s) > 1e-6 else 0.0:.3g} K behind",
                *self.warnings,
            ]
        )


def before_use(f: InverseFilter, noise_sd: float, wanted_K: float | None = None) -> BeforeUse:
    """The report on a proper inverse for a trace with white noise ``noise_sd`` [K].

    A warning comes when the answer would be noisier than ``wanted_K`` [K] (left out: than a hundred times the trace),
    with the bandwidth that can be had; and when the sampling is too slow for the bandwidth.
    """
    dt, chain = f.dt_s, f.chain
    span = 12 * (chain.lag_s + f.remaining_shift_s) + 20 * dt
    n = int(min(max(span / dt, 64), 400_000))
    fine = max(int(np.ceil(400 / n)), 1)
    u = np.zeros(n * fine)
    u[fine:] = 1.0
    raw = chain.response(u, dt / fine, hold="zoh")[::fine]
    step = signal.lfilter(f.b, f.a, raw)
    t = np.asarray((np.arange(n) - 1.0) * dt, dtype=np.float64)
    gain = f.noise_gain
    limit = 100.0 * noise_sd if wanted_K is None else wanted_K
    said = []
    if gain * noise_sd > limit:
        best = widest_bandwidth_Hz(chain, dt, noise_sd, limit)
        had = f"at most {best:.3g} Hz can be had" if best > 0 else "no bandwidth gives that"
        said.append(
            f"a bandwidth of {f.bandwidth_Hz:.3g} Hz makes {gain * noise_sd:.3g} K of noise, more than the "
            f"{limit:.3g} K allowed: {had} at this noise"
        )
    if f.bandwidth_Hz > 0.2 / dt:
        said.append(
            f"a bandwidth of {f.bandwidth_Hz:.3g} Hz is near half of the {1 / dt:.3g} Hz sampling: between samples the "
            "answer is not what the formula says"
        )
    if chain.delay_s > 0 or chain.zero_s < 0:
        said.append("dead time and right-half-plane zeros cannot be inverted: they remain as a shift")
    return BeforeUse(
        gain, gain * noise_sd, _bandwidth(f), _bandwidth_of_chain(chain), rise(t, step), rise(t, raw),
        float(max(step.max() - 1.0, 0.0)), f.remaining_shift_s, f.remaining_shift_s, t, step, raw, tuple(said),
    )  # fmt: skip


def widest_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, wanted_K: float) -> float:
    """Largest bandwidth [Hz] of the proper inverse whose answer has at most ``wanted_K`` of noise; 0 if none."""
    tried = np.geomspace(1e-3, 0.45, 40) / dt_s
    fits = [bw for bw in tried if proper_inverse(chain, dt_s, float(bw)).noise_gain * noise_sd <= wanted_K]
    return float(max(fits)) if fits else 0.0


def smoother_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, intensity: float) -> float:
    """Where the smoother hands over from data to prior [Hz]: |G|^2 q / w^4 equals the noise density."""
    return float(corner_rad_s(chain, np.array(intensity / (noise_sd**2 * dt_s)))) / (2 * np.pi)


def _bandwidth(f: InverseFilter) -> float:
    freq = np.geomspace(1e-4, 0.499, 3000) / f.dt_s
    return first_below(freq, np.abs(f.frequency_response(freq) * f.chain.frequency_response(freq)))


def _bandwidth_of_chain(chain: Chain) -> float:
    freq = np.geomspace(1e-4, 1e3, 4000) / max(chain.lag_s, 1e-6)
    return first_below(freq, np.abs(chain.frequency_response(freq)))


def first_below(freq: Array, gain: Array) -> float:
    """The first of the frequencies (N,) [Hz] at which a gain (N,) is below 1/sqrt 2; the last where none is."""
    below = np.flatnonzero(gain < np.sqrt(0.5))
    return float(freq[below[0]]) if len(below) else float(freq[-1])


def rise(t: Array, step: Array) -> float:
    """Time from 10 to 90 % of a step response (N,) at times (N,) [s], first crossings."""
    first = int(np.argmax(step >= 0.1)), int(np.argmax(step >= 0.9))
    times = [
        float(np.interp(level, step[max(k - 1, 0) : k + 1], t[max(k - 1, 0) : k + 1]))
        for level, k in zip((0.1, 0.9), first)
    ]
    return times[1] - times[0]
