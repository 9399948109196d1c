"""Inputs of identification tests: steps, and pseudo-random binary sequences for a range of lags.

``tests/identify/test_identify_interop.py`` checks their spectrum and what a fit to them gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.signal import max_len_seq

from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError

SETTLING_LAGS = 5.0  # lags for which a level is held; a first-order lag then is within 0.7 %
# Highest frequency of interest over 1/(shortest lag), and time of interest over the longest lag
# (95 % of its step response): Rivera and Jun, IEEE Control Systems Magazine 20(3) (2000), 25-37.
SPEED_FACTOR = 2.0
SETTLING_FACTOR = 3.0
# Frequency times clock interval at which a held sequence has half of its power: sinc^2 = 1/2
# (Godfrey, Perturbation Signals for System Identification, 1993).
HALF_POWER = 0.443


@with_named_arguments
def step_input(
    lag_s: float, dt_s: float, levels: Sequence[float], settling_lags: float = SETTLING_LAGS
) -> pd.DataFrame:
    """Staircase of levels, each held until the output has settled.

    Parameters
    ----------
    lag_s
        Expected lag, dead time included [s].
    dt_s
        Sampling interval [s].
    levels
        Levels of the input; the first is the level before the test.
    settling_lags
        Time for which each level is held, in lags.

    Returns
    -------
    DataFrame
        Columns time_s and u.

    Raises
    ------
    InputError
        For fewer than two levels, or times that are not above zero.

    Notes
    -----
    Up and down, at several levels, shows whether gain and lag depend on level and direction.

    Examples
    --------
    >>> table = step_input(lag_s=2.0, dt_s=0.5, levels=[20, 80, 20])
    >>> len(table), table["time_s"].iloc[-1]
    (60, np.float64(29.5))
    """
    _check_experiment(lag_s, dt_s, levels)
    count = int(np.ceil(settling_lags * lag_s / dt_s))
    return _input_table(np.repeat(np.asarray(levels, dtype=float), count), dt_s)


@with_named_arguments
def prbs_input(
    lag_s: tuple[float, float], dt_s: float, levels: tuple[float, float], periods: int = 1
) -> pd.DataFrame:
    """Pseudo-random binary sequence that excites a range of lags evenly.

    Parameters
    ----------
    lag_s
        Shortest and longest expected lag [s].
    dt_s
        Sampling interval [s].
    levels
        The two levels of the input.
    periods
        Number of periods.

    Returns
    -------
    DataFrame
        Columns time_s and u.

    Raises
    ------
    InputError
        For levels or times that are not usable, or a sampling interval that is too long for the
        shortest lag.

    Notes
    -----
    The clock interval T is the longest whose power at ``SPEED_FACTOR``/(shortest lag) is at least
    half of that at low frequency, T = 2 pi 0.443 lag/``SPEED_FACTOR``. The length of a period is
    the shortest of 2^k - 1 intervals that holds 2 pi ``SETTLING_FACTOR`` longest lags. Sources: see
    the constants; Ljung, System Identification, 2nd ed. (1999), 13.3.

    Examples
    --------
    >>> table = prbs_input(lag_s=(1.0, 5.0), dt_s=0.1, levels=(20.0, 80.0))
    >>> len(table), sorted(set(table["u"]))
    (1651, [20.0, 80.0])
    """
    shortest_s, longest_s = lag_s
    _check_experiment(shortest_s, dt_s, levels)
    clock = int(2 * np.pi * HALF_POWER * shortest_s / SPEED_FACTOR / dt_s)
    if clock < 1 or longest_s < shortest_s or len(levels) != 2 or periods < 1:
        raise InputError(
            f"prbs_input: lags {lag_s}, dt_s {dt_s}, levels {levels}, periods {periods}",
            expected="a sampling interval below 1.4 times the shortest lag, the longest lag last, "
            "two levels and at least one period",
        )
    needed = 2 * np.pi * SETTLING_FACTOR * longest_s / (clock * dt_s)
    bits = max(int(np.ceil(np.log2(needed + 1))), 2)
    is_high = np.tile(max_len_seq(bits)[0], periods)
    return _input_table(np.repeat(np.where(is_high, levels[1], levels[0]), clock), dt_s)


def _check_experiment(lag_s: float, dt_s: float, levels: Sequence[float]) -> None:
    """Check that lag and interval are above zero, and that the levels differ."""
    if not (lag_s > 0 and dt_s > 0 and len(set(levels)) > 1):
        raise InputError(
            f"lag_s {lag_s}, dt_s {dt_s}, levels {levels}",
            expected="times above zero, and at least two different levels",
        )


def _input_table(u: Array, dt_s: float) -> pd.DataFrame:
    """Return the input (N,) with its times."""
    return pd.DataFrame({"time_s": np.arange(len(u)) * dt_s, "u": u})
