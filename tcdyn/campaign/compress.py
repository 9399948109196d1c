"""The fit of both disks of one test, linear about its optimum, in few rows: its data alone, priors
left out.

Parameters become the answers (beta, ln h, lags) and what nobody measured; each of the latter says
how much of it is the rig's, the same in every test, and how much the test's own. A static line errs
by its level and its gain; what a mesh leaves unexplained and a pattern round the bore grow with the
heat; the parting is each test's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tcdyn.campaign.input_noise import friction_zero_u_N, noise_covariance
from tcdyn.campaign.sufficient_statistics import QUANTITIES, Loading, SufficientStatistics
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
MIN_SINGULAR_VALUE = (
    0.03  # rows that tell less than this of a standard uncertainty of anything are left out
)
REFERENCE_POWER_W = 300.0  # frictional power at which what grows with heat is as large as stated
LAG_TEST_SD_S = 0.01  # of a disk's lag from test to test
FRICTION_TEST_SD_REL = 0.0005  # of the friction's scale from test to test, beside its zero
MODEL_TEST_SHARE = 0.1  # of what rim and mesh leave unexplained, that does not grow with heat
HARMONIC_TEST_SHARE = 0.3  # of a pattern round the bore, that does not grow with heat
SURFACE_H_TEST_SHARE = (
    0.3  # of the film's shape along the track, which is the jets' and hangs on the speed a little
)
CONSTANT_KEYS = {
    "friction": "friction_rel",
    "half-width": "half_width_rel",
    "ambient": "ambient_K",
}  # [constants] widen them
TEST_SPECIFIC = ("parting", "uneven drift", "uneven bend", "air")  # of the test alone, wholly


def compress_likelihood(
    name: str,
    rig: str,
    test: EhlTest,
    disks: Sequence[Side],
    optimum: Optimum,
    harmonics: Mapping[str, Unevenness],
    **conditions: float,
) -> SufficientStatistics:
    """Rows of ``test``, whose ``disks`` were fitted together as ``optimum``, on the rig with the
    fingerprint ``rig``.

    The noise of what drives the model widens the rows that it moves; slow waves of the residuals
    beyond it all alike.
    """
    n_main = 4 * len(disks)
    n_data = len(optimum.residual) - len(disks)
    j = optimum.jacobian[:n_data]
    theta = optimum.theta
    totals = [float(sum(lags(theta[4 * i : 4 * i + 4]))) for i in range(len(disks))]
    quantities = np.column_stack(
        [
            j[:, SHARE] - j[:, 4 + SHARE],
            *(j[:, 4 * i + LOG_H] for i in range(2)),
            *(j[:, 4 * i + LOG_LAGS] / totals[i] for i in range(2)),
        ]
    )
    shapes = SHAPE_SD * j[:, LOG_TAU2:n_main:4]
    shape_at = [
        (theta[4 * i + LOG_TAU2] - np.log(s.prior_tau2_s)) / SHAPE_SD for i, s in enumerate(disks)
    ]
    nuisance = unknowns(disks)
    nuisance_names = [f"{what.name} {d}".strip() for what, d in nuisance]
    names = (*QUANTITIES, *(f"lag shape {d}" for d in DISKS), *nuisance_names)
    centre = np.concatenate(
        [
            theta[[SHARE, LOG_H, 4 + LOG_H]],
            [total + s.rest_of_lag_s for total, s in zip(totals, disks)],
            shape_at,
            theta[n_main:],
        ]
    )
    u, rows = compress_rows(np.hstack([quantities, shapes, j[:, n_main:]]))
    lower = np.linalg.cholesky(
        noise_covariance(test, disks, theta[:n_main], u, optimum.residual[:n_data])
    )
    rows = np.linalg.solve(lower, rows)
    right = np.linalg.solve(lower, -u.T @ optimum.residual[:n_data])
    informative = (np.abs(rows) > 0).any(axis=0) | (np.arange(len(names)) < len(QUANTITIES))
    power_W = test.friction_N * test.sliding_speed_m_s
    used_nuisance = [
        (label, *one)
        for label, one, use in zip(nuisance_names, nuisance, informative[len(QUANTITIES) + 2 :])
        if use
    ]
    loadings = {
        label: loading_of(what, d, test, harmonics, power_W) for label, what, d in used_nuisance
    }
    units = {label: unit_of(what, d or DISKS[0], test) for label, what, d in used_nuisance}
    return SufficientStatistics(
        name=name,
        rig=rig,
        names=tuple(n for n, use in zip(names, informative) if use),
        centre=centre[informative],
        rows=rows[:, informative],
        right=right,
        loading={label: one for label, one in loadings.items() if one is not None},
        lag_prior_s={s.disk: s.prior_lag_s for s in disks},
        lag_u_s={s.disk: s.prior_lag_u_s for s in disks},
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


def sufficient_statistics_of(name: str, rig: str, partition: Partition) -> dict[str, Any] | None:
    """What ``beta.json`` keeps of an analysed test for its campaign; None where its answer is
    withheld.
    """
    if partition.status == "withheld":
        return None
    disks = [partition.joint[d].side for d in DISKS]
    delta_T_us = partition.answers["delta_T_us"].value
    return compress_likelihood(
        name,
        rig,
        partition.test,
        disks,
        partition.both.optimum,
        partition.both.uneven,
        delta_T_us_K_m_s=delta_T_us,
    ).to_dict()


def compress_rows(rows: Array) -> tuple[Array, Array]:
    """Orthonormal directions (N, M) of data, and as few rows (M, P) of P parameters as tell what
    ``rows`` (N, P) do.

    By singular values, the answers in their units; directions of which the data tell nearly nothing
    are left out.
    """
    unit = np.ones(rows.shape[1])
    unit[: len(QUANTITIES)] = BETA_UNIT, LOG_H_UNIT, LOG_H_UNIT, LAG_UNIT_S, LAG_UNIT_S
    nonzero = rows.any(axis=0)
    u, s, vt = np.linalg.svd(rows[:, nonzero] * unit[nonzero], full_matrices=False)
    keep = s > MIN_SINGULAR_VALUE
    compressed = np.zeros((int(keep.sum()), rows.shape[1]))
    compressed[:, nonzero] = s[keep, None] * vt[keep] / unit[nonzero]
    return u[:, keep], compressed


def loading_of(
    nuisance: Unmeasured,
    disk: str,
    test: EhlTest,
    harmonics: Mapping[str, Unevenness],
    power_W: float,
) -> Loading | None:
    """How an unmeasured quantity of a test hangs on what all tests share; None where it is wholly
    the rig's.
    """
    kind, _, detail = nuisance.name.partition(" ")
    if nuisance.name.startswith(TEST_SPECIFIC):
        return Loading({}, 1.0)
    if (
        disk and detail in test.disks[disk].left_out
    ):  # what stands in errs otherwise, alike in tests without it
        return Loading({f"{nuisance.name} {disk}, left out": 1.0})
    if kind == "static":
        return _line_loading(detail, disk, test, power_W)
    if key := CONSTANT_KEYS.get(nuisance.name):
        components = [test.stated_u.get(key, 0.0)]
        if kind == "friction":
            components += [
                FRICTION_TEST_SD_REL,
                friction_zero_u_N(test) / test.friction_N,
                test.added.u_N / test.friction_N,
            ]
        total = getattr(test.disks[disk or DISKS[0]].uncertainty, key)
        specific = float(np.hypot.reduce(components)) / max(total, 1e-12)
        return Loading(
            {f"{nuisance.name} {disk}".strip(): float(np.sqrt(max(1 - specific**2, 0.0)))},
            min(specific, 1.0),
        )
    if nuisance.source == "film along the track":
        return Loading(
            {f"{nuisance.name} {disk}": float(np.sqrt(1 - SURFACE_H_TEST_SHARE**2))},
            SURFACE_H_TEST_SHARE,
        )
    if kind == "uneven":
        shape, side = detail.split(", ")
        size = SHAPES[shape] / float(harmonics[disk].prior_K[[*SHAPES].index(shape)])
        return Loading(
            {f"uneven {shape}, {side} {disk}": size * power_W / REFERENCE_POWER_W},
            HARMONIC_TEST_SHARE * size,
        )
    return None


def unit_of(nuisance: Unmeasured, disk: str, test: EhlTest) -> float | None:
    """A standard uncertainty of an unmeasured quantity [K, m, s, or of itself]; None where it is no
    one number.
    """
    traces = test.disks[disk]
    (kind, _, detail) = nuisance.name.partition(" ")
    u = traces.uncertainty
    if kind == "static":
        model = MODEL_K if detail in traces.setup.outer else 0.0
        return float(np.hypot(traces.static_u_K[traces.setup.channels.index(detail)], model))
    if kind == "depth":
        return float(traces.depth_u_m[traces.setup.channels.index(detail)])
    return {
        "conductivity": u.conductivity_rel,
        "heat capacity": u.heat_capacity_rel,
        "washer": u.washer_rel,
        "half-width": u.half_width_rel,
        "ambient": u.ambient_K,
        "parting": test.events.unload_u_s,
        "friction": u.friction_rel,
    }.get(nuisance.name)


def _line_loading(channel: str, disk: str, test: EhlTest, power_W: float) -> Loading:
    """A line errs by gain and offset, the same in every test: y dg + do = (do + y0 dg) + (y - y0)
    dg, the two parts independent about y0 = -cov(g, o)/var(g).
    """
    traces = test.disks[disk]
    index = traces.setup.channels.index(channel)
    model = MODEL_K if channel in traces.setup.outer else 0.0
    total = float(np.hypot(traces.static_u_K[index], model))
    line = traces.lines[index]
    steady = between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    y = (float(traces.readings_degC[steady, index].mean()) - line.offset) / line.gain
    (gg, go), (_, oo) = line.covariance
    pivot = -go / gg if gg > 0 else 0.0
    level = float(np.sqrt(max(oo - (go * go / gg if gg > 0 else 0.0), 0.0)))
    gain = float((y - pivot) * np.sqrt(gg))
    loadings = {f"line level {channel} {disk}": level, f"line gain {channel} {disk}": gain}
    specific = float(
        np.sqrt(max(traces.static_u_K[index] ** 2 - level**2 - gain**2, 0.0))
    )  # rounding, what stands in
    if model:
        loadings[f"model {channel} {disk}"] = model * power_W / REFERENCE_POWER_W
        specific = float(np.hypot(specific, MODEL_TEST_SHARE * model))
    return Loading({name: x / total for name, x in loadings.items()}, specific / total)
