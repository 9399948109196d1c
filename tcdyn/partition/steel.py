"""Conductivity and specific heat that change with temperature: the disk that a linear rim stands for, and its doubt.

In Kirchhoff's temperature conduction is linear but for the diffusivity, which is taken at the rim's temperature when
the load goes: the rim is steady until then, and cools by a tenth of what it is above the air while the fits look on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from tcdyn.core import Array
from tcdyn.heat.rim import bank_means
from tcdyn.partition.angular_harmonic import Unmeasured
from tcdyn.partition.window import DiskWindow, Perturbation, RimMeans
from tcdyn.rig.disk import DiskSetup
from tcdyn.rig.rigfile import UncertaintyTable

CONDUCTIVITY_SLOPE = Unmeasured("conductivity slope", "conductivity slope", True)
SMOOTH_S = 0.5
SPECIFIC_HEAT_SLOPE = Unmeasured("specific heat slope", "specific heat slope", True)


def depends_on_temperature(setup: DiskSetup, u: UncertaintyTable) -> bool:
    """Whether steel that changes with temperature is stated, or left open."""
    stated = setup.steel.conductivity_per_K, setup.steel.specific_heat_per_K
    return any((*stated, u.conductivity_slope_per_K, u.specific_heat_slope_per_K))


def linear_about(
    setup: DiskSetup, air_degC: float, surface_degC: float, rim_degC: float
) -> DiskSetup:
    """The disk of one conductivity and specific heat that stands for ``setup`` at these temperatures.

    In Kirchhoff's temperature (see ``SteelSlopes.straight``): k_m = k((T_A + T_s)/2), and rho c_m = rho c(T) k_m / k(T)
    at the rim's T, so that the diffusivity is the rim's.
    """
    steel = setup.steel.about(air_degC, surface_degC)
    k, k_rim = (steel.conductivity(t) for t in (steel.middle_degC, rim_degC))
    return replace(
        setup,
        steel=steel,
        conductivity_W_mK=setup.conductivity_W_mK * k,
        specific_heat_J_kgK=setup.specific_heat_J_kgK * steel.specific_heat(rim_degC) * k / k_rim,
    )


def conductivity_slope_effect(
    window: DiskWindow, share: float, h_W_m2K: float, u_per_K: float
) -> Array:
    """What the outer row shows more than predicted if the conductivity's slope is steeper by ``u_per_K``, (R, P) [K].

    The rim conducts otherwise, and the readings bend otherwise, those of the inner row driving it.
    """
    rim = window.rim
    dt_s = float(window.time_s[1] - window.time_s[0])
    steel = rim.setup.steel
    g = rim.gains(h_W_m2K)
    at_rim = float(rim.inputs[:, rim.inner].mean())
    own = u_per_K / steel.conductivity(steel.middle_degC)
    more = own * (steel.middle_degC - steel.reference_degC)
    more_at_rim = u_per_K * (at_rim - steel.reference_degC) / steel.conductivity(at_rim)
    rest, power = rim.answer(h_W_m2K)
    other, heat = rim.answer(
        h_W_m2K, Perturbation(conductivity=more, heat_capacity=more - more_at_rim)
    )
    width = max(
        int(round(SMOOTH_S / dt_s)), 1
    )  # a column that held the readings' noise would explain it
    readings = window.readings[:, rim.setup.places(rim.setup.inner)]
    inner = own * steel.bend(uniform_filter1d(readings, width, axis=0, mode="nearest"))
    driven = window.blocks @ inner @ g.direct[rim.inner]
    for k, x in enumerate(inner.T, start=1):
        driven = driven + bank_means(x, dt_s, rim.rates_1_s, window.counts) @ g.gains[k].T
    predicted = rest + share * power
    return np.asarray(other + share * heat - predicted + driven - own * steel.bend(predicted))


def specific_heat_slope_effect(rim: RimMeans, share: float, h_W_m2K: float, u_per_K: float) -> Array:
    """What the outer row shows more if the specific heat rises more steeply by ``u_per_K``, (R, P) [K]."""
    steel = rim.setup.steel
    at_rim = float(rim.inputs[:, rim.inner].mean())
    more = u_per_K * (at_rim - steel.reference_degC) / steel.specific_heat(at_rim)
    rest, power = rim.answer(h_W_m2K)
    other, heat = rim.answer(h_W_m2K, Perturbation(heat_capacity=more))
    return np.asarray(other - rest + share * (heat - power))
