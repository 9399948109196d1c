"""The lags of a disk from one plunge (above) and in the record: differences are more certain than the common lag."""

from common import lab, plunged, save

from tcdyn.plots import draw_common_lag, draw_differential_lags, draw_lags
from tcdyn.plots.style import figure
from tcdyn.rig.record import read_record

chain = read_record(lab() / "fast.disk.json").chain
assert chain is not None
picture, axes = figure(3, 1, width_in=8.5, height_in=10.0)
draw_common_lag(plunged(), axes[0])
draw_differential_lags(plunged(), axes[1])
draw_lags(chain, axes[2])
save(picture, __file__)
