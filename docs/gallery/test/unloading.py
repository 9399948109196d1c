"""
The unloading of a test
=======================

The unloading: grey is logged, coloured is the temperature at the junctions with its 95 %
interval.
"""

import matplotlib.pyplot as plt
from shared import analysed

from tcdyn.plots import draw_unloading
from tcdyn.rig.disk import DISKS

_, axes = plt.subplots(1, 2, figsize=(8.5, 4.2), layout="constrained")
for disk, ax in zip(DISKS, axes):
    draw_unloading(analysed(), disk, ax)
