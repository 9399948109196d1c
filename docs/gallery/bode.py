"""Step, magnitude, phase and poles of an identified model with 95 % intervals, wide where the input had no power."""

import numpy as np
from common import behind, save

from tcdyn import IOData, fit
from tcdyn.plots import draw_bode, draw_poles, draw_step
from tcdyn.plots.style import figure

rng = np.random.default_rng(3)
u = np.repeat(rng.choice([20.0, 80.0], 30), 40)
y = behind(behind(u, 0.75, 0.05), 0.2, 0.05) + rng.normal(0, 2.0, len(u))
model = fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P2D").identified

picture, (step, magnitude, poles, phase) = figure(2, 2, height_in=6.0)
draw_step(model, step)
draw_bode(model, magnitude, phase)
draw_poles(model, poles)
save(picture, __file__)
