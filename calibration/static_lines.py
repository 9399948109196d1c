"""Static lines of the thermocouples fitted to the oven's PRT, and statistics of the errors before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import Result
from tcdyn.estimation.line_fit import (
    LineFit,
    fit_line,
    lack_of_fit_p,
    outlying,
    quadratic_p,
    repeat_shift,
)
from tcdyn.rig.columns import couples_in
from tcdyn.rig.static_line import StaticLine, line_doubts, lines_table, significant_test
from tcdyn.rig.traceability import PRT_U_DEGC


def error_statistics(errors_K: ArrayLike) -> pd.Series[float]:
    """Table 2.6's statistics of thermocouple minus PRT [K], of any shape, under the table's names; NaN is left out.

    The standard deviation is about the mean error.

    >>> float(error_statistics([1.0, -1.0, 0.5, -0.5])["Average of the absolute error"])
    0.75
    """
    e = np.asarray(errors_K, dtype=float).ravel()
    e = e[np.isfinite(e)]
    if len(e) < 2:
        raise InputError("fewer than 2 errors to describe")
    size = np.abs(e)
    return pd.Series(
        {
            "Maximum error": float(size.max()),
            "Summation of the absolute error": float(size.sum()),
            "Average of the absolute error": float(size.mean()),
            "Standard deviation": float(e.std(ddof=1)),
        }
    )


def error_histogram(errors_K: ArrayLike, width_K: float = 0.1) -> tuple[NDArray[np.int64], Array]:
    """Counts and edges [K] of a histogram with bins of ``width_K`` centred on zero (figure 2.16)."""
    e = np.asarray(errors_K, dtype=float).ravel()
    e = e[np.isfinite(e)]
    half = int(np.ceil(np.abs(e).max() / width_K)) if len(e) else 1
    edges = width_K * (np.arange(-half, half + 2) - 0.5)
    counts, edges = np.histogram(e, edges)
    return counts.astype(np.int64), np.asarray(edges, dtype=np.float64)


def hold_means(frame: pd.DataFrame) -> pd.DataFrame:
    """One row for each hold, the mean of its minutes: repeat, setpoint_degC, prt_degC, a_degC .. f_degC.

    Minutes of one hold follow one another under one repeat and set point; a channel without a value in some minute
    is averaged over the others, against the PRT of the same minutes.
    """
    keys = ["repeat", "setpoint_degC"]
    if not frame.duplicated(keys).any():
        return frame.reset_index(drop=True)
    names = couples_in(frame)
    offset = frame[names].sub(frame["prt_degC"], axis=0)
    grouped = offset.assign(prt_degC=frame["prt_degC"]).groupby(
        [frame[k] for k in keys], sort=False
    )
    means = grouped.mean()
    means[names] = means[names].add(means["prt_degC"], axis=0)
    return means.reset_index()[[*keys, "prt_degC", *names]]


@dataclass(frozen=True)
class OvenFit(Result):
    """Static lines of one disk and what the oven said about them.

    ``residuals`` holds one row for each hold: repeat, setpoint_degC, prt_degC and the residual [K] of each channel.
    """

    lines: dict[str, StaticLine]
    statistics: pd.DataFrame
    residuals: pd.DataFrame
    raw_errors_K: Array
    calibrated_errors_K: Array
    findings: tuple[Finding, ...] = ()

    def summary(self) -> str:
        """The lines as people write them."""
        return "\n".join(
            f"{c}: T = {line.gain:.5f} x logged {line.offset:+.3f} degC, residual sd {line.residual_sd_degC:.3f} K"
            for c, line in self.lines.items()
        )

    def card(self) -> pd.DataFrame:
        """Gain and offset with their standard uncertainties, one row a channel."""
        return lines_table(self.lines)


def fit_static_lines(
    frame: pd.DataFrame, prt_u_degC: float = PRT_U_DEGC, prt_shared_u_degC: float = 0.0
) -> OvenFit:
    """Lines T = gain * logged + offset of every channel of an oven log (``Log.frame``).

    Rows of one hold (same repeat and set point) share the error of the PRT and count as one point, their mean. The
    PRT (standard uncertainty ``prt_u_degC`` for each reading; ``prt_shared_u_degC``, common to all, is kept beside the
    line) and the logged means both err; the slope is corrected for the noise of the logged side (errors in variables,
    method of moments). The residual scatter sets the covariance, not below what the PRT alone makes of it; lack of fit
    and a shift between repeats widen it. Tests at the 1 % level give notes, from 0.1 % on findings to look at: lack
    of fit, curvature, shifts; outlying rows by name.

    Raises InputError when a channel has fewer than 3 rows.
    """
    frame = hold_means(frame)
    prt = frame["prt_degC"].to_numpy(dtype=float)
    names = [n.removesuffix("_degC") for n in couples_in(frame)]
    lines: dict[str, StaticLine] = {}
    residuals = frame[["repeat", "setpoint_degC", "prt_degC"]].copy()
    found: list[Finding] = []
    for channel in names:
        logged = frame[f"{channel}_degC"].to_numpy(dtype=float)
        ok = np.isfinite(logged) & np.isfinite(prt)
        if ok.sum() < 3:
            raise InputError(
                f"channel {channel} has {int(ok.sum())} oven rows", expected="at least 3"
            )
        fit = fit_line(logged[ok], prt[ok], u_y=prt_u_degC)
        lines[channel], said = _line(channel, fit, frame[ok], prt_shared_u_degC)
        found += said
        residuals[f"{channel}_degC"] = prt - lines[channel].gain * logged - lines[channel].offset
    columns = [f"{c}_degC" for c in names]
    raw = (frame[columns].to_numpy(dtype=float) - prt[:, None]).ravel("F")
    after = -residuals[columns].to_numpy().ravel("F")
    table = pd.DataFrame({"raw": error_statistics(raw), "calibrated": error_statistics(after)})
    return OvenFit(lines, table, residuals, raw, after, tuple(found))


def _line(
    channel: str, fit: LineFit, rows: pd.DataFrame, shared_u: float
) -> tuple[StaticLine, list[Finding]]:
    within, shift_u, shift_p = repeat_shift(fit, rows["repeat"].to_numpy())
    found = significant_test(shift_p, "line.repeats_shift", channel, u_degC=shift_u)
    variance = shift_u**2 if found else 0.0
    for i in outlying(fit):
        repeat, setpoint = (float(rows[key].iloc[i]) for key in ("repeat", "setpoint_degC"))
        off_K = fit.residuals[i]
        found.append(
            warning(
                "line.outlying", subject=channel, repeat=repeat, setpoint_degC=setpoint, off_K=off_K
            )
        )
    (gg, go), (_, oo) = (fit.covariance_95 + np.diag([0.0, variance])).tolist()
    line = StaticLine(
        gain=fit.slope,
        offset=fit.intercept,
        covariance=((gg, go), (go, oo)),
        range_degC=(float(fit.y.min()), float(fit.y.max())),
        shared_u_K=shared_u,
        residual_sd_degC=fit.sd,
        repeatability_sd_degC=within,
        n=len(fit.y),
        r_squared=fit.r_squared,
        lack_of_fit_p=lack_of_fit_p(fit, rows["setpoint_degC"].to_numpy()),
        quadratic_p=quadratic_p(fit),
    )
    return line, [*line_doubts(channel, line), *found]
