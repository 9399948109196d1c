"""Nuisance parameters of a test, their effects on the readings, and the model of the joint fits.

The effects are linear about a share and a heat transfer coefficient: difference quotients of the
rim model for depths and materials, responses of the rim to errors of the inner row for static lines
and lags. Steady lines, cooling fit, joint fit, sensor check and model-form alternatives use them.
``LaggedRim`` gives the readings of a disk by its share, its heat transfer coefficient and the two
lags of its chain (docs/theory/partition.md). Steps of quotients are chosen by judgement; each
standard uncertainty says where it comes from. Guarded by ``tests/partition/test_effects.py``
(signs), ``tests/partition/test_power.py`` (lags), ``tests/partition/test_profile.py`` (derivatives)
and ``tests/partition/test_joint.py`` (effects against a simulated whole disk).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from tcdyn.chain import Chain
from tcdyn.chain.rational import Factor, Rational, simulate
from tcdyn.core import Array
from tcdyn.heat.rim import lag_basis_means, lag_weights
from tcdyn.partition.angular_harmonic import (
    AngularHarmonic,
    add_harmonic_effects,
)
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.specified import specified_effects
from tcdyn.partition.window import (
    POWER,
    DiskWindow,
    Perturbation,
    RimMeans,
    interpolate_blocks,
    power_means,
    steady_start_s,
)
from tcdyn.rig.contact import SWITCHING_MARGIN_S, running_line, smoothing_samples
from tcdyn.rig.disk import DiskSetup
from tcdyn.smoothing.traces import DiskTraces

# Main parameters of each disk, in the order of theta; h in W/m2K, "lags" is tau1 + tau2 [s].
PARAMETERS = ("share", "log h", "log lags", "log tau2")
SHARE, LOG_H, LOG_LAGS, LOG_TAU2 = range(4)
# Least first lag, as a fraction of the sum of both lags: keeps tau1 above zero.
MIN_LAG_FRACTION = 1e-7
# In ln(rate): a lag nearer to one of the bank is moved away from it, against a division by zero.
MIN_NODE_DISTANCE = 1e-6
# Step of the difference quotient by log h: errors by curvature and by rounding are then 5e-6 each.
LOG_H_STEP = 1e-5
# The search rejects h above exp(14) = 1.2 million W/m2K. Chosen by judgement.
MAX_LOG_H = 14.0
# Rows of ``nominal_effects``: conductivity and heat capacity, and ambient.
STEEL_ROWS = slice(-5, -3)
AMBIENT_INDEX = -1
# Steps of the difference quotients by conductivity, heat capacity, washer conductance and
# half-width, relative, and by depths [m]. Chosen by judgement.
MATERIAL_STEP = 0.01
MATERIALS = [Perturbation(*(MATERIAL_STEP * row)) for row in np.eye(4)]
DEPTH_STEP_M = 0.05e-3
# Readings of the inner row are averaged over this before their rate is taken [s], so that the
# effect of a lag does not follow their noise. Chosen by judgement.
SMOOTH_RATE_S = 0.5
# Standard uncertainty of how a channel's lag is split into two [s]: a plunge hardly determines it.
# Chosen by judgement.
SPLIT_SD_S = 0.03
# Standard uncertainty of rim model and mesh at a junction [K], by whole-disk solutions.
RIM_MODEL_U_K = 0.03
# Least first lag when the split of a lag is varied [s]. Chosen by judgement.
MIN_TAU1_S = 5e-3

# Times before the unloading [s] between which the mean error of the friction is one nuisance
# parameter; they are closer where their time matters more. With segments twice as long, part of the
# noise remains in the residuals. Chosen by judgement
FRICTION_SEGMENTS_S = np.concatenate(
    [np.arange(0, 6, 1), np.arange(6, 20, 2), np.arange(20, 50, 5), np.arange(50, 150, 10)]
)
FRICTION_NOISE = "friction noise"  # line of the budget, and beginning of the names

# Air of one disk, as far as its own channels differ; and its steel, as far as it differs from that
# of the other disk.
DISK_AIR = NuisanceParameter("air", "ambient")
DISK_STEEL = (
    NuisanceParameter("conductivity of one disk", "steel of one disk"),
    NuisanceParameter("heat capacity of one disk", "steel of one disk"),
)


def nominal_parameters(disk: DiskSetup) -> tuple[NuisanceParameter, ...]:
    """Nuisance parameters of rig.toml and record, (3 (P + k) + 5,).

    Parameters
    ----------
    disk
        The set-up of the disk, with P outer and k inner junctions.

    Returns
    -------
    tuple
        Static line, then depth, then lag of each junction, the outer row first; then conductivity,
        heat capacity, washer, half-width and ambient, which both disks share.

    Notes
    -----
    The order must be that of ``tcdyn.partition.nuisance.nominal_u``, of
    ``tcdyn.partition.nuisance.nominal_effects`` and, for depths and materials, of
    ``tcdyn.partition.nuisance.nominal_perturbations``. ``AMBIENT_INDEX`` expects the ambient last.
    ``tests/partition/test_effects.py`` fails if the order differs from that of the effects.
    """
    return (
        *(NuisanceParameter(f"static {c}", "static lines") for c in disk.rows),
        *(NuisanceParameter(f"depth {c}", "junction depth") for c in disk.rows),
        *(NuisanceParameter(f"lag {c}", "chain") for c in disk.rows),
        *(
            NuisanceParameter(name, name, True)
            for name in ("conductivity", "heat capacity", "washer", "half-width", "ambient")
        ),
    )


def parameters_of_test(disk: DiskSetup) -> tuple[NuisanceParameter, ...]:
    """Nuisance parameters that a test adds to ``nominal_parameters``, (P + 6,).

    Parameters
    ----------
    disk
        The set-up of the disk, with P outer junctions.

    Returns
    -------
    tuple
        Instant of unloading (its name in stored results is "parting"), friction, split of each
        outer junction's lag, exponent of the speed law ("film exponent"), the disk's own air, and
        its own steel.

    Notes
    -----
    The order must be that of ``test_u`` and of ``change`` in
    ``tcdyn.partition.nuisance.nuisance_effects``. ``tests/partition/test_as_logged.py`` uses the
    names.
    """
    return (
        NuisanceParameter("parting", "instant of unloading", True),
        NuisanceParameter("friction", "friction", True),
        *(NuisanceParameter(f"split {c}", "chain") for c in disk.outer),
        NuisanceParameter("film exponent", "film exponent", True),
        DISK_AIR,
        *DISK_STEEL,
    )


@dataclass(frozen=True)
class NuisanceEffects:
    """The effect of nuisance parameters on the readings.

    Parameters
    ----------
    parameters
        The Q nuisance parameters.
    change
        Readings less prediction by one standard uncertainty of each, (Q, R, P) [K].
    """

    parameters: tuple[NuisanceParameter, ...]
    change: Array


def nominal_u(disk: DiskTraces, static_u_K: Array) -> Array:
    """Standard uncertainties (Q,) of ``nominal_parameters`` [K, m, s, relative, K].

    Parameters
    ----------
    disk
        The traces of the disk.
    static_u_K
        Standard uncertainty of the static lines, (C,) in the order of the channels [K].

    Returns
    -------
    Array
        Static lines [K], depths [m] and lags [s] in the order of the disk's rows; then
        conductivity, heat capacity, washer and half-width, relative, and ambient [K].

    Notes
    -----
    The uncertainty of a lag is that of its difference from the mean of all, as the record
    determines it. The joint fit has the mean itself as a free parameter
    (``tcdyn.partition.joint.joint_problem``), so it must not be counted here again. The order must
    be that of ``tcdyn.partition.nuisance.nominal_parameters``.
    """
    u = disk.uncertainty
    order = disk.setup.channel_indices(disk.setup.rows)
    n_channels = len(order)
    centre = np.eye(n_channels) - 1.0 / n_channels
    variances = np.diag(centre @ disk.lag_covariance_s2 @ centre.T)
    lag_u_s = np.sqrt(np.clip(variances, 0.0, None))
    steel = [u.conductivity_rel, u.heat_capacity_rel, u.washer_rel, u.half_width_rel, u.ambient_K]
    return np.concatenate([static_u_K[order], disk.depth_u_m[order], lag_u_s[order], steel])


def nominal_perturbations(disk: DiskSetup) -> list[tuple[Perturbation, float]]:
    """Perturbations of the difference quotients of ``nominal_effects``, with their sizes.

    Parameters
    ----------
    disk
        The set-up of the disk.

    Returns
    -------
    list
        P + k depths [m], the outer row first, then conductivity, heat capacity, washer conductance
        and half-width [relative], each with its size.

    Notes
    -----
    The steps may change freely while the rim stays nearly linear over them. The order must be that
    of ``tcdyn.partition.nuisance.nominal_effects``.
    """
    n_junctions = len(disk.rows)
    deeper = [
        (Perturbation(depth_shift_m=tuple(row)), DEPTH_STEP_M)
        for row in DEPTH_STEP_M * np.eye(n_junctions)
    ]
    return deeper + [(p, MATERIAL_STEP) for p in MATERIALS]


def nominal_effects(
    perturbed: Array,
    input_responses: Array,
    constant: Array,
    rates_K_s: Array,
    inner_row_weights: Array,
) -> Array:
    """Readings less prediction by a unit of each of ``nominal_parameters``, (Q, R, n).

    The n predicted junctions are the P of the outer row, or these and the k of the inner row; R is
    the number of means.

    Parameters
    ----------
    perturbed
        Change of the prediction by a unit of each of ``nominal_perturbations``, (P + k + 4, R, n)
        [K/m, then K].
    input_responses
        Response to an input that is higher by a constant kelvin [1], by its rise of temperature
        with radius [K/m], and by its rate [K/s], each for the k junctions of the inner row, then to
        a kelvin of ambient, (3 k + 1, R, n).
    constant
        How much of a constant error the means show, (R,): 1 for a level, 0 for a change.
    rates_K_s
        Rate of each mean, (R, n) [K/s].
    inner_row_weights
        Error of each input of the inner row per error of each of its junctions, (k, k); the
        identity without surrogates.

    Returns
    -------
    Array
        Effects [K] of 1 K of each static line, 1 m of each depth, 1 s of each lag, of each material
        property by all of itself, and of 1 K of ambient.

    Notes
    -----
    A junction of the inner row that reads too high raises the prediction, so the outer row reads
    less than predicted. An inner junction that lies deeper, or lags more, reads too low for its
    nominal radius or time, so the outer row reads more than predicted. ``perturbed`` of an outer
    depth already is readings less prediction.

    ``tests/partition/test_effects.py`` fails if a sign changes.
    """
    k = len(inner_row_weights)
    n_junctions = len(perturbed) - len(MATERIALS)
    p = n_junctions - k
    junctions = np.eye(n_junctions, perturbed.shape[2])[:, None]
    static = junctions * constant[:, None]
    lag = -junctions * rates_K_s
    depth = perturbed[:n_junctions].copy()
    static[p:] -= np.tensordot(inner_row_weights, input_responses[:k], 1)
    depth[p:] += np.tensordot(inner_row_weights, input_responses[k : 2 * k], 1)
    lag[p:] += np.tensordot(inner_row_weights, input_responses[2 * k : 3 * k], 1)
    materials = perturbed[n_junctions:]
    ambient = input_responses[3 * k :]
    return np.concatenate([static, depth, lag, materials, ambient])


def steady_input_response(setup: DiskSetup, static: Array) -> Array:
    """Steady responses of the outer row in the order of ``nominal_effects``, (3 k + 1, P).

    Parameters
    ----------
    setup
        The set-up of the disk.
    static
        Steady responses to all inputs of the rim, (I, P): power, k of the inner row, ambient.
    """
    k = len(setup.inner)
    inner = static[1 : k + 1]
    ambient = static[k + 1 : k + 2]
    return np.concatenate([inner, inner, inner, ambient])


def inner_gradient(window: DiskWindow, share: float, h_W_m2K: float) -> Array:
    """Radial gradient at the inner row in every sample by the rim model, (N, k) [K/m].

    Parameters
    ----------
    window
        The window of the disk.
    share, h_W_m2K
        Share and heat transfer coefficient of the model.

    Notes
    -----
    Positive where the temperature rises with radius. It is computed for the R blocks and
    interpolated linearly between their mean times.
    """
    boundary, power = window.rim.gradient(h_W_m2K)
    return interpolate_blocks(window, boundary + share * power)


def harmonic_prior(test: EhlTest, disk: str) -> AngularHarmonic:
    """The angular harmonic of a disk as the test has it, else the default prior.

    Parameters
    ----------
    test
        The test.
    disk
        Name of the disk.

    Notes
    -----
    The default prior has the length of this test's steady window, because the drift and the
    curvature of the harmonic are defined over it.
    """
    return test.harmonics.get(
        disk, AngularHarmonic(steady_window_s=test.events.unload_s - steady_start_s(test))
    )


def nuisance_effects(
    test: EhlTest, disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> NuisanceEffects:
    """Effect of all nuisance parameters on the readings of a disk, linear about (share, h).

    Parameters that have no uncertainty are omitted.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.
    window
        Window of the readings, R blocks of P outer junctions.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.

    Returns
    -------
    NuisanceEffects
        ``nominal_parameters``, ``parameters_of_test``, those of rig.toml's further specifications,
        those of the friction's noise, and last those of the angular harmonics; effects (Q, R, P)
        [K] by one standard uncertainty of each.

    Notes
    -----
    How a lag of the outer row is split into two is a nuisance parameter. Per second moved from its
    first lag to its second, (1 + tau1 s)(1 + tau2 s) grows by (tau1 - tau2) s^2, so the reading
    loses (tau1 - tau2) s^2 / ((1 + tau1 s)(1 + tau2 s)) of itself.

    A larger ``SPLIT_SD_S`` or ``RIM_MODEL_U_K`` widens every estimate; ``RIM_MODEL_U_K`` is also
    read by ``tcdyn.campaign.compress``. To add a parameter, add it to
    ``tcdyn.partition.nuisance.parameters_of_test`` and, at the same position, to ``change`` and
    ``test_u``. The harmonics must stay last: ``add_harmonic_effects`` looks up all others.
    ``tests/partition/test_joint.py`` (study) compares the effects with a simulated whole disk.
    """
    rim = window.rim
    setup = disk.setup
    outer = setup.channel_indices(setup.outer)
    boundary, power = rim.response(h_W_m2K)
    predicted = boundary + share * power
    gains = rim.gains(h_W_m2K)
    perturbed = perturbed_changes(rim, predicted, share, h_W_m2K)
    input_responses = _responses_to_inner_row_errors(test, disk, window, share, h_W_m2K)
    rates = np.gradient(predicted, window.block_time_s, axis=0)
    constant = np.ones(len(predicted))
    nominal = nominal_effects(perturbed, input_responses, constant, rates, disk.inner_row_weights)
    later_unloading = -share * np.gradient(power, window.block_time_s, axis=0)
    speed_exponent = rim.input_response(rim.surface_air_inputs[1], h_W_m2K)
    change = np.concatenate(
        [
            nominal,
            [later_unloading, share * power],
            _split_effects(test, disk, window, predicted),
            [speed_exponent, nominal[AMBIENT_INDEX], *nominal[STEEL_ROWS]],
        ]
    )
    static_u_K = disk.static_u_K.copy()
    static_u_K[outer] = np.hypot(static_u_K[outer], RIM_MODEL_U_K)
    air_u_K = test.air[disk.name].own_u_K if disk.name in test.air else 0.0
    test_u = [
        test.events.unload_u_s,
        disk.uncertainty.friction_rel,
        *[SPLIT_SD_S] * len(outer),
        float(speed_exponent.any()),
        air_u_K,
        *[disk.uncertainty.steel_of_one_disk_rel] * len(DISK_STEEL),
    ]
    u = np.concatenate([nominal_u(disk, static_u_K), test_u])
    uncertain = np.flatnonzero(u > 0)
    candidates = (*nominal_parameters(setup), *parameters_of_test(setup))
    specified_parameters, specified_change = specified_effects(disk, window, share, h_W_m2K)
    noise_parameters, noise_change = friction_noise_effects(test, window, share, h_W_m2K)
    parameters = (*(candidates[q] for q in uncertain), *specified_parameters, *noise_parameters)
    change = np.concatenate(
        [u[uncertain, None, None] * change[uncertain], specified_change, noise_change]
    )
    since_s = window.block_time_s - test.events.unload_s
    harmonic = harmonic_prior(test, disk.name)
    static = gains.static[rim.inner_inputs]
    return NuisanceEffects(
        *add_harmonic_effects(parameters, change, harmonic, setup, h_W_m2K, static, since_s)
    )


def friction_noise_effects(
    test: EhlTest, window: DiskWindow, share: float, h_W_m2K: float
) -> tuple[tuple[NuisanceParameter, ...], Array]:
    """Effect of the noise of the logged friction, by segments of time before the unloading.

    Parameters
    ----------
    test
        The test.
    window
        Window of the readings of one disk.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.

    Returns
    -------
    parameters
        By how much the friction was higher than the log says, as the mean of each of the K
        segments; both disks have it in common. None without noise.
    change
        Readings less prediction by one standard uncertainty of each, (K, R, P) [K].

    Notes
    -----
    The mean of n samples of white noise of standard deviation s has the standard uncertainty
    s / sqrt(n). The model gets the friction as a running straight line
    (``tcdyn.rig.contact.running_line``), and so does each error. Without these parameters the noise
    looks like a change of h at the unloading: ``tests/partition/test_friction_noise.py``.
    """
    unload_s = test.events.unload_s
    # up to here the friction is smoothed; its last value continues
    settled_s = unload_s - test.events.fall_time_s - SWITCHING_MARGIN_S
    settled = (window.time_s >= test.events.load_on_s) & (window.time_s < settled_s)
    n_settled = int(settled.sum())
    if test.friction_noise_N == 0 or n_settled == 0:
        return (), np.zeros((0, *window.y.shape))
    continues = (window.time_s >= settled_s) & (window.time_s < unload_s + test.events.fall_time_s)
    first = int(np.searchsorted(test.time_s, window.time_s[0]))
    rows = slice(first, first + len(window.time_s))
    before_s = unload_s - window.time_s[settled]
    segment = np.searchsorted(FRICTION_SEGMENTS_S, before_s, side="right") - 1
    members = (segment[:, None] == np.arange(len(FRICTION_SEGMENTS_S))).astype(float)
    counts = members.sum(axis=0)
    used = np.flatnonzero(counts)
    samples = smoothing_samples(test.friction_noise_N, test.friction_N, test.dt_s, n_settled)
    smooth = running_line(members[:, used], samples)
    errors_N = test.friction_noise_N / np.sqrt(counts[used]) * smooth
    change = []
    for error_N in errors_N.T:
        error_rel = np.zeros_like(test.power_W)
        error_rel[rows][settled] = error_N / test.friction_N
        error_rel[rows][continues] = error_N[-1] / test.friction_N
        power_W = error_rel * test.power_W
        means = power_means(
            replace(test, power_W=power_W),
            rows,
            window.chain,
            window.blocks,
            window.counts,
            window.rim.rates_1_s,
        )
        change.append(share * window.rim.with_power(*means).input_response(POWER, h_W_m2K))
    parameters = [
        NuisanceParameter(f"{FRICTION_NOISE} {FRICTION_SEGMENTS_S[k]:g} s", FRICTION_NOISE, True)
        for k in used
    ]
    return tuple(parameters), np.array(change)


def perturbed_changes(rim: RimMeans, predicted: Array, share: float, h_W_m2K: float) -> Array:
    """Change of the prediction by a unit of each of ``nominal_perturbations``, (P + k + 4, R, n).

    Parameters
    ----------
    rim
        The rim, R means of n predicted junctions.
    predicted
        Its prediction, (R, n) [degC].
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.
    """
    changes = []
    for perturbation, size in nominal_perturbations(rim.setup):
        boundary, power = rim.response(h_W_m2K, perturbation)
        changes.append((boundary + share * power - predicted) / size)
    return np.array(changes)


def _responses_to_inner_row_errors(
    test: EhlTest, disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> Array:
    """Responses of the outer row (P channels) to errors of the k channels of the inner row.

    Parameters
    ----------
    test, disk
        The test and its disk.
    window
        Window of the fits, R blocks.
    share, h_W_m2K
        Heat partition and h at which the radial gradient is computed.

    Returns
    -------
    array
        ``input_responses`` of ``nominal_effects``, (3 k + 1, R, P). Constant errors have their
        steady response. Errors by gradient and by rate vary in time, so they pass the filter bank
        and the gains of the rim.
    """
    setup = disk.setup
    inner = setup.channel_indices(setup.inner)
    rates_1_s = window.rim.rates_1_s
    gains = window.rim.gains(h_W_m2K)
    width = max(int(round(SMOOTH_RATE_S / test.dt_s)), 1)
    smooth = ndimage.uniform_filter1d(window.readings[:, inner], width, axis=0, mode="nearest")
    gradients = inner_gradient(window, share, h_W_m2K)
    rates = np.gradient(smooth, test.dt_s, axis=0)
    steady = steady_input_response(setup, gains.static)
    out = np.repeat(steady[:, None], len(window.y), axis=1)
    for k, error in enumerate(np.hstack([gradients, rates]).T, start=len(inner)):
        i = 1 + k % len(inner)
        bank = lag_basis_means(error, test.dt_s, rates_1_s, window.counts)
        out[k] = (window.blocks @ error)[:, None] * gains.direct[i] + bank @ gains.gains[i].T
    return out


def _split_effects(test: EhlTest, disk: DiskTraces, window: DiskWindow, predicted: Array) -> Array:
    """Effect of a second moved from an outer junction's first lag to its second, (P, R, P) [K].

    ``predicted`` are the readings of the outer row in the blocks of the window, (R, P) [degC]. Each
    junction changes only its own reading. The lags are those of the mean chain.
    """
    dt = test.dt_s
    taus = sorted(disk.mean_chain.taus_s, reverse=True)
    tau1 = max(taus[0], MIN_TAU1_S)
    tau2 = max(taus[1] if len(taus) > 1 else 0.0, 2 * dt)
    loss = Rational(np.array([0.0, 0.0, tau1 - tau2]), (Factor((1.0, tau1)), Factor((1.0, tau2))))
    samples = interpolate_blocks(window, predicted)
    lost = np.column_stack([simulate(loss, column, dt) for column in samples.T])
    return -np.eye(predicted.shape[1])[:, None] * (window.blocks @ lost)


def lags(p: Array) -> tuple[float, float]:
    """tau1 and tau2 [s] of the parameters of a disk; tau2 is at most the sum of both.

    Parameters
    ----------
    p
        ``PARAMETERS`` of the disk, (4,).

    Returns
    -------
    tau1, tau2
        First and second lag. Which of them is larger is not fixed.

    Notes
    -----
    ``MIN_LAG_FRACTION`` keeps tau1 positive. The parameters are the logarithms of the sum and of
    tau2, so a change of this form must be made also in
    ``tcdyn.partition.nuisance.LaggedRim.__call__`` (the derivatives) and in
    ``tcdyn.partition.profile._Table``; ``tests/partition/test_profile.py`` compares them.
    """
    total = float(np.exp(p[LOG_LAGS]))
    second = min(float(np.exp(p[LOG_TAU2])), (1 - MIN_LAG_FRACTION) * total)
    return total - second, second


def with_lags(chain: Chain, taus_s: tuple[float, ...]) -> Chain:
    """The chain with ``taus_s`` for its largest lags, the others unchanged.

    Parameters
    ----------
    chain
        The chain of a channel or of a disk.
    taus_s
        The new lags, one or two [s]. They replace the two largest lags together.
    """
    return replace(chain, taus_s=(*taus_s, *sorted(chain.taus_s, reverse=True)[2:]))


def add_lag(u: Array, bank: Array, rates_1_s: Array, tau_s: float) -> tuple[Array, Array]:
    """Pass an input and its filter bank through one more first-order lag.

    Parameters
    ----------
    u
        Block means of the input, (R,).
    bank
        Block means of the input through the lags of the bank, (R, K).
    rates_1_s
        Rates of the bank, (K,) [1/s], ascending.
    tau_s
        The lag to add [s].

    Returns
    -------
    u, bank
        Block means of the lagged input, (R,), and of the lagged input through the bank, (R, K).

    Notes
    -----
    With the bank's lags L_k of rates r_k and a = 1/tau, L L_k = (a L_k - r_k L)/(a - r_k), and L is
    a sum of the L_k by ``lag_weights``: accurate to 1e-6 for a lag inside the range of the bank. A
    lag outside it is replaced by the nearest of its ends, so ``tcdyn.partition.window.disk_window``
    makes the bank long enough. A lag on a node would divide by zero; it is moved by
    ``MIN_NODE_DISTANCE``. ``tests/partition/test_power.py`` fails if the result differs from
    filtering the samples.
    """
    rate = 1 / tau_s
    if np.any(np.abs(np.log(rate / rates_1_s)) < MIN_NODE_DISTANCE):
        rate *= 1 + 3 * MIN_NODE_DISTANCE
    log_rate = np.log(np.clip([rate], *rates_1_s[[0, -1]]))
    lagged = bank @ lag_weights(rates_1_s, log_rate)[0]
    return lagged, (rate * bank - rates_1_s * lagged[:, None]) / (rate - rates_1_s)


@dataclass(frozen=True)
class LaggedRim:
    """Model of a joint fit: a rim whose frictional power passes two lags that are free.

    Parameters
    ----------
    rim
        The rim, its power already passed through ``lag_s`` and the rest of the chain.
    lag_s
        That lag [s].
    weight
        Weights of the readings, (R, P) [1/K].
    """

    rim: RimMeans
    lag_s: float
    weight: Array

    def rim_with_lags(self, taus_s: tuple[float, ...]) -> RimMeans:
        """The rim with the power passed through the lags ``taus_s`` [s] instead of ``lag_s``.

        Notes
        -----
        (1 + lag s)/(1 + tau s) = lag/tau + (1 - lag/tau) L for the longest of them, then the others
        are added by ``add_lag``. The power that ``rim`` holds is already lagged, so it has no jump
        at the unloading, and straight lines between its samples are accurate.
        """
        rates = self.rim.rates_1_s
        u = self.rim.inputs[:, 0]
        bank = self.rim.banks[0]
        longest, *others = sorted(taus_s, reverse=True)
        ratio = self.lag_s / longest
        lagged_u, lagged_bank = add_lag(u, bank, rates, longest)
        u = ratio * u + (1 - ratio) * lagged_u
        bank = ratio * bank + (1 - ratio) * lagged_bank
        for tau in others:
            u, bank = add_lag(u, bank, rates, tau)
        return self.rim.with_power(u, bank)

    def __call__(self, p: Array) -> tuple[Array, Array] | None:
        """Weighted prediction (m,), derivatives (m, 4) by ``PARAMETERS``; None for too large an h.

        Parameters
        ----------
        p
            ``PARAMETERS`` of the disk, (4,).

        Returns
        -------
        prediction, derivatives
            In standard deviations of the noise, m = R P.

        Notes
        -----
        The derivative by the logarithm of a lag L that the power P passes is (L - 1) L P. The chain
        rule from (log tau1, log tau2) to (log of the sum, log tau2) gives the last two columns. The
        derivative by log h is a difference quotient; ``LOG_H_STEP`` may change while curvature and
        rounding stay below 1e-5 of the slope. ``tests/partition/test_profile.py`` compares all four
        with central differences.
        """
        if not p[LOG_H] < MAX_LOG_H:
            return None
        share = p[SHARE]
        h = float(np.exp(p[LOG_H]))
        tau1, tau2 = lags(p)
        rim = self.rim_with_lags((tau1, tau2))
        boundary, power = rim.response(h * np.exp([0.0, LOG_H_STEP]))
        predicted, predicted_at_step = boundary + share * power

        def by_log_lag(tau: float) -> Array:
            """Derivative of the prediction by the logarithm of the lag ``tau`` [s], (R, P) [K]."""
            twice = self.rim_with_lags((tau1, tau2, tau)).input_response(POWER, h)
            return np.asarray(share * (twice - power[0]))

        by_tau1 = by_log_lag(tau1)
        by_tau2 = by_log_lag(tau2)
        derivatives = [
            power[0],
            (predicted_at_step - predicted) / LOG_H_STEP,
            by_tau1 * (tau1 + tau2) / tau1,
            by_tau2 - by_tau1 * tau2 / tau1,
        ]
        weighted = [(derivative * self.weight).ravel() for derivative in derivatives]
        return (predicted * self.weight).ravel(), np.stack(weighted, axis=1)
