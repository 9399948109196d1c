"""What a plunge fit says: lags with their covariance, split into common and differential, and what limits them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from immersion.chain_structures import StructureComparison
from immersion.correlations import check_validity
from immersion.plunge_data import PlungeRun
from immersion.plunge_model import junction_degC
from immersion.plunge_parameters import (
    BURST_KINDS,
    H_KINDS,
    RUN_KINDS,
    PlungeParameters,
    PlungePriors,
    apart,
    lag_u_s,
    stages,
)
from immersion.plunge_posterior import LagScan, ModelForm, PlungeOptimum
from tcdyn.chain import Chain
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array, Flags
from tcdyn.core.estimate import Estimate, rounded, with_u
from tcdyn.core.findings import Finding, info, labelled_messages, messages, unique, warning
from tcdyn.estimation import inverse
from tcdyn.rig.disk import DiskSetup

COLOURED = 4.0  # variance of slow residual waves over that of white noise: beyond it something is not modelled
DOUBTED = 3.0  # prior standard deviations beyond which what was expected, or the fluid, is doubted
UNUSUAL = 2.0  # the same of a plunge's bath and form of h, beyond which it is mentioned
SOURCES = {
    "entry burst": BURST_KINDS,
    "entry time": ("entry",),
    "h and its form": H_KINDS,
    "initial and bath temperature": ("initial", "bath"),
    "static lines": ("offset", "gain"),
    "conductivity and junction depths": ("ln_conductivity", "depth"),
    "split of the lag": ("split", "common_split"),
}
INTERVAL_NOTE = (
    "(a lag's interval may reach further up than down: a long lag behind a fierce entry burst fits nearly as well as a "
    "short one; burst and lag are common to the channels, so their differences have even intervals)"
)


@dataclass(frozen=True)
class LagShare:
    """Standard uncertainty that one source adds to the common lag and (rms over channels) to differential lags."""

    source: str
    u_common_s: float
    u_differential_s: float


@dataclass(frozen=True)
class PlungeFit:
    """Chains of one disk's channels identified from its plunges; lags include the conditioning filter's own.

    ``optimum`` is the most probable set of parameters, its common lag at the posterior mean of ``scan``;
    ``model_form`` and ``structures`` (None: not tried) tell what other models would change, and widen the lags.
    """

    setup: DiskSetup
    correlation: str
    priors: PlungePriors
    model_form: ModelForm
    rival: tuple[Finding, ...]  # a second solution, where there is one
    runs: tuple[PlungeRun, ...] = field(repr=False)
    optimum: PlungeOptimum = field(repr=False)
    scan: LagScan = field(repr=False)
    noise: LoggerNoise = field(repr=False)
    structures: StructureComparison | None = field(default=None, repr=False)

    @property
    def disk(self) -> str:
        """Name of the disk."""
        return self.setup.name

    @property
    def layout(self) -> PlungeParameters:
        """Where each parameter stands."""
        return self.optimum.problem.layout

    @property
    def structure(self) -> str:
        """Name of the chains' structure."""
        return self.layout.structure

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels, in the order of all arrays."""
        return self.layout.channels

    @property
    def converged(self) -> bool:
        """Whether the search ended at an optimum."""
        return self.optimum.found.converged

    @cached_property
    def chains(self) -> dict[str, Chain]:
        """The chain of each channel."""
        lay = self.layout
        theta = self.optimum.theta
        logits = theta[lay.at("common_split")] + theta[lay.at("split")]
        out = {}
        for c, lag, logit in zip(lay.channels, self.optimum.lag_s, logits):
            taus, delay, zero = stages(lay.structure, lag, logit)
            chain = Chain(
                tuple(taus),
                zero_s=float(zero),
                delay_s=float(delay),
                conditioning=self.setup.conditioning,
            )
            out[c] = chain
        return out

    @cached_property
    def split_u_s(self) -> dict[str, float]:
        """Standard uncertainty of how much of each channel's lag, held where it was found, is its largest lag's [s].

        The split's own, with the lag left free: what both have in common is counted twice rather than not at all.
        """
        lay = self.layout
        theta = self.optimum.theta
        cov = self.optimum.covariance
        common = lay.at("common_split")
        own = lay.at("split")
        logits = theta[common] + theta[own]
        u = np.sqrt(cov[common, common] + np.diag(cov[own, own]) + 2 * cov[common, own])[0]
        ends = [
            [stages(lay.structure, float(lag), float(at))[0][0] for at in (logit - sd, logit + sd)]
            for lag, logit, sd in zip(self.optimum.lag_s, logits, u)
        ]
        return {c: 0.5 * abs(high - low) for c, (low, high) in zip(lay.channels, ends)}

    @property
    def extra_covariance(self) -> Array:
        """What the choice of a correlation and of a structure adds to the lags' covariance (C, C) [s2]."""
        return self.model_form.covariance + (
            0.0 if self.structures is None else self.structures.covariance
        )

    @property
    def lag_covariance(self) -> Array:
        """Covariance (C, C) of the lags [s2]."""
        return self.scan.covariance + self.extra_covariance

    @cached_property
    def lag_s(self) -> dict[str, Estimate]:
        """Each channel's lag: the common lag's skew posterior along the profile, the rest normal."""
        lag = self.optimum.lag_s + self.setup.conditioning.lag_s
        slope = self.scan.lag_slope
        rest = np.diag(self.scan.differential_covariance + self.extra_covariance)
        return {
            c: self.scan.skewed(*map(float, each))
            for c, *each in zip(self.channels, lag, slope, rest)
        }

    @property
    def common_lag_s(self) -> Estimate:
        """The mean lag of the channels."""
        return self._common(self.extra_covariance)

    @cached_property
    def differential_lag_s(self) -> dict[str, Estimate]:
        """Each channel's lag less the mean of all."""
        lag = self.optimum.lag_s
        u = np.sqrt(np.maximum(np.diag(apart(self.lag_covariance)), 0.0))
        return {
            c: Estimate.normal(float(d), float(s))
            for c, d, s in zip(self.channels, lag - lag.mean(), u)
        }

    @cached_property
    def nuisances(self) -> pd.DataFrame:
        """Every parameter: value, u, prior_mean, prior_sd (nan where flat)."""
        problem = self.optimum.problem
        flat = ~np.isfinite(self.optimum.problem.sd)
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
        """Where the lags' uncertainty comes from: each group of parameters held known, the variance that goes away.

        The first rows are the marginal posterior's; the groups are by its normal approximation and do not add up,
        because they stand in for each other.
        """
        lag = self.layout.at("lag")
        full = self.optimum.covariance[lag, lag]
        every = [kind for kinds in SOURCES.values() for kind in kinds]
        known = {
            "all of the fit": self.scan.covariance,
            **{source: full - self._knowing(*kinds) for source, kinds in SOURCES.items()},
            "noise alone": self._knowing(*every),
            "choice of correlation": self.model_form.covariance,
        }
        if self.structures is not None:
            known = {"everything": self.lag_covariance, **known}
            known["choice of chain structure"] = self.structures.covariance
        return tuple(LagShare(source, *lag_u_s(covariance)) for source, covariance in known.items())

    @cached_property
    def limits(self) -> Finding:
        """The common lag and what keeps it from being better known."""
        common = self.common_lag_s
        within = self._common(self.model_form.covariance).u
        known = lag_u_s(self._knowing(*BURST_KINDS, "entry"))[0]
        return info(
            "plunge.lag",
            plunges=len(self.runs),
            common_lag_s=common.value,
            u_s=common.u,
            known_burst_u_s=known,
            apart=within <= max(0.05, 0.10 * common.value),
        )

    @property
    def sentence(self) -> str:
        """:attr:`limits` in words."""
        return self.limits.sentence

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Everything in the fit that a careful reader should know."""
        problem = self.optimum.problem
        theta = self.optimum.theta
        names = [run.name for run in self.runs]
        out = [*(self.structures.findings if self.structures is not None else ()), *self.rival]
        out += self.noise.findings(self.disk)
        if not self.converged:
            out.append(warning("plunge.unconverged"))
        pulls = np.where(np.isfinite(problem.sd), (theta - problem.mean) / problem.sd, 0.0)
        for (kind, subject), pull, value in zip(self.layout.table(), np.abs(pulls), theta):
            where = names[int(subject) - 1] if kind in RUN_KINDS else ""
            if kind == "ln_h" and pull > DOUBTED:
                fluid = self.runs[int(subject) - 1].fluid.name
                out.append(
                    warning("plunge.fluid", where=where, fluid=fluid, ratio=np.exp(value), sds=pull)
                )
            elif pull > (UNUSUAL if kind in ("bath", "h_exponent", "h_viscosity") else DOUBTED):
                where, subject = (where, "") if where else ("", subject)
                said = (warning if pull > DOUBTED else info)(
                    "plunge.pull", where=where, subject=subject, kind=kind, sds=pull
                )
                out.append(said)
        for run, model, surface, factor in zip(
            self.runs, problem.models, self.optimum.surfaces, problem.noise
        ):
            beyond = check_validity(model.bath, surface.temperature_degC, model.bath_degC)
            out += [f.at(run.name) for f in (*run.entry.findings, *beyond)]
            if model.blocks.spikes:
                out.append(info("plunge.spikes", where=run.name, count=model.blocks.spikes))
            if max(factor.common, factor.differential) > COLOURED:
                out.append(
                    warning(
                        "plunge.coloured",
                        where=run.name,
                        common=factor.common,
                        differential=factor.differential,
                        apart=factor.differential > COLOURED,
                    )
                )
        out += [
            warning("plunge.no_lag", subject=c)
            for c, lag in zip(self.channels, self.optimum.lag_s)
            if lag < 0.01
        ]
        return unique(out)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return messages(self.findings)

    def junction_degC(self, run: int) -> pd.DataFrame:
        """What the junctions of a plunge really saw, without the chain: [degC] by time after entry [s] and channel."""
        return junction_degC(self.optimum.problem.models[run], self.layout, self.optimum.theta, run)

    def summary(self) -> str:
        """The lags, the structures and what limits them, in a few lines; warnings last."""
        return "\n".join(
            [*self.lines(), *(f"  {line}" for line in labelled_messages(self.findings))]
        )

    def lines(self) -> list[str]:
        """The summary's lines without the warnings."""
        count = f"{len(self.runs)} plunge{'s' if len(self.runs) > 1 else ''}"
        common = self.common_lag_s
        rows = [
            (c, rounded(self.lag_s[c].value, self.lag_s[c].u), self.differential_lag_s[c])
            for c in self.channels
        ]
        lines = [
            f"{self.disk}: chain {self.structure}, correlation {self.correlation}, {count}",
            f"  common lag {with_u(common.value, common.u, 's')}, 95 % {interval(common)} s",
            f"    {INTERVAL_NOTE}",
            *(
                f"  {c}: lag {value} +- {u} s, from the common lag {with_u(d.value, d.u, 's')}"
                for c, (value, u), d in rows
            ),
            "  where the uncertainty comes from [s], common lag / differences:",
            *(
                f"    {s.source}: {s.u_common_s:.3f} / {s.u_differential_s:.3f}"
                for s in self.budget
            ),
            f"  {self.sentence}",
        ]
        if self.structures is None or self.structures.findings:  # said as a warning, then
            return lines
        return [*lines, f"  structure: {self.structures.sentence}."]

    def _common(self, extra: Array) -> Estimate:
        return self.scan.estimate(self.setup.conditioning.lag_s, lag_u_s(extra)[0])

    def _knowing(self, *kinds: str) -> Array:
        """Covariance (C, C) of the lags, were all parameters of ``kinds`` known."""
        keep: Flags = ~self.layout.mask(*kinds)
        at = np.flatnonzero(self.layout.mask("lag")[keep])
        return inverse(self.optimum.found.information[np.ix_(keep, keep)])[np.ix_(at, at)]


def interval(estimate: Estimate) -> str:
    """The 95 % interval with the decimals of the uncertainty.

    >>> interval(Estimate(value=0.7, u=0.068, low95=0.5931, high95=0.857))
    '0.593 to 0.857'
    """
    return f"{rounded(estimate.low95, estimate.u)[0]} to {rounded(estimate.high95, estimate.u)[0]}"
