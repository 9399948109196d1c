"""Error of a temperature that its readings do not resolve, or that the prior does not expect.

Above the corner frequency of the smoother the readings show nothing but noise, and the prior says
how much temperature remains there: level noise has a spectrum that falls as w^-2. That of a real
temperature may fall more slowly. :func:`unresolved_var` fits spectra of several exponents to the
readings and takes the mean error of the smoother over them. A wave that remains in the residuals
counts, too. Guarded by ``tests/smoothing/test_bands.py``; ``tests/smoothing/band_study.py``
measures the coverage.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tcdyn.chain.logger_noise import LINE_WIDTH_HZ
from tcdyn.core import Array
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.noise_levels import level_noise_at
from tcdyn.smoothing.process_noise import LINE_CHANCE, REACH_LAGS, hann_taper
from tcdyn.smoothing.state_space import Smoothed

# Exponents of the spectrum that are averaged over, with equal prior weights: from 1/f noise and
# flatter to level noise. 5/3 is that of turbulence.
EXPONENTS = np.linspace(0.5, 2.0, 16)
# The spectrum is used from this share of the corner frequency on: there the error arises
# (tests/smoothing/band_study.py)
SPECTRUM_START = 0.2
# ... up to this share of half the sampling rate, where the filter of a logger does not yet matter
SPECTRUM_END = 0.9
# Fewest frequencies from there to the corner. With 2 the band of a constant temperature is a fifth
# wider; with 10, 20 records of 60 rows of a random walk are covered 84 %, with 3 they are covered
# 90 %
MIN_FREQUENCIES = 3
# bands in which the spectrum is averaged, at most: the spectra are smooth, each band changes them
# by 3 % or less
MAX_BANDS = 200
# iterations of Fisher scoring, and largest change of a logarithm in one
ITERATIONS = 40
LARGEST_STEP = 1.0


class _Bands(NamedTuple):
    """Bands of frequencies: how many of the record, mean [rad/s], power [K2], gain [1/s], and the
    power [K2] of slope noise."""

    members: Array
    w: Array
    power: Array
    gain: Array
    of_slope: Array


class _Spectra(NamedTuple):
    """Spectra A (w / corner)^-b and noise, for each exponent b.

    ``amplitude`` (E,) [K2 s], ``noise_var`` (E,) [K2], ``weight`` (E,) their marginal likelihood.
    """

    amplitude: Array
    noise_var: Array
    weight: Array


def unresolved_var(fit: Smoothed, is_rough: Array) -> tuple[Array, Array]:
    """Variance that the band of a rough temperature misses, up to half the sampling rate.

    Parameters
    ----------
    fit
        The smoothed record.
    is_rough
        Probability (M,) that noise drives the temperature itself.

    Returns
    -------
    var, slope_var
        Of the temperature (N, M) [K2], and of its mean rate of change over one sampling interval
        [K2/s2].
    """
    n = len(fit.record.y)
    out = np.zeros((2, n, len(fit.intensities)))
    part = _between_events(fit)
    time_s = fit.record.dt_s * np.arange(n)
    for c, q in enumerate(fit.intensities):
        if q.level_noise:
            of_blocks = _of_spectrum(fit, c, part)
            block = np.maximum(np.searchsorted(q.starts_s, time_s, side="right") - 1, 0)
            out[:, :, c] = is_rough[c] * of_blocks[:, block]
    return out[0], out[1]


def line_var(fit: Smoothed) -> tuple[Array, Array]:
    """Variances (M,) of waves of the temperature that the smoother does not follow.

    Parameters
    ----------
    fit
        The smoothed record.

    Returns
    -------
    var, slope_var
        Of the temperature [K2], and of its mean rate of change over one sampling interval [K2/s2].

    Notes
    -----
    A wave that the prior does not expect remains in the residuals. At its frequency the error of
    the temperature is the residual over the gain G. White noise exceeds the limit in one record of
    1 / ``LINE_CHANCE``. Hum is no temperature, nor are the waves that rounding makes of a slow
    change.
    """
    each = np.array([_line_var_of_channel(fit, c) for c in range(len(fit.intensities))])
    return each[:, 0], each[:, 1]


def _line_var_of_channel(fit: Smoothed, channel: int) -> Array:
    """The ``line_var`` (2,) of one channel."""
    record = fit.record
    if record.rounding_K[channel] > 0:
        return np.zeros(2)
    n = len(record.y)
    is_good = record.weight[:, channel] > 0
    residuals = np.where(is_good, record.y[:, channel] - fit.predicted[:, channel], 0.0)
    power = np.abs(np.fft.rfft(residuals * hann_taper(n))) ** 2
    f_Hz = np.fft.rfftfreq(n, record.dt_s)
    noise_var = float(fit.noise_var[channel])
    is_line = power > noise_var * np.log(n / LINE_CHANCE)
    for f, _ in (line for model in record.noise for line in model.hum_lines):
        is_line &= np.abs(f_Hz - f) > LINE_WIDTH_HZ
    if not is_line.any():
        return np.zeros(2)
    gain = np.abs(record.chains[channel].frequency_response(f_Hz[is_line])) ** 2
    of_temperature = 2 / n * (power[is_line] - noise_var) / gain
    w = 2 * np.pi * f_Hz[is_line]
    per_rate = (2 * np.sin(0.5 * w * record.dt_s) / record.dt_s) ** 2
    return np.array([of_temperature.sum(), of_temperature @ per_rate])


def _of_spectrum(fit: Smoothed, channel: int, part: slice) -> Array:
    """Variances (2, B) of a rough temperature above the corner, and of its rate, in each block.

    Parameters
    ----------
    fit
        The smoothed record.
    channel
        A channel with level noise.
    part
        Samples of the periodogram: the longest part between two events, without its transient.

    Notes
    -----
    The spectrum S(w) = A (w / corner)^-b, beside that of the slope noise, and the noise R are
    fitted to the periodogram around and above the corner by Whittle's likelihood; noise that is
    known stays as it is. The smoother has the gain h = |G|^2 S0 dt / (|G|^2 S0 + R0 dt), with the
    spectrum S0 of its own intensities and its noise R0. Its mean square error is the integral of
    (1 - h)^2 S + h^2 R dt / |G|^2 over the frequency. The result is the mean of this over the
    exponents, with their marginal likelihoods as weights, less that of S0 and R0 themselves. In a
    block S follows the level noise. The rate of change over one sampling interval is the
    temperature through a filter of the gain 2 sin(w dt / 2) / dt.
    """
    record = fit.record
    dt = record.dt_s
    q = fit.intensities[channel]
    chain = record.chains[channel]
    noise_var = float(fit.noise_var[channel])
    even = record.at_samples()[part, channel]
    w = 2 * np.pi * np.asarray(np.fft.rfftfreq(len(even), dt)[1:], dtype=float)
    time_s = dt * np.arange(part.start, part.stop)
    # means as the periodogram weights the samples
    share = hann_taper(len(even)) ** 2
    level_noise = float(share @ level_noise_at([replace(q, changes=())], time_s)[0])
    slope_noise = float(share @ replace(q, changes=()).at(time_s))
    out = np.zeros((2, len(q.levels)))
    corner = float(corner_rad_s(chain, np.array(level_noise / (noise_var * dt)), 1))
    slope_corner = float(corner_rad_s(chain, np.array(slope_noise / (noise_var * dt))))
    first = max(int(np.searchsorted(w, SPECTRUM_START * corner)), 1)
    last = int(SPECTRUM_END * len(w))
    shown = min(int(np.searchsorted(w, corner)), last) - first
    if slope_corner > corner or shown < MIN_FREQUENCIES:
        return out
    gain = np.abs(chain.frequency_response(w / (2 * np.pi))) ** 2
    of_slope = gain / dt * slope_noise / w**4
    bands = _bands(even, w, gain / dt, of_slope, slice(first, last))
    spectra = _fitted(bands, corner, level_noise / corner**2, noise_var, record.noise_known)
    shapes = spectra.amplitude[:, None] * (w / corner) ** -EXPONENTS[:, None]
    per_rate = (2 * np.sin(0.5 * w * dt) / dt) ** 2
    for block, (p, slope_p) in enumerate(zip(q.level_noise, q.levels)):
        own = p / w**2 + slope_p / w**4
        h = gain * own / (gain * own + noise_var * dt)
        signal_share = (1 - h) ** 2
        noise_share = h * own / (gain * own + noise_var * dt) * dt
        error = signal_share * (shapes * (p / level_noise) + slope_p / w**4)
        error = error + noise_share * spectra.noise_var[:, None]
        missed = spectra.weight @ error - (signal_share * own + noise_share * noise_var)
        of_both = np.array([missed.sum(), missed @ per_rate]) * (w[1] - w[0]) / np.pi
        out[:, block] = np.maximum(of_both, 0.0)
    return out


def _between_events(fit: Smoothed) -> slice:
    """The longest run of samples between two events, from ``REACH_LAGS`` after the first on."""
    record = fit.record
    changes = {change.start_s for q in fit.intensities for change in q.changes}
    events_s = np.array(sorted({*record.events_s, *changes}))
    settling_s = REACH_LAGS * max(sensor.lag_s for sensor in record.sensors)
    first = np.ceil(np.append(0.0, events_s + settling_s) / record.dt_s).astype(int)
    last = np.append(np.floor(events_s / record.dt_s).astype(int), len(record.y))
    longest = int(np.argmax(last - first))
    return slice(int(first[longest]), int(max(last[longest], first[longest] + 2)))


def _bands(y: Array, w: Array, gain: Array, of_slope: Array, used: slice) -> _Bands:
    """Periodogram of readings (N,), averaged in bands of one width in log frequency."""
    n = len(y)
    detrended = y - np.interp(np.arange(n), [0, n - 1], y[[0, -1]])
    power = np.abs(np.fft.rfft(detrended * hann_taper(n))[1:]) ** 2
    edges = np.unique(np.geomspace(used.start, used.stop, MAX_BANDS + 1).astype(int))
    count = np.diff(edges)
    columns = (w, power, gain, of_slope)
    means = [np.add.reduceat(x[: used.stop], edges[:-1]) / count for x in columns]
    return _Bands(count, *means)


def _fitted(
    bands: _Bands, corner: float, at_corner: float, noise_var: float, noise_known: bool
) -> _Spectra:
    """Spectra of all exponents by Whittle's likelihood, with its marginal over A and R.

    Parameters
    ----------
    bands
        The periodogram.
    corner
        Corner frequency of the smoother [rad/s].
    at_corner
        Its spectrum there [K2 s], from which the search starts.
    noise_var, noise_known
        Noise variance [K2], and whether it is known.

    Notes
    -----
    Fisher scoring in the logarithms of A and R. The likelihood is integrated over them by Laplace's
    method. Noise so small that no frequency shows it leaves the likelihood flat: a unit of prior
    information about its logarithm keeps it near ``noise_var``.
    """
    shape = bands.gain * (bands.w / corner) ** -EXPONENTS[:, None]
    amplitude = np.full(len(EXPONENTS), at_corner)
    noise = np.full(len(EXPONENTS), noise_var)
    for _ in range(ITERATIONS):
        signal = amplitude[:, None] * shape
        expected = noise[:, None] + signal + bands.of_slope
        excess = bands.members * (bands.power / expected - 1)
        shares = np.stack([signal, np.broadcast_to(noise[:, None], signal.shape)]) / expected
        gradient = (shares * excess).sum(axis=2)
        information = np.einsum("aef,bef,f->eab", shares, shares, bands.members)
        gradient[1] -= np.log(noise / noise_var)
        information[:, 1, 1] += 1.0
        if noise_known:
            gradient[1] = 0.0
            information[:, 0, 1] = information[:, 1, 0] = 0.0
            information[:, 1, 1] = 1.0
        step = np.linalg.solve(information, gradient.T[..., None])[..., 0]
        step = np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        amplitude = amplitude * np.exp(step[:, 0])
        noise = noise * np.exp(step[:, 1])
    expected = noise[:, None] + amplitude[:, None] * shape + bands.of_slope
    cost = (bands.members * (np.log(expected) + bands.power / expected)).sum(axis=1)
    cost = cost + 0.5 * np.log(noise / noise_var) ** 2
    cost = cost + 0.5 * np.linalg.slogdet(information)[1]
    weight = np.exp(cost.min() - cost)
    return _Spectra(amplitude, noise, weight / weight.sum())
