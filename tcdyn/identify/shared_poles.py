"""Transfer functions whose inputs share their poles, begun at ARX regressions, by output and by equation error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identify.fit import fit
from tcdyn.identify.heldout import QUICK, Task, blocks_out
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import Model, as_template, bare, several, transfer
from tcdyn.identify.problem import Posed
from tcdyn.identify.search import Fit, pose
from tcdyn.identify.validate import coloured

MOST_POLES = 5
UNSEEN = 1.05  # times either of them, above which it is not
STRIDES = (1, 3, 10)  # samples, of the regressions that starts come from
# of a start's discrete poles
LONGEST = 0.9999
SHORTEST = 1e-3
LATEST = 4  # samples of dead time that regressions ask for
SEEN = 0.97  # times the errors in data kept from the fit, below which a model of coloured residuals is worth while


def rival(task: Task, now: Fit, held_out_rms: float, like: Model) -> tuple[Fit, float] | None:
    """The transfer function, of one to five poles that all inputs share, that foresees best, and its error over that of
    ``now``; None where none foresees 3 % better or, with white residuals where those of ``now`` are coloured, at most
    5 % worse.

    Each is fitted by output error, unless the options state how the runs begin also with their initial states
    estimated, and, unless they state a noise, by equation error, which holds where the disturbances come in before the
    poles. What counts is simulation of data kept from the fit: the geometric mean of
    what is held out, which ``now`` does to ``held_out_rms``, and of :func:`blocks_out`, neither more than 5 %
    worse. ``like`` holds what all have.
    """
    best = None
    least = 1.0
    before = blocks_out(now)
    quick = {**task.options, **QUICK}
    kinds = [False] if {"noise", "baseline"} & set(quick) else [False, True]
    for order, arx in product(range(1, MOST_POLES + 1), kinds):
        for found in candidates(task.data, order, arx, quick, like):
            if (blocks := blocks_out(found) / before) > UNSEEN:
                continue
            try:
                last = task.unseen(
                    found, initial=found.problem.initial, start=found.identified.theta
                )
                rest = last[0] / held_out_rms
            except InputError:  # too little is left of the record
                continue
            asked = UNSEEN if coloured(now) and not coloured(found) else SEEN
            if rest <= UNSEEN and (both := float(np.sqrt(blocks * rest))) < asked * least:
                best = (found, both)
                least = both / asked
    return best


def candidates(
    data: IOData, order: int, arx: bool, options: Mapping[str, Any], template: Model
) -> Iterator[Fit]:
    """Fits with ``order`` poles begun at those of ARX regressions, without a dead time and, where regressions ask for
    one, with; by output error with initial states estimated too, where ``options`` leave that open."""
    plain = [transfer(order, order, arx=arx)] * len(data.input_names)
    posed = pose(
        data, several(plain, data.input_names, common=True), options.get("initial", "equilibrium")
    )
    late = min(range(LATEST), key=lambda k: regressed(posed, order, k)[1])
    for delay in (0, late) if late else (0,):
        part = transfer(order - 1, order, delay=True, arx=arx) if delay else plain[0]
        model = several(
            [part] * len(data.input_names), data.input_names, common=True, known=template.known
        )
        model = as_template(model, template)
        poles = [regressed(posed, order, delay // stride, stride)[0] for stride in STRIDES]
        dead = {n: max(delay - 1.0, 0.2) * data.dt_s for n in model.names if bare(n) == "Td"}
        starts = [
            dead | {f"a{i}": float(a) for i, a in enumerate(one) if i}
            for one in poles
            if len(one) > 1
        ]
        asked = (
            [options]
            if arx or "initial" in options
            else [options, {**options, "initial": "estimated"}]
        )
        for each in asked:
            try:
                found = fit(data, model, **each, start=starts)
            except InputError:
                continue
            starts = [*starts, dict(found.identified.theta)]
            yield found


def regressed(posed: Posed, order: int, late: int = 0, stride: int = 1) -> tuple[Array, float]:
    """Denominator 1 + a1 s + .. (order + 1,) of an ARX regression of every ``stride``-th sample, all inputs behind the
    same poles and ``late`` samples, and its criterion N ln S + 2 parameters.

    Poles are put into the stable half plane; one that alternates from sample to sample has no likeness in continuous
    time, and gets its size.
    """
    rows = []
    outputs = []
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
    table = np.vstack(rows)
    y = np.concatenate(outputs)
    good = np.isfinite(table).all(axis=1) & np.isfinite(y)
    table = table[good]
    y = y[good]
    if len(y) <= table.shape[1]:
        return np.ones(1), np.inf
    size = np.linalg.norm(table, axis=0) + 1e-300
    theta = np.linalg.lstsq(table / size, y, rcond=1e-10)[0] / size
    error = y - table @ theta
    z = np.roots(np.append(1.0, -theta[:order])) + 0j
    far = np.abs(z)
    angle = np.where(z.imag == 0, 0.0, np.angle(z))
    far = np.clip(np.where(far > 1, 1 / np.maximum(far, 1.0), far), SHORTEST, LONGEST)
    below = np.poly((np.log(far) + 1j * angle) / (stride * posed.dt_s)).real[::-1]
    return below / below[0], float(
        len(y) * np.log(error @ error / len(y) + 1e-300) + 2 * len(theta)
    )
