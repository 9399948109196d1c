"""Interference of a logged column that switches: steps of the readings at its edges.

A heater, relay or valve may couple into the wires of a sensor. The reading then contains a multiple
of the column, at once and not through the sensor. The multiple is estimated beside what the
temperature itself may do at the edges: jump, or change its slope. Readings without it must be more
likely with intensities of their own.

Used by ``tcdyn.smoothing.smoother.smooth``. Guarded by ``tests/smoothing/test_pick_up.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.smoothing.events import STARTS
from tcdyn.smoothing.noise_levels import Intensity
from tcdyn.smoothing.process_noise import channel_spans, segment_levels, smearing_time_s
from tcdyn.smoothing.record import Record
from tcdyn.smoothing.roughness import select_channels
from tcdyn.smoothing.state_space import Smoothed, likelihood, predicted_readings, smooth_record

# Share of the rows in which a column that switches changes at most, and edges that it has at least:
# one does not tell a coincidence from a cause. Chosen by judgement
MOST_CHANGES = 0.34
FEWEST_EDGES = 2
# nats by which readings without an interference must be more likely, beside the number of columns
# that are tried: odds of 150 to 1
MIN_NATS = 5.0


# words for the state in which a load is switched off, in small letters
OFF_WORDS = frozenset(
    {"off", "aus", "open", "offen", "idle", "inactive", "stopped", "stop", "standby", "false", "no"}
)
TWO_WORDS = 2


@dataclass(frozen=True)
class PickUp:
    """Interference of a column in one channel.

    Attributes
    ----------
    channel
        Index of the channel.
    column
        Name of the column.
    values
        Its values (N,), less that without interference.
    per_unit_K
        Change of the reading for a unit of the column [K].
    """

    channel: int
    column: str
    values: Array
    per_unit_K: float

    @property
    def edge(self) -> float:
        """Usual size of an edge of the column."""
        edges = np.abs(np.diff(self.values))
        return float(np.median(edges[edges > 0]))

    @property
    def edges(self) -> int:
        """Number of its edges."""
        return int(np.count_nonzero(np.diff(self.values)))


def numbers_of(values: ArrayLike) -> Array | None:
    """A column (N,) as numbers, NaN where missing; None for a text that is no switch.

    Notes
    -----
    Of a text with two words, such as on and off, one of ``OFF_WORDS`` is 0 and the other one 1;
    without one, the first in the alphabet is 0.

    Examples
    --------
    >>> numbers_of(["Off", "on", None, "on"]).tolist()
    [0.0, 1.0, nan, 1.0]
    >>> numbers_of(["closed", "open"]).tolist(), numbers_of(["low", "mid", "high"])
    ([1.0, 0.0], None)
    """
    cells = pd.Series(np.asarray(values))
    numbers = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    if np.isfinite(numbers).any():
        return np.asarray(numbers)
    codes, words = pd.factorize(cells.astype("string"), sort=True)
    if len(words) != TWO_WORDS:
        return None
    is_off = [str(word).strip().lower() in OFF_WORDS for word in words]
    if is_off == [False, True]:
        codes = np.where(codes >= 0, 1 - codes, codes)
    return np.where(codes >= 0, codes.astype(float), np.nan)


def held(values: Array) -> Array:
    """Values (N,) of which some are missing: there the value before holds, first the first one.

    Examples
    --------
    >>> held(np.array([np.nan, 1.0, np.nan, 3.0])).tolist()
    [1.0, 1.0, 1.0, 3.0]
    """
    known = pd.Series(values).where(np.isfinite(values))
    return np.asarray(known.ffill().bfill().to_numpy())


def switching(values: Array) -> Array | None:
    """The values (N,) of a column that switches, less the smallest; None for another one.

    Parameters
    ----------
    values
        The column (N,), NaN where missing: there the value before holds.

    Examples
    --------
    >>> switching(np.array([1.0, 1, 1, 1, 3, 3, 3, 1, 1, np.nan, 3, 3])).tolist()
    [0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 2.0, 2.0]
    >>> switching(np.arange(9.0)) is None
    True
    """
    if not np.isfinite(values).any():
        return None
    all_values = held(values)
    changes = np.count_nonzero(np.diff(all_values))
    if not FEWEST_EDGES <= changes <= MOST_CHANGES * len(all_values):
        return None
    return np.asarray(all_values - all_values.min())


def find_pick_up(record: Record, switched: Mapping[str, Array]) -> tuple[PickUp, ...]:
    """The interference that readings show, at most that of one column in each channel.

    Parameters
    ----------
    record
        The record.
    switched
        Columns that switch (N,), see :func:`switching`, by name.
    """
    found: list[PickUp] = []
    if not switched:
        return ()
    needed = MIN_NATS + np.log(len(switched))
    for c in range(len(record.chains)):
        alone = select_channels(record, np.arange(len(record.chains)) == c)
        fit, without = _fitted(alone)
        most = without + needed
        best: PickUp | None = None
        for name, values in switched.items():
            for per_unit_K in _candidates(fit, values):
                y = alone.y - per_unit_K * values[:, None]
                _, value = _fitted(replace(alone, y=y))
                if value > most:
                    most = value
                    best = PickUp(c, name, values, per_unit_K)
        if best is not None:
            found.append(best)
    return tuple(found)


def without_pick_up(y: Array, pick_ups: Sequence[PickUp]) -> Array:
    """Readings (N,) or (N, M) without interference, in the shape (N, M)."""
    out = y.reshape(len(y), -1).copy()
    for pick_up in pick_ups:
        out[:, pick_up.channel] -= pick_up.per_unit_K * pick_up.values
    return out


def _fitted(record: Record) -> tuple[Smoothed, float]:
    """A record of one channel smoothed with its likeliest intensity, and its log likelihood."""
    intensities, noise_var = segment_levels(record, record.noise_sd**2, record.noise_known)
    value, _ = likelihood(record, noise_var, [intensities])
    return smooth_record(record, noise_var, intensities), float(value[0, 0])


def _candidates(fit: Smoothed, values: Array) -> list[float]:
    """Multiples [K per unit] of a column in the readings of one channel that are worth a fit."""
    candidates = []
    for factor in STARTS:
        (q,) = fit.intensities
        smaller = replace(q, levels=tuple(factor * level for level in q.levels))
        per_unit_K, nats = _estimate(fit, values, smaller)
        if nats > MIN_NATS:
            candidates.append(per_unit_K)
    return candidates


def _estimate(fit: Smoothed, values: Array, intensity: Intensity) -> tuple[float, float]:
    """Multiple [K per unit] of a column in the readings, and log likelihood that it gains.

    Parameters
    ----------
    fit
        Gives the record of one channel, and its noise.
    values
        The column (N,).
    intensity
        Intensity of the channel.

    Notes
    -----
    Beside it stand a jump of the temperature and a change of its slope at each edge, also in
    multiples of the column: the column through the chain, and its integral. With the covariance S
    of the readings, the residuals of the smoother over the noise variance are S^-1 y, for the
    readings and for the regressors X alike. The gain is that of the first beside the other two,

        1/2 b' (A + V^-1)^-1 b - 1/2 log det(1 + V A),  A = X' S^-1 X,  b = X' S^-1 y.
    """
    record = fit.record
    chain = record.chains[0]
    dt = record.dt_s
    integral = np.cumsum(values - values.mean()) * dt / smearing_time_s(record)
    regressors = np.stack(
        [values, chain.response(values, dt, "zoh"), chain.response(integral, dt)], axis=1
    )
    weight = record.weight[:, 0]
    noise_var = float(fit.noise_var[0])
    of_regressors = np.empty_like(regressors)
    for k, column in enumerate(regressors.T):
        only = replace(record, y=column[:, None])
        predicted, _ = predicted_readings(only, fit.noise_var, [intensity])
        of_regressors[:, k] = weight * (column - predicted[:, 0]) / noise_var
    gram = regressors.T @ of_regressors
    edges = np.abs(np.diff(values))
    prior_sd = float(channel_spans(record, fit.noise_var)[0] / np.median(edges[edges > 0]))
    scaled = prior_sd**2 * 0.5 * (gram + gram.T)
    projection = prior_sd * (of_regressors.T @ record.y[:, 0])

    def gained(index: list[int]) -> tuple[Array, float]:
        """Posterior means of some regressors, and the log likelihood that they gain."""
        information = np.eye(len(index)) + scaled[np.ix_(index, index)]
        mean = np.linalg.solve(information, projection[index])
        nats = 0.5 * projection[index] @ mean - 0.5 * np.linalg.slogdet(information)[1]
        return prior_sd * mean, float(nats)

    mean, of_all = gained([0, 1, 2])
    _, of_temperature = gained([1, 2])
    return float(mean[0]), of_all - of_temperature


@dataclass(frozen=True)
class Removed:
    """What the uncertainty of an interference changes.

    Attributes
    ----------
    pick_up
        The interference, with the final estimate.
    u_K
        Standard uncertainty of ``per_unit_K`` [K].
    temperature, slope
        Change of the temperature (N,) and of its rate of change [1/s] for a unit of it.
    correction
        Change of ``per_unit_K`` by the final estimate [K], which the temperature does not contain.
    """

    pick_up: PickUp
    u_K: float
    temperature: Array
    slope: Array
    correction: float


def removed(fit: Smoothed, pick_up: PickUp) -> Removed:
    """The final estimate of an interference, given all that the record shows.

    Parameters
    ----------
    fit
        The smoothed record, without the interference.
    pick_up
        The interference.

    Notes
    -----
    With the residuals S^-1 s of the column s, its multiple has the variance 1 / (s' S^-1 s).
    """
    c = pick_up.channel
    record = fit.record
    y = record.y.copy()
    y[:, c] = pick_up.values
    of_column = smooth_record(replace(record, y=y), fit.noise_var, fit.intensities)
    noise_var = float(fit.noise_var[c])
    weighted = record.weight[:, c] * (pick_up.values - of_column.predicted[:, c]) / noise_var
    information = float(pick_up.values @ weighted)
    correction = float(record.y[:, c] @ weighted) / information
    samples = of_column.at_samples()
    estimate = replace(pick_up, per_unit_K=pick_up.per_unit_K + correction)
    return Removed(
        estimate,
        float(np.sqrt(1 / information)),
        samples.temperature[:, c],
        samples.slope[:, c],
        correction,
    )
