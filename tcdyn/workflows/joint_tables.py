"""Joint fit on the page of a test: readings against the model, and the budget of beta."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.partition.analyse import Partition
from tcdyn.partition.joint import SHARE, main_covariance, nuisance_parameters
from tcdyn.partition.single_disk import OneDisk
from tcdyn.rig.disk import DISKS, LEFT_OUT_TEXT


@dataclass(frozen=True)
class FitComparison:
    """Readings of one disk's outer row against the joint fit.

    Attributes
    ----------
    channels
        The M channels of the outer row.
    time_since_unloading_s
        Time since the unloading, shape (R,).
    readings_degC, model_degC, sd_K
        Readings [degC], model [degC] and standard deviation of a reading [K], shape (R, M); NaN for a
        channel that is left out.
    """

    channels: tuple[str, ...]
    time_since_unloading_s: Array
    readings_degC: Array
    model_degC: Array
    sd_K: Array


def compare_joint_fit(p: Partition | OneDisk, disk: str) -> FitComparison:
    """Compare readings and model of a disk at the optimum of the joint fit of all its disks."""
    names = [d for d in DISKS if d in p.test.disks]
    sides = [p.joint.block] if isinstance(p, OneDisk) else [p.joint[d].block for d in names]
    optimum = p.optimum if isinstance(p, OneDisk) else p.both.optimum
    ends = np.cumsum([len(s.y) for s in sides])
    window = sides[names.index(disk)].window
    residual = np.split(optimum.residual[: ends[-1]], ends[:-1])[names.index(disk)].reshape(
        window.y.shape
    )
    sd = 1 / np.where(window.weight > 0, window.weight, np.nan)
    return FitComparison(
        p.test.disks[disk].setup.outer,
        window.block_time_s - p.test.events.unload_s,
        window.y,
        window.y + residual * sd,
        sd,
    )


def residuals_table(p: Partition | OneDisk) -> pd.DataFrame:
    """Table of reading minus model [K]: mean under load, mean after unloading, rms over noise."""
    rows = []
    for disk in [d for d in DISKS if d in p.test.disks]:
        m = compare_joint_fit(p, disk)
        difference = m.readings_degC - m.model_degC
        after = m.time_since_unloading_s > 0
        for k, c in enumerate(m.channels):
            if np.isnan(difference[:, k]).any():
                rows.append((disk, c, LEFT_OUT_TEXT, "", ""))
                continue
            before, cooling = (
                f"{1e3 * float(np.mean(difference[rows_of_part, k])):+z.0f}"
                for rows_of_part in (~after, after)
            )
            rms = float(np.sqrt(np.mean((difference[:, k] / m.sd_K[:, k]) ** 2)))
            rows.append((disk, c, before, cooling, f"{rms:.2f}"))
    columns = [
        "disk",
        "junction",
        "mean under load [mK]",
        "mean after the parting [mK]",
        "rms over noise [1]",
    ]
    return pd.DataFrame(rows, columns=columns)


def joint_budget(p: Partition) -> dict[str, float]:
    """Standard uncertainty of the recommended beta by source, largest first; squares add up."""
    sides = [p.joint[d].block for d in DISKS]
    noise, per_sd = main_covariance(p.both.optimum, sides)
    sources = [nuisance.source for nuisance, _ in nuisance_parameters(sides)] + ["chain"] * (
        2 * len(sides)
    )
    sources += ["measured surface flux"] * (per_sd.shape[1] - len(sources))
    square = {"noise": p.both.inflation * float(noise[SHARE, SHARE])}
    for source, by in zip(sources, per_sd[SHARE]):
        square[source] = square.get(source, 0.0) + float(by) ** 2
    return {source: x**0.5 for source, x in sorted(square.items(), key=lambda item: -item[1])}
