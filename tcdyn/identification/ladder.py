"""Selection of a process model: a fixed ladder of structures under one disturbance.

The structures are the process models P1 to P3 with or without dead time (D), zero (Z) and complex
pair (U), the integrator (I) and the half-order element (H). All are compared by BIC of the
innovations under one setting: the initial state, and the disturbance that is likeliest with the
best of the first structures (:func:`common_setting`).
``tcdyn.identification.comparison.compare`` uses it. ``tests/identify/bare_study.py`` measures the
coverage of the complete search; ``tests/identify/test_identify_ladder.py`` checks the steps.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np

from tcdyn.core.errors import InputError
from tcdyn.identification.fitting import fit_under
from tcdyn.identification.heldout import (
    Progress,
    held_out_statistics,
    split_held_out,
)
from tcdyn.identification.iodata import IOData
from tcdyn.identification.models import NO_MODEL, Model, as_model, as_template, several
from tcdyn.identification.recommendation import TIE_BIC
from tcdyn.identification.search import Fit
from tcdyn.identification.setting import Setting, bic, with_likely_start
from tcdyn.identification.starting_values import single_input_problem, starts
from tcdyn.identification.validation import has_clean_residuals

# Structures of one input that are always fitted: the others are their neighbours.
FIRST_STRUCTURES = ("P1D", "P2D", "P2DZ", "P2DU", "P3D")
# Structures that are tried where the best of the others does not describe the record.
FURTHER_STRUCTURES = ("P1I", "P1DI", "P2DI", "P1DH", "P2DH")
MAX_LAGS = 3  # of a process model
# Structures that are tried with one input only: with several the search took more than 200 s in a
# record of 1551 rows, most of it in pairs with zeros.
OF_ONE_INPUT = ("P2UZ", "P2DUZ", "P3U", "P3DU", "P3UZ", "P3DUZ")

# Thresholds, chosen by judgement.
MAX_SWEEPS = 6  # rounds over the inputs
N_STARTS = 2  # starting values of a changed branch of several inputs
N_REFERENCES = 2  # structures with which the common disturbance is estimated
MAX_COMMON_ROUNDS = 2  # of the common disturbance and the structures under it


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
        Options of :func:`tcdyn.identification.fit` that the caller has given.
    progress
        Called before each fit.
    held_out
        Another record, or the last share of ``data``, on which fits are scored.
    counter
        Numbers of the fits.
    """

    data: IOData
    template: Model
    options: Mapping[str, Any]
    progress: Progress
    held_out: IOData | float = 0.3
    counter: Iterator[int] = field(default_factory=lambda: count(1))

    def __post_init__(self) -> None:
        """Check that the held-out share is possible."""
        split_held_out(self.data, self.held_out)  # raises InputError for an unusable share

    def announce(self, name: str) -> None:
        """Report a fit, with its number; how many follow is not known."""
        self.progress("no effect" if name == "-" else name, next(self.counter), 0)

    def with_white_noise(self) -> Ladder:
        """Return the ladder with white noise and no baseline."""
        return replace(self, options={"noise": "white", "baseline": "none", **self.options})

    @property
    def setting(self) -> Setting:
        """The setting of the final fits."""
        return Setting.of(self.options)

    @property
    def fit_options(self) -> dict[str, Any]:
        """Options of a fit under a setting, without those that belong to the setting or result."""
        others = ("initial", "noise", "baseline", "intervals", "check")
        return {name: value for name, value in self.options.items() if name not in others}

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
        if model.arx:
            setting = Setting(setting.initial, "white", "none")
        return fit_under(self.data, model, setting, start, check=check, **self.fit_options)

    def fit_model(
        self, model: Model, setting: Setting, start: Sequence[Mapping[str, float]] = ()
    ) -> Fit | None:
        """Return :meth:`checked_fit`, or None where the model cannot be fitted."""
        self.announce(model.name)
        try:
            return self.checked_fit(model, setting, start)
        except InputError:
            return None

    def held_out_error(self, result: Fit, setting: Setting) -> tuple[float, float, float]:
        """Return the held-out statistics of a model, fitted to the training data if there are any.

        Parameters
        ----------
        result
            Fit to all of the data; its model is fitted again.
        setting
            The setting of that fit.

        Returns
        -------
        rms, percent, p
            As :func:`tcdyn.identification.heldout.held_out_statistics` returns them; NaN where the
            training data are too short.
        """
        train, test, from_s = split_held_out(self.data, self.held_out)
        if train is not None:
            start = [result.identified.theta]
            trained = replace(self, data=train, options={**self.options, "check": False})
            try:
                result = trained.checked_fit(result.problem.model, setting, start)
            except InputError:
                return np.nan, np.nan, np.nan
        return held_out_statistics(result, test, from_s)

    def model(self, names: Sequence[str]) -> Model:
        """Return the model with these structures behind the inputs."""
        if len(names) == 1:
            joined = as_model(names[0])
        else:
            joined = several(names, self.data.input_names, known=self.template.known)
        return as_template(joined, self.template)


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


def neighbours(name: str) -> list[str]:
    """Return the structures that differ by one element: dead time, zero, lag, complex pair.

    Parameters
    ----------
    name
        A structure such as "P2DZ", or ``NO_MODEL``, whose only neighbour is "P1D".

    Returns
    -------
    list of str
        Names of the neighbours.

    Notes
    -----
    The number of lags lies between 1 and ``MAX_LAGS``. Integrator (I) and half-order element (H)
    are never added or removed. A complex pair (U) replaces two lags: it needs at least two and
    neither I nor H, and with it the number of lags stays.
    ``tests/identify/test_identify_ladder.py`` guards that each is a neighbour of its neighbours.

    Examples
    --------
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
    """Fit structures of one input by name; those that cannot be fitted are left out."""
    fits = {}
    for name in names:
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
    target = ladder.setting
    first = target.with_white_noise if target.is_averaged else target
    fits = {"P1D": ladder.checked_fit(ladder.model(["P1D"]), first)}
    fits |= fit_structures(ladder, (*FIRST_STRUCTURES[1:], NO_MODEL), first)
    references = sorted(fits.values(), key=bic)[:N_REFERENCES]
    setting = common_setting(ladder, references, target)
    for _ in range(MAX_COMMON_ROUNDS):
        fits = fit_structures(ladder, list(fits), setting)
        fits = climb(ladder, fits, setting)
        best = best_fit(list(fits.values()))
        if not has_clean_residuals(best) or best.findings:
            new = [name for name in FURTHER_STRUCTURES if name not in fits]
            fits = climb(ladder, fits | fit_structures(ladder, new, setting), setting)
            best = best_fit(list(fits.values()))
        is_reference = any(best.problem.model.name == f.problem.model.name for f in references)
        if is_reference or not target.is_averaged:
            break
        # the disturbance that is likely with a poor model contains dynamics that it lacks
        references = [best]
        setting = common_setting(ladder, references, target)
    return fits, setting


def common_setting(ladder: Ladder, references: Sequence[Fit], target: Setting) -> Setting:
    """Return the initial state and the disturbance under which structures are compared.

    Parameters
    ----------
    ladder
        The record and the options.
    references
        Fits of the best structures so far, under white noise where ``target`` is averaged over
        noise, else under ``target``.
    target
        The setting of the final fits.

    Returns
    -------
    Setting
        That of the reference whose BIC at its own likeliest disturbance is least.
    """
    finals = []
    for reference in references:
        result: Fit | None = reference
        if target.is_averaged:
            start = [reference.identified.theta]
            result = ladder.fit_model(reference.problem.model, target, start)
        if result is not None:
            finals.append(with_likely_start(result, target, ladder.options, ladder.fit_model))
    if not finals:
        return target.with_white_noise
    best = min(finals, key=bic)
    if target.is_averaged:
        return target.at_likeliest_noise(best)
    return replace(target, initial=best.problem.initial)


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
    The search starts with one or two lags and a dead time behind each input; both are kept. For
    each input in turn the neighbours of its structure, and no effect at all, are fitted with the
    others unchanged, until a round over the inputs changes nothing.
    """
    n_inputs = len(ladder.data.input_names)
    target = ladder.setting
    white = target.with_white_noise if target.is_averaged else target
    first = ladder.checked_fit(ladder.model(["P1D"] * n_inputs), white)
    second = ladder.fit_model(ladder.model(["P2D"] * n_inputs), white)
    references = [first] if second is None else [first, second]
    setting = common_setting(ladder, references, target)
    fits = {}
    for reference in references:
        model = reference.problem.model
        result = ladder.fit_model(model, setting)
        if result is not None:
            fits[model.name] = result
    if not fits:
        fits = {first.problem.model.name: first}
        setting = white
    best = best_fit(list(fits.values()))
    names = [submodel.name for submodel in best.problem.model.submodels]
    for _ in range(MAX_SWEEPS):
        before = list(names)
        for k in range(n_inputs):
            others = [name for name in neighbours(names[k]) if name not in OF_ONE_INPUT]
            if names[k] != NO_MODEL:
                others.append(NO_MODEL)
            for structure in others:
                changed = [*names[:k], structure, *names[k + 1 :]]
                model = ladder.model(changed)
                if model.name in fits:
                    continue
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
