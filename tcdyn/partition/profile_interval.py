"""The 95 % intervals that profiles give, beside the normal ones: numbers, a table, a sentence where they part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.estimate import Z95, Estimate

Array = NDArray[np.float64]
LEVEL = Z95**2  # 3.84, the 95 % point of chi-squared with one degree of freedom
NOTICEABLE = 0.2  # of the half-width
WORDS = {
    "beta": "beta",
    "h": "h",
    "lag_s": "the lag",
    "h_fast": "h of the fast disk",
    "h_slow": "h of the slow disk",
    "exponent": "the exponent",
}
HEADINGS = {
    "beta": "β [1]",
    "h": "h [W/m²K]",
    "lag_s": "lag [s]",
    "h_fast": "h, fast [W/m²K]",
    "h_slow": "h, slow [W/m²K]",
    "exponent": "exponent n [1]",
}
UNITS = {"h": " W/m2K", "h_fast": " W/m2K", "h_slow": " W/m2K", "lag_s": " s"}


@dataclass(frozen=True)
class ProfileInterval:
    """The 95 % interval of one number of one joint fit by its profile, beside the normal one of ``estimate``.

    ``fit`` is "fast", "slow" or "both"; ``low95`` or ``high95`` is None where the profile stays below 3.84 as far as
    it was followed, ``low_seen`` to ``high_seen``.
    """

    fit: str
    parameter: str
    estimate: Estimate
    low95: float | None
    high95: float | None
    low_seen: float
    high_seen: float

    @property
    def differs(self) -> bool:
        """Whether an end is missing, or lies elsewhere than the normal one by a fifth of the half-width."""
        if self.low95 is None or self.high95 is None:
            return True
        allowed = NOTICEABLE * Z95 * self.estimate.u
        e = self.estimate
        return max(abs(self.low95 - e.low95), abs(self.high95 - e.high95)) > allowed

    def written(self, x: float | None) -> str:
        """``x`` with the decimals that two digits of the standard uncertainty have; None is "open"."""
        if x is None:
            return "open"
        decimals = max(0, 1 - int(np.floor(np.log10(self.estimate.u))))
        return f"{x:.{decimals}f}"

    @property
    def sentence(self) -> str:
        """What the reader of the normal interval must know; empty where both intervals agree."""
        if not self.differs:
            return ""
        who = "both disks" if self.fit == "both" else f"{self.fit} disk"
        what, unit = WORDS[self.parameter], UNITS.get(self.parameter, "")
        ends = ((self.low95, "below", self.low_seen), (self.high95, "above", self.high_seen))
        say = self.written
        open_ends = [f"from {word} (followed to {say(seen)}{unit})" for end, word, seen in ends if end is None]
        if open_ends:
            return f"Joint fit, {who}: the data do not bound {what} {' nor '.join(open_ends)}."
        e = self.estimate
        return (
            f"Joint fit, {who}: 95 % of {what} reaches from {say(self.low95)} to {say(self.high95)}{unit} "
            f"by its profile, and from {say(e.low95)} to {say(e.high95)}{unit} by its standard uncertainty."
        )


def intervals(table: pd.DataFrame) -> tuple[ProfileInterval, ...]:
    """The 95 % interval of every profile of ``table``."""
    out = []
    for (fit, parameter), own in table.groupby(["fit", "parameter"], sort=False):
        value, deviance = own["value"].to_numpy(), own["deviance"].to_numpy()
        estimate = Estimate.normal(own["estimate"].iloc[0], own["u"].iloc[0])
        low, high = crossing(value[::-1], deviance[::-1]), crossing(value, deviance)
        out.append(ProfileInterval(str(fit), str(parameter), estimate, low, high, float(value[0]), float(value[-1])))
    return tuple(out)


def crossing(value: Array, deviance: Array) -> float | None:
    """Where the deviance first reaches 3.84 beyond its least, going along ``value``; None when it never does.

    Linear in the root of the deviance, exact for a parabola.
    """
    k = int(np.argmin(deviance))
    root = np.sqrt(np.maximum(deviance[k:], 0.0))
    beyond = np.flatnonzero(root >= Z95)
    if not len(beyond):
        return None
    j = int(beyond[0])
    part = (Z95 - root[j - 1]) / (root[j] - root[j - 1])
    return float(value[k + j - 1] + part * (value[k + j] - value[k + j - 1]))


def interval_table(table: pd.DataFrame) -> pd.DataFrame:
    """Every number of the joint fits with both intervals, and a sentence where they part."""
    rows = []
    for i in intervals(table):
        e = i.estimate
        rows.append(
            {
                "joint fit": "both disks" if i.fit == "both" else f"{i.fit} disk",
                "number": HEADINGS[i.parameter],
                "value": str(e),
                "95 %, normal": f"{i.written(e.low95)} … {i.written(e.high95)}",
                "95 %, profile": f"{i.written(i.low95)} … {i.written(i.high95)}",
                "remark": i.sentence,
            }
        )
    return pd.DataFrame(rows)


def profiles_file(table: pd.DataFrame) -> dict[str, Any]:
    """Profiles and intervals for ``beta.json``: by fit and number; an end that the data leave open is null."""
    out: dict[str, Any] = {}
    for i in intervals(table):
        own = table[(table["fit"] == i.fit) & (table["parameter"] == i.parameter)]
        out.setdefault(i.fit, {})[i.parameter] = {
            "low95": i.low95,
            "high95": i.high95,
            "differs": i.differs,
            "sentence": i.sentence,
            "value": own["value"].tolist(),
            "deviance": own["deviance"].tolist(),
        }
    return out
