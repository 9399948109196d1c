"""Rows of a log, static lines, live smoother, rows of temperatures: in pieces of any length, state kept apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from calibration.errors import InputError
from calibration.finding import Finding, look, note
from calibration.lines.static import StaticLine, apply_static, static_u
from calibration.noise import SPIKES, trace_noise_sd
from calibration.record import DiskRecord
from calibration.rig import Rig
from tcdyn.chain import Chain
from tcdyn.compensate.inverse import BeforeUse, lag_rate
from tcdyn.compensate.live import LiveSmoother, LiveState, live_before_use
from tcdyn.compensate.record import SPIKE
from tcdyn.traces import DiskChannels, disk_channels

Array = NDArray[np.float64]
INTENSITY_K2_S3 = {"ehl": 30.0, "immersion": 3000.0}  # an unloading bends by 10 K/s in a second, a plunge by 100 K/s
LEAST_SAMPLES, LEAST_NOISE_K = 16, 1e-3
LONGEST_GAP_S = 600.0


@dataclass(frozen=True)
class Settings:
    """How to follow: the live smoother works ``behind_s`` [s] behind the present.

    ``noise_K`` and ``intensity_K2_s3`` for all channels; left out, the noise is measured in the first ``learn_s``
    seconds, and the intensity is 30 K2/s3 for a test on the rig, 3000 for a plunge.
    """

    behind_s: float = 0.0
    noise_K: float | None = None
    intensity_K2_s3: float | None = None
    learn_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.behind_s <= 60 or not 0 < self.learn_s <= 600:
            raise InputError(
                f"behind_s {self.behind_s:g}, learn_s {self.learn_s:g}",
                expected="0 to 60 s behind, and more than 0 and at most 600 s to learn from",
            )
        for name, value in (("noise_K", self.noise_K), ("intensity_K2_s3", self.intensity_K2_s3)):
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} {value:g}", expected="a positive number")


@dataclass(frozen=True)
class CausalState:
    """All that is needed to go on: the smoother's state, recent samples, rows that wait for their temperatures.

    ``waiting`` (k, columns): rows, NaN in every column where the logger left one out; ``found`` and ``found_u`` (k, M):
    answers not yet written.
    """

    kernel: LiveState
    rate_memory: Array
    waiting: Array
    found: Array
    found_u: Array
    last_time_s: float = -np.inf
    spikes: int = 0
    backward: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers, exact to the last bit in JSON."""
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        return plain | {"kernel": self.kernel.to_json()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> CausalState:
        """The state that :meth:`to_json` gave."""
        kept: dict[str, Any] = {k: np.array(v, dtype=float) if isinstance(v, list) else v for k, v in data.items()}
        return cls(**kept | {"kernel": LiveState.from_json(data["kernel"])})

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was noticed on the way."""
        spikes = [note("follow.spikes", count=self.spikes)] if self.spikes else []
        return (*spikes, *([look("follow.backward", count=self.backward)] if self.backward else []))


@dataclass(frozen=True)
class Causal:
    """What is done to each row: which columns are junctions, how they are measured, and the smoother for them.

    ``names``: all columns of a row; ``junctions`` (M,): those to compensate, with their ``lines``, ``chains``,
    uncertainty of the lag and noise; ``dead``: those that show nothing and are left empty. A row is written once the
    answer for its own time is there, so all columns of a row belong to its ``time_s``.
    """

    names: tuple[str, ...]
    junctions: tuple[str, ...]
    dead: tuple[str, ...]
    lines: tuple[StaticLine, ...]
    chains: tuple[Chain, ...]
    lag_u_s: Array
    noise_K: Array
    dt_s: float
    engine: LiveSmoother
    settings: Settings

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        kind: str,
        records: Mapping[str, DiskRecord],
        rig: Rig,
        settings: Settings,
        learnt: Mapping[str, Any],
    ) -> Causal:
        """The plan for columns ``names``; ``learnt``: dt_s, noise_K and dead (columns that show nothing)."""
        alive = [
            one
            for disk in _channels(kind, records, rig)
            for one in zip(disk.columns, disk.lines, disk.chains, np.diag(disk.lag_covariance_s2))
            if one[0] not in learnt["dead"]
        ]
        junctions, lines, chains, variances = zip(*alive)
        dt, noise = float(learnt["dt_s"]), np.array([learnt["noise_K"][n] for n in junctions], dtype=float)
        level = settings.intensity_K2_s3 or INTENSITY_K2_S3[kind]
        coarse = SPIKES["live immersion" if kind == "immersion" else "live ehl"]
        engine = LiveSmoother.of(chains, dt, noise, level, round(settings.behind_s / dt), coarse)
        return cls(
            tuple(names), junctions, tuple(learnt["dead"]), lines, chains, np.sqrt(np.maximum(variances, 0.0)), noise,
            dt, engine, settings,
        )  # fmt: skip

    def learnt(self) -> dict[str, Any]:
        """What ``of`` needs besides the files."""
        noise = dict(zip(self.junctions, self.noise_K.tolist()))
        return {"dt_s": self.dt_s, "noise_K": noise, "dead": list(self.dead)}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The channels that are left empty."""
        return tuple(look("follow.dead", subject=name) for name in self.dead)

    @property
    def output_names(self) -> tuple[str, ...]:
        """All columns, then a standard deviation for each temperature of a junction."""
        return (*self.names, *(_u(n) for n in self.names if n in {*self.junctions, *self.dead}))

    @property
    def shifts_s(self) -> Array:
        """By how much a channel's answer comes late (M,) [s]: dead time, and how far behind the smoother works."""
        return np.array([c.delay_s + self.engine.lag_samples * self.dt_s for c in self.chains])

    @property
    def rows_late(self) -> int:
        """How many rows a row waits for its temperatures."""
        return int(np.ceil(np.max(self.shifts_s) / self.dt_s - 1e-6))

    def start(self, first: Array) -> CausalState:
        """State before the first row, in equilibrium with ``first (M,)`` [degC, after the static lines]."""
        m = len(self.junctions)
        memory = [signal.lfilter_zi(*lag_rate(self.chains[i], self.dt_s))[0] * y for i, y in enumerate(first)]
        return CausalState(
            self.engine.start(first), np.array(memory),
            np.empty((0, len(self.names))), np.empty((0, m)), np.empty((0, m)),
        )  # fmt: skip

    def advance(self, state: CausalState, rows: Array) -> tuple[CausalState, Array]:
        """Take ``rows (n, columns)`` as logged; the rows (k, output columns) that are ready now."""
        state, rows = self._even(state, np.asarray(rows, dtype=float))
        if len(rows) == 0:
            return state, np.empty((0, len(self.output_names)))
        logged = rows[:, [self.names.index(n) for n in self.junctions]]
        y = np.column_stack([apply_static(logged[:, i], line) for i, line in enumerate(self.lines)])
        kernel, x, sd, flags = self.engine.run(state.kernel, y)
        rate, memory = np.empty_like(x), np.empty(x.shape[1])
        for i in range(x.shape[1]):
            per_lag = lag_rate(self.chains[i], self.dt_s)
            rate[:, i], memory[i : i + 1] = signal.lfilter(*per_lag, x[:, i], zi=state.rate_memory[i : i + 1])
        line_u = np.column_stack([static_u(line, x[:, i]) for i, line in enumerate(self.lines)])
        u = np.sqrt(sd**2 + line_u**2 + (rate * self.lag_u_s) ** 2)
        state = replace(
            state, kernel=kernel, rate_memory=memory, spikes=state.spikes + int(np.sum(flags == SPIKE)),
            waiting=_joined(state.waiting, rows), found=_joined(state.found, x), found_u=_joined(state.found_u, u),
        )  # fmt: skip
        return self._ready(state)

    def _even(self, state: CausalState, rows: Array) -> tuple[CausalState, Array]:
        """Rows with empty ones where samples are lacking; those whose time does not rise are left out."""
        time = np.where(np.isinf(rows[:, (at := self.names.index("time_s"))]), np.nan, rows[:, at])
        before = np.fmax.accumulate(np.concatenate([[state.last_time_s], time]))
        rising = time > before[:-1]
        step = (time - before[:-1])[rising]
        missed = np.where(np.isfinite(step), np.round(step / self.dt_s) - 1, 0).clip(0)
        if (gap := missed * self.dt_s > LONGEST_GAP_S).any():
            k = np.flatnonzero(rising)[int(np.argmax(gap))]
            raise InputError(
                f"column time_s jumps from {before[k]:.6g} s to {time[k]:.6g} s",
                expected=f"gaps of at most {LONGEST_GAP_S:g} s",
                remedy="follow what comes after it as a log of its own",
            )
        place = np.cumsum(missed + 1).astype(int)
        out = np.full((int(place[-1]) if len(place) else 0, rows.shape[1]), np.nan)
        out[place - 1] = rows[rising]
        backward = state.backward + int(np.count_nonzero(~rising))
        return replace(state, last_time_s=float(before[-1]), backward=backward), out

    def _ready(self, state: CausalState) -> tuple[CausalState, Array]:
        """The rows whose answers are all there, those between samples by straight lines; the rest goes on waiting."""
        ready = max(len(state.waiting) - self.rows_late, 0)
        out = np.full((ready, len(self.output_names)), np.nan)
        out[:, : len(self.names)] = state.waiting[:ready]
        out[:, [self.names.index(n) for n in self.dead]] = np.nan
        for i, (name, shift) in enumerate(zip(self.junctions, self.shifts_s / self.dt_s)):
            whole = int(np.floor(shift + 1e-6))
            part = shift - whole if shift - whole > 1e-6 else 0.0
            for source, column in ((state.found, name), (state.found_u, _u(name))):
                values = source[whole : whole + ready, i]
                if part:
                    values = (1 - part) * values + part * source[whole + 1 : whole + 1 + ready, i]
                out[:, self.output_names.index(column)] = values
        real = np.isfinite(state.waiting[:ready, self.names.index("time_s")])
        left = {k: getattr(state, k)[ready:] for k in ("waiting", "found", "found_u")}
        return replace(state, **left), out[real]

    def before_use(self) -> BeforeUse:
        """The report on the channel whose answer is noisiest."""
        return live_before_use(self.engine, self.chains)

    def notes(self) -> dict[str, str]:
        """What the output says about itself."""
        return {
            "method": "live smoother",
            "behind_s": f"{self.settings.behind_s:g}",
            "dt_s": f"{self.dt_s:.9g}",
            "noise_K": f"{self.noise_K.min():.4g} to {self.noise_K.max():.4g}",
            "intensity_K2_s3": f"{self.engine.intensity[0]:g}",
        }


def begin(
    names: Sequence[str], rows: Array, kind: str, records: Mapping[str, DiskRecord], rig: Rig, settings: Settings
) -> tuple[Causal, CausalState]:
    """Plan and first state from the first seconds ``rows (n, columns)``: sample interval, noise, starting level."""
    time = rows[:, list(names).index("time_s")]
    steps = np.diff(time[np.isfinite(time)])
    steps = steps[steps > 0]
    if len(steps) < LEAST_SAMPLES:
        raise InputError(
            f"{len(steps) + 1} samples in the first {settings.learn_s:g} s",
            expected=f"at least {LEAST_SAMPLES + 1}",
            remedy="raise learn_s",
            parameters=("learn_s",),
        )
    noise, first, dead = {}, [], []
    for disk in _channels(kind, records, rig):
        for name, line in zip(disk.columns, disk.lines):
            y = apply_static(rows[:, list(names).index(name)], line)
            good = y[np.isfinite(y)]
            if len(good) < LEAST_SAMPLES:
                dead.append(name)
                continue
            noise[name] = settings.noise_K or max(trace_noise_sd(y), LEAST_NOISE_K)
            first.append(float(np.median(good[: SPIKES["live ehl"].width])))
    if not noise:
        raise InputError("no channel shows a temperature", remedy="check the log's columns")
    learnt = {"dt_s": float(np.median(steps)), "noise_K": noise, "dead": dead}
    plan = Causal.of(names, kind, records, rig, settings, learnt)
    return plan, plan.start(np.array(first))


def _channels(kind: str, records: Mapping[str, DiskRecord], rig: Rig) -> list[DiskChannels]:
    return [
        disk_channels(record, rig.disk_setup(disk), f"{disk}_" if kind == "ehl" else "")
        for disk, record in records.items()
    ]


def _joined(waiting: Array, new: Array) -> Array:
    """New rows behind those that wait; an empty list that came back from JSON has lost its columns."""
    return np.concatenate([waiting.reshape(-1, new.shape[1]), new])


def _u(column: str) -> str:
    return column.replace("_degC", "_u_K")
