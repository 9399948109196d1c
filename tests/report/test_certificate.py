"""A certificate: a draft until it is complete, expanded uncertainty of lags, decision rule."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calibration.budget import expanded_of_skewed
from calibration.decisions import FIT_TO_USE, channel_verdicts, draft_reasons
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import info
from tcdyn.report.certificate import certificate_sections, certificate_verdict
from tcdyn.report.formal import DRAFT, formal_sections, lag_budget_table, results, title_marks
from tcdyn.report.page import render_page
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.tables import REQUIRED_ENTRIES
from tests.rig.test_record import RECORD

COMPLETE = {
    "laboratory": "Laboratory of the works",
    "certificate": "2026-17",
    "calibrated_by": "A. Person",
    "reference": "PRT",
    "reference_serial": "R-1",
    "reference_certificate": "K 4711",
    "reference_date": "2026-01-05",
    "logger": "Logger",
    "logger_serial": "L-2",
}


def with_traceability(**entries: object) -> DiskRecord:
    """The record with some entries of [traceability]."""
    table = RECORD.setup.traceability.model_copy(update=entries)
    return RECORD.model_copy(
        update={"setup": RECORD.setup.model_copy(update={"traceability": table})}
    )


def page(record: DiskRecord) -> str:
    """The formal part as HTML."""
    return render_page("Calibration", formal_sections(record), marks=title_marks(record))


@pytest.mark.parametrize(
    ("u_common_s", "u_difference_s", "title"),
    [
        (0.06, 0.01, "Lags: their differences are known 6 times better than their mean"),
        (0.06, 0.05, "Lags"),
        (2.0, 0.0, "Lags"),
    ],
)
def test_title_of_the_lags_says_how_well_their_differences_are_known(
    u_common_s: float, u_difference_s: float, title: str
) -> None:
    """u = 0 of the difference is a record of one channel."""
    chain = RECORD.chain
    assert chain is not None
    differences = {
        name: Estimate.normal(difference.value, u_difference_s)
        for name, difference in chain.differential_lag_s.items()
    }
    common = Estimate.normal(chain.common_lag_s.value, u_common_s)
    changed = chain.model_copy(update={"common_lag_s": common, "differential_lag_s": differences})
    sections = certificate_sections(RECORD.model_copy(update={"chain": changed}))
    assert [s.title for s in sections if s.title.startswith("Lags")] == [title]


def test_without_traceability_it_is_a_draft_without_a_person_or_lines_to_sign() -> None:
    text = page(RECORD)
    assert f'<span class="stamp">{DRAFT}</span>' in text
    assert f"<h2>{DRAFT.capitalize()}" in text
    for key in REQUIRED_ENTRIES:
        assert key in text
    assert "Signatures" not in text
    assert "Authorised by" not in text


@pytest.mark.parametrize("missing", REQUIRED_ENTRIES)
def test_a_certificate_that_lacks_one_entry_is_a_draft(missing: str) -> None:
    reasons = draft_reasons(with_traceability(**(COMPLETE | {missing: ""})))
    assert len(reasons) == 1
    assert reasons[0].endswith(f"does not state {missing}")


def test_a_complete_certificate_is_no_draft_and_has_lines_to_sign() -> None:
    record = with_traceability(**COMPLETE)
    text = page(record)
    assert title_marks(record) == ()
    assert "draft" not in text
    assert "Signatures" in text
    for value in COMPLETE.values():
        assert value in text


def test_a_complete_certificate_of_simulated_logs_or_without_an_oven_is_a_draft() -> None:
    record = with_traceability(**COMPLETE)
    simulated = record.model_copy(update={"findings": [info("log.simulated", subject="P1.csv")]})
    assert title_marks(simulated) == (DRAFT, "simulated")
    assert "P1.csv" in draft_reasons(simulated)[0]
    no_oven = record.model_copy(update={"findings": [info("static.stated", u_K=1.0)]})
    assert title_marks(no_oven) == (DRAFT,)


def test_expanded_uncertainty_of_a_skewed_lag_covers_at_least_95_percent() -> None:
    lag_s = stats.lognorm(0.3, scale=0.6)
    low95, high95 = lag_s.ppf([0.025, 0.975])
    estimate = Estimate(value=lag_s.mean(), u=lag_s.std(), low95=low95, high95=high95)
    expanded, k = expanded_of_skewed(estimate)
    assert expanded == pytest.approx(k * estimate.u)
    probability = lag_s.cdf(estimate.value + expanded) - lag_s.cdf(estimate.value - expanded)
    assert 0.95 <= probability < 0.99
    normal = Estimate.normal(0.6, 0.1)
    assert expanded_of_skewed(normal) == pytest.approx((0.196, 1.96), abs=1e-3)


def test_results_state_u_and_k_of_each_lag() -> None:
    assert RECORD.chain is not None
    table = results(RECORD).set_index("channel")
    for channel, chain in RECORD.chain.channels.items():
        row = table.loc[channel]
        k = float(row["k"])
        assert float(row["U of the lag [s]"]) == pytest.approx(k * chain.lag_s.u, rel=0.06)


def test_budget_of_the_lag_adds_up_with_its_correlations() -> None:
    assert RECORD.chain is not None
    u = RECORD.chain.common_lag_s.u
    shares = [("all of the fit", u, 0.02), ("entry burst", 0.9 * u, 0.01), ("noise alone", u, 0.01)]
    keys = ("source", "u_common_s", "u_differential_s")
    fit = {"lag_budget": [dict(zip(keys, share)) for share in shares]}
    table = lag_budget_table(RECORD.model_copy(update={"fit": fit})).set_index("source")
    for column in ("common lag [s]", "differences, rms [s]"):
        values = table[column].astype(float).to_numpy()
        signed_squares = np.sign(values[:-1]) * values[:-1] ** 2
        # the rows are rounded to 1e-4 s
        assert signed_squares.sum() == pytest.approx(values[-1] ** 2, rel=0.03)
    assert list(table["type"])[:2] == ["B", "A"]


def test_a_thermocouple_is_fit_to_use_only_if_u_is_within_the_tolerance() -> None:
    """Guarded acceptance with w = U and an estimated error of zero."""
    table = results(RECORD).set_index("channel")
    columns = [name for name in table if name.startswith("U at")]
    largest_K = float(table.loc["a", columns].astype(float).max())
    just_wider = with_traceability(tolerance_K=1.5 * largest_K)
    assert channel_verdicts(just_wider)["a"] == FIT_TO_USE
    narrower = with_traceability(tolerance_K=0.5 * largest_K)
    assert "exceeds the tolerance" in channel_verdicts(narrower)["a"]
    assert "0 of 6 thermocouples fit to use" in certificate_verdict(narrower)
    slow = with_traceability(lag_tolerance_s=1e-3)
    assert "of its lag exceeds the tolerance" in channel_verdicts(slow)["a"]
    assert "JCGM 106:2012" in page(slow)
