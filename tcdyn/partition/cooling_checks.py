"""Checks of the cooling fit: over the length of its window, and against the joint fit.

Used by the report of a test. Guarded by ``tests/partition/test_windows.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling import (
    compensate_disk,
    cooling_effects,
    cooling_fit,
    cooling_sensitivity,
    smooth_traces,
)
from tcdyn.partition.specified import log_h_prior
from tcdyn.partition.window import fit_rows

# window lengths [s] of ``cooling_by_window``; chosen by judgement
WINDOW_LENGTHS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0)
TWO_SIGMA = 2.0  # two estimates agree below so many standard uncertainties of their difference


def cooling_by_window(
    partition: Partition, lengths: Sequence[float] = WINDOW_LENGTHS_S
) -> pd.DataFrame:
    """Table of the h-only fit of each disk for each window length.

    Parameters
    ----------
    partition
        The partition.
    lengths
        Window lengths [s]; those beyond the end of the log are left out.

    Returns
    -------
    DataFrame
        Columns disk, window_s, within_lag, beta, u_beta, h_W_m2K, u_h_W_m2K and misfit_K. NaN where
        a fit fails.

    Raises
    ------
    InputError
        If no length is left, or one is not above zero.

    Notes
    -----
    Traces are smoothed as freely as for the cooling fit. ``u_beta`` and ``u_h_W_m2K`` include
    noise, nuisance parameters, the steady line and the lag. The lag counts as independent; the
    budget draws it with the correlations of the joint fit. ``within_lag`` marks windows shorter
    than the common lag of the disk, which depend more on the chain than on the cooling. The lengths
    may be changed freely. Guarded by ``tests/partition/test_windows.py``:
    ``test_window_of_five_seconds_reproduces_the_cooling_fit`` compares ``u_beta`` with the budget
    (within 20 %).
    """
    test = partition.test
    cooling_s = float(test.time_s[-1] - test.events.unload_s)
    if min(lengths, default=1.0) <= 0:
        raise InputError(f"a window of {min(lengths):g} s", expected="lengths above zero")
    lengths_s = sorted(float(x) for x in lengths if x <= cooling_s)
    if not lengths_s:
        raise InputError(
            f"the log holds {cooling_s:.2f} s of cooling",
            expected=f"at least {min(lengths, default=0):g} s",
        )
    fit_rows_slice = fit_rows(test, lengths_s[-1])
    of_disks = [
        _cooling_rows_of_disk(partition, disk, fit_rows_slice, lengths_s)
        for disk in partition.disks
    ]
    return pd.DataFrame([row for of_one in of_disks for row in of_one])


def _cooling_rows_of_disk(
    partition: Partition, name: str, fit_rows_slice: slice, lengths: Sequence[float]
) -> list[dict[str, object]]:
    """Rows of ``cooling_by_window`` for one disk.

    Parameters
    ----------
    partition
        The partition.
    name
        Name of the disk.
    fit_rows_slice
        Rows of the test that the longest window uses.
    lengths
        Window lengths [s].

    Returns
    -------
    list
        For each length disk, window_s [s], within_lag (whether the window is shorter than the
        common lag), beta and u_beta [1] (of the share of the fast disk), h_W_m2K and u_h_W_m2K
        [W/m2K], misfit_K [K]. The last five are NaN where the fit fails.

    Notes
    -----
    u^2 = sum per_sd^2 + noise + (u_lag by_lag)^2, by
    ``tcdyn.partition.cooling.cooling_sensitivity``; u_lag is that of the joint fit of the disk. The
    keys are the columns of :func:`cooling_by_window`, which
    ``tcdyn.plots.transient.draw_window_study`` reads; change both.
    """
    test = partition.test
    line = partition.lines[name]
    lag = partition.joint[name].estimates["lag_s"]
    nominal = partition.cooling[name]
    smoothed_traces = smooth_traces(
        test,
        test.disks[name],
        fit_rows_slice,
        partition.chains[name],
        lag.u,
        partition.compensated[name],
    )
    cooling_data = compensate_disk(
        test, test.disks[name], fit_rows_slice, smoothed_traces, partition.windows[name].rim.profile
    )
    errors = cooling_effects(cooling_data, nominal.share, nominal.h_W_m2K)
    out: list[dict[str, object]] = []
    for length in lengths:
        fit_values = dict.fromkeys(("beta", "u_beta", "h_W_m2K", "u_h_W_m2K", "misfit_K"), np.nan)
        try:
            prior = log_h_prior(cooling_data.disk.setup.surface)
            fit = cooling_fit(
                cooling_data.window,
                line.line,
                test.events.unload_s,
                length,
                cooling_data.noise_K,
                prior,
            )
        except InputError:
            pass
        else:
            shift = cooling_sensitivity(fit, *errors, line)
            variance = (
                (shift.per_sd**2).sum(axis=0) + np.diag(shift.noise) + (lag.u * shift.by_lag) ** 2
            )
            u_share, u_h = (float(u) for u in np.sqrt(variance))
            fit_values = {
                "beta": fit.beta,
                "u_beta": u_share,
                "h_W_m2K": fit.h_W_m2K,
                "u_h_W_m2K": u_h,
                "misfit_K": fit.misfit_K,
            }
        out.append(
            {"disk": name, "window_s": length, "within_lag": length < lag.value, **fit_values}
        )
    return out


def reference_table(partition: Partition) -> pd.DataFrame:
    """Compare the cooling fit and the joint fit of each disk for beta and h.

    The first fits compensated temperatures, the second applies the chain to the model, without an
    inverse.

    Parameters
    ----------
    partition
        The partition.

    Returns
    -------
    DataFrame
        ``u_difference`` is the standard deviation of the difference of the Monte Carlo samples of
        the budget, so that errors common to both cancel; ``z`` = difference / u_difference;
        ``agree`` where abs(z) is below ``TWO_SIGMA``.
    """
    rows = []
    for d in partition.disks:
        for quantity, key in (("beta", ""), ("h_W_m2K", "h ")):
            ways = [f"{key}{kind} {d}" for kind in ("cooling", "joint")]
            compensated_value, commuted_value = (partition.estimates[way] for way in ways)
            a, b = (partition.budget.samples[way] for way in ways)
            difference = compensated_value.value - commuted_value.value
            u = float(np.std(a - b))
            z = difference / max(u, 1e-12)
            rows.append(
                {
                    "disk": d,
                    "quantity": quantity,
                    "compensated": compensated_value.value,
                    "u_compensated": compensated_value.u,
                    "commuted": commuted_value.value,
                    "u_commuted": commuted_value.u,
                    "difference": difference,
                    "u_difference": u,
                    "correlation": float(np.corrcoef(a, b)[0, 1]),
                    "z": z,
                    "agree": bool(abs(z) < TWO_SIGMA),
                }
            )
    return pd.DataFrame(rows)
