"""The fitting problem: parameters in a vector, runs cut at missing inputs, residuals with their exact Jacobian."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Literal

import numpy as np

from tcdyn.chain.rational import Rational, Realisation, Start, free_rows, realise, simulate_rows
from tcdyn.core import Array, Flags
from tcdyn.estimation import Noise, Problem
from tcdyn.estimation.arma import equation_error
from tcdyn.estimation.trace_noise import rounding_sd
from tcdyn.identify.models import Model, bare
from tcdyn.identify.segments import Segment

Initial = Literal["equilibrium", "zero", "estimated"]


@dataclass(frozen=True)
class Posed:
    """Inputs, one output, one model. The vector x holds the free parameters (positive ones as logarithms), then
    the offset(s), then the initial states of the segments whose state is free: those after a gap, or all when
    ``initial`` is "estimated"; then what the input was before each segment begun in equilibrium, over its first
    sample, where the input is measured with noise. Of that past the first sample tells with the weight
    ``noise_sd``/``input_sds``, noise of the output over noise of each input; 0 for the latter is an input that is
    known. With a ``trend`` x ends with the drift of each run, over the length of the longest segment."""

    model: Model
    segments: tuple[Segment, ...]
    dt_s: float
    hold: Literal["zoh", "foh"]
    initial: Initial
    time_scale_s: float = 1.0
    input_sds: tuple[float, ...] = (0.0,)
    noise_sd: float = 1.0
    trend: bool = False

    @property
    def input_sd(self) -> float:
        """Noise of the input, where it is the only one."""
        return self.input_sds[0] if len(self.input_sds) == 1 else 0.0

    @cached_property
    def branches(self) -> list[tuple[Model, dict[str, str], list[int]]]:
        """The model behind each input, the names here of its parameters, and where in x its free ones stand."""
        pairs = [self.model.branch(k) for k in range(len(self.input_sds))]
        return [
            (part, names, [self.model.free.index(names[n]) for n in part.free])
            for part, names in pairs
        ]

    def rationals(self, x: Array) -> list[Rational]:
        """The transfer function behind each input at x."""
        theta = self.theta(x)
        return [
            part.rational({n: theta[w] for n, w in names.items()})
            for part, names, _ in self.branches
        ]

    @cached_property
    def state_sizes(self) -> list[int]:
        """How many initial states each branch has of its own; poles that inputs share hold one set of them."""
        sizes = [
            part.order + part.integrators + len(part.known.den) - 1 for part, *_ in self.branches
        ]
        common = self.model.parts and any("." not in n for n in self.model.names)
        return [sizes[0], *(0 if common else size for size in sizes[1:])]

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
        m = self.model
        runs = sorted({s.run for s in self.segments})
        offsets = {"free": 1, "per run": len(runs), "none": 0}[m.offset] * (
            not (m.integrators and all(self.loose))
        )
        edges = self.n_model + offsets + sum(self.state_sizes) * np.cumsum([0, *self.loose])
        own = [
            self.n_model + (runs.index(s.run) if m.offset == "per run" else 0)
            for s in self.segments
        ]
        return tuple(
            (slice(o, o + (offsets > 0)), slice(a, b))
            for o, a, b in zip(own, edges, edges[1:].tolist())
        )

    @cached_property
    def pasts(self) -> tuple[tuple[int | None, ...], ...]:
        """Where in x the level of each input before each segment stands, over its first sample; None where there is
        none. What an integrator has made of a past is its offset."""
        asked = self.initial == "equilibrium" and not self.model.integrators
        at = count(self.places[-1][1].stop)
        return tuple(
            tuple(next(at) if sd > 0 and asked and not loose else None for sd in self.input_sds)
            for loose in self.loose
        )

    @property
    def size(self) -> int:
        """Length of x."""
        levels = sum(k is not None for past in self.pasts for k in past)
        return self.places[-1][1].stop + levels + self.trend * len(self.begun_s)

    @cached_property
    def begun_s(self) -> dict[int, float]:
        """When each run begins [s]."""
        return {s.run: s.start_s for s in reversed(self.segments)}

    @cached_property
    def precision(self) -> Array:
        """What is known beforehand of x (size,), in units of the output's noise: the past, by its first sample."""
        known = np.zeros(self.size)
        for past in self.pasts:
            for k, sd in zip(past, self.input_sds):
                if k is not None:
                    known[k] = (self.noise_sd / sd) ** 2
        return known

    @property
    def n_seen(self) -> int:
        """Measured output samples."""
        return int(sum(s.seen.sum() for s in self.segments))

    def theta(self, x: Array) -> dict[str, float]:
        """All model parameters by name."""
        return self.model.theta(x)

    def vector(self, theta: Mapping[str, float]) -> Array:
        """x for the model parameters; offsets and initial states zero."""
        return np.append(self.model.vector(theta), np.zeros(self.size - self.n_model))

    @cached_property
    def reach(self) -> int:
        """Samples by which a dead time can hold the input back."""
        delays = [n for n in self.model.names if bare(n) == "Td"]
        longest = max(
            (self.model.fixed.get(n, self.longest_delay_s) for n in delays), default=-self.dt_s
        )
        return int(np.ceil(longest / self.dt_s)) + 1

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
        """d(natural parameter)/dx (size,)."""
        return np.exp(np.where(self.logarithms, x, 0.0))

    @cached_property
    def logarithms(self) -> Flags:
        """Which of x (size,) are logarithms."""
        return np.append(self.model.logarithms, np.zeros(self.size - self.n_model, dtype=bool))

    def colour(self, x: Array) -> Array:
        """Coefficients, behind its first, of the A(q) whose 1/A(q) colours a white noise that comes in before the
        model's own poles."""
        poles = np.concatenate([f.poles for f in self.rationals(x)[0].factors if f.free])
        return np.asarray(np.poly(np.exp(poles * self.dt_s)).real[1:])

    @cached_property
    def parts(self) -> list[slice]:
        """Slices of the residual vector within which samples follow each other without a gap."""
        found = []
        at = 0
        for segment in self.segments:
            index = np.flatnonzero(segment.seen)
            for part in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1):
                found.append(slice(at, at + len(part)))
                at += len(part)
        return found

    @cached_property
    def freed(self) -> list[bool]:
        """Whether each of the parts begins with a segment whose initial state is free."""
        begun = {
            at
            for at, free in zip(np.cumsum([0, *(s.seen.sum() for s in self.segments)]), self.loose)
            if free
        }
        return [part.start in begun for part in self.parts]

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
        lower, upper = self.model.box(
            (1e-2 * self.dt_s, 100 * self.longest_s), self.longest_delay_s
        )
        open_end = np.full(self.size - self.n_model, np.inf)
        return np.append(lower, -open_end), np.append(upper, open_end)

    def outputs(self, x: Array) -> list[tuple[Array, Array]] | None:
        """Per segment the model output (N,) and its Jacobian (N, size); None where the model is unstable."""
        rationals = self.rationals(x)
        if not all(g.stable for g in rationals):
            return None
        theta = self.theta(x)
        scale = self.natural_scale(x)
        behind = []
        for g, (part, names, at) in zip(rationals, self.branches):
            rule = part.chain_rule({n: theta[w] for n, w in names.items()}) * scale[at]
            behind.append((g, realise(g), rule, at))
        answers = []
        for segment, (offset, state), levels in zip(self.segments, self.places, self.pasts):
            y = np.full(len(segment.y), x[offset].sum())
            j = np.zeros((len(segment.y), self.size))
            j[:, offset] = 1.0
            if self.trend:
                run = self.size - len(self.begun_s) + sorted(self.begun_s).index(segment.run)
                j[:, run] = (
                    segment.start_s - self.begun_s[segment.run] + self.dt_s * np.arange(len(y))
                ) / self.longest_s
                y += x[run] * j[:, run]
            first = state.start
            for k, (one, level, own) in enumerate(zip(behind, levels, self.state_sizes)):
                own = own if state.stop > state.start else 0
                self.add(
                    one,
                    segment.of(k) if len(levels) > 1 else segment,
                    level,
                    slice(first, first + own),
                    x,
                    y,
                    j,
                )
                first += own
            answers.append((y, j))
        return answers

    def add(
        self,
        behind: tuple[Rational, Realisation, Array, list[int]],
        segment: Segment,
        level: int | None,
        state: slice,
        x: Array,
        y: Array,
        j: Array,
    ) -> None:
        """Add to ``y`` (N,) and ``j`` (N, size) what comes from one input of ``segment``: of the input, of its
        ``level`` before, of the initial ``state`` (places in x)."""
        rational, system, rule, at = behind
        past = (
            segment.history(self.reach) if segment.resumed else segment.past
        )  # what a dead time brings in
        u = np.concatenate([past, segment.u])
        if level is None:
            rows = simulate_rows(system, u, self.dt_s, rational.delay_s, self.hold, self.begun)[
                :, len(past) :
            ]
        else:  # what it was for ever, and from the first sample on the departure from that
            before = u[0] + x[level]
            rows = simulate_rows(system, u - before, self.dt_s, rational.delay_s, self.hold, "zero")
            rows += before * simulate_rows(system, np.ones(1), self.dt_s, 0.0, "zoh", "equilibrium")
            plain = realise(rational, False)
            one = np.ones(len(u))
            j[:, level] = (
                rational.num[0]
                - simulate_rows(plain, one, self.dt_s, rational.delay_s, "zoh", "zero")[0]
            )
        y += rows[0]
        j[:, at] += rows[1:].T @ rule
        if states := state.stop - state.start:
            scale = self.time_scale_s ** np.arange(1.0, states + 1)
            begun = realise(replace(rational, num=x[state] * scale, delay_s=0.0))
            free = free_rows(
                begun, len(y), self.dt_s
            )  # its value, d/dnumerator, d/dfactor coefficients
            by_factor = free[1 + states : -1]
            y += free[0]
            j[:, at] += by_factor.T @ rule[len(rule) - 1 - len(by_factor) : -1]
            j[:, state] = free[1 : 1 + states].T * scale

    def evaluate(self, x: Array, root: Array | float = 1.0) -> tuple[Array, Array] | None:
        """Residuals model - measured at the measured samples, all segments in a row, and their Jacobian, all rows times
        ``root`` (N,)."""
        answers = self.outputs(x)
        if answers is None:
            return None
        seen = [(y[s.seen] - s.y[s.seen], j[s.seen]) for s, (y, j) in zip(self.segments, answers)]
        residual, jacobian = (np.concatenate(each) for each in zip(*seen))
        return (residual * root, (jacobian.T * root).T) if np.isfinite(residual).all() else None

    def core(self, noise: Noise | None = None, root: Array | float = 1.0) -> Problem:
        """The problem as :mod:`tcdyn.estimation` solves it; residuals times ``root`` (N,), then whitened by
        ``noise``, or
        of a model whose poles colour its noise by them."""

        def evaluate(x: Array) -> tuple[Array, Array] | None:
            answer = self.evaluate(x, root)
            if answer is None:
                return None
            if self.model.arx:
                moved = [i for i, n in enumerate(self.model.free) if n[0] == "a"]
                return equation_error(self.colour, x, moved, self.parts, *answer, self.freed)
            whiten = (noise or Noise()).whiten
            return whiten(answer[0], self.parts), whiten(answer[1], self.parts)

        lower, upper = self.bounds()
        names = (*self.model.free, *(f"x{i}" for i in range(self.n_model, self.size)))
        with np.errstate(divide="ignore"):
            sd = 1 / np.sqrt(self.precision)
        return Problem(names, evaluate, lower=lower, upper=upper, prior_sd=sd)
