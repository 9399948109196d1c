"""
The rim model against closed forms
==================================

The rim's numerical scheme against closed forms: error in per cent, order, and table 3.2 of the
thesis (crosses).
"""

import matplotlib.pyplot as plt

from tcdyn.plots import draw_comparison, draw_convergence, draw_mesh_errors
from tcdyn.verify import studies
from tcdyn.verify.rim_rows import TABLE_3_2

_, axes = plt.subplots(2, 2, figsize=(10.0, 6.4), layout="constrained")
draw_comparison(studies.transient_check(), axes.flat[0])
draw_comparison(studies.steady_check(), axes.flat[1])
draw_convergence([studies.series_convergence(), studies.product_convergence()], axes.flat[2])
axes.flat[2].legend(loc="lower left", frameon=False, fontsize="small")
draw_mesh_errors(studies.ideal_study(late_steps=1), TABLE_3_2, axes.flat[3])
