"""The static line of a thermocouple: what it is, its uncertainty, and where it extrapolates."""

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
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.strict import STRICT

# a disk has some twenty such tests: only from the latter on it is asked to look
SIGNIFICANT = 0.01
CLEARLY = 0.001
FAR_K = 10.0  # beyond the oven's range
MIDDLE_DEGC = 85.0  # of what a disk's junctions read
WIRE_RANGE_DEGC = (
    -40.0,
    333.0,
)  # in which the tolerance of thermocouple wire is one number (IEC 60584-1)


class StaticLine(BaseModel):
    """T_degC = gain * logged + offset_degC, and how well it is known.

    ``covariance`` is that of (gain, offset) [1, degC; degC, degC^2], widened so that 1.96 standard uncertainties
    are the 95 % interval at the degrees of freedom at hand. ``range_degC`` is the span of the PRT readings.
    ``shared_u_K``: standard uncertainty that all channels calibrated against one reference have in common; it is not in
    ``covariance``, for it moves no difference between channels.
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
    def _sound(self) -> StaticLine:
        (a, b), (c, d) = self.covariance
        if (
            a < 0
            or d < 0
            or abs(b - c) > 1e-9 * (abs(b) + abs(c))
            or b * b > a * d * (1 + 1e-6) + 1e-30
        ):
            raise ValueError("covariance must be symmetric and positive semidefinite")
        if self.range_degC[0] >= self.range_degC[1]:
            raise ValueError("range_degC must be (low, high)")
        return self

    @property
    def gain_estimate(self) -> Estimate:
        """Gain with its 95 % interval."""
        return Estimate.normal(self.gain, float(np.sqrt(self.covariance[0][0])))

    @property
    def offset_estimate(self) -> Estimate:
        """Offset [degC] with its 95 % interval."""
        return Estimate.normal(self.offset, float(np.sqrt(self.covariance[1][1])))


def unit_lines(u_K: float, channels: Iterable[str] = CHANNELS) -> dict[str, StaticLine]:
    """Lines T = logged of the ``channels``, where no oven log tells better; ``u_K``: standard uncertainty of each [K].

    Of each channel by itself, in ``WIRE_RANGE_DEGC``, and nowhere less. So much may come or go within 100 K: wire is
    off by a slope as well as by an offset, u^2(T) = u_K^2 (1 + (T - 85 degC)^2 / (100 K)^2).

    >>> [round(float(static_u(unit_lines(0.9)["a"], t)), 2) for t in (20.0, 85.0, 150.0)]
    [1.07, 0.9, 1.07]
    """
    slope = (u_K / 100.0) ** 2
    covariance = (
        (slope, -MIDDLE_DEGC * slope),
        (-MIDDLE_DEGC * slope, u_K**2 + MIDDLE_DEGC**2 * slope),
    )
    known = {"covariance": covariance, "range_degC": WIRE_RANGE_DEGC}
    return {c: StaticLine(gain=1.0, offset=0.0, **known) for c in channels}  # type: ignore[arg-type]


def line_doubts(channel: str, line: StaticLine) -> list[Finding]:
    """What the tests of a line say against it, at the 1 % level: see ``fit_static_lines``."""
    fit = significant_test(line.lack_of_fit_p, "line.lack_of_fit", channel)
    return fit + significant_test(line.quadratic_p, "line.curved", channel)


def significant_test(p: float | None, code: str, channel: str, **numbers: Any) -> list[Finding]:
    """What a test says that fails at the 1 % level: a note, from 0.1 % on to be looked at."""
    if p is None or p >= SIGNIFICANT:
        return []
    return [(warning if p < CLEARLY else info)(code, subject=channel, **numbers, p=p)]


def lines_table(lines: Mapping[str, StaticLine]) -> pd.DataFrame:
    """Static lines as people read them, one row a channel, each number with its standard uncertainty."""
    return pd.DataFrame(
        [
            {
                "channel": name,
                "gain": str(line.gain_estimate),
                "offset [degC]": str(line.offset_estimate),
                "range [degC]": f"{line.range_degC[0]:.0f} to {line.range_degC[1]:.0f}",
                "u at mid-range [K]": f"{float(whole_u(line, 0.5 * sum(line.range_degC))):.2g}",
                "residual sd [K]": f"{line.residual_sd_degC:.2g}",
            }
            for name, line in sorted(lines.items())
        ]
    )


def apply_static(logged: ArrayLike, line: StaticLine) -> Array:
    """T [degC] = gain * logged + offset; any shape, NaN stays NaN.

    >>> line = StaticLine(gain=1.01, offset=-0.5, covariance=((0, 0), (0, 0)), range_degC=(20, 160))
    >>> apply_static([100.0], line).tolist()
    [100.5]
    """
    return np.asarray(line.gain * np.asarray(logged, dtype=float) + line.offset)


def static_u(line: StaticLine, temperature_degC: ArrayLike) -> Array:
    """Standard uncertainty [K] of the line at T [degC], the reference's own left out: u^2 = y^2 u_g^2 + 2 y cov(g, o)
    + u_o^2, y = (T - o)/g.
    """
    y = (np.asarray(temperature_degC, dtype=float) - line.offset) / line.gain
    (gg, go), (_, oo) = line.covariance
    return np.asarray(np.sqrt(np.maximum(y * y * gg + 2 * y * go + oo, 0.0)))


def whole_u(line: StaticLine, temperature_degC: ArrayLike) -> Array:
    """Standard uncertainty [K] of a reading at rest, that of the reference included: never below it."""
    return np.asarray(np.hypot(static_u(line, temperature_degC), line.shared_u_K))


def best_known(line: StaticLine) -> tuple[float, float, float]:
    """Where a line is best known [degC], its standard uncertainty there [K], and that of its slope [1] about there.

    The three make all of its covariance: u^2(T) = u_there^2 + (T - there)^2 u_slope^2.

    >>> line = StaticLine(gain=1.0, offset=0.0, covariance=((1e-6, -9e-5), (-9e-5, 0.0085)), range_degC=(20, 160))
    >>> [round(x, 4) for x in best_known(line)]
    [90.0, 0.02, 0.001]
    """
    (gg, go), _ = line.covariance
    there = line.offset - line.gain * go / gg if gg > 0 else 0.5 * sum(line.range_degC)
    return float(there), float(static_u(line, there)), float(np.sqrt(gg)) / line.gain


def shared_u_K(lines: Sequence[StaticLine]) -> Array:
    """Standard uncertainty (M,) [K] that lines have in common, that of their reference."""
    return np.array([line.shared_u_K for line in lines])


def outside_range(line: StaticLine, temperature_degC: ArrayLike, margin_K: float = 5.0) -> Flags:
    """Which temperatures lie more than ``margin_K`` outside the calibrated range: there the line extrapolates."""
    t = np.asarray(temperature_degC, dtype=float)
    with np.errstate(invalid="ignore"):
        return np.asarray((t < line.range_degC[0] - margin_K) | (t > line.range_degC[1] + margin_K))


def extrapolated(
    where: str, temperature_degC: Mapping[str, ArrayLike], lines: Mapping[str, StaticLine]
) -> list[Finding]:
    """One finding for all channels of one calibrated range that a log took far outside it.

    Far: more than ``FAR_K`` for more than half a per cent of the samples; a straight line bears a few kelvin more.

    ``temperature_degC``: after the static lines, (N,) each, NaN where missing.

    >>> line = StaticLine(gain=1.0, offset=0.0, covariance=((0, 0), (0, 0)), range_degC=(20.0, 60.0))
    >>> print(*extrapolated("B3.csv", {"fast_e": [30.0, 124.0]}, {"fast_e": line}))
    B3.csv: fast_e read 30 to 124 degC, calibrated from 20 to 60 degC: static lines extrapolate there
    """
    left: dict[tuple[float, float], dict[str, list[float]]] = {}
    for channel, values in temperature_degC.items():
        ends = np.nanquantile(np.asarray(values, dtype=float), [0.005, 0.995])
        if outside_range(lines[channel], ends, margin_K=FAR_K).any():
            left.setdefault(lines[channel].range_degC, {})[channel] = ends.tolist()
    return [
        warning(
            "line.extrapolated",
            where=where,
            subject=", ".join(read),
            read_degC=(
                min(low for low, _ in read.values()),
                max(high for _, high in read.values()),
            ),
            range_degC=span,
        )
        for span, read in left.items()
    ]
