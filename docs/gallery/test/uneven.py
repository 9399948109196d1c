"""
A disk whose bore conducts unevenly
===================================

The temperature around a disk whose bore conducts unevenly: 0.5 of the mean better at 30
degrees, worse opposite.
"""

import matplotlib.pyplot as plt

from tcdyn.plots import draw_middle_plane, draw_running_surface
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.ehl import EhlOptions
from tcdyn.simulate.field import disk_fields
from tcdyn.simulate.truth import BoreContact, draw_truth

truth = draw_truth(0, load_rig()).with_uneven({"slow": BoreContact(0.5, 30.0)})
quick = EhlOptions(load_on_s=10.0, unload_s=130.0, duration_s=140.0)
slow = disk_fields("B3", 0, truth, quick)["slow"]

_, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
draw_middle_plane(slow, left)
draw_running_surface(slow, right)
