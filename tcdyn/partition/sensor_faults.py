"""Which fault, if any, explains a disk's readings, and where a sound test places the junctions.

Each hypothesis is a normal distribution of what is left of the outer row when the rim model, driven by the inner row,
has said its part, and of the inner row's first seconds after an event when a rim down to the bore has. Its covariance
holds what nobody measured, and what the fault makes free. Hypotheses are compared by their likelihood, in which more
freedom costs what it should.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.partition.disk_features import DiskFeatures, Order, disk_features
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import nominal_parameters, nominal_u
from tcdyn.partition.window import NOMINAL
from tcdyn.smoothing.traces import DiskTraces

SHARE_SD = 0.12  # about each of the shares that are looked at
SWAPPED_LINES_K = 0.7  # swapped channels carry each other's static lines
SWAPPED_LAGS_S = 0.06
LEAST_LAG_U_S = 0.05
LOADING_U_S = 0.5  # how long the load takes to come on is not known
MODEL_REL = 0.005  # of what the frictional heat does: rim against whole disk
INNER_MODEL_REL = (
    0.015  # the same for the inner row, predicted as if the bore did not feel the first seconds
)
MODEL_K = 0.03
MIN_INFORMATION = 0.02
LOG_H_STEP = 0.05
H_GRID_W_M2K = np.geomspace(
    30.0, 3000.0, 14
)  # gains are worked out here, answers between by splines in ln h
H_FINE_W_M2K = np.geomspace(30.0, 3000.0, 131)
MAX_ITERATIONS = 4
SHARE_GRID = (0.14, 0.32, 0.5, 0.68, 0.86)
LOG_H_SD = 1.0  # h is as good as unknown
MISPLACED_M = 1.5e-3
FREE_PARAMETER = {
    "misplaced": ("depth", MISPLACED_M),
    "offset": ("static", 5.0),
    "late": ("lag", 0.5),
}  # m, K, s: sd of each
MIN_DEPTH_M = 0.3e-3
CONVERGED_M = 0.03e-3
CONVERGED_S = 0.01
MAX_LATE_ITERATIONS = 6


@dataclass(frozen=True)
class Fault:
    """A hypothesis: ``kind`` "none", "swapped", "misplaced", "offset", "late" or "foreign", with its channels.

    "foreign": the features hold another disk's channel in the place of this one.
    """

    kind: str
    channels: tuple[str, ...] = ()

    def order(self, channels: Sequence[str]) -> Order:
        """Which column reads each position of a disk with these channels."""
        order = list(range(len(channels)))
        if self.kind == "swapped":
            i, j = map(channels.index, self.channels)
            order[i] = j
            order[j] = i
        return tuple(order)


@dataclass(frozen=True)
class FaultFit:
    """A hypothesis with its log likelihood, chi-square and the number of data, at its best share and h.

    ``size`` is how far the junction is misplaced [m, positive deeper], how much it reads too high [K], how much it is
    late [s].
    """

    fault: Fault
    log_likelihood: float
    chi2: float
    dof: int
    share: float
    h_W_m2K: float
    size: Estimate | None


def hypotheses(channels: Sequence[str], left_out: Sequence[str] = ()) -> Iterator[list[Fault]]:
    """A sound disk, evenly held or not, and all faults that are looked for, by the order of their columns.

    Channels ``left_out`` have no faults.
    """
    used = [c for c in channels if c not in left_out]
    yield [Fault("none"), *(Fault(kind, (c,)) for c in used for kind in FREE_PARAMETER)]
    for pair in combinations(used, 2):
        yield [Fault("swapped", pair)]


def evaluate_faults(f: DiskFeatures, disk: DiskTraces, faults: Sequence[Fault]) -> list[FaultFit]:
    """Likelihood of the features under each of ``faults``, all of one order of the columns.

    The effect of every error grows with the share, so a hypothesis is a mixture of normal distributions about each
    share of ``SHARE_GRID``; the verdict's numbers are those of the likeliest.
    """
    s = f.setup
    logs = np.log(H_GRID_W_M2K)
    order = faults[0].order(s.channels)
    answers = f.response(order, tuple((float(h), NOMINAL) for h in H_GRID_W_M2K))
    rests, powers = (
        np.asarray(CubicSpline(logs, x[:, f.observed])(np.log(H_FINE_W_M2K))) for x in answers
    )
    found = []
    for share in SHARE_GRID:
        left = f.levels[:, order][:, s.places(s.rows)][f.observed] - rests - share * powers
        own = independent_sd_K(f, disk, powers[len(powers) // 2], order)
        start = int(np.argmin(((left / own) ** 2).sum(axis=1)))
        known: dict[
            tuple[int, tuple[str, ...]], _Seen
        ] = {}  # about points of the coarse grid, which most faults share
        found.append(
            [_about(f, disk, fault, share, left, powers, start, known) for fault in faults]
        )
    out = []
    for parts in zip(*found):
        best = max(parts, key=lambda v: v.log_likelihood)
        together = special.logsumexp([v.log_likelihood for v in parts]) - np.log(len(parts))
        out.append(replace(best, log_likelihood=float(together)))
    return out


@dataclass(frozen=True)
class _Seen:
    """What is left about one point, of a disk without free faults: ``effects`` (D, Q) and ``left`` (D, H), both divided
    by the ``root`` (D, D) of its covariance; ``chi2`` (H,), and the covariance's log determinant."""

    root: Array
    effects: Array
    left: Array
    chi2: Array
    log_det: float

    @classmethod
    def of(cls, covariance: Array, effects: Array, left: Array) -> _Seen:
        """Of what is ``left`` (H, D) by its ``covariance`` (D, D) and the ``effects`` (Q, D) about it."""
        root: Array = np.asarray(np.linalg.cholesky(covariance), dtype=float)
        white = solve_triangular(root, np.vstack([effects, left]).T, lower=True)
        by_effect = white[:, : len(effects)]
        by_h = white[:, len(effects) :]
        return cls(
            root, by_effect, by_h, (by_h**2).sum(axis=0), 2 * float(np.log(np.diag(root)).sum())
        )


def _about(
    f: DiskFeatures,
    disk: DiskTraces,
    fault: Fault,
    share: float,
    left: Array,
    powers: Array,
    best: int,
    known: dict[tuple[int, tuple[str, ...]], _Seen],
) -> FaultFit:
    """The verdict if the share lies about ``share``, of what is ``left`` (H, D) over ``H_FINE_W_M2K``.

    What a fault leaves free, e by one standard deviation of it, adds e e' to the covariance C. With e and all else
    divided by the root of C, that lowers chi-squared by (e'r)^2/(1 + e'e) and adds ln(1 + e'e) to the log determinant.
    """
    mixed = fault.channels if fault.kind in ("swapped", "foreign") else ()
    order = fault.order(f.setup.channels)
    stands = [what.name for what in nominal_parameters(f.setup)]
    quantity, sd = FREE_PARAMETER.get(fault.kind, ("", 0.0))
    rows = [stands.index(f"{quantity} {c}") for c in fault.channels] if sd else []
    at = -1
    for _ in range(
        MAX_ITERATIONS
    ):  # the covariance is worked out at the nearest point of the coarse grid
        nearest = int(np.argmin(np.abs(np.log(H_GRID_W_M2K / H_FINE_W_M2K[best]))))
        if nearest == at:
            break
        at = nearest
        if (at, mixed) not in known:
            effects = f.effects(order, float(H_GRID_W_M2K[at]), share)
            known[at, mixed] = _Seen.of(covariance(f, disk, effects, order, mixed), effects, left)
        seen = known[at, mixed]
        free = sd * seen.effects[:, rows].sum(axis=1)
        wider = 1 + float(free @ free)
        toward = free @ seen.left
        best = int(np.argmin(seen.chi2 - toward**2 / wider))
    one_sd = float(toward[best]) / wider
    chi2 = float(seen.chi2[best]) - one_sd * float(toward[best])
    log_det = seen.log_det + float(np.log(wider))
    size = Estimate.normal(sd * one_sd, sd / wider**0.5) if sd else None
    power = solve_triangular(seen.root, powers[best], lower=True)
    likely = float(
        np.clip(share + SHARE_SD**2 * float(power @ (seen.left[:, best] - one_sd * free)), 0.0, 1.0)
    )
    return FaultFit(
        fault,
        -0.5 * (chi2 + log_det),
        chi2,
        left.shape[1] - 1,
        likely,
        float(H_FINE_W_M2K[best]),
        size,
    )


def refine_fault(test: EhlTest, f: DiskFeatures, disk: DiskTraces, v: FaultFit) -> FaultFit:
    """A misplaced junction of the outer row, or a late channel, linearised again where the last look put it, until it
    stays."""
    channel = v.fault.channels[0]
    if v.fault.kind == "late" and v.size is not None:
        return _settled_late(test, disk, v, v.size)
    if v.fault.kind != "misplaced" or channel not in f.setup.outer or v.size is None:
        return v
    setup = f.setup
    at = setup.junctions[channel]
    deepest = setup.edge_m - MIN_DEPTH_M
    size = v.size
    again = v
    for _ in range(4):
        depth = float(np.clip(at.depth_m + size.value, MIN_DEPTH_M, deepest))
        there = {**setup.junctions, channel: replace(at, depth_m=depth)}
        (again,) = evaluate_faults(
            replace(f, setup=replace(setup, junctions=there)), disk, [v.fault]
        )
        if again.size is None:
            break
        size = Estimate.normal(depth - at.depth_m + again.size.value, again.size.u)
        if abs(again.size.value) < CONVERGED_M:
            break
    if size.value + at.depth_m > deepest:  # the outer row lies above the inner one
        return replace(again, size=size, log_likelihood=-np.inf)
    return replace(
        again,
        size=size,
        log_likelihood=again.log_likelihood - 0.5 * (size.value / MISPLACED_M) ** 2,
    )


def _settled_late(test: EhlTest, disk: DiskTraces, v: FaultFit, size: Estimate) -> FaultFit:
    """What is much late is not linear: the column is brought forward in time, and judged again."""
    k = disk.setup.channels.index(v.fault.channels[0])
    again = v
    for _ in range(MAX_LATE_ITERATIONS):
        readings = disk.readings_degC.copy()
        readings[:, k] = np.interp(test.time_s + size.value, test.time_s, readings[:, k])
        moved = replace(disk, readings_degC=readings)
        (again,) = evaluate_faults(disk_features(test, moved), moved, [v.fault])
        if again.size is None:
            break
        size = Estimate.normal(size.value + again.size.value, again.size.u)
        if abs(again.size.value) < CONVERGED_S:
            break
    return replace(
        again,
        size=size,
        log_likelihood=again.log_likelihood - 0.5 * (size.value / FREE_PARAMETER["late"][1]) ** 2,
    )


def covariance(
    f: DiskFeatures, disk: DiskTraces, effects: Array, order: Order, mixed: tuple[str, ...] = ()
) -> Array:
    """Covariance (D, D) [K2] of what is left of the predicted data, by their ``effects`` (see ``DiskFeatures``).

    ``mixed``: channels whose static lines and lags are another's.
    """
    foreign = np.isin(disk.setup.channels, mixed).astype(float)
    static = np.hypot(disk.static_u_K, SWAPPED_LINES_K * foreign)
    u = nominal_u(disk, static, SWAPPED_LAGS_S * foreign)
    common = [1.0, 1.0, max(disk.common_lag_u_s, LEAST_LAG_U_S), LOADING_U_S, SHARE_SD]
    a = np.concatenate([u, np.ones(len(effects) - len(u) - len(common)), common])[:, None] * effects
    return np.asarray(a.T @ a + np.diag(independent_sd_K(f, disk, effects[-1], order) ** 2))


def independent_sd_K(f: DiskFeatures, disk: DiskTraces, power: Array, order: Order) -> Array:
    """Independent part of each datum's standard deviation (D,) [K]: white noise, what the models miss, trends.

    ``power`` (D,): what a share of one makes.
    """
    places = f.setup.places(f.setup.rows)
    noise = f.noise[:, None] * np.maximum(disk.noise_K[list(order)][places], 1e-3)
    rel = np.repeat([MODEL_REL, INNER_MODEL_REL], [len(f.setup.outer), len(f.setup.inner)])
    bend = f.trend_u_K[:, order][:, places] * (rel == INNER_MODEL_REL)  # the outer row follows it
    own = 2 * noise**2 + MODEL_K**2 + bend**2
    return np.sqrt(own[f.observed] + (np.broadcast_to(rel, own.shape)[f.observed] * power) ** 2)


@dataclass(frozen=True)
class DepthTest:
    """The junctions of a disk, all or those used, against their stated depths.

    ``pull`` (C,): departure in standard deviations, standard normal on a sound disk, with correlation ``correlation``
    (C, C); ``deeper_m``: how much deeper each lies than stated by this test alone, its own stated depth, known to
    ``stated_u_m`` [m], not counted.
    """

    disk: str
    pull: Array
    correlation: Array
    deeper_m: dict[str, Estimate]
    stated_u_m: float
    left_out: tuple[str, ...] = ()


def depth_test(f: DiskFeatures, disk: DiskTraces, sound: FaultFit) -> DepthTest:
    """Score test of each depth about the ``sound`` verdict, all other nuisances and depths at their priors.

    With r the misfit, C its covariance and e the effect of one standard uncertainty of a depth, the pull is
    e C^-1 r / sqrt(e C^-1 e), and of the depth's prior variance the test removes the part t = e C^-1 e; so the test
    alone says (e C^-1 r) / t standard uncertainties, +- sqrt((1 - t) / t).
    """
    h = float(H_GRID_W_M2K[np.argmin(np.abs(np.log(H_GRID_W_M2K / sound.h_W_m2K)))])
    at, more = (
        rest + sound.share * power
        for rest, power in zip(
            *f.response(f.as_wired, tuple((x, NOMINAL) for x in (h, h * float(np.exp(LOG_H_STEP)))))
        )
    )
    off = LOG_H_SD / LOG_H_STEP * (more - at)[f.observed]
    known = f.effects(f.as_wired, h, sound.share)
    cov = covariance(f, disk, known, f.as_wired) + np.outer(off, off)
    left = (f.levels[:, f.setup.places(f.setup.rows)] - at)[f.observed]
    sd_m = disk.uncertainty.depth_mm * 1e-3
    used = [c for c in f.setup.channels if c not in disk.left_out]
    stands = [what.name for what in nominal_parameters(f.setup)]
    effects = sd_m * known[[stands.index(f"depth {c}") for c in used]]
    toward = np.linalg.solve(cov, effects.T).T
    gram = toward @ effects.T
    told = np.clip(np.diag(gram), MIN_INFORMATION, 1 - 1e-9)
    score = toward @ left
    root = np.sqrt(np.diag(gram))
    deeper = {
        c: Estimate.normal(sd_m * float(s / t), sd_m * float(np.sqrt((1 - t) / t)))
        for c, s, t in zip(used, score, told)
    }
    return DepthTest(
        disk.name, score / root, gram / np.outer(root, root), deeper, sd_m, disk.left_out
    )
