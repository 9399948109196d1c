"""The report of one EHL test: verdict, traces at unloading, lines with points, table, budget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from calibration.disk import DISKS
from tcdyn.partition.analyse import Partition
from tcdyn.plots import partition as draw
from tcdyn.plots.style import figure
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
        Section(f"{name}: error maps of the steady stretch", figure=maps, caption="The valley is the steady line."),
        Section(f"{name}: the test", table=test_table(p), figure=whole),
    ]


def ways_table(p: Partition) -> pd.DataFrame:
    """beta, h and lag by every way, with standard uncertainties."""
    rows: list[tuple[str, float, str, float, str, str | None]] = [
        ("speed law, fast disk", p.speed.beta, "speed law", p.speed.h_fast, "h_fast", None),
        ("speed law, slow disk", p.speed.beta, "speed law", p.speed.h_slow, "h_slow", None),
    ]
    rows += [(f"cooling fit, {d} disk", p.cooling[d].beta, f"cooling {d}", p.cooling[d].h_W_m2K, f"h cooling {d}", None) for d in DISKS]  # fmt: skip  # noqa: E501
    rows += [(f"joint fit, {d} disk", p.joint[d].beta, f"joint {d}", p.joint[d].h_W_m2K, f"h joint {d}", d) for d in DISKS]  # fmt: skip  # noqa: E501
    table = []
    for word, beta, key, h, h_key, disk in rows:
        lag = p.joint[disk].estimates["lag_s"] if disk else None
        b, hh = p.estimate(key, beta), p.estimate(h_key, h)
        table.append(
            {
                "way": word,
                "β [1]": f"{b.value:.4f} ± {b.u:.4f}",
                "h [W/m²K]": f"{hh.value:.0f} ± {hh.u:.0f}",
                "lag [s]": f"{lag.value:.3f} ± {lag.u:.3f}" if lag else "",
            }
        )
    both = p.both.estimates
    table.append(
        {
            "way": "joint fit, both disks",
            "β [1]": f"{both['beta'].value:.4f} ± {both['beta'].u:.4f}",
            "h [W/m²K]": f"{both['h_fast'].value:.0f} / {both['h_slow'].value:.0f}",
            "lag [s]": f"n = {both['exponent'].value:.3f} ± {both['exponent'].u:.3f}",
        }
    )
    return pd.DataFrame(table)


def budget_table(p: Partition) -> pd.DataFrame:
    """Source, and its standard uncertainty of beta by the speed law and by the cooling fit."""
    return pd.DataFrame(
        [
            {
                "source": r.source,
                "u(β) speed law": f"{r.u_beta_steady:.4f}",
                "u(β) cooling fit": f"{r.u_beta_transient:.4f}",
            }
            for r in p.budget.rows
        ]
    )


def test_table(p: Partition) -> pd.DataFrame:
    """The test's conditions."""
    t = p.test
    rows = [
        ("load", t.load_N, "N"),
        ("friction", t.friction_N, "N"),
        ("friction coefficient", t.friction_N / t.load_N, "1"),
        ("sliding speed", t.sliding_speed_m_s, "m/s"),
        ("entraining speed", t.entraining_speed_m_s, "m/s"),
        ("half-width of the contact", t.half_width_m * 1e3, "mm"),
        ("load on", t.events.load_on_s, "s"),
        ("unloading", t.events.unload_s, "s"),
        ("hottest surface, fast", p.surface.fast_max_degC, "°C"),
        ("hottest surface, slow", p.surface.slow_max_degC, "°C"),
        ("ΔT u_s", p.surface.delta_T_us, "K m/s"),
    ]
    return pd.DataFrame([{"quantity": q, "value": f"{v:.4g}", "unit": unit} for q, v, unit in rows])


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
