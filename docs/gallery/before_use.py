"""Properties of a proper inverse of 1.5 Hz before it is applied, and the L-curve of a deconvolution."""

import numpy as np
from common import behind, save

from tcdyn import Chain
from tcdyn.plots import draw_filter_report, draw_tradeoff
from tcdyn.plots.style import figure
from tcdyn.smoothing import deconvolve, proper_inverse, report_inverse

dt = 1 / 75
t = np.arange(0, 40, dt)
true = 120 - 12 * (1 - np.exp(-np.clip(t - 20, 0, None) / 1.0))
logged = behind(true, 0.67, dt) + np.random.default_rng(0).normal(0, 0.15, len(t))

picture, (left, right) = figure(1, 2, width_in=11.0, height_in=4.0)
draw_filter_report(report_inverse(proper_inverse(Chain(0.67), dt, 1.5), 0.15), left)
draw_tradeoff(deconvolve(logged, dt, Chain(0.67), criterion="l-curve")[1], right)
save(picture, __file__)
