"""What a picture shows, read back from its axes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer

from tcdyn.core import Array


def bars(ax: Axes) -> tuple[Array, Array, Array]:
    """Marks (N, 2) of all error bars, and the lower and upper ends (N,) along the direction of
    each."""
    marks, low, high = [], [], []
    for drawn in ax.containers:
        if isinstance(drawn, ErrorbarContainer):
            along = 0 if drawn.has_xerr else 1
            segments = [s for lines in drawn.lines[2] for s in lines.get_segments()]
            low += [s[:, along].min() for s in segments]
            high += [s[:, along].max() for s in segments]
            marks += list(
                np.transpose(drawn.lines[0].get_data())
                if drawn.lines[0]
                else [s.mean(0) for s in segments]
            )
    return np.array(marks), np.array(low), np.array(high)
