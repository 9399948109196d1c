"""One self-contained HTML page: sections of words, tables and pictures, warnings first."""

from __future__ import annotations

import base64
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
        return [part.strip() for part in self.text.split("\n\n") if part.strip()]

    @property
    def table_html(self) -> str:
        if self.table is None:
            return ""
        return str(self.table.to_html(index=False, border=0, escape=True, na_rep="", float_format=lambda x: f"{x:.5g}"))

    @property
    def image(self) -> str:
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
    html = render_page(title, sections, verdict=verdict, warnings=warnings, assumptions=assumptions, footer=footer)
    return write_text(path, html)
