"""What steady running leaves open, a line for each disk; every way to beta picks a point on it. Right: the ways."""

from common import analysed, save

from tcdyn.plots import draw, draw_lines
from tcdyn.plots.style import figure

picture, (left, right) = figure(1, 2, width_in=10.0, height_in=4.4)
draw_lines(analysed(), left)
draw(analysed(), right)  # draw_ways: of an analysis the picture that tells most
save(picture, __file__)
