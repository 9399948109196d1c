"""Rows for the speed law and for the static calibration."""

from __future__ import annotations

import numpy as np

from calibration.lines.oven import error_statistics
from calibration.lines.static import fit_static_lines
from tcdyn.partition.steady import speed_law_beta, speed_ratio_power
from tcdyn.simulate.oven import simulate_oven
from tcdyn.simulate.truth import draw_truth
from tcdyn.verify.row import VerifyRow, numbers, row

TABLE_2_6 = {"raw": (1.9, 117.0, 0.40, 0.56), "calibrated": (0.8, 66.5, 0.23, 0.29)}


def partition_rows() -> list[VerifyRow]:
    """All rows of sections 4.3 and 2.6."""
    return [*_speed_law(), *_ovens()]


def _speed_law() -> list[VerifyRow]:
    chi = speed_ratio_power(4.24, 0.667)
    fast_slope, slow_slope = (0.83 - 0.37) / 1100, (0.48 - 0.20) / 1100  # figures 4.13 to 4.16
    a, c = 0.37 - 100 * fast_slope, 0.20 - 100 * slow_slope
    beta = speed_law_beta(a, fast_slope, c, slow_slope, chi)
    h_fast = (beta - a) / fast_slope
    h_slow = (1 - beta - c) / slow_slope
    return [
        row("chi = (u_f/u_s)^n", "(4.6)", "2.62", f"{chi:.3f}", round(chi, 2) == 2.62, "4.24^0.667"),
        row(
            "beta of the worked example",
            "(4.7) as corrected",
            "0.73",
            f"{beta:.3f}",
            round(beta, 2) == 0.73,
            "lines read off figures 4.13 to 4.16; the thesis prints (4.7) for a slow line written for beta",
        ),
        row(
            "h_fast/h_slow at that point",
            "(4.6)",
            "2.62",
            f"{h_fast / h_slow:.3f}",
            bool(np.isclose(h_fast / h_slow, chi)),
            "the solution must obey the law it was solved with",
        ),
    ]


def _ovens() -> list[VerifyRow]:
    truth = draw_truth(1)
    raw, after = [], []
    for disk in ("fast", "slow"):
        frame, _ = simulate_oven(disk, 1, truth)
        fit = fit_static_lines(frame)
        raw.append(np.ravel(fit.raw_errors_K))
        after.append(np.ravel(fit.calibrated_errors_K))
    before, calibrated = (error_statistics(np.concatenate(x)) for x in (raw, after))
    ours = [tuple(s.rows().values()) for s in (before, calibrated)]
    better = all(b < a for a, b in zip(*ours, strict=True))
    fall = ours[1][2] / ours[0][2]
    return [
        row(
            "errors of 12 channels, raw then calibrated: maximum, sum, mean size, standard deviation, K",
            "table 2.6",
            "; ".join(numbers(TABLE_2_6[k], 2) for k in ("raw", "calibrated")),
            "; ".join(numbers(x, 2) for x in ours),
            better and before.n == calibrated.n == 288,
            f"simulated ovens ({before.n} readings, as in the thesis) with errors of their own; every "
            f"statistic must fall: the mean size to {fall:.0%} (thesis: {0.23 / 0.40:.0%})",
            good="same trend",
        )
    ]
