"""Profiles of the joint fits: how much worse the fit becomes as one number is held elsewhere and all others follow.

What is profiled is the posterior: nuisances and the chain's lag and shape stand in it with their priors, linear effects
of the nuisances as at the fit. Where the posterior is normal the profile is the parabola of the stated uncertainty;
where it is not, its 95 % interval, at a deviance of 3.84, is the better one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import DISKS
from calibration.estimate import Estimate
from tcdyn.chain import Chain
from tcdyn.partition.joint import BothFit, DiskFit
from tcdyn.partition.joint_solve import Point
from tcdyn.partition.pinned import (
    LOG_H,
    LOG_SUM,
    LOG_TAU2,
    SHARE,
    JointSurface,
    Surface,
    free_directions,
    joint_surface,
    minimum,
    rest_of_lag_s,
    table_of,
)
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.profile_interval import LEVEL
from tcdyn.partition.profile_interval import intervals as intervals

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]
STEP_U, LEAST_STEP_U, REACH_U, FARTHEST_U = 0.3, 0.05, 3.0, 6.0  # in standard uncertainties
OTHER_SHAPES = (0.0, -0.7, 0.7)  # starts of the second lag's logarithm: the posterior may have two valleys in it


@dataclass(frozen=True)
class Pin:
    """A number to be profiled: ``toward`` @ theta = ``at(value)`` holds it; ``low`` < value < ``high`` makes sense.

    ``per_coordinate``: its change per unit of toward @ theta, at the fit.
    """

    toward: Array
    at: Callable[[float], float]
    value: Callable[[float], float]
    per_coordinate: float
    low: float
    high: float


def joint_profiles(test: EhlTest, joint: Mapping[str, DiskFit], both: BothFit) -> pd.DataFrame:
    """Profiles of all numbers of the joint fits: fit, parameter, value, deviance, gaussian, estimate, u.

    ``deviance``: sum of squares above its least, all else refitted [1]; ``gaussian`` = ((value - estimate)/u)^2. The
    fits' own windows serve, nothing is filtered again.
    """
    shares_h = {"fast": (both.beta, both.h_fast), "slow": (1 - both.beta, both.h_slow)}
    together = {d: _point(*shares_h[d], both.chains[d]) for d in DISKS}
    tables = {}
    found = []
    for d in DISKS:
        fit, e = joint[d], joint[d].estimates
        alone = _point(fit.share, fit.h_W_m2K, fit.chain)
        tables[d] = table_of(test, fit.side, [alone, together[d]], e["h"].u, e["lag_s"].u)
        surface = joint_surface([fit.side], [tables[d]])
        found.append(_all(surface, theta_of(alone), disk_pins(fit), e, fit.inflation, d))
    surface = joint_surface([joint[d].side for d in DISKS], [tables[d] for d in DISKS])
    start = np.concatenate([theta_of(together[d]) for d in DISKS])
    found.append(_all(surface, start, both_pins(both), both.estimates, both.inflation, "both"))
    return pd.concat(found, ignore_index=True)


def profile(
    surface: Surface, start: Array, pin: Pin, estimate: Estimate, inflation: float = 1.0
) -> tuple[Array, Array]:
    """Values and deviances of one number, outward from the least sum of squares, each fit begun at its neighbour's.

    Steps of 0.3 standard uncertainties to three of them, and on to six while the deviance is below 3.84; shorter ones
    before the end of what makes sense or of the surface's table.
    """
    theta, least = start, float(np.sum(_rows(surface, start)[0] ** 2))
    centre = pin.value(float(pin.toward @ theta))
    shrink = _shrink(surface, theta, pin, inflation)
    found = {centre: 0.0}
    for sign in (-1.0, 1.0):
        at, offset, step, deviance = theta, 0.0, STEP_U, 0.0
        while step >= LEAST_STEP_U and (offset < REACH_U - 1e-9 or (deviance < LEVEL and offset < FARTHEST_U - 1e-9)):
            value = centre + sign * (offset + step) * estimate.u
            done = None
            if pin.low < value < pin.high:
                done = minimum(surface, at, pin.toward[None], np.array([pin.at(value)]))
            if done is None:
                step /= 2
                continue
            offset += step
            at, deviance = done[0], (done[1] - least) * shrink
            found[value] = deviance
    values = np.array(sorted(found))
    return values, np.array([found[v] for v in values])


def disk_pins(fit: DiskFit) -> dict[str, Pin]:
    """beta, h and the common lag of one disk's fit."""
    slow = fit.disk == "slow"
    rest = rest_of_lag_s(fit.side)
    one = np.eye(4)

    def of_share(share: float) -> float:
        return 1.0 - share if slow else share

    return {
        "beta": Pin(one[SHARE], of_share, of_share, -1.0 if slow else 1.0, 0.0, 1.0),
        "h": _log_pin(one[LOG_H], fit.h_W_m2K),
        "lag_s": Pin(
            one[LOG_SUM],
            lambda lag: float(np.log(lag - rest)),
            lambda x: float(np.exp(x)) + rest,
            fit.chain.lag_s - rest,
            rest,
            np.inf,
        ),
    }


def both_pins(fit: BothFit) -> dict[str, Pin]:
    """beta, both h and the exponent of the fit of both disks."""
    one = np.eye(8)
    log_ratio = float(np.log(fit.speed_ratio))
    return {
        "beta": Pin(one[SHARE], float, float, 1.0, 0.0, 1.0),
        "h_fast": _log_pin(one[LOG_H], fit.h_fast),
        "h_slow": _log_pin(one[4 + LOG_H], fit.h_slow),
        "exponent": Pin(
            (one[LOG_H] - one[4 + LOG_H]) / log_ratio, float, float, 1.0, -np.inf, np.inf
        ),
    }  # fmt: skip


def _log_pin(toward: Array, value: float) -> Pin:
    return Pin(toward, lambda x: float(np.log(x)), lambda x: float(np.exp(x)), value, 0.0, np.inf)


def _all(
    surface: JointSurface,
    start: Array,
    pins: Mapping[str, Pin],
    estimates: Mapping[str, Estimate],
    inflation: float,
    fit: str,
) -> pd.DataFrame:
    best = _best(surface, start)
    frames = []
    for name, pin in pins.items():
        e = estimates[name]
        value, deviance = profile(surface, best, pin, e, inflation)
        gaussian = ((value - e.value) / e.u) ** 2
        columns = {"value": value, "deviance": deviance, "gaussian": gaussian, "estimate": e.value, "u": e.u}
        frames.append(pd.DataFrame({"fit": fit, "parameter": name, **columns}))
    return pd.concat(frames, ignore_index=True)


def _best(surface: Surface, start: Array) -> Array:
    """Parameters of the least sum of squares from ``start`` and other second lags; ``start`` if it lies outside."""
    nothing = np.zeros((0, len(start))), np.zeros(0)
    tried = []
    for shift in OTHER_SHAPES:
        moved = start.copy()
        moved[LOG_TAU2::4] = np.minimum(moved[LOG_TAU2::4] + shift, moved[LOG_SUM::4] - 0.1)
        done = minimum(surface, moved, *nothing)
        if done is not None:
            tried.append(done)
    return min(tried, key=lambda t: t[1])[0] if tried else start


def _shrink(surface: Surface, theta: Array, pin: Pin, inflation: float) -> float:
    """Factor that makes the profile's curvature that of the stated covariance, where slow waves inflate its noise.

    The fits weigh with white noise and answer for the waves in the covariance of what they find, so the sum of squares
    alone is too sure. Scaling it by the ratio of both variances keeps its minimum, the fit, and gives the stated
    covariance when all is normal; weighing anew would move the minimum. Chandler & Bate (2007).
    """
    jac = _rows(surface, theta)[1]
    free = free_directions(surface.always)
    curve = (jac @ free).T @ (jac @ free)
    along = free.T @ pin.toward
    white = float(along @ np.linalg.solve(curve, along))
    return white / (white + (inflation - 1.0) * surface.noise_part(theta, pin.toward))


def _rows(surface: Surface, theta: Array) -> tuple[Array, Array]:
    done = surface.rows(theta)
    assert done is not None, "the table reaches about its own point"
    return done


def theta_of(p: Point) -> Array:
    """(share, log h, log(tau1 + tau2), log tau2) of a point of the joint fit."""
    total = float(np.log(np.exp(p.log_tau[0]) + np.exp(p.log_tau[1])))
    return np.array([p.share, p.log_h, total, p.log_tau[1]])


def _point(share: float, h_W_m2K: float, chain: Chain) -> Point:
    first, second = np.log(chain.taus_s[:2])
    return Point(share, float(np.log(h_W_m2K)), (float(first), float(second)))
