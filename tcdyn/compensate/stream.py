"""The proper inverse on a growing file: chunks of any length, state saved and restored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from calibration.errors import InputError
from tcdyn.compensate.inverse import InverseFilter
from tcdyn.compensate.result import MISSING, SPIKE

Array = NDArray[np.float64]
CONTEXT = 5  # samples before the present one whose median a spike is measured against


@dataclass(frozen=True)
class InverseState:
    """All that is needed to go on: filter memories, the last raw samples (CONTEXT, M), samples done."""

    memories: tuple[Array, ...]
    recent: Array
    done: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers, exact to the last bit in JSON."""
        return {"memories": [m.tolist() for m in self.memories], "recent": self.recent.tolist(), "done": self.done}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> InverseState:
        """The state that ``to_json`` wrote."""
        return cls(tuple(np.asarray(m) for m in data["memories"]), np.asarray(data["recent"]), int(data["done"]))


@dataclass(frozen=True)
class InverseStream:
    """Zero-lag streaming compensator: ``run(state, chunk) -> (state, temperature, flags)``, all chunkings alike.

    A missing sample, and one that lies more than ``spike_K`` from the median of the five before it, is replaced by
    that median and flagged: it does not ring through the filter. A step costs three samples, then the median has it.
    """

    filters: tuple[InverseFilter, ...]
    spike_K: float = np.inf

    @classmethod
    def of(cls, filters: Sequence[InverseFilter], spike_K: float = np.inf) -> InverseStream:
        """For one filter a channel; ``spike_K`` [K] as above, infinite for none."""
        return cls(tuple(filters), spike_K)

    def start(self, first: ArrayLike) -> InverseState:
        """State in equilibrium with the first sample ``first (M,)`` [degC]; InputError when it is missing."""
        first = np.asarray(first, dtype=float)
        if first.shape != (len(self.filters),) or not np.all(np.isfinite(first)):
            raise InputError(
                f"compensate: the first sample must have {len(self.filters)} finite temperatures; got {first}",
                remedy="start at the first complete row",
            )
        memories = tuple(signal.lfilter_zi(f.b, f.a) * y for f, y in zip(self.filters, first))
        return InverseState(memories, np.tile(first, (CONTEXT, 1)))

    def run(self, state: InverseState, chunk: ArrayLike) -> tuple[InverseState, Array, NDArray[np.uint8]]:
        """Compensate ``chunk (n, M)`` [degC] following what ``state`` has seen."""
        y = np.asarray(chunk, dtype=float)
        if len(y) == 0:
            return state, y, np.zeros(y.shape, dtype=np.uint8)
        context = np.concatenate([state.recent, y])
        clean, flags = self._cleaned(context)
        out, memories = np.empty_like(clean), []
        for c, f in enumerate(self.filters):
            out[:, c], memory = signal.lfilter(f.b, f.a, clean[:, c], zi=state.memories[c])
            memories.append(memory)
        return InverseState(tuple(memories), context[-CONTEXT:], state.done + len(y)), out, flags

    def _cleaned(self, context: Array) -> tuple[Array, NDArray[np.uint8]]:
        """Samples (n, M) after the context, bad ones replaced; depends on the CONTEXT samples before each one only."""
        y = context[CONTEXT:]
        missing = ~np.isfinite(y)
        flags = np.where(missing, MISSING, 0).astype(np.uint8)
        if self.spike_K == np.inf and not missing.any():
            return y, flags
        before = sliding_window_view(context, CONTEXT, axis=0)[:-1]
        known = np.isfinite(before)
        if not known.any(axis=-1).all():
            raise InputError(
                f"compensate: more than {CONTEXT} samples in a row are missing",
                remedy="use the smoother, which bridges gaps with an honest band, or start anew after the gap",
            )
        median = np.nanmedian(before, axis=-1)
        spike = np.abs(y - median) > self.spike_K
        flags[spike] |= SPIKE
        return np.where(missing | spike, median, y), flags
