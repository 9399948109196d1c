"""One self-contained HTML page: verdict, warnings, notes and assumptions first, then words, tables and pictures.

In a table numbers stand right and unbroken, words left, a value and its uncertainty rounded alike.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import resources
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, with_u
from tcdyn.core.findings import Finding, infos, messages, warnings_and_errors
from tcdyn.core.result import Result
from tcdyn.io.write import write_text
from tcdyn.smoothing.record import Compensated
from tcdyn.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGNS = (
    ("+-", "±"),
    (" degC", " °C"),
    ("[degC", "[°C"),
    ("W/m2K", "W/m²K"),
    ("W/mK", "W/m K"),
    ("kg/m3", "kg/m³"),
    ("mm2/s", "mm²/s"),
)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
UNIT = re.compile(r"\[[^\]]*\]")
UNBROKEN = re.compile(r" (?=[±%=] )|(?<=[±=]) | (?=%|°C|u_s)")  # spaces at which no line ends
SHORT = 20  # rows; a table of so many stays on one printed page
COMPRESSION = 3  # of pictures: a third quicker than the usual 6, and larger by a fortieth
MARGIN_IN = 0.1  # round a picture
LONG = 28  # characters; beyond it a cell is a sentence, or a word to be broken


@dataclass(frozen=True)
class Section:
    """A heading with any of: paragraphs of text (blank line between them), a table, a figure with its caption.

    ``folded``: opened by a click, and left out in print unless it is open; ``image``: the figure once it is drawn, as a
    ``data:`` address, ``width_in`` [inch] wide, by which a narrow screen knows how small it may be shown.
    """

    title: str
    text: str = ""
    table: pd.DataFrame | None = None
    figure: Figure | None = None
    caption: str = ""
    folded: bool = False
    image: str = ""
    width_in: float = 0.0

    @property
    def paragraphs(self) -> list[str]:
        """The text's paragraphs, as the template takes them."""
        return [part.strip() for part in self.text.split("\n\n") if part.strip()]

    @property
    def table_html(self) -> str:
        """The table as HTML; empty without one."""
        if self.table is None:
            return ""
        return table_html(self.table)

    @property
    def short(self) -> bool:
        """Whether heading, words and table stay on one printed page."""
        return self.table is None or len(self.table) <= SHORT

    def drawn(self) -> Section:
        """The section with an image in the place of its figure."""
        if self.figure is None:
            return self
        image = figure_data_uri(self.figure)
        width_in = float(self.figure.get_figwidth())
        return replace(self, figure=None, image=image, width_in=width_in)


@dataclass(frozen=True)
class Answer:
    """What a page says first, in large type: a number, what it rests on, and whether it can be used as it stands."""

    value: str
    detail: str = ""
    status: str = ""


def figure_data_uri(figure: Figure, dpi: int = 130) -> str:
    """The figure as a ``data:`` address, so that the page needs no other file; names stand in it sign by sign.

    It is drawn once and cut a tenth of an inch beyond what is drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text
    from PIL import Image, ImageOps

    for words in figure.findobj(Text):
        if (
            "\\math" not in words.get_text()
        ):  # no number of a logarithmic axis: a dollar is a dollar
            words.set(text=CONTROL.sub(" ", words.get_text()), parse_math=False)
    was = (figure.canvas, figure.dpi)
    canvas = FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.set_dpi(dpi)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    left, top, right, bottom = ImageOps.invert(picture).getbbox() or (0, 0, *picture.size)
    placed = [
        words
        for part in (figure, *figure.axes)
        for words in part.get_children()
        if isinstance(words, Text)
    ]
    boxes = [
        words.get_window_extent() for words in placed if words.get_text()
    ]  # headings, whose width no layout heeds
    left_in = min([left, *(b.x0 for b in boxes)])
    right_in = max([right, *(b.x1 for b in boxes)])
    inside = min(left_in, top, picture.width - right_in, picture.height - bottom) > 0
    figure.set_canvas(was[0])
    figure.set_dpi(was[1])
    if inside and figure.get_facecolor() == (1.0, 1.0, 1.0, 1.0):
        cut = picture.crop((left, top, right, bottom))
        ImageOps.expand(cut, round(MARGIN_IN * dpi), "white").save(
            buffer, "png", compress_level=COMPRESSION
        )
    else:  # something may reach beyond the figure
        more: Any = {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": COMPRESSION}}
        figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", **more)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def card_html(result: Result) -> str:
    """A result in a notebook: its own card with its picture, where it has one that needs nothing else.

    >>> from tcdyn.chain import Chain
    >>> card_html(Chain([0.6, 0.1])).count("<img")
    1
    """
    from tcdyn.plots.pick import draw  # knows every picture, which no page needs
    from tcdyn.plots.style import figure

    picture, (ax,) = figure(height_in=3.6)
    try:
        draw(result, ax, **({"logged": None} if isinstance(result, Compensated) else {}))
    except (InputError, TypeError):  # no picture of it, or one that needs more than the result
        return result._repr_html_()
    return f'{result._repr_html_()}<img src="{figure_data_uri(picture, 90)}" alt="{type(result).__name__}">'


def render_page(
    title: str,
    sections: Sequence[Section],
    *,
    verdict: str = "",
    findings: Sequence[Finding] = (),
    assumptions: Sequence[str] = (),
    answers: Sequence[Answer] = (),
    lead: Section | None = None,
    sources: pd.DataFrame | None = None,
    simulated: bool = False,
    footer: str = "",
) -> str:
    """The page as HTML text; of ``findings`` the notes stand apart.

    ``answers`` and the picture of ``lead`` stand before all else; ``sources``: the files that the numbers come from.
    """
    import jinja2

    every = [*sections] if lead is None else [lead, *sections]
    every = [section.drawn() for section in every]
    lead, sections = (None, every) if lead is None else (every[0], every[1:])
    source = (
        resources.files("tcdyn.report")
        .joinpath("templates/page.html.j2")
        .read_text(encoding="utf-8")
    )
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["typeset"] = lambda text: UNBROKEN.sub("\u00a0", typeset(text))
    page = environment.from_string(source).render(
        title=title,
        sections=sections,
        verdict=[part.strip() for part in verdict.split("\n\n") if part.strip()],
        warnings=messages(warnings_and_errors(findings)),
        notes=messages(infos(findings)),
        assumptions=list(assumptions),
        answers=answers,
        lead=lead,
        sources="" if sources is None else table_html(sources),
        simulated=simulated,
        footer=footer or f"tcdyn {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        plus_minus=any("±" in typeset(f"{s.text}{s.table_html}{s.caption}") for s in sections)
        or "+-" in verdict,
    )
    return CONTROL.sub(" ", page)


def write_page(path: str | Path, title: str, sections: Sequence[Section], **more: Any) -> Path:
    """Write the page of ``render_page``, ``more`` as there, beside and rename it into place; returns its path."""
    return write_text(path, render_page(title, sections, **more))


def typeset(text: str) -> str:
    """Plain words as a page shows them.

    >>> typeset("0.681 +- 0.009 at 110 degC in fast_a_degC")
    '0.681 ± 0.009 at 110 °C in fast_a_degC'
    """
    for plain, sign in SIGNS:
        text = text.replace(plain, sign)
    return text


def pm(values: Iterable[float], uncertainties: Iterable[float]) -> list[str]:
    """Cells "value ± u": the standard uncertainty to two digits, the value rounded to match; empty for nan.

    >>> pm([0.68149, float("nan")], [0.0093, 0.1])
    ['0.6815 ± 0.0093', '']
    """
    return [
        "" if v != v else typeset(with_u(float(v), float(u))) for v, u in zip(values, uncertainties)
    ]


def table_html(table: pd.DataFrame) -> str:
    """The table as HTML: numbers right and unbroken, words left, long sentences in a column wide enough to read."""
    columns = [[cell(v) for v in table.iloc[:, k]] for k in range(table.shape[1])]
    kinds = [_kind(cells) for cells in columns]
    head = "".join(
        f'<th class="{k}">{_heading(str(name))}</th>' for name, k in zip(table.columns, kinds)
    )
    names = [html.escape(typeset(str(name))) for name in table.columns]
    rows = (
        "<tr>"
        + "".join(
            f'<td class="{k}" data-name="{n}">{html.escape(c)}</td>'
            for c, k, n in zip(row, kinds, names)
        )
        + "</tr>"
        for row in zip(*columns)
    )
    short = ' class="short"' if len(table) <= SHORT else ""
    return f"<table{short}><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def cell(value: object) -> str:
    """A cell's text; a bare number, whose uncertainty nobody stated, with four digits.

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


def _heading(name: str) -> str:
    """A column's name, its unit kept in one piece."""
    return UNIT.sub(lambda unit: f'<span class="unit">{unit[0]}</span>', html.escape(typeset(name)))


def _kind(cells: list[str]) -> str:
    """ "prose" for sentences, "long" for unbroken words, "words" for short text, "number" for all else."""
    if any(len(c) > LONG and " " in c for c in cells):
        return "prose"
    if any(len(c) > LONG for c in cells):
        return "long"
    filled = [c for c in cells if c]
    return "words" if filled and not any(c[0] in "0123456789+-.<" for c in filled) else "number"
