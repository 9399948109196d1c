"""Equation error (ARX): what disturbs the output comes in before the poles, which colour it; starts by regression."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from calibration import Array
from tcdyn.fitting import Noise

if TYPE_CHECKING:
    from tcdyn.identify.problem import Posed

STRIDES = (1, 3, 10)  # samples, of the regressions that starts come from
LONGEST, SHORTEST = 0.9999, 1e-3  # of a start's discrete poles


def colour(posed: Posed, x: Array) -> Noise:
    """The noise 1/A(q) that the model's own poles make of a white one before them; white where they do not."""
    if not posed.model.arx:
        return Noise()
    poles = np.concatenate([f.poles for f in posed.rationals(x)[0].factors if f.free])
    return Noise(tuple(np.poly(np.exp(poles * posed.dt_s)).real[1:].tolist()), fitted=0)


def equation_error(posed: Posed, x: Array, r: Array, j: Array) -> tuple[Array, Array]:
    """The equation error A(q) r of residuals ``r`` (N,), A by :func:`colour`, and its Jacobian from theirs, ``j``.

    A moves with x, so that the noise tells of the poles as in an ARX regression. Nought where a part (a stretch without
    a gap) lacks the samples before.
    """
    own = np.array(colour(posed, x).ar)
    moved = [i for i, n in enumerate(posed.model.free) if n[0] == "a"]
    step = 1e-6 * np.maximum(np.abs(x), 1e-9)
    slopes = [(np.array(colour(posed, x + step * (np.arange(len(x)) == i)).ar) - own) / step[i] for i in moved]
    w, table, p = np.zeros_like(r), np.zeros_like(j), len(own)
    for s in posed.parts:
        late = np.array([r[s.start + p - k : s.stop - k] for k in range(1, p + 1) if s.stop - s.start > p])
        if len(late):
            w[s.start + p : s.stop] = r[s.start + p : s.stop] + own @ late
            table[s.start + p : s.stop] = lfilter([1.0, *own], [1.0], j[s], axis=0)[p:]
            table[s.start + p : s.stop, moved] += (np.array(slopes) @ late).T
    return w, table


def regressed(posed: Posed, order: int, late: int = 0, stride: int = 1) -> tuple[Array, float]:
    """Denominator 1 + a1 s + .. (order + 1,) of an ARX regression of every ``stride``-th sample, all inputs behind the
    same poles and ``late`` samples, and its criterion N ln S + 2 parameters.

    Poles are put into the stable half plane; one that alternates from sample to sample has no likeness in continuous
    time, and gets its size.
    """
    rows, outputs = [], []
    m = order + late
    for s in posed.segments:
        n = len(s.y) // stride
        if n <= m:
            continue
        y = np.where(s.seen, s.y, np.nan)[: n * stride : stride]
        u = (
            s.inputs[: n * stride].reshape(n, stride, -1).mean(axis=1)
            if posed.hold == "zoh"
            else s.inputs[::stride][:n]
        )
        columns = [y[m - i : n - i] for i in range(1, order + 1)]
        columns += [v[m - late - i : n - late - i] for v in u.T for i in range(order + 1)]
        rows.append(np.column_stack([*columns, np.ones(n - m)]))
        outputs.append(y[m:])
    if not rows:
        return np.ones(1), np.inf
    table, y = np.vstack(rows), np.concatenate(outputs)
    good = np.isfinite(table).all(axis=1) & np.isfinite(y)
    table, y = table[good], y[good]
    if len(y) <= table.shape[1]:
        return np.ones(1), np.inf
    size = np.linalg.norm(table, axis=0) + 1e-300
    theta = np.linalg.lstsq(table / size, y, rcond=1e-10)[0] / size
    error = y - table @ theta
    z = np.roots(np.append(1.0, -theta[:order])) + 0j
    far, angle = np.abs(z), np.where(z.imag == 0, 0.0, np.angle(z))
    far = np.clip(np.where(far > 1, 1 / np.maximum(far, 1.0), far), SHORTEST, LONGEST)
    below = np.poly((np.log(far) + 1j * angle) / (stride * posed.dt_s)).real[::-1]
    return below / below[0], float(len(y) * np.log(error @ error / len(y) + 1e-300) + 2 * len(theta))
