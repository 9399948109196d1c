"""Grey-box identification of a disk's measurement chains from its plunges, all channels and runs at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import DiskSetup
from calibration.errors import InputError
from immersion.correlations import THESIS_THREE, Bath, Correlation, check_validity
from immersion.correlations import correlation as find_correlation
from tcdyn.chain import Chain
from tcdyn.plunge.form import ModelForm, model_form
from tcdyn.plunge.layout import STRUCTURES, Layout, Structure, stages
from tcdyn.plunge.map import Optimum, fit_map
from tcdyn.plunge.prior import PlungePriors
from tcdyn.plunge.result import PlungeFit, known_burst_u, lag_estimates, lag_shares, split_lags
from tcdyn.plunge.run import Blocks, PlungeRun, make_blocks
from tcdyn.plunge.scan import LagScan, lag_covariance, settled_scan
from tcdyn.plunge.words import fit_warnings, lag_sentence

Array = NDArray[np.float64]


def identify_plunges(
    runs: Sequence[PlungeRun],
    setup: DiskSetup,
    *,
    correlation: str | Correlation = "churchill-chu-laminar",
    structure: Structure = "P2",
    priors: PlungePriors | None = None,
    alternatives: Sequence[str] = THESIS_THREE,
    face_W_m2K: float = 0.0,
) -> PlungeFit:
    """Chains of the channels of one disk from one or more plunges.

    Model: radial conduction from bore to running surface, h = s (|dT|/dT_0)^m h_correlation (1 + A exp(-(t/tau)^p)),
    junction -> chain (structure, with the known conditioning filter) -> static line. Per run s, m, A, tau, p, entry
    time, initial and bath temperature are free within ``priors``; per channel the lag, its split, depth and static
    remainders; the conductivity is common. The answer is the most probable parameter set, its covariance the inverse
    Hessian with the noise judged from the residuals. Each of ``alternatives`` is fitted too; the spread of the lags
    between correlations is added to their covariance. ``face_W_m2K`` is a leak through each side face.

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
    blocks = [make_blocks(r) for r in runs]
    layout = Layout(len(runs), channels, structure)
    initial = [_initial(b) for b in blocks]
    mean, sd = full_prior(layout, priors, runs, initial, [float(b.bath_degC[0]) for b in blocks], chosen, setup)
    best, rival = _best_of_two(runs, blocks, setup, layout, chosen, mean, sd, face_W_m2K)
    scan, best, _ = settled_scan(best)
    others = [find_correlation(name) for name in alternatives]
    form = model_form(best, scan, chosen, others, setup.conditioning.lag_s)
    return _result(runs, blocks, setup, chosen, layout, priors, best, scan, form, rival)


def full_prior(
    layout: Layout,
    priors: PlungePriors,
    runs: Sequence[PlungeRun],
    initial_degC: Sequence[float],
    bath_degC: Sequence[float],
    correlation: Correlation,
    setup: DiskSetup,
) -> tuple[Array, Array]:
    """Mean and standard deviation of all parameters before the data; each h scale widened by its fluid's properties.

    ``initial_degC`` and ``bath_degC`` (runs,) are the temperatures between which those properties are taken.
    """
    mean, sd = layout.prior(priors, [run.entry.u_s for run in runs], list(initial_degC))
    for r, run in enumerate(runs):
        known = _bath(run, correlation, setup).property_u_rel(initial_degC[r], bath_degC[r])["total"]
        sd[layout.run(r).start] = float(np.hypot(priors.h_scale_log, known))
    return mean, sd


def _result(
    runs: Sequence[PlungeRun],
    blocks: Sequence[Blocks],
    setup: DiskSetup,
    chosen: Correlation,
    layout: Layout,
    priors: PlungePriors,
    best: Optimum,
    scan: LagScan,
    form: ModelForm,
    rival: tuple[str, ...],
) -> PlungeFit:
    channels = layout.channels
    own = setup.conditioning.lag_s
    lag = best.theta[layout.lag] + own
    covariance = lag_covariance(scan) + form.covariance
    _, differential = split_lags(lag, covariance, channels)
    common = scan.estimate(own, form.u_common_s)
    validity = tuple(
        check_validity(_bath(r, chosen, setup), s.temperature_degC, m.bath_degC)
        for r, s, m in zip(runs, best.surfaces, best.problem.models)
    )
    return PlungeFit(
        disk=setup.name,
        structure=layout.structure,
        correlation=chosen.name,
        channels=channels,
        chains={c: _chain(best.theta, layout, j, setup) for j, c in enumerate(channels)},
        lag_s=lag_estimates(lag, scan, form.covariance, channels),
        lag_covariance=covariance,
        common_lag_s=common,
        differential_lag_s=differential,
        nuisances=_nuisances(best),
        budget=lag_shares(best, scan, form),
        model_form=form,
        validity=validity,
        warnings=(*rival, *fit_warnings(runs, blocks, best, validity)),
        sentence=lag_sentence(common, common.u, known_burst_u(best), len(runs)),
        converged=best.converged,
        priors=priors,
        setup=setup,
        runs=tuple(runs),
        optimum=best,
        scan=scan,
    )


def _best_of_two(
    runs: Sequence[PlungeRun],
    blocks: Sequence[Blocks],
    setup: DiskSetup,
    layout: Layout,
    chosen: Correlation,
    mean: Array,
    sd: Array,
    face_W_m2K: float,
) -> tuple[Optimum, tuple[str, ...]]:
    """The optimum, and a warning when a long lag under a fierce burst fits as well as a short one under a mild burst.

    A second start, from a lag of 0.5 s, is made when the first did not settle or ended beyond 1.5 s; of two solutions
    whose cost differs by less than 6 the shorter lag is taken, and the other is named.
    """
    best = fit_map(runs, blocks, setup, layout, chosen, mean, sd, face_W_m2K=face_W_m2K)
    long = float(np.mean(best.theta[layout.lag]))
    if best.converged and long < 1.5:
        return best, ()
    start = mean.copy()
    start[layout.lag] = 0.5
    other = fit_map(runs, blocks, setup, layout, chosen, mean, sd, start=start, face_W_m2K=face_W_m2K)
    short, gap = float(np.mean(other.theta[layout.lag])), other.cost - best.cost
    if gap > 6.0 or (short > long and gap > 0):
        return best, ()
    if gap < -6.0:
        return other, ()
    if abs(long - short) < 0.3:
        return other, ()
    own = setup.conditioning.lag_s
    text = f"a second solution, with a common lag of {long + own:.1f} s and a stronger entry burst, fits about as well"
    return other, (f"{text} (chi-square differs by {abs(gap):.1f})",)


def _initial(blocks: Blocks) -> float:
    return float(np.nanmean(blocks.readings_degC[blocks.time_s < 0]))


def _bath(run: PlungeRun, chosen: Correlation, setup: DiskSetup) -> Bath:
    return Bath(run.fluid, chosen, setup.width_m, 2 * setup.outer_radius_m)


def _chain(theta: Array, layout: Layout, j: int, setup: DiskSetup) -> Chain:
    taus, delay, zero = stages(
        layout.structure, float(theta[layout.lag][j]), float(theta[layout.common_split] + theta[layout.split][j])
    )
    return Chain(tuple(float(t) for t in taus), zero_s=zero, delay_s=delay, conditioning=setup.conditioning)


def _nuisances(best: Optimum) -> pd.DataFrame:
    problem = best.problem
    return pd.DataFrame(
        {
            "parameter": problem.layout.names(),
            "value": best.theta,
            "u": np.sqrt(np.diag(best.covariance)),
            "prior_mean": np.where(np.isfinite(problem.sd), problem.mean, np.nan),
            "prior_sd": np.where(np.isfinite(problem.sd), problem.sd, np.nan),
        }
    )
