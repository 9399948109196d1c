"""The fitting problem: parameters in a vector, runs cut at missing inputs, residuals with their exact Jacobian."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Literal

import numpy as np

from calibration import Array
from calibration.errors import InputError
from calibration.noise import rounding_sd
from tcdyn.chain.rational import Start, free_rows, realise, simulate_rows
from tcdyn.fitting import Noise, Problem
from tcdyn.identify.data import SHORTEST, IOData, Segment, cut, input_noise_sd
from tcdyn.identify.models import Model

Initial = Literal["equilibrium", "zero", "estimated"]


@dataclass(frozen=True)
class Posed:
    """One input, one output, one model. The vector x holds the free parameters (positive ones as logarithms), then
    the offset(s), then the initial states of the segments whose state is free: those after a gap, or all when
    ``initial`` is "estimated"; then what the input was before each segment begun in equilibrium, over its first
    sample, where the input is measured with noise. Of that past the first sample tells with the weight
    ``noise_sd``/``input_sd``, noise of the output over noise of the input; 0 for the latter is an input that is known.
    With a ``trend`` x ends with the drift of each run, over the length of the longest segment."""

    model: Model
    segments: tuple[Segment, ...]
    dt_s: float
    hold: Literal["zoh", "foh"]
    initial: Initial
    time_scale_s: float = 1.0
    input_sd: float = 0.0
    noise_sd: float = 1.0
    trend: bool = False

    @property
    def n_model(self) -> int:
        """Free model parameters."""
        return len(self.model.free)

    @cached_property
    def loose(self) -> tuple[bool, ...]:
        """Whether the initial state of each segment is free."""
        return tuple(s.resumed or self.initial == "estimated" for s in self.segments)

    @cached_property
    def places(self) -> tuple[tuple[slice, slice], ...]:
        """Where in x the offset and the initial state of each segment stand; empty where there is none.

        There is no offset where an integrator's free state is one already.
        """
        m, runs = self.model, sorted({s.run for s in self.segments})
        offsets = {"free": 1, "per run": len(runs), "none": 0}[m.offset] * (not (m.integrators and all(self.loose)))
        states = m.order + m.integrators + len(m.known.den) - 1
        edges = self.n_model + offsets + states * np.cumsum([0, *self.loose])
        own = [self.n_model + (runs.index(s.run) if m.offset == "per run" else 0) for s in self.segments]
        return tuple((slice(o, o + (offsets > 0)), slice(a, b)) for o, a, b in zip(own, edges, edges[1:].tolist()))

    @cached_property
    def pasts(self) -> tuple[int | None, ...]:
        """Where in x the level of the input before each segment stands, over its first sample; None where there is
        none. What an integrator has made of a past is its offset."""
        asked = self.input_sd > 0 and self.initial == "equilibrium" and not self.model.integrators
        at = count(self.places[-1][1].stop)
        return tuple(next(at) if asked and not loose else None for loose in self.loose)

    @property
    def size(self) -> int:
        """Length of x."""
        return self.places[-1][1].stop + sum(k is not None for k in self.pasts) + self.trend * len(self.begun_s)

    @cached_property
    def begun_s(self) -> dict[int, float]:
        """When each run begins [s]."""
        return {s.run: s.start_s for s in reversed(self.segments)}

    @cached_property
    def precision(self) -> Array:
        """What is known beforehand of x (size,), in units of the output's noise: the past, by its first sample."""
        known = np.zeros(self.size)
        known[[k for k in self.pasts if k is not None]] = (self.noise_sd / (self.input_sd or 1.0)) ** 2
        return known

    @property
    def n_seen(self) -> int:
        """Measured output samples."""
        return int(sum(s.seen.sum() for s in self.segments))

    def theta(self, x: Array) -> dict[str, float]:
        """All model parameters by name."""
        values = {n: float(np.exp(v)) if self.model.positive(n) else float(v) for n, v in zip(self.model.free, x)}
        return self.model.full(values)

    def vector(self, theta: Mapping[str, float]) -> Array:
        """x for the model parameters; offsets and initial states zero."""
        x = np.zeros(self.size)
        for i, n in enumerate(self.model.free):
            x[i] = np.log(max(theta[n], 1e-12)) if self.model.positive(n) else theta[n]
        return x

    @cached_property
    def reach(self) -> int:
        """Samples by which a dead time can hold the input back."""
        if "Td" not in self.model.names:
            return 0
        return int(np.ceil(self.model.fixed.get("Td", self.longest_delay_s) / self.dt_s)) + 1

    @cached_property
    def longest_s(self) -> float:
        """Length of the longest segment [s]."""
        return max(len(s.u) for s in self.segments) * self.dt_s

    @property
    def longest_delay_s(self) -> float:
        """The largest dead time that is looked for [s]."""
        return self.model.delay_max_s or 0.5 * self.longest_s

    @property
    def begun(self) -> Start:
        """The state in which runs begin, unless it is estimated."""
        return "zero" if self.initial == "zero" else "equilibrium"

    def natural_scale(self, x: Array) -> Array:
        """d(natural parameter)/dx of the free model parameters (n_model,)."""
        return np.array([np.exp(v) if self.model.positive(n) else 1.0 for n, v in zip(self.model.free, x)])

    @cached_property
    def parts(self) -> list[slice]:
        """Slices of the residual vector within which samples follow each other without a gap."""
        found, at = [], 0
        for segment in self.segments:
            index = np.flatnonzero(segment.seen)
            for part in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1):
                found.append(slice(at, at + len(part)))
                at += len(part)
        return found

    @cached_property
    def measured(self) -> Array:
        """The measured output samples of all segments in a row (N,)."""
        return np.concatenate([s.y[s.seen] for s in self.segments])

    @cached_property
    def rounding_step(self) -> float:
        """The step in which the output's logger counts, where neighbours are often equal; else zero."""
        if rounding_sd(self.measured) == 0:
            return 0.0
        moved = np.abs(np.diff(self.measured))
        return float(moved[moved > 1e-9 * moved.max()].min())

    def bounds(self) -> tuple[Array, Array]:
        """Box of x: lags between a hundredth of a sample and a hundred records, dead time up to its maximum."""
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for i, n in enumerate(self.model.free):
            if n == "Td":
                lower[i], upper[i] = 0.0, self.longest_delay_s
            elif n == "Zeta":
                lower[i], upper[i] = np.log(1e-3), np.log(20.0)
            elif self.model.positive(n):
                lower[i], upper[i] = np.log(1e-2 * self.dt_s), np.log(100 * self.longest_s)
        return lower, upper

    def outputs(self, x: Array) -> list[tuple[Array, Array]] | None:
        """Per segment the model output (N,) and its Jacobian (N, size); None where the model is unstable."""
        theta, n = self.theta(x), self.n_model
        rational = self.model.rational(theta)
        if not rational.stable:
            return None
        system, rule = realise(rational), self.model.chain_rule(theta) * self.natural_scale(x)
        answers = []
        for segment, (offset, state), level in zip(self.segments, self.places, self.pasts):
            past = segment.history(self.reach) if segment.resumed else segment.past  # what a dead time brings in
            u = np.concatenate([past, segment.u])
            if level is None:
                rows = simulate_rows(system, u, self.dt_s, rational.delay_s, self.hold, self.begun)[:, len(past) :]
            else:  # what it was for ever, and from the first sample on the departure from that
                before = u[0] + x[level]
                rows = simulate_rows(system, u - before, self.dt_s, rational.delay_s, self.hold, "zero")
                rows += before * simulate_rows(system, np.ones(1), self.dt_s, 0.0, "zoh", "equilibrium")
            y, j = rows[0] + x[offset].sum(), np.zeros((len(segment.u), self.size))
            j[:, :n] = rows[1:].T @ rule
            j[:, offset] = 1.0
            if self.trend:
                run = self.size - len(self.begun_s) + sorted(self.begun_s).index(segment.run)
                j[:, run] = (
                    segment.start_s - self.begun_s[segment.run] + self.dt_s * np.arange(len(y))
                ) / self.longest_s
                y = y + x[run] * j[:, run]
            if level is not None:
                plain, one = realise(rational, False), np.ones(len(u))
                j[:, level] = rational.num[0] - simulate_rows(plain, one, self.dt_s, rational.delay_s, "zoh", "zero")[0]
            if states := len(x[state]):
                scale = self.time_scale_s ** np.arange(1.0, states + 1)
                begun = realise(replace(rational, num=x[state] * scale, delay_s=0.0))
                free = free_rows(begun, len(y), self.dt_s)  # its value, d/dnumerator, d/dfactor coefficients
                y, by_factor = y + free[0], free[1 + states : -1]
                j[:, :n] += by_factor.T @ rule[len(rule) - 1 - len(by_factor) : -1]
                j[:, state] = free[1 : 1 + states].T * scale
            answers.append((y, j))
        return answers

    def evaluate(self, x: Array) -> tuple[Array, Array] | None:
        """Residuals model - measured at the measured samples, all segments in a row, and their Jacobian."""
        answers = self.outputs(x)
        if answers is None:
            return None
        seen = [(y[s.seen] - s.y[s.seen], j[s.seen]) for s, (y, j) in zip(self.segments, answers)]
        residual, jacobian = (np.concatenate(each) for each in zip(*seen))
        return (residual, jacobian) if np.isfinite(residual).all() else None

    def core(self, noise: Noise | None = None, root: Array | float = 1.0) -> Problem:
        """The problem as :mod:`tcdyn.fitting` solves it; residuals times ``root`` (N,), then whitened by ``noise``."""

        def evaluate(x: Array) -> tuple[Array, Array] | None:
            answer = self.evaluate(x)
            if answer is None:
                return None
            whiten = (noise or Noise()).whiten
            return whiten(answer[0] * root, self.parts), whiten((answer[1].T * root).T, self.parts)

        lower, upper = self.bounds()
        names = (*self.model.free, *(f"x{i}" for i in range(self.n_model, self.size)))
        with np.errstate(divide="ignore"):
            sd = 1 / np.sqrt(self.precision)
        return Problem(names, evaluate, lower=lower, upper=upper, prior_sd=sd)


def nothing_left(data: IOData) -> str:
    """Which column is to blame where no stretch of the data can be used."""
    for name, columns in (
        (data.input_names[0], [r.u[:, 0] for r in data.runs]),
        (data.output_names[0], [r.y[:, 0] for r in data.runs]),
    ):
        if not any(np.isfinite(c).any() for c in columns):
            return f"column {name} holds no number at all (NaN everywhere)"
    return f"column {data.input_names[0]} has no {SHORTEST} samples in a row, with the output measured, without a gap"


def pose(data: IOData, model: Model, initial: Initial, input_noise: float | Literal["auto"] = 0.0) -> Posed:
    """The problem of fitting ``model`` to one-input one-output ``data``; refuses data nothing can be learnt
    from. ``input_noise`` is its sd, in the input's unit."""
    where = data.name or "identify"
    if len(data.input_names) != 1 or len(data.output_names) != 1:
        raise InputError(
            f"the data hold {len(data.input_names)} inputs and {len(data.output_names)} outputs",
            where=where,
            remedy="choose one of each: data.select(input=.., output=..)",
        )
    segments = tuple(s for k, run in enumerate(data.runs) for s in cut(run, k, data.dt_s))
    if not segments:
        raise InputError(nothing_left(data), where=where, remedy="see whether the right column was taken")
    if all(np.ptp(s.u) == 0 for s in segments) and len({float(s.u[0]) for s in segments}) == 1:
        raise InputError(
            f"input {data.input_names[0]} is constant ({segments[0].u[0]:g})",
            where=where,
            expected="an input that moves: without a change there is no dynamics to see",
        )
    if data.hold == "zoh" and model.has_delay and model.order + model.integrators + len(model.known.den) == 1:
        raise InputError(
            f"{model.name} cannot find a dead time under a held input: nothing moves until it passes a whole sample",
            remedy="add a lag (P1D)",
        )
    if input_noise != "auto" and not 0 <= input_noise < np.inf:
        raise InputError(
            f"the input's noise is {input_noise}", where=where, expected="a standard deviation in the input's unit"
        )
    sd = input_noise_sd(segments) if input_noise == "auto" else float(input_noise)
    problem = Posed(model, segments, data.dt_s, data.hold, initial, input_sd=sd)
    problem = replace(problem, noise_sd=float(np.std(np.diff(problem.measured))) / np.sqrt(2) or 1.0)
    if problem.n_seen < max(2 * problem.size, 8):
        raise InputError(
            f"{problem.n_seen} measured samples for {problem.size} unknowns of {model.name}",
            where=where,
            expected=f"at least {max(2 * problem.size, 8)}",
            remedy="record longer or choose a smaller model",
        )
    if all(np.nanstd(s.y) == 0 for s in segments):
        raise InputError(f"output {data.output_names[0]} never moves", where=where, remedy="check the channel")
    return problem
