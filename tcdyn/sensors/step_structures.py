"""Structures of a plunged sensor: lags, the tail of heat conduction, a slow path, a dead time.

``tcdyn.sensors.plunge`` averages them. ``tests/sensors/test_sensor_plunge.py`` and
``tests/sensors/layered_study.py`` check them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.estimation import NoiseModel
from tcdyn.rig.disk import Conditioning
from tcdyn.sensors.construction import JUNCTION_WORDS, JunctionWord
from tcdyn.sensors.file import lag_and_times, percent_times
from tcdyn.sensors.step import Step
from tcdyn.sensors.step_fits import CurveFit, bic_weights, fit_curve, residual_noise, white_noise_K
from tcdyn.sensors.step_stages import STAGES, TIMES_LAGS, TIMES_ROWS

# Place of the junction: in the axis, insulated from the sheath; welded to the sheath; or bare.
Junction = JunctionWord
JUNCTIONS = JUNCTION_WORDS
# Grid of the second lag where it is not resolved, as shares of the largest; chosen by judgement.
SECOND_SHARES = (0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.23, 0.32)
# Probability, before the data, that the second lag is shorter than this grid; by judgement.
NO_SECOND_LAG = 0.3
# BIC above the best one beyond which no larger second lag is tried: a weight below 1e-4.
GRID_END = 20.0
# Second lag of a sheathed sensor without a gas gap over the square of its diameter [s/mm2], and the
# standard deviation of its logarithm: core, powder of 1.5 to 5 W/mK and sheath, in water, oil or
# air.
SECOND_LAG = (0.015, 0.35)
GAP_FACTOR = 30.0  # largest ratio by which a gap of 10 to 60 um lengthens it
# Shares of the lag with which the fits of one, two and three lags start; chosen by judgement.
START_SHARES = ([1.0], [0.85, 0.15], [0.75, 0.17, 0.08])
# Sum of all shorter lags, which act as a dead time, over the last lag that is fitted, and its
# standard deviation, for one or two lags and for three, by the place of the junction. Sensors with
# core, powder, sheath, and in half of them a gap, diameter 0.5 to 8 mm, in water, oil or air have
# 0.02 to 0.7 after two lags and 0.5 to 1.4 after three in the axis; a homogeneous cylinder has 0.8
# to 1.3 and 1.8 to 2.3, lumped lags have 0. At the sheath they have -1.5 to 0 after two. A bare
# wire or bead is nearly lumped, with Biot numbers below 0.3 in water: hardly a tail is left; by
# judgement.
TAIL = {
    "insulated": ((0.45, 0.28), (0.45, 0.28), (0.9, 0.5)),
    "grounded": ((-0.7, 0.5), (-0.7, 0.5), (-0.5, 0.6)),
    "exposed": ((0.1, 0.2), (0.1, 0.2), (0.2, 0.3)),
}
MIN_TAIL = {"insulated": 0.0, "grounded": -1.5, "exposed": 0.0}  # lower bounds
# Standard deviation of the drift in the fitted part over the step, before the data; by judgement.
DRIFT_SHARE = 0.02
# Time constants of a slow second heat path over the lag, of which the best is the start of its fit.
SLOW_RATIOS = (3.0, 6.0, 12.0)
SMALL_SHARE = 1e-4  # step of the linear estimate of a share, and of a dead time over the lag
# Least time constant of that path over the lag, and its largest share: with more it is the main
# path. A junction at the sheath follows the sheath quickly, and the powder behind it slowly.
MIN_SLOW_RATIO = {"insulated": 2.0, "grounded": 0.8, "exposed": 2.0}
MAX_SLOW_SHARE = {"insulated": 0.5, "grounded": 0.95, "exposed": 0.5}
# Start of the time in which a film settles over the lag, at most; it decides the number of steps
SETTLING_SHARE = 0.5
# Odds, before the data, of a stem that conducts, over those of none, by the junction. By judgement:
# it is common for an exposed one in air, and otherwise rare; the data then show it clearly.
FIN_ODDS = {"insulated": 0.05, "grounded": 0.05, "exposed": 1.0}
# Steps of the search, at most. Along the curved valley of a stem that conducts 20 to 40 are needed;
# a search that ends before leaves its lag up to 60 standard uncertainties off
# (`python -m tests.sensors.hand_study`).
MAX_STEPS = 150
# Fall of the sum of squares, in squared noises, at which the search for a structure of a dip ends;
# 1e-3 changes lag and times by less than 0.01 u (`python -m tests.behaviour.store "sensor plunge"`)
TOLERANCE = 1e-2
# Least first lag of a stage in intervals: a shorter one cannot be seen, and divides by zero
LEAST_FIRST = 0.01
# BIC above the best one beyond which no stage is tried beside a slow path: a weight below 1e-4
STAGE_END = 20.0
# Points in a row through which the response of a stage passes the other lags as straight lines
FINER = 2
# Gain in twice the log likelihood, in one linear step, from which such a path or a dead time is
# fitted: the BIC of more than 30 samples asks for 3.4 a parameter.
MIN_GAIN = 4.0
MEDIUM_LIMIT_U = 4.0  # largest lag of the medium, in standard uncertainties above its mean
# Start of the medium's lag over the lag that the sensor takes from it; chosen by judgement.
SHORT_MEDIUM = 0.1
MIN_WEIGHT = 1e-3  # probability below which a structure is not tried with the grid of second lags
SETTLED_NOISE = (0.8, 1.25)  # ratio of two white levels within which no round follows; by judgement
NOISE_ITERATIONS = 3  # rounds of noise and fit, at most; chosen by judgement


def exact_u_s(dt_s: float) -> float:
    """Return the standard uncertainty of a time specified as exact [s], for any interval."""
    return min(1e-6, 1e-3 * dt_s)


@dataclass(frozen=True)
class StepRecord:
    """Data of the fit.

    Attributes
    ----------
    t
        Times from the first row (N,) [s].
    y
        Readings (N,) [degC], NaN where missing.
    dt_s
        Interval [s].
    step
        The step.
    entry_s
        First guess of the entry, from the first row [s].
    entry_prior_s
        Prior of the entry, mean and standard deviation [s], or None.
    medium_s
        Medium's lag and its standard uncertainty [s].
    conditioning
        Filter after the sensor.
    diameter_m
        Diameter of the sheath [m], or None.
    junction
        Place of the junction.
    mean_s
        Time before each row over which it is a mean [s]; zero for none.
    """

    t: Array
    y: Array
    dt_s: float
    step: Step
    entry_s: float
    entry_prior_s: tuple[float, float] | None
    medium_s: tuple[float, float]
    conditioning: Conditioning
    diameter_m: float | None
    junction: Junction
    mean_s: float = 0.0

    @property
    def sensor_lag_s(self) -> float:
        """First guess of the sensor's lag without the filter."""
        behind_s = self.conditioning.lag_s + 0.5 * self.mean_s
        return max(self.step.rise_s - behind_s, 2 * self.dt_s)

    def start(self, shares: Sequence[float]) -> dict[str, float]:
        """Return start values of the parameters by name.

        Parameters
        ----------
        shares
            Lags over their sum.

        Returns
        -------
        dict
            The start values.
        """
        lag_s = self.sensor_lag_s
        return {
            "level": self.step.before_degC,
            "entry_s": self.entry_s,
            "size": self.step.size_K,
            "drift_K": 0.0,
            "medium_s": max(self.medium_s[0], min(1e-4, 0.1 * self.dt_s)),
            "tail": TAIL[self.junction][0][0],
            **{f"tau{k + 1}_s": share * lag_s for k, share in enumerate(shares)},
        }

    def prior_odds(self, fitted: FittedStructure) -> float:
        """Return the probability of a fitted structure before the data, not normalised.

        Parameters
        ----------
        fitted
            The structure and its fit.

        Returns
        -------
        float
            That of :meth:`prior`, times ``FIN_ODDS`` of a stem. A structure with a sharp step
            replaces one in which the last lag is the medium's. Both have one curve, so that only
            their priors may decide: the factors
            replace the term of the BIC for that lag by its prior, as a second lag of the sensor,
            and add the prior of the medium at a lag of zero.

        Notes
        -----
        Laplace approximation of the evidence: a parameter with the prior density p(theta) and the
        standard uncertainty u contributes sqrt(2 pi) p(theta) u (Kass and Raftery 1995), here
        instead of the 1/sqrt(N) of the BIC. Otherwise a quiet record would count for the sensor,
        although it says nothing about whose lag it is.
        """
        structure = fitted.structure
        odds = FIN_ODDS[self.junction] if structure.stage == "fin" else 1.0
        if not structure.sharp:
            return odds * self.prior(structure)
        fit = fitted.fit
        moved = f"tau{structure.lags}_s"
        lag_s = fit.theta[moved]
        shares = np.array(SECOND_SHARES)
        k = int(np.argmin(np.abs(np.log(shares * fit.theta["tau1_s"] / lag_s))))
        width_s = lag_s * float(np.gradient(np.log(shares))[k])
        nearest = StepStructure(1, self.conditioning, second_share=SECOND_SHARES[k])
        density = self.prior(nearest) / width_s
        evidence = density * float(np.sqrt(2 * np.pi * len(fit.residual))) * fit.u(moved)
        medium_s, medium_u_s = self.medium_s
        distance = medium_s / max(medium_u_s, exact_u_s(self.dt_s))
        return float(odds * evidence * np.exp(-0.5 * distance**2))

    def prior(self, structure: StepStructure) -> float:
        """Return the probability of a structure before the data, not normalised.

        Parameters
        ----------
        structure
            The structure.

        Returns
        -------
        float
            1 where all lags are fitted. The structures with one fitted lag share it: each has the
            probability that the second lag is near its own. A second lag of zero stands for all
            that are below the grid.
        """
        if structure.lags > 1:
            return 1.0
        shares = np.array(SECOND_SHARES)
        edges = np.r_[0.5 * shares[0], np.sqrt(shares[1:] * shares[:-1]), np.inf]
        k = int(np.searchsorted(shares, structure.second_share)) if structure.second_share else -1
        # with a stage each second value stands for the one before, too
        first = k - 1 if structure.stage and k > 0 else k
        if self.diameter_m is None:
            share = (1 - NO_SECOND_LAG) * (k - first + 1) / len(shares)
            return NO_SECOND_LAG if k < 0 else share
        below = second_lag_probability(edges * self.sensor_lag_s, self.diameter_m)
        return float(below[0] if k < 0 else below[k + 1] - below[first])

    def exchange_lags(self, values: Mapping[str, float]) -> list[dict[str, float]]:
        """Return start values with the medium's lag and one of the sensor's lags exchanged.

        The response is symmetric in them, so that both are solutions; their priors decide. Lags
        that the medium cannot have are left out.

        Parameters
        ----------
        values
            Fitted values by name.

        Returns
        -------
        list of dict
            The start values by name.
        """
        if "medium_s" not in values:
            return []
        longest_s = self.medium_s[0] + MEDIUM_LIMIT_U * self.medium_s[1]
        medium_s = values["medium_s"]
        lags = [(n, v) for n, v in values.items() if n.startswith("tau") and v < longest_s]
        return [{**values, "medium_s": lag_s, name: medium_s} for name, lag_s in lags]

    def sharp_step(
        self, structure: StepStructure, fit: CurveFit
    ) -> tuple[StepStructure, dict[str, float]] | None:
        """Return the structure in which the medium's lag is a further lag of the sensor.

        The medium's step is then sharp. The data cannot tell, because the curve is the same.

        Parameters
        ----------
        structure
            A structure in which the medium has a lag.
        fit
            Its fit.

        Returns
        -------
        structure, start
            The structure and its start values by name; None where the sensor has three lags, or
            where the data do not distinguish the medium's lag from zero.
        """
        if structure.lags == len(START_SHARES) or not fit.is_resolved(["medium_s"]):
            return None
        sharp = replace(structure, lags=structure.lags + 1, sharp=True)
        return sharp, self.with_further_lag(structure, fit)

    def with_further_lag(self, structure: StepStructure, fit: CurveFit) -> dict[str, float]:
        """Return start values with the medium's lag as a further lag of the sensor.

        Parameters
        ----------
        structure
            A structure in which the medium has a lag.
        fit
            Its fit.

        Returns
        -------
        dict
            The start values by name; the medium's lag is short.
        """
        medium_s = fit.theta["medium_s"]
        moved = {f"tau{structure.lags + 1}_s": medium_s, "medium_s": SHORT_MEDIUM * medium_s}
        return self.start([]) | fit.theta | moved

    def curve(self, structure: StepStructure, values: Mapping[str, float]) -> Array | None:
        """Return the readings (N,) of a structure; None where they cannot be computed.

        Parameters
        ----------
        structure
            The structure.
        values
            Its parameters by name.

        Returns
        -------
        array or None
            Readings [degC].
        """
        duration_s = float(self.t[-1])
        longest_s = max(values[name] for name in structure.lag_names)
        longest_s = max(longest_s, values.get("slow_s", 0.0))
        if not 0 <= values["entry_s"] < duration_s or longest_s > 50 * duration_s:
            return None
        if structure.stage and values["tau1_s"] < LEAST_FIRST * self.dt_s:
            return None
        chain = structure.chain(values, with_stage=False)
        after_medium = replace(
            chain,
            taus_s=(*chain.taus_s, 0.0 if structure.sharp else max(values["medium_s"], 0.0)),
            delay_s=chain.delay_s + values["entry_s"],
            mean_s=self.mean_s,
        )
        if structure.stage:
            response = structure.response(after_medium, values, self.t)
        else:
            response = after_medium.response(np.ones_like(self.t), self.dt_s, "zoh", "zero")
        return values["level"] + values["size"] * response + values["drift_K"] * self.drift

    @property
    def drift(self) -> Array:
        """A drift of one over the record, zero in its middle (N,)."""
        return np.asarray(self.t / self.t[-1] - 0.5)


@dataclass(frozen=True)
class StepStructure:
    """A sensor's chain as a function of fitted parameters.

    Attributes
    ----------
    lags
        Number of fitted lags, one to three.
    conditioning
        Filter after the sensor.
    second_share
        A fixed second lag over the first; 0 for none. Only with one fitted lag.
    slow
        Whether there is a slow second heat path.
    dead
        Whether there is a dead time.
    sharp
        Whether the medium's step is sharp, without a lag of its own.
    stage
        Name of what replaces the first lag (``STAGES``); empty for none.
    """

    lags: int
    conditioning: Conditioning
    second_share: float = 0.0
    slow: bool = False
    dead: bool = False
    sharp: bool = False
    stage: str = ""

    @property
    def names(self) -> list[str]:
        """Names of the parameters (P)."""
        names = ["level", "entry_s", "size", "drift_K"]
        if not self.sharp:
            names.append("medium_s")
        if self.lags > 1 or self.second_share:
            names.append("tail")
        if self.stage:
            names += [parameter.name for parameter in STAGES[self.stage].parameters]
        names += self.lag_names
        if self.slow:
            names += ["slow_share", "slow_s"]
        if self.dead:
            names.append("dead_s")
        return names

    @property
    def order(self) -> int:
        """Number of lags, without that of a slow path."""
        return self.lags + (self.second_share > 0)

    @property
    def lag_names(self) -> list[str]:
        """Names of the fitted lags."""
        return [f"tau{k}_s" for k in range(1, self.lags + 1)]

    @property
    def to_resolve(self) -> list[str]:
        """Names of the parameters that the data must distinguish from zero.

        Where the film settles, its lag may be undetermined: the dip may end before it has settled.
        """
        names = self.lag_names[1:] if self.stage == "film" else self.lag_names
        if self.slow:
            names += ["slow_share", "slow_s"]
        if self.dead:
            names.append("dead_s")
        return names

    @property
    def name(self) -> str:
        """Name of the structure, such as P2D; the dead time is that of the tail, too."""
        count = self.order + self.slow
        return f"P{count}" + "Z" * self.slow + "D" * ("tail" in self.names or self.dead)

    def chain(self, values: Mapping[str, float], *, with_stage: bool = True) -> Chain:
        """Return the sensor's chain.

        Parameters
        ----------
        values
            The parameters by name.
        with_stage
            Whether the first lag is in it: lags and a zero that stand for the stage. Otherwise of a
            structure with a stage, the chain contains what follows it.
        """
        later = [values[f"tau{k}_s"] for k in range(2, self.lags + 1)]
        if self.second_share:
            later.append(self.second_share * values["tau1_s"])
        tail_s = values.get("tail", 0.0) * min([values["tau1_s"], *later])
        delay_s = max(tail_s, 0.0) + values.get("dead_s", 0.0)
        zero_s = max(-tail_s, 0.0)
        if self.slow:
            later.append(values["slow_s"])
            zero_s += (1 - values["slow_share"]) * values["slow_s"]
        first: tuple[float, ...] = (values["tau1_s"],)
        if self.stage and with_stage:
            first, zero_of_stage_s = STAGES[self.stage].lags_and_zero(values, values["tau1_s"])
            zero_s += zero_of_stage_s
        elif self.stage:
            first = ()
        lags = sorted((tau for tau in [*first, *later] if tau > 0), reverse=True)
        return Chain(lags, zero_s, delay_s, conditioning=self.conditioning)

    def response(
        self, others: Chain, values: Mapping[str, float], t: Array, *, of_dip: bool = True
    ) -> Array:
        """Return the response (N,) to a unit step, of a structure with a stage.

        Parameters
        ----------
        others
            The chain without the stage; its dead time contains the time of entry.
        values
            The parameters by name.
        t
            Even times (N,) [s].
        of_dip
            Whether it is that of the dip, or the one whose percent times are those of the sensor.
        """
        stage = STAGES[self.stage]
        dt_s = float(t[1] - t[0]) / FINER
        # the dead time is that of the others
        since_s = dt_s * np.arange((len(t) - 1) * FINER + 1, dtype=np.float64)
        first_response = stage.response if of_dip else stage.sensor_response
        first = first_response(values, values["tau1_s"], since_s)
        return np.asarray(others.response(first, dt_s, "foh", "zero")[::FINER])

    def times(self, theta: Array) -> Array:
        """Return lag without the first time constant, lag, and times of the step (5,) [s]."""
        values = dict(zip(self.names, theta.tolist()))
        first_s = values["tau1_s"]
        chain = replace(self.chain(values, with_stage=False), conditioning=NO_CONDITIONING)
        if not self.stage:
            lag_s, *times = lag_and_times(chain)
            return np.array([lag_s - first_s, lag_s, *times])
        lag_s = chain.lag_s + STAGES[self.stage].sensor_lag_s(values, first_s)
        t = TIMES_LAGS * (first_s + chain.lag_s) * np.linspace(0.0, 1.0, TIMES_ROWS)
        times = percent_times(t, self.response(chain, values, t, of_dip=False))
        return np.array([lag_s - first_s, lag_s, *times])


@dataclass(frozen=True)
class FittedStructure:
    """A fitted structure.

    Attributes
    ----------
    structure
        The structure.
    fit
        Its fit.
    """

    structure: StepStructure
    fit: CurveFit


def second_lag_probability(tau_s: Array, diameter_m: float) -> Array:
    """Return the probability that the second lag of a sheathed sensor is below some values.

    Parameters
    ----------
    tau_s
        The values (K,) [s].
    diameter_m
        Diameter of the sheath [m].

    Returns
    -------
    array
        Probabilities (K,).

    Notes
    -----
    The second lag of a solid sensor is proportional to the square of its diameter and depends
    little on the medium (``SECOND_LAG``). With a gas gap between powder and sheath, assumed for
    half of the sensors, it is up to ``GAP_FACTOR`` times as long.

    Examples
    --------
    >>> second_lag_probability(np.array([0.001, 0.14, 10.0]), 3e-3).round(2).tolist()
    [0.0, 0.28, 1.0]
    """
    log_median = np.log(SECOND_LAG[0] * (1e3 * diameter_m) ** 2)
    position = np.log(tau_s) - log_median
    solid = norm.cdf(position / SECOND_LAG[1])
    gap = np.clip(position / np.log(GAP_FACTOR), 0.0, 1.0)
    return np.asarray(0.5 * (solid + gap))


def fit_structures(record: StepRecord) -> tuple[list[FittedStructure], Array]:
    """Fit all structures with the noise of the best fit's residuals.

    Parameters
    ----------
    record
        Data of the fit.

    Returns
    -------
    fitted
        The structures (K).
    weights
        Their probabilities (K,).
    """
    noise = (NoiseModel(), white_noise_K(record.y))
    for _ in range(NOISE_ITERATIONS):
        fitted, weights = _fit_with_noise(record, noise)
        best = fitted[int(np.argmax(weights))].fit
        colour, level_K = residual_noise(best.residual, len(best.optimum.theta))
        both_white = colour.white and noise[0].white
        if both_white and SETTLED_NOISE[0] < level_K / noise[1] < SETTLED_NOISE[1]:
            break
        noise = (colour, level_K)
    return fitted, weights


def _fit_with_noise(
    record: StepRecord, noise: tuple[NoiseModel, float]
) -> tuple[list[FittedStructure], Array]:
    """Fit all structures with one noise.

    Parameters
    ----------
    record
        Data of the fit.
    noise
        Autoregression and level [K] of the residuals.

    Returns
    -------
    fitted, weights
        As :func:`fit_structures` returns them.

    Raises
    ------
    InputError
        Where no structure can be fitted, because the response is within one row.

    Notes
    -----
    A short lag that the data show may be the medium's or the sensor's: both are fitted. A slow path
    and a dead time are added to the structures whose residuals ask for them. The grid of second
    lags is tried for each kind that the data do not exclude (``MIN_WEIGHT``).
    """
    fitted = list[FittedStructure]()
    unresolved = list[FittedStructure]()

    def add(structure: StepStructure, start: Mapping[str, float]) -> CurveFit | None:
        """Fit a structure; keep and return the fit if it is resolved and differs from others."""
        if record.curve(structure, start) is None:
            return None
        fit = _fit_structure(record, structure, start, noise)
        if not fit.is_resolved(structure.to_resolve):
            unresolved.append(FittedStructure(structure, fit))
            return None
        same = [f.fit for f in fitted if f.structure == structure]
        if any(known.is_near(fit, structure.lag_names) for known in same):
            return None
        fitted.append(FittedStructure(structure, fit))
        return fit

    starts = list[dict[str, float]]()
    for shares in START_SHARES:
        structure = StepStructure(len(shares), record.conditioning)
        starts = [record.start(shares), *starts]
        fits = [fit for fit in (add(structure, start) for start in starts) if fit is not None]
        if not fits:
            break
        for fit in fits:
            for exchanged in record.exchange_lags(fit.theta):
                add(structure, exchanged)
            sharp_step = record.sharp_step(structure, fit)
            if sharp_step is not None:
                add(*sharp_step)
        starts = [record.with_further_lag(structure, fit) for fit in fits]
    if not fitted:
        raise InputError(
            f"the reading follows the step within one row of {record.dt_s:.3g} s"
            ": no lag can be determined",
            expected="several rows in a lag",
            remedy="log faster; or the medium's lag, which was specified, explains all of the "
            "response",
        )
    for extension in (_dead_time, _slow_path):
        best_bic = min(f.fit.bic for f in fitted)
        for f in list(fitted):
            structure, start, gain = extension(record, f)
            if gain > MIN_GAIN and 2 * gain > f.fit.bic - best_bic:
                add(structure, start)
    best_bic = min(f.fit.bic for f in fitted)
    # a second lag that is not resolved alone may be, beside a stage
    for f in _best_of_each([*fitted, *unresolved]):
        if f.structure.slow and f.fit.bic > best_bic + STAGE_END:
            continue
        for stage in _possible_stages(record, f):
            structure = replace(f.structure, stage=stage)
            for start in _starts_of_stage(record, f, stage):
                staged = add(structure, start)
                if staged is None or structure.sharp:
                    continue
                sharp_step = record.sharp_step(structure, staged)
                if sharp_step is not None:
                    add(*sharp_step)
    weights = bic_weights(np.array([f.fit.bic for f in fitted]))
    probability = dict[StepStructure, float]()
    for f, weight in zip(fitted, weights):
        simplest = replace(f.structure, lags=1)
        probability[simplest] = probability.get(simplest, 0.0) + float(weight)
    for simplest, weight in probability.items():
        if weight > MIN_WEIGHT and not simplest.sharp and simplest.stage != "fin":
            alike = [f for f in fitted if replace(f.structure, lags=1) == simplest]
            near = min(alike, key=lambda f: f.fit.bic)
            start = record.start(START_SHARES[0]) | near.fit.theta
            best_bic = min(f.fit.bic for f in fitted)
            last_bic = np.inf
            for share in SECOND_SHARES[1::2] if simplest.stage else SECOND_SHARES:
                grid_fit = add(replace(simplest, second_share=share), start)
                if grid_fit is None or grid_fit.bic > max(last_bic, best_bic + GRID_END):
                    break
                last_bic = grid_fit.bic
                start |= grid_fit.theta
    fitted = _without_repeated_sharp(fitted)
    prior = np.array([record.prior_odds(f) for f in fitted])
    return fitted, bic_weights(np.array([f.fit.bic for f in fitted]), prior)


def _best_of_each(fitted: Sequence[FittedStructure]) -> list[FittedStructure]:
    """Return all fits of one lag, and of other structures that of least BIC.

    With one lag, the lag may be the sensor's or the medium's: stages start from both.
    """
    kept = [f for f in fitted if f.structure.lags == 1]
    best = dict[StepStructure, FittedStructure]()
    for f in fitted:
        known = best.get(f.structure)
        if f.structure.lags > 1 and (known is None or f.fit.bic < known.fit.bic):
            best[f.structure] = f
    return [*kept, *best.values()]


def _without_repeated_sharp(fitted: Sequence[FittedStructure]) -> list[FittedStructure]:
    """Return the structures without those that a structure with a sharp step repeats.

    A medium whose lag the data do not distinguish from zero makes a sharp step. Counted twice, and
    once with the term of the BIC, the step would gain over the medium's lag in a quiet record.

    Parameters
    ----------
    fitted
        The structures.

    Returns
    -------
    list of FittedStructure
        All but those with the number of lags of a sharp one that fits them as well.
    """
    kept = []
    for f in fitted:
        if f.structure.sharp or f.fit.is_resolved(["medium_s"]):
            kept.append(f)
            continue
        repeated = [
            other
            for other in fitted
            if other.structure.sharp
            and other.structure.order == f.structure.order
            and other.fit.optimum.cost < f.fit.optimum.cost + MIN_GAIN
        ]
        if not repeated:
            kept.append(f)
    return kept


def _slow_path(
    record: StepRecord, fitted: FittedStructure
) -> tuple[StepStructure, dict[str, float], float]:
    """Return a structure with a slow path, its start values, and the gain that they promise.

    Parameters
    ----------
    record
        Data of the fit.
    fitted
        A structure without such a path.

    Returns
    -------
    structure, start, gain
        The structure, its start values by name, and the score statistic; 0 where the share of the
        path would be negative.
    """
    structure = replace(fitted.structure, slow=True)
    trials = []
    for ratio in SLOW_RATIOS:
        path = {"slow_share": SMALL_SHARE, "slow_s": ratio * record.sensor_lag_s}
        share, gain = _score_of_parameter(record, fitted, structure, path, "slow_share")
        path["slow_share"] = float(np.clip(share, SMALL_SHARE, MAX_SLOW_SHARE[record.junction]))
        trials.append((gain if share > 0 else 0.0, path))
    gain, path = max(trials, key=lambda trial: trial[0])
    return structure, fitted.fit.theta | path, gain


def _possible_stages(record: StepRecord, fitted: FittedStructure) -> list[str]:
    """Return the stages that may replace the first lag of a structure.

    A bath and a stem beside a slow path would be the same curve twice. A stem that conducts has
    lags of its own, and a chain of a junction at the sheath has no place for its zero.
    """
    structure = fitted.structure
    if structure.slow:
        return ["film"]
    if structure.lags > 1 or record.junction == "grounded":
        return ["film", "bath"]
    return ["film", "bath", "fin"]


def _starts_of_stage(
    record: StepRecord, fitted: FittedStructure, stage: str
) -> list[dict[str, float]]:
    """Return start values for a structure whose first lag a stage replaces.

    Parameters
    ----------
    record
        Data of the fit.
    fitted
        The structure without the stage.
    stage
        Name of the stage.
    """
    starts = []
    for values in STAGES[stage].starts():
        if "settling_s" in values:
            values["settling_s"] = min(values["settling_s"], SETTLING_SHARE * record.sensor_lag_s)
        # level and drift of a fit without the stage are those of its misfit
        edge = record.start([])
        linear = {name: edge[name] for name in ("level", "size", "drift_K")}
        starts.append(fitted.fit.theta | linear | values)
    return starts


def _dead_time(
    record: StepRecord, fitted: FittedStructure
) -> tuple[StepStructure, dict[str, float], float]:
    """Return a structure with a dead time, its start values, and the gain that they promise.

    Parameters
    ----------
    record
        Data of the fit.
    fitted
        A structure without a dead time.

    Returns
    -------
    structure, start, gain
        As ``_slow_path`` returns them; the gain is 0 where the entry is unknown.
    """
    structure = replace(fitted.structure, dead=True)
    if record.entry_prior_s is None:
        return structure, {}, 0.0
    step_s = SMALL_SHARE * record.sensor_lag_s
    dead_s, gain = later_response(record, fitted)
    specified_s = record.entry_prior_s[0]
    start = fitted.fit.theta | {"entry_s": specified_s, "dead_s": max(dead_s, step_s)}
    is_possible = 0 < dead_s < record.t[-1] - specified_s
    return structure, start, gain if is_possible else 0.0


def later_response(record: StepRecord, fitted: FittedStructure) -> tuple[float, float]:
    """Return how much later than modelled the response begins, by a linear step, and its gain.

    Parameters
    ----------
    record
        Data of the fit, with a specified entry.
    fitted
        A structure without a dead time.

    Returns
    -------
    shift_s, gain
        As ``_score_of_parameter`` returns them; the shift is negative if the response begins
        earlier [s].
    """
    structure = replace(fitted.structure, dead=True)
    step_s = SMALL_SHARE * record.sensor_lag_s
    return _score_of_parameter(record, fitted, structure, {"dead_s": step_s}, "dead_s")


def _score_of_parameter(
    record: StepRecord,
    fitted: FittedStructure,
    structure: StepStructure,
    values: Mapping[str, float],
    name: str,
) -> tuple[float, float]:
    """Return the estimate of one further parameter by a linear step, and its gain.

    Parameters
    ----------
    record
        Data of the fit.
    fitted
        The structure without the parameter.
    structure
        The structure with it.
    values
        Small values of the further parameters by name.
    name
        Name of the one parameter whose effect is proportional to it.

    Returns
    -------
    value, gain
        As :meth:`tcdyn.sensors.step_fits.CurveFit.score` returns them.
    """
    without = record.curve(fitted.structure, fitted.fit.theta)
    curve = record.curve(structure, fitted.fit.theta | dict(values))
    if without is None or curve is None:
        return 0.0, 0.0
    direction = (curve - without)[np.isfinite(record.y)] / values[name]
    return fitted.fit.score(direction)


def _fit_structure(
    record: StepRecord,
    structure: StepStructure,
    start: Mapping[str, float],
    noise: tuple[NoiseModel, float],
) -> CurveFit:
    """Fit one structure.

    Parameters
    ----------
    record
        Data of the fit.
    structure
        The structure.
    start
        Start values by name; more than the structure has are allowed.
    noise
        Autoregression and level [K] of the residuals.

    Returns
    -------
    CurveFit
        The fit; theta in the order of ``structure.names``.
    """
    names = structure.names
    stage = STAGES[structure.stage].parameters if structure.stage else ()
    size_K = abs(record.step.size_K)
    lag_s = record.sensor_lag_s
    medium_s, medium_u_s = record.medium_s

    def model(theta: Array) -> Array | None:
        """Return the readings (N,) at theta; None where they cannot be computed."""
        return record.curve(structure, dict(zip(names, theta.tolist())))

    def linear(theta: Array, curve: Array) -> dict[str, Array]:
        """Return the derivatives (N,) by the parameters in which the curve is linear."""
        values = dict(zip(names, theta.tolist()))
        drift = record.drift
        response = (curve - values["level"] - values["drift_K"] * drift) / values["size"]
        return {"level": np.ones_like(curve), "size": response, "drift_K": drift}

    seconds = dict.fromkeys((n for n in names if n.endswith("_s")), lag_s)
    scales = {
        "level": size_K,
        "size": size_K,
        "drift_K": size_K,
        "tail": 1.0,
        "slow_share": 1.0,
        **{parameter.name: parameter.sd for parameter in stage},
        **seconds,
        "medium_s": max(lag_s, medium_u_s),
    }
    prior = {
        "medium_s": (medium_s, max(medium_u_s, exact_u_s(record.dt_s))),
        "drift_K": (0.0, DRIFT_SHARE * size_K),
        "tail": TAIL[record.junction][structure.lags - 1],
    }
    prior |= {parameter.name: (parameter.mean, parameter.sd) for parameter in stage}
    if record.entry_prior_s is not None:
        prior["entry_s"] = record.entry_prior_s
    lower = {**dict.fromkeys(seconds, 0.0), "tail": MIN_TAIL[record.junction], "slow_share": 0.0}
    lower |= {parameter.name: parameter.low for parameter in stage}
    if stage:
        lower["tau1_s"] = LEAST_FIRST * record.dt_s
    if structure.slow:
        lower["slow_s"] = MIN_SLOW_RATIO[record.junction] * lag_s
    return fit_curve(
        f"P{structure.lags}",
        model,
        record.y,
        names,
        np.array([start[n] for n in names]),
        np.array([scales[n] for n in names]),
        prior=prior,
        lower=lower,
        upper={
            "slow_share": MAX_SLOW_SHARE[record.junction],
            **{parameter.name: parameter.high for parameter in stage},
        },
        noise=noise,
        linear=linear,
        bends=True,
        steps=MAX_STEPS,
        tolerance=TOLERANCE,
    )
