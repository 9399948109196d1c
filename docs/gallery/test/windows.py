"""
Beta against the cooling that is used
=====================================

Beta against the length of the cooling that is used, for both forms of the fit, and the
junctions.
"""

import matplotlib.pyplot as plt
from shared import analysed

from tcdyn.partition.cooling_checks import cooling_by_window, reference_table
from tcdyn.plots import draw_inverse_check, draw_junctions, draw_window_study

p = analysed()
_, axes = plt.subplots(3, 1, figsize=(8.5, 11.0), layout="constrained")
draw_window_study(cooling_by_window(p, (0.5, 1.0, 2.0, 5.0, 10.0)), axes[0])
draw_inverse_check(reference_table(p), axes[1])
draw_junctions(p.sensors.depths, axes[2])
