"""How hot each disk is round its bore: what the press fit makes of it, and the temperature at the end of the load."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import harmonic_K
from tcdyn.plots import partition as draw
from tcdyn.plots.circumferential import round_figure
from tcdyn.plots.style import pictured
from tcdyn.report.page import Section
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.circumferential import around_disk


def uneven_section(p: Partition) -> Section:
    """What the bore contact makes of the temperature round each disk, and what was subtracted."""
    found = [f.sentence for d in DISKS if (f := p.both.uneven[d].finding(d)) is not None]
    rows = [
        {
            "disk": d,
            "junction": c,
            "angle [deg]": f"{j.angle_deg:g}",
            "reads more by [K]": f"{more:+z.2f}",
        }
        for d in DISKS
        for (c, j), more in zip(
            sorted(p.test.disks[d].setup.junctions.items()),
            harmonic_K(p.both.uneven[d], p.test.disks[d].setup, np.zeros(1))[0],
        )
    ]
    return Section(
        "are the disks even round their bores?",
        (". ".join(found) + "." if found else "Yes, as far as two groups of junctions can tell.")
        + " What the first harmonic makes of each reading at the parting is below: the joint fits find it, and the "
        "other ways to β see readings without it. The second harmonic, which two opposite groups see alike, is in the "
        "budget.",
        table=pd.DataFrame(rows),
        figure=pictured(*(partial(draw.draw_angular_harmonic, p, d) for d in DISKS), height_in=4.0),
        caption="The disks seen along the shaft, junctions at the angles of rig.toml; bright is hot.",
    )


def around_section(p: Partition) -> Section:
    """The temperature round each disk at the end of the load."""
    return Section(
        "the temperature round the disks",
        "Mean of the last ten seconds under load: the rim model's temperature by the joint fit of both disks with the "
        "first harmonic that was found. Nothing is measured deeper than the inner row.",
        figure=round_figure([around_disk(p, disk) for disk in DISKS]),
        caption="Above: the middle plane, unrolled, with the readings; open junctions lie beside it. Below: the mean "
        "across the running surface with its 95 % band.",
    )
