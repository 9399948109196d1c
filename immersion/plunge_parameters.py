"""The chain of every channel of a disk from its plunges, with everything that the plunge leaves open.

Here: the parameters of the fit as a table: kind, plunge or channel, and what is assumed before the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.rig.rigfile import UncertaintyTable

H_KINDS = ("ln_h", "h_exponent", "h_viscosity")
BURST_KINDS = ("ln_burst", "ln_burst_time", "ln_burst_shape")
RUN_KINDS = (*H_KINDS, *BURST_KINDS, "entry", "initial", "bath")
CHANNEL_KINDS = ("lag", "split", "depth", "offset", "gain")
COMMON_KINDS = ("ln_conductivity", "common_split")
KNOWN = 1e-6  # prior sd of a parameter that a structure does without


@dataclass(frozen=True)
class PlungePriors:
    """Medians and standard deviations of the nuisance parameters; a lag has a flat prior above zero.

    Logarithmic widths are of ln(parameter). ``burst``: h is multiplied by 1 + A exp(-(t/tau)^p) after entry.
    ``h_...``: what h may differ by from its correlation, s (|dT|/dT_0)^m (nu_wall/nu_bath)^v. Against (5.4), in oil
    and water, heated and cooled, McAdams (1954), Mikheev (1956), Churchill and Chu at any Ra, Morgan (1975) and the VDI
    Heat Atlas for cylinders are of this form within 0.2 % rms (Morgan 0.9 %), with ln s of -1 to 0.3, m of 0 to 0.11
    and v of -0.20 to 0.
    """

    h_scale_log: float = 0.30  # per run, about 1
    h_exponent: float = 0.06  # per run: extra power of the temperature difference in h, about 0
    h_viscosity: float = (
        0.10  # per run: power of the viscosity at the wall over that of the bath in h, about 0
    )
    burst_median: float = 1.5
    burst_log: float = 0.7
    burst_time_median_s: float = 1.2
    burst_time_log: float = 0.5
    burst_shape_log: float = 0.3  # p, about 1
    entry_scale: float = 1.0  # times the entry event's own u
    initial_K: float = 5.0  # of the disk's temperature before entry, about the readings' mean
    bath_K: float = 0.5  # offset of the bath thermometer
    conductivity_log: float = 0.03
    depth_m: float = 1e-4
    static_offset_K: float = (
        0.05  # per channel, of a run without static lines; else their own covariance
    )
    static_gain: float = 5e-4  # per channel, likewise
    shape_logit: float = 0.0  # logit of 4 tau1 tau2 / lag^2: centre
    shape_logit_common: float = 1.5
    shape_logit_channel: float = 0.7

    @classmethod
    def for_rig(cls, table: UncertaintyTable) -> PlungePriors:
        """The defaults, with steel, depths, bath and h as uncertain as the rig file's [uncertainty] says.

        A plunge sees K and rho c only together: what the fit frees as the conductivity carries both.
        """
        steel = float(np.hypot(table.conductivity_rel, table.heat_capacity_rel))
        return cls(
            h_scale_log=max(table.bath_h_rel, KNOWN),
            h_exponent=max(table.bath_h_exponent, KNOWN),
            h_viscosity=max(table.bath_h_viscosity, KNOWN),
            bath_K=max(table.bath_K, KNOWN),
            conductivity_log=max(steel, KNOWN),
            depth_m=max(table.depth_mm * 1e-3, 1e-9),
        )

    def describe(self) -> list[tuple[str, str]]:
        """Each prior as (parameter, sentence), for tables."""
        return [
            ("h scale, per run", f"lognormal about 1, sd {100 * self.h_scale_log:.0f} %"),
            ("extra exponent of h, per run", f"normal about 0, sd {self.h_exponent:g}"),
            (
                "power of viscosity, wall over bath, in h, per run",
                f"normal about 0, sd {self.h_viscosity:g}",
            ),
            (
                "burst size A, per run",
                f"lognormal about {self.burst_median:g}, sd of ln {self.burst_log:g}",
            ),
            (
                "burst time, per run",
                f"lognormal about {self.burst_time_median_s:g} s, sd of ln {self.burst_time_log:g}",
            ),
            (
                "burst shape, per run",
                f"lognormal about 1 (exponential), sd of ln {self.burst_shape_log:g}",
            ),
            ("entry time, per run", f"normal about the event, sd {self.entry_scale:g} times its u"),
            ("initial temperature, per run", f"normal about the readings, sd {self.initial_K:g} K"),
            ("bath offset, per run", f"normal about 0, sd {self.bath_K:g} K"),
            (
                "conductivity over heat capacity",
                f"lognormal about the rig file's, sd {100 * self.conductivity_log:.1f} %",
            ),
            (
                "junction depth, per channel",
                f"normal about the rig file's, sd {1e3 * self.depth_m:.2f} mm",
            ),
            (
                "static line, per channel",
                f"as the oven told it; without it sd {self.static_offset_K:g} K and {self.static_gain:g} of slope",
            ),
            (
                "split of the lag over two stages",
                f"logit of 4 tau1 tau2 / (tau1 + tau2)^2: normal about {self.shape_logit:g}, sd "
                f"{self.shape_logit_common:g} in common and {self.shape_logit_channel:g} per channel",
            ),
            ("lag, per channel", "flat above zero"),
        ]


@dataclass(frozen=True)
class PlungeParameters:
    """The parameter vector: 9 kinds for each plunge, then five kinds of the channels, then two common ones.

    ``lag`` is the sum of the chain's own lags and dead time [s], flat beforehand; ``split`` the channel's deviation of
    the split's logit; ``depth`` that of the junction [m]; ``offset`` [K] and ``gain`` [1] are left over by the static
    line; ``ln_conductivity`` is ln of the conductivity over its nominal value; ``common_split`` the common logit.
    """

    runs: int
    channels: tuple[str, ...]
    structure: str

    @property
    def size(self) -> int:
        """Number of parameters."""
        return (
            len(RUN_KINDS) * self.runs + len(CHANNEL_KINDS) * len(self.channels) + len(COMMON_KINDS)
        )

    def run(self, r: int) -> slice:
        """The parameters of run ``r``, in the order of RUN_KINDS."""
        return slice(len(RUN_KINDS) * r, len(RUN_KINDS) * (r + 1))

    def at(self, kind: str) -> slice:
        """Where the parameters of a kind stand: one a run, one a channel, or one in all."""
        own = len(RUN_KINDS) * self.runs
        c = len(self.channels)
        if kind in RUN_KINDS:
            return slice(RUN_KINDS.index(kind), own, len(RUN_KINDS))
        if kind in CHANNEL_KINDS:
            start = own + c * CHANNEL_KINDS.index(kind)
            return slice(start, start + c)
        start = own + c * len(CHANNEL_KINDS) + COMMON_KINDS.index(kind)
        return slice(start, start + 1)

    def mask(self, *kinds: str) -> NDArray[np.bool_]:
        """Whether each parameter is of one of ``kinds``, shape (P,)."""
        out = np.zeros(self.size, dtype=bool)
        for kind in kinds:
            out[self.at(kind)] = True
        return out

    @property
    def common_lag(self) -> Array:
        """The weights (P,) that make the common lag of the parameters: the mean of all channels'."""
        return self.mask("lag") / len(self.channels)

    def table(self) -> list[tuple[str, str]]:
        """Kind and subject of each parameter: the number of its run from 1, its channel, or nothing."""
        return [
            *((kind, str(r + 1)) for r in range(self.runs) for kind in RUN_KINDS),
            *((kind, c) for kind in CHANNEL_KINDS for c in self.channels),
            *((kind, "") for kind in COMMON_KINDS),
        ]

    def names(self) -> list[str]:
        """A name for each parameter."""
        return [f"{kind}_{subject}" if subject else kind for kind, subject in self.table()]

    def split_prior(self, p: PlungePriors) -> dict[str, tuple[float, float]]:
        """Prior mean and standard deviation of the two kinds that divide the lag; known where it is one."""
        wide = (
            (p.shape_logit_channel, p.shape_logit_common)
            if self.structure != "P1"
            else (KNOWN, KNOWN)
        )
        return {"split": (0.0, wide[0]), "common_split": (p.shape_logit, wide[1])}

    def prior(
        self,
        p: PlungePriors,
        entry_u_s: Sequence[float],
        initial_degC: Sequence[float],
        h_u_rel: Sequence[float] = (0.0,),
    ) -> tuple[Array, Array]:
        """Prior mean and standard deviation of every parameter (inf where flat).

        ``entry_u_s``, ``initial_degC`` and ``h_u_rel`` (of the fluid's properties, in h) hold one value a run.
        """
        known: dict[str, tuple[float | Sequence[float], float | Array]] = {
            "ln_h": (0.0, np.hypot(p.h_scale_log, h_u_rel)),
            "h_exponent": (0.0, p.h_exponent),
            "h_viscosity": (0.0, p.h_viscosity),
            "ln_burst": (float(np.log(p.burst_median)), p.burst_log),
            "ln_burst_time": (float(np.log(p.burst_time_median_s)), p.burst_time_log),
            "ln_burst_shape": (0.0, p.burst_shape_log),
            "entry": (0.0, p.entry_scale * np.asarray(entry_u_s)),
            "initial": (initial_degC, p.initial_K),
            "bath": (0.0, p.bath_K),
            "lag": (0.0, np.inf),
            "depth": (0.0, p.depth_m),
            "offset": (0.0, p.static_offset_K),
            "gain": (0.0, p.static_gain),
            "ln_conductivity": (0.0, p.conductivity_log),
            **self.split_prior(p),
        }
        mean = np.empty(self.size)
        sd = np.empty(self.size)
        for kind, (centre, width) in known.items():
            mean[self.at(kind)] = centre
            sd[self.at(kind)] = width
        return mean, sd


def stages(structure: str, lag_s: Any, logit: Any) -> tuple[tuple[Any, ...], Any, Any]:
    """Lags (tau1, tau2 ..), dead time and zero [s] of a chain whose own lag is ``lag_s``, with s = sigmoid(``logit``).

    Numbers, or arrays of one shape.

    P1: one lag. P2: tau1 + tau2 = lag, 4 tau1 tau2 / lag^2 = s. P1D: dead time = lag s/2. P2D: dead time = 0.4 lag s,
    the rest in lags of four to one. P2Z: zero = lag s, lags (1 + 0.8 s) and 0.2 s times the lag: a part of the reading
    answers quickly, the rest has a slow tail. P3: two equal lags of lag s/3, the rest in the first; equal at s = 1.
    """
    if structure == "P1":
        return (lag_s,), 0.0, 0.0
    share = 1 / (1 + np.exp(-logit))
    if structure == "P1D":
        return (lag_s * (1 - share / 2),), lag_s * share / 2, 0.0
    if structure == "P2D":
        rest = lag_s * (1 - 0.4 * share)
        return (0.8 * rest, 0.2 * rest), 0.4 * share * lag_s, 0.0
    if structure == "P2Z":
        return (lag_s * (1 + 0.8 * share), 0.2 * share * lag_s), 0.0, share * lag_s
    if structure == "P3":
        return (lag_s * (1 - 2 * share / 3), lag_s * share / 3, lag_s * share / 3), 0.0, 0.0
    root = np.sqrt(1 - share)
    return (lag_s * (1 + root) / 2, lag_s * (1 - root) / 2), 0.0, 0.0


def apart(covariance: Array) -> Array:
    """Covariance (C, C) of the differences of lags from the mean of all channels.

    >>> apart(np.array([[0.02, 0.0199], [0.0199, 0.02]])).round(6).tolist()
    [[5e-05, -5e-05], [-5e-05, 5e-05]]
    """
    project = np.eye(len(covariance)) - 1 / len(covariance)
    return np.asarray(project @ covariance @ project)


def lag_u_s(covariance: Array) -> tuple[float, float]:
    """Standard uncertainty [s] of the common lag and, rms over channels, of the differences from it.

    ``covariance`` (C, C) [s2] is that of the lags; a difference of two covariances may give less than nothing, and is
    taken as none.
    """
    variances = covariance.mean(), np.trace(apart(covariance)) / len(covariance)
    common, differential = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return common, differential
