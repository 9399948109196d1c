"""Which fault, if any, explains a disk's readings: swapped, misplaced or offset junctions, or a hotter side.

Each hypothesis is a normal distribution of what is left of the outer row when the rim model, driven by the inner row,
has said its part, and of the inner row's first seconds after an event when a rim down to the bore has. Its covariance
holds what nobody measured, and what the fault makes free. Hypotheses are compared by their likelihood, in which more
freedom costs what it should.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special, stats
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular

from calibration.disk import CHANNELS
from calibration.estimate import Estimate
from tcdyn.partition.sensors.errors import (
    SHARE_SD,
    Array,
    Errors,
    Order,
    covariance,
    errors_about,
    independent_K,
)
from tcdyn.partition.sensors.features import DiskFeatures, Gains
from tcdyn.traces import DiskTraces

AS_WIRED: Order = tuple(range(len(CHANNELS)))
H_GRID_W_M2K = np.geomspace(30.0, 3000.0, 14)  # gains are worked out here, answers between by splines in ln h
H_FINE_W_M2K = np.geomspace(30.0, 3000.0, 131)
ROUNDS = 4
SHARE_GRID = (0.14, 0.32, 0.5, 0.68, 0.86)
LOG_H_SD = 1.0  # h is as good as unknown
MISPLACED_M = 1.5e-3
OFFSET_K = 5.0


@dataclass(frozen=True)
class Fault:
    """A hypothesis: ``kind`` "none", "swapped", "misplaced", "offset", "side" or "foreign", with its channels.

    "foreign": the features hold another disk's channel in the place of this one.
    """

    kind: str
    channels: tuple[str, ...] = ()

    @property
    def order(self) -> Order:
        """Which column reads each position."""
        if self.kind != "swapped":
            return AS_WIRED
        i, j = (CHANNELS.index(c) for c in self.channels)
        order = list(AS_WIRED)
        order[i], order[j] = j, i
        return tuple(order)


@dataclass(frozen=True)
class Verdict:
    """A hypothesis with its log likelihood, chi-square and the number of data, at its best share and h.

    ``size`` is how far the junction is misplaced [m, positive deeper], how much it or the side reads too high [K].
    """

    fault: Fault
    log_likelihood: float
    chi2: float
    dof: int
    share: float
    h_W_m2K: float
    size: Estimate | None

    @property
    def p_value(self) -> float:
        """Chance of so bad a fit were the hypothesis true."""
        return float(stats.chi2.sf(self.chi2, self.dof))


def hypotheses(sides: tuple[tuple[str, ...], ...]) -> Iterator[Fault]:
    """All faults that are looked for; ``sides`` are the groups of channels by angle."""
    for pair in combinations(CHANNELS, 2):
        yield Fault("swapped", pair)
    for channel in CHANNELS:
        yield Fault("misplaced", (channel,))
        yield Fault("offset", (channel,))
    if len(sides) == 2 and min(len(s) for s in sides) > 1:
        yield Fault("side", sides[1])


def judge(f: DiskFeatures, disk: DiskTraces, fault: Fault, gains: list[Gains]) -> Verdict:
    """Likelihood of the features under ``fault``; ``gains`` over ``H_GRID_W_M2K``.

    The effect of every error grows with the share, so a hypothesis is a mixture of normal distributions about each
    share of ``SHARE_GRID``; the verdict's numbers are those of the likeliest.
    """
    order = fault.order
    whole = [f.answer(g, order) for g in gains]
    rests, powers = (_finely(np.stack([answer[i][f.seen] for answer in whole])) for i in range(2))
    parts = [_about(f, disk, fault, share, rests, powers) for share in SHARE_GRID]
    best = max(parts, key=lambda v: v.log_likelihood)
    together = special.logsumexp([v.log_likelihood for v in parts]) - np.log(len(parts))
    return replace(best, log_likelihood=float(together))


def _about(f: DiskFeatures, disk: DiskTraces, fault: Fault, share: float, rests: Array, powers: Array) -> Verdict:
    """The verdict if the share lies about ``share``, from answers (H, D) over ``H_FINE_W_M2K``."""
    order, seen = fault.order, f.seen
    left = f.level(order)[seen] - rests - share * powers
    middle = len(powers) // 2
    best = int(np.argmin(((left / independent_K(f, disk, _whole(f, powers[middle]), order)[seen]) ** 2).sum(axis=1)))
    mixed = fault.channels if fault.kind in ("swapped", "foreign") else ()
    at = -1
    for _ in range(ROUNDS):  # the covariance is worked out at the nearest point of the coarse grid
        nearest = int(np.argmin(np.abs(np.log(H_GRID_W_M2K / H_FINE_W_M2K[best]))))
        if nearest == at:
            break
        at = nearest
        e, cov = _errors(f, disk, order, mixed, float(H_GRID_W_M2K[at]), share)
        sd, effect = _freedom(e, fault)
        if effect is not None:
            cov = cov + np.outer(sd * effect[seen], sd * effect[seen])
        root: Array = np.asarray(np.linalg.cholesky(cov), dtype=float)
        white = solve_triangular(root, left.T, lower=True)
        best = int(np.argmin((white**2).sum(axis=0)))
    r = white[:, best]
    toward = solve_triangular(root, powers[best], lower=True)
    chi2, log_det = float(r @ r), 2 * float(np.log(np.diag(root)).sum())
    size = None
    if effect is not None:
        one_sd = solve_triangular(root, sd * effect[seen], lower=True)
        size = Estimate.normal(sd * float(one_sd @ r), sd * max(1 - float(one_sd @ one_sd), 0.0) ** 0.5)
    likely = float(np.clip(share + SHARE_SD**2 * float(toward @ r), 0.0, 1.0))
    return Verdict(fault, -0.5 * (chi2 + log_det), chi2, r.size - 1, likely, float(H_FINE_W_M2K[best]), size)


def _errors(
    f: DiskFeatures, disk: DiskTraces, order: Order, mixed: tuple[str, ...], h: float, share: float
) -> tuple[Errors, Array]:
    """Errors about a share and an h, and their covariance, which most hypotheses have in common."""
    e = f.remember(("errors", order, h, share), lambda: errors_about(f, order, h, share))
    return e, f.remember(("covariance", order, mixed, h, share), lambda: covariance(e, disk, mixed))


def _whole(f: DiskFeatures, seen: Array) -> Array:
    """Values (D,) put back where they were seen, (W, 6)."""
    out = np.zeros(f.seen.shape)
    out[f.seen] = seen
    return out


def _freedom(e: Errors, fault: Fault) -> tuple[float, Array | None]:
    """Prior standard deviation of what a fault leaves free, and its effect (W, 6) per unit."""
    if fault.kind == "misplaced":
        return MISPLACED_M, e.deeper(fault.channels[0])
    if fault.kind in ("side", "offset"):
        return OFFSET_K, np.asarray(np.sum([e.reading(c, e.steady) for c in fault.channels], axis=0))
    return 0.0, None


def _finely(coarse: Array) -> Array:
    """Answers (H, D) at ``H_GRID_W_M2K`` interpolated to ``H_FINE_W_M2K``."""
    return np.asarray(CubicSpline(np.log(H_GRID_W_M2K), coarse)(np.log(H_FINE_W_M2K)))
