"""The proper inverse: one over the chain, times a roll-off of stated bandwidth; causal, stable, fast; its band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.ndimage import uniform_filter1d

from calibration.arrays import Array
from calibration.errors import InputError
from tcdyn.chain import Chain, discretised
from tcdyn.compensate.result import Compensated, channel_noise_sd, columns_of
from tcdyn.compensate.sweep import stretch_of


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
    order: int
    remaining_shift_s: float
    rolloff_lag_s: float
    chain: Chain

    @property
    def noise_gain(self) -> float:
        """Standard deviation out over in, for white noise: sqrt(sum of the squared impulse response)."""
        return noise_gain(self.b, self.a)

    def __call__(self, y: ArrayLike) -> Array:
        """Apply to ``y`` (N,) or (N, M) [degC], from equilibrium with the first sample; same shape."""
        y = np.asarray(y, dtype=float)
        zi = signal.lfilter_zi(self.b, self.a)
        zi = zi.reshape(-1, *(1,) * (y.ndim - 1)) * y[:1]
        return np.asarray(signal.lfilter(self.b, self.a, y, axis=0, zi=zi)[0])

    def frequency_response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """The digital filter's own response, same shape as ``frequency_Hz``."""
        f = np.asarray(frequency_Hz, dtype=float)
        return np.asarray(signal.freqz(self.b, self.a, worN=np.atleast_1d(2 * np.pi * f * self.dt_s))[1]).reshape(
            f.shape
        )


def proper_inverse(chain: Chain, dt_s: float, bandwidth_Hz: float) -> InverseFilter:
    """The proper inverse of ``chain`` for samples every ``dt_s`` [s], exact for a trace straight between samples.

    >>> f = proper_inverse(Chain((0.6,)), 1 / 75, 1.0)
    >>> round(f.remaining_shift_s, 3), round(float(f.b.sum() / f.a.sum()), 9)
    (0.243, 1.0)

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
    bottom = num
    for _ in range(m):
        bottom = np.polymul(bottom, [1 / w, 1.0])
    b, a = _sampled(den, bottom, dt_s)
    shift = chain.delay_s + (2 * abs(zero) if zero < 0 else 0.0)
    return InverseFilter(b, a, dt_s, bandwidth_Hz, m, shift + m / w, m / w, chain)


def invert(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
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
    data = columns_of(y)
    sd = channel_noise_sd(data, noise_sd)
    stretch, flags, findings = stretch_of(data, dt_s, chains, (), sd, names)
    x, lag, slope, own = (np.empty(data.shape) for _ in range(4))
    for c, chain in enumerate(stretch.chains):
        f = proper_inverse(chain, dt_s, bandwidth_Hz)
        x[:, c] = f(stretch.y[:, c])
        lag[:, c] = lag_sensitivity(f, stretch.y[:, c])
        slope[:, c] = np.gradient(x[:, c], dt_s)
        width = max(int(f.remaining_shift_s / dt_s), 1)
        calm = uniform_filter1d(slope[:, c], 2 * width + 1, mode="nearest")
        own[:, c] = np.hypot(f.noise_gain * sd[c], f.remaining_shift_s * calm)
    return Compensated.of(
        x, own, slope, lag, lag_covariance, static_u, dt_s, noise_sd=sd, intensity=np.full(len(sd), np.nan),
        flags=flags, method=f"proper inverse, {bandwidth_Hz:g} Hz", findings=findings,
    )  # fmt: skip


def lag_sensitivity(f: InverseFilter, y: ArrayLike) -> Array:
    """Change of the answer per second of the largest lag [K/s], shape of ``y``: s/(1 + tau s) times the inverse."""
    taus = [tau for tau in f.chain.taus_s if tau > 0]
    tau = max(taus) if taus else 0.0
    x = f(y)
    if tau == 0.0:
        return np.asarray(np.gradient(x, f.dt_s, axis=0))
    e = float(np.exp(-f.dt_s / tau))
    part = (1 - e) * tau / f.dt_s
    lagged = signal.lfilter([1 - part, part - e], [1, -e], x - x[:1], axis=0)
    return np.asarray((x - x[:1] - lagged) / tau)


def noise_gain(b: Array, a: Array) -> float:
    """Gain of a digital filter for white noise, summed until its impulse response has died away."""
    poles = np.roots(a) if len(a) > 1 else np.zeros(1)
    slowest = float(np.max(np.abs(poles), initial=0.0))
    length = int(min(np.log(1e-9) / np.log(max(slowest, 0.1)), 4e6)) + 64
    pulse = np.zeros(length)
    pulse[0] = 1.0
    return float(np.sqrt(np.sum(signal.lfilter(b, a, pulse) ** 2)))


def _sampled(num: Array, den: Array, dt_s: float) -> tuple[Array, Array]:
    """Digital form of num/den, exact for input straight between samples (FOH), its static gain one to rounding."""
    b, a = discretised(num, den, dt_s)
    return b * (np.sum(a) / np.sum(b)), a
