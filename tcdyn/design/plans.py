"""Planned plunges, load steps and touches, and their expected lag uncertainty.

Plunges use the Fisher information of the model that the fit uses. Load steps of an EHL test and
touches with a soldering iron end within seconds and have models of their own.

``tcdyn.design.compare`` uses it. Guarded by ``tests/immersion/test_design_predictions.py``, which
compares plunges with simulated fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np
from scipy.linalg import block_diag
from scipy.special import erfc

from immersion.correlations import correlation as find_correlation
from immersion.cylinder import Cylinder
from immersion.entry import EntryEvent
from immersion.fluids import Fluid, fluid
from immersion.plunge_data import PlungeBlocks, PlungeRun, RunNoise, make_averages
from immersion.plunge_fit import full_prior
from immersion.plunge_model import build_run_models
from immersion.plunge_parameters import H_KINDS, PlungeParameters, PlungePriors, stages
from immersion.plunge_posterior import PlungeProblem
from immersion.radial import simulate_plunge_model
from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.design.prediction import PredictedTest, from_covariances, jacobian, posterior_covariance
from tcdyn.heat.modal import rim_gains
from tcdyn.heat.rim import InputJump, Mesh, Rim, basis_rates, junction_points, lag_basis
from tcdyn.rig.disk import DiskSetup

# Prior standard deviation of the logit by which a lag is split into two; chosen by judgement.
LAG_SPLIT_PRIOR_SD = 1.5
# Relative standard deviation of the expected lag. Chosen by judgement.
EXPECTED_LAG_SD_REL = 0.2
# Samples and the end points of their fits are clipped to so many prior standard deviations;
# chosen by judgement.
MAX_PRIOR_SDS = 2.5
# The lag at which such a fit ends is at least this share of the true lag; chosen by
# judgement.
MIN_LAG_SHARE = 0.2


@dataclass(frozen=True)
class PlungePlan:
    """One planned plunge.

    Parameters
    ----------
    fluid
        Name of the fluid, or a fluid.
    bath_degC, initial_degC
        Temperature of the bath, and of the disk before it.
    duration_s, before_s
        Time after the entry, and before it.
    rate_Hz
        Sampling rate.
    noise_K
        Noise of one sample.
    entry_u_s
        Standard uncertainty of the entry time.
    """

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
) -> PredictedTest:
    """Predict the lag uncertainty of ``plans`` fitted together.

    Parameters
    ----------
    plans
        The planned plunges.
    setup
        The disk.
    lag_s
        Expected lag of the chain, without conditioning [s].
    structure
        Chain structure of the fit.
    correlation
        Heat transfer correlation of the fit.
    priors
        Priors of the fit; the defaults if None.
    draws
        Number of Monte Carlo samples of the conditions that cannot be planned; with 1 the nominal
        conditions are used.

    Notes
    -----
    For each sample of h and its form, the burst, the split of the lag and the other parameters
    (from the priors; the lag within 20 %) the covariance is the inverse of Fisher information plus
    prior, evaluated where the fit would end: one linear step, theta + C (J' noise - (theta -
    mean)/sd^2). The fit reports the covariance at that point. In the valley of lag against burst it
    is on average larger than at the truth. Nothing is simulated or fitted.

    The seed is fixed, so that equal plans have equal predictions. The priors must be those of
    ``immersion.plunge_fit``: ``tests/immersion/test_design_predictions.py`` compares with the
    uncertainties that simulated fits state.
    """
    layout = PlungeParameters(len(plans), setup.channels, structure)
    chosen = find_correlation(correlation)
    planned = [_planned_run(plan, setup.channels) for plan in plans]
    starts = [p.initial_degC for p in plans]
    baths = [p.bath_degC for p in plans]
    mean, sd = full_prior(
        layout, priors or PlungePriors(), [run for run, _ in planned], starts, baths, chosen, setup
    )
    nominal = np.where(layout.mask("lag"), lag_s, mean)
    runs, blocks = zip(*planned)
    models = build_run_models(runs, blocks, setup, layout, chosen, nominal)
    noise = tuple(map(RunNoise.white, blocks))
    problem = PlungeProblem(models, layout, mean, sd, noise)
    rng = np.random.default_rng(0)
    covariances = [] if draws > 1 else [posterior_covariance(problem.evaluate(nominal)[1], sd)]
    # the readings tell where it began
    lag = layout.mask("lag")
    fixed = ~np.isfinite(sd) | layout.mask("initial")
    for _ in range(draws if draws > 1 else 0):
        sample = np.clip(rng.standard_normal(layout.size), -MAX_PRIOR_SDS, MAX_PRIOR_SDS)
        theta = nominal + np.where(fixed, 0.0, sd) * sample
        theta[lag] *= np.exp(EXPECTED_LAG_SD_REL * rng.standard_normal())
        rows = problem.evaluate(theta)[1]
        score = rows.T @ rng.standard_normal(len(rows)) - (theta - nominal) / sd**2
        estimate = theta + posterior_covariance(rows, sd) @ score
        clipped = np.clip(estimate, nominal - MAX_PRIOR_SDS * sd, nominal + MAX_PRIOR_SDS * sd)
        estimate = np.where(lag, np.maximum(estimate, MIN_LAG_SHARE * theta), clipped)
        covariances.append(posterior_covariance(problem.evaluate(estimate)[1], sd))
    u_h, *_, u_burst = np.sqrt(
        np.mean([np.diag(c)[: len(H_KINDS) + 1] for c in covariances], axis=0)
    )
    lags = [c[layout.at("lag"), layout.at("lag")] for c in covariances]
    substance = plans[0].fluid if isinstance(plans[0].fluid, str) else plans[0].fluid.name
    bath_text = ", ".join(f"{bath:g}" for bath in baths)
    label = f"{len(plans)} plunge{'s' if len(plans) > 1 else ''}, {substance}, {bath_text} degC"
    return from_covariances(
        label, "plunge", lags, {"u_h_rel": float(u_h), "u_ln_burst": float(u_burst)}
    )


def _planned_run(plan: PlungePlan, channels: tuple[str, ...]) -> tuple[PlungeRun, PlungeBlocks]:
    """A planned plunge as a run without noise, and its averages in blocks.

    Parameters
    ----------
    plan
        The plan.
    channels
        Channels of the disk.

    Returns
    -------
    run, blocks
        The readings stay at the initial temperature; only their Jacobian is used.
    """
    substance = fluid(plan.fluid) if isinstance(plan.fluid, str) else plan.fluid
    dt = 1 / plan.rate_Hz
    t = np.asarray(np.arange(-plan.before_s, plan.duration_s, dt), dtype=float)
    flat = np.full((len(t), len(channels)), plan.initial_degC)
    event = EntryEvent(0.0, plan.entry_u_s, None, None, "planned")
    run = PlungeRun(t, flat, channels, substance, np.full(len(t), plan.bath_degC), event)
    time, mean, count = make_averages(t, flat, dt, 2.0)
    bath_t = np.array([0.0, plan.duration_s])
    noise = np.full(len(channels), plan.noise_K)
    return run, PlungeBlocks(
        time, mean, count, noise, bath_t, np.full(2, plan.bath_degC), float(t[-1]), 0
    )


@dataclass(frozen=True)
class StepPlan:
    """One planned step of load.

    Parameters
    ----------
    kind
        Unloading or loading.
    power_W
        Heat into this disk under load.
    h_W_m2K
        Heat-transfer coefficient of the running surface.
    half_width_m
        Half-width of the contact.
    window_s
        Time after the step.
    rate_Hz
        Sampling rate.
    noise_K
        Noise of one sample.
    instant_u_s
        Standard uncertainty of the instant of the step.
    power_log_u, h_log_u, conductivity_log_u
        Prior standard deviations of the logarithms; the heat partition is all but unknown.
    offset_K
        Prior standard deviation of each outer channel against the inner row.
    depth_u_m
        Prior standard deviation of a depth.
    channel_lag_sd_s
        Prior standard deviation of a channel's lag about the common one.
    """

    kind: Literal["unloading", "loading"] = "unloading"
    power_W: float = 100.0
    h_W_m2K: float = 700.0
    half_width_m: float = 1.0e-3
    window_s: float = 5.0
    rate_Hz: float = 75.0
    noise_K: float = 0.12
    instant_u_s: float = 0.01
    power_log_u: float = 1.0  # heat partition: all but unknown
    h_log_u: float = 0.3
    offset_K: float = 0.3  # of each outer channel against the boundary row
    conductivity_log_u: float = 0.03
    depth_u_m: float = 1e-4
    channel_lag_sd_s: float = 0.05  # prior sd of a channel's lag about the common one


def predict_step(plan: StepPlan, setup: DiskSetup, *, lag_s: float = 0.65) -> PredictedTest:
    """Expected uncertainty of the lags from one step of load, by Fisher information.

    Parameters
    ----------
    plan
        The planned step.
    setup
        The disk.
    lag_s
        Expected lag of the chain, without conditioning [s].

    Notes
    -----
    In the commuted form the inner row's lagged readings drive the rim, so a lag common to all
    channels acts on the response to the friction only, whose instant the contact switch shows.
    Free: lags, their split, power into the disk, h, conductivity, outer depths, offsets, and the
    step's instant. Before the step the disk is steady at ``power_W`` (or cold); its inner row
    follows by radial conduction.

    The order of ``table`` must be that of the parameters of ``readings``. The steps of the
    differences may be changed within reason; ``tests/immersion/test_design_predictions.py`` tests
    the predictions.
    """
    dt, before = 1 / plan.rate_Hz, int(round(2.0 * plan.rate_Hz))
    t: Array = dt * np.arange(-before, int(plan.window_s * plan.rate_Hz), dtype=float)
    first, last = (1.0, 0.0) if plan.kind == "unloading" else (0.0, 1.0)
    on = np.where(t < 0, first, last)
    inputs = np.column_stack([on, _inner_row(plan, setup, t)])
    rates = basis_rates(dt)
    banks = [lag_basis(on, dt, rates, hold="zoh", jumps=(InputJump(before - 1, 1.0, first, last),))]
    banks += [lag_basis(x, dt, rates) for x in inputs.T[1:]]
    nominal = junction_points(setup, setup.outer)
    n, p = len(setup.channels), len(setup.outer)
    inner, outer = setup.channel_indices(setup.inner), setup.channel_indices(setup.outer)

    @cache
    def outer_traces(ln_h: float, ln_k: float, *deeper_m: float) -> tuple[Array, Array]:
        """True temperatures of the outer row; cached.

        Parameters
        ----------
        ln_h, ln_k
            Logarithms of factors of h and of the conductivity.
        *deeper_m
            Additions to the depths of the outer junctions [m].

        Returns
        -------
        power, rows
            Response to the power, (N, P), and to each reading of the inner row, (k, N, P) [K].
        """
        rim = Rim.from_setup(setup, conductivity_W_mK=setup.conductivity_W_mK * float(np.exp(ln_k)))
        points = [(depth + more, z) for (depth, z), more in zip(nominal, deeper_m)]
        g = rim_gains(
            rim,
            plan.h_W_m2K * float(np.exp(ln_h)),
            points,
            plan.half_width_m,
            rates,
            mesh=Mesh(33, 53),
        )
        each = np.array(
            [
                banks[i] @ g.gains[i].T + inputs[:, i : i + 1] * g.direct[i]
                for i in range(1 + len(inner))
            ]
        )
        return plan.power_W * each[0], each[1:]

    def through_chain(x: Array, lag: float = lag_s, split: float = 0.0) -> Array:
        """A trace as the logger shows it, with this lag and split."""
        taus, delay, _ = stages("P2", lag, split)
        return Chain(taus, delay_s=delay, conditioning=setup.conditioning).response(x, dt)

    def readings(theta: Array) -> Array:
        """Readings (P N,) [K] of the outer row at ``theta``, one channel after the other."""
        lags, (split, ln_power, ln_h, ln_k, instant), depths, offsets = np.split(
            theta, [n, n + 5, n + 5 + p]
        )
        power, rows = outer_traces(float(ln_h), float(ln_k), *map(float, depths))
        power = power * (1 + ln_power)
        row = rows.sum(axis=0)
        # a step that comes late, or an inner reading taken for less lagged than it is, is a shift
        # in time
        shift = -instant * power + np.tensordot(lags[inner] - lag_s, rows, axes=1)
        out = np.gradient(through_chain(shift), dt, axis=0) + offsets
        for k, at in enumerate(
            outer
        ):  # a split common to all channels acts on the power's share alone
            lag = float(lags[at])
            out[:, k] += through_chain(power[:, k], lag, float(split)) + through_chain(
                row[:, k], lag
            )
        return out.T.ravel()

    # nominal value, step of the difference, prior standard deviation, in the order of the readings'
    # parameters
    table = [
        (lag_s, 1e-3, np.inf),
        (0.0, 1e-3, LAG_SPLIT_PRIOR_SD),
        (0.0, 1e-3, plan.power_log_u),
        (0.0, 0.02, plan.h_log_u),
        (0.0, 0.02, plan.conductivity_log_u),
        (0.0, 1e-3, plan.instant_u_s),
        (0.0, 2e-5, plan.depth_u_m),
        (0.0, 1e-3, plan.offset_K),
    ]
    start, steps, prior = np.repeat(table, [n, 1, 1, 1, 1, 1, p, p], axis=0).T
    similarity_rows = np.eye(
        n, len(start)
    )  # rows added to the data: channels of one disk are much similarity_rows
    similarity_rows[:, :n] -= 1 / n
    c = posterior_covariance(
        np.vstack(
            [
                jacobian(readings, start, steps) / plan.noise_K,
                similarity_rows / plan.channel_lag_sd_s,
            ]
        ),
        prior,
    )
    other_u = {
        "u_power_rel": float(np.sqrt(c[n + 1, n + 1])),
        "u_h_rel": float(np.sqrt(c[n + 2, n + 2])),
    }
    label = f"{plan.kind}, {plan.power_W:g} W, {plan.window_s:g} s"
    return from_covariances(label, plan.kind, [c[:n, :n]], other_u)


def _inner_row(plan: StepPlan, setup: DiskSetup, t: Array) -> Array:
    """Temperature of the inner row above the surroundings [K].

    Parameters
    ----------
    plan
        The planned step.
    setup
        The disk.
    t
        Time from the step, (N,) [s].

    Returns
    -------
    Temperatures, (N, k): steady then cooling, or cold then warming.

    Notes
    -----
    Radial conduction only; the heat enters over the whole width.
    """
    flux = plan.power_W / (2 * np.pi * setup.outer_radius_m * setup.width_m)
    depths = [setup.junctions[c].depth_m for c in setup.inner]
    rise = simulate_plunge_model(
        Cylinder.from_setup(setup),
        depths,
        lambda T, F, t: np.full_like(T, plan.h_W_m2K),
        0.0,
        flux / plan.h_W_m2K,
        plan.window_s,
    ).at(t, 0.0)
    return flux / plan.h_W_m2K - rise if plan.kind == "unloading" else rise


@dataclass(frozen=True)
class TouchPlan:
    """A planned touch of a small patch with a soldering iron.

    Its instant is known from the reading only.

    Parameters
    ----------
    flux_W_m2
        Heat flux; 1e6 W/m2 are 7 W through 3 mm.
    radius_m
        Radius of the patch.
    duration_s
        Duration of the touch.
    onset_s
        Time constant with which contact is made.
    window_s
        Time after the start of the touch.
    rate_Hz
        Sampling rate.
    noise_K
        Noise of one sample.
    flux_log_u, radius_log_u, duration_log_u, onset_log_u, conductivity_log_u
        Prior standard deviations of the logarithms.
    start_u_s
        Prior standard deviation of the start.
    depth_u_m
        Prior standard deviation of a depth.
    """

    flux_W_m2: float = 1e6  # 7 W through 3 mm
    radius_m: float = 1.5e-3
    duration_s: float = 2.0
    onset_s: float = 0.15  # how fast contact is made
    window_s: float = 10.0
    rate_Hz: float = 75.0
    noise_K: float = 0.12
    flux_log_u: float = 0.7
    radius_log_u: float = 0.3
    start_u_s: float = 0.5
    duration_log_u: float = 0.3
    onset_log_u: float = 0.5
    depth_u_m: float = 1e-4
    conductivity_log_u: float = 0.03


def patch_response(
    t_s: Array, depth_m: float, radius_m: float, k_W_mK: float, alpha_m2_s: float
) -> Array:
    """Rise under the middle of a patch heated by a unit flux from t = 0 on a half space [K m2/W].

    Parameters
    ----------
    t_s
        Time, (N,) [s].
    depth_m
        Depth z below the surface [m].
    radius_m
        Radius a of the patch [m].
    k_W_mK
        Conductivity.
    alpha_m2_s
        Diffusivity.

    Returns
    -------
    Rise, (N,); zero up to t = 0.

    Notes
    -----
    T(z, t) = (2 sqrt(alpha t)/K) [ierfc(z / (2 sqrt(alpha t))) - ierfc(sqrt(z^2 + a^2) / (2
    sqrt(alpha t)))]

    Source: Carslaw and Jaeger (1959), section 10.5 (III). Valid while the heat has not reached the
    disk's faces.
    """
    root = 2 * np.sqrt(alpha_m2_s * np.maximum(t_s, 1e-12))

    def ierfc(x: Array) -> Array:
        """Integral of the complementary error function, in the shape of ``x``."""
        return np.exp(-(x**2)) / np.sqrt(np.pi) - x * erfc(x)

    rise = root / k_W_mK * (ierfc(depth_m / root) - ierfc(np.hypot(depth_m, radius_m) / root))
    return np.where(t_s > 0, rise, 0.0)


def predict_touches(plan: TouchPlan, setup: DiskSetup, *, lag_s: float = 0.65) -> PredictedTest:
    """Expected uncertainty of the lags from one touch above each thermocouple.

    Parameters
    ----------
    plan
        The planned touch.
    setup
        The disk.
    lag_s
        Expected lag of the chain, without conditioning [s].

    Notes
    -----
    By Fisher information. Each touch has its own flux, patch, start, duration and onset (section
    6.4.2.1); conductivity and the lag's split are shared. The last two rows of ``table`` must be
    the shared ones.
    """
    dt = 1 / plan.rate_Hz
    t = np.arange(-1.0, plan.window_s, dt)
    # nominal value, step of the difference, prior standard deviation; all but the last two are a
    # touch's own
    table = {
        "lag": (lag_s, 1e-3, np.inf),
        "ln_flux": (np.log(plan.flux_W_m2), 1e-3, plan.flux_log_u),
        "ln_radius": (np.log(plan.radius_m), 1e-3, plan.radius_log_u),
        "start": (0.0, 1e-3, plan.start_u_s),
        "ln_duration": (np.log(plan.duration_s), 1e-3, plan.duration_log_u),
        "ln_onset": (np.log(plan.onset_s), 1e-3, plan.onset_log_u),
        "depth": (0.0, 1e-6, plan.depth_u_m),
        "offset": (0.0, 1e-3, np.inf),
        "ln_k": (0.0, 1e-3, plan.conductivity_log_u),
        "split": (0.0, 1e-3, LAG_SPLIT_PRIOR_SD),
    }
    nominal, steps, prior = np.array(list(table.values())).T

    def reading(depth_m: float, theta: Array) -> Array:
        """Reading of one channel at a depth, for parameters in the order of ``table``, (N,) [K]."""
        lag, ln_flux, ln_radius, start, ln_duration, ln_onset, depth, offset, ln_k, split = map(
            float, theta
        )
        k = setup.conductivity_W_mK * np.exp(ln_k)
        alpha = k / (setup.density_kg_m3 * setup.specific_heat_J_kgK)
        after_onset, after_end = (
            patch_response(t - start - after, depth_m + depth, np.exp(ln_radius), k, alpha)
            for after in (0.0, np.exp(ln_duration))
        )
        taus, delay, _ = stages("P2", lag, split)
        chain = Chain(
            (*taus, float(np.exp(ln_onset))), delay_s=delay, conditioning=setup.conditioning
        )
        return chain.response(np.exp(ln_flux) * (after_onset - after_end), dt) + offset

    depths = [junction.depth_m for junction in setup.junctions.values()]
    each = [jacobian(partial(reading, depth), nominal, steps) / plan.noise_K for depth in depths]
    n_own = len(table) - 2
    rows = np.hstack(
        [block_diag(*(j[:, :n_own] for j in each)), np.vstack([j[:, n_own:] for j in each])]
    )
    lags = slice(0, n_own * len(each), n_own)
    c = posterior_covariance(
        rows, np.concatenate([np.tile(prior[:n_own], len(each)), prior[n_own:]])
    )
    return from_covariances(
        f"touch of {plan.duration_s:g} s above each thermocouple", "touch", [c[lags, lags]]
    )
