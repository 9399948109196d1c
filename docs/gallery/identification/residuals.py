"""
Residuals of a model that is rejected
=====================================

A model with one lag for data with two: the residuals are not white and correlate with the
input. It is rejected.
"""

import matplotlib.pyplot as plt
import numpy as np
from shared import lagged

from tcdyn import IOData, fit
from tcdyn.identification import validate
from tcdyn.plots import draw_correlation, draw_residuals

rng = np.random.default_rng(1)
heater = np.repeat(rng.choice([20.0, 60.0, 90.0], 20), 60)
warm = 25 + 0.6 * lagged(heater, 0.5, 18.0, 4.0) + rng.normal(0, 0.3, len(heater))
data = IOData.from_arrays(heater, warm, 0.5, hold="zoh")
found = fit(data, "P1", noise="white", baseline="none")
checked = validate(found)

_, axes = plt.subplots(3, 1, figsize=(8.5, 7.0), layout="constrained")
draw_residuals(found, axes[0])
draw_correlation(checked.whiteness, axes[1], "residuals with themselves")
draw_correlation(checked.input, axes[2], "residuals with the input")
