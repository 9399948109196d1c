"""Error and coverage with a fixed delay: ``python -m tests.smoothing.live_study SECONDS SEED
DELAY_S [BEFORE]``.

Six channels of the rig with an unloading and a reloading, lone outliers and bursts of the slip
rings once a minute in each channel. ``BEFORE`` is the share of the noise's amplitude that enters
before the filter (0). The batch smoother of the complete record is printed for comparison.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import smooth
from tests.smoothing.live_world import TAUS_S, World, with_delay, world

Array = NDArray[np.float64]
DT_S = 1 / 75
SETTLED_S = 5.0
CHAIN = Chain(TAUS_S, conditioning=Conditioning(cutoff_Hz=4.0, poles=2))


def judge(made: World, x: Array, sd: Array, title: str) -> None:
    """Print the error and the coverage near kinks, in bursts, and elsewhere."""
    after = made.time_s[:, None] - made.kinks_s
    near_kink = ((after > -0.1) & (after < 2.0)).any(axis=1)[:, None] & np.ones(x.shape, bool)
    settled = (made.time_s > SETTLED_S)[:, None]
    error = np.abs(x - made.true[:, None])
    z = error / sd
    print(title)
    for name, where in (
        ("all", np.isfinite(z)),
        ("2 s after kinks", near_kink),
        ("bursts", made.burst & ~near_kink),
        ("elsewhere", ~near_kink & ~made.burst),
    ):
        chosen = where & settled & np.isfinite(z)
        rms = np.sqrt(np.mean(error[chosen] ** 2))
        coverage = 100 * np.mean(z[chosen] < 1.96)
        print(
            f"  {name:16s} rms {rms:.3f} K, median {np.median(error[chosen]):.3f} K, coverage "
            f"{coverage:.1f} %, largest {error[chosen].max():.2f} K, {z[chosen].max():.1f} sd, "
            f"above 5 K {np.sum(error[chosen] > 5)}, median sd {np.median(sd[chosen]):.3f} K, "
            f"{np.count_nonzero(chosen)} samples",
            flush=True,
        )


def main(seconds: float, seed: int, delay_s: float, before: float) -> None:
    """One record, with the delay and as a whole."""
    made = world(seconds, before, seed, drops_K=(12.0,))
    start = time.process_time()
    x, sd = with_delay(made.readings, DT_S, CHAIN, delay_s)
    cpu_s = time.process_time() - start
    title = (
        f"delay {delay_s:g} s, {seconds:g} s of six channels, noise before the filter {before:g}"
    )
    judge(made, x, sd, f"{title}: {cpu_s / seconds:.2f} s of one core for each second")
    whole = smooth(made.readings, DT_S, CHAIN)
    judge(made, *whole.determined_estimates(), "batch smoother")


if __name__ == "__main__":
    seconds, seed, delay_s = sys.argv[1:4]
    main(float(seconds), int(seed), float(delay_s), float([*sys.argv, "0"][4]))
