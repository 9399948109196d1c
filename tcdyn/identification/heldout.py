"""Held-out error: how well a fit simulates data that it has not used.

``tcdyn.identification.ladder`` and ``shared_poles`` use it to compare models.
The simulation has only its initial state and, in one case, its level fitted; all else comes from
the fit. ``tests/identify/test_identify_closed_forms.py``, ``test_identify_data.py`` and
``test_identify_equation.py`` in that folder guard it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from tcdyn.core.errors import InputError
from tcdyn.estimation import autocorrelation_factor
from tcdyn.identification.iodata import IOData
from tcdyn.identification.search import Fit
from tcdyn.identification.segments import MIN_SEGMENT_SAMPLES, split_segments
from tcdyn.identification.starting_values import solve_linear_parameters
from tcdyn.identification.validation import nrmse_percent

# Memory of a disturbance over the length of the held-out record, above which the simulation starts
# from the level that the disturbance has reached (chosen by judgement).
LONG_MEMORY_SHARE = 0.3
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
    """Error of the simulation of other data.

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
    Only free states (after a gap, or all with "estimated") and levels before the record are
    estimated. A drift continues from its value at the end of the fit's data, with a slope of its
    own. A record that is scored from some time on continues from the state that fits the samples
    before; any other starts from the state that fits it. The probability is that of an F test of
    the variance of the innovations over that of the fit; coloured innovations count as fewer
    samples.

    What is fitted to the test data must not be scored on them: keep the samples of state and level
    apart from the scored ones. ``LONG_MEMORY_SHARE`` decides when a slow disturbance gives the
    level; without it the held-out error measures the disturbance.
    ``tests/identify/test_identify_data.py`` checks a run that is held out.
    """
    model = result.identified
    segments = [replace(s, y=s.y - model.offset) for s in split_segments(test)]
    scored = []
    state_segments = []
    for s in segments:
        times_s = s.start_s + np.arange(len(s.y)) * test.dt_s
        is_scored = s.measured & (times_s >= from_s)
        before = s.measured & ~is_scored
        scored.append(is_scored)
        # the free states are fitted to the samples before the scored ones, where there are enough
        has_before = before.sum() >= MIN_SEGMENT_SAMPLES
        state_segments.append(replace(s, measured=before) if has_before else s)
    problem = replace(
        result.problem,
        model=replace(model.model, fixed=model.theta, offset="none"),
        segments=tuple(state_segments),
        dt_s=test.dt_s,
        holds=test.holds,
        trend=False,
    )
    simulated = problem.outputs(solve_linear_parameters(problem, {})[1])
    assert simulated is not None
    residual = np.concatenate([(s.y - y)[s.measured] for s, (y, _) in zip(segments, simulated)])
    is_test = np.concatenate([flags[s.measured] for s, flags in zip(segments, scored)])
    slices = replace(problem, segments=tuple(segments)).residual_slices
    if result.problem.trend and not is_test.all():
        since = np.cumsum(is_test)[is_test]
        residual[is_test] -= since * (since @ residual[is_test]) / (since @ since)
    error = residual[is_test]
    innovation = result.noise.whiten(residual, slices)[is_test]
    if result.noise.time_constant > LONG_MEMORY_SHARE * len(error) and not is_test.all():
        error = error - np.mean(residual[~is_test][-MIN_SEGMENT_SAMPLES:])
    if len(error) == 0:
        return np.nan, np.nan, np.nan
    outputs = [s.y[flags] for s, flags in zip(segments, scored) if flags.any()]
    rms = float(np.sqrt(np.mean(error**2)))
    percent = nrmse_percent([error], outputs)
    ratio = float(np.mean(innovation**2)) / max(model.noise_sd**2, 1e-300)
    dof = [max(len(e) / autocorrelation_factor(e), 1.0) for e in (innovation, result.innovation)]
    return rms, percent, float(fdtrc(*dof, ratio))


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
