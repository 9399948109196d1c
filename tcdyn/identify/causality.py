"""Does the output move before the input? Exchanged columns and misaligned clocks are refused before they are
fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.arrays import Array
from calibration.errors import InputError
from tcdyn.identify.models import process
from tcdyn.identify.problem import Posed
from tcdyn.identify.start import filled, lag_bank

Fitted = tuple[float, int, float]  # r^2, shift [samples], lag [s]
REFINED = 4  # times the row of lags is narrowed to its cube root and less: from a factor 3 to 1 %


def shift_scores(x: Array, y: Array, reach: int) -> Array:
    """r^2 of y(t) with x(t - k) for k = -reach..reach over the samples both have, with the sign of r."""
    n = len(x)
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    cross = np.fft.irfft(np.fft.rfft(y, size) * np.conj(np.fft.rfft(x, size)), size)
    sxy = np.concatenate([cross[size - reach :], cross[: reach + 1]])
    k = np.arange(-reach, reach + 1)
    behind, ahead = np.maximum(k, 0), np.maximum(-k, 0)
    count = n - np.abs(k)

    def total(v: Array, first: NDArray[np.int_], last: NDArray[np.int_]) -> Array:
        sums = np.concatenate([[0.0], np.cumsum(v)])
        return np.asarray(sums[last] - sums[first])

    sx, sxx = (total(v, ahead, n - behind) for v in (x, x**2))
    sy, syy = (total(v, behind, n - ahead) for v in (y, y**2))
    vx, vy = sxx - sx**2 / count, syy - sy**2 / count
    good = (vx > 1e-9 * np.var(x) * n) & (vy > 1e-9 * np.var(y) * n)
    cov = sxy - sx * sy / count
    return np.asarray(np.where(good, np.sign(cov) * cov**2 / np.where(good, vx * vy, 1.0), 0.0))


def best_shifts(one: Posed, y: Array, taus_s: Array, reach: int) -> tuple[Fitted, Fitted]:
    """The best (r^2, shift in samples, lag [s]) with the output ahead of the input, and with it behind, for the lags
    ``taus_s`` (T,) and the output ``y`` (N,); ``one`` has one segment."""
    ahead, behind = (0.0, 0, float(taus_s[0])), (0.0, 0, float(taus_s[0]))
    for tau, x in zip(taus_s, lag_bank(one, taus_s)[0]):
        signed = shift_scores(x - x[0], y - y[0], reach)
        for score in (signed, -signed):
            k, m = int(np.argmax(score[: reach - 2])), reach - 2 + int(np.argmax(score[reach - 2 :]))
            ahead = max(ahead, (float(score[k]), reach - k, float(tau)))
            behind = max(behind, (float(score[m]), m - reach, float(tau)))
    return ahead, behind


def moves_first(ahead: Fitted, behind: Fitted) -> bool:
    """Whether the output ahead of the input explains it far better than behind (see :func:`check_causality`)."""
    return ahead[0] > 0.3 and 1 - ahead[0] < 0.7 * (1 - behind[0])


def check_causality(problem: Posed, where: str) -> None:
    """Raise InputError when a lag with a *negative* dead time explains the output far better than any real one.

    Far better means: more than two samples ahead, r^2 above 0.3, and less than 0.7 of the variance that the best
    dead time from zero upwards leaves unexplained. In trials every causal system, leads and integrators included,
    stayed above 0.97, exchanged or shifted columns below 0.63. On a record of little noise a trial lag a factor off
    leaves more than the right one early; so what a coarse row of lags suspects is judged by lags refined on both sides.
    """
    plain = replace(problem, model=process("P1D", known=problem.model.known))
    if problem.model.integrators or sum(len(s.u) for s in problem.segments) < 40:
        return
    longest = max(problem.segments, key=lambda s: len(s.u))
    one = replace(plain, segments=(longest,))
    n = len(longest.u)
    reach, y = n // 4, filled(longest)
    taus = np.geomspace(problem.dt_s, 0.3 * n * problem.dt_s, 8)
    ahead, behind = best_shifts(one, y, taus, reach)
    ratio = float(taus[1] / taus[0])
    for _ in range(REFINED):
        if not moves_first(ahead, behind):
            return
        for centre in (ahead[2], behind[2]):
            finer = best_shifts(one, y, centre * np.geomspace(1 / ratio, ratio, 9), reach)
            ahead, behind = max(ahead, finer[0]), max(behind, finer[1])
        ratio **= 0.3
    if moves_first(ahead, behind):
        raise InputError(
            f"the output moves about {ahead[1] * problem.dt_s:.3g} s before the input",
            where=where,
            expected="an output that follows its input",
            remedy="check that the columns are not exchanged and that both clocks agree; in a closed loop the input "
            "answers the output: use a record with the loop open, or --no-check (check=False)",
        )
