"""Structures of a chain by their usual names: P and the number of poles, then a letter for each further part.

Channels of several structures are made alike.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from tcdyn.chain.chain import Chain
from tcdyn.chain.rational import Factor, Rational, product, simulate
from tcdyn.core import Array
from tcdyn.core.errors import InputError

STRUCTURES = (
    "P1",
    "P2",
    "P1D",
    "P2D",
    "P2Z",
    "P3",
)  # what plunges are fitted with and told apart by
LEAST_LAG_S = 1e-3  # stands for a lag that is missing where a filter would not be proper without it
COUNTED = ("no lag", "one lag", "two lags", "three lags")


@dataclass(frozen=True)
class Structure:
    """Which parts a chain has: ``poles`` 0 to 3, two of them complex if ``pair``, and what its letters say.

    U complex pair, H half-order cement, Z zero, D dead time, I integrator.

    >>> Structure.of("P2DZ").parameters
    ('Tp1', 'Tp2', 'Tz', 'Td')
    """

    name: str
    poles: int
    pair: bool = False
    cement: bool = False
    zero: bool = False
    delay: bool = False
    integrator: bool = False

    @classmethod
    def of(cls, name: str) -> Structure:
        """The structure called ``name``. Raises InputError for one that there is not, or that cannot be simulated."""
        match = re.match(r"^P([0-3])([UHZDI]*)$", name)
        if match is None or len(set(match[2])) < len(match[2]):
            raise InputError(
                f"there is no process model {name!r}",
                expected="P0, P1, P2 or P3 followed by letters of U, H, Z, D, I, such as P2DZ",
            )
        found = cls(name, int(match[1]), *(letter in match[2] for letter in "UHZDI"))
        if found.pair and found.poles < 2:
            raise InputError(f"{name}: complex poles need at least two", remedy="use P2U or P3U")
        if found.zero and not (found.poles or found.cement or found.integrator):
            raise InputError(f"{name}: a zero without a pole cannot be simulated", remedy="use P1Z")
        return found

    @property
    def lags(self) -> tuple[str, ...]:
        """Names of its real lags: Tp1, Tp2, Tp3, or Tp3 beside a pair."""
        return tuple(f"Tp{i}" for i in range(3 if self.pair else 1, self.poles + 1))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters, the gain left out, lags first."""
        asked = (self.pair, self.pair, self.zero, self.cement, self.delay)
        return (*self.lags, *compress(("Tw", "Zeta", "Tz", "Tc", "Td"), asked))

    @property
    def meaning(self) -> str:
        """What the name stands for, in words.

        >>> Structure.of("P2D").meaning
        'two lags and a dead time'
        """
        words = ("a complex pair", "cement", "a zero", "a dead time", "an integrator")
        asked = (self.pair, self.cement, self.zero, self.delay, self.integrator)
        return " and ".join([COUNTED[len(self.lags)], *compress(words, asked)])


def equalised(y: Array, dt_s: float, chains: Sequence[Chain], common: Chain) -> Array:
    """Each column of ``y`` (N, M) [degC] as the ``common`` chain would have shown it: no inverse is needed for it.

    Column i is filtered by G_common / G_i, in which the conditioning cancels; where the common chain has as many lags,
    noise grows at most by their ratio. A channel with more dead time than the common chain keeps its excess. Before
    its first sample a column stood at its mean over the first second.
    """
    out = np.empty_like(y)
    for i, chain in enumerate(chains):
        before = np.mean(y[: max(int(1.0 / dt_s), 1), i])
        out[:, i] = simulate(_quotient(common, chain), np.concatenate([[before], y[:, i]]), dt_s)[
            1:
        ]
    return out


def _quotient(upper: Chain, lower: Chain) -> Rational:
    """G_upper / G_lower without their filter, kept proper by lags of 1 ms; what it would delay less than nothing is
    left out."""
    num: Array = product(lower.own_factors())
    below = list(upper.own_factors())
    if upper.zero_s != lower.zero_s:
        num = product([num, (1.0, upper.zero_s)])
        below.append((1.0, max(lower.zero_s, LEAST_LAG_S)))
    excess = len(num) - 1 - sum(len(f) - 1 for f in below)
    below += [(1.0, LEAST_LAG_S)] * excess
    return Rational(num, tuple(Factor(f) for f in below), max(upper.delay_s - lower.delay_s, 0.0))
