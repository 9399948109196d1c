"""A heater and a temperature, measured and simulated by the identified model; below, the data."""

import numpy as np
from common import behind, save

from tcdyn import IOData, fit
from tcdyn.plots import draw_data, draw_fit
from tcdyn.plots.style import figure

rng = np.random.default_rng(1)
heater = np.repeat(rng.choice([20.0, 60.0, 90.0], 20), 60)
warm = 25 + 0.6 * behind(behind(heater, 18.0, 0.5), 4.0, 0.5) + rng.normal(0, 0.3, len(heater))
data = IOData.from_arrays(heater, warm, 0.5, hold="zoh")

picture, (top, bottom) = figure(2, 1, height_in=6.0)
draw_fit(fit(data, "P2D"), top)
draw_data(data, bottom)
save(picture, __file__)
