"""The stretch of a test that the fits look at, and what drives the rim over it, averaged in windows.

The rim forgets in some seconds (its slowest mode decays at about 1 1/s), so nothing before the last minutes under load
matters, and one filter bank of that stretch serves every heat transfer coefficient, share and material.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration import Array
from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW, DiskSetup
from calibration.errors import InputError
from tcdyn.chain import Chain, equalised
from tcdyn.conduction.modal import RimGains, rim_gains
from tcdyn.conduction.rim import Mesh, Point, Profile, Rim, Switch, lag_bank, node_rates
from tcdyn.partition.prepare import EhlTest
from tcdyn.traces import DiskTraces

STEADY_S = 150.0  # section 4.3
FORGET_S = 20.0
STEADY_BLOCK_S = 1.0
FINE_S = 3.0  # sample by sample this long after parting, then in blocks of
COARSE_BLOCK_S = 0.1
GRADIENT_STEP_M = 0.25e-3
LEAST_SEEN = 1e-4  # share of a block's samples: what was bridged weighs nothing, and divides nothing by zero
OUTER = [CHANNELS.index(c) for c in OUTER_ROW]
INNER = [CHANNELS.index(c) for c in INNER_ROW]
FIT_MESH = Mesh(33, 53)
LEVEL = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Perturbation:
    """Departures from the stated disk: relative ones of properties, ``depth_m`` (3,) of the outer row a, c, e."""

    conductivity: float = 0.0
    heat_capacity: float = 0.0
    washer: float = 0.0
    half_width: float = 0.0
    depth_m: tuple[float, float, float] = LEVEL

    def of_rim(self, rim: Rim) -> Rim:
        """The stated ``rim`` with these departures of its properties."""
        return replace(
            rim,
            conductivity_W_mK=rim.conductivity_W_mK * (1 + self.conductivity),
            specific_heat_J_kgK=rim.specific_heat_J_kgK * (1 + self.heat_capacity),
            washer_W_m2K=rim.washer_W_m2K * (1 + self.washer),
        )


NOMINAL = Perturbation()


@dataclass(frozen=True)
class RimResponse:
    """What drives the rim of one disk, and the filter banks of it, as R means over windows of a test.

    ``inputs`` (R, 5) and ``banks`` (5, R, K) in the order power, d, b, f, ambient of the rim gains (power in W for a
    share of one), the lags of the banks at ``rates_1_s`` (K,).
    """

    setup: DiskSetup
    half_width_m: float
    rates_1_s: Array
    inputs: Array
    banks: Array
    profile: Profile = "modal"

    def gains(self, h_W_m2K: float, p: Perturbation = NOMINAL, extra: tuple[Point, ...] = ()) -> RimGains:
        """Gains of a disk that departs from its statement by ``p``, at the outer row and any ``extra`` points."""
        s = self.setup
        row = tuple((s.junctions[c].depth_m + shift, s.junctions[c].z_m) for c, shift in zip(OUTER_ROW, p.depth_m))
        width = self.half_width_m * (1 + p.half_width)
        rim = p.of_rim(Rim.from_setup(s))
        return cached_gains(rim, h_W_m2K, (*row, *extra), width, tuple(self.rates_1_s), self.profile, FIT_MESH)

    def heat(self, g: RimGains) -> Array:
        """Answer of the points of ``g`` to a share of one, (R, P) [K]."""
        return np.asarray(self.inputs[:, :1] @ g.direct[:1] + self.banks[0] @ g.gains[0].T)

    def answer(self, h_W_m2K: float, p: Perturbation = NOMINAL, extra: tuple[Point, ...] = ()) -> tuple[Array, Array]:
        """Model without frictional heat, and response to a share of one; (R, P) each, P with the ``extra`` points."""
        g = self.gains(h_W_m2K, p, extra)
        rest = self.inputs[:, 1:] @ g.direct[1:] + sum(b @ part.T for b, part in zip(self.banks[1:], g.gains[1:]))
        return np.asarray(rest), self.heat(g)

    def rise(self, h_W_m2K: float, p: Perturbation = NOMINAL) -> tuple[Array, Array]:
        """Rise from d, b and f to points ``GRADIENT_STEP_M`` above them, as ``answer`` gives it; (R, 3) each [K]."""
        depth = self.setup.junctions["b"].depth_m - GRADIENT_STEP_M
        above = tuple((depth, self.setup.junctions[c].z_m) for c in INNER_ROW)
        rest, power = self.answer(h_W_m2K, p, above)
        return rest[:, 3:] - self.inputs[:, 1:4], power[:, 3:]


@lru_cache(maxsize=2048)
def cached_gains(
    rim: Rim,
    h_W_m2K: float,
    points: tuple[Point, ...],
    half_width_m: float,
    rates: tuple[float, ...],
    profile: Profile,
    mesh: Mesh,
) -> RimGains:
    """``rim_gains``, worked out once: fits come back to the same h, and faults share all but one junction."""
    return rim_gains(rim, h_W_m2K, points, half_width_m, np.array(rates), profile=profile, mesh=mesh)


@dataclass(frozen=True)
class BlockMeans:
    """Rows of the stretch grouped into blocks: ``starts`` and ``counts`` of samples, ``time_s`` of their middle."""

    starts: NDArray[np.int64]
    counts: NDArray[np.int64]
    time_s: Array
    last: int

    def mean(self, x: Array) -> Array:
        """Average of ``x`` (N, ...) over each block."""
        sums = np.add.reduceat(x[: self.last], self.starts, axis=0)
        return np.asarray(sums / self.counts.reshape(-1, *(1,) * (x.ndim - 1)))


@dataclass(frozen=True)
class DiskWindow:
    """One disk over the stretch: measured outer row, and what drives the rim, block means of both.

    ``readings`` (N, 6) [degC] as they were seen at ``time_s`` (N,); ``y`` (R, 3) [degC]; ``weight`` (R, 3) one over
    the noise of a block mean of what was seen [1/K].
    """

    disk: str
    readings: Array
    time_s: Array
    blocks: BlockMeans
    y: Array
    weight: Array
    rim: RimResponse

    def with_power(self, power_W: Array, bank: Array) -> DiskWindow:
        """The same window with another frictional power, e.g. seen through another chain."""
        rim = replace(
            self.rim,
            inputs=np.column_stack([self.blocks.mean(power_W), self.rim.inputs[:, 1:]]),
            banks=np.concatenate([self.blocks.mean(bank)[None], self.rim.banks[1:]]),
        )
        return replace(self, rim=rim)

    def between(self, start_s: float, stop_s: float) -> NDArray[np.bool_]:
        """Which blocks lie in [start_s, stop_s)."""
        return (self.blocks.time_s >= start_s) & (self.blocks.time_s < stop_s)


def deeper_than_b_m(setup: DiskSetup) -> Array:
    """How much deeper d, b and f are stated to lie than b, (3,) [m].

    >>> from calibration.rig import load_rig
    >>> deeper_than_b_m(load_rig().disk_setup("fast"))
    array([0., 0., 0.])
    """
    depth = {c: setup.junctions[c].depth_m for c in INNER_ROW}
    return np.array([depth[c] - depth["b"] for c in INNER_ROW])


def stretch_of(test: EhlTest, after_s: float) -> slice:
    """Rows from well before the steady window to ``after_s`` after parting; refuses a log that ends before."""
    off, end = test.events.unload_s, test.time_s[-1]
    if end < off + after_s:
        left = max(np.floor(10 * (end - off)) / 10, 0.0)
        raise InputError(
            f"the log ends {end - off:.2f} s after the disks part",
            expected=f"at least {after_s:g} s of cooling",
            remedy=f"ask for a shorter window, window_s={left:g}, or log more of the cooling",
            parameters=(f"window_s={left:g}",),
        )
    return test.rows(max(off - STEADY_S - FORGET_S, test.events.load_on_s + 5.0), off + after_s)


def steady_start_s(test: EhlTest) -> float:
    """Start of the steady window: the last 150 s under load, less when the load was on for a shorter time."""
    loaded = test.events.unload_s - test.events.load_on_s
    return test.events.unload_s - min(STEADY_S, max(0.3 * loaded, 10.0))


def make_blocks(test: EhlTest, rows: slice, steady_s: float) -> BlockMeans:
    """One second under steady load, single samples about the parting, tenths of a second later."""
    t = test.time_s[rows]
    off = test.events.unload_s
    n = len(t)
    first = int(np.searchsorted(t, steady_s))
    fine = int(np.searchsorted(t, off - 0.5))
    coarse = int(np.searchsorted(t, off + FINE_S))
    big = max(int(round(STEADY_BLOCK_S / test.dt_s)), 1)
    small = max(int(round(COARSE_BLOCK_S / test.dt_s)), 1)
    starts = np.concatenate([np.arange(first, fine, big), np.arange(fine, coarse), np.arange(coarse, n, small)])
    counts = np.diff(np.append(starts, n))
    time = np.add.reduceat(t, starts) / counts
    return BlockMeans(starts, counts, time, n)


def disk_window(
    test: EhlTest,
    disk: DiskTraces,
    temperatures: Array,
    rows: slice,
    noise_K: Array,
    profile: Profile = "modal",
    chain: Chain | None = None,
) -> DiskWindow:
    """Build the window from the six ``temperatures`` (N, 6) of one disk over ``rows``, power seen through ``chain``."""
    blocks = make_blocks(test, rows, steady_start_s(test))
    seen = 1.0 - blocks.mean(disk.missing[rows][:, OUTER].astype(float))
    rates = node_rates(test.dt_s)
    feeds = [*(temperatures[:, INNER] + disk.inner_K[rows]).T, test.ambient_degC[rows]]
    power, bank = power_bank(test, rows, rates, chain)
    banks = [bank, *(lag_bank(u, test.dt_s, rates) for u in feeds)]
    return DiskWindow(
        disk=disk.name,
        readings=disk.readings_degC[rows] if chain is None else temperatures,
        time_s=test.time_s[rows],
        blocks=blocks,
        y=blocks.mean(temperatures[:, OUTER]),
        weight=np.sqrt(blocks.counts[:, None] * np.maximum(seen, LEAST_SEEN)) / noise_K[None, OUTER],
        rim=RimResponse(
            disk.setup,
            test.half_width_m,
            rates,
            inputs=np.column_stack([blocks.mean(u) for u in (power, *feeds)]),
            banks=np.stack([blocks.mean(b) for b in banks]),
            profile=profile,
        ),
    )


def lagged_window(test: EhlTest, disk: DiskTraces, rows: slice, profile: Profile = "modal") -> DiskWindow:
    """Window of the readings as they lag, all channels brought to the mean chain, power seen through it."""
    readings = equalised(disk.readings_degC[rows], test.dt_s, disk.chains, disk.mean_chain)
    return disk_window(test, disk, readings, rows, disk.noise_K, profile, disk.mean_chain)


def held_power(test: EhlTest, rows: slice) -> tuple[Array, tuple[Switch, ...]]:
    """Frictional power over ``rows`` [W], held between samples, and the instant inside a sample at which it ends."""
    power = test.power_W[rows]
    t = test.time_s[rows]
    off = test.events.unload_s
    k = int(np.searchsorted(t, off)) - 1
    if 0 <= k < len(t) - 1 and power[k] > 0 and power[k + 1] == 0:
        return power, (Switch(k, float((off - t[k]) / test.dt_s), float(power[k]), 0.0),)
    return power, ()


def power_bank(test: EhlTest, rows: slice, rates_1_s: Array, chain: Chain | None) -> tuple[Array, Array]:
    """Frictional power (N,) [W] as the ``chain`` would show it, or as it is, and its bank (N, K).

    Through the chain it drives the model when the readings are left lagged: the sample in which the power ends
    carries its average, which keeps the energy and places the step to second order in the sampling interval.
    """
    power, switches = held_power(test, rows)
    if chain is None:
        return power, lag_bank(power, test.dt_s, rates_1_s, hold="zoh", switches=switches)
    held = power.copy()
    for s in switches:
        held[s.index] = s.before * s.fraction + s.after * (1 - s.fraction)
    seen = chain.response(held, test.dt_s, hold="zoh")
    return seen, lag_bank(seen, test.dt_s, rates_1_s)
