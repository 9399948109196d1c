"""Uncertainty at rest: never below the reference's, held by draws with a common bias, and told source by source."""

from __future__ import annotations

from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from calibration.budget import Contribution, UncertaintyBudget, uncertainty_budget
from calibration.compare import compare_records
from calibration.static_lines import fit_static_lines
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import text_with_u
from tcdyn.report.page import render_page
from tcdyn.report.signed import (
    budget_table,
    channel_budget,
    next_calibration,
    results,
    signed_sections,
    temperatures,
)
from tcdyn.rig.disk import CHANNELS
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import load_rig, parse_rig, rig_toml
from tcdyn.rig.static_line import apply_static, reading_u, static_u
from tcdyn.rig.tables import TraceabilityTable
from tests.rig.log_cases import oven_frame, oven_truth

OVENS = 200
STATED = {"reference_u_K": 0.03, "reference_drift_K_per_year": 0.03, "reference_date": "2024-01-01"}
ON = date(2026, 1, 1)


def made(
    seed: int = 0, created: str = "2026-01-01T09:00:00+00:00", shift_K: float = 0.0
) -> DiskRecord:
    """The record of an oven whose reference is off by ``shift_K``."""
    rig = parse_rig({"traceability": STATED}, "rig.toml").common
    frame = oven_frame(seed)
    frame["prt_degC"] += shift_K
    lines = fit_static_lines(frame, prt_shared_u_degC=rig.traceability.shared_u_K(ON)).lines
    return DiskRecord(disk="fast", created=created, static=lines, setup=rig)


def test_a_reading_at_rest_is_never_surer_than_its_reference() -> None:
    record = made()
    shared = record.setup.traceability.shared_u_K(ON)
    assert shared == pytest.approx(np.hypot(0.03, 2 * 0.03 / 3**0.5), rel=1e-3)
    t = np.linspace(20.0, 160.0, 30)
    for line in record.static.values():
        assert np.all(reading_u(line, t) > shared)
        assert reading_u(line, t) ** 2 == pytest.approx(static_u(line, t) ** 2 + shared**2)


@pytest.mark.study
def test_intervals_hold_with_a_bias_and_a_drift_of_the_reference_and_differences_without() -> None:
    """200 ovens, each with a reference that is off by one certificate error and one drift for all its readings."""
    rng = np.random.default_rng(5)
    held = []
    apart = []
    for seed in range(OVENS):
        record = made(seed, shift_K=rng.normal(0, 0.03) + rng.uniform(-0.06, 0.06))
        gain, offset = oven_truth(seed)
        errors = []
        for k, c in enumerate(CHANNELS):
            line = record.static[c]
            error = float(apply_static((90.0 - offset[k]) / gain[k], line)) - 90.0
            held.append(abs(error) < channel_budget(record, c, 90.0).expanded)
            errors.append((error, float(static_u(line, 90.0))))
        a, u_a = errors[0]
        b, u_b = errors[3]
        apart.append(abs(a - b) < 1.96 * np.hypot(u_a, u_b))
    assert stats.binom.cdf(sum(apart), OVENS, 0.93) > 1e-4
    assert np.mean(held) == pytest.approx(
        0.95, abs=0.045
    )  # six channels share one error: 200 draws of it


def test_coverage_factor_and_freedom_are_the_gum_s() -> None:
    """GUM, H.1.6 (an end gauge): contributions in nm with their degrees of freedom make 32 nm with 16."""
    parts = [(25.0, 18), (9.7, 25.6), (2.9, 50), (16.6, 2)]
    found = UncertaintyBudget(
        tuple(Contribution(str(k), 0.0, u, "normal", 1.0, v) for k, (u, v) in enumerate(parts))
    )
    assert found.u == pytest.approx(32.0, abs=0.5)
    assert int(found.dof) == 16
    assert found.coverage == pytest.approx(stats.t.isf(0.025, int(found.dof)))


def test_a_line_s_own_part_is_its_scatter_not_student_s_widening() -> None:
    record = made()
    line = record.static["a"]
    own = uncertainty_budget(line, record.setup.traceability, ON, 90.0).sources[0]
    assert own.dof == line.n - 2
    assert own.u == pytest.approx(
        float(static_u(line, 90.0)) * 1.96 / stats.t.isf(0.025, line.n - 2), rel=1e-3
    )
    alone = uncertainty_budget(
        line.model_copy(update={"shared_u_K": 0.0}), TraceabilityTable(), ON, 90.0
    )
    assert [s.name for s in alone.sources] == ["line through the holds"]


def test_the_next_calibration_is_sooner_where_a_channel_drifts() -> None:
    now = made()
    before = made(created="2025-01-01T09:00:00+00:00")
    latest, why = next_calibration(now)
    assert (latest, "no earlier record" in why) == (date(2027, 1, 1), True)
    assert next_calibration(now, [before])[0] == latest
    drifted = {
        c: x.model_copy(update={"offset": x.offset + 1.0 * (c == "d")})
        for c, x in now.static.items()
    }
    due, why = next_calibration(now.model_copy(update={"static": drifted}), [before])
    assert date(2026, 6, 1) < due < date(2026, 7, 10)  # 1 K in a year: 0.5 K in half of one
    assert "d at" in why


def test_the_day_of_the_next_calibration_is_that_on_which_the_drift_with_its_uncertainty_reaches_the_limit() -> (
    None
):
    """(1 K + u) in two years: ``limit_K`` after limit/(1 K + u) of their days; a record of last week tells no drift."""
    now = made()
    before = made(created="2024-01-01T09:00:00+00:00")
    assert "allows longer" in next_calibration(now, [before])[1]
    drifted = {
        c: x.model_copy(update={"offset": x.offset + 1.0 * (c == "d")})
        for c, x in now.static.items()
    }
    stated = now.setup.traceability.model_copy(update={"valid_days": 3000, "limit_K": 2.0})
    setup = now.setup.model_copy(update={"traceability": stated})
    now = now.model_copy(update={"static": drifted, "setup": setup})
    rows = compare_records(before, now).table
    drift = rows[rows["quantity"].str.match("d at .*degC")].sort_values("u").iloc[-1]
    assert (abs(drift["change"]), drift["u"]) == pytest.approx((1.0, 0.05), abs=0.03)
    days = (date(2026, 1, 1) - date(2024, 1, 1)).days
    due, why = next_calibration(now, [before])
    assert (due - date(2026, 1, 1)).days == int(2.0 * days / (abs(drift["change"]) + drift["u"]))
    years = days / 365.25
    assert (
        f"drifted by {text_with_u(drift['change'] / years, drift['u'] / years, 'K a year')}" in why
    )
    recent = made(created="2025-12-25T09:00:00+00:00")
    assert next_calibration(now, [recent])[0] == date(2026, 1, 1) + timedelta(days=3000)


def test_results_correct_a_reading_at_the_ends_and_the_middle_of_the_range() -> None:
    record = made()
    line = record.static["a"].model_copy(
        update={"gain": 1.01, "offset": -0.5, "range_degC": (20.0, 160.0)}
    )
    static = {
        c: x.model_copy(update={"range_degC": (20.0, 160.0)}) for c, x in record.static.items()
    }
    record = record.model_copy(update={"static": {**static, "a": line}})
    assert temperatures(record) == [20.0, 90.0, 160.0]
    row = results(record).iloc[0]
    for t in temperatures(
        record
    ):  # read (t + 0.5)/1.01 at t; printed to a hundredth of a kelvin or finer
        assert float(row[f"correction at {t:.0f} degC [K]"]) == pytest.approx(
            t - (t + 0.5) / 1.01, abs=0.006
        )


def test_more_degrees_of_freedom_than_a_million_are_told_as_infinite() -> None:
    part = [Contribution(str(v), 0.0, 0.01, "normal", 1.0, v) for v in (12.4, 2e6, float("inf"))]
    assert list(budget_table(UncertaintyBudget(tuple(part)))["degrees of freedom"])[:3] == [
        "12",
        "infinite",
        "infinite",
    ]


def test_the_certificate_tells_who_what_and_how_well() -> None:
    record = made()
    page = render_page("Certificate", signed_sections(record))
    for said in (
        "not stated",
        "drift since",
        "degrees of freedom",
        "Signatures",
        "Next calibration",
    ):
        assert said in page, said
    table = results(record)
    assert list(table["channel"]) == list(CHANNELS)
    assert len(table.columns) == 1 + 2 * len(temperatures(record))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"reference_drift_K_per_year": 0.01}, "reference_date"),
        ({"reference_date": "last year"}, "reference_date"),
        ({"valid_days": 0}, "valid_days"),
        ({"who": "x"}, "no such key"),
    ],
)
def test_a_traceability_table_that_cannot_be_is_refused(
    table: dict[str, object], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        parse_rig({"traceability": table}, "rig.toml")


def test_the_table_goes_through_a_rig_file(tmp_path: Path) -> None:
    rig = parse_rig({"traceability": {**STATED, "laboratory": 'A "quoted" laboratory'}}, "rig.toml")
    path = tmp_path / "rig.toml"
    path.write_text(rig_toml(rig), encoding="utf-8")
    assert load_rig(path).common.traceability == rig.common.traceability
    assert replace(Contribution("a", 0.0, 2.0, "normal", -3.0, 4.0), u=1.0).contribution == 3.0
