"""Ratio of the lags of two sensors, or of several to the first.

``tcdyn sensor compare`` uses it. Tests: ``tests/sensors/test_ratio.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.estimate import Z95, Estimate
from tcdyn.core.findings import Finding, info, labelled_messages, warning
from tcdyn.core.result import Result, estimate_columns
from tcdyn.sensors.file import MEASURED, SensorFile, read_sensor
from tcdyn.sensors.history import condition, measured_lag_s, shared_u_s


@dataclass(frozen=True)
class LagRatio:
    """Lag of a sensor over that of the first.

    Attributes
    ----------
    name, first
        Names of both.
    lag_s
        Lag of the sensor [s].
    ratio
        Its lag over that of the first [1].
    shared_share
        Share of the variance of the ratio that is due to what measurements by one method share:
        the shorter lags, the medium, the model. It cancels where both sensors are of one
        construction.
    """

    name: str
    first: str
    lag_s: Estimate
    ratio: Estimate
    shared_share: float

    @property
    def differs(self) -> bool:
        """Whether the 95 % interval of the ratio excludes 1."""
        return not self.ratio.contains(1.0)


@dataclass(frozen=True, repr=False)
class SensorComparison(Result):
    """Lags of several sensors over that of the first.

    Attributes
    ----------
    first, first_lag_s
        Name and lag [s] of the first.
    ratios
        The others.
    same_design
        Whether what measurements by one method share was taken as the same error of all.
    findings
        Warnings and infos.
    """

    first: str
    first_lag_s: Estimate
    ratios: tuple[LagRatio, ...]
    same_design: bool
    findings: tuple[Finding, ...] = field(default=())

    def summary(self) -> str:
        """Lags, ratios, and what is shared."""
        lines = [f"{self.first}: lag {self.first_lag_s.text('s')}"]
        for each in self.ratios:
            verdict = "excludes 1" if each.differs else "includes 1"
            ratio = each.ratio
            lines.append(f"{each.name}: lag {each.lag_s.text('s')}")
            lines.append(
                f"  {ratio.text_without_interval()} times that of {self.first} (95 %: "
                f"{ratio.interval_text}, which {verdict})"
            )
            if each.shared_share > 0:
                lines.append(
                    f"  {100 * each.shared_share:.2g} % of the variance is shared by measurements "
                    "of one method, and cancels between sensors of one design"
                )
        if self.same_design:
            lines.append("shared uncertainties are taken as the same error of all sensors")
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def to_frame(self) -> pd.DataFrame:
        """One row for each sensor but the first."""
        rows = [
            {
                "sensor": each.name,
                "first": each.first,
                **estimate_columns("lag", "s", each.lag_s),
                **estimate_columns("ratio", "", each.ratio),
                "differs": each.differs,
                "shared_share": each.shared_share,
            }
            for each in self.ratios
        ]
        return pd.DataFrame(rows).set_index("sensor")


@dataclass(frozen=True)
class _Lag:
    """Lag of one column of a file."""

    name: str
    column: str
    sensor: SensorFile
    index: int  # of the file

    @property
    def lag_s(self) -> Estimate:
        """The lag without the filter [s]."""
        return measured_lag_s(self.sensor, self.column)


@with_named_arguments
def compare_sensors(
    sensors: Sequence[str | Path | SensorFile], *, same_design: bool = False
) -> SensorComparison:
    """Ratio of the lags of several sensors to that of the first.

    Parameters
    ----------
    sensors
        Sensor files or sensors; each column of a file is a sensor. Together at least two.
    same_design
        Whether the sensors are of one construction and were measured in one medium, so that what
        measurements by one method share is one relative error of all lags, and cancels.

    Returns
    -------
    SensorComparison
        The ratios, with warnings where sensors were not measured alike.

    Raises
    ------
    InputError
        For fewer than two sensors, one that is given twice, and a lag of zero.

    Notes
    -----
    u^2(log r) = u^2(log a) + u^2(log b) - 2 cov(log a, log b). The covariance is that of the file
    for two columns of one file; otherwise it is zero, and with ``same_design`` the product of the
    relative shared uncertainties (``tcdyn.sensors.history.SHARED``). The lag of several dips is the
    mean of many.

    Examples
    --------
    >>> from tcdyn.sensors import specified_sensor
    >>> old, new = (specified_sensor(name, ["T1"], [lag])
    ...             for name, lag in (("old", (2.4, 0.05)), ("new", (2.0, 0.05))))
    >>> compared = compare_sensors([new, old])
    >>> print(compared.ratios[0].ratio, compared.ratios[0].differs)
    1.200 +- 0.039 True
    """
    lags = _lags_of(sensors)
    if len(lags) < 2:
        raise InputError(f"{len(lags)} sensors to compare", expected="at least two")
    for each in lags:
        if not each.lag_s.value > 0:
            raise InputError(
                f"a lag of {each.lag_s.value:g} s", where=each.name, expected="a lag above zero"
            )
    first = lags[0]
    ratios = tuple(_ratio(each, first, same_design) for each in lags[1:])
    return SensorComparison(first.name, first.lag_s, ratios, same_design, tuple(_findings(lags)))


def _lags_of(sensors: Sequence[str | Path | SensorFile]) -> list[_Lag]:
    """One lag for each column of each file."""
    lags: list[_Lag] = []
    for index, given in enumerate(sensors):
        sensor = given if isinstance(given, SensorFile) else read_sensor(given)
        name = sensor.sensor if isinstance(given, SensorFile) else utf8(Path(given).name)
        if any(sensor == each.sensor for each in lags):
            raise InputError("is given twice", where=name, remedy="name each sensor once")
        for column in sensor.columns:
            full = f"{name} {column}" if len(sensor.columns) > 1 else name
            lags.append(_Lag(full, column, sensor, index))
    return lags


def _ratio(of: _Lag, first: _Lag, same_design: bool) -> LagRatio:
    """Lag of a sensor over that of the first.

    Parameters
    ----------
    of, first
        The sensors.
    same_design
        As of ``compare_sensors``.
    """
    a, b = of.lag_s, first.lag_s
    relative = np.array([a.u / a.value, b.u / b.value])
    shared = np.array([shared_u_s(of.sensor) / a.value, shared_u_s(first.sensor) / b.value])
    shared = np.minimum(shared, relative)
    covariance = 0.0
    is_one_file = of.index == first.index
    if is_one_file:
        i, j = (of.sensor.columns.index(each.column) for each in (of, first))
        covariance = float(of.sensor.lag_covariance_s2[i, j] / (a.value * b.value))
    elif same_design and of.sensor.method == first.sensor.method:
        covariance = float(shared.prod())
    variance = max(float(relative @ relative) - 2 * covariance, 0.0)
    left = float(shared @ shared) - 2 * covariance if not is_one_file else 0.0
    log_ratio = float(np.log(a.value / b.value))
    low, value, high = np.exp(log_ratio + Z95 * variance**0.5 * np.array([-1, 0, 1]))
    ratio = Estimate(value=value, u=(high - low) / (2 * Z95), low95=low, high95=high)
    share = max(left, 0.0) / variance if variance > 0 else 0.0
    return LagRatio(of.name, first.name, a, ratio, share)


def _findings(lags: Sequence[_Lag]) -> list[Finding]:
    """Warnings where sensors were not measured alike, or the uncertainty is not complete."""
    findings: list[Finding] = []
    first = lags[0]
    for each in lags:
        if condition(each.sensor) != condition(first.sensor):
            findings.append(
                warning(
                    "ratio.conditions",
                    subject=each.name,
                    condition=condition(each.sensor),
                    other=first.name,
                    other_condition=condition(first.sensor),
                )
            )
        if each.sensor.method == "plunge" and "mean_lag_s" not in each.sensor.fit:
            findings.append(warning("ratio.one_dip", subject=each.name))
        if each.sensor.method not in MEASURED:
            findings.append(info("ratio.stated", subject=each.name))
    return findings
