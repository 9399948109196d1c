"""Where one test alone places the six junctions of a disk, and how far that is from what rig.toml states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calibration.disk import CHANNELS
from calibration.estimate import Estimate
from tcdyn.partition.sensors.errors import covariance, errors_about
from tcdyn.partition.sensors.faults import AS_WIRED, H_GRID_W_M2K, LOG_H_SD, Verdict
from tcdyn.partition.sensors.features import DiskFeatures
from tcdyn.traces import DiskTraces

DRAWS = 20_000
LEAST_TOLD = 0.02
LEAST_SEEN = 20


@dataclass(frozen=True)
class DepthTest:
    """Six junctions a..f of a disk against their stated depths.

    ``pull`` (6,): departure in standard deviations, standard normal on a sound disk, with correlation ``correlation``
    (6, 6); ``deeper_m``: how much deeper each lies than stated by this test alone, its own stated depth, known to
    ``stated_u_m`` [m], not counted.
    """

    disk: str
    pull: NDArray[np.float64]
    correlation: NDArray[np.float64]
    deeper_m: dict[str, Estimate]
    stated_u_m: float


def depth_test(f: DiskFeatures, disk: DiskTraces, sound: Verdict) -> DepthTest:
    """Score test of each depth about the ``sound`` verdict, all other nuisances and depths at their priors.

    With r the misfit, C its covariance and e the effect of one standard uncertainty of a depth, the pull is
    e C^-1 r / sqrt(e C^-1 e), and of the depth's prior variance the test removes the part t = e C^-1 e; so the test
    alone says (e C^-1 r) / t standard uncertainties, +- sqrt((1 - t) / t).
    """
    h = float(H_GRID_W_M2K[np.argmin(np.abs(np.log(H_GRID_W_M2K / sound.h_W_m2K)))])
    e = errors_about(f, AS_WIRED, h, sound.share)
    seen = f.seen
    off = LOG_H_SD * e.of_log_h()[seen]
    cov = covariance(e, disk) + np.outer(off, off)
    left = (f.level(AS_WIRED) - e.base)[seen]
    sd_m = disk.uncertainty.depth_mm * 1e-3
    effects = np.stack([e.deeper(c)[seen] for c in CHANNELS]) * sd_m
    toward = np.linalg.solve(cov, effects.T).T
    gram = toward @ effects.T
    told = np.clip(np.diag(gram), LEAST_TOLD, 1 - 1e-9)
    score = toward @ left
    root = np.sqrt(np.diag(gram))
    deeper = {
        c: Estimate.normal(sd_m * float(s / t), sd_m * float(np.sqrt((1 - t) / t)))
        for c, s, t in zip(CHANNELS, score, told)
    }
    return DepthTest(disk.name, score / root, gram / np.outer(root, root), deeper, sd_m)


def largest_pulls(tests: Sequence[DepthTest], seed: int = 0) -> NDArray[np.float64]:
    """Draws of the largest pull of all ``tests`` on sound disks, (DRAWS,)."""
    rng = np.random.default_rng(seed)
    largest = np.zeros(DRAWS)
    for test in tests:
        values, vectors = np.linalg.eigh(test.correlation)
        root = vectors * np.sqrt(np.clip(values, 0.0, None))
        largest = np.maximum(largest, np.abs(rng.standard_normal((DRAWS, len(values))) @ root.T).max(axis=1))
    return largest


def chance_of(pull: float, largest: NDArray[np.float64], count: int) -> float:
    """How often the ``largest`` of ``count`` pulls is at least ``pull``; beyond the draws by the normal tail."""
    seen = float(np.mean(largest >= abs(pull)))
    return seen if seen * len(largest) >= LEAST_SEEN else min(1.0, 2.0 * count * float(stats.norm.sf(abs(pull))))
