"""Parameters of the plunge fit: layout of the parameter vector, priors, and chain structures.

Every module of the plunge fit and the design of plunges read the parameter vector through
:class:`PlungeParameters`, so the order of the kinds is defined here only. The widths of the priors
are those of ``rig.toml`` ([uncertainty]) where it has them; the others are chosen by judgement.
Tests:
``tests/immersion/test_plunge_fit.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tcdyn.core import Array, Flags
from tcdyn.rig.rigfile import UncertaintyTable

# Kinds of parameters, in the order of the parameter vector: scale and form of h, entry burst, all
# of a run, all of a channel, common to all runs.
H_KINDS = ("ln_h", "h_exponent", "h_viscosity")
BURST_KINDS = ("ln_burst", "ln_burst_time", "ln_burst_shape")
RUN_KINDS = (*H_KINDS, *BURST_KINDS, "entry", "initial", "bath")
CHANNEL_KINDS = ("lag", "split", "depth", "offset", "gain")
COMMON_KINDS = ("ln_conductivity", "common_split")
# Prior standard deviation of a parameter that has a fixed value, in its own unit; chosen by
# judgement: small, not zero, so that the precision stays finite.
FIXED_SD = 1e-6


@dataclass(frozen=True)
class PlungePriors:
    """Priors of the nuisance parameters: medians and standard deviations; a lag is flat above zero.

    A width whose name ends in ``_log`` is the standard deviation of ln(parameter).

    Notes
    -----
    Entry burst: h is multiplied by 1 + A exp(-(t/tau)^p) after the entry.

    Form of h: h may differ from its correlation by the factor s (|dT|/dT_0)^m (nu_wall/nu_bath)^v.
    The published powers of Ra are 1/4 (McAdams 1954, Mikheev 1956, Holman 2010), 1/3 (McAdams at
    large Ra), 0.19, 1/4 and 1/3 by range of Ra (Morgan 1975), and 1/4 to 1/3 (Churchill and Chu
    1975 at any Ra). The power of (5.4) is 0.24 with its constant term; the prior of m therefore
    covers powers of 0.12 to 0.36 (95 %). The power of |dT| also changes along a run, because the
    viscosity at the wall does.

    Relative to (5.4), in oil and water, heated and cooled, these forms and the VDI Heat Atlas for
    cylinders have the form above within 0.3 % rms (Morgan 0.8 %), with ln s from -1 to 0.3, m from
    -0.02 to 0.11 and v from -0.20 to 0.06: ``tests/immersion/test_immersion_correlations.py``. What
    remains shifts the common lag by less than 0.3 of its u. A power that changes linearly in ln
    |dT|, as a further parameter, would therefore change little.

    Each width may be changed; a wider prior widens the lags. A new kind of parameter also needs an
    entry in :meth:`PlungeParameters.prior` and in the Jacobian of ``immersion.plunge_model``.
    Coverage: ``tests/immersion/test_plunge_fit.py`` and ``tests/immersion/forms_study.py``.
    """

    h_scale_log: float = 0.30  # per run, median 1
    h_exponent: float = 0.06  # per run: extra power m of the temperature difference in h, mean 0
    h_viscosity: float = 0.10  # per run: power v of viscosity at the wall over bath, mean 0
    burst_median: float = 1.5  # of A
    burst_log: float = 0.7
    burst_time_median_s: float = 1.2
    burst_time_log: float = 0.5
    burst_shape_log: float = 0.3  # of p, median 1
    entry_scale: float = 1.0  # standard deviation of the entry time over u of the entry event
    initial_K: float = 5.0  # of the temperature before the entry; mean: that of the readings
    bath_K: float = 0.5  # offset of the bath thermometer
    conductivity_log: float = 0.03
    depth_m: float = 1e-4
    static_offset_K: float = 0.05  # per channel without static line; else the line's covariance
    static_gain: float = 5e-4  # per channel, likewise
    shape_logit: float = 0.0  # mean of the logit of 4 tau1 tau2 / lag^2
    shape_logit_common: float = 1.5
    shape_logit_channel: float = 0.7

    @classmethod
    def for_rig(cls, table: UncertaintyTable) -> PlungePriors:
        """The default priors, with the uncertainties in ``[uncertainty]`` of the rig file.

        A plunge depends on K / (rho c) only. The parameter "conductivity" of the fit therefore
        carries the uncertainties of both.

        Parameters
        ----------
        table
            The table ``[uncertainty]``.
        """
        steel_rel = float(np.hypot(table.conductivity_rel, table.heat_capacity_rel))
        return cls(
            h_scale_log=max(table.bath_h_rel, FIXED_SD),
            h_exponent=max(table.bath_h_exponent, FIXED_SD),
            h_viscosity=max(table.bath_h_viscosity, FIXED_SD),
            bath_K=max(table.bath_K, FIXED_SD),
            conductivity_log=max(steel_rel, FIXED_SD),
            depth_m=max(table.depth_mm * 1e-3, 1e-9),
        )

    def describe(self) -> list[tuple[str, str]]:
        """Each prior as (parameter, text), for tables.

        Returns
        -------
        rows
            Name and description of each prior.
        """
        return [
            ("h scale, per run", f"lognormal, median 1, sd {100 * self.h_scale_log:.0f} %"),
            ("extra exponent of h, per run", f"normal, mean 0, sd {self.h_exponent:g}"),
            (
                "power of viscosity, wall over bath, in h, per run",
                f"normal, mean 0, sd {self.h_viscosity:g}",
            ),
            (
                "burst size A, per run",
                f"lognormal, median {self.burst_median:g}, sd of ln {self.burst_log:g}",
            ),
            (
                "burst time, per run",
                f"lognormal, median {self.burst_time_median_s:g} s, sd of ln "
                f"{self.burst_time_log:g}",
            ),
            (
                "burst shape, per run",
                f"lognormal, median 1 (exponential), sd of ln {self.burst_shape_log:g}",
            ),
            (
                "entry time, per run",
                f"normal, mean: the entry event, sd {self.entry_scale:g} times its u",
            ),
            (
                "initial temperature, per run",
                f"normal, mean: the readings, sd {self.initial_K:g} K",
            ),
            ("bath offset, per run", f"normal, mean 0, sd {self.bath_K:g} K"),
            (
                "conductivity over heat capacity",
                f"lognormal, median: the rig file, sd {100 * self.conductivity_log:.1f} %",
            ),
            (
                "junction depth, per channel",
                f"normal, mean: the rig file, sd {1e3 * self.depth_m:.2f} mm",
            ),
            (
                "static line, per channel",
                "the covariance of the oven calibration; without it "
                f"sd {self.static_offset_K:g} K and {self.static_gain:g} of slope",
            ),
            (
                "split of the lag over two stages",
                f"logit of 4 tau1 tau2 / (tau1 + tau2)^2: normal, mean {self.shape_logit:g}, sd "
                f"{self.shape_logit_common:g} in common and {self.shape_logit_channel:g} per "
                "channel",
            ),
            ("lag, per channel", "flat above zero"),
        ]


@dataclass(frozen=True)
class PlungeParameters:
    """Layout of the parameter vector: nine kinds for each run, five for each channel, two common.

    Attributes
    ----------
    runs
        Number of runs (R).
    channels
        Names of the channels (C).
    structure
        Name of the chain structure.

    Notes
    -----
    ``lag`` is the sum of the lags and the dead time of the chain without the conditioning filter
    [s]; its prior is flat. ``split`` is the deviation of the channel from the common logit of the
    split. ``depth`` is the deviation of the junction's depth [m]. ``offset`` [K] and ``gain`` [1]
    are the errors that remain after the static line. ``ln_conductivity`` is ln of the conductivity
    over its nominal value. ``common_split`` is the common logit of the split.
    """

    runs: int
    channels: tuple[str, ...]
    structure: str

    @property
    def size(self) -> int:
        """Number of parameters."""
        n_run = len(RUN_KINDS) * self.runs
        n_channel = len(CHANNEL_KINDS) * len(self.channels)
        return n_run + n_channel + len(COMMON_KINDS)

    def run(self, r: int) -> slice:
        """Indices of the parameters of run ``r``, in the order of RUN_KINDS."""
        return slice(len(RUN_KINDS) * r, len(RUN_KINDS) * (r + 1))

    def at(self, kind: str) -> slice:
        """Indices of the parameters of one kind: one for each run, one for each channel, or one."""
        n_run = len(RUN_KINDS) * self.runs
        n_channels = len(self.channels)
        if kind in RUN_KINDS:
            return slice(RUN_KINDS.index(kind), n_run, len(RUN_KINDS))
        if kind in CHANNEL_KINDS:
            start = n_run + n_channels * CHANNEL_KINDS.index(kind)
            return slice(start, start + n_channels)
        start = n_run + n_channels * len(CHANNEL_KINDS) + COMMON_KINDS.index(kind)
        return slice(start, start + 1)

    def mask(self, *kinds: str) -> Flags:
        """Whether each parameter (P,) is of one of ``kinds``."""
        out = np.zeros(self.size, dtype=bool)
        for kind in kinds:
            out[self.at(kind)] = True
        return out

    @property
    def common_lag(self) -> Array:
        """Weights of the parameters in the common lag (P,), the mean lag of all channels."""
        return self.mask("lag") / len(self.channels)

    def table(self) -> list[tuple[str, str]]:
        """Kind and subject of each parameter: number of the run from 1, channel, or empty.

        Returns
        -------
        rows
            (kind, subject) of each parameter, in the order of the vector.
        """
        return [
            *((kind, str(r + 1)) for r in range(self.runs) for kind in RUN_KINDS),
            *((kind, c) for kind in CHANNEL_KINDS for c in self.channels),
            *((kind, "") for kind in COMMON_KINDS),
        ]

    def names(self) -> list[str]:
        """A name for each parameter."""
        return [f"{kind}_{subject}" if subject else kind for kind, subject in self.table()]

    def split_prior(self, priors: PlungePriors) -> dict[str, tuple[float, float]]:
        """Prior mean and standard deviation of the two split kinds; fixed for one lag.

        Parameters
        ----------
        priors
            Widths of the priors.

        Returns
        -------
        prior
            (mean, standard deviation) for "split" and "common_split".

        Notes
        -----
        P1 has no split; ``FIXED_SD`` keeps its two parameters at their mean.
        """
        channel_sd = priors.shape_logit_channel
        common_sd = priors.shape_logit_common
        if self.structure == "P1":
            channel_sd = FIXED_SD
            common_sd = FIXED_SD
        return {"split": (0.0, channel_sd), "common_split": (priors.shape_logit, common_sd)}

    def prior(
        self,
        priors: PlungePriors,
        entry_u_s: Sequence[float],
        initial_degC: Sequence[float],
        h_u_rel: Sequence[float] = (0.0,),
    ) -> tuple[Array, Array]:
        """Prior mean and standard deviation of every parameter.

        Parameters
        ----------
        priors
            Widths of the priors.
        entry_u_s
            Standard uncertainty of the entry time of each run [s].
        initial_degC
            Temperature before the entry of each run [degC].
        h_u_rel
            Relative standard uncertainty of h from the properties of the fluid, of each run.

        Returns
        -------
        mean, sd
            (P,) each; the standard deviation is infinite where the prior is flat.
        """
        prior: dict[str, tuple[float | Sequence[float], float | Array]] = {
            "ln_h": (0.0, np.hypot(priors.h_scale_log, h_u_rel)),
            "h_exponent": (0.0, priors.h_exponent),
            "h_viscosity": (0.0, priors.h_viscosity),
            "ln_burst": (float(np.log(priors.burst_median)), priors.burst_log),
            "ln_burst_time": (float(np.log(priors.burst_time_median_s)), priors.burst_time_log),
            "ln_burst_shape": (0.0, priors.burst_shape_log),
            "entry": (0.0, priors.entry_scale * np.asarray(entry_u_s)),
            "initial": (initial_degC, priors.initial_K),
            "bath": (0.0, priors.bath_K),
            "lag": (0.0, np.inf),
            "depth": (0.0, priors.depth_m),
            "offset": (0.0, priors.static_offset_K),
            "gain": (0.0, priors.static_gain),
            "ln_conductivity": (0.0, priors.conductivity_log),
            **self.split_prior(priors),
        }
        mean = np.empty(self.size)
        sd = np.empty(self.size)
        for kind, (centre, width) in prior.items():
            mean[self.at(kind)] = centre
            sd[self.at(kind)] = width
        return mean, sd


def stages(structure: str, lag_s: Any, logit: Any) -> tuple[tuple[Any, ...], Any, Any]:
    """Time constants, dead time and zero of a chain structure with a given total lag and split.

    Parameters
    ----------
    structure
        P1, P2, P1D, P2D, P2Z or P3.
    lag_s
        Lag of the chain without the conditioning filter [s]; a number or an array.
    logit
        Logit of the split s; a number or an array of the same shape.

    Returns
    -------
    taus_s, delay_s, zero_s
        Time constants (tau1, tau2, ...), dead time and zero [s].

    Notes
    -----
    With s = 1/(1 + exp(-logit)):

    - P1: one lag.
    - P2: tau1 + tau2 = lag, 4 tau1 tau2 / lag^2 = s.
    - P1D: dead time = lag s/2.
    - P2D: dead time = 0.4 lag s; two time constants of ratio four to one take the remaining lag.
    - P2Z: zero = lag s, time constants (1 + 0.8 s) lag and 0.2 s lag: one part of the reading
      responds quickly, the other has a slow tail.
    - P3: two equal time constants lag s/3, the first takes the remaining lag; all three are equal
      at s = 1.

    Each structure keeps the sum of time constants and dead time, minus the zero, at the lag:
    ``tests/immersion/test_plunge_fit.py``. A new structure needs an entry in
    ``tcdyn.chain.STRUCTURES``. The ratios 0.4, 0.8 and 0.2 are chosen by judgement.
    """
    if structure == "P1":
        return (lag_s,), 0.0, 0.0
    share = 1 / (1 + np.exp(-logit))
    if structure == "P1D":
        return (lag_s * (1 - share / 2),), lag_s * share / 2, 0.0
    if structure == "P2D":
        lags_s = lag_s * (1 - 0.4 * share)
        return (0.8 * lags_s, 0.2 * lags_s), 0.4 * share * lag_s, 0.0
    if structure == "P2Z":
        return (lag_s * (1 + 0.8 * share), 0.2 * share * lag_s), 0.0, share * lag_s
    if structure == "P3":
        return (lag_s * (1 - 2 * share / 3), lag_s * share / 3, lag_s * share / 3), 0.0, 0.0
    root = np.sqrt(1 - share)
    return (lag_s * (1 + root) / 2, lag_s * (1 - root) / 2), 0.0, 0.0


def differential_covariance(covariance: Array) -> Array:
    """Covariance (C, C) of the differences between the lags and their mean over all channels.

    Parameters
    ----------
    covariance
        Covariance of the lags (C, C) [s2].

    Returns
    -------
    covariance
        (C, C) [s2]; its rows sum to zero.

    Examples
    --------
    >>> differential_covariance(np.array([[0.02, 0.0199], [0.0199, 0.02]])).round(6).tolist()
    [[5e-05, -5e-05], [-5e-05, 5e-05]]
    """
    project = np.eye(len(covariance)) - 1 / len(covariance)
    return project @ covariance @ project


def common_and_differential_u_s(covariance: Array) -> tuple[float, float]:
    """Standard uncertainties of the common lag and (rms over channels) of the differences [s].

    Parameters
    ----------
    covariance
        Covariance (C, C) of the lags [s2]. It may be the difference of two covariances; a negative
        variance counts as zero.

    Returns
    -------
    common, differential
        Standard uncertainties [s].

    Notes
    -----
    u_common^2 = 1'C1 / n^2, the mean of all elements of C, for n channels. u_differential^2 is the
    mean of the diagonal of :func:`differential_covariance`. ``tcdyn.smoothing.traces.DiskTraces``
    computes the same mean for its ``common_lag_u_s``; keep both equal.
    ``test_lag_covariance_is_mostly_common`` in ``tests/immersion/test_plunge_fit.py`` compares that
    mean with the posterior; ``tests/immersion/test_design_predictions.py`` compares plans.
    """
    common_variance = covariance.mean()
    differential_variance = np.trace(differential_covariance(covariance)) / len(covariance)
    variances = np.array([common_variance, differential_variance])
    common, differential = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return common, differential
