"""
A fast and a slow unloading
===========================

An unloading in 0.02 and in 1.5 s (figure 4.20): friction, temperature of junction e, and its
slope.
"""

import matplotlib.pyplot as plt
import numpy as np

from tcdyn.plots.style import FAST, SLOW
from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions, simulate_ehl
from tcdyn.simulate.truth import CLEAN, draw_truth

rig = draw_truth(0).with_imperfections(CLEAN)
_, axes = plt.subplots(1, 3, figsize=(10.0, 3.4), layout="constrained")
for unloading_s, colour, style in ((0.02, SLOW, "-"), (1.5, FAST, "--")):
    quick = EhlOptions(unload_s=350.0, duration_s=355.0, parting_s=unloading_s, mesh=STUDY_MESH)
    truth = simulate_ehl("D4", 0, rig, quick)[1]
    traces = truth["traces"]
    since_s = traces["time_s"] - truth["unload_s"]
    near = (since_s > -2) & (since_s < 4)
    temperature = traces["fast_e_degC"].to_numpy()
    slope = np.gradient(temperature, traces["time_s"])
    for ax, y in zip(axes, (traces["friction_N"], temperature, slope)):
        ax.plot(since_s[near], y[near], style, color=colour, label=f"{unloading_s:g} s")
for ax, label in zip(axes, ("friction [N]", "temperature of e [°C]", "slope of e [K/s]")):
    ax.set(xlabel="time from the unloading [s]", ylabel=label)
axes[0].legend(title="unloading in", frameon=False, fontsize="small")
