"""The smoother of a record that grows, block after block, each from the state of the filter.

A block is smoothed from the state of the Kalman filter at a row near the end of the block before,
with intensities and noise that were learned from rows up to the end of a block. So each row is
filtered and smoothed a few times, and a later run needs nothing but ``Running`` and those rows to
continue. Where the rows of a block contradict what was learned, the intensities are adapted and
events are detected as in ``tcdyn.smoothing.smoother.smooth``.

Used by :mod:`tcdyn.sensors.delayed`. Guarded by ``tests/smoothing/test_block_by_block.py`` and
``tests/smoothing/test_fixed_delay.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.chain import Chain
from tcdyn.chain.law import LagLaw
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array
from tcdyn.core.threads import one_blas_thread
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing.followed_flow import FollowedFlow, followed_flow
from tcdyn.smoothing.noise_levels import Change, Intensity
from tcdyn.smoothing.process_noise import segment
from tcdyn.smoothing.record import Compensated, Record, Start, record_of
from tcdyn.smoothing.smoother import Learned, compensated, learned_from, likeliest
from tcdyn.smoothing.state_space import Smoothed, channel_ranges, reads_before, state_at


@dataclass(frozen=True)
class Running:
    """What a block passes on to the next one.

    Attributes
    ----------
    dt_s
        Sampling interval [s].
    noise
        Noise of the channels, see ``tcdyn.smoothing.record.Record``.
    learned
        Intensities on the clock of the first sample of the next block, and noise.
    start
        State of the filter at that sample, without its reading.
    is_contradicted
        Whether the block showed an event or other intensities than those that were learned.
    """

    dt_s: float
    noise: tuple[LoggerNoise, ...]
    learned: Learned
    start: Start
    is_contradicted: bool

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain data, from which ``from_dict`` makes the very same numbers."""
        learned = self.learned
        return {
            "dt_s": self.dt_s,
            "noise": [_noise_to_dict(noise) for noise in self.noise],
            "intensities": [asdict(intensity) for intensity in learned.intensities],
            "noise_var": learned.noise_var.tolist(),
            "dof": learned.dof.tolist(),
            "missed_var": learned.missed_var.tolist(),
            "missed_slope_var": learned.missed_slope_var.tolist(),
            "smooth_probability": learned.smooth_probability.tolist(),
            "means": [mean.tolist() for mean in self.start.means],
            "factors": [factor.tolist() for factor in self.start.factors],
            "range_K": self.start.range_K.tolist(),
            "rows": self.start.rows,
            "is_contradicted": self.is_contradicted,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Running:
        """What ``to_dict`` wrote; raises one of ``tcdyn.core.errors.DAMAGED`` for other data."""
        learned = Learned(
            tuple(_intensity_from_dict(intensity) for intensity in data["intensities"]),
            np.array(data["noise_var"], dtype=float),
            np.array(data["dof"], dtype=float),
            np.array(data["missed_var"], dtype=float),
            np.array(data["missed_slope_var"], dtype=float),
            np.array(data["smooth_probability"], dtype=float),
        )
        start = Start(
            tuple(np.array(mean, dtype=float) for mean in data["means"]),
            tuple(np.array(factor, dtype=float) for factor in data["factors"]),
            np.array(data["range_K"], dtype=float),
            int(data["rows"]),
        )
        noise = tuple(_noise_from_dict(noise) for noise in data["noise"])
        return cls(float(data["dt_s"]), noise, learned, start, bool(data["is_contradicted"]))


def _intensity_from_dict(data: Mapping[str, Any]) -> Intensity:
    """An intensity from its fields."""
    lists = {name: tuple(data[name]) for name in ("starts_s", "levels", "level_noise")}
    return Intensity(**lists, changes=tuple(Change(**change) for change in data["changes"]))


def _noise_to_dict(noise: LoggerNoise) -> dict[str, Any]:
    """The fields of the noise of a logger that a later block needs."""
    shaping = noise.shaping
    return {
        "before_filter_K": noise.before_filter_K.tolist(),
        "after_filter_K": noise.after_filter_K.tolist(),
        "level_K": noise.level_K.tolist(),
        "shaping": [shaping.cutoff_Hz, shaping.poles, shaping.shape],
        "sections": noise.sections,
        "hum_lines": [[f, amplitude.tolist()] for f, amplitude in noise.hum_lines],
        "rate_Hz": noise.rate_Hz,
    }


def _noise_from_dict(data: Mapping[str, Any]) -> LoggerNoise:
    """The noise of a logger from ``_noise_to_dict``, without what only its findings need."""
    cutoff_Hz, poles, shape = data["shaping"]
    return LoggerNoise(
        np.array(data["before_filter_K"], dtype=float),
        np.array(data["after_filter_K"], dtype=float),
        np.array(data["level_K"], dtype=float),
        Conditioning(cutoff_Hz, poles, shape),
        sections=tuple(tuple(section) for section in data["sections"]),
        hum_lines=tuple((float(f), np.array(a, dtype=float)) for f, a in data["hum_lines"]),
        rate_Hz=float(data["rate_Hz"]),
    )


@one_blas_thread
def smooth_block(
    y: Array,
    dt_s: float,
    chains: Sequence[Chain],
    origin: int,
    next_origin: int,
    rows_before: int,
    running: Running | None,
    learns: bool,
    *,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    lag_covariance: ArrayLike | None = None,
    split_u_s: ArrayLike = 0.0,
    static_u: Array | None = None,
    late_s: Array | None = None,
    laws: Sequence[LagLaw | None] = (),
    flow: Array | None = None,
    flow_u: ArrayLike = 0.0,
) -> tuple[Compensated, Running]:
    """Smooth the samples of one block.

    Parameters
    ----------
    y
        Readings (N, M) [degC], NaN where missing: rows before the block, which show its outliers
        and, where it ``learns``, its intensities; the block; and rows after it.
    dt_s
        Sampling interval of ``y`` [s], which counts where nothing was learned yet, or the block
        ``learns``.
    chains
        Chain of each channel (M,).
    origin, next_origin
        Samples at which this block and the next one begin: from there on, their rows are smoothed
        from the state of the filter. Without ``running`` this one begins with the first of all.
    rows_before
        Number of rows before ``origin`` among which events were looked for.
    running
        What the block before passed on; None: nothing.
    learns
        Whether noise and intensities are estimated again, from all of ``y``.
    names, units, lag_covariance, split_u_s
        As in ``tcdyn.smoothing.smoother.smooth``.
    static_u
        Standard uncertainty of the static line (N, M) [K].
    late_s, laws, flow, flow_u
        As in ``tcdyn.smoothing.smoother.smooth``.

    Returns
    -------
    result
        The result from the sample ``origin`` on.
    running
        For the next block.
    """
    law: FollowedFlow | None = None
    if flow is not None:
        law = followed_flow(y, chains, list(laws), flow, flow_u)
        chains = law.median_chains
    if running is None or learns:
        whole = record_of(y, dt_s, chains, names=names, units=units, late_s=late_s)
        if law is not None:
            whole = replace(whole, followed=law.lags(whole))
        likely = likeliest(whole, True)
        learned = learned_from(likely.fit, likely.smooth_probability)
        if running is None:
            record = whole
            origin = 0
        else:
            at_origin = [q.continued(origin * dt_s) for q in learned.intensities]
            learned = learned._replace(
                intensities=tuple(at_origin),
                missed_var=learned.missed_var[origin:],
                missed_slope_var=learned.missed_slope_var[origin:],
            )
            record = _continued_record(whole, likely.fit, origin, rows_before, running)
            likely = likeliest(record, True, learned)
        findings = whole.findings
        noise = whole.noise
        range_K = channel_ranges(whole)
    else:
        dt_s = running.dt_s
        noise = running.noise
        learned = running.learned
        whole = record_of(
            y, dt_s, chains, names=names, units=units, noise_model=noise, late_s=late_s
        )
        if law is not None:
            whole = replace(whole, followed=law.lags(whole))
        record = _from_start(whole, origin, replace(running.start, rows=rows_before))
        likely = likeliest(record, True, learned)
        findings = whole.findings
        range_K = running.start.range_K
    result = compensated(
        likely.fit,
        likely,
        learned,
        {},
        lag_covariance=lag_covariance,
        split_u_s=split_u_s,
        static_u=None if static_u is None else static_u[origin:],
        findings=findings,
        names=names,
        law=None if law is None else law.from_sample(origin),
    )
    end = next_origin - origin
    means, factors = state_at(likely.fit, end)
    passed_on = Running(
        dt_s,
        noise,
        learned._replace(
            intensities=tuple(q.continued(end * dt_s) for q in likely.fit.intensities),
            missed_var=_of_last_row(learned.missed_var),
            missed_slope_var=_of_last_row(learned.missed_slope_var),
        ),
        Start(means, factors, range_K, rows_before),
        not learns and likely.fit.intensities != learned.intensities,
    )
    return result, passed_on


def _of_last_row(values: Array) -> Array:
    """The last row of values (N, M) of samples; values (M,) for all samples as they are."""
    return np.asarray(values[-1] if values.ndim == 2 else values)


def _continued_record(
    whole: Record, fit: Smoothed, origin: int, rows_before: int, running: Running
) -> Record:
    """The samples of a record from ``origin`` on, with the state of the filter there.

    It is that of the block before; where the noise before the filter was learned anew, the states
    have another meaning, and it is that of the filter of ``fit``, the record of all samples.
    """
    start = replace(running.start, range_K=channel_ranges(whole), rows=rows_before)
    is_coloured = any(model.is_coloured for model in (*whole.noise, *running.noise))
    if is_coloured:
        means, factors = state_at(fit, origin)
        start = replace(start, means=means, factors=factors)
    return _from_start(whole, origin, start)


def _from_start(whole: Record, origin: int, start: Start) -> Record:
    """The samples of a record from ``origin`` on, which continue from ``start``.

    Readings of states before ``origin`` are part of the start, and have no weight.
    """
    record = segment(whole, origin, len(whole.y), ())
    weight = record.weight.copy()
    for c, sensor in enumerate(record.sensors):
        weight[reads_before(record, sensor), c] = 0.0
    return replace(record, weight=weight, start=start)
