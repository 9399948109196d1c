"""Rows of printed tables against each other: junction pairs, forces, h, trend lines.

No model of this project enters most of these rows: they compare printed numbers. Tests:
``tests/cli/test_verify.py``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.optimize import linprog

from tcdyn.core import Array
from tcdyn.partition.steady import speed_ratio_power
from tcdyn.rig.contact import hertz_contact
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.programme import PROGRAMME
from tcdyn.verify import VerifyRow, close, numbers, published, row, within

# The 16 tests of the programme, A1 to D4.
TESTS = tuple(PROGRAMME.values())
FAMILIES = tuple(TESTS[k : k + 4] for k in range(0, 16, 4))  # A to D, four loads each


def table_rows() -> Iterator[VerifyRow]:
    """Yield the rows that compare printed tables with each other."""
    yield from _kinematics_rows()
    yield _group_rows()
    yield from _force_rows()
    yield _ratio_rows()
    yield from _mean_difference_rows()
    yield from _trend_lines()


def _kinematics_rows() -> Iterator[VerifyRow]:
    """Sections 2.2.1 and 2.2.2: slide/roll ratio and aspect ratio of the contact."""
    slide_roll = [t.sliding_speed_m_s / t.entraining_speed_m_s for t in TESTS[::4]]
    yield row(
        "arithmetic",
        "slide/roll ratio of tests A to D",
        "section 2.2.1",
        "1.24",
        numbers(slide_roll, 3),
        within(slide_roll, [1.24] * 4, absolute=0.005),
        "u_s/u_m from the printed rpm, to the printed digit",
    )
    ellipses = [hertz_contact(t.load_N) for t in FAMILIES[0]]
    aspect = [e.major_m / e.minor_m for e in ellipses]
    yield row(
        "physics",
        "aspect ratio of the contact ellipse at the four loads",
        "section 2.2.2",
        "3.91",
        numbers(aspect, 3),
        within(aspect, [3.91] * 4, absolute=0.005),
        "from R = 38.1 mm and R_c = 304.8 mm alone, to the printed digit",
    )


def _group_rows() -> VerifyRow:
    """Table 6.5, and that the groups of table 6.2 are those of the default rig's angles."""
    counts = {published.PAIRS_SAME: Counter[str](), published.PAIRS_OTHER: Counter[str]()}
    for groups, comparisons in published.COMPARED:
        entries = comparisons.split()
        for pair, letter in zip(entries[::2], entries[1::2], strict=True):
            in_one_group = any(set(pair) <= set(group) for group in groups.split("|"))
            counts[published.PAIRS_SAME if in_one_group else published.PAIRS_OTHER][letter] += 1
    printed = _counts_text(published.TABLE_6_5)
    computed = _counts_text(counts)
    return row(
        "arithmetic",
        "logical, weak, illogical, N.A. pairs of junctions: in different groups; in the same one",
        "tables 6.2 to 6.5",
        printed,
        computed,
        printed == computed and _default_groups() == published.COMPARED[0][0],
        "27 and 18 pairs, counted in tables 6.2 to 6.4; the default rig's angles group the "
        "junctions as table 6.2 does",
    )


def _counts_text(counts: Mapping[str, Mapping[str, int]]) -> str:
    """Return the counts of logical, weak, illogical and N.A. pairs as text."""
    groups = (published.PAIRS_OTHER, published.PAIRS_SAME)
    return "; ".join(numbers([counts[group].get(c, 0) for c in "lwin"], 0) for group in groups)


def _default_groups() -> str:
    """Return the two groups of junctions by the angles of the default rig, that of a first."""
    junctions = load_rig().disk_setup("slow").junctions
    near = ""
    far = ""
    for channel in sorted(CHANNELS):
        angle_deg = junctions[channel].angle_deg - junctions["a"].angle_deg
        if np.cos(np.deg2rad(angle_deg)) > 0:
            near += channel
        else:
            far += channel
    return f"{near}|{far}"


def _force_rows() -> Iterator[VerifyRow]:
    """Section 6.5: traction and friction coefficient of the four families of tests."""
    load = np.array([[test.load_N for test in family] for family in FAMILIES])
    force = np.array([[test.friction_N for test in family] for family in FAMILIES])
    r2 = [float(np.corrcoef(x, y)[0, 1] ** 2) for x, y in zip(load, force, strict=True)]
    yield row(
        "rule",
        "traction against load, r squared of a straight line at 10, 13, 16, 20 m/s",
        "section 6.5, figure 6.33",
        "linear",
        numbers(r2, 4),
        min(r2) >= 0.994,
        "lines fitted to table 7.2 itself; agrees from 0.994 on",
    )
    friction = force[:, -1] / load[:, -1]
    yield row(
        "trend",
        "coefficient of friction at 2320 N, 10 to 20 m/s",
        "figure 6.34",
        "falls",
        numbers(friction, 4),
        bool(np.all(np.diff(friction) < 0)),
        "table 7.2 over table 6.1",
    )


def _ratio_rows() -> VerifyRow:
    """Table 7.1: one ratio h_f/h_s gives all printed pairs to their rounding."""
    h_pairs = [(test.h_fast_W_m2K, test.h_slow_W_m2K) for test in TESTS]
    fast, slow = np.array([*h_pairs, *published.CLARKE_H], dtype=float).T
    chi = speed_ratio_power(4.24, 0.667)
    low = ((fast - 0.5) / (slow + 0.5)).max()
    high = ((fast + 0.5) / (slow - 0.5)).min()
    ratios = fast / slow
    n_low = np.log(low) / np.log(4.24)
    n_high = np.log(high) / np.log(4.24)
    return row(
        "arithmetic",
        "h_f/h_s of all 32 tests, least and greatest",
        "table 7.1, (4.6)",
        numbers((2.62, 2.62), 2),
        numbers((ratios.min(), ratios.max()), 3),
        bool(low <= chi <= high),
        f"one ratio from {low:.4f} to {high:.4f} gives all 64 printed h to their rounding, and "
        f"ours, 4.24^0.667 = {chi:.4f}, is one; that is n from {n_low:.4f} to {n_high:.4f}",
    )


def _mean_difference_rows() -> Iterator[VerifyRow]:
    """Table 7.2: mean differences from Clarke's tests."""
    current = np.array([(t.fast_a_degC, t.slow_a_degC, t.friction_N) for t in TESTS])
    fast, slow, friction = (current - np.array(published.CLARKE_STEADY)).mean(axis=0)
    yield close(
        "arithmetic",
        "a of the fast and slow disk, mean difference from Clarke's tests, K",
        "table 7.2",
        "-0.1, 7.3",
        (fast, slow),
        2,
        "to the printed digit",
        absolute=0.05,
    )
    yield row(
        "arithmetic",
        "friction, mean difference from Clarke's tests, N",
        "table 7.2",
        "-0.3",
        f"{friction:.2f}",
        within([friction], [-0.39], absolute=0.005),
        "the table's own 16 differences have this mean",
        good="misprint",
    )


def chebyshev_line(x: Array, y: Array) -> tuple[float, float, float]:
    """Return intercept, slope and largest error of the minimax line.

    Parameters
    ----------
    x, y
        Points (N,).

    Returns
    -------
    intercept, slope, error
        The line, and its largest distance from the points.

    Notes
    -----
    The smallest largest error is a linear programme. It decides whether one line gives all printed
    numbers to their rounding; least squares would not.

    Examples
    --------
    >>> [round(v, 3) for v in chebyshev_line(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 1.0]))]
    [0.25, 0.5, 0.25]
    """
    a = np.column_stack([np.ones_like(x), x])
    ones = np.ones((len(x), 1))
    constraints = np.block([[a, -ones], [-a, -ones]])
    bounds = [(None, None), (None, None), (0, None)]
    solution = linprog([0, 0, 1], A_ub=constraints, b_ub=np.append(y, -y), bounds=bounds)
    intercept, slope, error = solution.x.tolist()
    return intercept, slope, error


def _trend_lines() -> Iterator[VerifyRow]:
    """Section 7.3: straight lines of models F and C, and the trend of the measured betas."""
    x, *models = np.array(published.TABLE_7_3).T
    for name, beta in zip("FC", models, strict=True):
        intercept, slope, error = chebyshev_line(x, beta)
        yield row(
            "rule",
            f"model {name}: beta against the product of temperature difference and sliding speed",
            "table 7.3, figure 7.19",
            "a straight line",
            f"{intercept:.3f} - {-slope * 1e5:.1f}e-5 x",
            error <= 0.005 and slope < 0,
            f"one falling line gives all 16 betas to their rounding (at most {error:.4f} off); "
            "nothing of ours in it",
        )
    measured = np.array([t.beta for t in TESTS])
    slope, level = np.polyfit(x, measured, 1)
    yield row(
        "trend",
        "measured beta against that product",
        "figure 7.18",
        "falls, majority to the fast disk",
        f"{level:.3f} - {-slope * 1e5:.1f}e-5 x",
        bool(slope < 0 and measured.min() > 0.5),
        "least squares, tables 7.1 and 7.3",
    )
    chi = [speed_ratio_power(4.25, n) for n in (0.57, 0.8)]
    yield close(
        "arithmetic",
        "h_f/h_s at n = 0.57 and 0.8",
        "section 7.4",
        "2.3, 3.2",
        chi,
        2,
        "4.25^n, to the printed digit",
        absolute=0.05,
    )
