"""One self-contained HTML page: sections of words, tables and pictures, warnings first."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from calibration.write import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Section:
    """A heading with any of: paragraphs of text (blank line between them), a table, a figure with its caption."""

    title: str
    text: str = ""
    table: pd.DataFrame | None = None
    figure: Figure | None = None
    caption: str = ""

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
    def image(self) -> str:
        """The figure as a ``data:`` address; empty without one."""
        return "" if self.figure is None else figure_data_uri(self.figure)


def table_html(table: pd.DataFrame) -> str:
    """The table as HTML: numbers right and unbroken, words left, long sentences in a column wide enough to read."""
    columns = [[_cell(v) for v in table.iloc[:, k]] for k in range(table.shape[1])]
    kinds = [_kind(cells) for cells in columns]
    head = "".join(f'<th class="{k}">{html.escape(str(name))}</th>' for name, k in zip(table.columns, kinds))
    rows = (
        "<tr>" + "".join(f'<td class="{k}">{html.escape(c)}</td>' for c, k in zip(row, kinds)) + "</tr>"
        for row in zip(*columns)
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _cell(value: object) -> str:
    if value is None or value != value:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _kind(cells: list[str]) -> str:
    """ "prose" for long text, "words" for short text, "number" for all else."""
    if any(len(c) > 28 and " " in c for c in cells):
        return "prose"
    filled = [c for c in cells if c]
    return "words" if filled and not any(c[0] in "0123456789+-.<" for c in filled) else "number"


def figure_data_uri(figure: Figure, dpi: int = 130) -> str:
    """The figure as a ``data:`` address, so that the page needs no other file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def render_page(
    title: str,
    sections: Sequence[Section],
    *,
    verdict: str = "",
    warnings: Sequence[str] = (),
    assumptions: Sequence[str] = (),
    footer: str = "",
) -> str:
    """The page as HTML text."""
    import jinja2

    source = resources.files("tcdyn.report").joinpath("templates/page.html.j2").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)
    return template.render(
        title=title,
        sections=sections,
        verdict=verdict,
        warnings=list(warnings),
        assumptions=list(assumptions),
        footer=footer,
    )


def write_page(
    path: str | Path,
    title: str,
    sections: Sequence[Section],
    *,
    verdict: str = "",
    warnings: Sequence[str] = (),
    assumptions: Sequence[str] = (),
    footer: str = "",
) -> Path:
    """Write the page beside and rename it into place; returns its path."""
    page = render_page(title, sections, verdict=verdict, warnings=warnings, assumptions=assumptions, footer=footer)
    return write_text(path, page)
