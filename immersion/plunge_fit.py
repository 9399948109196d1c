"""Grey-box identification of a disk's measurement chains from its plunges, all channels and runs at once."""

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
from immersion.plunge_parameters import KNOWN, PlungeParameters, PlungePriors
from immersion.plunge_posterior import (
    SEARCH,
    LagScan,
    ModelForm,
    PlungeOptimum,
    PlungeProblem,
    marginal,
    settled_scan,
)
from immersion.plunge_result import PlungeFit
from tcdyn.chain import STRUCTURES, Chain
from tcdyn.chain.bursts import noise_and_white
from tcdyn.chain.logger_noise import TYPICAL_LAG_S, LoggerNoise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.estimation import held
from tcdyn.estimation.trace_noise import SPIKES, white_noise_sd
from tcdyn.rig.disk import Conditioning, DiskSetup
from tcdyn.rig.static_line import best_known

Models = Callable[[Array], tuple[RunModel, ...]]


def identify_plunges(
    runs: Sequence[PlungeRun],
    setup: DiskSetup,
    *,
    correlation: str | Correlation = "churchill-chu-laminar",
    structure: str = "P2",
    priors: PlungePriors | None = None,
    alternatives: Sequence[str] = THESIS_THREE,
) -> PlungeFit:
    """Chains of the channels of one disk from one or more plunges.

    Model: radial conduction from bore to running surface, h = s (|dT|/dT_0)^m h_correlation (1 + A exp(-(t/tau)^p)),
    junction -> chain (structure, with the known conditioning filter) -> static line. Per run s, m, A, tau, p, entry
    time, initial and bath temperature are free within ``priors``; per channel the lag, its split, depth and static
    remainders; the conductivity is common. The answer is the most probable parameter set, its covariance the inverse
    Hessian with the noise judged from the residuals. Each of ``alternatives`` is fitted too; the spread of the lags
    between correlations is added to their covariance.

    Raises InputError when runs have different channels or too little data.
    """
    if not runs:
        raise InputError("no plunge was given", expected="one immersion log or more")
    channels = runs[0].channels
    if any(r.channels != channels for r in runs):
        raise InputError("the plunges have different channels", expected=", ".join(channels))
    if structure not in STRUCTURES:
        raise InputError(f"unknown chain structure {structure!r}", expected=", ".join(STRUCTURES))
    priors = priors or PlungePriors()
    chosen = find_correlation(correlation)
    noise, white = _made_white(runs, setup.conditioning)
    behind = replace(
        setup, conditioning=noise.behind(Chain((), conditioning=setup.conditioning)).conditioning
    )
    blocks = [make_blocks(r) for r in white]
    layout = PlungeParameters(len(runs), channels, structure)
    initial = [float(np.nanmean(b.readings_degC[b.time_s < 0])) for b in blocks]
    mean, sd = full_prior(
        layout, priors, runs, initial, [float(b.bath_degC[0]) for b in blocks], chosen, setup
    )

    def built(about: Array) -> tuple[RunModel, ...]:
        return build_run_models(runs, blocks, behind, layout, chosen, about)

    problem = PlungeProblem((), layout, mean, sd, tuple(RunNoise.white(b) for b in blocks))
    best, rival = _best_of_two(
        replace(problem, models=built(problem.start)), built, behind.conditioning.lag_s
    )
    scan, best, _ = settled_scan(best)
    form = model_form(
        best,
        scan,
        chosen,
        [find_correlation(name) for name in alternatives],
        setup.conditioning.lag_s,
    )
    return PlungeFit(setup, chosen.name, priors, form, rival, tuple(runs), best, scan, noise)


def _made_white(
    runs: Sequence[PlungeRun], filter_: Conditioning
) -> tuple[LoggerNoise, list[PlungeRun]]:
    """The noise of all runs together, and the runs with it made white, without spikes and bursts."""
    clean = [without_spikes(run.readings_degC)[0] for run in runs]
    white_K = np.mean([white_noise_sd(y) for y in clean], axis=0)
    usual = Chain((TYPICAL_LAG_S,), conditioning=filter_)
    dts = [run.dt_s for run in runs]
    chains = [usual] * len(white_K)
    noise, white = noise_and_white(clean, dts, filter_, white_K, chains, SPIKES["plunge"])
    kept = [np.where(np.isfinite(y) & ~moved, z, np.nan) for y, (z, moved) in zip(clean, white)]
    return noise, [replace(run, readings_degC=y) for run, y in zip(runs, kept)]


def full_prior(
    layout: PlungeParameters,
    priors: PlungePriors,
    runs: Sequence[PlungeRun],
    initial_degC: Sequence[float],
    bath_degC: Sequence[float],
    correlation: Correlation,
    setup: DiskSetup,
) -> tuple[Array, Array]:
    """Mean and standard deviation of all parameters before the data; each h scale widened by its fluid's properties.

    A channel with a static line errs as that line's covariance says; what all lines share acts as a bath does.
    ``initial_degC`` and ``bath_degC`` (runs,) are the temperatures between which those properties are taken.
    """
    baths = [Bath(run.fluid, correlation, setup.width_m, 2 * setup.outer_radius_m) for run in runs]
    h_u_rel = [b.property_u_rel(*span)["total"] for b, *span in zip(baths, initial_degC, bath_degC)]
    mean, sd = layout.prior(priors, [run.entry.u_s for run in runs], initial_degC, h_u_rel)
    for j, c in enumerate(layout.channels):
        if (line := runs[0].lines.get(c)) is not None:
            _, there, slope = best_known(line)
            sd[layout.at("offset").start + j] = max(there, KNOWN)
            sd[layout.at("gain").start + j] = slope or priors.static_gain
            sd[layout.at("bath")] = np.hypot(priors.bath_K, line.shared_u_K)
    return mean, sd


def moved_lines(fit: PlungeFit) -> pd.DataFrame:
    """What the plunges say of the static lines, one row a channel, beside what was known before.

    A reading after its line is taken as T + ``off_K`` + (T - ``at_degC``) ``slope_off``; ``u_..._before`` are those of
    the oven's covariance, ``u_...`` with the plunges. Only what differs between the channels is told by a plunge.
    """
    lay = fit.layout
    theta = fit.optimum.theta
    prior = fit.optimum.problem.sd
    u = np.sqrt(np.diag(fit.optimum.covariance))
    off = lay.at("offset")
    slope = lay.at("gain")
    return pd.DataFrame(
        {
            "channel": lay.channels,
            "at_degC": fit.runs[0].pivot_degC,
            "off_K": theta[off],
            "u_off_before_K": prior[off],
            "u_off_K": u[off],
            "slope_off": theta[slope],
            "u_slope_before": prior[slope],
            "u_slope": u[slope],
        }
    )


def with_structure_doubt(fit: PlungeFit) -> PlungeFit:
    """The fit with every other chain structure tried on its plunges, and the lags' covariance widened by the spread.

    The lags stay those of the fit's own structure; ``structures`` holds the comparison.
    """
    own = fit.setup.conditioning.lag_s
    return replace(
        fit,
        structures=compare_structures(
            fit.optimum, fit.scan, fit.priors, own, fit.model_form.u_common_s
        ),
    )


def published_degC(
    run: PlungeRun, setup: DiskSetup, correlations: Sequence[str] = THESIS_THREE
) -> dict[str, pd.DataFrame]:
    """Junctions by each correlation as published, h scale one, no burst (figures 5.26 and 5.27), by the names of both.

    Tables as those of :meth:`PlungeFit.junction_degC`; ``tcdyn.plots.draw_entry(run, tables, ax)`` draws them.
    """
    blocks = make_blocks(run)
    layout = PlungeParameters(1, run.channels, "P1")
    theta = np.where(layout.mask("ln_burst"), -np.inf, 0.0)
    theta[layout.at("initial")] = np.mean(blocks.readings_degC[blocks.time_s < 0])
    out = {}
    for chosen in map(find_correlation, correlations):
        (model,) = build_run_models([run], [blocks], setup, layout, chosen, theta)
        out[f"{chosen.name} {chosen.title}"] = junction_degC(model, layout, theta, 0)
    return out


def _best_of_two(
    problem: PlungeProblem, built: Models, own_lag_s: float
) -> tuple[PlungeOptimum, tuple[Finding, ...]]:
    """The optimum, and a finding when a long lag under a fierce burst fits as well as a short one under a mild burst.

    A second search, with everything free from the first step, is made when the first did not settle or ended beyond
    1.5 s; of two solutions whose cost differs by less than 6 the shorter lag is taken, and the other is named.
    """
    best = fit_map(problem, built)
    long = float(np.mean(best.lag_s))
    if best.found.converged and long < 1.5:
        return best, ()
    other = fit_map(problem, built, staged=False)
    short = float(np.mean(other.lag_s))
    gap = other.cost - best.cost
    if gap > 6.0 or (short > long and gap > 0):
        return best, ()
    if gap < -6.0 or abs(long - short) < 0.3:
        return other, ()
    return other, (warning("plunge.rival", lag_s=long + own_lag_s, chi_square=abs(gap)),)


def fit_map(
    problem: PlungeProblem, built: Models, *, staged: bool = True, passes: int = 2
) -> PlungeOptimum:
    """Fit, judge the noise by the residuals, relinearise the conduction about the answer, and fit again.

    The models of ``problem`` are those ``built`` about its :attr:`PlungeProblem.start`; ``passes`` counts the refits.
    ``staged``: h and the initial temperature are sought first, then lags and static offsets with them; near the
    valley all the rest follows.
    """
    layout = problem.layout
    about = problem.start
    theta = about
    first = ("ln_h", "initial")
    for kinds in (first, (*first, "lag", "offset")) if staged else ():
        theta = problem.minimised(theta, np.eye(layout.size)[~layout.mask(*kinds)], limit=6).theta
    best = problem.minimised(theta)
    for _ in range(passes):
        moved = np.abs(best.theta - about)
        if np.any(moved[layout.at("ln_conductivity")] > 2e-3) or np.any(
            moved[layout.at("depth")] > 2e-5
        ):
            about = best.theta
            problem = replace(problem, models=built(best.theta))
        best = replace(problem, noise=best.judged()).minimised(best.theta)
    return best


def model_form(
    final: PlungeOptimum,
    scan: LagScan,
    chosen: Correlation,
    others: Sequence[Correlation],
    own_lag_s: float,
) -> ModelForm:
    """Refit under each of ``others`` at three common lags about the answer; take the shift of the posterior's top.

    The base correlation is judged at the same three lags, so that skewness cancels. The spread of the lag vectors
    (sample covariance) is what the choice of correlation adds.
    """
    width = scan.sd_s
    others = [other for other in others if other.name != chosen.name]
    base_top = _top(final, width)
    lags = [final.lag_s]
    cost = {chosen.name: final.cost}
    for other in others:
        at = _under(final, other)
        shift = float(np.clip(_top(at, width) - base_top, -2 * width, 2 * width))
        lags.append(at.lag_s - at.lag_s.mean() + final.lag_s.mean() + shift)
        cost[other.name] = at.cost
    spread = (
        np.cov(np.transpose(lags))
        if len(lags) > 1
        else np.zeros((len(final.lag_s), len(final.lag_s)))
    )
    common = {name: float(row.mean() + own_lag_s) for name, row in zip(cost, lags)}
    return ModelForm(common, cost, np.atleast_2d(spread))


def _under(final: PlungeOptimum, other: Correlation) -> PlungeOptimum:
    """The optimum with the same common lag under another correlation; h scales are moved first."""
    problem = final.problem
    theta = final.theta.copy()
    models = tuple(replace(m, bath=replace(m.bath, correlation=other)) for m in problem.models)
    for r, (old, new, surface) in enumerate(zip(problem.models, models, final.surfaces)):
        T = surface.temperature_degC
        bath = old.bath_degC
        early = np.abs(bath - T) > 0.3 * old.step_K
        ratio = old.bath.h_W_m2K(T[early], bath[early]) / new.bath.h_W_m2K(T[early], bath[early])
        theta[problem.layout.at("ln_h")][r] += float(np.log(np.mean(ratio)))
    return replace(problem, models=models).minimised(
        theta, problem.layout.common_lag[None], limit=12
    )


def _top(at: PlungeOptimum, width: float) -> float:
    """Shift [s] of the top of the parabola through the log marginal at -width, 0, +width about ``at``."""
    row = at.problem.layout.common_lag
    lag = float(at.lag_s.mean())
    low, middle, high = (
        -0.5 * marginal(held(at.found, row, lag + shift, **SEARCH) if shift else at.found)
        for shift in (-width, 0.0, width)
    )
    curvature = high - 2 * middle + low
    return float(-width * (high - low) / (2 * curvature)) if curvature < 0 else 0.0
