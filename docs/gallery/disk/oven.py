"""
An oven calibration
===================

An oven calibration: errors of all channels before and after the static lines, and the residuals
of the lines.
"""

import matplotlib.pyplot as plt
from shared import oven

from tcdyn.plots import draw_error_histogram, draw_oven_residuals

_, axes = plt.subplots(3, 1, figsize=(8.5, 10.0), layout="constrained")
draw_error_histogram(oven().raw_errors_K, axes[0]).set_title("as logged")
draw_error_histogram(oven().calibrated_errors_K, axes[1]).set_title("with the lines")
draw_oven_residuals(oven(), axes[2])
