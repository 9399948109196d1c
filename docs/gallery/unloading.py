"""The unloading: grey is logged, coloured is the temperature at the junctions with its 95 % interval."""

from common import analysed, save

from tcdyn.plots import draw_unloading
from tcdyn.plots.style import figure
from tcdyn.rig.disk import DISKS

picture, axes = figure(1, 2, height_in=4.2)
for disk, ax in zip(DISKS, axes):
    draw_unloading(analysed(), disk, ax)
save(picture, __file__)
