"""Models whose special elements are no better than lags, which are the simpler explanation.

``tcdyn.identification.comparison`` does not recommend them.
``tests/identify/test_identify_ladder.py`` checks the rules.
"""

from __future__ import annotations

from collections.abc import Mapping

from tcdyn.identification.recommendation import DECISIVE_BIC
from tcdyn.identification.search import Fit
from tcdyn.identification.setting import bic


def overdamped_models(fits: Mapping[str, Fit]) -> list[str]:
    """Models with a pair of poles (U) that are real, where two lags fit no worse.

    The data determine the two lags, or do not determine the pair either.

    Parameters
    ----------
    fits
        Fits by the name of the model.

    Returns
    -------
    list of str
        Names of those models.
    """
    names = []
    for name, result in fits.items():
        structures = name.split(" + ")
        for k, part in enumerate(result.identified.by_input.values()):
            if part.theta.get("Zeta", 0.0) < 1:
                continue
            with_lags = [*structures[:k], structures[k].replace("U", ""), *structures[k + 1 :]]
            two_lags = fits.get(" + ".join(with_lags))
            if two_lags is not None and (result.findings or not two_lags.findings):
                names.append(name)
    return names


def needless_elements(fits: Mapping[str, Fit]) -> list[str]:
    """Models with an element that lags describe about as well.

    A half-order element has an infinite lag and takes part of the dead time, and an oscillating
    pair has two parameters as two lags have; lags are the simpler explanation.

    Parameters
    ----------
    fits
        Fits by the name of the model.

    Returns
    -------
    list of str
        Names of models with a half-order element whose BIC is not lower by ``DECISIVE_BIC`` than
        that of all models with lags, and of models with a pair where the same holds of two lags in
        its place.
    """
    needless = []
    lumped = [bic(result) for name, result in fits.items() if "H" not in name]
    if lumped:
        limit = min(lumped) - DECISIVE_BIC
        needless = [name for name in fits if "H" in name and bic(fits[name]) > limit]
    for name, result in fits.items():
        structures = name.split(" + ")
        for k, structure in enumerate(structures):
            if "U" not in structure:
                continue
            with_lags = [*structures[:k], structure.replace("U", ""), *structures[k + 1 :]]
            two_lags = fits.get(" + ".join(with_lags))
            if two_lags is not None and bic(result) > bic(two_lags) - DECISIVE_BIC:
                needless.append(name)
    return needless
