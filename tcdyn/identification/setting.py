"""Setting of the fits that are compared: initial state, noise and baseline.

Where the caller gives neither noise nor baseline, every fit is averaged over white noise, slow
noise and slow waves (:mod:`tcdyn.estimation.noise_average`). Structures are compared under the
likeliest of these disturbances, which is cheaper than an average of each.
``tcdyn.identification.fit`` and ``tcdyn.identification.ladder`` use it.
``tests/identify/test_identify_ladder.py`` checks the steps, ``tests/identify/bare_study.py`` the
coverage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from tcdyn.estimation import NoiseModel
from tcdyn.identification.disturbance import Baseline, NoiseName
from tcdyn.identification.models import Model
from tcdyn.identification.problem import Initial
from tcdyn.identification.search import Fit

# BIC that another initial state must gain: a state that is equally likely (BIC 0) is wrong in half
# of the cases, one that gains 6 is 20 times as likely (Raftery 1995: strong evidence).
MIN_INITIAL_GAIN = 6.0
# States that are tried after one.
LATER_STATES: dict[str, tuple[Initial, ...]] = {
    "equilibrium": ("level", "estimated"),
    "level": ("estimated",),
}


class LikelyNoise(NamedTuple):
    """One of the disturbances over which a fit is averaged, the likeliest.

    Parameters
    ----------
    noise
        Noise model.
    wave_sd
        Prior standard deviation of the first slow wave over that of the noise; zero for no waves.
    """

    noise: NoiseModel
    wave_sd: float


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
        Baseline of the output; "auto" with slow noise only, which is then averaged over slow waves.
    likely
        Noise and waves under which fits are compared, in place of the average over them.
    """

    initial: Initial = "equilibrium"
    noise: NoiseName | tuple[int, int] = "slow"
    baseline: Baseline = "auto"
    likely: LikelyNoise | None = None

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Setting:
        """Return the setting of the options of a caller.

        Parameters
        ----------
        given
            Options of :func:`tcdyn.identification.fit` that the caller has given.

        Notes
        -----
        Without a noise it is slow noise, or that of the steps of a random walk if the baseline is
        one. With another noise than slow noise there is no baseline unless it is given.
        """
        fields = {name: given[name] for name in ("initial", "noise", "baseline") if name in given}
        if fields.get("baseline") == "walk":
            fields.setdefault("noise", "arma")
        if fields.get("noise", "slow") != "slow":
            fields.setdefault("baseline", "none")
        return cls(**fields)

    @property
    def is_averaged(self) -> bool:
        """Whether fits are averaged over slow noise."""
        return self.noise == "slow" and self.likely is None

    @property
    def with_white_noise(self) -> Setting:
        """The setting with white noise in place of slow noise, without waves."""
        baseline: Baseline = "none" if self.baseline == "auto" else self.baseline
        return replace(self, noise="white", baseline=baseline, likely=None)

    def at_likeliest_noise(self, average: Fit) -> Setting:
        """Return the setting with the initial state and the likeliest noise of an average."""
        likely = LikelyNoise(average.noise, average.problem.wave_sd)
        return replace(self, initial=average.problem.initial, likely=likely)


# Fit of a model under a setting from sets of starting values, or None where it cannot be fitted.
FitModel = Callable[[Model, Setting, Sequence[Mapping[str, float]]], Fit | None]


def bic(result: Fit) -> float:
    """Return BIC of the innovations; it compares structures under one setting."""
    return float(result.identified.statistics["bic"])


def with_likely_start(
    result: Fit, setting: Setting, given: Mapping[str, Any], fit_model: FitModel
) -> Fit:
    """Return the fit with the initial state that the data show.

    Parameters
    ----------
    result
        Fit of a model under ``setting``.
    setting
        The setting.
    given
        Options of the caller; an initial state that they hold stays.
    fit_model
        Fits a model under another setting.

    Returns
    -------
    Fit
        ``result``, or a fit from the initial state whose BIC is less by ``MIN_INITIAL_GAIN``.

    Notes
    -----
    A change of the output at the start may be a free state or a slow disturbance. Both are compared
    under the disturbance that is likeliest with ``result``, so the state has to explain what the
    disturbance does not. The search begins with the starting values of the model: the optimum from
    another state may have the wrong sign of the gain.
    """
    if "initial" in given:
        return result
    model = result.problem.model
    reference: Fit | None = result
    common = setting
    if setting.is_averaged:
        common = setting.at_likeliest_noise(result)
        reference = fit_model(model, common, [result.identified.theta])
    if reference is None:
        return result
    best = reference
    limit = bic(reference) - MIN_INITIAL_GAIN
    for initial in LATER_STATES.get(setting.initial, ()):
        other = fit_model(model, replace(common, initial=initial), [])
        if other is not None and bic(other) < limit:
            best = other
            limit = bic(other) - MIN_INITIAL_GAIN
    if best is reference:
        return result
    if not setting.is_averaged:
        return best
    changed = replace(setting, initial=best.problem.initial)
    return fit_model(model, changed, [best.identified.theta]) or result
