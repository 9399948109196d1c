"""
Steady lines and estimates of beta
==================================

Steady running determines a line for each disk; each estimator of beta selects a point. Right:
the estimates.
"""

import matplotlib.pyplot as plt
from shared import analysed

from tcdyn.plots import draw, draw_lines

_, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
draw_lines(analysed(), left)
draw(analysed(), right)  # draw_beta_estimates: of an analysis the picture that tells most
