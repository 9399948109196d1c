"""
Planned tests compared
======================

Predicted uncertainty of the lags from planned plunges, a touch, a loading and an unloading:
shorter is better.
"""

import matplotlib.pyplot as plt

from tcdyn.design.compare import compare_tests
from tcdyn.design.plans import PlungePlan
from tcdyn.plots import draw_design
from tcdyn.rig.rigfile import load_rig

plans = [PlungePlan(bath_degC=bath, duration_s=60.0) for bath in (110.0, 138.0)]
_, ax = plt.subplots(figsize=(8.5, 4.8), layout="constrained")
draw_design(compare_tests(load_rig().disk_setup("fast"), plans, draws=4), ax)
ax.legend(loc="lower left", bbox_to_anchor=(-0.4, 1), ncols=2, frameon=False, fontsize="small")
