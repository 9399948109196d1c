"""Linear effects of model-form alternatives on the readings, and the joint fit with them added.

Each alternative is a departure of the test from the model that the fits assume, which rig.toml does
not cover: another flux, heat that is lost elsewhere, a slower junction. It is linear about the fit
of both disks, with a prior standard deviation that is chosen by judgement. ``MODEL_FORMS`` lists
them. :mod:`tcdyn.partition.model_forms` compares the fits with each of them added. Guarded by
``tests/partition/test_structures.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain, equalise
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate
from tcdyn.estimation import Optimum, free_directions, inverse, slow_variance_factor
from tcdyn.heat.nonuniform import cached_rim_gains
from tcdyn.heat.rim import Rim, junction_points, lag_basis, lag_basis_means
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import DiskFit
from tcdyn.partition.nuisance import LOG_H, SHARE, lags, nuisance_effects, with_lags
from tcdyn.partition.specified import conductivity_slope_effect, flux_shift_effect
from tcdyn.partition.window import (
    FIT_MESH,
    Perturbation,
    RimMeans,
    interpolate_blocks,
    lagged_power,
)
from tcdyn.rig.disk import DISKS

# Prior standard deviations of the alternatives, chosen by judgement.
H_STEP_SD = 0.15  # relative change of h at the unloading: the pattern of the jets changes
H_PER_K_SD = 0.002  # relative change of h per kelvin of the surface: viscosity of the film
SHIFT_SD_M = 0.35e-3  # of the flux along the track [m]: 0.5 mm of each disk
FLUX_WIDTH_SD = 0.5  # relative change of the flux's half-width
WASHER_SD = 1.0  # relative change of the washers' conductance
STEM_SD = 0.02  # of a junction's excess over ambient that its wires conduct away
LOST_HEAT_SD = 0.1  # of the frictional heat that enters neither disk, or of the friction's scale
CONDUCTIVITY_PER_100_K_SD = 0.07  # relative change of the conductivity
AIR_SD_K = 5.0  # temperature of oil or air at the running surface less the logged ambient [K]
LAG_SD_S = 0.3  # lag of one junction [s]: a bubble in its cement
# Chosen by judgement.
SURFACE_POINTS = np.linspace(0.05, 0.95, 7)  # across the running surface, relative to its width
# Values at the unloading are means over this long before it [s]. It is shorter than the 20 s of
# ``press_fit.WINDOW_S`` and ``joint_results.OIL_WINDOW_S``, which average noisy readings: the
# values here are block means, of the modelled surface and of the air, and the state at the
# unloading itself is the point to linearise at.
UNLOADING_MEAN_S = 10.0
MAX_LAG_REDUCTION = 0.8  # largest reduction of a lag, relative to the chain's longest


@dataclass(frozen=True)
class DiskAtFit:
    """One disk at its part of the fit of both, as the point to linearise at.

    Parameters
    ----------
    test, fit
        The test, and the joint fit of the disk.
    share, h_W_m2K
        Its share and heat transfer coefficient.
    rim
        The rim with the power as the fit sees it, through the fitted lags.
    chain
        The chain through which everything is seen.
    base, power
        Prediction of the outer row [degC], and its response to a share of one [K], (R, P).
    surface
        Mean temperature of the running surface, without lag, (R,) [degC].
    """

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
        """The disk of a joint fit at given parameters.

        Parameters
        ----------
        test, fit
            The test, and the joint fit of the disk.
        theta
            ``tcdyn.partition.nuisance.PARAMETERS`` of the disk, (4,).
        """
        rim = fit.block.rim_with_lags(lags(theta))
        share = float(theta[SHARE])
        h = float(np.exp(theta[LOG_H]))
        chain = with_lags(test.disks[fit.disk].mean_chain, lags(theta))
        boundary, power = rim.response(h)
        surface = _surface_temperature(test, fit, rim, share, h)
        return cls(test, fit, share, h, rim, chain, boundary + share * power, power, surface)

    def perturbation_effect(self, perturbation: Perturbation) -> Array:
        """Change of the outer row by a departure from the nominal disk, (R, P) [K]."""
        boundary, power = self.rim.response(self.h_W_m2K, perturbation)
        return np.asarray(boundary + self.share * power - self.base)

    def surface_air_effect(self, air_K: Array) -> Array:
        """Change of the outer row if only the air at the running surface is warmer, (R, P) [K].

        Parameters
        ----------
        air_K
            By how much it is warmer, (R,) [K].

        Notes
        -----
        The change of the air passes the chain, as everything in the readings does. The gains are
        those of the default flux: they do not depend on it, because no power is involved.
        """
        window = self.fit.block.window
        setup = self.rim.setup
        samples = interpolate_blocks(window, air_K[:, None])[:, 0]
        air = self.chain.response(samples, self.test.dt_s)
        bank = lag_basis_means(air, self.test.dt_s, self.rim.rates_1_s, window.counts)
        gains = cached_rim_gains(
            Rim.from_setup(setup),
            self.h_W_m2K,
            junction_points(setup, setup.outer),
            self.rim.half_width_m,
            tuple(self.rim.rates_1_s),
            self.rim.profile,
            "hertz",
            FIT_MESH,
            split_surface_air=True,
        )
        surface_air = self.rim.surface_air_inputs[0]
        direct = gains.direct[surface_air][0]
        return np.asarray(
            (window.blocks @ air)[:, None] * direct + bank @ gains.gains[surface_air][0].T
        )

    def h_change_effect(self, ratio: Array) -> Array:
        """Change of the outer row if h is higher by ``ratio`` (R,) of itself, (R, P) [K].

        Notes
        -----
        h (1 + ratio) (T - T_A) is the loss to an air that is colder by ratio (T - T_A). First
        order: the surface temperature is that of the fit. ``tests/partition/test_structures.py``
        compares it with the rim at another h.
        """
        superheat = self.surface - self.rim.inputs[:, self.rim.ambient_index]
        return self.surface_air_effect(-ratio * superheat)

    def lag_effects(self, late_s: float = 0.0) -> tuple[Array, list[str]]:
        """Change of the outer row when one junction is ``LAG_SD_S`` slower, and which junction.

        For junctions of the outer row, the secant to a given delay if that is not zero: a large lag
        is not linear.

        Parameters
        ----------
        late_s
            Delay for the secant [s]; zero for the slope.

        Returns
        -------
        change
            Effect of each junction, (C, R, P) [K].
        names
            The C channels.

        Notes
        -----
        The effects are those named "lag ..." of ``tcdyn.partition.nuisance.nuisance_effects``,
        whose standard uncertainty is that of the difference from the mean of all lags; the
        covariance is scaled so that it is ``LAG_SD_S``. ``MAX_LAG_REDUCTION`` keeps the shifted lag
        positive.
        """
        disk = self.test.disks[self.fit.disk]
        window = self.fit.block.window
        n = len(disk.chains)
        outer = disk.setup.outer
        # the effects subtract the mean of the n lags
        covariance_s2 = LAG_SD_S**2 * (n / (n - 1)) * np.eye(n)
        independent = replace(disk, lag_covariance_s2=covariance_s2)
        nuisances = nuisance_effects(self.test, independent, window, self.share, self.h_W_m2K)
        rows = [k for k, q in enumerate(nuisances.parameters) if q.name.startswith("lag ")]
        change = nuisances.change[rows].copy()
        names = [nuisances.parameters[k].name.removeprefix("lag ") for k in rows]
        shift_s = max(late_s, -MAX_LAG_REDUCTION * max(self.chain.taus_s))
        slower = self.chain.with_lag_shift(shift_s)
        delay_s = slower.lag_s - self.chain.lag_s
        if delay_s:
            samples = interpolate_blocks(window, self.base)
            delayed = equalise(samples, self.test.dt_s, (self.chain,) * len(outer), slower)
            secant = window.blocks @ (delayed - samples) * (LAG_SD_S / delay_s)
            for k, c in enumerate(outer):
                if c in names:
                    change[names.index(c)] = secant * (np.arange(len(outer)) == k)
        return change, names

    def mean_before_unloading(self, x: Array) -> float:
        """Mean over the last ``UNLOADING_MEAN_S`` under load.

        Parameters
        ----------
        x
            Means over the blocks of the window, (R,).

        Returns
        -------
        mean
            In the unit of ``x``.

        Notes
        -----
        Blocks whose time is in the interval count, each alike. Test:
        ``tests/partition/test_structures.py``.
        """
        since_s = self.fit.block.window.block_time_s - self.test.events.unload_s
        return float(x[(since_s > -UNLOADING_MEAN_S) & (since_s < 0.0)].mean())


def _surface_temperature(
    test: EhlTest, fit: DiskFit, rim: RimMeans, share: float, h_W_m2K: float
) -> Array:
    """Mean temperature of the running surface by the power without lag, (R,) [degC].

    Parameters
    ----------
    test, fit
        The test, and the joint fit of the disk.
    rim
        The rim, its power lagged; the power is replaced by that without lag.
    share, h_W_m2K
        Share and heat transfer coefficient of the model.

    Notes
    -----
    The inner row and the ambient still lag, since they are readings.
    """
    window = fit.block.window
    first = int(np.searchsorted(test.time_s, window.time_s[0]))
    rows = slice(first, first + len(window.time_s))
    power, hold = lagged_power(test, rows, None)
    bank = window.blocks @ lag_basis(power, test.dt_s, rim.rates_1_s, **hold)
    unlagged = replace(
        rim,
        inputs=np.column_stack([window.blocks @ power, rim.inputs[:, rim.boundary_inputs]]),
        banks=np.concatenate([bank[None], rim.banks[rim.boundary_inputs]]),
    )
    points = tuple((0.0, float(z)) for z in SURFACE_POINTS * rim.setup.width_m)
    boundary, heat = unlagged.response(h_W_m2K, extra=points)
    return np.asarray((boundary + share * heat)[:, len(rim.setup.outer) :].mean(axis=1))


def _h_step(at_fit: DiskAtFit) -> Array:
    """Effect of an h that is higher by ``H_STEP_SD`` from the unloading on, (R, P) [K]."""
    after = at_fit.fit.block.window.block_time_s >= at_fit.test.events.unload_s
    return H_STEP_SD * at_fit.h_change_effect(after.astype(float))


def _h_of_temperature(at_fit: DiskAtFit) -> Array:
    """Effect of an h that grows by ``H_PER_K_SD`` per kelvin of the surface, (R, P) [K].

    The surface temperature counts from that at the unloading.
    """
    return H_PER_K_SD * at_fit.h_change_effect(
        at_fit.surface - at_fit.mean_before_unloading(at_fit.surface)
    )


def _flux_shift(at_fit: DiskAtFit) -> Array:
    """Effect of a flux that is shifted along the track by ``SHIFT_SD_M``, (R, P) [K]."""
    return SHIFT_SD_M * flux_shift_effect(at_fit.rim, at_fit.share, at_fit.h_W_m2K)


def _flux_width(at_fit: DiskAtFit) -> Array:
    """Effect of a flux that is wider by ``FLUX_WIDTH_SD``, (R, P) [K]."""
    return at_fit.perturbation_effect(Perturbation(half_width=FLUX_WIDTH_SD))


def _washers(at_fit: DiskAtFit) -> Array:
    """Effect of a washer conductance that is higher by ``WASHER_SD``, (R, P) [K]."""
    return at_fit.perturbation_effect(Perturbation(washer=WASHER_SD))


def _stem_conduction(at_fit: DiskAtFit) -> Array:
    """Effect of wires that conduct heat away from the junctions, (R, P) [K].

    They take ``STEM_SD`` of each junction's excess over ambient.

    Each junction reads less of its excess; the inner row then drives the rim too cold.
    """
    ambient = at_fit.rim.ambient_index
    gains = at_fit.rim.gains(at_fit.h_W_m2K)
    air = at_fit.rim.inputs[:, [ambient]]
    by_inner = 0.0
    for k in range(1, ambient):
        excess = at_fit.rim.inputs[:, [k]] - air
        excess_bank = at_fit.rim.banks[k] - at_fit.rim.banks[ambient]
        by_inner = by_inner + (excess * gains.direct[k] + excess_bank @ gains.gains[k].T)
    return np.asarray(STEM_SD * (by_inner - (at_fit.base - air)))


def _lost_heat(at_fit: DiskAtFit) -> Array:
    """Effect of a frictional heat of which ``LOST_HEAT_SD`` enters neither disk, (R, P) [K]."""
    return -LOST_HEAT_SD * at_fit.share * at_fit.power


def _conductivity_of_temperature(at_fit: DiskAtFit) -> Array:
    """Effect of a conductivity that falls with temperature, (R, P) [K].

    By ``CONDUCTIVITY_PER_100_K_SD`` per 100 K, as rig.toml might have stated.
    """
    setup = at_fit.rim.setup
    air = at_fit.mean_before_unloading(at_fit.rim.inputs[:, at_fit.rim.ambient_index])
    steel = setup.steel.linearised_about(air, at_fit.mean_before_unloading(at_fit.surface))
    rim = replace(at_fit.rim, setup=replace(setup, steel=steel))
    window = replace(at_fit.fit.block.window, rim=rim)
    slope_u_per_K = 0.01 * CONDUCTIVITY_PER_100_K_SD
    return -conductivity_slope_effect(window, at_fit.share, at_fit.h_W_m2K, slope_u_per_K)


def _surface_air(at_fit: DiskAtFit) -> Array:
    """Effect of air at the running surface that is ``AIR_SD_K`` warmer, (R, P) [K]."""
    return at_fit.surface_air_effect(np.full(len(at_fit.base), AIR_SD_K))


# name: effect on a disk, and how far the disks may differ: half the standard deviation of the
# difference, relative to that of the mean
MODEL_FORMS: dict[str, tuple[Callable[[DiskAtFit], Array], float]] = {
    "h_step": (_h_step, 1.0),
    "h_of_T": (_h_of_temperature, 0.0),
    "flux_shift": (_flux_shift, 1.0),
    "flux_wider": (_flux_width, 0.0),
    "faces": (_washers, 0.0),
    "stem": (_stem_conduction, 0.0),
    "elsewhere": (_lost_heat, 0.0),
    "k_of_T": (_conductivity_of_temperature, 0.0),
    "film_air": (_surface_air, 0.0),
}


def model_form_columns(
    test: EhlTest, joint: Mapping[str, DiskFit], theta: Array, only: str = "", late_s: float = 0.0
) -> dict[str, Array]:
    """Effects of each alternative's parameters on the weighted data of both disks, (N, m) each.

    Parameters
    ----------
    test, joint
        The test, and the joint fit of each disk.
    theta
        Parameters of the fit of both disks, (8,): the point to linearise at.
    only
        Name of the one alternative to compute; all if empty.
    late_s
        Delay of a junction for the secant of its lag, if that is not small [s].

    Returns
    -------
    dict
        By name: the keys of ``MODEL_FORMS``, and "lag of DISK_CHANNEL" for each channel used. Each
        column is by one prior standard deviation; N is the number of weighted data of both disks,
        the fast disk's first. Alternatives in which the disks may differ have two columns, mean and
        difference.

    Notes
    -----
    To add an alternative, write its effect and add it to ``MODEL_FORMS``; give its message in
    ``tcdyn/core/messages/partition.py``. Every alternative lowers the prior probability of all
    others (``tcdyn.partition.model_forms._probabilities``). ``tests/partition/test_structures.py``
    counts them.
    """
    disks = [DiskAtFit.of(test, joint[d], theta[4 * k : 4 * k + 4]) for k, d in enumerate(DISKS)]
    weights = [a.fit.block.window.weight for a in disks]

    def column(k: int, change: Array) -> Array:
        """Weighted data of both disks by a ``change`` (R, P) of disk ``k``."""
        segments = [np.zeros(w.size) for w in weights]
        segments[k] = (change * weights[k]).ravel()
        return np.concatenate(segments)

    columns: dict[str, Array] = {}
    for name, (effect, difference) in MODEL_FORMS.items():
        if only not in ("", name):
            continue
        fast, slow = (column(k, effect(a)) for k, a in enumerate(disks))
        parameters = [fast + slow]
        if difference:
            parameters.append(difference * (fast - slow))
        columns[name] = np.stack(parameters, axis=1)
    for k, a in enumerate(disks):
        disk = DISKS[k]
        if only and not only.startswith(f"lag of {disk}"):
            continue
        changes, channels = a.lag_effects(late_s)
        for channel, change in zip(channels, changes):
            if channel not in test.disks[disk].excluded:
                columns[f"lag of {disk}_{channel}"] = column(k, change)[:, None]
    return columns


@dataclass(frozen=True)
class Refit:
    """The fit of both disks with more columns.

    Parameters
    ----------
    step
        Change of the fit's parameters, (P,).
    covariance
        Covariance (P, P) of the parameters as a function of the factor on the variance of the
        noise.
    sizes
        Estimates of the columns' parameters, in prior standard deviations.
    volume
        Half the log determinant of the information that the columns add, their prior included.
    log_odds
        Logarithm of the Bayes factor against the fit without the columns.
    delta_chi2
        Decrease of chi-squared, with the prior of the columns.
    inflation
        Variance ratio of slow waves in the remaining residuals to white noise.
    """

    step: Array
    covariance: Callable[[float], Array]
    sizes: tuple[Estimate, ...]
    volume: float
    log_odds: float
    delta_chi2: float
    inflation: float


@dataclass(frozen=True)
class LinearisedFit:
    """The fit of both disks, linear about its optimum.

    Parameters
    ----------
    residual, jacobian
        At the optimum: rows of the data, then of the records' lags, (N + 2,) and (N + 2, P).
    precision, off_prior
        Prior precisions of the parameters, and their departure from the prior mean, (P,).
    directions
        Free directions of the parameters, which keep the sum of the shares, (P, P - 1).
    ends
        Ends of each disk's data among the rows.
    points
        Number of junctions in the outer row of each disk.
    """

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
        parameters: NDArray[np.int64] | None = None,
    ) -> LinearisedFit:
        """The fit about an optimum.

        Parameters
        ----------
        best
            The optimum of :func:`tcdyn.partition.joint.joint_problem`.
        ends, points
            As of the class.
        parameters
            Indices of the parameters, all if None.
        """
        k = np.arange(len(best.theta)) if parameters is None else parameters
        off_prior = best.theta - best.problem.prior_mean
        return cls(
            residual=best.residual,
            jacobian=best.jacobian[:, k],
            precision=best.problem.precision[k],
            off_prior=off_prior[k],
            directions=free_directions(best.problem.fixed[:, k]),
            ends=ends,
            points=points,
        )

    @cached_property
    def _normal_equations(self) -> tuple[Array, Array, Array, Array]:
        """Information and half-gradient of the data, then of all priors.

        The rows of the records' lags count as priors: slow waves of the residuals do not weaken
        them.
        """
        n_data = self.ends[-1]
        data_residual = self.residual[:n_data]
        prior_residual = self.residual[n_data:]
        data_jacobian = self.jacobian[:n_data]
        prior_jacobian = self.jacobian[n_data:]
        prior_gradient = prior_jacobian.T @ prior_residual + self.precision * self.off_prior
        return (
            data_jacobian.T @ data_jacobian,
            data_jacobian.T @ data_residual,
            prior_jacobian.T @ prior_jacobian + np.diag(self.precision),
            prior_gradient,
        )

    def inflation_of(self, residual: Array) -> float:
        """Variance ratio of slow waves in the residuals of the worse disk to white noise.

        Parameters
        ----------
        residual
            Residuals of both disks, with or without the rows after them.
        """
        segments = np.split(residual[: self.ends[-1]], self.ends[:-1])
        return max(slow_variance_factor(r.reshape(-1, p)) for r, p in zip(segments, self.points))

    def __call__(self, columns: Array, noise_scale: float) -> Refit:
        """The fit with further columns, each with a standard normal prior, in one linear step.

        Parameters
        ----------
        columns
            Effects of the further parameters on the weighted data, (N, m).
        noise_scale
            Factor on the variance of the white noise.

        Notes
        -----
        With X the columns, J the Jacobian, C the posterior covariance and s the scale, the columns
        add the information I + X'X/s - X'J C J'X/s^2. Its log determinant and the decrease of
        chi-squared give the Bayes factor (Laplace's method, exact for a linear model).
        ``tests/partition/test_structures.py`` compares one step with a full fit.
        """
        n_data = self.ends[-1]
        jacobian = self.jacobian[:n_data]
        d = self.directions
        data_information, data_gradient, prior_information, prior_gradient = self._normal_equations
        information = data_information / noise_scale + prior_information
        cov = d @ inverse(d.T @ information @ d) @ d.T
        start = -cov @ (data_gradient / noise_scale + prior_gradient)
        residual = self.residual[:n_data] + jacobian @ start
        cross = jacobian.T @ columns / noise_scale
        follow = cov @ cross
        identity = np.eye(columns.shape[1])
        column_information = identity + columns.T @ columns / noise_scale - cross.T @ follow
        gradient = columns.T @ residual / noise_scale
        column_covariance = np.linalg.inv(column_information)
        size = -column_covariance @ gradient
        chi2 = float(gradient @ column_covariance @ gradient)
        volume = 0.5 * float(np.linalg.slogdet(column_information)[1])
        remaining = residual + columns @ size - jacobian @ (follow @ size)

        def covariance(scale: float) -> Array:
            """Covariance of the parameters, the noise variance scaled by ``scale``."""
            if scale != noise_scale:
                return self(columns, scale).covariance(scale)
            return np.asarray(cov + follow @ column_covariance @ follow.T)

        variances = np.diag(column_covariance)
        return Refit(
            step=start - follow @ size,
            covariance=covariance,
            sizes=tuple(
                Estimate.normal(float(s), float(np.sqrt(v))) for s, v in zip(size, variances)
            ),
            volume=volume,
            log_odds=0.5 * chi2 - volume,
            delta_chi2=chi2,
            inflation=self.inflation_of(remaining),
        )
