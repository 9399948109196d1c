"""Readings of channels that are smoothed together.

Used by :mod:`tcdyn.sensors.compensation`, :mod:`tcdyn.sensors.channels` and
:mod:`tcdyn.workflows.rig_channels`, which make them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.chain.law import LagLaw
from tcdyn.core import Array, Flags
from tcdyn.series.units import Unit


@dataclass(frozen=True)
class ChannelReadings:
    """Readings of M channels that are smoothed together, at N even times.

    Attributes
    ----------
    columns, units
        Columns of the source, and their units.
    base
        Readings (N, M) after the static lines, NaN where missing: temperatures in degC, other
        quantities in their unit, as all fields below.
    start_s, dt_s
        Time of the first of them, and interval [s].
    sample_of_row
        Index of the sample of each row of the segment (R,).
    chains, lag_covariance_s2, split_u_s
        Chains; covariance of their lags (M, M) [s2]; standard uncertainty (M,) [s] of how much of
        each lag is its largest lag.
    static_u_K
        Standard uncertainty (N, M) [K] of the static lines with that of their reference.
    shared_u_K
        The part (M,) [K] that all channels have in common.
    gain_u_rel
        Relative standard uncertainty (M,) of the gains of the static lines.
    noise_K
        Noise (M,) [K] where it is known; None: the smoother estimates it.
    disk
        Disk of the channels, in messages; empty for a table.
    is_separable
        Whether the channels are smoothed one by one where they cannot be smoothed together.
    is_left_out
        Whether the value of each row (R, M) was left out as impossible or as a code; None: none.
    late_s
        How much later than its sample each reading was taken (N,) [s]; None: not at all.
    others
        Other columns of the source (N,) as numbers, NaN where missing: those that switch may
        interfere with the readings.
    laws
        How the lag of each channel (M,) follows a flow, None where it does not; empty: of none.
    flow, flow_u
        That flow (N,), and its standard uncertainty as one error of all samples; None: no lag
        follows.
    """

    columns: tuple[str, ...]
    units: tuple[Unit, ...]
    base: Array
    start_s: float
    dt_s: float
    sample_of_row: NDArray[np.intp]
    chains: tuple[Chain, ...]
    lag_covariance_s2: Array
    split_u_s: Array
    static_u_K: Array
    shared_u_K: Array
    gain_u_rel: Array
    noise_K: Array | None = None
    disk: str = ""
    is_separable: bool = False
    is_left_out: Flags | None = None
    late_s: Array | None = None
    others: Mapping[str, Array] = field(default_factory=dict)
    laws: tuple[LagLaw | None, ...] = ()
    flow: Array | None = None
    flow_u: Array | None = None

    @property
    def names(self) -> list[str]:
        """Names of the channels in messages."""
        if not self.disk:
            return list(self.columns)
        return [column.removesuffix("_degC") for column in self.columns]

    def single(self, index: int) -> ChannelReadings:
        """The readings of one channel."""
        one = slice(index, index + 1)
        return replace(
            self,
            columns=self.columns[one],
            units=self.units[one],
            base=self.base[:, one],
            chains=self.chains[one],
            lag_covariance_s2=self.lag_covariance_s2[one, one],
            split_u_s=self.split_u_s[one],
            static_u_K=self.static_u_K[:, one],
            shared_u_K=self.shared_u_K[one],
            gain_u_rel=self.gain_u_rel[one],
            noise_K=None if self.noise_K is None else self.noise_K[one],
            is_left_out=None if self.is_left_out is None else self.is_left_out[:, one],
            laws=self.laws[one],
        )

    def from_sample(self, first: int) -> ChannelReadings:
        """The readings from a sample on; rows before it have negative indices of samples."""
        return replace(
            self,
            base=self.base[first:],
            start_s=self.start_s + first * self.dt_s,
            sample_of_row=self.sample_of_row - first,
            static_u_K=self.static_u_K[first:],
            late_s=None if self.late_s is None else self.late_s[first:],
            others={name: values[first:] for name, values in self.others.items()},
            flow=None if self.flow is None else self.flow[first:],
            flow_u=None if self.flow_u is None else self.flow_u[first:],
        )
