"""What the data of a test contradict: the record's lags, the speed exponent, a depth, a static line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import stats

from calibration.disk import DISKS
from calibration.estimate import Estimate
from tcdyn.partition.crosscheck import Tension
from tcdyn.partition.joint import LEAST_LAG_U_S, BothFit, DiskFit
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.sensors.check import SensorCheck, Suspect
from tcdyn.partition.sensors.depths import chance_of, largest_pulls

WORDS = {"parting": "the instant of parting, or the chain's shape (a dead time, a third lag)"}
DEPTH_ALARM = 0.03  # with the pairs of ways beyond three and the other values, alarms stay below 7 % of sound tests
OTHER_ALARM = 0.01
LEAST_CHANCE = 1e-12


def tensions(
    test: EhlTest,
    joint: Mapping[str, DiskFit],
    both: BothFit,
    sensors: SensorCheck | None = None,
) -> tuple[Tension, ...]:
    """Every stated value with the number of standard deviations by which the data would move it.

    Depths come from the sensor map, or where that was left out from the joint fit; other nuisances as pulls of the fit
    of both disks. The lag's prior and posterior differ with variance u_prior^2 - u_posterior^2; an exponent within the
    stated range about the one in use is no tension, outside it counts from the nearer end. What the sensor map suspects
    comes with the normal deviate of its odds.
    """
    depths = _depths(sensors)
    judged = {d for d in DISKS if sensors is not None and d in sensors.depths}
    pulls = {n: z for n, z in both.pulls.items() if not any(n.startswith("depth") and d in n for d in judged)}
    others = [(WORDS.get(name, name), z) for name, z in pulls.items()]
    for name, fit in joint.items():
        disk = test.disks[name]
        lag = fit.estimates["lag_s"]
        prior_u = max(disk.common_lag_u_s, LEAST_LAG_U_S)
        told = np.sqrt(max(prior_u**2 - lag.u**2, (0.3 * prior_u) ** 2))
        words = f"the lag of the {name} disk: record {disk.common_lag_s:.3f} s, unloading {lag.value:.3f} s"
        others.append((words, float((lag.value - disk.common_lag_s) / told)))
    n = both.estimates["exponent"]
    outside = n.value - float(np.clip(n.value, *test.exponent_range))
    words = f"the speed exponent: {test.speed_exponent:.3f} assumed, {n} implied by the two disks"
    others.append((words, outside / n.u))
    out = [Tension(what, z, _chance(z, len(others)), OTHER_ALARM) for what, z in others]
    named = [] if sensors is None else [_named(s) for s in sensors.suspects]
    return (*depths, *out, *named)


def _chance(z: float, count: int) -> float:
    """How often the largest of ``count`` independent normal deviates is at least |z|."""
    return float(max(-np.expm1(count * np.log1p(-min(2 * stats.norm.sf(abs(z)), 1 - 1e-9))), LEAST_CHANCE))


def _depths(sensors: SensorCheck | None) -> list[Tension]:
    """Stated depths against where the test places the junctions."""
    if sensors is None:
        return []
    tests = list(sensors.depths.values())
    largest, count = largest_pulls(tests), sum(len(t.pull) for t in tests)
    out = []
    for t in tests:
        for (channel, deeper), z in zip(t.deeper_m.items(), t.pull):
            mm = Estimate.normal(1e3 * deeper.value, 1e3 * deeper.u)
            way = "deeper" if mm.value > 0 else "nearer the surface"
            size = Estimate.normal(abs(mm.value), mm.u)
            words = f"the depth of junction {channel} of the {t.disk} disk (by this test {size} mm {way} than stated)"
            chance = max(chance_of(float(z), largest, count), LEAST_CHANCE)
            out.append(Tension(words, float(z), chance, DEPTH_ALARM))
    return out


def _named(suspect: Suspect) -> Tension:
    what = f"{' and '.join(suspect.columns) or 'the junctions of the ' + suspect.disk + ' disk'} ({suspect.kind})"
    z = float(np.sqrt(2.0 * max(suspect.log_odds, 0.0)))
    return Tension(what, z, LEAST_CHANCE, OTHER_ALARM)
