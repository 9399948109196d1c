"""The report of one EHL test: verdict, traces at unloading, lines with points, table, budget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calibration.disk import DISKS
from tcdyn.partition.analyse import Partition
from tcdyn.partition.tables import budget_table, test_table, ways_table
from tcdyn.partition.windows import cooling_by_window, referee_table
from tcdyn.plots import partition as draw
from tcdyn.plots.style import figure
from tcdyn.plots.windows import draw_referee, draw_window_study
from tcdyn.report.page import Section, write_page

ASSUMED = (
    "conductivity, density and specific heat of the steel, bore radius and washer thickness are assumptions of "
    "rig.toml with the uncertainties of its [uncertainty] table",
    "flux in the contact follows the Hertzian pressure; no heat leaves with the oil; the rim is axially symmetric",
    "the speed law h ~ u^n with n of rig.toml, uncertain between 0.571 and 0.8",
)


def beta_sections(p: Partition, name: str, truth: float | None = None) -> list[Section]:
    """Sections for one test, most wanted first."""
    unloading, axes = figure(1, 2, height_in=4.6)
    for disk, ax in zip(DISKS, axes):
        draw.draw_unloading(p, disk, ax)
    lines, (ax,) = figure(height_in=5.0)
    draw.draw_lines(p, ax)
    if truth is not None:
        ax.axhline(truth, color="black", linestyle="--", linewidth=1, label="truth of the simulation")
        ax.legend(frameon=False, fontsize=8, ncols=2)
    ways, (ax,) = figure(height_in=3.2)
    draw.draw_ways(p, ax, truth)
    budget, (ax,) = figure(height_in=4.0)
    draw.draw_budget(p, ax)
    exponent, (ax,) = figure(height_in=3.4)
    draw.draw_exponent(p, ax)
    maps, axes = figure(1, 2, height_in=4.0)
    for disk, ax in zip(DISKS, axes):
        draw.draw_map(p, disk, ax)
    whole, (ax,) = figure(height_in=3.8)
    draw.draw_temperatures(p, ax)
    lag = ", ".join(f"{d} {p.joint[d].estimates['lag_s']} s" for d in DISKS)
    return [
        Section(
            f"{name}: the unloading, as logged and compensated",
            f"Common lag of each disk from the unloading, the record as prior: {lag}.",
            figure=unloading,
            caption="Grey: readings after the static line. Coloured: junction temperature with its 95 % band.",
        ),
        Section(
            f"{name}: steady lines and the points on them",
            figure=lines,
            caption="Where the speed law, the cooling fits (h only) and the joint fits put each disk; bars are 95 %.",
        ),
        Section(f"{name}: every way to beta", table=ways_table(p), figure=ways),
        Section(
            f"{name}: where the uncertainty comes from",
            f"Monte Carlo of {len(next(iter(p.budget.draws.values())))} draws, one source at a time.",
            table=budget_table(p),
            figure=budget,
        ),
        Section(
            f"{name}: how much the exponent matters",
            figure=exponent,
            caption="The joint fit of both disks assumes no speed law and so estimates the exponent.",
        ),
        Section(f"{name}: error maps of the steady stretch", figure=maps, caption="The valley is the steady line."),
        *transient_sections(p, name),
        *sensor_sections(p, name),
        Section(f"{name}: the test", table=test_table(p), figure=whole),
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


def sensor_sections(p: Partition, name: str) -> list[Section]:
    """The pairs of junctions of each disk as tables 6.2 to 6.5 of the thesis judge them."""
    if p.sensors is None:
        return []
    out = []
    for disk in DISKS:
        matrix = p.sensors.matrix(disk).rename_axis("junction").reset_index()
        words = f"{p.sensors.verdicts[disk]} Bulk temperature {p.sensors.bulk_degC[disk]:.1f} degC."
        out.append(Section(f"{name}: sensor map of the {disk} disk, steady running", words, table=matrix))
    return out


def write_beta_report(
    path: str | Path, tests: dict[str, Partition], truths: dict[str, float] | None = None, extra: Sequence[Section] = ()
) -> Path:
    """One page for one test or several."""
    sections: list[Section] = []
    warnings: list[str] = []
    for name, p in tests.items():
        sections += beta_sections(p, name, (truths or {}).get(name))
        warnings += [w if len(tests) == 1 else f"{name}: {w}" for w in p.warnings]
    verdict = " ".join(
        p.crosscheck.sentence if len(tests) == 1 else f"{name}: {p.crosscheck.sentence}" for name, p in tests.items()
    )
    title = "Heat partition: " + ", ".join(tests)
    return write_page(path, title, [*extra, *sections], verdict=verdict, warnings=warnings, assumptions=ASSUMED)
