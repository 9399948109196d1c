"""Comparison of two temperature maps of one test before and after two channels were interchanged.

Section 6.4.2.4 of the thesis: the slip rings of two thermocouples are exchanged and the test is
repeated. If their difference stays, it belongs to the disk or the thermocouples, if it changes, to
the channels. ``tcdyn rig campaign --interchanged`` uses it. Guarded by
``tests/campaign/test_interchange.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.result import Result
from tcdyn.estimation.line_fit import fit_line

TemperatureMap = Mapping[str, Mapping[str, float | None]]  # by disk and junction [degC]
MIN_OTHER_JUNCTIONS = 4  # that were not interchanged: a line with two degrees of freedom


@dataclass(frozen=True, repr=False)
class MapComparison(Result):
    """Two steady temperature maps, before and after an interchange of two channels.

    Parameters
    ----------
    tests
        Names of the two tests.
    interchanged
        The two junctions whose channels were interchanged, such as "slow_a".
    before_degC, after_degC
        Steady temperature of each junction, such as "slow_a" [degC].
    expected_degC
        Temperature after the interchange that a linear relation of the other junctions gives.
    difference_K
        First minus second of the two junctions, before and after [K].
    channels_K
        Part of the difference before that the channels cause: their errors, first minus second.
    """

    tests: tuple[str, str]
    interchanged: tuple[str, str]
    before_degC: Mapping[str, float]
    after_degC: Mapping[str, float]
    expected_degC: Mapping[str, float]
    difference_K: tuple[float, float]
    channels_K: Estimate

    @property
    def is_channel_error(self) -> bool:
        """Whether the channels differ: the 95 % interval of their errors excludes zero."""
        return not self.channels_K.contains(0.0)

    def summary(self) -> str:
        """The differences before and after, and what the channels contribute."""
        first, second = self.interchanged
        before, after = self.difference_K
        text = (
            f"{first} minus {second}: {before:.2f} K before and {after:.2f} K after the "
            f"interchange; the channels contribute {self.channels_K.text_without_interval('K')} "
            f"(95 %: {self.channels_K.interval_text})"
        )
        if self.is_channel_error:
            return f"{text}. The channels differ"
        return f"{text}. The interchange shows no error of the channels"

    def to_frame(self) -> pd.DataFrame:
        """Temperatures of each junction, before and after, and as expected after."""
        columns = {
            "before_degC": self.before_degC,
            "after_degC": self.after_degC,
            "expected_degC": self.expected_degC,
        }
        return pd.DataFrame(columns).rename_axis("junction")

    def to_dict(self) -> dict[str, Any]:
        """The entry of ``campaign.json``."""
        return {**super().to_dict(), "is_channel_error": self.is_channel_error}


@with_named_arguments
def compare_maps(
    before: TemperatureMap,
    after: TemperatureMap,
    interchanged: tuple[str, str],
    tests: tuple[str, str] = ("before", "after"),
) -> MapComparison:
    """Compare the steady temperatures of one test before and after an interchange of two channels.

    Parameters
    ----------
    before, after
        Steady temperature by disk and junction [degC]; None for one that was left out. Both are
        named by junction: in the second test, too, "a" is the temperature of junction a.
    interchanged
        The two junctions, such as ("slow_a", "slow_c").
    tests
        Names of the two tests.

    Returns
    -------
    MapComparison
        The maps and the contribution of the channels.

    Raises
    ------
    InputError
        Where a map lacks one of the two junctions, or fewer than four others are in both.

    Notes
    -----
    Ambient temperature and friction of two tests differ, so that after = p + q before with p and q
    from the junctions that were not interchanged. With errors e1 and e2 of the channels, the
    junctions read T1 + e1 and T2 + e2 before, p + q T1 + e2 and p + q T2 + e1 after. Hence e1 - e2
    = (q (difference before) - (difference after)) / (1 + q). Its uncertainty is that of the scatter
    about the line, which is the repeatability of the test, with Student's t.

    Examples
    --------
    >>> before = {"slow": {"a": 121.0, "b": 115.9, "c": 120.0, "d": 114.1, "e": 126.2, "f": 114.0}}
    >>> after = {"slow": {"a": 118.0, "b": 116.0, "c": 123.1, "d": 114.0, "e": 126.2, "f": 114.1}}
    >>> result = compare_maps(before, after, ("slow_a", "slow_c"))
    >>> [round(x, 1) for x in result.difference_K], round(result.channels_K.value)
    ([1.0, -5.1], 3)
    """
    maps = []
    for name, by_disk in zip(tests, (before, after)):
        values = {
            f"{disk}_{c}": value
            for disk, junctions in by_disk.items()
            for c, value in junctions.items()
            if value is not None
        }
        for junction in interchanged:
            if junction not in values:
                raise InputError(
                    f"has no temperature of {junction}", where=name, expected=", ".join(values)
                )
        maps.append(values)
    first, second = interchanged
    if first == second:
        raise InputError(f"{first} is named twice", expected="two junctions")
    names = [name for name in maps[0] if name in maps[1]]
    others = [name for name in names if name not in interchanged]
    if len(others) < MIN_OTHER_JUNCTIONS:
        raise InputError(
            f"{len(others)} other junctions are in both maps",
            expected=f"{MIN_OTHER_JUNCTIONS} or more",
        )
    fit = fit_line(*(np.array([values[name] for name in others]) for values in maps))
    before_K, after_K = (values[first] - values[second] for values in maps)
    error_K = (fit.slope * before_K - after_K) / (1.0 + fit.slope)
    slope_u = float(np.sqrt(fit.covariance[0, 0]))
    u_K = float(np.hypot(np.sqrt(2.0) * fit.sd, slope_u * before_K)) / (1.0 + fit.slope)
    half_width_K = float(stdtrit(fit.dof, 0.975)) * u_K
    channels_K = Estimate(
        value=error_K, u=u_K, low95=error_K - half_width_K, high95=error_K + half_width_K
    )
    return MapComparison(
        tests=tests,
        interchanged=interchanged,
        before_degC={name: maps[0][name] for name in names},
        after_degC={name: maps[1][name] for name in names},
        expected_degC={name: fit.intercept + fit.slope * maps[0][name] for name in names},
        difference_K=(before_K, after_K),
        channels_K=channels_K,
    )
