"""Covariance of identified parameters, and intervals by profile likelihood where the quadratic ones are poor."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from tcdyn.core import Array
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import warning
from tcdyn.estimation import Loss, Optimum, inverse, robust_covariance, sandwich
from tcdyn.estimation import profile as walk
from tcdyn.identify.models import bare, suffix
from tcdyn.identify.problem import Posed
from tcdyn.identify.search import Fit, first_moment
from tcdyn.identify.validate import ALARM, whiteness

Covariance = Literal["auto", "classical", "robust"]


def profiled(found: Fit, everything: bool) -> Fit:
    """``found`` with profile intervals in place of the poor quadratic ones (or of all)."""
    estimates = dict(found.estimates)
    findings = list(found.findings)
    for name in (n for n in found.problem.model.free if everything or poor(found, n)):
        e, inside = profile(found, name)
        estimates[name] = e
        if not inside:
            findings.append(
                warning("fit.open_interval", subject=name, low95=e.low95, high95=e.high95)
            )
    return replace(
        found, identified=replace(found.identified, estimates=estimates, findings=tuple(findings))
    )


def profile(found: Fit, name: str) -> tuple[Estimate, bool]:
    """The estimate of ``name`` with its 95 % profile-likelihood interval, and whether both ends were found.

    The deviance is in units of the reported variance, sandwich and rounding included, against Student's t.
    """
    problem = found.problem
    e = found.innovation
    index = problem.model.free.index(name)
    freedom = problem.n_seen - problem.size
    positive = problem.model.positive(name)
    variance = float(e @ e) / freedom
    u = float(np.sqrt(max(found.covariance_x[index, index], 1e-30)))
    white = variance * found.optimum.covariance[index, index]
    wider = (
        found.covariance_x[index, index] / white
        if found.identified.statistics["robust_covariance"]
        else 1.0
    )
    t = float(stdtrit(freedom, 0.975))
    run = walk(
        found.optimum,
        name,
        u=min(u, 1.5) if positive else u,
        scale=variance * wider,
        level=t**2,
        drop=t**2,
        step=t,
        reach=1e3,
        refine=0.01,
        limit=25,
        tolerance=0.0,
        relative=1e-9,
    )
    ends = [run.value[k] if end is None else end for k, end in ((0, run.low95), (-1, run.high95))]
    low, high = np.exp(ends) if positive else ends
    old = found.estimates[name]
    interval = Estimate(
        value=old.value,
        u=min(old.u, float(high - low) / (2 * Z95)),
        low95=float(low),
        high95=float(high),
    )
    return interval, run.low95 is not None and run.high95 is not None


def poor(found: Fit, name: str) -> bool:
    """Whether the quadratic interval of ``name`` cannot be trusted: wide for its size, or over the edge."""
    e = found.estimates[name]
    model = found.problem.model
    if model.positive(name):
        return e.u > 0.2 * e.value
    twins = [n + suffix(name) for n in ("Tz", "Td")]
    if name in twins and set(twins) <= set(model.free):
        lag = first_moment(found.problem, found.x)
        return (
            abs(found.estimates[twins[0]].value) < 0.1 * lag
        )  # there zero and dead time act alike
    return bare(name) == "Td" and e.low95 < 0


def by_colour(
    e: Array, j: Array, parts: list[slice], dt_s: float, precision: Array, kind: Covariance = "auto"
) -> tuple[Array, bool]:
    """Covariance (P, P) from innovations ``e`` (N,), their slopes ``j`` (N, P) and what was known (P,), and whether it
    is the robust one, which "auto" takes where they are coloured."""
    if kind == "robust" or (kind == "auto" and whiteness(e, j, parts, dt_s, 20).p < ALARM):
        return sandwich(j, e, parts, precision), True
    return float(e @ e) / (len(e) - len(precision)) * inverse(j.T @ j + np.diag(precision)), False


def covariance_of(
    problem: Posed,
    optimum: Optimum,
    residual: Array,
    e: Array,
    j: Array,
    kind: Covariance,
    loss: Loss,
) -> tuple[Array, bool]:
    """Covariance of x from the innovation ``e`` (N,) and its slopes ``j`` (N, size), and whether it is wider than white
    noise alone makes it."""
    cov_x, wider = by_colour(e, j, problem.parts, problem.dt_s, problem.precision, kind)
    if loss != "linear":
        cov_x = robust_covariance(optimum.residual, optimum.jacobian, loss)
    step = problem.rounding_step
    if np.sqrt(np.mean(residual**2)) < step:  # no noise shakes it: equal readings share one error
        edges = [part.start for part in problem.parts]
        new = np.union1d(
            edges, np.flatnonzero(np.abs(np.diff(problem.measured)) > 0.5 * step) + 1
        ).astype(int)
        half = np.add.reduceat(j, new, axis=0) @ inverse(j.T @ j + np.diag(problem.precision))
        cov_x = cov_x + step**2 / 12 * half.T @ half
        wider = True
    return cov_x, wider
