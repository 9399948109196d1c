"""The cooling fit: with the power gone, h is the one unknown of a disk on its steady line (sections 4.4 and 7.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from calibration.errors import InputError
from tcdyn.partition.steady import Line
from tcdyn.partition.window import DiskWindow

H_RANGE_W_M2K = (5.0, 8000.0)
MATCH_S = 10.0  # the model is matched to the readings over this long before parting


@dataclass(frozen=True)
class CoolingFit:
    """h [W/m2K] and share of one disk from its cooling; ``misfit_K`` is the rms over the window.

    ``slope`` (R, 3): change of the matched model per unit of h along the line; ``inside`` (R,): blocks of the window,
    ``weight`` (inside,) their samples; ``h_noise`` its standard uncertainty from the compensated traces' noise alone.
    """

    disk: str
    h_W_m2K: float
    share: float
    window_s: float
    misfit_K: float
    residual_K: NDArray[np.float64]
    slope: NDArray[np.float64]
    power: NDArray[np.float64]
    inside: NDArray[np.bool_]
    weight: NDArray[np.float64]
    before: NDArray[np.bool_]
    h_noise: float

    @property
    def beta(self) -> float:
        """Heat partition of the fast disk."""
        return self.share if self.disk == "fast" else 1.0 - self.share

    def matched(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """``x`` (R, 3) less its mean just before parting."""
        return np.asarray(x - x[self.before].mean(axis=0))

    def pull(self, effect: NDArray[np.float64]) -> float:
        """Change of the fitted h when the model's prediction changes by ``effect`` (R, 3) [K]."""
        s, w = self.slope[self.inside], self.weight[:, None]
        return -float((w * s * self.matched(effect)[self.inside]).sum() / (w * s * s).sum())


def cooling_fit(window: DiskWindow, line: Line, unload_s: float, window_s: float, noise_K: float) -> CoolingFit:
    """Fit h alone to compensated traces over ``window_s`` seconds after ``unload_s``; the share follows the line.

    Each outer junction is compared with the model after both are matched over the last ``MATCH_S`` seconds under
    load, so that static errors, which the steady line already holds, do not enter twice. ``noise_K`` is the standard
    deviation of what compensation left in a trace. Raises InputError when no h in 5..8000 W/m2K fits best inside.
    """
    inside = window.between(unload_s, unload_s + window_s)
    before = window.between(unload_s - MATCH_S, unload_s - 0.1)
    weight = window.blocks.counts[inside][:, None].astype(float)

    def model(h: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        rest, power = window.answer(window.gains(h))
        return rest + line.at(h) * power, power

    def matched(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(x - x[before].mean(axis=0))

    target = matched(window.y)

    def cost(log_h: float) -> float:
        gap = (target - matched(model(float(np.exp(log_h)))[0]))[inside]
        return float((weight * gap**2).sum())

    low, high = np.log(H_RANGE_W_M2K)
    best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    if min(best.x - low, high - best.x) < 1e-2:
        raise InputError(
            f"the cooling fit of the {window.disk} disk runs to h = {np.exp(best.x):.3g} W/m2K",
            expected="an h between 5 and 8000 W/m2K",
            remedy="the lag or the instant of parting may be wrong; compare with the joint fit",
        )
    h = float(np.exp(best.x))
    predicted, power = model(h)
    step = 1e-3 * h
    slope = matched((model(h + step)[0] - model(h - step)[0]) / (2 * step))
    residual = target - matched(predicted)
    s = slope[inside]
    scatter = np.sqrt(((s * weight) ** 2 / weight * noise_K**2).sum()) / (weight * s * s).sum()
    return CoolingFit(
        window.disk,
        h,
        line.at(h),
        window_s,
        float(np.sqrt((weight * residual[inside] ** 2).sum() / (3 * weight.sum()))),
        residual,
        slope,
        power,
        inside,
        weight[:, 0],
        before,
        float(scatter),
    )
