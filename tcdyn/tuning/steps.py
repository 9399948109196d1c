"""Plants in steps of time under an input that is constant between them, exact with dead time.

``tcdyn.tuning.responses`` runs them, ``tcdyn.tuning.margins`` has their frequency response. Tests:
``tests/tuning/test_loop_responses.py`` and ``tests/tuning/test_loop_margins.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tcdyn.chain.rational import Complex, Rational, realise
from tcdyn.core import Array


@dataclass(frozen=True)
class PlantSteps:
    """One step of several plants of one structure, whose matrices are lower triangular.

    Attributes
    ----------
    phi, gamma
        State at the next step: phi x + gamma u; (D, n, n) and (D, n).
    c, d
        Output c x + d u with the delayed input; (D, n) and (D,).
    delay
        Steps by which the input is delayed (D,).
    """

    phi: NDArray
    gamma: NDArray
    c: NDArray
    d: NDArray
    delay: NDArray[np.intp]

    def twice(self) -> PlantSteps:
        """The same plants once more behind themselves."""
        doubled = [np.concatenate([each, each]) for each in vars(self).values()]
        return PlantSteps(*doubled)

    def pulse_responses(self, angle: Array) -> Complex:
        """Responses (D, W) of the pulse transfer functions at z = exp(i angle).

        Parameters
        ----------
        angle
            Angles (W,) [rad]: angular frequency times the step.

        Notes
        -----
        (c (z I - phi)^-1 gamma + d) z^-delay; phi is lower triangular, so that the states follow
        one after the other.
        """
        z = np.exp(1j * angle)
        states: list[Complex] = []
        response = np.repeat(self.d[:, None], len(z), axis=1).astype(complex)
        for row in range(self.gamma.shape[1]):
            driven = np.repeat(self.gamma[:, row, None], len(z), axis=1).astype(complex)
            for column, state in enumerate(states):
                driven = driven + self.phi[:, row, column, None] * state
            states.append(driven / (z - self.phi[:, row, row, None]))
            response = response + self.c[:, row, None] * states[-1]
        return np.asarray(response * z ** -self.delay[:, None].astype(float))


def plant_steps(plants: Sequence[Rational], step_s: float, further_s: float = 0.0) -> PlantSteps:
    """Matrices of one step of each plant.

    Parameters
    ----------
    plants
        The plants (D,).
    step_s
        The step [s].
    further_s
        Added to every dead time [s], as far as that stays positive.
    """
    systems = [realise(plant, sensitivities=False) for plant in plants]
    n = len(systems[0].B)
    block = np.zeros((len(systems), n + 1, n + 1), dtype=complex)
    for matrix, system in zip(block, systems):
        matrix[:n, :n] = system.A
        matrix[:n, n] = system.B
    delay_s = np.maximum([plant.delay_s + further_s for plant in plants], 0.0)
    delay = np.ceil(delay_s / step_s - 1e-9).astype(int)
    lead_s = np.maximum(delay * step_s - delay_s, 0.0)
    c = np.array([system.C[0] for system in systems]).reshape(len(systems), n)
    d = np.array([system.D[0] for system in systems])
    transition = expm(block * step_s) if n else block
    lead = expm(block * lead_s[:, None, None]) if n else block
    d = d + np.einsum("dn,dn->d", c, lead[:, :n, n])
    c = np.einsum("dn,dnm->dm", c, lead[:, :n, :n])
    phi = transition[:, :n, :n]
    gamma = transition[:, :n, n]
    if not any(np.any(np.asarray(system.A).imag != 0) for system in systems):
        phi, gamma, c, d = phi.real, gamma.real, c.real, d.real
    # An output that follows its input at once closes a loop without delay: one step is the least.
    delay = np.where((delay == 0) & (np.abs(d) > 0), 1, delay)
    return PlantSteps(phi, gamma, c, d, delay)
