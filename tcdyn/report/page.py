"""One self-contained HTML page: verdict, warnings, notes and assumptions first, then words, tables and pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from calibration.files.write import write_text
from calibration.finding import Finding, doubts, notes, sentences
from tcdyn.report.tables import table_html, typeset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Section", "figure_data_uri", "render_page", "table_html", "write_page"]


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
    findings: Sequence[Finding] = (),
    assumptions: Sequence[str] = (),
    footer: str = "",
) -> str:
    """The page as HTML text; of ``findings`` the notes stand apart."""
    import jinja2

    source = resources.files("tcdyn.report").joinpath("templates/page.html.j2").read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["typeset"] = typeset
    return environment.from_string(source).render(
        title=title,
        sections=sections,
        verdict=[part.strip() for part in verdict.split("\n\n") if part.strip()],
        warnings=sentences(doubts(findings)),
        notes=sentences(notes(findings)),
        assumptions=list(assumptions),
        footer=footer,
        plus_minus=any("±" in typeset(f"{s.text}{s.table_html}{s.caption}") for s in sections) or "+-" in verdict,
    )


def write_page(
    path: str | Path,
    title: str,
    sections: Sequence[Section],
    *,
    verdict: str = "",
    findings: Sequence[Finding] = (),
    assumptions: Sequence[str] = (),
    footer: str = "",
) -> Path:
    """Write the page beside and rename it into place; returns its path."""
    page = render_page(title, sections, verdict=verdict, findings=findings, assumptions=assumptions, footer=footer)
    return write_text(path, page)
