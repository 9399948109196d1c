"""
A sensor in a pipe, heated by a current
=======================================

A sensor in a pipe, heated by a current for a minute (LCSR): the lag in place, then a transient
of the pipe.
"""

import numpy as np
import pandas as pd
from shared import lagged, plot_traces

from tcdyn import compensate_frame, sensor_from_current

dt, rng = 0.1, np.random.default_rng(2015)
t = np.arange(0, 180, dt)
on = np.where((t > 20) & (t < 80), 1.0, 0.0)
warmed = 290 + 4 * lagged(on, dt, 6.0) + 1.5 * lagged(on, dt, 0.7)
heated = {"R1_degC": warmed + rng.normal(0, 0.02, len(t)), "I_mA": 60 * on}
time = pd.Index(t, name="time_s")
sensor = sensor_from_current(pd.DataFrame(heated, index=time), current="I_mA")
print(sensor.summary())

pipe = 290 + 12 * (1 - np.exp(-np.clip(t - 60, 0, None) / 4))
logged = lagged(pipe, dt, 6.0, 0.7, 0.5) + rng.normal(0, 0.02, len(t))
log = pd.DataFrame({"R1_degC": logged}, index=time)
ax = plot_traces(log, compensate_frame(log, sensor), "R1_degC", pipe)
ax.set_xlim(40, 120)
