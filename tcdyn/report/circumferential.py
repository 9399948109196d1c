"""Sections on the temperature around each disk: first circumferential harmonic, field.

Used by :mod:`tcdyn.report.beta`. Test: ``tests/report/test_beta_page.py``.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import harmonic_K
from tcdyn.partition.circumferential import circumferential_temperature
from tcdyn.plots import partition as draw
from tcdyn.plots.circumferential import circumferential_figure
from tcdyn.plots.style import panel_figure
from tcdyn.report.page import Section


def unevenness_section(partition: Partition) -> Section:
    """Return section of the first circumferential harmonic of each disk, which was subtracted."""
    rows = []
    sentences = []
    for disk in partition.disks:
        harmonic = partition.combined.harmonics[disk]
        setup = partition.test.disks[disk].setup
        finding = harmonic.finding(disk)
        if finding is not None:
            sentences.append(finding.sentence)
        contributions_K = harmonic_K(harmonic, setup, np.zeros(1))[0]
        for (channel, junction), contribution_K in zip(
            sorted(setup.junctions.items()), contributions_K
        ):
            rows.append(
                {
                    "disk": disk,
                    "junction": channel,
                    "angle [deg]": f"{junction.angle_deg:g}",
                    "reads more by [K]": f"{contribution_K:+z.2f}",
                }
            )
    conclusion = "Yes, as far as two groups of junctions can show."
    if sentences:
        conclusion = ". ".join(sentences) + "."
    panels = [partial(draw.draw_angular_harmonic, partition, disk) for disk in partition.disks]
    return Section(
        "is the temperature even around the bores?",
        f"{conclusion} The contribution of the first harmonic to each reading at the unloading is "
        "below: the joint fits estimate it, and the other estimators of β use readings without "
        "it. The second harmonic, which two opposite groups of junctions read alike, is in the "
        "budget.",
        table=pd.DataFrame(rows),
        figure=panel_figure(*panels, height_in=4.0),
        caption="The disks seen along the shaft, junctions at the angles of rig.toml.",
    )


def around_section(partition: Partition) -> Section:
    """Return the section of the temperature around each disk at the end of the load."""
    return Section(
        "the temperature around the disks",
        "Mean of the last ten seconds under load: the rim model's temperature by the joint "
        "fit with the first harmonic that it estimates. Nothing is measured deeper than "
        "the inner row.",
        figure=circumferential_figure(
            [circumferential_temperature(partition, disk) for disk in partition.disks]
        ),
        caption="Upper row: the middle plane, unrolled, with the readings; open junctions lie "
        "beside it. Lower row: the mean across the running surface with its 95 % band.",
    )
