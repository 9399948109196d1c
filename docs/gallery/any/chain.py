"""
Step response of a measurement chain
====================================

A step after two lags and a 4 Hz filter. The dashed line is the lag, the first moment of the
impulse response.
"""

import matplotlib.pyplot as plt

from tcdyn import Chain, Conditioning
from tcdyn.plots import draw_chain

_, ax = plt.subplots(figsize=(8.5, 3.6), layout="constrained")
draw_chain(Chain([0.55, 0.12], conditioning=Conditioning(cutoff_Hz=4.0, poles=2)), ax)
