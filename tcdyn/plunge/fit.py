"""Grey-box identification of a disk's measurement chains from its plunges, all channels and runs at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd

from calibration.arrays import Array, Flags
from calibration.disk import DiskSetup
from calibration.errors import InputError
from calibration.estimate import Estimate, rounded, with_u
from calibration.finding import Finding, look, note, once, sentences, with_where
from immersion.correlations import THESIS_THREE, Correlation, check_validity
from immersion.correlations import correlation as find_correlation
from tcdyn.chain import STRUCTURES, Chain
from tcdyn.plunge.model import build_run_model, junction_degC
from tcdyn.plunge.parameters import RUN_KINDS, PlungeParameters, PlungePriors, stages
from tcdyn.plunge.posterior import PlungeOptimum, fit_map, full_prior, inverse
from tcdyn.plunge.run import PlungeBlocks, PlungeRun, make_blocks
from tcdyn.plunge.scan import LagScan, ModelForm, lag_covariance, model_form, settled_scan
from tcdyn.plunge.structures import StructureComparison, compare_structures

COLOURED = 4.0  # variance of slow residual waves over that of white noise: beyond it something is not modelled
UNBELIEVABLE = 5.0  # prior standard deviations of h beyond which the fluid is doubted rather than the correlation
SOURCES = {
    "entry burst": ("ln_burst", "ln_burst_time", "ln_burst_shape"),
    "entry time": ("entry",),
    "h scale and exponent": ("ln_h", "h_exponent"),
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

    @classmethod
    def of(cls, source: str, covariance: Array) -> LagShare:
        """The share of a covariance (C, C) of the lags [s2]."""
        common, rest = covariance.mean(), np.trace(_apart(covariance)) / len(covariance)
        return cls(source, float(np.sqrt(max(common, 0.0))), float(np.sqrt(max(rest, 0.0))))


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
        return self.optimum.converged

    @cached_property
    def chains(self) -> dict[str, Chain]:
        """The chain of each channel."""
        lay, theta = self.layout, self.optimum.theta
        logits = theta[lay.at("common_split")] + theta[lay.at("split")]
        out = {}
        for c, lag, logit in zip(lay.channels, self.optimum.lag_s, logits):
            taus, delay, zero = stages(lay.structure, float(lag), float(logit))
            out[c] = Chain(tuple(map(float, taus)), zero_s=zero, delay_s=delay, conditioning=self.setup.conditioning)
        return out

    @property
    def extra_covariance(self) -> Array:
        """What the choice of a correlation and of a structure adds to the lags' covariance (C, C) [s2]."""
        return self.model_form.covariance + (0.0 if self.structures is None else self.structures.covariance)

    @property
    def lag_covariance(self) -> Array:
        """Covariance (C, C) of the lags [s2]."""
        return lag_covariance(self.scan) + self.extra_covariance

    @cached_property
    def lag_s(self) -> dict[str, Estimate]:
        """Each channel's lag: the common lag's skew posterior along the profile, the rest normal."""
        lag, slope = self.optimum.lag_s + self.setup.conditioning.lag_s, self.scan.lag_slope
        rest = np.diag(self.scan.differential_covariance + self.extra_covariance)
        return {c: self.scan.skewed(*map(float, each)) for c, *each in zip(self.channels, lag, slope, rest)}

    @property
    def common_lag_s(self) -> Estimate:
        """The mean lag of the channels."""
        return self._common(self.extra_covariance)

    @cached_property
    def differential_lag_s(self) -> dict[str, Estimate]:
        """Each channel's lag less the mean of all."""
        lag = self.optimum.lag_s
        u = np.sqrt(np.maximum(np.diag(_apart(self.lag_covariance)), 0.0))
        return {c: Estimate.normal(float(d), float(s)) for c, d, s in zip(self.channels, lag - lag.mean(), u)}

    @cached_property
    def nuisances(self) -> pd.DataFrame:
        """Every parameter: value, u, prior_mean, prior_sd (nan where flat)."""
        problem, flat = self.optimum.problem, ~np.isfinite(self.optimum.problem.sd)
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
        shares = [
            LagShare.of("all of the fit", lag_covariance(self.scan)),
            *(LagShare.of(source, full - self._knowing(*kinds)) for source, kinds in SOURCES.items()),
            LagShare.of("noise alone", self._knowing(*every)),
            LagShare.of("choice of correlation", self.model_form.covariance),
        ]
        if self.structures is not None:
            shares.insert(0, LagShare.of("everything", self.lag_covariance))
            shares.append(LagShare.of("choice of chain structure", self.structures.covariance))
        return tuple(shares)

    @cached_property
    def limits(self) -> Finding:
        """The common lag and what keeps it from being better known."""
        common, within = self.common_lag_s, self._common(self.model_form.covariance).u
        known = LagShare.of("", self._knowing("ln_burst", "ln_burst_time", "ln_burst_shape", "entry")).u_common_s
        return note(
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
        problem, theta = self.optimum.problem, self.optimum.theta
        names = [run.name for run in self.runs]
        out = [*(self.structures.findings if self.structures is not None else ()), *self.rival]
        if not self.converged:
            out.append(look("plunge.unconverged"))
        pulls = np.where(np.isfinite(problem.sd), (theta - problem.mean) / problem.sd, 0.0)
        for (kind, subject), pull, value in zip(self.layout.table(), np.abs(pulls), theta):
            where = names[int(subject) - 1] if kind in RUN_KINDS else ""
            if kind == "ln_h" and pull > UNBELIEVABLE:
                fluid = self.runs[int(subject) - 1].fluid.name
                out.append(look("plunge.fluid", where=where, fluid=fluid, ratio=np.exp(value), sds=pull))
            elif pull > 3:
                out.append(look("plunge.pull", where=where, subject="" if where else subject, kind=kind, sds=pull))
        for run, model, surface, factor in zip(self.runs, problem.models, self.optimum.surfaces, problem.noise):
            beyond = check_validity(model.bath, surface.temperature_degC, model.bath_degC)
            out += with_where((*run.entry.findings, *beyond), run.name)
            if model.blocks.spikes:
                out.append(note("plunge.spikes", where=run.name, count=model.blocks.spikes))
            if max(factor.common, factor.differential) > COLOURED:
                out.append(
                    look(
                        "plunge.coloured",
                        where=run.name,
                        common=factor.common,
                        differential=factor.differential,
                        apart=factor.differential > COLOURED,
                    )
                )
        out += [look("plunge.no_lag", subject=c) for c, lag in zip(self.channels, self.optimum.lag_s) if lag < 0.01]
        return once(out)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return sentences(self.findings)

    def junction_degC(self, run: int) -> pd.DataFrame:
        """What the junctions of a plunge really saw, without the chain: [degC] by time after entry [s] and channel."""
        return junction_degC(self.optimum.problem.models[run], self.layout, self.optimum.theta, run)

    def summary(self) -> str:
        """The lags, the structures and what limits them, in a few lines; warnings last."""
        return "\n".join([*self.lines(), *(f"  warning: {w}" for w in self.warnings)])

    def lines(self) -> list[str]:
        """The summary's lines without the warnings."""
        count = f"{len(self.runs)} plunge{'s' if len(self.runs) > 1 else ''}"
        common = self.common_lag_s
        rows = [(c, rounded(self.lag_s[c].value, self.lag_s[c].u), self.differential_lag_s[c]) for c in self.channels]
        lines = [
            f"{self.disk}: chain {self.structure}, correlation {self.correlation}, {count}",
            f"  common lag {with_u(common.value, common.u, 's')}, 95 % {interval(common)} s",
            f"    {INTERVAL_NOTE}",
            *(
                f"  {c}: lag {value} +- {u} s, from the common lag {with_u(d.value, d.u, 's')}"
                for c, (value, u), d in rows
            ),
            "  where the uncertainty comes from [s], common lag / differences:",
            *(f"    {s.source}: {s.u_common_s:.3f} / {s.u_differential_s:.3f}" for s in self.budget),
            f"  {self.sentence}",
        ]
        if self.structures is None or self.structures.findings:  # said as a warning, then
            return lines
        return [*lines, f"  structure: {self.structures.sentence}."]

    def _common(self, extra: Array) -> Estimate:
        return self.scan.estimate(self.setup.conditioning.lag_s, float(np.sqrt(max(extra.mean(), 0.0))))

    def _knowing(self, *kinds: str) -> Array:
        """Covariance (C, C) of the lags, were all parameters of ``kinds`` known."""
        keep: Flags = ~self.layout.mask(*kinds)
        at = np.flatnonzero(self.layout.mask("lag")[keep])
        return inverse(self.optimum.hessian[np.ix_(keep, keep)])[np.ix_(at, at)]


def identify_plunges(
    runs: Sequence[PlungeRun],
    setup: DiskSetup,
    *,
    correlation: str | Correlation = "churchill-chu-laminar",
    structure: str = "P2",
    priors: PlungePriors | None = None,
    alternatives: Sequence[str] = THESIS_THREE,
    face_W_m2K: float = 0.0,
) -> PlungeFit:
    """Chains of the channels of one disk from one or more plunges.

    Model: radial conduction from bore to running surface, h = s (|dT|/dT_0)^m h_correlation (1 + A exp(-(t/tau)^p)),
    junction -> chain (structure, with the known conditioning filter) -> static line. Per run s, m, A, tau, p, entry
    time, initial and bath temperature are free within ``priors``; per channel the lag, its split, depth and static
    remainders; the conductivity is common. The answer is the most probable parameter set, its covariance the inverse
    Hessian with the noise judged from the residuals. Each of ``alternatives`` is fitted too; the spread of the lags
    between correlations is added to their covariance. ``face_W_m2K`` is a leak through each side face.

    Raises InputError when runs have different channels or too little data.
    """
    if not runs:
        raise InputError("no plunge was given", expected="one immersion log or more")
    channels = runs[0].channels
    if any(r.channels != channels for r in runs):
        raise InputError("the plunges have different channels", expected=", ".join(channels))
    if structure not in STRUCTURES:
        raise InputError(f"unknown chain structure {structure!r}", expected=", ".join(STRUCTURES))
    priors = priors or PlungePriors()
    chosen = find_correlation(correlation)
    blocks = [make_blocks(r) for r in runs]
    layout = PlungeParameters(len(runs), channels, structure)
    initial = [float(np.nanmean(b.readings_degC[b.time_s < 0])) for b in blocks]
    mean, sd = full_prior(layout, priors, runs, initial, [float(b.bath_degC[0]) for b in blocks], chosen, setup)
    best, rival = _best_of_two(runs, blocks, setup, layout, chosen, mean, sd, face_W_m2K)
    scan, best, _ = settled_scan(best)
    form = model_form(best, scan, chosen, [find_correlation(name) for name in alternatives], setup.conditioning.lag_s)
    return PlungeFit(setup, chosen.name, priors, form, rival, tuple(runs), best, scan)


def with_structure_doubt(fit: PlungeFit) -> PlungeFit:
    """The fit with every other chain structure tried on its plunges, and the lags' covariance widened by the spread.

    The lags stay those of the fit's own structure; ``structures`` holds the comparison.
    """
    own = fit.setup.conditioning.lag_s
    return replace(
        fit, structures=compare_structures(fit.optimum, fit.scan, fit.priors, own, fit.model_form.u_common_s)
    )


def published_degC(
    run: PlungeRun, setup: DiskSetup, correlations: Sequence[str] = THESIS_THREE
) -> dict[str, pd.DataFrame]:
    """Junctions by each correlation as published, h scale one, no burst (figures 5.26 and 5.27), by the names of both.

    Tables as those of :meth:`PlungeFit.junction_degC`; ``tcdyn.plots.draw_entry(run, tables, ax)`` draws them.
    """
    blocks, layout = make_blocks(run), PlungeParameters(1, run.channels, "P1")
    theta = np.where(layout.mask("ln_burst"), -np.inf, 0.0)
    theta[layout.at("initial")] = np.mean(blocks.readings_degC[blocks.time_s < 0])
    out = {}
    for chosen in map(find_correlation, correlations):
        model = build_run_model(run, blocks, setup, layout, chosen)
        out[f"{chosen.name} {chosen.title}"] = junction_degC(model, layout, theta, 0)
    return out


def interval(estimate: Estimate) -> str:
    """The 95 % interval with the decimals of the uncertainty.

    >>> interval(Estimate(value=0.7, u=0.068, low95=0.5931, high95=0.857))
    '0.593 to 0.857'
    """
    return f"{rounded(estimate.low95, estimate.u)[0]} to {rounded(estimate.high95, estimate.u)[0]}"


def _apart(covariance: Array) -> Array:
    """Covariance (C, C) of the differences from the mean of all channels.

    >>> _apart(np.array([[0.02, 0.0199], [0.0199, 0.02]])).round(6).tolist()
    [[5e-05, -5e-05], [-5e-05, 5e-05]]
    """
    project = np.eye(len(covariance)) - 1 / len(covariance)
    return np.asarray(project @ covariance @ project)


def _best_of_two(
    runs: Sequence[PlungeRun],
    blocks: Sequence[PlungeBlocks],
    setup: DiskSetup,
    layout: PlungeParameters,
    chosen: Correlation,
    mean: Array,
    sd: Array,
    face_W_m2K: float,
) -> tuple[PlungeOptimum, tuple[Finding, ...]]:
    """The optimum, and a finding when a long lag under a fierce burst fits as well as a short one under a mild burst.

    A second start, from a lag of 0.5 s, is made when the first did not settle or ended beyond 1.5 s; of two solutions
    whose cost differs by less than 6 the shorter lag is taken, and the other is named.
    """
    best = fit_map(runs, blocks, setup, layout, chosen, mean, sd, face_W_m2K=face_W_m2K)
    long = float(np.mean(best.lag_s))
    if best.converged and long < 1.5:
        return best, ()
    start = mean.copy()
    start[layout.at("lag")] = 0.5
    other = fit_map(runs, blocks, setup, layout, chosen, mean, sd, start=start, face_W_m2K=face_W_m2K)
    short, gap = float(np.mean(other.lag_s)), other.cost - best.cost
    if gap > 6.0 or (short > long and gap > 0):
        return best, ()
    if gap < -6.0 or abs(long - short) < 0.3:
        return other, ()
    return other, (look("plunge.rival", lag_s=long + setup.conditioning.lag_s, chi_square=abs(gap)),)
