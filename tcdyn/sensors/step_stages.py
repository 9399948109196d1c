"""What a plunged sensor's largest lag does not describe: its film, its stem, its bath.

A stage replaces the largest lag of a structure of ``tcdyn.sensors.step_structures``, which averages
the structures with and without each. Tests: ``tests/sensors/test_step_stages.py``; coverage:
`python -m tests.sensors.hand_study`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from tcdyn.core import Array

# Nodes of the numerical inversion of a Laplace transform; its relative error is 10^(-0.6 M)
# (J. Abate, P. P. Valko, Int. J. Numer. Meth. Engng 60, 979, 2004).
TALBOT_NODES = 12
# Times at which a response is inverted; a spline joins them. Over the priors it is wrong by 1e-6 of
# the step in the median and by 1e-4 at most (test_step_stages.py).
SPLINE_TIMES = 80
# Lags until a response is followed for its percent times, and the rows of that grid
TIMES_LAGS = 40.0
TIMES_ROWS = 4001
# Difference of a response from that of one lag, below which it is one lag: a second one would not
# be determined. By judgement; the lag is the same.
ONE_LAG = 0.002
# Imaginary step of a derivative, over the lowest rate
DERIVATIVE_STEP = 1e-4


@dataclass(frozen=True)
class StageParameter:
    """A parameter of a stage: normal prior and limits.

    Attributes
    ----------
    name
        Name.
    mean, sd
        Mean and standard deviation of the prior.
    low, high
        Limits.
    """

    name: str
    mean: float
    sd: float
    low: float
    high: float


class Stage(ABC):
    """Response of the first stage of a sensor, which has one lag and further parameters."""

    parameters: tuple[StageParameter, ...]

    @abstractmethod
    def response(self, values: Mapping[str, float], lag_s: float, since_s: Array) -> Array:
        """Response (N,) of a dip at times after the entry (N,) [s], in steps of the reading.

        Parameters
        ----------
        values
            The parameters by name.
        lag_s
            Lag of the first stage [s].
        since_s
            Times (N,) [s], zero or more.
        """

    def means(self) -> dict[str, float]:
        """Means of the priors by name."""
        return {parameter.name: parameter.mean for parameter in self.parameters}

    def starts(self) -> list[dict[str, float]]:
        """Start values by name, of one fit each."""
        return [self.means()]

    def sensor_response(self, values: Mapping[str, float], lag_s: float, since_s: Array) -> Array:
        """Response (N,) whose percent times are those of the sensor; see ``response``."""
        return self.response(values, lag_s, since_s)

    def sensor_lag_s(self, values: Mapping[str, float], lag_s: float) -> float:
        """Lag of the stage as a compensation needs it [s]."""
        del values
        return lag_s

    def lags_and_zero(
        self, values: Mapping[str, float], lag_s: float
    ) -> tuple[tuple[float, ...], float]:
        """Lags and zero [s] of a chain that stands for the stage."""
        del values
        return (lag_s,), 0.0


class SettlingFilm(Stage):
    """A film coefficient h (1 + a exp(-t / s)) after the entry, as where a hand moves, then holds.

    Notes
    -----
    The exact response of the stage is 1 - exp(-(t + a s (1 - exp(-t / s))) / T) with the lag T of
    the settled film. The priors of a and s are by judgement: a hand that moves a sensor, then holds
    it, makes the coefficient half or twice as large for a part of a second.

    Examples
    --------
    >>> values = {"film_change": 1.0, "settling_s": 0.5}
    >>> SettlingFilm().response(values, 2.0, np.array([0.0, 1.0, 10.0])).round(3).tolist()
    [0.0, 0.511, 0.995]
    """

    parameters = (
        StageParameter("film_change", 0.0, 0.7, -0.8, 4.0),
        StageParameter("settling_s", 0.4, 0.4, 0.02, np.inf),
    )

    def starts(self) -> list[dict[str, float]]:
        """Start values: a film that falls a little, and one that rises."""
        return [self.means() | {"film_change": change} for change in (0.1, -0.4)]

    def response(self, values: Mapping[str, float], lag_s: float, since_s: Array) -> Array:
        """Response of a dip; see ``Stage``."""
        settling_s = values["settling_s"]
        moved_s = since_s - values["film_change"] * settling_s * np.expm1(-since_s / settling_s)
        return np.asarray(-np.expm1(-moved_s / lag_s))


class RelaxingBath(Stage):
    """A bath whose temperature changes exponentially after the entry, by a share of the step.

    The sensor has cooled the bath, or the bath is warmer at the top. The lag and the percent times
    are those of a step of the bath.

    Notes
    -----
    The bath is at 1 - b (1 - exp(-t / T)) of the step. A lag L follows with
    1 - exp(-t / L) - b (1 - (T exp(-t / T) - L exp(-t / L)) / (T - L)). Prior of b: 4 %; of the
    logarithm of T / L: that of 3, standard deviation 0.8; both by judgement. A rising bath is the
    same curve as a second, slow heat path: the record cannot distinguish them.

    Examples
    --------
    >>> values = {"bath_share": 0.05, "log_bath": np.log(3.0)}
    >>> RelaxingBath().response(values, 2.0, np.array([0.0, 2.0, 100.0])).round(3).tolist()
    [0.0, 0.627, 0.95]
    """

    parameters = (
        StageParameter("bath_share", 0.0, 0.04, -0.3, 0.3),
        StageParameter("log_bath", float(np.log(3.0)), 0.8, 0.1, 5.0),
    )

    def response(self, values: Mapping[str, float], lag_s: float, since_s: Array) -> Array:
        """Response of a dip; see ``Stage``."""
        bath_s = lag_s * float(np.exp(values["log_bath"]))
        of_bath = bath_s * np.exp(-since_s / bath_s)
        of_lag = lag_s * np.exp(-since_s / lag_s)
        fallen = 1 - (of_bath - of_lag) / (bath_s - lag_s)
        return np.asarray(-np.expm1(-since_s / lag_s) - values["bath_share"] * fallen)

    def sensor_response(self, values: Mapping[str, float], lag_s: float, since_s: Array) -> Array:
        """Response to a step of the bath; see ``Stage``."""
        del values
        return np.asarray(-np.expm1(-since_s / lag_s))


class Fin(Stage):
    """A junction on wires and a stem that conduct heat along themselves, out of the bath.

    The reading does not reach the bath: lag and response are those of the sensor's own final
    reading. A compensation therefore gives the temperature that the sensor would settle at.

    Notes
    -----
    Three sections of a rod that conducts along itself, of which each follows
    d2(theta)/dx2 = (1/T_i + d/dt) theta / alpha - u / (alpha T_i), with its own lag T_i = rho c d /
    (4 h): the free wires of lag T and length X_1 decay lengths, the immersed stem of a diameter
    ratio D and length X_2 of its decay lengths, and the part outside, which stays at the first
    temperature and has T_o = T / r. The coefficient of a cylinder in cross flow falls as d^(-1/2),
    so that T_2 = D^(3/2) T (Incropera and DeWitt, Fundamentals of Heat and Mass Transfer, sections
    3.6 and 7.4). Their transforms are those of electrical lines in series, and the response is
    inverted numerically.

    The parameters are the logarithms of X_1, D, X_2 and r. Their priors are those of wires of 0.2
    to 1.5 mm in water and in air that are immersed by 8 to 60 mm; by judgement.

    Examples
    --------
    >>> values = Fin().means() | {"log_depth": 0.0, "log_outside": -2.0}
    >>> round(Fin().gain(values), 3), round(Fin().sensor_lag_s(values, 2.0), 2)
    (0.979, 2.26)
    """

    parameters = (
        StageParameter("log_bead", float(np.log(0.3)), 1.2, -5.0, 4.0),
        StageParameter("log_bead_lag", float(np.log(1.5)), 0.4, -1.0, 2.0),
        StageParameter("log_free", float(np.log(2.0)), 1.0, -2.5, 3.5),
        StageParameter("log_ratio", 0.0, 0.8, 0.0, 2.5),
        StageParameter("log_depth", float(np.log(4.0)), 0.8, -1.0, 3.5),
        StageParameter("log_outside", float(np.log(0.03)), 1.5, -9.0, 0.5),
    )

    def starts(self) -> list[dict[str, float]]:
        """Start values: wires that end in a thicker stem, immersed more and less deeply."""
        deep = {"log_free": 1.0, "log_ratio": 1.0, "log_depth": 1.0}
        short = {"log_free": 0.3, "log_ratio": 1.0, "log_depth": 0.3, "log_outside": -3.0}
        return [self.means() | deep, self.means() | short]

    def response(self, values: Mapping[str, float], lag_s: float, since_s: Array) -> Array:
        """Response of a dip; see ``Stage``."""
        position = np.sqrt(since_s / lag_s)
        nodes = np.linspace(0.0, float(position.max()), SPLINE_TIMES)
        step = np.append(0.0, _invert_step(lambda p: _tip(p, values), nodes[1:] ** 2))
        return np.asarray(CubicSpline(nodes, step / self.gain(values))(position))

    def gain(self, values: Mapping[str, float]) -> float:
        """Final reading over the step of the bath [1]."""
        return float(_tip(np.zeros(1, dtype=complex), values)[0].real)

    def sensor_lag_s(self, values: Mapping[str, float], lag_s: float) -> float:
        """Lag of the stage [s]: the first moment of the response to an impulse."""
        lowest = min(float(np.exp(values["log_outside"])), np.exp(-1.5 * values["log_ratio"]))
        small = DERIVATIVE_STEP * lowest
        slope = float(_tip(np.array([1j * small]), values)[0].imag) / small
        return -lag_s * slope / self.gain(values)

    def lags_and_zero(
        self, values: Mapping[str, float], lag_s: float
    ) -> tuple[tuple[float, ...], float]:
        """Two lags and a zero with the lag of the stage, nearest to its response."""
        whole_s = self.sensor_lag_s(values, lag_s)
        t = np.linspace(0.0, 3.0, SPLINE_TIMES)[1:] ** 2 * lag_s
        wanted = self.response(values, lag_s, t)

        def misfit(log_lags: Array) -> Array:
            """Response of two lags and the zero, minus that of the stage."""
            lags_s = np.exp(log_lags)
            return np.asarray(_two_lags(lags_s, whole_s, t) - wanted)

        one_lag = -np.expm1(-t / whole_s)
        if float(np.abs(one_lag - wanted).max()) < ONE_LAG:
            return (whole_s,), 0.0
        start = np.log([0.7 * whole_s, 1.7 * whole_s])
        found = np.exp(least_squares(misfit, start).x)
        zero_s = float(found.sum() - whole_s)
        if zero_s < 0:
            return (whole_s,), 0.0
        return (float(found[0]), float(found[1])), zero_s


STAGES: dict[str, Stage] = {"film": SettlingFilm(), "bath": RelaxingBath(), "fin": Fin()}


def _two_lags(lags_s: Array, whole_s: float, t: Array) -> Array:
    """Response (N,) of two lags with the zero that makes their lag ``whole_s``."""
    first_s, second_s = lags_s
    if abs(first_s - second_s) < 1e-6 * whole_s:
        second_s = first_s * (1 + 1e-6)
    zero_s = first_s + second_s - whole_s
    of_first = (first_s - zero_s) / (first_s - second_s)
    of_second = (second_s - zero_s) / (second_s - first_s)
    return np.asarray(1 - of_first * np.exp(-t / first_s) - of_second * np.exp(-t / second_s))


def _tip(p: Array, values: Mapping[str, float]) -> Array:
    """Transform of the tip's temperature over that of the bath, at rates p (..., ) of 1/T."""
    ratio = float(np.exp(values["log_ratio"]))
    slower = ratio**1.5
    area = ratio**2
    free_root = np.sqrt(1 + p)
    stem_root = np.sqrt(1 / slower + p)
    outside_root = np.sqrt(np.exp(values["log_outside"]) + p)
    depth = np.exp(values["log_depth"]) * np.sqrt(slower)
    admittance, level = _through(
        area * outside_root, 0.0 * p, area * stem_root, 1 / (1 + slower * p), depth * stem_root
    )
    free = np.exp(values["log_free"])
    admittance, level = _through(admittance, level, free_root, 1 / (1 + p), free * free_root)
    bead = np.exp(values["log_bead"])
    bead_lag = np.exp(values["log_bead_lag"])
    return np.asarray((bead + admittance * level) / (bead * (1 + bead_lag * p) + admittance))


def _through(
    load: Array, load_level: Array, own: Array, level: Array, length: Array
) -> tuple[Array, Array]:
    """Admittance and level without flow at the near end of a section that ends in a load.

    Parameters
    ----------
    load, load_level
        Admittance of the load, and the level at which no heat flows into it.
    own, level
        Admittance of an endless section, and the level of a section without conduction.
    length
        Length of the section in its own decay lengths.
    """
    decay = np.exp(-length)
    square = decay * decay
    tangent = (1 - square) / (1 + square)
    secant = 2 * decay / (1 + square)
    near = own * (load + own * tangent) / (own + load * tangent)
    return near, level - (level - load_level) * load * secant / (own * tangent + load)


def _invert_step(transform: Callable[[Array], Array], t: Array) -> Array:
    """Step response (N,) at times above zero (N,) by the fixed Talbot contour.

    Parameters
    ----------
    transform
        Transfer function of an array of complex rates.
    t
        Times (N,), in the unit of one over the rates.
    """
    angle = np.arange(1, TALBOT_NODES) * np.pi / TALBOT_NODES
    cotangent = 1 / np.tan(angle)
    contour = np.append(1.0, angle * (cotangent + 1j))
    turn = angle * (1 + cotangent**2) - cotangent
    weight = np.append(0.5, 1 + 1j * turn)
    rate = 2 * TALBOT_NODES / (5 * t)
    p = rate[:, None] * contour
    terms = np.exp(p * t[:, None]) * transform(p) / p * weight
    return np.asarray(rate / TALBOT_NODES * terms.real.sum(axis=1))
