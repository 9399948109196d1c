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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import info
from tcdyn.estimation import crossing, eliminated, least, minimise, profile
from tcdyn.heat.rim import cardinal, cardinal_slope, log_nodes
from tcdyn.partition.joint import (
    LOG_H,
    LOG_LAGS,
    LOG_TAU2,
    SHARE,
    BothFit,
    DiskFit,
    Side,
    joint_problem,
    told,
)
from tcdyn.partition.window import POWER
from tcdyn.rig.disk import DISKS

REACH_U = 7.0  # half-width of the table in standard uncertainties,
REACH_FACTOR = 8.0  # but no farther than this factor
H_NODES = 13
SHAPE_NODES = 9
SUM_NODES = ((0.4, 5), (1.4, 7), (np.inf, 11))  # up to this width in log S
RANK = 60  # directions of data space that a disk's table spans: what they leave out is below 1e-8 K
SHAPE_STARTS = (
    0.0,
    -0.7,
    0.7,
)  # starts of the second lag's logarithm: the posterior may have two valleys in it
TOLERANCE = 1e-4  # of the sum of squares that a step would still gain; the step is taken, and leaves far less
# in standard uncertainties
STEP_U = 0.3
MAX_DISTANCE_U = 6.0
MAX_DEVIANCE = 8.99  # of the deviance: three standard uncertainties of a parabola
LEVEL = Z95**2  # 3.84, the 95 % point of chi-squared with one degree of freedom
NOTICEABLE = 0.2  # of the half-width


def rim_table(side: Side, points: Sequence[Array], h_u_W_m2K: float, lag_u_s: float) -> Side:
    """The side with a table for its rim model, in the few directions of data space that all of it spans.

    The rim is run on nodes of h [W/m2K], of the lags' sum [s] and of their shape e^q, about the ``points`` (4,) as far
    as the uncertainties of h and lag ask for; beyond them there is no answer.
    """
    nodes_h = log_nodes(*_reach([float(np.exp(p[LOG_H])) for p in points], h_u_W_m2K), H_NODES)
    sums = [float(np.exp(p[LOG_LAGS])) for p in points]
    low, high = _reach(sums, lag_u_s)
    high = min(
        high, float(np.log(max(2 * max(sums), 1 / side.window.rim.rates_1_s[0])))
    )  # what the bank has
    nodes_sum = log_nodes(
        low, high, next(count for width, count in SUM_NODES if high - low < width)
    )
    nodes_shape = log_nodes(0.0, 1.0, SHAPE_NODES)
    weight = side.window.weight
    rest = (
        side.window.rim.input_response(side.window.rim.boundary_inputs, nodes_h) * weight
    ).reshape(H_NODES, -1)
    power = np.empty((H_NODES, len(nodes_sum), SHAPE_NODES, weight.size))
    for i, s in enumerate(nodes_sum):
        for j, q in enumerate(np.log(nodes_shape)):
            ratio = max(0.5 * (1 - np.sqrt(max(1 - q, 0.0))), 1e-9)
            seen = side.rim_with_lags((float(s * (1 - ratio)), float(s * ratio)))
            power[:, i, j] = (seen.input_response(POWER, nodes_h) * weight).reshape(H_NODES, -1)
    # orthonormal columns that span data and effects exactly, and the many answers by random mixing:
    # Halko, Martinsson & Tropp, SIAM Review 53 (2011), algorithm 4.1
    many = np.vstack([rest, power.reshape(-1, weight.size)])
    mixed = np.random.default_rng(0).standard_normal((RANK, len(many))) @ many
    basis = np.linalg.qr(np.vstack([side.y, side.effects.T, mixed]).T)[0]
    rest = rest @ basis
    power = (power @ basis).reshape(H_NODES, -1)
    table = _Table((nodes_h, nodes_sum, nodes_shape), rest, power)
    return replace(side, y=side.y @ basis, effects=(side.effects.T @ basis).T, model=table)


@dataclass(frozen=True)
class _Table:
    """Answers ``rest`` (H, D) and ``power`` (H, S Q D) on ``nodes`` of h, the lags' sum and their shape."""

    nodes: tuple[Array, Array, Array]
    rest: Array
    power: Array

    def __call__(self, p: Array) -> tuple[Array, Array] | None:
        """A second lag that would be longer than the sum is all of it."""
        ratio = min(float(np.exp(p[LOG_TAU2] - p[LOG_LAGS])), 1.0)
        q = 4 * (1 - ratio) * ratio
        q_slope = (
            4 * ratio * (1 - 2 * ratio) if ratio < 1 else 0.0
        )  # by log tau2, and the opposite by log S
        weights = []
        for nodes, x in zip(self.nodes, (p[LOG_H], p[LOG_LAGS], q)):
            if not np.log(nodes[0]) <= x <= np.log(nodes[-1]):
                return None
            at = cardinal(nodes, np.array([x]))
            weights.append(np.concatenate([at, cardinal_slope(nodes, at)]))
        by_h, by_sum, by_q = weights  # at the point, and the slope there
        at_h = (by_h @ self.power).reshape(2, len(self.nodes[1]), -1)
        at_sum = (by_sum @ at_h[0]).reshape(2, SHAPE_NODES, -1)
        seen, seen_q = by_q @ at_sum[0]
        share = p[SHARE]
        seen_h = by_q[0] @ (by_sum[0] @ at_h[1]).reshape(SHAPE_NODES, -1)
        still, still_h = by_h @ self.rest
        by_shape = share * seen_q * q_slope
        slopes = [
            seen,
            still_h + share * seen_h,
            share * (by_q[0] @ at_sum[1]) - by_shape,
            by_shape,
        ]
        return still + share * seen, np.stack(slopes, axis=1)


@dataclass(frozen=True)
class ProfiledNumber:
    """A number to be profiled, ``value`` of the coordinate ``toward`` @ theta and back; it makes sense ``within``."""

    toward: Array
    value: Callable[[float], float] = float
    at: Callable[[float], float] = float
    within: tuple[float, float] = (-np.inf, np.inf)


def _logarithm(toward: Array, rest: float = 0.0) -> ProfiledNumber:
    return ProfiledNumber(
        toward,
        lambda x: float(np.exp(x)) + rest,
        lambda number: float(np.log(number - rest)),
        (rest, np.inf),
    )


def joint_profiles(joint: Mapping[str, DiskFit], both: BothFit) -> pd.DataFrame:
    """Profiles of all numbers of the joint fits: fit, parameter, value, deviance, estimate, u.

    ``deviance``: sum of squares above its least, all else refitted [1]. The fits' own windows serve,
    nothing is filtered again.
    """
    one = np.eye(8)

    def alone(d: str) -> tuple[pd.DataFrame, dict[str, Any]]:
        fit = joint[d]
        e = joint[d].estimates
        together = both.theta[:4] if d == DISKS[0] else both.theta[4:]
        table = rim_table(fit.side, [fit.theta, together], e["h"].u, e["lag_s"].u)
        turn = float if d == "fast" else (lambda share: 1.0 - share)
        numbers = {
            "beta": ProfiledNumber(one[SHARE, :4], turn, turn, (0.0, 1.0)),
            "h": _logarithm(one[LOG_H, :4]),
            "lag_s": _logarithm(one[LOG_LAGS, :4], fit.side.rest_of_lag_s),
        }
        found = _profiles(d, [table], fit.theta, numbers, e, fit.inflation)
        return found, {"y": table.y, "effect": table.effects, "model": table.model}

    found, tables = zip(*(alone(d) for d in DISKS))
    h_fast = one[LOG_H]
    h_slow = one[4 + LOG_H]
    numbers = {
        "beta": ProfiledNumber(one[SHARE], within=(0.0, 1.0)),
        "h_fast": _logarithm(h_fast),
        "h_slow": _logarithm(h_slow),
        "exponent": ProfiledNumber((h_fast - h_slow) / float(np.log(both.speed_ratio))),
    }
    sides = [replace(joint[d].side, **table) for d, table in zip(DISKS, tables)]
    whole = _profiles("both", sides, both.theta, numbers, both.estimates, both.inflation)
    return pd.concat([*found, whole], ignore_index=True)


def _profiles(
    fit: str,
    sides: Sequence[Side],
    start: Array,
    numbers: Mapping[str, ProfiledNumber],
    estimates: Mapping[str, Estimate],
    inflation: float,
) -> pd.DataFrame:
    """Profiles of one fit. Where slow waves inflate its noise they are scaled to the curvature of its covariance.

    The fits weigh with white noise and answer for the waves in the covariance of what they find, so the sum of squares
    alone is too sure. Scaling it by the ratio of both variances keeps its minimum, the fit, and gives the stated
    covariance when all is normal; weighing anew would move the minimum. Chandler & Bate (2007).
    """
    problem = joint_problem(sides)
    k = len(start)
    few = eliminated(problem, k, np.concatenate([start, np.zeros(problem.size - k)]))
    tried = []
    for shift in SHAPE_STARTS:
        theta = start.copy()
        theta[LOG_TAU2::4] = np.minimum(theta[LOG_TAU2::4] + shift, theta[LOG_LAGS::4] - 0.1)
        tried.append(minimise(few, theta, tolerance=TOLERANCE))
    best = least(tried)
    whole = minimise(
        problem, np.concatenate([best.theta, np.zeros(problem.size - k)]), tolerance=TOLERANCE
    )
    noise, per_sd = told(whole, sides)

    def walked(name: str) -> pd.DataFrame:
        n = numbers[name]
        e = estimates[name]
        white = n.toward @ noise @ n.toward
        other = np.sum((n.toward @ per_sd) ** 2)
        walk = profile(
            best,
            n.toward,
            u=e.u,
            scale=float((inflation * white + other) / (white + other)),
            step=STEP_U,
            drop=MAX_DEVIANCE,
            reach=MAX_DISTANCE_U,
            value=n.value,
            at=n.at,
            within=n.within,
            tolerance=TOLERANCE,
        )
        columns = {"value": walk.value, "deviance": walk.deviance, "estimate": e.value, "u": e.u}
        return pd.DataFrame({"fit": fit, "parameter": name, **columns})

    return pd.concat([walked(name) for name in numbers], ignore_index=True)


def _reach(values: Sequence[float], u: float) -> tuple[float, float]:
    """Logarithms of the ends of a table about all ``values``."""
    low = min(max(v - REACH_U * u, v / REACH_FACTOR) for v in values)
    high = max(min(v + REACH_U * u, v * REACH_FACTOR) for v in values)
    return float(np.log(low)), float(np.log(high))


@dataclass(frozen=True)
class ProfileInterval:
    """The 95 % interval of one number of one joint fit by its profile, beside the normal one of ``estimate``.

    ``fit`` is "fast", "slow" or "both"; ``low95`` or ``high95`` is None where the profile stays below 3.84 as far as
    it was followed, ``low_seen`` to ``high_seen``. ``differs``: whether an end is missing, or lies elsewhere than the
    normal one by a fifth of the half-width; ``sentence`` then tells the reader of the normal interval, else it is "".
    """

    fit: str
    parameter: str
    estimate: Estimate
    low95: float | None
    high95: float | None
    low_seen: float
    high_seen: float
    differs: bool
    sentence: str


def intervals(table: pd.DataFrame) -> tuple[ProfileInterval, ...]:
    """The 95 % interval of every profile of ``table``."""
    out = []
    for (fit, parameter), own in table.groupby(["fit", "parameter"], sort=False):
        value = own["value"].to_numpy()
        deviance = own["deviance"].to_numpy()
        e = Estimate.normal(own["estimate"].iloc[0], own["u"].iloc[0])
        low = crossing(value[::-1], deviance[::-1])
        high = crossing(value, deviance)
        first = float(value[0])
        last = float(value[-1])
        off = [
            np.inf if end is None else abs(end - normal)
            for end, normal in ((low, e.low95), (high, e.high95))
        ]
        differs = max(off) > NOTICEABLE * Z95 * e.u
        said = info(
            "joint.interval",
            subject=str(fit),
            parameter=parameter,
            u=e.u,
            low95=low,
            high95=high,
            normal_low95=e.low95,
            normal_high95=e.high95,
            low_seen=first,
            high_seen=last,
        )
        sentence = said.sentence if differs else ""
        out.append(
            ProfileInterval(str(fit), str(parameter), e, low, high, first, last, differs, sentence)
        )
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
