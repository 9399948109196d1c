"""What disturbs the output beside white noise: its model by name or by what the residuals ask for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyfromroots
from scipy.ndimage import median_filter
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax

from tcdyn.chain.rational import realise, simulate_rows
from tcdyn.core import Array
from tcdyn.estimation import Noise, Optimum, fit_ar, fit_arma
from tcdyn.estimation.arma import coefficients, partials
from tcdyn.estimation.noise_average import NoiseGrid, Slopes, moments, widest
from tcdyn.estimation.trace_noise import MAD_TO_SD
from tcdyn.identify.problem import Posed
from tcdyn.identify.search import rms, root_of, search

NoiseName = Literal["white", "slow", "ar", "arma", "auto"]
Baseline = Literal["none", "trend", "walk", "auto"]
NOISES = ("auto", "white", "slow", "ar", "arma")
BASELINES = ("auto", "none", "trend", "walk")
ORDERS = ((1, 1), (2, 1), (2, 2))  # of ARMA noise, that are tried
MOST_AR = 8
NEAREST = (
    0.999  # a partial correlation, beyond which noise is a random walk and no offset can be told
)
MOST_REFINED = 4  # coefficients that are searched by the restricted likelihood
DECISIVE = 4.0  # BIC by which a stationary noise must win over a random walk, which claims less
ROUNDS = 6  # of dynamics given the noise and noise given the dynamics
# of an averaged fit; standard uncertainties by which they may still move
MOST_ROUNDS = 3
AGREED = 0.05
# move of a logarithm, and in standard uncertainties, that may still be linear
LINEAR = 0.3
FAR = 5.0
# samples of a running median; its standard deviations, from which one beside it is a spike
BESIDE = 15
SPIKE = 4.0
NEGLIGIBLE = 0.01  # probability, below which a drift is left out
Estimate = Callable[[Posed, Array, Array], Noise]


def through_model(posed: Posed, x: Array, e: Array) -> Noise:
    """The colour of residuals in which the input's noise stands behind the model, s_y^2 |D|^2 + s_u^2 |B|^2 over |D|^2;
    white where it hardly counts.

    D from the poles, B from the impulse response, C by the roots within the unit circle; s_y from the variance of
    the residuals ``e`` (N,) less the input's share of it.
    """
    if not posed.input_sd:
        return Noise()
    g = posed.model.rational(posed.theta(x))
    poles = np.exp(
        np.concatenate([f.poles for f in g.factors] or [np.zeros(0, dtype=complex)]) * posed.dt_s
    )
    below = np.real(polyfromroots(poles))[::-1]
    length = max(len(s.u) for s in posed.segments)
    pulse = np.zeros(length)
    pulse[1] = posed.input_sd
    ahead = replace(g, delay_s=0.0)  # a dead time changes no spectrum
    h = simulate_rows(realise(ahead, False), pulse, posed.dt_s, 0.0, posed.hold, "zero")[0]
    above = np.convolve(below, h)[: len(below) + 2]
    above = above[np.abs(above) > 1e-9 * np.max(np.abs(above))] if len(below) > 1 else above
    above = np.pad(above, (0, max(len(below) - len(above), 0)))
    share = float(h @ h)
    left = float(e @ e) / max(len(e) - posed.size, 1)
    own = max(left - share, 0.01 * left)
    spectrum = np.convolve(above, above[::-1])
    mine = own * np.convolve(below, below[::-1])
    centre = len(above) - 1
    spectrum[centre - len(below) + 1 : centre + len(below)] += mine
    roots = np.roots(spectrum)
    inside = roots[np.argsort(np.abs(roots))][: len(above) - 1]
    if len(below) == 1 or np.any(np.abs(inside) >= 1) or share < 1e-6 * left:
        return Noise()
    return Noise(
        tuple(below[1:].tolist()), tuple(np.real(np.poly(inside))[1:].tolist()), rest=True, fitted=0
    )


def alternate(posed: Posed, optimum: Optimum, estimate: Estimate) -> tuple[Posed, Optimum, Noise]:
    """Alternate the dynamics given the noise and the noise given the dynamics; both lower the same prediction error.

    ``estimate`` finds the noise from the problem, its x and its residuals (N,). Robust weights stay as ``optimum`` has
    them, and where the noise is white so does ``optimum``."""
    begun = optimum
    root = root_of(optimum.weights)
    model = Noise()
    cost = np.inf
    for _ in range(ROUNDS):
        answer = posed.evaluate(optimum.theta, root)
        assert answer is not None
        model = refined(posed.parts, *answer, estimate(posed, optimum.theta, answer[0]))
        if model.white and begun.weights is not None:
            return posed, begun, model
        optimum = search(posed, posed.core(model, root), optimum.theta)
        posed = replace(posed, noise_sd=rms(optimum, posed))
        if abs(cost - optimum.cost) < 1e-4 * optimum.cost:
            break
        cost = optimum.cost
    return posed, optimum, model


def unspiked(posed: Posed, residual: Array) -> Posed:
    """``posed`` with the samples whose ``residual`` (N,), measured less simulated, stands out from a running median put
    upon it: weights by the size of residuals would take the crests of slow noise for spikes."""
    apart = residual - np.concatenate(
        [median_filter(residual[s], BESIDE, mode="nearest") for s in posed.parts]
    )
    spikes = np.where(np.abs(apart) > SPIKE * MAD_TO_SD * np.median(np.abs(apart)), apart, 0.0)
    segments = []
    at = 0
    for s in posed.segments:
        y = s.y.copy()
        count = int(s.seen.sum())
        y[s.seen] -= spikes[at : at + count]
        segments.append(replace(s, y=y))
        at += count
    return replace(posed, segments=tuple(segments))


def walking(e: Array, parts: list[slice], order: tuple[int, int]) -> Noise:
    """A random walk with ARMA(p, q) steps and white noise on it: MA(1) steps are a walk beneath white noise."""
    steps = np.concatenate([np.diff(e[s], prepend=e[s][:1]) for s in parts])
    found = fit_arma(steps, parts, *order)
    return Noise(
        tuple(np.convolve([1.0, -1.0], [1.0, *found.ar])[1:].tolist()), found.ma, True, sum(order)
    )


def refined(parts: list[slice], e: Array, j: Array, noise: Noise) -> Noise:
    """``noise`` at the restricted likelihood's maximum, in which what the fit took from the residuals is given back.

    Least (n - p) ln |w - WJ b|^2 + ln det (WJ)'(WJ) with w = W e, b its regression on the slopes WJ (Patterson and
    Thompson 1971); residuals alone make slow noise quicker than it is. Coefficients are searched by the areatangent of
    their partial correlations, within which every noise is stable and invertible.
    """
    free = sum(noise.order)
    walks = noise.walks
    if not 0 < free <= MOST_REFINED:
        return noise
    p = noise.order[0]
    own = np.array([*_divided(noise), *noise.ma])

    def at(z: Array) -> Noise:
        ar, ma = (coefficients(NEAREST * np.tanh(part)) for part in (z[:p], z[p:]))
        below = np.convolve([1.0, -1.0], [1.0, *ar])[1:] if walks else ar
        return Noise(
            tuple(np.asarray(below).tolist()), tuple(ma.tolist()), noise.rest, noise.fitted
        )

    told, size = j / np.maximum(np.linalg.norm(j, axis=0), 1e-300), len(e) - j.shape[1]

    def criterion(z: Array) -> float:
        table = at(z).whiten(np.column_stack([told, e]), parts)
        factor = np.abs(np.diag(np.linalg.qr(table, mode="r")))
        spread = at(z).log_spread(parts)
        return float(
            2 * size * np.log(factor[-1] + 1e-300)
            + 2 * np.sum(np.log(factor[:-1] + 1e-12))
            + spread
        )

    start = np.arctanh(
        np.clip(np.concatenate([partials(own[:p]), partials(own[p:])]), -0.998, 0.998)
    )
    found = minimize(
        criterion,
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 60 * free},
    )
    return at(found.x) if found.fun < criterion(start) else noise


def _divided(noise: Noise) -> Array:
    """AR coefficients without the random walk's own."""
    return np.cumsum([1.0, *noise.ar])[1:-1] if noise.walks else np.array(noise.ar)


def score(e: Array, parts: list[slice], noise: Noise) -> float:
    """BIC of ``noise`` for residuals ``e`` (N,)."""
    w = noise.whiten(e, parts)
    variance = float(w @ w) / max(int(np.count_nonzero(w)), 1)
    spread = noise.log_spread(parts)
    return float(
        len(e) * np.log(max(variance, 1e-300)) + spread + noise.parameters * np.log(len(e))
    )


def estimate(noise: NoiseName | tuple[int, int], baseline: Baseline) -> Estimate:
    """How to find the noise from residuals: of what ``noise`` allows that with the least BIC.

    Of autoregressions those up to the order that Yule and Walker's have, 8 at most; of random walks a few.
    """
    walk = {"white": [(0, 1)], "ar": [(1, 1)]}

    def found(posed: Posed, x: Array, e: Array) -> Noise:
        parts = posed.parts
        if baseline == "walk":
            orders = [noise] if isinstance(noise, tuple) else walk.get(noise, [(0, 1), (1, 1)])
            options = [walking(e, parts, order) for order in orders]
        elif isinstance(noise, tuple) and any(noise):
            options = [fit_arma(e, parts, *noise)]
        else:
            most = max(1, min(MOST_AR, len(fit_ar(e, parts).ar)))
            orders = [(p, 0) for p in range(1, most + 1)] if noise in ("ar", "auto") else []
            orders += ORDERS if noise in ("arma", "auto") else []
            options = [fit_arma(e, parts, *order) for order in orders]
            options += [through_model(posed, x, e)] if noise not in ("ar", "arma") else []
        return min(options, key=lambda m: score(e, parts, m))

    return found


@dataclass(frozen=True)
class Averaged:
    """``mean`` and ``covariance`` over the noises, of x with its logarithms taken back: there small lags and dead time
    add up. ``noise`` is the likeliest, ``optimum`` given it, and ``evidence`` the logarithm of the likelihood averaged
    over all noises; ``walks`` is the probability that the disturbance outlasts the record."""

    posed: Posed
    optimum: Optimum
    noise: Noise
    mean: Array
    covariance: Array
    evidence: float
    walks: float

    def found(self, weights: Array | None) -> tuple[Posed, Optimum, Noise, Array]:
        """Problem, optimum and noise as any other fit has them, residuals and slopes at the mean, and covariance of x.

        Where the mean lies further off than the problem is linear, as in a direction of which the data tell nothing,
        x stays that given the likeliest noise, and what it is off the mean is uncertainty.
        """
        posed = self.posed
        core = self.posed.core(self.noise, root_of(weights))
        x = self.optimum.theta
        scale = posed.natural_scale(self.optimum.theta)
        logs = posed.logarithms
        answer = core.evaluate(x)
        covariance = self.covariance
        assert answer is not None
        apart = self.mean - plain(posed, x)
        moved = x + np.where(logs, np.log1p(np.clip(apart / scale, -LINEAR, LINEAR)), apart)
        moved = np.clip(moved, core.lower, core.upper)
        there = core.evaluate(moved) if np.all(np.abs(apart / scale)[logs] < LINEAR) else None
        limit = (1 + FAR**2 / posed.n_seen) * float(answer[0] @ answer[0])
        if there is not None and there[0] @ there[0] < limit:
            x = moved
            answer = there
            scale = posed.natural_scale(moved)
        else:
            covariance = covariance + np.outer(apart, apart)
        here = replace(self.optimum, problem=core, theta=x, residual=answer[0], jacobian=answer[1])
        return posed, here, self.noise, covariance / np.outer(scale, scale)


def plain(posed: Posed, x: Array) -> Array:
    """x (P,) with its logarithms taken back."""
    return np.where(posed.logarithms, posed.natural_scale(x), x)


def slopes(posed: Posed, x: Array, root: Array | float) -> Slopes:
    """``posed`` made linear at x, all rows times ``root``, by x with logarithms taken back; what stands on a bound
    stays there."""
    answer = posed.evaluate(x, root)
    assert answer is not None
    lower, upper = posed.bounds()
    j = answer[1] * ((lower < x) & (x < upper)) / posed.natural_scale(x)
    size = np.linalg.norm(j, axis=0)
    size[size == 0] = np.inf
    told = np.sqrt(posed.precision)
    prior = np.column_stack([np.diag(told / size), told * x])[told > 0]
    return Slopes(answer[0], j / size, size, prior, posed.parts, posed.trend * len(posed.begun_s))


def averaged(posed: Posed, optimum: Optimum) -> Averaged:
    """``posed`` averaged over first-order disturbances, white noise and what a measured input's leaves, begun at
    ``optimum``, whose robust weights stay."""
    root = root_of(optimum.weights)
    box = widest(posed.n_seen)
    others = [Noise(averaged=True)]
    begun = posed.evaluate(optimum.theta, root)
    assert begun is not None
    if not (behind := through_model(posed, optimum.theta, begun[0])).white:
        others.append(behind)
    for _ in range(MOST_ROUNDS):
        line = slopes(posed, optimum.theta, root)
        grid = NoiseGrid.of(line, box)
        evidence, walks, noise, step, covariance = grid.integrated(line, others)
        mean = plain(posed, optimum.theta) + step
        if box is grid.box or np.all(np.abs(step) <= AGREED * np.sqrt(np.diag(covariance))):
            break
        optimum = search(posed, posed.core(noise, root), optimum.theta)
        posed = replace(posed, noise_sd=rms(optimum, posed))
        box = grid.box
    return Averaged(posed, optimum, noise, mean, covariance, evidence, walks)


def mixed(found: Sequence[Averaged]) -> Averaged:
    """One of all, each by its evidence: the problem of the last that is not negligible, of which those before are the
    special case that its last unknowns are nought."""
    height = np.array([f.evidence for f in found])
    weight = softmax(height)
    kept = [k for k in range(len(found)) if weight[k] > NEGLIGIBLE]
    last = found[kept[-1]]
    size = len(found[kept[-1]].mean)
    means = np.array([np.pad(found[k].mean, (0, size - len(found[k].mean))) for k in kept])
    covariances = np.array(
        [np.pad(found[k].covariance, (0, size - len(found[k].mean))) for k in kept]
    )
    mean, covariance = moments(height[kept], means, covariances)
    likeliest = found[int(np.argmax(height))].noise
    walks = float(weight[kept] / weight[kept].sum() @ [found[k].walks for k in kept])
    evidence = float(logsumexp(height))
    return Averaged(last.posed, last.optimum, likeliest, mean, covariance, evidence, walks)
