"""What the inputs of a record can show: one frequency only, or inputs that move together.

``tcdyn.identification.comparison`` adds the findings to the record, and
``tcdyn.identification.causality`` asks for periodic records. Guarded by
``tests/identify/test_identify_excitation.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import correlate

from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning
from tcdyn.identification.iodata import IOData
from tcdyn.identification.segments import Segment, split_segments

# Mean square change over a period, relative to twice the variance: below it a signal is periodic,
# above half it is not at that shift (chosen by judgement).
MAX_CHANGE_OF_PERIODIC = 0.1
MIN_CHANGE_WITHIN_PERIOD = 0.5
# Share of an input's variance in one sine above which it has one frequency; zero padding of its
# spectrum, whose maximum is then at most 1.3 % too small (chosen by judgement).
MIN_SHARE_OF_SINE = 0.95
PADDING = 8
# Share of an input's variance that the other inputs do not explain, below which its effect cannot
# be told from theirs (chosen by judgement).
MIN_OWN_SHARE = 1e-4


def excitation(data: IOData) -> tuple[Finding, ...]:
    """Warnings about inputs that do not determine gain and lag.

    Parameters
    ----------
    data
        The record.

    Returns
    -------
    tuple of Finding
        "record.one_frequency" for a single input that is a sine, where the output has settled to
        one, too; "record.inseparable" for each input that the others explain.

    Notes
    -----
    A sine in the steady state determines two numbers, amplitude and phase at one frequency
    (Ljung, System Identification, 2nd ed. 1999, section 13.2). A transient at its start determines
    more.

    Examples
    --------
    >>> t = 0.5 * np.arange(400)
    >>> u, y = np.sin(0.2 * t), 0.5 * np.sin(0.2 * t - 0.8)
    >>> [f.code for f in excitation(IOData.from_arrays(u, y, 0.5))]
    ['record.one_frequency']
    """
    segments = split_segments(data)
    if not segments:
        return ()
    if len(data.input_names) == 1:
        period_s = period_of_sine(segments, data.dt_s)
        if period_s is None or not is_periodic(segments):
            return ()
        name = data.input_names[0]
        return (warning("record.one_frequency", subject=name, period_s=period_s),)
    return tuple(
        warning("record.inseparable", subject=data.input_names[k], percent=100 * share)
        for k, share in enumerate(_own_shares(np.concatenate([s.inputs for s in segments])))
        if share < MIN_OWN_SHARE
    )


def is_periodic(segments: Sequence[Segment]) -> bool:
    """Whether each segment repeats input and output with a period from its first sample on.

    A lead of the output cannot be told from a delay there.
    """
    for s in segments:
        periods = _periods(np.ravel(s.u))
        if not any(_change_over(s.filled_y, int(k)) < MAX_CHANGE_OF_PERIODIC for k in periods):
            return False
    return True


def _periods(u: Array) -> Array:
    """Shifts of up to half the length, in samples, after which a signal (N,) repeats itself."""
    n = len(u)
    v = u - u.mean()
    lags = np.arange(1, n // 2 + 1)
    squares = np.concatenate([[0.0], np.cumsum(v**2)])
    product = correlate(v, v, method="fft")[n - 1 :][lags]
    mean_square = (squares[n - lags] + squares[n] - squares[lags] - 2 * product) / (n - lags)
    change = mean_square / max(2 * float(np.var(u)), 1e-300)
    has_changed = np.maximum.accumulate(change) > MIN_CHANGE_WITHIN_PERIOD
    return lags[has_changed & (change < MAX_CHANGE_OF_PERIODIC)]


def _change_over(y: Array, period: int) -> float:
    """Mean square change over a period, relative to twice the variance; over the first period alone
    if that is more."""
    square = (y[period:] - y[:-period]) ** 2
    largest = max(float(np.mean(square)), float(np.mean(square[:period])))
    return largest / max(2 * float(np.var(y)), 1e-300)


def period_of_sine(segments: Sequence[Segment], dt_s: float) -> float | None:
    """Period of the input [s] where it is one sine in the longest segment, else None.

    The segment contains at least a period: a single step may resemble a part of one.
    """
    u = np.ravel(max((s.u for s in segments), key=len))
    v = u - u.mean()
    power = np.abs(np.fft.rfft(v, PADDING * len(v))) ** 2
    peak = int(np.argmax(power))
    share = 2 * float(power[peak]) / max(len(v) * float(v @ v), 1e-300)
    return PADDING * len(v) * dt_s / peak if peak >= PADDING and share > MIN_SHARE_OF_SINE else None


def _own_shares(inputs: Array) -> Array:
    """Share of the variance of each input (N, M) that the others do not explain (M,)."""
    centred = inputs - inputs.mean(axis=0)
    scaled = centred / np.maximum(np.linalg.norm(centred, axis=0), 1e-300)
    shares = []
    for k in range(scaled.shape[1]):
        others = np.delete(scaled, k, axis=1)
        weights = np.linalg.lstsq(others, scaled[:, k], rcond=1e-9)[0]
        shares.append(float(np.sum((scaled[:, k] - others @ weights) ** 2)))
    return np.array(shares)
