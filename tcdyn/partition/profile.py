"""Profiles of the joint fits: deviance with one number fixed and all others refitted.

What is profiled is the posterior: nuisance parameters and the chain's lag and shape have their
priors, with linear effects of the nuisance parameters as at the fit. Where the posterior is normal,
the profile is the parabola of the stated uncertainty; where it is not, its 95 % interval, at a
deviance of 3.84, is the better one.

A table replaces the rim model, cheap enough for hundreds of fits. The two lags enter as 1/(1 + S s
+ q S^2 s^2/4) with S = tau1 + tau2 and q = 4 tau1 tau2/S^2 in [0, 1], smoothly and whichever is the
longer, so a Chebyshev table in log h, log S and q is accurate to 0.1 mK, at worst 0.7 mK, of 100 K.

Used by :mod:`tcdyn.partition.analyse`, :mod:`tcdyn.workflows.beta_tables` and
:mod:`tcdyn.plots.transient`. Guarded by ``tests/partition/test_profile.py``.
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
from tcdyn.estimation import eliminate_linear, first_crossing, lowest_cost, minimise, profile
from tcdyn.heat.rim import lag_weights, lag_weights_slope, log_nodes
from tcdyn.partition.joint import (
    LOG_H,
    LOG_LAGS,
    LOG_TAU2,
    SHARE,
    CombinedFit,
    DiskBlock,
    DiskFit,
    joint_problem,
    main_covariance,
)
from tcdyn.partition.window import POWER
from tcdyn.rig.disk import DISKS

# Half-width of the table in standard uncertainties, but at most this factor. A profile reaches
# ``MAX_DISTANCE_U``; the rest is a margin. Chosen by judgement.
REACH_U = 7.0
REACH_FACTOR = 8.0
# Numbers of nodes: of h, of the shape q, and of the sum S by the width of the table in log S.
H_NODES = 13
SHAPE_NODES = 9
SUM_NODES = ((0.4, 5), (1.4, 7), (np.inf, 11))
RANK = 60  # directions of data space that a disk's table spans: the rest is below 1e-8 K
MIN_LAG_RATIO = 1e-9  # least second lag relative to the sum: keeps it above zero
# Starts of the second lag's logarithm, relative to the fit: there may be two minima in it.
SHAPE_STARTS = (0.0, -0.7, 0.7)
# A search stops when a step would lower the sum of squares by less than this. That step is
# taken, and leaves far less.
TOLERANCE = 1e-4
# Chosen by judgement.
STEP_U = 0.3  # step of a profile in standard uncertainties
MAX_DISTANCE_U = 6.0  # farthest point of a profile in standard uncertainties
MAX_DEVIANCE = 8.99  # a profile ends there: three standard uncertainties of a parabola
DEVIANCE_95 = Z95**2  # 3.84, the 95 % point of chi-squared with one degree of freedom
# The interval differs from the normal one if an end differs by this part of the half-width. Chosen
# by judgement.
NOTICEABLE = 0.2


def rim_table(
    block: DiskBlock, points: Sequence[Array], h_u_W_m2K: float, lag_u_s: float
) -> DiskBlock:
    """Replace the rim model of a disk by a table, in the directions of data space that it spans.

    Parameters
    ----------
    block
        The disk.
    points
        Parameters (4,) about which the table is made.
    h_u_W_m2K, lag_u_s
        Standard uncertainties of h and lag, for its extent.

    Returns
    -------
    DiskBlock
        ``y`` (D,), ``effects`` (D, Q) and ``model`` projected on D orthonormal directions.

    Notes
    -----
    The rim is run on nodes of h [W/m2K], of the lags' sum [s] and of their shape e^q; the table has
    no value beyond them. The basis consists of orthonormal columns that span data and effects
    exactly, and the many responses by random mixing: Halko, Martinsson & Tropp, SIAM Review 53
    (2011), algorithm 4.1.

    More nodes or a larger ``RANK`` cost time only. Fewer make the table wrong:
    ``tests/partition/test_profile.py`` (study) requires sums of squares within 0.01 of the rim
    model's.
    """
    rim = block.window.rim
    weight = block.window.weight
    nodes_h = log_nodes(*_log_range([float(np.exp(p[LOG_H])) for p in points], h_u_W_m2K), H_NODES)
    sums = [float(np.exp(p[LOG_LAGS])) for p in points]
    low, high = _log_range(sums, lag_u_s)
    longest_s = max(2 * max(sums), 1 / rim.rates_1_s[0])  # that the filter bank holds
    high = min(high, float(np.log(longest_s)))
    n_sums = next(count for width, count in SUM_NODES if high - low < width)
    nodes_sum = log_nodes(low, high, n_sums)
    nodes_shape = log_nodes(0.0, 1.0, SHAPE_NODES)
    boundary = rim.input_response(rim.boundary_inputs, nodes_h) * weight
    boundary = boundary.reshape(H_NODES, -1)
    power = np.empty((H_NODES, n_sums, SHAPE_NODES, weight.size))
    for i, s in enumerate(nodes_sum):
        for j, q in enumerate(np.log(nodes_shape)):
            ratio = max(0.5 * (1 - np.sqrt(max(1 - q, 0.0))), MIN_LAG_RATIO)
            lagged = block.rim_with_lags((float(s * (1 - ratio)), float(s * ratio)))
            response = lagged.input_response(POWER, nodes_h) * weight
            power[:, i, j] = response.reshape(H_NODES, -1)
    responses = np.vstack([boundary, power.reshape(-1, weight.size)])
    mixed = np.random.default_rng(0).standard_normal((RANK, len(responses))) @ responses
    basis = np.linalg.qr(np.vstack([block.y, block.effects.T, mixed]).T)[0]
    table = _Table(
        nodes=(nodes_h, nodes_sum, nodes_shape),
        boundary=boundary @ basis,
        power=(power @ basis).reshape(H_NODES, -1),
    )
    return replace(block, y=block.y @ basis, effects=(block.effects.T @ basis).T, model=table)


@dataclass(frozen=True)
class _Table:
    """Responses on nodes of h, the lags' sum and their shape, in D directions of data space.

    Parameters
    ----------
    nodes
        Nodes of h [W/m2K], of the sum S [s], and of e^q.
    boundary
        Response without heat, (H, D).
    power
        Response to a share of one, (H, S Q D) with the sum, then the shape, then the direction.
    """

    nodes: tuple[Array, Array, Array]
    boundary: Array
    power: Array

    def __call__(self, p: Array) -> tuple[Array, Array] | None:
        """Prediction (D,) and derivatives (D, 4) at the parameters ``p``; None outside the table.

        Parameters
        ----------
        p
            ``tcdyn.partition.nuisance.PARAMETERS`` of the disk, (4,). A second lag above the sum
            counts as the sum.

        Notes
        -----
        The same interface as ``tcdyn.partition.nuisance.LaggedRim``;
        ``tests/partition/test_profile.py`` compares its derivatives with differences.
        """
        ratio = min(float(np.exp(p[LOG_TAU2] - p[LOG_LAGS])), 1.0)
        q = 4 * (1 - ratio) * ratio
        # by log tau2; the opposite by log S
        q_slope = 4 * ratio * (1 - 2 * ratio) if ratio < 1 else 0.0
        weights = []
        for nodes, x in zip(self.nodes, (p[LOG_H], p[LOG_LAGS], q)):
            if not np.log(nodes[0]) <= x <= np.log(nodes[-1]):
                return None
            value = lag_weights(nodes, np.array([x]))
            weights.append(np.concatenate([value, lag_weights_slope(nodes, value)]))
        # rows: value, slope
        by_h, by_sum, by_q = weights
        n_sums = len(self.nodes[1])
        at_h = (by_h @ self.power).reshape(2, n_sums, -1)
        at_sum = (by_sum @ at_h[0]).reshape(2, SHAPE_NODES, -1)
        power, power_by_q = by_q @ at_sum[0]
        power_by_sum = by_q[0] @ at_sum[1]
        power_by_h = by_q[0] @ (by_sum[0] @ at_h[1]).reshape(SHAPE_NODES, -1)
        boundary, boundary_by_h = by_h @ self.boundary
        share = p[SHARE]
        by_log_tau2 = share * power_by_q * q_slope
        derivatives = [
            power,
            boundary_by_h + share * power_by_h,
            share * power_by_sum - by_log_tau2,
            by_log_tau2,
        ]
        return boundary + share * power, np.stack(derivatives, axis=1)


@dataclass(frozen=True)
class ProfiledNumber:
    """A number to be profiled.

    Parameters
    ----------
    toward
        Its coordinate is ``toward`` @ theta, (P,).
    value, at
        Number of a coordinate, and coordinate of a number; inverse to each other.
    within
        Range in which the number makes sense.
    """

    toward: Array
    value: Callable[[float], float] = float
    at: Callable[[float], float] = float
    within: tuple[float, float] = (-np.inf, np.inf)


def _exponential_number(toward: Array, offset: float = 0.0) -> ProfiledNumber:
    """The number exp(coordinate) + offset.

    Parameters
    ----------
    toward
        Direction of the coordinate.
    offset
        Added to the exponential, for example the lag of the chain that the fit leaves as it is [s].
    """
    return ProfiledNumber(
        toward,
        lambda x: float(np.exp(x)) + offset,
        lambda number: float(np.log(number - offset)),
        (offset, np.inf),
    )


def joint_profiles(joint: Mapping[str, DiskFit], combined: CombinedFit) -> pd.DataFrame:
    """Profiles of all numbers of the joint fits.

    Parameters
    ----------
    joint
        Joint fit of each disk.
    combined
        Joint fit of all disks.

    Returns
    -------
    table
        Columns fit, parameter, value, deviance, estimate, u. ``deviance`` is the sum of squares
        above its least value, all else refitted [1]. The fits' own windows are used; no log is
        filtered again.

    Notes
    -----
    One table of each disk serves its own fit and the fit of both, so it is made about both. To
    profile another number, add it to ``numbers``, with an estimate of the same key.
    """
    unit = np.eye(8)
    tables = {}
    profiles = []
    for k, (d, fit) in enumerate(joint.items()):
        e = fit.estimates
        points = [fit.theta, combined.theta[4 * k : 4 * k + 4]]
        tables[d] = rim_table(fit.block, points, e["h"].u, e["lag_s"].u)
        beta_of_share = float if d == "fast" else _complement
        numbers = {
            "beta": ProfiledNumber(unit[SHARE, :4], beta_of_share, beta_of_share, (0.0, 1.0)),
            "h": _exponential_number(unit[LOG_H, :4]),
            "lag_s": _exponential_number(unit[LOG_LAGS, :4], fit.block.remaining_lag_s),
        }
        profiles.append(_profiles(d, [tables[d]], fit.theta, numbers, e, fit.inflation))
    if len(joint) == len(DISKS):
        h_fast = unit[LOG_H]
        h_slow = unit[4 + LOG_H]
        log_ratio = float(np.log(combined.speed_ratio))
        numbers = {
            "beta": ProfiledNumber(unit[SHARE], within=(0.0, 1.0)),
            "h_fast": _exponential_number(h_fast),
            "h_slow": _exponential_number(h_slow),
            "exponent": ProfiledNumber((h_fast - h_slow) / log_ratio),
        }
        profiles.append(
            _profiles(
                "both",
                [tables[d] for d in DISKS],
                combined.theta,
                numbers,
                combined.estimates,
                combined.inflation,
            )
        )
    return pd.concat(profiles, ignore_index=True)


def _complement(share: float) -> float:
    """beta of the fast disk by the share of the slow disk, and the inverse."""
    return 1.0 - share


def _profiles(
    fit: str,
    disk_blocks: Sequence[DiskBlock],
    start: Array,
    numbers: Mapping[str, ProfiledNumber],
    estimates: Mapping[str, Estimate],
    inflation: float,
) -> pd.DataFrame:
    """Profiles of one fit.

    Where slow waves inflate its noise, they are scaled to the curvature of its covariance.

    Parameters
    ----------
    fit
        "fast", "slow" or "both".
    disk_blocks
        The disks, with tables as their models.
    start
        The fitted parameters, (4,) or (8,).
    numbers
        The numbers to profile.
    estimates
        Estimates of the numbers by the fit.
    inflation
        Variance ratio of slow waves in the residuals to white noise.

    Notes
    -----
    The fits weight with white noise and allow for the waves in the covariance of the estimates, so
    the sum of squares is too optimistic. Scaling it by the ratio of both variances keeps its
    minimum, the fit, and gives the stated covariance when all is normal; new weights would move the
    minimum. Chandler & Bate (2007). ``tests/partition/test_profile.py`` (study) tests both.
    """
    problem = joint_problem(disk_blocks)
    k = len(start)
    nuisance_start = np.zeros(problem.size - k)
    reduced = eliminate_linear(problem, k, np.concatenate([start, nuisance_start]))
    optima = []
    for shift in SHAPE_STARTS:
        theta = start.copy()
        theta[LOG_TAU2::4] = np.minimum(theta[LOG_TAU2::4] + shift, theta[LOG_LAGS::4] - 0.1)
        optima.append(minimise(reduced, theta, tolerance=TOLERANCE))
    best = lowest_cost(optima)
    full_start = np.concatenate([best.theta, nuisance_start])
    full = minimise(problem, full_start, tolerance=TOLERANCE)
    noise, sensitivity = main_covariance(full, disk_blocks)

    def profile_of(name: str) -> pd.DataFrame:
        """Rows of the table for one number."""
        number = numbers[name]
        estimate = estimates[name]
        white = number.toward @ noise @ number.toward
        other = np.sum((number.toward @ sensitivity) ** 2)
        curve = profile(
            best,
            number.toward,
            u=estimate.u,
            scale=float((inflation * white + other) / (white + other)),
            step=STEP_U,
            max_deviance=MAX_DEVIANCE,
            max_distance=MAX_DISTANCE_U,
            value=number.value,
            at=number.at,
            bounds=number.within,
            tolerance=TOLERANCE,
        )
        return pd.DataFrame(
            {
                "fit": fit,
                "parameter": name,
                "value": curve.value,
                "deviance": curve.deviance,
                "estimate": estimate.value,
                "u": estimate.u,
            }
        )

    return pd.concat([profile_of(name) for name in numbers], ignore_index=True)


def _log_range(values: Sequence[float], u: float) -> tuple[float, float]:
    """Logarithms of the ends of a table about all values.

    Parameters
    ----------
    values
        Values that the table must hold.
    u
        Their standard uncertainty.

    Returns
    -------
    low, high
        ``REACH_U`` standard uncertainties beyond the values, at most the factor ``REACH_FACTOR``.
    """
    low = min(max(v - REACH_U * u, v / REACH_FACTOR) for v in values)
    high = max(min(v + REACH_U * u, v * REACH_FACTOR) for v in values)
    return float(np.log(low)), float(np.log(high))


@dataclass(frozen=True)
class ProfileInterval:
    """The 95 % interval of one number of one joint fit by its profile.

    Parameters
    ----------
    fit
        "fast", "slow" or "both".
    parameter
        The number.
    estimate
        Its estimate with the normal interval.
    low95, high95
        Ends by the profile; None where it stays below 3.84 as far as it was followed.
    profile_low, profile_high
        Ends of the profile.
    differs
        Whether an end is missing, or differs from the normal one by a fifth of the half-width.
    sentence
        The message if it differs, else "".
    """

    fit: str
    parameter: str
    estimate: Estimate
    low95: float | None
    high95: float | None
    profile_low: float
    profile_high: float
    differs: bool
    sentence: str


def intervals(table: pd.DataFrame) -> tuple[ProfileInterval, ...]:
    """The 95 % interval of every profile of a table.

    Parameters
    ----------
    table
        Result of :func:`joint_profiles`; each profile must be ascending in its value.

    Notes
    -----
    ``NOTICEABLE`` decides only which intervals are reported; ``tests/partition/test_profile.py``
    expects no message from a sound test.
    """
    out = []
    for (fit, parameter), rows in table.groupby(["fit", "parameter"], sort=False):
        value = rows["value"].to_numpy()
        deviance = rows["deviance"].to_numpy()
        estimate = Estimate.normal(rows["estimate"].iloc[0], rows["u"].iloc[0])
        low = first_crossing(value[::-1], deviance[::-1])
        high = first_crossing(value, deviance)
        first = float(value[0])
        last = float(value[-1])
        differences = [
            np.inf if end is None else abs(end - normal)
            for end, normal in ((low, estimate.low95), (high, estimate.high95))
        ]
        differs = max(differences) > NOTICEABLE * Z95 * estimate.u
        finding = info(
            "joint.interval",
            subject=str(fit),
            parameter=parameter,
            u=estimate.u,
            low95=low,
            high95=high,
            normal_low95=estimate.low95,
            normal_high95=estimate.high95,
            low_seen=first,
            high_seen=last,
        )
        interval = ProfileInterval(
            fit=str(fit),
            parameter=str(parameter),
            estimate=estimate,
            low95=low,
            high95=high,
            profile_low=first,
            profile_high=last,
            differs=differs,
            sentence=finding.sentence if differs else "",
        )
        out.append(interval)
    return tuple(out)


def profiles_file(table: pd.DataFrame) -> dict[str, Any]:
    """Profiles and intervals for ``beta.json``, by fit and number; an open end is null."""
    out: dict[str, Any] = {}
    for interval in intervals(table):
        of_fit = table["fit"] == interval.fit
        rows = table[of_fit & (table["parameter"] == interval.parameter)]
        out.setdefault(interval.fit, {})[interval.parameter] = {
            "low95": interval.low95,
            "high95": interval.high95,
            "differs": interval.differs,
            "sentence": interval.sentence,
            "value": rows["value"].tolist(),
            "deviance": rows["deviance"].tolist(),
        }
    return out
