"""What a planned set of plunges will tell: Fisher information of the very model that the fit uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.arrays import Array
from calibration.disk import CHANNELS, DiskSetup
from immersion.correlations import correlation as find_correlation
from immersion.events import EntryEvent
from immersion.fluids import Fluid, fluid
from tcdyn.design import PredictedTest, from_covariances
from tcdyn.plunge.model import build_run_model
from tcdyn.plunge.parameters import PlungeParameters, PlungePriors
from tcdyn.plunge.posterior import PlungeProblem, RunNoise, full_prior, inverse, normal_equations
from tcdyn.plunge.run import PlungeBlocks, PlungeRun, make_averages


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
    channels: tuple[str, ...] = CHANNELS,
    draws: int = 24,
    seed: int = 0,
    name: str | None = None,
) -> PredictedTest:
    """Expected uncertainty of the lags from ``plans`` fitted together; ``lag_s`` is the chains' own expected lag.

    The covariance is the inverse of Fisher information plus prior at each of ``draws`` values of what nobody can plan
    (h scale, burst, split of the lag, drawn from the priors), and their mean. Nothing is simulated or fitted.
    """
    layout = PlungeParameters(len(plans), channels, structure)
    chosen = find_correlation(correlation)
    planned = [_planned(plan, channels) for plan in plans]
    starts, baths = [p.initial_degC for p in plans], [p.bath_degC for p in plans]
    mean, sd = full_prior(layout, priors or PlungePriors(), [run for run, _ in planned], starts, baths, chosen, setup)
    models = [build_run_model(run, blocks, setup, layout, chosen) for run, blocks in planned]
    noise = tuple(RunNoise.white(blocks) for _, blocks in planned)
    problem = PlungeProblem(tuple(models), layout, mean, sd, noise)
    rng = np.random.default_rng(seed)
    covariances, scales, bursts = [], [], []
    for _ in range(max(draws, 1)):
        theta = _drawn(mean, sd, layout, lag_s, rng) if draws > 1 else _centred(mean, layout, lag_s)
        covariance = inverse(normal_equations(problem, theta, [None] * len(plans))[2])
        covariances.append(covariance[layout.at("lag"), layout.at("lag")])
        scales.append(covariance[0, 0])
        bursts.append(covariance[2, 2])
    others = {"u_h_rel": float(np.sqrt(np.mean(scales))), "u_ln_burst": float(np.sqrt(np.mean(bursts)))}
    first = plans[0]
    substance = first.fluid if isinstance(first.fluid, str) else first.fluid.name
    label = (
        name
        or f"{len(plans)} plunge{'s' if len(plans) > 1 else ''}, {substance}, "
        + ", ".join(f"{p.bath_degC:g}" for p in plans)
        + " degC"
    )
    return from_covariances(label, "plunge", covariances, others)


def _planned(plan: PlungePlan, channels: tuple[str, ...]) -> tuple[PlungeRun, PlungeBlocks]:
    substance = fluid(plan.fluid) if isinstance(plan.fluid, str) else plan.fluid
    dt = 1 / plan.rate_Hz
    t = np.asarray(np.arange(-plan.before_s, plan.duration_s, dt), dtype=float)
    flat = np.full((len(t), len(channels)), plan.initial_degC)
    event = EntryEvent(0.0, plan.entry_u_s, None, None, "planned")
    run = PlungeRun(t, flat, channels, substance, np.full(len(t), plan.bath_degC), event)
    time, mean, count = make_averages(t, flat, dt, 2.0)
    bath_t = np.array([0.0, plan.duration_s])
    noise = np.full(len(channels), plan.noise_K)
    return run, PlungeBlocks(time, mean, count, noise, bath_t, np.full(2, plan.bath_degC), float(t[-1]), 0)


def _centred(mean: Array, layout: PlungeParameters, lag_s: float) -> Array:
    theta = mean.copy()
    theta[layout.at("lag")] = lag_s
    return theta


def _drawn(mean: Array, sd: Array, layout: PlungeParameters, lag_s: float, rng: np.random.Generator) -> Array:
    theta = _centred(mean, layout, lag_s)
    for r in range(layout.runs):
        at = layout.run(r)
        theta[at.start : at.start + 5] += sd[at.start : at.start + 5] * np.clip(rng.standard_normal(5), -2.5, 2.5)
    theta[layout.at("common_split")] += sd[layout.at("common_split")] * rng.standard_normal()
    return theta
