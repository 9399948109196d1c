"""Uncertainty of static readings: never below that of the reference, coverage with a common bias,
and its components."""

from __future__ import annotations

from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from calibration.budget import Contribution, UncertaintyBudget, uncertainty_budget
from calibration.compare import compare_records
from calibration.decisions import channel_budget, next_calibration, range_temperatures
from calibration.static_lines import fit_static_lines
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import text_with_u
from tcdyn.report.formal import budget_table, formal_sections, results
from tcdyn.report.page import render_page
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import load_rig, parse_rig, rig_toml
from tcdyn.rig.static_line import apply_static, reading_u, static_u
from tcdyn.rig.tables import TraceabilityTable
from tests.rig.log_cases import oven_frame, oven_truth

OVENS = 200
TRACEABILITY = {
    "reference_u_K": 0.03,
    "reference_drift_K_per_year": 0.03,
    "reference_date": "2024-01-01",
}
ON = date(2026, 1, 1)


def oven_record(
    seed: int = 0, created: str = "2026-01-01T09:00:00+00:00", shift_K: float = 0.0
) -> DiskRecord:
    """The record of an oven whose reference deviates by ``shift_K``."""
    rig = parse_rig({"traceability": TRACEABILITY}, "rig.toml").common
    frame = oven_frame(seed)
    frame["prt_degC"] += shift_K
    lines = fit_static_lines(frame, prt_shared_u_degC=rig.traceability.shared_u_K(ON)).lines
    return DiskRecord(disk="fast", created=created, static=lines, setup=rig)


def test_reading_is_never_more_certain_than_its_reference() -> None:
    record = oven_record()
    shared = record.setup.traceability.shared_u_K(ON)
    assert shared == pytest.approx(np.hypot(0.03, 2 * 0.03 / 3**0.5), rel=1e-3)
    t = np.linspace(20.0, 160.0, 30)
    for line in record.static.values():
        assert np.all(reading_u(line, t) > shared)
        assert reading_u(line, t) ** 2 == pytest.approx(static_u(line, t) ** 2 + shared**2)


@pytest.mark.study
def test_intervals_cover_with_bias_and_drift_of_the_reference_and_differences_without() -> None:
    """200 ovens, each with one certificate error and one drift of the reference for all its
    readings."""
    rng = np.random.default_rng(5)
    covered = []
    difference_covered = []
    for seed in range(OVENS):
        record = oven_record(seed, shift_K=rng.normal(0, 0.03) + rng.uniform(-0.06, 0.06))
        gain, offset = oven_truth(seed)
        errors = []
        for k, c in enumerate(CHANNELS):
            line = record.static[c]
            error = float(apply_static((90.0 - offset[k]) / gain[k], line)) - 90.0
            covered.append(abs(error) < channel_budget(record, c, 90.0).expanded)
            errors.append((error, float(static_u(line, 90.0))))
        a, u_a = errors[0]
        b, u_b = errors[3]
        difference_covered.append(abs(a - b) < 1.96 * np.hypot(u_a, u_b))
    assert stats.binom.cdf(sum(difference_covered), OVENS, 0.93) > 1e-4
    # six channels share one error: 200 samples of it
    assert np.mean(covered) == pytest.approx(0.95, abs=0.045)


def test_coverage_factor_and_degrees_of_freedom_follow_the_gum() -> None:
    """GUM, H.1.6 (an end gauge): contributions in nm with their degrees of freedom give 32 nm with
    16."""
    components = [(25.0, 18), (9.7, 25.6), (2.9, 50), (16.6, 2)]
    budget = UncertaintyBudget(
        tuple(Contribution(str(k), 0.0, u, "normal", 1.0, v) for k, (u, v) in enumerate(components))
    )
    assert budget.u == pytest.approx(32.0, abs=0.5)
    assert int(budget.dof) == 16
    assert budget.coverage == pytest.approx(stats.t.isf(0.025, int(budget.dof)))


def test_line_component_is_its_scatter_without_student_factor() -> None:
    record = oven_record()
    line = record.static["a"]
    line_component = uncertainty_budget(line, record.setup.traceability, ON, 90.0).sources[0]
    assert line_component.dof == line.n - 2
    assert line_component.u == pytest.approx(
        float(static_u(line, 90.0)) * 1.96 / stats.t.isf(0.025, line.n - 2), rel=1e-3
    )
    without_reference = uncertainty_budget(
        line.model_copy(update={"shared_u_K": 0.0}), TraceabilityTable(), ON, 90.0
    )
    assert [s.name for s in without_reference.sources] == ["line through the holds"]


def test_next_calibration_is_earlier_if_a_channel_drifts() -> None:
    current = oven_record()
    previous = oven_record(created="2025-01-01T09:00:00+00:00")
    default_due, reason = next_calibration(current)
    assert (default_due, "no earlier record" in reason) == (date(2027, 1, 1), True)
    assert next_calibration(current, [previous])[0] == default_due
    drifted = {
        c: x.model_copy(update={"offset": x.offset + 1.0 * (c == "d")})
        for c, x in current.static.items()
    }
    due, reason = next_calibration(current.model_copy(update={"static": drifted}), [previous])
    # 1 K in a year: the limit of 0.5 K in half a year
    assert date(2026, 6, 1) < due < date(2026, 7, 10)
    assert "d at" in reason


def test_next_calibration_is_due_when_drift_plus_uncertainty_reaches_the_limit() -> None:
    """(1 K + u) in two years: ``limit_K`` is reached after limit/(1 K + u) of their days; a record
    of last week gives no drift."""
    current = oven_record()
    previous = oven_record(created="2024-01-01T09:00:00+00:00")
    assert "allows longer" in next_calibration(current, [previous])[1]
    drifted = {
        c: x.model_copy(update={"offset": x.offset + 1.0 * (c == "d")})
        for c, x in current.static.items()
    }
    longer_validity = current.setup.traceability.model_copy(
        update={"valid_days": 3000, "limit_K": 2.0}
    )
    setup = current.setup.model_copy(update={"traceability": longer_validity})
    current = current.model_copy(update={"static": drifted, "setup": setup})
    rows = compare_records(previous, current).table
    drift = rows[rows["quantity"].str.match("d at .*degC")].sort_values("u").iloc[-1]
    assert (abs(drift["change"]), drift["u"]) == pytest.approx((1.0, 0.05), abs=0.03)
    days = (date(2026, 1, 1) - date(2024, 1, 1)).days
    due, reason = next_calibration(current, [previous])
    assert (due - date(2026, 1, 1)).days == int(2.0 * days / (abs(drift["change"]) + drift["u"]))
    years = days / 365.25
    assert (
        f"drifted by {text_with_u(drift['change'] / years, drift['u'] / years, 'K a year')}"
        in reason
    )
    recent_record = oven_record(created="2025-12-25T09:00:00+00:00")
    assert next_calibration(current, [recent_record])[0] == date(2026, 1, 1) + timedelta(days=3000)


def test_results_correct_readings_at_the_ends_and_the_middle_of_the_range() -> None:
    record = oven_record()
    line = record.static["a"].model_copy(
        update={"gain": 1.01, "offset": -0.5, "range_degC": (20.0, 160.0)}
    )
    static = {
        c: x.model_copy(update={"range_degC": (20.0, 160.0)}) for c, x in record.static.items()
    }
    record = record.model_copy(update={"static": {**static, "a": line}})
    assert range_temperatures(record) == [20.0, 90.0, 160.0]
    row = results(record).iloc[0]
    # reads (t + 0.5)/1.01 at t; printed to a hundredth of a kelvin or finer
    for t in range_temperatures(record):
        assert float(row[f"correction at {t:.0f} degC [K]"]) == pytest.approx(
            t - (t + 0.5) / 1.01, abs=0.006
        )


def test_degrees_of_freedom_above_a_million_are_printed_as_infinite() -> None:
    components = [
        Contribution(str(v), 0.0, 0.01, "normal", 1.0, v) for v in (12.4, 2e6, float("inf"))
    ]
    assert list(budget_table(UncertaintyBudget(tuple(components)))["degrees of freedom"])[:3] == [
        "12",
        "infinite",
        "infinite",
    ]


def test_certificate_states_responsibility_method_and_uncertainty() -> None:
    record = oven_record()
    page = render_page("Certificate", formal_sections(record))
    for text in (
        "not stated",
        "drift since",
        "degrees of freedom",
        "Decision rule",
        "Next calibration",
    ):
        assert text in page, text
    table = results(record)
    assert list(table["channel"]) == list(CHANNELS)
    assert len(table.columns) == 1 + 2 * len(range_temperatures(record))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"reference_drift_K_per_year": 0.01}, "reference_date"),
        ({"reference_date": "last year"}, "reference_date"),
        ({"valid_days": 0}, "valid_days"),
        ({"who": "x"}, "no such key"),
    ],
)
def test_invalid_traceability_table_raises(table: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_rig({"traceability": table}, "rig.toml")


def test_traceability_table_survives_a_rig_file(tmp_path: Path) -> None:
    rig = parse_rig(
        {"traceability": {**TRACEABILITY, "laboratory": 'A "quoted" laboratory'}}, "rig.toml"
    )
    path = tmp_path / "rig.toml"
    path.write_text(rig_toml(rig), encoding="utf-8")
    assert load_rig(path).common.traceability == rig.common.traceability
    assert replace(Contribution("a", 0.0, 2.0, "normal", -3.0, 4.0), u=1.0).contribution == 3.0


def test_a_day_may_be_a_date_of_toml(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[traceability]\nreference_date = 2026-01-15\n", encoding="utf-8")
    assert load_rig(path).tables("fast").traceability.reference_date == "2026-01-15"
