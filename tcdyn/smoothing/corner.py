"""How fast the smoother follows: its corner frequency.

Used by :mod:`tcdyn.smoothing.process_noise`, :mod:`tcdyn.smoothing.roughness`,
:mod:`tcdyn.smoothing.smoother` and :mod:`tcdyn.smoothing.inverse`. Guarded by
``tests/smoothing/test_states.py``.
"""

from __future__ import annotations

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array


def corner_rad_s(chain: Chain, ratio: Array, order: int = 2) -> Array:
    """Corner frequency [rad/s] of the smoother: where the signal falls below the noise.

    Parameters
    ----------
    chain
        The chain, with frequency response G.
    ratio
        q / R [1/s4] of any shape: intensity over the spectral density R = noise variance times dt;
        with ``order`` 1 p / R [1/s2], p the intensity of level noise.
    order
        2 for slope noise, 1 for level noise.

    Returns
    -------
    Array
        Corner frequency [rad/s], same shape as ``ratio``; between 1e-4 and 1e4.

    Notes
    -----
    Solves |G(w)|^2 q / w^(2 order) = R, by linear interpolation of logarithms between 400
    frequencies. The number of frequencies may be changed; ``tests/smoothing/test_states.py``
    requires an accuracy of
    0.2 %.
    """
    w = np.geomspace(1e-4, 1e4, 400)
    gain = np.abs(chain.frequency_response(w / 2 / np.pi))
    needed = np.maximum.accumulate(2 * order * np.log(w) - 2 * np.log(gain + 1e-30))
    return np.asarray(np.exp(np.interp(np.log(ratio), needed, np.log(w))))
