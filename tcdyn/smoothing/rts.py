"""The smoother of Rauch, Tung and Striebel over time intervals, means by Bryson and Frazier's form.

A Kalman filter runs forward in the information form. Recursions of the adjoint and of the
information of later samples run backward. The recursions are exact where anything changes. Between
events and gaps the covariance becomes stationary after some correlation times; from there on both
passes are linear recursions with one constant gain, evaluated for all channels and intervals at
once.

Used by :mod:`tcdyn.smoothing.state_space` and by ``tcdyn.smoothing.smoother.window_covariance``.
The thresholds below trade speed against rounding errors only; ``tests/smoothing/test_smoother.py``
compares the result with the recursion without constant gain, and with dense least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array

# relative change of a covariance from one interval to the next below which it counts as stationary
SETTLED_CHANGE = 1e-7
# relative difference of information or intensity below which intervals count as equal: it changes
# no temperature by a millionth of its standard deviation
EQUAL_TOLERANCE = 1e-6
# equal intervals from which on the recursion of constant gain is used (a matter of speed only)
MIN_RUN = 16
# intervals from one test of a stationary covariance to the next (a matter of speed only)
TEST_STRIDE = 4


@dataclass(frozen=True)
class IntervalModel:
    """A linear Gaussian model on J time intervals, M channels, Q proposed intensities, n states.

    The first two states are the level [degC] and the slope [K/s] of the junction temperature.

    Parameters
    ----------
    knots_s
        Knots (J+1,) [s]; interval j lies between knots j and j + 1.
    kind
        Which of K kinds an interval is (J,), by its length and by where samples lie in it.
    mean0, cov0
        Prior mean (M, Q, n) and covariance (M, Q, n, n) at the first knot.
    transition
        Transition matrix of each kind of interval (K, M, 1, n, n).
    information, score
        Sums over the samples of interval j of w o o' (J, M, 1, n, n) and w o y (J, M, 1, n); w is
        the weight of a sample over its noise variance and o the row that predicts it from the state
        at the knot.
    jump_var
        Variance (J, M, Q, 2) added to level [K2] and slope [K2/s2] at knot j.
    rows
        For each channel and each kind that has samples: its intervals (c,), the rows o (count, n),
        and the indices of the samples (c, count), equal to N where the record has none.

    Notes
    -----
    ``tcdyn.smoothing.state_space.interval_model`` makes it. ``rts_smooth`` uses the first proposal
    only, ``tcdyn.smoothing.state_space.kalman_filter`` all of them.
    """

    knots_s: Array
    kind: NDArray[np.intp]
    mean0: Array
    cov0: Array
    transition: Array
    information: Array
    score: Array
    jump_var: Array
    rows: tuple[tuple[tuple[NDArray[np.intp], Array, NDArray[np.intp]], ...], ...]


@dataclass(frozen=True)
class RtsResult:
    """Smoothed states at the J intervals, for M channels of n states.

    Parameters
    ----------
    mean, cov
        Mean (J, M, n) and covariance (J, M, n, n) given all samples.
    filtered_cov
        Covariance (J, M, n, n) given the samples up to the end of the interval.
    adjoint, adjoint_var
        Adjoint (J, M, 2) of level and slope at the knot, which is the score for a jump there, and
        its variance (J, M, 2, 2).
    jump_slope
        Minus the covariance (J, M) [1/s] of a jump of the level at the knot and the slope after it,
        given all samples, over the prior variance of that jump.
    """

    mean: Array
    cov: Array
    filtered_cov: Array
    adjoint: Array
    adjoint_var: Array
    jump_slope: Array


def rts_smooth(model: IntervalModel) -> RtsResult:
    """RTS smoother for the first proposal of each channel: Kalman filter, then the backward pass.

    Parameters
    ----------
    model
        The model on J intervals; only the first of its proposals is used.

    Returns
    -------
    RtsResult
        Smoothed states, their covariances, and the adjoint of each interval.

    Notes
    -----
    The means of the backward pass are in the form of Bryson and Frazier. With prior covariance P,
    information L, score s and transition A of an interval: the gain matrix is S = (I + P L)^-1, the
    filtered covariance P+ = S P, the innovation e = s - L m, the filtered mean m+ = m + P+ e, and
    the next mean A m+ = F m + A P+ s with F = A S. Backward, the adjoint is q = S' e + F' q of the
    next interval. Given all samples, the mean is m + P+ (e + A' q), with q of the next interval.

    The information of later samples is V = A' N A with N of the next knot; N = ((L + V)^-1 + Q)^-1
    is the information about the state before the process noise Q acts at the knot. Given all
    samples, the covariance is (P+^-1 + V)^-1; the variance of the adjoint is ((L + V)^-1 + P)^-1.
    Bryson and Frazier's covariance P+ - P+ A' W A P+, with W of the next adjoint, is the same, but
    a difference: in the first interval, in a gap or beside a jump P+ is many orders of magnitude
    larger, and only rounding errors remain. A jump w of the level at the knot, of prior variance
    Q, has with the state after it the covariance Q (I - W P), with W of the adjoint there.

    What may be changed: ``MIN_RUN`` freely (speed), ``SETTLED_CHANGE`` and ``EQUAL_TOLERANCE`` as
    long as ``tests/smoothing/test_smoother.py`` finds the same result with and without constant
    gain. The order of level and slope in the state must stay that of ``tcdyn.chain.chain.Sensor``.
    """
    predicted_cov, filtered_cov, gain_matrix, base = _filter_covariances(model)
    info = model.information[:, :, 0]
    score = model.score[:, :, 0]
    transition = model.transition[:, :, 0]
    # intervals of one gain also share step and added variance
    distinct, gain_index = np.unique(base, return_inverse=True)
    step = transition[model.kind[distinct]] @ gain_matrix[distinct]
    gain = transition[model.kind[distinct]] @ filtered_cov[distinct]
    mean = _predicted_means(
        model.mean0[:, 0], transition[model.kind], step, gain, info, score, gain_index
    )
    innovation = score - _matrix_vector(info, mean)
    driven = _matrix_vector(gain_matrix.swapaxes(-1, -2), innovation)
    adjoint, later_info, shared = _backward_pass(step, driven, gain_index, model)
    mean += _matrix_vector(
        filtered_cov,
        innovation + _matrix_vector(transition[model.kind].swapaxes(-1, -2), adjoint[1:]),
    )
    # first interval of each run with one covariance
    first = np.flatnonzero(np.diff(gain_index, prepend=-1) | np.diff(shared, prepend=-1))
    count = np.diff(first, append=len(gain_index))
    later_info = later_info[first]
    cov = _with_information(filtered_cov[first], later_info)
    adjoint_var = _with_information(info[first] + later_info, predicted_cov[first])
    jump_slope = np.einsum("jmn,jmn->jm", adjoint_var[..., 0, :], predicted_cov[first][..., 1])
    return RtsResult(
        mean,
        np.repeat(cov, count, axis=0),
        filtered_cov,
        adjoint[:-1, :, :2],
        np.repeat(adjoint_var[..., :2, :2], count, axis=0),
        np.repeat(jump_slope, count, axis=0),
    )


def _filter_covariances(model: IntervalModel) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Predicted and filtered covariances, gain matrices, and which intervals share them.

    Parameters
    ----------
    model
        The model on J intervals.

    Returns
    -------
    predicted_cov
        Covariance P (J, M, n, n) given the samples before each interval.
    filtered_cov
        Covariance P+ (J, M, n, n) given the samples up to the end of each interval.
    gain_matrix
        Gain matrix S = (I + P L)^-1 (J, M, n, n).
    base
        First interval (J,) that has the same gain; the interval itself where the gain is its own.

    Notes
    -----
    In a run of equal intervals the recursion stops when P+ changes by less than ``SETTLED_CHANGE``,
    and the rest of the run gets its last value. The run must have ``MIN_RUN`` more intervals.
    """
    count = len(model.kind)
    (batch, _, n) = model.mean0.shape
    predicted_cov, filtered_cov, gain_matrix = np.empty((3, count, batch, n, n))
    base = np.arange(count)
    ends = _run_ends(model)
    cov = model.cov0[:, 0].copy()
    eye = np.eye(n)
    back = model.transition[:, :, 0].swapaxes(-1, -2)
    j = 0
    while j < count:
        kind = model.kind[j]
        cov[:, 0, 0] += model.jump_var[j, :, 0, 0]
        cov[:, 1, 1] += model.jump_var[j, :, 0, 1]
        predicted_cov[j] = cov
        gain_matrix[j] = np.linalg.inv(cov @ model.information[j, :, 0] + eye)
        filtered_cov[j] = gain_matrix[j] @ cov
        last = int(ends[j])
        if (
            j
            and last - j >= MIN_RUN
            and j % TEST_STRIDE == 0
            and ends[j - 1] == last
            and _are_settled(filtered_cov[j], filtered_cov[j - 1])
        ):
            rows = slice(j, last + 1)
            predicted_cov[rows] = cov
            filtered_cov[rows] = filtered_cov[j]
            gain_matrix[rows] = gain_matrix[j]
            base[rows] = j
            j = last
        cov = model.transition[kind, :, 0] @ filtered_cov[j] @ back[kind]
        j += 1
    return predicted_cov, filtered_cov, gain_matrix, base


def _predicted_means(
    start: Array,
    transition: Array,
    step: Array,
    gain: Array,
    info: Array,
    score: Array,
    gain_index: NDArray[np.intp],
) -> Array:
    """Predicted means m (J, M, n) before the samples of each interval.

    Parameters
    ----------
    start
        Prior mean (M, n) at the first knot.
    transition
        Transition A of each interval (J, M, n, n).
    step, gain
        F = A S and A P+ (K, M, n, n) of each distinct gain.
    info, score
        Information L (J, M, n, n) and score s (J, M, n) of the samples.
    gain_index
        Index (J,) of the gain and step of an interval.

    Returns
    -------
    Array
        Means (J, M, n).

    Notes
    -----
    The next mean is A m + gain (s - L m), or step m + gain s where several intervals have one gain.
    Elsewhere the second form is not used: where the state is still uncertain it is a difference of
    large numbers.
    """
    mean = np.empty_like(score)
    j = 0
    mean[0] = start
    last_of_run = [*np.flatnonzero(np.diff(gain_index)).tolist(), len(gain_index) - 1]
    for last in last_of_run:
        k = gain_index[last]
        if last > j:
            driven = np.concatenate([mean[j][None], _matrix_vector(gain[k], score[j:last])])
            mean[j : last + 1] = recursion(step[k], driven)
        j = last + 1
        if j < len(mean):
            innovation = score[last] - _matrix_vector(info[last], mean[last])
            mean[j] = _matrix_vector(transition[last], mean[last]) + _matrix_vector(
                gain[k], innovation
            )
    return mean


def _backward_pass(
    step: Array, driven: Array, gain_index: NDArray[np.intp], model: IntervalModel
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Backward pass: adjoints, and the information of later samples.

    Parameters
    ----------
    step
        F = A S (K, M, n, n) of each distinct gain.
    driven
        S' e (J, M, n) of each interval, e the innovation.
    gain_index
        Index (J,) of the gain and step of an interval.
    model
        The model on J intervals.

    Returns
    -------
    adjoint
        Adjoint q (J + 1, M, n): q = step' q + driven, with q of the next interval; zero after the
        last one.
    later_info
        Information V (J, M, n, n) about the state at a knot from the samples of later intervals.
    shared
        The interval (J,) whose V an interval shares.
    """
    count = len(gain_index)
    (batch, n) = driven.shape[1:]
    adjoint = np.zeros((count + 1, batch, n))
    later_info = np.empty((count, batch, n, n))
    back = step.swapaxes(-1, -2)
    flow = model.transition[:, :, 0]
    flow_back = flow.swapaxes(-1, -2)
    jump_var = model.jump_var[:, :, 0]
    has_noise = np.asarray(jump_var.any(axis=1))
    shared = np.arange(count)
    run_starts = np.searchsorted(gain_index, np.arange(len(step)))
    before_noise = np.zeros((batch, n, n))
    j = count - 1
    while j >= 0:
        k = gain_index[j]
        kind = model.kind[j]
        later_info[j] = flow_back[kind] @ before_noise @ flow[kind]
        before_noise = later_info[j] + model.information[j, :, 0]
        for i in range(2):
            if has_noise[j, i]:
                _add_noise(before_noise, i, jump_var[j, :, i, None])
        start = int(run_starts[k])
        if (
            j - start >= MIN_RUN
            and j % TEST_STRIDE == 0
            and j < count - 1
            and _are_settled(later_info[j], later_info[j + 1])
        ):
            later_info[start:j] = later_info[j]
            shared[start:j] = j
            reversed_driven = np.concatenate([adjoint[j + 1][None], driven[start : j + 1][::-1]])
            adjoint[start : j + 1] = recursion(back[k], reversed_driven)[:0:-1]
            j = start
        else:
            adjoint[j] = _matrix_vector(back[k], adjoint[j + 1]) + driven[j]
        j -= 1
    return adjoint, later_info, shared


def _add_noise(info: Array, i: int, var: Array) -> None:
    """Change information about a state after noise to that about the state before it.

    Parameters
    ----------
    info
        Information (M, n, n), changed in place.
    i
        The state that the noise is added to.
    var
        Variance of the noise (M, 1).

    Notes
    -----
    (info^-1 + Q)^-1 = info - x x' var / (1 + var x_i) with x the column i of ``info``. Column and
    row i become x / (1 + var x_i), which is no difference.
    """
    column = info[:, i].copy()
    remaining = column / (1.0 + var * column[:, i, None])
    info -= (var * remaining)[:, :, None] * column[:, None, :]
    info[:, i] = remaining
    info[:, :, i] = remaining


def _with_information(cov: Array, info: Array) -> Array:
    """Covariance (cov^-1 + info)^-1 (..., n, n) as a sum of squares.

    Parameters
    ----------
    cov, info
        Covariance and further information (..., n, n), positive semidefinite but for rounding.

    Notes
    -----
    With cov = C C' it is C (I + C' info C)^-1 C', where the matrix that is inverted has no
    eigenvalue below one: what is determined keeps its relative accuracy beside what is not.
    """
    factor = _lower_factor(cov, 0.0)
    gained = factor.swapaxes(-1, -2) @ info @ factor + np.eye(cov.shape[-1])
    lower = np.moveaxis(_lower_factor(gained, 1.0), (-2, -1), (0, 1))
    root = np.moveaxis(factor, (-1, -2), (0, 1)).copy()
    for i in range(len(root)):  # root = lower^-1 C'
        root[i] -= sum(lower[i, k] * root[k] for k in range(i))
        root[i] /= lower[i, i]
    root = np.moveaxis(root, (0, 1), (-2, -1))
    return np.asarray(root.swapaxes(-1, -2) @ root)


def _lower_factor(matrix: Array, least: float) -> Array:
    """Lower Cholesky factor (..., n, n) of matrices none of whose pivots lies below ``least``.

    A pivot that does is the work of rounding. It becomes ``least``, and with it zero the column is
    zero: that component follows from those before it.
    """
    factor = np.moveaxis(matrix, (-2, -1), (0, 1)).copy()  # fast for many small matrices
    for i in range(len(factor)):
        root = np.sqrt(np.maximum(factor[i, i], least))
        factor[i, i] = root
        factor[i, i + 1 :] = 0.0
        factor[i + 1 :, i] /= np.where(root > 0, root, np.inf)
        for j in range(i + 1, len(factor)):
            factor[j:, j] -= factor[j:, i] * factor[j, i]
    return np.asarray(np.moveaxis(factor, (0, 1), (-2, -1)))


def _run_ends(model: IntervalModel) -> NDArray[np.intp]:
    """Last interval (J,) of the run of equal intervals that each interval belongs to.

    Intervals are equal if they have one kind, and information and added variance differ by less
    than ``EQUAL_TOLERANCE`` from those of the first interval of the run.
    """
    count = len(model.kind)
    features = np.concatenate(
        [model.information[:, :, 0].reshape(count, -1), model.jump_var[:, :, 0].reshape(count, -1)],
        axis=1,
    )
    size = np.maximum(np.abs(features), 1e-300)
    changes = np.ones(count, dtype=bool)
    other_kind = model.kind[1:] != model.kind[:-1]
    other_values = (np.abs(np.diff(features, axis=0)) > EQUAL_TOLERANCE * size[1:]).any(axis=1)
    changes[1:] = other_kind | other_values
    ends = np.arange(count)
    for a, b in pairwise([*np.flatnonzero(changes).tolist(), count]):
        while b - a > 1:  # a slow drift ends the run where it is too far from its first interval
            differs = (np.abs(features[a:b] - features[a]) > EQUAL_TOLERANCE * size[a]).any(axis=1)
            stop = a + int(np.argmax(differs)) if differs.any() else b
            ends[a:stop] = stop - 1
            a = stop
    return ends


def recursion(phi: Array, driven: Array) -> Array:
    """Solve x_j = phi x_{j-1} + driven_j with x_{-1} = 0 by doubling.

    Parameters
    ----------
    phi
        Constant matrix (M, n, n) of each channel.
    driven
        Driving vectors (L, M, n).

    Returns
    -------
    Array
        Solution x (L, M, n).

    Notes
    -----
    The doubling ends where phi^k falls below 1e-18, which no sum of doubles can show.

    Examples
    --------
    >>> recursion(np.array([[[0.5]]]), np.ones((4, 1, 1))).ravel().tolist()
    [1.0, 1.5, 1.75, 1.875]
    """
    x = np.ascontiguousarray(driven.swapaxes(0, 1))
    step = 1
    while step < x.shape[1] and np.abs(phi).max() > 1e-18:
        x[:, step:] += x[:, :-step] @ phi.swapaxes(-1, -2)
        phi = phi @ phi
        step = 2 * step
    return np.asarray(x.swapaxes(0, 1))


def _matrix_vector(matrix: Array, vectors: Array) -> Array:
    """Products of matrices (..., M, n, n) and vectors (..., M, n)."""
    return np.asarray((matrix @ vectors[..., None])[..., 0])


def _are_settled(a: Array, b: Array) -> bool:
    """Whether covariances (M, n, n) agree within ``SETTLED_CHANGE`` of their standard deviations.

    The standard deviations are those of ``a``.
    """
    size = np.sqrt(np.abs(np.diagonal(a, axis1=-2, axis2=-1)))
    return bool(np.all(np.abs(a - b) <= SETTLED_CHANGE * size[..., :, None] * size[..., None, :]))
