"""
The lags of a disk
==================

The lags of a disk from one plunge (above) and in the record: differences are more certain than
the common lag.
"""

import matplotlib.pyplot as plt
from shared import lab, plunged

from tcdyn.plots import draw_common_lag, draw_lags
from tcdyn.rig.record import read_record

chain = read_record(lab() / "fast.disk.json").chain
assert chain is not None
_, axes = plt.subplots(3, 1, figsize=(8.5, 10.0), layout="constrained")
draw_common_lag(plunged(), axes[0])
for channel, lag in plunged().differential_lag_s.items():
    axes[1].errorbar(channel, lag.value, 1.96 * lag.u, fmt="ko", capsize=3)
axes[1].set(xlabel="channel", ylabel="lag minus common lag [s]")
draw_lags(chain, axes[2])
