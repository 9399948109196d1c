"""What the data of a test contradict: the record's lags, the speed exponent, a depth, a static line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calibration.rigfile import UncertaintyTable
from tcdyn.partition.crosscheck import Tension
from tcdyn.partition.joint import LEAST_LAG_U_S, BothFit, DiskFit
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.sensors import SensorCheck, Suspect

WORDS = {"parting": "the instant of parting, or the chain's shape (a dead time, a third lag)"}


def tensions(
    test: EhlTest,
    joint: Mapping[str, DiskFit],
    both: BothFit,
    u: UncertaintyTable,
    sensors: SensorCheck | None = None,
) -> tuple[Tension, ...]:
    """Every stated value with the number of standard deviations by which the joint fits would move it.

    The lag's prior and posterior differ with variance u_prior^2 - u_posterior^2; an exponent inside its stated range
    is no tension, outside it counts from the nearer end; nuisances come as pulls of the fit of both disks; what the
    sensor map suspects comes with the normal deviate of its odds.
    """
    out = []
    for name, fit in joint.items():
        disk = test.disks[name]
        lag = fit.estimates["lag_s"]
        prior_u = max(disk.common_lag_u_s, LEAST_LAG_U_S)
        told = np.sqrt(max(prior_u**2 - lag.u**2, (0.3 * prior_u) ** 2))
        words = f"the lag of the {name} disk: record {disk.common_lag_s:.3f} s, unloading {lag.value:.3f} s"
        out.append(Tension(words, float((lag.value - disk.common_lag_s) / told)))
    n = both.estimates["exponent"]
    outside = n.value - float(np.clip(n.value, u.speed_exponent_low, u.speed_exponent_high))
    words = (
        f"the speed exponent: {test.speed_exponent:.3f} assumed, {n.value:.3f} +- {n.u:.3f} implied by the two disks"
    )
    out.append(Tension(words, outside / n.u))
    out += [Tension(WORDS.get(name, name), pull) for name, pull in both.pulls.items()]
    if sensors is not None:
        out += [Tension(_subject(s), float(np.sqrt(2.0 * max(s.log_odds, 0.0)))) for s in sensors.suspects]
    return tuple(out)


def _subject(suspect: Suspect) -> str:
    return f"{' and '.join(suspect.columns) or 'the junctions of the ' + suspect.disk + ' disk'} ({suspect.kind})"
