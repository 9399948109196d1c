"""What disturbs the output beside white noise: its model by name or by what the residuals ask for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyfromroots
from scipy.optimize import minimize

from calibration import Array
from tcdyn.chain.rational import realise, simulate_rows
from tcdyn.fitting import Noise, Optimum, fit_ar, fit_arma
from tcdyn.identify.problem import Posed
from tcdyn.identify.search import rms, search

NoiseName = Literal["white", "slow", "ar", "arma", "auto"]
Baseline = Literal["none", "trend", "walk", "auto"]
NOISES, BASELINES = ("auto", "white", "slow", "ar", "arma"), ("auto", "none", "trend", "walk")
ORDERS = ((1, 1), (2, 1), (2, 2))  # of ARMA noise, that are tried
MOST_AR = 8
NEAREST = 0.999  # a partial correlation, beyond which noise is a random walk and no offset can be told
MOST_REFINED = 4  # coefficients that are searched by the restricted likelihood
DECISIVE = 4.0  # BIC by which a stationary noise must win over a random walk, which claims less
ROUNDS = 6  # of dynamics given the noise and noise given the dynamics
Estimate = Callable[[Posed, Array, Array], Noise]


def through_model(posed: Posed, x: Array, e: Array) -> Noise:
    """The colour of residuals in which the input's noise stands behind the model: s_y^2 |D|^2 + s_u^2 |B|^2 over |D|^2.

    D from the poles, B from the impulse response, C by the roots within the unit circle; s_y from the variance of
    the residuals ``e`` (N,) less the input's share of it.
    """
    g = posed.model.rational(posed.theta(x))
    poles = np.exp(np.concatenate([f.poles for f in g.factors] or [np.zeros(0, dtype=complex)]) * posed.dt_s)
    below, length = np.real(polyfromroots(poles))[::-1], max(len(s.u) for s in posed.segments)
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
    return Noise(tuple(below[1:].tolist()), tuple(np.real(np.poly(inside))[1:].tolist()), rest=True, fitted=0)


def through(posed: Posed, optimum: Optimum) -> list[Noise]:
    """What the noise of a measured input makes of the residuals, where it makes anything of them."""
    answer = posed.evaluate(optimum.theta)
    assert answer is not None
    root = 1.0 if optimum.weights is None else np.sqrt(optimum.weights)
    behind = through_model(posed, optimum.theta, answer[0] * root) if posed.input_sd else Noise()
    return [] if behind.white else [behind]


def alternate(posed: Posed, optimum: Optimum, estimate: Estimate) -> tuple[Posed, Optimum, Noise]:
    """Alternate the dynamics given the noise and the noise given the dynamics; both lower the same prediction error.

    ``estimate`` finds the noise from the problem, its x and its residuals (N,). Robust weights stay as ``optimum`` has
    them."""
    root = 1.0 if optimum.weights is None else np.sqrt(optimum.weights)
    model, cost = Noise(), np.inf
    for _ in range(ROUNDS):
        answer = posed.evaluate(optimum.theta)
        assert answer is not None
        r, j = answer[0] * root, (answer[1].T * root).T
        model = refined(posed.parts, r, j, estimate(posed, optimum.theta, r))
        optimum = search(posed, posed.core(model, root), optimum.theta)
        posed = replace(posed, noise_sd=rms(optimum, posed))
        if abs(cost - optimum.cost) < 1e-4 * optimum.cost:
            break
        cost = optimum.cost
    return posed, optimum, model


def walking(e: Array, parts: list[slice], order: tuple[int, int]) -> Noise:
    """A random walk with ARMA(p, q) steps and white noise on it: MA(1) steps are a walk beneath white noise."""
    steps = np.concatenate([np.diff(e[s], prepend=e[s][:1]) for s in parts])
    found = fit_arma(steps, parts, *order)
    return Noise(tuple(np.convolve([1.0, -1.0], [1.0, *found.ar])[1:].tolist()), found.ma, True, sum(order))


def refined(parts: list[slice], e: Array, j: Array, noise: Noise) -> Noise:
    """``noise`` at the restricted likelihood's maximum, in which what the fit took from the residuals is given back.

    Least (n - p) ln |w - WJ b|^2 + ln det (WJ)'(WJ) with w = W e, b its regression on the slopes WJ (Patterson and
    Thompson 1971); residuals alone make slow noise quicker than it is. Coefficients are searched by the areatangent of
    their partial correlations, within which every noise is stable and invertible.
    """
    free, walks = sum(noise.order), noise.walks
    if not 0 < free <= MOST_REFINED:
        return noise
    p = noise.order[0]
    own = np.array([*_divided(noise), *noise.ma])

    def at(z: Array) -> Noise:
        ar, ma = (coefficients(NEAREST * np.tanh(part)) for part in (z[:p], z[p:]))
        below = np.convolve([1.0, -1.0], [1.0, *ar])[1:] if walks else ar
        return Noise(tuple(np.asarray(below).tolist()), tuple(ma.tolist()), noise.rest, noise.fitted)

    told, size = j / np.maximum(np.linalg.norm(j, axis=0), 1e-300), len(e) - j.shape[1]

    def criterion(z: Array) -> float:
        table = at(z).whiten(np.column_stack([told, e]), parts)
        factor = np.abs(np.diag(np.linalg.qr(table, mode="r")))
        spread = at(z).log_spread(parts)
        return float(2 * size * np.log(factor[-1] + 1e-300) + 2 * np.sum(np.log(factor[:-1] + 1e-12)) + spread)

    start = np.arctanh(np.clip(np.concatenate([partials(own[:p]), partials(own[p:])]), -0.998, 0.998))
    found = minimize(
        criterion, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 60 * free}
    )
    return at(found.x) if found.fun < criterion(start) else noise


def _divided(noise: Noise) -> Array:
    """AR coefficients without the random walk's own."""
    return np.cumsum([1.0, *noise.ar])[1:-1] if noise.walks else np.array(noise.ar)


def coefficients(partial: Array) -> Array:
    """Of the polynomial 1 + d_1 q^-1 + .. whose partial correlations are ``partial``: Levinson's recursion."""
    d = np.zeros(0)
    for k in partial:
        d = np.append(d - k * d[::-1], -k)
    return d


def partials(d: Array) -> Array:
    """Partial correlations of 1 + d_1 q^-1 + .., the recursion backwards."""
    found = []
    while len(d):
        k = -d[-1]
        found.append(k)
        d = (d[:-1] + k * d[-2::-1]) / max(1 - k**2, 1e-9) if len(d) > 1 else d[:0]
    return np.array(found[::-1])


def score(e: Array, parts: list[slice], noise: Noise) -> float:
    """BIC of ``noise`` for residuals ``e`` (N,)."""
    w = noise.whiten(e, parts)
    variance = float(w @ w) / max(int(np.count_nonzero(w)), 1)
    spread = noise.log_spread(parts)
    return float(len(e) * np.log(max(variance, 1e-300)) + spread + noise.parameters * np.log(len(e)))


def best_ar(e: Array, parts: list[slice]) -> Noise:
    """The autoregression with the least BIC, up to order 8, by least squares."""
    most = max(1, min(MOST_AR, len(fit_ar(e, parts).ar)))
    return min((fit_arma(e, parts, p, 0) for p in range(1, most + 1)), key=lambda m: score(e, parts, m))


def best_arma(e: Array, parts: list[slice]) -> Noise:
    """The ARMA model with the least BIC of a few."""
    return min((fit_arma(e, parts, *order) for order in ORDERS), key=lambda m: score(e, parts, m))


def estimate(noise: NoiseName | tuple[int, int], baseline: Baseline) -> Estimate:
    """How to find the noise from residuals: of what ``noise`` allows that with the least BIC."""
    walk = {"white": [(0, 1)], "ar": [(1, 1)]}
    orders = [noise] if isinstance(noise, tuple) else walk.get(noise, [(0, 1), (1, 1)])

    def found(posed: Posed, x: Array, e: Array) -> Noise:
        parts = posed.parts
        if baseline == "walk":
            options = [walking(e, parts, order) for order in orders]
        elif isinstance(noise, tuple) and any(noise):
            options = [fit_arma(e, parts, *noise)]
        else:
            behind = through_model(posed, x, e) if posed.input_sd else Noise()
            options = [behind] if noise not in ("ar", "arma") else []
            options += [best_ar(e, parts)] if noise in ("ar", "auto") else []
            options += [best_arma(e, parts)] if noise in ("arma", "auto") else []
        return min(options, key=lambda m: score(e, parts, m))

    return found
