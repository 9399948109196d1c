"""
An inverse filter before use, and the L-curve
=============================================

Properties of a proper inverse of 1.5 Hz before it is applied, and the L-curve of a
deconvolution.
"""

import matplotlib.pyplot as plt
import numpy as np
from shared import lagged

from tcdyn import Chain
from tcdyn.plots import draw_filter_report
from tcdyn.smoothing import deconvolve, proper_inverse, report_inverse

dt = 1 / 75
t = np.arange(0, 40, dt)
true = 120 - 12 * (1 - np.exp(-np.clip(t - 20, 0, None) / 1.0))
logged = lagged(true, dt, 0.67) + np.random.default_rng(0).normal(0, 0.15, len(t))

_, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.0), layout="constrained")
draw_filter_report(report_inverse(proper_inverse(Chain(0.67), dt, 1.5), 0.15), left)
_, curve = deconvolve(logged, dt, Chain(0.67), criterion="l-curve")
misfit, roughness = curve.misfit[:, 0], curve.roughness[:, 0]
right.loglog(misfit, roughness, "o-", markersize=3)
log_chosen, log_intensity = np.log(curve.chosen[0]), np.log(curve.intensity[:, 0])
chosen = [np.interp(log_chosen, log_intensity, values) for values in (misfit, roughness)]
right.loglog(*chosen, "s", label="chosen by the L-curve")
right.set(xlabel="mean square residual [K²]", ylabel="roughness [K²/s³]")
right.legend(frameon=False, fontsize="small")
