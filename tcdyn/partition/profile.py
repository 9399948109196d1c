"""Profiles of the joint fits: how much worse the fit becomes as one number is held elsewhere and all others follow.

What is profiled is the posterior: nuisances and the chain's lag and shape stand in it with their priors, linear effects
of the nuisances as at the fit. Where the posterior is normal the profile is the parabola of the stated uncertainty;
where it is not, its 95 % interval, at a deviance of 3.84, is the better one.

A table stands for the rim model, cheap enough for hundreds of fits. The two lags enter as 1/(1 + S s + q S^2 s^2/4)
with S = tau1 + tau2 and q = 4 tau1 tau2/S^2 in [0, 1], smoothly and whichever is the longer, so a Chebyshev table in
log h, log S and q is good to 0.1 mK, at worst 0.7 mK, of 100 K.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calibration import Array
from calibration.disk import DISKS
from calibration.estimate import Z95, Estimate
from calibration.finding import note
from tcdyn.conduction.rim import cardinal, cardinal_slope
from tcdyn.fitting import crossing, least, minimise, profile
from tcdyn.partition.joint import BothFit, DiskFit, told
from tcdyn.partition.posterior import LOG_H, LOG_LAGS, LOG_TAU2, SHARE, Side, joint_problem
from tcdyn.partition.window import POWER, REST

REACH_U = 7.0  # half-width of the table in standard uncertainties,
REACH_FOLD = 8.0  # but no farther than this factor
H_NODES, SHAPE_NODES = 13, 9
SUM_NODES = ((0.4, 5), (1.4, 7), (np.inf, 11))  # up to this width in log S
RANK = 60  # directions of data space that a disk's table spans: what they leave out is below 1e-8 K
OTHER_SHAPES = (0.0, -0.7, 0.7)  # starts of the second lag's logarithm: the posterior may have two valleys in it
ENOUGH = 1e-7
STEP_U, FARTHEST_U = 0.3, 6.0  # in standard uncertainties
TOP = 8.99  # of the deviance: three standard uncertainties of a parabola
LEVEL = Z95**2  # 3.84, the 95 % point of chi-squared with one degree of freedom
NOTICEABLE = 0.2  # of the half-width


@dataclass(frozen=True)
class RimTable:
    """One disk's data and answers (see ``posterior.Answers``) in the few directions that they span.

    Nodes of ``h`` [W/m2K], of the ``lag_sum`` [s] and of the ``shape`` e^q; ``rest`` (H, m), ``power`` (H, S, Q, m).
    """

    h: Array
    lag_sum: Array
    shape: Array
    y: Array
    effect: Array
    rest: Array
    power: Array

    def model(self, p: Array) -> tuple[Array, Array] | None:
        """See ``Answers``; a second lag that would be longer than the sum is all of it."""
        if not (_inside(p[LOG_H], self.h) and _inside(p[LOG_LAGS], self.lag_sum)):
            return None
        ratio = min(float(np.exp(p[LOG_TAU2] - p[LOG_LAGS])), 1.0)
        q = 4 * (1 - ratio) * ratio
        q_slope = 4 * ratio * (1 - 2 * ratio) if ratio < 1 else 0.0  # by log tau2, and the opposite by log S
        (a, da), (b, db), (c, dc) = (
            _weights(n, x) for n, x in ((self.h, p[LOG_H]), (self.lag_sum, p[LOG_LAGS]), (self.shape, q))
        )
        by_lags = np.tensordot(a, self.power, 1)
        by_shape = np.tensordot(b, by_lags, 1)
        power, by_q = c @ by_shape, dc @ by_shape
        by_h = c @ np.tensordot(b, np.tensordot(da, self.power, 1), 1)
        by_sum = c @ np.tensordot(db, by_lags, 1)
        share = p[SHARE]
        slopes = [power, da @ self.rest + share * by_h, share * (by_sum - by_q * q_slope), share * by_q * q_slope]
        return a @ self.rest + share * power, np.stack(slopes, axis=1)


def rim_table(side: Side, points: Sequence[Array], h_u_W_m2K: float, lag_u_s: float) -> RimTable:
    """Run the rim model on all nodes about the ``points`` (4,), as far as the uncertainties of h and lag ask for."""
    nodes_h = _nodes(*_reach([float(np.exp(p[LOG_H])) for p in points], h_u_W_m2K), H_NODES)
    low, high = _reach([float(np.exp(p[LOG_LAGS])) for p in points], lag_u_s)
    nodes_sum = _nodes(low, high, next(count for width, count in SUM_NODES if high - low < width))
    nodes_shape = _nodes(0.0, 1.0, SHAPE_NODES)
    rim, weight = side.window.rim, side.window.weight
    rest = (rim.through(REST, nodes_h) * weight).reshape(H_NODES, -1)
    power = np.empty((H_NODES, len(nodes_sum), SHAPE_NODES, weight.size))
    for i, s in enumerate(nodes_sum):
        for j, q in enumerate(np.log(nodes_shape)):
            ratio = max(0.5 * (1 - np.sqrt(max(1 - q, 0.0))), 1e-9)
            seen = side.heated((float(s * (1 - ratio)), float(s * ratio)))
            power[:, i, j] = (seen.through(POWER, nodes_h) * weight).reshape(H_NODES, -1)
    basis = _span(np.vstack([rest, power.reshape(-1, weight.size)]), np.vstack([side.y, side.effect.T]))
    return RimTable(
        nodes_h, nodes_sum, nodes_shape, side.y @ basis, (side.effect.T @ basis).T, rest @ basis, power @ basis
    )


@dataclass(frozen=True)
class Number:
    """A number to be profiled, ``value`` of the coordinate ``toward`` @ theta and back; it makes sense ``within``."""

    toward: Array
    value: Callable[[float], float] = float
    at: Callable[[float], float] = float
    within: tuple[float, float] = (-np.inf, np.inf)


def disk_numbers(fit: DiskFit) -> dict[str, Number]:
    """beta, h and the common lag of one disk's fit."""
    one, rest, slow = np.eye(4), fit.side.rest_of_lag_s, fit.disk == "slow"

    def of_share(share: float) -> float:
        return 1.0 - share if slow else share

    return {
        "beta": Number(one[SHARE], of_share, of_share, (0.0, 1.0)),
        "h": _logarithm(one[LOG_H]),
        "lag_s": _logarithm(one[LOG_LAGS], rest),
    }


def both_numbers(fit: BothFit) -> dict[str, Number]:
    """beta, both h and the exponent of the fit of both disks."""
    one = np.eye(8)
    return {
        "beta": Number(one[SHARE], within=(0.0, 1.0)),
        "h_fast": _logarithm(one[LOG_H]),
        "h_slow": _logarithm(one[4 + LOG_H]),
        "exponent": Number((one[LOG_H] - one[4 + LOG_H]) / float(np.log(fit.speed_ratio))),
    }


def _logarithm(toward: Array, rest: float = 0.0) -> Number:
    return Number(
        toward, lambda x: float(np.exp(x)) + rest, lambda number: float(np.log(number - rest)), (rest, np.inf)
    )


def joint_profiles(joint: Mapping[str, DiskFit], both: BothFit) -> pd.DataFrame:
    """Profiles of all numbers of the joint fits: fit, parameter, value, deviance, estimate, u.

    ``deviance``: sum of squares above its least, all else refitted [1]. The fits' own windows serve,
    nothing is filtered again.
    """
    together = {d: both.theta[4 * i : 4 * i + 4] for i, d in enumerate(DISKS)}
    tables, found = {}, []
    for d in DISKS:
        fit, e = joint[d], joint[d].estimates
        tables[d] = rim_table(fit.side, [fit.theta, together[d]], e["h"].u, e["lag_s"].u)
        found.append(_profiles(d, [fit.side], [tables[d]], fit.theta, disk_numbers(fit), e, fit.inflation))
    sides = [joint[d].side for d in DISKS]
    ends = both.theta, both_numbers(both), both.estimates, both.inflation
    found.append(_profiles("both", sides, [tables[d] for d in DISKS], *ends))
    return pd.concat(found, ignore_index=True)


def _profiles(
    fit: str,
    sides: Sequence[Side],
    tables: Sequence[RimTable],
    start: Array,
    numbers: Mapping[str, Number],
    estimates: Mapping[str, Estimate],
    inflation: float,
) -> pd.DataFrame:
    """Profiles of one fit. Where slow waves inflate its noise they are scaled to the curvature of its covariance.

    The fits weigh with white noise and answer for the waves in the covariance of what they find, so the sum of squares
    alone is too sure. Scaling it by the ratio of both variances keeps its minimum, the fit, and gives the stated
    covariance when all is normal; weighing anew would move the minimum. Chandler & Bate (2007).
    """
    problem, k = joint_problem(sides, tables), len(start)
    tried = []
    for shift in OTHER_SHAPES:
        theta = np.concatenate([start, np.zeros(problem.size - k)])
        theta[LOG_TAU2:k:4] = np.minimum(theta[LOG_TAU2:k:4] + shift, theta[LOG_LAGS:k:4] - 0.1)
        tried.append(minimise(problem, theta, tolerance=ENOUGH))
    best = least(tried)
    stated, white = (told(best, sides, factor).covariance for factor in (inflation, 1.0))
    frames = []
    for name, n in numbers.items():
        e, toward = estimates[name], np.concatenate([n.toward, np.zeros(problem.size - k)])
        walk = profile(
            best, toward, u=e.u, scale=float(n.toward @ stated @ n.toward / (n.toward @ white @ n.toward)),
            step=STEP_U, drop=TOP, reach=FARTHEST_U, value=n.value, at=n.at, within=n.within, tolerance=ENOUGH,
        )  # fmt: skip
        columns = {"value": walk.value, "deviance": walk.deviance, "estimate": e.value, "u": e.u}
        frames.append(pd.DataFrame({"fit": fit, "parameter": name, **columns}))
    return pd.concat(frames, ignore_index=True)


def _inside(x: float, nodes: Array) -> bool:
    return bool(np.log(nodes[0]) <= x <= np.log(nodes[-1]))


def _reach(values: Sequence[float], u: float) -> tuple[float, float]:
    """Logarithms of the ends of a table about all ``values``."""
    low = min(max(v - REACH_U * u, v / REACH_FOLD) for v in values)
    high = max(min(v + REACH_U * u, v * REACH_FOLD) for v in values)
    return float(np.log(low)), float(np.log(high))


def _nodes(low: float, high: float, count: int) -> Array:
    """Chebyshev nodes in the logarithm, as ``cardinal`` takes them."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    return np.asarray(np.exp(low + (high - low) * (x + 1) / 2))


def _weights(nodes: Array, log_at: float) -> tuple[Array, Array]:
    """Weights of the table's nodes and their derivative by the logarithm."""
    weights = cardinal(nodes, np.array([log_at]))
    return weights[0], cardinal_slope(nodes, weights)[0]


def _span(many: Array, few: Array) -> Array:
    """Orthonormal columns that span the rows of ``few`` exactly and those of ``many`` by random mixing.

    Halko, Martinsson & Tropp, SIAM Review 53 (2011), algorithm 4.1.
    """
    mixed = np.random.default_rng(0).standard_normal((RANK, len(many))) @ many
    return np.asarray(np.linalg.qr(np.vstack([few, mixed]).T)[0])


@dataclass(frozen=True)
class ProfileInterval:
    """The 95 % interval of one number of one joint fit by its profile, beside the normal one of ``estimate``.

    ``fit`` is "fast", "slow" or "both"; ``low95`` or ``high95`` is None where the profile stays below 3.84 as far as
    it was followed, ``low_seen`` to ``high_seen``.
    """

    fit: str
    parameter: str
    estimate: Estimate
    low95: float | None
    high95: float | None
    low_seen: float
    high_seen: float

    @property
    def differs(self) -> bool:
        """Whether an end is missing, or lies elsewhere than the normal one by a fifth of the half-width."""
        if self.low95 is None or self.high95 is None:
            return True
        allowed = NOTICEABLE * Z95 * self.estimate.u
        e = self.estimate
        return max(abs(self.low95 - e.low95), abs(self.high95 - e.high95)) > allowed

    @property
    def sentence(self) -> str:
        """What the reader of the normal interval must know; empty where both intervals agree."""
        if not self.differs:
            return ""
        e = self.estimate
        return note(
            "joint.interval", subject=self.fit, parameter=self.parameter, u=e.u, low95=self.low95, high95=self.high95,
            low_seen=self.low_seen, high_seen=self.high_seen, normal_low95=e.low95, normal_high95=e.high95,
        ).sentence  # fmt: skip


def intervals(table: pd.DataFrame) -> tuple[ProfileInterval, ...]:
    """The 95 % interval of every profile of ``table``."""
    out = []
    for (fit, parameter), own in table.groupby(["fit", "parameter"], sort=False):
        value, deviance = own["value"].to_numpy(), own["deviance"].to_numpy()
        estimate = Estimate.normal(own["estimate"].iloc[0], own["u"].iloc[0])
        low, high = crossing(value[::-1], deviance[::-1]), crossing(value, deviance)
        out.append(ProfileInterval(str(fit), str(parameter), estimate, low, high, float(value[0]), float(value[-1])))
    return tuple(out)


def profiles_file(table: pd.DataFrame) -> dict[str, Any]:
    """Profiles and intervals for ``beta.json``: by fit and number; an end that the data leave open is null."""
    out: dict[str, Any] = {}
    for i in intervals(table):
        own = table[(table["fit"] == i.fit) & (table["parameter"] == i.parameter)]
        out.setdefault(i.fit, {})[i.parameter] = {
            "low95": i.low95,
            "high95": i.high95,
            "differs": i.differs,
            "sentence": i.sentence,
            "value": own["value"].tolist(),
            "deviance": own["deviance"].tolist(),
        }
    return out
