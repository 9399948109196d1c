"""What is counted while a column passes by in pieces: how many, where first, the longest run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.files.table import FloatArray


class Tally:
    """Marked samples of a column that comes in pieces: how many, the first one, the longest run of them."""

    def __init__(self) -> None:
        self.count, self.first, self.value = 0, -1, np.nan
        self.start, self.length, self.held = -1, 0, np.nan
        self._open_start, self._open_length, self._open_held = -1, 0, np.nan

    def see(self, mask: NDArray[np.bool_], values: FloatArray, at: int) -> None:
        """Count the True of ``mask (N,)``, whose first sample is number ``at``; ``values (N,)`` as in the file.

        ``value`` becomes that of the first one, ``held`` that at the start of the longest run.
        """
        starts, lengths = runs(mask)
        if not len(starts):
            return
        if self.count == 0:
            self.first, self.value = at + int(starts[0]), float(values[starts[0]])
        self.count += int(lengths.sum())
        begin, held, long = starts + at, values[starts], lengths
        if begin[0] == self._open_start + self._open_length:
            begin[0], long[0] = self._open_start, lengths[0] + self._open_length
            held[0] = self._open_held
        k = int(np.argmax(long))
        if long[k] > self.length:
            self.start, self.length, self.held = int(begin[k]), int(long[k]), float(held[k])
        self._open_start, self._open_length, self._open_held = int(begin[-1]), int(long[-1]), float(held[-1])


def runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts and lengths of the runs of True.

    >>> runs(np.array([False, True, True, False, True]))
    (array([1, 4]), array([2, 1]))
    """
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts
