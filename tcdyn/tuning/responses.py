"""Responses of loops in time to a step of the set point and to a step of the load.

The plant is solved exactly between steps of its input, with its exact dead time; a loop for each
draw runs at the same time. Limits of the actuator are not part of it. ``tcdyn.tuning.tune`` uses
it. Tests: ``tests/tuning/test_loop_responses.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tcdyn.chain.rational import Rational
from tcdyn.core import Array, Flags
from tcdyn.tuning.forms import Controller
from tcdyn.tuning.steps import PlantSteps, plant_steps

# Length of the simulation: SIMC settings settle within six integral times after a load, and within
# 20 inverses of the crossover frequency after a set point (for lag-dominant and delay-dominant
# plants, checked by tests/tuning/test_loop_responses.py).
INTEGRAL_TIMES = 6.0
CROSSOVERS = 20.0
N_STEPS = 2000  # a step is about 1 % of the closed loop's time constant
MAX_STEPS = 6000  # of a sampled controller; beyond it the sampling is a dead time of half a sample
SETTLED = 0.02  # of the step: the usual band of the settling time
RISE = (0.1, 0.9)  # shares of the step between which the rise time is measured
LARGEST = 1e9  # of the simulated output, at which an unstable loop is cut off: no number overflows


@dataclass(frozen=True)
class Responses:
    """Responses of loops (D, N) at times (N,).

    Attributes
    ----------
    time_s
        Times after the step [s].
    setpoint
        Output after a unit step of the set point.
    setpoint_input
        Controller output after it.
    load
        Output after a unit step at the input of the plant.
    load_input
        Controller output after it.
    """

    time_s: Array
    setpoint: Array
    setpoint_input: Array
    load: Array
    load_input: Array

    @property
    def rise_s(self) -> Array:
        """Time from 10 to 90 % of the step (D,) [s]; infinite where it is not reached."""
        first = [self._first_time(self.setpoint >= share) for share in RISE]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nan_to_num(first[1] - first[0], nan=np.inf), dtype=float)

    @property
    def settling_s(self) -> Array:
        """Time from which the output stays within 2 % of the step (D,) [s]."""
        outside = np.abs(self.setpoint - 1) > SETTLED
        last = outside.shape[1] - np.argmax(outside[:, ::-1], axis=1)
        last = np.where(outside.any(axis=1), last, 0)
        times = np.append(self.time_s, np.inf)
        return np.asarray(times[last])

    @property
    def overshoot_percent(self) -> Array:
        """Largest output beyond the set point (D,) [% of the step]."""
        return np.asarray(100 * np.maximum(self.setpoint.max(axis=1) - 1, 0.0))

    @property
    def load_iae(self) -> Array:
        """Integral of |output| after a unit step of the load (D,)."""
        step_s = self.time_s[1] - self.time_s[0]
        return np.asarray(np.abs(self.load).sum(axis=1) * step_s)

    @property
    def load_peak(self) -> Array:
        """Largest |output| after a unit step of the load (D,)."""
        return np.asarray(np.abs(self.load).max(axis=1))

    def _first_time(self, is_reached: Flags) -> Array:
        """First time at which a condition (D, N) holds (D,) [s]; infinite without one."""
        first = np.argmax(is_reached, axis=1)
        return np.where(is_reached.any(axis=1), self.time_s[first], np.inf)


def simulate_loops(
    plants: Sequence[Rational], controller: Controller, crossover_rad_s: float
) -> Responses:
    """Simulate a controller with each of several plants.

    Parameters
    ----------
    plants
        The plants (D,), of one structure.
    controller
        The controller. Its derivative acts on the reading, and its integral and proportional part
        on the error.
    crossover_rad_s
        Crossover frequency of the loop [rad/s], which gives the length of the simulation.

    Returns
    -------
    Responses
        The responses.

    Notes
    -----
    A continuous controller is computed in steps, with the trapezoidal rule. The hold of its output
    delays it by half a step, by which the dead time of the plant is shortened where it is longer.
    So that a jump of set point or load does not come half a step early, its first step has half of
    its size. The error is then of second order in the step.

    Examples
    --------
    >>> from tcdyn.chain import Chain
    >>> plant = Chain([8.0], delay_s=1.0).rational
    >>> responses = simulate_loops([plant], Controller.from_ideal(4.0, 8.0), 0.5)
    >>> responses.overshoot_percent.round(0), responses.load_iae.round(1)
    (array([4.]), array([2.]))
    """
    integral_s = controller.kp / controller.ki
    length_s = INTEGRAL_TIMES * integral_s + CROSSOVERS / crossover_rad_s
    step_s = length_s / N_STEPS
    further_s = 0.0
    period = 1
    if controller.sample_s:
        period = int(np.ceil(controller.sample_s / step_s - 1e-9))
        step_s = controller.sample_s / period
        if length_s / step_s > MAX_STEPS:
            step_s = length_s / MAX_STEPS
            period = 1
            further_s = controller.sample_s / 2
            controller = controller.sampled(0.0)
    if not controller.sample_s:
        further_s -= step_s / 2
    count = int(np.ceil(length_s / step_s)) + 1
    steps = plant_steps(plants, step_s, further_s)
    size = len(plants)
    output, controlled = _run(steps.twice(), controller, count, period, step_s)
    time_s = step_s * np.arange(count, dtype=float)
    return Responses(time_s, output[:size], controlled[:size], output[size:], controlled[size:])


def _run(
    steps: PlantSteps,
    controller: Controller,
    count: int,
    period: int,
    step_s: float,
) -> tuple[Array, Array]:
    """Run the loops, the first half with a step of the set point, the others with one of the load.

    Parameters
    ----------
    steps
        The plants.
    controller
        The controller.
    count
        Number of steps.
    period
        Steps between two samples of the controller.
    step_s
        The step [s].

    Returns
    -------
    output, controller_output
        Arrays (D, N).
    """
    size = len(steps.delay)
    rows = np.arange(size)
    longest = int(steps.delay.max(initial=0))
    inputs = np.zeros((count + longest + 1, size))  # of the plant, from `longest` steps before zero
    output = np.zeros((count, size))
    controlled = np.zeros((count, size))
    state = np.zeros(steps.gamma.shape, dtype=steps.phi.dtype)
    law = _Law(controller, step_s, size)
    setpoint = np.repeat([1.0, 0.0], size // 2)
    load = 1 - setpoint
    for k in range(count):
        share = 0.5 if k == 0 and not law.is_sampled else 1.0
        delayed = inputs[k - steps.delay + longest, rows]
        reading = (np.einsum("dn,dn->d", steps.c, state) + steps.d * delayed).real
        output[k] = np.clip(reading, -LARGEST, LARGEST)
        if k % period == 0:
            value = law.output(share * setpoint, output[k])
        controlled[k] = value
        inputs[k + longest] = value + share * load
        delayed = inputs[k - steps.delay + longest, rows]  # now with this step's input
        state = np.einsum("dnm,dm->dn", steps.phi, state) + steps.gamma * delayed[:, None]
        state = np.where(np.abs(state) < LARGEST * 1e3, state, 0.0)
    return output.T, controlled.T


class _Law:
    """The controllers of all loops, called once a sample.

    Parameters
    ----------
    controller
        The controller; a continuous one is computed with the trapezoidal rule.
    step_s
        Step of the simulation [s].
    size
        Number of loops.
    """

    def __init__(self, controller: Controller, step_s: float, size: int) -> None:
        """Compute the factors of one call."""
        self.kp = controller.kp
        self.weight = controller.setpoint_weight
        self.is_sampled = controller.sample_s > 0
        self.integral = np.zeros(size)
        self.derivative = np.zeros(size)
        self.last_error = np.zeros(size)
        self.last_reading = np.zeros(size)
        if self.is_sampled:
            self.integral_factor = controller.ki * controller.sample_s
            self.memory = controller.derivative_memory
            self.derivative_factor = controller.derivative_factor
        else:
            double_s = 2 * controller.filter_s
            self.integral_factor = controller.ki * step_s / 2
            self.memory = (double_s - step_s) / (double_s + step_s)
            self.derivative_factor = 2 * controller.kd / (double_s + step_s)

    def output(self, setpoint: Array, reading: Array) -> Array:
        """Output of the controllers (D,) for set points and readings (D,)."""
        error = setpoint - reading
        further = error if self.is_sampled else error + self.last_error
        self.integral = self.integral + self.integral_factor * further
        change = reading - self.last_reading
        self.derivative = self.memory * self.derivative - self.derivative_factor * change
        self.last_error = error
        self.last_reading = reading
        proportional = self.kp * (self.weight * setpoint - reading)
        return proportional + self.integral + self.derivative
