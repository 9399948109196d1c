"""Steel that depends on temperature: the equivalent linear disk and its nuisance parameters.

In Kirchhoff's temperature conduction is linear but for the diffusivity, which is taken at the rim's
temperature at the unloading: the rim is steady until then, and during the fits it cools by a tenth
of its excess over the air."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from tcdyn.core import Array
from tcdyn.heat.rim import lag_basis_means
from tcdyn.partition.angular_harmonic import NuisanceParameter
from tcdyn.partition.window import DiskWindow, Perturbation, RimMeans
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.rigfile import UncertaintyTable

CONDUCTIVITY_SLOPE = NuisanceParameter("conductivity slope", "conductivity slope", True)
SPECIFIC_HEAT_SLOPE = NuisanceParameter("specific heat slope", "specific heat slope", True)
# Readings of the inner row are averaged over this [s]: a column with their noise would explain
# that noise.
SMOOTH_S = 0.5


def depends_on_temperature(setup: DiskSetup, u: UncertaintyTable) -> bool:
    """Whether the steel's slopes with temperature are specified, or uncertain."""
    steel = setup.steel
    slopes = (
        steel.conductivity_per_K,
        steel.specific_heat_per_K,
        u.conductivity_slope_per_K,
        u.specific_heat_slope_per_K,
    )
    return any(slopes)


def linear_about(
    setup: DiskSetup, air_degC: float, surface_degC: float, rim_degC: float
) -> DiskSetup:
    """The equivalent disk of constant conductivity and specific heat at these temperatures.

    Notes
    -----
    In Kirchhoff's temperature (see ``SteelSlopes.straight``): k_m = k((T_A + T_s)/2), and
    rho c_m = rho c(T) k_m / k(T) at the rim's T, so that the diffusivity is the rim's.
    """
    steel = setup.steel.linearised_about(air_degC, surface_degC)
    k = steel.conductivity(steel.mean_degC)
    k_rim = steel.conductivity(rim_degC)
    return replace(
        setup,
        steel=steel,
        conductivity_W_mK=setup.conductivity_W_mK * k,
        specific_heat_J_kgK=setup.specific_heat_J_kgK * steel.specific_heat(rim_degC) * k / k_rim,
    )


def conductivity_slope_effect(
    window: DiskWindow, share: float, h_W_m2K: float, u_per_K: float
) -> Array:
    """Readings less prediction if the conductivity's slope is steeper by ``u_per_K``, (R, P) [K].

    The rim conducts differently, and Kirchhoff's transformation of the readings changes, also of
    those of the inner row that drive the rim."""
    rim = window.rim
    dt_s = float(window.time_s[1] - window.time_s[0])
    steel = rim.setup.steel
    gains = rim.gains(h_W_m2K)
    rim_degC = float(rim.inputs[:, rim.inner_inputs].mean())
    slope_rel = u_per_K / steel.conductivity(steel.mean_degC)
    conductivity = slope_rel * (steel.mean_degC - steel.reference_degC)
    at_rim = u_per_K * (rim_degC - steel.reference_degC) / steel.conductivity(rim_degC)
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
    """Change of the outer row if the slope of specific heat is higher by ``u_per_K``, (R, P)."""
    steel = rim.setup.steel
    rim_degC = float(rim.inputs[:, rim.inner_inputs].mean())
    heat_capacity = u_per_K * (rim_degC - steel.reference_degC) / steel.specific_heat(rim_degC)
    boundary, power = rim.response(h_W_m2K)
    perturbed_boundary, perturbed_power = rim.response(
        h_W_m2K, Perturbation(heat_capacity=heat_capacity)
    )
    return np.asarray(perturbed_boundary - boundary + share * (perturbed_power - power))
