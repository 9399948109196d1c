"""Joint fit of heat partition, heat transfer coefficient and common lag, with no inverse filter.

If all channels of a disk share one chain G, filtering the rim model by G leaves the logged readings
of the inner row as its boundary condition; only the frictional power passes G
(docs/theory/partition.md). So no noise is amplified. The nuisance parameters of the test enter the
fit with their priors, so that the covariance of the result holds them. The fit of both disks, with
shares that add to one, is the recommended estimate. Used by :mod:`tcdyn.partition.fit_rounds`,
:mod:`tcdyn.partition.profile`,
:mod:`tcdyn.partition.model_forms` and :mod:`tcdyn.campaign`. Guarded by
``tests/partition/test_joint.py``, ``tests/partition/test_profile.py`` and the behaviour suite.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tcdyn.chain import Chain, equalise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.estimation import Optimum, Problem, covariance_from_rows, minimise, slow_variance_factor
from tcdyn.estimation.trace_noise import white_noise_sd
from tcdyn.heat.rim import Profile, lag_basis_means
from tcdyn.partition.angular_harmonic import (
    HARMONIC_SOURCES,
    AngularHarmonic,
    harmonic_from_fit,
)
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance import (
    FRICTION_NOISE,
    LOG_H,
    LOG_LAGS,
    LOG_TAU2,
    PARAMETERS,
    SHARE,
    LaggedRim,
    harmonic_prior,
    lags,
    nuisance_effects,
    with_lags,
)
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.specified import SURFACE_SLOPE, log_h_prior
from tcdyn.partition.steady import FitSensitivity
from tcdyn.partition.window import DiskWindow, RimMeans, disk_window, fit_rows, lagged_power
from tcdyn.rig.disk import DISKS
from tcdyn.smoothing.traces import DIFFERENCE_ORDER, DiskTraces

# Largest change of share, log h, log lags and log tau2 in one step of the search. By judgement.
MAX_STEP = (np.inf, 0.7, 0.7, 0.7)
# Prior standard deviation of the logarithm of the second lag: known to a factor of about four.
# Chosen by judgement.
LOG_TAU2_SD = 1.5
# Least standard uncertainty of a disk's common lag from its record [s]. Chosen by judgement.
MIN_LAG_U_S = 0.02
# Least part of a column of the Jacobian, relative to its length, that is independent of the others.
# Below, two columns are equal within rounding.
MIN_INDEPENDENT_PART = 1e-10
# The search stops when a step would lower chi-squared by less than this. Chosen by judgement.
TOLERANCE = 1e-7
# The same for passes whose result is only a start, and for refits of alternatives.
COARSE_TOLERANCE = 1e-3
# A further pass is needed if a parameter changed by more than this [standard deviations].
# Of 36 fits that passed this test, the next pass changed none by more than 0.008.
CONVERGED_U = 0.1
# Least first guesses of the longest lag [s] and of h [W/m2K]. Chosen by judgement.
MIN_START_LAG_S = 0.02
MIN_START_H_W_M2K = 20.0
# Length of the cooling that the joint fits use, unless the log is shorter [s]. Chosen by judgement.
JOINT_WINDOW_S = 10.0
StartPoints = Mapping[str, tuple[float, float]]  # share and h [W/m2K] of each disk, to start from


@dataclass(frozen=True)
class DiskBlock:
    """Data, model and priors of one disk in a joint fit, in standard deviations of its noise.

    Parameters
    ----------
    disk
        Name of the disk.
    parameters
        The Q nuisance parameters.
    y
        Weighted readings, (m,).
    effects
        Change of the readings by one standard uncertainty of each nuisance parameter, (m, Q).
    model
        Prediction (m,) and its derivatives (m, 4) by ``PARAMETERS``; None outside the range of the
        model.
    prior_lag_s, prior_lag_u_s
        Common lag of the disk by its record, and its standard uncertainty [s].
    prior_tau2_s
        Prior of the second lag [s].
    remaining_lag_s
        Lag of the chain beyond tau1 + tau2 [s].
    prior_log_h
        Mean and standard deviation of log h (h in W/m2K); the standard deviation is infinite
        without a measured surface loss.
    window
        The window of readings that ``y`` and ``model`` belong to.
    rim_with_lags
        The rim of the window with the frictional power passed through given lags.

    Notes
    -----
    ``tcdyn.partition.profile.rim_table`` replaces ``y``, ``effects`` and ``model`` by projections
    on fewer directions; ``window`` is then still the full one.
    """

    disk: str
    parameters: tuple[NuisanceParameter, ...]
    y: Array
    effects: Array
    model: Callable[[Array], tuple[Array, Array] | None]
    prior_lag_s: float
    prior_lag_u_s: float
    prior_tau2_s: float
    remaining_lag_s: float
    prior_log_h: tuple[float, float]
    window: DiskWindow
    rim_with_lags: Callable[[tuple[float, ...]], RimMeans]


@dataclass(frozen=True)
class DiskFit:
    """Joint fit of one disk: share, h [W/m2K] and common chain.

    Parameters
    ----------
    disk
        Name of the disk.
    theta
        The fitted ``PARAMETERS``, (4,).
    share, beta
        Share of the frictional power that enters this disk, and the fast disk.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    estimates
        beta (of the fast disk), h and lag_s with their uncertainties.
    chain
        The common chain of the channels, with the fitted lags.
    sensitivity
        Sensitivity of (share, h, lag) to the nuisance parameters, and the covariance by noise.
    inflation
        Variance ratio of slow waves in the residuals to white noise, at least 1: the factor by
        which the covariance by noise is larger than that of white noise.
    block
        The data and the model that were fitted.
    """

    disk: str
    theta: Array
    share: float
    beta: float
    h_W_m2K: float
    estimates: Mapping[str, Estimate]
    chain: Chain
    sensitivity: FitSensitivity
    inflation: float
    block: DiskBlock = field(repr=False, compare=False)


@dataclass(frozen=True)
class CombinedFit:
    """Joint fit of all disks of a test at once; with two disks their shares add to one.

    Parameters
    ----------
    theta
        The fitted ``PARAMETERS`` of each disk, the fast disk's first, (4 n,) for n disks.
    speed_ratio
        u_f/u_s under load.
    estimates
        beta and h of each disk as "h_fast" and "h_slow" [W/m2K]; of two disks also the exponent
        ln(h_fast/h_slow)/ln(u_f/u_s) that they imply.
    pulls
        For each nuisance parameter: the parameter, its disk ("" if common to both), and how many
        standard deviations the data would move it from its nominal value; about standard normal on
        a sound rig. Without those of the angular harmonics and of the friction's noise.
    inflation
        Variance ratio of slow waves in the residuals of the worse disk to white noise.
    harmonics
        First circumferential harmonic of each disk.
    optimum
        Result of the least-squares search: the 4 n parameters, then the nuisance parameters.
    """

    theta: Array
    speed_ratio: float
    estimates: Mapping[str, Estimate]
    pulls: tuple[tuple[NuisanceParameter, str, float], ...]
    inflation: float
    harmonics: Mapping[str, AngularHarmonic] = field(repr=False, compare=False)
    optimum: Optimum = field(repr=False, compare=False)


def disk_block(
    test: EhlTest, disk: DiskTraces, theta: Array, window_s: float, profile: Profile, tau2_s: float
) -> DiskBlock:
    """Bring all channels of a disk to one common chain, and linearise the nuisance parameters.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    theta
        ``PARAMETERS`` of the disk, (4,): the point to linearise at, whose lags the common chain
        gets.
    window_s
        Length of the cooling [s].
    profile
        Profile of the inner boundary along z.
    tau2_s
        Prior of the second lag [s].

    Raises
    ------
    InputError
        If the log ends before the window.

    Notes
    -----
    If all channels of a disk share one chain G, filtering the rim model by G gives y_outer =
    H_boundary y_(d,b,f) + share G (H_F F u_s) + H_A T_A. So the lagged boundary readings drive the
    model as they are, and only the frictional power passes G (docs/theory/partition.md).

    The readings depend on ``theta`` by the common chain, and the effects by the linearisation;
    therefore ``tcdyn.partition.joint.disk_fit`` calls this function again at its result.
    ``remaining_lag_s`` must leave out the same lags that ``tcdyn.partition.nuisance.with_lags``
    replaces; ``tests/partition/test_joint.py`` (a third lag of the record) fails otherwise.
    """
    rows = fit_rows(test, window_s)
    record_chain = disk.mean_chain
    common_chain = with_lags(record_chain, lags(theta))
    lag_shift_s = common_chain.lag_s - record_chain.lag_s
    chains = tuple(c.with_lag_shift(lag_shift_s) for c in disk.chains)
    readings = equalise(
        disk.readings_degC[rows], test.dt_s, chains, record_chain.with_lag_shift(lag_shift_s)
    )
    noise = _noise_K(disk, readings)
    window = disk_window(test, disk, readings, rows, noise, profile, common_chain)
    nuisances = nuisance_effects(
        test, disk, window, float(theta[SHARE]), float(np.exp(theta[LOG_H]))
    )
    longest_s = max(lags(theta))
    power, _ = lagged_power(test, rows, with_lags(record_chain, (longest_s,)))
    bank = lag_basis_means(power, test.dt_s, window.rim.rates_1_s, window.counts)
    rim = window.rim.with_power(window.blocks @ power, bank)
    model = LaggedRim(rim, longest_s, window.weight)
    n_nuisances = len(nuisances.parameters)
    return DiskBlock(
        disk=disk.name,
        parameters=nuisances.parameters,
        y=(window.y * window.weight).ravel(),
        effects=(nuisances.change * window.weight).reshape(n_nuisances, -1).T,
        model=model,
        prior_lag_s=disk.common_lag_s,
        prior_lag_u_s=max(disk.common_lag_u_s, MIN_LAG_U_S),
        prior_tau2_s=tau2_s,
        remaining_lag_s=record_chain.lag_s - sum(sorted(record_chain.taus_s, reverse=True)[:2]),
        prior_log_h=log_h_prior(disk.setup.surface),
        window=window,
        rim_with_lags=model.rim_with_lags,
    )


def _noise_K(disk: DiskTraces, readings: Array) -> Array:
    """Standard deviation of the noise of each channel, (C,) [K].

    Differences of the readings show white noise that was equalised; at least half of the trace's
    own noise is kept. For coloured noise the differences mean nothing, so the trace's own noise is
    taken.
    """
    if disk.noise.is_coloured:
        return disk.noise_K
    return np.maximum(white_noise_sd(readings, DIFFERENCE_ORDER), 0.5 * disk.noise_K)


def nuisance_parameters(disk_blocks: Sequence[DiskBlock]) -> list[tuple[NuisanceParameter, str]]:
    """All nuisance parameters in the order of the fit, each with its disk, "" if common.

    A parameter that both disks share is listed once.
    """
    labels = [
        (parameter, "" if parameter.shared else block.disk)
        for block in disk_blocks
        for parameter in block.parameters
    ]
    return list(dict.fromkeys(labels))


def joint_problem(disk_blocks: Sequence[DiskBlock]) -> Problem:
    """The posterior of one disk, or of both with shares that keep their sum.

    The parameters are four for each disk, then the nuisance parameters in standard uncertainties. A
    nuisance parameter that the disks share is there once.

    Parameters
    ----------
    disk_blocks
        The disks, one or two.

    Returns
    -------
    Problem
        Residual: the weighted data of each disk, then for each disk its lag less that of the
        record, in standard uncertainties.

    Notes
    -----
    ``fixed`` keeps the sum of the shares at its value at the start, so the caller must start with
    shares that add to one. Priors: none on the share; log h only where the surface loss was
    measured; tau2 by ``LOG_TAU2_SD``. ``tcdyn.partition.joint.main_covariance``,
    ``tcdyn.partition.profile`` and ``tcdyn.partition.departures.LinearisedFit`` rely on the order
    of rows and columns. ``tests/partition/test_profile.py`` compares the Jacobian with differences.
    """
    n_main = 4 * len(disk_blocks)
    ends = np.cumsum([0, *(len(block.y) for block in disk_blocks)])
    n_data = ends[-1]
    nuisances = nuisance_parameters(disk_blocks)
    effects = np.zeros((n_data, len(nuisances)))
    for i, block in enumerate(disk_blocks):
        columns = [nuisances.index((q, "" if q.shared else block.disk)) for q in block.parameters]
        effects[ends[i] : ends[i + 1], columns] = block.effects

    names = [f"{name}, {block.disk} disk" for block in disk_blocks for name in PARAMETERS]
    names += [f"{parameter.name} {disk}".strip() for parameter, disk in nuisances]
    mean = np.zeros(len(names))
    sd = np.where(np.arange(len(names)) < n_main, np.inf, 1.0)
    mean[LOG_TAU2:n_main:4] = [np.log(block.prior_tau2_s) for block in disk_blocks]
    sd[LOG_TAU2:n_main:4] = LOG_TAU2_SD
    mean[LOG_H:n_main:4] = [block.prior_log_h[0] for block in disk_blocks]
    sd[LOG_H:n_main:4] = [block.prior_log_h[1] for block in disk_blocks]
    largest = np.append(MAX_STEP * len(disk_blocks), np.full(len(nuisances), np.inf))
    fixed = np.zeros((len(disk_blocks) - 1, len(names)))
    fixed[:, SHARE:n_main:4] = 1.0
    evaluate = partial(_joint_residual, tuple(disk_blocks), effects)
    return Problem(tuple(names), evaluate, mean, sd, max_step=largest, fixed=fixed)


def _joint_residual(
    disk_blocks: Sequence[DiskBlock], effects: Array, theta: Array
) -> tuple[Array, Array] | None:
    """Residual of :func:`joint_problem` and its Jacobian; None outside the range of a model.

    Parameters
    ----------
    disk_blocks
        The disks.
    effects
        Change (N, Q) of the weighted data for one standard uncertainty of each nuisance parameter.
    theta
        The parameters.
    """
    n_main = 4 * len(disk_blocks)
    n_data = len(effects)
    residual = np.zeros(n_data + len(disk_blocks))
    jacobian = np.zeros((len(residual), len(theta)))
    residual[:n_data] = effects @ theta[n_main:]
    jacobian[:n_data, n_main:] = effects
    start = 0
    for i, block in enumerate(disk_blocks):
        main = theta[4 * i : 4 * i + 4]
        rows = slice(start, start + len(block.y))
        start = rows.stop
        response = block.model(main)
        if response is None:
            return None
        prediction, derivatives = response
        residual[rows] += prediction - block.y
        jacobian[rows, 4 * i : 4 * i + 4] = derivatives
        lag_s = float(np.exp(main[LOG_LAGS]))
        deviation_s = lag_s + block.remaining_lag_s - block.prior_lag_s
        residual[n_data + i] = deviation_s / block.prior_lag_u_s
        jacobian[n_data + i, 4 * i + LOG_LAGS] = lag_s / block.prior_lag_u_s
    return residual, jacobian


def main_covariance(optimum: Optimum, disk_blocks: Sequence[DiskBlock]) -> tuple[Array, Array]:
    """Covariance of the main parameters by white noise, and their sensitivity to everything else.

    Parameters
    ----------
    optimum
        Optimum of :func:`joint_problem`.
    disk_blocks
        The disks of that problem.

    Returns
    -------
    covariance
        Covariance of the P = 4 parameters a disk by the white noise of the readings, (P, P).
    sensitivity
        Change of the main parameters by one standard uncertainty of each nuisance parameter, then
        of each disk's lag, of its second lag, and of its h where that has a prior, (P, Q).

    Raises
    ------
    InputError
        If a column of the Jacobian adds nothing to the others: without priors, share and h then
        cannot be separated.

    Notes
    -----
    With the posterior covariance C, C J' is the response to the whitened data. The total covariance
    is ``covariance + sensitivity sensitivity'``. The order of the columns must stay that of the
    parameters which ``tcdyn.partition.joint.disk_fit`` lists. ``MIN_INDEPENDENT_PART`` only decides
    when the fit is refused. ``tests/partition/test_joint.py`` tests the refusal.
    """
    n_main = 4 * len(disk_blocks)
    n_data = len(optimum.residual) - len(disk_blocks)
    prior_root = np.sqrt(optimum.problem.precision)
    directions = optimum.directions
    prior_rows = np.diag(prior_root)[prior_root > 0]
    inner, independent_part = covariance_from_rows(
        np.vstack([optimum.jacobian, prior_rows]) @ directions
    )
    if independent_part < MIN_INDEPENDENT_PART:
        raise InputError(
            "the data about the unloading do not separate heat partition from heat transfer "
            "coefficient",
            expected="frictional heat before the unloading and some cooling after it",
            remedy="log more of the cooling, or check load and friction before the unloading",
        )
    covariance = directions @ inner @ directions.T
    gain = covariance[:n_main] @ optimum.jacobian.T
    noise_gain = gain[:, :n_data]
    by_nuisance = -covariance[:n_main, n_main:]
    by_lag = gain[:, n_data:]
    by_tau2 = covariance[:n_main, LOG_TAU2:n_main:4] / LOG_TAU2_SD
    log_h_sd = np.array([block.prior_log_h[1] for block in disk_blocks])
    by_h = (covariance[:n_main, LOG_H:n_main:4] / log_h_sd)[:, np.isfinite(log_h_sd)]
    return noise_gain @ noise_gain.T, np.hstack([by_nuisance, by_lag, by_tau2, by_h])


def _noise_and_sensitivity(
    best: Optimum, disk_blocks: Sequence[DiskBlock], index: list[int], scale: Array
) -> tuple[float, Array, Array]:
    """Covariance and sensitivity of k numbers, allowing for correlated residuals.

    Parameters
    ----------
    best, disk_blocks
        Optimum of :func:`joint_problem`, and its disks.
    index
        Indices of the k numbers among the main parameters.
    scale
        Change of each number with its parameter, (k,): 1, or its value where the parameter is its
        logarithm.

    Returns
    -------
    inflation
        Variance ratio of slow waves in the residuals of the worse disk to white noise.
    noise
        Covariance by noise, inflated, (k, k).
    sensitivity
        Sensitivity to everything else, (k, Q).
    """
    white, sensitivity = main_covariance(best, disk_blocks)
    ends = np.cumsum([len(block.y) for block in disk_blocks])[:-1]
    residuals = np.split(best.residual[: -len(disk_blocks)], ends)
    inflation = max(
        slow_variance_factor(residual.reshape(block.window.y.shape))
        for block, residual in zip(disk_blocks, residuals)
    )
    noise = inflation * white[np.ix_(index, index)] * np.outer(scale, scale)
    return inflation, noise, scale[:, None] * sensitivity[index]


def joint_fits(
    test: EhlTest,
    start: StartPoints,
    window_s: float = JOINT_WINDOW_S,
    profile: Profile = "modal",
) -> tuple[dict[str, DiskFit], CombinedFit]:
    """Fit each disk by itself, then all disks of the test together.

    Parameters
    ----------
    test
        The test, with one or both disks.
    start
        Share and h [W/m2K] of each disk to start from.
    window_s
        Length of the cooling used [s].
    profile
        Profile of the inner boundary along z.

    Returns
    -------
    fits
        The joint fit of each disk by itself.
    combined
        The fit of all disks at once. With one disk it is the fit of this disk.

    Raises
    ------
    InputError
        If the log ends before the window, or share and h cannot be separated.

    Notes
    -----
    The combined fit uses the blocks of the single fits, with their common chains and linearisation
    points. Its start has shares that add to one, because ``joint_problem`` keeps their sum.
    ``tests/partition/test_joint.py`` compares the results with rigs of known truth,
    ``tests/partition/test_one_disk.py`` the fit of one disk with that of the full test.
    """
    names = [d for d in DISKS if d in test.disks]
    fits = {d: disk_fit(test, test.disks[d], *start[d], window_s, profile) for d in names}
    disk_blocks = [fits[d].block for d in names]
    n_main = 4 * len(names)
    problem = joint_problem(disk_blocks)
    theta = np.zeros(len(problem.names))
    theta[:n_main] = np.concatenate([fits[d].theta for d in names])
    if len(names) > 1:
        theta[SHARE:n_main:4] += 0.5 * (1.0 - theta[SHARE:n_main:4].sum())
    best = minimise(problem, theta, tolerance=TOLERANCE)
    share = float(best.theta[SHARE])
    h_W_m2K = np.exp(best.theta[LOG_H:n_main:4])
    inflation, noise, sensitivity = _noise_and_sensitivity(
        best,
        disk_blocks,
        [SHARE, *range(LOG_H, n_main, 4)],
        np.array([1.0, *h_W_m2K]),
    )
    covariance = noise + sensitivity @ sensitivity.T
    variances = [*np.diag(covariance)]
    values = {"beta": share if names[0] == "fast" else 1.0 - share}
    values |= {f"h_{d}": float(h) for d, h in zip(names, h_W_m2K)}
    if len(names) > 1:
        log_ratio = np.log(test.speed_ratio)
        exponent_slope = np.array([0.0, 1 / h_W_m2K[0], -1 / h_W_m2K[1]]) / log_ratio
        values["exponent"] = float(np.log(h_W_m2K[0] / h_W_m2K[1]) / log_ratio)
        variances.append(exponent_slope @ covariance @ exponent_slope)
    nuisances = nuisance_parameters(disk_blocks)
    harmonics = {
        d: harmonic_from_fit(
            best.theta[n_main:],
            best.covariance[n_main:, n_main:],
            nuisances,
            d,
            h,
            harmonic_prior(test, d),
        )
        for d, h in zip(names, h_W_m2K)
    }
    combined = CombinedFit(
        theta=best.theta[:n_main],
        speed_ratio=test.speed_ratio,
        estimates=_estimates(values, np.sqrt(variances)),
        pulls=_pulls(best, nuisances),
        inflation=inflation,
        harmonics=harmonics,
        optimum=best,
    )
    return fits, combined


def _estimates(values: Mapping[str, float], u: Array) -> dict[str, Estimate]:
    """Normal estimates of ``values`` with standard uncertainties ``u``."""
    return {
        name: Estimate.normal(float(value), float(sd))
        for (name, value), sd in zip(values.items(), u)
    }


def _pulls(
    best: Optimum, nuisances: Sequence[tuple[NuisanceParameter, str]]
) -> tuple[tuple[NuisanceParameter, str, float], ...]:
    """The pull of each nuisance parameter except those of the circumferential harmonics.

    Parameters
    ----------
    best
        Optimum of the fit of both disks; the nuisance parameters are its last.
    nuisances
        The nuisance parameters, each with its disk.
    """
    values = [*best.pulls.values()][-len(nuisances) :]
    return tuple(
        (parameter, disk, z)
        for (parameter, disk), z in zip(nuisances, values)
        if parameter.source not in {*HARMONIC_SOURCES, FRICTION_NOISE}
    )


def disk_fit(
    test: EhlTest, disk: DiskTraces, share: float, h: float, window_s: float, profile: Profile
) -> DiskFit:
    """Joint fit of one disk by itself.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    share, h
        Share and heat transfer coefficient [W/m2K] to start from.
    window_s
        Length of the cooling used [s].
    profile
        Profile of the inner boundary along z.

    Raises
    ------
    InputError
        If the log ends before the window, or share and h cannot be separated.

    Notes
    -----
    Up to three passes; each equalises the channels with the chain that the previous one fitted. The
    first is coarse. It stops after the second if no parameter changed by ``CONVERGED_U`` standard
    deviations. The labels appended to ``parameters`` must match the last columns of
    ``tcdyn.partition.joint.main_covariance``. ``tests/partition/test_joint.py`` fails if further
    passes would still move the result.
    """
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1 = max(taus[0], MIN_START_LAG_S)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 0.1 * tau1)
    log_h = np.log(max(h, MIN_START_H_W_M2K))
    theta = np.array([share, log_h, np.log(tau1 + tau2), np.log(tau2)])
    # each pass equalises the channels with the chain that the previous pass fitted
    for tolerance in (COARSE_TOLERANCE, TOLERANCE, TOLERANCE):
        block = disk_block(test, disk, theta, window_s, profile, tau2)
        problem = joint_problem([block])
        start = np.append(theta, np.zeros(len(problem.names) - len(theta)))
        best = minimise(problem, start, tolerance=tolerance)
        change = np.abs(best.theta[:4] - theta[:4])
        theta = best.theta
        sd = np.sqrt(np.diag(best.covariance)[:4])
        if tolerance == TOLERANCE and np.all(change < CONVERGED_U * sd):
            break
    share = float(theta[SHARE])
    h, lag_s = map(float, np.exp(theta[[LOG_H, LOG_LAGS]]))
    inflation, noise, sensitivity = _noise_and_sensitivity(
        best, [block], [SHARE, LOG_H, LOG_LAGS], np.array([1.0, h, lag_s])
    )
    beta = share if disk.name == "fast" else 1.0 - share
    chain = with_lags(disk.mean_chain, lags(theta))
    u = np.sqrt(np.diag(noise + sensitivity @ sensitivity.T))
    parameters = [
        *block.parameters,
        *(NuisanceParameter(x, "chain") for x in ("common lag", "lag shape")),
    ]
    if np.isfinite(block.prior_log_h[1]):
        parameters.append(SURFACE_SLOPE)
    return DiskFit(
        disk=disk.name,
        theta=theta[:4],
        share=share,
        beta=beta,
        h_W_m2K=h,
        chain=chain,
        estimates=_estimates({"beta": beta, "h": h, "lag_s": chain.lag_s}, u),
        sensitivity=FitSensitivity(tuple(parameters), sensitivity.T, noise),
        inflation=inflation,
        block=block,
    )
