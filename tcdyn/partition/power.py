"""What heats and cools a disk while its thermocouples lag: frictional power and changed film as a chain shows them."""

from __future__ import annotations

from typing import Any

import numpy as np

from calibration import Array
from tcdyn.chain import Chain
from tcdyn.conduction.rim import Switch
from tcdyn.partition.events import EhlTest
from tcdyn.traces import DiskTraces


def film_seen(test: EhlTest, disk: DiskTraces, rows: slice, chain: Chain | None) -> list[Array]:
    """What the changed film, if any, comes to and its change by its exponent, (N,) [K] each, seen through ``chain``."""
    film = test.film[disk.name][rows].T if disk.name in test.film else ()
    return [x if chain is None else chain.response(x, test.dt_s) for x in film]


def power_seen(test: EhlTest, rows: slice, chain: Chain | None) -> tuple[Array, dict[str, Any]]:
    """Frictional power (N,) [W] as the ``chain`` would show it, or as it is, and how ``lag_bank`` is to hold it.

    It is held between samples and ends at an instant inside one. Through the chain, for readings left lagged, the
    sample in which it ends carries its average, which keeps the energy and places the step to second order in dt.
    """
    if chain is not None:
        return chain.response(held_power(test, rows), test.dt_s, hold="zoh"), {}
    power, (k, part) = test.power_W[rows], _ending(test, rows)
    return power, {"hold": "zoh", "switches": (Switch(k, part, float(power[k]), 0.0),) if part < 1 else ()}


def held_power(test: EhlTest, rows: slice) -> Array:
    """Frictional power (N,) [W], in the sample in which it ends its average there."""
    held, (k, part) = test.power_W[rows].copy(), _ending(test, rows)
    held[k] *= part
    return held


def _ending(test: EhlTest, rows: slice) -> tuple[int, float]:
    """The sample in which the frictional power ends, and for which part of it there is some; all where none ends."""
    power, t, off = test.power_W[rows], test.time_s[rows], test.events.unload_s
    k = int(np.searchsorted(t, off)) - 1
    ends = 0 <= k < len(t) - 1 and power[k] > 0 and power[k + 1] == 0
    return max(k, 0), float((off - t[k]) / test.dt_s) if ends else 1.0
