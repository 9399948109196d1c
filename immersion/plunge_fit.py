"""Grey-box identification of the chains of a disk from its plunges: joint MAP fit.

:func:`identify_plunges` is the entry point, used by ``tcdyn rig calibrate``. The order: whiten the
noise, average in blocks, set the priors, find the MAP, scan the common lag, refit with other
correlations. :func:`with_structure_uncertainty` adds the comparison of structures. Thresholds are
chosen by judgement. Tests: ``tests/immersion/test_plunge_fit.py`` and
``tests/immersion/test_plunge_structures.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from immersion.chain_structures import compare_structures
from immersion.correlations import THESIS_THREE, Bath, Correlation
from immersion.correlations import correlation as find_correlation
from immersion.plunge_data import PlungeRun, RunNoise, make_blocks, without_spikes
from immersion.plunge_model import RunModel, build_run_models, junction_degC
from immersion.plunge_parameters import FIXED_SD, PlungeParameters, PlungePriors
from immersion.plunge_posterior import (
    FAR_SEARCH,
    SEARCH,
    LagScan,
    PlungeModelForm,
    PlungeOptimum,
    PlungeProblem,
    marginal_deviance,
    scan_common_lag,
)
from immersion.plunge_result import PlungeFit
from tcdyn.chain import STRUCTURES, Chain
from tcdyn.chain.bursts import estimate_and_whiten_noise
from tcdyn.chain.logger_noise import TYPICAL_LAG_S, LoggerNoise
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.estimation import minimise_constrained
from tcdyn.estimation.trace_noise import SPIKES, white_noise_sd
from tcdyn.rig.disk import Conditioning, DiskSetup
from tcdyn.rig.static_line import smallest_uncertainty

# Linearised models of all runs about given parameters (P,).
BuildModels = Callable[[Array], tuple[RunModel, ...]]
# Weak burst from which a second search starts, in prior standard deviations of ln A below its
# median; chosen by judgement.
WEAK_BURST_SDS = 2.0
CLEARLY_BETTER_CHI_SQUARE = (
    6.0  # difference of cost that decides between two solutions; by judgement
)
REFITS = 2  # with the noise of the residuals and conduction linearised again; by judgement
# Share of the initial difference above which the ratio of h of two correlations is averaged; by
# judgement.
REFIT_DIFFERENCE_SHARE = 0.3


@with_named_arguments
def identify_plunges(
    runs: Sequence[PlungeRun],
    setup: DiskSetup,
    *,
    correlation: str | Correlation = "churchill-chu-laminar",
    structure: str = "P2",
    priors: PlungePriors | None = None,
    alternatives: Sequence[str] = THESIS_THREE,
) -> PlungeFit:
    """Identify the chains of all channels of one disk from one or more plunges.

    Parameters
    ----------
    runs
        Plunges with the same channels.
    setup
        The disk: geometry, steel, junctions and conditioning filter.
    correlation
        Correlation of natural convection, or its name.
    structure
        Chain structure.
    priors
        Priors of the nuisance parameters; None: the defaults.
    alternatives
        Correlations that are fitted too. The spread of the lags between correlations is added to
        their covariance.

    Returns
    -------
    fit
        Lags with covariance, chains, budget and findings.

    Raises
    ------
    InputError
        When runs have different channels or too little data.

    Notes
    -----
    Model: radial conduction from bore to running surface, h = s (|dT|/dT_0)^m h_correlation (1 + A
    exp(-(t/tau)^p)), junction -> chain (``structure``, with the conditioning filter, which is not
    estimated) -> static line. For each run s, m, A, tau, p, entry time, initial and bath
    temperature are nuisance parameters with ``priors``; for each channel the lag, its split, the
    depth and the errors of the static line; the conductivity is common. The result is the most
    probable parameter set (MAP). Its covariance is the inverse Hessian, with the noise estimated
    from the residuals.

    The steps must stay in this order: the readings are whitened by the noise model of the logger,
    and the model gets the same filter (``whitened_setup``); the lags are reported with the
    conditioning filter of ``setup``. A correlation more in ``alternatives`` can widen the lags.
    Test: ``tests/immersion/test_plunge_fit.py``.
    """
    if not runs:
        raise InputError("no plunge was given", expected="one immersion log or more")
    channels = runs[0].channels
    if any(r.channels != channels for r in runs):
        raise InputError("the plunges have different channels", expected=", ".join(channels))
    if structure not in STRUCTURES:
        raise InputError(f"unknown chain structure {structure!r}", expected=", ".join(STRUCTURES))
    priors = priors or PlungePriors()
    base = find_correlation(correlation)
    noise, white_runs = _whitened_runs(runs, setup.conditioning)
    # the noise model filters the readings, so the model's readings pass the same filter
    filtered = noise.whitened_chain(Chain((), conditioning=setup.conditioning)).conditioning
    whitened_setup = replace(setup, conditioning=filtered)
    blocks = [make_blocks(r) for r in white_runs]
    layout = PlungeParameters(len(runs), channels, structure)
    initial_degC = [float(np.nanmean(b.readings_degC[b.time_s < 0])) for b in blocks]
    bath_degC = [float(b.bath_degC[0]) for b in blocks]
    mean, sd = full_prior(layout, priors, runs, initial_degC, bath_degC, base, setup)

    def build(about: Array) -> tuple[RunModel, ...]:
        """Models of all runs, linearised about parameters (P,)."""
        return build_run_models(runs, blocks, whitened_setup, layout, base, about)

    problem = PlungeProblem((), layout, mean, sd, tuple(RunNoise.white(b) for b in blocks))
    problem = replace(problem, models=build(problem.start))
    best, rival = _search_optimum(problem, build, filtered.lag_s)
    scan, best, _ = scan_common_lag(best)
    others = [find_correlation(name) for name in alternatives]
    form = compare_correlations(best, scan, base, others, setup.conditioning.lag_s)
    return PlungeFit(setup, base.name, priors, form, rival, tuple(runs), best, scan, noise)


def _whitened_runs(
    runs: Sequence[PlungeRun], filter_: Conditioning
) -> tuple[LoggerNoise, list[PlungeRun]]:
    """Noise model of all runs, and the runs with whitened noise.

    Parameters
    ----------
    runs
        Runs with the same channels.
    filter_
        Conditioning filter of the logger.

    Returns
    -------
    noise
        Noise model that all runs have in common.
    runs
        Runs whose readings are whitened; spikes and bursts are NaN.

    Notes
    -----
    ``tcdyn.chain.logger_noise.TYPICAL_LAG_S`` is the lag of the chain that is assumed here, before
    any lag is known.
    """
    clean = [without_spikes(run.readings_degC)[0] for run in runs]
    white_K = np.mean([white_noise_sd(y) for y in clean], axis=0)
    typical = Chain((TYPICAL_LAG_S,), conditioning=filter_)
    intervals_s = [run.dt_s for run in runs]
    chains = [typical] * len(white_K)
    noise, whitened = estimate_and_whiten_noise(
        clean, intervals_s, filter_, white_K, chains, SPIKES["plunge"]
    )
    white_runs = []
    for run, y, (white, outlier_mask) in zip(runs, clean, whitened):
        readings = np.where(np.isfinite(y) & ~outlier_mask, white, np.nan)
        white_runs.append(replace(run, readings_degC=readings))
    return noise, white_runs


def full_prior(
    layout: PlungeParameters,
    priors: PlungePriors,
    runs: Sequence[PlungeRun],
    initial_degC: Sequence[float],
    bath_degC: Sequence[float],
    correlation: Correlation,
    setup: DiskSetup,
) -> tuple[Array, Array]:
    """Prior mean and standard deviation of all parameters, with fluid and static lines.

    Parameters
    ----------
    layout, priors, runs, correlation, setup
        As in the fit.
    layout
        Layout of the parameter vector.
    priors
        Priors of the nuisance parameters.
    runs
        The runs, in the order of the layout.
    initial_degC, bath_degC
        For each run, the temperatures between which the uncertainty of the fluid properties is
        evaluated.
    correlation, setup
        Correlation and disk, for the uncertainty of h.

    Returns
    -------
    mean, sd
        (P,) each; infinite where the prior is flat.

    Notes
    -----
    The uncertainty of the fluid's properties widens each scale of h. The errors of a channel with a
    static line have the covariance of that line; the error that is common to all lines acts like
    one of the bath thermometer.

    Used by the design of plunges, too, so that predicted and fitted uncertainties agree:
    ``tests/immersion/test_design_predictions.py``.
    """
    h_u_rel = []
    for run, initial, bath_temperature in zip(runs, initial_degC, bath_degC):
        bath = Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m)
        h_u_rel.append(bath.property_u_rel(initial, bath_temperature)["total"])
    mean, sd = layout.prior(priors, [run.entry.u_s for run in runs], initial_degC, h_u_rel)
    for j, channel in enumerate(layout.channels):
        line = runs[0].lines.get(channel)
        if line is None:
            continue
        _, offset_u, slope_u = smallest_uncertainty(line)
        sd[layout.at("offset").start + j] = max(offset_u, FIXED_SD)
        sd[layout.at("gain").start + j] = slope_u or priors.static_gain
        sd[layout.at("bath")] = np.hypot(priors.bath_K, line.shared_u_K)
    return mean, sd


def static_line_corrections(fit: PlungeFit) -> pd.DataFrame:
    """Corrections of the static lines by the plunges, with uncertainties before and after.

    Parameters
    ----------
    fit
        A plunge fit.

    Returns
    -------
    corrections
        One row a channel.

    Notes
    -----
    A reading after its line is taken as T + ``off_K`` + (T - ``at_degC``) ``slope_off``.
    ``u_..._before`` come from the covariance of the oven calibration, ``u_...`` include the
    plunges. A plunge determines only the differences between channels.
    """
    layout = fit.layout
    theta = fit.optimum.theta
    prior = fit.optimum.problem.sd
    u = np.sqrt(np.diag(fit.optimum.covariance))
    offset = layout.at("offset")
    slope = layout.at("gain")
    return pd.DataFrame(
        {
            "channel": layout.channels,
            "at_degC": fit.runs[0].pivot_degC,
            "off_K": theta[offset],
            "u_off_before_K": prior[offset],
            "u_off_K": u[offset],
            "slope_off": theta[slope],
            "u_slope_before": prior[slope],
            "u_slope": u[slope],
        }
    )


def with_structure_uncertainty(fit: PlungeFit) -> PlungeFit:
    """The fit with a comparison of all chain structures, whose spread widens the lags.

    The lags stay those of the fit's structure; ``structures`` of the result holds the comparison.
    """
    structures = compare_structures(
        fit.optimum,
        fit.scan,
        fit.priors,
        fit.setup.conditioning.lag_s,
        fit.model_form.u_common_s,
    )
    return replace(fit, structures=structures)


def published_degC(
    run: PlungeRun, setup: DiskSetup, correlations: Sequence[str] = THESIS_THREE
) -> dict[str, pd.DataFrame]:
    """Junctions by each published correlation, with scale of h one and no burst.

    The keys are name and title of the correlation; the tables are like those of
    :meth:`PlungeFit.junction_degC`. An example of the gallery plots them.

    Figures 5.26 and 5.27 of the thesis.

    Parameters
    ----------
    run
        The plunge.
    setup
        The disk.
    correlations
        Names of correlations.

    Returns
    -------
    tables
        By name and title of the correlation; each like
        :meth:`immersion.plunge_result.PlungeFit.junction_degC`.
    """
    blocks = make_blocks(run)
    layout = PlungeParameters(1, run.channels, "P1")
    theta = np.where(layout.mask("ln_burst"), -np.inf, 0.0)
    theta[layout.at("initial")] = np.mean(blocks.readings_degC[blocks.time_s < 0])
    tables = {}
    for published in map(find_correlation, correlations):
        (model,) = build_run_models([run], [blocks], setup, layout, published, theta)
        tables[f"{published.name} {published.title}"] = junction_degC(model, layout, theta, 0)
    return tables


def _search_optimum(
    problem: PlungeProblem, build: BuildModels, filter_lag_s: float
) -> tuple[PlungeOptimum, tuple[Finding, ...]]:
    """The optimum, and a warning where a long and a short lag fit equally well.

    Parameters
    ----------
    problem
        Problem with its models.
    build
        Builds the linearised models about given parameters.
    filter_lag_s
        Lag of the conditioning filter [s], added to the lag in the warning.

    Returns
    -------
    optimum
        The solution to report.
    findings
        A warning about the other solution, or nothing.

    Notes
    -----
    A long lag with a strong entry burst and a short lag with a weak one can both be optima. The
    search starts from the median of the burst and from a weak burst; all parameters are free from
    the first step. The costs of two solutions are compared with the same noise. Of two whose costs
    differ by less than ``CLEARLY_BETTER_CHI_SQUARE``, the one with the shorter lag is taken, and
    the warning gives the other. Test: ``tests/immersion/test_plunge_fit.py``.
    """
    burst = problem.layout.mask("ln_burst")
    weak = np.where(burst, problem.mean - WEAK_BURST_SDS * problem.sd, problem.start)
    optima = [problem.optimise(start, **FAR_SEARCH) for start in (problem.start, weak)]
    best, other = sorted(optima, key=lambda o: o.cost)
    best = _refit_with_residual_noise(best, build)
    if other.is_near(best):
        return best, ()
    other = best.problem.optimise(other.theta)
    short, long = sorted((best, other), key=lambda o: float(o.lag_s.mean()))
    excess = abs(other.cost - best.cost)
    if other.is_near(best) or excess > CLEARLY_BETTER_CHI_SQUARE:
        return min((best, other), key=lambda o: o.cost), ()
    long_lag_s = float(long.lag_s.mean()) + filter_lag_s
    return short, (warning("plunge.rival", lag_s=long_lag_s, chi_square=excess),)


def _refit_with_residual_noise(best: PlungeOptimum, build: BuildModels) -> PlungeOptimum:
    """The optimum with the noise of the residuals, and with conduction linearised about it.

    Parameters
    ----------
    best
        Optimum with the noise of the samples.
    build
        Builds the linearised models about given parameters.
    """
    for _ in range(REFITS):
        models = build(best.theta)
        problem = replace(best.problem, models=models, noise=best.residual_noise())
        best = problem.optimise(best.theta)
    return best


def compare_correlations(
    final: PlungeOptimum,
    scan: LagScan,
    chosen: Correlation,
    others: Sequence[Correlation],
    filter_lag_s: float,
) -> PlungeModelForm:
    """Refit with each of ``others`` and compare the lags.

    Parameters
    ----------
    final
        Optimum with the correlation ``chosen``.
    scan
        Its profile scan.
    chosen
        Base correlation.
    others
        Alternatives; the base correlation among them is left out.
    filter_lag_s
        Lag of the conditioning filter [s], added to the common lags.

    Returns
    -------
    form
        Common lags by correlation, and the covariance that the choice adds.

    Notes
    -----
    Each refit is made at three common lags about the result; the shift of the maximum of the
    posterior is taken. The base correlation is treated in the same way, so that skewness cancels.
    The sample covariance of the lag vectors is what the choice of correlation adds.

    The shift is limited to two standard deviations of the common lag.
    ``PlungeModelForm.covariance`` is added to that of the lags in
    :class:`immersion.plunge_result.PlungeFit`. Test: ``tests/immersion/test_plunge_fit.py``.
    """
    width = scan.sd_s
    base_shift = _maximum_shift(final, width)
    lags = {chosen.name: final.lag_s}
    for other in others:
        if other.name == chosen.name:
            continue
        at = _refit_with(final, other)
        shift = _maximum_shift(at, width) - base_shift
        shift = float(np.clip(shift, -2 * width, 2 * width))
        lags[other.name] = at.lag_s - at.lag_s.mean() + final.lag_s.mean() + shift
    covariance = np.zeros((len(final.lag_s), len(final.lag_s)))
    if len(lags) > 1:
        covariance = np.atleast_2d(np.cov(np.transpose([*lags.values()])))
    common = {name: float(row.mean() + filter_lag_s) for name, row in lags.items()}
    return PlungeModelForm(common, covariance)


def _refit_with(final: PlungeOptimum, other: Correlation) -> PlungeOptimum:
    """The optimum at the same common lag with another correlation.

    Parameters
    ----------
    final
        Optimum with the first correlation.
    other
        Another correlation.

    Returns
    -------
    optimum
        With the scale of h started so that h is the same on average.
    """
    problem = final.problem
    theta = final.theta.copy()
    models = tuple(replace(m, bath=replace(m.bath, correlation=other)) for m in problem.models)
    for r, (old, new, surface) in enumerate(zip(problem.models, models, final.surfaces)):
        T = surface.temperature_degC
        bath = old.bath_degC
        large = np.abs(bath - T) > REFIT_DIFFERENCE_SHARE * old.step_K
        ratio = old.bath.h_W_m2K(T[large], bath[large]) / new.bath.h_W_m2K(T[large], bath[large])
        theta[problem.layout.at("ln_h")][r] += float(np.log(np.mean(ratio)))
    fixed = problem.layout.common_lag[None]
    return replace(problem, models=models).optimise(theta, fixed=fixed, limit=12)


def _maximum_shift(at: PlungeOptimum, width: float) -> float:
    """Shift [s] of the maximum of the log marginal: parabola through three values about ``at``.

    Parameters
    ----------
    at
        Optimum; its common lag is the middle of the three.
    width
        Distance of the outer two [s].

    Returns
    -------
    shift
        [s]; zero where the parabola has no maximum.
    """
    weights = at.problem.layout.common_lag
    lag = float(at.lag_s.mean())
    low = -0.5 * marginal_deviance(
        minimise_constrained(at.solution, weights, lag - width, **SEARCH)
    )
    middle = -0.5 * marginal_deviance(at.solution)
    high = -0.5 * marginal_deviance(
        minimise_constrained(at.solution, weights, lag + width, **SEARCH)
    )
    curvature = high - 2 * middle + low
    if curvature >= 0:
        return 0.0
    return float(-width * (high - low) / (2 * curvature))
