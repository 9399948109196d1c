"""The cooling fit's answer against the length of its window, and the two transient forms against each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calibration.disk import DISKS
from calibration.errors import InputError
from tcdyn.partition.analyse import Partition
from tcdyn.partition.compensated import (
    compensate_stretch,
    compensated_window,
    cooling_by_lag,
    cooling_shift,
    lag_effect,
)
from tcdyn.partition.cooling import cooling_fit
from tcdyn.partition.nuisance import nuisances
from tcdyn.partition.window import OUTER, stretch_of

LENGTHS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0)
TWO_SIGMA = 2.0


def cooling_by_window(partition: Partition, lengths: Sequence[float] = LENGTHS_S) -> pd.DataFrame:
    """The h-only fit of both disks for each window length [s]: disk, window_s, beta, u_beta, h, u_h, misfit, lag.

    ``u_beta`` and ``u_h_W_m2K`` hold noise, nuisances, the steady line and the lag, as the budget
    does; ``within_lag`` marks windows shorter than the disk's common lag, which hold more of the chain than of the
    cooling. Lengths beyond the log's end are left out; a window whose fit runs away has NaN. Raises InputError when no
    length is left, or one is not above zero.
    """
    test = partition.test
    held = float(test.time_s[-1] - test.events.unload_s)
    if min(lengths, default=1.0) <= 0:
        raise InputError(f"a window of {min(lengths):g} s", expected="lengths above zero")
    wanted = sorted(float(x) for x in lengths if x <= held)
    if not wanted:
        raise InputError(f"the log holds {held:.2f} s of cooling", expected=f"at least {min(lengths, default=0):g} s")
    rows = stretch_of(test, wanted[-1])
    return pd.DataFrame([row for d in DISKS for row in _disk_rows(partition, d, rows, wanted)])


def _disk_rows(p: Partition, name: str, rows: slice, lengths: Sequence[float]) -> list[dict[str, object]]:
    test, disk, line = p.test, p.test.disks[name], p.lines[name]
    lag = p.joint[name].estimates["lag_s"]
    done = compensate_stretch(test, disk, rows, p.chains[name], lag.u)
    window = compensated_window(test, disk, rows, done, p.windows[name].profile)
    noise = float(np.median(done.sd_noise[:, OUTER]))
    at = p.cooling[name]
    nuis = nuisances(window, disk, disk.readings_degC[rows], test.dt_s, at.share, at.h_W_m2K, test.events.unload_u_s)
    effect = lag_effect(test, disk, rows, done, window, at.h_W_m2K)
    out: list[dict[str, object]] = []
    for length in lengths:
        row: dict[str, object] = {"disk": name, "window_s": length, "within_lag": length < lag.value}
        try:
            fit = cooling_fit(window, line.line, test.events.unload_s, length, noise)
        except InputError:
            empty = dict.fromkeys(("beta", "u_beta", "h_W_m2K", "u_h_W_m2K", "misfit_K"), np.nan)
            out.append(row | empty)
            continue
        shift = cooling_shift(nuis, line, fit)
        late = lag.u * cooling_by_lag(effect, line, fit)
        u_share, u_h = np.sqrt((shift.per_sd**2).sum(axis=0) + np.diag(shift.noise) + late**2)
        out.append(
            row
            | {
                "beta": fit.beta,
                "u_beta": float(u_share),
                "h_W_m2K": fit.h_W_m2K,
                "u_h_W_m2K": float(u_h),
                "misfit_K": fit.misfit_K,
            }
        )
    return out


def referee_table(partition: Partition) -> pd.DataFrame:
    """Compensated (cooling fit) against commuted (joint fit, no inverse) for beta and h of each disk.

    ``u_difference`` is the spread of the difference of the budget's draws, so that what moves both alike does not
    count; ``z`` = difference / u_difference; ``agree`` below two.
    """
    rows = []
    draws = partition.budget.draws
    for d in DISKS:
        cooling, joint = partition.cooling[d], partition.joint[d]
        for quantity, one, other, key in (
            ("beta", cooling.beta, joint.beta, ""),
            ("h_W_m2K", cooling.h_W_m2K, joint.h_W_m2K, "h "),
        ):
            a, b = draws[f"{key}cooling {d}"], draws[f"{key}joint {d}"]
            u = float(np.std(a - b))
            z = (one - other) / max(u, 1e-12)
            rows.append(
                {
                    "disk": d,
                    "quantity": quantity,
                    "compensated": one,
                    "u_compensated": float(np.std(a)),
                    "commuted": other,
                    "u_commuted": float(np.std(b)),
                    "difference": one - other,
                    "u_difference": u,
                    "correlation": float(np.corrcoef(a, b)[0, 1]),
                    "z": z,
                    "agree": bool(abs(z) < TWO_SIGMA),
                }
            )
    return pd.DataFrame(rows)
