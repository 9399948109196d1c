"""First- and second-order models with dead time by the half rule of Skogestad (2003).

S. Skogestad, "Simple analytic rules for model reduction and PID controller tuning", Journal of
Process Control 13 (2003) 291-309. The settings follow from the reduced model in
``tcdyn.tuning.rules``; margins and responses are always those of the full model. Tests:
``tests/tuning/test_half_rule.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isinf, sqrt

import numpy as np
from numpy.polynomial.polynomial import polyroots

from tcdyn.chain.rational import Complex, Rational
from tcdyn.core.errors import InputError

# Damping ratio below which a pair of poles amplifies at some frequency more than at zero: |G|^2 of
# 1/(1 + 2 zeta T s + T^2 s^2) has a maximum above zero frequency if zeta^2 < 1/2.
MIN_DAMPING = sqrt(0.5)
# Rules for zeros of Skogestad (2003): a zero is cancelled by the next smaller lag
# only if it is less than this much larger.
CLOSE_LAG_RATIO = 1.6
# Effective dead times from which a lag is slow: rule T2, and the bound of rule T3.
SLOW_LAG_RATIO = 5.0
MAX_ITERATIONS = 50  # of the effective dead time in the rules for zeros; a few suffice
ROUNDING = 1e-9  # relative difference of two times that counts as none
MAX_IMAGINARY_SHARE = 1e-6  # imaginary over absolute value, below which a root is real: rounding


@dataclass(frozen=True)
class ReducedModel:
    """A model of first or second order with dead time.

    Attributes
    ----------
    gain
        Static gain; of an integrating model the slope of the output, output unit per input unit and
        second.
    tau1_s
        Larger lag [s]; infinite for an integrating model.
    tau2_s
        Second lag [s]; 0 in a first-order model.
    dead_time_s
        Effective dead time [s], with half a sample of a sampled controller.
    """

    gain: float
    tau1_s: float
    tau2_s: float
    dead_time_s: float

    @property
    def is_integrating(self) -> bool:
        """Whether the model has no static gain."""
        return isinf(self.tau1_s)

    @property
    def slope(self) -> float:
        """Initial slope of the output after a unit step of the input: gain/tau1, or the gain."""
        return self.gain if self.is_integrating else self.gain / self.tau1_s


def reduce_model(g: Rational, order: int, further_dead_time_s: float = 0.0) -> ReducedModel:
    """The first- or second-order model by the half rule.

    Parameters
    ----------
    g
        The plant. Real poles and zeros enter as they are; known factors are part of it.
    order
        1 for a PI controller, 2 for a PID controller.
    further_dead_time_s
        Added to the dead time [s]: half a sample.

    Returns
    -------
    ReducedModel
        The reduced model.

    Raises
    ------
    InputError
        For a plant without a lag, with a pair of poles that oscillates, or with more slow zeros
        than lags.

    Notes
    -----
    The largest lag that is not kept is distributed evenly to the effective dead time and to the
    smallest lag that is kept; smaller lags and zeros in the right half plane go to the dead time.
    An integrator counts as the largest lag. A zero in the left half plane is cancelled with a
    neighbouring lag (rules T1 to T3). That depends on the effective dead time and is repeated from
    the dead time without zeros, until it no longer changes. Where two dead times agree with the
    rules, this finds the longer one, and so the slower loop.

    The paper does not treat complex pairs. Here a pair with damping ratio zeta and period 2 pi T
    is replaced by two real roots of time constant zeta T, which keep the first moment. A pair of
    poles with zeta below 0.71 has a resonance that the reduced model does not have; it is refused
    if T exceeds the effective dead time, where the resonance is within the bandwidth of the loop.

    Examples
    --------
    Example E1 of the paper, 1/((s + 1)(0.2 s + 1)):

    >>> from tcdyn.chain import Chain
    >>> reduced = reduce_model(Chain([1.0, 0.2]).rational, order=1)
    >>> round(reduced.tau1_s, 3), round(reduced.dead_time_s, 3)
    (1.1, 0.1)
    """
    lags, pairs = _lags(g)
    zeros = _zero_times(g)
    delay_s = g.delay_s + further_dead_time_s + sum(-t for t in zeros if t < 0)
    lags = sorted(lags, reverse=True)
    positive_zeros = sorted((t for t in zeros if t > 0), reverse=True)
    found: list[ReducedModel] = []
    dead_time_s = _keep(1.0, lags, delay_s, order, g.integrators).dead_time_s
    for _ in range(MAX_ITERATIONS):
        ratio, left = _cancel_zeros(lags, positive_zeros, dead_time_s)
        reduced = _keep(float(g.num[0]) * ratio, left, delay_s, order, g.integrators)
        is_repeated = bool(found) and np.isclose(reduced.dead_time_s, dead_time_s, rtol=1e-9)
        found.append(reduced)
        if is_repeated or not positive_zeros:
            break
        dead_time_s = reduced.dead_time_s
    else:  # two rules take turns: the longer dead time is the more careful choice
        reduced = max(found[-2:], key=lambda each: each.dead_time_s)
    for damping, period_s in pairs:
        if damping < MIN_DAMPING and period_s > reduced.dead_time_s:
            raise InputError(
                f"the model oscillates (damping ratio {damping:.2g}, period "
                f"{2 * np.pi * period_s:.3g} s): the rule simc is for plants whose lags are real",
                remedy="use {rule}, which uses the complete model",
                parameters={"rule": "robust"},
            )
    if reduced.tau1_s == 0:
        raise InputError(
            "the model has no lag: the rule simc needs one",
            remedy="use {rule}",
            parameters={"rule": "robust"},
        )
    return reduced


def _lags(g: Rational) -> tuple[list[float], list[tuple[float, float]]]:
    """Lags of the plant [s], and its complex pairs, as of :func:`_time_constants`."""
    lags = [float(f.coefs[1]) for f in g.factors if len(f.coefs) == 2]
    roots = [complex(-pole) for f in g.factors if len(f.coefs) > 2 for pole in f.poles]
    more, pairs = _time_constants(roots)
    return [*lags, *more], pairs


def _time_constants(roots: Sequence[complex]) -> tuple[list[float], list[tuple[float, float]]]:
    """Time constants of factors (s + r), and the complex pairs among them.

    Parameters
    ----------
    roots
        The numbers r [1/s], not zero.

    Returns
    -------
    times_s
        Time constant of each root [s]; that of a complex one is zeta T.
    pairs
        Damping ratio and T [s] of each complex pair.
    """
    times_s = []
    pairs = []
    for root in roots:
        is_real = abs(root.imag) < MAX_IMAGINARY_SHARE * abs(root)
        times_s.append(1 / root.real if is_real else root.real / abs(root) ** 2)
        if not is_real and root.imag > 0:
            pairs.append((root.real / abs(root), 1 / abs(root)))
    return times_s, pairs


def _zero_times(g: Rational) -> list[float]:
    """Time constants of the numerator [s]; negative ones of zeros in the right half plane."""
    num = np.trim_zeros(np.asarray(g.num, dtype=float), "b")
    if len(num) < 2:
        return []
    roots: Complex = np.asarray(-polyroots(num), dtype=complex)
    return _time_constants(roots.tolist())[0]


def _keep(
    gain: float, lags: Sequence[float], delay_s: float, order: int, integrators: int
) -> ReducedModel:
    """Apply the half rule.

    Parameters
    ----------
    gain
        Gain.
    lags
        Lags [s], the largest first, without the integrator.
    delay_s
        Dead time, with that of zeros [s].
    order
        Number of lags that are kept.
    integrators
        1 if the model integrates; the integrator is the first of the lags.
    """
    ordered = [*[inf] * integrators, *sorted(lags, reverse=True), 0.0, 0.0, 0.0]
    kept = ordered[:order]
    half_s = ordered[order] / 2
    kept[-1] += half_s
    kept.sort(reverse=True)
    dead_time_s = delay_s + half_s + sum(ordered[order + 1 :])
    return ReducedModel(gain, kept[0], kept[1] if order == 2 else 0.0, dead_time_s)


def _cancel_zeros(
    lags: Sequence[float], zeros: Sequence[float], dead_time_s: float
) -> tuple[float, list[float]]:
    """Cancel zeros in the left half plane with lags (rules T1 to T3).

    Parameters
    ----------
    lags, zeros
        Time constants [s], the largest first.
    dead_time_s
        Effective dead time [s].

    Returns
    -------
    ratio
        Factor of the gain.
    lags
        The lags that are left [s].

    Raises
    ------
    InputError
        For a zero without a lag.
    """
    left = list(lags)
    ratio = 1.0
    for zero in zeros:
        larger = min((lag for lag in left if lag >= zero), default=None)
        smaller = max((lag for lag in left if lag < zero), default=None)
        if larger is None and smaller is None:
            raise InputError(
                "the model has as many slow zeros as lags: the rule simc has no settings for it",
                remedy="use {rule}",
                parameters={"rule": "robust"},
            )
        takes_smaller = larger is None
        if larger is not None and smaller is not None:
            is_close = zero / smaller < CLOSE_LAG_RATIO * (1 - ROUNDING)
            takes_smaller = is_close and zero / smaller < larger / zero
        if takes_smaller and smaller is not None:
            left.remove(smaller)
            ratio *= max(zero, dead_time_s) / max(smaller, dead_time_s)  # T1, T1a, T1b
            continue
        assert larger is not None
        left.remove(larger)
        if zero >= SLOW_LAG_RATIO * dead_time_s:  # T2
            ratio *= zero / larger
            continue
        bounded_s = min(larger, SLOW_LAG_RATIO * dead_time_s)  # T3
        ratio *= bounded_s / larger
        if bounded_s > zero:
            left.append(bounded_s - zero)
    return ratio, left
