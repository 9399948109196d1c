"""Margins and stability of loops from their exact frequency responses.

Dead times are exact: nothing is replaced by a rational function. ``tcdyn.tuning.tune`` evaluates
the plant and its draws at once. Tests: ``tests/tuning/test_loop_margins.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tcdyn.chain.rational import Complex, Rational
from tcdyn.core import Array, Flags
from tcdyn.tuning.forms import Controller
from tcdyn.tuning.steps import plant_steps

# Grid of frequencies: points of a decade, 1 % apart, so that the phase of a dead time changes by
# less than a third of a radian up to 30 rad; and decades on both sides of the crossover frequency.
# A draw whose dead time is a hundred times that of the model still has 1.5 decades above its
# crossover.
POINTS_A_DECADE = 230
DECADES = 3.5


@dataclass(frozen=True)
class Margins:
    """Margins of loops, one element for each loop (D,).

    Attributes
    ----------
    gain_margin
        Factor of the gain at which the loop becomes unstable; infinite where none does. Below one
        for a loop that is unstable.
    phase_margin_deg
        Phase margin [deg]; negative for a loop that is unstable.
    ms
        Largest sensitivity, max |1/(1 + L)|; infinite for a loop that is unstable.
    mt
        Largest complementary sensitivity, max |L/(1 + L)|; infinite for a loop that is unstable.
    is_stable
        Whether the loop is stable.
    """

    gain_margin: Array
    phase_margin_deg: Array
    ms: Array
    mt: Array
    is_stable: Flags


def plant_responses(plants: Sequence[Rational], omega: Array, sample_s: float = 0.0) -> Complex:
    """Frequency responses (D, W) of plants.

    Parameters
    ----------
    plants
        The plants (D,).
    omega
        Angular frequencies (W,) [rad/s].
    sample_s
        Sampling interval [s] of the controller, whose output is held and which sees samples of the
        plant's output; 0: continuous.
    """
    if sample_s:
        return plant_steps(plants, sample_s).pulse_responses(omega * sample_s)
    frequency_Hz = omega / (2 * np.pi)
    return np.array([plant.frequency_response(frequency_Hz) for plant in plants])


def frequency_grid(centre_rad_s: float, sample_s: float = 0.0) -> Array:
    """Angular frequencies [rad/s] around a crossover frequency.

    Parameters
    ----------
    centre_rad_s
        The crossover frequency [rad/s].
    sample_s
        Sampling interval of the controller [s]; the grid ends at its Nyquist frequency.
    """
    count = int(2 * DECADES * POINTS_A_DECADE) + 1
    omega = centre_rad_s * np.logspace(-DECADES, DECADES, count)
    if sample_s:
        nyquist = np.pi / sample_s
        omega = np.append(omega[omega < 0.999 * nyquist], 0.999 * nyquist)
    return omega


def crossover_rad_s(plant: Rational, controller: Controller) -> float:
    """Largest angular frequency at which the gain of the loop is one [rad/s].

    Parameters
    ----------
    plant, controller
        The loop.

    Notes
    -----
    The search covers twelve decades around the inverse of the plant's times.
    """
    times = plant.delay_s + sum(abs(f.coefs[1]) for f in plant.factors)
    start = 1 / times if times else abs(controller.ki * float(plant.num[0]))
    omega = start * np.logspace(-6, 6, 12 * 100 + 1)
    continuous = controller.sampled(0.0)
    gain = np.abs(plant_responses([plant], omega)[0] * continuous.frequency_response(omega))
    above = np.flatnonzero(gain >= 1)
    return float(omega[above[-1]]) if len(above) else float(start)


def loop_margins(
    plants: Sequence[Rational], controller: Controller, omega: Array | None = None
) -> Margins:
    """Margins of a controller with each of several plants.

    Parameters
    ----------
    plants
        The plants (D,), stable but for one integrator; all integrate, or none.
    controller
        The controller, with integral action.
    omega
        Angular frequencies (W,) [rad/s]; by default those around the crossover of the first plant.

    Returns
    -------
    Margins
        The margins (D,).

    Examples
    --------
    The PI settings of the SIMC rule for a lag with dead time, Skogestad (2003), table 3:

    >>> from tcdyn.chain import Chain
    >>> plant = Chain([8.0], delay_s=1.0).rational
    >>> margins = loop_margins([plant], Controller.from_ideal(4.0, 8.0))
    >>> margins.gain_margin.round(2), margins.phase_margin_deg.round(1), margins.ms.round(2)
    (array([3.14]), array([61.4]), array([1.59]))
    """
    if omega is None:
        omega = frequency_grid(crossover_rad_s(plants[0], controller), controller.sample_s)
    response = plant_responses(plants, omega, controller.sample_s)
    loop = response * controller.frequency_response(omega)
    return margins_of(loop, 1 + plants[0].integrators, controller.sample_s > 0)


def margins_of(loop: Complex, integrators: int, is_sampled: bool = False) -> Margins:
    """Margins from frequency responses of open loops.

    Parameters
    ----------
    loop
        Responses (D, W) at rising frequencies.
    integrators
        Poles of the open loop at zero; its other poles are stable.
    is_sampled
        Whether the grid ends at the Nyquist frequency.
    """
    is_stable = count_unstable_poles(loop, integrators, is_sampled) == 0
    distance = np.abs(1 + loop)
    with np.errstate(divide="ignore"):
        ms = np.where(is_stable, np.max(1 / distance, axis=1), np.inf)
        mt = np.where(is_stable, np.max(np.abs(loop) / distance, axis=1), np.inf)
    return Margins(
        _gain_margins(loop, is_stable, is_sampled),
        _phase_margins_deg(loop, is_stable),
        ms,
        mt,
        is_stable,
    )


def count_unstable_poles(loop: Complex, integrators: int, is_sampled: bool = False) -> Array:
    """Number of unstable poles of each closed loop (D,), by the argument principle.

    Parameters
    ----------
    loop
        Responses (D, W) of open loops whose poles are stable but for those at zero.
    integrators
        Number of poles of the open loop at zero.
    is_sampled
        Whether the grid ends at the Nyquist frequency.

    Notes
    -----
    The argument of F = 1 + L changes by (m/2 - n) pi from frequency zero to infinity, with m poles
    of L at zero and n unstable poles of the closed loop: each stable pole of the closed loop turns
    the numerator by pi/2, each unstable one by -pi/2, and the poles of L at zero do not turn the
    denominator. The path is closed at F = 1, where L has vanished. A loop whose gain is one or
    more at the end of the grid counts as unstable: any further dead time, however small, would make
    it so. The same change holds of sampled loops up to the Nyquist frequency, where each stable
    pole turns numerator or denominator by pi.
    """
    f = 1 + loop
    if not is_sampled:
        f = np.concatenate([f, np.ones((len(f), 1))], axis=1)
    turned = np.sum(np.angle(f[:, 1:] / f[:, :-1]), axis=1)
    count = np.round(integrators / 2 - turned / np.pi)
    if is_sampled:
        return np.asarray(count)
    return np.where(np.abs(loop[:, -1]) >= 1, np.maximum(count, 1), count)


def _gain_margins(loop: Complex, is_stable: Flags, is_sampled: bool) -> Array:
    """Gain margins (D,), from the crossings of the negative real axis.

    Parameters
    ----------
    loop
        Responses (D, W).
    is_stable
        Whether each closed loop is stable (D,); of others, all crossings count.
    is_sampled
        Whether the grid ends at the Nyquist frequency, where the response of a sampled loop is
        real: a crossing of the negative axis if it is negative.
    """
    if is_sampled:
        loop = np.concatenate([loop, loop[:, -1:].real], axis=1)
    before = loop[:, :-1]
    after = loop[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = before.imag / (before.imag - after.imag)
        real = before.real + share * (after.real - before.real)
    is_crossing = (before.imag * after.imag <= 0) & (real < 0) & (before.imag != after.imag)
    counts = is_crossing & ((real > -1) | ~is_stable[:, None])
    largest = np.max(np.where(counts, -real, 0.0), axis=1)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / largest)


def _phase_margins_deg(loop: Complex, is_stable: Flags) -> Array:
    """Phase margins (D,) [deg], from the crossings of the unit circle.

    Parameters
    ----------
    loop
        Responses (D, W).
    is_stable
        Whether each closed loop is stable (D,).
    """
    level = np.log(np.abs(loop))
    before = level[:, :-1]
    after = level[:, 1:]
    is_crossing = (before * after <= 0) & (before != after)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(is_crossing, before / (before - after), 0.0)
    turn = np.angle(loop[:, 1:] / loop[:, :-1])
    above = np.angle(-loop[:, :-1]) + share * turn  # angle from the point -1
    above = np.abs((above + np.pi) % (2 * np.pi) - np.pi)
    margin = np.min(np.where(is_crossing, above, np.inf), axis=1)
    return np.degrees(np.where(is_stable, margin, -margin))
