"""Which chain structure the plunges speak for, and what the choice does to the lags: figures and sentences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.estimate import Estimate, rounded, with_u
from tcdyn.plunge.layout import STRUCTURES

Array = NDArray[np.float64]
MEANING: dict[str, str] = {
    "P1": "one lag",
    "P2": "two lags",
    "P1D": "one lag and a dead time",
    "P2D": "two lags and a dead time",
    "P2Z": "two lags and a zero",
    "P3": "three lags",
}
WORSE = 12.0  # of chi-square: a second lag that is not there gains less, with its split free in six channels
POSSIBLE = 0.05  # a structure less probable than this may be called contradicted, one above it is possible


@dataclass(frozen=True)
class StructureRow:
    """One structure: the common lag it gives, and how well it accounts for the plunges.

    ``chi_square`` (with the priors' part) and ``held_out`` count from the best structure, smaller is better;
    ``held_out`` is -2 log of the probability given to each plunge by the others, None for one plunge alone.
    ``second_lag_s``: of a second solution under the same structure, where it is possible too.
    """

    structure: str
    common_lag_s: Estimate
    chi_square: float
    probability: float
    held_out: float | None
    second_lag_s: Estimate | None = None


@dataclass(frozen=True)
class StructureComparison:
    """Every structure on the same plunges and noise; ``chosen`` is the one whose lags are reported.

    ``probability`` of the rows is by the evidence (Laplace, integrated over the common lag), structures equally
    likely beforehand; one lag, a special case of the others, counts by its likelihood and not for its simplicity.
    ``covariance`` (C, C) [s2] is the mean square of what the lags would be off by, were another structure true.
    """

    chosen: str
    rows: tuple[StructureRow, ...]
    covariance: Array
    u_before_s: float

    @property
    def own(self) -> StructureRow:
        """The row of the chosen structure."""
        return next(r for r in self.rows if r.structure == self.chosen)

    @property
    def best(self) -> StructureRow:
        """The most probable structure's row."""
        return max(self.rows, key=lambda r: r.probability)

    @property
    def u_structure_s(self) -> float:
        """Standard uncertainty that the choice of structure adds to the common lag [s]."""
        return float(np.sqrt(max(self.covariance.mean(), 0.0)))

    @property
    def u_after_s(self) -> float:
        """Standard uncertainty of the common lag, the choice of structure included [s]."""
        return float(np.hypot(self.u_before_s, self.u_structure_s))

    @property
    def contradicted(self) -> bool:
        """Whether the plunges speak against the chosen structure: improbable, and a clearly worse fit."""
        return self.own.probability < POSSIBLE and self.own.chi_square - self.best.chi_square > WORSE

    @property
    def rivals(self) -> tuple[StructureRow, ...]:
        """Structures other than the chosen one that the plunges leave possible, the most probable first."""
        others = [r for r in self.rows if r.structure != self.chosen and r.probability >= POSSIBLE]
        return tuple(sorted(others, key=lambda r: -r.probability))

    @property
    def sentence(self) -> str:
        """What the plunges say about the structure, in one sentence with figures."""
        return f"{self._told()}{self._second()}; {self._widened()}{self._remedy()}"

    def _told(self) -> str:
        own, best = self.own, self.best
        if self.contradicted:
            return (
                f"the plunges contradict chain {named(own)}: {named(best)} is {odds(best, own)} times as probable "
                f"(chi-square lower by {own.chi_square - best.chi_square:.0f}) and gives a common lag of "
                f"{plain(best.common_lag_s)} instead of {plain(own.common_lag_s)}"
            )
        if not self.rivals:
            return f"of {len(self.rows)} chain structures the plunges speak for {named(own)} ({percent(own)})"
        others = " or ".join(judged_words(r) for r in self.rivals)
        return f"the plunges cannot tell chain {judged_words(own)} from {others}"

    def _second(self) -> str:
        lag = self.own.second_lag_s
        return "" if lag is None else f", and a lag of {plain(lag)} under another entry burst is possible too"

    def _remedy(self) -> str:
        if not self.contradicted:
            return ""
        if self.best.structure not in STRUCTURES:
            return "; a record holds two lags: take the common lag from an unloading"
        return f"; calibrate with --structure {self.best.structure}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentence, when the structure is contradicted, or adds more to the lag's u than all else together."""
        return (self.sentence,) if self.contradicted or self.u_structure_s > self.u_before_s else ()

    def _widened(self) -> str:
        before, after = (rounded(u, u)[1] for u in (self.u_before_s, self.u_after_s))
        if before == after:
            return "the common lag hardly depends on it"
        return f"the standard uncertainty of the common lag was widened from {before} s to {after} s for it"

    def table(self) -> pd.DataFrame:
        """One row a structure, for people."""
        held = any(r.held_out is not None for r in self.rows)
        rows = []
        for r in self.rows:
            row = {
                "chain": named(r) + (", used here" if r.structure == self.chosen else ""),
                "probability": percent(r),
                "chi-square above the best": f"{r.chi_square:.1f}",
            }
            if held:
                row["held-out plunge, above the best"] = "" if r.held_out is None else f"{r.held_out:.1f}"
            rows.append({**row, "common lag [s]": with_u(r.common_lag_s.value, r.common_lag_s.u)})
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, object]:
        """As the record's ``fit.structures`` keeps it."""
        return {
            "chosen": self.chosen,
            "sentence": self.sentence,
            "contradicted": self.contradicted,
            "u_common_lag_before_s": self.u_before_s,
            "u_common_lag_after_s": self.u_after_s,
            "candidates": [
                {
                    "structure": r.structure,
                    "probability": r.probability,
                    "chi_square": r.chi_square,
                    "held_out": r.held_out,
                    "common_lag_s": r.common_lag_s.model_dump(),
                    "second_lag_s": None if r.second_lag_s is None else r.second_lag_s.model_dump(),
                }
                for r in self.rows
            ],
        }


def named(row: StructureRow) -> str:
    """The structure's name and what it is."""
    return f"{row.structure} ({MEANING[row.structure]})"


def judged_words(row: StructureRow) -> str:
    """The structure with its probability and its common lag."""
    return f"{row.structure} ({MEANING[row.structure]}: {percent(row)}, {plain(row.common_lag_s)})"


def plain(lag: Estimate) -> str:
    """A lag without its interval."""
    return with_u(lag.value, lag.u, "s")


def percent(row: StructureRow) -> str:
    """A probability as people say it."""
    share = 100 * row.probability
    if share < 0.1 or share > 99.9:
        return "below 0.1 %" if share < 50 else "above 99.9 %"
    return f"{share:.1f} %" if share < 1 or share > 99 else f"{share:.0f} %"


def odds(one: StructureRow, other: StructureRow) -> str:
    """How many times as probable ``one`` is."""
    ratio = one.probability / max(other.probability, 1e-300)
    return "more than a million" if ratio > 1e6 else f"{float(f'{ratio:.2g}'):.0f}"
