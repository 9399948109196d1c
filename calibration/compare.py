"""Two records of one disk side by side: what drifted, and whether that is more than their uncertainties."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtr

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, messages, unique, warning, warnings_and_errors
from tcdyn.core.result import Result, jsonable
from tcdyn.rig.record import DiskRecord, moment, now_utc
from tcdyn.rig.rigfile import changed_keys
from tcdyn.rig.static_line import apply_static, line_doubts, outside_range, static_u

SIGNIFICANT = 0.05
OF_A_LOG = {
    "columns",
    "logger",
    "traceability",
    "constants",
    "ambient",
}  # of rig.toml, and no part of a disk


@dataclass(frozen=True)
class RecordDiff(Result):
    """One row a quantity: old, new, change, its standard uncertainty, z and two-sided p.

    ``significant`` is at the 5 % level after Holm's correction over all rows.
    """

    table: pd.DataFrame
    findings: tuple[Finding, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words."""
        return messages(self.findings)

    @property
    def significant(self) -> pd.DataFrame:
        """The rows whose change is significant."""
        return self.table[self.table["significant"]]

    def sentence(self) -> str:
        """The verdict in words."""
        drifted = list(self.significant["quantity"])
        if not drifted:
            return f"No significant drift in {len(self.table)} quantities."
        return f"{len(drifted)} of {len(self.table)} quantities drifted significantly: {', '.join(drifted)}."

    def summary(self) -> str:
        """The verdict and the notes."""
        return "\n".join([self.sentence(), *(f"info: {info}" for info in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """Sentence, notes and every row of the table."""
        return {
            "sentence": self.sentence(),
            "notes": list(self.notes),
            "quantities": jsonable(self.table),
        }

    def card(self) -> pd.DataFrame:
        """What drifted."""
        return self.significant


def diff_records(old: DiskRecord, new: DiskRecord) -> RecordDiff:
    """Changes from ``old`` to ``new``: each channel's reading at both ends of the common range [degC], and its lag
    [s].

    The two calibrations are taken as independent. Raises InputError for records of different disks.
    """
    if old.disk != new.disk:
        raise InputError(
            f"records of disk {old.disk!r} and of disk {new.disk!r}",
            expected="two calibrations of one disk",
        )
    rows: list[tuple[str, float, float, float]] = []
    found: list[Finding] = []
    by = [
        (r.setup.traceability.reference, r.setup.traceability.reference_certificate)
        for r in (old, new)
    ]
    other_reference = by[0] != by[1]  # one and the same moves no line against another
    for c in sorted(set(old.static) & set(new.static)):
        a = old.static[c]
        b = new.static[c]
        low = max(a.range_degC[0], b.range_degC[0])
        high = min(a.range_degC[1], b.range_degC[1])
        if low >= high:
            found.append(warning("record.ranges_apart", subject=c))
            continue
        for t in (low, high):
            logged = (t - a.offset) / a.gain
            u = float(np.hypot(static_u(a, t), static_u(b, t)))
            u = float(np.hypot(u, np.hypot(a.shared_u_K, b.shared_u_K))) if other_reference else u
            rows.append((f"{c} at {t:.0f} degC", t, float(apply_static(logged, b)), u))
    if old.chain is not None and new.chain is not None:
        for c in sorted(set(old.chain.channels) & set(new.chain.channels)):
            lags = [
                (r.chain.channels[c].lag_s, r.chain.differential_lag_s[c])
                for r in (old, new)
                if r.chain
            ]
            for name, before, after in zip((f"{c} lag_s", f"{c} differential lag_s"), *lags):
                rows.append((name, before.value, after.value, float(np.hypot(before.u, after.u))))
    # what of rig.toml the records were made with differs; names of columns and people have no part in a lag
    made = [
        r.setup.model_dump(exclude=OF_A_LOG) | {"conditioning": asdict(r.conditioning)}
        for r in (old, new)
    ]
    found += [
        info("record.changed", subject=key, was=was, now=now)
        for key, was, now in changed_keys(*made)
    ]
    if gone := sorted(set(old.static) ^ set(new.static)):
        found.append(warning("record.in_one_only", channels=gone))
    return RecordDiff(_holm(rows), tuple(found))


def _holm(rows: list[tuple[str, float, float, float]]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["quantity", "old", "new", "u"])
    table.insert(3, "change", table["new"] - table["old"])
    size = table["u"].to_numpy()
    change = table["change"].to_numpy()
    certain = np.where(change == 0.0, 0.0, np.copysign(np.inf, change))
    table["z"] = np.divide(change, size, out=certain, where=size > 0)
    table["p"] = 2 * ndtr(-np.abs(table["z"]))
    ranked = table["p"].sort_values(kind="stable")
    adjusted = (ranked * np.arange(len(ranked), 0, -1)).cummax()
    table["significant"] = adjusted < SIGNIFICANT  # by index, so back in the table's order
    return table


def check_record(record: DiskRecord) -> tuple[Finding, ...]:
    """What a careful reader would ask about a sound record; empty when nothing.

    What was noticed while it was made is among it; notes, which tell of what was mended in full, are not. A record of
    version 0.1 kept sentences only, so what the tests of its lines say is found anew from their numbers.
    """
    found = list(warnings_and_errors(record.findings))
    for c, line in record.static.items():
        found += warnings_and_errors(line_doubts(c, line))
    if missing := [c for c in sorted(record.setup.thermocouples) if c not in record.static]:
        found.append(warning("record.missing_channels", channels=missing))
    if moment(record.created) > moment(now_utc()):
        found.append(warning("record.future", created=record.created))
    for c, line in record.static.items():
        if abs(line.gain - 1) > 0.05:
            found.append(warning("record.gain", subject=c, gain=line.gain))
        if outside_range(line, [20.0, 160.0], margin_K=10.0).any():
            found.append(warning("record.range", subject=c, range_degC=line.range_degC))
        u = float(np.max(static_u(line, np.array(line.range_degC))))
        if u > 0.5:
            found.append(warning("record.line_unsure", subject=c, u_K=u))
    if record.chain is None:
        return unique([*found, warning("record.no_chain")])
    common = record.chain.common_lag_s
    for c, chain in record.chain.channels.items():
        lag = chain.lag_s
        apart = record.chain.differential_lag_s[c]
        if lag.u > 0.5 * lag.value:
            found.append(warning("record.lag_unsure", subject=c, lag_s=lag.value, u_s=lag.u))
        if abs(apart.value) > 0.5 * common.value and abs(apart.value) > 2 * apart.u:
            found.append(warning("record.lag_apart", subject=c, apart_s=apart.value, u_s=apart.u))
    return unique(found)
