"""A step after two lags and a 4 Hz filter. The dashed line is the lag, the first moment of the impulse response."""

from common import save

from tcdyn import Chain, Conditioning
from tcdyn.plots import draw_chain
from tcdyn.plots.style import figure

picture, (ax,) = figure(height_in=3.6)
draw_chain(Chain([0.55, 0.12], conditioning=Conditioning(cutoff_Hz=4.0, poles=2)), ax)
save(picture, __file__)
