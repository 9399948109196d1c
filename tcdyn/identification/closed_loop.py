"""Closed-loop check: whether an input is computed from the output, as by a controller.

From such a record no plant can be identified. ``tcdyn.identification.fitting.fit`` and
``tcdyn.identification.comparison.compare`` call it. The thresholds come from
``tests/identify/closed_loop_study.py``; ``tests/identify/test_identify_closed_loop.py`` checks
loops that must be recognised and open loops that must not. Thermostats are recognised by
``tcdyn.identification.thermostat``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.estimation import orthonormal_basis
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.identification.iodata import IOData
from tcdyn.identification.segments import Segment, split_segments, true_intervals
from tcdyn.identification.thermostat import Thermostat, find_thermostat

# The thresholds come from simulated records of 100 to 1,000 samples: 7 controllers and 25 kinds of
# open loop, in tests/identify/closed_loop_study.py. Each comment gives the figures between which
# the threshold lies.

INPUT_LAGS = 8  # past values of the input from which the input is predicted
# poles of the filters that a controller may have on its measurement
FILTER_POLES = (0.5, 0.7, 0.85, 0.95)
# terms without an integral: the last three outputs and the filtered ones
PROPORTIONAL_TERMS = 3 + len(FILTER_POLES)
MIN_ROWS = 40  # rows of a record below which nothing can be decided
MIN_INTERVAL_ROWS = 10  # rows between two limits or set-point steps
# rows after a set-point step that are left out: the filters of a controller settle
SETTLING_ROWS = 15
# times that the extreme value of an input is repeated where it is a limit
MIN_LIMIT_REPEATS = 3
# innovation of the input that is a step of the set point, in robust standard deviations
STEP_SDS = 8.0
# share of the rows above which such innovations are no steps but the input's own distribution
MAX_STEP_SHARE = 1 / 30
# share of the input's innovation variance that the law leaves unexplained; noise-free loops 1e-8,
# noise of 10 % 0.3
MAX_UNEXPLAINED = 0.5
# F value of the integral term; white noise and open loops with white residuals at most 40
MIN_INTEGRAL_F = 60.0
# the same against the best leaky integral, which an inverted lead has: leads at most 53, loops 85
MIN_PURE_INTEGRAL_F = 60.0
MIN_LEAK_SAMPLES = 20.0  # time constant of a leaky integral; the filters above are shorter
# the same over the length of the record; slower leaks cannot be distinguished from none
MAX_LEAK_LENGTHS = 1.5
# ratio of the leaks from one to the next: close enough that no lead falls between two
LEAK_RATIO = 1.25
# ratio of the residual variances without and with the integral, for records of any length
MIN_INTEGRAL_RATIO = 1.2
# blocks of the record, in each of which the integral of an inexact law must explain something
BLOCKS = 4
# share of the explained variance in each block; a single transient leaves less in two of them
MIN_BLOCK_SHARE = 0.03
# autocorrelation of the law's residuals; of a chance fit to a slow drift it is above 0.8
MAX_AUTOCORRELATION = 0.75
# innovation of the input over its standard deviation; below, it is a smooth prescribed curve
MIN_RANDOMNESS = 1e-3
MAX_EXACT_UNEXPLAINED = 0.02  # unexplained share above which a law is not exact
# MIN_RANDOMNESS where the law is not exact; a noisy plunge has 0.05, loops 0.3 to 1
MIN_RANDOMNESS_NOISY = 0.08
PAST_LAGS = 10  # past values of input and output in the test for a delayed law
# share of the input's innovation variance that past outputs explain; open loops at most 0.27
MIN_PAST_SHARE = 0.6
# sum of squared correlations of the output's innovations with the next ones of the input; open
# loops at most 0.33
MIN_PAST_CORRELATION = 0.4
# squared singular value over the largest, below which a column is a combination of others
ROUNDING = 1e-13
# rows that are examined, of all segments together, so that long records cost no more
MAX_ROWS = 20_000


@dataclass(frozen=True)
class Rows:
    """One input and the output of a segment.

    Parameters
    ----------
    u, y
        Input and output (N,) in their units, gaps of the output interpolated linearly.
    is_measured
        Whether the output was measured here and at the ``PAST_LAGS`` samples before (N,).
    """

    u: Array
    y: Array
    is_measured: NDArray[np.bool_]


def check_closed_loop(data: IOData, where: str) -> tuple[Finding, ...]:
    """Raise an error where a controller has computed an input from the output.

    Parameters
    ----------
    data
        The record.
    where
        Record that the error names.

    Returns
    -------
    tuple of Finding
        Findings of inputs that a thermostat switches. They remain warnings, because the level at
        which the output switches the input moves with its noise only.

    Raises
    ------
    InputError
        Where :func:`closed_loop` finds another loop.
    """
    findings = closed_loop(data)
    loops = [f for f in findings if f.code == "record.closed_loop"]
    if loops:
        name = loops[0].subject
        output = data.output_names[0]
        raise InputError(
            f"the input {name} follows the output {output}: it is computed from it (closed loop)",
            where=where,
            expected="an input that does not depend on the output",
            remedy="record with the loop open (controller in manual), or add to the input a test "
            "signal that is larger than what the controller does (dither, steps); where no "
            "controller was active, check that the columns are not exchanged; with {check} it is "
            "a warning",
            parameters={"check": False},
        )
    return findings


def closed_loop(data: IOData) -> tuple[Finding, ...]:
    """A warning for each input that is computed from the output.

    Parameters
    ----------
    data
        One output, one or several inputs.

    Returns
    -------
    tuple of Finding
        ``record.closed_loop``, or ``record.thermostat`` with the readings at which the input is
        switched, with the input as its subject; empty for an open loop.

    Notes
    -----
    Two laws are tested.

    1. A controller with an integral term, u[k] = c + F(q) y[k] + K S[k] + n[k] with S the running
       sum of y. -1/C(s), which has no static gain, fits such a record as well as a plant does
       (Ljung, System Identification, 2nd ed. 1999, section 13.4).
    2. A law that uses past outputs only. The past output then predicts the input beyond the
       input's own past (Granger, Econometrica 37, 424, 1969), by the part that the input did not
       cause.

    An on/off input may be switched by a thermostat, which
    :func:`tcdyn.identification.thermostat.find_thermostat` recognises.

    A proportional law without delay is a static relation like any other and cannot be recognised
    from the data.

    The thresholds at the top of the module belong together: they separate the loops from the open
    loops of the study. After a change of one, run ``tests/identify/test_identify_closed_loop.py``.
    """
    if len(data.output_names) != 1:
        return ()
    output = data.output_names[0]
    segments = split_segments(data)
    total = sum(len(s.u) for s in segments)
    share = min(1.0, MAX_ROWS / max(total, 1))
    findings = []
    for k, name in enumerate(data.input_names):
        relay = thermostat_of(segments, k, share)
        if relay is not None:
            finding = warning(
                "record.thermostat",
                subject=name,
                output=output,
                off_at=relay.off_at,
                on_at=relay.on_at,
            )
            findings.append(finding)
            continue
        rows = [rows_of(s, k, int(np.ceil(share * len(s.u)))) for s in segments]
        rows = [r for r in rows if len(r.u) >= INPUT_LAGS + MIN_INTERVAL_ROWS]
        if integral_law(rows) or delayed_law(rows):
            findings.append(warning("record.closed_loop", subject=name, output=output))
    return tuple(findings)


def thermostat_of(segments: Sequence[Segment], k: int, share: float) -> Thermostat | None:
    """Return the thermostat that switches an input; None where there is none.

    Parameters
    ----------
    segments
        The record.
    k
        Number of the input.
    share
        Share of the rows of each segment that is examined, from its start.

    Returns
    -------
    Thermostat or None
        The thermostat.
    """
    pairs = []
    for segment in segments:
        count = int(np.ceil(share * len(segment.u)))
        pairs.append((segment.inputs[:count, k], segment.y[:count]))
    found = find_thermostat(pairs)
    return found if found is not None and found.is_named else None


def rows_of(segment: Segment, k: int, count: int) -> Rows:
    """Return the first rows of one input and of the output of a segment.

    Parameters
    ----------
    segment
        The segment.
    k
        Number of the input.
    count
        Number of rows.

    Returns
    -------
    Rows
        The rows.
    """
    u = segment.inputs[:count, k]
    measured = segment.measured[:count]
    times = np.arange(count)
    y = segment.filled_y[:count]
    n_missing = np.cumsum(np.append(0, ~measured))
    first = np.maximum(times - PAST_LAGS, 0)
    return Rows(u, y, n_missing[times + 1] == n_missing[first])


def integral_law(segments: Sequence[Rows]) -> bool:
    """Whether the input is an integral and proportional law of the output.

    Parameters
    ----------
    segments
        Rows of one input, a record for each segment.

    Returns
    -------
    bool
        False also where there are too few rows.
    """
    innovations = input_innovations(segments)
    if innovations is None:
        return False
    usable, input_innovation = innovations
    usable_innovation = np.concatenate([w[good] for good, w in zip(usable, input_innovation)])
    scale = MAD_TO_SD * float(np.median(np.abs(usable_innovation)))
    steps = [np.abs(w) > STEP_SDS * scale for w in input_innovation]
    n_steps = sum(int(step.sum()) for step in steps)
    if n_steps > MAX_STEP_SHARE * len(usable_innovation):
        steps = [np.zeros_like(step) for step in steps]
    level = float(np.mean(np.concatenate([r.y for r in segments])))
    longest = max(len(r.u) for r in segments)
    tables = []
    own_innovation = []
    n_polynomials = 0
    for rows, good, step, w in zip(segments, usable, steps, input_innovation):
        table = np.column_stack([rows.u, law_terms(rows.y - level, longest)])
        intervals = law_intervals(good, step)
        # of the set point's integral: a ramp, or constant between the steps of the set point
        degree = 2 if len(intervals) == 1 else 1
        n_polynomials += len(intervals) * (degree + 1)
        for interval in intervals:
            tables.append(remove_polynomial(table[interval], degree))
            own_innovation.append(w[interval])
    n_rows = sum(len(w) for w in own_innovation)
    dof = n_rows - n_polynomials - PROPORTIONAL_TERMS - 1
    if dof < MIN_ROWS // 2:
        return False
    return is_law(np.vstack(tables), np.concatenate(own_innovation), scale, dof)


def is_law(table: Array, innovation: Array, scale: float, dof: int) -> bool:
    """Whether the input is a law with a pure integral of the output.

    Parameters
    ----------
    table
        The input, then the terms of the law (:func:`law_terms`) (N, M).
    innovation
        What the input's own past does not predict of it (N,).
    scale
        Robust standard deviation of the innovation.
    dof
        Degrees of freedom of the residuals.

    Returns
    -------
    bool
        Whether all conditions hold: the explained share, the F values, the share in each block, the
        residuals' autocorrelation, and the randomness of the input.

    Notes
    -----
    The law must predict better than the input's own past, and the pure integral better than the
    leaky ones.
    """
    u = table[:, 0]
    basis = basis_of(table[:, 1 : 1 + PROPORTIONAL_TERMS])
    without_integral = project_out(basis, u)
    integrals = project_out(basis, table[:, 1 + PROPORTIONAL_TERMS :])
    power = np.maximum(np.sum(integrals**2, axis=0), 1e-300)
    slopes = (without_integral @ integrals) / power
    explained = slopes**2 * power
    best_leaky = float(np.max(explained[1:], initial=0.0))
    residual = without_integral - slopes[0] * integrals[:, 0]
    sse = max(float(residual @ residual), 1e-300)
    variance = sse / dof
    inflation = len(u) / dof
    unexplained = inflation * sse / max(float(innovation @ innovation), 1e-300)
    median_ratio = np.median(np.abs(residual)) / max(np.median(np.abs(innovation)), 1e-150)
    median_unexplained = inflation * float(median_ratio) ** 2
    decrease = without_integral**2 - residual**2
    blocks = [float(np.sum(block)) for block in np.array_split(decrease, BLOCKS)]
    randomness = scale / max(float(np.sqrt(np.mean(u**2))), 1e-150)
    is_exact = unexplained < MAX_EXACT_UNEXPLAINED
    min_randomness = MIN_RANDOMNESS if is_exact else MIN_RANDOMNESS_NOISY
    holds_throughout = is_exact or min(blocks) > MIN_BLOCK_SHARE * sum(blocks)
    return bool(
        max(unexplained, median_unexplained) < MAX_UNEXPLAINED
        and explained[0] > MIN_INTEGRAL_F * variance
        and explained[0] > (MIN_INTEGRAL_RATIO - 1) * sse
        and explained[0] - best_leaky > MIN_PURE_INTEGRAL_F * variance
        and holds_throughout
        and float(residual[1:] @ residual[:-1]) < MAX_AUTOCORRELATION * sse
        and randomness > min_randomness
    )


def input_innovations(
    segments: Sequence[Rows],
) -> tuple[list[NDArray[np.bool_]], list[Array]] | None:
    """Return the usable rows of each segment, and the innovations of the input there.

    Usable rows are not at a limit of the input. The innovation is what the input's own past does
    not predict. None for too few rows.

    Parameters
    ----------
    segments
        Rows of one input, a record for each segment.

    Returns
    -------
    usable
        True at the usable rows, an array (N,) for each segment.
    innovation
        Innovations, an array (N,) for each segment, zero at other rows.
    """
    if not segments:
        return None
    u = np.concatenate([r.u for r in segments])
    limits = [v for v in (u.min(), u.max()) if np.sum(u == v) >= MIN_LIMIT_REPEATS]
    usable = []
    tables = []
    for rows in segments:
        good = rows.is_measured.copy()
        good[:INPUT_LAGS] = False
        for limit in limits:
            good &= rows.u != limit
        usable.append(good)
        lagged = [delay(rows.u, i) for i in range(1, INPUT_LAGS + 1)]
        tables.append(np.column_stack([np.ones(len(rows.u)), *lagged]))
    good = np.concatenate(usable)
    if good.sum() < MIN_ROWS:
        return None
    innovation = np.zeros(len(good))
    innovation[good] = project_out(basis_of(np.vstack(tables)[good]), u[good])
    edges = np.cumsum([len(r.u) for r in segments])[:-1]
    return usable, np.split(innovation, edges)


def delayed_law(segments: Sequence[Rows]) -> bool:
    """Whether past outputs predict the input beyond its own past, by what it did not cause.

    Parameters
    ----------
    segments
        Rows of one input, a record for each segment.

    Returns
    -------
    bool
        False also where there are too few rows, or where the input is a smooth prescribed curve.
    """
    inputs = []
    outputs = []
    for rows in segments:
        if len(rows.u) <= PAST_LAGS:
            continue
        good = rows.is_measured[PAST_LAGS:]
        # one column for each lag, the latest value first
        inputs.append(sliding_window_view(rows.u, PAST_LAGS + 1)[good, ::-1])
        outputs.append(sliding_window_view(rows.y, PAST_LAGS + 1)[good, ::-1])
    if sum(len(rows) for rows in inputs) < MIN_ROWS + 2 * PAST_LAGS:
        return False
    u = np.vstack(inputs)
    y = np.vstack(outputs)
    constant = np.ones((len(u), 1))
    past_u = np.hstack([constant, u[:, 1:]])
    past_u_y = np.hstack([past_u, y[:, 1:]])
    past_y_all_u = np.hstack([constant, u, y[:, 1:]])
    u_innovation = project_out(basis_of(past_u), u[:, 0])
    u_residual = project_out(basis_of(past_u_y), u[:, 0])
    y_innovation = project_out(basis_of(past_y_all_u), y[:, 0])
    sse = float(u_innovation @ u_innovation)
    scale = MAD_TO_SD * float(np.median(np.abs(u_innovation)))
    if scale <= MIN_RANDOMNESS * float(np.std(u[:, 0])):
        return False
    inflation = len(u) / (len(u) - 2 * PAST_LAGS - 1)
    explained = 1 - float(u_residual @ u_residual) / sse * inflation
    products = [float(y_innovation[:-i] @ u_innovation[i:]) for i in range(1, PAST_LAGS + 1)]
    norm = max(sse * float(y_innovation @ y_innovation), 1e-300)
    squares = np.array(products) ** 2 / norm
    return bool(explained > MIN_PAST_SHARE and np.sum(squares) > MIN_PAST_CORRELATION)


def law_terms(y: Array, longest: int) -> Array:
    """Return the terms of a control law: output, its last two values, filtered outputs, sums.

    The sums are the running sum and leaky sums, up to ``MAX_LEAK_LENGTHS`` times ``longest``.

    Parameters
    ----------
    y
        Output less its level (N,).
    longest
        Samples of the longest segment.

    Returns
    -------
    array
        Terms (N, M). The first ``PROPORTIONAL_TERMS`` have no integral; the running sum and the
        leaky sums follow.

    Notes
    -----
    ``tcdyn.identification.closed_loop.is_law`` relies on this order.
    """
    columns = [y, delay(y, 1), delay(y, 2)]
    for pole in FILTER_POLES:
        columns.append(lfilter([1 - pole], [1, -pole], y, zi=[pole * y[0]])[0])
    columns.append(np.cumsum(y))
    memory = MIN_LEAK_SAMPLES
    while memory <= MAX_LEAK_LENGTHS * longest:
        columns.append(lfilter([1.0], [1.0, -np.exp(-1 / memory)], y))
        memory *= LEAK_RATIO
    return np.column_stack(columns)


def basis_of(table: Array) -> Array:
    """Return an orthonormal basis (N, K) of columns (N, M), up to rounding errors."""
    return orthonormal_basis(table, ROUNDING)


def delay(x: Array, count: int) -> Array:
    """Return ``x`` (N,) delayed by ``count`` samples, with its first value before."""
    return np.concatenate([np.full(count, x[0]), x[:-count]])


def law_intervals(good: NDArray[np.bool_], step: NDArray[np.bool_]) -> list[slice]:
    """Return the intervals of consecutive usable rows, cut where the set point has a step.

    Parameters
    ----------
    good
        Usable rows (N,).
    step
        Rows with a step of the set point (N,).

    Returns
    -------
    list of slice
        Intervals of at least ``MIN_INTERVAL_ROWS`` rows. After a step ``SETTLING_ROWS`` are left
        out.
    """
    cuts = np.flatnonzero(step)
    intervals = []
    for rows in true_intervals(good):
        inside = cuts[(cuts > rows.start) & (cuts < rows.stop)]
        borders = [rows.start, *inside.tolist(), rows.stop]
        for a, b in pairwise(borders):
            start = a + SETTLING_ROWS if step[a] else a
            if b - start >= MIN_INTERVAL_ROWS:
                intervals.append(slice(start, b))
    return intervals


def remove_polynomial(table: Array, degree: int) -> Array:
    """Return the columns of ``table`` (N, M) less their polynomials in time of that degree."""
    powers = np.vander(np.linspace(-1.0, 1.0, len(table)), degree + 1)
    return project_out(np.linalg.qr(powers)[0], table)


def project_out(basis: Array, x: Array) -> Array:
    """Return the part of ``x`` that is orthogonal to an orthonormal basis.

    Parameters
    ----------
    basis
        Orthonormal columns (N, K).
    x
        Values (N,) or (N, M).

    Returns
    -------
    array
        The same shape as ``x``. The projection is done twice, against rounding errors.
    """
    once = x - basis @ (basis.T @ x)
    return np.asarray(once - basis @ (basis.T @ once))
