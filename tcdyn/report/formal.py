"""Formal part of a certificate: identification, results, decision rule, budgets, validity.

Sources: JCGM 100:2008 (GUM), 7.2; ISO/IEC 17025:2017, 7.8.2, 7.8.4 and 7.8.6; JCGM 106:2012.

Used by :mod:`tcdyn.report.certificate`. Tests: ``tests/report/test_certificate.py`` and
``tests/calibration/test_budget.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from calibration.budget import UncertaintyBudget, expanded_of_skewed
from calibration.decisions import (
    calibrated_on,
    channel_budget,
    draft_reasons,
    has_oven_lines,
    lag_of_channel,
    next_calibration,
    range_temperatures,
    simulated_files,
    widest,
)
from tcdyn.core.estimate import rounded_texts
from tcdyn.report.page import SIMULATED, Section
from tcdyn.rig.record import DiskRecord
from tcdyn.version import __version__

# Texts of the certificate.
NOT_STATED = "not stated"
OVEN = "oven against a PRT, straight lines"
NO_OVEN = "readings at rest taken as logged, their uncertainty stated"
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
    "logged value; lines have it in them. For a lag, U is the farther side of its 95 % "
    "interval, so the lag lies within U with a probability of at least 95 %; its degrees of "
    "freedom are infinite (noise of thousands of samples; all else type B)."
)
# Title and mark of a certificate that is none.
DRAFT = "draft, not a calibration certificate"
# Rows of the stored budget of the lags that are sums of others, and the rows of type A.
LAG_TOTALS = ("everything", "all of the fit")
LAG_TYPE_A = ("noise alone",)


def title_marks(record: DiskRecord) -> tuple[str, ...]:
    """Return the marks next to the title of a certificate: draft, simulated, both or none."""
    draft = (DRAFT,) if draft_reasons(record) else ()
    return (*draft, SIMULATED) if simulated_files(record) else draft


def decision_rule(record: DiskRecord) -> str:
    """Return the rule by which a thermocouple is fit to use."""
    stated = record.setup.traceability
    return (
        "A thermocouple is fit to use if no finding speaks against it and the error of a corrected "
        f"reading at rest lies within {stated.tolerance_K:g} K, that of its lag within "
        f"{stated.lag_tolerance_s:g} s ([traceability] tolerance_K, lag_tolerance_s). Guarded "
        "acceptance with the guard band w = U (JCGM 106:2012, 8.3.2; ILAC-G8:09/2019, 4.2.2): "
        "it is accepted if |error| + U does not exceed the tolerance. After correction the error "
        "is estimated as zero, so U must not exceed it; the probability that an accepted "
        "thermocouple is beyond its tolerance is then at most 5 %."
    )


def identification(record: DiskRecord) -> pd.DataFrame:
    """Return who calibrated what with which reference, as the rows that ISO/IEC 17025 asks for."""
    t = record.setup.traceability
    sensors = f"{len(record.static)} thermocouples"
    channels = ", ".join(record.static)
    if has_oven_lines(record):
        method = OVEN
        reference = _instrument_text(
            t.reference, t.reference_serial, t.reference_certificate, t.reference_date
        )
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
        "Logger": _instrument_text(t.logger, t.logger_serial, t.logger_certificate, t.logger_date),
        "Calibrated by": t.calibrated_by,
        "Software": f"tcdyn {__version__}; checksums of all logs below",
    }
    values = [value or NOT_STATED for value in rows.values()]
    return pd.DataFrame({"": list(rows), "stated": values})


def _instrument_text(name: str, serial: str, certificate: str, day: str) -> str:
    """Return an instrument with its serial number, its certificate and the day of that.

    Parameters
    ----------
    name, serial, certificate, day
        As in ``[traceability]``; empty: not stated.
    """
    if not name and not serial and not certificate:
        return NOT_STATED
    certificate_text = certificate or NOT_STATED
    if day:
        certificate_text += f" of {day}"
    return (
        f"{name or NOT_STATED}; serial number {serial or NOT_STATED}; "
        f"certificate {certificate_text}"
    )


def results(record: DiskRecord) -> pd.DataFrame:
    """Return correction and expanded uncertainty at three temperatures, and lag, by channel."""
    rows = []
    for channel, line in sorted(record.static.items()):
        row = {"channel": channel}
        for t in range_temperatures(record):
            logged = (t - line.offset) / line.gain
            expanded = channel_budget(record, channel, t).expanded
            correction_text, expanded_text = rounded_texts(t - logged, expanded)
            row[f"correction at {t:.0f} degC [K]"] = correction_text
            row[f"U at {t:.0f} degC [K]"] = expanded_text
        if record.chain is not None:
            row |= dict.fromkeys(("lag [s]", "U of the lag [s]", "k", "95 % interval [s]"), "")
            lag_s = lag_of_channel(record, channel)
            if lag_s is not None:
                expanded_s, coverage = expanded_of_skewed(lag_s)
                lag_text, expanded_text = rounded_texts(lag_s.value, expanded_s)
                row["lag [s]"] = lag_text
                row["U of the lag [s]"] = expanded_text
                row["k"] = f"{coverage:.2f}"
                row["95 % interval [s]"] = lag_s.interval_text
        rows.append(row)
    return pd.DataFrame(rows)


def budget_table(budget: UncertaintyBudget) -> pd.DataFrame:
    """Return the budget of a correction at one temperature as a table, in the form of the GUM."""
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
                "degrees of freedom": _dof_text(source.dof),
            }
        )
    combined = {
        "source": f"combined; U = {budget.expanded:.2g} K with k = {budget.coverage:.2f}",
        "contribution [K]": f"{budget.u:.2g}",
        "degrees of freedom": _dof_text(budget.dof),
    }
    return pd.DataFrame([*rows, combined]).fillna("")


def lag_budget_table(record: DiskRecord) -> pd.DataFrame:
    """Return the budget of the common lag and of the differences between channels.

    Empty if the record has none.

    Parameters
    ----------
    record
        The record.

    Notes
    -----
    A source counts with the variance that would disappear if it were known. The sources are
    correlated after the fit, so the sum of their variances differs from the variance of the lag;
    the row on correlations is that difference, with its sign.
    """
    shares = record.fit.get("lag_budget")
    if record.chain is None or not shares:
        return pd.DataFrame()
    common_s = record.chain.common_lag_s
    total = {"u_common_s": common_s.u, "u_differential_s": shares[0]["u_differential_s"]}
    sources = [share for share in shares if share["source"] not in LAG_TOTALS]
    rows = []
    for share in sources:
        kind = "A" if share["source"] in LAG_TYPE_A else "B"
        contributions = (f"{share[key]:.4f}" for key in total)
        rows.append((share["source"], kind, "infinite", *contributions))
    correlations = []
    for key, u in total.items():
        variance = u**2 - sum(share[key] ** 2 for share in sources)
        correlations.append(f"{math.copysign(math.sqrt(abs(variance)), variance):.4f}")
    rows.append(("correlations of the sources", "", "", *correlations))
    expanded_s, coverage = expanded_of_skewed(common_s)
    combined = f"combined; U = {expanded_s:.2g} s of the common lag with k = {coverage:.2f}"
    rows.append((combined, "", "infinite", *(f"{u:.4f}" for u in total.values())))
    columns = ["source", "type", "degrees of freedom", "common lag [s]", "differences, rms [s]"]
    return pd.DataFrame(rows, columns=columns)


def _dof_text(dof: float) -> str:
    """Return degrees of freedom as text."""
    return "infinite" if math.isinf(dof) or dof > 1e6 else f"{dof:.0f}"


def formal_sections(record: DiskRecord, earlier: Sequence[DiskRecord] = ()) -> list[Section]:
    """Return the first pages of a certificate.

    Identification, results, decision rule, budgets, validity and files. A draft begins with what it
    lacks; only a complete certificate has lines for signatures.

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
    sections = [
        Section("Identification and traceability", table=identification(record)),
        Section("Results", ABOUT, table=results(record)),
        Section("Decision rule", decision_rule(record)),
        Section(
            f"Budget: channel {channel} at {temperature_degC:.0f} degC, the least certain",
            table=budget_table(budget),
        ),
    ]
    lag_budget = lag_budget_table(record)
    if len(lag_budget):
        sections.append(Section("Budget: lags", table=lag_budget))
    sections.append(Section("Validity", f"Next calibration {reason}. {changes}\n\n{NOT_MEASURED}"))
    reasons = draft_reasons(record)
    if reasons:
        title = f"{DRAFT[:1].upper()}{DRAFT[1:]}"
        sections.insert(0, Section(title, f"{'; '.join(reasons)}."))
    else:
        sections.append(Section("Signatures", table=_signature_lines(record)))
    return [*sections, Section("Made from", table=files if len(files) else None)]


def _signature_lines(record: DiskRecord) -> pd.DataFrame:
    """Return empty lines for two signatures, with the names that are stated."""
    stated = record.setup.traceability
    return pd.DataFrame(
        {
            "": ["Calibrated by", "Authorised by"],
            "name": [stated.calibrated_by, stated.authorised_by or NOT_STATED],
            "date": ["\u2003" * 8, "\u2003" * 8],
            "signature": ["\u2003" * 14, "\u2003" * 14],
        }
    )
