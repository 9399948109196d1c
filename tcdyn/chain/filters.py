"""The filters that every command needs, by numpy and LAPACK: to import scipy.signal, which has them all, takes as long
as some commands compute. Its other filters are imported where they are used."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import toeplitz
from scipy.linalg.lapack import dtbtrs, ztbtrs

from calibration import Array

# samples: of a block; from which on blocks are quicker
BLOCK = 16
LONG = 4096
KERNELS = 8  # lengths of a kernel that are transformed at once


def first_order(decay: complex, drive: NDArray) -> NDArray:
    """y_0 = drive_0, y_k = decay y_(k-1) + drive_k: ``scipy.signal.lfilter([1], [1, -decay], drive)``, (N,).

    The solution of a bidiagonal system. In a long record that gives the last sample of each block, by decay^BLOCK;
    what a block's own drive makes of it, and what the block before leaves, are products with powers of ``decay``.

    >>> first_order(0.5, np.array([1.0, 0.0, 4.0]))
    array([1.  , 0.5 , 4.25])
    """
    n = len(drive)
    if (
        n < LONG or not np.isfinite(drive).all()
    ):  # a block would take what is not finite to its beginning
        bands = np.ones((2, n), dtype=np.result_type(drive, decay), order="F")
        bands[1] = -decay
        solve = ztbtrs if np.iscomplexobj(bands) else dtbtrs
        return np.asarray(solve(bands, drive, uplo="L", diag="U")[0])
    powers = np.asarray(decay) ** np.arange(BLOCK + 1)
    y = np.pad(drive, (0, -n % BLOCK)).reshape(-1, BLOCK) @ toeplitz(powers[:-1], np.zeros(BLOCK)).T
    y[1:] += np.outer(first_order(powers[-1], y[:-1, -1]), powers[1:])
    return np.asarray(y.ravel()[:n])


def largest_match(y: Array, shapes: Array) -> Array:
    """max_k |sum_j y_(i+j) shapes_kj|, (N - L + 1,), of ``y`` (N,) and ``shapes`` (K, L): by Fourier transforms of
    overlapping pieces, as in ``scipy.signal.oaconvolve``, but no more than one shape's products at a time.

    >>> largest_match(np.array([0.0, 1.0, 2.0, 0.0]), np.array([[1.0, 0.0], [1.0, -1.0]])).round(9)
    array([1., 1., 2.])
    """
    length = shapes.shape[1]
    count = len(y) - shapes.shape[1] + 1
    size = next_fast_len(min(KERNELS * length, len(y)), real=True)
    step = size - length + 1
    pieces = rfft(sliding_window_view(np.pad(y, (0, size)), size)[:count:step])
    best = np.zeros((len(pieces), step))
    for shape in rfft(shapes, size).conj():
        np.maximum(best, np.abs(irfft(pieces * shape, size)[:, :step]), out=best)
    return best.ravel()[:count]


def peaks(y: Array, height: float, distance: int) -> Iterator[int]:
    """Samples of the maxima of ``y`` (N,) above ``height``, highest first, each ``distance`` or more samples from a
    higher one, or from an equal one behind it; of a flat top its middle. Where no two are equal, they are those of
    ``scipy.signal.find_peaks``.

    >>> list(peaks(np.array([0.0, 3.0, 2.0, 5.0, 0.0, 4.0, 0.0]), 2.5, 3))
    [3]
    """
    first = np.flatnonzero(np.diff(y, prepend=np.nan) != 0)  # of each run of equal values
    level = y[first]
    rise = np.diff(y[first])
    tops = 1 + np.flatnonzero((level[1:-1] >= height) & (rise[:-1] > 0) & (rise[1:] < 0))
    left = (first[tops] + first[tops + 1] - 1) // 2
    while len(left):
        top = int(left[len(left) - 1 - np.argmax(y[left][::-1])])
        yield top
        left = left[np.abs(left - top) >= distance]
