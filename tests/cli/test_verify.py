"""``tcdyn verify``: every row computed, a row that differs stops it."""

import json

import pytest
import typer
from typer.testing import CliRunner

from tcdyn.cli import verify as command
from tcdyn.verify import KINDS, VerifyRow, verify_rows, within

app = typer.Typer()
app.command()(command.verify)


@pytest.mark.e2e
def test_every_published_number_agrees_or_says_why_it_cannot_be_checked():
    rows = verify_rows()
    assert [r.quantity for r in rows if r.failed] == []
    assert all(r.why and r.ours and r.published for r in rows)
    sources = " ".join(r.source for r in rows)
    for source in (
        "table 2.6",
        "table 3.1",
        "table 3.2",
        "table 3.3",
        "table 3.5",
        "table 3.6",
        "figure 3.15",
    ):
        assert source in sources
    for source in (
        "figure 3.16",
        "(3.27)",
        "table 6.1",
        "(5.1)",
        "table 6.6",
        "(6.1)",
        "appendix B",
        "(4.6)",
        "(4.7)",
    ):
        assert source in sources
    for source in (
        "tables 6.2 to 6.5",
        "table 7.1",
        "table 7.2",
        "table 7.3",
        "figure 6.26",
        "figure 6.27",
        "figure 6.28",
    ):
        assert source in sources
    assert sum(r.source == "table 3.4" and "heat correction" in r.quantity for r in rows) == 4
    assert all(r.kind in KINDS for r in rows)
    assert (
        sum(r.kind == "physics" for r in rows) >= 40
    )  # 19 were evidence when the rows had no class
    assert {r.source for r in rows if r.verdict == "misprint"} == {"table 7.2", "table 7.3"}


def few(verdict):
    return [VerifyRow("x", "table 0", "1", "2", verdict, "because", "trend")]


def test_a_row_that_differs_ends_in_exit_code_one(monkeypatch, tmp_path):
    monkeypatch.setattr("tcdyn.verify.verify_rows", lambda: few("differs"))
    result = CliRunner().invoke(app, ["--out", str(tmp_path / "rows.csv")])
    assert result.exit_code == 1
    assert "1 differ" in result.output
    assert (
        (tmp_path / "rows.csv")
        .read_text()
        .startswith("quantity,source,published,ours,verdict,why,kind")
    )


def worst_of_mesh_one(rows):
    return next(
        r.verdict
        for r in rows
        if r.source == "table 3.5" and r.quantity.startswith("mesh I against")
    )


def test_an_array_of_another_length_than_the_table_differs_instead_of_passing(monkeypatch):
    """A scheme that loses a time of table 3.5 must not end as "not checkable"."""
    from tcdyn.verify import rim_rows

    assert not within([1.0], [1.0, 2.0], absolute=9.0)
    assert not within([1.0, 2.0], [1.0], absolute=9.0)
    monkeypatch.setattr(rim_rows, "TABLE_3_5", {**rim_rows.TABLE_3_5, "I": (5.015, 3.111, 1.0)})
    verdicts = [
        r.verdict
        for r in rim_rows.mesh_rows()
        if r.source == "table 3.5" and r.quantity.startswith("mesh I ag")
    ]
    assert verdicts == ["differs"]


def test_an_error_ten_times_off_the_table_differs_even_where_sizes_cannot_be_compared(monkeypatch):
    from tcdyn.verify import rim_rows

    monkeypatch.setattr(rim_rows, "TABLE_3_5", {**rim_rows.TABLE_3_5, "I": (50.0, 31.0)})
    verdicts = [
        r.verdict
        for r in rim_rows.mesh_rows()
        if r.source == "table 3.5" and r.quantity.startswith("mesh I ag")
    ]
    assert verdicts == ["differs"]


def test_a_chapter_that_cannot_go_on_differs_and_the_others_are_still_told(monkeypatch):
    import tcdyn.verify
    from tcdyn.verify import table_rows

    monkeypatch.setattr(
        tcdyn.verify, "CHAPTERS", (("table_rows", "table_rows"), ("contact_rows", "speed_law_rows"))
    )
    monkeypatch.setattr(table_rows, "speed_ratio_power", lambda ratio, n: 1 / 0)
    rows = verify_rows()
    stopped = [r for r in rows if r.failed]
    assert [r.why for r in stopped] == ["table rows stopped: division by zero"]
    assert rows[0].source == "section 2.2.1"
    assert rows[-1].source == "(4.7) as corrected"


def test_the_summary_counts_the_classes_and_each_row_says_its_own(monkeypatch):
    rows = [
        VerifyRow("x", "table 0", "1", "1", "agrees", "because", kind)
        for kind in ("physics", "rule", "rule")
    ]
    monkeypatch.setattr("tcdyn.verify.verify_rows", lambda: rows)
    result = CliRunner().invoke(app, ["--json"])
    told = json.loads(result.output)
    assert told["classes"] == {"physics": 1, "trend": 0, "rule": 2, "arithmetic": 0}
    assert [r["kind"] for r in told["rows"]] == ["physics", "rule", "rule"]
    text = CliRunner().invoke(app, []).output
    assert text.count("  rule, table 0") == 2


def test_rows_that_agree_end_well_and_print_their_reasons_when_asked(monkeypatch):
    monkeypatch.setattr("tcdyn.verify.verify_rows", lambda: few("agrees"))
    result = CliRunner().invoke(app, ["--why"])
    assert result.exit_code == 0
    assert "because" in result.output


def test_a_changed_formula_is_caught(monkeypatch):
    """The misprinted (4.7) gives another beta: the row must say so."""
    from tcdyn.verify import contact_rows

    monkeypatch.setattr(
        contact_rows,
        "speed_law_beta",
        lambda a, b, c, d, chi: (a * d + chi * b * c) / (d + chi * b),
    )
    failed = [r.quantity for r in contact_rows.speed_law_rows() if r.failed]
    assert "beta of the worked example" in failed


@pytest.mark.e2e
def test_the_report_has_the_table_and_four_pictures(monkeypatch, tmp_path):
    monkeypatch.setattr("tcdyn.verify.verify_rows", lambda: few("not checkable"))
    page = tmp_path / "verify.html"
    assert CliRunner().invoke(app, ["--report", str(page)]).exit_code == 0
    html = page.read_text()
    assert html.count("data:image/png") == 4
    assert "not checkable" in html


def test_the_list_fits_eighty_columns_and_gives_a_shared_reason_once(monkeypatch):
    long = [
        VerifyRow(
            f"error of mesh {k} at 2, 4, 8, 15 s, %",
            "table 3.2",
            "1, 2",
            "3, 4",
            "same trend",
            "word " * 40,
            "trend",
        )
        for k in range(4)
    ]
    monkeypatch.setattr("tcdyn.verify.verify_rows", lambda: [*few("agrees"), *long])
    result = CliRunner().invoke(app, [], env={"COLUMNS": "80"})
    assert max(len(line) for line in result.output.splitlines()) <= 80
    assert result.output.count("word") == 40
    assert result.output.index("same trend (") < result.output.index(
        "agrees ("
    )  # what needs reading comes first
    assert "because" not in result.output
