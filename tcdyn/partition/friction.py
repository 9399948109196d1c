"""The force in the contact: its zero taken out, steady where it is steady, ended when it ended."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tcdyn.partition.events import SETTLE_S, Events

SMOOTH_S = 2.0


def contact_force(t: NDArray[np.float64], raw_N: NDArray[np.float64], events: Events) -> NDArray[np.float64]:
    """Force while the disks touch [N], zero elsewhere; ``raw_N`` as logged, both of shape (N,).

    The zero is the mean before loading and after unloading, drifting straight between the two (section 2.9). Under
    load the force is a running median and mean of ``SMOOTH_S`` that never looks across a switching instant: an
    average smeared over the parting edge would scale beta one to one.
    """
    on, off = events.load_on_s, events.unload_s
    quiet = events.parting_s + SETTLE_S
    zero = _zero(t, raw_N, on - SETTLE_S, off + quiet)
    inside = (t > on + SETTLE_S) & (t < off - quiet)
    level = pd.Series((raw_N - zero)[inside])
    window = max(int(round(SMOOTH_S / float(np.median(np.diff(t))))), 3)
    spikes = (level - level.rolling(window, center=True, min_periods=1).median()).abs()
    level = level.mask(spikes > 6 * 1.4826 * spikes.median())
    level = level.rolling(window, center=True, min_periods=1).mean().interpolate(limit_direction="both")
    force = np.interp(t, t[inside], level.to_numpy())
    ramp_s = events.parting_s / 0.8  # from the 90-10 % time to the whole of a straight fall
    if ramp_s > 4 * float(np.median(np.diff(t))):
        share = np.clip((off + 0.5 * ramp_s - t) / ramp_s, 0.0, 1.0)
    else:
        share = (t < off).astype(float)
    return np.where(t >= on, force * share, 0.0)


def _zero(t: NDArray[np.float64], raw: NDArray[np.float64], before_s: float, after_s: float) -> NDArray[np.float64]:
    """The transducer's zero at each instant, from the unloaded stretches."""
    early, late = t < before_s, (t > after_s) & (t < after_s + 60.0)
    points = [(float(np.mean(t[m])), float(np.nanmedian(raw[m]))) for m in (early, late) if m.sum() >= 10]
    if not points:
        return np.zeros_like(t)
    return np.asarray(np.interp(t, [p[0] for p in points], [p[1] for p in points]))
