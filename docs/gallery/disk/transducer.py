"""
A load cell and the bearing friction
====================================

A load cell's gain, one for two sessions of dead weights, and the bearing friction of a
pure-rolling test.
"""

import matplotlib.pyplot as plt
import numpy as np

from calibration.transducers import fit_bearing_friction, fit_transducer
from tcdyn.plots import draw_bearing

rng = np.random.default_rng(1)
force, session = np.tile(np.arange(0, 2500, 250.0), 2), np.repeat([1, 2], 10)
volts = force / 512.3 + 0.3 * session + rng.normal(0, 0.002, 20)
load, rpm = np.tile([850.0, 1460.0, 1850.0, 2320.0], 2), np.repeat([774.0, 1546.0], 4)
friction = 3 + 0.002 * load + 0.002 * rpm + rng.normal(0, 0.1, 8)

_, (left, right) = plt.subplots(1, 2, figsize=(8.5, 3.8), layout="constrained")
line = fit_transducer(volts, force, session)
for name, intercept in line.intercept_N.items():
    x = volts[session == int(name)]
    (dots,) = left.plot(x, force[session == int(name)], "o", markersize=4, label=name)
    left.axline((0, intercept.value), slope=line.slope_N_V.value, color=dots.get_color())
left.set(xlabel="transducer [V]", ylabel="force [N]")
left.legend(title="session", frameon=False, fontsize="small")
draw_bearing(fit_bearing_friction(load, friction, rpm), right)
