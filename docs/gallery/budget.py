"""Contributions to the uncertainty of beta; and beta by the speed law against its exponent, with the estimated one."""

from common import analysed, save

from tcdyn.plots import draw_beta_by_exponent, draw_budget, draw_map
from tcdyn.plots.style import figure

picture, axes = figure(1, 3, width_in=14.0, height_in=5.0)
draw_budget(analysed(), axes[0])
draw_beta_by_exponent(analysed(), axes[1])
draw_map(analysed(), "fast", axes[2])
save(picture, __file__)
