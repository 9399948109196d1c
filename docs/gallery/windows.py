"""Beta against the length of the cooling that is used, for both forms of the fit, and the junctions."""

from common import analysed, save

from tcdyn.plots import draw_inverse_check, draw_junctions, draw_window_study
from tcdyn.plots.style import figure
from tcdyn.workflows.beta_tables import cooling_by_window, reference_table

p = analysed()
picture, axes = figure(3, 1, width_in=8.5, height_in=11.0)
draw_window_study(cooling_by_window(p, (0.5, 1.0, 2.0, 5.0, 10.0)), axes[0])
draw_inverse_check(reference_table(p), axes[1])
draw_junctions(p.sensors.depths, axes[2])
save(picture, __file__)
