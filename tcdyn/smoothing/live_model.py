"""The model of the live smoother: state, sensor and noise as one linear model, and several samples
at once.
"""

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
    """State of a live smoother, for M channels and the four hypotheses, n states and a lag of L
    samples.

    Parameters
    ----------
    mean
        States, then the temperatures of the last L samples (M, 4, n + L).
    cov
        Covariance (M, 4, n + L, n) of these with the states.
    var
        Variances (M, 4, L) of the temperatures.
    weight
        Probabilities (M, 4) of the hypotheses.
    recent
        Last readings without outliers (W, M) [degC].
    held
        Number of consecutive outliers (M,).
    past
        Last results (2 bend, M).
    done
        Number of samples processed.
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
    """How q samples of M channels follow from the n states before them.

    The rows are q readings without their white noise, the n states after them, and the temperatures
    before each of the q samples, newest first. The columns are the same, with mean and variance
    after the states. H is the number of hypotheses.

    Parameters
    ----------
    effects
        Effect (q + 1, M, 1, n + 2 q, n) on the rows of the states before, and of the process noise
        at each sample.
    back
        Effect (M, 1, n + 2, n + 2 q + 2) on the columns of the states before, their mean and
        variance.
    noise
        Covariance (M, H, n + 2 q, n + 2 q + 2) from the process noise.
    row, column
        Indices (n + 2 q,) of the diagonal.
    requested
        Rows (K q,) of the temperatures that lie K ``lags`` samples before each reading; the last
        temperatures follow below the rows.
    eye
        Unit matrix (q, q).
    available
        Which readings are available for each requested temperature (K q, q).
    """

    effects: Array
    back: Array
    noise: Array
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    requested: NDArray[np.intp]
    eye: Array
    available: Array

    @classmethod
    def of(cls, q: int, lags: NDArray[np.intp], step: Array, row: Array, scatter: Array) -> Block:
        """Block of q samples.

        The states change by ``step`` (M, 1, n, n) with process noise ``scatter`` (M, H, n, n) at
        each sample, and are observed through ``row`` (M, 1, n).
        """
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
        requested = np.where(newest > 0, q + n - 1 + newest, q)
        return cls(
            effects,
            back,
            process_noise_covariance(effects, scatter, column),
            np.arange(n + 2 * q),
            column,
            requested,
            np.eye(q),
            np.tile(np.tri(q), (len(lags), 1)),
        )


def process_noise_covariance(effects: Array, scatter: Array, column: NDArray[np.intp]) -> Array:
    """``Block.noise`` where each sample adds ``scatter`` (M, H, n, n) to the covariance of the
    states.
    """
    covariance = np.sum(effects[1:] @ scatter @ effects[1:].swapaxes(-1, -2), axis=0)
    noise = np.zeros((*covariance.shape[:-1], len(column) + 2))
    noise[..., column] = covariance
    return noise


def noise_filters(chains: Sequence[Chain]) -> list[Sensor]:
    """The conditioning filter of each chain; its input replaces the junction temperature."""
    return sensors([Chain((), conditioning=c.conditioning) for c in chains])


def sensor_with_noise(
    s: Sensor, path: Sensor, leak_s: float, dt_s: float
) -> tuple[Array, Array, Array]:
    """Transition matrix (n, n) and observation row (n,) of sensor and noise, and the noise
    covariance in the states.

    The states are those of the sensor, the offset of a burst, which decays with ``leak_s``, and
    those of the filter that the noise passes. The third result is the stationary covariance of
    these for white noise that has standard deviation 1 after the filter.
    """
    kept_states = np.r_[0, 2 : len(path.output)]
    drift = path.drift[np.ix_(kept_states, kept_states)]
    row = path.output[kept_states]
    covariance: Array = np.zeros((len(s.output) + len(kept_states),) * 2)
    if np.any(row[1:]):
        stages = solve_continuous_lyapunov(drift[1:, 1:], -np.outer(drift[1:, 0], drift[1:, 0]))
        covariance[len(s.output) + 1 :, len(s.output) + 1 :] = stages / (row[1:] @ stages @ row[1:])
    drift[0, 0] = -1.0 / leak_s
    return flow(block_diag(s.drift, drift), dt_s), np.append(s.output, row), covariance
