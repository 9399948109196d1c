"""
A log of the rig
================

A log of the rig: twelve junctions from warm running through loading to the unloading and the
cooling after it.
"""

import matplotlib.pyplot as plt
from shared import analysed, lab

from tcdyn.plots import draw_log, draw_temperatures
from tcdyn.rig.log import read_log

_, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
draw_log(read_log(lab() / "EHL_B3.csv", "ehl"), left)
draw_temperatures(analysed(), right)
