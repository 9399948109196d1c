"""Calibration of a disk: oven log to static lines, plunge logs to the chain, both to a record.

The fits are :mod:`calibration.static_lines` and :mod:`immersion.plunge_fit`; here are their order
and the checks of the logs against each other. Guarded by ``tests/cli/test_calibrate_command.py``
and ``tests/calibration/test_new_user_run.py``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from calibration.static_lines import OvenFit, fit_static_lines
from immersion.entry import EntryEvent
from immersion.fluids import fluid
from immersion.plunge_checks import check_junction_order, check_not_repeated, deviating_at_rest
from immersion.plunge_data import PlungeRun, run_from_log, with_filled_bath
from immersion.plunge_fit import (
    identify_plunges,
    static_line_corrections,
    with_structure_uncertainty,
)
from immersion.plunge_parameters import PlungePriors
from immersion.plunge_result import PlungeFit
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, unique, warning
from tcdyn.core.options import options_of
from tcdyn.core.progress import Progress, no_progress
from tcdyn.core.result import Result
from tcdyn.core.threads import one_blas_thread
from tcdyn.rig.disk import DISKS
from tcdyn.rig.log import Log, read_log, simulated_findings
from tcdyn.rig.record import (
    ChainRecord,
    ChannelChain,
    DiskRecord,
    InputFile,
    now_utc,
    parse_time,
)
from tcdyn.rig.rigfile import Rig
from tcdyn.rig.static_line import StaticLine, extrapolation_warnings, identity_lines
from tcdyn.workflows.rig_options import CalibrateOptions


@dataclass(frozen=True, repr=False)
class CalibrationRun(Result):
    """Result of a calibration: the record, and the fits behind it for the report.

    Parameters
    ----------
    record
        The disk record.
    oven
        Fit of the static lines; None without an oven log.
    plunges
        The plunges as they were fitted.
    fit
        Fit of the chains.
    """

    record: DiskRecord
    oven: OvenFit | None
    plunges: tuple[PlungeRun, ...]
    fit: PlungeFit

    def headline(self) -> str:
        """Name of the disk and the first line of the summary."""
        return f"{self.record.disk} disk: {super().headline()}"

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of logs and fits."""
        return tuple(self.record.findings)

    def summary(self) -> str:
        """Static errors, lags and what the plunges cannot determine, in a few lines."""
        return "\n".join(self.fit.lines())

    def to_dict(self) -> dict[str, Any]:
        """The content of the disk record."""
        return self.record.to_dict()

    def to_frame(self) -> pd.DataFrame:
        """Numbers of static line and lag, one row a channel."""
        return self.record.to_frame()

    def card(self) -> pd.DataFrame:
        """Static line and lag of each channel."""
        return self.record.card()


@with_named_arguments
@one_blas_thread
def calibrate_disk(
    rig: Rig,
    disk: str,
    oven: str | Path | None,
    immersion: Sequence[str | Path],
    fluids: Sequence[str],
    *,
    progress: Progress = no_progress,
    **options: Any,
) -> CalibrationRun:
    """Calibrate one disk from its oven log and its plunges.

    Parameters
    ----------
    rig, disk
        The rig; "fast" or "slow".
    oven
        Oven log; None with ``reading_u_K``.
    immersion, fluids
        Plunge logs; one fluid (name or table) for all plunges, or one for each.
    progress
        Called with the name of each stage.
    **options
        Fields of :class:`tcdyn.workflows.rig_options.CalibrateOptions`: ``structure``,
        ``correlation``, ``reading_u_K`` and ``prt_u_degC``.

    Returns
    -------
    CalibrationRun
        The record and the fits.

    Raises
    ------
    InputError
        With file and location, for anything that cannot be used.

    Examples
    --------
    >>> from tcdyn import load_rig, write_record  # doctest: +SKIP
    >>> rig = load_rig("rig.toml")  # doctest: +SKIP
    >>> plunges = ["plunge_fast_1.csv", "plunge_fast_2.csv"]  # doctest: +SKIP
    >>> fluids = ["mobil-jet-ii"]  # doctest: +SKIP
    >>> run = calibrate_disk(rig, "fast", "oven_fast.csv", plunges, fluids)  # doctest: +SKIP
    >>> write_record(run.record, "fast.disk.json").name  # doctest: +SKIP
    'fast.disk.json'
    """
    settings = options_of(CalibrateOptions, options, "calibrate_disk")
    _check_disk_and_fluids(disk, fluids, len(immersion))
    tables = rig.tables(disk)
    static = _static_lines(oven, settings, rig, disk, progress)
    plunges = _read_plunges(immersion, fluids, rig, disk, static.lines, progress)
    progress("grey-box fit of the chain to all plunges")
    fit = identify_plunges(
        plunges.runs,
        rig.disk_setup(disk),
        correlation=settings.correlation,
        structure=settings.structure,
        priors=PlungePriors.for_rig(tables.uncertainty),
    )
    check_junction_order(plunges.logs, fit)
    progress("other chain structures on the same plunges")
    fit = with_structure_uncertainty(fit)
    findings = [*static.findings, *plunges.findings]
    if static.fit is not None:
        findings += _other_disk_findings(disk, fit, plunges.runs)
    findings += fit.findings
    record = DiskRecord(
        disk=disk,
        created=now_utc(),
        created_by=tables.traceability.calibrated_by,
        inputs=[*static.inputs, *plunges.inputs],
        static=static.lines,
        chain=chain_record(fit, settings.structure),
        conditioning=tables.conditioning,
        setup=tables,
        fit=fit_summary(fit, settings.correlation),
        findings=list(unique(findings)),
    )
    return CalibrationRun(record, static.fit, tuple(plunges.runs), fit)


def _check_disk_and_fluids(disk: str, fluids: Sequence[str], n_plunges: int) -> None:
    """Check the disk, and that there is one fluid for all plunges or one for each.

    Raises
    ------
    InputError
        Otherwise.
    """
    if disk not in DISKS:
        raise InputError(f"disk is {disk!r}", where="calibrate", expected=" or ".join(DISKS))
    if len(fluids) not in (1, n_plunges):
        raise InputError(
            f"{len(fluids)} fluids for {n_plunges} plunge(s)",
            where="calibrate",
            expected="one fluid for all plunges, or one for each, in their order",
        )


@dataclass(frozen=True)
class _Plunges:
    """The plunges of a disk as they were read.

    Attributes
    ----------
    runs
        Readings for the fit, one for each plunge.
    logs
        Their logs.
    inputs
        Their files.
    findings
        Findings of the logs.
    """

    runs: list[PlungeRun] = field(default_factory=list)
    logs: list[Log] = field(default_factory=list)
    inputs: list[InputFile] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)


def _read_plunges(
    immersion: Sequence[str | Path],
    fluids: Sequence[str],
    rig: Rig,
    disk: str,
    lines: Mapping[str, StaticLine],
    progress: Progress,
) -> _Plunges:
    """Read the plunge logs.

    Parameters
    ----------
    immersion, fluids, rig, disk, progress
        As for :func:`calibrate_disk`.
    lines
        Static line of each channel.

    Raises
    ------
    InputError
        For a log that cannot be used, or one that is another one's copy.
    """
    plunges = _Plunges()
    channels = rig.disk_setup(disk).channels
    for k, path in enumerate(immersion):
        progress(f"plunge {k + 1} of {len(immersion)}: {Path(path).name}")
        log = read_log(path, "immersion", rig, disk)
        check_not_repeated(log, plunges.logs)
        substance = fluid(fluids[k if len(fluids) > 1 else 0])
        filled = with_filled_bath(log)
        run = run_from_log(filled, substance, lines, channels=channels, name=log.path.name)
        readings_degC = dict(zip(run.channels, run.readings_degC.T))
        plunges.logs.append(log)
        plunges.runs.append(run)
        plunges.inputs.append(InputFile.of_path(log.path, log.sha256))
        plunges.findings.extend(extrapolation_warnings(run.name, readings_degC, lines))
        plunges.findings.extend(log_findings(log, run.entry))
    return plunges


def _other_disk_findings(disk: str, fit: PlungeFit, runs: Sequence[PlungeRun]) -> list[Finding]:
    """A warning if the oven log seems to be that of another disk.

    It is if the plunges contradict the static lines of more than half of the channels, or if more
    than one channel deviates at rest in every plunge.

    Parameters
    ----------
    disk
        Name of the disk.
    fit
        Fit of the chains.
    runs
        The plunges.
    """
    pulled_channels = {
        finding.subject
        for finding in fit.findings
        if finding.code == "plunge.pull" and finding.numbers["kind"] in ("offset", "gain")
    }
    deviating = set.intersection(*(deviating_at_rest(run) for run in runs))
    is_most = len(pulled_channels) > len(fit.setup.channels) // 2
    if not is_most and len(deviating) <= 1:
        return []
    count = len(pulled_channels | deviating)
    return [warning("calibrate.other_disk", subject=disk, count=count)]


@dataclass(frozen=True)
class _StaticLines:
    """Static lines of a disk.

    Attributes
    ----------
    fit
        Fit of the lines; None without an oven log.
    lines
        Static line of each channel.
    findings
        Findings.
    inputs
        The oven log as an input file.
    """

    fit: OvenFit | None
    lines: dict[str, StaticLine]
    findings: list[Finding]
    inputs: list[InputFile]


def _static_lines(
    oven: str | Path | None, options: CalibrateOptions, rig: Rig, disk: str, progress: Progress
) -> _StaticLines:
    """Static lines from the oven log, or readings as they are with a stated uncertainty.

    Parameters
    ----------
    oven
        Oven log, or None.
    options
        The options of the calibration.
    rig, disk
        The rig, and the name of the disk.
    progress
        Called with the name of the stage.

    Raises
    ------
    InputError
        Unless exactly one of ``oven`` and ``reading_u_K`` is given.
    """
    reading_u_K = options.reading_u_K
    if (oven is None) == (reading_u_K is None):
        raise InputError(
            "no oven log" if oven is None else "an oven log and a stated line",
            where="calibrate",
            expected="one of them: the oven log, or how far off a reading may be as logged "
            "(standard uncertainty, K)",
            remedy="add {oven} or {reading_u_K}" if oven is None else "leave one out",
            parameters={"oven": "LOG", "reading_u_K": "K"},
        )
    if oven is None or reading_u_K is not None:
        lines = identity_lines(reading_u_K or 0.0, rig.disk_setup(disk).channels)
        return _StaticLines(None, lines, [info("static.stated", u_K=reading_u_K)], [])
    progress("static lines from the oven log")
    log = read_log(oven, "oven", rig, disk)
    stated = rig.tables(disk).traceability.shared_u_K(parse_time(now_utc()).date())
    fit = fit_static_lines(log.frame, prt_u_degC=options.prt_u_degC, prt_shared_u_degC=stated)
    findings = [*log.findings, *simulated_findings(log), *fit.findings]
    made_from = [InputFile.of_path(log.path, log.sha256)]
    return _StaticLines(fit, fit.lines, findings, made_from)


def log_findings(log: Log, entry: EntryEvent) -> list[Finding]:
    """Findings of a plunge log, and an info if it is simulated.

    A bouncing switch that the findings of the entry report already is left out.
    """
    findings = [*log.findings, *simulated_findings(log)]
    entry_reports_bounce = any(f.code == "entry.bounced" for f in entry.findings)
    return [f for f in findings if not (entry_reports_bounce and f.code == "switch.bounces")]


def chain_record(fit: PlungeFit, structure: str) -> ChainRecord:
    """The identified chains in the form of the record.

    The covariance of the lags is in the alphabetical order of the channels, as
    ``tcdyn.smoothing.traces.disk_channels`` reads it.

    Parameters
    ----------
    fit
        Fit of the chains.
    structure
        Chain structure.
    """
    channels = {
        c: ChannelChain(**fit.chains[c].parameters, lag_s=fit.lag_s[c], split_u_s=fit.split_u_s[c])
        for c in sorted(fit.chains)
    }
    return ChainRecord(
        structure=structure,
        channels=channels,
        covariance=[[float(x) for x in row] for row in fit.lag_covariance],
        common_lag_s=fit.common_lag_s,
        differential_lag_s=dict(fit.differential_lag_s),
    )


def fit_summary(fit: PlungeFit, correlation: str) -> dict[str, object]:
    """What a reader of the record needs to judge the fit, as JSON.

    Parameters
    ----------
    fit
        Fit of the chains.
    correlation
        Heat transfer correlation.
    """
    return {
        "correlation": correlation,
        "sentence": fit.sentence,
        "converged": fit.converged,
        "static_lines": json.loads(static_line_corrections(fit).to_json(orient="records")),
        "nuisances": json.loads(fit.parameter_table.to_json(orient="records")),
        "structures": fit.structures.to_dict() if fit.structures is not None else None,
        "lag_budget": [asdict(share) for share in fit.budget],
    }
