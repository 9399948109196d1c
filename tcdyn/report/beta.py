"""The report of one EHL test: verdict, traces at unloading, lines with points, table, budget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from calibration.disk import DISKS
from calibration.finding import Finding
from tcdyn.partition.analyse import Partition
from tcdyn.partition.uneven import harmonic_K
from tcdyn.pipeline.around import around_disk
from tcdyn.pipeline.tables import (
    budget_table,
    cooling_by_window,
    interval_table,
    junctions_table,
    referee_table,
    structures_table,
    test_table,
    ways_table,
)
from tcdyn.plots import partition as draw
from tcdyn.plots.around import draw_round, draw_round_surface
from tcdyn.plots.style import TRUTH, figure
from tcdyn.plots.transient import draw_junctions, draw_profiles, draw_referee, draw_structures, draw_window_study
from tcdyn.report.page import Section, write_page

ASSUMED = (
    "conductivity, density and specific heat of the steel and washer thickness are assumptions of rig.toml with the "
    "uncertainties of its [uncertainty] table",
    "flux in the contact follows the Hertzian pressure; no heat leaves with the oil; what differs round a disk is its "
    "first harmonic, at the angles of rig.toml",
    "the speed law h ~ u^n with n of rig.toml, whose range is part of the uncertainty",
)


def beta_sections(p: Partition, name: str, truth: float | None = None) -> list[Section]:
    """Sections for one test, most wanted first."""
    return [
        *answer_sections(p, name, truth),
        structure_section(p, name),
        *uncertainty_sections(p, name),
        uneven_section(p, name),
        around_section(p, name),
        *transient_sections(p, name),
        profile_section(p, name),
        *test_sections(p, name),
    ]


def answer_sections(p: Partition, name: str, truth: float | None) -> list[Section]:
    """Every way to beta, the traces at the unloading, and the steady lines with the points on them."""
    ways, (ax,) = figure(height_in=3.2)
    draw.draw_ways(p, ax, truth)
    unloading, axes = figure(1, 2, height_in=4.6)
    for disk, ax in zip(DISKS, axes):
        draw.draw_unloading(p, disk, ax)
    lines, (ax,) = figure(height_in=4.8)
    draw.draw_lines(p, ax)
    if truth is not None:
        ax.axhline(truth, color=TRUTH, linestyle=":", linewidth=1.2, label="truth of the simulation")
        ax.legend(frameon=False, fontsize=8, ncols=2)
    lag = ", ".join(f"{d} {p.joint[d].estimates['lag_s'].text('s')}" for d in DISKS)
    return [
        Section(
            f"{name}: every way to β",
            "Speed law: where the steady lines of both disks meet h ~ u^n. Cooling fit: h of one disk from its "
            "compensated traces after the parting. Joint fit: β, h and lag together from the traces as logged.",
            table=ways_table(p),
            figure=ways,
            caption="Bars are 95 % intervals.",
        ),
        Section(
            f"{name}: the unloading, as logged and compensated",
            f"Common lag of each disk from the unloading, the record as prior: {lag}.",
            figure=unloading,
            caption="Noisy grey: readings after the static line. Smooth: junction temperature with its 95 % band.",
        ),
        Section(
            f"{name}: steady lines and the points on them",
            figure=lines,
            caption="Steady running leaves a line for each disk; each way picks a point on it. Bars are 95 %. Markers "
            "of different size, so that equal answers stay visible.",
        ),
    ]


def structure_section(p: Partition, name: str) -> Section:
    """The fit of both disks if the test were built otherwise."""
    picture, (ax,) = figure(height_in=5.2)
    draw_structures(p.structures, ax)
    return Section(
        f"{name}: does β hold if the test is built otherwise?",
        "The joint fit of both disks again, each time with one departure that the fits do not assume; the probability "
        "weighs how well it explains both disks and whether the exponent that it implies is the speed law's.",
        table=structures_table(p),
        figure=picture,
        caption="Bars are 95 % intervals, darker the likelier; the band is the 95 % range over all of them.",
    )


def uncertainty_sections(p: Partition, name: str) -> list[Section]:
    """Budget, influence of the exponent, and the error maps that the steady lines come from."""
    budget, (ax,) = figure(height_in=4.4)
    draw.draw_budget(p, ax)
    exponent, (ax,) = figure(height_in=3.4)
    draw.draw_exponent(p, ax)
    maps, axes = figure(1, 2, height_in=4.0)
    for disk, ax in zip(DISKS, axes):
        draw.draw_map(p, disk, ax)
    steady = max(p.budget.rows, key=lambda r: r.u_beta_steady).source
    transient = max(p.budget.rows, key=lambda r: r.u_beta_transient).source
    return [
        Section(
            f"{name}: where the uncertainty comes from",
            f"Largest source: {steady} for the speed law, {transient} for the cooling fit. Each row is one source "
            f"alone, by Monte Carlo of {len(next(iter(p.budget.draws.values())))} draws; the last row is all sources "
            "drawn together.",
            table=budget_table(p),
            figure=budget,
        ),
        Section(
            f"{name}: how much the exponent matters",
            figure=exponent,
            caption="The joint fit of both disks assumes no speed law and so estimates the exponent. Bars are 95 %.",
        ),
        Section(f"{name}: error maps of the steady stretch", figure=maps, caption="The valley is the steady line."),
    ]


def test_sections(p: Partition, name: str) -> list[Section]:
    """The sensors' readings against each other, the conditions, and the whole record."""
    whole, (ax,) = figure(height_in=3.8)
    draw.draw_temperatures(p, ax)
    return [
        *sensor_sections(p, name),
        Section(f"{name}: the test", table=test_table(p), figure=whole, caption="Upright lines: load on, unloading."),
    ]


def transient_sections(p: Partition, name: str) -> list[Section]:
    """The cooling fit against the length of its window, and the compensated form against the commuted one."""
    study = cooling_by_window(p)
    picture, axes = figure(1, 2, height_in=3.8)
    draw_window_study(study, axes[0])
    draw_referee(referee_table(p), axes[1])
    return [
        Section(
            f"{name}: does the cooling fit depend on its window, or on the inverse?",
            figure=picture,
            caption="Left: beta by the cooling fit against the cooling used. Right: the cooling fit on compensated "
            "traces against the joint fit on lagged ones, which needs no inverse.",
        )
    ]


def uneven_section(p: Partition, name: str) -> Section:
    """What the bore contact makes of the temperature round each disk, and what was subtracted."""
    picture, axes = figure(1, 2, height_in=4.0)
    for disk, ax in zip(DISKS, axes):
        draw.draw_uneven(p, disk, ax)
    found = [f.sentence for d in DISKS if (f := p.both.uneven[d].finding(d)) is not None]
    rows = [
        {"disk": d, "junction": c, "angle [deg]": f"{j.angle_deg:g}", "reads more by [K]": f"{more:+.2f}"}
        for d in DISKS
        for (c, j), more in zip(
            sorted(p.test.disks[d].setup.junctions.items()),
            harmonic_K(p.both.uneven[d], p.test.disks[d].setup, np.zeros(1))[0],
        )
    ]
    return Section(
        f"{name}: are the disks even round their bores?",
        (". ".join(found) + "." if found else "Yes, as far as two groups of junctions can tell.")
        + " What the first harmonic makes of each reading at the parting is below: the joint fits find it, and the "
        "other ways to β see readings without it. The second harmonic, which two opposite groups see alike, is in the "
        "budget.",
        table=pd.DataFrame(rows),
        figure=picture,
        caption="The disks seen along the shaft, junctions at the angles of rig.toml; bright is hot.",
    )


def around_section(p: Partition, name: str) -> Section:
    """The temperature round each disk at the end of the load."""
    picture, axes = figure(2, 2, width_in=10.0, height_in=6.4)
    for disk, whole, surface in zip(DISKS, axes[:2], axes[2:]):
        around = around_disk(p, disk)
        draw_round(around, whole)
        draw_round_surface(around, surface)
    return Section(
        f"{name}: the temperature round the disks",
        "Mean of the last ten seconds under load: the rim model's temperature by the joint fit of both disks with the "
        "first harmonic that was found. Nothing is measured deeper than the inner row.",
        figure=picture,
        caption="Above: the middle plane, unrolled, with the readings; open junctions lie beside it. Below: the mean "
        "across the running surface with its 95 % band.",
    )


def profile_section(p: Partition, name: str) -> Section:
    """Whether the standard uncertainties of the joint fits tell their 95 % intervals: profiles, intervals, remarks."""
    picture, axes = figure(3, 4, width_in=10.0, height_in=7.0)
    draw_profiles(p.profiles, axes)
    table = interval_table(p.profiles)
    remarks = [r for r in table.pop("remark") if r]
    return Section(
        f"{name}: are the joint fits' intervals symmetric?",
        " ".join(remarks)
        or "Yes: profiles and standard uncertainties give the same 95 % intervals, to a fifth of their half-width.",
        table=table,
        figure=picture,
        caption="How much worse the fit becomes as one number is held elsewhere and everything else follows.",
    )


def sensor_sections(p: Partition, name: str) -> list[Section]:
    """The pairs of junctions of each disk as tables 6.2 to 6.5 of the thesis judge them."""
    if p.sensors is None:
        return []
    out = []
    for disk in DISKS:
        matrix = p.sensors.matrix(disk).rename_axis("junction").reset_index()
        matrix = matrix.iloc[:-1].drop(columns=matrix.columns[1])  # each pair stands once
        words = (
            f"{p.sensors.said[disk]} Bulk temperature {p.sensors.bulk_degC[disk]:.1f} degC.\n\nOf each pair: "
            "logical where the two differ as their places say they must, weak within two standard uncertainties, "
            "illogical where they differ the other way, N.A. where their places do not tell which is hotter."
        )
        out.append(Section(f"{name}: sensor map of the {disk} disk, steady running", words, table=matrix))
    if p.sensors.depths:
        whole, (ax,) = figure(height_in=3.4)
        draw_junctions(p.sensors.depths, ax)
        words = (
            "The steady pattern and the first seconds after loading and unloading place each junction by themselves. "
            "A bar outside the grey band is a junction to measure again; what counts as a contradiction is judged over "
            "all junctions together, in the verdict above."
        )
        table = junctions_table(p.sensors.depths)
        out.append(Section(f"{name}: are the junctions where they are stated to be?", words, table=table, figure=whole))
    return out


def verdict(p: Partition) -> str:
    """The answer first, then whether the ways to it agree."""
    return f"{p.headline.sentence.replace('beta =', 'β =', 1)} {p.crosscheck.sentence}"


def assumed(p: Partition) -> list[str]:
    """What nobody measured, with the values in use."""
    s = p.test.disks["fast"].setup
    return [
        f"steel: conductivity {s.conductivity_W_mK:g} W/mK, density {s.density_kg_m3:g} kg/m3, specific heat "
        f"{s.specific_heat_J_kgK:g} J/kgK, with the uncertainties of rig.toml's table [uncertainty], as is the washer",
        "flux in the contact follows the Hertzian pressure; no heat leaves with the oil; what differs round a disk is "
        "its first harmonic, at the angles of rig.toml: two groups of junctions, 15 degrees between neighbours",
        f"the speed law h ~ u^n with n = {p.test.speed_exponent:g} of rig.toml, whose range is part of the uncertainty",
    ]


def write_beta_report(
    path: str | Path, tests: dict[str, Partition], truths: dict[str, float] | None = None, extra: Sequence[Section] = ()
) -> Path:
    """One page for one test or several."""
    sections: list[Section] = []
    found: list[Finding] = []
    for name, p in tests.items():
        sections += beta_sections(p, name, (truths or {}).get(name))
        # the verdict stands above
        found += p.noticed if len(tests) == 1 else [f.at(name) for f in p.noticed]
    said = "\n\n".join(verdict(p) if len(tests) == 1 else f"{name}: {verdict(p)}" for name, p in tests.items())
    title = "Heat partition: " + ", ".join(tests)
    told = list(dict.fromkeys(line for p in tests.values() for line in assumed(p)))
    return write_page(path, title, [*extra, *sections], verdict=said, findings=found, assumptions=told)
