"""Signed part of a certificate: identification, results, uncertainty by source, validity, limits.

Sources: JCGM 100:2008 (GUM), 7.2; ISO/IEC 17025:2017, 7.8.2 and 7.8.4.

Used by :mod:`tcdyn.report.certificate`. Tests: ``tests/calibration/test_budget.py``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from typing import Any

import pandas as pd

from calibration.budget import UncertaintyBudget, uncertainty_budget
from calibration.compare import compare_records
from tcdyn.core.estimate import rounded_texts, text_with_u
from tcdyn.report.page import Section
from tcdyn.rig.record import DiskRecord, parse_time
from tcdyn.rig.tables import YEAR_DAYS
from tcdyn.version import __version__

# Texts of the certificate.
NOT_STATED = "not stated"
OVEN = "oven against a PRT, straight lines"
NO_OVEN = "readings at rest taken as logged, their uncertainty stated"
MIN_YEARS = 0.05  # between two calibrations for a rate of drift; chosen by judgement
MAX_DAYS = 3653  # until the next calibration: ten years; chosen by judgement
# Texts of the certificate on limits, and on the symbols of its table.
NOT_MEASURED = (
    "Not measured: depth and place of the junctions (as drawn), the conditioning filter (its data "
    "sheet), immersion errors of the reference in the oven, thermocouple inhomogeneity along the "
    "wire, slip rings in rotation, temperatures outside the range of the holds. The results are "
    "those of this disk with this wiring and logger only."
)
ABOUT = (
    "U = k u is the expanded uncertainty for 95 % (GUM, 6.2), k Student's factor at the effective "
    "degrees of freedom (Welch and Satterthwaite). A correction is what was to be added to a "
    "logged value; lines have it in them."
)


def has_oven_lines(record: DiskRecord) -> bool:
    """Return whether the static lines come from an oven and not from the user."""
    return not any(finding.code == "static.stated" for finding in record.findings)


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


def identification(record: DiskRecord) -> pd.DataFrame:
    """Return laboratory, customer, item, reference, instruments, days and software as rows."""
    t = record.setup.traceability
    sensors = f"{len(record.static)} thermocouples"
    channels = ", ".join(record.static)
    if has_oven_lines(record):
        method = OVEN
        reference = _instrument(t.reference, t.reference_certificate, t.reference_date)
    else:
        method = NO_OVEN
        reference = "none: no oven, the readings at rest are not traceable"
    received = t.received or NOT_STATED
    rows = {
        "Certificate": t.certificate,
        "Laboratory": ", ".join(x for x in (t.laboratory, t.address) if x),
        "Place of calibration": t.place,
        "Customer": t.customer,
        "Item": f"{sensors} of the {record.disk} disk, channels {channels}",
        "Received; calibrated": f"{received}; {calibrated_on(record)}",
        "Procedure": t.procedure or f"{method}; plunges, grey-box fit of the chain",
        "Reference": reference,
        "Logger": _instrument(t.logger, t.logger_certificate, t.logger_date),
        "Software": f"tcdyn {__version__}; checksums of all logs below",
    }
    values = [value or NOT_STATED for value in rows.values()]
    return pd.DataFrame({"": list(rows), "stated": values})


def _instrument(name: str, certificate: str, day: str) -> str:
    """Return an instrument with its certificate and the day of that.

    Parameters
    ----------
    name, certificate, day
        As in ``[traceability]``; empty: not stated.
    """
    if not name and not certificate:
        return NOT_STATED
    certificate_day = day or "a day not stated"
    return f"{name or NOT_STATED}; certificate {certificate or NOT_STATED} of {certificate_day}"


def temperatures(record: DiskRecord) -> list[float]:
    """Return lowest, middle and highest temperature of the range common to all channels [degC]."""
    low = max(line.range_degC[0] for line in record.static.values())
    high = min(line.range_degC[1] for line in record.static.values())
    return [low, 0.5 * (low + high), high]


def results(record: DiskRecord) -> pd.DataFrame:
    """Return correction and expanded uncertainty at three temperatures, and lag, by channel."""
    rows = []
    for channel, line in sorted(record.static.items()):
        row = {"channel": channel}
        for t in temperatures(record):
            logged = (t - line.offset) / line.gain
            expanded = channel_budget(record, channel, t).expanded
            correction_text, expanded_text = rounded_texts(t - logged, expanded)
            row[f"correction at {t:.0f} degC [K]"] = correction_text
            row[f"U at {t:.0f} degC [K]"] = expanded_text
        if record.chain is not None:
            chain = record.chain.channels.get(channel)
            row["lag [s]"] = ""
            row["95 % interval [s]"] = ""
            if chain is not None:
                row["lag [s]"] = rounded_texts(chain.lag_s.value, chain.lag_s.u)[0]
                row["95 % interval [s]"] = chain.lag_s.interval_text
        rows.append(row)
    return pd.DataFrame(rows)


def budget_table(budget: UncertaintyBudget) -> pd.DataFrame:
    """Return the budget as in the GUM."""
    rows = []
    for source in budget.sources:
        rows.append(
            {
                "source": source.name,
                "estimate": f"{source.estimate:.4g}",
                "u": f"{source.u:.2g}",
                "distribution": source.distribution,
                "sensitivity": f"{source.sensitivity:.3g}",
                "contribution [K]": f"{source.contribution:.2g}",
                "degrees of freedom": _freedom(source.dof),
            }
        )
    combined = {
        "source": f"combined; U = {budget.expanded:.2g} K with k = {budget.coverage:.2f}",
        "contribution [K]": f"{budget.u:.2g}",
        "degrees of freedom": _freedom(budget.dof),
    }
    return pd.DataFrame([*rows, combined]).fillna("")


def _freedom(dof: float) -> str:
    """Return degrees of freedom as text."""
    return "infinite" if math.isinf(dof) or dof > 1e6 else f"{dof:.0f}"


def widest(record: DiskRecord) -> tuple[str, float]:
    """Return channel and temperature [degC] of the largest expanded uncertainty at rest.

    Returns
    -------
    channel
        Name of the channel.
    temperature_degC
        One of :func:`temperatures`.
    """
    cases = [(channel, t) for channel in sorted(record.static) for t in temperatures(record)]
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


def signed_sections(record: DiskRecord, earlier: Sequence[DiskRecord] = ()) -> list[Section]:
    """Return the first pages of a certificate.

    Identification, results, budget, validity, signatures and files.

    Parameters
    ----------
    record
        The record.
    earlier
        Records of the same disk, for its drift.
    """
    channel, temperature_degC = widest(record)
    budget = channel_budget(record, channel, temperature_degC)
    _, reason = next_calibration(record, earlier)
    changes = "Where the disk, a junction, a cable or the logger is changed, it ends that day."
    files = pd.DataFrame([file.model_dump() for file in record.inputs])
    calibrated_by = record.created_by or NOT_STATED
    authorised_by = record.setup.traceability.authorised_by or NOT_STATED
    signatures = pd.DataFrame(
        {
            "": ["Calibrated by", "Authorised by"],
            "name": [calibrated_by, authorised_by],
            "date": ["\u2003" * 8, "\u2003" * 8],
            "signature": ["\u2003" * 14, "\u2003" * 14],
        }
    )
    return [
        Section("Identification and traceability", table=identification(record)),
        Section("Results", ABOUT, table=results(record)),
        Section(
            f"Budget: channel {channel} at {temperature_degC:.0f} degC, the least certain",
            table=budget_table(budget),
        ),
        Section("Validity", f"Next calibration {reason}. {changes}\n\n{NOT_MEASURED}"),
        Section("Signatures", table=signatures),
        Section("Made from", table=files if len(files) else None),
    ]
