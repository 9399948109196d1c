"""How often 95 % intervals of lags hold the truth: `python -m tests.sensors.sensor_study KIND
[draws]`."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from tcdyn.core.estimate import Estimate
from tcdyn.sensors.current import current_sensor
from tcdyn.sensors.dips import pool_dips
from tcdyn.sensors.noise import noise_sensor
from tcdyn.sensors.pair import pair_sensor
from tcdyn.sensors.plunge import plunge_sensor
from tests.sensors.sensor_world import Sheath, fluctuating, two_in_a_gas
from tests.sensors.test_sensor_plunge import plunged, truth

Draw = Callable[[int], list[tuple[Estimate, float]]]


def plunge(seed: int) -> list[tuple[Estimate, float]]:
    """Lag, t50, t63.2, t90; lags, rate and noise are drawn."""
    rng = np.random.default_rng(seed)
    slow = np.exp(rng.uniform(np.log(0.2), np.log(8.0)))
    taus = (slow, *(slow * rng.uniform(0.05, 0.4, rng.integers(0, 3))))
    t, y, _ = plunged(taus, slow / rng.uniform(15, 50), 600, rng.uniform(0.05, 0.5), seed)
    made = plunge_sensor(t, y, "T")
    return list(zip([Estimate(**made.fit["lag_s"]), *made.times["T"].values()], truth(taus)))


def dips(seed: int) -> list[tuple[Estimate, float]]:
    """Lag, t50, t63.2, t90 of a further dip, then the mean lag: 2 to 8 dips, whose times differ by
    a drawn spread."""
    rng = np.random.default_rng(seed)
    slow = np.exp(rng.uniform(np.log(0.5), np.log(5.0)))
    taus = (slow, slow * rng.uniform(0.1, 0.4))
    spread = np.exp(rng.uniform(np.log(0.01), np.log(0.2)))
    factors = np.exp(spread * rng.standard_normal(rng.integers(3, 10)))
    noise_K = rng.uniform(0.05, 0.3)
    made = []
    for number, factor in enumerate(factors[:-1]):
        scaled = tuple(factor * tau for tau in taus)
        t, y, _ = plunged(scaled, slow / 20, 400, noise_K, 100 * seed + number)
        made.append(plunge_sensor(t, y, "T"))
    pooled = pool_dips(made)
    further = truth(tuple(factors[-1] * tau for tau in taus))
    got = [Estimate(**pooled.fit["lag_s"]), *pooled.times["T"].values()]
    return [*zip(got, further), (Estimate(**pooled.fit["mean_lag_s"]), sum(taus))]


def pair(seed: int, step: bool = False) -> list[tuple[Estimate, float]]:
    """Both lags; noise on both; with ``step`` the speed trebles in the middle, first stated, then
    piecewise."""
    rng = np.random.default_rng(seed)
    quick = np.exp(rng.uniform(np.log(0.05), np.log(0.3)))
    taus = (quick, quick * rng.uniform(1.7, 5))
    noise = rng.uniform(0.1, 1.0)
    made = two_in_a_gas(
        seed, taus, 0.01, 3000, (noise, noise * rng.uniform(0.5, 2)), 3.0 if step else 1.0
    )
    if not step:
        found = pair_sensor(*made[:3], ("A", "B"), bare=True)
        return [(found.chain.channels[c].lag_s, tau) for c, tau in zip("AB", taus)]
    by_speed = pair_sensor(*made[:3], ("A", "B"), speed=made[3], bare=True)
    at = float(by_speed.fit["speed_median"]) ** -0.5
    pieces = pair_sensor(*made[:3], ("A", "B"), changes_s=[15.0], bare=True)
    return [
        *((by_speed.chain.channels[c].lag_s, tau * at) for c, tau in zip("AB", taus)),
        *((pieces.chain.channels[c].lag_s, tau * 3.0**-0.5) for c, tau in zip("AB", taus)),
    ]


def current(seed: int, gap: float = 0.0) -> list[tuple[Estimate, float]]:
    """The lag of a sheathed sensor that was heated inside: radius, film, wall, noise are drawn."""
    rng = np.random.default_rng(seed)
    probe = Sheath.drawn(rng, gap)
    t, y, power = probe.heated(rng, rng.uniform(0.002, 0.02))
    made = current_sensor(t, y, np.sqrt(power), "T")
    return [(Estimate(**made.fit["lag_s"]), probe.lag_s)]


def noise(seed: int) -> list[tuple[Estimate, float]]:
    """The lag from fluctuations that are white but for 0.02 lags: lag, second lag, record and
    logger's noise drawn."""
    rng = np.random.default_rng(seed)
    tau = np.exp(rng.uniform(np.log(0.3), np.log(5)))
    taus = (tau, *([tau * rng.uniform(0.05, 0.4)] if rng.random() < 0.5 else []))
    t, y = fluctuating(
        seed,
        taus,
        tau / rng.uniform(8, 25),
        int(rng.uniform(10_000, 30_000)),
        rng.uniform(0.01, 0.2),
    )
    made = noise_sensor(t, y, "T")
    return [(Estimate(**made.fit["lag_s"]), sum(taus))]


def flow(seed: int) -> list[tuple[Estimate, float]]:
    """The pair through a step of the flow."""
    return pair(seed, True)


def gap(seed: int) -> list[tuple[Estimate, float]]:
    """The same with a gap between powder and wall, which no model of the fit has."""
    return current(seed, 0.2)


DRAWS: dict[str, Draw] = {
    "plunge": plunge,
    "dips": dips,
    "pair": pair,
    "flow": flow,
    "current": current,
    "gap": gap,
    "noise": noise,
}


def main(which: str, draws: int, first: int = 0) -> None:
    """Print how often each interval holds, errors over stated uncertainties, and relative
    errors."""
    rows, lost = [], 0
    for seed in range(first, first + draws):
        try:
            rows.append(
                [
                    (e.contains(v), (e.value - v) / e.u, e.value / v - 1)
                    for e, v in DRAWS[which](seed)
                ]
            )
        except ValueError as problem:
            lost += 1
            print(seed, problem)
    held, z, off = np.moveaxis(np.array(rows, dtype=float), -1, 0)
    print(f"{which}: {len(rows)} draws, {lost} refused")
    print("  95 % intervals hold", np.round(100 * held.mean(axis=0), 1), "%")
    print(
        "  error over u: mean",
        np.round(z.mean(axis=0), 2),
        "rms",
        np.round(np.sqrt((z**2).mean(axis=0)), 2),
    )
    rms, most = 100 * np.sqrt((off**2).mean(axis=0)), 100 * np.abs(off).max(axis=0)
    print("  relative error, rms", np.round(rms, 2), "%, largest", np.round(most, 1), "%")


if __name__ == "__main__":
    main(
        sys.argv[1],
        int(sys.argv[2]) if len(sys.argv) > 2 else 200,
        int(sys.argv[3]) if len(sys.argv) > 3 else 0,
    )
