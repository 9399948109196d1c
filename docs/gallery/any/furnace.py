"""
A furnace door opens
====================

A furnace whose door opens at 300 s, in kelvin; the lag is stated. Grey is logged, blue
compensated, dotted true.
"""

import numpy as np
import pandas as pd
from shared import lagged, plot_traces

from tcdyn import compensate_frame
from tcdyn.sensors import specified_sensor

t = np.arange(0, 900, 1.0)
door = np.clip(t - 300, 0, None)
air_K = 1123.15 - 120 * (1 - np.exp(-door / 15)) * np.exp(-door / 200)
logged = lagged(air_K, 1.0, 25.0) + np.random.default_rng(2015).normal(0, 0.3, len(t))

sensor = specified_sensor("TC1", ["TC1_K"], taus_s=[(25.0, 1.0)])
log = pd.DataFrame({"TC1_K": logged}, index=pd.Index(t, name="time_s"))
plot_traces(log, compensate_frame(log, sensor), "TC1_K", air_K)
