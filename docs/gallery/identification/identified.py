"""
A heater and a temperature
==========================

A heater and a temperature, measured and simulated by the identified model; below, the
residuals of the model, which are white.
"""

import matplotlib.pyplot as plt
import numpy as np
from shared import lagged

from tcdyn import IOData, fit
from tcdyn.plots import draw_fit, draw_residuals

rng = np.random.default_rng(1)
heater = np.repeat(rng.choice([20.0, 60.0, 90.0], 20), 60)
warm = 25 + 0.6 * lagged(heater, 0.5, 18.0, 4.0) + rng.normal(0, 0.3, len(heater))
data = IOData.from_arrays(heater, warm, 0.5, hold="zoh")

_, (top, bottom) = plt.subplots(2, 1, figsize=(8.5, 6.0), layout="constrained")
model = fit(data, "P2D")
draw_fit(model, top)
draw_residuals(model, bottom)
