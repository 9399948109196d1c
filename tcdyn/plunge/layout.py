"""Where each parameter of the plunge fit stands in its vector, with its prior mean, its prior sd and its name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tcdyn.plunge.prior import PlungePriors

Array = NDArray[np.float64]
Structure = Literal["P1", "P2", "P1D", "P2D", "P2Z", "P3"]
STRUCTURES: tuple[Structure, ...] = ("P1", "P2", "P1D", "P2D", "P2Z")  # P3 is for comparison: a record holds two lags
COMPARED: tuple[Structure, ...] = (*STRUCTURES, "P3")
RUN_NAMES = ("ln_h", "h_exponent", "ln_burst", "ln_burst_time", "ln_burst_shape", "entry", "initial", "bath")


@dataclass(frozen=True)
class Layout:
    """Slices of the parameter vector: 8 per run, then per channel lag, split, depth, offset, gain, then two common.

    A lag's prior sd is infinite (flat). The split is a logit; its common part stands beside the conductivity.
    """

    runs: int
    channels: tuple[str, ...]
    structure: Structure

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(RUN_NAMES) * self.runs + 5 * len(self.channels) + 2

    def run(self, r: int) -> slice:
        """The parameters of run ``r``, in the order of RUN_NAMES."""
        return slice(len(RUN_NAMES) * r, len(RUN_NAMES) * (r + 1))

    def _channel(self, kind: int) -> slice:
        c = len(self.channels)
        start = len(RUN_NAMES) * self.runs + kind * c
        return slice(start, start + c)

    @property
    def lag(self) -> slice:
        """Sum of the chain's own lags and dead time, per channel [s]."""
        return self._channel(0)

    @property
    def split(self) -> slice:
        """Channel's deviation of the split's logit."""
        return self._channel(1)

    @property
    def depth(self) -> slice:
        """Deviation of the junction's depth [m]."""
        return self._channel(2)

    @property
    def offset(self) -> slice:
        """Static offset left over [K]."""
        return self._channel(3)

    @property
    def gain(self) -> slice:
        """Static gain error left over [1]."""
        return self._channel(4)

    @property
    def ln_k(self) -> int:
        """Index of ln of the conductivity over its nominal value."""
        return self.size - 2

    @property
    def common_split(self) -> int:
        """Index of the split's common logit."""
        return self.size - 1

    def names(self) -> list[str]:
        """A name for each parameter."""
        out = [f"{name}_{r + 1}" for r in range(self.runs) for name in RUN_NAMES]
        for kind in ("lag", "split", "depth", "offset", "gain"):
            out += [f"{kind}_{c}" for c in self.channels]
        return [*out, "ln_conductivity", "common_split"]

    def prior(self, p: PlungePriors, entry_u_s: list[float], initial_degC: list[float]) -> tuple[Array, Array]:
        """Prior mean and standard deviation of every parameter (inf where flat)."""
        mean, sd = np.zeros(self.size), np.full(self.size, np.inf)
        for r in range(self.runs):
            mean[self.run(r)] = [
                0,
                0,
                np.log(p.burst_median),
                np.log(p.burst_time_median_s),
                0,
                0,
                initial_degC[r],
                0,
            ]
            sd[self.run(r)] = [
                p.h_scale_log,
                p.h_exponent,
                p.burst_log,
                p.burst_time_log,
                p.burst_shape_log,
                p.entry_scale * entry_u_s[r],
                p.initial_K,
                p.bath_K,
            ]
        used = self.structure != "P1"
        sd[self.split] = p.shape_logit_channel if used else 1e-6
        sd[self.depth] = p.depth_m
        sd[self.offset] = p.static_offset_K
        sd[self.gain] = p.static_gain
        sd[self.ln_k] = p.conductivity_log
        mean[self.common_split] = p.shape_logit
        sd[self.common_split] = p.shape_logit_common if used else 1e-6
        return mean, sd


def stages(structure: Structure, lag_s: float, logit: float) -> tuple[tuple[float, ...], float, float]:
    """Lags (tau1, tau2 ..), dead time and zero [s] of a chain whose own lag is ``lag_s``, with s = sigmoid(``logit``).

    P1: one lag. P2: tau1 + tau2 = lag, 4 tau1 tau2 / lag^2 = s. P1D: dead time = lag s/2. P2D: dead time = 0.4 lag s,
    the rest in lags of four to one. P2Z: zero = lag s, lags (1 + 0.8 s) and 0.2 s times the lag: a part of the reading
    answers quickly, the rest has a slow tail. P3: two equal lags of lag s/3, the rest in the first; equal at s = 1.
    """
    if structure == "P1":
        return (lag_s,), 0.0, 0.0
    share = float(1 / (1 + np.exp(-logit)))
    if structure == "P1D":
        return (lag_s * (1 - share / 2),), lag_s * share / 2, 0.0
    if structure == "P2D":
        rest = lag_s * (1 - 0.4 * share)
        return (0.8 * rest, 0.2 * rest), 0.4 * share * lag_s, 0.0
    if structure == "P2Z":
        return (lag_s * (1 + 0.8 * share), 0.2 * share * lag_s), 0.0, share * lag_s
    if structure == "P3":
        return (lag_s * (1 - 2 * share / 3), lag_s * share / 3, lag_s * share / 3), 0.0, 0.0
    root = float(np.sqrt(1 - share))
    return (lag_s * (1 + root) / 2, lag_s * (1 - root) / 2), 0.0, 0.0
