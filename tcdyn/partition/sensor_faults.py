"""Likelihood of sensor faults of a disk, and the depths of the junctions of a sound one.

Each hypothesis is a normal distribution of the residuals of the outer row, predicted by the rim
model from the inner row, and of the inner row's first seconds after an event, predicted by a rim
down to the bore. Its covariance holds the nuisance parameters and the free parameter of the fault.
Hypotheses are compared by their likelihood, which penalises free parameters as it should. Used by
:mod:`tcdyn.partition.sensor_check` and, for the depths, by :mod:`tcdyn.partition.crosscheck`.
Priors are chosen by judgement, model errors are by comparison with whole-disk solutions. Guarded by
``tests/partition/test_sensors.py`` and ``tests/partition/test_depths.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import optimize, special
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular

from tcdyn.chain import equalise
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.partition.disk_features import DiskFeatures, Order, disk_features
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import nominal_parameters, nominal_u
from tcdyn.partition.window import NOMINAL
from tcdyn.smoothing.traces import DiskTraces

# Priors, chosen by judgement.
SHARE_SD = 0.12  # standard deviation of the share about each of ``SHARE_GRID``
SHARE_GRID = (0.14, 0.32, 0.5, 0.68, 0.86)
LOG_H_SD = 1.0  # standard deviation of log h: practically unknown
# Standard uncertainties of static line [K] and lag [s] where they are another channel's.
SWAPPED_LINES_K = 0.7
SWAPPED_LAGS_S = 0.06
LEAST_LAG_U_S = 0.05  # least standard uncertainty of the common lag [s]
LOADING_U_S = 0.5  # standard uncertainty of the duration of loading, which is not known [s]
# Standard uncertainty of the model relative to the effect of the frictional heat: rim against whole
# disk, and the same for the inner row, predicted as if the bore did not feel the first seconds.
MODEL_REL = 0.005
INNER_MODEL_REL = 0.015
MODEL_K = 0.03  # the same, constant, by comparison with whole-disk solutions [K]
MISPLACED_M = 1.5e-3  # prior standard deviation of the depth of a misplaced junction [m]
# Free parameter of each kind of fault, and its prior standard deviation [m, K, s].
FREE_PARAMETER = {
    "misplaced": ("depth", MISPLACED_M),
    "offset": ("static", 5.0),
    "late": ("lag", 0.5),
}
# Least part of a depth's prior variance that the test is taken to remove: keeps the depth finite.
MIN_INFORMATION = 0.02
LOG_H_STEP = 0.05  # step of the difference quotient by log h; chosen by judgement
# Gains are computed at these h [W/m2K]; responses between them are splines in ln h. More nodes cost
# time only.
H_GRID_W_M2K = np.geomspace(30.0, 3000.0, 14)
H_FINE_W_M2K = np.geomspace(30.0, 3000.0, 131)
MAX_ITERATIONS = 4  # of the search for the nearest node of the coarse grid
MIN_DEPTH_M = 0.3e-3  # least depth of a misplaced junction [m]
# A refined fault has converged when its size changes by less than this.
CONVERGED_M = 0.03e-3
CONVERGED_S = 0.02
# Most iterations of a refinement of a depth. Chosen by judgement.
MAX_DEPTH_ITERATIONS = 4
# Longest further lag of a late channel [s], and largest reduction of an early one's longest lag,
# relative to it. Chosen by judgement.
MAX_LATE_S = 1.5
MAX_EARLY_REL = 0.9
LATE_STEP_S = 0.1  # step of the second difference by the lag; chosen by judgement


@dataclass(frozen=True)
class Fault:
    """A hypothesis: a kind of fault and its channels.

    Parameters
    ----------
    kind
        "none", "swapped", "misplaced", "offset", "late" or "foreign": the features hold another
        disk's channel in place of this one.
    channels
        The channels concerned.
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
    """The fit of a hypothesis, at its best share and h.

    Parameters
    ----------
    fault
        The hypothesis.
    log_likelihood, chi2, dof
        Its log likelihood, up to a constant of the data, chi-squared and degrees of freedom.
    share, h_W_m2K
        The best share and heat transfer coefficient.
    size
        How much deeper the junction lies [m], how much it reads too high [K], how late it is [s];
        None without a free parameter.
    """

    fault: Fault
    log_likelihood: float
    chi2: float
    dof: int
    share: float
    h_W_m2K: float
    size: Estimate | None


def hypotheses(channels: Sequence[str], excluded: Sequence[str] = ()) -> Iterator[list[Fault]]:
    """A sound disk and all faults that are considered, in lists with one order of the columns each.

    Parameters
    ----------
    channels
        The channels of the disk.
    excluded
        Channels that have no faults.

    Yields
    ------
    list
        First the sound disk with all faults of one channel, then each swap.
    """
    used = [c for c in channels if c not in excluded]
    yield [Fault("none"), *(Fault(kind, (c,)) for c in used for kind in FREE_PARAMETER)]
    for pair in combinations(used, 2):
        yield [Fault("swapped", pair)]


def evaluate_faults(f: DiskFeatures, disk: DiskTraces, faults: Sequence[Fault]) -> list[FaultFit]:
    """Likelihood of the features under each of some faults, all with one order of the columns.

    Parameters
    ----------
    f, disk
        Features and traces of the disk.
    faults
        The faults.

    Returns
    -------
    list
        The fit of each fault.

    Notes
    -----
    The effect of every error grows with the share, so a hypothesis is a mixture of normal
    distributions about each share of ``SHARE_GRID``; the numbers of a fit are those of the
    likeliest. The grid's spacing is 1.5 ``SHARE_SD``, so that the mixture is smooth; change both
    together. Each hypothesis has its own best h of ``H_FINE_W_M2K``.
    """
    setup = f.setup
    order = faults[0].order(setup.channels)
    responses = f.response(order, tuple((float(h), NOMINAL) for h in H_GRID_W_M2K))
    boundary, power = (
        CubicSpline(np.log(H_GRID_W_M2K), x[:, f.observed])(np.log(H_FINE_W_M2K)) for x in responses
    )
    readings = f.levels[:, order][:, setup.channel_indices(setup.rows)][f.observed]
    independent_sd = independent_sd_K(f, disk, power[len(power) // 2], order)
    fits_by_share = []
    for share in SHARE_GRID:
        residuals = readings - boundary - share * power
        start = int(np.argmin(((residuals / independent_sd) ** 2).sum(axis=1)))
        component = _ShareComponent(f, disk, share, residuals, power)
        fits_by_share.append([component.fit(fault, start) for fault in faults])
    out = []
    for fits in zip(*fits_by_share):
        best = max(fits, key=lambda fit: fit.log_likelihood)
        total = special.logsumexp([fit.log_likelihood for fit in fits]) - np.log(len(fits))
        out.append(replace(best, log_likelihood=float(total)))
    return out


@dataclass(frozen=True)
class _Whitened:
    """Residuals about one point, without a free fault, divided by a root of their covariance.

    Parameters
    ----------
    root
        Cholesky root of the covariance, (D, D).
    effects, residuals
        Effects of the errors, (D, Q), and residuals at each h, (D, H), divided by it.
    chi2
        Chi-squared at each h, (H,).
    log_det
        Log determinant of the covariance.
    """

    root: Array
    effects: Array
    residuals: Array
    chi2: Array
    log_det: float

    @classmethod
    def of(cls, covariance: Array, effects: Array, residuals: Array) -> _Whitened:
        """Whiten residuals and effects.

        Parameters
        ----------
        covariance
            Of the residuals, (D, D).
        effects, residuals
            (Q, D) and (H, D).
        """
        root: Array = np.asarray(np.linalg.cholesky(covariance), dtype=float)
        white = solve_triangular(root, np.vstack([effects, residuals]).T, lower=True)
        white_effects = white[:, : len(effects)]
        white_residuals = white[:, len(effects) :]
        chi2 = (white_residuals**2).sum(axis=0)
        log_det = 2 * float(np.log(np.diag(root)).sum())
        return cls(root, white_effects, white_residuals, chi2, log_det)


class _ShareComponent:
    """One normal component of the mixture: the share lies about one of ``SHARE_GRID``.

    Parameters
    ----------
    f, disk
        Features and traces of the disk.
    share
        The share.
    residuals, power
        Residuals, and responses to a share of one, over ``H_FINE_W_M2K``, (H, D).
    """

    def __init__(
        self, f: DiskFeatures, disk: DiskTraces, share: float, residuals: Array, power: Array
    ) -> None:
        """Store the data; parameters as of the class."""
        self.f = f
        self.disk = disk
        self.share = share
        self.residuals = residuals
        self.power = power
        # by node of the coarse grid and swapped channels: most faults have them in common
        self._cache: dict[tuple[int, tuple[str, ...]], _Whitened] = {}

    def _whitened(self, node: int, fault: Fault) -> _Whitened:
        """The residuals whitened with the covariance at a node of the coarse grid, cached.

        Parameters
        ----------
        node
            Index of ``H_GRID_W_M2K``.
        fault
            The fault, for the order of the columns and for swapped static lines.
        """
        swapped = fault.channels if fault.kind in ("swapped", "foreign") else ()
        if (node, swapped) not in self._cache:
            order = fault.order(self.f.setup.channels)
            effects = self.f.effects(order, float(H_GRID_W_M2K[node]), self.share)
            cov = covariance(self.f, self.disk, effects, order, swapped)
            self._cache[node, swapped] = _Whitened.of(cov, effects, self.residuals)
        return self._cache[node, swapped]

    def fit(self, fault: Fault, start: int) -> FaultFit:
        """The fit of a fault, from a given h.

        Parameters
        ----------
        fault
            The fault.
        start
            Index of ``H_FINE_W_M2K``.

        Notes
        -----
        The free parameter of a fault, e by one standard deviation of it, adds e e' to the
        covariance C. With e and all else divided by the root of C, that lowers chi-squared by
        (e'r)^2/(1 + e'e) and adds ln(1 + e'e) to the log determinant. ``FREE_PARAMETER`` names the
        effects by the first word of ``tcdyn.partition.nuisance.nominal_parameters``.
        """
        names = [parameter.name for parameter in nominal_parameters(self.f.setup)]
        quantity, sd = FREE_PARAMETER.get(fault.kind, ("", 0.0))
        rows = [names.index(f"{quantity} {c}") for c in fault.channels] if sd else []
        best = start
        node = -1
        for _ in range(MAX_ITERATIONS):  # the covariance is that at the nearest node
            nearest = int(np.argmin(np.abs(np.log(H_GRID_W_M2K / H_FINE_W_M2K[best]))))
            if nearest == node:
                break
            node = nearest
            white = self._whitened(node, fault)
            effect = sd * white.effects[:, rows].sum(axis=1)
            widening = 1 + float(effect @ effect)
            projection = effect @ white.residuals
            best = int(np.argmin(white.chi2 - projection**2 / widening))
        size_in_sd = float(projection[best]) / widening
        chi2 = float(white.chi2[best]) - size_in_sd * float(projection[best])
        log_det = white.log_det + float(np.log(widening))
        size = Estimate.normal(sd * size_in_sd, sd / widening**0.5) if sd else None
        power = solve_triangular(white.root, self.power[best], lower=True)
        residual = white.residuals[:, best] - size_in_sd * effect
        share = self.share + SHARE_SD**2 * float(power @ residual)
        return FaultFit(
            fault=fault,
            log_likelihood=-0.5 * (chi2 + log_det),
            chi2=chi2,
            dof=self.residuals.shape[1] - 1,
            share=float(np.clip(share, 0.0, 1.0)),
            h_W_m2K=float(H_FINE_W_M2K[best]),
            size=size,
        )


def refine_fault(test: EhlTest, f: DiskFeatures, disk: DiskTraces, fit: FaultFit) -> FaultFit:
    """Refine the size of a misplaced outer junction, or of a late channel: a large one is not linear.

    Other faults are returned as they are.

    Parameters
    ----------
    test
        The test.
    f, disk
        Features and traces of the disk.
    fit
        The linear fit of the fault.

    Notes
    -----
    A long delay and a large shift of depth are not linear. ``tests/partition/test_sensors.py``
    (study) fails if their size is wrong.
    """
    if fit.size is None:
        return fit
    channel = fit.fault.channels[0]
    if fit.fault.kind == "late":
        return _refine_late(test, disk, fit)
    if fit.fault.kind == "misplaced" and channel in f.setup.outer:
        return _refine_depth(f, disk, fit, fit.size)
    return fit


def _refine_depth(f: DiskFeatures, disk: DiskTraces, v: FaultFit, start: Estimate) -> FaultFit:
    """Evaluate a misplaced junction at its estimated depth until that converges.

    Parameters
    ----------
    f, disk
        Features and traces of the disk.
    v
        The linear fit.
    start
        Its shift of depth [m].

    Notes
    -----
    A junction below the inner row is rejected with a likelihood of zero.
    """
    channel = v.fault.channels[0]
    setup = f.setup
    junction = setup.junctions[channel]
    deepest_m = setup.edge_m - MIN_DEPTH_M
    size = start
    fit = v
    for _ in range(MAX_DEPTH_ITERATIONS):
        depth_m = float(np.clip(junction.depth_m + size.value, MIN_DEPTH_M, deepest_m))
        junctions = {**setup.junctions, channel: replace(junction, depth_m=depth_m)}
        features = replace(f, setup=replace(setup, junctions=junctions))
        (fit,) = evaluate_faults(features, disk, [v.fault])
        if fit.size is None:
            break
        shift_m = depth_m - junction.depth_m
        size = Estimate.normal(shift_m + fit.size.value, fit.size.u)
        if abs(fit.size.value) < CONVERGED_M:
            break
    if size.value + junction.depth_m > deepest_m:  # the outer row lies above the inner one
        return replace(fit, size=size, log_likelihood=-np.inf)
    return _with_prior(fit, size, MISPLACED_M)


def _refine_late(test: EhlTest, disk: DiskTraces, v: FaultFit) -> FaultFit:
    """The likeliest of three forms of a late channel: a further lag, a longer first lag, a delay.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    v
        The linear fit.

    Notes
    -----
    The linear fit is that of a further first-order lag: with y the readings, it adds s dy/dt to
    them. A bubble in the cement makes the chain's first lag longer, for which the linear fit can be
    seven times too small: at each size the channel is brought to the chain of its record, which
    raises its noise in proportion. A column may also be shifted in time. Without the fault the disk
    counts as sound.
    """
    k = disk.setup.channels.index(v.fault.channels[0])
    chain = disk.chains[k]
    longest_s = max(chain.taus_s)
    sd = FREE_PARAMETER["late"][1]
    reach = (-MAX_EARLY_REL * longest_s, MAX_LATE_S)

    def with_channel(y: Array, noise_factor: float) -> FaultFit:
        """The fit of a sound disk with other readings (N,) of the channel."""
        readings = disk.readings_degC.copy()
        readings[:, k] = y
        level_K = disk.noise.level_K.copy()
        level_K[k] *= noise_factor
        changed = replace(disk, readings_degC=readings, noise=replace(disk.noise, level_K=level_K))
        return evaluate_faults(disk_features(test, changed), changed, [Fault("none")])[0]

    def without_lag(size_s: float) -> FaultFit:
        """The fit with the first lag shorter by a size [s]."""
        later = chain.with_lag_shift(size_s)
        y = equalise(disk.readings_degC[:, [k]], test.dt_s, (later,), chain)[:, 0]
        return with_channel(y, max(1.0 + size_s / longest_s, 1.0))

    def without_delay(size_s: float) -> FaultFit:
        """The fit with the channel earlier by a size [s]."""
        y = np.interp(test.time_s + size_s, test.time_s, disk.readings_degC[:, k])
        return with_channel(y, 1.0)

    forms = [v]
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
        found = replace(fit, fault=v.fault, log_likelihood=evidence)
        forms.append(_with_prior(found, Estimate.normal(size_s, u_s), sd))
    return max(forms, key=lambda form: form.log_likelihood)


def _with_prior(fit: FaultFit, size: Estimate, sd: float) -> FaultFit:
    """A refined fit with its total size, and the likelihood with the prior of that size.

    Parameters
    ----------
    fit
        The fit about the refined point.
    size
        Total size, from the nominal value.
    sd
        Standard deviation of its prior.
    """
    penalty = 0.5 * (size.value / sd) ** 2
    return replace(fit, size=size, log_likelihood=fit.log_likelihood - penalty)


def covariance(
    f: DiskFeatures,
    disk: DiskTraces,
    effects: Array,
    order: Order,
    swapped_channels: tuple[str, ...] = (),
) -> Array:
    """Covariance of the residuals of the predicted data, (D, D) [K2].

    Parameters
    ----------
    f, disk
        Features and traces of the disk.
    effects
        ``DiskFeatures.effects`` of the data, (Q, D).
    order
        Which column reads each position.
    swapped_channels
        Channels whose static lines and lags are another channel's.

    Notes
    -----
    The order of the uncertainties must be that of
    ``tcdyn.partition.disk_features.DiskFeatures.effects``: nominal parameters, harmonics of unit
    size, then flux position, speed exponent, common lag, loading and share. The uncertainty of h is
    not here: h is fitted.
    """
    swapped = np.isin(disk.setup.channels, swapped_channels).astype(float)
    static_u_K = np.hypot(disk.static_u_K, SWAPPED_LINES_K * swapped)
    nominal = nominal_u(disk, static_u_K, SWAPPED_LAGS_S * swapped)
    common = [1.0, 1.0, max(disk.common_lag_u_s, LEAST_LAG_U_S), LOADING_U_S, SHARE_SD]
    n_harmonic = len(effects) - len(nominal) - len(common)
    u = np.concatenate([nominal, np.ones(n_harmonic), common])
    scaled = u[:, None] * effects
    independent = np.diag(independent_sd_K(f, disk, effects[-1], order) ** 2)
    return np.asarray(scaled.T @ scaled + independent)


def independent_sd_K(f: DiskFeatures, disk: DiskTraces, power: Array, order: Order) -> Array:
    """Independent standard deviation of each datum, (D,) [K]: white noise, model errors, trends.

    Parameters
    ----------
    f, disk
        Features and traces of the disk.
    power
        Response to a share of one, (D,) [K].
    order
        Which column reads each position.

    Notes
    -----
    The noise counts twice: the inner row that predicts a datum has as much. The outer row follows
    the inner row's trend, so trends count for the inner row only.
    """
    setup = f.setup
    index = setup.channel_indices(setup.rows)
    n_outer = len(setup.outer)
    n_inner = len(setup.inner)
    noise = f.noise[:, None] * np.maximum(disk.noise_K[list(order)][index], 1e-3)
    model_rel = np.repeat([MODEL_REL, INNER_MODEL_REL], [n_outer, n_inner])
    is_inner = np.repeat([False, True], [n_outer, n_inner])
    trend = (
        f.trend_u_K[:, order][:, index] * is_inner
    )  # the outer row follows the inner row's trend
    variance = 2 * noise**2 + MODEL_K**2 + trend**2
    by_power = np.broadcast_to(model_rel, variance.shape)[f.observed] * power
    return np.sqrt(variance[f.observed] + by_power**2)


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


def depth_test(f: DiskFeatures, disk: DiskTraces, sound: FaultFit) -> DepthTest:
    """Score test of each depth about the fit of a sound disk.

    All other nuisance parameters and depths are at their priors.

    Parameters
    ----------
    f, disk
        Features and traces of the disk.
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
    setup = f.setup
    h = float(H_GRID_W_M2K[np.argmin(np.abs(np.log(H_GRID_W_M2K / sound.h_W_m2K)))])
    higher_h = h * float(np.exp(LOG_H_STEP))
    boundary, power = f.response(f.as_wired, ((h, NOMINAL), (higher_h, NOMINAL)))
    predicted, predicted_at_step = boundary + sound.share * power
    by_h = LOG_H_SD / LOG_H_STEP * (predicted_at_step - predicted)[f.observed]
    all_effects = f.effects(f.as_wired, h, sound.share)
    cov = covariance(f, disk, all_effects, f.as_wired) + np.outer(by_h, by_h)
    residual = (f.levels[:, setup.channel_indices(setup.rows)] - predicted)[f.observed]
    depth_u_m = disk.uncertainty.depth_mm * 1e-3
    used = [c for c in setup.channels if c not in disk.excluded]
    names = [parameter.name for parameter in nominal_parameters(setup)]
    effects = depth_u_m * all_effects[[names.index(f"depth {c}") for c in used]]
    weighted = np.linalg.solve(cov, effects.T).T
    gram = weighted @ effects.T
    score = weighted @ residual
    information = np.clip(np.diag(gram), MIN_INFORMATION, 1 - 1e-9)
    root = np.sqrt(np.diag(gram))
    deeper_m = {
        c: Estimate.normal(depth_u_m * float(s / t), depth_u_m * float(np.sqrt((1 - t) / t)))
        for c, s, t in zip(used, score, information)
    }
    correlation = gram / np.outer(root, root)
    return DepthTest(disk.name, score / root, correlation, deeper_m, depth_u_m, disk.excluded)
