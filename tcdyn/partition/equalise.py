"""Give all channels of a disk the same lag, without inverting it: the commuted form needs no more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tcdyn.chain import Chain, delayed, discretised


def equalised(y: NDArray[np.float64], dt_s: float, chains: tuple[Chain, ...], common: Chain) -> NDArray[np.float64]:
    """Each column of ``y`` (N, M) [degC] as the ``common`` chain would have shown it.

    Column i is filtered by G_common / G_i, in which the conditioning cancels; numerator and denominator have the same
    degree, so noise grows at most by the ratio of the lags. A channel with more dead time than the common chain keeps
    its excess.
    """
    out = np.empty_like(y)
    for i, chain in enumerate(chains):
        num, den = np.ones(1), np.ones(1)
        order = max(len(chain.taus_s), len(common.taus_s))
        own = sorted(chain.taus_s, reverse=True) + [0.0] * (order - len(chain.taus_s))
        ref = sorted(common.taus_s, reverse=True) + [0.0] * (order - len(common.taus_s))
        for tau, tau_ref in zip(own, ref):
            floor = 1e-3 if tau_ref < tau else 0.0  # keep the filter proper where the common chain lacks a lag
            if max(tau, tau_ref) > 0:
                num = np.asarray(np.polymul(num, [tau, 1.0]), dtype=float)
                den = np.asarray(np.polymul(den, [max(tau_ref, floor), 1.0]), dtype=float)
        if common.zero_s != chain.zero_s:
            num = np.asarray(np.polymul(num, [common.zero_s, 1.0]), dtype=float)
            den = np.asarray(np.polymul(den, [max(chain.zero_s, 1e-3), 1.0]), dtype=float)
        x = delayed(y[:, i], max(common.delay_s - chain.delay_s, 0.0) / dt_s, "foh", y[0, i])
        b, a = discretised(num, den, dt_s)
        start = np.mean(x[: max(int(1.0 / dt_s), 1)])
        out[:, i] = signal.lfilter(b, a, x, zi=signal.lfilter_zi(b, a) * start)[0]
    return out
