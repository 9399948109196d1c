"""Exponent and lags of a pair of sensors in a changing flow, for sheaths by finite volumes.

`python -m tests.sensors.pair_flow_study [RECORDS] [SEED]` prints for each course of the flow how
often exponent and lags are inside their 95 % intervals, their rms error over the median u, and how
often the exponent is named as contradicted, with the right prior and with one that is 0.35 off. The
sensors are those of ``tests.smoothing.flow_study``: solid cylinders of different size in one fluid.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.sensors.pair import pair_sensor
from tests.smoothing.flow_study import (
    FINE,
    FLOW_AT,
    LEAST,
    down_to_zero,
    film_of,
    lags_of,
    reading_of,
    steps,
    turbulence,
)

DT_S = 0.25
ROWS = 2400
NOISE_K = 0.02
COURSES = {"steps by four": steps, "turbulence": turbulence, "slowly": down_to_zero}


def judge(name: str, index: int, seed: int, added: float) -> tuple[float, ...]:
    """Departures over u of exponent and lags, error and u of the exponent, and warnings."""
    rng = np.random.default_rng([seed, index])
    t = DT_S / FINE * np.arange(ROWS * FINE)
    flow = COURSES[name](t, rng) + (1.0 if name == "slowly" else 0.0)
    exponent = float(np.clip(rng.normal(0.5, 0.1), 0.2, 0.8))
    keep = np.exp(-(t[1] - t[0]) / rng.uniform(2.0, 10.0))
    fluid = 300 + 30 * lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(len(t)))
    readings = []
    lags_s = []
    median = float(np.median(flow[::FINE]))
    for film_s in (rng.uniform(1.0, 2.0), rng.uniform(4.0, 8.0)):
        inner_s = film_s * rng.uniform(0.1, 0.4)
        film = film_of(flow, exponent)
        y = reading_of(fluid, film, film_s, inner_s, DT_S / FINE)[::FINE]
        readings.append(y + NOISE_K * rng.standard_normal(ROWS))
        at_median = float(film_of(np.array([median]), exponent)[0])
        lags_s.append(sum(lags_of(film_s / at_median, inner_s)))
    first, second = readings
    found = pair_sensor(
        t[::FINE],
        first,
        second,
        ("A", "B"),
        speed=flow[::FINE],
        exponent=(exponent + added + 0.1 * float(rng.standard_normal()), 0.1),
    )
    n = found.fit["exponent"]
    departures = [(n["value"] - exponent) / n["u"]]
    for column, true_s in zip(found.columns, lags_s):
        lag_s = found.chain.channels[column].lag_s
        departures.append((lag_s.value - true_s) / lag_s.u)
    codes = {finding.code for finding in found.findings}
    return (
        *departures,
        n["value"] - exponent,
        n["u"],
        float("sensor.pair_exponent" in codes),
        float(found.law is not None),
    )


def report(records: int, seed: int) -> None:
    """Print the table."""
    assert LEAST < FLOW_AT
    for added in (0.0, 0.35, -0.35):
        for name in COURSES:
            with ProcessPoolExecutor(2) as pool:
                rows = pool.map(
                    judge, [name] * records, range(records), [seed] * records, [added] * records
                )
                table: Array = np.array(list(rows))
            held = np.mean(np.abs(table[:, :3]) < 1.96, axis=0) * 100
            rms = np.sqrt(np.mean(table[:, 3] ** 2))
            print(
                f"prior {added:+.2f}  {name:14s} covered: exponent {held[0]:5.1f} %, lags "
                f"{held[1]:5.1f}, {held[2]:5.1f} %; exponent rms error {rms:.3f}, median u "
                f"{np.median(table[:, 4]):.3f}; contradicted {table[:, 5].sum():.0f}, law in the "
                f"file {table[:, 6].sum():.0f} of {records}",
                flush=True,
            )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:]]
    report(*[*numbers, *(40, 95301)[len(numbers) :]])
