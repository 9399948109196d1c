"""Departures of a test from the structure that the fits assume: what readings show more by a standard deviation each.

None of them is covered by a statement of rig.toml. They are linear about the fit of both disks, and known beforehand to
a standard deviation only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain, equalised
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.estimation import Optimum, free_directions, inverse, wave_factor
from tcdyn.heat.nonuniform import cached_gains
from tcdyn.heat.rim import Rim, bank_means, lag_bank, points_of
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.nuisance import LOG_H, SHARE, nuisance_effects, lags, with_lags
from tcdyn.partition.steel import conductivity_slope_effect
from tcdyn.partition.track import flux_shift_effect
from tcdyn.partition.window import FIT_MESH, Perturbation, RimMeans, lagged_power, interpolate_blocks
from tcdyn.rig.disk import DISKS

H_STEP_SD = 0.15  # of h at the parting: the jets' pattern changes
H_PER_K_SD = 0.002  # of h by a kelvin of the surface: viscosity of the film
SHIFT_SD_M = 0.35e-3  # of the flux along the track: 0.5 mm of each disk
FLUX_WIDTH_SD = 0.5  # of the flux's half-width
WASHER_SD = 1.0  # of the washers' conductance
STEM_SD = 0.02  # of a junction's excess over ambient that its wires take away
LOST_HEAT_SD = 0.1  # of the frictional heat that enters neither disk, or of the friction's scale
CONDUCTIVITY_PER_100_K_SD = 0.07  # of the conductivity
AIR_SD_K = 5.0  # of what the running surface loses heat to, oil or air, against the logged ambient
LAG_SD_S = 0.3  # of one junction: a bubble in its cement
SURFACE_POINTS = np.linspace(
    0.05, 0.95, 7
)  # places across the running surface whose mean is its temperature


@dataclass(frozen=True)
class DiskAtFit:
    """One disk about its part of the fit of both: its rim driven by the power that the fit sees, answers there.

    ``base`` and ``power`` (R, P): what the outer row is predicted to show, and by a share of one; ``surface`` (R,):
    mean temperature of the running surface [degC], its power not lagged; ``chain``: through which all is seen."""

    test: EhlTest
    fit: DiskFit
    share: float
    h_W_m2K: float
    rim: RimMeans
    chain: Chain
    base: Array
    power: Array
    surface: Array

    @classmethod
    def of(cls, test: EhlTest, fit: DiskFit, theta: Array) -> DiskAtFit:
        """The disk of ``fit`` at ``theta`` (4,)."""
        rim = fit.side.heated(lags(theta))
        share = float(theta[SHARE])
        h = float(np.exp(theta[LOG_H]))
        chain = with_lags(test.disks[fit.disk].mean_chain, lags(theta))
        window = fit.side.window
        rest, power = rim.answer(h)
        first = int(np.searchsorted(test.time_s, window.time_s[0]))
        true, held = lagged_power(test, slice(first, first + len(window.time_s)), None)
        bank = window.blocks @ lag_bank(true, test.dt_s, rim.rates_1_s, **held)
        inputs = np.column_stack([window.blocks @ true, rim.inputs[:, rim.rest]])
        unlagged = replace(
            rim, inputs=inputs, banks=np.concatenate([bank[None], rim.banks[rim.rest]])
        )
        at_surface, heat = unlagged.answer(
            h, extra=tuple((0.0, float(x)) for x in SURFACE_POINTS * rim.setup.width_m)
        )
        surface = (at_surface + share * heat)[:, len(rim.setup.outer) :].mean(axis=1)
        return cls(test, fit, share, h, rim, chain, rest + share * power, power, surface)

    def moved(self, p: Perturbation) -> Array:
        """What the outer row shows more of a disk that departs by ``p``, (R, P) [K]."""
        rest, power = self.rim.answer(self.h_W_m2K, p)
        return np.asarray(rest + self.share * power - self.base)

    def film(self, air_K: Array) -> Array:
        """What the outer row shows more when the air at the running surface alone is warmer by ``air_K`` (R,), (R, P)
        [K]."""
        window = self.fit.side.window
        air = self.chain.response(interpolate_blocks(window, air_K[:, None])[:, 0], self.test.dt_s)
        bank = bank_means(air, self.test.dt_s, self.rim.rates_1_s, window.counts)
        s = self.rim.setup
        points = points_of(s, s.outer)
        film = self.rim.films[0]
        gains = cached_gains(
            Rim.from_setup(s),
            self.h_W_m2K,
            points,
            self.rim.half_width_m,
            tuple(self.rim.rates_1_s),
            self.rim.profile,
            "hertz",
            FIT_MESH,
            film=True,
        )
        return np.asarray(
            (window.blocks @ air)[:, None] * gains.direct[film][0] + bank @ gains.gains[film][0].T
        )

    def lossier(self, ratio: Array) -> Array:
        """The same when h is higher by ``ratio`` (R,) of itself: h (1 + ratio) (T - T_A) is an air that is colder by
        ratio (T - T_A)."""
        return self.film(-ratio * (self.surface - self.rim.inputs[:, self.rim.ambient]))

    def later(self, late_s: float = 0.0) -> tuple[Array, list[str]]:
        """What the outer row shows more when one junction is ``LAG_SD_S`` slower, (C, R, P), and which.

        Of the outer row by the straight line to ``late_s``, if that is not zero: much lag is not linear.
        """
        disk = self.test.disks[self.fit.disk]
        window = self.fit.side.window
        n = len(disk.chains)
        outer = disk.setup.outer
        free = replace(
            disk, lag_covariance_s2=LAG_SD_S**2 * (n / (n - 1)) * np.eye(n)
        )  # less the mean of n
        known = nuisance_effects(self.test, free, window, self.share, self.h_W_m2K)
        rows = [k for k, what in enumerate(known.of) if what.name.startswith("lag ")]
        change = known.change[rows].copy()
        names = [known.of[k].name.removeprefix("lag ") for k in rows]
        slower = self.chain.with_lag_shift(max(late_s, -0.8 * max(self.chain.taus_s)))
        if off_s := slower.lag_s - self.chain.lag_s:
            whole = interpolate_blocks(window, self.base)
            shown = equalised(whole, self.test.dt_s, (self.chain,) * len(outer), slower)
            moved = window.blocks @ (shown - whole) * (LAG_SD_S / off_s)
            for k, c in enumerate(outer):
                if c in names:
                    change[names.index(c)] = moved * (np.arange(len(outer)) == k)
        return change, names


def _h_step(a: DiskAtFit) -> Array:
    return H_STEP_SD * a.lossier((a.fit.side.window.at_s >= a.test.events.unload_s).astype(float))


def _h_of_T(a: DiskAtFit) -> Array:
    return H_PER_K_SD * a.lossier(a.surface - _at_parting(a, a.surface))


def _at_parting(a: DiskAtFit, x: Array) -> float:
    since = a.fit.side.window.at_s - a.test.events.unload_s
    return float(x[(since > -10.0) & (since < 0.0)].mean())


def _flux_shift(a: DiskAtFit) -> Array:
    return SHIFT_SD_M * flux_shift_effect(a.rim, a.share, a.h_W_m2K)


def _flux_wider(a: DiskAtFit) -> Array:
    return a.moved(Perturbation(half_width=FLUX_WIDTH_SD))


def _faces(a: DiskAtFit) -> Array:
    return a.moved(Perturbation(washer=WASHER_SD))


def _stem(a: DiskAtFit) -> Array:
    """Every junction reads less by a part of its excess over ambient; the inner row then drives the rim too cold."""
    at = a.rim.ambient
    gains = a.rim.gains(a.h_W_m2K)
    air = a.rim.inputs[:, [at]]
    excess = [a.rim.inputs[:, [k]] - air for k in range(1, at)]
    driven = sum(
        x * gains.direct[k] + (a.rim.banks[k] - a.rim.banks[at]) @ gains.gains[k].T
        for k, x in enumerate(excess, 1)
    )
    return np.asarray(STEM_SD * (driven - (a.base - air)))


def _elsewhere(a: DiskAtFit) -> Array:
    return -LOST_HEAT_SD * a.share * a.power


def _k_of_T(a: DiskAtFit) -> Array:
    """Less where it is hot, as rig.toml might have stated."""
    s = a.rim.setup
    air = _at_parting(a, a.rim.inputs[:, a.rim.ambient])
    rim = replace(a.rim, setup=replace(s, steel=s.steel.about(air, _at_parting(a, a.surface))))
    window = replace(a.fit.side.window, rim=rim)
    return -conductivity_slope_effect(window, a.share, a.h_W_m2K, 0.01 * CONDUCTIVITY_PER_100_K_SD)


def _film_air(a: DiskAtFit) -> Array:
    return a.film(np.full(len(a.base), AIR_SD_K))


# name: column of a disk, and how far the disks may differ: half the difference's standard deviation over the mean's
MODEL_FORMS: dict[str, tuple[Callable[[DiskAtFit], Array], float]] = {
    "h_step": (_h_step, 1 / 3),
    "h_of_T": (_h_of_T, 0.0),
    "flux_shift": (_flux_shift, 1.0),
    "flux_wider": (_flux_wider, 0.0),
    "faces": (_faces, 0.0),
    "stem": (_stem, 0.0),
    "elsewhere": (_elsewhere, 0.0),
    "k_of_T": (_k_of_T, 0.0),
    "film_air": (_film_air, 0.0),
}


def model_form_columns(
    test: EhlTest, joint: Mapping[str, DiskFit], theta: Array, only: str = "", late_s: float = 0.0
) -> dict[str, Array]:
    """Whitened columns (N, m) of both disks' data by a prior standard deviation of each structure's parameters.

    ``theta`` (8,) is where the fit of both disks stands; ``only`` one structure, if named; ``late_s`` how late a
    junction is, if not a little.
    """
    about = [DiskAtFit.of(test, joint[d], theta[4 * k : 4 * k + 4]) for k, d in enumerate(DISKS)]
    weights = [a.fit.side.window.weight for a in about]

    def alone(k: int, change: Array) -> Array:
        parts = [np.zeros(w.size) for w in weights]
        parts[k] = (change * weights[k]).ravel()
        return np.concatenate(parts)

    out: dict[str, Array] = {}
    for name, (column, differ) in MODEL_FORMS.items():
        if only in ("", name):
            fast, slow = (alone(k, column(a)) for k, a in enumerate(about))
            out[name] = np.stack(
                [fast + slow, differ * (fast - slow)] if differ else [fast + slow], axis=1
            )
    for k, a in enumerate(about):
        if not only or only.startswith(f"lag of {DISKS[k]}"):
            change, channels = a.later(late_s)
            used = [c not in test.disks[DISKS[k]].left_out for c in channels]
            out |= {
                f"lag of {DISKS[k]}_{c}": alone(k, x)[:, None]
                for c, x, u in zip(channels, change, used)
                if u
            }
    return out


@dataclass(frozen=True)
class Refit:
    """The fit with more columns: ``step`` (P,) of its parameters, ``sizes`` of the columns, ``volume``: half the log
    determinant of what they add to the information; ``covariance`` (P, P) for white noise scaled by a factor."""

    step: Array
    covariance: Callable[[float], Array]
    sizes: tuple[Estimate, ...]
    volume: float
    log_odds: float
    delta_chi2: float
    waves: float


@dataclass(frozen=True)
class LinearisedFit:
    """The fit of both disks linear about its optimum; ``ends`` of each disk's data, behind which stand prior rows, and
    ``points``: how many junctions its outer row has."""

    residual: Array
    jacobian: Array
    precision: Array
    off_prior: Array
    directions: Array
    ends: NDArray[np.int64]
    points: tuple[int, ...]

    @classmethod
    def at(
        cls,
        best: Optimum,
        ends: NDArray[np.int64],
        points: tuple[int, ...],
        which: NDArray[np.int64] | None = None,
    ) -> LinearisedFit:
        """About an optimum, by the parameters ``which`` of it."""
        k = np.arange(len(best.theta)) if which is None else which
        off = best.theta - best.problem.prior_mean
        free = free_directions(best.problem.fixed[:, k])
        return cls(
            best.residual,
            best.jacobian[:, k],
            best.problem.precision[k],
            off[k],
            free,
            ends,
            points,
        )

    @cached_property
    def _sums(self) -> tuple[Array, Array, Array, Array]:
        """Information and half-gradient of the data, and of all that was known beforehand."""
        (r, s), (j, k) = (np.split(x, self.ends[-1:]) for x in (self.residual, self.jacobian))
        return (
            j.T @ j,
            j.T @ r,
            k.T @ k + np.diag(self.precision),
            k.T @ s + self.precision * self.off_prior,
        )

    def waves(self, residual: Array) -> float:
        """Slow waves in the residuals of the worse disk, as the fits count them."""
        parts = np.split(residual[: self.ends[-1]], self.ends[:-1])
        return max(wave_factor(r.reshape(-1, p)) for r, p in zip(parts, self.points))

    def __call__(self, columns: Array, waves: float) -> Refit:
        """The answer with ``columns`` (N, m), each with a standard normal prior, white noise scaled by ``waves``."""
        r = self.residual[: self.ends[-1]]
        j = self.jacobian[: self.ends[-1]]
        d = self.directions
        seen_by, toward, before, held = self._sums
        cov = d @ inverse(d.T @ (seen_by / waves + before) @ d) @ d.T
        start = -cov @ (toward / waves + held)
        left = r + j @ start
        across = j.T @ columns / waves
        follow = cov @ across
        seen = np.eye(columns.shape[1]) + columns.T @ columns / waves - across.T @ follow
        b = columns.T @ left / waves
        known = np.linalg.inv(seen)
        size = -known @ b
        chi2 = float(b @ known @ b)
        volume = 0.5 * float(np.linalg.slogdet(seen)[1])

        def covariance(scaled: float) -> Array:
            own = np.asarray(cov + follow @ known @ follow.T)
            return own if scaled == waves else self(columns, scaled).covariance(scaled)

        return Refit(
            step=start - follow @ size,
            covariance=covariance,
            sizes=tuple(
                Estimate.normal(float(s), float(np.sqrt(v))) for s, v in zip(size, np.diag(known))
            ),
            volume=volume,
            log_odds=0.5 * chi2 - volume,
            delta_chi2=chi2,
            waves=self.waves(left + columns @ size - j @ (follow @ size)),
        )
