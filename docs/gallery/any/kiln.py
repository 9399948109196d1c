"""
Eight thermocouples in a kiln
=============================

One of eight thermocouples of one kind in a kiln: one sensor file, one error of the lag for all
of them.
"""

import numpy as np
import pandas as pd
from shared import lagged, plot_traces

from tcdyn import compensate_frame
from tcdyn.sensors import specified_sensor

t, rng = np.arange(0, 3600, 5.0), np.random.default_rng(2015)
kiln = {f"T{k}_degC": 600 + 0.05 * t + 40 * np.sin(t / 250 + k / 3) for k in range(1, 9)}
read = {k: lagged(true, 5.0, 60.0) + rng.normal(0, 0.5, len(t)) for k, true in kiln.items()}

sensor = specified_sensor("K3", list(kiln), taus_s=[(60.0, 3.0)])
log = pd.DataFrame(read, index=pd.Index(t, name="time_s"))
plot_traces(log, compensate_frame(log, sensor), "T3_degC", kiln["T3_degC"])
