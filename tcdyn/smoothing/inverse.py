"""The proper inverse of a chain (causal and fast), and the report on a filter before it is used.

C(s) = R(s)/G_0(s), with a roll-off R of given bandwidth and the chain G_0 without what cannot be
inverted. Used by :mod:`tcdyn.sensors.compensation`, :mod:`tcdyn.workflows.compensate` and
:mod:`tcdyn.report.compensate`; the reports and the filters for lags also by the live smoother.
Guarded by ``tests/smoothing/test_causal.py`` and ``tests/smoothing/test_before_use.py``, which
compare with closed forms. Limits without a source were chosen by judgement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.ndimage import uniform_filter1d

from tcdyn.chain import Chain, discretised
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.labels import labels_of
from tcdyn.core.result import Result
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.record import Compensated, channel_names, record_of

# Share to which an impulse response must have decayed, and most rows of it, for the noise gain.
DECAYED = 1e-9
MAX_DECAY_ROWS = 4e6
# Noise of the result over that of the trace, from which there is a warning; chosen by judgement.
MAX_NOISE_GAIN = 100.0
# Bandwidth over the sampling frequency, from which there is a warning; chosen by judgement.
MAX_BANDWIDTH_SHARE = 0.2
# Rows of the step response in a report: so many times lag and shift, plus a few, within bounds that
# limit the time; and fewest points of the raw step, which is oversampled. Chosen by judgement.
STEP_LAGS = 12
STEP_MARGIN_ROWS = 20
STEP_ROWS = (64, 400_000)
MIN_STEP_POINTS = 400


@dataclass(frozen=True)
class InverseFilter:
    """The digital filter b / a of the compensator C(s) = R(s) / G_0(s).

    R = 1/(1 + s/w)^m is a roll-off with |R| = 1/sqrt 2 at ``bandwidth_Hz``. G_0 is the chain
    without its dead time and with a right-half-plane zero mirrored; the remaining effect of both is
    a shift in time, which is not inverted. m is the excess of poles of G_0 (at least 1), so that C
    is proper. ``a`` contains only poles of R and zeros of G_0, all of them stable.

    Parameters
    ----------
    b, a
        Numerator and denominator in powers of z^-1.
    dt_s
        Sampling interval [s].
    bandwidth_Hz
        Bandwidth of R [Hz].
    remaining_shift_s
        Delay of the result [s]: dead time + 2 |mirrored zero| + m/w.
    chain
        The chain that is inverted.
    """

    b: Array
    a: Array
    dt_s: float
    bandwidth_Hz: float
    remaining_shift_s: float
    chain: Chain

    @property
    def noise_gain(self) -> float:
        """Ratio of output and input standard deviation for white noise.

        The square root of the sum of the squared impulse response, until it has decayed.
        """
        return float(np.sqrt(np.sum(self._impulse_response() ** 2)))

    @property
    def rate_noise_gain(self) -> float:
        """Noise of the rate of change over that of the input [1/s].

        The rate is that of ``numpy.gradient``. Zeros beside the response make both its ends count.
        """
        response = np.pad(self._impulse_response(), 2)
        return float(np.sqrt(np.sum(np.gradient(response, self.dt_s) ** 2)))

    def _impulse_response(self) -> Array:
        """The impulse response until it has decayed."""
        poles = np.roots(self.a) if len(self.a) > 1 else np.zeros(1)
        slowest = float(np.max(np.abs(poles), initial=0.0))
        decay_rows = np.log(DECAYED) / np.log(max(slowest, 0.1))
        length = int(min(decay_rows, MAX_DECAY_ROWS)) + 64 + len(self.b)
        impulse = np.zeros(length)
        impulse[0] = 1.0
        return np.asarray(signal.lfilter(self.b, self.a, impulse))

    def __call__(self, y: ArrayLike) -> Array:
        """Filter readings from equilibrium with the first sample.

        Parameters
        ----------
        y
            Readings (N,) or (N, M) [degC], finite.

        Returns
        -------
        Array
            Compensated temperature [degC], same shape.
        """
        y = np.asarray(y, dtype=float)
        zi = signal.lfilter_zi(self.b, self.a)
        zi = zi.reshape(-1, *[1] * (y.ndim - 1)) * y[:1]
        return np.asarray(signal.lfilter(self.b, self.a, y, axis=0, zi=zi)[0])

    def frequency_response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response of the digital filter, same shape as ``frequency_Hz``."""
        z = np.exp(-2j * np.pi * self.dt_s * np.asarray(frequency_Hz, dtype=float))
        return np.asarray(np.polyval(self.b[::-1], z) / np.polyval(self.a[::-1], z))


@with_named_arguments
def proper_inverse(chain: Chain, dt_s: float, bandwidth_Hz: float) -> InverseFilter:
    """The proper inverse of a chain, exact for a trace that is straight between samples.

    Parameters
    ----------
    chain
        The chain to invert.
    dt_s
        Sampling interval [s].
    bandwidth_Hz
        Bandwidth of chain times inverse [Hz], where the gain is 1/sqrt 2.

    Returns
    -------
    InverseFilter
        The filter; its static gain is one.

    Raises
    ------
    InputError
        If the bandwidth is not below half the sampling frequency.

    Notes
    -----
    What may be changed: the roll-off R, if it stays stable and of at least the same order. Then w
    and ``remaining_shift_s`` must follow: the latter is the slope of the phase of R at zero
    frequency. ``tests/smoothing/test_causal.py`` checks stability, gain and bandwidth,
    ``tests/smoothing/test_before_use.py`` the shift.

    Examples
    --------
    >>> f = proper_inverse(Chain(0.6), 1 / 75, 1.0)
    >>> round(f.remaining_shift_s, 3), round(float(f.b.sum() / f.a.sum()), 9)
    (0.159, 1.0)
    """
    nyquist = 0.5 / dt_s
    if not 0 < bandwidth_Hz < nyquist:
        raise InputError(
            f"compensate: bandwidth_Hz must be between 0 and {nyquist:g} "
            f"(half of the {1 / dt_s:g} Hz sampling); "
            f"got {bandwidth_Hz:g}",
            remedy="lower it",
        )
    zero = chain.zero_s
    num, den = replace(chain, zero_s=abs(zero), delay_s=0.0).rational.polynomials()
    m = max(len(den) - len(num), 1)
    w = 2 * np.pi * bandwidth_Hz / float(2.0 ** (1 / m) - 1) ** 0.5
    b, a = discretised(den, np.polymul(num, np.poly(np.full(m, -w)) / w**m), dt_s)
    b = b * (np.sum(a) / np.sum(b))  # the static gain is one
    shift = chain.delay_s + (2 * abs(zero) if zero < 0 else 0.0)
    return InverseFilter(b, a, dt_s, bandwidth_Hz, shift + m / w, chain)


@with_named_arguments
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
    units: Sequence[str] | None = None,
) -> Compensated:
    """Compensate a full record causally with a given bandwidth.

    Parameters
    ----------
    y
        Readings (N,) or (N, M) after the static line [degC], NaN where missing.
    dt_s
        Sampling interval [s].
    chains
        One chain for all channels or one per channel; a number is one lag [s].
    bandwidth_Hz
        Bandwidth of the compensated signal [Hz].
    noise_sd, lag_covariance, static_u, names, units
        As in ``tcdyn.smoothing.smoother.smooth``.

    Returns
    -------
    Compensated
        With arrays (N, M); ``intensity`` is NaN.

    Notes
    -----
    ``sd_noise`` is hypot(noise gain times noise, remaining shift times |slope|): the result is late
    by the remaining shift, and its uncertainty includes this; it is not shifted. The slope is
    averaged over twice the remaining shift. Bad samples are interpolated linearly before filtering.
    ``tests/smoothing/test_smoother.py`` checks the coverage.

    Examples
    --------
    >>> reading = 20 + np.random.default_rng(0).normal(0, 0.1, 100)
    >>> invert(reading, 0.1, Chain(0.5), bandwidth_Hz=1.0).temperature.shape
    (100, 1)
    """
    record = record_of(y, dt_s, chains, (), noise_sd, names, units)
    sd = record.noise_sd
    x, lag, slope, sd_noise, slope_sd = np.empty((5, *record.y.shape))
    names = names or labels_of(y) or channel_names(None, len(sd))
    for c, chain in enumerate(record.chains):
        f = proper_inverse(chain, dt_s, bandwidth_Hz)
        x[:, c] = f(record.y[:, c])
        lag[:, c] = lag_sensitivity(f, record.y[:, c])
        slope[:, c] = np.gradient(x[:, c], dt_s)
        width = max(int(f.remaining_shift_s / dt_s), 1)
        mean_slope = uniform_filter1d(slope[:, c], 2 * width + 1, mode="nearest")
        sd_noise[:, c] = np.hypot(f.noise_gain * sd[c], f.remaining_shift_s * mean_slope)
        mean_curvature = np.gradient(mean_slope, dt_s)
        slope_sd[:, c] = np.hypot(f.rate_noise_gain * sd[c], f.remaining_shift_s * mean_curvature)
    result = Compensated.from_components(
        x,
        sd_noise,
        slope,
        slope_sd,
        lag,
        lag_covariance,
        static_u,
        dt_s,
        noise_sd=sd,
        intensity=np.full(len(sd), np.nan),
        flags=record.flags,
        method=f"proper inverse, {bandwidth_Hz:g} Hz",
        findings=record.findings,
        units=record.units,
    )
    return result.with_undetermined(record.y, names, record.chains).with_labels(y, names)


def lag_sensitivity(inverse: InverseFilter, y: ArrayLike) -> Array:
    """Change of the compensated temperature per second of the largest lag [K/s].

    Parameters
    ----------
    inverse
        The inverse.
    y
        Readings (N,) or (N, M) [degC].

    Returns
    -------
    Array
        Shape of ``y``.

    Notes
    -----
    It is s/(1 + tau s) times the inverse, tau the largest lag: the derivative of (1 + tau s) with
    respect to tau over 1 + tau s. The digital form is exact where the input is straight between
    samples. ``tests/smoothing/test_causal.py`` compares it with the change for another lag.
    """
    x = inverse(y)
    e = float(np.exp(-inverse.dt_s / max((*inverse.chain.taus_s, inverse.dt_s))))
    b = np.array([1.0, -1.0]) * (1 - e) / inverse.dt_s
    return np.asarray(signal.lfilter(b, np.array([1.0, -e]), x - x[:1], axis=0))


@dataclass(frozen=True, repr=False)
class FilterReport(Result):
    """Properties of chain times compensator: a design report before the filter is used.

    Parameters
    ----------
    noise_gain
        Standard deviation of the output over that of the input.
    noise_out_K
        Standard deviation of the compensated temperature [K].
    bandwidth_Hz
        Frequency where the gain of chain times compensator falls to 1/sqrt 2.
    raw_bandwidth_Hz
        The same for the chain.
    rise_s, raw_rise_s
        Rise time from 10 to 90 % of a step, with and without compensation.
    overshoot
        Overshoot as a share of the step.
    remaining_shift_s
        Delay of the result.
    bias_K_per_K_s
        Error on a ramp of 1 K/s.
    step_time_s, step, raw_step
        Step responses with and without compensation.
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

    def to_frame(self) -> pd.DataFrame:
        """Step responses with and without compensation, over the time [s]."""
        index = pd.Index(self.step_time_s, name="time_s")
        return pd.DataFrame({"step": self.step, "raw_step": self.raw_step}, index)

    def summary(self) -> str:
        """The report as text."""
        return "\n".join([*self.lines(), *self.warnings])

    def lines(self) -> list[str]:
        """The report as text without its warnings."""
        bias = self.bias_K_per_K_s if abs(self.bias_K_per_K_s) > 1e-6 else 0.0
        return [
            f"noise gain {self.noise_gain:.3g}: the answer has a noise of {self.noise_out_K:.3g} K",
            f"bandwidth {self.bandwidth_Hz:.3g} Hz (uncompensated {self.raw_bandwidth_Hz:.3g} Hz)",
            f"step response, 10 to 90 %: {self.rise_s:.3g} s "
            f"(uncompensated {self.raw_rise_s:.3g} s), "
            f"overshoot {100 * self.overshoot:.2g} %",
            f"remaining shift {self.remaining_shift_s:.3g} s: on a ramp of 1 K/s the answer is "
            f"{bias:.3g} K behind",
        ]


@with_named_arguments
def report_inverse(
    inverse: InverseFilter, noise_sd: float, wanted_K: float | None = None
) -> FilterReport:
    """The report on a proper inverse for a trace with white noise.

    Parameters
    ----------
    inverse
        The inverse.
    noise_sd
        Standard deviation of the white noise of the trace [K].
    wanted_K
        Largest noise of the result without a warning [K]; by default ``MAX_NOISE_GAIN`` times that
        of the trace.

    Returns
    -------
    FilterReport
        With a warning when the result would be noisier, which states the largest bandwidth that is
        possible; and above ``MAX_BANDWIDTH_SHARE``.

    Examples
    --------
    >>> report = report_inverse(proper_inverse(Chain(0.5), 0.1, 1.0), 0.1)
    >>> report.rise_s < report.raw_rise_s
    True
    """
    dt = inverse.dt_s
    noise_out = inverse.noise_gain * noise_sd
    limit = MAX_NOISE_GAIN * noise_sd if wanted_K is None else wanted_K
    findings = []
    if noise_out > limit:
        best_Hz = widest_bandwidth_Hz(inverse.chain, dt, noise_sd, limit)
        findings.append(
            warning(
                "inverse.noisy",
                bandwidth_Hz=inverse.bandwidth_Hz,
                noise_K=noise_out,
                limit_K=limit,
                best_Hz=best_Hz,
            )
        )
    if inverse.bandwidth_Hz > MAX_BANDWIDTH_SHARE / dt:
        findings.append(
            warning("inverse.near_nyquist", bandwidth_Hz=inverse.bandwidth_Hz, rate_Hz=1 / dt)
        )
    chain = inverse.chain
    gain = inverse.noise_gain
    shown_s = STEP_LAGS * (chain.lag_s + inverse.remaining_shift_s)
    rows = int(min(max(shown_s / dt + STEP_MARGIN_ROWS, STEP_ROWS[0]), STEP_ROWS[1]))
    oversampling = max(int(np.ceil(MIN_STEP_POINTS / rows)), 1)
    u = np.zeros(rows * oversampling)
    u[oversampling:] = 1.0  # a step at the second sample
    raw = np.asarray(
        chain.response(u, dt / oversampling, hold="zoh")[::oversampling], dtype=np.float64
    )
    step = np.asarray(signal.lfilter(inverse.b, inverse.a, raw), dtype=np.float64)
    t = np.asarray((np.arange(rows) - 1.0) * dt, dtype=np.float64)
    freq = np.geomspace(1e-4, 0.499, 3000) / dt
    raw_freq = np.geomspace(1e-4, 1e3, 4000) / max(chain.lag_s, 1e-6)
    b_delay = np.arange(len(inverse.b)) @ inverse.b / np.sum(inverse.b)
    a_delay = np.arange(len(inverse.a)) @ inverse.a / np.sum(inverse.a)
    delay_warnings = [warning("inverse.dead_time")] if chain.delay_s > 0 or chain.zero_s < 0 else []
    total_gain = np.abs(inverse.frequency_response(freq) * chain.frequency_response(freq))
    return FilterReport(
        noise_gain=gain,
        noise_out_K=gain * noise_sd,
        bandwidth_Hz=_first_below(freq, total_gain),
        raw_bandwidth_Hz=_first_below(raw_freq, np.abs(chain.frequency_response(raw_freq))),
        rise_s=_rise_time_s(t, step),
        raw_rise_s=_rise_time_s(t, raw),
        overshoot=float(max(step.max() - 1.0, 0.0)),
        remaining_shift_s=inverse.remaining_shift_s,
        bias_K_per_K_s=float(dt * (b_delay - a_delay) + chain.lag_s),
        step_time_s=t,
        step=step,
        raw_step=raw,
        findings=(*findings, *delay_warnings),
    )


@with_named_arguments
def widest_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, wanted_K: float) -> float:
    """Largest bandwidth [Hz] of the proper inverse whose output noise is acceptable; 0 if none.

    Parameters
    ----------
    chain
        The chain.
    dt_s
        Sampling interval [s].
    noise_sd
        Standard deviation of the white noise of the trace [K].
    wanted_K
        Largest standard deviation of the output noise [K].

    Notes
    -----
    The largest of 40 bandwidths from 1e-3 to 0.45 of the sampling frequency, evenly in the
    logarithm; the result is at most one step (17 %) too small.

    Examples
    --------
    >>> widest_bandwidth_Hz(Chain(0.5), 0.1, 0.1, 0.3) > 0
    True
    """
    candidates_Hz = np.geomspace(1e-3, 0.45, 40) / dt_s
    admissible_Hz = []
    for bandwidth in candidates_Hz:
        gain = proper_inverse(chain, dt_s, float(bandwidth)).noise_gain
        if gain * noise_sd <= wanted_K:
            admissible_Hz.append(bandwidth)
    return float(max(admissible_Hz)) if admissible_Hz else 0.0


def smoother_bandwidth_Hz(chain: Chain, dt_s: float, noise_sd: float, intensity: float) -> float:
    """Frequency [Hz] above which the smoother follows its prior.

    Parameters
    ----------
    chain
        The chain, with frequency response G.
    dt_s
        Sampling interval [s].
    noise_sd
        Standard deviation of the noise [K].
    intensity
        Process-noise intensity q [K2/s3].

    Notes
    -----
    There |G|^2 q / w^4 equals the spectral density of the noise; see
    ``tcdyn.smoothing.corner.corner_rad_s``.
    """
    return float(corner_rad_s(chain, np.array(intensity / (noise_sd**2 * dt_s)))) / (2 * np.pi)


def _first_below(freq: Array, gain: Array) -> float:
    """First frequency [Hz] where a gain is below 1/sqrt 2; the last frequency if there is none.

    Parameters
    ----------
    freq
        Frequencies (N,) [Hz], increasing.
    gain
        Gain (N,) at them.
    """
    below = np.flatnonzero(gain < np.sqrt(0.5))
    return float(freq[below[0]]) if len(below) else float(freq[-1])


def _rise_time_s(t: Array, step: Array) -> float:
    """Rise time from 10 to 90 % of a step response (N,) at times (N,) [s], first crossings."""
    crossings = []
    for level in (0.1, 0.9):
        k = int(np.argmax(step >= level))
        around = slice(max(k - 1, 0), k + 1)
        crossings.append(float(np.interp(level, step[around], t[around])))
    return crossings[1] - crossings[0]
