"""Layout of pages: cells rounded to their uncertainty, warnings separate from notes, numbers with
their signs."""

from __future__ import annotations

from base64 import b64decode
from io import BytesIO
from pathlib import Path

import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Rectangle

from calibration.decisions import channel_verdicts
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.plots.style import figure
from tcdyn.report.page import Section, cells_with_u, figure_data_uri, render_page, table_html
from tcdyn.report.sources import log_row, record_rows
from tcdyn.rig.log import Log
from tcdyn.rig.record import read_record
from tcdyn.workflows.beta_tables import u_beta_text


def with_ordinary_spaces(page: str) -> str:
    """The page with ordinary spaces in place of non-breaking ones."""
    return page.replace("\u00a0", " ")


def test_number_is_not_separated_from_its_sign_or_unit_at_a_line_end() -> None:
    page = render_page("B3", [Section("x", "beta = 0.66 +- 0.01, 95 %: 0.64 to 0.68 at 110 degC")])
    assert "beta\u00a0=\u00a00.66\u00a0±\u00a00.01, 95\u00a0%: 0.64 to 0.68 at 110\u00a0°C" in page


def test_picture_scrolls_at_a_readable_size_and_prints_with_its_heading() -> None:
    """Where no script runs, and on paper."""
    fig, (ax,) = figure(1, 1, width_in=8.5)
    ax.plot([0, 1])
    page = render_page("B3", [Section("x", figure=fig, caption="what to see")])
    assert '<div class="keep">\n<h2>x</h2>' in page
    assert (
        page.index('<div class="scroll picture"><img')
        < page.index('style="--in: 8.5"')
        < page.index("<figcaption>what")
    )
    long_table = pd.DataFrame({"row": range(40)})
    assert 'class="keep"' not in render_page("B3", [Section("x", table=long_table)])


@pytest.mark.parametrize(("end", "width_in"), [(0.75, 1.2), (1.25, 2.2)])
def test_picture_is_cropped_a_tenth_of_an_inch_beyond_its_content(end, width_in) -> None:
    fig = Figure(figsize=(2.0, 2.0))
    fig.add_artist(Rectangle((0.25, 0.25), end - 0.25, 0.5))
    picture = imread(BytesIO(b64decode(figure_data_uri(fig, 100).split(",")[1])))
    # pixels that are partly covered
    assert picture.shape[:2] == pytest.approx((120, 100 * width_in), abs=2)


@pytest.mark.e2e
def test_heading_wider_than_its_picture_is_shown_completely() -> None:
    """Also if the border falls between two letters. The figure itself stays unchanged."""
    for pad in range(12):
        fig = Figure(figsize=(2.0, 1.5), layout="constrained")
        ax = fig.add_subplot()
        ax.set_title("iiiiiiiiii" * 4 + "i" * pad)
        before = fig.canvas, fig.dpi
        picture = imread(BytesIO(b64decode(figure_data_uri(fig, 100).split(",")[1])))
        assert (fig.canvas, fig.dpi) == before
        fig.set_dpi(100)
        renderer = FigureCanvasAgg(fig).get_renderer()
        assert picture.shape[1] >= ax.title.get_window_extent(renderer).width


def test_cells_are_formatted_by_their_content() -> None:
    html = table_html(
        pd.DataFrame(
            {
                "way": ["speed law", "joint fit"],
                "β [1]": ["0.710 +- 0.009", ""],
                "h": [745.88532, float("nan")],
                "why": ["the log is truncated: copy the file again", "a < b & c"],
                "sha": ["0123456789abcdef0123456789abcdef", ""],
            }
        )
    )
    assert (
        '<td class="words" data-name="way">speed law</td>'
        '<td class="number" data-name="β [1]">0.710 ± 0.009</td>' in html
    )
    # the name is shown where a row becomes a card
    assert '<td class="number" data-name="h">745.9</td>' in html
    assert (
        '<td class="number" data-name="h"></td>'
        '<td class="prose" data-name="why">a &lt; b &amp; c</td>' in html
    )
    assert '<th class="prose">why</th>' in html
    assert '<th class="number">β <span class="unit">[1]</span></th>' in html
    assert '<td class="long" data-name="sha">0123456789abcdef0123456789abcdef</td>' in html


def test_table_of_twenty_rows_is_kept_on_one_printed_page() -> None:
    for rows, is_short in ((20, True), (21, False)):
        assert (
            table_html(pd.DataFrame({"row": range(rows)})).startswith('<table class="short">')
            == is_short
        )


def test_uncertainty_below_the_last_digit_is_given_as_below_it() -> None:
    assert (u_beta_text(0.0123), u_beta_text(0.00005), u_beta_text(0.000049)) == (
        "0.0123",
        "0.0001",
        "below 0.0001",
    )


def test_sources_name_the_record_file_and_the_complete_log_of_a_section(tmp_path: Path) -> None:
    file = Path(__file__).parents[1] / "rig" / "of_version_0_1.disk.json"
    record = read_record(file)
    logs = ", ".join(f.file for f in record.inputs)
    (by_file,), (without_file,) = (record_rows({"fast": record}, files) for files in ([file], []))
    assert (by_file[1], without_file[1]) == (f"{file.name}, of {logs}", logs)
    frame = pd.DataFrame({"time_s": [0.0, 1.0]})
    section = Log(frame, "ehl", tmp_path / "D4.2.csv", "00", 1.0)
    assert log_row(section)[1] == "D4.csv, test 2"
    section.path.touch()  # a file of this name is taken as it is
    assert log_row(section)[1] == "D4.2.csv"


def test_value_is_rounded_to_its_uncertainty() -> None:
    assert cells_with_u([0.681487, 747.3], [0.00934, 60.2]) == ["0.6815 ± 0.0093", "747 ± 60"]
    html = table_html(pd.DataFrame({"lag": [Estimate.normal(0.74512, 0.0163)]}))
    assert ">0.745 ± 0.016<" in html


def test_corrected_findings_are_notes_and_the_others_warnings() -> None:
    corrected = "651 spikes in 12 channels were taken as missing, most in fast_c_degC (122)"
    alarm = (
        "fast disk: c read 22 to 140 degC, calibrated from 20 to 130 degC: static lines "
        "extrapolate there"
    )
    findings = [info("from_file", text=corrected), warning("from_file", text=alarm)]
    page = with_ordinary_spaces(
        render_page(
            "B3", [Section("x", "0.66 +- 0.01 W/m2K")], findings=findings, assumptions=["n = 2/3"]
        )
    )
    warnings_html, notes_html = (
        page.split(f'<div class="{kind}">')[1].split("</div>")[0] for kind in ("warnings", "notes")
    )
    assert corrected in notes_html
    assert corrected not in warnings_html
    assert "22 to 140 °C" in warnings_html
    assert "0.66 ± 0.01 W/m²K" in page
    assert page.index("n = 2/3") < page.index("<h2>")  # assumptions come first
    only_corrected = render_page("B3", [], findings=findings[:1])
    assert '<div class="warnings">' not in only_corrected


@pytest.mark.parametrize(
    ("finding", "is_unfit"),
    [
        (
            warning(
                "values.absent",
                subject="e_degC",
                count=1,
                row=9,
                time_s=0.1,
                length=1,
                length_s=0.013,
            ),
            False,
        ),
        (
            warning(
                "line.extrapolated",
                subject="a, e",
                read_degC=[20, 190],
                range_degC=[20, 160],
                u_K=0.3,
            ),
            False,
        ),
        (warning("noise.high", subject="e_degC", noise_K=2.0, others_K=0.14), True),
        (warning("line.curved", subject="e", p=0.001), True),
    ],
)
def test_gap_in_a_log_does_not_disqualify_a_thermocouple_but_noise_does(
    finding: Finding, is_unfit: bool
) -> None:
    file = Path(__file__).parents[1] / "rig" / "of_version_0_1.disk.json"
    record = read_record(file)
    before = channel_verdicts(record)
    after = channel_verdicts(record.model_copy(update={"findings": [*record.findings, finding]}))
    assert {c for c in before if before[c] != after[c]} == ({"e"} if is_unfit else set())
