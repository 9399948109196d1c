"""Two wires in an exhaust: the pair determines both lags without a reference. The coarse one is compensated."""

import numpy as np
import pandas as pd
from common import behind, made, save, tcdyn, traces

dt, rng = 0.002, np.random.default_rng(2015)
t = np.arange(0, 8, dt)
gas = 500 + 60 * np.sin(2 * np.pi * 3 * t) + 25 * np.sin(2 * np.pi * 0.7 * t + 1)
fine, coarse = (behind(gas, tau, dt) + rng.normal(0, 0.8, len(t)) for tau in (0.05, 0.18))
table, sensor, done = (made(__file__, name) for name in ("csv", "sensor.json", "compensated.csv"))
pd.DataFrame({"time_s": np.round(t, 4), "fine_degC": fine, "coarse_degC": coarse}).to_csv(
    table, index=False
)

tcdyn("sensor", "pair", table, "--column", "fine", "--column", "coarse", "--out", sensor)
tcdyn("compensate", table, "--sensor", sensor, "--out", done)
picture = traces(table, done, "coarse_degC", gas)
picture.axes[0].set_xlim(2, 4)
save(picture, __file__)
