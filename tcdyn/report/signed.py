"""What makes a certificate one that can be signed: who and what, uncertainty by source, validity, what is left out.

Sources: JCGM 100:2008 (GUM), 7.2; ISO/IEC 17025:2017, 7.8.2 and 7.8.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import date, timedelta

import pandas as pd

from calibration.budget import RestBudget, rest_budget
from calibration.compare import diff_records
from tcdyn.core.estimate import rounded, with_u
from tcdyn.report.page import Section
from tcdyn.rig.record import DiskRecord, moment
from tcdyn.rig.traceability import YEAR_DAYS
from tcdyn.version import __version__

NOT_STATED = "not stated"
OVEN = "oven against a PRT, straight lines"
NO_OVEN = "readings at rest taken as logged, their uncertainty stated"
LEAST_YEARS = 0.05  # between two calibrations, for a rate of drift
NOT_MEASURED = (
    "Not measured: depth and place of the junctions (as drawn), the conditioning filter (its data sheet), immersion "
    "errors of the reference in the oven, thermocouple inhomogeneity along the wire, slip rings in rotation, "
    "temperatures outside the range of the holds. The results are those of this disk with this wiring and logger only."
)
ABOUT = (
    "U = k u is the expanded uncertainty for 95 % (GUM, 6.2), k Student's factor at the effective degrees of freedom "
    "(Welch and Satterthwaite). A correction is what was to be added to a logged value; lines have it in them."
)


def in_oven(record: DiskRecord) -> bool:
    """Whether the static lines come from an oven, and were not stated."""
    return not any(f.code == "static.stated" for f in record.findings)


def calibrated_on(record: DiskRecord) -> date:
    """The day of the calibration."""
    return moment(record.created).date()


def budget_of(record: DiskRecord, channel: str, temperature_degC: float) -> RestBudget:
    """The budget of one channel at rest, as the record keeps what it needs."""
    return rest_budget(
        record.static[channel], record.setup.traceability, calibrated_on(record), temperature_degC
    )


def identification(record: DiskRecord) -> pd.DataFrame:
    """Laboratory, customer, item, reference and instruments, days and software, one row each."""
    t = record.setup.traceability
    by = _instrument(t.reference, t.reference_certificate, t.reference_date)
    rows = [
        ("Certificate", t.certificate),
        ("Laboratory", ", ".join(x for x in (t.laboratory, t.address) if x)),
        ("Place of calibration", t.place),
        ("Customer", t.customer),
        (
            "Item",
            f"{len(record.static)} thermocouples of the {record.disk} disk, channels {', '.join(record.static)}",
        ),
        ("Received; calibrated", f"{t.received or NOT_STATED}; {calibrated_on(record)}"),
        (
            "Procedure",
            t.procedure
            or f"{OVEN if in_oven(record) else NO_OVEN}; plunges, grey-box fit of the chain",
        ),
        (
            "Reference",
            by if in_oven(record) else "none: no oven, the readings at rest are not traceable",
        ),
        ("Logger", _instrument(t.logger, t.logger_certificate, t.logger_date)),
        ("Software", f"tcdyn {__version__}; checksums of all logs below"),
    ]
    return pd.DataFrame([(name, said or NOT_STATED) for name, said in rows], columns=["", "stated"])


def _instrument(name: str, certificate: str, day: str) -> str:
    if not name and not certificate:
        return NOT_STATED
    return f"{name or NOT_STATED}; certificate {certificate or NOT_STATED} of {day or 'a day not stated'}"


def temperatures(record: DiskRecord) -> list[float]:
    """Lowest, middle and highest temperature that all channels were calibrated at [degC]."""
    low = max(line.range_degC[0] for line in record.static.values())
    high = min(line.range_degC[1] for line in record.static.values())
    return [low, 0.5 * (low + high), high]


def results(record: DiskRecord) -> pd.DataFrame:
    """Of each channel at rest at three temperatures: correction and expanded uncertainty; and its lag with U."""
    rows = []
    for channel, line in sorted(record.static.items()):
        row = {"channel": channel}
        for t in temperatures(record):
            found = budget_of(record, channel, t)
            logged = (t - line.offset) / line.gain
            correction, expanded = rounded(t - logged, found.expanded)
            row[f"correction at {t:.0f} degC [K]"] = correction
            row[f"U at {t:.0f} degC [K]"] = expanded
        rows.append(row)
    table = pd.DataFrame(rows)
    if record.chain is not None:
        lags = {c: x.lag_s for c, x in record.chain.channels.items()}
        table["lag [s]"] = [
            rounded(lags[c].value, lags[c].u)[0] if c in lags else "" for c in table["channel"]
        ]
        table["95 % interval [s]"] = [
            lags[c].interval if c in lags else "" for c in table["channel"]
        ]
    return table


def budget_table(found: RestBudget) -> pd.DataFrame:
    """The budget as the GUM writes it."""
    rows = [
        {
            "source": s.name,
            "estimate": f"{s.estimate:.4g}",
            "u": f"{s.u:.2g}",
            "distribution": s.distribution,
            "sensitivity": f"{s.sensitivity:.3g}",
            "contribution [K]": f"{s.contribution:.2g}",
            "degrees of freedom": _freedom(s.freedom),
        }
        for s in found.sources
    ]
    rows.append(
        {
            "source": f"combined; U = {found.expanded:.2g} K with k = {found.coverage:.2f}",
            "estimate": "",
            "u": "",
            "distribution": "",
            "sensitivity": "",
            "contribution [K]": f"{found.u:.2g}",
            "degrees of freedom": _freedom(found.freedom),
        }
    )
    return pd.DataFrame(rows)


def _freedom(count: float) -> str:
    return "infinite" if math.isinf(count) or count > 1e6 else f"{count:.0f}"


def widest(record: DiskRecord) -> tuple[str, float]:
    """Channel and temperature [degC] where a reading at rest is least certain."""
    places = [(c, t) for c in sorted(record.static) for t in temperatures(record)]
    return max(places, key=lambda place: budget_of(record, *place).expanded)


def next_calibration(record: DiskRecord, earlier: Sequence[DiskRecord] = ()) -> tuple[date, str]:
    """The day of the next calibration, and why then: ``valid_days``, or sooner where a channel drifts.

    The fastest drift of any channel between the last of ``earlier`` and this record, its standard uncertainty added,
    must not exceed ``limit_K`` before that day.
    """
    stated = record.setup.traceability
    today = calibrated_on(record)
    latest = today + timedelta(days=stated.valid_days)
    plain = f"no later than {latest}, {stated.valid_days} days after this one ([traceability] valid_days)"
    old = [r for r in earlier if (today - calibrated_on(r)).days > LEAST_YEARS * YEAR_DAYS]
    before = [r for r in old if in_oven(r) and in_oven(record)]
    if not before:
        return latest, f"{plain}; no earlier record was given that tells how fast it drifts"
    last = max(before, key=calibrated_on)
    years = (today - calibrated_on(last)).days / YEAR_DAYS
    table = diff_records(last, record).table
    rest = table[table["quantity"].str.endswith("degC")].to_dict("records")
    if not any(abs(row["change"]) + row["u"] > 0 for row in rest):
        return latest, f"{plain}; the earlier record shares no range of temperature with this one"
    worst = max(rest, key=lambda row: abs(row["change"]) + row["u"])
    told = with_u(worst["change"] / years, worst["u"] / years, "K a year")
    rate = (abs(worst["change"]) + worst["u"]) / years
    due = today + timedelta(days=int(min(stated.limit_K / rate * YEAR_DAYS, 3653)))
    if due >= latest:
        return (
            latest,
            f"{plain}; the largest drift since {calibrated_on(last)}, {told}, allows longer",
        )
    return due, (
        f"no later than {due}: {worst['quantity']} drifted by {told} since {calibrated_on(last)}, and may move "
        f"by {stated.limit_K:g} K till then"
    )


def signed_sections(record: DiskRecord, earlier: Sequence[DiskRecord] = ()) -> list[Section]:
    """The first pages of a certificate: identification, results, budget, validity, signatures, files."""
    channel, at = widest(record)
    found = budget_of(record, channel, at)
    _, why = next_calibration(record, earlier)
    changed = " Where the disk, a junction, a cable or the logger is changed, it ends that day."
    files = pd.DataFrame([file.model_dump() for file in record.inputs])
    by = pd.DataFrame(
        {
            "": ["Calibrated by", "Authorised by"],
            "name": [
                record.created_by or NOT_STATED,
                record.setup.traceability.authorised_by or NOT_STATED,
            ],
            "date": ["\u2003" * 8, "\u2003" * 8],
            "signature": ["\u2003" * 14, "\u2003" * 14],
        }
    )
    return [
        Section("Identification and traceability", table=identification(record)),
        Section("Results", ABOUT, table=results(record)),
        Section(
            f"Budget: channel {channel} at {at:.0f} degC, the least certain",
            table=budget_table(found),
        ),
        Section("Validity", f"Next calibration {why}.{changed}\n\n{NOT_MEASURED}"),
        Section("Signatures", table=by),
        Section("Made from", table=files if len(files) else None),
    ]
