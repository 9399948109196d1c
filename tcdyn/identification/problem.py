"""The identification problem: parameter vector, residuals of the simulation and their Jacobian.

The residuals are those of the output error; with a noise model they are whitened (prediction
error). The Jacobian is exact. ``tcdyn.identification.search`` minimises it, and every later stage
evaluates it. ``tests/identify/test_identify_several.py`` and ``test_identify_simulation.py`` in
that folder compare the derivatives with differences;
``tests/identify/test_identify_disturbance.py`` checks the input levels and the drift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import count
from typing import Literal, NamedTuple

import numpy as np

from tcdyn.chain.rational import (
    InitialState,
    Rational,
    Realisation,
    impulse_rows,
    realise,
    simulate_rows,
)
from tcdyn.core import Array, Flags
from tcdyn.estimation import NoiseModel, Problem
from tcdyn.estimation.arma import equation_error
from tcdyn.estimation.trace_noise import rounding_sd
from tcdyn.identification.holds import Hold
from tcdyn.identification.models import NO_MODEL, Model, base_name
from tcdyn.identification.segments import Segment, row_slices
from tcdyn.series.updates import usual_spacing

# State in which the runs start: in equilibrium with the first input, or with another level of it,
# which is estimated; from zero; or from any state, which is estimated.
Initial = Literal["equilibrium", "level", "zero", "estimated"]

MIN_LAG_SAMPLES = 1e-2  # lower bound of a lag, in sampling intervals
MAX_LAG_RECORDS = 100  # upper bound of a lag, in lengths of the longest segment
# Slow waves of a run: a line and cosines up to three periods, as faster ones are noise of a shorter
# memory (`python -m tests.identify.small_drift_study`); and of all runs together, to save time.
N_WAVES = 7
MAX_WAVES = 24


class Branch(NamedTuple):
    """The model of one input within the complete model.

    Parameters
    ----------
    model
        The model of the input.
    names
        By the name of a parameter in that model, its name in the complete model.
    positions
        Positions of its free parameters in x.
    """

    model: Model
    names: dict[str, str]
    positions: list[int]


class _BranchSystem(NamedTuple):
    """A branch at one x.

    Parameters
    ----------
    rational
        Transfer function.
    realisation
        Its realisation, with sensitivities.
    chain_rule
        d(coefficients)/dx (rows, P).
    positions
        Positions of the free parameters in x.
    """

    rational: Rational
    realisation: Realisation
    chain_rule: Array
    positions: list[int]


@dataclass(frozen=True)
class IdentificationProblem:
    """Inputs, one output and one model, as a least-squares problem in a vector x.

    Parameters
    ----------
    model
        The model structure.
    segments
        The record, cut where an input is missing.
    dt_s
        Sampling interval [s].
    holds
        Each input between samples: held ("zoh") or a straight line ("foh").
    initial
        State in which the runs start.
    time_scale_s
        Time scale of the initial states [s].
    input_sds
        Standard deviation of the measurement noise of each input; 0 for an exact input.
    noise_sd
        Standard deviation of the output's noise. ``noise_sd/input_sds`` weights the first sample
        of an input against the fitted level before it.
    trend
        Whether each run has a linear drift.
    wave_sd
        Prior standard deviation of the first of the slow waves of each run, over ``noise_sd``; zero
        for no waves.
    limits
        Bounds (low, high) of parameters by name, within those of the model.
    priors
        Mean and standard uncertainty of parameters by name, of normal distributions; of the
        logarithm where the parameter is positive.

    Notes
    -----
    x holds, in this order:

    1. the free parameters of the model, positive ones as logarithms;
    2. the offset, or one for each run;
    3. the initial states of the segments whose state is free: those after a gap, or all where
       ``initial`` is "estimated";
    4. for each segment that starts in equilibrium, the level before it, over the first sample, of
       each noisy input, or of all inputs where ``initial`` is "level";
    5. with ``trend`` the drift of each run, over the length of the longest segment;
    6. with ``wave_sd`` the slow waves of each run: a line, and cos(pi k t/T) with k = 1, 2, ... and
       T the length of the longest run. The prior standard deviations of the cosines fall as 1/k^2,
       as the series of a smooth curve does.

    The order of x is computed in ``offset_and_state_slices``, ``past_level_index`` and
    ``baseline``, and it is read in ``tcdyn.identification.fitting.final_offset`` and
    ``tcdyn.identification.disturbance.linearise``. A new kind of unknown goes to one of these ends.
    ``tests/identify/test_identify_disturbance.py`` fails where a column of the Jacobian is at a
    wrong position.
    """

    model: Model
    segments: tuple[Segment, ...]
    dt_s: float
    holds: tuple[Hold, ...]
    initial: Initial
    time_scale_s: float = 1.0
    input_sds: tuple[float, ...] = (0.0,)
    noise_sd: float = 1.0
    trend: bool = False
    wave_sd: float = 0.0
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def input_sd(self) -> float:
        """Noise of the input where there is one input only, else 0."""
        return self.input_sds[0] if len(self.input_sds) == 1 else 0.0

    @property
    def hold(self) -> Hold:
        """The hold of the first input."""
        return self.holds[0]

    @cached_property
    def branches(self) -> list[Branch]:
        """The model behind each input."""
        branches = []
        for k in range(len(self.input_sds)):
            model, names = self.model.branch(k)
            positions = [self.model.free.index(names[n]) for n in model.free]
            branches.append(Branch(model, names, positions))
        return branches

    def rationals(self, x: Array) -> list[Rational]:
        """Return the transfer function behind each input at x."""
        theta = self.theta(x)
        return [
            branch.model.rational({n: theta[full] for n, full in branch.names.items()})
            for branch in self.branches
        ]

    @cached_property
    def state_sizes(self) -> list[int]:
        """Number of initial states of each branch; shared poles have one set of states."""
        sizes = []
        for branch in self.branches:
            model = branch.model
            sizes.append(model.order + model.integrators + len(model.known.den) - 1)
        shares_poles = self.model.submodels and any("." not in n for n in self.model.names)
        if shares_poles:
            return [sizes[0], *[0] * (len(sizes) - 1)]
        return sizes

    @property
    def n_model(self) -> int:
        """Number of free model parameters."""
        return len(self.model.free)

    @cached_property
    def has_free_state(self) -> tuple[bool, ...]:
        """Whether the initial state of each segment is free.

        An integrator has no equilibrium with a level of the input.
        """
        is_free = self.initial == "estimated"
        is_free |= self.initial == "level" and self.model.integrators > 0
        return tuple(s.after_gap or is_free for s in self.segments)

    @cached_property
    def offset_and_state_slices(self) -> tuple[tuple[slice, slice], ...]:
        """For each segment, the slices of x with its offset and its initial state (may be empty).

        x holds the model parameters, the offsets, the initial states of the segments, the input
        levels before the segments, and the drifts, in this order. ``final_offset`` and
        ``past_level_index`` rely on it.

        There is no offset where the free state of an integrator is one already.
        """
        runs = sorted({s.run for s in self.segments})
        n_offsets = {"free": 1, "per run": len(runs), "none": 0}[self.model.offset]
        if self.model.integrators and all(self.has_free_state):
            n_offsets = 0
        first_state = self.n_model + n_offsets
        n_states = sum(self.state_sizes)
        edges = first_state + n_states * np.cumsum([0, *self.has_free_state])
        positions = []
        for k, segment in enumerate(self.segments):
            offset = self.n_model
            if self.model.offset == "per run":
                offset += runs.index(segment.run)
            state = slice(int(edges[k]), int(edges[k + 1]))
            positions.append((slice(offset, offset + (n_offsets > 0)), state))
        return tuple(positions)

    @cached_property
    def past_level_index(self) -> tuple[tuple[int | None, ...], ...]:
        """Position in x of the level before each segment, or None, by segment and input.

        The level is relative to the first sample. For an integrator, the effect of the past is
        the offset.
        """
        may_differ = [sd > 0 and self.initial == "equilibrium" for sd in self.input_sds]
        if self.initial == "level":
            may_differ = [branch.model.name != NO_MODEL for branch in self.branches]
        position = count(self.offset_and_state_slices[-1][1].stop)
        return tuple(
            tuple(
                next(position) if differs and not free and not self.model.integrators else None
                for differs in may_differ
            )
            for free in self.has_free_state
        )

    @property
    def size(self) -> int:
        """Length of x."""
        n_levels = sum(k is not None for levels in self.past_level_index for k in levels)
        n_baseline = len(self.run_start_s) * (self.trend + self.n_waves)
        return self.offset_and_state_slices[-1][1].stop + n_levels + n_baseline

    @property
    def n_waves(self) -> int:
        """Number of slow waves of each run."""
        if self.wave_sd == 0:
            return 0
        return max(min(N_WAVES, MAX_WAVES // len(self.run_start_s)), 1)

    @property
    def wave_slice(self) -> slice:
        """Positions of the slow waves in x."""
        return slice(self.size - len(self.run_start_s) * self.n_waves, self.size)

    @property
    def drift_slice(self) -> slice:
        """Positions of the linear drifts in x."""
        stop = self.wave_slice.start
        return slice(stop - len(self.run_start_s) * self.trend, stop)

    @property
    def wave_shares(self) -> Array:
        """Prior standard deviation of each wave over that of the line of its run."""
        cosines = 1 / np.arange(1, self.n_waves, dtype=float) ** 2
        return np.tile([1.0, *cosines], len(self.run_start_s))

    @cached_property
    def run_start_s(self) -> dict[int, float]:
        """Start of each run [s]."""
        return {s.run: s.start_s for s in reversed(self.segments)}

    @cached_property
    def prior_precision(self) -> Array:
        """Prior precision of x (size,), in units of the output's noise.

        It is above zero for parameters with a prior, and for the levels of the inputs before a
        segment, over its first sample: by the noise of the input, or by its range where ``initial``
        is "level". A level far outside of the range would be a slow drift of the output.
        """
        precision = np.zeros(self.size)
        sds: Sequence[float] = self.input_sds
        if self.initial == "level":
            sds = np.ptp(np.concatenate([s.inputs for s in self.segments]), axis=0).tolist()
        for levels in self.past_level_index:
            for k, sd in zip(levels, sds):
                if k is not None and sd > 0:
                    precision[k] = (self.noise_sd / sd) ** 2
        for name, (mean, u) in self.priors.items():
            if name in self.model.free:
                sd = u / mean if self.model.is_positive(name) else u
                precision[self.model.free.index(name)] = (self.noise_sd / sd) ** 2
        if self.n_waves:
            precision[self.wave_slice] = 1 / (self.wave_sd * self.wave_shares) ** 2
        return precision

    @cached_property
    def prior_mean(self) -> Array:
        """Prior mean of x (size,); zero where there is no prior of a parameter."""
        mean = np.zeros(self.size)
        for name, (value, _) in self.priors.items():
            if name in self.model.free:
                mean[self.model.free.index(name)] = self.model.as_x(name, value)
        return mean

    @property
    def n_measured(self) -> int:
        """Number of measured output samples."""
        return int(sum(s.measured.sum() for s in self.segments))

    def by_segment(self, rows: Array) -> list[Array]:
        """Return the rows (N, ..) of the measured samples, divided by segment."""
        counts = [s.measured.sum() for s in self.segments]
        return np.split(rows, np.cumsum(counts[:-1]))

    def theta(self, x: Array) -> dict[str, float]:
        """Return all model parameters by name at x."""
        return self.model.theta(x)

    def vector(self, theta: Mapping[str, float]) -> Array:
        """Return x (size,) for the model parameters, with zero offsets and initial states."""
        return np.append(self.model.vector(theta), np.zeros(self.size - self.n_model))

    @cached_property
    def max_delay_samples(self) -> int:
        """Largest number of samples by which a dead time can delay the input."""
        longest_s = -self.dt_s
        for name in self.model.names:
            if base_name(name) == "Td":
                longest_s = max(longest_s, self.model.fixed.get(name, self.delay_max_s))
        if self.model.known.delay_s:
            longest_s = max(longest_s, 0.0) + self.model.known.delay_s
        return int(np.ceil(longest_s / self.dt_s)) + 1

    @cached_property
    def longest_segment_s(self) -> float:
        """Length of the longest segment [s]."""
        return max(len(s.u) for s in self.segments) * self.dt_s

    @cached_property
    def longest_run_s(self) -> float:
        """Length of the longest run, with its gaps [s]."""
        ends = {s.run: s.start_s + len(s.u) * self.dt_s for s in self.segments}
        return max(ends[run] - start_s for run, start_s in self.run_start_s.items())

    @property
    def delay_max_s(self) -> float:
        """Upper bound of the dead time [s]: that of the model, or half the longest segment."""
        return self.model.delay_max_s or 0.5 * self.longest_segment_s

    @property
    def start(self) -> InitialState:
        """The state in which runs start, unless it is estimated."""
        return "zero" if self.initial == "zero" else "equilibrium"

    def natural_scale(self, x: Array) -> Array:
        """Return d(natural parameter)/dx (size,): the parameter for a logarithm, else one."""
        scale = self.model.natural_scale(x[: self.n_model])
        return np.append(scale, np.ones(self.size - self.n_model))

    @cached_property
    def is_logarithm(self) -> Flags:
        """Which of x (size,) are logarithms."""
        return np.append(self.model.is_logarithm, np.zeros(self.size - self.n_model, dtype=bool))

    def pole_polynomial(self, x: Array) -> Array:
        """Return A(q), the polynomial of the sampled free poles, without its first coefficient.

        White noise that enters before the model's own poles is coloured by 1/A(q).

        Parameters
        ----------
        x
            The vector (size,).

        Returns
        -------
        array
            Coefficients (order,).
        """
        factors = self.rationals(x)[0].factors
        poles = np.concatenate([f.poles for f in factors if f.free])
        return np.asarray(np.poly(np.exp(poles * self.residual_dt_s)).real[1:])

    @cached_property
    def residual_spacing(self) -> int:
        """Rows from one measured output to the next, of an output that is measured less often.

        1 where the rows between measured outputs are not even.
        """
        return usual_spacing([np.flatnonzero(s.measured) for s in self.segments])

    @property
    def residual_dt_s(self) -> float:
        """Time from one measured output to the next [s], without gaps."""
        return self.residual_spacing * self.dt_s

    @cached_property
    def residual_slices(self) -> list[slice]:
        """Slices of the residual vector in which the samples are consecutive, without a gap."""
        spacing = self.residual_spacing
        gap = np.zeros(spacing, dtype=bool)
        flags = np.concatenate([np.append(s.measured, gap) for s in self.segments])
        return row_slices(flags, spacing)

    @cached_property
    def slice_has_free_state(self) -> list[bool]:
        """Whether each residual slice starts with a segment whose initial state is free."""
        first_rows = np.cumsum([0, *(s.measured.sum() for s in self.segments)])
        free_starts = {row for row, free in zip(first_rows, self.has_free_state) if free}
        return [s.start in free_starts for s in self.residual_slices]

    @cached_property
    def measured_output(self) -> Array:
        """Measured output samples of all segments in a row (N,)."""
        return np.concatenate([s.y[s.measured] for s in self.segments])

    @cached_property
    def rounding_step(self) -> float:
        """Resolution of the output's logger where neighbours are often equal, else zero."""
        if rounding_sd(self.measured_output) == 0:
            return 0.0
        change = np.abs(np.diff(self.measured_output))
        return float(change[change > 1e-9 * change.max()].min())

    def bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds of x.

        Lags lie between ``MIN_LAG_SAMPLES`` samples and ``MAX_LAG_RECORDS`` records, the dead
        time between zero and :attr:`delay_max_s`, and all within ``limits``.

        Returns
        -------
        lower, upper
            Bounds (size,), infinite where there is none.
        """
        lags_s = (MIN_LAG_SAMPLES * self.dt_s, MAX_LAG_RECORDS * self.longest_segment_s)
        lower, upper = self.model.bounds(lags_s, self.delay_max_s)
        for name, (low, high) in self.limits.items():
            if name in self.model.free:
                k = self.model.free.index(name)
                lower[k] = max(lower[k], self.model.as_x(name, low))
                upper[k] = min(upper[k], self.model.as_x(name, high))
        unbounded = np.full(self.size - self.n_model, np.inf)
        return np.append(lower, -unbounded), np.append(upper, unbounded)

    def outputs(self, x: Array) -> list[tuple[Array, Array]] | None:
        """Return the model output of each segment and its Jacobian.

        Parameters
        ----------
        x
            The vector (size,).

        Returns
        -------
        list of tuple or None
            Output (N,) and Jacobian (N, size) of each segment; None where the model is unstable.
        """
        systems = self._branch_systems(x)
        if systems is None:
            return None
        outputs = []
        for k, segment in enumerate(self.segments):
            y, jacobian = self._offset_and_baseline(segment, self.offset_and_state_slices[k][0], x)
            self._add_branches(systems, k, x, y, jacobian)
            outputs.append((y, jacobian))
        return outputs

    def delay_slopes(self, x: Array) -> list[Array] | None:
        """Return the derivative of the output with respect to a further dead time of all inputs.

        Parameters
        ----------
        x
            The vector (size,).

        Returns
        -------
        list of array or None
            Derivative (N,) in each segment, in output units over seconds; None where the model is
            unstable. The free response of an estimated initial state is not delayed.
        """
        systems = self._branch_systems(x)
        if systems is None:
            return None
        delayed = []
        for system in systems:
            rule = np.zeros((len(system.chain_rule), 1))
            rule[-1] = 1.0  # the dead time is the last of the coefficients
            delayed.append(system._replace(chain_rule=rule, positions=[self.size]))
        slopes = []
        for k, segment in enumerate(self.segments):
            n = len(segment.y)
            jacobian = np.zeros((n, self.size + 1))
            self._add_branches(delayed, k, x, np.zeros(n), jacobian)
            slopes.append(jacobian[:, -1])
        return slopes

    def _add_branches(
        self, systems: Sequence[_BranchSystem], k: int, x: Array, y: Array, jacobian: Array
    ) -> None:
        """Add the responses to all inputs in segment ``k`` to output and Jacobian, in place.

        Parameters
        ----------
        systems
            The branches at x.
        k
            Number of the segment.
        x
            The vector (size,).
        y, jacobian
            Output (N,) and Jacobian (N, size), which are changed.
        """
        segment = self.segments[k]
        levels = self.past_level_index[k]
        state = self.offset_and_state_slices[k][1]
        has_state = state.stop > state.start
        first = state.start
        for i, system in enumerate(systems):
            size = self.state_sizes[i] if has_state else 0
            single = segment.with_input(i) if len(levels) > 1 else segment
            rows = slice(first, first + size)
            self._add_branch(system, single, self.holds[i], levels[i], rows, x, y, jacobian)
            first += size

    def _branch_systems(self, x: Array) -> list[_BranchSystem] | None:
        """Return the branches at x; None where one of them is unstable."""
        rationals = self.rationals(x)
        if not all(g.is_stable for g in rationals):
            return None
        theta = self.theta(x)
        scale = self.natural_scale(x)
        systems = []
        for g, branch in zip(rationals, self.branches):
            parameters = {n: theta[full] for n, full in branch.names.items()}
            rule = branch.model.chain_rule(parameters) * scale[branch.positions]
            systems.append(_BranchSystem(g, realise(g), rule, branch.positions))
        return systems

    def baseline(self, run: int, since_s: Array) -> Array:
        """Return the derivatives (N, size) of drift and waves of a run with x.

        Parameters
        ----------
        run
            Number of the run.
        since_s
            Times since its start (N,) [s].
        """
        jacobian = np.zeros((len(since_s), self.size))
        k = sorted(self.run_start_s).index(run)
        if self.trend:
            jacobian[:, self.drift_slice.start + k] = since_s / self.longest_segment_s
        if self.n_waves:
            first = self.wave_slice.start + k * self.n_waves
            share = since_s / self.longest_run_s
            numbers = np.arange(1, self.n_waves)
            jacobian[:, first] = share - 0.5
            cosines = slice(first + 1, first + self.n_waves)
            jacobian[:, cosines] = np.cos(np.pi * share[:, None] * numbers)
        return jacobian

    def _offset_and_baseline(
        self, segment: Segment, offset: slice, x: Array
    ) -> tuple[Array, Array]:
        """Return offset, drift and waves of a segment, and their Jacobian.

        Parameters
        ----------
        segment
            The segment.
        offset
            Slice of x with its offset, may be empty.
        x
            The vector (size,).

        Returns
        -------
        y
            Their sum (N,).
        jacobian
            Its derivatives with x (N, size).
        """
        first_s = segment.start_s - self.run_start_s[segment.run]
        since_s = first_s + self.dt_s * np.arange(len(segment.y), dtype=np.float64)
        jacobian = self.baseline(segment.run, since_s)
        jacobian[:, offset] = 1.0
        parts = [offset, self.drift_slice, self.wave_slice]
        y = sum((jacobian[:, part] @ x[part] for part in parts), np.zeros(len(segment.y)))
        return y, jacobian

    def _add_branch(
        self,
        system: _BranchSystem,
        segment: Segment,
        hold: Hold,
        level: int | None,
        state: slice,
        x: Array,
        y: Array,
        jacobian: Array,
    ) -> None:
        """Add the response to one input to output and Jacobian, in place.

        Parameters
        ----------
        system
            The branch at x.
        segment
            The segment with this input.
        hold
            The hold of this input.
        level
            Position in x of the input's level before the segment, or None.
        state
            Slice of x with the initial state, may be empty.
        x
            The vector (size,).
        y
            Output (N,), which is changed.
        jacobian
            Jacobian (N, size), which is changed.

        Notes
        -----
        The initial state is the numerator of a transfer function with the same poles, in powers of
        ``time_scale_s``; its impulse response is the free response. Each new term of ``y`` needs
        its derivative in ``jacobian``: ``tests/identify/test_identify_several.py`` fails where the
        two disagree.
        """
        g = system.rational
        rule = system.chain_rule
        # earlier inputs, which a dead time delays into the segment
        past = segment.past_input
        if segment.after_gap:
            past = segment.last_inputs(self.max_delay_samples)
        u = np.concatenate([past, segment.u])
        if level is None:
            rows = simulate_rows(system.realisation, u, self.dt_s, g.delay_s, hold, self.start)
            rows = rows[:, len(past) :]
        else:
            # steady state at the level before, plus the response to the departure from it
            before = u[0] + x[level]
            rows = simulate_rows(system.realisation, u - before, self.dt_s, g.delay_s, hold, "zero")
            steady = simulate_rows(
                system.realisation, np.ones(1), self.dt_s, 0.0, "zoh", "equilibrium"
            )
            rows += before * steady
            step = simulate_rows(
                realise(g, False), np.ones(len(u)), self.dt_s, g.delay_s, "zoh", "zero"
            )
            jacobian[:, level] = g.num[0] - step[0]
        y += rows[0]
        jacobian[:, system.positions] += rows[1:].T @ rule
        n_states = state.stop - state.start
        if n_states:
            scale = self.time_scale_s ** np.arange(1.0, n_states + 1)
            decay = realise(replace(g, num=x[state] * scale, delay_s=0.0))
            # the response, d/d(numerator), d/d(factor coefficients)
            free = impulse_rows(decay, len(y), self.dt_s)
            by_factor = free[1 + n_states : -1]
            y += free[0]
            first_factor = len(rule) - 1 - len(by_factor)
            jacobian[:, system.positions] += by_factor.T @ rule[first_factor:-1]
            jacobian[:, state] = free[1 : 1 + n_states].T * scale

    def evaluate(self, x: Array, root: Array | float = 1.0) -> tuple[Array, Array] | None:
        """Return residuals, model minus measured, and their Jacobian.

        Parameters
        ----------
        x
            The vector (size,).
        root
            Factor of each row (N,).

        Returns
        -------
        residual, jacobian
            Arrays (N,) and (N, size) over the measured samples of all segments; None where the
            model is unstable or a residual is not finite.
        """
        outputs = self.outputs(x)
        if outputs is None:
            return None
        residuals = []
        jacobians = []
        for segment, (y, jacobian) in zip(self.segments, outputs):
            residuals.append(y[segment.measured] - segment.y[segment.measured])
            jacobians.append(jacobian[segment.measured])
        residual = np.concatenate(residuals)
        if not np.isfinite(residual).all():
            return None
        return residual * root, (np.concatenate(jacobians).T * root).T

    def least_squares_problem(
        self, noise: NoiseModel | None = None, root: Array | float = 1.0
    ) -> Problem:
        """Return the problem in the form that :mod:`tcdyn.estimation` solves.

        Parameters
        ----------
        noise
            Noise model; the residuals are whitened by it. The residuals of an ARX model are the
            equation error instead.
        root
            Factor of each residual (N,): the root of its robust weight.

        Returns
        -------
        Problem
            Names, residuals, bounds and priors. The unknowns after the model parameters are called
            x0, x1, .. by their position.
        """
        evaluate = partial(self._innovations, noise=noise or NoiseModel(), root=root)
        lower, upper = self.bounds()
        names = (*self.model.free, *(f"x{i}" for i in range(self.n_model, self.size)))
        with np.errstate(divide="ignore"):
            prior_sd = 1 / np.sqrt(self.prior_precision)
        return Problem(names, evaluate, self.prior_mean, prior_sd, lower, upper)

    def _innovations(
        self, x: Array, noise: NoiseModel, root: Array | float
    ) -> tuple[Array, Array] | None:
        """Whitened residuals (N,) and their Jacobian (N, size).

        Parameters
        ----------
        x
            Parameters, offsets, drifts and initial states (size,).
        noise
            Noise model; not used with equation error, whose noise is that of the poles.
        root
            Square roots of the weights of the residuals.

        Returns
        -------
        tuple of array, or None
            None where the model cannot be computed.
        """
        slices = self.residual_slices
        rows = self.evaluate(x, root)
        if rows is None:
            return None
        if self.model.arx:
            poles = [i for i, n in enumerate(self.model.free) if n[0] == "a"]
            return equation_error(
                self.pole_polynomial, x, poles, slices, *rows, self.slice_has_free_state
            )
        return noise.whiten(rows[0], slices), noise.whiten(rows[1], slices)
