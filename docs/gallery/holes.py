"""Junctions in holes of three sizes plunged into hot water: with cement in the widest hole, most of a second later."""

from common import save

from immersion.hole import compare_holes
from tcdyn.plots import draw_holes
from tcdyn.plots.style import figure
from tcdyn.simulate.plunge import simulate_hole

picture, (ax,) = figure(height_in=4.4)
draw_holes(compare_holes(simulate_hole(1)[0]), ax)
save(picture, __file__)
