"""Result of a plunge fit: lags with covariance, common and differential lag, budget, warnings.

Returned by :func:`immersion.plunge_fit.identify_plunges`; read by ``tcdyn rig calibrate``, the
certificate and the figures. It computes from the optimum and the scan and fits nothing. The
thresholds decide messages only; they are chosen by judgement. Tests:
``tests/immersion/test_plunge_fit.py`` and ``tests/immersion/test_plunge_structures.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from immersion.chain_structures import StructureComparison
from immersion.correlations import check_validity
from immersion.plunge_data import PlungeRun, block_sd
from immersion.plunge_model import junction_degC
from immersion.plunge_parameters import (
    BURST_KINDS,
    H_KINDS,
    RUN_KINDS,
    PlungeParameters,
    PlungePriors,
    common_and_differential_u_s,
    differential_covariance,
    stages,
)
from immersion.plunge_posterior import LagScan, PlungeModelForm, PlungeOptimum
from tcdyn.chain import Chain
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array, Flags
from tcdyn.core.estimate import Estimate, rounded_texts, text_with_u
from tcdyn.core.findings import Finding, info, labelled_messages, messages, unique, warning
from tcdyn.core.result import Result, estimate_columns, jsonable
from tcdyn.estimation import inverse
from tcdyn.rig.disk import DiskSetup

# Variance of slow residuals over that of white noise, beyond which a warning is given; chosen by
# judgement.
MAX_VARIANCE_FACTOR = 4.0
# Deviations from the prior mean, in prior standard deviations; chosen by judgement.
WARNING_DEVIATION = 3.0  # beyond: a warning about the parameter, or about the fluid
INFO_DEVIATION = 2.0  # beyond: an info, for the bath's temperature and the form of h
# Kinds that give an info between the two limits.
INFO_KINDS = ("bath", "h_exponent", "h_viscosity")
# Lag of a chain without the conditioning filter [s] below which a warning is given; chosen by
# judgement.
MIN_LAG_S = 0.01
# The burst is separated from the lag if u of the common lag is below both [s] and [1]; chosen by
# judgement.
SEPARATED_U_S = 0.05
SEPARATED_U_REL = 0.10
# Groups of parameters in the uncertainty budget.
SOURCES = {
    "entry burst": BURST_KINDS,
    "entry time": ("entry",),
    "h and its form": H_KINDS,
    "initial and bath temperature": ("initial", "bath"),
    "static lines": ("offset", "gain"),
    "conductivity and junction depths": ("ln_conductivity", "depth"),
    "split of the lag": ("split", "common_split"),
}
# Remark of the summary and the certificate on the intervals of the lags.
INTERVAL_NOTE = (
    "(a lag's interval may reach further up than down: a long lag with a strong entry burst fits "
    "nearly as well as a short one; burst and lag are common to the channels, so the intervals of "
    "their differences are symmetric)"
)


@dataclass(frozen=True)
class LagShare:
    """Standard uncertainty from one source: common lag, and differential lags (rms).

    Attributes
    ----------
    source
        Name of the source.
    u_common_s, u_differential_s
        Standard uncertainties [s].
    """

    source: str
    u_common_s: float
    u_differential_s: float


@dataclass(frozen=True, repr=False)
class PlungeFit(Result):
    """Chains of one disk, identified from its plunges; the lags include the conditioning filter.

    Attributes
    ----------
    setup
        The disk.
    correlation
        Name of the correlation.
    priors
        Priors of the nuisance parameters.
    model_form
        Refits with other correlations; their spread widens the lags.
    rival
        A warning about a second solution, where there is one.
    runs
        The plunges.
    optimum
        The most probable parameters, with the common lag at the posterior mean of ``scan``.
    scan
        Profile scan of the common lag.
    noise
        Noise model of the logger.
    structures
        Comparison of chain structures, whose spread widens the lags; None: not made.
    """

    setup: DiskSetup
    correlation: str
    priors: PlungePriors
    model_form: PlungeModelForm
    rival: tuple[Finding, ...]
    runs: tuple[PlungeRun, ...]
    optimum: PlungeOptimum
    scan: LagScan
    noise: LoggerNoise
    structures: StructureComparison | None = None

    @property
    def disk(self) -> str:
        """Name of the disk."""
        return self.setup.name

    @property
    def layout(self) -> PlungeParameters:
        """Layout of the parameter vector."""
        return self.optimum.problem.layout

    @property
    def structure(self) -> str:
        """Name of the chain structure."""
        return self.layout.structure

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels, in the order of all arrays."""
        return self.layout.channels

    @property
    def converged(self) -> bool:
        """Whether the search converged."""
        return self.optimum.solution.converged

    @cached_property
    def chains(self) -> dict[str, Chain]:
        """The chain of each channel."""
        theta = self.optimum.theta
        logits = theta[self.layout.at("common_split")] + theta[self.layout.at("split")]
        chains = {}
        for channel, lag, logit in zip(self.channels, self.optimum.lag_s, logits):
            taus, delay, zero = stages(self.structure, lag, logit)
            chains[channel] = Chain(
                tuple(taus),
                zero_s=float(zero),
                delay_s=float(delay),
                conditioning=self.setup.conditioning,
            )
        return chains

    @cached_property
    def split_u_s(self) -> dict[str, float]:
        """Standard uncertainty of the largest time constant of each channel at fixed lag [s].

        The uncertainty of the split is that with the lag free. The part that is common to lag and
        split is counted twice rather than not at all.

        Notes
        -----
        "Fixed lag" means that the total lag keeps its value while the logit of the split varies by
        its standard uncertainty.
        """
        theta = self.optimum.theta
        cov = self.optimum.covariance
        common = self.layout.at("common_split")
        split = self.layout.at("split")
        logits = theta[common] + theta[split]
        variance = cov[common, common] + np.diag(cov[split, split]) + 2 * cov[common, split]
        u = np.sqrt(variance)[0]
        split_u_s = {}
        for channel, lag, logit, sd in zip(self.channels, self.optimum.lag_s, logits, u):
            low = stages(self.structure, float(lag), float(logit - sd))[0][0]
            high = stages(self.structure, float(lag), float(logit + sd))[0][0]
            split_u_s[channel] = 0.5 * abs(low - high)
        return split_u_s

    @property
    def extra_covariance(self) -> Array:
        """Covariance of the lags (C, C) from the choice of correlation and of structure [s2].

        Returns
        -------
        covariance
            (C, C) [s2]; without a comparison of structures, that of the correlation only.
        """
        if self.structures is None:
            return self.model_form.covariance
        return self.model_form.covariance + self.structures.covariance

    @property
    def lag_covariance(self) -> Array:
        """Covariance (C, C) of the lags [s2]."""
        return self.scan.covariance + self.extra_covariance

    @cached_property
    def lag_s(self) -> dict[str, Estimate]:
        """Lag of each channel with the conditioning filter [s].

        The skew posterior of the common lag, plus an independent normal component.
        """
        lag = self.optimum.lag_s + self.setup.conditioning.lag_s
        slope = self.scan.lag_slope
        normal = np.diag(self.scan.differential_covariance + self.extra_covariance)
        return {
            channel: self.scan.skewed_estimate(float(value), float(factor), float(variance))
            for channel, value, factor, variance in zip(self.channels, lag, slope, normal)
        }

    @property
    def common_lag_s(self) -> Estimate:
        """The mean lag of the channels, with the conditioning filter [s]."""
        return self._widened_common_lag(self.extra_covariance)

    @cached_property
    def differential_lag_s(self) -> dict[str, Estimate]:
        """Lag of each channel minus the mean of all [s]."""
        lag = self.optimum.lag_s
        variance = np.diag(differential_covariance(self.lag_covariance))
        u = np.sqrt(np.maximum(variance, 0.0))
        return {
            channel: Estimate.normal(float(difference), float(sd))
            for channel, difference, sd in zip(self.channels, lag - lag.mean(), u)
        }

    @cached_property
    def parameter_table(self) -> pd.DataFrame:
        """Every parameter: value, u, prior_mean, prior_sd (nan where the prior is flat)."""
        problem = self.optimum.problem
        flat = ~np.isfinite(problem.sd)
        return pd.DataFrame(
            {
                "parameter": self.layout.names(),
                "value": self.optimum.theta,
                "u": np.sqrt(np.diag(self.optimum.covariance)),
                "prior_mean": np.where(flat, np.nan, problem.mean),
                "prior_sd": np.where(flat, np.nan, problem.sd),
            }
        )

    @cached_property
    def budget(self) -> tuple[LagShare, ...]:
        """Uncertainty budget of the lags by source.

        The first rows are those of the marginal posterior. The groups use its normal approximation;
        they do not add up, because their parameters are correlated.

        Each row is the variance that disappears if a group of parameters is fixed.

        Notes
        -----
        The groups are ``SOURCES``; every kind with a prior must be in one of them, or "noise alone"
        would include it.
        """
        lag = self.layout.at("lag")
        full = self.optimum.covariance[lag, lag]
        all_kinds = [kind for kinds in SOURCES.values() for kind in kinds]
        shares: dict[str, Array] = {}
        if self.structures is not None:
            shares["everything"] = self.lag_covariance
        shares["all of the fit"] = self.scan.covariance
        for source, kinds in SOURCES.items():
            shares[source] = full - self._covariance_with_fixed(*kinds)
        shares["noise alone"] = self._covariance_with_fixed(*all_kinds)
        shares["choice of correlation"] = self.model_form.covariance
        if self.structures is not None:
            shares["choice of chain structure"] = self.structures.covariance
        return tuple(
            LagShare(source, *common_and_differential_u_s(share))
            for source, share in shares.items()
        )

    @cached_property
    def lag_finding(self) -> Finding:
        """The common lag, and what limits its uncertainty.

        Notes
        -----
        ``SEPARATED_U_S`` and ``SEPARATED_U_REL`` choose between two texts:
        ``tests/immersion/test_plunge_fit.py``.
        """
        common = self.common_lag_s
        u_without_structure = self._widened_common_lag(self.model_form.covariance).u
        known_burst_u_s = common_and_differential_u_s(
            self._covariance_with_fixed(*BURST_KINDS, "entry")
        )[0]
        separated = u_without_structure <= max(SEPARATED_U_S, SEPARATED_U_REL * common.value)
        return info(
            "plunge.lag",
            plunges=len(self.runs),
            common_lag_s=common.value,
            u_s=common.u,
            known_burst_u_s=known_burst_u_s,
            apart=separated,
        )

    def to_frame(self) -> pd.DataFrame:
        """Lag and differential lag of each channel, with their 95 % intervals."""
        differential_s = self.differential_lag_s
        rows = {
            channel: {
                **estimate_columns("lag", "s", lag),
                **estimate_columns("differential_lag", "s", differential_s[channel]),
            }
            for channel, lag in self.lag_s.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("channel")

    def to_dict(self) -> dict[str, Any]:
        """Lags and findings; all parameters are in ``parameter_table``."""
        return {
            "disk": self.disk,
            "structure": self.structure,
            "common_lag_s": jsonable(self.common_lag_s),
            "lag_s": jsonable(self.lag_s),
            "differential_lag_s": jsonable(self.differential_lag_s),
            "findings": jsonable(self.findings),
        }

    @property
    def sentence(self) -> str:
        """:attr:`lag_finding` as text."""
        return self.lag_finding.sentence

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """All warnings and infos about the fit."""
        findings: list[Finding] = []
        if self.structures is not None:
            findings += self.structures.findings
        findings += self.rival
        findings += self.noise.findings(self.disk)
        if not self.converged:
            findings.append(warning("plunge.unconverged"))
        findings += self._prior_findings()
        for r in range(len(self.runs)):
            findings += self._run_findings(r)
        for channel, lag in zip(self.channels, self.optimum.lag_s):
            if lag < MIN_LAG_S:
                findings.append(warning("plunge.no_lag", subject=channel))
        return unique(findings)

    def _prior_findings(self) -> list[Finding]:
        """Findings about parameters that are far from their prior mean.

        Notes
        -----
        The limits ``INFO_DEVIATION`` and ``WARNING_DEVIATION`` decide messages only.
        """
        problem = self.optimum.problem
        theta = self.optimum.theta
        informative = np.isfinite(problem.sd)
        deviations = np.abs(np.where(informative, (theta - problem.mean) / problem.sd, 0.0))
        findings = []
        for (kind, subject), deviation, value in zip(self.layout.table(), deviations, theta):
            run_name = ""
            if kind in RUN_KINDS:
                run = self.runs[int(subject) - 1]
                run_name = run.name
                if kind == "ln_h" and deviation > WARNING_DEVIATION:
                    unexpected_h = warning(
                        "plunge.fluid",
                        where=run_name,
                        fluid=run.fluid.name,
                        ratio=np.exp(value),
                        sds=deviation,
                    )
                    findings.append(unexpected_h)
                    continue
            limit = INFO_DEVIATION if kind in INFO_KINDS else WARNING_DEVIATION
            if deviation > limit:
                severity = warning if deviation > WARNING_DEVIATION else info
                unexpected = severity(
                    "plunge.pull",
                    where=run_name,
                    subject="" if run_name else subject,
                    kind=kind,
                    sds=deviation,
                )
                findings.append(unexpected)
        return findings

    def _run_findings(self, run_index: int) -> list[Finding]:
        """Findings about one run: entry, validity of the correlation, spikes, coloured residuals.

        ``run_index`` counts from 0. Residuals are coloured above ``MAX_VARIANCE_FACTOR``.
        """
        run = self.runs[run_index]
        model = self.optimum.problem.models[run_index]
        surface = self.optimum.surfaces[run_index]
        noise = self.optimum.problem.noise[run_index]
        validity = check_validity(model.bath, surface.temperature_degC, model.bath_degC)
        findings = [f.at(run.name) for f in (*run.entry.findings, *validity)]
        if model.blocks.spikes:
            findings.append(info("plunge.spikes", where=run.name, count=model.blocks.spikes))
        if max(noise.common, noise.differential) > MAX_VARIANCE_FACTOR:
            coloured = warning(
                "plunge.coloured",
                where=run.name,
                common=noise.common,
                differential=noise.differential,
                apart=noise.differential > MAX_VARIANCE_FACTOR,
            )
            findings.append(coloured)
        return findings

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as text."""
        return messages(self.findings)

    def junction_degC(self, run: int) -> pd.DataFrame:
        """Temperatures of the junctions in a plunge, without the chain [degC].

        Parameters
        ----------
        run
            Index of the plunge.

        Returns
        -------
        table
            One row a time after the nominal entry, one column a channel.
        """
        return junction_degC(self.optimum.problem.models[run], self.layout, self.optimum.theta, run)

    def standardised_residuals(self, run: int) -> Array:
        """Residual of each block of a plunge over its standard deviation for white noise.

        Parameters
        ----------
        run
            Index of the plunge.

        Returns
        -------
        z
            (B, C); NaN for an empty block.
        """
        problem = self.optimum.problem
        blocks = problem.models[run].blocks
        residual = blocks.readings_degC - self.optimum.predictions_degC[run]
        z = residual / block_sd(problem.noise[run].sd_K, blocks.count)
        return np.where(blocks.count > 0, z, np.nan)

    def summary(self) -> str:
        """The lags, the structures and what limits them, in a few lines; warnings last."""
        warning_lines = [f"  {line}" for line in labelled_messages(self.findings)]
        return "\n".join([*self.lines(), *warning_lines])

    def lines(self) -> list[str]:
        """The lines of the summary without the warnings."""
        count = f"{len(self.runs)} plunge{'s' if len(self.runs) > 1 else ''}"
        common = self.common_lag_s
        lines = [
            f"{self.disk}: chain {self.structure}, correlation {self.correlation}, {count}",
            f"  common lag {text_with_u(common.value, common.u, 's')}, "
            f"95 % {interval_text(common)} s",
            f"    {INTERVAL_NOTE}",
        ]
        for channel in self.channels:
            value, u = rounded_texts(self.lag_s[channel].value, self.lag_s[channel].u)
            difference = self.differential_lag_s[channel]
            from_common = text_with_u(difference.value, difference.u, "s")
            lines.append(f"  {channel}: lag {value} +- {u} s, from the common lag {from_common}")
        lines.append("  where the uncertainty comes from [s], common lag / differences:")
        for share in self.budget:
            u_s = f"{share.u_common_s:.3f} / {share.u_differential_s:.3f}"
            lines.append(f"    {share.source}: {u_s}")
        lines.append(f"  {self.sentence}")
        # with findings, the text about the structures is among the warnings
        if self.structures is not None and not self.structures.findings:
            lines.append(f"  structure: {self.structures.sentence}.")
        return lines

    def _widened_common_lag(self, extra: Array) -> Estimate:
        """The common lag, widened by the covariance ``extra`` (C, C) of the lags."""
        return self.scan.estimate(
            self.setup.conditioning.lag_s, common_and_differential_u_s(extra)[0]
        )

    def _covariance_with_fixed(self, *kinds: str) -> Array:
        """Covariance (C, C) of the lags if all parameters of ``kinds`` are fixed.

        Parameters
        ----------
        *kinds
            Kinds of :mod:`immersion.plunge_parameters`.

        Returns
        -------
        covariance
            (C, C) [s2].
        """
        free: Flags = ~self.layout.mask(*kinds)
        lags = np.flatnonzero(self.layout.mask("lag")[free])
        information = self.optimum.solution.information[np.ix_(free, free)]
        return inverse(information)[np.ix_(lags, lags)]


def interval_text(estimate: Estimate) -> str:
    """The 95 % interval with the decimals of the uncertainty.

    >>> interval_text(Estimate(value=0.7, u=0.068, low95=0.5931, high95=0.857))
    '0.593 to 0.857'
    """
    low = rounded_texts(estimate.low95, estimate.u)[0]
    high = rounded_texts(estimate.high95, estimate.u)[0]
    return f"{low} to {high}"
