"""The fit of both disks of one test, linear about its optimum, in few rows: its data alone, priors left out.

Parameters become the answers (beta, ln h, lags) and what nobody measured; each of the latter says how much of it is the
rig's, the same in every test, and how much the test's own. A static line errs by its level and its gain; what a mesh
leaves unexplained and a pattern round the bore grow with the heat; the parting is each test's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tcdyn.campaign.input_noise import whole_noise, zero_u
from tcdyn.campaign.sufficient_statistics import ANSWERS, KeptTest, Loading
from tcdyn.core import Array
from tcdyn.estimation import Optimum
from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import SHAPES, Unevenness, Unmeasured
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import LOG_H, LOG_LAGS, LOG_TAU2, SHAPE_SD, SHARE, Side, lags, unknowns
from tcdyn.partition.nuisance import MODEL_K
from tcdyn.partition.window import between, steady_start_s
from tcdyn.rig.disk import DISKS

# of the answers, where rows are weighed against each other
BETA_UNIT = 0.01
LOG_H_UNIT = 0.02
LAG_UNIT_S = 0.02
LEAST_ROW = 0.03  # rows that tell less than this of a standard uncertainty of anything are left out
REFERENCE_W = 300.0  # frictional power at which what grows with heat is as large as stated
LAG_OWN_S = 0.01  # of a disk's lag from test to test
FRICTION_OWN_REL = 0.0005  # of the friction's scale from test to test, beside its zero
MODEL_OWN = 0.1  # of what rim and mesh leave unexplained, that does not grow with heat
ROUND_OWN = 0.3  # of a pattern round the bore, that does not grow with heat
FILM_OWN = (
    0.3  # of the film's shape along the track, which is the jets' and hangs on the speed a little
)
OF_LOG = {
    "friction": "friction_rel",
    "half-width": "half_width_rel",
    "ambient": "ambient_K",
}  # [constants] widen them
OWN = ("parting", "uneven drift", "uneven bend", "air")  # of the test alone, wholly


def compressed(
    name: str,
    rig: str,
    test: EhlTest,
    sides: Sequence[Side],
    best: Optimum,
    uneven: Mapping[str, Unevenness],
    **conditions: float,
) -> KeptTest:
    """Rows of ``test``, whose ``sides`` were fitted together as ``best``, on the rig with the fingerprint ``rig``.

    The noise of what drives the model widens the rows that it moves; slow waves of the residuals beyond it all alike.
    """
    k = 4 * len(sides)
    data = len(best.residual) - len(sides)
    j = best.jacobian[:data]
    theta = best.theta
    totals = [float(sum(lags(theta[4 * i : 4 * i + 4]))) for i in range(len(sides))]
    answers = np.column_stack(
        [
            j[:, SHARE] - j[:, 4 + SHARE],
            *(j[:, 4 * i + LOG_H] for i in range(2)),
            *(j[:, 4 * i + LOG_LAGS] / totals[i] for i in range(2)),
        ]
    )
    shapes = SHAPE_SD * j[:, LOG_TAU2:k:4]
    shape_at = [
        (theta[4 * i + LOG_TAU2] - np.log(s.prior_tau2_s)) / SHAPE_SD for i, s in enumerate(sides)
    ]
    unknown = unknowns(sides)
    labels = [f"{what.name} {d}".strip() for what, d in unknown]
    names = (*ANSWERS, *(f"lag shape {d}" for d in DISKS), *labels)
    centre = np.concatenate(
        [
            theta[[SHARE, LOG_H, 4 + LOG_H]],
            [total + s.rest_of_lag_s for total, s in zip(totals, sides)],
            shape_at,
            theta[k:],
        ]
    )
    u, rows = fewer_rows(np.hstack([answers, shapes, j[:, k:]]))
    lower = np.linalg.cholesky(whole_noise(test, sides, theta[:k], u, best.residual[:data]))
    rows = np.linalg.solve(lower, rows)
    right = np.linalg.solve(lower, -u.T @ best.residual[:data])
    seen = (np.abs(rows) > 0).any(axis=0) | (np.arange(len(names)) < len(ANSWERS))
    power_W = test.friction_N * test.sliding_speed_m_s
    used = [
        (label, *one) for label, one, use in zip(labels, unknown, seen[len(ANSWERS) + 2 :]) if use
    ]
    loadings = {label: loading_of(what, d, test, uneven, power_W) for label, what, d in used}
    units = {label: unit_of(what, d or DISKS[0], test) for label, what, d in used}
    return KeptTest(
        name=name,
        rig=rig,
        names=tuple(n for n, use in zip(names, seen) if use),
        centre=centre[seen],
        rows=rows[:, seen],
        right=right,
        loading={label: one for label, one in loadings.items() if one is not None},
        lag_prior_s={s.disk: s.prior_lag_s for s in sides},
        lag_u_s={s.disk: s.prior_lag_u_s for s in sides},
        units={label: size for label, size in units.items() if size is not None},
        conditions={
            "load_N": test.load_N,
            "friction_N": test.friction_N,
            "sliding_speed_m_s": test.sliding_speed_m_s,
            "entraining_speed_m_s": test.entraining_speed_m_s,
            "speed_ratio": test.speed_ratio,
            "power_W": power_W,
            "speed_exponent": test.speed_exponent,
            **conditions,
        },
    )


def kept_of(name: str, rig: str, p: Partition) -> dict[str, Any] | None:
    """What ``beta.json`` keeps of an analysed test for its campaign; None where its answer is withheld."""
    if p.status == "withheld":
        return None
    sides = [p.joint[d].side for d in DISKS]
    heat = p.answers["delta_T_us"].value
    return compressed(
        name, rig, p.test, sides, p.both.optimum, p.both.uneven, delta_T_us_K_m_s=heat
    ).to_dict()


def fewer_rows(rows: Array) -> tuple[Array, Array]:
    """Orthonormal directions (N, M) of data, and as few rows (M, P) of P parameters as tell what ``rows`` (N, P) do.

    By singular values, the answers in their units; directions of which the data tell nearly nothing are left out.
    """
    unit = np.ones(rows.shape[1])
    unit[: len(ANSWERS)] = BETA_UNIT, LOG_H_UNIT, LOG_H_UNIT, LAG_UNIT_S, LAG_UNIT_S
    told = rows.any(axis=0)
    u, s, vt = np.linalg.svd(rows[:, told] * unit[told], full_matrices=False)
    keep = s > LEAST_ROW
    few = np.zeros((int(keep.sum()), rows.shape[1]))
    few[:, told] = s[keep, None] * vt[keep] / unit[told]
    return u[:, keep], few


def loading_of(
    what: Unmeasured, disk: str, test: EhlTest, uneven: Mapping[str, Unevenness], power_W: float
) -> Loading | None:
    """How an unmeasured quantity of a test hangs on what all tests share; None where it is wholly the rig's."""
    kind, _, place = what.name.partition(" ")
    if what.name.startswith(OWN):
        return Loading({}, 1.0)
    if (
        disk and place in test.disks[disk].left_out
    ):  # what stands in errs otherwise, alike in tests without it
        return Loading({f"{what.name} {disk}, left out": 1.0})
    if kind == "static":
        return _static(place, disk, test, power_W)
    if key := OF_LOG.get(what.name):
        parts = [test.stated_u.get(key, 0.0)]
        if kind == "friction":
            parts += [
                FRICTION_OWN_REL,
                zero_u(test) / test.friction_N,
                test.added.u_N / test.friction_N,
            ]
        total = getattr(test.disks[disk or DISKS[0]].uncertainty, key)
        own = float(np.hypot.reduce(parts)) / max(total, 1e-12)
        return Loading(
            {f"{what.name} {disk}".strip(): float(np.sqrt(max(1 - own**2, 0.0)))}, min(own, 1.0)
        )
    if what.source == "film along the track":
        return Loading({f"{what.name} {disk}": float(np.sqrt(1 - FILM_OWN**2))}, FILM_OWN)
    if kind == "uneven":
        shape, side = place.split(", ")
        size = SHAPES[shape] / float(uneven[disk].prior_K[[*SHAPES].index(shape)])
        return Loading(
            {f"uneven {shape}, {side} {disk}": size * power_W / REFERENCE_W}, ROUND_OWN * size
        )
    return None


def unit_of(what: Unmeasured, disk: str, test: EhlTest) -> float | None:
    """A standard uncertainty of an unmeasured quantity [K, m, s, or of itself]; None where it is no one number."""
    traces = test.disks[disk]
    (kind, _, place) = what.name.partition(" ")
    u = traces.uncertainty
    if kind == "static":
        model = MODEL_K if place in traces.setup.outer else 0.0
        return float(np.hypot(traces.static_u_K[traces.setup.channels.index(place)], model))
    if kind == "depth":
        return float(traces.depth_u_m[traces.setup.channels.index(place)])
    return {
        "conductivity": u.conductivity_rel,
        "heat capacity": u.heat_capacity_rel,
        "washer": u.washer_rel,
        "half-width": u.half_width_rel,
        "ambient": u.ambient_K,
        "parting": test.events.unload_u_s,
        "friction": u.friction_rel,
    }.get(what.name)


def _static(channel: str, disk: str, test: EhlTest, power_W: float) -> Loading:
    """A line errs by gain and offset, the same in every test: y dg + do = (do + y0 dg) + (y - y0) dg, the two parts
    independent about y0 = -cov(g, o)/var(g)."""
    traces = test.disks[disk]
    at = traces.setup.channels.index(channel)
    model = MODEL_K if channel in traces.setup.outer else 0.0
    total = float(np.hypot(traces.static_u_K[at], model))
    line = traces.lines[at]
    steady = between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    y = (float(traces.readings_degC[steady, at].mean()) - line.offset) / line.gain
    (gg, go), (_, oo) = line.covariance
    pivot = -go / gg if gg > 0 else 0.0
    level = float(np.sqrt(max(oo - (go * go / gg if gg > 0 else 0.0), 0.0)))
    gain = float((y - pivot) * np.sqrt(gg))
    parts = {f"line level {channel} {disk}": level, f"line gain {channel} {disk}": gain}
    rest = float(
        np.sqrt(max(traces.static_u_K[at] ** 2 - level**2 - gain**2, 0.0))
    )  # rounding, what stands in
    if model:
        parts[f"model {channel} {disk}"] = model * power_W / REFERENCE_W
        rest = float(np.hypot(rest, MODEL_OWN * model))
    return Loading({name: x / total for name, x in parts.items()}, rest / total)
