"""Held-out error: how well a fit simulates data that it has not used.

``tcdyn.identification.ladder`` and ``shared_poles`` use it to compare models.
The simulation is free: nothing is fitted to the samples that are scored.
``tests/identify/test_identify_held_out.py``, ``test_identify_closed_forms.py``,
``test_identify_data.py`` and ``test_identify_equation.py`` in that folder guard it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import fdtrc

from tcdyn.core import Array, Flags
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.estimation import NoiseModel, autocorrelation_factor
from tcdyn.identification.iodata import IOData
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.search import Fit
from tcdyn.identification.segments import MIN_SEGMENT_SAMPLES, split_segments
from tcdyn.identification.starting_values import solve_linear_parameters
from tcdyn.identification.validation import nrmse_percent

# Share of the samples of a segment to which its free state is fitted, where there are no samples
# before: enough for a state, and most are left for the score (chosen by judgement).
STATE_SHARE = 0.2
# Options of fits of which only a score is used.
SCORING_OPTIONS: dict[str, Any] = {"intervals": "quadratic", "check": False}

Progress = Callable[[str, int, int], None]  # name of a model, its number, their count or 0


def split_held_out(data: IOData, held_out: IOData | float) -> tuple[IOData | None, IOData, float]:
    """Split a record into training data and test data.

    Parameters
    ----------
    data
        The record.
    held_out
        Another record, or the last share of ``data``, from 0 to 1; of several runs the last run.

    Returns
    -------
    train
        Training data; None where ``held_out`` is another record.
    test
        Test data; a share of one run keeps the complete run, for its state at the start.
    from_s
        Time from which the test error counts [s].

    Raises
    ------
    InputError
        For a share that is not between 0 and 1.
    """
    if isinstance(held_out, IOData):
        return None, held_out, -np.inf
    if not 0 < held_out < 1:
        raise InputError(f"held_out is {held_out}", expected="a share between 0 and 1, or IOData")
    if len(data.runs) > 1:
        return replace(data, runs=data.runs[:-1]), data.run(len(data.runs) - 1), -np.inf
    run = data.runs[0]
    edge = run.start_s + (run.n - 1) * data.dt_s * (1 - held_out)
    return data.between(None, edge), data, edge + 0.5 * data.dt_s


@with_named_arguments
def held_out_score(result: Fit, test: IOData, from_s: float = -np.inf) -> tuple[float, float]:
    """Return rms error and fit percent of the simulation of other data.

    They are the first two results of :func:`held_out_statistics`, whose notes say how the states
    at the start and a drift are found.

    Parameters
    ----------
    result
        The fit.
    test
        Data that the fit has not used.
    from_s
        Time from which the error counts [s].

    Returns
    -------
    rms
        Rms error in the output's unit; NaN if no sample is scored.
    percent
        NRMSE fit percent: 100 is perfect, 0 as bad as the mean of the scored outputs. NaN if no
        sample is scored.

    Examples
    --------
    >>> from tcdyn.identification import IOData, fit, process, simulate
    >>> u = np.repeat([20.0, 80.0, 20.0], 60)
    >>> truth = process("P1").rational({"Kp": 1.0, "Tp1": 0.75})
    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.2, len(u))
    >>> data = IOData.from_arrays(u, y, 0.05, hold="zoh")

    >>> y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(1).normal(0, 0.2, len(u))
    >>> new_data = IOData.from_arrays(u, y, 0.05, hold="zoh")
    >>> held_out_score(fit(data, "P1"), new_data)[1] > 98
    True
    """
    return held_out_statistics(result, test, from_s)[:2]


def held_out_statistics(
    result: Fit, test: IOData, from_s: float = -np.inf
) -> tuple[float, float, float]:
    """Error of the free simulation of other data.

    Parameters
    ----------
    result
        The fit.
    test
        Data that the fit has not used.
    from_s
        Time from which the error counts [s].

    Returns
    -------
    tuple
        Rms error, NRMSE fit percent, and the probability of an error at least as large from the
        noise of the fit alone; all NaN if no sample is scored.

    Notes
    -----
    Nothing is fitted to the scored samples. A record that is scored from some time on continues
    from the state that fits the samples before. The state of any other segment, where it is free,
    is fitted to its first samples (``STATE_SHARE``), which are not scored. A drift continues with
    its fitted slope, slow waves stay as at the end, and a disturbance as its noise model forecasts
    it from the samples before (:func:`forecast`). The probability is that of an F test of the
    variance of the innovations over that of the fit; coloured innovations count as fewer samples.

    ``tests/identify/test_identify_held_out.py`` checks that a change of the scored outputs does
    not change the simulation.
    """
    model = result.identified
    continues = np.isfinite(from_s)
    times = []
    segments = []
    for s in split_segments(test):
        times_s = s.start_s + np.arange(len(s.y), dtype=float) * test.dt_s
        offset = model.offset + (drift_since_end(result, times_s) if continues else 0.0)
        segments.append(replace(s, y=s.y - offset))
        times.append(times_s)
    problem = replace(
        result.problem,
        model=replace(model.model, fixed=model.theta, offset="none"),
        segments=tuple(segments),
        dt_s=test.dt_s,
        holds=test.holds,
        trend=False,
        wave_sd=0.0,
    )
    scored = []
    state_segments = []
    for k, s in enumerate(segments):
        is_scored = s.measured & (times[k] >= from_s)
        before = s.measured & ~is_scored
        if before.sum() < MIN_SEGMENT_SAMPLES and has_unknown_start(problem, k):
            count = max(MIN_SEGMENT_SAMPLES, int(STATE_SHARE * s.measured.sum()))
            is_scored &= np.cumsum(s.measured) > count
            before = s.measured & ~is_scored
        scored.append(is_scored)
        state_segments.append(replace(s, measured=before))
    starts = replace(problem, segments=tuple(state_segments))
    simulated = starts.outputs(solve_linear_parameters(starts, {})[1])
    assert simulated is not None
    residual = np.concatenate([(s.y - y)[s.measured] for s, (y, _) in zip(segments, simulated)])
    is_test = np.concatenate([flags[s.measured] for s, flags in zip(segments, scored)])
    if not is_test.any():
        return np.nan, np.nan, np.nan
    error = residual[is_test]
    if continues:
        error = error - forecast(result.noise, residual, is_test)[is_test]
    innovation = result.noise.whiten(residual, problem.residual_slices)[is_test]
    outputs = [s.y[flags] for s, flags in zip(segments, scored) if flags.any()]
    rms = float(np.sqrt(np.mean(error**2)))
    percent = nrmse_percent([error], outputs)
    ratio = float(np.mean(innovation**2)) / max(model.noise_sd**2, 1e-300)
    dof = [max(len(e) / autocorrelation_factor(e), 1.0) for e in (innovation, result.innovation)]
    return rms, percent, float(fdtrc(*dof, ratio))


def drift_since_end(result: Fit, times_s: Array) -> Array:
    """Forecast of the drift (N,) relative to its value at the end of the fit's data.

    Parameters
    ----------
    result
        The fit, whose offset is that at the end of its data.
    times_s
        Times (N,) [s].

    Returns
    -------
    array
        The drift in the output's unit; zero without one.
    """
    problem = result.problem
    if not problem.trend:
        return np.zeros(len(times_s))
    end_s = max(s.start_s + len(s.y) * problem.dt_s for s in problem.segments)
    slope = float(np.mean(result.x[problem.drift_slice])) / problem.longest_segment_s
    return slope * (times_s - end_s)


def has_unknown_start(problem: IdentificationProblem, k: int) -> bool:
    """Whether the state of segment ``k``, or an input level before it, has to be estimated."""
    state = problem.offset_and_state_slices[k][1]
    return state.stop > state.start or any(i is not None for i in problem.past_level_index[k])


def forecast(noise: NoiseModel, residual: Array, is_later: Flags) -> Array:
    """Forecast of a disturbance from the samples before.

    Parameters
    ----------
    noise
        Model of the disturbance D(q) n = C(q) w.
    residual
        Residuals (N,).
    is_later
        Which of them (N,) are forecast.

    Returns
    -------
    array
        The expected residuals (N,), those before as they are; zero for white noise.

    Notes
    -----
    The forecast is the series whose later innovations are zero: n = -(C/D) W n0, with n0 the
    residuals before, continued by zeros, and W n0 their later innovations. Gaps are passed over:
    their samples do not count as time.
    """
    before = np.where(is_later, 0.0, residual)
    if noise.white or is_later.all():
        return before
    innovation = noise.whiten(before, [slice(0, len(before))])
    driving = np.where(is_later, -innovation, 0.0)
    return before + lfilter([1.0, *noise.ma], [1.0, *noise.ar], driving)


def block_held_out_rms(result: Fit, count: int = 6) -> float:
    """Return the rms error of blocks of the record, each left out of the fit in turn.

    The first of the ``count`` blocks stays in the fit, for it determines the initial state.

    Parameters
    ----------
    result
        The fit.
    count
        Number of blocks.

    Returns
    -------
    float
        Rms error in the output's unit.

    Notes
    -----
    Without block b the parameters change by (J'J - J_b'J_b)^-1 J_b' w_b, with J the Jacobian of
    the innovations w, and the simulation by its Jacobian times that. This is exact for a linear
    problem.

    ``tests/identify/test_identify_equation.py`` compares it with fits without the block.
    """
    rows = result.problem.evaluate(result.x)
    assert rows is not None
    residual, residual_jacobian = rows
    w = result.optimum.residual * result.sqrt_weights
    j = result.optimum.jacobian * result.sqrt_weights[:, None]
    size = np.linalg.norm(j, axis=0)
    size[size == 0] = np.inf
    scaled = j / size
    information = scaled.T @ scaled + np.diag(result.problem.prior_precision / size**2)
    errors = []
    for block in np.array_split(np.arange(len(w)), count)[1:]:
        remaining = information - scaled[block].T @ scaled[block]
        gradient = scaled[block].T @ w[block]
        step = np.linalg.lstsq(remaining, gradient, rcond=1e-10)[0] / size
        errors.append(residual[block] + residual_jacobian[block] @ step)
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
