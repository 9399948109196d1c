"""Live smoother of a log: static lines, fixed-lag Kalman smoother, temperatures row by row.

Rows come in chunks of any length. The state is a separate value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.rig.plausible import out_of_range
from tcdyn.rig.record import MAX_LAG_S
from tcdyn.rig.static_line import StaticLine, apply_static, reading_u
from tcdyn.sensors.units import uncertainty_column
from tcdyn.smoothing.inverse import FilterReport, lag_sensitivity_filter, lag_split_filter
from tcdyn.smoothing.live import LiveSmoother, report_live_smoother
from tcdyn.smoothing.live_model import LiveState
from tcdyn.smoothing.record import SPIKE
from tcdyn.smoothing.traces import DiskChannels
from tcdyn.workflows.reachable import Reach, ReadingTrack, Screening

Array = NDArray[np.float64]
# Process-noise intensity of tables that are not rig logs: the corner of the smoother is so many
# radians in one lag.
CORNER_LAGS = 6.0
# A longer gap [s] is reported; after a gap of ``LONGEST_GAP_S`` the smoother restarts.
REPORTED_GAP_S = 1.0
LONGEST_GAP_S = 60.0
# Longest delay of the output [s] that is accepted at any rate.
LONGEST_BEHIND_S = 60.0
# A step of fewer rows is not a gap at any rate: half a row above the regular step.
GAP_ROWS = 1.5
# A gap of fewer rows does not restart the smoother at any rate.
RESTART_ROWS = 10.0
# Most rows that wait for their answer, or are interpolated in a gap: a minute at the rig's 75 Hz.
# Bounds the memory.
MAX_HELD_ROWS = 4500
COUNTERS = ("spikes", "backward", "gaps", "longest_gap_s")


@dataclass(frozen=True)
class LiveSettings:
    """Settings of the live compensation.

    Attributes
    ----------
    behind_s
        Fixed lag of the smoother: how far it works behind the present [s].
    noise_K
        Noise of all channels; None: measured in the first ``learn_s`` seconds.
    intensity_K2_s3
        Process-noise intensity of all channels; None: 30 K2/s3 for a test on the rig, 3000 K2/s3 for a
        plunge.
    learn_s
        Length of the warm-up [s].
    """

    behind_s: float = 0.0
    noise_K: float | None = None
    intensity_K2_s3: float | None = None
    learn_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.behind_s < MAX_LAG_S or not 0 < self.learn_s < MAX_LAG_S:
            raise InputError(
                f"behind_s {self.behind_s:g}, learn_s {self.learn_s:g}",
                expected=f"at least 0 s behind, more than 0 s to learn from, both below {MAX_LAG_S:g} s",
            )
        for name, value in (("noise_K", self.noise_K), ("intensity_K2_s3", self.intensity_K2_s3)):
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} {value:g}", expected="a positive number")


@dataclass(frozen=True)
class LiveCompensatorState:
    """State between two calls: smoother, recent samples, rows that wait for their temperatures.

    Attributes
    ----------
    kernel
        State of the live smoother.
    memory
        States of the filters for the sensitivity to lag and split, shape (M, 3).
    waiting
        Rows (k, columns); NaN in every column where the logger left one out.
    found, found_u
        Temperatures and uncertainties that are not written yet, shape (k, M).
    screening
        Which readings were treated as missing.
    """

    kernel: LiveState
    memory: Array
    waiting: Array
    found: Array
    found_u: Array
    last_time_s: float = -np.inf
    spikes: int = 0
    backward: int = 0
    gaps: int = 0
    longest_gap_s: float = 0.0
    screening: Screening = field(
        default_factory=lambda: Screening.begin(ReadingTrack.begin(np.empty(0)))
    )

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers, exact to the last bit in JSON."""
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        return plain | {"kernel": self.kernel.to_json(), "screening": self.screening.to_json()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> LiveCompensatorState:
        """The state that :meth:`to_json` gave."""
        kept: dict[str, Any] = {
            k: np.array(v, dtype=float) if isinstance(v, list) else v for k, v in data.items()
        }
        parts = {
            "kernel": LiveState.from_json(data["kernel"]),
            "screening": Screening.from_json(data["screening"]),
        }
        return cls(**kept | parts)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings during the run."""
        spikes = [info("follow.spikes", count=self.spikes)] if self.spikes else []
        backward = [warning("follow.backward", count=self.backward)] if self.backward else []
        gaps = (
            [warning("follow.gaps", count=self.gaps, longest_s=self.longest_gap_s)]
            if self.gaps
            else []
        )
        return (*spikes, *backward, *gaps)


@dataclass(frozen=True)
class LiveCompensator:
    """Live compensator: columns, their calibration, and the smoother.

    Attributes
    ----------
    names
        All columns of a row.
    junctions
        The M columns to compensate, with ``lines``, ``chains``, uncertainties of the lag and its split
        (``lag_u_s``, ``split_u_s``), white noise ``noise_K`` and noise before the filter ``before_K``.
    dead
        Junctions without valid readings; their columns stay empty.

    Notes
    -----
    A row is written when the temperatures for its own time are available, so all columns of a row
    belong to its ``time_s``.
    """

    names: tuple[str, ...]
    junctions: tuple[str, ...]
    dead: tuple[str, ...]
    lines: tuple[StaticLine, ...]
    chains: tuple[Chain, ...]
    lag_u_s: Array
    split_u_s: Array
    noise_K: Array
    before_K: Array
    dt_s: float
    engine: LiveSmoother
    settings: LiveSettings

    @classmethod
    def create(
        cls,
        names: Sequence[str],
        channels: Sequence[DiskChannels],
        level_K2_s3: float | None,
        settings: LiveSettings,
        warm_up: Mapping[str, Any],
    ) -> LiveCompensator:
        """Create the compensator for columns ``names``.

        Parameters
        ----------
        names, channels
            Columns of a row; junctions with their calibration.
        level_K2_s3
            Process-noise intensity where the settings have none; None: by lag and noise.
        settings
            Settings of the live compensation.
        warm_up
            Result of the warm-up: dt_s, dead, noise_K (white noise by channel) and before_K (noise by
            channel that was white before the filter).
        """
        alive = [
            channel
            for disk in channels
            for channel in zip(
                disk.columns,
                disk.lines,
                disk.chains,
                np.diag(disk.lag_covariance_s2),
                disk.split_u_s,
            )
            if channel[0] not in warm_up["dead"]
        ]
        junctions, lines, chains, variances, split_u = zip(*alive)
        dt = float(warm_up["dt_s"])
        level = settings.intensity_K2_s3 or level_K2_s3
        after, before = (
            np.array([warm_up[k][n] for n in junctions], dtype=float)
            for k in ("noise_K", "before_K")
        )
        if level is None:
            corner = CORNER_LAGS / np.array([max(c.lag_s, dt) for c in chains])
            level = np.hypot(after, before) ** 2 * dt * corner**4 * (1 + CORNER_LAGS**2)
        longest_behind_s = max(LONGEST_BEHIND_S, MAX_HELD_ROWS * dt)
        if settings.behind_s > longest_behind_s:
            what = f"{{behind_s}} {settings.behind_s:g} with rows every {dt:.3g} s"
            raise InputError(
                what, expected=f"at most {longest_behind_s:g} s", parameters={"behind_s": None}
            )
        delay_s = max(c.delay_s for c in chains)
        if delay_s > longest_behind_s:
            what = f"a dead time of {delay_s:g} s with rows every {dt:.3g} s: rows would wait for too long"
            raise InputError(
                what, expected=f"at most {longest_behind_s:g} s", remedy="use `tcdyn compensate`"
            )
        engine = LiveSmoother.from_chains(
            chains, dt, after, level, round(settings.behind_s / dt), before
        )
        return cls(
            tuple(names),
            junctions,
            tuple(warm_up["dead"]),
            lines,
            chains,
            np.sqrt(np.maximum(variances, 0.0)),
            np.array(split_u),
            after,
            before,
            dt,
            engine,
            settings,
        )

    def warm_up_statistics(self) -> dict[str, Any]:
        """Return the result of the warm-up, for the state file."""
        levels = {"noise_K": self.noise_K, "before_K": self.before_K}
        named = {k: dict(zip(self.junctions, v.tolist())) for k, v in levels.items()}
        return {"dt_s": self.dt_s, "dead": list(self.dead), **named}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The channels that are left empty."""
        return tuple(warning("follow.dead", subject=name) for name in self.dead)

    @property
    def output_names(self) -> tuple[str, ...]:
        """All columns, then a standard deviation for each temperature of a junction."""
        return (
            *self.names,
            *(uncertainty_column(n) for n in self.names if n in {*self.junctions, *self.dead}),
        )

    @property
    def delays_s(self) -> Array:
        """By how much a channel's answer comes late (M,) [s]: dead time, and how far behind the
        smoother works.
        """
        return np.array([c.delay_s + self.engine.lag_samples * self.dt_s for c in self.chains])

    @property
    def delay_rows(self) -> int:
        """How many rows a row waits for its temperatures."""
        return int(np.ceil(np.max(self.delays_s) / self.dt_s - 1e-6))

    def start(self, first: Array, count: float = 0.0) -> LiveCompensatorState:
        """State before the first row, in equilibrium with ``first (M,)`` [degC, after the static
        lines].

        ``count``: how many readings are known to agree with ``first``.
        """
        m = len(self.junctions)
        memory = [np.concatenate([signal.lfilter_zi(*f) for f in pair]) for pair in self._filters]
        return LiveCompensatorState(
            self.engine.initial_state(first),
            np.array(memory) * first[:, None],
            np.empty((0, len(self.names))),
            np.empty((0, m)),
            np.empty((0, m)),
            screening=Screening.begin(ReadingTrack.begin(first, count)),
        )

    def check_fits(self, state: LiveCompensatorState) -> None:
        """Raise ValueError where the arrays of ``state`` have not the shapes of this plan's."""
        expected_state = self.start(np.zeros(len(self.junctions)))
        screening = state.screening
        expected_screening = expected_state.screening
        pairs: list[tuple[Any, Any]] = [
            (state.kernel, expected_state.kernel),
            (screening, expected_screening),
        ]
        pairs += [(screening.track, expected_screening.track), (state, expected_state)]
        for given, expected in pairs:
            for name, value in vars(expected).items():
                if not isinstance(value, np.ndarray):
                    continue
                shape = np.shape(getattr(given, name))
                if shape == (0,):  # JSON keeps no more of an array without rows
                    fits = not value.size
                elif name in ("waiting", "found", "found_u"):  # any number of rows
                    fits = shape[1:] == value.shape[1:]
                else:
                    fits = shape == value.shape
                if not fits:
                    raise ValueError(f"{name} has the shape {shape}")

    @cached_property
    def _filters(self) -> list[tuple[tuple[Array, Array], tuple[Array, Array]]]:
        """Filters from temperatures to their change per second of lag, and per split of the lag."""
        dt = self.dt_s
        return [
            (lag_sensitivity_filter(c, dt), lag_split_filter(c, u, dt))
            for c, u in zip(self.chains, self.split_u_s.tolist())
        ]

    @cached_property
    def reach(self) -> Reach:
        """How far the readings of each channel can move."""
        noise_K = np.hypot(self.noise_K, self.before_K)
        return Reach.create(self.chains, self.lag_u_s, self.split_u_s, noise_K, self.dt_s)

    def advance(
        self, state: LiveCompensatorState, rows: Array
    ) -> tuple[LiveCompensatorState, Array]:
        """Process ``rows`` (n, columns) as logged; return the state and the rows that are ready now.

        After a gap of more than a minute, a lag and ten rows the smoother restarts. The rows that still
        wait are returned first.
        """
        rows = np.asarray(rows, dtype=float)
        time = np.where(np.isinf(rows[:, (at := self.names.index("time_s"))]), np.nan, rows[:, at])
        before = np.fmax.accumulate(np.concatenate([[state.last_time_s], time]))
        rising = time > before[:-1]
        step = np.where(rising & np.isfinite(before[:-1]), time - before[:-1], 0.0)
        gap = step > max(REPORTED_GAP_S, GAP_ROWS * self.dt_s)
        if long_gaps := np.flatnonzero(step > self._longest_gap_s).tolist():
            state, first = self.advance(state, rows[: long_gaps[0]])
            fresh = replace(
                self.start(self._first_levels(rows[long_gaps[0] :], state)),
                **{k: getattr(state, k) for k in COUNTERS},
            )
            fresh = replace(fresh, screening=replace(state.screening, track=fresh.screening.track))
            fresh = replace(
                fresh,
                gaps=fresh.gaps + 1,
                longest_gap_s=max(fresh.longest_gap_s, float(step[long_gaps[0]])),
            )
            fresh, later = self.advance(fresh, rows[long_gaps[0] :])
            return fresh, np.concatenate([first, self.flush(state), later])
        positions = np.cumsum(np.round(np.maximum(step[rising] / self.dt_s, 1.0))).astype(int)
        regular_rows = np.full((int(positions[-1]) if len(positions) else 0, rows.shape[1]), np.nan)
        regular_rows[positions - 1] = rows[rising]
        state = replace(
            state,
            last_time_s=float(before[-1]),
            backward=state.backward + int(np.count_nonzero(~rising)),
            gaps=state.gaps + int(np.count_nonzero(gap)),
            longest_gap_s=max([state.longest_gap_s, *step[gap].tolist()]),
        )
        return self._advance_regular(state, regular_rows)

    @property
    def _longest_gap_s(self) -> float:
        """The gap beyond which the smoother starts anew [s]."""
        lag_s = min(max(c.lag_s for c in self.chains), MAX_HELD_ROWS * self.dt_s)
        return max(LONGEST_GAP_S, lag_s, RESTART_ROWS * self.dt_s)

    def flush(self, state: LiveCompensatorState) -> Array:
        """Return the rows that still wait when no more rows come, by the current estimate."""
        return self._advance_regular(state, np.full((self.delay_rows, len(self.names)), np.nan))[1]

    def _first_levels(self, rows: Array, state: LiveCompensatorState) -> Array:
        """First valid reading of each channel in ``rows``; its last known level where it has none."""
        y = self._apply_lines(rows)
        finite = np.isfinite(y)
        return np.where(
            finite.any(axis=0),
            y[np.argmax(finite, axis=0), np.arange(y.shape[1])],
            state.kernel.recent[-1],
        )

    def _logged(self, rows: Array) -> Array:
        """Readings of the junctions (n, M) [degC] before the static lines."""
        return rows[:, [self.names.index(n) for n in self.junctions]]

    def _apply_lines(self, rows: Array) -> Array:
        """Temperatures of the junctions (n, M) [degC] after the static lines, NaN outside the
        physical range.
        """
        logged = self._logged(rows)
        logged = np.where(out_of_range(logged), np.nan, logged)
        return np.column_stack(
            [apply_static(logged[:, i], line) for i, line in enumerate(self.lines)]
        )

    def _advance_regular(
        self, state: LiveCompensatorState, rows: Array
    ) -> tuple[LiveCompensatorState, Array]:
        """Like ``advance`` for one row a sample, NaN where the logger left one out."""
        if len(rows) == 0:
            return state, np.empty((0, len(self.output_names)))
        time_s = rows[:, self.names.index("time_s")]
        outside = out_of_range(self._logged(rows))
        screening, y, anew = state.screening.examined(
            self.reach, time_s, self._apply_lines(rows), outside
        )
        starts = np.flatnonzero(anew.any(axis=1)).tolist()
        borders = sorted({0, *starts, len(rows)})
        answers: list[Array] = []
        uncertainties: list[Array] = []
        for first, last in pairwise(borders):
            if first in starts:
                state = self._restart(state, y[first], anew[first])
            state, x, u = self._smooth(state, y[first:last])
            answers.append(x)
            uncertainties.append(u)
        x = np.concatenate(answers)
        u = np.concatenate(uncertainties)
        bad = out_of_range(x)
        state = replace(
            state,
            screening=screening.blanked(bad),
            waiting=_append(state.waiting, rows),
            found=_append(state.found, np.where(bad, np.nan, x)),
            found_u=_append(state.found_u, np.where(bad, np.nan, u)),
        )
        return self._pop_ready(state)

    def _smooth(
        self, state: LiveCompensatorState, y: Array
    ) -> tuple[LiveCompensatorState, Array, Array]:
        """The state after the readings ``y (n, M)`` [degC], temperatures [degC] and their
        uncertainty [K] (n, M).
        """
        kernel, x, sd, flags = self.engine.run(state.kernel, y)
        rate = np.empty_like(x)
        split_K = np.empty_like(x)
        memory = np.empty_like(state.memory)
        for i, (per_lag, divided) in enumerate(self._filters):
            rate[:, i], memory[i, :1] = signal.lfilter(*per_lag, x[:, i], zi=state.memory[i, :1])
            split_K[:, i], memory[i, 1:] = signal.lfilter(*divided, x[:, i], zi=state.memory[i, 1:])
        line_u = np.column_stack([reading_u(line, x[:, i]) for i, line in enumerate(self.lines)])
        u = np.sqrt(sd**2 + line_u**2 + (rate * self.lag_u_s) ** 2 + split_K**2)
        spikes = state.spikes + int(np.sum(flags == SPIKE))
        return replace(state, kernel=kernel, memory=memory, spikes=spikes), x, u

    def _restart(
        self, state: LiveCompensatorState, y: Array, anew: NDArray[np.bool_]
    ) -> LiveCompensatorState:
        """The state with the channels ``anew`` (M,) begun from their readings ``y`` (M,) [degC]."""
        fresh = self.start(np.where(anew, y, state.kernel.recent[-1]))
        kernel = {}
        for name in ("mean", "cov", "var", "weight", "held"):
            kernel[name] = getattr(state.kernel, name).copy()
            kernel[name][anew] = getattr(fresh.kernel, name)[anew]
        for name in ("recent", "past"):
            kernel[name] = getattr(state.kernel, name).reshape(-1, len(anew)).copy()
            kernel[name][:, anew] = getattr(fresh.kernel, name)[:, anew]
        memory = np.where(anew[:, None], fresh.memory, state.memory)
        return replace(state, kernel=replace(state.kernel, **kernel), memory=memory)

    def _pop_ready(self, state: LiveCompensatorState) -> tuple[LiveCompensatorState, Array]:
        """Return the complete rows, interpolated linearly between samples; the others wait on."""
        ready = max(len(state.waiting) - self.delay_rows, 0)
        out = np.full((ready, len(self.output_names)), np.nan)
        out[:, : len(self.names)] = state.waiting[:ready]
        out[:, [self.names.index(n) for n in self.dead]] = np.nan
        for i, (name, shift) in enumerate(zip(self.junctions, self.delays_s / self.dt_s)):
            whole_rows = int(np.floor(shift + 1e-6))
            fraction = shift - whole_rows if shift - whole_rows > 1e-6 else 0.0
            for source, column in ((state.found, name), (state.found_u, uncertainty_column(name))):
                values = source[whole_rows : whole_rows + ready, i]
                if fraction:
                    values = (1 - fraction) * values + fraction * source[
                        whole_rows + 1 : whole_rows + 1 + ready, i
                    ]
                out[:, self.output_names.index(column)] = values
        real = np.isfinite(state.waiting[:ready, self.names.index("time_s")])
        remaining = {k: getattr(state, k)[ready:] for k in ("waiting", "found", "found_u")}
        return replace(state, **remaining), out[real]

    def filter_report(self) -> FilterReport:
        """Filter report of the channel with the largest noise."""
        return report_live_smoother(self.engine, self.chains)

    def notes(self) -> dict[str, str]:
        """Notes at the head of the output."""
        return {
            "method": "live smoother",
            "behind_s": f"{self.settings.behind_s:g}",
            "dt_s": f"{self.dt_s:.9g}",
            "noise_K": f"{self.noise_K.min():.4g} to {self.noise_K.max():.4g}",
            "noise_before_filter_K": f"{self.before_K.min():.4g} to {self.before_K.max():.4g}",
            "intensity_K2_s3": f"{self.engine.intensity[0]:g}",
        }


def _append(waiting: Array, new: Array) -> Array:
    """New rows behind those that wait; an empty list that came back from JSON has lost its
    columns.
    """
    return np.concatenate([waiting.reshape(-1, new.shape[1]), new])
