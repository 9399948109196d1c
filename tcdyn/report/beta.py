"""Report of EHL tests: beta, unloading, steady lines, joint fit, uncertainty budget, checks.

Written by ``tcdyn rig beta`` and ``tcdyn demo``; :mod:`tcdyn.report.campaign` uses parts of it. A
test with one disk has fewer sections. The order of the sections is their importance; what is
folded is not printed. Tests: ``tests/report/test_beta_page.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd

from tcdyn.core.findings import Finding
from tcdyn.partition.analyse import Partition
from tcdyn.partition.cooling_checks import cooling_by_window, reference_table
from tcdyn.partition.joint_results import joint_budget
from tcdyn.partition.model_forms import is_undetermined
from tcdyn.partition.sensor_check import SensorCheck
from tcdyn.plots import partition as draw
from tcdyn.plots.style import figure, panel_figure
from tcdyn.plots.transient import (
    draw_inverse_check,
    draw_junctions,
    draw_likelihood_profiles,
    draw_model_forms,
    draw_window_study,
)
from tcdyn.report.circumferential import around_section, unevenness_section
from tcdyn.report.page import SIMULATED, MainResult, Section, write_page
from tcdyn.workflows.beta_tables import (
    budget_table,
    conditions_table,
    estimates_table,
    interval_table,
    junctions_table,
    model_forms_table,
    residuals_table,
)

BETA_DEFINITION = (
    "β is the share of the frictional heat in the contact that enters the fast disk; the rest, "
    "1 - β, enters the slow disk."
)
# Assumptions of all tests, for the page of a campaign.
ASSUMPTIONS = (
    "conductivity, density and specific heat of the steel and washer thickness are assumptions of "
    "rig.toml with the uncertainties of its [uncertainty] table",
    "flux in the contact follows the Hertzian pressure; the heat of the oil film is not "
    "subtracted; the temperature around a disk varies by its first harmonic, at the angles of "
    "rig.toml",
    "the speed law h ~ u^n with n of rig.toml, whose range is part of the uncertainty",
)


def beta_sections(partition: Partition, truth: float | None = None) -> list[Section]:
    """Return the sections of one test by importance, that of the page's head first.

    Details and the appendix are folded. Figures are rendered at once, so that a page of many tests
    keeps images only.

    Parameters
    ----------
    partition
        Result of the test.
    truth
        Beta of a simulation; None: not plotted.

    Returns
    -------
    sections
        With images instead of figures.

    Notes
    -----
    The first section must be that of :func:`lead_section`: :func:`write_beta_report` takes it as
    the head of the page.
    """
    main = [
        lead_section(partition, truth),
        *estimate_sections(partition, truth),
        fit_section(partition),
        *uncertainty_sections(partition),
        unevenness_section(partition),
    ]
    appendix = [
        *model_form_sections(partition),
        around_section(partition),
        transient_section(partition),
    ]
    if partition.status != "withheld":
        appendix.append(profile_section(partition))
    appendix += test_sections(partition)
    unfolded = [section for section in main if not section.folded]
    folded = [section for section in main if section.folded]
    folded += [replace(section, folded=True) for section in appendix]
    return [section.render() for section in (*unfolded, *folded)]


def lead_section(partition: Partition, truth: float | None = None) -> Section:
    """Return the figure of the page's head: all estimates of beta.

    Parameters
    ----------
    partition
        Result of the test.
    truth
        Beta of a simulation; None: not plotted.
    """
    height_in = 1.8 if partition.single_disk else 2.8
    estimates = panel_figure(
        partial(draw.draw_beta_estimates, partition, truth=truth), height_in=height_in
    )
    caption = "All estimates of β, the recommended one on top; 95 % intervals."
    return Section("All estimates of β", figure=estimates, caption=caption)


def main_result(partition: Partition) -> MainResult:
    """Return the recommended beta with its interval, or that none is given.

    Parameters
    ----------
    partition
        Result of the test.
    """
    forms = partition.model_forms
    beta = partition.combined.estimates["beta"]
    value = f"β = {beta}"
    detail = f"95 %: {beta.interval_text}"
    if partition.status == "withheld":
        value = "no β"
        disk = partition.single_disk
        fit = f"the joint fit of the {disk} disk" if disk else "the fit of both disks"
        detail = f"the result of {fit} is impossible"
        if is_undetermined(beta):
            detail = f"{fit} does not determine it"
        elif not disk:
            detail += ", or its power is far off"
    elif forms is None:
        detail += f"; by the {partition.single_disk} disk alone"
    else:
        detail += (
            f"; over {len(forms.forms) - 1} other structures of the test {forms.low95:.3f} to "
            f"{forms.high95:.3f}"
        )
    return MainResult(value, detail, partition.status)


def estimate_sections(partition: Partition, truth: float | None) -> list[Section]:
    """Return all estimates of beta, the unloading, and the steady lines with the estimates.

    Parameters
    ----------
    partition
        Result of the test.
    truth
        Beta of a simulation; None: not plotted.
    """
    lags = ", ".join(
        f"{d} {partition.joint[d].estimates['lag_s'].text('s')}" for d in partition.disks
    )
    unloading = [partial(draw.draw_unloading, partition, d) for d in partition.disks]
    text = (
        "Speed law: where the steady lines of both disks meet h ~ u^n. Cooling fit: h of one disk "
        "from its compensated traces after the unloading. Joint fit: β, h and lag together from "
        "the traces as logged."
    )
    if partition.single_disk:
        text = (
            "Joint fit: β, h and lag together from the traces as logged. Cooling fit: h from the "
            "compensated traces after the unloading, and β from the steady line at that h. Speed "
            "law and the fit of both disks need the other disk, so nothing here checks friction, "
            "steel and depths by shares that add to one."
        )
    return [
        Section("all estimates of β", text, table=estimates_table(partition, truth)),
        Section(
            "the unloading, as logged and compensated",
            f"Common lag of each disk from the unloading, the record as prior: {lags}.",
            figure=panel_figure(*unloading, height_in=4.6),
            caption="Noisy grey: readings after the static line. Smooth: junction temperature "
            "with its 95 % band.",
        ),
        Section(
            "steady lines and the estimates on them",
            figure=panel_figure(partial(draw.draw_lines, partition, truth=truth), height_in=4.8),
            caption="Steady running determines a line for each disk; each estimator gives a point "
            "on it. Bars are 95 %. Markers of different size, so that equal estimates stay "
            "visible.",
            folded=True,
        ),
    ]


def fit_section(partition: Partition) -> Section:
    """Return readings and model of the joint fit at the junctions that the rim model predicts."""
    n = len(partition.disks)
    fig, axes = figure(2, n, width_in=10.0, height_in=6.4)
    for k, disk in enumerate(partition.disks):
        draw.draw_joint_fit(partition, disk, axes[k], axes[n + k])
    return Section(
        "does the model agree with the readings?",
        "The joint fit predicts the row near the surface from the readings of the inner row, the "
        "logged friction and the chain; nuisance parameters (depths, steel, static lines) vary "
        "within their stated uncertainty. A model that fits leaves residuals about as large as "
        "their noise, without a trend in time.",
        table=residuals_table(partition),
        figure=fig,
        caption="Upper row: block means of the readings (points) and the model (lines). Lower row: "
        "reading minus model; the band is two standard deviations of a block mean, the lines are "
        "running means of half a second, which would show a trend in time.",
    )


def model_form_sections(partition: Partition) -> list[Section]:
    """Return the fit of both disks under the model-form alternatives; nothing with one disk."""
    if partition.model_forms is None:
        return []
    return [
        Section(
            "model-form alternatives",
            "The joint fit of both disks again, each time with one departure that the fits do not "
            "assume; the probability weighs how well it explains both disks and whether the "
            "exponent that it implies is the speed law's.",
            table=model_forms_table(partition.model_forms),
            figure=panel_figure(partial(draw_model_forms, partition.model_forms), height_in=5.2),
            caption="Bars are 95 % intervals, darker the likelier; the band is the 95 % range over "
            "all of them.",
        )
    ]


def uncertainty_sections(partition: Partition) -> list[Section]:
    """Return the budget, the influence of the exponent, and the error maps of the steady lines."""
    largest = ", ".join(list(joint_budget(partition))[:3])
    n_draws = len(next(iter(partition.budget.samples.values())))
    recommended = "the joint fit" if partition.single_disk else "the fit of both disks"
    others = "the cooling fit" if partition.single_disk else "speed law and cooling fit"
    maps = [partial(draw.draw_map, partition, d) for d in partition.disks]
    sections = [
        Section(
            "uncertainty budget",
            f"Most of β's uncertainty by {recommended} comes from {largest}. Each row is "
            "one source alone; the last row is all together, the root of the sum of squares. "
            f"That of {others} is by Monte Carlo of {n_draws} draws.",
            table=budget_table(partition),
            figure=panel_figure(partial(draw.draw_budget, partition), height_in=3.8),
            caption="The first column of the table; a longer bar is a source better worth "
            "measuring.",
        ),
        Section(
            "error maps of the steady segment",
            figure=panel_figure(*maps, height_in=4.0),
            caption="Along the steady line (black) the misfit is least: steady running determines "
            "no point on it.",
            folded=True,
        ),
    ]
    if not partition.single_disk:
        exponent = Section(
            "influence of the exponent",
            figure=panel_figure(partial(draw.draw_beta_by_exponent, partition), height_in=3.4),
            caption="The joint fit of both disks assumes no speed law and so estimates the "
            "exponent. Bars are 95 %.",
            folded=True,
        )
        sections.insert(1, exponent)
    return sections


def test_sections(partition: Partition) -> list[Section]:
    """Return the comparison of the sensors, the conditions, and the full record."""
    test = Section(
        "the test",
        table=conditions_table(partition),
        figure=panel_figure(partial(draw.draw_temperatures, partition), height_in=3.8),
        caption="Vertical lines: loading, unloading.",
    )
    return [*sensor_sections(partition), test]


def transient_section(partition: Partition) -> Section:
    """Return the cooling fit over the length of its window, and against the joint fit."""
    window_study = partial(draw_window_study, cooling_by_window(partition))
    comparison = partial(draw_inverse_check, reference_table(partition))
    return Section(
        "does the cooling fit depend on its window, or on the inverse?",
        figure=panel_figure(window_study, comparison, height_in=3.8),
        caption="a: β by the cooling fit against the length of its window. b: the "
        "cooling fit on compensated traces against the joint fit on lagged ones, which needs "
        "no inverse.",
    )


def profile_section(partition: Partition) -> Section:
    """Return the profile likelihoods of the joint fits, and their 95 % intervals."""
    n_rows = partition.profiles["fit"].nunique()
    fig, axes = figure(n_rows, 4, width_in=10.0, height_in=1.0 + 2.0 * n_rows)
    draw_likelihood_profiles(partition.profiles, axes)
    table = interval_table(partition.profiles)
    remarks = [remark for remark in table.pop("remark") if remark]
    symmetric = (
        "Yes: profiles and standard uncertainties give the same 95 % intervals, to a fifth of "
        "their half-width."
    )
    return Section(
        "are the joint fits' intervals symmetric?",
        " ".join(remarks) or symmetric,
        table=table,
        figure=fig,
        caption="Increase of the misfit when one parameter is fixed elsewhere and all others are "
        "fitted again. An arrowhead: the data do not bound the interval there.",
    )


def sensor_sections(partition: Partition) -> list[Section]:
    """Return pairs of junctions of each disk, judged as in tables 6.2 to 6.5, and their depths."""
    if partition.sensors is None:
        return []
    sections = [_sensor_map_section(partition.sensors, disk) for disk in partition.disks]
    if partition.sensors.depths:
        sections.append(
            Section(
                "are the junctions at their nominal depths?",
                "The steady pattern and the first seconds after loading and unloading determine "
                "the depth of each junction. A bar outside the grey band is a junction to measure "
                "again; a contradiction is judged over all junctions together, in the verdict "
                "above.",
                table=junctions_table(partition.sensors.depths),
                figure=panel_figure(
                    partial(draw_junctions, partition.sensors.depths), height_in=3.4
                ),
            )
        )
    return sections


def _sensor_map_section(sensors: SensorCheck, disk: str) -> Section:
    """Return the comparison of all pairs of junctions of a disk.

    Parameters
    ----------
    sensors
        Result of the comparison of sensors.
    disk
        Name of the disk.
    """
    matrix = sensors.matrix(disk).rename_axis("junction").reset_index()
    # Each pair has one cell.
    upper_half = matrix.iloc[:-1].drop(columns=matrix.columns[1])
    text = (
        f"{sensors.texts[disk]} Bulk temperature {sensors.bulk_degC[disk]:.1f} degC.\n\nOf each "
        "pair: logical where the two differ as their positions require, weak within two standard "
        "uncertainties, illogical where they differ the other way, N.A. where their positions do "
        "not determine which is hotter."
    )
    return Section(f"sensor map of the {disk} disk, steady running", text, table=upper_half)


def verdict(partition: Partition) -> str:
    """Return the recommended beta, and whether its estimates agree."""
    recommendation = partition.recommendation.sentence.replace("beta =", "β =", 1)
    return f"{recommendation}\n\n{partition.crosscheck.sentence}"


def beta_assumptions(partition: Partition) -> list[str]:
    """Return what was assumed and not measured, with the values in use."""
    setup = partition.test.disks[partition.disks[0]].setup
    steel = (
        f"steel: conductivity {setup.conductivity_W_mK:g} W/mK, density {setup.density_kg_m3:g} "
        f"kg/m3, specific heat {setup.specific_heat_J_kgK:g} J/kgK, with the uncertainties of "
        "rig.toml's table [uncertainty], as is the washer"
    )
    heat = (
        "flux in the contact follows the Hertzian pressure; the heat of the oil film is not "
        "subtracted; the temperature around a disk varies by its first harmonic, at the angles of "
        "rig.toml: two groups of junctions, 15 degrees between neighbours"
    )
    if partition.single_disk:
        return [steel, heat]
    n = partition.test.speed_exponent
    law = (
        f"the speed law h ~ u^n with n = {n:g} of rig.toml, whose range is part of the uncertainty"
    )
    return [steel, heat, law]


def write_beta_report(
    path: str | Path,
    tests: Mapping[str, Partition],
    truths: Mapping[str, float] | None = None,
    sources: pd.DataFrame | None = None,
) -> Path:
    """Write one page for one or more tests and return its path.

    Parameters
    ----------
    path
        File to write.
    tests
        Results by name of the test.
    truths
        True beta of simulated tests.
    sources
        Table of the files.

    Returns
    -------
    path
        The same path.

    Notes
    -----
    The page is marked as simulated if truths are given; a log that is simulated by its metadata has
    a finding. With one test its first section becomes the head of the page; with several, every
    title and finding carries the name of its test. Test: ``tests/report/test_beta_page.py``.
    """
    truths = truths or {}
    single = len(tests) == 1
    sections: list[Section] = []
    verdicts = []
    findings: list[Finding] = []
    main_results = []
    assumptions: list[str] = []
    lead = None
    for name, p in tests.items():
        page_sections = beta_sections(p, truths.get(name))
        result = main_result(p)
        prefix = f"{name}: "
        if single:
            prefix = ""
            lead, *page_sections = page_sections
        sections += [replace(s, title=f"{name}: {s.title}") for s in page_sections]
        verdicts.append(prefix + verdict(p))
        main_results.append(replace(result, value=prefix + result.value))
        # ``analysis_findings`` has no verdict, which stands above.
        findings += (
            p.analysis_findings if single else [finding.at(name) for finding in p.analysis_findings]
        )
        assumptions += [line for line in beta_assumptions(p) if line not in assumptions]
    return write_page(
        path,
        "Heat partition: " + ", ".join(tests),
        sections,
        verdict="\n\n".join([BETA_DEFINITION, *verdicts]),
        findings=findings,
        assumptions=assumptions,
        main_results=main_results,
        lead=lead,
        sources=sources,
        marks=[SIMULATED] if truths else [],
    )
