"""The proper inverse, causal and fast: a second opinion; and what such a filter will do, said before it is used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.ndimage import uniform_filter1d

from tcdyn.chain import Chain, discretised
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, messages, warning
from tcdyn.core.result import Result
from tcdyn.smoothing.intervals import corner_rad_s
from tcdyn.smoothing.record import Compensated, stretch_of


@dataclass(frozen=True)
class InverseFilter:
    """C(s) = R(s) / G_0(s), R = 1/(1 + s/w)^m with |R| = 1/sqrt 2 at ``bandwidth_Hz``, as a digital filter b / a.

    G_0 is the chain without its dead time, a right-half-plane zero mirrored: what is left of both is a shift, not
    inverted. m is the excess of poles of G_0 (at least 1), so that C is proper; ``a`` holds only poles of R and zeros
    of G_0, all stable. ``remaining_shift_s``: dead time + 2 |mirrored zero| + m/w, by which the answer comes late.
    """

    b: Array
    a: Array
    dt_s: float
    bandwidth_Hz: float
    remaining_shift_s: float
    chain: Chain

    @property
    def noise_gain(self) -> float:
        """Standard deviation out over in, for white noise: sqrt(sum of the squared impulse response)."""
        poles = np.roots(self.a) if len(self.a) > 1 else np.zeros(1)
        slowest = float(np.max(np.abs(poles), initial=0.0))
        length = int(min(np.log(1e-9) / np.log(max(slowest, 0.1)), 4e6)) + 64 + len(self.b)
        return float(
            np.sqrt(np.sum(signal.lfilter(self.b, self.a, np.r_[1.0, np.zeros(length - 1)]) ** 2))
        )

    def __call__(self, y: ArrayLike) -> Array:
        """Apply to ``y`` (N,) or (N, M) [degC], from equilibrium with the first sample; same shape."""
        y = np.asarray(y, dtype=float)
        zi = signal.lfilter_zi(self.b, self.a)
        zi = zi.reshape(-1, *(1,) * (y.ndim - 1)) * y[:1]
        return np.asarray(signal.lfilter(self.b, self.a, y, axis=0, zi=zi)[0])

    def frequency_response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """The digital filter's own response, same shape as ``frequency_Hz``."""
        z = np.exp(-2j * np.pi * self.dt_s * np.asarray(frequency_Hz, dtype=float))
        return np.asarray(np.polyval(self.b[::-1], z) / np.polyval(self.a[::-1], z))


def proper_inverse(chain: Chain, dt_s: float, bandwidth_Hz: float) -> InverseFilter:
    """The proper inverse of ``chain`` for samples every ``dt_s`` [s], exact for a trace straight between samples.

    >>> f = proper_inverse(Chain(0.6), 1 / 75, 1.0)
    >>> round(f.remaining_shift_s, 3), round(float(f.b.sum() / f.a.sum()), 9)
    (0.159, 1.0)

    Raises:
        InputError: bandwidth not below half the sampling frequency.
    """
    nyquist = 0.5 / dt_s
    if not 0 < bandwidth_Hz < nyquist:
        raise InputError(
            f"compensate: bandwidth_Hz must be between 0 and {nyquist:g} (half of the {1 / dt_s:g} Hz sampling); "
            f"got {bandwidth_Hz:g}",
            remedy="lower it",
        )
    zero = chain.zero_s
    num, den = replace(chain, zero_s=abs(zero), delay_s=0.0).rational.polynomials()
    m = max(len(den) - len(num), 1)
    w = 2 * np.pi * bandwidth_Hz / float(2.0 ** (1 / m) - 1) ** 0.5
    b, a = discretised(den, np.polymul(num, np.poly(np.full(m, -w)) / w**m), dt_s)
    b = b * (np.sum(a) / np.sum(b))  # static gain one to rounding
    shift = chain.delay_s + (2 * abs(zero) if zero < 0 else 0.0)
    return InverseFilter(b, a, dt_s, bandwidth_Hz, shift + m / w, chain)


def invert(
    y: ArrayLike,
    dt_s: float,
    chains: float | Chain | Sequence[Chain],
    bandwidth_Hz: float,
    *,
    noise_sd: ArrayLike | None = None,
    lag_covariance: ArrayLike | None = None,
    static_u: ArrayLike | None = None,
    names: Sequence[str] | None = None,
) -> Compensated:
    """Causal compensation of a whole record with a stated bandwidth; arguments and result as for ``smooth``.

    ``sd_noise`` is hypot(noise gain times noise, remaining shift times |slope|): the answer is late by the remaining
    shift and says so in its band instead of being moved. Bad samples are bridged by straight lines before filtering.
    """
    record = stretch_of(y, dt_s, chains, (), noise_sd, names)
    sd = record.noise_sd
    x, lag, slope, own = np.empty((4, *record.y.shape))
    for c, chain in enumerate(record.chains):
        f = proper_inverse(chain, dt_s, bandwidth_Hz)
        x[:, c] = f(record.y[:, c])
        lag[:, c] = lag_sensitivity(f, record.y[:, c])
        slope[:, c] = np.gradient(x[:, c], dt_s)
        width = max(int(f.remaining_shift_s / dt_s), 1)
        calm = uniform_filter1d(slope[:, c], 2 * width + 1, mode="nearest")
        own[:, c] = np.hypot(f.noise_gain * sd[c], f.remaining_shift_s * calm)
    done = Compensated.of(
        x,
        own,
        slope,
        lag,
        lag_covariance,
        static_u,
        dt_s,
        noise_sd=sd,
        intensity=np.full(len(sd), np.nan),
        flags=record.flags,
        method=f"proper inverse, {bandwidth_Hz:g} Hz",
        findings=record.findings,
    )
    return done.checked(
        record.y, [f"channel {c + 1}" for c in range(len(sd))] if names is None else list(names)
    )


def lag_sensitivity(f: InverseFilter, y: ArrayLike) -> Array:
    """Change of the answer per second of the largest lag [K/s], shape of ``y``: s/(1 + tau s) times the inverse."""
    x = f(y)
    return np.asarray(signal.lfilter(*lag_rate(f.chain, f.dt_s), x - x[:1], axis=0))


def lag_rate(chain: Chain, dt_s: float) -> tuple[Array, Array]:
    """s/(1 + tau s), tau the largest lag, as a digital filter: what it makes of an answer is its change per lag."""
    e = float(np.exp(-dt_s / max((*chain.taus_s, dt_s))))
    return np.array([1.0, -1.0]) * (1 - e) / dt_s, np.array([1.0, -e])


def split_change(chain: Chain, shift_s: float, dt_s: float) -> tuple[Array, Array]:
    """(t1 t2 - t1' t2') s^2/((1 + t1' s)(1 + t2' s)) likewise: the change where lags are ``Chain.with_split_shift``.

    What a single lag gives away goes to a second one, which makes of slow changes what a dead time makes.
    """
    first, second = [*sorted(chain.taus_s, reverse=True), 0.0, 0.0][:2]
    left = max(first - shift_s, 0.0)
    right = second + min(shift_s, first)
    lags = np.maximum([left, right], dt_s)
    b, a = discretised([1.0, 0.0, 0.0], [lags[0] * lags[1], lags.sum(), 1.0], dt_s)
    return (first * second - left * right) * b, a


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
        return messages(self.findings)

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
    dt = f.dt_s
    noise_out = f.noise_gain * noise_sd
    limit = 100.0 * noise_sd if wanted_K is None else wanted_K
    found = []
    if noise_out > limit:
        best = widest_bandwidth_Hz(f.chain, dt, noise_sd, limit)
        found.append(
            warning(
                "inverse.noisy",
                bandwidth_Hz=f.bandwidth_Hz,
                noise_K=noise_out,
                limit_K=limit,
                best_Hz=best,
            )
        )
    if f.bandwidth_Hz > 0.2 / dt:
        found.append(warning("inverse.near_nyquist", bandwidth_Hz=f.bandwidth_Hz, rate_Hz=1 / dt))
    return filter_report(f, noise_sd, found)


def filter_report(f: InverseFilter, noise_sd: float, found: Sequence[Finding]) -> BeforeUse:
    """The figures of any digital compensator; ``found``: what is to be said of it first."""
    dt = f.dt_s
    chain = f.chain
    gain = f.noise_gain
    rows = int(min(max(12 * (chain.lag_s + f.remaining_shift_s) / dt + 20, 64), 400_000))
    fine = max(int(np.ceil(400 / rows)), 1)
    u = np.zeros(rows * fine)
    u[fine:] = 1.0  # a step at the second sample
    raw = np.asarray(chain.response(u, dt / fine, hold="zoh")[::fine], dtype=np.float64)
    step = np.asarray(signal.lfilter(f.b, f.a, raw), dtype=np.float64)
    t = np.asarray((np.arange(rows) - 1.0) * dt, dtype=np.float64)
    freq = np.geomspace(1e-4, 0.499, 3000) / dt
    wide = np.geomspace(1e-4, 1e3, 4000) / max(chain.lag_s, 1e-6)
    b = np.arange(len(f.b)) @ f.b / np.sum(f.b)
    a = np.arange(len(f.a)) @ f.a / np.sum(f.a)
    late = [warning("inverse.dead_time")] if chain.delay_s > 0 or chain.zero_s < 0 else []
    return BeforeUse(
        noise_gain=gain,
        noise_out_K=gain * noise_sd,
        bandwidth_Hz=_first_below(
            freq, np.abs(f.frequency_response(freq) * chain.frequency_response(freq))
        ),
        raw_bandwidth_Hz=_first_below(wide, np.abs(chain.frequency_response(wide))),
        rise_s=_rise(t, step),
        raw_rise_s=_rise(t, raw),
        overshoot=float(max(step.max() - 1.0, 0.0)),
        remaining_shift_s=f.remaining_shift_s,
        bias_K_per_K_s=float(dt * (b - a) + chain.lag_s),
        step_time_s=t,
        step=step,
        raw_step=raw,
        findings=(*found, *late),
    )


def widest_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, wanted_K: float) -> float:
    """Largest bandwidth [Hz] of the proper inverse whose answer has at most ``wanted_K`` of noise; 0 if none."""
    tried = np.geomspace(1e-3, 0.45, 40) / dt_s
    fits = [
        bw
        for bw in tried
        if proper_inverse(chain, dt_s, float(bw)).noise_gain * noise_sd <= wanted_K
    ]
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
