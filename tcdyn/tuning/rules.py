"""Settings of a PI or PID controller by the SIMC rule, and by a limit of the sensitivity.

``tcdyn.tuning.tune`` calls both. Tests: ``tests/tuning/test_tuning_rules.py``.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from tcdyn.chain.rational import Complex, Rational
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.tuning.forms import Controller
from tcdyn.tuning.margins import count_unstable_poles, frequency_grid, plant_responses
from tcdyn.tuning.reduction import ReducedModel

# Integral time over tau_c + dead time, above which SIMC bounds it: a damping ratio of 1 of the slow
# oscillation of an integrating plant (Skogestad 2003).
INTEGRAL_RATIO = 4.0
# Grids of the search for the robust settings: times over the sum of lags and dead time. Integrating
# plants need the longest integral times: SIMC has 8 effective dead times.
SHORTEST, LONGEST = 1e-2, 1e2
N_TIMES = 33  # of the grid, from which a simplex search starts: eight a decade
# Largest candidates of the gain whose stability is checked; only a conditionally stable loop has
# more than two.
MAX_CANDIDATES = 8
# Ratio of two gains that are neighbours on the grid of frequencies, below which the range between
# them is no gap but the spacing of the grid.
GAP_RATIO = 1.02


def simc(reduced: ReducedModel, tau_c_s: float, filter_ratio: float) -> Controller:
    """Settings by the SIMC rule, PI for a first-order and PID for a second-order model.

    Parameters
    ----------
    reduced
        The reduced model.
    tau_c_s
        Time constant of the closed loop [s].
    filter_ratio
        N: derivative time over the time constant of its filter.

    Notes
    -----
    Series form: Kc = 1/(k' (tau_c + theta)), Ti = min(tau1, 4 (tau_c + theta)), Td = tau2, with
    the slope k' = k/tau1 (Skogestad 2003, equations 23 to 25).

    Examples
    --------
    >>> simc(ReducedModel(2.0, 8.0, 0.0, 1.0), tau_c_s=1.0, filter_ratio=10.0).ideal
    Form(gain=2.0, integral_s=8.0, derivative_s=0.0)
    """
    horizon_s = tau_c_s + reduced.dead_time_s
    gain = 1 / (reduced.slope * horizon_s)
    integral_s = min(reduced.tau1_s, INTEGRAL_RATIO * horizon_s)
    derivative_s = reduced.tau2_s
    return Controller.from_series(gain, integral_s, derivative_s, derivative_s / filter_ratio)


def robust(
    plant: Rational,
    has_derivative: bool,
    max_ms: float,
    filter_ratio: float,
    sample_s: float = 0.0,
) -> Controller:
    """Settings with the largest integral gain for which the sensitivity stays below a limit.

    Parameters
    ----------
    plant
        The complete model.
    has_derivative
        Whether the controller has a derivative.
    max_ms
        Limit of the largest sensitivity Ms.
    filter_ratio
        N: derivative time over the time constant of its filter.
    sample_s
        Sampling interval of the controller [s]; 0 for a continuous one.

    Returns
    -------
    Controller
        The settings.

    Raises
    ------
    InputError
        For a plant that permits any gain, and where no gain satisfies the limit.

    Notes
    -----
    The integral of the error after a step of the load is 1/Ki, so that the largest Ki rejects a
    load best for a response that does not oscillate (Åström, Panagopoulos and Hägglund, Automatica
    34 (1998) 585-601; Panagopoulos, Åström and Hägglund, IEE Proceedings 149 (2002) 32-40). The
    largest gain for given times has a closed form (:func:`largest_gain`); the times are searched.
    The zeros of the PID controller are real (Ti >= 4 Td in the ideal form): without this constraint
    the optimum has complex zeros and a response that oscillates (Åström and Hägglund, Advanced PID
    Control, ISA 2006).
    """
    times_s = plant.delay_s + sum(abs(f.coefs[1]) for f in plant.factors) + sample_s / 2
    if not times_s:
        raise _any_gain_error()
    omega = frequency_grid(1 / times_s, sample_s)
    response = plant_responses([plant], omega, sample_s)[0] * np.sign(plant.num[0])

    def settings(logs: Array) -> tuple[float, float, float]:
        """Largest gain, and the times [s], at logarithms of times over ``times_s``."""
        integral_s = times_s * float(np.exp(logs[0]))
        derivative_s = 0.0
        if has_derivative:
            derivative_s = min(times_s * float(np.exp(logs[1])), integral_s)
        shape = Controller.from_series(1.0, integral_s, derivative_s, derivative_s / filter_ratio)
        shape = shape.sampled(sample_s)
        loop = response * shape.frequency_response(omega)
        gain = largest_gain(loop, max_ms, 1 + plant.integrators, sample_s > 0)
        return gain, integral_s, derivative_s

    def cost(logs: Array) -> float:
        """Minus the logarithm of the integral gain times the sum of lags and dead time."""
        gain, integral_s, _ = settings(logs)
        return float(-np.log(max(gain, 1e-300) * times_s / integral_s))

    grid = np.linspace(np.log(SHORTEST), np.log(LONGEST), N_TIMES)
    if has_derivative:
        starts = [np.array([a, b]) for a in grid[::2] for b in grid[::2] if b <= a]
    else:
        starts = [np.array([a]) for a in grid]
    best = min(starts, key=cost)
    found = minimize(cost, best, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6})
    gain, integral_s, derivative_s = settings(found.x)
    if gain <= 0:
        raise InputError(
            f"no setting keeps the sensitivity below {{max_ms}} = {max_ms:g}",
            remedy="allow a larger {max_ms}",
            parameters={"max_ms": None},
        )
    sign = float(np.sign(plant.num[0]))
    filter_s = derivative_s / filter_ratio
    found_settings = Controller.from_series(sign * gain, integral_s, derivative_s, filter_s)
    return found_settings.sampled(sample_s)


def largest_gain(loop: Complex, max_ms: float, integrators: int, is_sampled: bool = False) -> float:
    """The largest factor K of a loop with max |1/(1 + K L)| <= Ms that leaves it stable.

    Parameters
    ----------
    loop
        Response L of the open loop of unit gain (W,).
    max_ms
        Ms.
    integrators
        Number of its poles at zero.
    is_sampled
        Whether its frequencies end at the Nyquist frequency.

    Returns
    -------
    gain
        K; 0 where none is allowed.

    Raises
    ------
    InputError
        Where every gain satisfies the limit.

    Notes
    -----
    |1 + K L| >= 1/Ms fails between the roots of |L|^2 K^2 + 2 Re(L) K + 1 - 1/Ms^2. The gains that
    are left lie between the intervals of all frequencies; the largest stable one is returned.

    Examples
    --------
    A pure delay under integral control has |1 + K L|^2 = 1 - 2 (K/w) sin w + (K/w)^2.

    >>> omega = np.geomspace(1e-3, 1e2, 2000)
    >>> round(largest_gain(np.exp(-1j * omega) / (1j * omega), 1.4, 1), 3)
    0.373
    """
    square = np.abs(loop) ** 2
    half = loop.real
    discriminant = half**2 - square * (1 - 1 / max_ms**2)
    is_bounded = (discriminant >= 0) & (half < 0)
    if not is_bounded.any():
        raise _any_gain_error()
    root = np.sqrt(discriminant[is_bounded])
    low = (-half[is_bounded] - root) / square[is_bounded]
    high = (-half[is_bounded] + root) / square[is_bounded]
    order = np.argsort(low)
    low = low[order]
    covered = np.maximum.accumulate(high[order])
    is_end = np.append(True, low[1:] > GAP_RATIO * covered[:-1])
    for gain in low[is_end][::-1][:MAX_CANDIDATES]:
        if count_unstable_poles(gain * loop[None, :], integrators, is_sampled)[0] == 0:
            return float(gain)
    return 0.0


def _any_gain_error() -> InputError:
    """Error for a plant that no gain makes unstable."""
    return InputError(
        "the model has no dead time, and any gain satisfies the limit of the sensitivity",
        expected="a model with a dead time, or a sampled controller",
        remedy="give {sample_s}, or {rule} with {tau_c_s}",
        parameters={"sample_s": None, "rule": "simc", "tau_c_s": None},
    )
