"""Plants of the tests of controllers: as factors, and as identified models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tcdyn.chain.rational import Factor, Rational
from tcdyn.identification import Identified, process


def plant(
    gain: float,
    lags: Sequence[float] = (),
    delay_s: float = 0.0,
    zeros: Sequence[float] = (),
    integrators: int = 0,
    pair: tuple[float, float] | None = None,
) -> Rational:
    """gain prod(1 + z s) exp(-delay s) / (s^k prod(1 + T s)); ``pair``: T and damping ratio."""
    num = np.array([float(gain)])
    for zero in zeros:
        num = np.convolve(num, [1.0, zero])
    factors = [Factor((1.0, lag)) for lag in lags]
    if pair is not None:
        factors.append(Factor((1.0, 2 * pair[1] * pair[0], pair[0] ** 2)))
    return Rational(num, tuple(factors), delay_s, integrators)


def model(
    name: str, theta: Mapping[str, float], relative_u: float = 0.02, **more: Any
) -> Identified:
    """An identified model whose parameters have one relative standard uncertainty."""
    structure = process(name)
    u = [relative_u * abs(theta[n]) for n in structure.free]
    fields = {"input_name": "heater_percent", "output_name": "T1_degC", "dt_s": 1.0, **more}
    return Identified.of(structure, theta, np.diag(np.square(u)), **fields)


HEATER = {"Kp": 0.6, "Tp1": 180.0, "Td": 15.0}
