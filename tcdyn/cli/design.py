"""Command ``tcdyn rig design``: predicted uncertainties of a planned test.

Single tests are :mod:`tcdyn.design.compare`, campaigns :mod:`tcdyn.campaign.planned`. Tests:
``tests/immersion/test_plunge_pictures.py`` and ``tests/campaign/test_planned.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tcdyn.cli.common import (
    Disk,
    Reporter,
    RigFile,
    check_outputs,
    number_option,
    options_from_docstring,
)
from tcdyn.core.errors import InputError
from tcdyn.io.endings import CSV, CSV_OR_PAGE

if TYPE_CHECKING:
    from tcdyn.campaign.planned import PlannedCampaign
    from tcdyn.design.compare import Design


@options_from_docstring
def design(
    rig: RigFile = None,
    disk: Disk = "fast",
    fluid: str = "mobil-jet-ii",
    bath_degC: Annotated[list[float] | None, number_option(-60, 400)] = None,
    initial_degC: Annotated[float, number_option(-60, 400)] = 25.0,
    duration_s: Annotated[float, number_option(10, 3600)] = 140.0,
    noise_K: Annotated[float, number_option(1e-6, 100)] = 0.12,
    noise_before_K: Annotated[float, number_option(0, 100)] = 0.0,
    rate_Hz: Annotated[float, number_option(1, 1000)] = 75.0,
    entry_u_s: Annotated[float, number_option(1e-6, 10)] = 0.05,
    lag_s: Annotated[float, number_option(0, 100, ends=False)] = 0.73,
    power_W: Annotated[float, number_option(1e-3, 1e6)] = 100.0,
    campaign: Path | None = None,
    out: Path | None = None,
    *,
    reporter: Reporter,
) -> None:
    """Predict how well planned tests determine the lags.

    The tests are plunges, a touch with a soldering iron, a loading and an unloading.

    With --campaign: predict how well planned EHL tests together determine beta, before junctions
    are drilled. Positions and angles are those of rig.toml for both disks; --out is then a .csv.

    Example: tcdyn rig design --fluid water --bath-degC 80 --bath-degC 95 --noise-K 0.05 --out
    plan.html

    Parameters
    ----------
    fluid
        bath fluid: mobil-jet-ii, water or a table.csv
    bath_degC
        bath temperature; repeat for each plunge (default 110 and 138)
    initial_degC
        temperature of the disk before the plunge
    duration_s
        length of each plunge in seconds
    noise_K
        noise of one sample (1 sd)
    noise_before_K
        additional noise of one sample, from before the conditioning filter (1 sd)
    rate_Hz
        logging rate
    entry_u_s
        standard uncertainty of the instant of entry
    lag_s
        expected lag, with the conditioning filter
    power_W
        heat flow into this disk before the unloading
    campaign
        CSV of planned EHL tests (load_N, friction_N, speed_fast_rpm, speed_slow_rpm; beta,
        h_fast_W_m2K if expected): predicts u of beta, n and slopes, with the junctions of --rig
    out
        table (.csv) or HTML report (.html) to write
    """
    from tcdyn.chain.logger_noise import noise_power_ratio
    from tcdyn.design.compare import compare_tests
    from tcdyn.design.plans import PlungePlan, StepPlan
    from tcdyn.rig.rigfile import load_rig

    kind = CSV_OR_PAGE if campaign is None else CSV
    check_outputs([rig, fluid, campaign], reporter.overwrite, out=(out, kind))
    if campaign is not None:
        _campaign(campaign, rig, rate_Hz, math.hypot(noise_K, noise_before_K), out, reporter)
        return
    baths_degC = bath_degC or [110.0, 138.0]
    if any(abs(b - initial_degC) < 5 for b in baths_degC):
        raise InputError(
            "bath and disk are within 5 K of each other",
            where="design",
            remedy="plan a larger step",
        )
    rig_table = load_rig(rig)
    setup = rig_table.disk_setup(disk)
    uncertainty = rig_table.tables(disk).uncertainty
    # the fits whiten the noise, so its level at low frequency decides
    passed = noise_power_ratio(setup.conditioning, 1 / rate_Hz)
    level_K = math.hypot(noise_K, noise_before_K / passed**0.5)
    plans = [
        PlungePlan(fluid, b, initial_degC, duration_s, rate_Hz, level_K, entry_u_s)
        for b in baths_degC
    ]
    step = StepPlan(power_W=power_W, rate_Hz=rate_Hz, noise_K=level_K)
    result = compare_tests(setup, plans, step=step, uncertainty=uncertainty, lag_s=lag_s)
    if out is not None:
        assumptions = [
            f"{disk} disk: conductivity {setup.conductivity_W_mK:g} W/mK +- "
            f"{100 * uncertainty.conductivity_rel:g} %, depths +- {uncertainty.depth_mm:g} mm, lag "
            f"{lag_s:g} s with the conditioning filter, as specified",
            f"each plunge: {fluid}, disk at {initial_degC:g} degC before, {duration_s:g} s at "
            f"{rate_Hz:g} Hz with noise of {noise_K:g} K per sample and {noise_before_K:g} K from "
            f"before the filter, u of the entry time {entry_u_s:g} s",
            f"before the unloading {power_W:g} W enter this disk",
        ]
        _write(result, out, assumptions)
    _report(result, out, reporter)


def _report(result: Design | PlannedCampaign, out: Path | None, reporter: Reporter) -> None:
    """Print a prediction, and the file that was written.

    Parameters
    ----------
    result
        The prediction.
    out
        File; None: none.
    reporter
        Output of the command.
    """
    reporter.json(result.to_dict)
    reporter.summary(result.summary())
    if out is not None:
        reporter.text(f"\nwrote {out}")


def _campaign(
    plan: Path,
    rig: Path | None,
    rate_Hz: float,
    noise_K: float,
    out: Path | None,
    reporter: Reporter,
) -> None:
    """Predict a campaign: ``--campaign``.

    Parameters
    ----------
    plan
        Table of the planned tests.
    rig
        Rig file; None: the defaults.
    rate_Hz, noise_K
        Logging rate, and noise of one sample.
    out
        CSV to write; None: none.
    reporter
        Output of the command.
    """
    from tcdyn.campaign.planned import Logging, predict_campaign, read_plan
    from tcdyn.io.write import table_csv, write_text
    from tcdyn.rig.rigfile import load_rig

    logging = Logging(rate_Hz=rate_Hz, noise_K=noise_K)
    prediction = predict_campaign(read_plan(plan), load_rig(rig), logging)
    if out is not None:
        write_text(out, table_csv(prediction.table()))
    _report(prediction, out, reporter)


def _write(result: Design, out: Path, assumptions: Sequence[str]) -> None:
    """Write the table (.csv) or the page (.html) of a prediction.

    Parameters
    ----------
    result
        The prediction.
    out
        File to write.
    assumptions
        Numbers of the plan, for the page.
    """
    from tcdyn.io.write import table_csv, write_text

    if out.suffix.lower() == ".csv":
        write_text(out, table_csv(result.table()))
        return
    from tcdyn.report.dynamics import write_design_report

    write_design_report(out, result, assumptions)
