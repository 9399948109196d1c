"""Page of one test: the result first, components that add up, figures that remain legible in
grey."""

from __future__ import annotations

from math import hypot
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.colors import to_rgb

from tcdyn.partition import joint_results
from tcdyn.partition.analyse import Partition
from tcdyn.partition.beta_file import beta_file
from tcdyn.plots import partition as draw
from tcdyn.plots.style import DISK_COLOUR, DISK_LINE, DISK_MARKER, figure
from tcdyn.report.beta import beta_assumptions, verdict, write_beta_report
from tcdyn.report.page import typeset
from tcdyn.rig.disk import DISKS
from tcdyn.workflows import beta_tables


def decimals(text: str) -> int:
    """Number of digits after the decimal point."""
    return len(text.partition(".")[2])


def test_uncertainty_components_add_up_to_the_total(partition: Partition) -> None:
    table = beta_tables.budget_table(partition)
    assert table["source"].iloc[-1] == "all together"
    steady = partition.budget.total.u_beta_steady
    cooling = partition.budget.total.u_beta_transient
    assert steady is not None
    joint_u = partition.combined.estimates["beta"].u
    assert hypot(*joint_results.joint_budget(partition).values()) == pytest.approx(
        joint_u, rel=1e-9
    )
    assert [float(x) for x in table.iloc[-1, 1:]] == pytest.approx(
        [joint_u, steady, cooling], abs=5e-5
    )
    # independent sources in a nearly linear model: 4000 samples determine each spread to 1.1 %,
    # none is above the sum
    assert hypot(*(r.u_beta_steady or 0.0 for r in partition.budget.rows)) == pytest.approx(
        steady, rel=0.06
    )
    # the worse disk of each source: never below the worse disk of all
    assert hypot(*(r.u_beta_transient for r in partition.budget.rows)) > 0.97 * cooling


def test_budget_has_a_line_of_the_heat_that_leaves_with_the_oil(partition: Partition) -> None:
    share = joint_results.oil_film_share(partition)
    assert 1 / 1500 < share < 1 / 150  # appendix B: 1/1200 to 1/500 for 16 tests
    table = beta_tables.budget_table(partition).set_index("source")
    friction, film = (
        pd.to_numeric(table.loc[source], errors="coerce").fillna(0.0)
        for source in ("friction", "oil film")
    )
    # like a friction that is wrong by this share; cells are rounded to 0.0001
    friction_rel = partition.test.disks["fast"].uncertainty.friction_rel
    assert (film - friction * share / friction_rel).abs().max() < 1e-4
    conditions = beta_tables.conditions_table(partition).set_index("quantity")
    shown = conditions.loc["frictional heat that leaves with the oil film", "value"]
    assert float(shown) == pytest.approx(100 * share, abs=0.005)


def test_value_and_uncertainty_have_the_same_last_digit(partition: Partition) -> None:
    cells = [c for column in beta_tables.estimates_table(partition).to_numpy().T for c in column]
    cells += list(beta_tables.conditions_table(partition)["value"])
    pairs = [c.split(" +- ") for c in cells if "+-" in c]
    assert len(pairs) > 20
    for value, u in pairs:
        assert decimals(value) == decimals(u), (value, u)
        assert len(u.replace(".", "").lstrip("0")) == 2 or decimals(u) == 0, u


def test_summary_gives_the_result_before_the_agreement(partition: Partition) -> None:
    sentence = verdict(partition)
    assert sentence.startswith("β = 0.")
    assert sentence.index("95 %") < sentence.index("estimates of beta")
    assert any(f"{partition.test.speed_exponent:g}" in line for line in beta_assumptions(partition))


@pytest.mark.long
@pytest.mark.e2e
def test_crosscheck_is_a_finding_and_is_printed_once(partition: Partition, tmp_path: Path) -> None:
    findings = partition.findings
    sentence = partition.crosscheck.sentence
    assert findings[-1] is partition.crosscheck.finding
    assert sum(f.code.startswith("ways.") for f in findings) == 1
    stored = beta_file(partition, {})
    assert stored["findings"][-1]["code"] == partition.crosscheck.finding.code
    assert stored["crosscheck"]["sentence"] == sentence
    assert sentence not in stored["warnings"]
    page = write_beta_report(tmp_path / "x.html", {"B3": partition}).read_text(encoding="utf-8")
    assert page.count(sentence.partition(",")[0]) == 1


def test_model_on_the_page_is_the_model_of_the_joint_fit(partition: Partition) -> None:
    for disk in DISKS:
        comparison = joint_results.compare_joint_fit(partition, disk)
        assert comparison.time_since_unloading_s[0] < -60
        assert comparison.time_since_unloading_s[-1] > 5
        is_loaded = comparison.time_since_unloading_s < 0
        reading = comparison.readings_degC[is_loaded].mean(axis=0)
        under_load = reading - comparison.model_degC[is_loaded].mean(axis=0)
        # K: the nuisance parameters have moved the model onto the readings
        assert abs(under_load).max() < 0.03
        z = (comparison.readings_degC - comparison.model_degC) / comparison.sd_K
        assert 0.7 < float((z**2).mean()) < 2.0
    rows = beta_tables.residuals_table(partition)
    assert len(rows) == 6
    assert (rows["rms over noise [1]"].astype(float) < 2).all()


@pytest.mark.e2e
def test_page_states_result_status_sources_and_simulation(
    partition: Partition, tmp_path: Path
) -> None:
    sources = pd.DataFrame({"what": ["log"], "file": ["B3.csv"]})
    page = write_beta_report(
        tmp_path / "x.html", {"B3": partition}, {"B3": 0.7}, sources
    ).read_text(encoding="utf-8")
    page = page.replace("\u00a0", " ")  # non-breaking spaces
    head = page[page.index("<h1>") : page.index("<section>")]
    assert '<span class="stamp">simulated' in head
    assert typeset(f"<b>β = {partition.combined.estimates['beta']}</b>") in head
    assert '<span class="status sound">' in head
    assert "B3.csv" in head
    assert head.count("<img") == 1
    plain = write_beta_report(tmp_path / "y.html", {"B3": partition}).read_text(encoding="utf-8")
    assert '<span class="stamp">' not in plain
    assert page.count("<details>") > page.count("<section>")


def test_disks_differ_in_tone_line_and_marker() -> None:
    fast, slow = (
        sum(w * c for w, c in zip((0.299, 0.587, 0.114), to_rgb(DISK_COLOUR[d]))) for d in DISKS
    )
    assert abs(fast - slow) > 0.2  # in units of white; a printer resolves about ten greys
    assert DISK_LINE["fast"] != DISK_LINE["slow"]
    assert DISK_MARKER["fast"] != DISK_MARKER["slow"]


def test_equal_estimates_on_the_lines_remain_visible(partition: Partition) -> None:
    _, (ax,) = figure()
    draw.draw_lines(partition, ax)
    points = [c.lines[0] for c in ax.containers if c.get_label().endswith("fast")]
    assert len({p.get_marker() for p in points}) == 3
    assert [p.get_markersize() for p in points] == sorted(
        (p.get_markersize() for p in points), reverse=True
    )
    assert [p.get_zorder() for p in points] == sorted(p.get_zorder() for p in points)
