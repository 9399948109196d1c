"""
The uncertainty budget of beta
==============================

Contributions to the uncertainty of beta; and beta by the speed law against its exponent, with
the estimated one.
"""

import matplotlib.pyplot as plt
from shared import analysed

from tcdyn.plots import draw_beta_by_exponent, draw_budget, draw_map

_, axes = plt.subplots(1, 3, figsize=(14.0, 5.0), layout="constrained")
draw_budget(analysed(), axes[0])
draw_beta_by_exponent(analysed(), axes[1])
draw_map(analysed(), "fast", axes[2])
