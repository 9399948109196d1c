"""The force in the contact: its zero taken out, steady where it is steady, ended when it ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from calibration.finding import Finding
from calibration.noise import MAD_TO_SD, white_noise_sd
from tcdyn.partition.events import SETTLE_S, Events

SMOOTH_S = 4.0  # straight line of this length; longer where the noise asks for it, up to
LONGEST_SMOOTH_S = 40.0
NOISE_LEFT = 0.002  # of the force at the parting: a fifth of the transducer's own uncertainty
LEAST_ZERO = 10  # samples of an unloaded stretch that give a zero


@dataclass(frozen=True)
class FrictionAdded:
    """What the transducer does not see of the contact's friction, its standard uncertainty, and what to say of it."""

    value_N: float
    u_N: float
    findings: tuple[Finding, ...] = ()


NOTHING_ADDED = FrictionAdded(0.0, 0.0)


def contact_force(t: NDArray[np.float64], raw_N: NDArray[np.float64], events: Events) -> NDArray[np.float64]:
    """Force while the disks touch [N], zero elsewhere; ``raw_N`` as logged, both of shape (N,).

    The zero is the median before loading and after unloading, drifting straight between the two (section 2.9). Under
    load the force is a running straight line, spikes left out, that never looks across a switching instant: an average
    smeared over the parting edge would scale beta one to one, and so does noise left at that edge. The line is as long
    as ``NOISE_LEFT`` asks, since its end scatters by 2 sd / sqrt(samples).
    """
    on, off = events.load_on_s, events.unload_s
    quiet = events.parting_s + SETTLE_S
    zero = _zero(t, raw_N, on - SETTLE_S, off + quiet)
    inside = (t > on + SETTLE_S) & (t < off - quiet)
    level = _line_through((raw_N - zero)[inside], float(np.median(np.diff(t))))
    force = np.interp(t, t[inside], level)
    ramp_s = events.fall_s
    if ramp_s > 4 * float(np.median(np.diff(t))):
        share = np.clip((off + 0.5 * ramp_s - t) / ramp_s, 0.0, 1.0)
    else:
        share = (t < off).astype(float)
    return np.where(t >= on, force * share, 0.0)


def _line_through(raw: NDArray[np.float64], dt_s: float) -> NDArray[np.float64]:
    """The slow course of a force (N,) with noise, spikes and missing samples, straight to its very ends."""
    level = pd.Series(raw)
    short = max(int(round(0.5 * SMOOTH_S / dt_s)), 3)
    away = (level - level.rolling(short, center=True, min_periods=1).median()).abs()
    filled = level.mask(away > 6 * MAD_TO_SD * away.median()).interpolate(limit_direction="both").to_numpy()
    left = 2 * float(white_noise_sd(filled)) / max(NOISE_LEFT * abs(float(np.median(filled))), 1e-12)
    count = min(max(SMOOTH_S / dt_s, left**2), LONGEST_SMOOTH_S / dt_s, len(filled))
    window = max(2 * int((count - 1) // 2) + 1, 1)
    return np.asarray(savgol_filter(filled, window, min(1, window - 1), mode="interp"))


def _zero(t: NDArray[np.float64], raw: NDArray[np.float64], before_s: float, after_s: float) -> NDArray[np.float64]:
    """The transducer's zero at each instant, from the unloaded stretches."""
    early, late = t < before_s, (t > after_s) & (t < after_s + 60.0)
    points = [(float(np.mean(t[m])), float(np.nanmedian(raw[m]))) for m in (early, late) if m.sum() >= LEAST_ZERO]
    if not points:
        return np.zeros_like(t)
    return np.asarray(np.interp(t, [p[0] for p in points], [p[1] for p in points]))
