"""Lag in air from a dip in water: coverage for sensors by finite volumes.

`python -m tests.sensors.stream_study [SENSORS] [SEED]` prints how often lag, t50, t63.2 and t90 in
the other stream are inside their 95 % intervals, and the median relative standard uncertainty of
the lag there, from water to air and from air to water. The sensors are those of
``tests.sensors.layered_world``, whose surface coefficients are Hilpert's, not those of the package;
half of them have a gap. The noise of the dip is 0.05 to 0.5 K.
"""

from __future__ import annotations

import sys

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors.file import SHARES
from tcdyn.sensors.medium import Surroundings
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.sensors.surface_h import BoundaryLayer
from tests.sensors.layered_world import MEDIA, layered, plunge_record, surface_h

KEYS = ("lag_s", *SHARES)


def judge(
    rng: np.random.Generator, here: str, there: str
) -> tuple[list[bool], float, float] | None:
    """Whether each time is covered; relative u of the lag, and its error over the true lag."""
    d = float(np.exp(rng.uniform(np.log(0.5e-3), np.log(8e-3))))
    gap_m = float(min(rng.uniform(10e-6, 60e-6), d / 40)) if rng.random() < 0.5 else 0.0
    core, wall, k = rng.uniform(0.15, 0.35), rng.uniform(0.10, 0.16), rng.uniform(1.5, 5.0)
    speeds = {name: float(np.exp(rng.uniform(*np.log(MEDIA[name][3:])))) for name in (here, there)}
    made = {
        name: layered(d, core, wall, k, surface_h(name, d, speeds[name]), gap_m)
        for name in (here, there)
    }
    record = plunge_record(made[here], rng)
    film = BoundaryLayer(here, d, speeds[here])
    try:
        probe = plunge_sensor(record.time_s, record.y_degC, "T", film=film)
        lag = Estimate(**probe.fit["lag_s"])
        to = Surroundings(there, speeds[there])
        fit = film.in_other(lag, probe.times["T"], to, 0.0)
    except InputError:
        return None
    found = [Estimate(**fit[f"to_{key}"]) for key in KEYS]  # type: ignore[arg-type]
    truth = made[there].truth()
    covered = [estimate.contains(value) for estimate, value in zip(found, truth)]
    return covered, found[0].u / truth[0], found[0].value / truth[0] - 1


def report(sensors: int, seed: int) -> None:
    """Print the table."""
    for number, (here, there) in enumerate((("water", "air"), ("air", "water"))):
        rng = np.random.default_rng([seed, number])
        rows = [judge(rng, here, there) for _ in range(sensors)]
        judged = [row for row in rows if row is not None]
        covered = 100 * np.mean([row[0] for row in judged], axis=0)
        us, errors = np.array([row[1:] for row in judged]).T
        print(
            f"{here} to {there}: covered lag {covered[0]:.0f} %, t50 {covered[1]:.0f}, t63.2 "
            f"{covered[2]:.0f}, t90 {covered[3]:.0f} %; lag: u {100 * np.median(us):.0f} % "
            f"(median), error {100 * np.median(errors):+.0f} % (median), "
            f"{100 * np.sqrt(np.mean(errors**2)):.0f} % (rms); {len(judged)} of {sensors} sensors",
            flush=True,
        )


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:]]
    report(*[*numbers, *(40, 352)[len(numbers) :]])
