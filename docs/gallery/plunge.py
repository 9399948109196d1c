"""A plunge: first seconds and the fitted chain, the residuals, h with the burst at the entry, the reading."""

from common import plunged, save

from immersion.plunge_fit import published_degC
from tcdyn.plots import (
    draw_entry,
    draw_heat_transfer,
    draw_plunge,
    draw_plunge_residuals,
    draw_record,
)
from tcdyn.plots.style import figure
from tcdyn.rig.rigfile import load_rig

fit, setup = plunged(), load_rig().disk_setup("fast")
models = {**published_degC(fit.runs[0], setup), "fitted": fit.junction_degC(0)}
picture, axes = figure(3, 2, width_in=10.0, height_in=9.6)
draw_plunge(fit, 0, axes[0])
draw_plunge_residuals(fit, 0, axes[1])
draw_heat_transfer(fit, 0, axes[2])
draw_entry(fit.runs[0], models, axes[3])
draw_record(fit.runs[0], axes[4])
draw_record(fit.runs[0], axes[5], until_s=20.0)
save(picture, __file__)
