"""The sixteen tests of the thesis (tables 6.1 and 7.2): traction, its coefficient, temperature of junction a."""

import pandas as pd
from common import save

from tcdyn.plots import draw_quantity
from tcdyn.plots.style import figure
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

picture, axes = figure(2, 2, width_in=10.0, height_in=6.8)
draw_quantity(table, "friction_N", axes[0])
draw_quantity(table, "friction_coefficient", axes[1], against="sliding_speed_m_s")
for disk, ax in zip(("fast", "slow"), axes[2:]):
    draw_quantity(table, f"{disk}_a_degC", ax)
    ax.set_ylabel(f"junction a, {disk} disk [°C]")
save(picture, __file__)
