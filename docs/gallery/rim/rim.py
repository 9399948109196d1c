"""
Temperatures in the rim
=======================

The rim under the track: isotherms, and three profiles through the readings of d, b and f.
"""

import matplotlib.pyplot as plt
import numpy as np

from tcdyn.heat.engine import RimInputs, fields_at
from tcdyn.heat.rim import Rim, junction_points
from tcdyn.plots import draw_field, draw_profiles
from tcdyn.rig.rigfile import load_rig

setup = load_rig().disk_setup("fast")
rim, one = Rim.from_setup(setup), np.ones(2)
drive = RimInputs(1 / 75, 170.0 * one, 96.0 * one, 98.0 * one, 95.0 * one, 60.0 * one)
field = fields_at(rim, drive, 750.0, 1.62e-3, [0])[0]

_, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
draw_field(field, rim, left, points=dict(zip("ace", junction_points(setup, "ace"))))
draw_profiles(rim, [96.0, 98.0, 95.0], 60.0, right)
