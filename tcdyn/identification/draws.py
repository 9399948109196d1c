"""Draws of transfer functions from the distribution of a model's parameters.

``Identified.plant`` uses it. Tests: ``tests/tuning/test_tune_draws.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tcdyn.chain.rational import Rational
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation.noise_average import MixturePart
from tcdyn.identification.responses import Dynamics

# Draws: the 2.5 % quantile is that of twelve of them, and its probability is known to 0.7 %.
N_DRAWS = 500
SEED = 2003  # any fixed number: the same model has the same draws
MAX_ROUNDS = 50  # of draws again, in place of impossible ones: 10 % possible ones suffice


@dataclass(frozen=True)
class _Part:
    """A normal distribution of changes of the free parameters (P,), with its weight.

    Attributes
    ----------
    weight
        Probability of the part.
    mean
        Mean (P,).
    factor
        Matrix (P, P) that turns independent standard normal numbers into deviations from it.
    """

    weight: float
    mean: Array
    factor: Array


def draw_models(model: Dynamics, count: int = N_DRAWS) -> tuple[tuple[Rational, ...], float]:
    """Transfer functions drawn from the distribution of the parameters.

    Parameters
    ----------
    model
        The model of one input.
    count
        Number of draws.

    Returns
    -------
    draws
        The transfer functions; none for a model without uncertainty.
    redrawn_share
        Share of draws that were impossible, and were drawn again.

    Raises
    ------
    InputError
        For a covariance that is not finite, and where nearly all draws are impossible.

    Notes
    -----
    The parameters are drawn from their normal distribution, or mixture. Impossible draws are drawn
    again: a lag, damping ratio or dead time that is not positive, or poles in the right half plane,
    since a record that was identified with bounded outputs is not that of an unstable plant. This
    is the normal distribution under the condition that the model is possible. It keeps what the
    record determines well, such as the sum of two lags of which each is uncertain; logarithms of
    the lags would not. The dead time gets the uncertainty of the time of the output besides.

    Examples
    --------
    >>> from tcdyn.identification import Identified, process
    >>> model = Identified.of(process("P1"), {"Kp": 2.0, "Tp1": 0.8}, np.diag([1e-4, 0.64]))
    >>> draws, _ = draw_models(model)
    >>> len(draws), min(draw.lag_s for draw in draws) > 0
    (500, True)
    """
    if not (model.covariance.any() or model.timing_u_s or model.parts):
        return (), 0.0
    if not np.isfinite(model.covariance).all():
        raise InputError(
            f"the covariance of {model.model.name} is not finite: the record does not determine it",
            remedy="identify the model from a longer record",
        )
    rng = np.random.default_rng(SEED)
    parts = _parts(model)
    draws: list[Rational] = []
    n_drawn = 0
    for _ in range(MAX_ROUNDS):
        found = [_draw(model, parts, rng) for _ in range(count - len(draws))]
        n_drawn += len(found)
        draws += [each for each in found if each is not None]
        if len(draws) == count:
            return tuple(draws), 1 - count / n_drawn
    raise InputError(
        f"{100 * (1 - len(draws) / n_drawn):.0f} % of the draws from the distribution of "
        f"{model.model.name} have a negative lag or are unstable: the record does not determine it",
        remedy="identify a model with fewer parameters, or from a longer record",
    )


def _draw(model: Dynamics, parts: Sequence[_Part], rng: np.random.Generator) -> Rational | None:
    """One transfer function; None for an impossible one.

    Parameters
    ----------
    model
        The model of one input.
    parts
        The normal distributions of its free parameters.
    rng
        Generator of random numbers.
    """
    part = parts[int(rng.choice(len(parts), p=[each.weight for each in parts]))]
    change = part.mean + part.factor @ rng.standard_normal(len(part.mean))
    late_s = model.timing_u_s * rng.standard_normal()
    theta = dict(model.theta)
    for name, difference in zip(model.model.free, change):
        theta[name] = float(theta[name] + difference)
        if theta[name] <= 0 and model.model.is_positive(name):
            return None
    g = model.model.rational(theta)
    drawn = replace(g, delay_s=g.delay_s + late_s)
    return drawn if drawn.delay_s >= 0 and drawn.is_stable else None


def _parts(model: Dynamics) -> list[_Part]:
    """The normal distributions of the free parameters."""
    parts = model.parts or (MixturePart(1.0, np.zeros(len(model.model.free)), model.covariance),)
    total = sum(part.weight for part in parts)
    found = []
    for weight, mean, covariance in parts:
        values, vectors = np.linalg.eigh(covariance)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        found.append(_Part(weight / total, np.asarray(mean), factor))
    return found
