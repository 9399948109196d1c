"""
The tests of the thesis
=======================

The sixteen tests of the thesis (tables 6.1 and 7.2): traction, its coefficient, temperature of
junction a.
"""

import matplotlib.pyplot as plt
import pandas as pd

from tcdyn.plots import draw_quantity
from tcdyn.simulate.programme import PROGRAMME
from tcdyn.verify.published import CLARKE_STEADY

tests = list(PROGRAMME.values())
table = pd.DataFrame(
    {
        "error": "",
        "load_N": [t.load_N for t in tests],
        "sliding_speed_m_s": [t.sliding_speed_m_s for t in tests],
        "friction_N": [row[2] for row in CLARKE_STEADY],
        "fast_a_degC": [row[0] for row in CLARKE_STEADY],
        "slow_a_degC": [row[1] for row in CLARKE_STEADY],
    }
)
table["friction_coefficient"] = table["friction_N"] / table["load_N"]

_, axes = plt.subplots(2, 2, figsize=(10.0, 6.8), layout="constrained")
draw_quantity(table, "friction_N", axes.flat[0])
draw_quantity(table, "friction_coefficient", axes.flat[1], against="sliding_speed_m_s")
for disk, ax in zip(("fast", "slow"), axes[1]):
    draw_quantity(table, f"{disk}_a_degC", ax)
    ax.set_ylabel(f"junction a, {disk} disk [°C]")
