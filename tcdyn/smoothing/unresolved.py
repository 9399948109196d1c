"""Error of a rough temperature that its readings do not resolve.

Above the corner frequency of the smoother the readings show nothing but noise, and the prior says
how much temperature remains there: level noise has a spectrum that falls as w^-2. That of a real
temperature may fall more slowly. :func:`unresolved_var` fits spectra of several exponents to the
readings and takes the mean error of the smoother over them. Guarded by
``tests/smoothing/test_bands.py``; ``tests/smoothing/band_study.py`` measures the coverage.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tcdyn.core import Array
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.state_space import Smoothed

# Exponents of the spectrum that are averaged over, with equal prior weights: from 1/f noise and
# flatter to level noise. 5/3 is that of turbulence.
EXPONENTS = np.linspace(0.5, 2.0, 16)
# The spectrum is used from this share of the corner frequency on: there the error arises
# (tests/smoothing/band_study.py)
SPECTRUM_START = 0.2
# ... up to this share of half the sampling rate, where the filter of a logger does not yet matter
SPECTRUM_END = 0.9
# Fewest frequencies from there to the corner: fewer show a level, but no exponent. An exponent is
# known to about the inverse of their root
MIN_FREQUENCIES = 10
# bands in which the spectrum is averaged, at most: the spectra are smooth, each band changes them
# by 3 % or less
MAX_BANDS = 200
# iterations of Fisher scoring, and largest change of a logarithm in one
ITERATIONS = 40
LARGEST_STEP = 1.0
# lags after an event from which on its transient no longer counts: exp(-5) of it remains
SETTLED_LAGS = 5


class _Bands(NamedTuple):
    """Bands of frequencies: how many of the record, mean [rad/s], power [K2] and gain [1/s]."""

    members: Array
    w: Array
    power: Array
    gain: Array


class _Spectra(NamedTuple):
    """Spectra A (w / corner)^-b and noise, for each exponent b.

    ``amplitude`` (E,) [K2 s], ``noise_var`` (E,) [K2], ``weight`` (E,) their marginal likelihood.
    """

    amplitude: Array
    noise_var: Array
    weight: Array


def unresolved_var(fit: Smoothed) -> tuple[Array, Array]:
    """Variance that the band of a rough temperature misses, up to half the sampling rate.

    Parameters
    ----------
    fit
        The smoothed record.

    Returns
    -------
    var, slope_var
        Of the temperature (M,) [K2], and of its mean rate of change over one sampling interval
        [K2/s2].

    Notes
    -----
    The spectrum S(w) = A w^-b and the noise R are fitted to the periodogram around and above the
    corner by Whittle's likelihood; noise that is known stays as it is. The smoother has the gain
    h = |G|^2 S0 dt / (|G|^2 S0 + R0 dt), with the spectrum S0 of its own intensities and its noise
    R0. Its mean square error is the integral of (1 - h)^2 S + h^2 R dt / |G|^2 over the frequency.
    The periodogram is that of the longest part between two events, without its transient.
    The result is the mean of this over the exponents, with their marginal likelihoods as weights,
    less that of S0 and R0 themselves. The rate of change over one sampling interval is the
    temperature through a filter of the gain 2 sin(w dt / 2) / dt.
    """
    record = fit.record
    dt = record.dt_s
    part = _between_events(fit)
    even = record.at_samples()[part]
    w = 2 * np.pi * np.asarray(np.fft.rfftfreq(len(even), dt)[1:], dtype=float)
    per_rate = (2 * np.sin(0.5 * w * dt) / dt) ** 2
    out = np.zeros((2, len(fit.intensities)))
    for c, (chain, q, var) in enumerate(zip(record.chains, fit.intensities, fit.noise_var)):
        if not q.level_noise:
            continue
        density = var * dt
        level_noise = float(np.median(q.level_noise))
        slope_noise = float(np.median(q.levels))
        corner = float(corner_rad_s(chain, np.array(level_noise / density), 1))
        slope_corner = float(corner_rad_s(chain, np.array(slope_noise / density)))
        first = max(int(np.searchsorted(w, SPECTRUM_START * corner)), 1)
        last = int(SPECTRUM_END * len(w))
        shown = min(int(np.searchsorted(w, corner)), last) - first
        if slope_corner > corner or shown < MIN_FREQUENCIES:
            continue
        gain = np.abs(chain.frequency_response(w / (2 * np.pi))) ** 2
        bands = _bands(even[:, c], w, gain / dt, first, last)
        at_corner = level_noise / corner**2
        spectra = _fitted(bands, corner, at_corner, float(var), record.noise_known)
        own = level_noise / w**2 + slope_noise / w**4
        h = gain * own / (gain * own + density)
        signal_share = (1 - h) ** 2
        noise_share = h * own / (gain * own + density) * dt
        powers = (w / corner) ** -EXPONENTS[:, None]
        error = signal_share * spectra.amplitude[:, None] * powers
        error = error + noise_share * spectra.noise_var[:, None]
        missed = spectra.weight @ error - (signal_share * own + noise_share * var)
        of_both = np.array([missed.sum(), missed @ per_rate]) * (w[1] - w[0]) / np.pi
        out[:, c] = np.maximum(of_both, 0.0)
    return out[0], out[1]


def _between_events(fit: Smoothed) -> slice:
    """The longest run of samples between two events, from ``SETTLED_LAGS`` after the first on."""
    record = fit.record
    bursts = {burst.start_s for q in fit.intensities for burst in q.bursts}
    events_s = np.array(sorted({*record.events_s, *bursts}))
    settling_s = SETTLED_LAGS * max(sensor.lag_s for sensor in record.sensors)
    first = np.ceil(np.append(0.0, events_s + settling_s) / record.dt_s).astype(int)
    last = np.append(np.floor(events_s / record.dt_s).astype(int), len(record.y))
    longest = int(np.argmax(last - first))
    return slice(int(first[longest]), int(max(last[longest], first[longest] + 2)))


def _bands(y: Array, w: Array, gain: Array, first: int, last: int) -> _Bands:
    """Periodogram of readings (N,), averaged in bands of one width in log frequency."""
    n = len(y)
    taper = np.hanning(n + 1)[:-1]
    taper = taper / np.linalg.norm(taper)
    detrended = y - np.interp(np.arange(n), [0, n - 1], y[[0, -1]])
    power = np.abs(np.fft.rfft(detrended * taper)[1:]) ** 2
    edges = np.unique(np.geomspace(first, last, MAX_BANDS + 1).astype(int))
    count = np.diff(edges)
    means = [np.add.reduceat(x[:last], edges[:-1]) / count for x in (w, power, gain)]
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
        expected = noise[:, None] + signal
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
    expected = noise[:, None] + amplitude[:, None] * shape
    cost = (bands.members * (np.log(expected) + bands.power / expected)).sum(axis=1)
    cost = cost + 0.5 * np.log(noise / noise_var) ** 2
    cost = cost + 0.5 * np.linalg.slogdet(information)[1]
    weight = np.exp(cost.min() - cost)
    return _Spectra(amplitude, noise, weight / weight.sum())
