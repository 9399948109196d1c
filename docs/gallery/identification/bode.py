"""
Step, Bode diagram and poles with intervals
===========================================

Step, magnitude, phase and poles of an identified model with 95 % intervals, wide where the
input had no power.
"""

import matplotlib.pyplot as plt
import numpy as np
from shared import lagged

from tcdyn import IOData, fit
from tcdyn.plots import draw_bode, draw_poles, draw_step

rng = np.random.default_rng(3)
u = np.repeat(rng.choice([20.0, 80.0], 30), 40)
y = lagged(u, 0.05, 0.75, 0.2) + rng.normal(0, 2.0, len(u))
model = fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P2D").identified

_, ((step, magnitude), (poles, phase)) = plt.subplots(
    2, 2, figsize=(8.5, 6.0), layout="constrained"
)
draw_step(model, step)
draw_bode(model, magnitude, phase)
draw_poles(model, poles)
