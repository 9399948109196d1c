"""Whether an input is computed from the output: a record of a closed loop, from which no plant can be identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, warning
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.identify.iodata import IOData
from tcdyn.identify.segments import Segment, cut

# The thresholds come from simulated records of 100 to 1,000 samples: 7 controllers and 25 kinds of open loop, in
# tests/identify/closed_loop_study.py. The comment beside each gives the figures that it lies between.
OWN_LAGS = 8  # past values of the input from which its own prediction is made
FILTER_POLES = (
    0.5,
    0.7,
    0.85,
    0.95,
)  # of the filters that a controller may have on its measurement
PROPORTIONAL = 3 + len(
    FILTER_POLES
)  # terms without an integral: the last three outputs and the filtered ones
LEAST_ROWS = 40  # rows of a record below which nothing can be decided
SHORTEST_STRETCH = 10  # rows between two limits or set-point steps
SETTLING = 15  # rows after a set-point step that are left out: the filters of a controller settle
LIMIT_REPEATS = 3  # times that the extreme value of an input is repeated where it is a limit
STEP_SDS = (
    8.0  # innovation of the input, in robust standard deviations, that is a step of the set point
)
MOST_STEPS = (
    1 / 30
)  # share of the rows above which such innovations are no steps but the input's own distribution
MOST_UNEXPLAINED = (
    0.5  # of the input's innovation variance by the law; noise-free loops 1e-8, noise of 10 % 0.3
)
INTEGRAL_F = 60.0  # F value of the integral term; of white noise and open loops with white residuals at most 40
# The same against the best leaky integral, which an inverted lead has: leads at most 53, loops 85
PURE_INTEGRAL_F = 60.0
SHORTEST_LEAK = 20.0  # samples; the filters above are shorter
LONGEST_LEAK = 1.5  # lengths of the record; a slower leak is no longer told from none
LEAK_RATIO = (
    1.25  # from one leaky integral to the next: close enough that no lead falls between two
)
INTEGRAL_GAIN = (
    1.2  # ratio of the residual variances without and with the integral, however long the record is
)
BLOCKS = 4  # quarters of the record, in each of which the integral of a law that is not exact must explain something
LEAST_SHARE = 0.03  # of what it explains in all; a single transient leaves less in two of them
MOST_CORRELATED = (
    0.75  # autocorrelation of the law's residuals; of a chance fit to a slow drift it is above 0.8
)
LEAST_RANDOM = 1e-3  # innovation of the input over its standard deviation; below, it is a smooth prescribed curve
EXACT = 0.02  # unexplained share above which a law is no exact one
LEAST_RANDOM_NOISY = (
    0.08  # LEAST_RANDOM where the law is not exact; a noisy plunge has 0.05, loops 0.3 to 1
)
PAST_LAGS = 10  # past values of input and output in the test for a delayed law
PAST_SHARE = 0.6  # of the input's innovation variance that the past output explains; in open loops at most 0.27
PAST_CORRELATION = 0.4  # sum of squared correlations of the output's innovations with the next ones of the input; 0.33
MOST_ROWS = 20_000  # first rows that are examined, of all segments together, so that long records cost no more


@dataclass(frozen=True)
class Rows:
    """One input and the output of a segment.

    Attributes
    ----------
    u, y : (N,) array
        Input and output in their units, gaps of the output bridged by straight lines.
    known : (N,) array of bool
        Whether the output was measured here and at the ``PAST_LAGS`` samples before.
    """

    u: Array
    y: Array
    known: NDArray[np.bool_]


def check_closed_loop(data: IOData, where: str) -> None:
    """Refuse a record whose input is computed from its output.

    Parameters
    ----------
    data : IOData
        One output, one or several inputs.
    where : str
        The file or function that the error names.

    Raises
    ------
    InputError
        Where :func:`closed_loop` has a finding.
    """
    findings = closed_loop(data)
    if findings:
        name = findings[0].subject
        output = data.output_names[0]
        raise InputError(
            f"the input {name} follows the output {output}: it is computed from it (closed loop)",
            where=where,
            expected="an input that does not depend on the output",
            remedy="record with the loop open (controller in manual), or add to the input a test signal that is "
            "larger than what the controller does (dither, steps); where no controller was active, check that the "
            "columns are not exchanged; with {check} it is a warning",
            parameters={"check": False},
        )


def closed_loop(data: IOData) -> tuple[Finding, ...]:
    """A warning for each input that is computed from the output.

    Parameters
    ----------
    data : IOData
        One output, one or several inputs.

    Returns
    -------
    tuple of Finding
        ``record.closed_loop`` with the input as its subject; empty for an open loop.

    Notes
    -----
    Two laws are looked for. A controller with an integral term, u[k] = c + F(q) y[k] + K S[k] + n[k] with S the running
    sum of y: -1/C(s), which has no static gain, fits such a record as well as a plant does (Ljung, System
    Identification, 2nd ed. 1999, section 13.4). And a law that uses past outputs only: the past output then predicts
    the input beyond the input's own past (Granger, Econometrica 37, 424, 1969), by what the input did not cause. A
    proportional law without delay is a static relation like any other and cannot be recognised from the data.
    """
    if len(data.output_names) != 1:
        return ()
    output = data.output_names[0]
    segments = cut(data)
    total = sum(len(s.u) for s in segments)
    share = min(1.0, MOST_ROWS / max(total, 1))
    findings = []
    for k, name in enumerate(data.input_names):
        rows = [rows_of(s, k, int(np.ceil(share * len(s.u)))) for s in segments]
        rows = [r for r in rows if len(r.u) >= OWN_LAGS + SHORTEST_STRETCH]
        if integral_law(rows) or delayed_law(rows):
            findings.append(warning("record.closed_loop", subject=name, output=output))
    return tuple(findings)


def rows_of(segment: Segment, k: int, count: int) -> Rows:
    """The first ``count`` rows of a segment's ``k``-th input and of its output."""
    u = segment.inputs[:count, k]
    seen = segment.seen[:count]
    if not seen.any():
        return Rows(u[:0], u[:0], seen[:0])
    times = np.arange(count)
    y = np.interp(times, times[seen], segment.y[:count][seen])
    missing = np.cumsum(np.append(0, ~seen))
    first = np.maximum(times - PAST_LAGS, 0)
    known = missing[times + 1] == missing[first]
    return Rows(u, y, known)


def integral_law(segments: Sequence[Rows]) -> bool:
    """Whether the input is a controller's integral and proportional answer to the output, within a small residual."""
    innovations = own_innovations(segments)
    if innovations is None:
        return False
    usable, own = innovations
    scale = MAD_TO_SD * float(
        np.median(np.abs(np.concatenate([w[g] for g, w in zip(usable, own)])))
    )
    jumps = [np.abs(w) > STEP_SDS * scale for w in own]
    if sum(int(j.sum()) for j in jumps) > MOST_STEPS * sum(int(g.sum()) for g in usable):
        jumps = [np.zeros_like(j) for j in jumps]
    level = float(np.mean(np.concatenate([r.y for r in segments])))
    longest = max(len(r.u) for r in segments)
    tables = []
    kept = []
    polynomials = 0
    for rows, good, jump, w in zip(segments, usable, jumps, own):
        table = np.column_stack([rows.u, terms(rows.y - level, longest)])
        parts = stretches(good, jump)
        degree = (
            2 if len(parts) == 1 else 1
        )  # of the set point's integral: a ramp, or constant between its steps
        polynomials += len(parts) * (degree + 1)
        tables += [without_trend(table[part], degree) for part in parts]
        kept += [w[part] for part in parts]
    free = sum(len(w) for w in kept) - polynomials - PROPORTIONAL - 1
    return free >= LEAST_ROWS // 2 and is_law(np.vstack(tables), np.concatenate(kept), scale, free)


def is_law(table: Array, own: Array, scale: float, free: int) -> bool:
    """Whether the input, first in ``table`` (N, M), is a law of the terms after it (:func:`terms`): better than by its
    own past, which leaves ``own`` (N,) of typical size ``scale``, and by the pure integral; ``free`` rows are left."""
    u = table[:, 0]
    basis = orthonormal(table[:, 1 : 1 + PROPORTIONAL])
    without = project_out(basis, u)
    integrals = project_out(basis, table[:, 1 + PROPORTIONAL :])
    power = np.maximum(np.sum(integrals**2, axis=0), 1e-300)
    slopes = (without @ integrals) / power
    gained = slopes**2 * power
    residual = without - slopes[0] * integrals[:, 0]
    remaining = max(float(residual @ residual), 1e-300)
    unit = remaining / free
    inflation = len(u) / free
    unexplained = inflation * remaining / max(float(own @ own), 1e-300)
    typical = (
        inflation * float(np.median(np.abs(residual)) / max(np.median(np.abs(own)), 1e-150)) ** 2
    )
    blocks = [float(np.sum(part)) for part in np.array_split(without**2 - residual**2, BLOCKS)]
    randomness = scale / max(float(np.sqrt(np.mean(u**2))), 1e-150)
    exact = unexplained < EXACT
    least_random = LEAST_RANDOM if exact else LEAST_RANDOM_NOISY
    throughout = exact or min(blocks) > LEAST_SHARE * sum(blocks)
    leaky = float(np.max(gained[1:], initial=0.0))
    return bool(
        max(unexplained, typical) < MOST_UNEXPLAINED
        and gained[0] > INTEGRAL_F * unit
        and gained[0] > (INTEGRAL_GAIN - 1) * remaining
        and gained[0] - leaky > PURE_INTEGRAL_F * unit
        and throughout
        and float(residual[1:] @ residual[:-1]) < MOST_CORRELATED * remaining
        and randomness > least_random
    )


def own_innovations(segments: Sequence[Rows]) -> tuple[list[NDArray[np.bool_]], list[Array]] | None:
    """Which rows are usable, off the limits of the input, and what of the input its own past does not predict there;
    None for too few rows."""
    if not segments:
        return None
    everything = np.concatenate([r.u for r in segments])
    limits = [
        v for v in (everything.min(), everything.max()) if np.sum(everything == v) >= LIMIT_REPEATS
    ]
    usable = []
    tables = []
    for rows in segments:
        good = rows.known.copy()
        good[:OWN_LAGS] = False
        for limit in limits:
            good &= rows.u != limit
        usable.append(good)
        lagged = [delayed(rows.u, i) for i in range(1, OWN_LAGS + 1)]
        tables.append(np.column_stack([np.ones(len(rows.u)), *lagged]))
    good = np.concatenate(usable)
    if good.sum() < LEAST_ROWS:
        return None
    table = np.vstack(tables)
    w = np.zeros(len(good))
    w[good] = project_out(orthonormal(table[good]), everything[good])
    edges = np.cumsum([len(r.u) for r in segments])[:-1]
    return usable, np.split(w, edges)


def delayed_law(segments: Sequence[Rows]) -> bool:
    """Whether past outputs predict the input where its own past does not, by what the input did not cause."""
    inputs = []
    outputs = []
    for rows in segments:
        n = len(rows.u)
        good = rows.known[PAST_LAGS:]
        if n <= PAST_LAGS:
            continue
        inputs.append(
            np.column_stack([rows.u[PAST_LAGS - i : n - i] for i in range(PAST_LAGS + 1)])[good]
        )
        outputs.append(
            np.column_stack([rows.y[PAST_LAGS - i : n - i] for i in range(PAST_LAGS + 1)])[good]
        )
    if sum(len(rows) for rows in inputs) < LEAST_ROWS + 2 * PAST_LAGS:
        return False
    u = np.vstack(inputs)
    y = np.vstack(outputs)
    one = np.ones((len(u), 1))
    own = project_out(orthonormal(np.hstack([one, u[:, 1:]])), u[:, 0])
    both = project_out(orthonormal(np.hstack([one, u[:, 1:], y[:, 1:]])), u[:, 0])
    output = project_out(orthonormal(np.hstack([one, u, y[:, 1:]])), y[:, 0])
    variance = float(own @ own)
    scale = MAD_TO_SD * float(np.median(np.abs(own)))
    if scale <= LEAST_RANDOM * float(np.std(u[:, 0])):
        return False
    explained = 1 - float(both @ both) / variance * len(u) / (len(u) - 2 * PAST_LAGS - 1)
    products = [float(output[:-i] @ own[i:]) for i in range(1, PAST_LAGS + 1)]
    squares = np.array(products) ** 2 / max(variance * float(output @ output), 1e-300)
    return bool(explained > PAST_SHARE and np.sum(squares) > PAST_CORRELATION)


def terms(y: Array, longest: int) -> Array:
    """What a law may be made of (N, M): the output, its two last values, filtered ones; its sum; its leaky sums."""
    columns = [y, delayed(y, 1), delayed(y, 2)]
    for pole in FILTER_POLES:
        columns.append(lfilter([1 - pole], [1, -pole], y, zi=[pole * y[0]])[0])
    columns.append(np.cumsum(y))
    memory = SHORTEST_LEAK
    while memory <= LONGEST_LEAK * longest:
        columns.append(lfilter([1.0], [1.0, -np.exp(-1 / memory)], y))
        memory *= LEAK_RATIO
    return np.column_stack(columns)


def delayed(x: Array, count: int) -> Array:
    """``x`` (N,) so many samples later, begun at its first value."""
    return np.concatenate([np.full(count, x[0]), x[:-count]])


def stretches(good: NDArray[np.bool_], jump: NDArray[np.bool_]) -> list[slice]:
    """Usable rows that follow each other, cut where the input jumps."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.view(np.int8), [0]]))).reshape(-1, 2)
    cuts = np.flatnonzero(jump)
    parts = []
    for first, end in edges:
        inside = cuts[(cuts > first) & (cuts < end)]
        borders = [int(first), *inside.tolist(), int(end)]
        for a, b in pairwise(borders):
            start = a + SETTLING if jump[a] else a
            if b - start >= SHORTEST_STRETCH:
                parts.append(slice(start, b))
    return parts


def without_trend(table: Array, degree: int) -> Array:
    """The columns of ``table`` (N, M) less their polynomials in time of that degree."""
    powers = np.vander(np.linspace(-1.0, 1.0, len(table)), degree + 1)
    return project_out(np.linalg.qr(powers)[0], table)


def orthonormal(table: Array) -> Array:
    """An orthonormal basis of the columns of ``table`` (N, M), those that depend on the others left out."""
    size = np.linalg.norm(table, axis=0)
    scaled = table / np.where(size > 0, size, 1.0)
    gram_values, gram_vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = gram_values > 1e-13 * gram_values[-1]
    basis = scaled @ (gram_vectors[:, kept] / np.sqrt(gram_values[kept]))
    return np.asarray(np.linalg.qr(basis)[0])


def project_out(basis: Array, x: Array) -> Array:
    """``x`` (N,) or (N, M) less its part in the orthonormal ``basis`` (N, K); twice, against rounding."""
    once = x - basis @ (basis.T @ x)
    return np.asarray(once - basis @ (basis.T @ once))
