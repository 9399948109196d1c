"""What a live smoother is made of: its state, sensor and noise as one linear model, samples in a row taken at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve_continuous_lyapunov

from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.core import Array
from tcdyn.smoothing.state_space import flow


@dataclass(frozen=True)
class LiveState:
    """All that is needed to go on, for M channels and the four hypotheses.

    ``mean`` (M, 4, n + L), ``cov`` (M, 4, n + L, n): states, then the temperatures of the last L samples, and their
    covariance with the states; ``var`` (M, 4, L): of those temperatures; ``weight`` (M, 4) of the hypotheses;
    ``recent`` (W, M): the last readings that were no spikes [degC]; ``held`` (M,):
    readings in a row that were spikes; ``past`` (2 bend, M): the last answers.
    """

    mean: Array
    cov: Array
    var: Array
    weight: Array
    recent: Array
    held: Array
    past: Array
    done: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers, exact to the last bit in JSON."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> LiveState:
        """The state that ``to_json`` wrote."""
        arrays = {k: np.asarray(v, dtype=float) for k, v in data.items() if k != "done"}
        return cls(**arrays, done=int(data["done"]))


@dataclass(frozen=True)
class Block:
    """How q samples of M channels follow from n states before them.

    Rows: q readings without their own noise, n states after them, and the temperatures before each of the q, newest
    first. Columns: the same, but mean and variance stand behind the states. ``effects`` (q + 1, M, 1, n + 2 q, n): on
    the rows, of the states before, and of what moves the states at each sample; ``back`` (M, 1, n + 2, n + 2 q + 2):
    of the states before, their mean and variance on the columns; ``noise`` (M, H, n + 2 q, n + 2 q + 2): covariance
    that what moves the states makes; ``row``, ``column`` (n + 2 q,): of the diagonal; ``asked`` (K q,): rows of
    the temperatures that lie K ``lags`` samples before each reading, where the last temperatures follow below, and
    ``sofar`` (K q, q): which readings are there by then; ``eye`` (q, q): unit matrix.
    """

    effects: Array
    back: Array
    noise: Array
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    asked: NDArray[np.intp]
    eye: Array
    sofar: Array

    @classmethod
    def of(cls, q: int, lags: NDArray[np.intp], step: Array, row: Array, scatter: Array) -> Block:
        """States move by ``step`` (M, 1, n, n) and ``scatter`` (M, H, n, n) each sample, read by ``row`` (M, 1, n)."""
        m, n = row.shape[::2]
        powers = [np.broadcast_to(np.eye(n), step.shape)]
        for _ in range(q):
            powers.append(step @ powers[-1])
        effects = np.zeros((q + 1, m, 1, n + 2 * q, n))
        for k, effect in enumerate(effects):
            effect[..., q : q + n, :] = powers[q - k]
            for i in range(k, q):
                effect[..., n + 2 * q - 1 - i, :] = powers[i - k][..., 0, :]
            for i in range(max(k, 1), q + 1):
                effect[..., i - 1, :] = (row[..., None, :] @ powers[i - k])[..., 0, :]
        column = np.delete(np.arange(n + 2 * q + 2), [q + n, q + n + 1])
        back = np.zeros((m, 1, n + 2, n + 2 * q + 2))
        back[..., :n, column] = effects[0].swapaxes(-1, -2)
        back[..., [n, n + 1], [q + n, q + n + 1]] = 1.0
        newest = (lags[:, None] + np.arange(q)[::-1]).ravel()
        asked = np.where(newest > 0, q + n - 1 + newest, q)
        return cls(
            effects,
            back,
            scattered(effects, scatter, column),
            np.arange(n + 2 * q),
            column,
            asked,
            np.eye(q),
            np.tile(np.tri(q), (len(lags), 1)),
        )


def scattered(effects: Array, scatter: Array, column: NDArray[np.intp]) -> Array:
    """``Block.noise`` where each sample adds ``scatter`` (M, H, n, n) to the covariance of the states."""
    added = np.sum(effects[1:] @ scatter @ effects[1:].swapaxes(-1, -2), axis=0)
    noise = np.zeros((*added.shape[:-1], len(column) + 2))
    noise[..., column] = added
    return noise


def noise_paths(chains: Sequence[Chain]) -> list[Sensor]:
    """The filter of each chain alone, its input standing where a sensor has the temperature of the junction."""
    return sensors([Chain((), conditioning=c.conditioning) for c in chains])


def with_noise(s: Sensor, path: Sensor, leak_s: float, dt_s: float) -> tuple[Array, Array, Array]:
    """Step (n, n) and row (n,) of sensor and noise, and what white noise that comes out with sd 1 leaves in the states.

    States: those of the sensor, the offset of a burst, which leaks away in ``leak_s``, those of the filter that noise
    passes.
    """
    keep = np.r_[0, 2 : len(path.output)]
    drift = path.drift[np.ix_(keep, keep)]
    row = path.output[keep]
    held: Array = np.zeros((len(s.output) + len(keep),) * 2)
    if np.any(row[1:]):
        stages = solve_continuous_lyapunov(drift[1:, 1:], -np.outer(drift[1:, 0], drift[1:, 0]))
        held[len(s.output) + 1 :, len(s.output) + 1 :] = stages / (row[1:] @ stages @ row[1:])
    drift[0, 0] = -1.0 / leak_s
    return flow(block_diag(s.drift, drift), dt_s), np.append(s.output, row), held
