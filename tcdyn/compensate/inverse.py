"""Second opinions: the proper inverse, causal and fast, and regularised deconvolution, without phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.ndimage import uniform_filter1d

from calibration import Array
from calibration.errors import InputError
from tcdyn.chain import Chain, discretised
from tcdyn.compensate.grid import Intensity, read_variance, readings
from tcdyn.compensate.result import Compensated, channel_noise_sd, columns_of
from tcdyn.compensate.smoother import smooth
from tcdyn.compensate.sweep import Stretch, stretch_of, swept

Criterion = Literal["gcv", "discrepancy", "l-curve"]


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
        length = int(min(np.log(1e-9) / np.log(max(slowest, 0.1)), 4e6)) + 64
        return float(np.sqrt(np.sum(signal.lfilter(self.b, self.a, np.r_[1.0, np.zeros(length - 1)]) ** 2)))

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
    b, a = discretised(den, np.polymul(num, np.poly(np.full(m, -w)) / w**m), dt_s)
    b = b * (np.sum(a) / np.sum(b))  # static gain one to rounding
    shift = chain.delay_s + (2 * abs(zero) if zero < 0 else 0.0)
    return InverseFilter(b, a, dt_s, bandwidth_Hz, shift + m / w, chain)


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


@dataclass(frozen=True)
class Tradeoff:
    """The choice of weight as data, one row a trial: ``intensity (L, M)`` = noise variance / weight [K2/s3],

    ``misfit (L, M)`` mean square residual [K2], ``roughness (L, M)`` integral of x''2 [K2/s3], ``freedom (L, M)``
    trace of the influence matrix, ``chosen (M,)`` [K2/s3].
    """

    intensity: Array
    misfit: Array
    roughness: Array
    freedom: Array
    chosen: Array
    criterion: str


def deconvolve(
    y: ArrayLike,
    dt_s: float,
    chains: Chain | Sequence[Chain],
    *,
    criterion: Criterion = "gcv",
    noise_sd: ArrayLike | None = None,
    lag_covariance: ArrayLike | None = None,
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
        chains: one for all channels or one per channel.
        noise_sd: per channel [K]; estimated when left out.
        lag_covariance, static_u, names: as in ``smooth``.
        trials: number of weights tried, evenly in their logarithm.
    """
    data = columns_of(y)
    m = data.shape[1]
    sd = channel_noise_sd(data, noise_sd)
    stretch, _, _ = stretch_of(data, dt_s, chains, (), sd, names)
    levels = np.geomspace(1e-4, 1e7, trials)
    rows = [_trial(stretch, sd**2, level * sd**2) for level in levels]
    misfit, roughness, freedom = (np.array([row[k] for row in rows]) for k in range(3))
    used = (stretch.weight > 0).sum(axis=0)
    chosen = np.array(
        [_pick(criterion, levels, misfit[:, c], roughness[:, c], freedom[:, c], used[c], sd[c] ** 2) for c in range(m)]
    )
    result = smooth(
        data,
        dt_s,
        chains,
        noise_sd=sd,
        intensity=list(chosen * sd**2),
        lag_covariance=lag_covariance,
        static_u=static_u,
        names=names,
    )
    named = replace(result, method=f"regularised deconvolution, weight by {criterion}")
    return named, Tradeoff(levels[:, None] * sd**2, misfit, roughness, freedom, chosen * sd**2, criterion)


def _trial(stretch: Stretch, noise_var: Array, level: Array) -> tuple[Array, Array, Array]:
    """Misfit, roughness and freedom (M,) at one intensity per channel."""
    grid, states = swept(stretch, noise_var, [Intensity.constant(q) for q in level])
    n = len(stretch.y)
    misfit, roughness, freedom = [], [], []
    lengths = np.diff(grid.knots_s)
    for c, s in enumerate(stretch.sensors):
        w = stretch.weight[:, c]
        residual = stretch.y[:, c] - readings(grid, s, states.mean[:, c], n, stretch.dt_s)
        misfit.append(float(np.sum(w * residual**2) / np.sum(w)))
        roughness.append(float(np.sum(np.diff(states.mean[:, c, 1]) ** 2 / lengths[1:])))
        variance = read_variance(grid, s, states.cov[:, c], n, stretch.dt_s)
        freedom.append(float(np.sum(w * variance) / noise_var[c]))
    return np.array(misfit), np.array(roughness), np.array(freedom)


def _pick(
    criterion: Criterion, levels: Array, misfit: Array, roughness: Array, freedom: Array, used: int, noise_var: float
) -> float:
    """Intensity over noise variance that meets the criterion, between the trials by a parabola or a straight line."""
    logs = np.log(levels)
    if criterion == "discrepancy":  # the misfit falls as the intensity rises
        return float(np.exp(np.interp(-np.log(noise_var), -np.log(misfit), logs)))
    if criterion == "gcv":
        score = np.log(misfit / (1 - freedom / used) ** 2)
    else:
        a, b = np.log(misfit), np.log(np.maximum(roughness, 1e-300))
        da, db = np.gradient(a, logs), np.gradient(b, logs)
        bend = (da * np.gradient(db, logs) - db * np.gradient(da, logs)) / (da**2 + db**2) ** 1.5
        score = -np.abs(bend)
        score[:2] = score[-2:] = np.inf
    k = int(np.argmin(score))
    if criterion == "l-curve" or k in (0, len(levels) - 1):
        return float(levels[k])
    c2, c1, _ = np.polyfit(logs[k - 1 : k + 2] - logs[k], score[k - 1 : k + 2], 2)
    return float(levels[k] * np.exp(np.clip(-c1 / (2 * c2), -1, 1)))
