"""
A plunge and its fit
====================

A plunge: first seconds and the fitted chain, the residuals, h with the burst at the entry, the
reading.
"""

import matplotlib.pyplot as plt
from shared import plunged

from immersion.plunge_fit import published_degC
from tcdyn.plots import (
    draw_entry,
    draw_heat_transfer,
    draw_plunge,
    draw_plunge_residuals,
    draw_record,
)
from tcdyn.rig.rigfile import load_rig

fit, setup = plunged(), load_rig().disk_setup("fast")
models = {**published_degC(fit.runs[0], setup), "fitted": fit.junction_degC(0)}
_, axes = plt.subplots(3, 2, figsize=(10.0, 9.6), layout="constrained")
draw_plunge(fit, 0, axes.flat[0])
draw_plunge_residuals(fit, 0, axes.flat[1])
draw_heat_transfer(fit, 0, axes.flat[2])
draw_entry(fit.runs[0], models, axes.flat[3])
axes.flat[3].legend(loc="upper left", frameon=False, fontsize="x-small")
draw_record(fit.runs[0], axes.flat[4])
draw_record(fit.runs[0], axes.flat[5], until_s=20.0)
