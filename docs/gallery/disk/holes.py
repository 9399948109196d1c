"""
Junctions in holes of three sizes
=================================

Junctions in holes of three sizes plunged into hot water: with cement in the widest hole, most
of a second later.
"""

import matplotlib.pyplot as plt

from immersion.hole import compare_holes
from tcdyn.plots import draw_holes
from tcdyn.simulate.plunge import simulate_hole

_, ax = plt.subplots(figsize=(8.5, 4.4), layout="constrained")
draw_holes(compare_holes(simulate_hole(1)[0]), ax)
