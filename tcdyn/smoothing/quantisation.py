"""Readings of a logger whose step is coarser than its noise.

The error of such a reading is no white noise: it repeats from sample to sample while the
temperature stays within one step. But each reading tells between which two limits the temperature
plus its noise was, and where a reading changes, the limit was just crossed. Expectation propagation
replaces each of these statements by a value and a weight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import log_ndtr

from tcdyn.core import Array
from tcdyn.smoothing.record import Record
from tcdyn.smoothing.roughness import MAX_DIVISIONS, adapted
from tcdyn.smoothing.state_space import Smoothed, smooth_record

# Values without a source below were chosen by judgement, and tried by tests/smoothing/band_study.py
# noise in steps of the logger: at least, and at most
NOISE_STEPS = (0.08, 0.3)
# width of the median [samples] that removes the changes of a reading back and forth
RETURN_SAMPLES = 25
# changes of a reading per sample and per noise in steps, at a uniform speed: 2/sqrt(pi)
CHANGES_PER_NOISE = 1.128
# rounds of expectation propagation, and damping of a round
ROUNDS = 12
DAMPING = 0.6
# largest share of the precision of a sample that its own reading may have
MAX_OWN_SHARE = 0.98


def noise_in_steps(readings: Array, step_K: float) -> float:
    """Noise over the step, from changes of the readings (N,) that return.

    At a uniform speed, noise of s steps changes the reading back and forth 2 s / sqrt(pi) times a
    sample.
    """
    median = median_filter(readings, min(RETURN_SAMPLES, len(readings)), mode="nearest")
    changes = np.count_nonzero(np.diff(readings))
    lasting = np.count_nonzero(np.diff(median))
    returning = max(int(changes) - int(lasting), 0)
    share = returning / len(readings) / CHANGES_PER_NOISE
    return float(np.clip(share, *NOISE_STEPS))


def propagated(fit: Smoothed, readings: Array) -> Smoothed:
    """Smooth again with the readings (N, M) of coarse channels as limits, not as values."""
    coarse = np.flatnonzero(fit.record.step_K > 0)
    noise_K = {
        c: fit.record.step_K[c] * noise_in_steps(readings[:, c], fit.record.step_K[c])
        for c in coarse
    }
    for stage in range(2):
        for _ in range(ROUNDS):
            record = fit.record
            for c in coarse:
                record = _with_sites(record, fit, int(c), readings[:, c], noise_K[c])
            fit = smooth_record(record, fit.noise_var, fit.intensities)
        fit = adapted(fit, MAX_DIVISIONS if stage else 0)
    return fit


def _with_sites(
    record: Record, fit: Smoothed, channel: int, readings: Array, noise_K: float
) -> Record:
    """The record with new values and weights of one channel (Minka 2001, with damping)."""
    half = 0.5 * record.step_K[channel]
    noise_var = fit.noise_var[channel]
    good = record.weight[:, channel] > 0
    precision = record.weight[good, channel] / noise_var
    value = record.y[good, channel]
    var = np.maximum(fit.predicted_var[good, channel], 1e-12 * half**2)
    own = np.minimum(precision * var, MAX_OWN_SHARE)
    cavity_var = var / (1 - own)
    cavity_mean = (fit.predicted[good, channel] - own * value) / (1 - own)
    total_sd = np.sqrt(cavity_var + noise_K**2)
    low = (readings[good] - half - cavity_mean) / total_sd
    high = (readings[good] + half - cavity_mean) / total_sd
    # mirror, so that differences of the distribution function keep their digits
    mirrored = low > 0
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    log_low = log_ndtr(low)
    log_high = log_ndtr(high)
    log_p = log_high + np.log1p(-np.exp(np.minimum(log_low - log_high, -1e-15)))
    density_low = np.exp(-0.5 * low**2 - log_p) / np.sqrt(2 * np.pi)
    density_high = np.exp(-0.5 * high**2 - log_p) / np.sqrt(2 * np.pi)
    slope = np.where(mirrored, -1.0, 1.0) * (density_low - density_high) / total_sd
    bend = slope**2 + (high * density_high - low * density_low) / total_sd**2
    bend = np.clip(bend, 1e-9 / cavity_var, (1 - 1e-6) / cavity_var)
    new_precision = bend / (1 - bend * cavity_var)
    new_value = cavity_mean + slope / bend
    usable = np.isfinite(new_precision) & np.isfinite(new_value)
    new_precision = np.where(usable, new_precision, precision)
    new_value = np.where(usable, new_value, value)
    mixed = DAMPING * new_precision + (1 - DAMPING) * precision
    mean = (DAMPING * new_precision * new_value + (1 - DAMPING) * precision * value) / mixed
    y = record.y.copy()
    weight = record.weight.copy()
    y[good, channel] = mean
    weight[good, channel] = mixed * noise_var
    return replace(record, y=y, weight=weight)
