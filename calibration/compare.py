"""Compare two records of one disk: which quantities drifted significantly (Holm's correction).

:func:`compare_records` is ``tcdyn rig record diff``, :func:`check_record` is
``tcdyn rig record check`` (``tcdyn.cli.record``); both are used by the certificate, too.
``SIGNIFICANCE`` decides which changes are significant; the other thresholds decide warnings only.
They are chosen by judgement where no other reason is given. Tests: ``tests/rig/test_record.py`` and
``tests/calibration/test_budget.py``.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtr

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, messages, unique, warning, warnings_and_errors
from tcdyn.core.result import Result, jsonable
from tcdyn.rig.record import DiskRecord, now_utc, parse_time
from tcdyn.rig.rigfile import changed_keys
from tcdyn.rig.static_line import (
    StaticLine,
    apply_static,
    findings_of_tests,
    outside_range,
    static_u,
)

# Level of the family of tests: decides ``RecordComparison.significant``, the sentence and what
# ``tcdyn rig record diff`` lists.
SIGNIFICANCE = 0.05
# Tables of rig.toml that describe logs and people, not the disk.
LOG_TABLES = {"columns", "logger", "traceability", "constants", "ambient"}
# A gain further from one gives a warning. Chosen by judgement.
MAX_GAIN_DEVIATION = 0.05
# The range of a rolling-contact test [degC], which the static lines should cover.
TEST_RANGE_DEGC = [20.0, 160.0]
# A larger standard uncertainty of a static line in its range gives a warning [K].
MAX_LINE_U_K = 0.5
# Larger relative uncertainties, and larger relative differences from the common lag, give a
# warning.
MAX_RELATIVE_LAG_U = 0.5
MAX_RELATIVE_LAG_DIFFERENCE = 0.5


class Change(NamedTuple):
    """A quantity in both records, and the standard uncertainty of the change.

    Parameters
    ----------
    quantity
        Name of the quantity.
    old, new
        Values in the two records.
    u
        Standard uncertainty of the change.
    """

    quantity: str
    old: float
    new: float
    u: float


@dataclass(frozen=True, repr=False)
class RecordComparison(Result):
    """Comparison of two records.

    Parameters
    ----------
    table
        One row a quantity: old, new, change, its standard uncertainty, z, two-sided p, and whether
        the change is significant at the 5 % level after Holm's correction over all rows.
    findings
        Findings about the comparison.
    """

    table: pd.DataFrame
    findings: tuple[Finding, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return messages(self.findings)

    @property
    def significant(self) -> pd.DataFrame:
        """The rows whose change is significant."""
        return self.table[self.table["significant"]]

    def sentence(self) -> str:
        """The conclusion in one sentence."""
        drifted = list(self.significant["quantity"])
        if not drifted:
            return f"No significant drift in {len(self.table)} quantities."
        return (
            f"{len(drifted)} of {len(self.table)} quantities drifted significantly: "
            f"{', '.join(drifted)}."
        )

    def summary(self) -> str:
        """The conclusion and the findings."""
        return "\n".join([self.sentence(), *(f"info: {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """Conclusion, findings and every row of the table."""
        return {
            "sentence": self.sentence(),
            "notes": list(self.notes),
            "quantities": jsonable(self.table),
        }

    def to_frame(self) -> pd.DataFrame:
        """The table by quantity; units are in its names."""
        return self.table.set_index("quantity")

    def card(self) -> pd.DataFrame:
        """The quantities that drifted."""
        return self.significant


def compare_records(old: DiskRecord, new: DiskRecord) -> RecordComparison:
    """Changes from ``old`` to ``new``; the two calibrations are taken as independent.

    Compared are each channel's reading at both ends of the common range [degC], its lag and its
    differential lag [s].

    Parameters
    ----------
    old, new
        Two calibrations of one disk.

    Returns
    -------
    RecordComparison
        One row for each quantity. The findings name channels without a common range, changed keys
        of rig.toml except those of ``LOG_TABLES``, and channels that only one record has.

    Raises
    ------
    InputError
        Records of different disks.

    Notes
    -----
    An error of one common reference cancels in the change; with two references both enter. The
    quantities of one channel are correlated, for which Holm's correction is valid. References are
    the same where name and certificate in ``[traceability]`` are equal, also if both are empty.

    The day of the next calibration (``calibration.decisions.next_calibration``) reads the rows
    whose name ends in "degC": keep these names. Guarded by ``tests/rig/test_record.py`` and
    ``tests/calibration/test_budget.py``.
    """
    if old.disk != new.disk:
        raise InputError(
            f"records of disk {old.disk!r} and of disk {new.disk!r}",
            expected="two calibrations of one disk",
        )
    changes: list[Change] = []
    findings: list[Finding] = []
    # an error of one common reference cancels in the change
    is_same_reference = _reference_thermometer(old) == _reference_thermometer(new)
    for channel in sorted(set(old.static) & set(new.static)):
        line_changes = _line_changes(
            channel, old.static[channel], new.static[channel], is_same_reference
        )
        if not line_changes:
            findings.append(warning("record.ranges_apart", subject=channel))
        changes += line_changes
    changes += _lag_changes(old, new)
    for key, before, after in changed_keys(_disk_tables(old), _disk_tables(new)):
        findings.append(info("record.changed", subject=key, was=before, now=after))
    in_one_only = sorted(set(old.static) ^ set(new.static))
    if in_one_only:
        findings.append(warning("record.in_one_only", channels=in_one_only))
    return RecordComparison(_holm_table(changes), tuple(findings))


def _reference_thermometer(record: DiskRecord) -> tuple[str, str]:
    """The reference thermometer of a record and its certificate.

    Returns
    -------
    reference, certificate
        Names, as written in ``rig.toml``.
    """
    table = record.setup.traceability
    return table.reference, table.reference_certificate


def _disk_tables(record: DiskRecord) -> dict[str, Any]:
    """The tables of rig.toml that a lag may depend on."""
    tables = record.setup.model_dump(exclude=LOG_TABLES)
    return tables | {"conditioning": asdict(record.conditioning)}


def _line_changes(
    channel: str, old: StaticLine, new: StaticLine, is_same_reference: bool
) -> list[Change]:
    """Change of a reading at both ends of the common range; empty if there is no common range.

    Parameters
    ----------
    channel
        Name of the channel.
    old, new
        Its static lines.
    is_same_reference
        Whether both calibrations used one reference with one certificate.

    Notes
    -----
    The old line gives what was logged at a temperature; the new line then reads the same log.
    """
    low = max(old.range_degC[0], new.range_degC[0])
    high = min(old.range_degC[1], new.range_degC[1])
    if low >= high:
        return []
    changes: list[Change] = []
    for t in (low, high):
        logged = (t - old.offset) / old.gain
        u = float(np.hypot(static_u(old, t), static_u(new, t)))
        if not is_same_reference:
            u = float(np.hypot(u, np.hypot(old.shared_u_K, new.shared_u_K)))
        after = float(apply_static(logged, new))
        changes.append(Change(f"{channel} at {t:.0f} degC", t, after, u))
    return changes


def _lag_changes(old: DiskRecord, new: DiskRecord) -> list[Change]:
    """Change of lag and differential lag of each channel that has a chain in both records.

    Parameters
    ----------
    old, new
        The two records.
    """
    if old.chain is None or new.chain is None:
        return []
    changes: list[Change] = []
    for channel in sorted(set(old.chain.channels) & set(new.chain.channels)):
        pairs = {
            "lag_s": (old.chain.channels[channel].lag_s, new.chain.channels[channel].lag_s),
            "differential lag_s": (
                old.chain.differential_lag_s[channel],
                new.chain.differential_lag_s[channel],
            ),
        }
        for name, (before, after) in pairs.items():
            u = float(np.hypot(before.u, after.u))
            changes.append(Change(f"{channel} {name}", before.value, after.value, u))
    return changes


def _holm_table(changes: list[Change]) -> pd.DataFrame:
    """The table of changes with z, p and their significance by Holm's step-down procedure.

    Notes
    -----
    Holm (1979): p-values in rising order times the number of those that remain, made monotonic. The
    level is ``SIGNIFICANCE``. Test: ``tests/rig/test_record.py``.
    """
    table = pd.DataFrame(changes, columns=["quantity", "old", "new", "u"])
    table.insert(3, "change", table["new"] - table["old"])
    u = table["u"].to_numpy()
    change = table["change"].to_numpy()
    z_if_exact = np.where(change == 0.0, 0.0, np.copysign(np.inf, change))
    table["z"] = np.divide(change, u, out=z_if_exact, where=u > 0)
    table["p"] = 2 * ndtr(-np.abs(table["z"]))
    ranked = table["p"].sort_values(kind="stable")
    adjusted = (ranked * np.arange(len(ranked), 0, -1)).cummax()
    table["significant"] = adjusted < SIGNIFICANCE  # aligned by index
    return table


def check_record(record: DiskRecord) -> tuple[Finding, ...]:
    """Warnings about a valid record; empty if there are none.

    They include the warnings of the calibration, but not its information. A record of version 0.1
    holds sentences only, so the tests of its lines are evaluated again from their p-values.

    Parameters
    ----------
    record
        A valid record.

    Returns
    -------
    findings
        Warnings and errors, each once.
    """
    findings = list(warnings_and_errors(record.findings))
    for channel, line in record.static.items():
        findings += warnings_and_errors(findings_of_tests(channel, line))
    missing = [c for c in sorted(record.setup.thermocouples) if c not in record.static]
    if missing:
        findings.append(warning("record.missing_channels", channels=missing))
    if parse_time(record.created) > parse_time(now_utc()):
        findings.append(warning("record.future", created=record.created))
    for channel, line in record.static.items():
        findings += _check_line(channel, line)
    findings += _check_lags(record)
    return unique(findings)


def _check_line(channel: str, line: StaticLine) -> list[Finding]:
    """Warnings about gain, range and uncertainty of a static line.

    Parameters
    ----------
    channel, line
        Name of the channel and its static line.

    Notes
    -----
    ``MAX_GAIN_DEVIATION``, ``TEST_RANGE_DEGC`` (with a margin of 10 K) and ``MAX_LINE_U_K`` decide
    warnings only.
    """
    findings: list[Finding] = []
    if abs(line.gain - 1) > MAX_GAIN_DEVIATION:
        findings.append(warning("record.gain", subject=channel, gain=line.gain))
    if outside_range(line, TEST_RANGE_DEGC, margin_K=10.0).any():
        findings.append(warning("record.range", subject=channel, range_degC=line.range_degC))
    u = float(np.max(static_u(line, np.array(line.range_degC))))
    if u > MAX_LINE_U_K:
        findings.append(warning("record.line_unsure", subject=channel, u_K=u))
    return findings


def _check_lags(record: DiskRecord) -> list[Finding]:
    """Warnings about uncertain lags, and about lags far from the common lag of the disk.

    A lag is uncertain above ``MAX_RELATIVE_LAG_U``. It is far from the common lag above
    ``MAX_RELATIVE_LAG_DIFFERENCE``, if the difference also exceeds twice its uncertainty.
    """
    if record.chain is None:
        return [warning("record.no_chain")]
    findings: list[Finding] = []
    common = record.chain.common_lag_s
    for channel, chain in record.chain.channels.items():
        lag = chain.lag_s
        difference = record.chain.differential_lag_s[channel]
        if lag.u > MAX_RELATIVE_LAG_U * lag.value:
            findings.append(
                warning("record.lag_unsure", subject=channel, lag_s=lag.value, u_s=lag.u)
            )
        is_large = abs(difference.value) > MAX_RELATIVE_LAG_DIFFERENCE * common.value
        if is_large and abs(difference.value) > 2 * difference.u:
            findings.append(
                warning(
                    "record.lag_apart",
                    subject=channel,
                    apart_s=difference.value,
                    u_s=difference.u,
                )
            )
    return findings
