"""Fit static lines to the PRT of an oven log (errors in variables); statistics of the errors.

Used by ``tcdyn rig calibrate`` and the certificate. The tests of a line (lack of fit, curvature,
shift, outliers) are those of :mod:`tcdyn.estimation.line_fit`; their levels are in
:mod:`tcdyn.rig.static_line`. Tests: ``tests/calibration/test_static_lines.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import Result
from tcdyn.estimation.line_fit import (
    LineFit,
    fit_line,
    lack_of_fit_p,
    outliers,
    quadratic_p,
    repeat_shift,
)
from tcdyn.rig.columns import junction_columns_in
from tcdyn.rig.static_line import (
    StaticLine,
    finding_of_test,
    findings_of_tests,
    lines_frame,
    lines_table,
)
from tcdyn.rig.tables import PRT_U_DEGC


def error_statistics(errors_K: ArrayLike) -> pd.Series[float]:
    """The statistics of table 2.6 of thermocouple minus PRT [K], by the names of the table.

    ``errors_K`` may have any shape; NaN is left out. The standard deviation is about the mean
    error.

    Parameters
    ----------
    errors_K
        Errors of any shape [K]; NaN is left out.

    Returns
    -------
    statistics
        By the names of the table.

    Raises
    ------
    InputError
        Fewer than two finite errors.

    Examples
    --------
    >>> float(error_statistics([1.0, -1.0, 0.5, -0.5])["Average of the absolute error"])
    0.75
    """
    errors = _finite_values(errors_K)
    if len(errors) < 2:
        raise InputError("fewer than 2 errors to describe")
    size = np.abs(errors)
    return pd.Series(
        {
            "Maximum error": float(size.max()),
            "Summation of the absolute error": float(size.sum()),
            "Average of the absolute error": float(size.mean()),
            "Standard deviation": float(errors.std(ddof=1)),
        }
    )


def _finite_values(errors_K: ArrayLike) -> Array:
    """The finite values in one row."""
    errors = np.asarray(errors_K, dtype=float).ravel()
    return errors[np.isfinite(errors)]


def hold_means(frame: pd.DataFrame) -> pd.DataFrame:
    """Means over each hold of an oven log: repeat, setpoint_degC, prt_degC, a_degC .. f_degC.

    The rows of a hold have the same repeat and set point. A channel with missing values is averaged
    over its other rows, as a difference from the PRT of the same rows.

    Parameters
    ----------
    frame
        Rows of an oven log.

    Returns
    -------
    means
        One row a hold; ``frame`` itself if no hold has two rows.
    """
    keys = ["repeat", "setpoint_degC"]
    if not frame.duplicated(keys).any():
        return frame.reset_index(drop=True)
    names = junction_columns_in(frame)
    offset = frame[names].sub(frame["prt_degC"], axis=0)
    grouped = offset.assign(prt_degC=frame["prt_degC"]).groupby(
        [frame[k] for k in keys], sort=False
    )
    means = grouped.mean()
    means[names] = means[names].add(means["prt_degC"], axis=0)
    return means.reset_index()[[*keys, "prt_degC", *names]]


@dataclass(frozen=True, repr=False)
class OvenFit(Result):
    """Static lines of one disk.

    Parameters
    ----------
    lines
        Static line of each channel.
    statistics
        Statistics of the errors before and after the calibration.
    residuals
        One row a hold: repeat, setpoint_degC, prt_degC and the residual [K] of each channel.
    raw_errors_K, calibrated_errors_K
        Errors of all channels and holds before and after the calibration.
    findings
        Findings about the lines.
    """

    lines: dict[str, StaticLine]
    statistics: pd.DataFrame
    residuals: pd.DataFrame
    raw_errors_K: Array
    calibrated_errors_K: Array
    findings: tuple[Finding, ...] = ()

    def summary(self) -> str:
        """The equation of each line, and its residual standard deviation."""
        return "\n".join(
            f"{channel}: T = {line.gain:.5f} x logged {line.offset:+.3f} degC, "
            f"residual sd {line.residual_sd_degC:.3f} K"
            for channel, line in self.lines.items()
        )

    def headline(self) -> str:
        """Number of lines and the largest residual standard deviation."""
        worst = max(line.residual_sd_degC for line in self.lines.values())
        return f"{len(self.lines)} static lines, residual sd at most {worst:.3f} K"

    def to_frame(self) -> pd.DataFrame:
        """Numbers of each static line, one row a channel."""
        return lines_frame(self.lines)

    def card(self) -> pd.DataFrame:
        """Gain and offset with their standard uncertainties, one row a channel."""
        return lines_table(self.lines)


def fit_static_lines(
    frame: pd.DataFrame, prt_u_degC: float = PRT_U_DEGC, prt_shared_u_degC: float = 0.0
) -> OvenFit:
    """Fit T = gain * logged + offset for every channel of an oven log.

    Parameters
    ----------
    frame
        Rows of the oven log (``Log.frame``).
    prt_u_degC
        Standard uncertainty of each reading of the PRT.
    prt_shared_u_degC
        Standard uncertainty of the PRT that is common to all readings; it is stored with the line,
        and is not in its covariance.

    Returns
    -------
    fit
        Lines, residuals, statistics and findings.

    Raises
    ------
    InputError
        A channel has fewer than 3 rows.

    Notes
    -----
    Rows of one hold (same repeat and set point) share the error of the PRT and count as one point,
    their mean. Both the PRT and the logged means have errors; the slope is corrected for the noise
    of the logged side (errors in variables, method of moments). The scatter of the residuals sets
    the covariance, but it is never below the contribution of the PRT. Lack of fit and a shift
    between repeats increase it. Lack of fit, curvature and shifts that are significant at the 1 %
    level are information, at the 0.1 % level warnings; outlying rows are warnings.

    The mean of a hold must come before the fit: rows of one hold share the error of the PRT.
    ``prt_shared_u_degC`` must not enter the covariance, since it cancels in differences between
    channels. Test: ``tests/calibration/test_static_lines.py`` (coverage over 200 ovens).
    """
    frame = hold_means(frame)
    prt = frame["prt_degC"].to_numpy(dtype=float)
    columns = junction_columns_in(frame)
    lines: dict[str, StaticLine] = {}
    residuals = frame[["repeat", "setpoint_degC", "prt_degC"]].copy()
    findings: list[Finding] = []
    for column in columns:
        channel = column.removesuffix("_degC")
        logged = frame[column].to_numpy(dtype=float)
        ok = np.isfinite(logged) & np.isfinite(prt)
        if ok.sum() < 3:
            raise InputError(
                f"channel {channel} has {int(ok.sum())} oven rows", expected="at least 3"
            )
        fit = fit_line(logged[ok], prt[ok], u_y=prt_u_degC)
        line, line_findings = _static_line(channel, fit, frame[ok], prt_shared_u_degC)
        lines[channel] = line
        findings += line_findings
        residuals[column] = prt - line.gain * logged - line.offset
    raw = (frame[columns].to_numpy(dtype=float) - prt[:, None]).ravel("F")
    calibrated = -residuals[columns].to_numpy().ravel("F")
    statistics = pd.DataFrame(
        {"raw": error_statistics(raw), "calibrated": error_statistics(calibrated)}
    )
    return OvenFit(lines, statistics, residuals, raw, calibrated, tuple(findings))


def _static_line(
    channel: str, fit: LineFit, rows: pd.DataFrame, shared_u: float
) -> tuple[StaticLine, list[Finding]]:
    """The static line of a fit, with the findings of its tests.

    Parameters
    ----------
    channel
        Name of the channel.
    fit
        Its line.
    rows
        Hold means that were fitted.
    shared_u
        Standard uncertainty that is common to all readings [K].

    Returns
    -------
    line
        With the variance of a significant shift between repeats added to that of the offset.
    findings
        Of the tests, the shift and the outlying rows.
    """
    repeatability, shift_u, shift_p = repeat_shift(fit, rows["repeat"].to_numpy())
    shift_findings = finding_of_test(shift_p, "line.repeats_shift", channel, u_degC=shift_u)
    shift_variance = shift_u**2 if shift_findings else 0.0
    covariance = fit.covariance_95 + np.diag([0.0, shift_variance])
    (gg, go), (_, oo) = covariance.tolist()
    line = StaticLine(
        gain=fit.slope,
        offset=fit.intercept,
        covariance=((gg, go), (go, oo)),
        range_degC=(float(fit.y.min()), float(fit.y.max())),
        shared_u_K=shared_u,
        residual_sd_degC=fit.sd,
        repeatability_sd_degC=repeatability,
        n=len(fit.y),
        r_squared=fit.r_squared,
        lack_of_fit_p=lack_of_fit_p(fit, rows["setpoint_degC"].to_numpy()),
        quadratic_p=quadratic_p(fit),
    )
    outlier_findings = [
        warning(
            "line.outlying",
            subject=channel,
            repeat=float(rows["repeat"].iloc[i]),
            setpoint_degC=float(rows["setpoint_degC"].iloc[i]),
            off_K=fit.residuals[i],
        )
        for i in outliers(fit)
    ]
    return line, [*findings_of_tests(channel, line), *shift_findings, *outlier_findings]
