"""CPU time of a followed log of the rig: ``python -m tests.benchmarks.live [SECONDS]``.

Twelve channels at 75 Hz with spikes and slow waves, without an unloading and with one. Printed is
the share of one core, or, beyond one, by how much the run would fall behind.
"""

from __future__ import annotations

import sys
import time

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tests.smoothing.live_world import TAUS_S, with_delay, world

DT_S = 1 / 75
CHAIN = Chain(TAUS_S, conditioning=Conditioning(cutoff_Hz=4.0, poles=2))
DELAYS_S = (0.5, 1.0, 2.0, 5.0)


def main(seconds: float) -> None:
    """Print the table."""
    for drop_K in (0.0, 12.0):
        made = world(seconds, 0.0, 7, drops_K=(drop_K,), bursts_s=60.0, channels=12)
        with_delay(made.readings[:200], DT_S, CHAIN, 1.0)  # compiles
        for delay_s in DELAYS_S:
            start_s = time.process_time()
            with_delay(made.readings, DT_S, CHAIN, delay_s)
            share = (time.process_time() - start_s) / seconds
            print(f"unloading by {drop_K:4.0f} K, delay {delay_s:g} s: {share:.3f}", flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
