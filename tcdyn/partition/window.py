"""Means over windows of a test, and what the rim of a disk answers in them.

The rim forgets in some seconds (its slowest mode decays at about 1 1/s), so nothing before the last minutes under load
matters, and one filter bank of that stretch serves every heat transfer coefficient, share and material.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from tcdyn.chain import Chain, equalised
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.flux import track
from tcdyn.heat.modal import RimGains
from tcdyn.heat.nonuniform import cached_gains
from tcdyn.heat.rim import Mesh, Point, Profile, Rim, Switch, bank_means, lag_bank, node_rates
from tcdyn.partition.events import EhlTest
from tcdyn.rig.disk import DiskSetup
from tcdyn.smoothing.traces import DiskTraces

STEADY_S = 150.0  # section 4.3
FORGET_S = 20.0
STEADY_BLOCK_S = 1.0
SINGLE_SAMPLES_S = 3.0  # sample by sample this long after parting, then in blocks of
COARSE_BLOCK_S = 0.1
GRADIENT_STEP_M = 0.25e-3
MIN_OBSERVED_FRACTION = (
    1e-4  # share of a block's samples: what was bridged weighs nothing, and divides nothing by zero
)
FIT_MESH, BORE_MESH = Mesh(33, 53), Mesh(49, 41)
POWER = slice(0, 1)  # of the rim's inputs


@dataclass(frozen=True)
class Perturbation:
    """Departures from the stated disk: relative ones of properties, ``deeper_m`` of the disk's ``rows``, none if empty.

    ``shift_m``: of the flux's centre along z [m]; ``film``: of h along the track, see ``film_along``. The rim begins at
    its stated edge whatever the inner row's depths are.
    """

    conductivity: float = 0.0
    heat_capacity: float = 0.0
    washer: float = 0.0
    half_width: float = 0.0
    deeper_m: tuple[float, ...] = ()
    shift_m: float = 0.0
    film: tuple[float, float] = (0.0, 0.0)


NOMINAL = Perturbation()


@dataclass(frozen=True)
class RimMeans:
    """What drives the rim of one disk, and the filter banks of it, as R means over windows of a test.

    ``inputs`` (R, I) and ``banks`` (I, R, K) in the order power, inner row, ambient of the rim gains (power in W for a
    share of one), the lags of the banks at ``rates_1_s`` (K,). Where the speeds change there are two more, air at the
    running surface alone: what the changed film comes to, and by how much a standard uncertainty of its exponent
    changes that (see :func:`tcdyn.partition.cooling.with_slowing_air_offset`).
    """

    setup: DiskSetup
    half_width_m: float
    rates_1_s: Array
    inputs: Array
    banks: Array
    profile: Profile = "modal"

    @property
    def ambient(self) -> int:
        """Which of the inputs is the air."""
        return len(self.setup.inner) + 1

    @property
    def inner(self) -> slice:
        """Which of the inputs are the inner row."""
        return slice(1, self.ambient)

    @property
    def rest(self) -> slice:
        """All inputs but the power, and the film where speeds change."""
        return slice(1, self.ambient + 2)

    @property
    def films(self) -> tuple[slice, slice]:
        """Where speeds change: what the film comes to, and what its exponent changes in that."""
        return slice(self.ambient + 1, self.ambient + 2), slice(self.ambient + 2, self.ambient + 3)

    @cached_property
    def _kept(self) -> dict[tuple[float, Perturbation, tuple[Point, ...], bool], RimGains]:
        return {}

    def gains(
        self,
        h_W_m2K: float,
        p: Perturbation = NOMINAL,
        extra: tuple[Point, ...] = (),
        bore: bool = False,
    ) -> RimGains:
        """Gains of a disk that departs from its statement by ``p``, at the outer row and any ``extra`` points.

        With ``bore`` those at the inner row, of a rim that reaches to the bore.
        """
        key = h_W_m2K, p, extra, bore
        if key not in self._kept:
            self._kept[key] = self._gains(*key)
        return self._kept[key]

    def _gains(
        self, h_W_m2K: float, p: Perturbation, extra: tuple[Point, ...], bore: bool
    ) -> RimGains:
        s = self.setup
        moved = zip_longest(s.rows, p.deeper_m, fillvalue=0.0)
        places = [
            (s.junctions[str(c)].depth_m + float(dx), s.junctions[str(c)].z_m) for c, dx in moved
        ]
        rim = Rim.from_setup(s, inner_radius_m=s.bore_radius_m) if bore else Rim.from_setup(s)
        rim = replace(
            rim,
            conductivity_W_mK=rim.conductivity_W_mK * (1 + p.conductivity),
            specific_heat_J_kgK=rim.specific_heat_J_kgK * (1 + p.heat_capacity),
            washer_W_m2K=rim.washer_W_m2K * (1 + p.washer),
        )
        split = len(s.outer)
        points = (*(places[split:] if bore else places[:split]), *extra)
        width = self.half_width_m * (1 + p.half_width)
        flux = track(s.flux, width, p.shift_m, 1 + p.half_width)
        mesh = BORE_MESH if bore else FIT_MESH
        rates = tuple(self.rates_1_s)
        film = len(self.banks) > self.ambient + 1
        return cached_gains(
            rim, h_W_m2K, points, width, rates, self.profile, flux, mesh, film, p.film
        )

    def through(
        self,
        which: slice,
        h_W_m2K: ArrayLike,
        p: Perturbation = NOMINAL,
        extra: tuple[Point, ...] = (),
        bore: bool = False,
    ) -> Array:
        """Answer to the inputs of ``which``, (..., R, P) for h of shape (...)."""
        every = [self.gains(float(h), p, extra, bore) for h in np.ravel(h_W_m2K)]
        direct, gains = (
            np.concatenate([getattr(g, x)[which] for g in every], axis=1)
            for x in ("direct", "gains")
        )
        out = self.inputs[:, which] @ direct
        for bank, part in zip(self.banks[which], gains):
            out += bank @ part.T
        return np.moveaxis(out.reshape(len(out), len(every), -1), 1, 0).reshape(
            *np.shape(h_W_m2K), len(out), -1
        )

    def driven_by(self, power_W: Array, bank: Array) -> RimMeans:
        """The same rim, its gains kept, by another power (R,) with its ``bank`` (R, K)."""
        inputs = np.column_stack([power_W, self.inputs[:, self.rest]])
        other = replace(
            self, inputs=inputs, banks=np.concatenate([bank[None], self.banks[self.rest]])
        )
        other.__dict__["_kept"] = self._kept
        return other

    def answer(
        self, h_W_m2K: ArrayLike, p: Perturbation = NOMINAL, extra: tuple[Point, ...] = ()
    ) -> tuple[Array, Array]:
        """Model without frictional heat, and per share of one; (..., R, P) each, P with the ``extra`` points."""
        return self.through(self.rest, h_W_m2K, p, extra), self.through(POWER, h_W_m2K, p, extra)

    @property
    def inside(self) -> tuple[Point, ...]:
        """Points just inside the rim at the inner row."""
        depth = self.setup.edge_m - GRADIENT_STEP_M
        return tuple((depth, self.setup.junctions[c].z_m) for c in self.setup.inner)

    def gradient(self, h_W_m2K: ArrayLike, p: Perturbation = NOMINAL) -> tuple[Array, Array]:
        """Rise of temperature with radius at the inner row, as ``answer`` gives it; (..., R, k) each [K/m]."""
        rest, power = (
            x[..., len(self.setup.outer) :] for x in self.answer(h_W_m2K, p, self.inside)
        )
        return (rest - self.inputs[:, self.inner]) / GRADIENT_STEP_M, power / GRADIENT_STEP_M


@dataclass(frozen=True)
class DiskWindow:
    """One disk over a stretch: measured outer row, and what drives the rim, means over blocks of both.

    ``readings`` (N, C) [degC] as they were seen at ``time_s`` (N,); ``blocks`` (R, N) averages over blocks of
    ``counts`` (R,) samples about ``at_s`` (R,); ``y`` (R, P) [degC]; ``weight`` (R, P) one over the noise of a block
    mean of what was seen [1/K], zero for a channel that is left out.
    """

    disk: str
    readings: Array
    time_s: Array
    blocks: sparse.csr_array
    at_s: Array
    counts: NDArray[np.int64]
    y: Array
    weight: Array
    rim: RimMeans

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which of the outer row are looked at (P,)."""
        return np.asarray(self.weight.any(axis=0))


def between(time_s: Array, start_s: float, stop_s: float) -> slice:
    """The samples from ``start_s`` to before ``stop_s``.

    >>> between(np.arange(5.0), 1.5, 3.0)
    slice(2, 3, None)
    """
    first, last = (int(k) for k in np.searchsorted(time_s, [start_s, stop_s]))
    return slice(first, last)


def stretch_of(test: EhlTest, after_s: float) -> slice:
    """Rows from well before the steady window to ``after_s`` after parting; refuses a log that ends before."""
    off = test.events.unload_s
    end = test.time_s[-1]
    if end < off + after_s:
        left = max(np.floor(10 * (end - off)) / 10, 0.0)
        raise InputError(
            f"the log ends {end - off:.2f} s after the disks part",
            expected=f"at least {after_s:g} s of cooling",
            remedy="ask for a shorter window, {window_s}, or log more of the cooling",
            parameters={"window_s": f"{left:g}"},
        )
    return between(
        test.time_s, max(off - STEADY_S - FORGET_S, test.events.load_on_s + 5.0), off + after_s
    )


def steady_start_s(test: EhlTest) -> float:
    """Start of the steady window: the last 150 s under load, less when the load was on for a shorter time."""
    loaded = test.events.unload_s - test.events.load_on_s
    return test.events.unload_s - min(STEADY_S, max(0.3 * loaded, 10.0))


def disk_window(
    test: EhlTest,
    disk: DiskTraces,
    temperatures: Array,
    rows: slice,
    noise_K: Array,
    profile: Profile = "modal",
    chain: Chain | None = None,
) -> DiskWindow:
    """Build the window from the ``temperatures`` (N, C) of one disk over ``rows``, power seen through ``chain``.

    Blocks are one second long under steady load, single samples about the parting, tenths of a second later.
    """
    t = test.time_s[rows]
    dt = test.dt_s
    off = test.events.unload_s
    straight = disk.setup.steel.straight(temperatures)
    inner_row, outer_row = (disk.setup.places(row) for row in (disk.setup.inner, disk.setup.outer))
    first, fine, coarse = np.searchsorted(t, [steady_start_s(test), off - 0.5, off + SINGLE_SAMPLES_S])
    big, small = (max(int(round(length / dt)), 1) for length in (STEADY_BLOCK_S, COARSE_BLOCK_S))
    starts = np.concatenate(
        [np.arange(first, fine, big), np.arange(fine, coarse), np.arange(coarse, len(t), small)]
    )
    counts = np.diff(np.append(starts, len(t)))
    each = np.repeat(1.0 / counts, counts), np.arange(first, len(t))
    blocks = sparse.csr_array(
        (*each, np.append(starts, len(t)) - first), shape=(len(starts), len(t))
    )
    seen = np.maximum(1.0 - blocks @ disk.missing[rows][:, outer_row].astype(float), MIN_OBSERVED_FRACTION)
    lags_s = chain.taus_s if chain else ()  # whose longest, and twice that, a fit makes of the bank
    (power, held) = lagged_power(test, rows, chain)
    rates = node_rates(dt, longest_s=2 * max(lags_s, default=0.0))
    bank = (
        blocks @ lag_bank(power, dt, rates, **held)
        if held
        else bank_means(power, dt, rates, counts)
    )
    inner = straight[:, inner_row] + disk.inner_K[rows]
    feeds = [*inner.T, test.ambient_of(disk.name)[rows], *lagged_surface_air(test, disk, rows, chain)]
    inputs = blocks @ np.column_stack([power, *feeds])
    banks = np.stack([bank, *(bank_means(u, dt, rates, counts) for u in feeds)])
    return DiskWindow(
        disk=disk.name,
        readings=disk.readings_degC[rows] if chain is None else temperatures,
        time_s=t,
        blocks=blocks,
        at_s=blocks @ t,
        counts=counts,
        y=blocks @ straight[:, outer_row],
        weight=np.sqrt(counts[:, None] * seen) / noise_K[None, outer_row] * ~disk.out[outer_row],
        rim=RimMeans(
            disk.setup, test.half_width_m, rates, inputs=inputs, banks=banks, profile=profile
        ),
    )


def lagged_window(
    test: EhlTest, disk: DiskTraces, rows: slice, profile: Profile = "modal"
) -> DiskWindow:
    """Window of the readings as they lag, all channels brought to the mean chain, power seen through it."""
    readings = equalised(disk.readings_degC[rows], test.dt_s, disk.chains, disk.mean_chain)
    return disk_window(test, disk, readings, rows, disk.noise_K, profile, disk.mean_chain)


def interpolate_blocks(window: DiskWindow, of_blocks: Array) -> Array:
    """What was worked out on block means (R, M), straight between them, (N, M)."""
    return np.column_stack(
        [np.interp(window.time_s, window.at_s, column) for column in of_blocks.T]
    )


def lagged_surface_air(test: EhlTest, disk: DiskTraces, rows: slice, chain: Chain | None) -> list[Array]:
    """What the changed film, if any, comes to and its change by its exponent, (N,) [K] each, seen through ``chain``."""
    film = test.film[disk.name][rows].T if disk.name in test.film else ()
    return [x if chain is None else chain.response(x, test.dt_s) for x in film]


def lagged_power(test: EhlTest, rows: slice, chain: Chain | None) -> tuple[Array, dict[str, Any]]:
    """Frictional power (N,) [W] as the ``chain`` would show it, or as it is, and how ``lag_bank`` is to hold it.

    It is held between samples and ends at an instant inside one. Through the chain, for readings left lagged, the
    sample in which it ends carries its average, which keeps the energy and places the step to second order in dt.
    """
    power = test.power_W[rows]
    t = test.time_s[rows]
    off = test.events.unload_s
    k = int(np.searchsorted(t, off)) - 1
    ends = 0 <= k < len(t) - 1 and power[k] > 0 and power[k + 1] == 0
    part = float((off - t[k]) / test.dt_s) if ends else 1.0
    if chain is None:
        return power, {
            "hold": "zoh",
            "switches": (Switch(k, part, float(power[k]), 0.0),) if ends else (),
        }
    held = power.copy()
    held[max(k, 0)] *= part
    return chain.response(held, test.dt_s, hold="zoh"), {}
