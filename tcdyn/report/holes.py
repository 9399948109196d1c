"""Page of ``tcdyn rig holes``: extra lags of cemented thermocouples over the clamped ones.

The comparison is :mod:`immersion.hole`. Test: ``tests/cli/test_hole_command.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from immersion.hole import HoleComparison
from tcdyn.core.findings import Finding
from tcdyn.plots.plunge import draw_holes
from tcdyn.plots.style import panel_figure
from tcdyn.report.page import Section, write_page
from tcdyn.report.sources import log_row
from tcdyn.report.sources import to_table as sources
from tcdyn.rig.log import Log

PLUNGE_CAPTION = (
    "Dots: readings; lines: the fit. All junctions have the same temperature around them, so a "
    "curve that lags the clamped ones (ideal) is delayed by its hole and cement."
)


def write_holes_report(
    path: str | Path,
    comparison: HoleComparison,
    log: Log,
    depth_mm: tuple[float, float],
    findings: Sequence[Finding],
) -> Path:
    """Write the page of a comparison of holes and return its path.

    Parameters
    ----------
    path
        File to write.
    comparison
        The comparison.
    log
        The log that it was made from.
    depth_mm
        Depth of all junctions and its standard uncertainty [mm].
    findings
        Findings of log and comparison.

    Returns
    -------
    path
        The same path.
    """
    depth, depth_u = depth_mm
    picture = panel_figure(partial(draw_holes, comparison), height_in=4.5)
    sections = [
        Section("Extra lag of each hole", table=comparison.card()),
        Section("The plunge", figure=picture, caption=PLUNGE_CAPTION),
    ]
    return write_page(
        path,
        f"Holes and cement: {log.path.name}",
        sections,
        verdict=comparison.summary().replace("\n", "\n\n"),
        findings=findings,
        sources=sources([log_row(log)]),
        assumptions=[f"all junctions lie {depth:g} +- {depth_u:g} mm deep, at one temperature"],
    )
