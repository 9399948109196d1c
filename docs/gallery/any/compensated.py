"""
An unloading, compensated
=========================

An unloading: 12 K in a time constant of 1 s. Dots are logged, the line is compensated, the kink
is preserved.
"""

import matplotlib.pyplot as plt
import numpy as np
from shared import lagged

from tcdyn import Chain, smooth
from tcdyn.plots import draw_compensated

dt = 1 / 75
t = np.arange(0, 40, dt)
true = 120 - 12 * (1 - np.exp(-np.clip(t - 20, 0, None) / 1.0))
logged = lagged(true, dt, 0.55, 0.12) + np.random.default_rng(0).normal(0, 0.15, len(t))
done = smooth(logged, dt, Chain([0.55, 0.12]), events_s=(20.0,), lag_covariance=[[0.02**2]])

_, ax = plt.subplots(figsize=(8.5, 3.8), layout="constrained")
draw_compensated(done, logged, ax, window_s=(18, 26))
ax.plot(t, true, "k:", linewidth=0.9, label="true")
ax.set_xlim(18, 26)
ax.legend(frameon=False, fontsize="small")
