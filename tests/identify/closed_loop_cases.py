"""Records of closed and open loops, simulated without the library, for tests of closed-loop
recognition."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from tcdyn.identification import IOData

GAIN = 2.0  # of the plant, K/%
LAG_S = 60.0
DEAD_SAMPLES = 5  # 5 s at 1 s a sample
WARM_UP = 300  # samples before the record


def closed_loop_record(
    controller: str,
    *,
    samples: int = 600,
    seed: int = 0,
    dither: float = 0.0,
    noise: float = 0.02,
    set_point: str = "constant",
    delayed: bool = False,
    step: float = 1e-4,
    disturbance: float = 0.5,
    heating: bool = True,
) -> IOData:
    """A heater that controls a temperature of 60 degC against slow disturbances; exact for a held
    input.

    ``controller`` is P, PI, PID (derivative filter of 2 samples), filtered PI, clipped PI (integral
    stopped at 19.2 and 20.8 %), cascade or thermostat. ``dither`` is the sd of a white noise added
    to the input [%], ``noise`` that of the measured output [K], ``disturbance`` that of a
    disturbance with a time constant of 30 s [K]. ``delayed``: the controller uses the output of the
    previous sample. The input is quantised in steps of ``step`` [%]. With ``heating`` false, plant
    and controller have the opposite sign (a cooler).
    """
    rng = np.random.default_rng(seed)
    count = samples + WARM_UP
    memory = np.exp(-1 / 30.0)
    slow = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.normal(size=count)) * disturbance
    output_noise = noise * rng.normal(size=count)
    input_noise = dither * rng.normal(size=count)
    setpoint = np.full(count, 60.0)
    if set_point == "steps":
        setpoint += np.repeat(rng.choice([-5.0, 0.0, 5.0], count // 100 + 1), 100)[:count]
    if set_point == "ramp":
        setpoint += 0.02 * np.arange(count)
    sign = 1.0 if heating else -1.0
    decay = np.exp(-1 / LAG_S)
    plant = 40.0
    inner = 20.0
    integral = 20.0
    filtered = 60.0
    derivative = 0.0
    previous_error = 0.0
    on = False
    u = np.full(count, 20.0)
    y = np.zeros(count)
    for k in range(count):
        y[k] = 60.0 + sign * (plant - 40.0) + slow[k] + output_noise[k]
        measured = y[k - 1] if delayed and k else y[k]
        error = sign * (setpoint[k] - measured)
        if controller == "P":
            value = 20.0 + 2 * error
        elif controller == "PI":
            integral += error / 60
            value = integral + error
        elif controller == "clipped PI":
            value = float(np.clip(integral + error, 19.2, 20.8))
            integral += error / 60 if value == integral + error else 0.0
        elif controller == "PID":
            integral += error / 60
            derivative = 0.5 * derivative + 0.5 * (error - previous_error)
            value = integral + error + 3 * derivative
            previous_error = error
        elif controller == "filtered PI":
            filtered += 0.3 * (measured - filtered)
            error = sign * (setpoint[k] - filtered)
            integral += error / 60
            value = integral + error
        elif controller == "cascade":
            integral += error / 60
            value = 20.0 + 2 * (integral + error - inner)
        else:
            on = error > -0.3 if on else error > 0.3
            value = 40.0 * on
        u[k] = step * np.round((value + input_noise[k]) / step)
        if controller == "cascade":
            inner += (1 - np.exp(-1 / 5.0)) * (u[k] - inner) + 0.02 * rng.normal()
        plant_input = inner if controller == "cascade" else u[max(k - DEAD_SAMPLES + 1, 0)]
        plant = decay * plant + (1 - decay) * GAIN * plant_input
    y = np.round(y, 4)
    return IOData.from_arrays(
        u[WARM_UP:],
        y[WARM_UP:],
        1.0,
        input_names=["heater"],
        output_names=["T1"],
        name=f"{controller} loop",
    )


def lag_of_held_input(u: np.ndarray, *lags: float) -> np.ndarray:
    """Response of lags [samples] to an input held between samples, from equilibrium."""
    y = np.asarray(u, dtype=float)
    for lag in lags:
        a = np.exp(-1 / lag)
        y = lfilter([0, 1 - a], [1, -a], y - y[0]) + y[0]
    return y


def lag_of_linear_input(u: np.ndarray, *lags: float) -> np.ndarray:
    """Response of lags [samples] to an input that is linear between samples, on a grid twenty
    times finer."""
    fine = np.interp(np.arange((len(u) - 1) * 20 + 1) / 20, np.arange(len(u)), u)
    for lag in lags:
        a = np.exp(-1 / (20 * lag))
        fine = lfilter([(1 - a) / 2, (1 - a) / 2], [1, -a], fine - fine[0]) + fine[0]
    return fine[::20]


def first_order_process(rng: np.random.Generator, samples: int, memory: float = 0.95) -> np.ndarray:
    """First-order random process with mean 50 and sd 5."""
    white = rng.normal(size=samples + 200)
    return 50 + 5 * lfilter([np.sqrt(1 - memory**2)], [1, -memory], white)[200:]


def open_loop_record(kind: str, *, samples: int = 600, seed: int = 0) -> IOData:
    """A record of an input that does not depend on the output."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples, dtype=float)
    white = rng.normal(size=(2, samples))
    levels = np.repeat(rng.choice([20.0, 40.0, 60.0], samples // 20 + 1), 20)[:samples]
    binary = np.repeat(np.where(rng.random(samples // 10 + 1) < 0.5, 25.0, 75.0), 10)[:samples]
    plunge = 25 + 155 * (
        1 - np.exp(-np.clip(time - 0.1 * samples - 0.37, 0, None) / (0.05 * samples))
    )
    phases = 2 * np.pi * rng.random(6)
    sines = 50 + sum(
        5 / (i + 1) * np.sin(0.02 * (i + 1) ** 1.3 * time + phases[i]) for i in range(6)
    )
    walk = np.cumsum(white[1])
    free = first_order_process(rng, samples)
    smooth = first_order_process(rng, samples, 0.995)
    records = {
        "binary": (binary, lag_of_held_input(binary, 30, 5) + 0.3 * white[0], "zoh"),
        "binary without noise": (binary, lag_of_held_input(binary, 30), "zoh"),
        "binary with a random walk": (binary, lag_of_held_input(binary, 30) + 0.3 * walk, "zoh"),
        "levels": (levels, 0.7 * lag_of_held_input(levels, 30, 4) + 0.1 * white[0], "zoh"),
        "levels, coarse output": (
            levels,
            np.round(1.4 * lag_of_held_input(levels, 30, 4)) / 2,
            "zoh",
        ),
        "white": (
            free + 5 * white[1],
            lag_of_held_input(free + 5 * white[1], 20) + 0.2 * white[0],
            "zoh",
        ),
        "random": (free, lag_of_linear_input(free, 20, 3) + 0.2 * white[0], "foh"),
        "random without noise": (free, lag_of_linear_input(free, 20), "foh"),
        "random, two lags without noise": (free, lag_of_linear_input(free, 20, 3), "foh"),
        "random with a random walk": (free, lag_of_linear_input(free, 20, 3) + 0.5 * walk, "foh"),
        "random with slow noise": (
            free,
            lag_of_linear_input(free, 20, 3) + 0.2 * (first_order_process(rng, samples, 0.98) - 50),
            "foh",
        ),
        "plunge": (
            plunge,
            lag_of_linear_input(plunge, 0.05 * samples, 0.01 * samples) + 0.3 * white[0],
            "foh",
        ),
        "plunge without noise": (plunge, lag_of_linear_input(plunge, 0.05 * samples), "foh"),
        "plunge, noisy input": (
            plunge + 0.5 * white[1],
            lag_of_linear_input(plunge, 0.05 * samples) + 0.05 * white[0],
            "foh",
        ),
        "ramp": (
            np.clip(time - 100, 0, 300) / 10,
            lag_of_linear_input(np.clip(time - 100, 0, 300) / 10, 20) + 0.1 * white[0],
            "foh",
        ),
        "sines": (sines, lag_of_linear_input(sines, 20, 5) + 0.1 * white[0], "foh"),
        "sines without noise": (sines, lag_of_linear_input(sines, 20), "foh"),
        "static": (free, 3 + 2 * free + 0.1 * white[0], "foh"),
        "static, negative, without noise": (free, 300 - 2 * free, "foh"),
        "lead": (free, 3 * free - 2 * lag_of_linear_input(free, 20) + 0.1 * white[0], "foh"),
        "lead without noise": (free, 5 * free - 4 * lag_of_linear_input(free, 20), "foh"),
        "noisy input": (
            free + 0.5 * white[1],
            lag_of_linear_input(free, 10) + 0.05 * white[0],
            "foh",
        ),
        "smooth noisy input": (
            smooth + 0.5 * white[1],
            lag_of_linear_input(smooth, 2) + 0.02 * white[0],
            "foh",
        ),
        "common noise": (
            free + 0.2 * white[1],
            lag_of_linear_input(free, 20) + 0.2 * white[1] + 0.05 * white[0],
            "foh",
        ),
        "integrating": (
            levels - 40,
            np.cumsum(np.append(0.0, levels[:-1] - 40)) / 100 + 0.05 * white[0],
            "zoh",
        ),
    }
    u, y, hold = records[kind]
    return IOData.from_arrays(
        u, y, 1.0, hold=hold, input_names=["heater"], output_names=["T1"], name=kind
    )


OPEN_LOOPS = (
    "binary",
    "binary without noise",
    "binary with a random walk",
    "levels",
    "levels, coarse output",
    "white",
    "random",
    "random without noise",
    "random, two lags without noise",
    "random with a random walk",
    "random with slow noise",
    "plunge",
    "plunge without noise",
    "plunge, noisy input",
    "ramp",
    "sines",
    "sines without noise",
    "static",
    "static, negative, without noise",
    "lead",
    "lead without noise",
    "noisy input",
    "smooth noisy input",
    "common noise",
    "integrating",
)
