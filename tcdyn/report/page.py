"""Self-contained HTML pages: main result, warnings, assumptions, sections.

In a table numbers are aligned right and unbroken, text left, and a value and its uncertainty are
rounded alike. A figure stands on the page twice: as charts (:mod:`tcdyn.report.interactive`) and as
a picture, for print and for browsers without scripts. Charts and the script of Plotly, one copy a
page, are compressed; the browser inflates them.

Used by every module of ``tcdyn/report`` and by the commands that write a page directly. Limits are
chosen by judgement. Tests:
``tests/report/test_page.py``.
"""

from __future__ import annotations

import base64
import gzip
import html
import io
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import resources
from numbers import Real
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.text import Text
from plotly.offline import get_plotlyjs

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, text_with_u
from tcdyn.core.findings import Finding, infos, messages, warnings_and_errors
from tcdyn.core.result import Result
from tcdyn.io.endings import PAGE, check_ending
from tcdyn.io.write import write_text
from tcdyn.plots.pick import draw
from tcdyn.plots.style import figure as new_figure
from tcdyn.report.interactive import NotConvertible, convert_figure
from tcdyn.version import __version__

# Plain text of units and signs, and how a page writes it.
SIGNS = (
    ("+-", "±"),
    (" degC", " °C"),
    ("[degC", "[°C"),
    ("W/m2K", "W/m²K"),
    ("W/mK", "W/m K"),
    ("kg/m3", "kg/m³"),
    ("mm2/s", "mm²/s"),
)
# Control characters, which HTML does not allow; tab and newline are kept.
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
# A unit in a heading.
UNIT = re.compile(r"\[[^\]]*\]")
UNBROKEN = re.compile(r" (?=[±%=] )|(?<=[±=]) | (?=%|°C|u_s)")  # spaces at which no line ends
MAX_ROWS_UNBROKEN = 20  # rows of a table that stays on one printed page; chosen by judgement
# Mark of a page whose numbers come from simulated logs.
SIMULATED = "simulated"
COMPRESSION = 3  # of PNG: a third faster than the usual 6, and larger by a fortieth; measured
MARGIN_IN = 0.1  # white margin around a figure [inch]; chosen by judgement
MAX_CHARACTERS = 28  # a longer cell is a sentence, or a word that may be broken; judgement


@dataclass(frozen=True)
class Section:
    """A section of a page: a heading with any of text, a table, and a figure with its caption.

    Parameters
    ----------
    text
        Paragraphs, with a blank line between them.
    folded
        Whether a click opens the section. It is not printed unless it is open.
    image, charts
        The figure as a ``data:`` address and as charts, once it is rendered.
    width_in
        Width of the figure [inch], which limits its size on a narrow screen.
    title
        Heading.
    table, figure
        Content below the text.
    caption
        Text below the figure.
    """

    title: str
    text: str = ""
    table: pd.DataFrame | None = None
    figure: Figure | None = None
    caption: str = ""
    folded: bool = False
    image: str = ""
    charts: dict[str, Any] | None = None
    width_in: float = 0.0

    @property
    def paragraphs(self) -> list[str]:
        """Paragraphs of the text."""
        return _paragraphs(self.text)

    @property
    def table_html(self) -> str:
        """The table as HTML; empty without one."""
        if self.table is None:
            return ""
        return table_html(self.table)

    @property
    def short(self) -> bool:
        """Whether heading, text and table stay on one printed page."""
        return self.table is None or len(self.table) <= MAX_ROWS_UNBROKEN

    def render(self) -> Section:
        """Return the section with picture and charts instead of its figure."""
        if self.figure is None:
            return self
        image = figure_data_uri(self.figure)
        width_in = float(self.figure.get_figwidth())
        caption = self.caption
        charts = None
        try:
            charts = convert_figure(self.figure)
        except NotConvertible as problem:
            caption = f"{caption} (A picture only: no chart of a {problem}.)".lstrip()
        return replace(
            self, figure=None, caption=caption, image=image, charts=charts, width_in=width_in
        )


@dataclass(frozen=True)
class MainResult:
    """The result at the top of a page: a value in large type, a detail, and its status.

    Attributes
    ----------
    value
        The value, with its uncertainty.
    detail
        Line below it.
    status
        Status of the result, for its colour.
    """

    value: str
    detail: str = ""
    status: str = ""


def _paragraphs(text: str) -> list[str]:
    """Return the paragraphs of a text, which blank lines separate."""
    return [part.strip() for part in text.split("\n\n") if part.strip()]


def figure_data_uri(figure: Figure, dpi: int = 130) -> str:
    """Return the figure as a ``data:`` address, so that the page needs no other file.

    The image ends ``MARGIN_IN`` beyond the plotted content. Names in the figure are literal text,
    without mathematical notation.

    Parameters
    ----------
    figure
        The figure.
    dpi
        Resolution.

    Returns
    -------
    uri
        PNG, base64.
    """
    for text in figure.findobj(Text):
        text.set(text=CONTROL.sub(" ", text.get_text()), parse_math=False)
    buffer = io.BytesIO()
    metadata = {"Software": None}
    figure.savefig(
        buffer,
        format="png",
        metadata=metadata,
        pil_kwargs={"compress_level": COMPRESSION},
        dpi=dpi,
        bbox_inches="tight",
        pad_inches=MARGIN_IN,
    )
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def gzip_base64(text: str) -> str:
    """Return a text compressed by gzip, in base64, for a script of the page."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def card_html(result: Result) -> str:
    """Return HTML of a result in a notebook: its card, and its figure if one needs no more data.

    >>> from tcdyn.chain import Chain
    >>> card_html(Chain([0.6, 0.1])).count("<img")
    1
    """
    fig, (ax,) = new_figure(height_in=3.6)
    card = result._repr_html_()
    try:
        draw(result, ax)
    except (InputError, TypeError):  # no figure, or one that needs more than the result
        return card
    return f'{card}<img src="{figure_data_uri(fig, 90)}" alt="{type(result).__name__}">'


def render_page(
    title: str,
    sections: Sequence[Section],
    *,
    verdict: str = "",
    findings: Sequence[Finding] = (),
    assumptions: Sequence[str] = (),
    main_results: Sequence[MainResult] = (),
    lead: Section | None = None,
    sources: pd.DataFrame | None = None,
    marks: Sequence[str] = (),
    footer: str = "",
) -> str:
    """Return a page as HTML.

    Parameters
    ----------
    title
        Heading and title of the page.
    sections
        In the order of the page.
    verdict
        Conclusion in sentences, after the main results.
    findings
        Warnings and errors are listed before the notes.
    assumptions
        What was assumed and not measured.
    main_results
        Values in large type at the top.
    lead
        Section whose figure follows the verdict.
    sources
        Table of the files that the numbers come from.
    marks
        Words in a frame beside the title, such as "simulated"; they are printed on each page.
    footer
        Last line; by default version and time.

    Returns
    -------
    html
        The complete page.
    """
    sections = [section.render() for section in sections]
    lead = None if lead is None else lead.render()
    with_figure = [s for s in (lead, *sections) if s is not None and s.charts is not None]
    charts = {f"figure-{k}": section.charts for k, section in enumerate(with_figure)}
    figure_ids = {id(section): name for name, section in zip(charts, with_figure)}
    content = [f"{s.text}{s.table_html}{s.caption}" for s in sections]
    has_uncertainty = "+-" in verdict or any("±" in typeset(text) for text in content)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["typeset"] = lambda text: UNBROKEN.sub("\u00a0", typeset(text))
    template = resources.files("tcdyn.report").joinpath("templates/page.html.j2")
    page = environment.from_string(template.read_text(encoding="utf-8")).render(
        title=title,
        sections=sections,
        verdict=_paragraphs(verdict),
        warnings=messages(warnings_and_errors(findings)),
        notes=messages(infos(findings)),
        assumptions=list(assumptions),
        main_results=main_results,
        lead=lead,
        sources="" if sources is None else table_html(sources),
        marks=list(marks),
        footer=footer or f"tcdyn {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        plus_minus=has_uncertainty,
        figure_id=lambda section: figure_ids.get(id(section), ""),
        charts=gzip_base64(json.dumps(charts, ensure_ascii=False)) if charts else "",
        script=resources.files("tcdyn.report").joinpath("templates/charts.js").read_text("utf-8"),
        plotly=gzip_base64(get_plotlyjs()) if charts else "",
    )
    return CONTROL.sub(" ", page)


def write_page(path: str | Path, title: str, sections: Sequence[Section], **options: Any) -> Path:
    """Write the page of :func:`render_page` atomically and return its path.

    ``options``: keyword arguments of :func:`render_page`.

    Parameters
    ----------
    path
        File to write.
    title
        Heading and title of the page.
    sections
        In the order of the page.
    **options
        Keyword arguments of :func:`render_page`.

    Returns
    -------
    path
        The same path.

    Raises
    ------
    InputError
        For an ending that is not one of a page, before anything is rendered.
    """
    check_ending(path, PAGE)
    return write_text(path, render_page(title, sections, **options))


def typeset(text: str) -> str:
    """Return plain text with the signs of a page.

    >>> typeset("0.681 +- 0.009 at 110 degC in fast_a_degC")
    '0.681 ± 0.009 at 110 °C in fast_a_degC'
    """
    for plain, sign in SIGNS:
        text = text.replace(plain, sign)
    return text


def cells_with_u(values: Iterable[float], uncertainties: Iterable[float]) -> list[str]:
    """Return cells "value ± u"; empty for nan.

    The standard uncertainty has two digits, and the value is rounded to match.

    Parameters
    ----------
    values, uncertainties
        Numbers of one length.

    Examples
    --------
    >>> cells_with_u([0.68149, float("nan")], [0.0093, 0.1])
    ['0.6815 ± 0.0093', '']
    """
    cells = []
    for value, u in zip(values, uncertainties):
        is_nan = value != value
        cells.append("" if is_nan else typeset(text_with_u(float(value), float(u))))
    return cells


def table_html(table: pd.DataFrame) -> str:
    """Return a table as HTML: numbers right and unbroken, text left, sentences in a wide column.

    Parameters
    ----------
    table
        Any table; cells as of :func:`cell`.

    Notes
    -----
    Test: ``tests/report/test_page.py``.
    """
    columns = [[cell(value) for value in table.iloc[:, k]] for k in range(table.shape[1])]
    kinds = [_column_class(cells) for cells in columns]
    titles = [str(name) for name in table.columns]
    heads = [f'<th class="{kind}">{_title_html(title)}</th>' for title, kind in zip(titles, kinds)]
    names = [html.escape(typeset(title)) for title in titles]
    rows = []
    for cells in zip(*columns):
        row = ""
        for text, kind, name in zip(cells, kinds, names):
            row += f'<td class="{kind}" data-name="{name}">{html.escape(text)}</td>'
        rows.append(f"<tr>{row}</tr>")
    short = ' class="short"' if len(table) <= MAX_ROWS_UNBROKEN else ""
    head = f"<thead><tr>{''.join(heads)}</tr></thead>"
    return f"<table{short}>{head}<tbody>{''.join(rows)}</tbody></table>"


def cell(value: object) -> str:
    """Return the text of a cell; a number without uncertainty has four digits.

    >>> cell(Estimate.normal(0.6543, 0.0123)), cell(745.88532), cell(True), cell(None)
    ('0.654 ± 0.012', '745.9', 'yes', '')
    """
    if value is None or value != value:
        return ""
    if isinstance(value, Estimate):
        return typeset(value.text())
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Real) and not isinstance(value, int):
        return f"{float(value):.4g}"
    return typeset(str(value))


def _title_html(name: str) -> str:
    """Return a column's title as HTML, its unit in one piece."""
    return UNIT.sub(lambda unit: f'<span class="unit">{unit[0]}</span>', html.escape(typeset(name)))


def _column_class(cells: list[str]) -> str:
    """Return the CSS class of a column.

    "prose" for sentences, "long" for unbroken words, "words" for short text, "number" for all else.

    Notes
    -----
    ``MAX_CHARACTERS`` decides which cells count as sentences.
    """
    long_cells = [text for text in cells if len(text) > MAX_CHARACTERS]
    if any(" " in text for text in long_cells):
        return "prose"
    if long_cells:
        return "long"
    filled = [text for text in cells if text]
    has_number = any(text[0] in "0123456789+-.<" for text in filled)
    return "words" if filled and not has_number else "number"
