"""An oven calibration: errors of all channels before and after the static lines, and the residuals of the lines."""

from common import oven, save

from tcdyn.plots import draw_error_histogram, draw_oven_residuals
from tcdyn.plots.style import figure

picture, axes = figure(3, 1, width_in=8.5, height_in=10.0)
draw_error_histogram(oven().raw_errors_K, axes[0], label="as logged")
draw_error_histogram(oven().calibrated_errors_K, axes[1], label="with the lines")
draw_oven_residuals(oven(), axes[2])
save(picture, __file__)
