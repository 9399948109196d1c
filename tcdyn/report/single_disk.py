"""The report of an EHL test of which one disk was logged: its ways to beta, what they rest on, and the budget."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from tcdyn.partition.single_disk import OneDisk
from tcdyn.plots import partition as draw
from tcdyn.plots.style import pictured
from tcdyn.report.beta import fit_section, lead, test_sections, write_tests
from tcdyn.report.page import Answer, Section
from tcdyn.workflows.beta_tables import u_of_beta
from tcdyn.workflows.single_disk import ways_of


def one_disk_sections(p: OneDisk) -> list[Section]:
    """Sections for one test of one disk, the page's head first, most wanted first; what few ask for is folded."""
    shown = [lead(p), *_answers(p), fit_section(p, [p.disk]), _budget(p)]
    return [*shown, *(replace(s, folded=True) for s in (_line(p), _round(p), *test_sections(p)))]


def answer(p: OneDisk) -> Answer:
    """beta with its interval, or that none is given."""
    if p.status == "withheld":
        return Answer(
            "no β", f"what the joint fit of the {p.disk} disk finds is impossible", p.status
        )
    beta = p.answers["joint"]
    return Answer(f"β = {beta}", f"95 %: {beta.interval}; by the {p.disk} disk alone", p.status)


def _answers(p: OneDisk) -> list[Section]:
    return [
        Section(
            "the ways to β",
            "Joint fit: β, h and lag together from the traces as logged. Cooling fit: h from the compensated traces "
            "after the parting, and β from the steady line at that h. Speed law and the fit of both disks need the "
            "other disk, so nothing here checks friction, steel and depths by shares that add to one.",
            table=ways_of(p),
        ),
        Section(
            "the unloading, as logged and compensated",
            f"Common lag from the unloading, the record as prior: {p.answers['lag_s'].text('s')}.",
            figure=pictured(partial(draw.draw_unloading, p, p.disk), height_in=4.6),
            caption="Noisy grey: readings after the static line. Smooth: junction temperature with its 95 % band.",
        ),
    ]


def _budget(p: OneDisk) -> Section:
    rows = [(source, *map(u_of_beta, parts)) for source, parts in p.budget.items()]
    rows.append(("all together", *(u_of_beta(p.answers[way].u) for way in ("joint", "cooling"))))
    return Section(
        "where the uncertainty comes from",
        f"Most of β's uncertainty by the joint fit comes from {', '.join(list(p.budget)[:3])}. Each row is one source "
        "alone; the last row is all together, the root of the sum of squares.",
        table=pd.DataFrame(
            rows, columns=["source", "u(β) [1], joint fit", "u(β) [1], cooling fit"]
        ),
        figure=pictured(partial(draw.draw_budget, p), height_in=3.8),
        caption="The first column of the table; a longer bar is a source better worth measuring.",
    )


def _line(p: OneDisk) -> Section:
    return Section(
        "the steady line and the points on it",
        figure=pictured(partial(draw.draw_line, p)),
        caption="Steady running leaves a line; each way picks a point on it. Bars are 95 %.",
    )


def _round(p: OneDisk) -> Section:
    found = p.uneven.finding(p.disk)
    return Section(
        "is the disk even round its bore?",
        f"{found.sentence}." if found else "Yes, as far as two groups of junctions can tell.",
        figure=pictured(
            partial(draw.draw_angular_harmonic, p, p.disk), width_in=5.0, height_in=4.0
        ),
        caption="The disk seen along the shaft, junctions at the angles of rig.toml; bright is hot.",
    )


def write_one_disk_report(
    path: str | Path, tests: Mapping[str, OneDisk], sources: pd.DataFrame | None = None
) -> Path:
    """One page for one test of one disk or several; ``sources``: the files they come from."""
    parts = {name: (one_disk_sections(p), answer(p)) for name, p in tests.items()}
    return write_tests(path, tests, parts, sources)
