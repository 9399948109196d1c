"""What the ways to a lag share: a fit by least squares with its noise made white, and structures weighed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, mixture_range
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation import Noise, Optimum, Problem, Status, fit_ar, minimise
from tcdyn.sensors.file import undetermined

Model = Callable[[Array], Array | None]
STEP = 1e-5  # of a parameter's scale, for differences


@dataclass(frozen=True)
class Fitted:
    """One structure fitted: optimum, Bayesian information criterion, noise [K]."""

    optimum: Optimum
    bic: float
    noise_K: float
    colour: Noise
    residual: Array = field(repr=False)
    scale: Array = field(repr=False)

    @property
    def theta(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.optimum.problem.names, self.optimum.theta.tolist()))

    def of(self, quantity: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Quantities (K,) of theta, and their covariance (K, K) by first order."""
        here = quantity(self.optimum.theta)
        rows = []
        for k, size in enumerate(1e-3 * self.scale):
            ahead = self.optimum.theta.copy()
            behind = self.optimum.theta.copy()
            ahead[k] += size
            behind[k] = max(behind[k] - size, float(self.optimum.problem.lower[k]))
            rows.append((quantity(ahead) - quantity(behind)) / (ahead[k] - behind[k]))
        slopes = np.array(rows)
        return here, slopes.T @ self.optimum.covariance @ slopes

    def doubts(self, column: str, noise_K: float, least_K: float) -> list[Finding]:
        """Whether the residuals are coloured, and whether they are clearly more than ``noise_K`` and ``least_K``."""
        found = [] if self.colour.white else [info("sensor.coloured", subject=column)]
        rest = float(np.sqrt(np.mean(self.residual**2)))
        if rest > max(3 * noise_K, least_K):
            found.append(warning("sensor.misfit", subject=column, rms_K=rest, noise_K=noise_K))
        return found


def fit_curve(
    name: str,
    model: Model,
    y: Array,
    names: Sequence[str],
    start: Array,
    scale: Array,
    *,
    prior: Mapping[str, tuple[float, float]] | None = None,
    lower: Mapping[str, float] | None = None,
    noise: tuple[Noise, float] | None = None,
) -> Fitted:
    """Least squares of ``model(theta)`` (N,) to ``y`` (N,), NaN left out, the residuals' colour taken out of both.

    ``scale`` (P,): of each parameter, for differences and steps; ``prior``: (mean, sd) by name; ``lower``: the box's
    lower ends; ``noise``: colour and level [K] of what is left, where another fit told them.
    Raises InputError where the model cannot be computed at its start.
    """
    ok, p = np.isfinite(y), len(names)
    mean, sd = np.array([(prior or {}).get(n, (0.0, np.inf)) for n in names]).T
    low = np.array([(lower or {}).get(n, -np.inf) for n in names])
    whole = [slice(0, int(ok.sum()))]
    colour, noise_K = noise or (Noise(), 1.0)

    def evaluate(theta: Array) -> tuple[Array, Array] | None:
        here = model(theta)
        if here is None:
            return None
        slopes = []
        for k, size in enumerate(scale):
            moved = theta.copy()
            moved[k] += STEP * size
            other = model(moved)
            if other is None:
                return None
            slopes.append((other - here)[ok] / (STEP * size))
        residual = (here - y)[ok]
        jacobian = np.stack(slopes, axis=1)
        return colour.whiten(residual, whole) / noise_K, colour.whiten(jacobian, whole) / noise_K

    theta = start
    last = 0 if noise else 2
    for turn in range(last + 1):
        problem = Problem(
            tuple(names), evaluate, prior_mean=mean, prior_sd=sd, lower=low, largest=3 * scale
        )
        found = minimise(problem, theta, limit=80)
        if found.status is Status.NOWHERE:
            raise InputError(f"{name} cannot be fitted: the model cannot be computed")
        theta = found.theta
        if turn == last:
            break
        colour, noise_K = colour_of((np.asarray(model(theta)) - y)[ok], p)
    bic = found.cost + p * np.log(len(found.residual))
    return Fitted(found, bic, noise_K, colour, (np.asarray(model(theta)) - y)[ok], scale)


def colour_of(residual: Array, parameters: int) -> tuple[Noise, float]:
    """The autoregression of residuals (N,), none where BIC does not ask for one, and the level of what is white [K]."""
    n = len(residual)
    whole = [slice(0, len(residual))]
    colour = fit_ar(residual, whole, max_order=8)
    spread = float(residual @ residual), float(np.sum(colour.whiten(residual, whole) ** 2))
    if n * np.log(max(spread[0], 1e-300) / max(spread[1], 1e-300)) < len(colour.ar) * np.log(n):
        colour = Noise()
    return colour, max(
        float(np.sqrt(spread[0 if colour.white else 1] / max(n - parameters, 1))), 1e-9
    )


def weights_of(bic: Array, prior: Array | float = 1.0) -> Array:
    """Probability (K,) of each structure by its information criterion, all on one noise, and by its ``prior``."""
    w = np.exp(-0.5 * (bic - bic.min())) * prior
    return w / w.sum()


def averaged(values: Sequence[float], us: Sequence[float], weights: Array) -> Estimate:
    """The estimate of a quantity over structures: mean, standard deviation and 95 % range of the mixture."""
    v = np.asarray(values, dtype=float)
    u = np.asarray(us, dtype=float)
    if not (np.all(np.isfinite(v)) and np.all(np.isfinite(u))):
        raise undetermined()
    mean = float(weights @ v)
    sd = float(np.sqrt(weights @ (u**2 + (v - mean) ** 2)))
    low, high = mixture_range(
        [Estimate.normal(a, max(b, 1e-12)) for a, b in zip(v, u)], weights.tolist()
    )
    return Estimate(value=mean, u=sd, low95=low, high95=high)
