"""Rows of a log, static lines, causal compensator, rows of temperatures: in pieces of any length, state kept apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from calibration.disk import CHANNELS
from calibration.errors import InputError
from calibration.lines.static import StaticLine, apply_static, static_u
from calibration.record import DiskRecord
from calibration.rig import Rig
from tcdyn.chain import Chain
from tcdyn.compensate.before_use import BeforeUse, before_use
from tcdyn.compensate.inverse import proper_inverse
from tcdyn.compensate.live import LiveSmoother, LiveState
from tcdyn.compensate.noise import noise_sd
from tcdyn.compensate.stream import CONTEXT, InverseState, InverseStream
from tcdyn.pipeline.live_report import MOST_GAIN, live_before_use
from tcdyn.traces import record_chains

Array = NDArray[np.float64]
INTENSITY_K2_S3 = {"ehl": 30.0, "immersion": 3000.0}  # an unloading bends by 10 K/s in a second, a plunge by 100 K/s
SPIKE_K = {"ehl": 1.5, "immersion": 30.0}  # within five samples no junction of a rig moves so far
SPIKE_SD = 10.0
HELD = 2  # samples in a row that may be a spike; the third is believed
LEAST_SAMPLES, LEAST_NOISE_K = 16, 1e-3
LONGEST_GAP_S = 600.0


@dataclass(frozen=True)
class Settings:
    """How to follow. ``method``: "live" smoother, ``behind_s`` [s] behind, or "inverse" of ``bandwidth_Hz``.

    ``noise_K`` and ``intensity_K2_s3`` for all channels; left out, the noise is measured in the first ``learn_s``
    seconds, and the intensity is 30 K2/s3 for a test on the rig, 3000 for a plunge.
    """

    method: Literal["live", "inverse"] = "live"
    behind_s: float = 0.0
    bandwidth_Hz: float = 0.5
    noise_K: float | None = None
    intensity_K2_s3: float | None = None
    learn_s: float = 5.0

    def __post_init__(self) -> None:
        if self.method not in ("live", "inverse"):
            raise InputError(f"method {self.method!r}", expected="live or inverse")
        if not 0 <= self.behind_s <= 60 or not 0 < self.learn_s <= 600:
            raise InputError(
                f"behind_s {self.behind_s:g}, learn_s {self.learn_s:g}",
                expected="0 to 60 s behind, and more than 0 and at most 600 s to learn from",
            )
        if self.method == "inverse" and self.behind_s > 0:
            raise InputError("the inverse cannot look back", expected="--behind-s with --method live only")
        for name, value in (("noise_K", self.noise_K), ("intensity_K2_s3", self.intensity_K2_s3)):
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} {value:g}", expected="a positive number")


@dataclass(frozen=True)
class CausalState:
    """All that is needed to go on: the compensator's state, recent samples, rows that wait for their temperatures."""

    kernel: LiveState | InverseState
    recent: Array
    run: Array
    rate_memory: Array
    waiting: Array
    waiting_real: Array
    found: Array
    found_u: Array
    last_time_s: float
    spikes: int = 0
    backward: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers, exact to the last bit in JSON."""
        rest = {k: v for k, v in vars(self).items() if k != "kernel"}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in rest.items()} | {
            "kernel": self.kernel.to_json()
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> CausalState:
        """The state that :meth:`to_json` gave."""
        kind = LiveState if "lagged" in data["kernel"] else InverseState
        plain = ("last_time_s", "spikes", "backward")
        arrays: dict[str, Any] = {k: np.array(v, dtype=float) for k, v in data.items() if k not in (*plain, "kernel")}
        return cls(kernel=kind.from_json(data["kernel"]), **arrays, **{k: data[k] for k in plain})

    def said(self) -> list[str]:
        """What was noticed on the way."""
        said = [f"{self.spikes} spikes were taken as missing"] if self.spikes else []
        return [*said, f"{self.backward} rows whose time does not rise were left out"] if self.backward else said


@dataclass(frozen=True)
class Causal:
    """What is done to each row: which columns are junctions, their lines, chains, compensator and shifts.

    ``shifts_s`` (M,): by how much a channel's answer comes late (dead time, lag behind, roll-off); a row is written
    once the answer for its own time is there, so all columns of a row belong to its ``time_s``.
    """

    names: tuple[str, ...]
    output_names: tuple[str, ...]
    junctions: tuple[str, ...]
    at: tuple[int, ...]
    lines: tuple[StaticLine, ...]
    chains: tuple[Chain, ...]
    lag_u_s: Array
    dt_s: float
    noise_K: Array
    intensity_K2_s3: float
    spike_K: Array
    shifts_s: Array
    engine: LiveSmoother | InverseStream
    settings: Settings
    warnings: tuple[str, ...]

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
        junctions: list[str] = []
        lines, chains, lag_u = [], [], []
        for disk, record in records.items():
            if record.chain is None:
                raise InputError(
                    f"the record of the {disk} disk holds no chain", remedy="calibrate it with plunge logs"
                )
            variances = np.diag(record.chain.lag_covariance())
            for c, chain, variance in zip(CHANNELS, record_chains(record, rig.disk_setup(disk)), variances):
                name = f"{disk}_{c}_degC" if kind == "ehl" else f"{c}_degC"
                if name not in learnt["dead"]:
                    junctions.append(name)
                    lines.append(record.static[c])
                    chains.append(chain)
                    lag_u.append(float(np.sqrt(max(variance, 0.0))))
        dt = float(learnt["dt_s"])
        noise = np.array([learnt["noise_K"][n] for n in junctions], dtype=float)
        level = settings.intensity_K2_s3 or INTENSITY_K2_S3[kind]
        engine: LiveSmoother | InverseStream
        if settings.method == "live":
            behind = round(settings.behind_s / dt)
            engine = LiveSmoother.of(chains, dt, noise, level, behind)
            shifts = np.array([c.delay_s + behind * dt for c in chains])
        else:
            engine = InverseStream.of([proper_inverse(c, dt, settings.bandwidth_Hz) for c in chains])
            shifts = np.array([f.remaining_shift_s for f in engine.filters])
        out = (*names, *(n.replace("_degC", "_u_K") for n in names if n in {*junctions, *learnt["dead"]}))
        said = tuple(f"column {n} shows nothing: it is left empty" for n in learnt["dead"])
        return cls(
            tuple(names), out, tuple(junctions), tuple(list(names).index(n) for n in junctions), tuple(lines),
            tuple(chains), np.array(lag_u), dt, noise, level, np.maximum(SPIKE_K[kind], SPIKE_SD * noise), shifts,
            engine, settings, said,
        )  # fmt: skip

    def learnt(self) -> dict[str, Any]:
        """What ``of`` needs besides the files."""
        dead = [n for n in self._temperatures() if n not in self.junctions]
        return {"dt_s": self.dt_s, "noise_K": dict(zip(self.junctions, self.noise_K.tolist())), "dead": dead}

    def _temperatures(self) -> list[str]:
        return [n.replace("_u_K", "_degC") for n in self.output_names if n.endswith("_u_K")]

    @property
    def rows_late(self) -> int:
        """How many rows a row waits for its temperatures."""
        return int(np.ceil(np.max(self.shifts_s) / self.dt_s - 1e-6))

    def start(self, first: Array) -> CausalState:
        """State before the first row, in equilibrium with ``first (M,)`` [degC, after the static lines]."""
        m, c = len(self.junctions), len(self.names)
        return CausalState(
            self.engine.start(first), np.tile(first, (CONTEXT, 1)), np.zeros((2, m)),
            self._rate(first[None], None)[1], np.empty((0, c)), np.empty(0), np.empty((0, m)), np.empty((0, m)),
            -np.inf,
        )  # fmt: skip

    def advance(self, state: CausalState, rows: Array) -> tuple[CausalState, Array]:
        """Take ``rows (n, columns)`` as logged; the rows (k, output columns) that are ready now."""
        rows, real, state = self._even(state, np.asarray(rows, dtype=float))
        if len(rows) == 0:
            return state, np.empty((0, len(self.output_names)))
        y = np.column_stack([apply_static(rows[:, at], line) for at, line in zip(self.at, self.lines)])
        state, clean, filled, lost = self._cleaned(state, y)
        kernel: LiveState | InverseState
        if isinstance(self.engine, LiveSmoother):
            assert isinstance(state.kernel, LiveState)
            kernel, x, sd, _ = self.engine.run(state.kernel, clean)
        else:
            assert isinstance(state.kernel, InverseState)
            kernel, x, _ = self.engine.run(state.kernel, filled)
            sd = np.tile([f.noise_gain * s for f, s in zip(self.engine.filters, self.noise_K)], (len(x), 1))
        rate, memory = self._rate(x, state.rate_memory)
        still = np.column_stack([static_u(line, x[:, i]) for i, line in enumerate(self.lines)])
        u = np.sqrt(sd**2 + still**2 + (rate * self.lag_u_s) ** 2)
        if isinstance(self.engine, InverseStream):
            x, u = np.where(lost, np.nan, x), np.where(lost, np.nan, u)
        state = replace(state, kernel=kernel, rate_memory=memory)
        return self._aligned(state, rows, real, x, u)

    def _even(self, state: CausalState, rows: Array) -> tuple[Array, Array, CausalState]:
        """Rows with empty ones where samples are lacking; those whose time does not rise are left out."""
        at = self.names.index("time_s")
        out, real, last, backward = [], [], state.last_time_s, state.backward
        for row in rows:
            t = float(row[at])
            if not t > last or t == np.inf:
                backward += 1
                continue
            missed = round((t - last) / self.dt_s) - 1 if np.isfinite(last) else 0
            if missed * self.dt_s > LONGEST_GAP_S:
                raise InputError(
                    f"column time_s jumps from {last:.6g} s to {t:.6g} s",
                    expected=f"gaps of at most {LONGEST_GAP_S:g} s",
                    remedy="follow what comes after it as a log of its own",
                )
            out += [np.full(len(row), np.nan)] * max(missed, 0) + [row]
            real += [0.0] * max(missed, 0) + [1.0]
            last = t
        state = replace(state, last_time_s=last, backward=backward)
        return np.array(out).reshape(-1, len(self.names)), np.array(real), state

    def _cleaned(self, state: CausalState, y: Array) -> tuple[CausalState, Array, Array, NDArray[np.bool_]]:
        """Spikes as missing; the same with medians of the last five in their place; where that median is too old."""
        recent, (high, absent) = state.recent.copy(), state.run
        clean, filled, lost = y.copy(), y.copy(), np.zeros(y.shape, dtype=bool)
        spikes = 0
        for k, now in enumerate(y):
            middle = np.sort(recent, axis=0)[CONTEXT // 2]
            missing = ~np.isfinite(now)
            spike = ~missing & (np.abs(now - middle) > self.spike_K) & (high < HELD)
            high = np.where(spike, high + 1, np.where(missing, high, 0.0))
            bad = spike | missing
            absent = np.where(bad, absent + 1, 0.0)
            clean[k, bad] = np.nan
            filled[k, bad] = middle[bad]
            lost[k] = absent > CONTEXT
            recent[:-1] = recent[1:]
            recent[-1] = np.where(missing, middle, now)
            spikes += int(spike.sum())
        done = replace(state, recent=recent, run=np.array([high, absent]), spikes=state.spikes + spikes)
        return done, clean, filled, lost

    def _rate(self, x: Array, memory: Array | None) -> tuple[Array, Array]:
        """s/(1 + tau s) of ``x (n, M)``, tau the largest lag: its change per second of lag; memory (M,)."""
        out, left = np.empty_like(x), np.empty(x.shape[1])
        for i, chain in enumerate(self.chains):
            tau = max((*chain.taus_s, self.dt_s))
            e = float(np.exp(-self.dt_s / tau))
            b, a = [(1 - e) / self.dt_s, -(1 - e) / self.dt_s], [1.0, -e]
            zi = signal.lfilter_zi(b, a) * x[0, i] if memory is None else memory[i : i + 1]
            out[:, i], zf = signal.lfilter(b, a, x[:, i], zi=zi)
            left[i] = zf[0]
        return out, left

    def _aligned(self, state: CausalState, rows: Array, real: Array, x: Array, u: Array) -> tuple[CausalState, Array]:
        """Each row with the answers for its own time, those between samples by straight lines."""
        rows = np.concatenate([state.waiting.reshape(-1, len(self.names)), rows])
        real = np.concatenate([state.waiting_real, real])
        x = np.concatenate([state.found.reshape(-1, len(self.junctions)), x])
        u = np.concatenate([state.found_u.reshape(-1, len(self.junctions)), u])
        late = self.rows_late
        ready = max(len(rows) - late, 0)
        out = np.full((ready, len(self.output_names)), np.nan)
        out[:, : len(self.names)] = rows[:ready]
        out[:, [self.names.index(n) for n in self._temperatures()]] = np.nan
        for i, (name, shift) in enumerate(zip(self.junctions, self.shifts_s)):
            whole = int(np.floor(shift / self.dt_s + 1e-6))
            part = shift / self.dt_s - whole
            for source, column in ((x, name), (u, name.replace("_degC", "_u_K"))):
                values = source[whole : whole + ready, i]
                if part > 1e-6:
                    values = (1 - part) * values + part * source[whole + 1 : whole + 1 + ready, i]
                out[:, self.output_names.index(column)] = values
        state = replace(
            state, waiting=rows[ready:], waiting_real=real[ready:], found=x[ready:], found_u=u[ready:]
        )  # fmt: skip
        return state, out[real[:ready] > 0]

    def before_use(self) -> BeforeUse:
        """The report on the channel whose answer is noisiest; a warning beyond ten times the trace's noise."""
        if isinstance(self.engine, LiveSmoother):
            return live_before_use(self.engine, self.chains)
        noisy = [f.noise_gain * sd for f, sd in zip(self.engine.filters, self.noise_K)]
        worst = int(np.argmax(noisy))
        sd = float(self.noise_K[worst])
        return before_use(self.engine.filters[worst], sd, wanted_K=MOST_GAIN * sd)

    def notes(self) -> dict[str, str]:
        """What the output says about itself."""
        noise = f"{self.noise_K.min():.4g} to {self.noise_K.max():.4g}"
        own = {"dt_s": f"{self.dt_s:.9g}", "noise_K": noise}
        if self.settings.method == "live":
            own = {"method": "live smoother", "behind_s": f"{self.settings.behind_s:g}", **own}
            return own | {"intensity_K2_s3": f"{self.intensity_K2_s3:g}"}
        shift = f"{self.shifts_s.max():.4g} s at most, taken off: each row holds the temperatures of its own time_s"
        own = {"method": "proper inverse", "bandwidth_Hz": f"{self.settings.bandwidth_Hz:g}", **own}
        return own | {"remaining_shift": shift}


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
            remedy="raise --learn-s",
        )
    noise, first, dead = {}, [], []
    for disk, record in records.items():
        for c in CHANNELS:
            name = f"{disk}_{c}_degC" if kind == "ehl" else f"{c}_degC"
            y = np.asarray(apply_static(rows[:, list(names).index(name)], record.static[c]))
            good = y[np.isfinite(y)]
            if len(good) < LEAST_SAMPLES:
                dead.append(name)
                continue
            noise[name] = settings.noise_K or max(noise_sd(y), LEAST_NOISE_K)
            first.append(float(np.median(good[:CONTEXT])))
    if not noise:
        raise InputError("no channel shows a temperature", remedy="check the log's columns")
    learnt = {"dt_s": float(np.median(steps)), "noise_K": noise, "dead": dead}
    plan = Causal.of(names, kind, records, rig, settings, learnt)
    return plan, plan.start(np.array(first))
