"""A furnace whose door opens at 300 s, in kelvin; the lag is stated. Grey is logged, blue compensated, dotted true."""

import numpy as np
import pandas as pd
from common import behind, made, save, tcdyn, traces

t = np.arange(0, 900, 1.0)
door = np.clip(t - 300, 0, None)
air = 850 - 120 * (1 - np.exp(-door / 15)) * np.exp(-door / 200)
y = behind(air, 25.0, 1.0) + np.random.default_rng(2015).normal(0, 0.3, len(t)) + 273.15
table, sensor, done = (made(__file__, name) for name in ("csv", "sensor.json", "compensated.csv"))
pd.DataFrame({"time_s": t, "TC1_K": y, "power_kW": 30.0}).to_csv(table, index=False)

tcdyn("sensor", "new", "--tau-s", "25+-1", "--column", "TC1", "--out", sensor)
tcdyn("compensate", table, "--sensor", sensor, "--out", done)
save(traces(table, done, "TC1_K", air, 273.15), __file__)
