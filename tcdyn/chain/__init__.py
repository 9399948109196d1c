"""The measurement chain: transfer function, exact simulation, state space, structures by their names."""

from tcdyn.chain.chain import (
    NO_CONDITIONING,
    Chain,
    Sensor,
    cement_lags,
    chains_for,
    discretised,
    equalised,
    sensors,
)
from tcdyn.chain.rational import Hold
from tcdyn.chain.structures import STRUCTURES, Structure

__all__ = [
    "NO_CONDITIONING",
    "STRUCTURES",
    "Chain",
    "Hold",
    "Sensor",
    "Structure",
    "cement_lags",
    "chains_for",
    "discretised",
    "equalised",
    "sensors",
]
