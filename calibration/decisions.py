"""Decisions about a calibrated disk: fit to use, traceable, and when to calibrate it again.

Sources: JCGM 106:2012 and ILAC-G8:09/2019 for the decision rule; ISO/IEC 17025:2017, 7.8.

Used by the certificate (:mod:`tcdyn.report.certificate`). Tests:
``tests/calibration/test_budget.py``
and ``tests/report/test_certificate.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from typing import Any

from calibration.budget import UncertaintyBudget, expanded_of_skewed, uncertainty_budget
from calibration.compare import check_record, compare_records
from tcdyn.core.estimate import Estimate, text_with_u
from tcdyn.core.findings import messages
from tcdyn.rig.record import DiskRecord, parse_time
from tcdyn.rig.tables import YEAR_DAYS

MIN_YEARS = 0.05  # between two calibrations for a rate of drift; chosen by judgement
MAX_DAYS = 3653  # until the next calibration: ten years; chosen by judgement
CHANNEL_FINDINGS = (
    "line",
    "record",
    "plunge",
    "noise",
    "junctions",
    "from_file",
)  # first part of codes
EXTRAPOLATED = "line.extrapolated"  # a plunge beyond the range of the oven
FIT_TO_USE = "fit to use"  # verdict on a thermocouple without a finding


def has_oven_lines(record: DiskRecord) -> bool:
    """Return whether the static lines come from an oven and not from the user."""
    return not any(finding.code == "static.stated" for finding in record.findings)


def simulated_files(record: DiskRecord) -> list[str]:
    """Return the names of the logs that are simulated by their metadata."""
    return [str(finding.subject) for finding in record.findings if finding.code == "log.simulated"]


def draft_reasons(record: DiskRecord) -> list[str]:
    """Return why the page is no calibration certificate; empty for one that is."""
    reasons = []
    missing = record.setup.traceability.missing_entries
    if missing:
        reasons.append(f"[traceability] of rig.toml does not state {', '.join(missing)}")
    if not has_oven_lines(record):
        reasons.append("without an oven log the readings at rest are not traceable")
    simulated = simulated_files(record)
    if simulated:
        reasons.append(f"simulated: {', '.join(simulated)}")
    return reasons


def calibrated_on(record: DiskRecord) -> date:
    """Return the day of the calibration."""
    return parse_time(record.created).date()


def channel_budget(record: DiskRecord, channel: str, temperature_degC: float) -> UncertaintyBudget:
    """Return the uncertainty budget of one channel at rest.

    Parameters
    ----------
    record
        The record.
    channel
        Name of the channel.
    temperature_degC
        Temperature of the reading.
    """
    line = record.static[channel]
    return uncertainty_budget(
        line, record.setup.traceability, calibrated_on(record), temperature_degC
    )


def lag_of_channel(record: DiskRecord, channel: str) -> Estimate | None:
    """Return the lag of a channel; None if the record does not have it."""
    if record.chain is None or channel not in record.chain.channels:
        return None
    return record.chain.channels[channel].lag_s


def tolerance_faults(record: DiskRecord, channel: str) -> list[str]:
    """Return in what a channel does not meet the decision rule; empty if it meets it.

    Parameters
    ----------
    record
        The record.
    channel
        Name of the channel.

    Notes
    -----
    Guarded acceptance with the guard band w = U: accepted if |error| <= tolerance - U. The error
    of a corrected reading, and of a lag that is removed, is estimated as zero, so this is
    U <= tolerance. Sources: :func:`tcdyn.report.formal.decision_rule`. U at rest is largest at an
    end of the range.
    """
    stated = record.setup.traceability
    faults = []
    expanded_K, t = max(
        (channel_budget(record, channel, t).expanded, t) for t in record.static[channel].range_degC
    )
    if expanded_K > stated.tolerance_K:
        faults.append(
            f"U = {expanded_K:.2g} K at {t:.0f} degC exceeds the tolerance of "
            f"{stated.tolerance_K:g} K"
        )
    lag_s = lag_of_channel(record, channel)
    if lag_s is None:
        return faults
    expanded_s, _ = expanded_of_skewed(lag_s)
    if expanded_s > stated.lag_tolerance_s:
        faults.append(
            f"U = {expanded_s:.2g} s of its lag exceeds the tolerance of "
            f"{stated.lag_tolerance_s:g} s"
        )
    return faults


def range_temperatures(record: DiskRecord) -> list[float]:
    """Return lowest, middle and highest temperature of the range common to all channels [degC]."""
    low = max(line.range_degC[0] for line in record.static.values())
    high = min(line.range_degC[1] for line in record.static.values())
    return [low, 0.5 * (low + high), high]


def widest(record: DiskRecord) -> tuple[str, float]:
    """Return channel and temperature [degC] of the largest expanded uncertainty at rest.

    Returns
    -------
    channel
        Name of the channel.
    temperature_degC
        One of :func:`range_temperatures`.
    """
    cases = [(channel, t) for channel in sorted(record.static) for t in range_temperatures(record)]
    return max(cases, key=lambda case: channel_budget(record, *case).expanded)


def next_calibration(record: DiskRecord, earlier: Sequence[DiskRecord] = ()) -> tuple[date, str]:
    """Return the day of the next calibration, and the reason.

    It is ``valid_days`` after this one, or sooner where a channel drifts: the fastest drift of any
    channel between the last of ``earlier`` and this record, plus its standard uncertainty, must not
    exceed ``limit_K`` before that day.

    Parameters
    ----------
    record
        The present record.
    earlier
        Records of the same disk.

    Returns
    -------
    day
        Day of the next calibration.
    reason
        One sentence.

    Notes
    -----
    ``MIN_YEARS`` keeps the scatter of two calibrations from being taken as a drift. ``MAX_DAYS``
    only keeps the computed day finite; ``valid_days`` may not be longer. Test:
    ``tests/calibration/test_budget.py``.
    """
    traceability = record.setup.traceability
    today = calibrated_on(record)
    latest = today + timedelta(days=traceability.valid_days)
    default = (
        f"no later than {latest}, {traceability.valid_days} days after this one ([traceability] "
        "valid_days)"
    )
    comparable = []
    for candidate in earlier:
        age_days = (today - calibrated_on(candidate)).days
        if (
            age_days > MIN_YEARS * YEAR_DAYS
            and has_oven_lines(candidate)
            and has_oven_lines(record)
        ):
            comparable.append(candidate)
    if not comparable:
        return latest, f"{default}; no earlier record was given that determines its drift"
    last = max(comparable, key=calibrated_on)
    last_day = calibrated_on(last)
    years = (today - last_day).days / YEAR_DAYS
    table = compare_records(last, record).table
    changes = table[table["quantity"].str.endswith("degC")].to_dict("records")
    if not any(_largest_change(row) > 0 for row in changes):
        return latest, f"{default}; the earlier record shares no range of temperature with this one"
    fastest = max(changes, key=_largest_change)
    drift = text_with_u(fastest["change"] / years, fastest["u"] / years, "K a year")
    rate_K_year = _largest_change(fastest) / years
    days = int(min(traceability.limit_K / rate_K_year * YEAR_DAYS, MAX_DAYS))
    due = today + timedelta(days=days)
    if due >= latest:
        return latest, f"{default}; the largest drift since {last_day}, {drift}, allows longer"
    return due, (
        f"no later than {due}: {fastest['quantity']} drifted by {drift} since {last_day}, and may "
        f"drift by {traceability.limit_K:g} K until then"
    )


def _largest_change(row: Mapping[Any, Any]) -> float:
    """Return the size of a change plus its standard uncertainty [K]."""
    return abs(row["change"]) + row["u"]


def channel_verdicts(record: DiskRecord) -> dict[str, str]:
    """Return a sentence on each thermocouple: fit to use, or what is wrong with it.

    The rule is :func:`tcdyn.report.formal.decision_rule`. A gap or an impossible value in a log, or
    a plunge beyond the oven's range, is no fault of a thermocouple.

    Parameters
    ----------
    record
        The record.

    Returns
    -------
    verdicts
        By channel.

    Notes
    -----
    ``CHANNEL_FINDINGS`` names the kinds of findings that count against a thermocouple. A new kind
    that should count must be added there.
    """
    findings = [
        finding
        for finding in check_record(record)
        if finding.code.partition(".")[0] in CHANNEL_FINDINGS and finding.code != EXTRAPOLATED
    ]
    verdicts: dict[str, str] = {}
    for name in sorted(record.static):
        faults = [finding for finding in findings if name in finding.channels]
        texts = [*messages(faults), *tolerance_faults(record, name)]
        verdicts[name] = "; ".join(texts) or FIT_TO_USE
    return verdicts
