"""Setting of the fits that are compared: initial state, noise and baseline, and its selection.

``tcdyn.identification.fit`` selects the setting of one model with it,
``tcdyn.identification.ladder`` that of several models together.
``tests/identify/test_identify_ladder.py`` checks the steps,
``tests/identify/test_identify_disturbance.py`` and ``tests/identify/bare_study.py`` the coverage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tcdyn.identification.disturbance import Baseline, NoiseName
from tcdyn.identification.models import Model
from tcdyn.identification.problem import Initial
from tcdyn.identification.search import Fit
from tcdyn.identification.validation import has_clean_residuals, has_coloured_residuals, is_undriven

# Thresholds, chosen by judgement.
MIN_SETTING_GAIN = 6.0  # BIC that a change of the setting must gain
MAX_SETTING_STEPS = 4  # changes of the setting
N_REFERENCES = 3  # models by which the setting is selected


@dataclass(frozen=True)
class Setting:
    """What all compared models share besides the structure.

    Parameters
    ----------
    initial
        State in which the runs start.
    noise
        Noise of the output: a name, or the order (p, q) of an ARMA model.
    baseline
        Baseline of the output; "auto" with slow noise only, which is averaged with and without a
        drift.
    """

    initial: Initial = "equilibrium"
    noise: NoiseName | tuple[int, int] = "white"
    baseline: Baseline = "none"

    @classmethod
    def first(cls, given: Mapping[str, Any]) -> Setting:
        """Return the setting from which a selection starts: as given, else white noise.

        Parameters
        ----------
        given
            Options of :func:`tcdyn.identification.fit` that the caller has given.
        """
        fields = {name: given[name] for name in ("initial", "noise", "baseline") if name in given}
        if fields.get("noise") == "slow":
            fields.setdefault("baseline", "auto")
        return cls(**fields)

    @property
    def options(self) -> dict[str, Any]:
        """The setting as options of :func:`tcdyn.identification.fit`."""
        return asdict(self)

    @property
    def has_disturbance(self) -> bool:
        """Whether it has coloured noise or a baseline."""
        return self.noise != "white" or self.baseline != "none"


# Fit of a model under a setting from sets of starting values, or None where it cannot be fitted.
FitModel = Callable[[Model, Setting, Sequence[Mapping[str, float]]], Fit | None]


def bic(result: Fit) -> float:
    """Return BIC of the innovations; it compares structures under one setting."""
    return float(result.identified.statistics["bic"])


def setting_of(result: Fit) -> Setting:
    """Return the setting under which a model was fitted."""
    initial = result.problem.initial
    noise = result.noise
    if noise.averaged:
        return Setting(initial, "slow", "auto")
    if noise.is_random_walk:
        return Setting(initial, noise.order, "walk")
    baseline: Baseline = "trend" if result.problem.trend else "none"
    return Setting(initial, noise.order if any(noise.order) else "white", baseline)


def select_setting(
    fits: Sequence[Fit], setting: Setting, given: Mapping[str, Any], fit_model: FitModel
) -> tuple[Setting, Fit]:
    """Select initial state, noise and baseline, for the best few models together.

    Parameters
    ----------
    fits
        Fits of one or several models under ``setting``.
    setting
        Where the selection starts.
    given
        Options of the caller; what they hold is not changed.
    fit_model
        Fits a model under another setting.

    Returns
    -------
    setting
        The setting.
    best
        The best fit under it.

    Notes
    -----
    Each step changes one element: the initial state, a linear drift, ARMA noise, a random walk.
    It is taken where the least BIC over the models falls by more than ``MIN_SETTING_GAIN``. A
    disturbance under which the residuals still follow the input is not accepted: it would replace
    dynamics that the models lack. Structure and disturbance are judged together, because a drift of
    the output looks like a slow lag to a model without one. With a drift or another initial state
    the search begins with the starting values of the model: the optimum without them may have the
    wrong sign of the gain where they are as large as the response.
    """
    references = sorted(fits, key=bic)[:N_REFERENCES]
    best = references[0]
    has_given_noise = given.get("noise", "white") != "white"
    for _ in range(MAX_SETTING_STEPS):
        if has_clean_residuals(best) and not has_given_noise:
            break
        candidates = []
        for changed in changed_settings(setting, given, best):
            adds_drift = changed.baseline == "trend" and setting.baseline != "trend"
            is_same_disturbance = changed == replace(setting, initial=changed.initial)
            for reference in references:
                is_far = adds_drift or changed.initial != setting.initial
                start = [] if is_far else [reference.identified.theta]
                result = fit_model(reference.problem.model, changed, start)
                if result is not None and (is_same_disturbance or is_undriven(result)):
                    candidates.append((segment_bic(result), changed, result))
        if not candidates:
            break
        least, changed, result = min(candidates, key=lambda candidate: candidate[0])
        if least > segment_bic(best) - MIN_SETTING_GAIN:
            break
        setting = changed
        best = result
    return setting, best


def changed_settings(setting: Setting, given: Mapping[str, Any], best: Fit) -> list[Setting]:
    """Return the settings that differ in one element and may explain the residuals.

    Parameters
    ----------
    setting
        The setting.
    given
        Options of the caller; what they hold is not changed.
    best
        The best fit so far. Only coloured residuals may be a disturbance. Of a robust loss the
        disturbance stays.

    Returns
    -------
    list of Setting
        The settings.
    """
    settings = []
    noise = setting.noise
    has_given_noise = "noise" in given
    if "initial" not in given:
        later_states: dict[Any, tuple[Initial, ...]] = {
            "equilibrium": ("level", "estimated"),
            "level": ("estimated",),
        }
        for initial in later_states.get(setting.initial, ()):
            settings.append(replace(setting, initial=initial))
    is_given_colour = has_given_noise and noise != "white"
    is_coloured = is_given_colour or has_coloured_residuals(best)
    if noise == "slow" or not is_coloured or given.get("loss", "linear") != "linear":
        return settings
    may_change_baseline = "baseline" not in given
    if may_change_baseline and setting.baseline == "none":
        settings.append(replace(setting, baseline="trend"))
    next_orders: dict[Any, tuple[int, int]] = {"white": (1, 1), (1, 1): (2, 2)}
    if not has_given_noise and noise in next_orders:
        settings.append(replace(setting, noise=next_orders[noise]))
    is_fixed_noise = has_given_noise or noise == "white"
    if may_change_baseline and setting.baseline != "walk" and is_fixed_noise:
        settings.append(replace(setting, baseline="walk"))
    return settings


def average_noise(best: Fit, given: Mapping[str, Any], fit_model: FitModel) -> Fit:
    """Return the fit with the noise averaged over slow disturbances.

    Parameters
    ----------
    best
        The fit with the selected noise and baseline.
    given
        Options of the caller; noise that they hold stays, as does a random walk.
    fit_model
        Fits a model under another setting.

    Returns
    -------
    Fit
        The average; ``best`` where the residuals of the average follow the input, or where the
        selected disturbance leaves white residuals and the average does not.

    Notes
    -----
    No test decides whether there is a disturbance: a drift too small for a test of whiteness moves
    gain and lag by several of the standard uncertainties of white noise
    (``tests/identify/small_drift_study.py``). White noise is one of the averaged models.
    """
    selected = setting_of(best)
    is_given = "noise" in given or given.get("baseline") == "walk"
    if is_given:
        return best
    averaged = replace(selected, noise="slow", baseline=given.get("baseline", "auto"))
    average = fit_model(best.problem.model, averaged, [best.identified.theta])
    if average is None or not is_undriven(average):
        return best
    is_worse = has_coloured_residuals(average) and not has_coloured_residuals(best)
    if is_worse and selected.has_disturbance:
        return best
    return average


def segment_bic(result: Fit) -> float:
    """BIC of the segments between gaps, free of the level of each segment after the first.

    A random walk leaves these levels free.

    Returns
    -------
    float
        The criterion; it compares fits of one record with and without a random walk.

    Notes
    -----
    (n - L) ln |w|^2 + sum ln |l|^2, with l the whitened level of each of the L segments and w the
    innovations orthogonal to it.
    """
    noise = result.noise
    slices = result.problem.residual_slices
    e = result.innovation.copy()
    volume = 0.0
    for s in slices[1:]:
        level = noise.whiten(result.sqrt_weights[s], [slice(0, s.stop - s.start)])
        e[s] -= level * (level @ e[s]) / (level @ level)
        volume += float(np.log(level @ level))
    dof = len(e) - len(slices) + 1
    deviance = dof * np.log(max(float(e @ e), 1e-300) / dof)
    deviance += volume + noise.log_determinant(slices)
    return float(deviance + result.identified.statistics["parameters"] * np.log(dof))
