"""Records for the study of ``compare(data)`` without options, simulated independently of the
library.

Case A has lags of 2.0 and 0.5 s, a dead time of 0.37 s and 800 samples at 0.05 s; its input is 25
or 75 degC, held for 20 samples. Each case changes one thing. ``tests/identify/test_bare_study.py``
compares the simulators with closed forms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import StateSpace, cont2discrete, dlsim, lfilter, lfilter_zi

from tcdyn.identification import IOData, from_frame

Array = NDArray[np.float64]

DT_S = 0.05
FINE_S = 0.005  # step of the simulation; the dead times are multiples of it
N_SAMPLES = 800
NOISE_K = 0.5
SWING_K = 50.0
NUM_A = (1.0,)  # descending powers of s
DEN_A = (1.0, 2.5, 1.0)  # (2 s + 1) (0.5 s + 1)
DEAD_A_S = 0.37
WARM_UP = 110  # samples before a record that starts between two levels


@dataclass(frozen=True)
class Case:
    """A record and what its identification has to give.

    Parameters
    ----------
    record
        Makes the record of a seed.
    gain
        True static gain, or gain of the integrator; None where there is none.
    lag_s
        True first moment of the impulse response [s]; None where there is none.
    dead_s
        True dead time [s]; None where the process models do not contain the truth.
    integrators
        Integrators of the true model.
    words
        Words of which the message must contain one, if the record must be named; empty where an
        estimate is right.
    """

    record: Callable[[int], IOData]
    gain: float | None = 1.0
    lag_s: float | None = 2.87
    dead_s: float | None = DEAD_A_S
    integrators: int = 0
    words: tuple[str, ...] = ()


def levels(rng: np.random.Generator, n: int = N_SAMPLES, hold: int = 20) -> Array:
    """Levels of 25 or 75 degC (n,), each held for ``hold`` samples; the second is not the first."""
    high = rng.random(-(-n // hold)) < 0.5
    high[1] = not high[0]
    return np.repeat(np.where(high, 75.0, 25.0), hold)[:n]


def fine_response(
    u: Array,
    num: Sequence[float] = NUM_A,
    den: Sequence[float] = DEN_A,
    dead_s: float = DEAD_A_S,
    start: float | None = None,
) -> Array:
    """Response to an input that is held for each step of the fine grid, exact.

    Parameters
    ----------
    u
        Input (n,).
    num, den
        Transfer function, descending powers of s.
    dead_s
        Dead time [s].
    start
        Input before the record, to which the system is in equilibrium; by default the first one.

    Returns
    -------
    array
        Output (n,).
    """
    first = u[0] if start is None else start
    dead_steps = round(dead_s / FINE_S)
    delayed = np.concatenate([np.full(dead_steps, first), u])[: len(u)]
    b, a, _ = cont2discrete((num, den), FINE_S, method="zoh")
    if den[-1] == 0:  # an integrator starts at zero
        return np.asarray(lfilter(b.ravel(), a, delayed))
    state = lfilter_zi(b.ravel(), a) * first
    return np.asarray(lfilter(b.ravel(), a, delayed, zi=state)[0])


def response(u: Array, *system: object, dt_s: float = DT_S, start: float | None = None) -> Array:
    """Response (n,) at the samples to an input held from sample to sample; see
    ``fine_response``."""
    factor = round(dt_s / FINE_S)
    return fine_response(np.repeat(u, factor), *system, start=start)[::factor]


def diffusion(widths: Array, surface_resistance: float = 0.0) -> StateSpace:
    """Heat conduction by finite volumes, driven by the temperature of the surroundings.

    Parameters
    ----------
    widths
        Widths of the volumes (n,) from the surface to the insulated end [sqrt(s)]: thickness over
        the square root of the diffusivity.
    surface_resistance
        Resistance of the surface film, in the resistance of a volume of unit width.

    Returns
    -------
    StateSpace
        Its outputs are the temperatures of the surface and of the last volume.
    """
    distances = 0.5 * (widths[1:] + widths[:-1])
    conductances = 1 / np.concatenate([[surface_resistance + widths[0] / 2], distances, [np.inf]])
    flows = np.diag(-(conductances[:-1] + conductances[1:]))
    flows += np.diag(conductances[1:-1], 1) + np.diag(conductances[1:-1], -1)
    a = flows / widths[:, None]
    b = np.zeros((len(widths), 1))
    b[0] = conductances[0] / widths[0]
    from_surroundings = 1 - surface_resistance * conductances[0]
    c = np.zeros((2, len(widths)))
    c[0, 0] = 1 - from_surroundings
    c[1, -1] = 1.0
    return StateSpace(a, b, c, np.array([[from_surroundings], [0.0]]))


def diffusion_response(u: Array, system: StateSpace) -> Array:
    """Temperatures (n, 2) of surface and last volume, from equilibrium; exact in time."""
    discrete = cont2discrete((system.A, system.B, system.C, system.D), DT_S, method="zoh")
    state = np.full(len(system.A), u[0])
    return np.asarray(dlsim(discrete, u, x0=state)[1])


SLAB_S = 4.0  # thickness^2 over diffusivity; the first moment is half of it
SLAB = diffusion(np.full(80, np.sqrt(SLAB_S) / 80))
HALF_ORDER_S = 0.5  # of 1 / (1 + sqrt(0.5 s))
# a volume is 8 % wider than the one before; 60 sqrt(s) deep: no heat reaches the end in 40 s
HALF_ORDER = diffusion(0.002 * 1.08 ** np.arange(102), np.sqrt(HALF_ORDER_S))


def slow_noise(rng: np.random.Generator, memory: float, n: int = N_SAMPLES) -> Array:
    """First-order autoregressive noise (n,) with unit standard deviation."""
    white = rng.normal(size=n + 3000)
    return np.asarray(lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], white)[3000:])


def as_record(u: Array, y: Array, dt_s: float = DT_S, **options: object) -> IOData:
    """Record as from a logger's table with a time column."""
    table = pd.DataFrame({"time_s": dt_s * np.arange(len(u)), "heater": u, "T": y})
    return from_frame(table, input="heater", output="T", **options)


def case_a(change: Callable[[np.random.Generator, Array], Array], **truth: object) -> Case:
    """Case A of which ``change`` makes the measured output from the true one."""

    def record(seed: int) -> IOData:
        rng = np.random.default_rng(seed)
        u = levels(rng)
        return as_record(u, change(rng, response(u)))

    return Case(record, **truth)


def other_system(
    num: Sequence[float],
    den: Sequence[float],
    dead_s: float,
    dt_s: float = DT_S,
    n: int = N_SAMPLES,
    hold: int = 20,
    record_hold: str = "auto",
) -> Case:
    """Another system, another sampling, or a hold that the user specifies."""

    def record(seed: int) -> IOData:
        rng = np.random.default_rng(seed)
        u = levels(rng, n, hold)
        y = response(u, num, den, dead_s, dt_s=dt_s)
        return as_record(u, y + NOISE_K * rng.normal(size=n), dt_s, hold=record_hold)

    lead_s = num[-2] / num[-1] if len(num) > 1 else 0.0
    lag_s = den[-2] / den[-1] - lead_s + dead_s
    return Case(record, gain=num[-1] / den[-1], lag_s=lag_s, dead_s=dead_s)


def integrating(seed: int) -> IOData:
    """An integrator in place of the lag of 2 s; the input is 0 at first, then -25 or 25."""
    rng = np.random.default_rng(seed)
    u = levels(rng) - 50
    u[:20] = 0.0
    y = response(u, [0.5], [0.5, 1.0, 0.0])
    return as_record(u, y + NOISE_K * rng.normal(size=N_SAMPLES))


def measured_input(seed: int) -> IOData:
    """The levels reach the system through a lag of 0.5 s, and are measured with noise."""
    rng = np.random.default_rng(seed)
    factor = round(DT_S / FINE_S)
    u = fine_response(np.repeat(levels(rng), factor), [1.0], [0.5, 1.0], 0.0)
    y = fine_response(u)
    noise = NOISE_K * rng.normal(size=(2, N_SAMPLES))
    return as_record(u[::factor] + noise[0], y[::factor] + noise[1])


def irregular(seed: int) -> IOData:
    """Time stamps up to 0.3 intervals off the grid, resampled as the reader's error asks for."""
    rng = np.random.default_rng(seed)
    factor = round(DT_S / FINE_S)
    u = np.repeat(levels(rng), factor)
    steps = factor * np.arange(N_SAMPLES) + rng.integers(-3, 4, N_SAMPLES)
    steps = np.clip(steps, 0, None)
    y = fine_response(u)[steps] + NOISE_K * rng.normal(size=N_SAMPLES)
    table = pd.DataFrame({"time_s": FINE_S * steps, "heater": u[steps], "T": y})
    return from_frame(table, input="heater", output="T", resample_s=DT_S)


def missing_rows(seed: int) -> IOData:
    """One row in twenty is missing, and thirty rows together."""
    rng = np.random.default_rng(seed)
    u = levels(rng)
    y = response(u) + NOISE_K * rng.normal(size=N_SAMPLES)
    stays = rng.random(N_SAMPLES) > 0.05
    stays[0] = True
    stays[400:430] = False
    table = pd.DataFrame({"time_s": DT_S * np.arange(N_SAMPLES), "heater": u, "T": y})
    return from_frame(table[stays], input="heater", output="T")


def off_equilibrium(seed: int) -> IOData:
    """The record starts while the output is still moving."""
    rng = np.random.default_rng(seed)
    u = levels(rng, N_SAMPLES + WARM_UP)
    u[80:100] = 100 - u[100]
    y = response(u) + NOISE_K * rng.normal(size=len(u))
    return as_record(u[WARM_UP:], y[WARM_UP:])


def from_rest(seed: int) -> IOData:
    """The record starts when the heater is switched, in equilibrium with its other level."""
    rng = np.random.default_rng(seed)
    u = levels(rng)
    y = response(u, NUM_A, DEN_A, DEAD_A_S, start=100 - u[0])
    return as_record(u, y + NOISE_K * rng.normal(size=N_SAMPLES))


def conduction(system: StateSpace, output: int) -> Callable[[int], IOData]:
    """Records of a diffusion system."""

    def record(seed: int) -> IOData:
        rng = np.random.default_rng(seed)
        u = levels(rng)
        y = diffusion_response(u, system)[:, output]
        return as_record(u, y + NOISE_K * rng.normal(size=N_SAMPLES))

    return record


def pi_loop(disturbance: Array, set_point: float = 50.0) -> tuple[Array, Array]:
    """Input and output of case A under PI control, exact for the held input.

    Parameters
    ----------
    disturbance
        Added to the output (n,), the noise of its measurement included [K].
    set_point
        Wanted output [K].

    Returns
    -------
    u, y
        Input and output (n,).

    Notes
    -----
    u = e + integral of e / 2.5 s. The dead time is 7.4 intervals: within an interval the system
    sees u[k-8] for 0.02 s and u[k-7] for 0.03 s.
    """
    a = np.array([[-0.5, 0.0], [2.0, -2.0]])
    first = expm(a * 0.02)
    second = expm(a * 0.03)
    ones = np.ones(2)  # state in equilibrium with a unit input
    n = len(disturbance)
    u = np.full(n + 8, set_point)  # eight inputs before the record
    y = np.zeros(n)
    state = set_point * ones
    integral = set_point
    for k in range(n):
        y[k] = state[1] + disturbance[k]
        error = set_point - y[k]
        integral += error * DT_S / 2.5
        u[k + 8] = integral + error
        state = u[k] * ones + first @ (state - u[k] * ones)
        state = u[k + 1] * ones + second @ (state - u[k + 1] * ones)
    return u[8:], y


def closed_loop(input_noise: float) -> Case:
    """A loop against a slow disturbance; ``input_noise`` is in sd of the controller's output."""

    def record(seed: int) -> IOData:
        rng = np.random.default_rng(seed)
        slow = 2.0 * slow_noise(rng, np.exp(-DT_S / 5.0))
        u, y = pi_loop(slow + NOISE_K * rng.normal(size=N_SAMPLES))
        u = u + input_noise * np.std(u) * rng.normal(size=N_SAMPLES)
        return as_record(u, y)

    return Case(record, gain=None, lag_s=None, words=("closed loop",))


def constant_input(level: float, start: float) -> Case:
    """An input that never changes, from equilibrium with the input ``start``."""

    def record(seed: int) -> IOData:
        rng = np.random.default_rng(seed)
        u = np.full(N_SAMPLES, level)
        return as_record(u, response(u, start=start) + NOISE_K * rng.normal(size=N_SAMPLES))

    return Case(record, gain=None, lag_s=None, words=("constant",))


def unrelated(seed: int) -> IOData:
    """The output is a slow noise."""
    rng = np.random.default_rng(seed)
    u = levels(rng)
    return as_record(u, 50 + 5 * slow_noise(rng, 0.95) + NOISE_K * rng.normal(size=N_SAMPLES))


def with_white(rng: np.random.Generator, y: Array, sd: float = NOISE_K) -> Array:
    """White noise added."""
    return y + sd * rng.normal(size=len(y))


def with_outliers(rng: np.random.Generator, y: Array) -> Array:
    """White noise, and outliers of 10 K in 3 % of the samples."""
    spikes = np.where(rng.random(len(y)) < 0.03, 10 * rng.normal(size=len(y)), 0.0)
    return with_white(rng, y) + spikes


def with_walk(rng: np.random.Generator, y: Array) -> Array:
    """White noise of 0.3 K and a random walk of 0.05 K a sample."""
    return with_white(rng, y, 0.3) + np.cumsum(0.05 * rng.normal(size=len(y)))


def with_drift(share: float) -> Callable[[np.random.Generator, Array], Array]:
    """White noise and a drift by a share of the swing over the record."""
    return lambda rng, y: with_white(rng, y) + share * SWING_K * np.linspace(0, 1, len(y))


def with_wave(share: float) -> Callable[[np.random.Generator, Array], Array]:
    """White noise and 0.7 periods of a sine, whose range is a share of the swing."""

    def change(rng: np.random.Generator, y: Array) -> Array:
        wave = np.sin(2 * np.pi * (0.7 * np.linspace(0, 1, len(y)) + rng.random()))
        return with_white(rng, y) + share * SWING_K * wave / np.ptp(wave)

    return change


CASES: dict[str, Case] = {
    "white": case_a(with_white),
    "AR 0.9": case_a(lambda rng, y: y + NOISE_K * slow_noise(rng, 0.9)),
    "AR 0.99": case_a(lambda rng, y: y + NOISE_K * slow_noise(rng, 0.99)),
    "random walk": case_a(with_walk),
    "drift 1 %": case_a(with_drift(0.01)),
    "drift 2 %": case_a(with_drift(0.02)),
    "drift 6 %": case_a(with_drift(0.06)),
    "wave 6 %": case_a(with_wave(0.06)),
    "noisy input": Case(measured_input),
    "outliers": case_a(with_outliers),
    "quantised": case_a(lambda rng, y: np.round(2 * with_white(rng, y, 0.1)) / 2),
    "irregular": Case(irregular),
    "missing rows": Case(missing_rows),
    "off equilibrium": Case(off_equilibrium),
    "from rest": Case(from_rest),
    "30 samples": other_system(NUM_A, DEN_A, DEAD_A_S, dt_s=0.5, n=30, hold=5),
    "half-sample delay": other_system(NUM_A, DEN_A, 0.375),
    "feedthrough": other_system([0.6, 1.0], [2.0, 1.0], 0.0),
    "non-minimum phase": other_system([-0.6, 1.0], DEN_A, DEAD_A_S),
    "damping 0.2": other_system(NUM_A, [1.0, 0.4, 1.0], DEAD_A_S),
    "slab": Case(conduction(SLAB, 1), lag_s=SLAB_S / 2, dead_s=None),
    "half order": Case(conduction(HALF_ORDER, 0), lag_s=None, dead_s=None),
    "sampled at the lag": other_system(NUM_A, DEN_A, DEAD_A_S, dt_s=2.0),
    "wrong hold": other_system(NUM_A, DEN_A, DEAD_A_S, record_hold="foh"),
    "integrator": Case(integrating, gain=0.5, lag_s=None, dead_s=None, integrators=1),
    "P2": other_system(NUM_A, DEN_A, 0.0),
    "P1": other_system(NUM_A, [2.0, 1.0], 0.0),
    "closed loop": closed_loop(0.0),
    "closed loop, noisy input": closed_loop(0.1),
    "clipped": case_a(
        lambda rng, y: np.minimum(with_white(rng, y), 60.0),
        words=("clip", "limit", "saturat"),
    ),
    "constant input": constant_input(50.0, 50.0),
    "on from the first row": constant_input(75.0, 25.0),
    "unrelated": Case(
        unrelated,
        gain=None,
        lag_s=None,
        words=("unrelated", "does not respond", "does not follow", "no response"),
    ),
}
