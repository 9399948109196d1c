"""Do the speed law, the cooling and the joint fits agree, their uncertainties and correlations counted?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calibration.estimate import Estimate

SUSPECT_Z = 3.0
NOTED_CHANCE = 0.5


@dataclass(frozen=True)
class Tension:
    """A stated value that the data pull: what it is in words, and by how many standard deviations.

    ``chance``: how often a sound test shows as much somewhere among the values of this kind; ``alarm``: the chance
    below which it is a contradiction.
    """

    what: str
    z: float
    chance: float
    alarm: float

    @property
    def contradicts(self) -> bool:
        """Whether chance would bring so large a tension too rarely to believe it."""
        return self.chance < self.alarm


@dataclass(frozen=True)
class CrossCheck:
    """``z`` is the largest disagreement of any two ways to beta in standard deviations of their difference.

    ``suspects`` are stated values that the data contradict (a depth, a lag, the exponent), worst first; ``strained`` is
    the one that they pull most, where half of all sound tests show less, though it is no contradiction.
    """

    z: float
    agree: bool
    sentence: str
    pair: tuple[str, str]
    p_value: float
    pairs: tuple[tuple[str, str, float, float], ...]
    suspects: tuple[Tension, ...]
    strained: Tension | None


def cross_check(
    values: dict[str, float],
    draws: dict[str, NDArray[np.float64]],
    steady: Estimate,
    tensions: Sequence[Tension] = (),
) -> CrossCheck:
    """Compare the ways to beta, given Monte Carlo ``draws`` of each that share their common errors.

    ``values`` and ``draws`` have the same keys. The difference of two ways is judged against the spread of the
    difference of their draws, so an error that moves both alike does not count. With several pairs the largest z is
    judged by the chance that any of so many would be as large (``p_value`` from the draws themselves). ``tensions``
    that contradict become named suspects. The ways agree when there is none and no pair is beyond ``SUSPECT_Z``.
    """
    names = list(values)
    pairs, zs = [], []
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            gap = values[one] - values[other]
            centred = draws[one] - draws[other]
            spread = max(float(np.std(centred)), 1e-12)
            pairs.append((one, other, float(gap), float(abs(gap) / spread)))
            zs.append(np.abs(centred - centred.mean()) / spread)
    worst = max(pairs, key=lambda row: row[3])
    largest = np.max(np.stack(zs), axis=0)
    p = float(np.mean(largest >= worst[3]))
    if worst[3] > largest.max():  # beyond what the draws can tell: the normal tail, for so many pairs
        p = min(1.0, 2 * len(pairs) * float(stats.norm.sf(worst[3])))
    suspects = tuple(sorted((t for t in tensions if t.contradicts), key=lambda t: -abs(t.z)))
    agree = worst[3] < SUSPECT_Z and not suspects
    most = min(tensions, key=lambda t: t.chance, default=None)
    strained = most if most is not None and most.chance < NOTED_CHANCE else None
    sentence = _sentence(worst, values, steady, suspects, strained)
    return CrossCheck(worst[3], agree, sentence, (worst[0], worst[1]), p, tuple(pairs), suspects, strained)


def _sentence(
    worst: tuple[str, str, float, float],
    values: dict[str, float],
    steady: Estimate,
    suspects: Sequence[Tension],
    strained: Tension | None,
) -> str:
    one, other, gap, z = worst
    spread = f"{min(values.values()):.3f} to {max(values.values()):.3f}"
    blame = "; ".join(f"{t.what} ({abs(t.z):.1f} standard deviations)" for t in suspects[:3])
    if z >= SUSPECT_Z:
        return (
            f"The ways to beta do NOT agree: {one} and {other} differ by {abs(gap):.3f}, {z:.1f} standard deviations "
            f"of their difference; suspect {blame or _suspect(one, other)}."
        )
    if suspects:
        return (
            f"The ways to beta lie together ({spread}), but the data contradict what was stated: suspect {blame}. "
            "Do NOT trust beta before that is cleared up."
        )
    return (
        f"The ways to beta agree: {spread}, speed law {steady}; the largest "
        f"difference, {one} against {other}, is {abs(gap):.3f} or {z:.1f} standard deviations"
        + (
            f". The stated value that the data pull most is {strained.what}: {abs(strained.z):.1f} standard "
            f"deviations, no contradiction (one sound test in {1 / strained.chance:.0f} shows as much)."
            if strained
            else "."
        )
    )


def _suspect(one: str, other: str) -> str:
    words = {one, other}
    if words == {"joint fast", "joint slow"}:
        return "a junction depth, a static line or the friction scale: the two disks' shares do not add to one"
    if any(w.startswith("cooling") for w in words) and any(w.startswith("joint") for w in words):
        return "the chain's lag or the instant of parting: compensated and commuted forms should give the same"
    if any(w.startswith("cooling") for w in words):
        return "the lag that was compensated, or the speed exponent"
    return "the speed exponent, or a junction depth"
