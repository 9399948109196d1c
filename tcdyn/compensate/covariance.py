"""Covariance between times of a smoothed trace, for a chosen window only: no N x N matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError
from tcdyn.chain import Chain
from tcdyn.compensate.grid import corner_rad_s
from tcdyn.compensate.model import grid_for, problem_for
from tcdyn.compensate.profile import shifted
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import stretch_of
from tcdyn.compensate.sweep import backward, forward

Array = NDArray[np.float64]
MARGIN = 12.0  # corner periods (1/rad) beyond the window that are smoothed along with it: exp(-12) of an end is left


def window_covariance(
    y: ArrayLike, dt_s: float, chain: Chain, result: Compensated, channel: int, first: int, last: int
) -> Array:
    """Covariance (n, n) [K2] of the temperatures at samples ``first`` .. ``last`` - 1 of one channel.

    Noise and regularisation by C(j, k) = J_j C(j+1, k), J_j = P_j F' (P-_{j+1})^-1 of the same smoother on the window
    and a margin; the lag adds lag_sensitivity_i lag_sensitivity_k u(lag)^2. The static line's part, the same error at
    all times, is left to the user, who knows whether it cancels.

    Args:
        y: (N,) the logged trace that ``result`` was made from [degC].
        dt_s, chain: as given to ``smooth``.
        result: what ``smooth`` returned.
        channel: column of ``result``.
        first, last: window, in samples.
    """
    data = np.asarray(y, dtype=float)
    if not 0 <= first < last <= len(data) or not result.intensities:
        raise InputError(
            f"window_covariance: samples {first} to {last} of {len(data)}", expected="a window inside a smoothed record"
        )
    noise_var = result.noise_sd[channel : channel + 1] ** 2
    q = result.intensities[channel]
    least = np.min(q.at(result.time_s[first:last]))
    corner = float(corner_rad_s(chain, np.array(least / (noise_var[0] * dt_s))))
    extra = int(np.ceil((MARGIN / corner + 5 * chain.lag_s) / dt_s))
    a, b = max(first - extra, 0), min(last + extra, len(data))
    part = np.where(result.flags[a:b, channel] == 0, data[a:b], np.nan)[:, None]
    events = [e - a * dt_s for e, _ in result.events_s]
    stretch, _, _ = stretch_of(part, dt_s, chain, events, result.noise_sd[channel : channel + 1])
    proposals = [[shifted(q, a * dt_s)]]
    grid = grid_for(stretch, proposals, noise_var)
    problem = problem_for(stretch, grid, noise_var, proposals)
    done = forward(problem)
    states = backward(problem, done)
    t = np.arange(first - a, last - a) * dt_s
    cell = np.clip(np.searchsorted(grid.knots_s, t + 1e-6 * dt_s, side="right") - 1, 0, grid.cells - 1)
    low, high = int(cell[0]), int(cell[-1])
    count, n = high - low + 1, states.mean.shape[2]
    between = np.zeros((count, count, n, n))
    for k in range(count):
        between[k, k] = states.cov[low + k, 0]
    for j in range(count - 2, -1, -1):
        across = problem.transition[problem.kind[low + j], 0, 0]
        kept = done.cov[low + j, 0]
        ahead = across @ kept @ across.T
        ahead[1, 1] += problem.slope_var[low + j + 1, 0, 0]
        gain = np.linalg.solve(ahead, across @ kept).T
        between[j, j + 1 :] = gain @ between[j + 1, j + 1 :]
        between[j + 1 :, j] = between[j, j + 1 :].transpose(0, 2, 1)
    row = np.zeros((len(t), n))
    row[:, 0], row[:, 1] = 1.0, t - grid.knots_s[cell]
    pairs = between[(cell - low)[:, None], (cell - low)[None, :]]
    out = np.einsum("ia,ijab,jb->ij", row, pairs, row, optimize=True)
    s = result.lag_sensitivity[first:last, channel]
    return np.asarray(out + np.outer(s, s) * result.lag_covariance[channel, channel])
