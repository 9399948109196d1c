"""The report of an EHL test of which one disk was logged: its ways to beta, what they rest on, and the budget."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from calibration.estimate import rounded
from tcdyn.partition.one_disk import OneDisk
from tcdyn.pipeline.one_disk import ways_of
from tcdyn.plots import partition as draw
from tcdyn.plots.style import pictured
from tcdyn.report.beta import assumed, fit_section, test_sections, verdict
from tcdyn.report.page import Answer, Section, write_page


def one_disk_sections(p: OneDisk, name: str) -> list[Section]:
    """Sections for one test of one disk, most wanted first; what few ask for is folded."""
    shown = [*_answers(p, name), fit_section(p, name, [p.disk]), _budget(p, name)]
    return [*shown, *(replace(s, folded=True) for s in (_line(p, name), _round(p, name), *test_sections(p, name)))]


def lead(p: OneDisk) -> Section:
    """The one picture of a page's head: beta by the ways that one disk allows."""
    ways = pictured(partial(draw.draw_ways, p), height_in=1.8)
    return Section("β by every way", figure=ways, caption="β by each way, the recommended one on top; 95 % intervals.")


def answer(p: OneDisk, name: str) -> Answer:
    """beta with its interval, or that none is given."""
    if p.status == "withheld":
        return Answer(f"{name}no β", f"what the joint fit of the {p.disk} disk finds is impossible", p.status)
    beta = p.answers["joint"]
    low, high = (rounded(end, beta.u)[0] for end in (beta.low95, beta.high95))
    return Answer(f"{name}β = {beta}", f"95 %: {low} to {high}; by the {p.disk} disk alone", p.status)


def _answers(p: OneDisk, name: str) -> list[Section]:
    return [
        Section(
            f"{name}: the ways to β",
            "Joint fit: β, h and lag together from the traces as logged. Cooling fit: h from the compensated traces "
            "after the parting, and β from the steady line at that h. Speed law and the fit of both disks need the "
            "other disk, so nothing here checks friction, steel and depths by shares that add to one.",
            table=ways_of(p),
        ),
        Section(
            f"{name}: the unloading, as logged and compensated",
            f"Common lag from the unloading, the record as prior: {p.answers['lag_s'].text('s')}.",
            figure=pictured(partial(draw.draw_unloading, p, p.disk), height_in=4.6),
            caption="Noisy grey: readings after the static line. Smooth: junction temperature with its 95 % band.",
        ),
    ]


def _budget(p: OneDisk, name: str) -> Section:
    rows = [(source, *map(_u, parts)) for source, parts in p.budget.items()]
    rows.append(("all together", _u(p.answers["joint"].u), _u(p.answers["cooling"].u)))
    return Section(
        f"{name}: where the uncertainty comes from",
        f"Most of β's uncertainty by the joint fit comes from {', '.join(list(p.budget)[:3])}. Each row is one source "
        "alone; the last row is all together, the root of the sum of squares.",
        table=pd.DataFrame(rows, columns=["source", "u(β) [1], joint fit", "u(β) [1], cooling fit"]),
        figure=pictured(partial(draw.draw_budget, p), height_in=3.8),
        caption="The first column of the table; a longer bar is a source better worth measuring.",
    )


def _line(p: OneDisk, name: str) -> Section:
    return Section(
        f"{name}: the steady line and the points on it",
        figure=pictured(partial(draw.draw_line, p)),
        caption="Steady running leaves a line; each way picks a point on it. Bars are 95 %.",
    )


def _round(p: OneDisk, name: str) -> Section:
    found = p.uneven.finding(p.disk)
    return Section(
        f"{name}: is the disk even round its bore?",
        f"{found.sentence}." if found else "Yes, as far as two groups of junctions can tell.",
        figure=pictured(partial(draw.draw_uneven, p, p.disk), width_in=5.0, height_in=4.0),
        caption="The disk seen along the shaft, junctions at the angles of rig.toml; bright is hot.",
    )


def _u(u: float) -> str:
    return f"{u:.4f}" if u >= 0.00005 else "below 0.0001"


def write_one_disk_report(path: str | Path, tests: Mapping[str, OneDisk], sources: pd.DataFrame | None = None) -> Path:
    """One page for one test of one disk or several; ``sources``: the files they come from."""
    one, sections, shown = len(tests) == 1, list[Section](), None
    for name, p in tests.items():
        shown = lead(p)
        sections += [] if one else [replace(shown, title=f"{name}: β by every way")]
        sections += one_disk_sections(p, name)
    return write_page(
        path, "Heat partition: " + ", ".join(tests), sections,
        verdict="\n\n".join(verdict(p) if one else f"{name}: {verdict(p)}" for name, p in tests.items()),
        findings=[f if one else f.at(name) for name, p in tests.items() for f in p.noticed],
        assumptions=list(dict.fromkeys(line for p in tests.values() for line in assumed(p)[:2])),
        answers=[answer(p, "" if one else f"{name}: ") for name, p in tests.items()],
        lead=shown if one else None, sources=sources,
    )  # fmt: skip
