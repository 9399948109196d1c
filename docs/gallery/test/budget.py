"""
The uncertainty budget of beta
==============================

Contributions to the uncertainty of beta.
"""

import matplotlib.pyplot as plt
from shared import analysed

from tcdyn.plots import draw_beta_by_exponent, draw_budget, draw_map

_, ax = plt.subplots(figsize=(8.5, 4.0), layout="constrained")
draw_budget(analysed(), ax)

# %%
# Left: beta by the speed law against its exponent, and the exponent that the joint fit estimates
# without that law. Right: how well each pair of h and beta explains the steady temperatures.

_, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
draw_beta_by_exponent(analysed(), left)
draw_map(analysed(), "fast", right)
