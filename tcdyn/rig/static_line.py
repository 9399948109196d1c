"""The static line of a thermocouple: its uncertainty, its tests, and where it extrapolates.

Made by :mod:`calibration.static_lines`; used wherever a logged temperature is corrected. The
significance levels belong to the tests of the fit. Tests:
``tests/calibration/test_static_lines.py`` and ``tests/calibration/test_without_oven.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field, model_validator

from tcdyn.core import Array, Flags
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.result import estimate_columns
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.tables import STRICT

# Levels of the tests of a line: below the first an information, below the second a warning, because
# a disk has some twenty such tests.
INFO_SIGNIFICANCE = 0.01
WARNING_SIGNIFICANCE = 0.001
# Readings this far outside the oven's range give a warning [K] ...
MAX_EXTRAPOLATION_K = 10.0
# ... if these quantiles of the readings do.
READING_QUANTILES = (0.005, 0.995)
# Middle of the readings of the junctions of a disk [degC].
MIDDLE_DEGC = 85.0
# Range in which the tolerance of thermocouple wire is constant [degC] (IEC 60584-1).
WIRE_RANGE_DEGC = (-40.0, 333.0)


class StaticLine(BaseModel):
    """Static line T_degC = gain * logged + offset_degC, and its uncertainty.

    Parameters
    ----------
    gain, offset
        Of the line.
    covariance
        Of (gain, offset) [1, degC; degC, degC^2], widened so that 1.96 standard uncertainties are
        the 95 % interval at the available degrees of freedom.
    range_degC
        Range of the PRT readings.
    shared_u_K
        Standard uncertainty common to all channels calibrated against one reference. It is not in
        ``covariance``, because it does not affect differences between channels.
    residual_sd_degC, repeatability_sd_degC
        Standard deviation of the residuals, and within repeats.
    n, r_squared, lack_of_fit_p, quadratic_p
        Number of holds, and tests of the fit.
    """

    model_config = STRICT

    gain: float = Field(gt=0.3, lt=3.0)
    offset: float = Field(gt=-100.0, lt=100.0)
    covariance: tuple[tuple[float, float], tuple[float, float]]
    range_degC: tuple[float, float]
    shared_u_K: float = Field(default=0.0, ge=0.0, lt=50.0)
    residual_sd_degC: float = Field(default=0.0, ge=0.0, lt=50.0)
    repeatability_sd_degC: float | None = Field(default=None, ge=0.0, lt=50.0)
    n: int = Field(default=2, ge=2)
    r_squared: float | None = Field(default=None, ge=0.0, le=1.0)
    lack_of_fit_p: float | None = Field(default=None, ge=0.0, le=1.0)
    quadratic_p: float | None = Field(default=None, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _check_covariance(self) -> StaticLine:
        """Check that covariance and range of the line are possible."""
        (a, b), (c, d) = self.covariance
        is_symmetric = abs(b - c) <= 1e-9 * (abs(b) + abs(c))
        is_semidefinite = a >= 0 and d >= 0 and b * b <= a * d * (1 + 1e-6) + 1e-30
        if not (is_symmetric and is_semidefinite):
            raise ValueError("covariance must be symmetric and positive semidefinite")
        if self.range_degC[0] >= self.range_degC[1]:
            raise ValueError("range_degC must be (low, high)")
        return self

    @property
    def gain_estimate(self) -> Estimate:
        """Gain with its 95 % interval."""
        return Estimate.normal(self.gain, float(np.sqrt(self.covariance[0][0])))

    @property
    def gain_u_rel(self) -> float:
        """Relative standard uncertainty of the gain."""
        return float(np.sqrt(self.covariance[0][0])) / self.gain

    @property
    def offset_estimate(self) -> Estimate:
        """Offset [degC] with its 95 % interval."""
        return Estimate.normal(self.offset, float(np.sqrt(self.covariance[1][1])))


def identity_lines(u_K: float, channels: Iterable[str] = CHANNELS) -> dict[str, StaticLine]:
    """Lines T = logged of the ``channels``, for a disk without an oven log.

    They are valid in ``WIRE_RANGE_DEGC``. Wire deviates by a slope as well as by an offset, so the
    uncertainty increases by as much over 100 K: u^2(T) = u_K^2 (1 + (T - 85 degC)^2 / (100 K)^2).

    Parameters
    ----------
    u_K
        Standard uncertainty of each channel at 85 degC, independent of the others.
    channels
        Names of the channels.

    Returns
    -------
    lines
        One line a channel, all equal.

    Notes
    -----
    ``MIDDLE_DEGC`` and the 100 K are chosen by judgement. Test:
    ``tests/calibration/test_without_oven.py``.

    Examples
    --------
    >>> [round(float(static_u(identity_lines(0.9)["a"], t)), 2) for t in (20.0, 85.0, 150.0)]
    [1.07, 0.9, 1.07]
    """
    variance = (u_K / 100.0) ** 2
    covariance = (
        (variance, -MIDDLE_DEGC * variance),
        (-MIDDLE_DEGC * variance, u_K**2 + MIDDLE_DEGC**2 * variance),
    )
    line = StaticLine(gain=1.0, offset=0.0, covariance=covariance, range_degC=WIRE_RANGE_DEGC)
    return dict.fromkeys(channels, line)


def findings_of_tests(channel: str, line: StaticLine) -> list[Finding]:
    """Findings of the tests of a line, see ``fit_static_lines``.

    Parameters
    ----------
    channel
        Name of the channel.
    line
        Its static line.
    """
    return [
        *finding_of_test(line.lack_of_fit_p, "line.lack_of_fit", channel),
        *finding_of_test(line.quadratic_p, "line.curved", channel),
    ]


def finding_of_test(p: float | None, code: str, channel: str, **numbers: Any) -> list[Finding]:
    """The finding of one test of a line; empty if it is not significant.

    Parameters
    ----------
    p
        p-value; None: not tested.
    code
        Code of the message.
    channel
        Name of the channel.
    **numbers
        Further numbers of the message.

    Notes
    -----
    Below ``INFO_SIGNIFICANCE`` an info, below ``WARNING_SIGNIFICANCE`` a warning. The info for
    "line.repeats_shift" also widens the offset (:mod:`calibration.static_lines`).
    """
    if p is None or p >= INFO_SIGNIFICANCE:
        return []
    report = warning if p < WARNING_SIGNIFICANCE else info
    return [report(code, subject=channel, **numbers, p=p)]


def lines_table(lines: Mapping[str, StaticLine]) -> pd.DataFrame:
    """Table of static lines, one row a channel, each number with its standard uncertainty."""
    return pd.DataFrame(
        [
            {
                "channel": name,
                "gain": str(line.gain_estimate),
                "offset [degC]": str(line.offset_estimate),
                "range [degC]": f"{line.range_degC[0]:.0f} to {line.range_degC[1]:.0f}",
                "u at mid-range [K]": f"{float(reading_u(line, 0.5 * sum(line.range_degC))):.2g}",
                "residual sd [K]": f"{line.residual_sd_degC:.2g}",
            }
            for name, line in sorted(lines.items())
        ]
    )


def lines_frame(lines: Mapping[str, StaticLine]) -> pd.DataFrame:
    """Numbers of static lines, one row a channel."""
    rows = {
        name: {
            **estimate_columns("gain", "", line.gain_estimate),
            **estimate_columns("offset", "degC", line.offset_estimate),
            "low_degC": line.range_degC[0],
            "high_degC": line.range_degC[1],
            "residual_sd_K": line.residual_sd_degC,
        }
        for name, line in sorted(lines.items())
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("channel")


def apply_static(logged: ArrayLike, line: StaticLine) -> Array:
    """Apply a static line: T = gain * logged + offset [degC].

    Parameters
    ----------
    logged
        Readings of any shape; NaN stays NaN.
    line
        Static line of the channel.

    Returns
    -------
    temperature
        Of the same shape.

    Examples
    --------
    >>> line = StaticLine(gain=1.01, offset=-0.5, covariance=((0, 0), (0, 0)), range_degC=(20, 160))
    >>> apply_static([100.0], line).tolist()
    [100.5]
    """
    return np.asarray(line.gain * np.asarray(logged, dtype=float) + line.offset)


def static_u(line: StaticLine, temperature_degC: ArrayLike) -> Array:
    """Standard uncertainty of a line, without that of the reference [K].

    u^2 = y^2 u_g^2 + 2 y cov(g, o) + u_o^2, y = (T - o)/g

    Parameters
    ----------
    line
        Static line of the channel.
    temperature_degC
        Temperatures of any shape.

    Returns
    -------
    u
        Of the same shape.
    """
    y = (np.asarray(temperature_degC, dtype=float) - line.offset) / line.gain
    (gg, go), (_, oo) = line.covariance
    return np.asarray(np.sqrt(np.maximum(y * y * gg + 2 * y * go + oo, 0.0)))


def reading_u(line: StaticLine, temperature_degC: ArrayLike) -> Array:
    """Standard uncertainty [K] of a reading at rest, including that of the reference.

    Parameters
    ----------
    line
        Static line of the channel.
    temperature_degC
        Temperatures of any shape.

    Returns
    -------
    u
        Of the same shape.
    """
    return np.asarray(np.hypot(static_u(line, temperature_degC), line.shared_u_K))


def smallest_uncertainty(line: StaticLine) -> tuple[float, float, float]:
    """Temperature at which a line has its smallest uncertainty, and two uncertainties.

    These are the standard uncertainty there [K], and that of the slope about there [1]. The three
    values are equivalent to the covariance: u^2(T) = u_there^2 + (T - there)^2 u_slope^2.

    Parameters
    ----------
    line
        Static line of the channel.

    Returns
    -------
    temperature_degC
        Middle of the range where the gain has no uncertainty.
    u_K
        Standard uncertainty there.
    slope_u
        Standard uncertainty of the slope about there [1].

    Notes
    -----
    The plunge fit uses these as independent priors of offset and slope
    (:func:`immersion.plunge_fit.full_prior`).

    Examples
    --------
    >>> covariance = ((1e-6, -9e-5), (-9e-5, 0.0085))
    >>> line = StaticLine(gain=1.0, offset=0.0, covariance=covariance, range_degC=(20, 160))
    >>> [round(x, 4) for x in smallest_uncertainty(line)]
    [90.0, 0.02, 0.001]
    """
    (gg, go), _ = line.covariance
    middle = 0.5 * sum(line.range_degC)
    if gg > 0:
        middle = line.offset - line.gain * go / gg
    return middle, float(static_u(line, middle)), float(np.sqrt(gg)) / line.gain


def shared_u_K(lines: Sequence[StaticLine]) -> Array:
    """Standard uncertainty of the reference of each line, (M,) [K].

    Parameters
    ----------
    lines
        Static lines (M).

    Returns
    -------
    u
        (M,) [K].
    """
    return np.array([line.shared_u_K for line in lines])


def outside_range(line: StaticLine, temperature_degC: ArrayLike, margin_K: float = 5.0) -> Flags:
    """Which temperatures are more than ``margin_K`` outside the calibrated range.

    Parameters
    ----------
    line
        Static line of the channel.
    temperature_degC
        Temperatures of any shape; False for NaN.
    margin_K
        Distance that is still allowed.
    """
    t = np.asarray(temperature_degC, dtype=float)
    with np.errstate(invalid="ignore"):
        return np.asarray((t < line.range_degC[0] - margin_K) | (t > line.range_degC[1] + margin_K))


def extrapolation_warnings(
    where: str, temperature_degC: Mapping[str, ArrayLike], lines: Mapping[str, StaticLine]
) -> list[Finding]:
    """Warnings about channels that were far outside their calibrated range, one for each range.

    Far: more than 10 K for more than half a per cent of the samples at one end; a straight line may
    be extrapolated by a few kelvin.

    Parameters
    ----------
    where
        Name of the log.
    temperature_degC
        Readings after the static lines, (N,) each, NaN where missing.
    lines
        Static line of each channel.

    Examples
    --------
    >>> line = StaticLine(gain=1, offset=0, covariance=((0, 0), (0, 0)), range_degC=(20.0, 60.0))
    >>> print(*extrapolation_warnings("B3", {"fast_e": [30.0, 124.0]}, {"fast_e": line}))
    B3: fast_e read 30 to 124 degC, calibrated from 20 to 60 degC: static lines extrapolate there
    """
    by_range: dict[tuple[float, float], dict[str, list[float]]] = {}
    for channel, values in temperature_degC.items():
        ends = np.nanquantile(np.asarray(values, dtype=float), READING_QUANTILES)
        line = lines[channel]
        if outside_range(line, ends, margin_K=MAX_EXTRAPOLATION_K).any():
            by_range.setdefault(line.range_degC, {})[channel] = ends.tolist()
    findings: list[Finding] = []
    for range_degC, readings in by_range.items():
        low = min(ends[0] for ends in readings.values())
        high = max(ends[1] for ends in readings.values())
        findings.append(
            warning(
                "line.extrapolated",
                where=where,
                subject=", ".join(readings),
                read_degC=(low, high),
                range_degC=range_degC,
            )
        )
    return findings
