"""A log of the rig: twelve junctions from warm running through loading to the unloading and the cooling after it."""

from common import analysed, lab, save

from tcdyn.plots import draw_log, draw_temperatures
from tcdyn.plots.style import figure
from tcdyn.rig.log import read_log

picture, (left, right) = figure(1, 2, width_in=10.0, height_in=4.0)
draw_log(read_log(lab() / "EHL_B3.csv", "ehl"), left)
draw_temperatures(analysed(), right)
save(picture, __file__)
