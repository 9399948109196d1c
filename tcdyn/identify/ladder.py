"""Selection of a process model: a fixed ladder of structures, and one setting of the disturbance.

The structures are the process models P1 to P3 with or without dead time (D), zero (Z) and complex
pair (U), the integrator (I) and the half-order element (H). All are compared by BIC of the
innovations under one setting: the initial state, the noise and the baseline, which are selected
first. ``tcdyn.identify.comparison.compare`` uses it. ``tests/identify/bare_study.py`` measures the
coverage of the complete search; ``tests/identify/test_identify_ladder.py`` checks the steps.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

from tcdyn.core.errors import InputError
from tcdyn.identify.disturbance import Baseline, NoiseName
from tcdyn.identify.fit import fit, segment_bic
from tcdyn.identify.heldout import SCORING_OPTIONS, Progress
from tcdyn.identify.iodata import IOData
from tcdyn.identify.models import NO_MODEL, Model, as_model, as_template, several
from tcdyn.identify.problem import Initial
from tcdyn.identify.search import Fit
from tcdyn.identify.starting_values import single_input_problem, starts
from tcdyn.identify.validate import has_clean_residuals, has_coloured_residuals

# Structures of one input that are always fitted: the others are their neighbours.
FIRST_STRUCTURES = ("P1D", "P2D", "P2DZ", "P2DU", "P3D")
# Structures that are tried where the best of the others does not describe the record.
FURTHER_STRUCTURES = ("P1I", "P1DI", "P2DI", "P1DH", "P2DH")
MAX_LAGS = 3  # of a process model

# Thresholds, chosen by judgement.
TIE_BIC = 2.0  # difference of BIC within which the smaller model is preferred
MIN_SETTING_GAIN = 6.0  # BIC that a change of the setting must gain
MAX_SETTING_STEPS = 4  # changes of the setting
N_REFERENCES = 3  # structures by which the setting is selected
MAX_SWEEPS = 6  # rounds over the inputs
N_STARTS = 2  # starting values of a changed branch of several inputs


@dataclass(frozen=True)
class Setting:
    """What all compared models share besides the structure.

    Parameters
    ----------
    initial
        State in which the runs start.
    noise
        Noise of the output: "white", or the order (p, q) of an ARMA model.
    baseline
        Baseline of the output.
    """

    initial: Initial = "equilibrium"
    noise: NoiseName | tuple[int, int] = "white"
    baseline: Baseline = "none"

    @property
    def options(self) -> dict[str, Any]:
        """The setting as options of :func:`tcdyn.identify.fit`."""
        return {"initial": self.initial, "noise": self.noise, "baseline": self.baseline}

    @property
    def is_disturbed(self) -> bool:
        """Whether it has coloured noise or a baseline."""
        return self.noise != "white" or self.baseline != "none"


@dataclass(frozen=True)
class Ladder:
    """The record, and what all fits of the selection share.

    Parameters
    ----------
    data
        One output, one or several inputs.
    template
        What all models have: known factor, offset, dead-time bound, fixed gain.
    options
        Options of :func:`tcdyn.identify.fit` that the caller has given.
    progress
        Called before each fit.
    counter
        Numbers of the fits.
    """

    data: IOData
    template: Model
    options: Mapping[str, Any]
    progress: Progress
    counter: Iterator[int] = field(default_factory=lambda: count(1))

    def announce(self, name: str) -> None:
        """Report a fit, with its number; how many follow is not known."""
        number = next(self.counter)
        self.progress(name, number, number)

    @property
    def first_setting(self) -> Setting:
        """The setting from which the selection starts: that of the caller, or white noise."""
        fields = ("initial", "noise", "baseline")
        return Setting(**{name: self.options[name] for name in fields if name in self.options})

    def with_white_noise(self, initial: Initial) -> Ladder:
        """Return the ladder with white noise, and this initial state unless the caller gave one."""
        options = {"initial": initial, "noise": "white", "baseline": "none"}
        return replace(self, options={**options, **self.options})

    def checked_fit(
        self, model: Model, setting: Setting, start: Sequence[Mapping[str, float]] = ()
    ) -> Fit:
        """Return the fit of one model.

        Parameters
        ----------
        model
            The model.
        setting
            The setting.
        start
            Sets of parameters to start from; none for the starting values of the model.

        Returns
        -------
        Fit
            The fit.

        Raises
        ------
        InputError
            Where the model cannot be fitted.
        """
        check = self.options.get("check", True) and not start
        options = {**self.options, **setting.options, **SCORING_OPTIONS, "check": check}
        return fit(self.data, model, **options, start=start or None)

    def fit_model(
        self, model: Model, setting: Setting, start: Sequence[Mapping[str, float]] = ()
    ) -> Fit | None:
        """Return :meth:`checked_fit`, or None where the model cannot be fitted."""
        try:
            return self.checked_fit(model, setting, start)
        except InputError:
            return None

    def model(self, names: Sequence[str]) -> Model:
        """Return the model with these structures behind the inputs."""
        if len(names) == 1:
            joined = as_model(names[0])
        else:
            joined = several(names, self.data.input_names, known=self.template.known)
        return as_template(joined, self.template)


def bic(result: Fit) -> float:
    """Return BIC of the innovations; it compares structures under one setting."""
    return float(result.identified.statistics["bic"])


def best_fit(fits: Sequence[Fit]) -> Fit:
    """Return the fit of least BIC, or a smaller one within ``TIE_BIC`` of it.

    Parameters
    ----------
    fits
        Fits of one record under one setting.

    Returns
    -------
    Fit
        One of them.
    """
    least = min(bic(f) for f in fits)
    near = [f for f in fits if bic(f) <= least + TIE_BIC]
    return min(near, key=lambda f: (f.problem.size, bic(f)))


def select_setting(ladder: Ladder, fits: Sequence[Fit], setting: Setting) -> tuple[Setting, Fit]:
    """Select initial state, noise and baseline, for the best few structures together.

    Parameters
    ----------
    ladder
        The record and the options.
    fits
        Fits of several structures under ``setting``.
    setting
        Where the selection starts.

    Returns
    -------
    setting
        The setting.
    best
        The best fit under it.

    Notes
    -----
    Each step changes one element: a free initial state, a linear drift, a random walk, ARMA noise.
    It is taken where the least BIC over the structures falls by more than ``MIN_SETTING_GAIN``.
    Structure and disturbance are judged together, because a drift of the output looks like a slow
    lag to a model without one.
    """
    references = sorted(fits, key=bic)[:N_REFERENCES]
    best = references[0]
    for _ in range(MAX_SETTING_STEPS):
        if has_clean_residuals(best):
            break
        candidates = []
        for changed in changed_settings(setting, ladder.options, has_coloured_residuals(best)):
            for reference in references:
                ladder.announce(reference.problem.model.name)
                theta = reference.identified.theta
                result = ladder.fit_model(reference.problem.model, changed, [theta])
                if result is not None:
                    candidates.append((segment_bic(result), changed, result))
        if not candidates:
            break
        least, changed, result = min(candidates, key=lambda candidate: candidate[0])
        if least > segment_bic(best) - MIN_SETTING_GAIN:
            break
        setting = changed
        best = result
    return setting, best


def changed_settings(
    setting: Setting, given: Mapping[str, Any], is_coloured: bool
) -> list[Setting]:
    """Return the settings that differ in one element.

    Parameters
    ----------
    setting
        The setting.
    given
        Options of the caller; what they hold is not changed.
    is_coloured
        Whether the residuals are coloured, so that a disturbance may explain them.

    Returns
    -------
    list of Setting
        The settings.
    """
    settings = []
    if setting.initial == "equilibrium" and "initial" not in given:
        settings.append(replace(setting, initial="estimated"))
    is_linear = given.get("loss", "linear") == "linear"
    may_change_noise = is_coloured and is_linear and not {"noise", "baseline"} & set(given)
    if may_change_noise and setting.baseline == "none":
        settings.append(replace(setting, baseline="trend"))
    if may_change_noise and setting.noise == "white":
        settings.append(replace(setting, noise=(1, 1)))
        settings.append(replace(setting, noise=(0, 1), baseline="walk"))
    elif may_change_noise and setting.noise == (1, 1):
        settings.append(replace(setting, noise=(2, 2)))
    return settings


def neighbours(name: str) -> list[str]:
    """Return the structures that differ by one element: dead time, zero, lag, complex pair.

    >>> neighbours("P2D")
    ['P2', 'P2DZ', 'P1D', 'P3D', 'P2DU']
    >>> neighbours("P1DI")
    ['P1I', 'P1DZI', 'P2DI']
    """
    if name == NO_MODEL:
        return ["P1D"]
    n_lags = int(name[1])
    letters = set(re.sub(r"[P\d]", "", name))
    variants: list[tuple[int, set[str]]] = [(n_lags, letters ^ {"D"}), (n_lags, letters ^ {"Z"})]
    if "U" not in letters:
        variants += [(n_lags - 1, letters), (n_lags + 1, letters)]
    if n_lags >= 2 and not letters & {"H", "I"}:
        variants.append((n_lags, letters ^ {"U"}))
    names = []
    for poles, used in variants:
        if 1 <= poles <= MAX_LAGS:
            names.append(f"P{poles}" + "".join(c for c in "DUZHI" if c in used))
    return names


def climb(ladder: Ladder, fits: dict[str, Fit], setting: Setting) -> dict[str, Fit]:
    """Add neighbours of the best structure of one input until none is better.

    Parameters
    ----------
    ladder
        The record and the options.
    fits
        Fits by the name of the structure.
    setting
        The setting.

    Returns
    -------
    dict
        All fits by the name of the structure.
    """
    tried = set(fits)
    while True:
        best = best_fit(list(fits.values()))
        name = best.problem.model.name
        new = [n for n in neighbours(name) if n not in tried]
        if not new:
            return fits
        fits = fits | fit_structures(ladder, new, setting)
        tried |= set(new)
        if best_fit(list(fits.values())).problem.model.name == name:
            return fits


def fit_structures(ladder: Ladder, names: Sequence[str], setting: Setting) -> dict[str, Fit]:
    """Return the fits of structures of one input, without those that cannot be fitted."""
    fits = {}
    for name in names:
        ladder.announce(name)
        result = ladder.fit_model(ladder.model([name]), setting)
        if result is not None:
            fits[name] = result
    return fits


def select_one_input(ladder: Ladder) -> tuple[dict[str, Fit], Setting]:
    """Select the structure behind one input.

    Parameters
    ----------
    ladder
        The record and the options.

    Returns
    -------
    fits
        Fits by the name of the structure, all under one setting.
    setting
        The setting.

    Raises
    ------
    InputError
        Where no structure can be fitted.
    """
    first = ladder.first_setting
    fits = {"P1D": ladder.checked_fit(ladder.model(["P1D"]), first)}
    fits |= fit_structures(ladder, (*FIRST_STRUCTURES[1:], NO_MODEL), first)
    setting, best = select_setting(ladder, list(fits.values()), first)
    if setting != first:
        fits = fit_structures(ladder, (*FIRST_STRUCTURES, NO_MODEL), setting)
    fits = climb(ladder, fits, setting)
    best = best_fit(list(fits.values()))
    if not has_clean_residuals(best) or best.findings:
        further = fit_structures(ladder, FURTHER_STRUCTURES, setting)
        fits = climb(ladder, fits | further, setting)
    return fits, setting


def select_several_inputs(ladder: Ladder) -> tuple[dict[str, Fit], Setting]:
    """Select the structure behind each of several inputs, one input at a time.

    Parameters
    ----------
    ladder
        The record and the options.

    Returns
    -------
    fits
        Fits by the name of the model, all under one setting: the path of the search.
    setting
        The setting.

    Notes
    -----
    The search starts with one lag and a dead time behind each input. For each input in turn the
    neighbours of its structure, and no effect at all, are fitted with the others unchanged, until
    a round over the inputs changes nothing.
    """
    n_inputs = len(ladder.data.input_names)
    names = ["P1D"] * n_inputs
    setting = ladder.first_setting
    first = ladder.checked_fit(ladder.model(names), setting)
    second = ladder.fit_model(ladder.model(["P2D"] * n_inputs), setting)
    references = [first] if second is None else [first, second]
    setting, best = select_setting(ladder, references, setting)
    if len(best.problem.model.names) > len(first.problem.model.names):
        names = ["P2D"] * n_inputs
    fits = {best.problem.model.name: best}
    for _ in range(MAX_SWEEPS):
        before = list(names)
        for k in range(n_inputs):
            others = neighbours(names[k])
            if names[k] != NO_MODEL:
                others.append(NO_MODEL)
            for structure in others:
                changed = [*names[:k], structure, *names[k + 1 :]]
                model = ladder.model(changed)
                if model.name in fits:
                    continue
                ladder.announce(model.name)
                start = branch_starts(best, model, k)
                result = ladder.fit_model(model, setting, start)
                if result is not None:
                    fits[model.name] = result
            best = best_fit(list(fits.values()))
            names = [submodel.name for submodel in best.problem.model.submodels]
        if names == before:
            break
    return fits, setting


def branch_starts(current: Fit, model: Model, k: int) -> list[dict[str, float]]:
    """Return starting parameters of a model that differs behind one input.

    Parameters
    ----------
    current
        Fit of the other model.
    model
        The model.
    k
        Number of the input.

    Returns
    -------
    list of dict
        Parameters by name: those of the other inputs as they are, those of this input from the
        output without the response to the others.
    """
    theta = current.identified.theta
    branch, names = model.branch(k)
    kept = {n: theta[n] for n in model.names if n in theta and n not in names.values()}
    if not branch.free:
        return [kept]
    single = single_input_problem(current.problem, theta, k)
    template = current.problem.model
    branch = replace(branch, offset=template.offset, delay_max_s=template.delay_max_s)
    single = replace(single, model=branch)
    branch_sets = [single.theta(x) for x in starts(single)[:N_STARTS]]
    return [kept | {names[n]: v for n, v in values.items()} for values in branch_sets]


def select_structures(ladder: Ladder) -> tuple[dict[str, Fit], Setting]:
    """Return fits of the structures of the ladder under the selected setting.

    Parameters
    ----------
    ladder
        The record and the options.

    Returns
    -------
    fits
        Fits by the name of the model.
    setting
        The setting.

    Raises
    ------
    InputError
        Where no structure can be fitted.
    """
    if len(ladder.data.input_names) == 1:
        return select_one_input(ladder)
    return select_several_inputs(ladder)
