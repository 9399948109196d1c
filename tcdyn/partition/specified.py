"""Nuisance parameters of what ``rig.toml`` may specify beyond the thesis's own model (section 8.3).

These are flux and heat transfer coefficient along the track, steel that depends on temperature, and
a running surface whose loss was measured; further the rim edge that an inner row of few junctions
does not determine. The effects are difference quotients of the rim model. Their standard
uncertainties are keys of rig.toml. :mod:`tcdyn.partition.nuisance` collects them for all fits; the
model-form alternatives (:mod:`tcdyn.partition.departures`) use some of the effects with their own
priors. Steps of quotients are chosen by judgement. Guarded by
``tests/partition/test_statement.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from tcdyn.core import Array
from tcdyn.heat.nonuniform import cached_rim_gains
from tcdyn.heat.rim import Rim, junction_points, lag_basis_means
from tcdyn.partition.events import EhlTest
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.window import FIT_MESH, DiskWindow, Perturbation, RimMeans
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.rigfile import UncertaintyTable
from tcdyn.rig.tables import SurfaceFlux
from tcdyn.smoothing.traces import SURROGATE_U_K, DiskTraces

# Slopes of the steel with temperature; both disks are of the same steel.
CONDUCTIVITY_SLOPE = NuisanceParameter("conductivity slope", "conductivity slope", True)
SPECIFIC_HEAT_SLOPE = NuisanceParameter("specific heat slope", "specific heat slope", True)
# Readings of the inner row are averaged over this [s]: a column with their noise would explain
# that noise. Chosen by judgement.
SMOOTH_S = 0.5


def depends_on_temperature(setup: DiskSetup, uncertainties: UncertaintyTable) -> bool:
    """Whether the steel's slopes with temperature are specified, or uncertain.

    Parameters
    ----------
    setup
        The disk.
    uncertainties
        Standard uncertainties of rig.toml.
    """
    steel = setup.steel
    slopes = (
        steel.conductivity_per_K,
        steel.specific_heat_per_K,
        uncertainties.conductivity_slope_per_K,
        uncertainties.specific_heat_slope_per_K,
    )
    return any(slopes)


def linear_about(
    setup: DiskSetup, air_degC: float, surface_degC: float, rim_degC: float
) -> DiskSetup:
    """The equivalent disk of constant conductivity and specific heat at these temperatures.

    Parameters
    ----------
    setup
        The disk, with slopes of conductivity and specific heat.
    air_degC, surface_degC
        Temperatures of air and running surface, between which Kirchhoff's temperature is defined.
    rim_degC
        Temperature of the rim, at which its diffusivity is taken.

    Notes
    -----
    In Kirchhoff's temperature (see ``tcdyn.rig.steel.SteelSlopes.kirchhoff_temperature``): k_m =
    k((T_A + T_s)/2), and rho c_m = rho c(T) k_m / k(T) at the rim's T, so that the diffusivity is
    the rim's. The readings must be transformed with the returned ``steel``, as
    ``tcdyn.partition.window.disk_window`` does. ``tests/partition/test_statement.py`` (study) fails
    if a bias remains.
    """
    steel = setup.steel.linearised_about(air_degC, surface_degC)
    k = steel.relative_conductivity(steel.mean_degC)
    k_rim = steel.relative_conductivity(rim_degC)
    return replace(
        setup,
        steel=steel,
        conductivity_W_mK=setup.conductivity_W_mK * k,
        specific_heat_J_kgK=setup.specific_heat_J_kgK
        * steel.relative_specific_heat(rim_degC)
        * k
        / k_rim,
    )


def conductivity_slope_effect(
    window: DiskWindow, share: float, h_W_m2K: float, u_per_K: float
) -> Array:
    """Readings less prediction if the conductivity's slope is steeper by ``u_per_K``, (R, P) [K].

    The rim conducts differently, and Kirchhoff's transformation of the readings changes, also of
    those of the inner row that drive the rim.

    Parameters
    ----------
    window
        Window of the disk, R blocks; the steel of its rim is linearised.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.
    u_per_K
        Change of the slope [1/K].

    Notes
    -----
    The inner row is smoothed over ``SMOOTH_S`` first. Without that the effect would hold the noise
    of the readings and the fit would use it to explain that noise;
    ``tests/partition/test_statement.py`` (study) tests this.
    """
    rim = window.rim
    dt_s = float(window.time_s[1] - window.time_s[0])
    steel = rim.setup.steel
    gains = rim.gains(h_W_m2K)
    rim_degC = float(rim.inputs[:, rim.inner_inputs].mean())
    slope_rel = u_per_K / steel.relative_conductivity(steel.mean_degC)
    conductivity = slope_rel * (steel.mean_degC - steel.reference_degC)
    at_rim = u_per_K * (rim_degC - steel.reference_degC) / steel.relative_conductivity(rim_degC)
    perturbation = Perturbation(conductivity=conductivity, heat_capacity=conductivity - at_rim)
    boundary, power = rim.response(h_W_m2K)
    perturbed_boundary, perturbed_power = rim.response(h_W_m2K, perturbation)
    predicted = boundary + share * power
    perturbed = perturbed_boundary + share * perturbed_power
    width = max(int(round(SMOOTH_S / dt_s)), 1)
    readings = window.readings[:, rim.setup.channel_indices(rim.setup.inner)]
    smooth = uniform_filter1d(readings, width, axis=0, mode="nearest")
    inner = slope_rel * steel.kirchhoff_curvature(smooth)
    by_inner = window.blocks @ inner @ gains.direct[rim.inner_inputs]
    for k, column in enumerate(inner.T, start=1):
        bank = lag_basis_means(column, dt_s, rim.rates_1_s, window.counts)
        by_inner = by_inner + bank @ gains.gains[k].T
    return np.asarray(
        perturbed - predicted + by_inner - slope_rel * steel.kirchhoff_curvature(predicted)
    )


def specific_heat_slope_effect(
    rim: RimMeans, share: float, h_W_m2K: float, u_per_K: float
) -> Array:
    """Change of the outer row if the slope of specific heat is higher by ``u_per_K``, (R, P) [K].

    Parameters
    ----------
    rim
        The rim, R blocks.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.
    u_per_K
        Change of the slope [1/K].
    """
    steel = rim.setup.steel
    rim_degC = float(rim.inputs[:, rim.inner_inputs].mean())
    heat_capacity = (
        u_per_K * (rim_degC - steel.reference_degC) / steel.relative_specific_heat(rim_degC)
    )
    boundary, power = rim.response(h_W_m2K)
    perturbed_boundary, perturbed_power = rim.response(
        h_W_m2K, Perturbation(heat_capacity=heat_capacity)
    )
    return np.asarray(perturbed_boundary - boundary + share * (perturbed_power - power))


# Air temperature and h of a running surface whose loss was measured; one line of the budget.
SURFACE_AIR = NuisanceParameter("surface air", "measured surface flux")
SURFACE_SLOPE = NuisanceParameter("surface slope", "measured surface flux")
# Least relative standard uncertainty of a measured h: keeps its prior finite. Chosen by judgement.
MIN_H_U_REL = 1e-4


def with_surface_air(test: EhlTest) -> EhlTest:
    """The test with the air offset of disks whose surface has another air than their faces.

    That is T_a where the surface loss was measured, else what the disk's own channels show. Without
    either, the test is returned as it is.

    Notes
    -----
    Must come before every fit. ``tests/partition/test_as_logged.py`` and
    ``tests/partition/test_statement.py`` (both study) test channels at the surface and a measured
    loss.
    """
    offsets = {}
    for name, disk in test.disks.items():
        offset = constant_speed_air_offset(test, disk)
        if disk.setup.surface.is_measured or offset.any():
            offsets[name] = offset
    if not offsets:
        return test
    return replace(test, surface_air_offset_K={**test.surface_air_offset_K, **offsets})


def constant_speed_air_offset(test: EhlTest, disk: DiskTraces) -> Array:
    """Air offset at constant speed, (N, 2) [K]: T_a less ambient, and zero.

    Parameters
    ----------
    test, disk
        The test, and the traces of the disk.

    Returns
    -------
    Array
        The columns of ``EhlTest.surface_air_offset_K``: offset, and its change by the speed
        exponent, which is zero at constant speed.
    """
    surface = disk.setup.surface
    ambient = test.ambient_of(disk.name)
    if surface.is_measured:
        offset = surface.air_degC - ambient
    elif disk.name in test.air:
        offset = test.air[disk.name].surface - ambient
    else:
        offset = np.zeros_like(ambient)
    return np.column_stack([offset, np.zeros_like(offset)])


def surface_air_effect(rim: RimMeans, h_W_m2K: float, u_K: float) -> Array:
    """Change of the outer row if T_a is permanently higher by ``u_K``, (R, P) [K].

    Parameters
    ----------
    rim
        The rim, R blocks, with an offset of the surface air.
    h_W_m2K
        Heat transfer coefficient of the running surface.
    u_K
        Change of T_a [K].
    """
    static = rim.gains(h_W_m2K).static[rim.surface_air_inputs[0]]
    return np.asarray(u_K * static * np.ones((len(rim.inputs), 1)))


def log_h_prior(surface: SurfaceFlux) -> tuple[float, float]:
    """Prior mean and standard deviation of log h.

    Parameters
    ----------
    surface
        The measured loss of the running surface, if there is one.

    Returns
    -------
    mean, sd
        Of the logarithm of h [W/m2K]; the standard deviation is infinite unless h was measured.

    Notes
    -----
    Joint fit and cooling fit must use the same prior; both call this function.
    """
    if not surface.is_measured:
        return 0.0, np.inf
    h = surface.heat_transfer_W_m2K
    return float(np.log(h)), max(surface.heat_transfer_u_W_m2K / h, MIN_H_U_REL)


# Step of the difference quotient by the position of the flux [m]. Chosen by judgement.
SHIFT_STEP_M = 0.25e-3
FLUX_SHIFT = NuisanceParameter("flux shift", "place of the flux")
UNRESOLVED_EDGE = NuisanceParameter("edge", "inner row of few junctions")
# Step of the difference quotient by the shape of h, relative to h. Chosen by judgement.
H_PROFILE_STEP = 0.1
# For each shape of h along the track, the two perturbations of the difference quotient.
H_PROFILE_STEPS = {
    NuisanceParameter(f"film along {name}", "film along the track"): [
        Perturbation(h_profile=(step * tilt, step * crown))
        for step in (H_PROFILE_STEP, -H_PROFILE_STEP)
    ]
    for name, tilt, crown in (("the width", 1.0, 0.0), ("the middle", 0.0, 1.0))
}


def flux_shift_effect(rim: RimMeans, share: float, h_W_m2K: float) -> Array:
    """Change of the outer row by the position of the flux, a central difference, (R, P) [K/m].

    Parameters
    ----------
    rim
        The rim, R blocks.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.

    Notes
    -----
    Because of the positions of d and f about b, the sign of a shift is each disk's own, so
    ``FLUX_SHIFT`` is not shared. ``tests/partition/test_structures.py`` compares the effect with a
    small shift.
    """
    boundary, power = rim.response(h_W_m2K, Perturbation(shift_m=SHIFT_STEP_M))
    other_boundary, other_power = rim.response(h_W_m2K, Perturbation(shift_m=-SHIFT_STEP_M))
    change = boundary - other_boundary + share * (power - other_power)
    return np.asarray(change / (2 * SHIFT_STEP_M))


def h_profile_effects(
    rim: RimMeans, share: float, h_W_m2K: float
) -> dict[NuisanceParameter, Array]:
    """Change of the outer row when h departs from its mean by all of itself, (R, P) [K] each.

    The shapes are the tilt and the crown of ``tcdyn.heat.nonuniform.h_along``.

    Parameters
    ----------
    rim
        The rim, R blocks.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.

    Returns
    -------
    dict
        The effect of each shape, by its nuisance parameter.

    Notes
    -----
    The mean of h stays, so that the fitted h is the mean. ``tests/partition/test_joint.py`` (study)
    tests an h that is lower at the track.
    """
    effects = {}
    for parameter, (up, down) in H_PROFILE_STEPS.items():
        boundary_up, power_up = rim.response(h_W_m2K, up)
        boundary_down, power_down = rim.response(h_W_m2K, down)
        change = (boundary_up + share * power_up) - (boundary_down + share * power_down)
        effects[parameter] = np.asarray(change) / (2 * H_PROFILE_STEP)
    return effects


def unresolved_edge_effect(rim: RimMeans, h_W_m2K: float) -> Array | None:
    """Change of the outer row by a constant kelvin at a rim edge that is not resolved, (P,) [K].

    None where the inner row determines the profile along z.

    Parameters
    ----------
    rim
        The rim.
    h_W_m2K
        Heat transfer coefficient of the running surface.

    Notes
    -----
    The effect is that of one more junction at the edge, at the place where the inner row leaves the
    profile most uncertain (``tcdyn.heat.rim.Rim.undetermined_z_m``). Joint fit and sensor check
    multiply it by ``SURROGATE_U_K``.
    """
    disk = Rim.from_setup(rim.setup)
    z = disk.undetermined_z_m
    if z is None:
        return None
    wider = replace(disk, boundary_z_m=(*disk.boundary_z_m, z))
    gains = cached_rim_gains(
        wider,
        h_W_m2K,
        junction_points(rim.setup, rim.setup.outer),
        rim.half_width_m,
        tuple(rim.rates_1_s),
        rim.profile,
        "hertz",
        FIT_MESH,
    )
    return gains.static[rim.ambient_index]


def specified_effects(
    disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float
) -> tuple[tuple[NuisanceParameter, ...], Array]:
    """Nuisance parameters of what is specified with an uncertainty, and their effects.

    Parameters
    ----------
    disk
        The traces of the disk, with its uncertainties.
    window
        Window of the disk, R blocks.
    share, h_W_m2K
        Share and heat transfer coefficient to linearise at.

    Returns
    -------
    parameters
        The Q nuisance parameters.
    effects
        Effect of one standard uncertainty of each on the outer row, (Q, R, P) [K].

    Notes
    -----
    To add a specification, give it a key in ``UncertaintyTable`` of :mod:`tcdyn.rig.tables`, an
    effect, and an entry here. A zero uncertainty must add no parameter:
    ``tests/partition/test_statement.py`` (study) expects no line of the budget for it.
    """
    u = disk.uncertainty
    rim = window.rim
    surface = disk.setup.surface
    effects: dict[NuisanceParameter, Array] = {}
    edge = unresolved_edge_effect(rim, h_W_m2K)
    if edge is not None:
        effects[UNRESOLVED_EDGE] = np.zeros_like(window.y)
        effects[UNRESOLVED_EDGE][:, : len(edge)] = SURROGATE_U_K * edge
    if u.film_along_rel:
        for parameter, change in h_profile_effects(rim, share, h_W_m2K).items():
            effects[parameter] = u.film_along_rel * change
    if u.flux_shift_mm:
        effects[FLUX_SHIFT] = 1e-3 * u.flux_shift_mm * flux_shift_effect(rim, share, h_W_m2K)
    if surface.is_measured and surface.air_u_K:
        effects[SURFACE_AIR] = surface_air_effect(rim, h_W_m2K, surface.air_u_K)
    if u.conductivity_slope_per_K:
        effects[CONDUCTIVITY_SLOPE] = conductivity_slope_effect(
            window, share, h_W_m2K, u.conductivity_slope_per_K
        )
    if u.specific_heat_slope_per_K:
        effects[SPECIFIC_HEAT_SLOPE] = specific_heat_slope_effect(
            rim, share, h_W_m2K, u.specific_heat_slope_per_K
        )
    return tuple(effects), np.reshape([*effects.values()], (len(effects), *window.y.shape))
