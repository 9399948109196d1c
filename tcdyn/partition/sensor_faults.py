"""Likelihood of sensor faults of a disk, and the depths of the junctions of a sound one.

Each hypothesis is a normal distribution of the residuals of the outer row, predicted by the rim
model from the inner row, and of the inner row's first seconds after an event, predicted by a rim
down to the bore. Its covariance holds the nuisance parameters of the fits; a fault widens the prior
of one of them, or exchanges channels. Hypotheses are compared by their likelihood, which penalises
free parameters as it should. Used by :mod:`tcdyn.partition.sensor_check` and, for the depths, by
:mod:`tcdyn.partition.crosscheck`. Priors are chosen by judgement, model errors are by comparison
with whole-disk solutions. Guarded by ``tests/partition/test_sensors.py`` and
``tests/partition/test_depths.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy import optimize, special
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular

from tcdyn.chain import equalise
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, error, warning
from tcdyn.partition.events import EhlTest
from tcdyn.partition.sensor_window import SHARE_SD, SensorWindow, Sources, sensor_window
from tcdyn.smoothing.traces import DiskTraces

# Points about which the effects are linear: the prior of the share is a mixture about them.
SHARE_GRID = (0.14, 0.32, 0.5, 0.68, 0.86)
LOG_H_SD = 1.0  # standard deviation of log h: practically unknown
# The parameters of a channel whose prior each kind of fault widens, and by which standard deviation
# [m, K, s]. A fault with one such parameter has a size. Chosen by judgement.
EXCHANGED = {"static": 0.7, "lag": 0.06}  # static line and lag are another channel's
WIDENED: dict[str, dict[str, float]] = {
    "none": {},
    "misplaced": {"depth": 1.5e-3},
    "offset": {"static": 5.0},
    "late": {"lag": 0.5},
    "swapped": EXCHANGED,
    "foreign": EXCHANGED,
}
SINGLE_CHANNEL_FAULTS = ("misplaced", "offset", "late")
# Least part of a depth's prior variance that the test is taken to remove: keeps the depth finite.
MIN_INFORMATION = 0.02
LOG_H_STEP = 0.05  # step of the difference quotient by log h; chosen by judgement
# Gains are computed at these h [W/m2K]; responses between them are splines in ln h. More nodes cost
# time only.
H_GRID_W_M2K = np.geomspace(30.0, 3000.0, 14)
H_FINE_W_M2K = np.geomspace(30.0, 3000.0, 131)
MAX_ITERATIONS = 4  # of the search for the nearest node of the coarse grid
MIN_DEPTH_M = 0.3e-3  # least depth of a misplaced junction [m]
# A refined fault has converged when its size changes by less than this [m], [s].
CONVERGED_M = 0.03e-3
CONVERGED_S = 0.02
MAX_REFINEMENTS = 6  # of a depth; chosen by judgement
# Part of a step that is taken after a change of direction. Full steps may alternate about the depth
# of a misplaced junction without an end, because another depth also changes h.
DAMPING = 0.5
# Longest further lag of a late channel [s], and largest reduction of an early one's longest lag,
# relative to it. Chosen by judgement.
MAX_LATE_S = 1.5
MAX_EARLY_REL = 0.9
LATE_STEP_S = 0.1  # step of the second difference by the lag; chosen by judgement


@dataclass(frozen=True)
class FaultFit:
    """The fit of a hypothesis, at its best share and h.

    Parameters
    ----------
    kind
        "none", "swapped", "misplaced", "offset", "late" or "foreign": another disk's channel is
        read in place of this one.
    channels
        The channels concerned.
    log_likelihood, chi2, dof
        Its log likelihood, up to a constant of the data, chi-squared and degrees of freedom.
    share, h_W_m2K
        The best share and heat transfer coefficient.
    size
        How much deeper the junction lies [m], how much it reads too high [K], how late it is [s];
        None without a free parameter.
    """

    kind: str
    channels: tuple[str, ...]
    log_likelihood: float
    chi2: float
    dof: int
    share: float
    h_W_m2K: float
    size: Estimate | None


@dataclass(frozen=True)
class Suspect:
    """A suspected fault.

    Parameters
    ----------
    disk
        The disk; "both" for a swap between the disks, with channels such as "fast_a".
    kind
        "dead", "swapped", "misplaced", "offset", "late" or "unknown".
    channels
        The channels concerned.
    size
        How much deeper the junction lies than its nominal depth [m], how much it reads too high
        [K], or how late it is [s]; None for other kinds.
    log_odds
        Logarithm of the odds against a sound disk.
    numbers
        Further numbers of the message.
    """

    disk: str
    kind: str
    channels: tuple[str, ...] = ()
    size: Estimate | None = None
    log_odds: float = np.inf
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the suspected channels in the log."""
        prefix = "" if self.disk == "both" else f"{self.disk}_"
        return tuple(f"{prefix}{c}_degC" for c in self.channels)

    @property
    def finding(self) -> Finding:
        """The fault as an error for a dead or swapped channel, else as a warning."""
        numbers: dict[str, Any] = {
            "kind": self.kind,
            "channels": self.channels,
            "columns": self.columns,
        }
        if self.kind not in ("dead", "unknown"):
            numbers["log_odds"] = self.log_odds
        if self.size is not None:
            numbers["size"] = self.size.value
            numbers["size_u"] = self.size.u
        numbers |= self.numbers
        severity = error if self.kind in ("dead", "swapped") else warning
        return severity("sensors.suspect", subject=self.disk, **numbers)


def fit_faults(window: SensorWindow) -> list[FaultFit]:
    """The fit of a sound disk, then those of all faults that are considered.

    Parameters
    ----------
    window
        Window of the disk.
    """
    single = [(kind, (c,)) for c in window.used_channels for kind in SINGLE_CHANNEL_FAULTS]
    fits = [fit_fault(window, kind, channels, {}) for kind, channels in (("none", ()), *single)]
    for first, second in combinations(window.used_channels, 2):
        sources = {first: (window, second), second: (window, first)}
        fits.append(fit_fault(window, "swapped", (first, second), sources))
    return fits


def fit_fault(
    window: SensorWindow,
    kind: str,
    channels: tuple[str, ...],
    sources: Sources,
) -> FaultFit:
    """Likelihood of the window under a fault.

    Parameters
    ----------
    window
        Window of the disk.
    kind, channels
        The fault, as of ``FaultFit``.
    sources
        Channels that the fault lets other positions read, as of ``SensorWindow.rewired``.

    Notes
    -----
    The effect of every error grows with the share, so a hypothesis is a mixture of normal
    distributions about each share of ``SHARE_GRID``; the numbers of a fit are those of the
    likeliest. The grid's spacing is 1.5 ``SHARE_SD``, so that the mixture is smooth; change both
    together. Each hypothesis has its own best h of ``H_FINE_W_M2K``.

    The effects are those of the disk as wired: with two channels exchanged they are nearly the
    same.
    """
    levels, rim = window.rewire(sources)
    boundary, power = (
        CubicSpline(np.log(H_GRID_W_M2K), x[:, window.observed])(np.log(H_FINE_W_M2K))
        for x in rim.response(H_GRID_W_M2K)
    )
    without_heat = levels[window.observed] - boundary
    fits = [_fit_about(window, kind, channels, share, without_heat, power) for share in SHARE_GRID]
    best = max(fits, key=lambda fit: fit.log_likelihood)
    total = special.logsumexp([fit.log_likelihood for fit in fits]) - np.log(len(fits))
    return replace(best, log_likelihood=float(total))


def _fit_about(
    window: SensorWindow,
    kind: str,
    channels: tuple[str, ...],
    share: float,
    without_heat: Array,
    power: Array,
) -> FaultFit:
    """The fit of a fault by one component of the mixture.

    Parameters
    ----------
    window, kind, channels
        Window of the disk, and the fault.
    share
        The share about which the component lies.
    without_heat, power
        Residuals for a share of zero, and responses to a share of one, over ``H_FINE_W_M2K``,
        (H, D).

    Notes
    -----
    The covariance is that at the nearest node of ``H_GRID_W_M2K``. A widened parameter of prior
    variance v, whose unit has the effect e, has the posterior mean v e'C^-1 r and variance
    v - v^2 e'C^-1 e.
    """
    widened = {f"{q} {c}": sd for c in channels for q, sd in WIDENED[kind].items()}
    residuals = without_heat - share * power
    best = len(residuals) // 2
    node = -1
    for _ in range(MAX_ITERATIONS):
        nearest = int(np.argmin(np.abs(np.log(H_GRID_W_M2K / H_FINE_W_M2K[best]))))
        if nearest == node:
            break
        node = nearest
        table = window.effects(share, float(H_GRID_W_M2K[node]))
        root = np.linalg.cholesky(table.covariance(widened))
        white = solve_triangular(root, residuals.T, lower=True)
        chi2 = (white**2).sum(axis=0)
        best = int(np.argmin(chi2))
    weighted = solve_triangular(root.T, white[:, best])
    size = None
    if len(widened) == 1:
        ((name, sd),) = widened.items()
        row = table.names.index(name)
        variance = table.u[row] ** 2 + sd**2
        effect = solve_triangular(root, table.change[row], lower=True)
        u = np.sqrt(variance - variance**2 * (effect @ effect))
        size = Estimate.normal(float(variance * table.change[row] @ weighted), float(u))
    return FaultFit(
        kind=kind,
        channels=channels,
        log_likelihood=-0.5 * float(chi2[best]) - float(np.log(np.diag(root)).sum()),
        chi2=float(chi2[best]),
        dof=residuals.shape[1] - 1,
        share=float(np.clip(share + SHARE_SD**2 * power[best] @ weighted, 0.0, 1.0)),
        h_W_m2K=float(H_FINE_W_M2K[best]),
        size=size,
    )


def refine_fault(test: EhlTest, disk: DiskTraces, fit: FaultFit) -> FaultFit:
    """Refine the size of a misplaced junction, or of a late channel, of the outer row.

    A large fault is not linear. Other faults are returned as they are.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    fit
        The linear fit of the fault.

    Notes
    -----
    ``tests/partition/test_sensors.py`` (study) fails if a size is wrong. The likelihood is that
    with the prior of the total size. Faults of the inner row stay linear, all of them: a wrong
    depth of the inner row moves the edge of the rim, and a refined lag next to a linear depth would
    be preferred for its refinement.
    """
    if fit.size is None or fit.channels[0] not in disk.setup.outer:
        return fit
    if fit.kind == "late":
        return _refine_late(test, disk, fit)
    if fit.kind == "misplaced":
        return _refine_depth(test, disk, fit, fit.size)
    return fit


def _refine_depth(test: EhlTest, disk: DiskTraces, fit: FaultFit, step: Estimate) -> FaultFit:
    """Move a misplaced junction to its estimated depth, and fit again until that converges.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    fit, step
        The linear fit, and its shift of depth [m].

    Notes
    -----
    A junction below the inner row is rejected with a likelihood of zero.
    """
    (channel,) = fit.channels
    setup = disk.setup
    junction = setup.junctions[channel]
    low = MIN_DEPTH_M - junction.depth_m
    high = setup.edge_m - MIN_DEPTH_M - junction.depth_m
    shift = 0.0
    part = 1.0
    for _ in range(MAX_REFINEMENTS):
        shift = float(np.clip(shift + part * step.value, low, high))
        moved = replace(junction, depth_m=junction.depth_m + shift)
        junctions = {**setup.junctions, channel: moved}
        corrected = replace(disk, setup=replace(setup, junctions=junctions))
        fit = fit_fault(sensor_window(test, corrected), fit.kind, fit.channels, {})
        last_step = step
        step = fit.size or step
        if step.value * last_step.value < 0:
            part = DAMPING
        size = Estimate.normal(shift + step.value, step.u)
        if abs(step.value) < CONVERGED_M:
            break
    if size.value > high:  # the outer row lies above the inner one
        return replace(fit, size=size, log_likelihood=-np.inf)
    return _with_prior(fit, size)


def _refine_late(test: EhlTest, disk: DiskTraces, linear: FaultFit) -> FaultFit:
    """The likeliest of three forms of a late channel: a further lag, a longer first lag, a delay.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    linear
        The linear fit.

    Notes
    -----
    The linear fit is that of a further first-order lag: with y the readings, it adds s dy/dt to
    them. A bubble in the cement makes the chain's first lag longer, for which the linear fit can be
    seven times too small: at each size the channel is brought to the chain of its record, which
    raises its noise in proportion. A column may also be shifted in time. Without the fault the disk
    counts as sound.
    """
    k = disk.setup.channels.index(linear.channels[0])
    chain = disk.chains[k]
    longest_s = max(chain.taus_s)
    (sd,) = WIDENED["late"].values()
    reach = (-MAX_EARLY_REL * longest_s, MAX_LATE_S)

    def with_channel(y: Array, noise_factor: float) -> FaultFit:
        """The fit of a sound disk with other readings (N,) of the channel."""
        readings = disk.readings_degC.copy()
        readings[:, k] = y
        level_K = disk.noise.level_K.copy()
        level_K[k] *= noise_factor
        changed = replace(disk, readings_degC=readings, noise=replace(disk.noise, level_K=level_K))
        return fit_fault(sensor_window(test, changed), "none", (), {})

    def without_lag(size_s: float) -> FaultFit:
        """The fit with the first lag shorter by a size [s]."""
        later = chain.with_lag_shift(size_s)
        y = equalise(disk.readings_degC[:, [k]], test.dt_s, (later,), chain)[:, 0]
        return with_channel(y, max(1.0 + size_s / longest_s, 1.0))

    def without_delay(size_s: float) -> FaultFit:
        """The fit with the channel earlier by a size [s]."""
        y = np.interp(test.time_s + size_s, test.time_s, disk.readings_degC[:, k])
        return with_channel(y, 1.0)

    forms = [linear]
    for fit_at in (without_lag, without_delay):

        def cost(size_s: float, fit_at: Callable[[float], FaultFit] = fit_at) -> float:
            """Minus the log posterior of the size."""
            return 0.5 * (size_s / sd) ** 2 - fit_at(size_s).log_likelihood

        best = optimize.minimize_scalar(cost, bounds=reach, options={"xatol": CONVERGED_S})
        size_s = float(best.x)
        curvature = cost(size_s + LATE_STEP_S) - 2 * float(best.fun) + cost(size_s - LATE_STEP_S)
        u_s = LATE_STEP_S / float(np.sqrt(max(curvature, (LATE_STEP_S / sd) ** 2)))
        fit = fit_at(size_s)
        evidence = fit.log_likelihood + float(np.log(u_s / sd))
        refined = replace(fit, kind="late", channels=linear.channels, log_likelihood=evidence)
        forms.append(_with_prior(refined, Estimate.normal(size_s, u_s)))
    best_form = max(forms, key=lambda form: form.log_likelihood)
    # each form has a third of the prior probability
    total = special.logsumexp([form.log_likelihood for form in forms]) - np.log(len(forms))
    return replace(best_form, log_likelihood=float(total))


def _with_prior(fit: FaultFit, size: Estimate) -> FaultFit:
    """A refined fit with its total size, and the likelihood with the prior of that size.

    Parameters
    ----------
    fit
        The fit about the refined point.
    size
        Total size, from the nominal value.
    """
    (prior_sd,) = WIDENED[fit.kind].values()
    penalty = 0.5 * (size.value / prior_sd) ** 2
    return replace(fit, size=size, log_likelihood=fit.log_likelihood - penalty)


@dataclass(frozen=True)
class DepthTest:
    """The depths of the junctions of a disk, all or those used, against their nominal depths.

    Parameters
    ----------
    disk
        Name of the disk.
    pull
        Departure of each depth in standard deviations, standard normal on a sound disk, (C,).
    correlation
        Correlation of the pulls, (C, C).
    deeper_m
        How much deeper each junction lies by this test only, without its own nominal depth.
    nominal_u_m
        Standard uncertainty of the nominal depths.
    excluded
        Channels that were excluded.
    """

    disk: str
    pull: Array
    correlation: Array
    deeper_m: dict[str, Estimate]
    nominal_u_m: float
    excluded: tuple[str, ...] = ()


def depth_test(window: SensorWindow, sound: FaultFit) -> DepthTest:
    """Score test of each depth about the fit of a sound disk.

    All other nuisance parameters and depths are at their priors.

    Parameters
    ----------
    window
        Window of the disk.
    sound
        The fit of a sound disk.

    Notes
    -----
    With r the residuals, C their covariance and e the effect of one standard uncertainty of a
    depth, the pull is e C^-1 r / sqrt(e C^-1 e), and of the depth's prior variance the test removes
    the part t = e C^-1 e; so the test gives (e C^-1 r) / t standard uncertainties, +- sqrt((1 - t)
    / t), without the prior.

    h counts as unknown: its effect, ``LOG_H_SD``, is part of C. ``tests/partition/test_depths.py``
    fails if another h is taken for a wrong depth.
    """
    disk = window.disk
    h = float(H_GRID_W_M2K[np.argmin(np.abs(np.log(H_GRID_W_M2K / sound.h_W_m2K)))])
    boundary, power = window.rim.response(h * np.exp([0.0, LOG_H_STEP]))
    predicted, predicted_at_step = (boundary + sound.share * power)[:, window.observed]
    by_h = LOG_H_SD / LOG_H_STEP * (predicted_at_step - predicted)
    table = window.effects(sound.share, h)
    cov = table.covariance({}) + np.outer(by_h, by_h)
    residual = window.levels[window.observed] - predicted
    depth_u_m = disk.uncertainty.depth_mm * 1e-3
    rows = [table.names.index(f"depth {c}") for c in window.used_channels]
    effects = depth_u_m * table.change[rows]
    weighted = np.linalg.solve(cov, effects.T).T
    gram = weighted @ effects.T
    score = weighted @ residual
    information = np.clip(np.diag(gram), MIN_INFORMATION, 1 - 1e-9)
    root = np.sqrt(np.diag(gram))
    deeper_m = {
        c: Estimate.normal(depth_u_m * float(s / t), depth_u_m * float(np.sqrt((1 - t) / t)))
        for c, s, t in zip(window.used_channels, score, information)
    }
    correlation = gram / np.outer(root, root)
    return DepthTest(disk.name, score / root, correlation, deeper_m, depth_u_m, disk.excluded)
