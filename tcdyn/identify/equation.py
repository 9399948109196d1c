"""Equation error (ARX): what disturbs the output comes in before the poles, which colour it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.signal import lfilter

from calibration import Array


def equation_error(
    colour: Callable[[Array], Array], x: Array, moved: Sequence[int], parts: Sequence[slice], r: Array, j: Array
) -> tuple[Array, Array]:
    """The equation error A(q) r of residuals ``r`` (N,), and its Jacobian from theirs, ``j``.

    ``colour`` gives the coefficients of A behind its first at ``x``, of which ``moved`` are the places that A depends
    on, so that the noise tells of the poles as in an ARX regression. Nought where a part (a stretch without a gap)
    lacks the samples before.
    """
    own = colour(x)
    step = 1e-6 * np.maximum(np.abs(x), 1e-9)
    slopes = [(colour(x + step * (np.arange(len(x)) == i)) - own) / step[i] for i in moved]
    w, table, p = np.zeros_like(r), np.zeros_like(j), len(own)
    for s in parts:
        late = np.array([r[s.start + p - k : s.stop - k] for k in range(1, p + 1) if s.stop - s.start > p])
        if len(late):
            w[s.start + p : s.stop] = r[s.start + p : s.stop] + own @ late
            table[s.start + p : s.stop] = lfilter([1.0, *own], [1.0], j[s], axis=0)[p:]
            table[s.start + p : s.stop, moved] += (np.array(slopes) @ late).T
    return w, table
