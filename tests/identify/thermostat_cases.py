"""Records of thermostats and of open-loop on/off heaters, simulated without the library.

The plant is two lumped masses (heater and body) with a dead time and a loss to the surroundings,
integrated by explicit Euler steps. The relay, the timer, the noise and the rounding are written
out here and share no code with the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tcdyn.core import Array
from tcdyn.identification import IOData

AMBIENT_DEGC = 20.0
STEPS_PER_ROW = 10  # Euler steps between two rows of the log

# Drifts of the loss with time: factors on the conductance to the surroundings.
LOADS = ("constant", "steps", "wave", "random")
# Open-loop on/off inputs.
OPEN_KINDS = (
    "random durations",
    "random telegraph",
    "PRBS",
    "timer",
    "timer with jitter",
    "timer after heating",
    "timer under changing load",
    "pattern",
    "few steps",
    "single step",
)


@dataclass(frozen=True)
class Plant:
    """A body that is heated by a heater element.

    Parameters
    ----------
    heater_lag_s
        Time constant between heater and body [s].
    body_lag_s
        Time constant of the loss of the body [s].
    dead_s
        Dead time of the sensor [s].
    rise_K
        Steady temperature rise with the heater on and the mean load [K].
    """

    heater_lag_s: float
    body_lag_s: float
    dead_s: float
    rise_K: float


@dataclass(frozen=True)
class Noise:
    """Noise and rounding of the readings.

    Parameters
    ----------
    noise_K
        Standard deviation of the noise of a reading [K].
    rounding_K
        Step of the readings [K]; 0 for none.
    own_sensor
        Whether the relay has its own sensor, with noise of its own that is not logged.
    """

    noise_K: float
    rounding_K: float
    own_sensor: bool


def load_factor(kind: str, rng: np.random.Generator, n_rows: int) -> Array:
    """Conductance to the surroundings over its mean (n_rows,)."""
    rows = np.arange(n_rows)
    if kind == "steps":
        n_steps = rng.integers(3, 7)
        factor = rng.uniform(0.6, 1.5, n_steps)
        return factor[np.minimum(rows * n_steps // n_rows, n_steps - 1)]
    if kind == "wave":
        n_waves = rng.uniform(0.7, 3.0)
        return 1 + 0.35 * np.sin(2 * np.pi * (n_waves * rows / n_rows + rng.uniform()))
    if kind == "random":
        hold = max(n_rows // 40, 1)
        return np.repeat(rng.uniform(0.6, 1.4, n_rows // hold + 1), hold)[:n_rows]
    return np.ones(n_rows)


class Simulation:
    """The plant with its log, row by row."""

    def __init__(
        self, plant: Plant, noise: Noise, load: Array, rng: np.random.Generator, start_K: float
    ) -> None:
        """Start with heater and body at the same temperature above ambient."""
        self.plant = plant
        self.noise = noise
        self.load = load
        self.rng = rng
        self.heater_K = start_K
        self.body_K = start_K
        n_delay = round(plant.dead_s * STEPS_PER_ROW)
        self.delayed_K = [start_K] * (n_delay + 1)

    def reading(self) -> tuple[float, float]:
        """The logged reading, and the one that the relay sees."""
        true = AMBIENT_DEGC + self.delayed_K[0]
        logged = true + self.noise.noise_K * self.rng.normal()
        seen = logged
        if self.noise.own_sensor:
            seen = true + self.noise.noise_K * self.rng.normal()
        if self.noise.rounding_K > 0:
            logged = self.noise.rounding_K * round(logged / self.noise.rounding_K)
        return logged, seen

    def advance(self, row: int, on: bool) -> None:
        """Integrate over one row, 1 s."""
        h = 1 / STEPS_PER_ROW
        for _ in range(STEPS_PER_ROW):
            loss = self.load[row] * self.body_K / self.plant.body_lag_s
            power = self.plant.rise_K / self.plant.body_lag_s if on else 0.0
            # a heater of a tenth of the heat capacity of the body
            flow = 0.1 * (self.heater_K - self.body_K) / self.plant.heater_lag_s
            self.heater_K += h * (power - flow) / 0.1
            self.body_K += h * (flow - loss)
            self.delayed_K.append(self.body_K)
            self.delayed_K.pop(0)


def random_plant(rng: np.random.Generator) -> Plant:
    """A plant with lags from seconds to minutes at rows of 1 s."""
    body = np.exp(rng.uniform(np.log(60), np.log(600)))
    return Plant(
        heater_lag_s=rng.uniform(0.01, 0.08) * body,
        body_lag_s=body,
        dead_s=rng.uniform(0.0, 0.05) * body,
        rise_K=rng.uniform(40.0, 150.0),
    )


def random_noise(rng: np.random.Generator) -> Noise:
    """Noise up to 0.1 K, in half of the records rounded to 0.1 K."""
    return Noise(
        noise_K=float(rng.choice([0.0, 0.02, 0.05, 0.1])),
        rounding_K=float(rng.choice([0.0, 0.1])),
        own_sensor=bool(rng.random() < 0.5),
    )


def as_record(u: Array, y: Array, name: str) -> IOData:
    """The record, with the input in per cent."""
    return IOData.from_arrays(
        u, y, 1.0, hold="zoh", input_names=["heater"], output_names=["T1"], name=name
    )


def thermostat_record(
    seed: int,
    *,
    load: str = "",
    from_cold: bool | None = None,
    delay_rows: int | None = None,
    cooler: bool = False,
    hysteresis_K: float | None = None,
    noise: Noise | None = None,
    n_cycles: float = 15,
    input_noise: float = 0.0,
    every: int = 1,
) -> IOData:
    """A heater switched by a relay with hysteresis.

    ``load`` is one of ``LOADS``; what is not given is random. ``delay_rows`` is the delay of the
    relay. With ``cooler`` the relay switches a cooler, the readings are mirrored. ``every``: the
    log has one row of so many.
    """
    rng = np.random.default_rng(seed)
    plant = random_plant(rng)
    noise = noise or random_noise(rng)
    load = load or str(rng.choice(LOADS[1:]))
    if from_cold is None:
        from_cold = bool(rng.random() < 0.5)
    if delay_rows is None:
        delay_rows = int(rng.choice([0, 1, 1, 2, 4]))
    hysteresis = hysteresis_K or float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    limit = AMBIENT_DEGC + plant.rise_K * rng.uniform(0.25, 0.6)
    # time of a cycle of a relay: hysteresis over the rates of heating and cooling, and dead times
    share = (limit - AMBIENT_DEGC) / plant.rise_K
    swing = hysteresis + plant.rise_K / plant.body_lag_s * (
        plant.dead_s + plant.heater_lag_s + delay_rows
    )
    cycle_s = plant.body_lag_s * swing / plant.rise_K * (1 / share + 1 / (1 - share))
    heating_s = -plant.body_lag_s * np.log(1 - share) if from_cold else 0.0
    n_rows = int(np.clip(n_cycles * cycle_s + 1.2 * heating_s, 100, 6000))
    start = 0.0 if from_cold else limit - AMBIENT_DEGC
    plant_rows = Simulation(plant, noise, load_factor(load, rng, n_rows), rng, start)
    on = from_cold
    commands = [on] * (delay_rows + 1)
    u = np.zeros(n_rows)
    y = np.zeros(n_rows)
    for row in range(n_rows):
        y[row], seen = plant_rows.reading()
        if seen > limit + hysteresis / 2:
            on = False
        elif seen < limit - hysteresis / 2:
            on = True
        commands.append(on)
        commands.pop(0)
        u[row] = 100.0 * commands[0]
        plant_rows.advance(row, commands[0])
    if cooler:
        y = 2 * AMBIENT_DEGC - y
    u += input_noise * rng.normal(size=n_rows)
    return as_record(u[::every], y[::every], "thermostat")


def durations(kind: str, rng: np.random.Generator, mean_rows: float, n_rows: int) -> Array:
    """Durations of the phases of an open-loop input, in rows, on and off in turn."""
    count = int(n_rows / mean_rows * 3) + 10
    duty = rng.uniform(0.25, 0.75)
    mean = mean_rows * 2 * np.where(np.arange(count) % 2 == 0, duty, 1 - duty)
    if kind == "random durations":
        rows = mean_rows * rng.uniform(0.3, 1.7, count)
    elif kind == "random telegraph":
        rows = rng.exponential(mean_rows, count) + rng.choice([1.0, 0.2 * mean_rows])
    elif kind == "PRBS":
        clock = max(round(mean_rows / 2), 2)
        rows = clock * rng.geometric(0.5, count)
    elif kind == "timer with jitter":
        rows = mean * (1 + rng.choice([0.02, 0.1]) * rng.normal(size=count))
    elif kind == "pattern":
        length = 2 * rng.integers(1, 4)
        rows = mean_rows * np.tile(rng.uniform(0.3, 1.7, length), count // length + 1)[:count]
    elif kind == "few steps":
        rows = np.full(count, float(n_rows))
        n_steps = rng.integers(3, 7)
        rows[:n_steps] = n_rows / n_steps * rng.uniform(0.5, 1.1, n_steps)
    elif kind == "single step":
        rows = np.full(count, float(n_rows))
        rows[0] = n_rows * rng.uniform(0.1, 0.5)
    else:
        rows = mean.copy()
    if kind == "timer after heating":
        rows[0] = mean[0] * rng.uniform(2, 12)
    return np.maximum(np.round(rows), 1).astype(int)


def on_off_record(kind: str, seed: int) -> IOData:
    """A heater switched on and off in an open loop; ``kind`` is one of ``OPEN_KINDS``.

    The phases last from a fiftieth of the time constant of the body to ten times as long.
    """
    rng = np.random.default_rng(seed)
    plant = random_plant(rng)
    noise = random_noise(rng)
    mean_rows = max(plant.body_lag_s * np.exp(rng.uniform(np.log(0.02), np.log(10.0))), 4.0)
    n_rows = int(np.clip(rng.integers(6, 60) * mean_rows, 100, 6000))
    load = "constant"
    if kind == "timer under changing load" or rng.random() < 0.3:
        load = str(rng.choice(LOADS[1:]))
    rows = durations(kind, rng, mean_rows, n_rows)
    # in half of the records the log starts within a phase
    starts_within = kind != "timer after heating" and rng.random() < 0.5
    if starts_within:
        rows[0] = rng.integers(1, rows[0] + 1)
    start = plant.rise_K * rng.uniform(0, 0.6) if starts_within else 0.0
    phase = np.repeat(np.arange(len(rows)), rows)
    phase = np.append(phase, np.full(n_rows, phase[-1]))[:n_rows]
    on = phase % 2 == (0 if kind == "timer after heating" else rng.integers(2))
    simulation = Simulation(plant, noise, load_factor(load, rng, n_rows), rng, start)
    y = np.zeros(n_rows)
    for row in range(n_rows):
        y[row] = simulation.reading()[0]
        simulation.advance(row, bool(on[row]))
    return as_record(100.0 * on, y, kind)
