"""Model-form alternatives: joint fit under other assumptions, evidence, impossible results.

With columns X of the whitened data by a standard deviation of an alternative and the fit's own
Jacobian J and posterior covariance C, what J leaves of X, K = X'X - X'J C J'X, gives the
alternative's size, its evidence (Bayes factor against the assumed model) and the refitted
parameters in one step, so that no log is filtered again. The speed law is independent evidence: an
alternative is preferred only if the exponent that it implies agrees with it.

The module also decides which estimates are physically impossible and are not reported. Used by
:mod:`tcdyn.partition.analyse` and :mod:`tcdyn.partition.crosscheck`. Thresholds are chosen by
judgement. Guarded by ``tests/partition/test_structures.py`` and
``tests/partition/test_crosscheck.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from tcdyn.core import Array
from tcdyn.core.estimate import Estimate, mixture_interval95
from tcdyn.core.findings import Finding, info, warning
from tcdyn.estimation import minimise
from tcdyn.partition.departures import LAG_SD_S, LinearisedFit, Refit, model_form_columns
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import (
    COARSE_TOLERANCE,
    LOG_H,
    SHARE,
    CombinedFit,
    DiskFit,
    joint_problem,
)
from tcdyn.partition.nuisance import MAX_LOG_H
from tcdyn.partition.nuisance_parameter import NuisanceParameter
from tcdyn.rig.disk import DISKS

# Keys of the heat transfer coefficients that an estimator gives beside beta.
H_KEYS = {
    "speed law": ("h_fast", "h_slow"),
    **{f"{kind} {d}": (f"h {kind} {d}",) for kind in ("cooling", "joint") for d in DISKS},
}
# The estimators of beta. The speed law must be first: ``cross_check`` takes the first as the steady
# one.
ESTIMATORS = tuple(H_KEYS)
# A warning reports a frictional power that differs from the heat that both disks show by more than
# this fraction and this many standard uncertainties. Chosen by judgement.
POWER_SCALE_TOLERANCE = 0.1
POWER_SCALE_Z = 5.0
# Beyond this ratio of heat to power, or its inverse, shares of the power mean nothing. Chosen
# by judgement.
MAX_POWER_SCALE = 2.0
# True power over logged power when a number has another unit, and the unit.
UNIT_FACTORS = {
    "friction in pounds-force": 4.448,
    "friction in kilograms-force": 9.807,
    "speeds in rad/s": 9.549,
    "speeds in revolutions per second": 60.0,
    "friction in kilonewtons": 1000.0,
}
# In ln(scale), within which a unit is named. Chosen by judgement.
UNIT_TOLERANCE = 0.08
# The best alternatives are fitted again, since a large departure is not linear: this many, with
# log-odds above this, in this many iterations. Chosen by judgement.
MAX_REFITS = 3
REFIT_LOG_ODDS = 3.0
N_REFIT_ITERATIONS = 3
# Prior probability of the assumed model; the alternatives share the rest. Chosen by
# judgement.
ASSUMED_PROBABILITY = 0.5
# An alternative is preferred if its log-odds are above this and its exponent agrees with the speed
# law within this many standard uncertainties. Chosen by judgement.
NAMED_LOG_ODDS = 8.0
SPEED_LAW_Z = 3.0
# An alternative is undecided if the test does not exclude it (log-odds) and beta would be less
# certain with it than assumed by this factor. Chosen by judgement.
EXCLUDED_LOG_ODDS = -3.0
UNDECIDED_U_RATIO = 1.5
# The estimate holds if the best alternative changes beta by at most this many standard
# uncertainties, and half the range of beta over all alternatives is at most this. Chosen by
# judgement.
MAX_SHIFT_U = 2.0
MAX_HALF_RANGE = 0.02


@dataclass(frozen=True)
class ModelForm:
    """The fit of both disks under one set of assumptions.

    Parameters
    ----------
    name
        Name of the alternative, or "as assumed".
    beta, exponent
        Its estimates.
    size
        Estimates of its parameters in prior standard deviations; empty for the assumed model.
    log_odds
        Logarithm of its Bayes factor against the assumed model.
    delta_chi2
        Decrease of chi-squared.
    speed_law_z
        Distance of the exponent that it implies from the speed law's, in standard deviations, with
        sign.
    """

    name: str
    beta: Estimate
    exponent: Estimate
    size: tuple[Estimate, ...]
    log_odds: float
    delta_chi2: float
    speed_law_z: float


@dataclass(frozen=True)
class ModelForms:
    """All model-form alternatives, the most probable first, the assumed model among them.

    Parameters
    ----------
    forms
        The alternatives.
    probability
        Posterior probability of each.
    low95, high95
        95 % range of beta over all of them, weighted by their probabilities.
    assumed
        The assumed model.
    """

    forms: tuple[ModelForm, ...]
    probability: tuple[float, ...]
    low95: float
    high95: float
    assumed: ModelForm

    @property
    def preferred(self) -> ModelForm | None:
        """The alternative that is far likelier and agrees with the speed law, else None."""
        best = max(self.forms, key=lambda form: form.log_odds)
        if best.log_odds > NAMED_LOG_ODDS and abs(best.speed_law_z) < SPEED_LAW_Z:
            return best
        return None

    @property
    def estimate_holds(self) -> bool:
        """Whether the recommended estimate holds under every alternative that the data allow.

        Notes
        -----
        The most probable form must be near the assumed one (``MAX_SHIFT_U``), and the range of beta
        over all forms narrow (``MAX_HALF_RANGE``). ``tests/partition/test_crosscheck.py`` tests
        both.
        """
        beta = self.assumed.beta
        best = self.forms[0].beta
        near = abs(best.value - beta.value) <= MAX_SHIFT_U * max(beta.u, best.u)
        return near and 0.5 * (self.high95 - self.low95) <= MAX_HALF_RANGE

    @property
    def undecided(self) -> tuple[ModelForm, ...]:
        """Alternatives that the test does not exclude and that would make beta less certain.

        Notes
        -----
        With such an alternative the data allow a wider range of beta, and the test itself cannot
        show whether it applies: a change of h of one disk at the unloading, for example, looks like
        another conductivity.
        """
        return tuple(
            form
            for form in self.forms
            if form.size
            and form.log_odds > EXCLUDED_LOG_ODDS
            and form.beta.u > UNDECIDED_U_RATIO * self.assumed.beta.u
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The preferred alternative, a warning unless the estimate holds, and those undecided."""
        findings = []
        best = self.preferred
        if best is not None:
            severity = info if self.estimate_holds else warning
            findings.append(
                severity(
                    "structures.other",
                    name=best.name,
                    log_odds=best.log_odds,
                    beta=best.beta.value,
                    u=best.beta.u,
                )
            )
        for form in self.undecided:
            if form is not best:
                beta = form.beta
                findings.append(
                    info("structures.undecided", name=form.name, beta=beta.value, u=beta.u)
                )
        return tuple(findings)

    def to_list(self) -> list[dict[str, Any]]:
        """The entry of ``beta.json``."""
        return [
            {
                "name": form.name,
                "beta": form.beta.model_dump(),
                "delta_chi2": form.delta_chi2,
                "log_odds": form.log_odds,
                "probability": probability,
                "exponent": form.exponent.model_dump(),
            }
            for form, probability in zip(self.forms, self.probability)
        ]


def compare_model_forms(
    test: EhlTest, joint: Mapping[str, DiskFit], both: CombinedFit
) -> ModelForms:
    """The fit of both disks under every model-form alternative, and the range of beta over all.

    Parameters
    ----------
    test, joint, both
        The test that was fitted, the joint fit of each disk, and of both.

    Returns
    -------
    ModelForms
        The most probable first.

    Notes
    -----
    Slow waves of the residuals count as in the fits' own uncertainties: evidence is weighted with
    the waves that remain when all alternatives are free at once, the uncertainty of an estimate
    with those that its own alternative leaves. The best alternatives are fitted again with the
    model itself, since a large departure is not linear.

    ``test`` must be that of the joint fits (``MainFits.fitted_test`` of
    :mod:`tcdyn.partition.fit_rounds`), not the one without harmonics. ``MAX_REFITS`` and
    ``N_REFIT_ITERATIONS`` may grow; they cost time.
    """
    ends = np.cumsum([len(joint[d].block.y) for d in DISKS])
    points = tuple(joint[d].block.window.y.shape[1] for d in DISKS)
    columns = model_form_columns(test, joint, both.theta)
    no_column = np.zeros((ends[-1], 0))
    solve = LinearisedFit.at(both.optimum, ends, points)
    all_columns = np.hstack([*columns.values()])
    waves = solve(all_columns, solve.inflation_of(both.optimum.residual)).inflation
    assumed_covariance = solve(no_column, both.inflation).covariance(both.inflation)
    law_u = test.exponent_half_range / np.sqrt(3)
    refits = {"as assumed": solve(no_column, waves)}
    refits |= {name: solve(column, waves) for name, column in columns.items()}
    assumed_step = refits["as assumed"].step
    best = sorted(refits, key=lambda name: -refits[name].log_odds)[:MAX_REFITS]
    beta_direction, exponent_direction = _beta_and_exponent_gradients(test, len(both.optimum.theta))

    def estimate(key: str, direction: Array, step: Array, covariance: Array) -> Estimate:
        """Estimate of a number under an alternative.

        Parameters
        ----------
        key
            Key of the number in ``both.estimates``.
        direction
            Its derivative by the parameters.
        step, covariance
            Change and covariance of the parameters under the alternative.

        Notes
        -----
        Shift and uncertainty are relative to those of the assumed model by the same linear step, so
        that the assumed model keeps its own estimate.
        """
        nominal = both.estimates[key]
        shift = float(direction @ (step - assumed_step))
        ratio = (direction @ covariance @ direction) / (direction @ assumed_covariance @ direction)
        return Estimate.normal(nominal.value + shift, nominal.u * float(np.sqrt(ratio)))

    forms = []
    for name, first in refits.items():
        refit = first
        if name in best and first.log_odds > REFIT_LOG_ODDS:
            refit = _nonlinear_refit(test, joint, both, name, first, solve, waves)
        covariance = assumed_covariance
        if refit.sizes:
            covariance = refit.covariance(max(refit.inflation, waves))
        beta = estimate("beta", beta_direction, refit.step, covariance)
        n = estimate("exponent", exponent_direction, refit.step, covariance)
        z = (n.value - test.speed_exponent) / float(np.hypot(n.u, law_u))
        forms.append(ModelForm(name, beta, n, refit.sizes, refit.log_odds, refit.delta_chi2, z))
    probability = _probabilities(forms, law_u)
    low, high = mixture_interval95([form.beta for form in forms], [float(p) for p in probability])
    order = np.argsort(-probability)
    return ModelForms(
        forms=tuple(forms[k] for k in order),
        probability=tuple(float(probability[k]) for k in order),
        low95=low,
        high95=high,
        assumed=forms[0],
    )


def _beta_and_exponent_gradients(test: EhlTest, n_parameters: int) -> tuple[Array, Array]:
    """Derivatives of beta and of the exponent by the parameters of the fit of both disks.

    Parameters
    ----------
    test
        The test, for its speed ratio.
    n_parameters
        Number of parameters P.

    Returns
    -------
    beta, exponent
        (P,) each. The exponent is (log h_fast - log h_slow)/ln(u_f/u_s).
    """
    log_ratio = float(np.log(test.speed_ratio))
    beta = np.zeros(n_parameters)
    beta[SHARE] = 1.0
    exponent = np.zeros(n_parameters)
    exponent[[LOG_H, 4 + LOG_H]] = [1 / log_ratio, -1 / log_ratio]
    return beta, exponent


def _probabilities(forms: list[ModelForm], law_u: float) -> Array:
    """Posterior probability of each form, the assumed model first.

    That is the prior times the Bayes factor times the density of the exponent by the speed law.

    Parameters
    ----------
    forms
        The forms, the assumed model first.
    law_u
        Standard uncertainty of the speed law's exponent.

    Notes
    -----
    ``ASSUMED_PROBABILITY`` may change. ``tests/partition/test_structures.py`` computes the same
    probabilities with 0.5.
    """
    n_others = len(forms) - 1
    prior = [np.log(ASSUMED_PROBABILITY)]
    prior += [np.log((1 - ASSUMED_PROBABILITY) / n_others)] * n_others
    speed_law = [
        -0.5 * form.speed_law_z**2 - np.log(np.hypot(form.exponent.u, law_u)) for form in forms
    ]
    return np.asarray(
        special.softmax([form.log_odds + p + s for form, p, s in zip(forms, prior, speed_law)])
    )


def _nonlinear_refit(
    test: EhlTest,
    joint: Mapping[str, DiskFit],
    both: CombinedFit,
    name: str,
    first: Refit,
    linear: LinearisedFit,
    waves: float,
) -> Refit:
    """The fit of both disks with one alternative by the model itself.

    The columns of the alternative are computed anew at each iteration.

    Parameters
    ----------
    test, joint, both
        As of :func:`compare_model_forms`.
    name
        Name of the alternative.
    first
        Its fit by one linear step, where the iteration starts.
    linear
        The linearised fit without alternatives.
    waves
        Factor on the variance of the white noise for the evidence.

    Notes
    -----
    An alternative whose fit leaves the range of the model (``MAX_LOG_H``) explains nothing: it
    keeps the parameters of the assumed model. ``tests/partition/test_structures.py`` guards it.
    """
    ends = linear.ends
    best = both.optimum
    blocks = [joint[d].block for d in DISKS]
    theta = both.theta + first.step[:8]
    refit = first
    for _ in range(N_REFIT_ITERATIONS):
        if not np.all(theta[LOG_H::4] < MAX_LOG_H):
            unchanged = np.zeros_like(first.step)
            return replace(first, step=unchanged, log_odds=-first.volume, delta_chi2=0.0)
        late_s = LAG_SD_S * refit.sizes[0].value if name.startswith("lag of ") else 0.0
        columns = model_form_columns(test, joint, theta, name, late_s)[name]
        extra = tuple(NuisanceParameter(f"{name} {k}", name, True) for k in range(columns.shape[1]))
        extended = [
            replace(
                block,
                parameters=(*block.parameters, *extra),
                effects=np.hstack([block.effects, column]),
            )
            for block, column in zip(blocks, np.split(columns, ends[:-1]))
        ]
        problem = joint_problem(extended)
        start = np.zeros(len(problem.names))
        start[:8] = theta
        optimum = minimise(problem, start, tolerance=COARSE_TOLERANCE)
        theta = optimum.theta[:8]
        extra_index = [problem.names.index(parameter.name) for parameter in extra]
        order = np.array([problem.names.index(x) for x in best.problem.names])
        solve = LinearisedFit.at(optimum, ends, linear.points, order)
        linear_refit = solve(optimum.jacobian[: ends[-1], extra_index], waves)
        sizes = tuple(
            Estimate.normal(float(optimum.theta[k]), size.u)
            for k, size in zip(extra_index, linear_refit.sizes)
        )
        refit = replace(
            linear_refit,
            step=optimum.theta[order] - best.theta,
            sizes=sizes,
            inflation=solve.inflation_of(optimum.residual),
        )
    decrease = (best.cost - optimum.cost) / waves
    return replace(refit, log_odds=0.5 * decrease - refit.volume, delta_chi2=decrease)


def is_impossible(beta: Estimate, *h: Estimate) -> bool:
    """Whether no disk can have these: beta outside 0 to 1, or an h that is not above zero.

    Parameters
    ----------
    beta
        Share of the fast disk.
    h
        Heat transfer coefficients [W/m2K].
    """
    return not 0 <= beta.value <= 1 or any(each.value <= 0 for each in h)


def is_undetermined(estimate: Estimate) -> bool:
    """Whether a test says nothing about beta, or about the exponent n of h ~ u^n.

    That is so if the 95 % interval contains both ends of what is possible anyway. For beta these
    are 0 and 1: all heat in one disk or in the other. For the exponent they are 0, an h that does
    not depend on the speed, and 1, an h that is proportional to it; correlations of rotating disks
    have 0.5 (laminar) to 0.8 (turbulent).

    Parameters
    ----------
    estimate
        Estimate of beta or of the exponent.

    Examples
    --------
    >>> is_undetermined(Estimate.normal(0.76, 0.60)), is_undetermined(Estimate.normal(0.7, 0.2))
    (True, False)
    """
    return estimate.contains(0.0) and estimate.contains(1.0)


def impossible_keys(
    estimates: Mapping[str, Estimate], combined: Mapping[str, Estimate]
) -> frozenset[str]:
    """Keys of physically impossible estimates; with an estimate goes the estimator that gives it.

    These are beta outside 0 to 1, h not above zero, beta or an exponent that the data do not
    determine (:func:`is_undetermined`), and shares of a frictional power that is wrong by far.

    Parameters
    ----------
    estimates
        All estimates of a test; with one disk only those of this disk.
    combined
        Estimates of the combined fit; may be empty.

    Notes
    -----
    Estimates of the combined fit have the prefix "both". ``MAX_POWER_SCALE`` and ``POWER_SCALE_Z``
    may change; ``tests/partition/test_crosscheck.py`` tests what is withheld.

    Examples
    --------
    >>> some = {key: Estimate.normal(0.7, 0.01) for key in ESTIMATORS}
    >>> some |= {h: Estimate.normal(700.0, 9.0) for hs in H_KEYS.values() for h in hs}
    >>> sorted(impossible_keys(some | {"joint slow": Estimate.normal(1.4, 0.1)}, {}))
    ['h joint slow', 'joint slow']
    """
    keys: set[str] = set()
    for estimator, h_keys in H_KEYS.items():
        if estimator not in estimates:
            continue
        beta = estimates[estimator]
        if is_impossible(beta, *(estimates[h] for h in h_keys)) or is_undetermined(beta):
            keys |= {estimator, *h_keys}
    if not combined:
        return frozenset(keys)
    h = [estimate for key, estimate in combined.items() if key.startswith("h_")]
    beta = combined["beta"]
    if is_impossible(beta, *h) or is_undetermined(beta) or _is_power_wrong(estimates):
        keys |= {f"both {name}" for name in combined}
    if "exponent" in combined and is_undetermined(combined["exponent"]):
        keys.add("both exponent")
    return frozenset(keys)


def best_determined(
    estimates: Mapping[str, Estimate], combined: Mapping[str, Estimate]
) -> str | None:
    """The estimator with the least uncertainty of beta of those that are reported.

    Parameters
    ----------
    estimates, combined
        As of :func:`impossible_keys`.

    Returns
    -------
    str or None
        One of ``ESTIMATORS``; None if none is reported, and if the frictional power is wrong by
        far, whose shares mean nothing by any estimator.
    """
    if _is_power_wrong(estimates):
        return None
    withheld = impossible_keys(estimates, combined)
    reported = [name for name in ESTIMATORS if name in estimates and name not in withheld]
    return min(reported, key=lambda name: estimates[name].u, default=None)


def _is_power_wrong(estimates: Mapping[str, Estimate]) -> bool:
    """Whether the heat of both disks is far from the logged power; False with one disk."""
    fast = estimates.get("joint fast")
    slow = estimates.get("joint slow")
    if fast is None or slow is None:
        return False
    scale = power_scale(fast.value, slow.value)
    u = float(np.hypot(fast.u, slow.u))
    out_of_range = not 1 / MAX_POWER_SCALE < scale < MAX_POWER_SCALE
    return out_of_range and abs(scale - 1) > POWER_SCALE_Z * u


def power_scale(fast: float, slow: float) -> float:
    """Heat of both disks over the logged frictional power.

    Parameters
    ----------
    fast, slow
        beta by the joint fit of each disk. The slow disk's share is 1 - beta.
    """
    return 1 + fast - slow


def impossibility_findings(
    estimates: Mapping[str, Estimate],
    combined: Mapping[str, Estimate],
    samples: Mapping[str, Array],
) -> list[Finding]:
    """Warnings of impossible estimates, and of a power that is not the heat of both disks.

    The shares that the joint fits of the two disks give by themselves add to true power over logged
    power; likely units are named.

    Parameters
    ----------
    estimates, combined
        As of :func:`impossible_keys`.
    samples
        Monte Carlo samples of "joint fast" and "joint slow", which hold their correlation.
    """
    findings = list[Finding]()
    keys = impossible_keys(estimates, combined)
    if "joint fast" in estimates and "joint slow" in estimates:
        scale = power_scale(estimates["joint fast"].value, estimates["joint slow"].value)
        u = float(np.std(samples["joint fast"] - samples["joint slow"]))
        if abs(scale - 1) > max(POWER_SCALE_TOLERANCE, POWER_SCALE_Z * u):
            findings.append(warning("power.scale", scale=scale, u=u, units=_likely_units(scale, u)))
    betas = {estimator: estimates[estimator] for estimator in ESTIMATORS if estimator in keys}
    if "both beta" in keys and "exponent" in combined:
        betas["joint, both disks"] = combined["beta"]
    undetermined = [estimator for estimator, beta in betas.items() if is_undetermined(beta)]
    impossible = [estimator for estimator in betas if estimator not in undetermined]
    if impossible:
        findings.append(warning("answers.impossible", ways=impossible))
    if undetermined:
        findings.append(
            warning(
                "answers.undetermined",
                ways=undetermined,
                low95=[betas[estimator].low95 for estimator in undetermined],
                high95=[betas[estimator].high95 for estimator in undetermined],
            )
        )
    return findings


def _likely_units(scale: float, u: float) -> list[str]:
    """The two units whose factors are nearest to ``scale``, within the tolerance.

    Parameters
    ----------
    scale
        True power over logged power.
    u
        Its standard uncertainty.
    """
    if scale <= 0:
        return []
    distance = {name: abs(np.log(abs(scale) / factor)) for name, factor in UNIT_FACTORS.items()}
    tolerance = max(UNIT_TOLERANCE, 2 * u / abs(scale))
    return [
        name for name in sorted(distance, key=distance.__getitem__) if distance[name] < tolerance
    ][:2]
