"""What touching the surface above each thermocouple with a soldering iron will tell (section 6.4.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from calibration.disk import CHANNELS, DiskSetup
from tcdyn.chain import Chain
from tcdyn.design.prediction import Prediction, from_covariances, information
from tcdyn.plunge.parameters import stages

Array = NDArray[np.float64]
_OWN = ("lag", "ln_flux", "ln_radius", "start", "ln_duration", "ln_onset", "depth", "offset")


@dataclass(frozen=True)
class TouchPlan:
    """A touch of about two seconds on a small patch; nothing tells its instant but the reading itself."""

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


def patch_response(t_s: Array, depth_m: float, radius_m: float, k_W_mK: float, alpha_m2_s: float) -> Array:
    """Rise under the middle of a patch of radius a heated by a unit flux from t = 0 on a half space [K m2/W].

    T(z, t) = (2 sqrt(alpha t)/K) [ierfc(z / (2 sqrt(alpha t))) - ierfc(sqrt(z^2 + a^2) / (2 sqrt(alpha t)))]

    Source: Carslaw and Jaeger (1959), section 10.5 (III). Good while the heat has not met the disk's faces.
    """
    root = 2 * np.sqrt(alpha_m2_s * np.maximum(t_s, 1e-12))

    def ierfc(x: Array) -> Array:
        return np.asarray(np.exp(-(x**2)) / np.sqrt(np.pi) - x * erfc(x))

    rise = root / k_W_mK * (ierfc(depth_m / root) - ierfc(np.hypot(depth_m, radius_m) / root))
    return np.where(t_s > 0, rise, 0.0)


def predict_touches(plan: TouchPlan, setup: DiskSetup, *, lag_s: float = 0.65, logit: float = 0.0) -> Prediction:
    """Expected uncertainty of the lags from one touch above each thermocouple, by Fisher information.

    Each touch has its own flux, patch, start, duration and onset; conductivity and the lag's split are shared.
    """
    dt = 1 / plan.rate_Hz
    t = np.arange(-1.0, plan.window_s, dt)
    nominal = {
        "lag": lag_s,
        "ln_flux": np.log(plan.flux_W_m2),
        "ln_radius": np.log(plan.radius_m),
        "start": 0.0,
        "ln_duration": np.log(plan.duration_s),
        "ln_onset": np.log(plan.onset_s),
        "depth": 0.0,
        "offset": 0.0,
        "ln_k": 0.0,
        "split": logit,
    }

    def reading(channel: str, **moved: float) -> Array:
        v = {**nominal, **moved}
        k = setup.conductivity_W_mK * np.exp(v["ln_k"])
        alpha = k / (setup.density_kg_m3 * setup.specific_heat_J_kgK)
        depth = setup.junctions[channel].depth_m + v["depth"]
        since = t - v["start"]

        def patch(s: Array) -> Array:
            return patch_response(s, depth, float(np.exp(v["ln_radius"])), k, alpha)

        x = np.exp(v["ln_flux"]) * (patch(since) - patch(since - np.exp(v["ln_duration"])))
        taus, delay, _ = stages("P2", v["lag"], v["split"])
        chain = Chain((*taus, float(np.exp(v["ln_onset"]))), delay_s=delay, conditioning=setup.conditioning)
        return chain.response(x, dt) + v["offset"]

    steps = dict.fromkeys((*_OWN, "ln_k", "split"), 1e-3) | {"depth": 1e-6}
    jacobians = []
    for channel in CHANNELS:
        columns = [
            (reading(channel, **{name: nominal[name] + e}) - reading(channel, **{name: nominal[name] - e})) / (2 * e)
            for name, e in steps.items()
        ]
        jacobians.append(np.column_stack(columns))
    own = np.array(
        [
            np.inf,
            plan.flux_log_u,
            plan.radius_log_u,
            plan.start_u_s,
            plan.duration_log_u,
            plan.onset_log_u,
            plan.depth_u_m,
            np.inf,
        ]
    )
    covariance = information(jacobians, plan.noise_K, len(_OWN), 2, own, np.array([plan.conductivity_log_u, 1.5]))
    at = np.arange(len(CHANNELS)) * len(_OWN)
    label = f"touch of {plan.duration_s:g} s above each thermocouple"
    return from_covariances(label, "touch", [covariance[np.ix_(at, at)]])
