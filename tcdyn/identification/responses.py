"""Responses of an identified model with uncertainty bands: step response, percent times, Bode.

``tcdyn.identification.identified`` and ``tcdyn.plots.identify`` use it. Bands are first-order
propagation of the covariance of the parameters. ``tests/identify/test_identify_closed_forms.py``
compares them with the derivatives of one lag, ``tests/identify/test_identify_results.py`` checks
their coverage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.polynomial import polynomial

from tcdyn.chain.rational import Rational, realise, simulate_rows
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95, Estimate, mixture
from tcdyn.core.result import Result
from tcdyn.estimation.noise_average import MixturePart
from tcdyn.identification.models import KnownDynamics, Model

SMALLEST_REL_U = 1e-12  # relative uncertainty below which it is a rounding error
# Slowest time constants after which a step response is complete: 0.03 % of one lag remain.
STEP_TIME_CONSTANTS = 8.0
# Shares of the final value whose times are reported (VDI/VDE 3522).
PERCENT_TIMES = {"t50": 0.5, "t63.2": 1 - float(np.exp(-1)), "t90": 0.9}


class Dynamics:
    """A linear model with the covariance of its free parameters; base of the identified model.

    Parameters
    ----------
    model
        The model structure.
    theta
        All parameters by name.
    covariance
        Covariance (P, P) of the free parameters, in the order of ``model.free``.
    dt_s
        Sampling interval of the record [s]; 0 for a model without a record.
    timing_u_s
        Standard uncertainty of the time of the output against the input [s], which is in lag, dead
        time and percent times.
    parts
        Normal distributions of the free parameters, relative to ``theta``, whose mixture has the
        covariance; none for one normal distribution.
    """

    model: Model
    theta: Mapping[str, float]
    covariance: Array
    dt_s: float
    timing_u_s: float
    parts: tuple[MixturePart, ...]

    @property
    def rational(self) -> Rational:
        """The transfer function as factors, the known one included.

        Raises
        ------
        InputError
            For several inputs, of which each has its own.
        """
        if self.model.inputs:
            raise InputError(
                f"{self.model.name} has {len(self.model.inputs)} inputs",
                remedy=f"take by_input[{self.model.inputs[0]!r}]",
            )
        return self.model.rational(self.theta)

    @property
    def gain(self) -> float:
        """Static gain (without the integrator)."""
        return float(self.rational.num[0])

    @property
    def static_gain(self) -> Estimate:
        """Static gain with its uncertainty (without the integrator)."""
        return mixture(*self.gain_parts)

    @property
    def gain_parts(self) -> tuple[list[Estimate], list[float]]:
        """Normal distributions of the static gain and their weights."""
        return self.distribution(self.gain, self.model.chain_rule(self.theta)[0])

    @cached_property
    def lag_s(self) -> Estimate:
        """First moment of the impulse response [s], the known factor included.

        Raises
        ------
        InputError
            For a model without a lag, or with one for each input.
        """
        return mixture(*self.lag_parts)

    @property
    def lag_parts(self) -> tuple[list[Estimate], list[float]]:
        """Normal distributions of the lag [s] and their weights.

        Notes
        -----
        Td + sum of a_1 - b_1/b_0; its derivatives with the free parameters follow from the chain
        rule of the coefficients.

        Raises
        ------
        InputError
            For a model without a lag, or with one for each input.
        """
        if self.model.integrators:
            raise InputError(
                f"{self.model.name} has no lag: its output rises as long as the input is not zero",
                expected="a model without integrator",
            )
        g = self.rational
        gradient = [0.0] * len(g.num)
        if len(g.num) > 1:
            gradient[0] = g.num[1] / g.num[0] ** 2
            gradient[1] = -1.0 / g.num[0]
        for factor in g.factors:
            if factor.free:
                gradient += [1.0, *[0.0] * (len(factor.coefs) - 2)]
        gradient.append(1.0)
        by_parameter = gradient @ self.model.chain_rule(self.theta)
        return self.distribution(g.lag_s, by_parameter, self.timing_u_s)

    def distribution(
        self, value: float, gradient: Array, further_u: float = 0.0
    ) -> tuple[list[Estimate], list[float]]:
        """Return the normal distributions of a quantity, and their weights.

        Parameters
        ----------
        value
            The quantity.
        gradient
            Its derivatives with the free parameters (P,).
        further_u
            Standard uncertainty from elsewhere, in the unit of the quantity.
        """
        parts = self.parts or (MixturePart(1.0, np.zeros(len(gradient)), self.covariance),)
        estimates = []
        for part in parts:
            variance = max(float(gradient @ part.covariance @ gradient), 0.0)
            u = float(np.hypot(np.sqrt(variance), further_u))
            estimates.append(Estimate.normal(value + float(gradient @ part.mean), u))
        return estimates, [part.weight for part in parts]

    def standard_uncertainty(self, jacobian: Array) -> Array:
        """Return the standard uncertainties of quantities from their derivatives.

        Parameters
        ----------
        jacobian
            Derivatives with the free parameters (P, N).

        Returns
        -------
        array
            Standard uncertainties (N,).
        """
        variance = np.einsum("pn,pq,qn->n", jacobian, self.covariance, jacobian)
        return np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True, repr=False)
class Band(Result):
    """A curve with its standard uncertainty; the 95 % band is value -+ 1.96 u.

    Parameters
    ----------
    x
        Abscissa (N,).
    value
        Ordinate (N,).
    u
        Standard uncertainty of the ordinate (N,).
    """

    x: Array
    value: Array
    u: Array

    def summary(self) -> str:
        """Number of points and range."""
        return (
            f"{len(self.x)} points from {self.x[0]:.4g} to {self.x[-1]:.4g}, values "
            f"{np.min(self.value):.4g} to {np.max(self.value):.4g}, u at most {np.max(self.u):.2g}"
        )

    def to_frame(self) -> pd.DataFrame:
        """Value, standard uncertainty and 95 % band, in the units of the curve."""
        columns = {"value": self.value, "u": self.u, "low95": self.low95, "high95": self.high95}
        return pd.DataFrame(columns, pd.Index(self.x, name="x"))

    @property
    def low95(self) -> Array:
        """Lower edge of the 95 % band (N,)."""
        return self.value - Z95 * self.u

    @property
    def high95(self) -> Array:
        """Upper edge of the 95 % band (N,)."""
        return self.value + Z95 * self.u


@dataclass(frozen=True, repr=False)
class BodeBand(Result):
    """Magnitude and phase with their bands over frequency [Hz].

    Parameters
    ----------
    magnitude_dB
        Magnitude [dB].
    phase_deg
        Unwrapped phase [deg].
    """

    magnitude_dB: Band
    phase_deg: Band

    def summary(self) -> str:
        """Number of frequencies and their range."""
        f = self.magnitude_dB.x
        return f"magnitude and phase at {len(f)} frequencies, {f[0]:.3g} to {f[-1]:.3g} Hz"

    def to_frame(self) -> pd.DataFrame:
        """Magnitude and phase with their standard uncertainties, over the frequency [Hz]."""
        columns = {
            "magnitude_dB": self.magnitude_dB.value,
            "magnitude_u_dB": self.magnitude_dB.u,
            "phase_deg": self.phase_deg.value,
            "phase_u_deg": self.phase_deg.u,
        }
        return pd.DataFrame(columns, pd.Index(self.magnitude_dB.x, name="frequency_Hz"))


def step_rows(model: Dynamics, time_s: Array) -> tuple[Array, Array]:
    """Return the unit step response and its derivatives with the free parameters.

    Parameters
    ----------
    model
        The model.
    time_s
        Uniform grid of times (N,) from 0 [s].

    Returns
    -------
    y
        Step response (N,).
    jacobian
        Derivatives (P, N).
    """
    g = model.rational
    dt = float(time_s[1] - time_s[0])
    rows = simulate_rows(realise(g), np.ones(len(time_s)), dt, g.delay_s, "zoh", "zero")
    return rows[0], model.model.chain_rule(model.theta).T @ rows[1:]


def step_time_grid(model: Dynamics, n_intervals: int = 1200) -> Array:
    """Return a uniform grid of times (n_intervals + 1,) [s] over the complete step response."""
    g = model.rational
    end_s = g.delay_s + STEP_TIME_CONSTANTS * slowest_time_constant_s(g)
    return np.linspace(0.0, end_s, n_intervals + 1)


def slowest_time_constant_s(g: Rational) -> float:
    """Time constant of the slowest pole [s]; 1 where there is none."""
    return max((float(1 / np.min(np.abs(f.poles.real))) for f in g.factors), default=1.0)


@with_named_arguments
def step_band(model: Dynamics, time_s: Array | None = None) -> Band:
    """The unit step response with its band, by first-order propagation of the covariance.

    Parameters
    ----------
    model
        The model.
    time_s
        Uniform grid of times (N,) from 0 [s]; by default that of ``step_time_grid``.

    Returns
    -------
    Band
        The step response.

    Examples
    --------
    >>> from tcdyn.identification import Identified, process
    >>> model = Identified.of(process("P1"), {"Kp": 2.0, "Tp1": 0.8}, np.diag([1e-4, 1e-4]))

    >>> step_band(model, np.array([0.0, 20.0])).value.round(3)
    array([0., 2.])
    """
    t = step_time_grid(model, 400) if time_s is None else np.asarray(time_s, dtype=float)
    y, jacobian = step_rows(model, t)
    return Band(t, y, model.standard_uncertainty(jacobian))


@with_named_arguments
def percent_times(model: Dynamics) -> dict[str, Estimate]:
    """t50, t63.2 and t90 [s] of the unit step response (VDI/VDE 3522).

    The time at which the response first passes that share of its final value.

    Parameters
    ----------
    model
        The model.

    Returns
    -------
    dict
        Time [s] by name; without those that the covariance leaves undetermined.

    Raises
    ------
    InputError
        For an integrating model, which has no final value.

    Notes
    -----
    dt_q = -d(y/K)/dtheta / slope at the crossing.

    Examples
    --------
    >>> from tcdyn.identification import Identified, process
    >>> model = Identified.of(process("P1"), {"Kp": 2.0, "Tp1": 0.8}, np.diag([1e-4, 1e-4]))

    >>> {name: round(t.value, 2) for name, t in percent_times(model).items()}
    {'t50': 0.55, 't63.2': 0.8, 't90': 1.84}
    """
    if model.model.integrators:
        raise InputError(f"{model.model.name} integrates: its step response has no final value")
    t = step_time_grid(model, 4000)
    y, jacobian = step_rows(model, t)
    share = y / model.gain
    gain_gradient = model.model.chain_rule(model.theta)[0]
    share_jacobian = (jacobian - np.outer(gain_gradient, share)) / model.gain
    slope = np.gradient(share, t)
    times = {}
    for name, q in PERCENT_TIMES.items():
        i = max(int(np.argmax(share >= q)), 1)
        crossing = float(np.interp(q, share[i - 1 : i + 1], t[i - 1 : i + 1]))
        slope_there = max(float(np.interp(crossing, t, slope)), 1e-12)
        # one column, also without free parameters
        gradient = np.array([np.interp(crossing, t, row) for row in share_jacobian])[:, None]
        u = float(model.standard_uncertainty(-gradient / slope_there)[0])
        is_rounding = 0 < u < SMALLEST_REL_U * crossing  # a pole that is almost cancelled
        if u < t[-1] and not is_rounding:  # false where u is not a number
            times[name] = Estimate.normal(crossing, float(np.hypot(u, model.timing_u_s)))
    return times


@with_named_arguments
def bode_band(model: Dynamics, frequency_Hz: Array | None = None) -> BodeBand:
    """Return magnitude and phase with their bands.

    By default two decades on both sides of the slowest corner, and for a model of a record up to
    half its sampling rate.

    Parameters
    ----------
    model
        The model.
    frequency_Hz
        Frequencies (F,) [Hz].

    Returns
    -------
    BodeBand
        Magnitude and phase.

    Notes
    -----
    d(20 lg|G|) = 20/ln 10 Re(dG/G), d(phase) = Im(dG/G).

    Examples
    --------
    >>> from tcdyn.identification import Identified, process
    >>> model = Identified.of(process("P1"), {"Kp": 2.0, "Tp1": 0.8}, np.diag([1e-4, 1e-4]))

    >>> bode_band(model, np.array([1e-4])).magnitude_dB.value.round(1)
    array([6.])
    """
    g = model.rational
    if frequency_Hz is None:
        frequency_Hz = _default_frequencies(g, model.dt_s)
    f = np.asarray(frequency_Hz, dtype=float)
    value = g.frequency_response(f)
    relative = model.model.chain_rule(model.theta).T @ (g.frequency_sensitivity(f) / value)
    u_magnitude = model.standard_uncertainty(20 / np.log(10) * relative.real)
    u_phase = model.standard_uncertainty(np.degrees(relative.imag))
    return BodeBand(
        Band(f, 20 * np.log10(np.abs(value)), u_magnitude),
        Band(f, np.degrees(np.unwrap(np.angle(value))), u_phase),
    )


def _default_frequencies(g: Rational, dt_s: float) -> Array:
    """Return frequencies [Hz] around the corner of a transfer function.

    Parameters
    ----------
    g
        The transfer function.
    dt_s
        Sampling interval [s]; 0 for a model without a record.

    Returns
    -------
    array
        200 frequencies in equal ratios.
    """
    if not dt_s:
        corner = 1 / (2 * np.pi * slowest_time_constant_s(g))
        return np.geomspace(corner / 100, corner * 100, 200)
    if g.integrators:
        corner = 0.1 / dt_s
    else:
        corner = 1 / (2 * np.pi * max(g.lag_s, dt_s))
    return np.geomspace(corner / 100, min(corner * 100, 0.5 / dt_s), 200)


@dataclass(frozen=True)
class Root:
    """A pole or zero of the model.

    Parameters
    ----------
    kind
        "pole" or "zero".
    value
        The root [1/s].
    covariance
        Covariance (2, 2) of its real and imaginary part.
    """

    kind: str
    value: complex
    covariance: Array


@with_named_arguments
def roots_of(model: Dynamics) -> list[Root]:
    """Poles and zeros of the identified part with their covariances, without the known factor.

    Parameters
    ----------
    model
        The model.

    Returns
    -------
    list of Root
        The poles at zero of integrators, the zeros, then the other poles.

    Notes
    -----
    A root r of p(s) = sum c_k s^k changes by dr = -(sum r^k dc_k)/p'(r); valid for distinct roots.
    The poles at zero of an integrator are exact.

    Examples
    --------
    >>> from tcdyn.identification import Identified, process
    >>> model = Identified.of(process("P1"), {"Kp": 2.0, "Tp1": 0.8}, np.diag([1e-4, 1e-4]))

    >>> [round(-1 / root.value.real, 2) for root in roots_of(model)]
    [0.8]
    """
    m = model.model
    roots = [Root("pole", 0j, np.zeros((2, 2)))] * m.integrators
    rule = replace(m, known=KnownDynamics()).chain_rule(model.theta)
    num, factors = m.coefficients(m.all_parameters(model.theta))
    polynomials = [("zero", num), *(("pole", factor) for factor in factors)]
    row = 0
    for kind, coefficients in polynomials:
        c = np.asarray(coefficients, dtype=float)
        first = int(kind == "pole")  # the constant term of a factor is one
        n_rows = len(c) - first
        jacobian = np.zeros((len(c), rule.shape[1]))
        jacobian[first:] = rule[row : row + n_rows]
        row += n_rows
        if len(c) == 1:
            continue
        derivative = polynomial.polyder(c)
        for root in polynomial.polyroots(c):
            change = -(root ** np.arange(len(c)) @ jacobian) / polynomial.polyval(root, derivative)
            j = np.array([np.real(change), np.imag(change)])
            roots.append(Root(kind, complex(root), j @ model.covariance @ j.T))
    return roots
