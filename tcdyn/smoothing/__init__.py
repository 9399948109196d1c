"""Compensation: estimate the junction temperature from the readings, with its uncertainty.

Kalman smoother, regularised deconvolution and proper inverse.

>>> import numpy as np
>>> from tcdyn.chain import Chain
>>> dt, chain = 0.02, Chain(0.5)
>>> t = np.arange(0.0, 20.0, dt)
>>> true = 80 - 10 * (1 - np.exp(-np.clip(t - 10, 0, None)))
>>> y = chain.response(true, dt) + np.random.default_rng(0).normal(0, 0.1, len(t))
>>> def worst(result):
...     return round(float(np.abs(result.temperature[:, 0] - true)[600:-50].max()), 1)
>>> worst(smooth(y, dt, chain, events_s=(10.0,)))
0.0
>>> worst(deconvolve(y, dt, chain)[0])
0.1
>>> worst(invert(y, dt, chain, 1.0))
1.1
>>> result = smooth(y, dt, chain, events_s=(10.0,))
>>> window_covariance(y, dt, chain, result, channel=0, first=500, last=503).shape
(3, 3)
>>> round(widest_bandwidth_Hz(chain, dt, noise_sd=0.1, wanted_K=0.3), 2)  # of the proper inverse
0.98
>>> round(report_inverse(proper_inverse(chain, dt, 1.0), noise_sd=0.1).noise_out_K, 2)
0.31
"""

from tcdyn.smoothing.inverse import (
    FilterReport,
    InverseFilter,
    invert,
    proper_inverse,
    report_inverse,
    widest_bandwidth_Hz,
)
from tcdyn.smoothing.noise_levels import Change, Intensity
from tcdyn.smoothing.process_noise import TradeoffCurve
from tcdyn.smoothing.record import Compensated
from tcdyn.smoothing.smoother import deconvolve, smooth, window_covariance

__all__ = [
    "Change",
    "Compensated",
    "FilterReport",
    "Intensity",
    "InverseFilter",
    "TradeoffCurve",
    "deconvolve",
    "invert",
    "proper_inverse",
    "report_inverse",
    "smooth",
    "widest_bandwidth_Hz",
    "window_covariance",
]
