"""The report of one EHL test: verdict, traces at unloading, lines with points, table, budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from tcdyn.partition.analyse import Partition
from tcdyn.partition.single_disk import OneDisk
from tcdyn.plots import partition as draw
from tcdyn.plots.style import figure, pictured
from tcdyn.plots.transient import (
    draw_junctions,
    draw_profiles,
    draw_referee,
    draw_structures,
    draw_window_study,
)
from tcdyn.report.circumferential import around_section, uneven_section
from tcdyn.report.page import Answer, Section, write_page
from tcdyn.rig.disk import DISKS
from tcdyn.workflows.beta_tables import (
    budget_table,
    cooling_by_window,
    interval_table,
    junctions_table,
    referee_table,
    structures_table,
    test_table,
    ways_table,
)
from tcdyn.workflows.joint_tables import both_budget, residuals_table

ASSUMED = (
    "conductivity, density and specific heat of the steel and washer thickness are assumptions of rig.toml with the "
    "uncertainties of its [uncertainty] table",
    "flux in the contact follows the Hertzian pressure; no heat leaves with the oil; what differs round a disk is its "
    "first harmonic, at the angles of rig.toml",
    "the speed law h ~ u^n with n of rig.toml, whose range is part of the uncertainty",
)


def beta_sections(p: Partition, truth: float | None = None) -> list[Section]:
    """Sections for one test, that of the page's head first, then most wanted first; what few ask for is folded."""
    main = [
        lead(p, truth),
        *answer_sections(p, truth),
        fit_section(p),
        *uncertainty_sections(p),
        uneven_section(p),
    ]
    appendix = [
        structure_section(p),
        around_section(p),
        *transient_sections(p),
        profile_section(p),
        *test_sections(p),
    ]
    shown = [section for section in main if not section.folded]
    folded = [section for section in main if section.folded]
    folded += [replace(section, folded=True) for section in appendix]
    return [
        section.drawn() for section in (*shown, *folded)
    ]  # a page of many tests keeps images, not figures


def lead(p: Partition | OneDisk, truth: float | None = None) -> Section:
    """The one picture of a page's head: beta by every way."""
    height_in = 1.8 if isinstance(p, OneDisk) else 2.8
    ways = pictured(partial(draw.draw_ways, p, truth=truth), height_in=height_in)
    caption = "β by every way, the recommended one on top; 95 % intervals."
    return Section("β by every way", figure=ways, caption=caption)


def answer(p: Partition) -> Answer:
    """beta of both disks with its interval, or that none is given."""
    if p.status == "withheld":
        return Answer(
            "no β",
            "what the fit of both disks finds is impossible, or its power is off by far",
            p.status,
        )
    beta = p.both.estimates["beta"]
    s = p.structures
    return Answer(
        f"β = {beta}",
        f"95 %: {beta.interval}; over {len(s.tried) - 1} other structures of the test {s.low95:.3f} to {s.high95:.3f}",
        p.status,
    )


def answer_sections(p: Partition, truth: float | None) -> list[Section]:
    """Every way to beta, the traces at the unloading, and the steady lines with the points on them."""
    lag = ", ".join(f"{d} {p.joint[d].estimates['lag_s'].text('s')}" for d in DISKS)
    return [
        Section(
            "every way to β",
            "Speed law: where the steady lines of both disks meet h ~ u^n. Cooling fit: h of one disk from its "
            "compensated traces after the parting. Joint fit: β, h and lag together from the traces as logged.",
            table=ways_table(p),
        ),
        Section(
            "the unloading, as logged and compensated",
            f"Common lag of each disk from the unloading, the record as prior: {lag}.",
            figure=pictured(*(partial(draw.draw_unloading, p, d) for d in DISKS), height_in=4.6),
            caption="Noisy grey: readings after the static line. Smooth: junction temperature with its 95 % band.",
        ),
        Section(
            "steady lines and the points on them",
            figure=pictured(partial(draw.draw_lines, p, truth=truth), height_in=4.8),
            caption="Steady running leaves a line for each disk; each way picks a point on it. Bars are 95 %. Markers "
            "of different size, so that equal answers stay visible.",
            folded=True,
        ),
    ]


def fit_section(p: Partition | OneDisk, disks: Sequence[str] = DISKS) -> Section:
    """Measured against modelled at the junctions that the rim model predicts, by the joint fit of the ``disks``."""
    picture, axes = figure(2, len(disks), width_in=10.0, height_in=6.4)
    for k, disk in enumerate(disks):
        draw.draw_fit(p, disk, axes[k], axes[len(disks) + k])
    return Section(
        "does the model meet the readings?",
        "The joint fit predicts the row near the surface from the readings of the inner row, the logged "
        "friction and the chain; what nobody measured (depths, steel, static lines) may move within what is stated of "
        "it. A way that fits leaves residuals about as large as their noise, without a course in time.",
        table=residuals_table(p),
        figure=picture,
        caption="Above: block means of the readings (points) and the model (lines). Below: reading less model; the "
        "band is two standard deviations of a block mean, the lines are running means of half a second: a course in "
        "time would show in them.",
    )


def structure_section(p: Partition) -> Section:
    """The fit of both disks if the test were built otherwise."""
    return Section(
        "does β hold if the test is built otherwise?",
        "The joint fit of both disks again, each time with one departure that the fits do not assume; the probability "
        "weighs how well it explains both disks and whether the exponent that it implies is the speed law's.",
        table=structures_table(p),
        figure=pictured(partial(draw_structures, p.structures), height_in=5.2),
        caption="Bars are 95 % intervals, darker the likelier; the band is the 95 % range over all of them.",
    )


def uncertainty_sections(p: Partition) -> list[Section]:
    """Budget, influence of the exponent, and the error maps that the steady lines come from."""
    most = ", ".join(list(both_budget(p))[:3])
    draws = len(next(iter(p.budget.draws.values())))
    return [
        Section(
            "where the uncertainty comes from",
            f"Most of β's uncertainty by the fit of both disks comes from {most}. Each row is one source alone; the "
            "last row is all together, the root of the sum of squares. That of speed law and cooling fit is by Monte "
            f"Carlo of {draws} draws.",
            table=budget_table(p),
            figure=pictured(partial(draw.draw_budget, p), height_in=3.8),
            caption="The first column of the table; a longer bar is a source better worth measuring.",
        ),
        Section(
            "how much the exponent matters",
            figure=pictured(partial(draw.draw_exponent, p), height_in=3.4),
            caption="The joint fit of both disks assumes no speed law and so estimates the exponent. Bars are 95 %.",
            folded=True,
        ),
        Section(
            "error maps of the steady stretch",
            figure=pictured(*(partial(draw.draw_map, p, d) for d in DISKS), height_in=4.0),
            caption="Along the steady line (black) the misfit is least: steady running tells no point on it.",
            folded=True,
        ),
    ]


def test_sections(p: Partition | OneDisk) -> list[Section]:
    """The sensors' readings against each other, the conditions, and the whole record."""
    whole = pictured(partial(draw.draw_temperatures, p), height_in=3.8)
    return [
        *sensor_sections(p),
        Section(
            "the test",
            table=test_table(p),
            figure=whole,
            caption="Upright lines: load on, unloading.",
        ),
    ]


def transient_sections(p: Partition) -> list[Section]:
    """The cooling fit against the length of its window, and the compensated form against the commuted one."""
    draws = (
        partial(draw_window_study, cooling_by_window(p)),
        partial(draw_referee, referee_table(p)),
    )
    return [
        Section(
            "does the cooling fit depend on its window, or on the inverse?",
            figure=pictured(*draws, height_in=3.8),
            caption="Left: beta by the cooling fit against the cooling used. Right: the cooling fit on compensated "
            "traces against the joint fit on lagged ones, which needs no inverse.",
        )
    ]


def profile_section(p: Partition) -> Section:
    """Whether the standard uncertainties of the joint fits tell their 95 % intervals: profiles, intervals, remarks."""
    picture, axes = figure(3, 4, width_in=10.0, height_in=7.0)
    draw_profiles(p.profiles, axes)
    table = interval_table(p.profiles)
    remarks = [r for r in table.pop("remark") if r]
    return Section(
        "are the joint fits' intervals symmetric?",
        " ".join(remarks)
        or "Yes: profiles and standard uncertainties give the same 95 % intervals, to a fifth of their half-width.",
        table=table,
        figure=picture,
        caption="How much worse the fit becomes as one number is held elsewhere and everything else follows.",
    )


def sensor_sections(p: Partition | OneDisk) -> list[Section]:
    """The pairs of junctions of each disk as tables 6.2 to 6.5 of the thesis judge them."""
    if p.sensors is None:
        return []
    out = []
    for disk in [d for d in DISKS if d in p.test.disks]:
        matrix = p.sensors.matrix(disk).rename_axis("junction").reset_index()
        matrix = matrix.iloc[:-1].drop(columns=matrix.columns[1])  # each pair stands once
        words = (
            f"{p.sensors.said[disk]} Bulk temperature {p.sensors.bulk_degC[disk]:.1f} degC.\n\nOf each pair: "
            "logical where the two differ as their places say they must, weak within two standard uncertainties, "
            "illogical where they differ the other way, N.A. where their places do not tell which is hotter."
        )
        out.append(Section(f"sensor map of the {disk} disk, steady running", words, table=matrix))
    if p.sensors.depths:
        whole = pictured(partial(draw_junctions, p.sensors.depths), height_in=3.4)
        words = (
            "The steady pattern and the first seconds after loading and unloading place each junction by themselves. "
            "A bar outside the grey band is a junction to measure again; what counts as a contradiction is judged over "
            "all junctions together, in the verdict above."
        )
        table = junctions_table(p.sensors.depths)
        out.append(
            Section(
                "are the junctions where they are stated to be?", words, table=table, figure=whole
            )
        )
    return out


def verdict(p: Partition | OneDisk) -> str:
    """The answer first, then whether the ways to it agree."""
    return f"{p.headline.sentence.replace('beta =', 'β =', 1)}\n\n{p.crosscheck.sentence}"


def assumed(p: Partition | OneDisk) -> list[str]:
    """What nobody measured, with the values in use."""
    n = p.test.speed_exponent
    law = (
        f"the speed law h ~ u^n with n = {n:g} of rig.toml, whose range is part of the uncertainty"
    )
    s = next(p.test.disks[d].setup for d in DISKS if d in p.test.disks)
    return [
        f"steel: conductivity {s.conductivity_W_mK:g} W/mK, density {s.density_kg_m3:g} kg/m3, specific heat "
        f"{s.specific_heat_J_kgK:g} J/kgK, with the uncertainties of rig.toml's table [uncertainty], as is the washer",
        "flux in the contact follows the Hertzian pressure; no heat leaves with the oil; what differs round a disk is "
        "its first harmonic, at the angles of rig.toml: two groups of junctions, 15 degrees between neighbours",
        *([] if isinstance(p, OneDisk) else [law]),
    ]


def write_beta_report(
    path: str | Path,
    tests: Mapping[str, Partition],
    truths: Mapping[str, float] | None = None,
    sources: pd.DataFrame | None = None,
) -> Path:
    """One page for one test or several; ``sources``: the files they come from; ``truths``: of simulated ones."""
    truths = truths or {}
    parts = {name: (beta_sections(p, truths.get(name)), answer(p)) for name, p in tests.items()}
    return write_tests(path, tests, parts, sources, bool(truths))


def write_tests(
    path: str | Path,
    tests: Mapping[str, Partition | OneDisk],
    parts: Mapping[str, tuple[list[Section], Answer]],
    sources: pd.DataFrame | None,
    simulated: bool = False,
) -> Path:
    """One page of tests; ``parts``: of each its sections, that of the page's head first, and its answer."""
    (one,) = parts if len(tests) == 1 else ("",)
    before = {name: "" if one else f"{name}: " for name in tests}
    sections: list[Section] = []
    for name, (own, _) in parts.items():
        sections += [replace(s, title=f"{name}: {s.title}") for s in (own[1:] if one else own)]
    return write_page(
        path,
        "Heat partition: " + ", ".join(tests),
        sections,
        verdict="\n\n".join(before[name] + verdict(p) for name, p in tests.items()),
        findings=[
            f if one else f.at(name) for name, p in tests.items() for f in p.noticed
        ],  # the verdict stands above
        assumptions=list(dict.fromkeys(line for p in tests.values() for line in assumed(p))),
        answers=[
            replace(said, value=before[name] + said.value) for name, (_, said) in parts.items()
        ],
        lead=parts[one][0][0] if one else None,
        sources=sources,
        simulated=simulated,
    )
