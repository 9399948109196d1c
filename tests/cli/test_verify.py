"""``tcdyn verify``: every row computed, a row that differs stops it."""

import typer
from typer.testing import CliRunner

from tcdyn.cli import verify as command
from tcdyn.verify import VerifyRow, verify_rows

app = typer.Typer()
app.command()(command.verify)


def test_every_published_number_agrees_or_says_why_it_cannot_be_checked():
    rows = verify_rows()
    assert [r.quantity for r in rows if r.failed] == []
    assert all(r.why and r.ours and r.published for r in rows)
    sources = " ".join(r.source for r in rows)
    for source in ("table 2.6", "table 3.1", "table 3.2", "table 3.3", "table 3.5", "table 3.6", "figure 3.15"):
        assert source in sources
    for source in ("figure 3.16", "(3.27)", "table 6.1", "(5.1)", "table 6.6", "(6.1)", "appendix B", "(4.6)", "(4.7)"):
        assert source in sources
    assert sum(r.source == "table 3.4" and "heat correction" in r.quantity for r in rows) == 16


def few(verdict):
    return [VerifyRow("x", "table 0", "1", "2", verdict, "because")]


def test_a_row_that_differs_ends_in_exit_code_one(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "verify_rows", lambda: few("differs"))
    result = CliRunner().invoke(app, ["--csv", str(tmp_path / "rows.csv")])
    assert result.exit_code == 1
    assert "1 differ" in result.output
    assert (tmp_path / "rows.csv").read_text().startswith("quantity,source,published,ours,verdict,why")


def test_rows_that_agree_end_well_and_print_their_reasons_when_asked(monkeypatch):
    monkeypatch.setattr(command, "verify_rows", lambda: few("agrees"))
    result = CliRunner().invoke(app, ["--why"])
    assert result.exit_code == 0
    assert "because" in result.output


def test_a_changed_formula_is_caught(monkeypatch):
    """The misprinted (4.7) gives another beta: the row must say so."""
    from tcdyn.verify import contact_rows

    monkeypatch.setattr(contact_rows, "speed_law_beta", lambda a, b, c, d, chi: (a * d + chi * b * c) / (d + chi * b))
    failed = [r.quantity for r in contact_rows.speed_law_rows() if r.failed]
    assert "beta of the worked example" in failed


def test_the_report_has_the_table_and_four_pictures(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "verify_rows", lambda: few("not checkable"))
    page = tmp_path / "verify.html"
    assert CliRunner().invoke(app, ["--report", str(page)]).exit_code == 0
    html = page.read_text()
    assert html.count("data:image/png") == 4
    assert "not checkable" in html


def test_the_list_fits_eighty_columns_and_gives_a_shared_reason_once(monkeypatch):
    long = [VerifyRow(f"error of mesh {k} at 2, 4, 8, 15 s, %", "table 3.2", "1, 2", "3, 4", "same trend", "word " * 40)
            for k in range(4)]  # fmt: skip
    monkeypatch.setattr(command, "verify_rows", lambda: [*few("agrees"), *long])
    result = CliRunner().invoke(app, [], env={"COLUMNS": "80"})
    assert max(len(line) for line in result.output.splitlines()) <= 80
    assert result.output.count("word") == 40
    assert result.output.index("same trend (") < result.output.index("agrees (")  # what needs reading comes first
    assert "because" not in result.output
