"""
Temperatures in the rim
=======================

The rim under the track: isotherms, and three profiles through the readings of d, b and f.
"""

import matplotlib.pyplot as plt
import numpy as np

from tcdyn.heat.engine import RimInputs, fields_at
from tcdyn.heat.modal import spectrum
from tcdyn.heat.rim import MESH_IV, Rim, junction_points
from tcdyn.rig.rigfile import load_rig

setup = load_rig().disk_setup("fast")
rim, one = Rim.from_setup(setup), np.ones(2)
drive = RimInputs(1 / 75, 170.0 * one, 96.0 * one, 98.0 * one, 95.0 * one, 60.0 * one)
field = fields_at(rim, drive, 750.0, 1.62e-3, [0])[0]

_, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
depth_mm = 1e3 * np.linspace(rim.thickness_m, 0.0, field.shape[0])
z_mm = 1e3 * np.linspace(0.0, rim.width_m, field.shape[1])
filled = left.contourf(z_mm, depth_mm, field, levels=14, cmap="inferno")
plt.colorbar(filled, ax=left, label="temperature [°C]")
for name, (depth_m, z_m) in zip("ace", junction_points(setup, "ace")):
    left.plot(1e3 * z_m, 1e3 * depth_m, "ow")
    left.annotate(name, (1e3 * z_m + 0.3, 1e3 * depth_m - 0.2), color="white")
left.invert_yaxis()
left.set(xlabel="z [mm]", ylabel="depth [mm]")

inner_row = np.array([96.0, 98.0, 95.0])
z_mm = 1e3 * np.linspace(0.0, rim.width_m, MESH_IV.nz)
for kind, style in (("quadratic", "-"), ("quartic", "--"), ("modal", ":")):
    basis = spectrum(rim, 0.0, rim.width_m / 4, kind, "uniform", MESH_IV).profile
    right.plot(z_mm, inner_row @ basis[:3] + 60.0 * basis[3:].sum(axis=0), style, label=kind)
right.plot(1e3 * np.array(rim.boundary_z_m), inner_row, "ko", label="inner row")
right.set(xlabel="z [mm]", ylabel="temperature at R_i [°C]")
right.legend(frameon=False, fontsize="small")
