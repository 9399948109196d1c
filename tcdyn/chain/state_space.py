"""The junction temperature and its chain as one continuous-time state space, scaled in degrees throughout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from calibration.errors import InputError
from tcdyn.chain import Chain, cement_lags, conditioning_polynomials

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """State (x, x', stages of the chain): d state/dt = drift @ state, logged value = output @ state.

    x is the junction temperature [degC], x' its slope [K/s]; every stage has unit static gain, so all stages are in
    degC. ``lag_row @ state`` is the change of the compensated temperature per second of extra lag [K/s].
    """

    drift: Array
    output: Array
    lag_row: Array
    delay_s: float
    lag_s: float

    @property
    def size(self) -> int:
        """Number of states."""
        return len(self.output)

    def ramp(self) -> Array:
        """Columns (2, size): the state of a chain that has followed a level 1, and a slope 1 through zero, for ever."""
        n = self.size
        columns = np.zeros((n, 2))
        columns[0, 0] = columns[1, 1] = 1.0
        if n > 2:
            stages, level = self.drift[2:, 2:], self.drift[2:, 0]
            columns[2:, 0] = -np.linalg.solve(stages, level)
            columns[2:, 1] = np.linalg.solve(stages, columns[2:, 0])
        return columns

    def ramp_scatter(self) -> Array:
        """Stationary covariance (size, size) of the stages about the ramp, for slope noise of intensity 1 K2/s3."""
        covariance = np.zeros((self.size, self.size))
        if self.size > 2:
            v = self.ramp()[2:, 1]
            covariance[2:, 2:] = solve_continuous_lyapunov(self.drift[2:, 2:], -np.outer(v, v))
        return covariance


def sensor(chain: Chain, size: int | None = None) -> Sensor:
    """The state space of ``chain``, padded with idle states up to ``size`` so that channels can be stacked.

    Largest lag first: y = (1 + zero s) B(s) / prod (1 + tau_i s) x(t - delay), with the chain's complex pair and the
    lags of its cement below where it has them; the delay is kept apart, exactly.
    """
    blocks = [np.array([[-1.0 / tau]]) for tau in sorted(chain.taus_s, reverse=True) if tau > 0]
    if chain.pair is not None:
        w, zeta = 1.0 / chain.pair[0], chain.pair[1]
        blocks.append(np.array([[0.0, w], [-w, -2.0 * zeta * w]]))
    if chain.cement_s:
        blocks += [np.array([[-1.0 / (chain.cement_s * share)]]) for share in cement_lags()]
    blocks += _conditioning_blocks(chain)
    n = 2 + sum(len(block) for block in blocks)
    drift = np.zeros((n, n))
    drift[0, 1] = 1.0
    source, at = 0, 2
    for block in blocks:
        k = len(block)
        drift[at : at + k, at : at + k] = block
        drift[at : at + k, source] = -block[:, 0]
        source, at = at, at + k
    output = np.zeros(n)
    output[source] = 1.0
    if chain.zero_s:
        if not blocks:
            raise InputError(f"Chain: a zero of {chain.zero_s:g} s needs at least one lag or the conditioning filter")
        output = output + chain.zero_s * drift[source]
    lag_row = np.zeros(n)
    if chain.taus_s and max(chain.taus_s) > 0:
        lag_row[:] = drift[2]
    else:
        lag_row[1] = 1.0
    if size is not None and size > n:
        drift = np.pad(drift, (0, size - n))
        drift[range(n, size), range(n, size)] = -1.0
        output, lag_row = np.pad(output, (0, size - n)), np.pad(lag_row, (0, size - n))
    return Sensor(drift, output, lag_row, chain.delay_s, chain.lag_s)


def _conditioning_blocks(chain: Chain) -> list[Array]:
    """Unit-gain sections of B: (1, 1) for a real pole, (2, 2) for a pair, driven through minus their first column."""
    _, den = conditioning_polynomials(chain.conditioning)
    blocks = []
    if chain.conditioning.shape == "cascade":
        rate = 2 * np.pi * chain.conditioning.cutoff_Hz
        return [np.array([[-rate]])] * chain.conditioning.poles
    for pole in np.roots(den):
        if abs(pole.imag) < 1e-9 * abs(pole):
            blocks.append(np.array([[pole.real]]))
        elif pole.imag > 0:
            w = abs(pole)
            blocks.append(np.array([[0.0, w], [-w, 2 * pole.real]]))
    return blocks


def stacked(chains: list[Chain]) -> list[Sensor]:
    """Sensors of one common size."""
    size = max(sensor(chain).size for chain in chains)
    return [sensor(chain, size) for chain in chains]
