"""Hold of the inputs: held between samples (zoh) or a straight line (foh), as stated or selected.

``tcdyn.identification.iodata`` and ``recordings`` use it.
``tests/identify/test_identify_choose.py`` checks the selection.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation.trace_noise import MAD_TO_SD

Hold = Literal["zoh", "foh"]  # the input between samples: held, or a straight line
Holds = Hold | tuple[Hold, ...]  # one hold for all inputs, or one for each

# Findings of the selection.
HOLD_CODES = ("record.hold", "record.noisy_levels")

# Thresholds, chosen by judgement.
# Share of samples that equal the one before, above which the input was set by a computer and not
# measured.
MIN_REPEATED_SHARE = 0.4
# Changes that are one step, and ranges that are at most two steps, over the least step; halfway.
ONE_STEP = 1.5
TWO_STEPS = 2.5
# Change of an input that a computer has set, over its range; rounding makes smaller steps.
MIN_JUMP_SHARE = 0.05
# Share of the changes of a staircase before and after which it stays constant.
MIN_ISOLATED_SHARE = 0.95
# Changes of an input with noise that are jumps, in standard deviations of the noise; the largest
# share of rows with one; scatter of a level over that of white noise.
JUMP_NOISES = 8.0
MAX_JUMP_SHARE = 0.25
MAX_SCATTER_RATIO = 1.3


def select_holds(
    hold: Holds | Literal["auto"], names: Sequence[str], inputs: Array, dt_s: float
) -> tuple[Holds, list[Finding]]:
    """Return the hold of each input; where it is to be selected, from the samples.

    Parameters
    ----------
    hold
        "zoh", "foh", one of them for each input, or "auto".
    names
        Names of the inputs (K,).
    inputs
        Their samples (N, K).
    dt_s
        Sampling interval [s].

    Returns
    -------
    holds
        ``hold``, or "zoh" for each input that was set by a computer, else "foh".
    findings
        One for each input that does not determine it.
    """
    if not (isinstance(hold, str) and hold == "auto"):
        return hold, []
    holds: list[Hold] = []
    findings = []
    for name, values in zip(names, inputs.T):
        is_set, step = is_setpoint(values)
        has_noisy_levels = not is_set and has_levels(values)
        selected: Hold = "zoh" if is_set or has_noisy_levels else "foh"
        holds.append(selected)
        if has_noisy_levels:
            findings.append(warning("record.noisy_levels", subject=name, dt_s=dt_s))
            continue
        if step:
            finding = info if is_set else warning
            findings.append(
                finding("record.hold", subject=name, step=step, hold=selected, half_s=dt_s / 2)
            )
    return tuple(holds), findings


def timing_u_s(hold: Holds | Literal["auto"], dt_s: float) -> float:
    """Standard uncertainty of the time of the output against the inputs [s].

    Parameters
    ----------
    hold
        The hold as the user has stated it, or "auto".
    dt_s
        Sampling interval [s].

    Returns
    -------
    float
        That of a uniform distribution over half a row on either side, dt / sqrt(12) (JCGM
        100:2008, 4.3.7): a logger may average over a row, read its channels one after the other,
        or write an input that was set within the row. Zero for a stated hold.

    Examples
    --------
    >>> round(timing_u_s("auto", 1.0), 4), timing_u_s("zoh", 1.0)
    (0.2887, 0.0)
    """
    return float(dt_s / np.sqrt(12)) if hold == "auto" else 0.0


def is_setpoint(u: Array) -> tuple[bool, float]:
    """Whether a computer has set the input ``u`` (N,).

    Parameters
    ----------
    u
        The input (N,), NaN is left out.

    Returns
    -------
    tuple
        Whether it was set, and its least step where this cannot be distinguished from a measured
        input that is rounded to that step, else 0.

    Notes
    -----
    An input that was set mostly stays constant, and changes by a twentieth of its range or more,
    or between two samples that stay. An input that is measured in steps changes, when it is slow,
    by one step at a time. So does a staircase of equal steps, which counts as set where a step is a
    twentieth of the range or more.

    ``MIN_JUMP_SHARE`` and ``MIN_ISOLATED_SHARE`` separate coarse readings from set points; a wrong
    hold shifts the dead time by half a sample. ``tests/identify/test_identify_choose.py`` checks
    small steps and rounding.
    """
    u = u[np.isfinite(u)]
    change = np.abs(np.diff(u))
    index = np.flatnonzero(change)
    if not 0 < len(index) < (1 - MIN_REPEATED_SHARE) * len(change):
        return False, 0.0
    changes = change[index]
    stays = np.concatenate([[True], change == 0, [True]])
    step = float(changes.min())
    isolated = float(np.mean(stays[index] & stays[index + 2]))
    is_large = bool(np.median(changes) > MIN_JUMP_SHARE * np.ptp(u))
    mostly_one_step = np.mean(changes < ONE_STEP * step) > 0.5
    if np.ptp(u) < TWO_STEPS * step or not mostly_one_step:
        return is_large or isolated > 0.5, 0.0
    is_isolated = isolated > MIN_ISOLATED_SHARE
    return is_large and is_isolated, step if is_large or is_isolated else 0.0


def has_levels(u: Array) -> bool:
    """Whether ``u`` (N,) has constant levels with white noise, and jumps from row to row.

    So does the measured power of a heater that a computer sets. NaN is left out.

    Notes
    -----
    Jumps exceed the noise by ``JUMP_NOISES`` and a twentieth of the range. Nearly all must be
    isolated, and between them the scatter must be that of white noise with such changes.
    """
    u = u[np.isfinite(u)]
    if len(u) < 2:
        return False
    change = np.diff(u)
    noise = MAD_TO_SD * float(np.median(np.abs(change))) / np.sqrt(2)
    limit = max(JUMP_NOISES * noise, MIN_JUMP_SHARE * float(np.ptp(u)))
    is_jump = np.abs(change) > limit
    count = int(np.count_nonzero(is_jump))
    if noise == 0.0 or not 0 < count < MAX_JUMP_SHARE * len(change):
        return False
    jumps = np.flatnonzero(is_jump)
    isolated = np.mean(np.diff(jumps) > 1) if count > 1 else 1.0
    levels = np.split(u, jumps + 1)
    squares = sum(float(np.sum((level - level.mean()) ** 2)) for level in levels)
    scatter = np.sqrt(squares / max(len(u) - len(levels), 1))
    return bool(isolated > MIN_ISOLATED_SHARE and scatter < MAX_SCATTER_RATIO * noise)


def check_hold(hold: Hold | Sequence[Hold], n_inputs: int, where: str) -> Holds:
    """Return the hold after a check: one where all inputs have the same, else one for each.

    Raises
    ------
    InputError
        Where one is neither "zoh" nor "foh", or there is another number of them than of inputs.
    """
    holds = (hold,) * n_inputs if isinstance(hold, str) else tuple(hold)
    if not set(holds) <= {"zoh", "foh"}:
        expected = "'zoh' (input held between samples) or 'foh' (straight line)"
        raise InputError(f"hold is {hold!r}", where=where, expected=expected)
    if len(holds) != n_inputs:
        raise InputError(
            f"hold has {len(holds)} values",
            where=where,
            expected=f"one for all inputs, or one for each of {n_inputs}",
        )
    return holds[0] if len(set(holds)) == 1 else holds


def hold_of_each(hold: Holds, n_inputs: int) -> tuple[Hold, ...]:
    """Return the hold of each input."""
    return hold if isinstance(hold, tuple) else (hold,) * n_inputs


def hold_text(hold: Holds) -> str:
    """Return the hold in capitals, or those of the inputs.

    >>> hold_text("zoh"), hold_text(("zoh", "foh"))
    ('ZOH', 'ZOH, FOH')
    """
    return ", ".join(hold_of_each(hold, 1)).upper()
