"""Sufficient statistics of one test: its likelihood, linear about the optimum, compressed by SVD.

Priors are left out. The parameters are the quantities (beta, ln h, lags) and the nuisance
parameters. Each nuisance parameter has a factor loading: how much of it is common to all tests of
the rig, and how much is specific to the test. A static line has an error of level and of gain. The
model error of the mesh and the angular harmonic grow with the heat. The unloading instant is
specific to each test.

``tcdyn.workflows`` stores the result in ``beta.json``; ``tcdyn.campaign.planned`` uses it for
planned tests. Guarded by ``tests/campaign/test_posterior.py`` and
``tests/partition/test_as_logged.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tcdyn.campaign.input_noise import friction_zero_u_N, noise_covariance
from tcdyn.campaign.sufficient_statistics import QUANTITIES, Loading, SufficientStatistics
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.estimation import Optimum
from tcdyn.partition.analyse import Partition
from tcdyn.partition.angular_harmonic import HARMONIC_PRIOR_K, AngularHarmonic
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import (
    LOG_H,
    LOG_LAGS,
    LOG_TAU2,
    LOG_TAU2_SD,
    SHARE,
    DiskBlock,
    lags,
    nuisance_parameters,
)
from tcdyn.partition.nuisance import FRICTION_NOISE, RIM_MODEL_U_K
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.partition.window import rows_between, steady_start_s
from tcdyn.rig.disk import DISKS

# Scale of the quantities in the SVD: of beta, ln h and the lags [s]. Chosen by judgement.
BETA_UNIT = 0.01
LOG_H_UNIT = 0.02
LAG_UNIT_S = 0.02
# Directions with less information than this (in standard uncertainties) are dropped.
MIN_SINGULAR_VALUE = 0.03
# Frictional power [W] at which errors that grow with heat have their stated size.
REFERENCE_POWER_W = 300.0
# Parts that are specific to a test, chosen by judgement:
LAG_TEST_SD_S = 0.01  # lag of a disk [s]
FRICTION_TEST_SD_REL = 0.0005  # scale of the friction, in addition to its zero (relative)
MODEL_TEST_SHARE = 0.1  # share of the model error of rim and mesh that does not grow with heat
HARMONIC_TEST_SHARE = 0.3  # share of the angular harmonic that does not grow with heat
# Share of the shape of the surface heat transfer along the track. The jets set the shape; it
# depends on the speed a little.
SURFACE_H_TEST_SHARE = 0.3
# Nuisance parameters that [constants] of rig.toml makes wider, with the key of ``constants_u``.
CONSTANT_KEYS = {
    "friction": "friction_rel",
    "half-width": "half_width_rel",
    "ambient": "ambient_K",
}
# Nuisance parameters that are fully specific to the test.
TEST_SPECIFIC = ("parting", "uneven drift", "uneven curvature", "air", FRICTION_NOISE)


@with_named_arguments
def compress_likelihood(
    name: str,
    rig: str,
    test: EhlTest,
    sides: Sequence[DiskBlock],
    best: Optimum,
    uneven: Mapping[str, AngularHarmonic],
    **conditions: float,
) -> SufficientStatistics:
    """Return the sufficient statistics of a test.

    Parameters
    ----------
    name, rig
        Name of the test; fingerprint of the rig.
    test
        The test.
    sides
        Block of each disk in the joint fit, in the order of ``DISKS``.
    best
        Optimum of the joint fit.
    uneven
        Angular harmonic of each disk.
    **conditions
        Further numbers to store with the conditions of the test.

    Returns
    -------
    The statistics, without any prior.

    Notes
    -----
    Noise of the model's inputs widens the rows that it affects. Slow components of the residuals
    beyond that noise widen all rows alike: see :func:`noise_covariance`.

    The columns of the Jacobian are those of ``tcdyn.partition.joint``: four for each disk, then the
    nuisance parameters. A further parameter there needs its column here, and a loading in
    ``loading_of`` unless it is fully common to the rig.
    """
    n_main = 4 * len(sides)
    n_data = len(best.residual) - len(sides)
    j = best.jacobian[:n_data]
    residual = best.residual[:n_data]
    theta = best.theta
    totals = [float(sum(lags(theta[4 * i : 4 * i + 4]))) for i in range(len(sides))]
    quantities = np.column_stack(
        [
            j[:, SHARE] - j[:, 4 + SHARE],
            *(j[:, 4 * i + LOG_H] for i in range(2)),
            *(j[:, 4 * i + LOG_LAGS] / totals[i] for i in range(2)),
        ]
    )
    shapes = LOG_TAU2_SD * j[:, LOG_TAU2:n_main:4]
    shape_values = [
        (theta[4 * i + LOG_TAU2] - np.log(s.prior_tau2_s)) / LOG_TAU2_SD
        for i, s in enumerate(sides)
    ]
    nuisance = nuisance_parameters(sides)
    nuisance_names = [f"{what.name} {d}".strip() for what, d in nuisance]
    names = (*QUANTITIES, *(f"lag shape {d}" for d in DISKS), *nuisance_names)
    centre = np.concatenate(
        [
            theta[[SHARE, LOG_H, 4 + LOG_H]],
            [total + s.remaining_lag_s for total, s in zip(totals, sides)],
            shape_values,
            theta[n_main:],
        ]
    )
    u, rows = compress_rows(np.hstack([quantities, shapes, j[:, n_main:]]))
    lower = np.linalg.cholesky(noise_covariance(test, sides, theta[:n_main], u, residual))
    rows = np.linalg.solve(lower, rows)
    right = np.linalg.solve(lower, -u.T @ residual)
    is_quantity = np.arange(len(names)) < len(QUANTITIES)
    informative = (np.abs(rows) > 0).any(axis=0) | is_quantity
    power_W = test.friction_N * test.sliding_speed_m_s
    loadings = {}
    units = {}
    for label, (what, d), use in zip(nuisance_names, nuisance, informative[len(QUANTITIES) + 2 :]):
        if not use:
            continue
        loading = loading_of(what, d, test, uneven, power_W)
        if loading is not None:
            loadings[label] = loading
        unit = unit_of(what, d or DISKS[0], test)
        if unit is not None:
            units[label] = unit
    return SufficientStatistics(
        name=name,
        rig=rig,
        names=tuple(n for n, use in zip(names, informative) if use),
        centre=centre[informative],
        rows=rows[:, informative],
        rhs=right,
        loading=loadings,
        lag_prior_s={s.disk: s.prior_lag_s for s in sides},
        lag_u_s={s.disk: s.prior_lag_u_s for s in sides},
        units=units,
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


@with_named_arguments
def sufficient_statistics_of(name: str, rig: str, partition: Partition) -> dict[str, Any] | None:
    """The block "kept" of ``beta.json``; None for a test whose result is withheld.

    Parameters
    ----------
    name
        Name of the test.
    rig
        Fingerprint of the rig, from ``tcdyn.campaign.sufficient_statistics.rig_fingerprint``.
    partition
        Result of the analysis of the test.
    """
    if partition.status == "withheld":
        return None
    statistics = compress_likelihood(
        name,
        rig,
        partition.test,
        [partition.joint[d].block for d in DISKS],
        partition.combined.optimum,
        partition.combined.harmonics,
        delta_T_us_K_m_s=partition.estimates["delta_T_us"].value,
    )
    return statistics.to_dict()


def compress_rows(rows: Array) -> tuple[Array, Array]:
    """Compress rows by a singular value decomposition.

    Parameters
    ----------
    rows
        Jacobian of N data by P parameters, shape (N, P).

    Returns
    -------
    u
        Orthonormal directions of the data, (N, M).
    compressed
        Compressed rows, (M, P).

    Notes
    -----
    Directions with a singular value below ``MIN_SINGULAR_VALUE`` are dropped. The columns of the
    quantities have the units ``BETA_UNIT``, ``LOG_H_UNIT`` and ``LAG_UNIT_S``, nuisance parameters
    their standard uncertainty. Smaller units drop more directions. Dropped directions lose
    information, but cause no bias.
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
    what: NuisanceParameter,
    disk: str,
    test: EhlTest,
    uneven: Mapping[str, AngularHarmonic],
    power_W: float,
) -> Loading | None:
    """Factor loading of a nuisance parameter; None if it is fully common to the rig.

    Parameters
    ----------
    what
        The nuisance parameter.
    disk
        Disk that it belongs to; empty for both.
    test
        The test.
    uneven
        Angular harmonic of each disk.
    power_W
        Frictional power of the test [W].

    Notes
    -----
    Shared and specific parts add in squares to one where the size does not depend on the test. The
    shares at the top of the module decide how much of an error differs between tests: a larger
    specific share makes differences between tests less certain. The names of the kinds are those of
    ``tcdyn.partition.joint.nuisance_parameters``.
    """
    kind, _, detail = what.name.partition(" ")
    label = f"{what.name} {disk}".strip()
    if what.name.startswith(TEST_SPECIFIC):
        return Loading({}, 1.0)
    if disk and detail in test.disks[disk].excluded:
        # The surrogate has another error; it is common to the tests without this channel.
        return Loading({f"{what.name} {disk}, left out": 1.0})
    if kind == "static":
        return _line_loading(detail, disk, test, power_W)
    key = CONSTANT_KEYS.get(what.name)
    if key:
        components = [test.constants_u.get(key, 0.0)]
        if kind == "friction":
            components.append(FRICTION_TEST_SD_REL)
            components.append(friction_zero_u_N(test) / test.friction_N)
            components.append(test.added_friction.u_N / test.friction_N)
        total = getattr(test.disks[disk or DISKS[0]].uncertainty, key)
        specific = float(np.hypot.reduce(components)) / max(total, 1e-12)
        common = float(np.sqrt(max(1 - specific**2, 0.0)))
        return Loading({label: common}, min(specific, 1.0))
    if what.source == "film along the track":
        common = float(np.sqrt(1 - SURFACE_H_TEST_SHARE**2))
        return Loading({f"{what.name} {disk}": common}, SURFACE_H_TEST_SHARE)
    if kind == "uneven":
        shape, side = detail.split(", ")
        index = [*HARMONIC_PRIOR_K].index(shape)
        size = HARMONIC_PRIOR_K[shape] / float(uneven[disk].prior_K[index])
        by_heat = size * power_W / REFERENCE_POWER_W
        return Loading({f"uneven {shape}, {side} {disk}": by_heat}, HARMONIC_TEST_SHARE * size)
    return None


def unit_of(what: NuisanceParameter, disk: str, test: EhlTest) -> float | None:
    """Standard uncertainty of a nuisance parameter [K, m, s or relative].

    None where it is not a single number.

    Parameters
    ----------
    what
        The nuisance parameter.
    disk
        Disk that it belongs to.
    test
        The test.
    """
    traces = test.disks[disk]
    kind, _, detail = what.name.partition(" ")
    u = traces.uncertainty
    if kind == "static":
        return _line_u_K(detail, disk, test)
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
    }.get(what.name)


def _line_u_K(channel: str, disk: str, test: EhlTest) -> float:
    """Standard uncertainty of a channel's static error [K], with the model error for the outer row.

    Parameters
    ----------
    channel
        The channel.
    disk
        Its disk.
    test
        The test.
    """
    traces = test.disks[disk]
    model = RIM_MODEL_U_K if channel in traces.setup.outer else 0.0
    return float(np.hypot(traces.static_u_K[traces.setup.channels.index(channel)], model))


def _line_loading(channel: str, disk: str, test: EhlTest, power_W: float) -> Loading:
    """Factor loading of a static line.

    Parameters
    ----------
    channel
        The channel.
    disk
        Its disk.
    test
        The test.
    power_W
        Frictional power of the test [W].

    Notes
    -----
    The errors of gain g and offset o are common to all tests: y dg + do = (do + y0 dg) + (y - y0)
    dg. The two terms are independent for y0 = -cov(g, o) / var(g).
    """
    traces = test.disks[disk]
    index = traces.setup.channels.index(channel)
    total = _line_u_K(channel, disk, test)
    line = traces.lines[index]
    steady = rows_between(test.time_s, steady_start_s(test), test.events.unload_s - 0.5)
    y = (float(traces.readings_degC[steady, index].mean()) - line.offset) / line.gain
    (gg, go), (_, oo) = line.covariance
    y0 = 0.0
    level_variance = oo
    if gg > 0:
        y0 = -go / gg
        level_variance = oo - go * go / gg
    level = float(np.sqrt(max(level_variance, 0.0)))
    gain = float((y - y0) * np.sqrt(gg))
    loadings = {f"line level {channel} {disk}": level, f"line gain {channel} {disk}": gain}
    # Rounding, and the error of a surrogate channel.
    specific_variance = traces.static_u_K[index] ** 2 - level**2 - gain**2
    specific = float(np.sqrt(max(specific_variance, 0.0)))
    if channel in traces.setup.outer:
        loadings[f"model {channel} {disk}"] = RIM_MODEL_U_K * power_W / REFERENCE_POWER_W
        specific = float(np.hypot(specific, MODEL_TEST_SHARE * RIM_MODEL_U_K))
    shared = {name: x / total for name, x in loadings.items()}
    return Loading(shared, specific / total)
