"""When the heat ended: the fall of friction and load at the parting, to better than a sample."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning

AGREE_S = 0.1
MAX_GAP = 3.5  # sampling intervals: a wider gap at the fall leaves its instant open
NEAR_S = 1.0  # from the switch: nearer than this the force's fall is looked for about the switch
STEP_REACH_S = 60.0  # as far from the switch as the force's step is looked for
INDICATOR_U_S = 0.05 / 12**0.5  # section 5.3: the signals differ by 0.05 s
NO_SWITCH_U_S = (
    0.05 / 3**0.5
)  # of a force alone, which may be that far from the switch on either side
SIGNAL_NAMES = {"friction_N": "friction", "load_N": "load cell"}


def unloading_instant(
    t: Array, frame: pd.DataFrame, switch_s: float | None, about_s: float, contact_s: float
) -> tuple[float, float, float, list[Finding]]:
    """Instant of parting, its standard uncertainty, the friction's 90-10 % time, and what was noticed.

    Contact switch, friction and load cell each miss the instant by up to 0.05 s (section 5.3); those that agree are
    averaged. A switch that differs from the friction by more is not believed: the friction is the heat. A friction too
    noisy to show its fall leaves the word to the load cell. ``contact_s``: when the contact
    began; ``about_s``: where the three together see it end.
    """
    dt = float(np.median(np.diff(t)))
    indicator_u_s = NO_SWITCH_U_S if switch_s is None else INDICATOR_U_S
    falls = {
        c: _far_fall(t, frame[c].to_numpy(dtype=float), about_s, contact_s)
        for c in SIGNAL_NAMES
        if c in frame
    }
    named = [(SIGNAL_NAMES[c], fall) for c, fall in falls.items() if fall is not None]
    if not named and switch_s is None:
        return about_s, AGREE_S, 0.0, [warning("parting.unclear")]
    if not named and switch_s is not None:
        return switch_s, indicator_u_s, 0.0, [warning("parting.switch_alone")]
    said: list[Finding] = []
    if falls.get("friction_N") is None:
        said.append(warning("parting.no_friction"))
    (witness, (at, parting)), *others = named
    instants_of_others = ([] if switch_s is None else [switch_s]) + [fall[0] for _, fall in others]
    near = [x for x in instants_of_others if abs(x - at) <= max(AGREE_S, 0.5 * parting)]
    if switch_s is not None and switch_s not in near:
        said.append(warning("parting.disagree", subject=witness, late_s=at - switch_s))
    if (
        parting > AGREE_S
    ):  # a slow fall: switch and load cell do not say when the heat was half gone
        return at, float(np.hypot(indicator_u_s, 0.05 * parting)), parting, said
    instants = [at, *near]
    spread = max(indicator_u_s, float(np.std(instants)))
    return (
        float(np.mean(instants)),
        float(np.hypot(spread, dt / np.sqrt(12)) / np.sqrt(len(instants))),
        parting,
        said,
    )


def _far_fall(
    t: Array, force: Array, switch_s: float, contact_s: float
) -> tuple[float, float] | None:
    """``_fall`` about the switch, or about the force's own step where that lies too far from the switch."""
    step = _step(t, force, max(switch_s - STEP_REACH_S, contact_s), switch_s + STEP_REACH_S)
    if (
        step is not None
        and abs(step - switch_s) > NEAR_S
        and (far := _fall(t, force, step)) is not None
    ):
        return far
    return _fall(t, force, switch_s)


def _step(t: Array, force: Array, start_s: float, stop_s: float) -> float | None:
    """Where the force steps down in (start, stop): the cut whose two levels explain most, or None if it never falls."""
    rows = np.flatnonzero((t > start_s) & (t < stop_s) & np.isfinite(force))
    if len(rows) < 20:
        return None
    x = force[rows]
    before = np.arange(1, len(x))
    sums = np.cumsum(x)[:-1]
    fall = sums / before - (x.sum() - sums) / (len(x) - before)
    explained = np.where(fall > 0, before * (len(x) - before) * fall**2, 0.0)
    cut = int(np.argmax(explained))
    return 0.5 * float(t[rows[cut]] + t[rows[cut + 1]]) if explained[cut] > 0 else None


def _fall(t: Array, friction: Array, about_s: float) -> tuple[float, float] | None:
    """Instant at which the friction passes half its level and its 90-10 % time, or None where it is not clear."""
    before = friction[(t > about_s - 3.0) & (t < about_s - 1.6)]
    after = friction[(t > about_s + 1.6) & (t < about_s + 3.0)]
    if len(before) < 10 or len(after) < 10:
        return None
    high = np.nanmedian(before)
    low = np.nanmedian(after)
    noise = 1.4826 * np.nanmedian(np.abs(np.concatenate([before - high, after - low])))
    if high - low < 10 * noise or high <= low:
        return None
    near = np.flatnonzero((t > about_s - 1.6) & (t < about_s + 1.6) & np.isfinite(friction))
    level = (friction[near] - low) / (high - low)
    if len(level) < 10:
        return None
    instants = [_crossing(t[near], level, at) for at in (0.9, 0.5, 0.1)]
    if any(x is None for x in instants):
        return None
    start, middle, end = (float(x) for x in instants if x is not None)
    return middle, max(end - start, 0.0)


def _crossing(t: Array, level: Array, at: float) -> float | None:
    """Where ``level`` falls through ``at``: the cut that misplaces the fewest samples, then a straight line.

    None where that is not clear, or where samples are missing at that place.
    """
    above = level > at
    misplaced = np.cumsum(~above) + (above.sum() - np.cumsum(above))
    cut = int(np.argmin(misplaced))
    if cut + 1 >= len(t) or misplaced[cut] > 0.2 * len(t):
        return None
    if t[cut + 1] - t[cut] > MAX_GAP * float(np.median(np.diff(t))):
        return None
    a = level[cut]
    b = level[cut + 1]
    part = np.clip((a - at) / (a - b), 0.0, 1.0) if a != b else 0.5
    return float(t[cut] + part * (t[cut + 1] - t[cut]))
