"""A PID controller in its ideal, parallel and series form, continuous or sampled.

All forms are one transfer function with the same filter of the derivative, so that a conversion is
exact. ``tcdyn.tuning.rules`` makes controllers. Tests: ``tests/tuning/test_controller_forms.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tcdyn.chain.rational import Complex
from tcdyn.core import Array


@dataclass(frozen=True)
class Form:
    """Gain and times of the ideal or of the series form.

    Attributes
    ----------
    gain
        Gain, in input unit per output unit of the plant.
    integral_s
        Integral time [s].
    derivative_s
        Derivative time [s].
    """

    gain: float
    integral_s: float
    derivative_s: float


@dataclass(frozen=True)
class Controller:
    """A PI or PID controller.

    Attributes
    ----------
    kp
        Proportional gain, in input unit per output unit of the plant.
    ki
        Integral gain, that unit per second.
    kd
        Derivative gain, that unit times a second.
    filter_s
        Time constant of the filter of the derivative [s]; 0 without a derivative.
    sample_s
        Sampling interval of the controller [s]; 0 for a continuous one.
    setpoint_weight
        Weight b of the set point in the proportional part, Kp (b setpoint - reading); it changes
        no margin.

    Notes
    -----
    Parallel: Kp + Ki/s + Kd s/(1 + Tf s). Ideal: Kp (1 + 1/(Ti s) + Td s/(1 + Tf s)). Series:
    Kc (1 + 1/(Ti s)) (1 + Td s)/(1 + Tf s). Tf is the same in all forms.

    Examples
    --------
    >>> controller = Controller.from_series(2.0, 8.0, 2.0, 0.2)
    >>> round(controller.kp, 3), round(controller.ki, 3), round(controller.kd, 3)
    (2.45, 0.25, 3.51)
    """

    kp: float
    ki: float
    kd: float = 0.0
    filter_s: float = 0.0
    sample_s: float = 0.0
    setpoint_weight: float = 1.0

    @classmethod
    def from_series(
        cls, gain: float, integral_s: float, derivative_s: float = 0.0, filter_s: float = 0.0
    ) -> Controller:
        """The controller of a series form.

        Parameters
        ----------
        gain
            Kc, in input unit per output unit.
        integral_s, derivative_s, filter_s
            Ti, Td and Tf [s].
        """
        ideal_s = integral_s + derivative_s - filter_s
        ki = gain / integral_s
        kd = ki * (integral_s * derivative_s - ideal_s * filter_s) if derivative_s else 0.0
        return cls(ki * ideal_s, ki, kd, filter_s)

    @classmethod
    def from_ideal(
        cls, gain: float, integral_s: float, derivative_s: float = 0.0, filter_s: float = 0.0
    ) -> Controller:
        """The controller of an ideal form.

        Parameters
        ----------
        gain
            Kp, in input unit per output unit.
        integral_s, derivative_s, filter_s
            Ti, Td and Tf [s].
        """
        return cls(gain, gain / integral_s, gain * derivative_s, filter_s)

    def sampled(self, sample_s: float) -> Controller:
        """The same gains with a sampling interval [s]."""
        return replace(self, sample_s=sample_s)

    def weighted(self, setpoint_weight: float) -> Controller:
        """The same gains with a weight of the set point."""
        return replace(self, setpoint_weight=setpoint_weight)

    @property
    def ideal(self) -> Form:
        """The ideal form."""
        derivative_s = self.kd / self.kp if self.kd else 0.0  # not -0
        return Form(self.kp, self.kp / self.ki, derivative_s)

    @property
    def series(self) -> Form | None:
        """The series form; None where the zeros of the controller are complex.

        Notes
        -----
        The zeros are those of 1 + (Kp/Ki + Tf) s + (Kd/Ki + Kp Tf/Ki) s^2. Rounding of a double
        zero is no complex pair.
        """
        total_s = self.kp / self.ki + self.filter_s
        product_s2 = (self.kd + self.kp * self.filter_s) / self.ki if self.kd else 0.0
        discriminant = total_s**2 - 4 * product_s2
        if discriminant < -1e-12 * total_s**2:
            return None
        integral_s = (total_s + max(discriminant, 0.0) ** 0.5) / 2
        return Form(self.ki * integral_s, integral_s, product_s2 / integral_s)

    @property
    def derivative_memory(self) -> float:
        """Factor of the last derivative term of the sampled controller, Tf/(Tf + h)."""
        return self.filter_s / (self.filter_s + self.sample_s) if self.filter_s else 0.0

    @property
    def derivative_factor(self) -> float:
        """Factor of the change of the reading in the sampled derivative term, Kd/(Tf + h)."""
        return self.kd / (self.filter_s + self.sample_s) if self.kd else 0.0

    def difference_equation(self) -> list[str]:
        """Lines of the sampled controller: what one call computes.

        Notes
        -----
        The integral is that of backward rectangles, the derivative a filtered backward difference
        of the reading.

        Examples
        --------
        >>> print("\\n".join(Controller(2.0, 0.5).sampled(0.1).difference_equation()))
        e = setpoint - reading
        I = I + 0.05 e
        output = 2 e + I
        """
        lines = ["e = setpoint - reading", f"I = I + {self.ki * self.sample_s:.5g} e"]
        weight = self.setpoint_weight
        total = f"output = {self.kp:.5g} e + I"
        if weight != 1:
            total = f"output = {self.kp:.5g} ({weight:g} setpoint - reading) + I"
        if self.kd:
            lines.append(
                f"D = {self.derivative_memory:.5g} D - {self.derivative_factor:.5g} "
                "(reading - last reading)"
            )
            total += " + D"
        return [*lines, total]

    def frequency_response(self, omega: Array) -> Complex:
        """Response at angular frequencies (W,) [rad/s].

        Notes
        -----
        That of a sampled controller is from samples to samples, at z = exp(i omega h).
        """
        s = 1j * omega
        if not self.sample_s:
            return np.asarray(self.kp + self.ki / s + self.kd * s / (1 + self.filter_s * s))
        delay = np.exp(-self.sample_s * s)
        response = self.kp + self.ki * self.sample_s / (1 - delay)
        if self.kd:
            difference = self.derivative_factor * (1 - delay)
            response = response + difference / (1 - self.derivative_memory * delay)
        return np.asarray(response)
