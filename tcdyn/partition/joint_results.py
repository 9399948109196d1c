"""What the joint fit leaves unexplained, and what its uncertainty comes from.

Used by beta.json, figures and tables of a test. Guarded by ``tests/report/test_beta_page.py`` and
``tests/partition/test_structures.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from immersion.fluids import fluid
from tcdyn.core import Array
from tcdyn.partition.analyse import Partition
from tcdyn.partition.film_heat import film_heat_share
from tcdyn.partition.joint import SHARE, main_covariance, nuisance_parameters
from tcdyn.partition.window import rows_between

OIL_WINDOW_S = 20.0  # before the unloading, for the temperature of the oil film; by judgement


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
        Readings [degC], model [degC] and standard deviation of a reading [K], shape (R, M); NaN
        for a channel that is left out.
    """

    channels: tuple[str, ...]
    time_since_unloading_s: Array
    readings_degC: Array
    model_degC: Array
    sd_K: Array


def compare_joint_fit(partition: Partition, disk: str) -> FitComparison:
    """Compare readings and model of a disk at the optimum of the joint fit of all its disks.

    Parameters
    ----------
    partition
        The partition.
    disk
        Name of the disk.

    Notes
    -----
    The residuals of the optimum start with those of the readings, disk by disk in the order of
    ``tcdyn.rig.disk.DISKS``; this must stay the order of ``tcdyn.partition.joint``.
    """
    blocks = [fit.block for fit in partition.joint.values()]
    index = partition.disks.index(disk)
    ends = np.cumsum([len(block.y) for block in blocks])
    window = blocks[index].window
    residuals = np.split(partition.combined.optimum.residual[: ends[-1]], ends[:-1])
    residual = residuals[index].reshape(window.y.shape)
    sd = 1 / np.where(window.weight > 0, window.weight, np.nan)
    return FitComparison(
        partition.test.disks[disk].setup.outer,
        window.block_time_s - partition.test.events.unload_s,
        window.y,
        window.y + residual * sd,
        sd,
    )


def joint_budget(partition: Partition) -> dict[str, float]:
    """Standard uncertainty of the recommended beta by source, largest first; squares add up.

    Parameters
    ----------
    partition
        The partition.

    Returns
    -------
    dict
        Standard uncertainty [1] by source.

    Notes
    -----
    The order of the sources is that of the columns of ``tcdyn.partition.joint.main_covariance``:
    nuisance parameters, two of the chain for each disk, and the measured surface flux if there are
    more. Noise is scaled by the inflation factor of the fit.
    """
    blocks = [fit.block for fit in partition.joint.values()]
    noise, per_sd = main_covariance(partition.combined.optimum, blocks)
    sources = [nuisance.source for nuisance, _ in nuisance_parameters(blocks)]
    sources += ["chain"] * (2 * len(blocks))
    sources += ["measured surface flux"] * (per_sd.shape[1] - len(sources))
    square = {"noise": partition.combined.inflation * float(noise[SHARE, SHARE])}
    for source, by in zip(sources, per_sd[SHARE]):
        square[source] = square.get(source, 0.0) + float(by) ** 2
    return {source: x**0.5 for source, x in sorted(square.items(), key=lambda item: -item[1])}


def oil_film_share(partition: Partition) -> float:
    """Share of the frictional heat that leaves with the oil film, assumed to be Mobil Jet Oil II.

    The oil has the mean temperature of the junctions in the last seconds under load.

    Parameters
    ----------
    partition
        Result of one test.
    """
    test = partition.test
    rows = rows_between(test.time_s, test.events.unload_s - OIL_WINDOW_S, test.events.unload_s)
    disks = list(test.disks.values())
    bulk_degC = np.mean([np.nanmean(disk.readings_degC[rows]) for disk in disks])
    setup = disks[0].setup
    return film_heat_share(
        test.load_N,
        test.friction_N,
        test.sliding_speed_m_s,
        test.entraining_speed_m_s,
        fluid("mobil-jet-ii").at(bulk_degC),
        setup.outer_radius_m,
        setup.crown_radius_m,
    )
