"""
Two wires in an exhaust gas
===========================

Two wires in an exhaust: the pair determines both lags without a reference. The coarse one is
compensated.
"""

import numpy as np
import pandas as pd
from shared import lagged, plot_traces

from tcdyn import compensate_frame, sensor_from_pair

dt, rng = 0.002, np.random.default_rng(2015)
t = np.arange(0, 8, dt)
gas = 500 + 60 * np.sin(2 * np.pi * 3 * t) + 25 * np.sin(2 * np.pi * 0.7 * t + 1)
fine, coarse = (lagged(gas, dt, tau_s) + rng.normal(0, 0.8, len(t)) for tau_s in (0.05, 0.18))

log = pd.DataFrame({"fine_degC": fine, "coarse_degC": coarse}, index=pd.Index(t, name="time_s"))
pair = sensor_from_pair(log, bare=True)
print(pair.summary())
ax = plot_traces(log, compensate_frame(log, pair), "coarse_degC", gas)
ax.set_xlim(2, 4)
