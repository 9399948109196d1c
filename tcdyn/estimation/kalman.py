"""Kalman filter, likelihood and smoother of a linear Gaussian model, sample by sample.

Each step between two points has its own length, transition and process noise; each point may have
a reading with its own variance, or none. All covariances and informations are kept as square roots
that are updated by orthogonal transformations, so that every variance is a sum of squares. They are
not computed again while nothing changes.

The model, for the states x of n numbers at the points p:

    x[p+1] = F x[p] + w,  w ~ N(0, level N1 + slope N2 + D diag(jump) D'),  y[p] = h x[p] + noise

F, N1 and N2 belong to the kind of the step; the columns of D are the first two unit vectors and
the direction of a step of the reading. Used by :mod:`tcdyn.smoothing.state_space`. Guarded by
``tests/estimation/test_kalman.py``, which compares with dense algebra in extended precision.

Source of the array algorithms: T. Kailath, A. H. Sayed and B. Hassibi, "Linear Estimation",
Prentice Hall 2000, chapters 12 and 16.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array, Flags
from tcdyn.estimation.compiled import compiled

# Points whose filter is stored at once. The smoother filters each block again on its way back, so
# that its memory does not grow with the states of the record. A matter of memory only.
BLOCK = 65536
# Relative change of a covariance from one point to the next below which it counts as settled. The
# rest of its change is this over the share that it loses at each point: 1e-10 of 10,000 points.
SETTLED = 1e-12
# Square of the rest of a row over that of its diagonal below which the row is triangular: the rest
# is 1e-30 of the diagonal, far below rounding. With a smaller one a reflection may underflow.
NEGLIGIBLE = 1e-60


class PointModel(NamedTuple):
    """A model on P points, K kinds of steps between them, n states.

    Parameters
    ----------
    transition
        Matrix F of each kind of step (K, n, n).
    level_noise, slope_noise
        Covariances N1 and N2 of each kind of step (K, n, n) for noise of intensity one.
    kind
        Kind of the step from each point to the next (P,); that of the last point is not used.
    level, slope
        Intensities of the noise of that step (P,).
    jump
        Variances (P, 4) of jumps at the end of that step: of the first state, of the second, of
        all states along ``direction``, and along ``impulse``.
    direction
        Jump (n,) of the states that is a step of the reading by one.
    impulse
        Jump (n,) of the states that an impulse of the first one makes, per area.
    row
        The row h (n,).
    reading, variance
        Reading of each point and its variance (P,); a variance of zero means that there is none.
    mean, factor
        Mean (n,) of the states at the first point before its reading, and a lower triangular
        square root (n, n) of their covariance.
    is_mark
        Points (P,) between which the change of the first state is wanted.
    period
        Number of points after which the steps usually repeat: 1, or 2 where points of two kinds
        alternate. Covariances are settled when they repeat, too.
    """

    transition: Array
    level_noise: Array
    slope_noise: Array
    kind: NDArray[np.int64]
    level: Array
    slope: Array
    jump: Array
    direction: Array
    impulse: Array
    row: Array
    reading: Array
    variance: Array
    mean: Array
    factor: Array
    is_mark: Flags
    period: int = 1


class Smoothing(NamedTuple):
    """States of a model given all its readings; each array (P,) or (P, k).

    Parameters
    ----------
    mean
        Mean of the first two states (P, 2).
    covariance
        Variance of the first, their covariance, and variance of the second (P, 3).
    extra
        Products (P, E) of further rows with the mean.
    predicted, predicted_var
        Predicted reading without noise h x, and its variance.
    change_var
        Variance (P, 2) of the change of the first state from each mark to the next, and to the one
        after that; zero at other points.
    score
        Adjoint of the jumps (P, 3): the derivative of the log likelihood with respect to a jump of
        the first state, of the second, or along ``direction``, before the point.
    score_var
        Variance of the first, covariance, variance of the second, variance of the third (P, 4).
    gradient, expected
        For level and slope noise of the step before a point (P, 2): q' N q and trace(N W), with the
        adjoint q and its covariance W. Half of their difference is the derivative of the log
        likelihood with respect to the intensity.
    """

    mean: Array
    covariance: Array
    extra: Array
    predicted: Array
    predicted_var: Array
    change_var: Array
    score: Array
    score_var: Array
    gradient: Array
    expected: Array


@compiled
def _triangularise(a: Array, count: int, rows: int, columns: int, next_column: int) -> None:
    """Make the first rows of an array lower triangular by an orthogonal matrix from the right.

    ``a @ a.T`` does not change. The diagonal becomes positive or zero (Householder reflections).

    Parameters
    ----------
    a
        Array; its first ``count`` rows and ``columns`` are used, and changed in place.
    count
        Number of rows.
    rows
        Number of rows that become triangular.
    columns
        Number of columns, at least ``rows``.
    next_column
        A row has zeros between its diagonal and this column; zero where that is not known.
    """
    for i in range(rows):
        after = max(i + 1, next_column)
        rest = 0.0
        for j in range(after, columns):
            rest += a[i, j] * a[i, j]
        head = a[i, i]
        if rest <= NEGLIGIBLE * head * head:
            for j in range(after, columns):
                a[i, j] = 0.0
            if head < 0.0:
                for k in range(i, count):
                    a[k, i] = -a[k, i]
            continue
        norm = np.sqrt(head * head + rest)
        v = -rest / (head + norm) if head > 0.0 else head - norm
        scale = 2.0 * v * v / (rest + v * v)
        inverse = 1.0 / v
        for j in range(after, columns):
            a[i, j] *= inverse
        for k in range(i + 1, count):
            product = a[k, i]
            for j in range(after, columns):
                product += a[k, j] * a[i, j]
            product *= scale
            a[k, i] -= product
            for j in range(after, columns):
                a[k, j] -= product * a[i, j]
        a[i, i] = norm
        for j in range(after, columns):
            a[i, j] = 0.0


@compiled
def _copy(source: Array, target: Array) -> None:
    """Copy the numbers of a matrix."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@compiled
def _copy_vector(source: Array, target: Array) -> None:
    """Copy the numbers of a vector."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled
def _clear(target: Array) -> None:
    """Set all numbers of a matrix to zero."""
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[i, j] = 0.0


@compiled
def _cholesky(a: Array, n: int) -> None:
    """Lower Cholesky factor in place; a pivot that rounding made negative gives a zero column.

    Parameters
    ----------
    a
        Symmetric matrix; its first ``n`` rows and columns are used.
    n
        Size.
    """
    for i in range(n):
        pivot = a[i, i]
        for k in range(i):
            pivot -= a[i, k] * a[i, k]
        root = np.sqrt(pivot) if pivot > 1e-15 * a[i, i] else 0.0
        for j in range(i + 1, n):
            value = a[j, i]
            for k in range(i):
                value -= a[j, k] * a[i, k]
            a[j, i] = value / root if root > 0.0 else 0.0
        a[i, i] = root
        for j in range(i + 1, n):
            a[i, j] = 0.0


@compiled
def _is_same_step(model: PointModel, p: int, q: int) -> bool:
    """Whether two points have steps with the same transition and noise after them."""
    return bool(
        model.kind[p] == model.kind[q]
        and model.level[p] == model.level[q]
        and model.slope[p] == model.slope[q]
        and model.jump[p, 0] == model.jump[q, 0]
        and model.jump[p, 1] == model.jump[q, 1]
        and model.jump[p, 2] == model.jump[q, 2]
        and model.jump[p, 3] == model.jump[q, 3]
    )


@compiled
def _noise_factor(model: PointModel, p: int, out: Array) -> None:
    """Lower triangular square root (n, n) of the process noise of the step after a point."""
    n = len(out)
    kind = model.kind[p]
    for i in range(n):
        for j in range(n):
            out[i, j] = (
                model.level[p] * model.level_noise[kind, i, j]
                + model.slope[p] * model.slope_noise[kind, i, j]
            )
    out[0, 0] += model.jump[p, 0]
    out[1, 1] += model.jump[p, 1]
    if model.jump[p, 2] != 0.0 or model.jump[p, 3] != 0.0:
        for i in range(n):
            for j in range(n):
                of_direction = model.direction[i] * model.direction[j]
                of_impulse = model.impulse[i] * model.impulse[j]
                out[i, j] += model.jump[p, 2] * of_direction + model.jump[p, 3] * of_impulse
    _cholesky(out, n)


@compiled
def _is_settled(new: Array, old: Array, tolerance: float) -> bool:
    """Whether the rows of two triangular factors agree within a share of their lengths."""
    n = len(new)
    for i in range(n):
        difference = 0.0
        size = 0.0
        for j in range(i + 1):
            difference += abs(new[i, j] - old[i, j])
            size += abs(new[i, j])
        if difference > tolerance * size:
            return False
    return True


@compiled
def _filter_block(
    model: PointModel,
    repeats: Flags,
    first: int,
    last: int,
    mean: Array,
    factor: Array,
    slot_of: NDArray[np.int64],
    means: Array,
    factors: Array,
    noise_factors: Array,
    gains: Array,
    roots: Array,
    work: Array,
    tolerance: float,
) -> tuple[float, float]:
    """Filter some points, and store what the smoother needs.

    Parameters
    ----------
    model
        The model.
    repeats
        Its points that repeat the one before, see ``_repeats``.
    first, last
        First point, and one past the last.
    mean, factor
        Mean (n,) and square root (n, n) of the covariance at the first point before its reading;
        changed to those of the point ``last``.
    slot_of
        For each point the slot of ``factors``, ``noise_factors``, ``gains`` and ``roots`` with its
        values; several points that do not differ share one.
    means
        Predicted means (B, n).
    factors, noise_factors, gains, roots
        By slot: square roots of the predicted covariance and of the process noise of the step, gain
        (n,) of the next mean over the root of the innovation variance, and that root.
    work
        Array of at least (n + 1, 2 n + 1).
    tolerance
        See ``SETTLED``.

    Returns
    -------
    log_roots, chi2
        Sum of the logarithms of the standard deviations of the innovations, and of the squares of
        the innovations over their variance.
    """
    n = len(mean)
    log_roots = 0.0
    chi2 = 0.0
    used = 0
    is_repeated = False
    log_slot = -1
    log_root = 0.0
    end = len(model.kind) - 1
    predicted = np.empty(n)
    for p in range(first, last):
        k = p - first
        before = k - model.period
        kind = model.kind[p]
        present = model.variance[p] > 0.0
        may_repeat = before >= 0 and repeats[p]
        if may_repeat and (is_repeated or _is_settled(factor, factors[slot_of[before]], tolerance)):
            slot = slot_of[before]
            slot_of[k] = slot
            is_repeated = True
        else:
            if is_repeated:  # the factor after the last point is that after the point it repeats
                _copy(factors[slot_of[before]], factor)
            slot = used
            slot_of[k] = slot
            used += 1
            is_repeated = False
            if p == end:
                _clear(noise_factors[slot])
            elif before >= 0 and _is_same_step(model, p, first + before):
                _copy(noise_factors[slot_of[before]], noise_factors[slot])
            else:
                _noise_factor(model, p, noise_factors[slot])
            _copy(factor, factors[slot])
            o = 1 if present else 0
            _clear(work)
            if present:
                work[0, 0] = np.sqrt(model.variance[p])
                for j in range(n):
                    value = 0.0
                    for i in range(j, n):
                        value += model.row[i] * factor[i, j]
                    work[0, 1 + j] = value
            for i in range(n):
                for j in range(n):
                    value = 0.0
                    for m in range(j, n):
                        value += model.transition[kind, i, m] * factor[m, j]
                    work[o + i, o + j] = value
                    work[o + i, o + n + j] = noise_factors[slot, i, j]
            _triangularise(work, n + o, n + o, 2 * n + o, 0)
            roots[slot] = work[0, 0] if present else 0.0
            for i in range(n):
                gains[slot, i] = work[1 + i, 0] if present else 0.0
                for j in range(n):
                    factor[i, j] = work[o + i, o + j]
        scaled = 0.0
        innovation = model.reading[p]
        for i in range(n):
            means[k, i] = mean[i]
            innovation -= model.row[i] * mean[i]
        if present:
            scaled = innovation / roots[slot]
            if slot != log_slot:
                log_slot = slot
                log_root = np.log(roots[slot])
            log_roots += log_root
            chi2 += scaled * scaled
        for i in range(n):
            value = gains[slot, i] * scaled
            for j in range(n):
                value += model.transition[kind, i, j] * mean[j]
            predicted[i] = value
        for i in range(n):
            mean[i] = predicted[i]
    if is_repeated:
        _copy(factors[slot_of[last - first - model.period]], factor)
    return log_roots, chi2


@compiled
def _filter_to(
    model: PointModel, repeats: Flags, count: int, mean: Array, factor: Array, tolerance: float
) -> tuple[float, float]:
    """Filter the first ``count`` points; ``mean`` and ``factor`` become those of the next point.

    The other parameters and the results are those of ``_filter_block``.
    """
    n = len(mean)
    block = max(min(BLOCK, count), 1)
    slot_of = np.empty(block, dtype=np.int64)
    means = np.empty((block, n))
    factors = np.empty((block, n, n))
    noise_factors = np.empty((block, n, n))
    gains = np.empty((block, n))
    roots = np.empty(block)
    work = np.empty((n + 1, 2 * n + 1))
    log_roots = 0.0
    chi2 = 0.0
    for first in range(0, count, block):
        last = min(first + block, count)
        sums = _filter_block(
            model, repeats, first, last, mean, factor, slot_of, means, factors, noise_factors,
            gains, roots, work, tolerance,
        )  # fmt: skip
        log_roots += sums[0]
        chi2 += sums[1]
    return log_roots, chi2


@compiled
def _solve_lower(lower: Array, n: int, b: Array) -> None:
    """Solve lower x = b in place, for a lower triangular matrix of size n."""
    for i in range(n):
        value = b[i]
        for k in range(i):
            value -= lower[i, k] * b[k]
        b[i] = value / lower[i, i]


@compiled
def _solve_upper(lower: Array, n: int, b: Array) -> None:
    """Solve lower' x = b in place, for a lower triangular matrix of size n."""
    for i in range(n - 1, -1, -1):
        value = b[i]
        for k in range(i + 1, n):
            value -= lower[k, i] * b[k]
        b[i] = value / lower[i, i]


@compiled
def _product(factor: Array, information: Array, out: Array) -> None:
    """G = T'S (n, n) of two lower triangular square roots S and T."""
    n = len(out)
    for i in range(n):
        for j in range(n):
            value = 0.0
            for k in range(max(i, j), n):
                value += information[k, i] * factor[k, j]
            out[i, j] = value


@compiled
def _factor_of_gram(matrix: Array, transposed: bool, out: Array) -> None:
    """Lower triangular square root of I + M'M, or of I + M M' if ``transposed``.

    The rows of (I, M') or (I, M) are made triangular, so that the identity is not lost beside a
    large M.
    """
    n = len(out)
    work = np.zeros((n, 2 * n))
    for i in range(n):
        work[i, i] = 1.0
        for j in range(n):
            work[i, n + j] = matrix[i, j] if transposed else matrix[j, i]
    _triangularise(work, n, n, 2 * n, n)
    for i in range(n):
        for j in range(n):
            out[i, j] = work[i, j]


@compiled
def _row_times_factor(row: Array, factor: Array, out: Array) -> None:
    """S'h (n,) of a row h and a lower triangular square root S."""
    n = len(row)
    for j in range(n):
        value = 0.0
        for i in range(j, n):
            value += row[i] * factor[i, j]
        out[j] = value


@compiled
def _state_moments(
    factor: Array,
    product: Array,
    lower: Array,
    rows: Array,
    moments: Array,
    row_map: Array,
    solved: Array,
) -> None:
    """Variances of functions of the states of a point given all readings, and the map to them.

    Parameters
    ----------
    factor
        Square root S of the predicted covariance.
    product, lower
        G and the square root of I + G'G, see ``_product``.
    rows
        Rows (R, n) of the functions; the first three are both first states and the reading.
    moments
        Its first 4 numbers become variance, covariance and variance of the first two functions, and
        the variance of the third.
    row_map
        Becomes the matrix (R, n) from e = d - T'm to the functions less those of m.
    solved
        Array (R, n) for work.

    Notes
    -----
    The covariance is S (I + G'G)^-1 S', and the mean m + S (I + G'G)^-1 G'e. The matrix that is
    inverted has no eigenvalue below one.
    """
    n = len(factor)
    for f in range(len(rows)):
        _row_times_factor(rows[f], factor, solved[f])
        _solve_lower(lower, n, solved[f])
    for i in range(4):
        moments[i] = 0.0
    for i in range(n):
        moments[0] += solved[0, i] * solved[0, i]
        moments[1] += solved[0, i] * solved[1, i]
        moments[2] += solved[1, i] * solved[1, i]
        moments[3] += solved[2, i] * solved[2, i]
    for f in range(len(rows)):
        _solve_upper(lower, n, solved[f])
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += product[i, j] * solved[f, j]
            row_map[f, i] = value


@compiled
def _score_moments(
    product: Array,
    information: Array,
    level_noise: Array,
    slope_noise: Array,
    direction: Array,
    moments: Array,
    score_map: Array,
    lower: Array,
) -> None:
    """Variances of the adjoint of a point, and the map to it.

    Parameters
    ----------
    product
        The matrix G, see ``_product``.
    information
        Square root T of the information of the readings from the point on.
    level_noise, slope_noise
        Covariances N1 and N2 of the step before the point.
    direction
        Direction (n,) of a step of the reading.
    moments
        Its numbers 4 to 9 become variance, covariance and variance of the first two adjoints,
        trace(N1 W), trace(N2 W), and the variance of the adjoint along ``direction``.
    score_map
        Becomes the matrix (n, n) from e = d - T'm to the adjoint.
    lower
        Array (n, n) for work.

    Notes
    -----
    The adjoint is T (I + G G')^-1 e, and its covariance W = T (I + G G')^-1 T'.
    """
    n = len(product)
    _factor_of_gram(product, True, lower)
    for i in range(n):
        for j in range(n):
            score_map[i, j] = information[i, j]
        _solve_lower(lower, n, score_map[i])
    moments[7] = 0.0
    moments[8] = 0.0
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(n):
                value += score_map[i, k] * score_map[j, k]
            twice = value if i == j else 2.0 * value
            moments[7] += twice * level_noise[i, j]
            moments[8] += twice * slope_noise[i, j]
            if i < 2:
                moments[4 + i + j] = value
    moments[9] = 0.0
    for k in range(n):
        value = 0.0
        for i in range(n):
            value += direction[i] * score_map[i, k]
        moments[9] += value * value
    for i in range(n):
        _solve_upper(lower, n, score_map[i])


@compiled
def _carry_back(
    transition: Array, noise_factor: Array, work: Array, coefficients: Array, solved: Array
) -> float:
    """Carry a linear function of the state after a step back to the state before it.

    Parameters
    ----------
    transition
        The matrix F of the step.
    noise_factor
        Square root L of its process noise.
    work
        Triangular square root ((X, 0), (Y, Z)) of the information about the noise of the step and
        the state before it, see ``_backward_step``.
    coefficients
        Coefficients a (n,) of the state after the step; changed to those of the state before it.
    solved
        Array (n,) for work.

    Returns
    -------
    float
        Variance of the part that depends on the noise of the step alone.

    Notes
    -----
    With the noise L v and u = X^-1 L'a the variance is u'u, and F'a - Y u remains of the state.
    """
    n = len(coefficients)
    _row_times_factor(coefficients, noise_factor, solved)
    variance = 0.0
    for i in range(n):
        value = solved[i]
        for k in range(i):
            value -= work[i, k] * solved[k]
        solved[i] = value / work[i, i]
        variance += solved[i] * solved[i]
    moved = np.zeros(n)
    for i in range(n):
        for k in range(n):
            moved[i] += transition[k, i] * coefficients[k] - work[n + i, k] * solved[k]
    _copy_vector(moved, coefficients)
    return variance


@compiled
def _change_var(
    factor: Array, lower: Array, coefficients: Array, change_row: Array, solved: Array
) -> float:
    """Variance of a function of the state less that of ``change_row``, given all readings.

    Parameters
    ----------
    factor
        Square root S of the predicted covariance.
    lower
        Cholesky factor of I + G'G, see ``_product``.
    coefficients
        Coefficients (n,) of the function.
    change_row
        Coefficients (n,) that are taken off.
    solved
        Array (n,) for work.
    """
    n = len(coefficients)
    for i in range(n):
        solved[i] = coefficients[i] - change_row[i]
    _row_times_factor(solved.copy(), factor, solved)
    _solve_lower(lower, n, solved)
    variance = 0.0
    for i in range(n):
        variance += solved[i] * solved[i]
    return variance


@compiled
def _backward_step(
    transition: Array,
    noise_factor: Array,
    row: Array,
    variance: float,
    information: Array,
    sides: Array,
    work: Array,
) -> None:
    """Square root of the information about the noise of a step and the state before it.

    Parameters
    ----------
    transition
        The matrix F of the step.
    noise_factor
        Square root L of its process noise.
    row, variance
        Row and variance of the reading before the step; a variance of zero means that there is
        none.
    information
        Square root T of the information of the readings after the step.
    sides
        Right-hand sides (k, n + 1): numbers d with T'x = d + white noise of the readings after the
        step, and the reading before it over its standard deviation.
    work
        Array of at least (2 n + k, 2 n + 1). Its rows become ((X, 0), (Y, Z)), and below them the
        right-hand sides.

    Notes
    -----
    The information about noise v and state x is ((I + L'TT'L, L'TT'F), (F'TT'L, F'TT'F + h'h /
    variance)). Z is the square root of what is left about x alone.
    """
    n = len(row)
    _clear(work)
    for i in range(n):
        work[i, i] = 1.0
        for j in range(n):
            noise = 0.0
            state = 0.0
            for m in range(j, n):
                noise += noise_factor[m, i] * information[m, j]
                state += transition[m, i] * information[m, j]
            work[i, n + j] = noise
            work[n + i, n + j] = state
    if variance > 0.0:
        root = np.sqrt(variance)
        for i in range(n):
            work[n + i, 2 * n] = row[i] / root
    for k in range(len(sides)):
        for j in range(n + 1):
            work[2 * n + k, n + j] = sides[k, j]
    _triangularise(work, 2 * n + len(sides), 2 * n, 2 * n + 1, n)


@compiled
def _smooth(
    model: PointModel,
    repeats: Flags,
    rows: Array,
    change_row: Array,
    may_share: bool,
    noise_roots: Array,
    with_scores: bool,
    tolerance: float,
    values: Array,
    adjoints: Array,
    gradient: Array,
    moments: Array,
    change_var: Array,
) -> None:
    """Smoother; fills the arrays from ``values`` on.

    Parameters
    ----------
    model
        The model.
    repeats
        Its points that repeat the one before, see ``_repeats``.
    rows
        Rows (R, n) of functions of the states, see ``_state_moments``.
    change_row
        Row (n,) of the function whose change from mark to mark is wanted.
    may_share
        Whether points that do not differ may share what was computed for one of them. They may
        not where marks are rarer than points: the change since a mark differs.
    noise_roots
        Lower triangular square roots of N1 and N2 of each kind of step (2, K, n, n).
    with_scores
        Whether adjoints, their variances and changes are wanted.
    tolerance
        See ``SETTLED``.
    values
        Array (P, R): the functions.
    adjoints, gradient, change_var
        Arrays (P, 3), (P, 2) and (P, 2), see ``Smoothing``.
    moments
        Array (P, 10), see ``_state_moments`` and ``_score_moments``.

    Notes
    -----
    The filter runs forward and keeps its state at the first point of each block. On the way back
    each block but the last is filtered again. Backward, the readings from a point on are summed up
    as T'x = d + white noise of variance one, see ``_backward_step``.
    """
    n = len(model.mean)
    count = len(model.kind)
    n_rows = len(rows)
    block = min(BLOCK, count)
    n_blocks = (count + block - 1) // block
    start_means = np.empty((n_blocks, n))
    start_factors = np.empty((n_blocks, n, n))
    mean = model.mean.copy()
    factor = model.factor.copy()
    slot_of = np.empty(block, dtype=np.int64)
    means = np.empty((block, n))
    factors = np.empty((block, n, n))
    noise_factors = np.empty((block, n, n))
    gains = np.empty((block, n))
    roots = np.empty(block)
    work = np.empty((2 * n + n + 1, 2 * n + 1))
    for b in range(n_blocks):
        _copy_vector(mean, start_means[b])
        _copy(factor, start_factors[b])
        last = min((b + 1) * block, count)
        _filter_block(
            model, repeats, b * block, last, mean, factor, slot_of, means, factors, noise_factors,
            gains, roots, work, tolerance,
        )  # fmt: skip
    # of the last point of each phase: what the next point of that phase may share
    period = model.period
    informations = np.zeros((period, n, n))  # T
    row_maps = np.zeros((period, n_rows, n))
    score_maps = np.zeros((period, n, n))
    is_repeated = np.zeros(period, dtype=np.bool_)
    propagations = np.zeros((period, n + 1, n))  # of d and the reading to the d of the point before
    has_propagation = np.zeros(period, dtype=np.bool_)
    functions = np.zeros((period, 2, n))  # of the states: the wanted one at the next two marks
    function_vars = np.zeros((period, 2))
    new_information = np.zeros((n, n))
    product = np.zeros((n, n))  # G
    lower = np.zeros((n, n))
    other_lower = np.zeros((n, n))
    solved_rows = np.zeros((n_rows, n))
    side = np.zeros((1, n + 1))  # d, and the reading over its standard deviation
    identity = np.zeros((n + 1, n + 1))
    for i in range(n + 1):
        identity[i, i] = 1.0
    residual = np.empty(n)
    solved = np.empty(n)
    q = np.empty(n)
    for b in range(n_blocks - 1, -1, -1):
        first = b * block
        last = min(first + block, count)
        if b < n_blocks - 1:
            _copy_vector(start_means[b], mean)
            _copy(start_factors[b], factor)
            _filter_block(
                model, repeats, first, last, mean, factor, slot_of, means, factors, noise_factors,
                gains, roots, work, tolerance,
            )  # fmt: skip
        for phase in range(period):
            is_repeated[phase] = False
        for p in range(last - 1, first - 1, -1):
            k = p - first
            slot = slot_of[k]
            phase = p % period
            next_phase = (p + 1) % period
            later = k + period
            kind_before = model.kind[max(p - 1, 0)]
            read = 0.0
            if model.variance[p] > 0.0:
                read = model.reading[p] / np.sqrt(model.variance[p])
            # the change over two marks depends on the steps of two periods
            shares = (
                may_share
                and is_repeated[next_phase]
                and k > 0
                and first + later + period < last
                and slot == slot_of[later]
                and slot == slot_of[later + period]
                and slot_of[k - 1] == slot_of[later - 1]
                and model.is_mark[p] == model.is_mark[p + period]
            )
            if shares:
                if not has_propagation[phase]:
                    _backward_step(
                        model.transition[model.kind[p]], noise_factors[slot], model.row,
                        model.variance[p], informations[next_phase], identity, work,
                    )  # fmt: skip
                    for i in range(n + 1):
                        for j in range(n):
                            propagations[phase, i, j] = work[2 * n + i, n + j]
                    has_propagation[phase] = True
                for j in range(n):
                    q[j] = read * propagations[phase, n, j]
                for i in range(n):
                    value = side[0, i]
                    for j in range(n):
                        q[j] += value * propagations[phase, i, j]
                for j in range(n):
                    side[0, j] = q[j]
                for i in range(10):
                    moments[p, i] = moments[p + period, i]
                if with_scores:
                    change_var[p, 0] = change_var[p + period, 0]
                    change_var[p, 1] = change_var[p + period, 1]
                is_repeated[phase] = True
            else:
                # the last point has a step without transition and noise, and nothing is known
                # after it
                transition = model.transition[model.kind[p]]
                information = informations[phase]
                row_map = row_maps[phase]
                score_map = score_maps[phase]
                has_propagation[phase] = False
                side[0, n] = read
                _backward_step(
                    transition, noise_factors[slot], model.row, model.variance[p],
                    informations[next_phase], side, work,
                )  # fmt: skip
                for i in range(n):
                    side[0, i] = work[2 * n, n + i]
                    for j in range(n):
                        new_information[i, j] = work[n + i, n + j]
                is_repeated[phase] = _is_settled(new_information, information, tolerance)
                _copy(new_information, information)
                _product(factors[slot], information, product)
                _factor_of_gram(product, False, lower)
                _state_moments(
                    factors[slot], product, lower, rows, moments[p], row_map, solved_rows
                )
                if with_scores:
                    _score_moments(
                        product, information, model.level_noise[kind_before],
                        model.slope_noise[kind_before], model.direction, moments[p], score_map,
                        other_lower,
                    )  # fmt: skip
                    for f in range(2):
                        function_vars[phase, f] = function_vars[next_phase, f]
                        _copy_vector(functions[next_phase, f], functions[phase, f])
                        function_vars[phase, f] += _carry_back(
                            transition, noise_factors[slot], work, functions[phase, f], solved
                        )
                        if model.is_mark[p]:
                            change_var[p, f] = function_vars[phase, f] + _change_var(
                                factors[slot], lower, functions[phase, f], change_row, solved
                            )
                    if model.is_mark[p]:
                        function_vars[phase, 1] = function_vars[phase, 0]
                        function_vars[phase, 0] = 0.0
                        for i in range(n):
                            functions[phase, 1, i] = functions[phase, 0, i]
                            functions[phase, 0, i] = change_row[i]
            for i in range(n):
                residual[i] = side[0, i]
            for j in range(n):
                value = means[k, j]
                for i in range(j + 1):
                    residual[i] -= informations[phase, j, i] * value
            for f in range(n_rows):
                value = 0.0
                for i in range(n):
                    value += rows[f, i] * means[k, i] + row_maps[phase, f, i] * residual[i]
                values[p, f] = value
            if with_scores:
                for i in range(n):
                    value = 0.0
                    for j in range(n):
                        value += score_maps[phase, i, j] * residual[j]
                    q[i] = value
                adjoints[p, 0] = q[0]
                adjoints[p, 1] = q[1]
                adjoints[p, 2] = 0.0
                for i in range(n):
                    adjoints[p, 2] += model.direction[i] * q[i]
                for f in range(2):
                    total = 0.0
                    for j in range(n):
                        value = 0.0
                        for i in range(j, n):
                            value += noise_roots[f, kind_before, i, j] * q[i]
                        total += value * value
                    gradient[p, f] = total


@compiled
def _level_covariance(
    model: PointModel, repeats: Flags, first: int, last: int, tolerance: float, out: Array
) -> None:
    """Covariance of the first state at some points given all readings; fills ``out`` (c, c).

    Parameters
    ----------
    model
        The model; the points of the window are within one ``BLOCK`` of it.
    repeats
        Its points that repeat the one before, see ``_repeats``.
    first, last
        First point of the window, and one past the last.
    tolerance
        See ``SETTLED``.
    out
        Array (c, c) for the c points.

    Notes
    -----
    C(j, k) = P_j A' (I - W_k P_k) for j <= k, with the product A of the closed loops F - F K h from
    j to k, the predicted covariance P and the covariance W of the adjoint.
    """
    n = len(model.mean)
    count = len(model.kind)
    slot_of = np.empty(count, dtype=np.int64)
    means = np.empty((count, n))
    factors = np.empty((count, n, n))
    noise_factors = np.empty((count, n, n))
    gains = np.empty((count, n))
    roots = np.empty(count)
    work = np.empty((2 * n + 1, 2 * n + 1))
    _filter_block(
        model, repeats, 0, count, model.mean.copy(), model.factor.copy(), slot_of, means, factors,
        noise_factors, gains, roots, work, tolerance,
    )  # fmt: skip
    information = np.zeros((n, n))
    product = np.zeros((n, n))
    lower = np.empty((n, n))
    side = np.zeros((0, n + 1))
    column = np.empty(n)
    moved = np.empty(n)
    rest = np.empty(n)
    for p in range(count - 1, first - 1, -1):
        slot = slot_of[p]
        _backward_step(
            model.transition[model.kind[p]], noise_factors[slot], model.row, model.variance[p],
            information, side, work,
        )  # fmt: skip
        for i in range(n):
            for j in range(n):
                information[i, j] = work[n + i, n + j]
        if p >= last:
            continue
        # the column (I - W P) e of this point: e - T (I + G G')^-1 G S'e
        _product(factors[slot], information, product)
        _factor_of_gram(product, True, lower)
        for i in range(n):
            rest[i] = 0.0
            for j in range(n):
                rest[i] += product[i, j] * factors[slot, 0, j]
        _solve_lower(lower, n, rest)
        _solve_upper(lower, n, rest)
        for i in range(n):
            column[i] = 1.0 if i == 0 else 0.0
            for j in range(i + 1):
                column[i] -= information[i, j] * rest[j]
        for j in range(p, first - 1, -1):
            slot = slot_of[j]
            if j < p:  # back through the closed loop of the step after point j
                transition = model.transition[model.kind[j]]
                weight = 0.0
                if roots[slot] > 0.0:
                    for i in range(n):
                        weight -= gains[slot, i] * column[i] / roots[slot]
                for k in range(n):
                    moved[k] = model.row[k] * weight
                    for i in range(n):
                        moved[k] += transition[i, k] * column[i]
                _copy_vector(moved, column)
            value = 0.0
            for k in range(n):
                of_factor = 0.0
                for i in range(k, n):
                    of_factor += factors[slot, i, k] * column[i]
                value += factors[slot, 0, k] * of_factor
            out[j - first, p - first] = value
            out[p - first, j - first] = value


def _repeats(model: PointModel) -> Flags:
    """Points (P,) that have step and reading variance of those one period before."""
    count = len(model.kind)
    out = np.zeros(count, dtype=bool)
    now = slice(model.period, count - 1)
    before = slice(0, max(count - 1 - model.period, 0))
    out[now] = (
        (model.kind[now] == model.kind[before])
        & (model.level[now] == model.level[before])
        & (model.slope[now] == model.slope[before])
        & (model.jump[now] == model.jump[before]).all(axis=1)
        & (model.variance[now] == model.variance[before])
    )
    return out


def log_likelihood(model: PointModel, tolerance: float = SETTLED) -> tuple[float, float]:
    """Log likelihood of the readings of a model.

    Parameters
    ----------
    model
        The model.
    tolerance
        See ``SETTLED``.

    Returns
    -------
    value
        Log likelihood, without the constant -n/2 log(2 pi) of n readings.
    chi2
        Sum of the squares of the innovations over their variance.
    """
    log_roots, chi2 = _filter_to(
        model, _repeats(model), len(model.kind), model.mean.copy(), model.factor.copy(), tolerance
    )
    return -log_roots - 0.5 * chi2, chi2


def filtered_state(
    model: PointModel, point: int, tolerance: float = SETTLED
) -> tuple[Array, Array]:
    """Mean and covariance of the states at a point given the readings before it.

    Parameters
    ----------
    model
        The model.
    point
        The point.
    tolerance
        See ``SETTLED``.

    Returns
    -------
    mean
        Mean (n,).
    factor
        Lower triangular square root (n, n) of the covariance.
    """
    mean = model.mean.copy()
    factor = model.factor.copy()
    _filter_to(model, _repeats(model), point, mean, factor, tolerance)
    return mean, factor


def level_covariance(model: PointModel, first: int, last: int, tolerance: float = SETTLED) -> Array:
    """Covariance (c, c) of the first state at the points ``first`` to ``last`` - 1.

    Parameters
    ----------
    model
        The model.
    first, last
        First point of the window, and one past the last.
    tolerance
        See ``SETTLED``.
    """
    out = np.empty((last - first, last - first))
    _level_covariance(model, _repeats(model), first, last, tolerance, out)
    return out


def compile_functions() -> None:
    """Compile the functions of this module, if they are not stored yet.

    A process that starts worker processes calls it before, so that not each of them compiles.
    """
    count = 4
    model = PointModel(
        np.eye(2)[None],
        np.zeros((1, 2, 2)),
        np.zeros((1, 2, 2)),
        np.zeros(count, dtype=np.int64),
        np.zeros(count),
        np.zeros(count),
        np.zeros((count, 4)),
        np.array([1.0, 0.0]),
        np.zeros(2),
        np.array([1.0, 0.0]),
        np.zeros(count),
        np.ones(count),
        np.zeros(2),
        np.eye(2),
        np.ones(count, dtype=bool),
    )
    log_likelihood(model)
    filtered_state(model, 2)
    smooth_points(model)
    level_covariance(model, 0, count)


def root_of_sum(*roots: Array) -> Array:
    """Lower triangular square root (n, n) of a sum of covariances, from their square roots (n, k).

    Examples
    --------
    >>> root = root_of_sum(np.array([[3.0], [0.0]]), np.array([[4.0, 0.0], [0.0, 2.0]]))
    >>> root.round(12).tolist()
    [[5.0, 0.0], [0.0, 2.0]]
    """
    n = len(roots[0])
    work = np.ascontiguousarray(np.concatenate([*roots, np.zeros((n, n))], axis=1))
    _triangularise(work, n, n, work.shape[1], 0)
    return np.ascontiguousarray(work[:, :n])


def smooth_points(
    model: PointModel,
    extra_rows: Array | None = None,
    *,
    with_scores: bool = True,
    change_row: Array | None = None,
    tolerance: float = SETTLED,
) -> Smoothing:
    """States of a model given all its readings.

    Parameters
    ----------
    model
        The model.
    extra_rows
        Rows (E, n) whose products with the mean are wanted.
    with_scores
        Whether ``score``, ``score_var``, ``gradient``, ``expected`` and ``change_var`` are wanted;
        else they are not determined.
    change_row
        Row (n,) of the function of the states whose change between marks is wanted; None: the
        first state. With a row all points are computed, which takes longer.
    tolerance
        See ``SETTLED``.

    Returns
    -------
    Smoothing
        The states at all points.

    Examples
    --------
    A level with known noise, read four times:

    >>> one = np.eye(2)[None]
    >>> none = np.zeros((1, 2, 2))
    >>> kind = np.zeros(4, dtype=np.int64)
    >>> zero = np.zeros(4)
    >>> model = PointModel(
    ...     one, none, none, kind, zero, zero, np.zeros((4, 4)), np.array([1.0, 0.0]),
    ...     np.zeros(2), np.array([1.0, 0.0]), np.array([1.0, 2.0, 3.0, 2.0]), np.full(4, 4.0),
    ...     np.zeros(2), np.diag([1e6, 1.0]), np.ones(4, dtype=bool),
    ... )
    >>> result = smooth_points(model)
    >>> result.mean[:, 0].round(6).tolist(), result.covariance[0, 0].round(6)
    ([2.0, 2.0, 2.0, 2.0], np.float64(1.0))
    """
    count = len(model.kind)
    n = len(model.mean)
    rows = np.stack([*np.eye(n)[:2], model.row, *([] if extra_rows is None else extra_rows)])
    noises = np.stack([model.level_noise, model.slope_noise])
    noise_roots = noises.copy()
    for noise_root in noise_roots.reshape(-1, n, n):
        _cholesky(noise_root, n)
    values = np.empty((count, len(rows)))
    adjoints = np.empty((count, 3))
    gradient = np.empty((count, 2))
    change_var = np.zeros((count, 2))
    moments = np.empty((count, 10))
    of_change = np.eye(n)[0] if change_row is None else change_row
    _smooth(
        model,
        _repeats(model),
        rows,
        of_change,
        change_row is None,
        noise_roots,
        with_scores,
        tolerance,
        values,
        adjoints,
        gradient,
        moments,
        change_var,
    )
    gradient[0] = 0.0  # there is no step before the first point
    moments[0, 7:9] = 0.0
    return Smoothing(
        values[:, :2],
        moments[:, :3],
        values[:, 3:],
        values[:, 2],
        moments[:, 3],
        change_var,
        adjoints,
        moments[:, [4, 5, 6, 9]],
        gradient,
        moments[:, 7:9],
    )
