"""Transfer functions whose inputs share their poles, started from ARX regressions.

They are fitted by output error and by equation error.
``tcdyn.identification.comparison.add_common_pole_model`` uses them as a last step.
``tests/identify/test_identify_equation.py`` guards the regression, the equation error and the
choice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification.fitting import fit
from tcdyn.identification.heldout import SCORING_OPTIONS, block_held_out_rms
from tcdyn.identification.iodata import IOData
from tcdyn.identification.ladder import Ladder
from tcdyn.identification.models import Model, as_template, base_name, several, transfer
from tcdyn.identification.problem import IdentificationProblem
from tcdyn.identification.recommendation import CLEAR_GAIN_RATIO
from tcdyn.identification.search import Fit, make_problem
from tcdyn.identification.validation import has_coloured_residuals

# Findings of a fit whose response is slower than the record.
GAIN_OPEN = frozenset({"fit.lag_unbounded", "fit.slow_pole"})
MAX_POLES = 5  # largest number of common poles
MAX_ERROR_RATIO = 1.05  # each held-out error over that of the current model, at most
ERROR_GAIN_RATIO = 0.97  # mean of both that a model with coloured residuals must reach
STRIDES = (1, 3, 10)  # samples between the rows of the ARX regressions for starting values
MAX_POLE_RADIUS = 0.9999  # Radius of a discrete pole of a starting value: its bounds.
MIN_POLE_RADIUS = 1e-3
MAX_DELAY_SAMPLES = 4  # dead times of the regressions are shorter


def best_common_pole_fit(
    ladder: Ladder, current: Fit, held_out_rms: float, limit: float = 1.0
) -> tuple[Fit, float, tuple[float, float, float]] | None:
    """The best transfer function with one to five poles that all inputs share.

    Parameters
    ----------
    ladder
        The record and the options.
    current
        The recommended fit.
    held_out_rms
        Its held-out error.
    limit
        Largest mean error of the fit over that of ``current``.

    Returns
    -------
    tuple or None
        The fit, its error over that of ``current``, and its held-out statistics. None where no
        fit is 3 % better, or at most 5 % worse with white residuals where those of ``current`` are
        coloured; 20 % better for one that the data do not determine, if they determine ``current``.
        A fit whose response is slower than the record does not replace one whose response is not.

    Notes
    -----
    Each model is fitted by output error (also with estimated initial states, unless the options
    give ``initial``), and by equation error, unless the options give a noise. Equation error is
    right where the disturbances enter before the poles. The error is the geometric mean of the
    held-out error and of :func:`block_held_out_rms`, neither more than 5 % worse.
    """
    best = None
    current_blocks = block_held_out_rms(current)
    equation_error = [False] if {"noise", "baseline"} & set(ladder.options) else [False, True]
    ladder = ladder.with_white_noise()
    options = {**ladder.options, **SCORING_OPTIONS}
    for order, arx in product(range(1, MAX_POLES + 1), equation_error):
        for candidate in common_pole_fits(ladder.data, order, arx, options, ladder.template):
            if leaves_gain_open(candidate) and not leaves_gain_open(current):
                continue
            block_ratio = block_held_out_rms(candidate) / current_blocks
            if block_ratio > MAX_ERROR_RATIO:
                continue
            setting = replace(ladder.setting, initial=candidate.problem.initial)
            error = ladder.held_out_error(candidate, setting)
            ratio = error[0] / held_out_rms
            if not ratio <= MAX_ERROR_RATIO:  # NaN: the training data are too short
                continue
            whitens = has_coloured_residuals(current) and not has_coloured_residuals(candidate)
            allowed = MAX_ERROR_RATIO if whitens else ERROR_GAIN_RATIO
            if candidate.findings and not current.findings:
                allowed = CLEAR_GAIN_RATIO
            mean_ratio = float(np.sqrt(block_ratio * ratio))
            if mean_ratio < allowed * limit:
                best = (candidate, mean_ratio, error)
                limit = mean_ratio / allowed
    return best


def leaves_gain_open(result: Fit) -> bool:
    """Whether a response is slower than the record: gain and lag are then extrapolated."""
    return bool(GAIN_OPEN & {finding.code for finding in result.findings})


def common_pole_fits(
    data: IOData, order: int, arx: bool, options: Mapping[str, Any], template: Model
) -> Iterator[Fit]:
    """Yield fits with common poles, started from those of ARX regressions.

    They have no dead time, and one where the regressions show one. By output error they are also
    fitted with estimated initial states, unless ``options`` give ``initial``.

    Parameters
    ----------
    data
        The record.
    order
        Number of poles.
    arx
        Whether the fit is by equation error.
    options
        Options of :func:`tcdyn.identification.fit`.
    template
        What all models have.

    Returns
    -------
    iterator of Fit
        Fits that succeeded.
    """
    inputs = data.input_names
    no_delay = transfer(order, order, arx=arx)
    problem = make_problem(
        data,
        several([no_delay] * len(inputs), inputs, common=True),
        options.get("initial", "equilibrium"),
    )
    delays = range(MAX_DELAY_SAMPLES)
    best_delay = min(delays, key=lambda k: arx_regression(problem, order, k)[1])
    option_sets: list[Mapping[str, Any]] = [{"initial": "equilibrium", **options}]
    if not arx and "initial" not in options:
        option_sets.append({**options, "initial": "estimated"})
    for delay in (0, best_delay) if best_delay else (0,):
        submodel = transfer(order - 1, order, delay=True, arx=arx) if delay else no_delay
        model = several([submodel] * len(inputs), inputs, common=True, known=template.known)
        model = as_template(model, template)
        delay_s = max(delay - 1.0, 0.2) * data.dt_s
        dead_times = {n: delay_s for n in model.names if base_name(n) == "Td"}
        starts = []
        for stride in STRIDES:
            den = arx_regression(problem, order, delay // stride, stride)[0]
            if len(den) > 1:
                poles = {f"a{i}": float(a) for i, a in enumerate(den) if i}
                starts.append(dead_times | poles)
        for option_set in option_sets:
            try:
                result = fit(data, model, **option_set, start=starts)
            except InputError:
                continue
            starts = [*starts, dict(result.identified.theta)]
            yield result


def arx_regression(
    problem: IdentificationProblem, order: int, delay: int = 0, stride: int = 1
) -> tuple[Array, float]:
    """Denominator of an ARX regression with common poles, in continuous time.

    Parameters
    ----------
    problem
        The identification problem.
    order
        Number of poles.
    delay
        Dead time in rows of the regression.
    stride
        Samples between the rows.

    Returns
    -------
    tuple
        Denominator 1 + a1 s + .. (order + 1,), or (1,) for too few samples; and the criterion
        N ln S + 2 parameters (AIC).

    Notes
    -----
    Unstable poles are mirrored into the stable half plane. A real pole that alternates from sample
    to sample has no counterpart in continuous time; its radius is used.

    The radius of a starting pole is clipped to ``MIN_POLE_RADIUS`` and ``MAX_POLE_RADIUS``. A
    longer stride is less sensitive to noise for slow poles and cannot show fast ones.
    """
    rows = []
    outputs = []
    first = order + delay
    for s in problem.segments:
        n = len(s.y) // stride
        if n <= first:
            continue
        y = np.where(s.measured, s.y, np.nan)[: n * stride : stride]
        means = s.inputs[: n * stride].reshape(n, stride, -1).mean(axis=1)
        u = np.where([hold == "zoh" for hold in problem.holds], means, s.inputs[::stride][:n])
        columns = [y[first - i : n - i] for i in range(1, order + 1)]
        for v in u.T:
            columns += [v[order - i : n - delay - i] for i in range(order + 1)]
        columns.append(np.ones(n - first))
        rows.append(np.column_stack(columns))
        outputs.append(y[first:])
    if not rows:
        return np.ones(1), np.inf
    table = np.vstack(rows)
    y = np.concatenate(outputs)
    good = np.isfinite(table).all(axis=1) & np.isfinite(y)
    table = table[good]
    y = y[good]
    if len(y) <= table.shape[1]:
        return np.ones(1), np.inf
    size = np.linalg.norm(table, axis=0) + 1e-300
    theta = np.linalg.lstsq(table / size, y, rcond=1e-10)[0] / size
    error = y - table @ theta
    z = np.roots(np.append(1.0, -theta[:order])) + 0j
    radius = np.abs(z)
    radius = np.where(radius > 1, 1 / np.maximum(radius, 1.0), radius)
    radius = np.clip(radius, MIN_POLE_RADIUS, MAX_POLE_RADIUS)
    angle = np.where(z.imag == 0, 0.0, np.angle(z))
    poles = (np.log(radius) + 1j * angle) / (stride * problem.dt_s)
    den = np.poly(poles).real[::-1]
    criterion = len(y) * np.log(error @ error / len(y) + 1e-300) + 2 * len(theta)
    return den / den[0], float(criterion)
