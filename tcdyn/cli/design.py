"""Command ``tcdyn rig design``: predicted uncertainties of a planned test.

Single tests are :mod:`tcdyn.design.compare`, campaigns :mod:`tcdyn.campaign.planned`. Tests:
``tests/immersion/test_plunge_pictures.py`` and ``tests/campaign/test_planned.py``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import (
    HIGHEST_DEGC,
    LOWEST_DEGC,
    Disk,
    OutFile,
    Reporter,
    RigFile,
    check_outputs,
    options_from_docstring,
)
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.io.endings import CSV, CSV_OR_PAGE

if TYPE_CHECKING:
    from tcdyn.campaign.planned import PlannedCampaign
    from tcdyn.design.compare import Design
    from tcdyn.rig.disk import DiskSetup
    from tcdyn.rig.tables import UncertaintyTable

# Least difference [K] of bath and disk: some forty times the noise of a sample (0.12 K).
LEAST_STEP_K = 5.0


@dataclass(frozen=True)
class PlanOptions(Options):
    """How planned tests are logged, and what they do.

    Attributes
    ----------
    fluid
        bath fluid: mobil-jet-ii, water or a table.csv
    bath_degC
        bath temperature; repeat for each plunge (default 110 and 138)
    initial_degC
        temperature of the disk before the plunge
    duration_s
        length of each plunge in seconds
    power_W
        heat flow into this disk before the unloading
    lag_s
        expected lag, with the conditioning filter
    noise_K
        noise of one sample (1 sd)
    noise_before_K
        additional noise of one sample, from before the conditioning filter (1 sd)
    rate_Hz
        logging rate
    entry_u_s
        standard uncertainty of the instant of entry
    """

    fluid: str = option("mobil-jet-ii", "Input")
    bath_degC: Sequence[float] = option(
        (), "Input", low=LOWEST_DEGC, high=HIGHEST_DEGC, takes=list[float]
    )
    initial_degC: float = option(25.0, "Input", low=LOWEST_DEGC, high=HIGHEST_DEGC)
    duration_s: float = option(140.0, "Input", low=10, high=3600)
    power_W: float = option(100.0, "Input", low=1e-3, high=1e6)
    lag_s: float = option(0.73, "Sensor", low=0, high=100, ends=False)
    noise_K: float = option(0.12, "Sensor", low=1e-6, high=100)
    noise_before_K: float = option(0.0, "Sensor", low=0, high=100)
    rate_Hz: float = option(75.0, "Sensor", low=1, high=1000)
    entry_u_s: float = option(0.05, "Sensor", low=1e-6, high=10)

    @property
    def baths_degC(self) -> Sequence[float]:
        """Temperature of the bath of each plunge.

        Raises
        ------
        InputError
            If one is that of the disk before it.
        """
        baths_degC = self.bath_degC or [110.0, 138.0]
        if any(abs(bath - self.initial_degC) < LEAST_STEP_K for bath in baths_degC):
            raise InputError(
                f"bath and disk are within {LEAST_STEP_K:g} K of each other",
                where="design",
                remedy="plan a larger step",
            )
        return baths_degC

    @property
    def logged_noise_K(self) -> float:
        """Noise of one logged sample, from before and after the filter."""
        return math.hypot(self.noise_K, self.noise_before_K)

    def predicted(self, setup: DiskSetup, uncertainty: UncertaintyTable) -> Design:
        """The uncertainties of the planned tests of a disk.

        Parameters
        ----------
        setup
            The disk.
        uncertainty
            Uncertainties of its properties.
        """
        from tcdyn.chain.logger_noise import noise_power_ratio
        from tcdyn.design.compare import compare_tests
        from tcdyn.design.plans import PlungePlan, StepPlan

        # the fits whiten the noise, so its level at low frequency decides
        passed = noise_power_ratio(setup.conditioning, 1 / self.rate_Hz)
        level_K = math.hypot(self.noise_K, self.noise_before_K / passed**0.5)
        plans = [
            PlungePlan(
                self.fluid,
                bath,
                self.initial_degC,
                self.duration_s,
                self.rate_Hz,
                level_K,
                self.entry_u_s,
            )
            for bath in self.baths_degC
        ]
        step = StepPlan(power_W=self.power_W, rate_Hz=self.rate_Hz, noise_K=level_K)
        return compare_tests(setup, plans, step=step, uncertainty=uncertainty, lag_s=self.lag_s)

    def assumptions(self, setup: DiskSetup, uncertainty: UncertaintyTable) -> list[str]:
        """The numbers of the plan, for the page.

        Parameters
        ----------
        setup, uncertainty
            As of :meth:`predicted`.
        """
        return [
            f"{setup.name} disk: conductivity {setup.conductivity_W_mK:g} W/mK +- "
            f"{100 * uncertainty.conductivity_rel:g} %, depths +- {uncertainty.depth_mm:g} mm, lag "
            f"{self.lag_s:g} s with the conditioning filter, as specified",
            f"each plunge: {self.fluid}, disk at {self.initial_degC:g} degC before, "
            f"{self.duration_s:g} s at {self.rate_Hz:g} Hz with noise of {self.noise_K:g} K per "
            f"sample and {self.noise_before_K:g} K from before the filter, u of the entry time "
            f"{self.entry_u_s:g} s",
            f"before the unloading {self.power_W:g} W enter this disk",
        ]


@options_from_docstring
def design(
    rig: RigFile = None,
    disk: Disk = "fast",
    campaign: Annotated[Path | None, typer.Option(rich_help_panel="Two-disk rig")] = None,
    out: OutFile = None,
    *,
    options: PlanOptions,
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
    campaign
        CSV of planned EHL tests (load_N, friction_N, speed_fast_rpm, speed_slow_rpm; beta,
        h_fast_W_m2K if expected): predicts u of beta, n and slopes, with the junctions of --rig
    out
        table (.csv) or HTML report (.html) to write
    """
    from tcdyn.rig.rigfile import load_rig

    kind = CSV_OR_PAGE if campaign is None else CSV
    check_outputs([rig, options.fluid, campaign], reporter.overwrite, out=(out, kind))
    if campaign is not None:
        _campaign(campaign, rig, options.rate_Hz, options.logged_noise_K, out, reporter)
        return
    rig_settings = load_rig(rig)
    setup = rig_settings.disk_setup(disk)
    uncertainty = rig_settings.tables(disk).uncertainty
    result = options.predicted(setup, uncertainty)
    if out is not None:
        _write(result, out, options.assumptions(setup, uncertainty))
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
