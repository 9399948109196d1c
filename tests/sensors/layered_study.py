"""Coverage on layered sensors: `python -m tests.sensors.layered_study KIND [COUNT] [SEED]`.

KIND is plunge, sheath (plunges with the junction at the sheath), current, noise, slow (noise of a
slow fluid), or pair. Sensor k is drawn with seed
SEED + k, in water, oil, air in turn; the entry of every second plunge is known.
"""

from __future__ import annotations

import re
import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors import SensorFile
from tcdyn.sensors.current import current_sensor
from tcdyn.sensors.noise import noise_sensor
from tcdyn.sensors.pair import pair_sensor
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.sensors.step_structures import Junction
from tests.sensors.layered_world import (
    MEDIA,
    MEDIUM_S,
    Array,
    LayeredSensor,
    PlungeRecord,
    drawn,
    plunge_record,
)

FINE = 20  # steps of the simulated fluid in a row
QUANTITIES = ("lag", "t50", "t63", "t90")


@dataclass
class Case:
    """One result: its file, estimates and truths by name, and relative errors of the reference."""

    group: str
    made: SensorFile
    pairs: dict[str, tuple[Estimate, float]]
    reference: float | None = None


def quantities(
    made: SensorFile, column: str, sensor: LayeredSensor
) -> dict[str, tuple[Estimate, float]]:
    """Estimates and truths of lag and times."""
    found = [Estimate(**made.fit["lag_s"]), *made.times[column].values()]
    return dict(zip(QUANTITIES, zip(found, sensor.truth())))


def reference_error(sensor: LayeredSensor, record: PlungeRecord) -> float:
    """Relative error of the scale of all times if the structure is known.

    Free: scale, entry, level, size, and the medium's lag with its prior.
    """
    t, y, sd = record.time_s, record.y_degC, record.noise_K
    rise_s = sensor.times_s()[1]

    def residual(theta: Array) -> Array:
        """Residuals over their noise, and those of the priors."""
        log_scale, entry, level, size, medium_s = theta
        since = (t - record.true_entry_s - entry * rise_s) / np.exp(log_scale)
        model = 60 + level + size * sensor.step(since, abs(medium_s) * np.exp(-log_scale))
        priors = [(medium_s - MEDIUM_S[0]) / MEDIUM_S[1]]
        if record.entry_s is not None:
            stated, u = record.entry_s
            priors.append((record.true_entry_s + entry * rise_s - stated) / u)
        return np.r_[(model - y) / sd, priors]

    start = [0.0, 0.0, 0.0, record.step_K, MEDIUM_S[0]]
    fit = least_squares(residual, start, x_scale=[0.1, 0.1, 1.0, 1.0, 0.02])
    return float(np.expm1(fit.x[0]))


def plunge(
    rng: np.random.Generator, medium: str, known: bool, junction: Junction = "insulated"
) -> Case:
    """A plunge with the defaults."""
    sensor = drawn(rng, medium, at_sheath=junction == "grounded")
    record = plunge_record(sensor, rng, entry_known=known)
    made = plunge_sensor(
        record.time_s, record.y_degC, "T", entry_s=record.entry_s, junction=junction
    )
    group = f"{medium}, entry {'known' if known else 'unknown'}"
    return Case(group, made, quantities(made, "T", sensor), reference_error(sensor, record))


def sheath(rng: np.random.Generator, medium: str, known: bool) -> Case:
    """A plunge with the junction at the sheath, as specified."""
    return plunge(rng, medium, known, "grounded")


def current(rng: np.random.Generator, medium: str, _: bool) -> Case:
    """Heating by a current that is on for about ten lags, and off again."""
    sensor = drawn(rng, medium)
    dt = sensor.lag_s / rng.uniform(40, 80)
    power = np.where((np.arange(1200) > 60) & (np.arange(1200) < 620), 1.0, 0.0)
    noise = rng.uniform(0.02, 0.2) * rng.standard_normal(len(power))
    y = 20 + 10 * sensor.heat(power, dt) + noise
    made = current_sensor(np.arange(len(y)) * dt, y, np.sqrt(power), "T")
    return Case(medium, made, quantities(made, "T", sensor))


def noise(rng: np.random.Generator, medium: str, _: bool, slow: bool = False) -> Case:
    """Fluctuations: white over the band of the sensor, or of a fluid slower than the sensor."""
    sensor = drawn(rng, medium)
    dt = sensor.times_s()[1] / rng.uniform(8, 25)
    n = int(rng.uniform(10_000, 30_000))
    lead = int(20 * sensor.lag_s / dt)
    x = rng.standard_normal((n + lead) * FINE)
    if slow:
        keep = np.exp(-dt / FINE / (sensor.lag_s * rng.uniform(3, 30)))
        x = lfilter([1], [1, -keep], x)
    y = sensor.follow(x, dt / FINE)[lead * FINE :: FINE]
    y = 50 + y / np.std(y) + rng.uniform(0.01, 0.2) * rng.standard_normal(len(y))
    made = noise_sensor(np.arange(len(y)) * dt, y, "T")
    return Case(medium, made, quantities(made, "T", sensor))


def slow(rng: np.random.Generator, medium: str, known: bool) -> Case:
    """Fluctuations of a fluid that is 3 to 30 times slower than the sensor."""
    return noise(rng, medium, known, slow=True)


def pair(rng: np.random.Generator, medium: str, _: bool) -> Case:
    """Two sensors, the second 1.7 to 4 times as thick, in a fluid that fluctuates."""
    thin = drawn(rng, medium)
    wide = min(thin.diameter_m * rng.uniform(1.7, 4.0), 12e-3)
    thick = drawn(rng, medium, diameter_m=wide, speed_m_s=thin.speed_m_s)
    rise_s = thin.times_s()[1]
    dt, fine = rise_s / rng.uniform(8, 25), 4
    x = np.full(4000 * fine, 300.0)
    for share, size in ((rng.uniform(0.5, 2), 6.0), (rng.uniform(5, 20), 20.0)):
        keep = np.exp(-dt / fine / (share * rise_s))
        gain = size * np.sqrt(1 - keep**2)
        x += lfilter([gain], [1, -keep], rng.standard_normal(len(x)))
    sd = rng.uniform(0.05, 0.5)
    read = [
        sensor.follow(x, dt / fine)[::fine] + ratio * sd * rng.standard_normal(4000)
        for sensor, ratio in ((thin, 1.0), (thick, rng.uniform(0.5, 2)))
    ]
    made = pair_sensor(np.arange(4000) * dt, *read, ("thin", "thick"))
    lags = {
        name: (made.chain.channels[name].lag_s, sensor.lag_s)
        for name, sensor in (("thin", thin), ("thick", thick))
    }
    return Case(medium, made, lags)


KINDS: dict[str, Callable[[np.random.Generator, str, bool], Case]] = {
    "plunge": plunge,
    "sheath": sheath,
    "current": current,
    "noise": noise,
    "slow": slow,
    "pair": pair,
}


def print_group(group: str, cases: list[Case]) -> None:
    """Print a line for each quantity, the reference, and the warnings."""
    warned = [any(f.severity.value == "warning" for f in case.made.findings) for case in cases]
    for name in cases[0].pairs:
        pairs = [case.pairs[name] for case in cases]
        held = np.array([estimate.contains(truth) for estimate, truth in pairs])
        error = np.array([100 * (estimate.value / truth - 1) for estimate, truth in pairs])
        u = np.array([100 * estimate.u / truth for estimate, truth in pairs])
        silent = ~held & ~np.array(warned)
        print(
            f"  {group:24s} {name:6s} n {len(pairs):3d}  held {100 * held.mean():5.1f} %"
            f"  error: mean {error.mean():6.2f}, rms {np.sqrt(np.mean(error**2)):6.2f} %"
            f"  u {u.mean():6.2f} %  silent misses {100 * silent.mean():5.1f} %"
        )
    references = [100 * case.reference for case in cases if case.reference is not None]
    if references:
        print(f"  {group:24s} reference rms error {np.sqrt(np.mean(np.square(references))):.2f} %")
    codes = Counter(
        f.code for case in cases for f in case.made.findings if f.severity.value == "warning"
    )
    print(f"  {group:24s} warned {sum(warned)} of {len(cases)}: {dict(codes)}")


def main(kind: str, count: int, first: int) -> None:
    """Draw the sensors and print each group and all."""
    groups: dict[str, list[Case]] = defaultdict(list)
    refused = Counter[str]()
    for k in range(count):
        medium = list(MEDIA)[k % 3]
        try:
            case = KINDS[kind](np.random.default_rng(first + k), medium, k // 3 % 2 == 1)
        except InputError as problem:
            refused[f"{medium}: {re.sub(r'[0-9.]+(e[+-]?[0-9]+)?', '#', str(problem))}"] += 1
            continue
        groups[case.group].append(case)
        groups["all"].append(case)
    print(f"{kind}: {count} sensors from seed {first}, {refused.total()} refused")
    for group in sorted(groups):
        print_group(group, groups[group])
    for message, times in refused.items():
        print(f"  refused {times} x {message}")


if __name__ == "__main__":
    main(
        sys.argv[1],
        int(sys.argv[2]) if len(sys.argv) > 2 else 60,
        int(sys.argv[3]) if len(sys.argv) > 3 else 0,
    )
