"""Steady running determines a line for each disk; each estimator of beta selects a point. Right: the estimates."""

from common import analysed, save

from tcdyn.plots import draw, draw_lines
from tcdyn.plots.style import figure

picture, (left, right) = figure(1, 2, width_in=10.0, height_in=4.4)
draw_lines(analysed(), left)
draw(analysed(), right)  # draw_beta_estimates: of an analysis the picture that tells most
save(picture, __file__)
