"""Settings from simulated records, on the plant that made the record.

`python -m tests.tuning.tuning_study [PLANTS] [SEED]` simulates step records of plants (lags with
dead time, three unequal lags, a rod that is heated at one end, the rod behind a slow sensor),
identifies each without naming a model, tunes PI and PID controllers by both rules, and closes the
loop with the true plant. It prints whether the true loop is stable, whether its gain margin, phase
margin and largest sensitivity are inside of the stated 95 % ranges, its largest sensitivity, and
the warnings. Plants, records and loops are solved here, by code of their own.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

import tcdyn
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Severity
from tcdyn.tuning import Controller, Tuning

KINDS = ("lag", "two lags", "three lags", "rod", "rod and sensor")
SETTINGS = (("simc", "pi"), ("simc", "pid"), ("robust", "pi"), ("robust", "pid"))
N_CELLS = 30  # of the rod
SAMPLES = 800
NOISE = (0.002, 0.05)  # of the range of the output
MARGINS = ("gain_margin", "phase_margin_deg", "ms")


@dataclass(frozen=True)
class TruePlant:
    """dx/dt = A x + b u(t - delay_s), y = c x."""

    kind: str
    A: Array
    b: Array
    c: Array
    delay_s: float

    @property
    def lag_s(self) -> float:
        """First moment of the impulse response [s]."""
        gain = -self.c @ np.linalg.solve(self.A, self.b)
        moment = self.c @ np.linalg.solve(self.A, np.linalg.solve(self.A, self.b))
        return float(self.delay_s + moment / gain)

    def response(self, omega: Array) -> Array:
        """Frequency response (W,)."""
        unit = np.eye(len(self.b))
        states = [np.linalg.solve(1j * w * unit - self.A, self.b) for w in omega]
        return np.array(states) @ self.c * np.exp(-1j * omega * self.delay_s)


def in_series(first: TruePlant, lag_s: float) -> TruePlant:
    """A plant with one more lag behind it."""
    n = len(first.b)
    A = np.zeros((n + 1, n + 1))
    A[:n, :n] = first.A
    A[n, :n] = first.c / lag_s
    A[n, n] = -1 / lag_s
    b = np.append(first.b, 0.0)
    c = np.append(np.zeros(n), 1.0)
    return TruePlant(first.kind, A, b, c, first.delay_s)


def lags(kind: str, gain: float, times_s: list[float], delay_s: float) -> TruePlant:
    """Lags one after the other."""
    one = np.array([[-1 / times_s[0]]])
    plant = TruePlant(kind, one, np.array([gain / times_s[0]]), np.ones(1), delay_s)
    for time_s in times_s[1:]:
        plant = in_series(plant, time_s)
    return plant


def rod(kind: str, gain: float, time_s: float, loss: float, delay_s: float) -> TruePlant:
    """A rod heated at one end, measured at 0.6 of its length, that loses heat along it.

    ``time_s`` is its diffusion time [s], ``loss`` the loss over the conduction.
    """
    rate = N_CELLS**2 / time_s
    A = rate * (np.eye(N_CELLS, k=1) + np.eye(N_CELLS, k=-1) - 2 * np.eye(N_CELLS))
    A[0, 0] = A[-1, -1] = -rate
    A -= np.eye(N_CELLS) * loss / time_s
    b = np.zeros(N_CELLS)
    b[0] = 1 / time_s
    c = np.zeros(N_CELLS)
    c[int(0.6 * N_CELLS)] = 1.0
    static = -c @ np.linalg.solve(A, b)
    return TruePlant(kind, A, b * gain / static, c, delay_s)


def drawn_plant(kind: str, rng: np.random.Generator) -> TruePlant:
    """A plant of a kind, its times and gain at random."""
    gain = float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.2), np.log(5))))
    slow_s = float(np.exp(rng.uniform(np.log(20), np.log(300))))
    delay_s = slow_s * float(rng.uniform(0.03, 0.5))
    if kind == "rod":
        return rod(kind, gain, slow_s, float(rng.uniform(0.5, 3)), 0.2 * delay_s)
    if kind == "rod and sensor":
        inner = rod(kind, gain, slow_s, float(rng.uniform(0.5, 3)), 0.0)
        return in_series(inner, slow_s * float(rng.uniform(0.03, 0.2)))
    ratios = {"lag": [1.0], "two lags": [1.0, 0.3], "three lags": [1.0, 0.4, 0.15]}[kind]
    times_s = [slow_s * ratio * float(rng.uniform(0.7, 1.3)) for ratio in ratios]
    return lags(kind, gain, times_s, delay_s)


class Run:
    """A plant in steps of time, with a buffer for its dead time."""

    def __init__(self, plant: TruePlant, step_s: float) -> None:
        """Compute the matrices of one step."""
        n = len(plant.b)
        block = np.zeros((n + 1, n + 1))
        block[:n, :n] = plant.A
        block[:n, n] = plant.b
        e = expm(block * step_s)
        self.phi, self.gamma, self.c = e[:n, :n], e[:n, n], plant.c
        self.buffer = [0.0] * round(plant.delay_s / step_s)
        self.x = np.zeros(n)

    def step(self, u: float) -> float:
        """The output one step later, under a constant input."""
        self.buffer.append(u)
        self.x = self.phi @ self.x + self.gamma * self.buffer.pop(0)
        return float(self.c @ self.x)


def record(plant: TruePlant, rng: np.random.Generator) -> tuple[Array, Array, float]:
    """Input, output and interval [s] of a record of four steps, with noise."""
    dt_s = 16 * plant.lag_s / SAMPLES
    u = np.repeat([30.0, 60.0, 40.0, 70.0, 30.0], [40, 190, 190, 190, 190])
    run = Run(plant, dt_s / 10)
    y = []
    for value in u:
        y.append(float(run.c @ run.x))  # sampled as the input is set
        for _ in range(10):
            run.step(value - 30.0)
    clean = np.array(y)
    noise = float(np.exp(rng.uniform(*np.log(NOISE))))
    return u, 20 + clean + noise * np.ptp(clean) * rng.standard_normal(len(u)), dt_s


def true_margins(plant: TruePlant, controller: Controller) -> tuple[float, float, float]:
    """Gain margin, phase margin [deg] and largest sensitivity of the true loop."""
    omega = np.geomspace(1e-3, 300, 6000) / plant.lag_s
    s = 1j * omega
    law = controller.kp + controller.ki / s + controller.kd * s / (1 + controller.filter_s * s)
    loop = plant.response(omega) * law
    phase = np.unwrap(np.angle(loop))
    phase -= 2 * np.pi * np.round((phase[0] + np.pi / 2) / (2 * np.pi))
    beyond = np.flatnonzero(phase <= -np.pi)
    gain_margin = 1 / abs(loop[beyond[0]]) if len(beyond) else np.inf
    crossing = np.flatnonzero(np.abs(loop) >= 1)[-1]
    return (
        float(gain_margin),
        float(180 + np.degrees(phase[crossing])),
        float(np.max(1 / np.abs(1 + loop))),
    )


def settles(plant: TruePlant, controller: Controller, crossover: float) -> bool:
    """Whether the true loop comes to rest after a step of the load."""
    length_s = 12 * controller.kp / controller.ki + 60 / crossover
    step_s = min(length_s / 6000, controller.filter_s / 3 or np.inf)
    run = Run(plant, step_s)
    y = integral = derivative = last = 0.0
    trace = []
    for _ in range(int(length_s / step_s)):
        integral -= controller.ki * step_s * y
        if controller.kd:
            filtered_s = controller.filter_s + step_s
            derivative = (
                controller.filter_s * derivative - controller.kd * (y - last)
            ) / filtered_s
        last = y
        y = run.step(1.0 - controller.kp * y + integral + derivative)
        trace.append(y)
    early, late = np.array_split(np.abs(trace), 2)
    return bool(late.max() < 0.5 * early.max())


def judge(plant: TruePlant, tuning: Tuning) -> dict[str, bool | float]:
    """What came true of the settings."""
    gain_margin, phase_margin_deg, ms = true_margins(plant, tuning.controller)
    true = {"gain_margin": gain_margin, "phase_margin_deg": phase_margin_deg, "ms": ms}
    crossover = 20.0 / (
        tuning.responses.time_s[-1] - 6 * tuning.controller.kp / tuning.controller.ki
    )
    found: dict[str, bool | float] = {"stable": settles(plant, tuning.controller, crossover)}
    for name, value in true.items():
        spread = tuning.margins[name]
        found[name] = spread.low95 <= value <= spread.high95
    found["true ms"] = ms
    found["model ms"] = tuning.margins["ms"].value
    return found


def main(count: int, seed: int) -> None:
    """Print one line for each setting, and the counts."""
    rng = np.random.default_rng(seed)
    counts: Counter[tuple[str, str]] = Counter()
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        plant = drawn_plant(kind, rng)
        u, y, dt_s = record(plant, rng)
        comparison = tcdyn.identify((u, y, dt_s), input="heater_percent", output="T_degC")
        for rule, controller in SETTINGS:
            key = f"{rule} {controller}"
            try:
                tuning = comparison.best.tune(rule=rule, controller=controller)
            except InputError as problem:
                counts[key, "refused"] += 1
                print(f"{kind:15s} {comparison.recommended:8s} {key:11s} refused: {problem}")
                continue
            found = judge(plant, tuning)
            serious = [f.code for f in tuning.findings if f.severity is not Severity.INFO]
            counts[key, "settings"] += 1
            for name in ("stable", *MARGINS):
                counts[key, name] += bool(found[name])
            counts[key, "true Ms above 2"] += found["true ms"] > 2
            counts[key, "warned"] += bool(serious)
            counts[key, "true Ms above 2, not warned"] += found["true ms"] > 2 and not serious
            inside = "".join(
                "x" if found[n] else "-" for n in ("gain_margin", "phase_margin_deg", "ms")
            )
            print(
                f"{kind:15s} {comparison.recommended:8s} {key:11s} "
                f"{'stable' if found['stable'] else 'UNSTABLE'} inside GM PM Ms: {inside}  "
                f"Ms true {found['true ms']:.2f}, model {found['model ms']:.2f} {serious}",
                flush=True,
            )
    names = ("settings", "refused", "stable", *MARGINS)
    names += ("true Ms above 2", "warned", "true Ms above 2, not warned")
    print()
    for rule, controller in SETTINGS:
        key = f"{rule} {controller}"
        print(f"{key}: " + ", ".join(f"{name} {counts[key, name]}" for name in names))


if __name__ == "__main__":
    main(*(int(word) for word in (*sys.argv[1:], *("40", "1")[len(sys.argv) - 1 :])))
