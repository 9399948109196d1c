"""Comparison of chain structures on the same plunges by evidence; covariance from the choice.

Called by :func:`immersion.plunge_fit.with_structure_uncertainty`. Each structure of
``tcdyn.chain.STRUCTURES`` is fitted to the same block means. The evidence is Laplace's
approximation, integrated over the common lag. The spread of the lags over the structures is added
to their covariance. The thresholds are chosen by judgement where no other reason is given. Tests:
``tests/immersion/test_plunge_structures.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from immersion.plunge_data import RunNoise
from immersion.plunge_parameters import BURST_KINDS, PlungePriors, common_and_differential_u_s
from immersion.plunge_posterior import LagScan, PlungeOptimum, scan_common_lag
from tcdyn.chain import STRUCTURES, ChainStructure
from tcdyn.core import Array
from tcdyn.core.estimate import Estimate, text_with_u
from tcdyn.core.findings import Finding, Severity, info, warning
from tcdyn.core.messages.plunge import probability_text
from tcdyn.core.result import jsonable

# Excess of chi-square from which the chosen structure can be contradicted: a second lag that does
# not exist gains less, with its split free in six channels.
CONTRADICTED_CHI_SQUARE = 12.0
# Probability below which a structure can be contradicted, and above which it is possible; chosen by
# judgement.
POSSIBLE_PROBABILITY = 0.05
# A mean lag [s] from which a second fit starts, at the short lag; chosen by judgement.
LONG_LAG_S = 0.8
# The mean lag [s] at which that second fit starts; chosen by judgement.
SHORT_LAG_S = 0.5
# Log evidence below the largest from which Laplace's approximation is accurate enough, without a
# scan of the lag; chosen by judgement.
UNLIKELY_LOG_EVIDENCE = 5.0
MAX_EXCESS_COST = (
    30.0  # cost above the first solution beyond which a second one is dropped; by judgement
)
# Heading of a column of ``table``, which is dropped where there is one plunge only.
HELD_OUT_COLUMN = "held-out plunge, above the best"


@dataclass(frozen=True)
class StructureRow:
    """One chain structure: the common lag it gives, and how well it fits the plunges.

    Attributes
    ----------
    structure
        Name of the structure.
    common_lag_s
        Common lag.
    chi_square
        With the contribution of the priors, above the best structure.
    probability
        Posterior probability.
    held_out
        -2 log of the probability that the other plunges give to each plunge, above the best
        structure; None for one plunge only.
    second_lag_s
        Common lag of a second solution with the same structure, where it is possible too.
    """

    structure: str
    common_lag_s: Estimate
    chi_square: float
    probability: float
    held_out: float | None
    second_lag_s: Estimate | None = None


@dataclass(frozen=True)
class StructureComparison:
    """All chain structures on the same plunges and noise; the lags of ``chosen`` are reported.

    Attributes
    ----------
    chosen
        Name of the chosen structure.
    rows
        One row a structure.
    covariance
        Mean square error of the lags if another structure is true (C, C) [s2].
    u_before_s
        Standard uncertainty of the common lag without the choice of structure [s].

    Notes
    -----
    Probabilities follow from the evidence (Laplace, integrated over the common lag) with equal
    prior probabilities. One lag (P1), a special case of the others, counts by its likelihood and
    has no advantage for its simplicity.
    """

    chosen: str
    rows: tuple[StructureRow, ...]
    covariance: Array
    u_before_s: float

    @property
    def chosen_row(self) -> StructureRow:
        """The row of the chosen structure."""
        return next(r for r in self.rows if r.structure == self.chosen)

    @property
    def best(self) -> StructureRow:
        """The row of the most probable structure."""
        return max(self.rows, key=lambda r: r.probability)

    @property
    def u_structure_s(self) -> float:
        """Standard uncertainty of the common lag from the choice of structure [s]."""
        return common_and_differential_u_s(self.covariance)[0]

    @property
    def u_after_s(self) -> float:
        """Standard uncertainty of the common lag, with the choice of structure [s]."""
        return float(np.hypot(self.u_before_s, self.u_structure_s))

    @property
    def is_contradicted(self) -> bool:
        """Whether the chosen structure is improbable and fits clearly worse than the best.

        Notes
        -----
        The thresholds ``POSSIBLE_PROBABILITY`` and ``CONTRADICTED_CHI_SQUARE`` decide the message
        and its severity only. They change neither a lag nor its uncertainty.
        """
        excess = self.chosen_row.chi_square - self.best.chi_square
        improbable = self.chosen_row.probability < POSSIBLE_PROBABILITY
        return improbable and excess > CONTRADICTED_CHI_SQUARE

    @property
    def conclusion(self) -> Finding:
        """Conclusion about the structures: the chosen one, then the best or all possible ones."""
        if self.is_contradicted:
            others = [self.best]
        else:
            possible = [
                r
                for r in self.rows
                if r.structure != self.chosen and r.probability >= POSSIBLE_PROBABILITY
            ]
            others = sorted(possible, key=lambda r: -r.probability)
        listed = [self.chosen_row, *others]
        second = self.chosen_row.second_lag_s
        numbers: dict[str, Any] = {
            "structures": [r.structure for r in listed],
            "meanings": [ChainStructure.from_name(r.structure).description for r in listed],
            "probability": [r.probability for r in listed],
            "chi_square": [r.chi_square for r in listed],
            "lag_s": [r.common_lag_s.value for r in listed],
            "u_s": [r.common_lag_s.u for r in listed],
            "second_s": None if second is None else (second.value, second.u),
            "candidates": len(self.rows),
            "contradicted": self.is_contradicted,
            "u_before_s": self.u_before_s,
            "u_after_s": self.u_after_s,
        }
        if self.is_contradicted or self.u_structure_s > self.u_before_s:
            return warning("plunge.structure", **numbers)
        return info("plunge.structure", **numbers)

    @property
    def sentence(self) -> str:
        """The conclusion about the structures in one sentence with numbers."""
        return self.conclusion.sentence

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The conclusion, if it is a warning; otherwise empty.

        It is a warning if the chosen structure is contradicted, or if the choice of structure more
        than doubles the variance of the common lag.
        """
        conclusion = self.conclusion
        return (conclusion,) if conclusion.severity is Severity.WARNING else ()

    def table(self) -> pd.DataFrame:
        """One row a structure, formatted for reports."""
        table = pd.DataFrame([self._table_row(row) for row in self.rows])
        if all(row.held_out is None for row in self.rows):
            return table.drop(columns=HELD_OUT_COLUMN)
        return table

    def _table_row(self, row: StructureRow) -> dict[str, str]:
        """One row of :meth:`table`: numbers as text, by the heading of their column."""
        suffix = ", used here" if row.structure == self.chosen else ""
        return {
            "chain": f"{row.structure} "
            f"({ChainStructure.from_name(row.structure).description}){suffix}",
            "probability": probability_text(row.probability),
            "chi-square above the best": f"{row.chi_square:.1f}",
            HELD_OUT_COLUMN: "" if row.held_out is None else f"{row.held_out:.1f}",
            "common lag [s]": text_with_u(row.common_lag_s.value, row.common_lag_s.u),
        }

    def to_dict(self) -> dict[str, object]:
        """Content of ``fit.structures`` in the record."""
        return {
            "chosen": self.chosen,
            "sentence": self.sentence,
            "contradicted": self.is_contradicted,
            "u_common_lag_before_s": self.u_before_s,
            "u_common_lag_after_s": self.u_after_s,
            "candidates": jsonable(self.rows),
        }


@dataclass(frozen=True)
class _Solution:
    """One solution for one structure; the fit reports the lags of the ``reported`` one.

    Attributes
    ----------
    structure
        Name of the structure.
    optimum
        The solution.
    lag_s
        Common lag, with the conditioning filter [s].
    cost
        Least chi-square, with the contribution of the priors.
    log_evidence
        Log evidence, up to a constant common to all structures.
    reported
        Whether the fit reports the lags of this solution.
    """

    structure: str
    optimum: PlungeOptimum
    lag_s: Estimate
    cost: float
    log_evidence: float
    reported: bool = False


def compare_structures(
    final: PlungeOptimum,
    scan: LagScan,
    priors: PlungePriors,
    filter_lag_s: float,
    extra_u_s: float = 0.0,
    structures: Sequence[str] = STRUCTURES,
) -> StructureComparison:
    """Fit each structure to the plunges of ``final``, with the noise of the best residuals.

    Parameters
    ----------
    final
        Optimum of the chosen structure.
    scan
        Its profile scan.
    priors
        Priors of the nuisance parameters.
    filter_lag_s
        Lag of the conditioning filter [s].
    extra_u_s
        Further standard uncertainty of the common lag (choice of correlation) [s].
    structures
        Structures to compare.

    Returns
    -------
    comparison
        One row a structure, the probability of each, and the covariance of the lags that the choice
        of structure adds.

    Notes
    -----
    The order of the steps matters: all structures are fitted with the noise of the chosen one. If
    another solution is better, all are fitted again with the noise of its residuals, so that their
    evidences are comparable. A structure whose log evidence is lower by more than
    ``UNLIKELY_LOG_EVIDENCE`` is not scanned.

    The step (1.8 standard deviations) and the drop (7) of the scans are chosen by judgement; they
    are coarser than the defaults of :func:`immersion.plunge_posterior.scan_common_lag`. A change of
    these, of the structures or of the thresholds changes ``StructureComparison.covariance``, and
    with it the u of every lag: ``tests/immersion/test_plunge_structures.py``.
    """
    chosen = final.problem.layout.structure
    optima = {s: _structure_optima(final, s, priors) for s in structures}
    best = max(optima, key=lambda s: optima[s][0].laplace)
    scan_is_valid = best == chosen and optima[best][0].is_near(final)
    if not scan_is_valid:
        noise = optima[best][0].residual_noise()
        optima = {s: [_refit_structure(o, s, priors, noise) for o in optima[s]] for s in structures}
    largest = max(o.laplace for s in structures for o in optima[s])
    reported_lag_s = scan.estimate(filter_lag_s, extra_u_s)
    solutions: list[_Solution] = []
    for structure in structures:
        for k, optimum in enumerate(optima[structure]):
            is_final = scan_is_valid and structure == chosen and k == 0
            if is_final:
                solution = _Solution(
                    structure,
                    final,
                    reported_lag_s,
                    min(float(scan.cost.min()), final.cost),
                    log_evidence(scan, final),
                    reported=True,
                )
            elif structure != chosen and optimum.laplace < largest - UNLIKELY_LOG_EVIDENCE:
                weights = optimum.problem.layout.common_lag
                lag_s = optimum.solution.value(weights) + filter_lag_s
                approximate = Estimate.normal(lag_s, optimum.solution.u(weights))
                solution = _Solution(structure, optimum, approximate, optimum.cost, optimum.laplace)
            else:
                path, at, start = scan_common_lag(optimum, step=1.8, drop=7.0)
                same = [s for s in solutions if s.structure == structure and s.optimum.is_near(at)]
                if same:
                    continue
                reported = structure == chosen and at.is_near(final)
                solution = _Solution(
                    structure,
                    at,
                    reported_lag_s if reported else path.estimate(filter_lag_s, extra_u_s),
                    min(float(path.cost.min()), start.cost),
                    log_evidence(path, at),
                    reported,
                )
            solutions.append(solution)
    probability = _solution_probabilities(solutions)
    shift = [0 * final.lag_s if s.reported else s.optimum.lag_s - final.lag_s for s in solutions]
    covariance = np.einsum("s,si,sj->ij", probability, shift, shift)
    rows = _structure_rows(solutions, probability, structures)
    return StructureComparison(chosen, rows, covariance, reported_lag_s.u)


def _solution_probabilities(solutions: Sequence[_Solution]) -> Array:
    """Probability of each solution by evidence; that of P1, a special case, by likelihood.

    Occam's factor would favour one lag for having fewer parameters. That a second lag is not needed
    for a good fit does not make the narrower interval of the first one true.

    Parameters
    ----------
    solutions
        All solutions of all structures (S).

    Returns
    -------
    probability
        (S,), with the sum one.

    Notes
    -----
    P1 gets the largest evidence of a richer structure, reduced by half its excess of chi-square
    over that structure. To use the plain evidence instead, remove the loop; the interval then
    narrows where one lag fits. Test: ``tests/immersion/test_plunge_structures.py``.
    """
    evidence = np.array([s.log_evidence for s in solutions])
    cost = np.array([s.cost for s in solutions])
    richer = np.array([s.structure != "P1" for s in solutions])
    if richer.any():
        for k in np.flatnonzero(~richer):
            worse = np.maximum(cost[k] - cost[richer], 0.0)
            evidence[k] = np.max(evidence[richer] - 0.5 * worse)
    weights = np.exp(evidence - evidence.max())
    return weights / weights.sum()


def _structure_rows(
    solutions: Sequence[_Solution], probability: Array, structures: Sequence[str]
) -> tuple[StructureRow, ...]:
    """One row a structure: its reported or most probable solution, and a possible second one.

    Parameters
    ----------
    solutions, probability
        Solutions (S) and the probability of each (S,).
    structures
        Structures in the order of the rows.

    Returns
    -------
    rows
        ``chi_square`` and ``held_out`` are above the least of all rows.
    """
    ranked = sorted(zip(solutions, probability), key=lambda pair: (not pair[0].reported, -pair[1]))
    rows = []
    for structure in structures:
        candidates = [(s, p) for s, p in ranked if s.structure == structure]
        first = candidates[0][0]
        second = [s.lag_s for s, p in candidates[1:] if p > POSSIBLE_PROBABILITY]
        row = StructureRow(
            structure=structure,
            common_lag_s=first.lag_s,
            chi_square=min(s.cost for s, _ in candidates),
            probability=float(sum(p for _, p in candidates)),
            held_out=held_out(first.optimum),
            second_lag_s=second[0] if second else None,
        )
        rows.append(row)
    least_cost = min(row.chi_square for row in rows)
    least_held_out = min((r.held_out for r in rows if r.held_out is not None), default=0.0)
    above_best = []
    for row in rows:
        excess = None if row.held_out is None else row.held_out - least_held_out
        above_best.append(replace(row, chi_square=row.chi_square - least_cost, held_out=excess))
    return tuple(above_best)


def _structure_optima(
    near: PlungeOptimum, structure: str, priors: PlungePriors
) -> list[PlungeOptimum]:
    """The solutions of a structure, most probable first: from ``near``, and from a short lag.

    A long lag with a strong entry burst and a short lag with a mild burst can both be optima.

    Parameters
    ----------
    near
        Optimum from which the search starts.
    structure
        Structure to fit.
    priors
        Priors; those of the split depend on the structure.

    Returns
    -------
    optima
        One or two, by decreasing evidence.

    Notes
    -----
    ``LONG_LAG_S`` and ``SHORT_LAG_S`` decide when and where the second search starts. A lower
    ``LONG_LAG_S`` costs time and can only add solutions.
    """
    layout = near.problem.layout
    noise = near.problem.noise
    optima = [_refit_structure(near, structure, priors, noise)]
    mean_lag_s = near.lag_s.mean()
    if float(mean_lag_s) > LONG_LAG_S:
        reset = layout.mask(*BURST_KINDS, "entry")
        theta = np.where(reset, near.problem.mean, near.theta)
        theta[layout.at("lag")] += SHORT_LAG_S - mean_lag_s
        start = replace(near, solution=replace(near.solution, theta=theta))
        other = _refit_structure(start, structure, priors, noise)
        if not other.is_near(optima[0]) and other.cost < optima[0].cost + MAX_EXCESS_COST:
            optima.append(other)
    return sorted(optima, key=lambda o: o.laplace, reverse=True)


def log_evidence(scan: LagScan, at: PlungeOptimum) -> float:
    """Log evidence, integrated over the common lag along its scan, up to a common constant.

    Parameters
    ----------
    scan
        Profile scan of the common lag.
    at
        Optimum that gives the prior; it belongs to the scan.

    Notes
    -----
    The integral over the lag is exp(log marginal) / density at the maximum of the scan, because
    ``density`` is normalised. Where the posterior is normal this is Laplace's approximation
    (``tests/immersion/test_plunge_structures.py``). It must stay comparable with
    ``immersion.plunge_posterior.PlungeOptimum.laplace``, which replaces it for unlikely structures.
    """
    log_marginal = -0.5 * scan.cost - scan.log_volume
    k = int(np.argmax(log_marginal))
    density = float(np.interp(scan.lag_s[k], scan.grid_s, scan.density))
    return float(log_marginal[k]) - float(np.log(density)) + at.problem.log_prior


def held_out(at: PlungeOptimum, folds: int = 3) -> float | None:
    """Held-out deviance of the plunges: -2 log probability of each given the others.

    Parameters
    ----------
    at
        Optimum with all plunges.
    folds
        Largest number of groups; each group in turn is left out.

    Returns
    -------
    deviance
        None for one plunge.

    Notes
    -----
    log p(group | others) is the difference of the log evidences with and without the group. It is
    printed in the table only, and enters no uncertainty.
    """
    runs = at.problem.layout.runs
    if runs < 2:
        return None
    folds = min(runs, folds)
    training = [
        _subset_optimum(at, [r for r in range(runs) if r % folds != k]).laplace
        for k in range(folds)
    ]
    return -2 * float(np.sum(at.laplace - np.array(training)))


def _subset_optimum(at: PlungeOptimum, runs: Sequence[int]) -> PlungeOptimum:
    """The optimum of a subset of the runs.

    Parameters
    ----------
    at
        Optimum with all runs; the search starts from its parameters.
    runs
        Indices of the runs to use.
    """
    problem = at.problem
    layout = problem.layout
    all_parameters = np.arange(layout.size)
    of_runs = [all_parameters[layout.run(r)] for r in runs]
    of_disk = all_parameters[layout.run(layout.runs - 1).stop :]
    index = np.concatenate([*of_runs, of_disk])
    subset = replace(
        problem,
        models=tuple(problem.models[r] for r in runs),
        noise=tuple(problem.noise[r] for r in runs),
        layout=replace(layout, runs=len(runs)),
        mean=problem.mean[index],
        sd=problem.sd[index],
    )
    return subset.optimise(at.theta[index], limit=12)


def _refit_structure(
    near: PlungeOptimum, structure: str, priors: PlungePriors, noise: tuple[RunNoise, ...]
) -> PlungeOptimum:
    """The optimum with another structure and another ``noise``, started from ``near``.

    Parameters
    ----------
    near
        Optimum from which the search starts.
    structure
        Structure to fit.
    priors
        Priors; those of the split depend on the structure.
    noise
        Noise of each run.

    Notes
    -----
    Where the structure differs, the search starts with the split at its prior mean: the split of
    one structure means nothing in another.
    """
    layout = replace(near.problem.layout, structure=structure)
    mean = near.problem.mean.copy()
    sd = near.problem.sd.copy()
    for kind, (prior_mean, prior_sd) in layout.split_prior(priors).items():
        mean[layout.at(kind)] = prior_mean
        sd[layout.at(kind)] = prior_sd
    theta = near.theta
    if structure != near.problem.layout.structure:
        theta = np.where(layout.mask("split", "common_split"), mean, theta)
    return replace(near.problem, layout=layout, mean=mean, sd=sd, noise=noise).optimise(theta)
