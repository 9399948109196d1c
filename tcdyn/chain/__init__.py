"""The measurement chain: transfer function, exact simulation, state space, and structures by name.

>>> import numpy as np
>>> slow, quick = Chain([0.6, 0.1]), Chain(0.3)
>>> [s.drift.shape for s in sensors([slow, quick])]  # x, x' and the stages, padded alike
[(4, 4), (4, 4)]
>>> [np.round(part, 3).tolist() for part in discretised([1.0], [0.5, 1.0], dt_s=0.1, hold="zoh")]
[[0.0, 0.181], [1.0, -0.819]]
>>> t = np.arange(0.0, 20.0, 0.02)
>>> read = np.column_stack([c.response(20 + 5 * t, 0.02) for c in (slow, quick)])
>>> alike = equalise(read, 0.02, [slow, quick], common=slow)  # no inverse: both become slow
>>> np.round(20 + 5 * t[-1] - alike[-1], 3)  # both lag by 0.7 s
array([3.5, 3.5])
>>> FlowLaw(at=2.0, exponent=0.5, inner_share=0.2).factor(8.0).round(3)  # of the lag at 2 m/s
np.float64(0.6)
>>> round(sum(cement_lags()), 6)  # of the diffusion time: the first moment
0.5
"""

from tcdyn.chain.chain import (
    NO_CONDITIONING,
    Chain,
    Sensor,
    cement_lags,
    chains_for,
    discretised,
    sensors,
)
from tcdyn.chain.equalisation import equalise
from tcdyn.chain.law import FlowLaw, TableLaw, TemperatureLaw
from tcdyn.chain.rational import Hold
from tcdyn.chain.structures import STRUCTURES, ChainStructure

__all__ = [
    "NO_CONDITIONING",
    "STRUCTURES",
    "Chain",
    "ChainStructure",
    "FlowLaw",
    "Hold",
    "Sensor",
    "TableLaw",
    "TemperatureLaw",
    "cement_lags",
    "chains_for",
    "discretised",
    "equalise",
    "sensors",
]
