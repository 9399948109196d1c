"""One of eight thermocouples of one kind in a kiln: one sensor file, one error of the lag for all of them."""

import numpy as np
import pandas as pd
from common import behind, made, save, tcdyn, traces

t, rng = np.arange(0, 3600, 5.0), np.random.default_rng(2015)
kiln = {f"T{k}": 600 + 0.05 * t + 40 * np.sin(t / 250 + k / 3) for k in range(1, 9)}
read = {f"{k}_degC": behind(v, 60.0, 5.0) + rng.normal(0, 0.5, len(t)) for k, v in kiln.items()}
table, sensor, done = (made(__file__, name) for name in ("csv", "sensor.json", "compensated.csv"))
pd.DataFrame({"time_s": t, **read, "gas_m3_h": 12.0}).to_csv(table, index=False)

tcdyn("sensor", "new", "--tau-s", "60+-3", "--column", "T*", "--out", sensor)
tcdyn("compensate", table, "--sensor", sensor, "--out", done)
save(traces(table, done, "T3_degC", kiln["T3"]), __file__)
