"""The stretch of a test that the fits look at, and the rim model's answer to it, averaged in blocks.

The rim forgets in some seconds (its slowest mode decays at about 1 1/s), so nothing before the last minutes under load
matters, and one filter bank of that stretch serves every heat transfer coefficient, share and material.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW, DiskSetup
from calibration.errors import InputError
from tcdyn.chain import Chain
from tcdyn.conduction.bank import Switch, lag_bank, node_rates
from tcdyn.conduction.modal import RimGains, rim_gains
from tcdyn.conduction.rim import Mesh, Profile, Rim
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


@dataclass(frozen=True)
class Perturbation:
    """Departures from the stated disk: relative ones of properties, ``depth_m`` (3,) of the outer row a, c, e."""

    conductivity: float = 0.0
    heat_capacity: float = 0.0
    washer: float = 0.0
    half_width: float = 0.0
    depth_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


NOMINAL = Perturbation()


@dataclass(frozen=True)
class Blocks:
    """Rows of the stretch grouped into blocks: ``starts`` and ``counts`` of samples, ``time_s`` of their middle."""

    starts: NDArray[np.int64]
    counts: NDArray[np.int64]
    time_s: NDArray[np.float64]
    last: int

    def mean(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Average of ``x`` (N, ...) over each block."""
        sums = np.add.reduceat(x[: self.last], self.starts, axis=0)
        return np.asarray(sums / self.counts.reshape(-1, *(1,) * (x.ndim - 1)))


@dataclass(frozen=True)
class DiskWindow:
    """One disk over the stretch: measured outer row and the filter banks of all inputs, block means of both.

    ``y`` (R, 3) [degC]; ``weight`` (R, 3) one over the noise of a block mean of what was
    seen [1/K]; ``inputs`` (R, 5) and ``banks``
    (5, R, K) in the order power, d, b, f, ambient of the rim gains (power in W for a share of one).
    """

    disk: str
    setup: DiskSetup
    half_width_m: float
    time_s: NDArray[np.float64]
    blocks: Blocks
    y: NDArray[np.float64]
    weight: NDArray[np.float64]
    rates_1_s: NDArray[np.float64]
    inputs: NDArray[np.float64]
    banks: NDArray[np.float64]
    profile: Profile

    def gains(self, h_W_m2K: float, p: Perturbation = NOMINAL) -> RimGains:
        """Gains of the rim to the outer row."""
        return perturbed_gains(self.setup, h_W_m2K, self.half_width_m, self.rates_1_s, p, self.profile)

    def answer(self, g: RimGains) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Model without frictional heat, and response to a share of one; (R, 3) each."""
        n = g.direct.shape[1]
        rest = self.inputs[:, 1:] @ g.direct[1:] + np.einsum("irk,ipk->rp", self.banks[1:], g.gains[1:], optimize=True)
        power = self.inputs[:, :1] @ g.direct[:1] + self.banks[0] @ g.gains[0].T
        return rest.reshape(-1, n), power.reshape(-1, n)

    def with_power(self, power_W: NDArray[np.float64], bank: NDArray[np.float64]) -> DiskWindow:
        """The same window with another frictional power, e.g. seen through another chain."""
        return replace(
            self,
            inputs=np.column_stack([self.blocks.mean(power_W), self.inputs[:, 1:]]),
            banks=np.concatenate([self.blocks.mean(bank)[None], self.banks[1:]]),
        )

    def between(self, start_s: float, stop_s: float) -> NDArray[np.bool_]:
        """Which blocks lie in [start_s, stop_s)."""
        return (self.blocks.time_s >= start_s) & (self.blocks.time_s < stop_s)


def perturbed_gains(
    setup: DiskSetup,
    h_W_m2K: float,
    half_width_m: float,
    rates: NDArray[np.float64],
    p: Perturbation,
    profile: Profile,
    extra: tuple[tuple[float, float], ...] = (),
) -> RimGains:
    """Rim gains of a disk that departs from its statement by ``p``, at the outer row and any ``extra`` points."""
    rim = Rim.from_setup(setup)
    rim = replace(
        rim,
        conductivity_W_mK=rim.conductivity_W_mK * (1 + p.conductivity),
        specific_heat_J_kgK=rim.specific_heat_J_kgK * (1 + p.heat_capacity),
        washer_W_m2K=rim.washer_W_m2K * (1 + p.washer),
    )
    points = [(setup.junctions[c].depth_m + shift, setup.junctions[c].z_m) for c, shift in zip(OUTER_ROW, p.depth_m)]
    width = half_width_m * (1 + p.half_width)
    return rim_gains(rim, h_W_m2K, [*points, *extra], width, rates, profile=profile, mesh=FIT_MESH)


def deeper_than_b_m(setup: DiskSetup) -> NDArray[np.float64]:
    """How much deeper d, b and f are stated to lie than b, (3,) [m].

    >>> from calibration.rig import load_rig
    >>> deeper_than_b_m(load_rig().disk_setup("fast"))
    array([0., 0., 0.])
    """
    depth = {c: setup.junctions[c].depth_m for c in INNER_ROW}
    return np.array([depth[c] - depth["b"] for c in INNER_ROW])


def above_inner_row(setup: DiskSetup) -> tuple[tuple[float, float], ...]:
    """Depth and z [m] of the points ``GRADIENT_STEP_M`` above the rim's inner radius at d, b and f."""
    depth = setup.junctions["b"].depth_m - GRADIENT_STEP_M
    return tuple((depth, setup.junctions[c].z_m) for c in INNER_ROW)


def stretch_of(test: EhlTest, after_s: float) -> slice:
    """Rows from well before the steady window to ``after_s`` after parting; refuses a log that ends before."""
    off, end = test.events.unload_s, test.time_s[-1]
    if end < off + after_s:
        left = max(np.floor(10 * (end - off)) / 10, 0.0)
        raise InputError(
            f"the log ends {end - off:.2f} s after the disks part",
            expected=f"at least {after_s:g} s of cooling",
            remedy=f"ask for a shorter window, --window-s {left:g} or window_s={left:g}, or log more of the cooling",
        )
    return test.rows(max(off - STEADY_S - FORGET_S, test.events.load_on_s + 5.0), off + after_s)


def steady_start_s(test: EhlTest) -> float:
    """Start of the steady window: the last 150 s under load, less when the load was on for a shorter time."""
    loaded = test.events.unload_s - test.events.load_on_s
    return test.events.unload_s - min(STEADY_S, max(0.3 * loaded, 10.0))


def make_blocks(test: EhlTest, rows: slice, steady_s: float) -> Blocks:
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
    return Blocks(starts, counts, time, n)


def disk_window(
    test: EhlTest,
    disk: DiskTraces,
    temperatures: NDArray[np.float64],
    rows: slice,
    noise_K: NDArray[np.float64],
    profile: Profile = "modal",
) -> DiskWindow:
    """Build the window from the six ``temperatures`` (N, 6) of one disk over ``rows``, frictional power unlagged."""
    blocks = make_blocks(test, rows, steady_start_s(test))
    seen = 1.0 - blocks.mean(disk.missing[rows][:, OUTER].astype(float))
    rates = node_rates(test.dt_s)
    ambient = test.ambient_degC[rows]
    at_b = temperatures[:, INNER] + disk.inner_K[rows]
    feeds = [*at_b.T, ambient]
    power, switch = held_power(test, rows)
    banks = [lag_bank(power, test.dt_s, rates, hold="zoh", switches=switch)]
    banks += [lag_bank(u, test.dt_s, rates) for u in feeds]
    return DiskWindow(
        disk=disk.name,
        setup=disk.setup,
        half_width_m=test.half_width_m,
        time_s=test.time_s[rows],
        blocks=blocks,
        y=blocks.mean(temperatures[:, OUTER]),
        weight=np.sqrt(blocks.counts[:, None] * np.maximum(seen, LEAST_SEEN)) / noise_K[None, OUTER],
        rates_1_s=rates,
        inputs=np.column_stack([blocks.mean(u) for u in (power, *feeds)]),
        banks=np.stack([blocks.mean(b) for b in banks]),
        profile=profile,
    )


def held_power(test: EhlTest, rows: slice) -> tuple[NDArray[np.float64], tuple[Switch, ...]]:
    """Frictional power over ``rows`` [W], held between samples, and the instant inside a sample at which it ends."""
    power = test.power_W[rows]
    t = test.time_s[rows]
    off = test.events.unload_s
    k = int(np.searchsorted(t, off)) - 1
    if 0 <= k < len(t) - 1 and power[k] > 0 and power[k + 1] == 0:
        return power, (Switch(k, float((off - t[k]) / test.dt_s), float(power[k]), 0.0),)
    return power, ()


def chained_power(test: EhlTest, rows: slice, chain: Chain) -> NDArray[np.float64]:
    """Frictional power as the chain would show it: what drives the model when the readings are left lagged.

    The sample in which the power ends carries its average, which keeps the energy and places the step to second
    order in the sampling interval.
    """
    power, switches = held_power(test, rows)
    held = power.copy()
    for s in switches:
        held[s.index] = s.before * s.fraction + s.after * (1 - s.fraction)
    return chain.response(held, test.dt_s, hold="zoh")
