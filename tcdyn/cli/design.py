"""``tcdyn design``: what a planned test can tell, before it is run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import Disk, RigFile, Told, bounded, grouped, spare_inputs
from tcdyn.core.errors import InputError

if TYPE_CHECKING:
    from tcdyn.campaign.planned import PlannedCampaign
    from tcdyn.design.compare import Design


@grouped
def design(
    rig: RigFile = None,
    disk: Disk = "fast",
    fluid: Annotated[str, typer.Option(help="mobil-jet-ii, water or a table.csv")] = "mobil-jet-ii",
    bath_degC: Annotated[
        list[float] | None,
        bounded("--bath-degC", "bath temperature; once for each plunge (110 and 138)", -60, 400),
    ] = None,
    initial_degC: Annotated[
        float, bounded("--initial-degC", "disk before the plunge", -60, 400)
    ] = 25.0,
    duration_s: Annotated[
        float, bounded("--duration-s", "length of each plunge", 10, 3600)
    ] = 140.0,
    noise_K: Annotated[float, bounded("--noise-K", "noise of one sample", 1e-6, 100)] = 0.12,
    noise_before_K: Annotated[
        float,
        bounded(
            "--noise-before-K",
            "more noise of one sample, from before the conditioning filter",
            0,
            100,
        ),
    ] = 0.0,
    rate_Hz: Annotated[float, bounded("--rate-Hz", "logging rate", 1, 1000)] = 75.0,
    entry_u_s: Annotated[
        float,
        bounded("--entry-u-s", "standard uncertainty of the entry's instant", 1e-6, 10),
    ] = 0.05,
    lag_s: Annotated[
        float,
        bounded("--lag-s", "expected lag, conditioning included", 0, 100, ends=False),
    ] = 0.73,
    power_W: Annotated[
        float,
        bounded("--power-W", "heat into this disk before unloading", 1e-3, 1e6),
    ] = 100.0,
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="CSV of planned EHL tests (load_N, friction_N, speed_fast_rpm, speed_slow_rpm; beta, "
            "h_fast_W_m2K if expected): u of beta, n and slopes, with the junctions of --rig"
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="table (.csv) or HTML report (.html) to write")
    ] = None,
    *,
    tell: Told,
) -> None:
    """What planned plunges, a soldering-iron touch, a loading and an unloading will tell of the lags.

    With --campaign: what planned EHL tests will tell of beta together, so that junctions are drilled once. Places and
    angles are those of rig.toml, of both disks; noise and rate as given; --out is then a .csv.

    Example: tcdyn design --fluid water --bath-degC 80 --bath-degC 95 --noise-K 0.05 --out plan.html
    """
    from tcdyn.chain.logger_noise import passed_share
    from tcdyn.design.compare import compare_tests
    from tcdyn.design.plans import PlungePlan, StepPlan
    from tcdyn.rig.rigfile import load_rig

    spare_inputs([rig, fluid, campaign], out=out)
    if campaign is not None:
        _campaign(campaign, rig, rate_Hz, math.hypot(noise_K, noise_before_K), out, tell)
        return
    baths = bath_degC or [110.0, 138.0]
    if any(abs(b - initial_degC) < 5 for b in baths):
        raise InputError(
            "bath and disk are within 5 K of each other",
            where="design",
            remedy="plan a larger step",
        )
    rig_table = load_rig(rig)
    setup = rig_table.disk_setup(disk)
    uncertainty = rig_table.tables(disk).uncertainty
    # fits make the noise white: what counts is its strength at low frequency
    level_K = math.hypot(
        noise_K, noise_before_K / passed_share(setup.conditioning, 1 / rate_Hz) ** 0.5
    )
    plans = [
        PlungePlan(fluid, b, initial_degC, duration_s, rate_Hz, level_K, entry_u_s) for b in baths
    ]
    step = StepPlan(power_W=power_W, rate_Hz=rate_Hz, noise_K=level_K)
    result = compare_tests(setup, plans, step=step, uncertainty=uncertainty, lag_s=lag_s)
    if out is not None:
        k = setup.conductivity_W_mK
        _write(
            result,
            out,
            [
                f"{disk} disk: conductivity {k:g} W/mK +- {100 * uncertainty.conductivity_rel:g} %, depths +- "
                f"{uncertainty.depth_mm:g} mm, lag {lag_s:g} s with the conditioning, as given",
                f"each plunge: {fluid}, disk at {initial_degC:g} degC before, {duration_s:g} s at {rate_Hz:g} Hz with "
                f"noise of {noise_K:g} K a sample and {noise_before_K:g} K from before the filter, "
                f"entry known to +- {entry_u_s:g} s",
                f"before the unloading {power_W:g} W enter this disk",
            ],
        )
    _answer(result, out, tell)


def _answer(result: Design | PlannedCampaign, out: Path | None, tell: Told) -> None:
    tell.json(result.to_dict)
    tell.say(result.summary())
    if out is not None:
        tell.say(f"\nwrote {out}")


def _campaign(
    plan: Path, rig: Path | None, rate_Hz: float, noise_K: float, out: Path | None, tell: Told
) -> None:
    from tcdyn.campaign.planned import Logging, predict_campaign, read_plan
    from tcdyn.io.write import write_text
    from tcdyn.rig.rigfile import load_rig

    if out is not None and out.suffix.lower() != ".csv":
        raise InputError(
            f"{out.name}: unknown kind of file",
            where="design",
            expected=".csv for a planned campaign",
        )
    found = predict_campaign(
        read_plan(plan), load_rig(rig), Logging(rate_Hz=rate_Hz, noise_K=noise_K)
    )
    if out is not None:
        write_text(out, found.table().to_csv(index=False))
    _answer(found, out, tell)


def _write(result: Design, out: Path, assumptions: Sequence[str]) -> None:
    from tcdyn.io.write import write_text

    if out.suffix.lower() == ".csv":
        write_text(out, result.table().to_csv(index=False))
        return
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(
            f"{out.name}: unknown kind of file", where="design", expected=".csv or .html"
        )
    from tcdyn.report.dynamics import write_design_report

    write_design_report(out, result, assumptions)
