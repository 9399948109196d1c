"""What a planned set of plunges will tell: Fisher information of the very model that the fit uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.disk import CHANNELS, DiskSetup
from immersion.correlations import correlation as find_correlation
from immersion.events import EntryEvent
from immersion.fluids import Fluid, fluid
from tcdyn.design import PredictedTest, covariance, from_covariances
from tcdyn.plunge import PlungeParameters, PlungePriors
from tcdyn.plunge.fit import full_prior
from tcdyn.plunge.model import build_run_model
from tcdyn.plunge.posterior import PlungeProblem
from tcdyn.plunge.run import PlungeBlocks, PlungeRun, RunNoise, make_averages


@dataclass(frozen=True)
class PlungePlan:
    """One planned plunge: bath, duration after entry, logging rate, noise of one sample, u of the entry time."""

    fluid: str | Fluid = "mobil-jet-ii"
    bath_degC: float = 110.0
    initial_degC: float = 25.0
    duration_s: float = 140.0
    rate_Hz: float = 75.0
    noise_K: float = 0.12
    entry_u_s: float = 0.05
    before_s: float = 5.0


def predict_plunges(
    plans: Sequence[PlungePlan],
    setup: DiskSetup,
    *,
    lag_s: float = 0.65,
    structure: str = "P2",
    correlation: str = "churchill-chu-laminar",
    priors: PlungePriors | None = None,
    draws: int = 24,
    seed: int = 0,
) -> PredictedTest:
    """Expected uncertainty of the lags from ``plans`` fitted together; ``lag_s`` is the chains' own expected lag.

    The covariance is the inverse of Fisher information plus prior at each of ``draws`` values of what nobody can plan
    (h scale, burst, split of the lag, drawn from the priors), and their mean. Nothing is simulated or fitted.
    """
    layout = PlungeParameters(len(plans), CHANNELS, structure)
    chosen = find_correlation(correlation)
    planned = [_planned(plan) for plan in plans]
    starts, baths = [p.initial_degC for p in plans], [p.bath_degC for p in plans]
    mean, sd = full_prior(layout, priors or PlungePriors(), [run for run, _ in planned], starts, baths, chosen, setup)
    nominal = np.where(layout.mask("lag"), lag_s, mean)
    models = [build_run_model(*each, setup, layout, chosen, nominal, r) for r, each in enumerate(planned)]
    noise = tuple(RunNoise.white(blocks) for _, blocks in planned)
    problem = PlungeProblem(tuple(models), layout, mean, sd, noise)
    rng = np.random.default_rng(seed)
    covariances = []
    for _ in range(max(draws, 1)):
        theta = nominal.copy()
        if draws > 1:
            for at in map(layout.run, range(layout.runs)):
                five = slice(at.start, at.start + 5)
                theta[five] += sd[five] * np.clip(rng.standard_normal(5), -2.5, 2.5)
            theta[layout.at("common_split")] += sd[layout.at("common_split")] * rng.standard_normal()
        covariances.append(covariance(problem.evaluate(theta)[1], sd))
    u_h, _, u_burst = np.sqrt(np.mean([np.diag(c)[:3] for c in covariances], axis=0))
    lags = [c[layout.at("lag"), layout.at("lag")] for c in covariances]
    substance = plans[0].fluid if isinstance(plans[0].fluid, str) else plans[0].fluid.name
    baths_said = ", ".join(f"{bath:g}" for bath in baths)
    label = f"{len(plans)} plunge{'s' if len(plans) > 1 else ''}, {substance}, {baths_said} degC"
    return from_covariances(label, "plunge", lags, {"u_h_rel": float(u_h), "u_ln_burst": float(u_burst)})


def _planned(plan: PlungePlan) -> tuple[PlungeRun, PlungeBlocks]:
    substance = fluid(plan.fluid) if isinstance(plan.fluid, str) else plan.fluid
    dt = 1 / plan.rate_Hz
    t = np.asarray(np.arange(-plan.before_s, plan.duration_s, dt), dtype=float)
    flat = np.full((len(t), len(CHANNELS)), plan.initial_degC)
    event = EntryEvent(0.0, plan.entry_u_s, None, None, "planned")
    run = PlungeRun(t, flat, CHANNELS, substance, np.full(len(t), plan.bath_degC), event)
    time, mean, count = make_averages(t, flat, dt, 2.0)
    bath_t = np.array([0.0, plan.duration_s])
    noise = np.full(len(CHANNELS), plan.noise_K)
    return run, PlungeBlocks(time, mean, count, noise, bath_t, np.full(2, plan.bath_degC), float(t[-1]), 0)
