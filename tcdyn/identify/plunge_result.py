"""What a plunge fit says: lags with their covariance, split into common and differential, and what limits them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibration.disk import DiskSetup
from calibration.estimate import Estimate
from immersion.correlations import Validity
from tcdyn.chain import Chain
from tcdyn.identify.plunge_form import ModelForm
from tcdyn.identify.plunge_map import Optimum, inverse
from tcdyn.identify.plunge_prior import PlungePriors
from tcdyn.identify.plunge_run import PlungeRun
from tcdyn.identify.plunge_scan import LagScan, lag_covariance

Array = NDArray[np.float64]


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
    validity: tuple[Validity, ...]
    warnings: tuple[str, ...]
    sentence: str
    converged: bool
    priors: PlungePriors
    setup: DiskSetup
    runs: tuple[PlungeRun, ...] = field(repr=False)
    optimum: Optimum = field(repr=False)
    scan: LagScan = field(repr=False)

    def summary(self) -> str:
        """A few lines of text."""
        lines = [
            f"{self.disk}: chain {self.structure}, correlation {self.correlation}, {len(self.runs)} plunges",
            f"  common lag {self.common_lag_s} s",
        ]
        lines += [f"  {c}: lag {self.lag_s[c]} s, differential {self.differential_lag_s[c]} s" for c in self.channels]
        lines += [
            f"  {s.source}: u {s.u_common_s:.3f} s common, {s.u_differential_s:.3f} s differential" for s in self.budget
        ]
        return "\n".join([*lines, f"  {self.sentence}", *(f"  warning: {w}" for w in self.warnings)])


def split_lags(lag: Array, covariance: Array, channels: tuple[str, ...]) -> tuple[Estimate, dict[str, Estimate]]:
    """Common lag (mean over channels) and each channel's difference from it, with uncertainties.

    >>> common, rest = split_lags(np.array([0.7, 0.8]), np.array([[0.02, 0.0199], [0.0199, 0.02]]), ("a", "b"))
    >>> print(common, rest["b"])
    0.75 +- 0.14 0.05 +- 0.0071
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
    out = [_share("all of the fit", lag_covariance(scan))]
    everything = np.zeros(lay.size, dtype=bool)
    for name, held in groups.items():
        out.append(_share(name, full - _held(best.hessian, held, lay.lag)))
        everything |= held
    out.append(_share("noise alone", _held(best.hessian, everything, lay.lag)))
    out.append(_share("choice of correlation", form.covariance))
    return tuple(out)


def conditional_u(best: Optimum, *starts: str) -> float:
    """Standard uncertainty of the common lag if the parameters whose names begin with ``starts`` were known [s]."""
    lay = best.problem.layout
    held = np.array([n.startswith(starts) for n in lay.names()])
    return _share("", _held(best.hessian, held, lay.lag)).u_common_s


def _held(hessian: Array, held: NDArray[np.bool_], lag: slice) -> Array:
    keep = np.flatnonzero(~held)
    covariance = inverse(hessian[np.ix_(keep, keep)])
    at = np.searchsorted(keep, np.arange(lag.start, lag.stop))
    return np.asarray(covariance[np.ix_(at, at)])


def _share(source: str, covariance: Array) -> LagShare:
    c = len(covariance)
    project = np.eye(c) - 1 / c
    common = max(float(covariance.mean()), 0.0)
    rest = max(float(np.trace(project @ covariance @ project)) / c, 0.0)
    return LagShare(source, float(np.sqrt(common)), float(np.sqrt(rest)))
