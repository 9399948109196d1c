"""A record in stretches with every input known throughout, as the fits take it; the noise of a measured input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np

from tcdyn.core import Array
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.identify.iodata import IOData

REPEATED = (
    0.4  # share of samples that equal the one before, from which an input was set and not measured
)
MOST_NOISE = 0.1  # of the standard deviation of the input, beyond which it is no noise
SHORTEST = 8  # samples with the input known throughout, below which a stretch is passed over


@dataclass(frozen=True)
class Segment:
    """A stretch with its ``inputs`` (N, K) known throughout, and ``y`` (N,) with NaN where not measured.

    ``before`` (M, K) are the inputs of its run before it, gaps bridged by straight lines. A segment that has a past
    follows a gap: nothing is known of the state it begins from, but what a dead time holds back is.
    """

    inputs: Array
    y: Array
    seen: np.ndarray
    run: int
    start_s: float
    before: Array

    @property
    def u(self) -> Array:
        """The (first) input (N,)."""
        return self.inputs[:, 0]

    @property
    def past(self) -> Array:
        """The (first) input before it (M,)."""
        return self.before[:, 0]

    def of(self, k: int) -> Segment:
        """With the ``k``-th input alone."""
        return replace(self, inputs=self.inputs[:, [k]], before=self.before[:, [k]])

    @property
    def resumed(self) -> bool:
        """Whether it follows a gap of its run."""
        return len(self.past) > 0

    def history(self, count: int) -> Array:
        """The last ``count`` inputs before it (count,); what lies before the run is as its first input."""
        first = np.concatenate([self.past, self.u])[0]
        padded = np.concatenate([np.full(max(count - len(self.past), 0), first), self.past])
        return padded[len(padded) - count :]


def cut(data: IOData) -> tuple[Segment, ...]:
    """The runs in stretches without missing input; a stretch shorter than 8 samples is dropped."""
    pieces = []
    for index, run in enumerate(data.runs):
        known = np.asarray(np.isfinite(run.u).all(axis=1))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], known.view(np.int8), [0]])))
        for a, b in edges.reshape(-1, 2):
            y = run.y[a:b, 0]
            if b - a >= min(SHORTEST, run.n) and np.isfinite(y).any():
                t = np.flatnonzero(known[:b])
                past = np.array([np.interp(np.arange(t[0], a), t, u[t]) for u in run.u.T]).T
                pieces.append(
                    Segment(run.u[a:b], y, np.isfinite(y), index, run.start_s + a * data.dt_s, past)
                )
    return tuple(pieces)


def input_noise_sd(segments: Sequence[Segment]) -> float:
    """Standard deviation of the input's measurement noise, from its fourth differences; 0 where it counts for nothing.

    A signal slower than a tenth of the sampling rate leaves less than 2 % of its amplitude in them. An input whose
    samples mostly repeat the one before was set, not measured; noise of less than 1e-4 of what the input moves is none.
    Where it would be more than a tenth of the input's standard deviation, the input itself moves that fast.
    """
    u = [s.u for s in segments if len(s.u) > 4]
    if not u or np.mean(np.concatenate([np.diff(x) for x in u]) == 0) > REPEATED:
        return 0.0
    away = np.abs(np.concatenate([np.diff(x, 4) for x in u]))
    away = away[away <= 4 * MAD_TO_SD * np.median(away)]  # a step leaves five of them, each far out
    sd = float(np.sqrt(np.mean(away**2) / comb(8, 4)))
    moving = np.concatenate(u)
    return sd if 1e-4 * np.ptp(moving) < sd < MOST_NOISE * np.std(moving) else 0.0
