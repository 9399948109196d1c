"""The steady line of each disk in the (share, h) plane, and the speed law that picks a point on both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError

H_GRID_W_M2K: NDArray[np.float64] = np.asarray(np.arange(100.0, 1201.0, 100.0), dtype=np.float64)  # section 4.3
SHARE_GRID: NDArray[np.float64] = np.asarray(np.arange(0.1, 1.01, 0.1), dtype=np.float64)


@dataclass(frozen=True)
class Line:
    """share = intercept + slope h: what the steady running of one disk leaves free; (4.1), (4.2).

    ``share`` is beta for the fast disk and 1 - beta for the slow one; ``slope`` in 1/(W/m2K).
    """

    intercept: float
    slope: float

    def at(self, h_W_m2K: float) -> float:
        """The share that fits the steady temperatures if the heat transfer coefficient is ``h_W_m2K``."""
        return self.intercept + self.slope * h_W_m2K


@dataclass(frozen=True)
class SteadyMap:
    """Misfit of one disk over a grid of shares and h, and the line of least misfit.

    ``mean_abs_K`` and ``rms_K`` have shape (n_h, n_share); ``best_share`` is, for each h, the share of least squares.
    """

    h_W_m2K: NDArray[np.float64]
    share: NDArray[np.float64]
    mean_abs_K: NDArray[np.float64]
    rms_K: NDArray[np.float64]
    best_share: NDArray[np.float64]
    line: Line
    thesis_line: Line


@dataclass(frozen=True)
class SpeedLawPoint:
    """beta and both heat transfer coefficients [W/m2K] where the lines meet h_fast / h_slow = chi."""

    beta: float
    h_fast: float
    h_slow: float
    chi: float


def speed_ratio_power(speed_ratio: float, exponent: float) -> float:
    """chi = (u_f / u_s)^n, eq. (4.6).

    >>> round(speed_ratio_power(4.24, 0.667), 2)
    2.62
    """
    return float(speed_ratio**exponent)


def speed_law_beta(A: float, B: float, C: float, D: float, chi: float) -> float:
    """beta = (A D + chi B (1 - C)) / (D + chi B): eq. (4.7) as it must read with (4.1), (4.2) and (4.6).

    ``A``, ``B``: intercept and slope of the fast line beta = A + B h_f; ``C``, ``D``: of the slow line
    1 - beta = C + D h_s. The thesis prints (4.7) for a slow line written for beta.

    >>> B, D = (0.83 - 0.37) / 1100, (0.48 - 0.20) / 1100
    >>> round(speed_law_beta(0.37 - 100 * B, B, 0.20 - 100 * D, D, 4.24**0.667), 2)
    0.73
    """
    return (A * D + chi * B * (1 - C)) / (D + chi * B)


def speed_law(fast: Line, slow: Line, speed_ratio: float, exponent: float) -> SpeedLawPoint:
    """The point of both lines that obeys h_fast = (u_f/u_s)^n h_slow.

    Raises InputError when the lines do not rise with h or meet at a negative h: then the data contradict the model.
    """
    chi = speed_ratio_power(speed_ratio, exponent)
    if fast.slope <= 0 or slow.slope <= 0:
        raise InputError(
            f"a steady line falls with h (slopes {fast.slope:.3g} and {slow.slope:.3g})",
            expected="more loss to need more heat",
            remedy="check that no channels are swapped and that depths in rig.toml are those of this disk",
        )
    beta = speed_law_beta(fast.intercept, fast.slope, slow.intercept, slow.slope, chi)
    h_fast = (beta - fast.intercept) / fast.slope
    return SpeedLawPoint(beta, h_fast, h_fast / chi, chi)


def exponent_sensitivity(
    fast: Line, slow: Line, speed_ratio: float, exponents: NDArray[np.float64]
) -> NDArray[np.float64]:
    """beta by the speed law for each exponent n (figure 4.17), shape of ``exponents``.

    >>> B, D = 0.46 / 1100, 0.28 / 1100
    >>> lines = Line(0.37 - 100 * B, B), Line(0.20 - 100 * D, D)
    >>> exponent_sensitivity(*lines, 4.24, np.array([0.571, 0.667, 0.8])).round(2)
    array([0.72, 0.73, 0.75])
    """
    chi = speed_ratio ** np.asarray(exponents, dtype=float)
    return np.array([speed_law_beta(fast.intercept, fast.slope, slow.intercept, slow.slope, float(c)) for c in chi])


def steady_map(
    y: NDArray[np.float64],
    boundary: NDArray[np.float64],
    per_share: NDArray[np.float64],
    h_W_m2K: NDArray[np.float64] = H_GRID_W_M2K,
    share: NDArray[np.float64] = SHARE_GRID,
    weights: NDArray[np.float64] | None = None,
) -> SteadyMap:
    """Misfit over (h, share) and the line of least misfit, the thesis's way and directly.

    ``y``: measured outer row, (rows, P) [degC]; ``boundary``: model with no frictional heat, (n_h, rows, P) [degC];
    ``per_share``: model response to a share of one, (n_h, rows, P) [K]; ``weights``: of the P junctions, (7.1) gives
    each the same, (7.2) a double one to ``a``. The model is linear in the share, so for each h the best share is one
    division, and the map costs no further model run. The thesis's line fits a parabola to the error along each h
    (figure 4.10) and then a straight line through the minima.
    """
    w = np.ones(y.shape[1]) if weights is None else np.asarray(weights, dtype=float)
    w = w / w.sum()
    gap = y[None] - boundary
    best = np.einsum("hrp,hrp,p->h", gap, per_share, w) / np.einsum("hrp,hrp,p->h", per_share, per_share, w)
    misfit = gap[:, None] - share[None, :, None, None] * per_share[:, None]
    mean_abs = np.einsum("hsrp,p->hs", np.abs(misfit), w) / y.shape[0]
    rms = np.sqrt(np.einsum("hsrp,hsrp,p->hs", misfit, misfit, w) / y.shape[0])
    slope, intercept = np.polyfit(h_W_m2K, best, 1)
    thesis_best = np.array([_parabola_minimum(share, row) for row in mean_abs])
    inside = (thesis_best >= share[0]) & (thesis_best <= share[-1])
    use = inside if inside.sum() >= 3 else np.ones_like(inside)
    t_slope, t_intercept = np.polyfit(h_W_m2K[use], thesis_best[use], 1)
    return SteadyMap(
        h_W_m2K,
        share,
        mean_abs,
        rms,
        best,
        Line(float(intercept), float(slope)),
        Line(float(t_intercept), float(t_slope)),
    )


def _parabola_minimum(x: NDArray[np.float64], error: NDArray[np.float64]) -> float:
    """Where the parabola through the least error and its neighbours is least."""
    k = int(np.clip(np.argmin(error), 2, len(x) - 3))
    c2, c1, _ = np.polyfit(x[k - 2 : k + 3], error[k - 2 : k + 3], 2)
    return float(-c1 / (2 * c2)) if c2 > 0 else float(x[np.argmin(error)])
