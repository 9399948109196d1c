"""Report of an EHL test with one logged disk: estimates of beta, fit, uncertainty budget.

Written by ``tcdyn beta`` for a log of one disk. It shares head, fit and tests with
:mod:`tcdyn.report.beta`. Tests: ``tests/partition/test_one_disk.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from tcdyn.partition.single_disk import OneDisk
from tcdyn.plots import partition as draw
from tcdyn.plots.style import panel_figure
from tcdyn.report.beta import fit_section, lead_section, test_sections, write_tests
from tcdyn.report.page import MainResult, Section
from tcdyn.workflows.beta_tables import u_of_beta
from tcdyn.workflows.single_disk import one_disk_estimates_table


def one_disk_sections(p: OneDisk) -> list[Section]:
    """Return the sections of one test, that of the page's head first; the appendix is folded."""
    main = [lead_section(p), *_estimate_sections(p), fit_section(p, [p.disk]), _budget(p)]
    appendix = [_line(p), _unevenness(p), *test_sections(p)]
    return [*main, *(replace(section, folded=True) for section in appendix)]


def main_result(p: OneDisk) -> MainResult:
    """Return beta with its interval, or that none is given."""
    if p.status == "withheld":
        detail = f"the result of the joint fit of the {p.disk} disk is impossible"
        return MainResult("no β", detail, p.status)
    beta = p.estimates["joint"]
    return MainResult(
        f"β = {beta}", f"95 %: {beta.interval_text}; by the {p.disk} disk alone", p.status
    )


def _estimate_sections(p: OneDisk) -> list[Section]:
    """Return the sections of all estimates of beta, and of the unloading."""
    return [
        Section(
            "the estimates of β",
            "Joint fit: β, h and lag together from the traces as logged. Cooling fit: h from the "
            "compensated traces after the unloading, and β from the steady line at that h. Speed "
            "law and the fit of both disks need the other disk, so nothing here checks friction, "
            "steel and depths by shares that add to one.",
            table=one_disk_estimates_table(p),
        ),
        Section(
            "the unloading, as logged and compensated",
            f"Common lag from the unloading, the record as prior: {p.estimates['lag_s'].text('s')}.",
            figure=panel_figure(partial(draw.draw_unloading, p, p.disk), height_in=4.6),
            caption="Noisy grey: readings after the static line. Smooth: junction temperature "
            "with its 95 % band.",
        ),
    ]


def _budget(p: OneDisk) -> Section:
    """Return the section of the uncertainty budget."""
    rows = [(source, *map(u_of_beta, components)) for source, components in p.budget.items()]
    combined = [u_of_beta(p.estimates[estimator].u) for estimator in ("joint", "cooling")]
    rows.append(("all together", *combined))
    columns = ["source", "u(β) [1], joint fit", "u(β) [1], cooling fit"]
    return Section(
        "uncertainty budget",
        f"Most of β's uncertainty by the joint fit comes from {', '.join(list(p.budget)[:3])}. "
        "Each row is one source alone; the last row is all together, the root of the sum of "
        "squares.",
        table=pd.DataFrame(rows, columns=columns),
        figure=panel_figure(partial(draw.draw_budget, p), height_in=3.8),
        caption="The first column of the table; a longer bar is a source better worth measuring.",
    )


def _line(p: OneDisk) -> Section:
    """Return the section of the steady line."""
    return Section(
        "the steady line and the estimates on it",
        figure=panel_figure(partial(draw.draw_line, p)),
        caption="Steady running determines a line; each estimator gives a point on it. Bars are "
        "95 %.",
    )


def _unevenness(p: OneDisk) -> Section:
    """Return the section of the first circumferential harmonic."""
    finding = p.harmonic.finding(p.disk)
    text = "Yes, as far as two groups of junctions can show."
    if finding:
        text = f"{finding.sentence}."
    draw_panel = partial(draw.draw_angular_harmonic, p, p.disk)
    return Section(
        "is the temperature even around the bore?",
        text,
        figure=panel_figure(draw_panel, width_in=5.0, height_in=4.0),
        caption="The disk seen along the shaft, junctions at the angles of rig.toml; bright is "
        "hot.",
    )


def write_one_disk_report(
    path: str | Path, tests: Mapping[str, OneDisk], sources: pd.DataFrame | None = None
) -> Path:
    """Write one page for one or more tests of one disk and return its path.

    Parameters
    ----------
    path
        File to write.
    tests
        Results by name of the test.
    sources
        Table of the files.

    Returns
    -------
    path
        The same path.
    """
    pages = {name: (one_disk_sections(p), main_result(p)) for name, p in tests.items()}
    return write_tests(path, tests, pages, sources)
