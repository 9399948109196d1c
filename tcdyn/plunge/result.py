"""What a plunge fit says: lags with their covariance, split into common and differential, and what limits them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import DiskSetup
from calibration.estimate import Estimate, rounded, with_u
from calibration.finding import Finding
from tcdyn.chain import Chain
from tcdyn.plunge.form import ModelForm
from tcdyn.plunge.map import Optimum, inverse
from tcdyn.plunge.prior import PlungePriors
from tcdyn.plunge.run import PlungeRun
from tcdyn.plunge.scan import LagScan, lag_covariance
from tcdyn.plunge.structures import StructureComparison

Array = NDArray[np.float64]
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
    """Chains of one disk's channels identified from its plunges; lags include the conditioning filter's own."""

    disk: str
    structure: str
    correlation: str
    channels: tuple[str, ...]
    chains: dict[str, Chain]
    lag_s: dict[str, Estimate]
    lag_covariance: Array  # (C, C) [s2]
    common_lag_s: Estimate
    differential_lag_s: dict[str, Estimate]
    nuisances: pd.DataFrame  # parameter, value, u, prior_mean, prior_sd
    budget: tuple[LagShare, ...]
    model_form: ModelForm
    validity: tuple[tuple[Finding, ...], ...]
    warnings: tuple[str, ...]
    sentence: str
    converged: bool
    priors: PlungePriors
    setup: DiskSetup
    runs: tuple[PlungeRun, ...] = field(repr=False)
    optimum: Optimum = field(repr=False)
    scan: LagScan = field(repr=False)
    structures: StructureComparison | None = field(default=None, repr=False)  # None: other structures not tried

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
        if self.structures is None or self.structures.warnings:  # said as a warning, then
            return lines
        return [*lines, f"  structure: {self.structures.sentence}."]


def interval(estimate: Estimate) -> str:
    """The 95 % interval with the decimals of the uncertainty.

    >>> interval(Estimate(value=0.7, u=0.068, low95=0.5931, high95=0.857))
    '0.593 to 0.857'
    """
    return f"{rounded(estimate.low95, estimate.u)[0]} to {rounded(estimate.high95, estimate.u)[0]}"


def lag_estimates(lag: Array, scan: LagScan, extra: Array, channels: tuple[str, ...]) -> dict[str, Estimate]:
    """Each channel's lag (C,) [s]: the common lag's skew posterior along the profile, the rest normal.

    ``extra`` (C, C) [s2] is what the choice of a model adds to the covariance.
    """
    rest = np.diag(scan.differential_covariance + extra)
    return {c: scan.skewed(float(lag[j]), float(scan.lag_slope[j]), float(rest[j])) for j, c in enumerate(channels)}


def split_lags(lag: Array, covariance: Array, channels: tuple[str, ...]) -> tuple[Estimate, dict[str, Estimate]]:
    """Common lag (mean over channels) and each channel's difference from it, with uncertainties.

    >>> common, rest = split_lags(np.array([0.7, 0.8]), np.array([[0.02, 0.0199], [0.0199, 0.02]]), ("a", "b"))
    >>> print(common, rest["b"])
    0.75 +- 0.14 0.0500 +- 0.0071
    """
    c = len(lag)
    one = np.full(c, 1 / c)
    project = np.eye(c) - 1 / c
    spread = np.sqrt(np.maximum(np.diag(project @ covariance @ project), 0.0))
    common = Estimate.normal(float(one @ lag), float(np.sqrt(one @ covariance @ one)))
    rest = {k: Estimate.normal(float(d), float(u)) for k, d, u in zip(channels, project @ lag, spread)}
    return common, rest


def lag_shares(best: Optimum, scan: LagScan, form: ModelForm) -> tuple[LagShare, ...]:
    """Where the lags' uncertainty comes from: each group of parameters held known, the variance that goes away.

    The first row is the marginal posterior's; the groups are by its normal approximation and do not add up, because
    they stand in for each other.
    """
    lay = best.problem.layout
    full = best.covariance[lay.lag, lay.lag]
    names = lay.names()

    def matching(*starts: str) -> NDArray[np.bool_]:
        return np.array([n.startswith(starts) for n in names])

    groups = {
        "entry burst": matching("ln_burst"),
        "entry time": matching("entry_"),
        "h scale and exponent": matching("ln_h_", "h_exponent"),
        "initial and bath temperature": matching("initial_", "bath_"),
        "static lines": matching("offset_", "gain_"),
        "conductivity and junction depths": matching("ln_conductivity", "depth_"),
        "split of the lag": matching("split_", "common_split"),
    }
    out = [share_of("all of the fit", lag_covariance(scan))]
    everything = np.zeros(lay.size, dtype=bool)
    for name, held in groups.items():
        out.append(share_of(name, full - _held(best.hessian, held, lay.lag)))
        everything |= held
    out.append(share_of("noise alone", _held(best.hessian, everything, lay.lag)))
    out.append(share_of("choice of correlation", form.covariance))
    return tuple(out)


def known_burst_u(best: Optimum) -> float:
    """Standard uncertainty of the common lag [s], were entry burst and entry time known."""
    lay = best.problem.layout
    held = np.array([n.startswith(("ln_burst", "entry_")) for n in lay.names()])
    return share_of("", _held(best.hessian, held, lay.lag)).u_common_s


def _held(hessian: Array, held: NDArray[np.bool_], lag: slice) -> Array:
    keep = np.flatnonzero(~held)
    covariance = inverse(hessian[np.ix_(keep, keep)])
    at = np.searchsorted(keep, np.arange(lag.start, lag.stop))
    return np.asarray(covariance[np.ix_(at, at)])


def share_of(source: str, covariance: Array) -> LagShare:
    """The common and the differential standard uncertainty in a covariance (C, C) of the lags [s2]."""
    c = len(covariance)
    project = np.eye(c) - 1 / c
    common = max(float(covariance.mean()), 0.0)
    rest = max(float(np.trace(project @ covariance @ project)) / c, 0.0)
    return LagShare(source, float(np.sqrt(common)), float(np.sqrt(rest)))
