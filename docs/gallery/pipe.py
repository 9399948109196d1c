"""A sensor in a pipe, heated by a current for a minute (LCSR): the lag in place, then a transient of the pipe."""

import numpy as np
import pandas as pd
from common import behind, made, save, tcdyn, traces

dt, rng = 0.1, np.random.default_rng(2015)
t = np.arange(0, 180, dt)
on = np.where((t > 20) & (t < 80), 1.0, 0.0)
warm = 4 * behind(on, 6.0, dt) + 1.5 * behind(on, 0.7, dt)
heated, sensor, table, done = (
    made(__file__, n) for n in ("lcsr.csv", "sensor.json", "csv", "compensated.csv")
)
r = 290 + warm + rng.normal(0, 0.02, len(t))
pd.DataFrame({"time_s": np.round(t, 2), "R1_degC": r, "I_mA": 60 * on}).to_csv(heated, index=False)
pipe = 290 + 12 * (1 - np.exp(-np.clip(t - 60, 0, None) / 4))
y = behind(behind(behind(pipe, 6.0, dt), 0.7, dt), 0.5, dt) + rng.normal(0, 0.02, len(t))
pd.DataFrame({"time_s": np.round(t, 2), "R1_degC": y}).to_csv(table, index=False)

tcdyn("sensor", "current", heated, "--column", "R1", "--current", "I_mA", "--out", sensor)
tcdyn("compensate", table, "--sensor", sensor, "--out", done)
save(traces(table, done, "R1_degC", pipe), __file__)
