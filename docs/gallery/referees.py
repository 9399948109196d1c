"""The rim's numerical scheme against closed forms: error in per cent, order, and table 3.2 of the thesis (crosses)."""

from common import save

from tcdyn.plots import draw_comparison, draw_convergence, draw_mesh_errors
from tcdyn.plots.style import figure
from tcdyn.verify import studies
from tcdyn.verify.rim_rows import TABLE_3_2

picture, axes = figure(2, 2, width_in=10.0, height_in=6.4)
draw_comparison(studies.transient_check(), axes[0])
draw_comparison(studies.steady_check(), axes[1])
draw_convergence([studies.series_convergence(), studies.product_convergence()], axes[2])
draw_mesh_errors(studies.ideal_study(late_steps=1), TABLE_3_2, axes[3])
save(picture, __file__)
