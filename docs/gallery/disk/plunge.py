"""
A plunge and its fit
====================

A plunge: first seconds and the fitted chain, the residuals, h with the burst at the entry, and
one reading with the junction by published correlations and by the fit.
"""

import matplotlib.pyplot as plt
import pandas as pd
from shared import plunged

from immersion.plunge_fit import published_degC
from tcdyn.plots import draw_plunge, draw_plunge_residuals
from tcdyn.rig.rigfile import load_rig

fit = plunged()
run = fit.runs[0]
readings = pd.DataFrame(run.readings_degC, run.time_s - run.entry.time_s, columns=run.channels)
_, axes = plt.subplots(3, 2, figsize=(10.0, 9.6), layout="constrained")
draw_plunge(fit, 0, axes.flat[0])
draw_plunge_residuals(fit, 0, axes.flat[1])

# h after the entry, fitted and by the correlation at the same temperatures
model, surface = fit.optimum.problem.models[0], fit.optimum.surfaces[0]
after = model.grid_s > 0.01
published = model.bath.h_W_m2K(surface.temperature_degC, model.bath_degC)
axes.flat[2].semilogx(model.grid_s[after], surface.h_W_m2K[after], label="fitted")
axes.flat[2].semilogx(model.grid_s[after], published[after], "--", label=fit.correlation)
axes.flat[2].set(ylabel="h [W/m²K]")

readings["a"].loc[-3:15].plot(ax=axes.flat[3], color="0.6", label="measured, a")
models = published_degC(run, load_rig().disk_setup("fast")) | {"fitted": fit.junction_degC(0)}
for name, junctions in models.items():
    junctions["a"].loc[:15].plot(ax=axes.flat[3], label=name)
readings.plot(ax=axes.flat[4], linewidth=0.9)
readings.loc[:20].plot(ax=axes.flat[5], linewidth=0.9)
for ax in axes.flat[2:]:
    ax.set(xlabel="time after the entry [s]")
    ax.legend(frameon=False, fontsize="x-small")
for ax in axes.flat[3:]:
    ax.set(ylabel="temperature [°C]")
