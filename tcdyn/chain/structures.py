"""Structures of a chain by their usual names.

The name is P and the number of poles, then a letter for each further element.
``tcdyn.identification`` and ``immersion.chain_structures`` fit structures by name. Guarded by
``tests/chain/test_chain.py`` and ``tests/immersion/test_plunge_structures.py``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import compress

from tcdyn.core.errors import InputError

# structures that are fitted to plunges and compared
STRUCTURES = ("P1", "P2", "P1D", "P2D", "P2Z", "P3")
# words of ``ChainStructure.description`` for 0 to 3 real lags
LAG_COUNTS = ("no lag", "one lag", "two lags", "three lags")


@dataclass(frozen=True)
class ChainStructure:
    """Elements of a chain structure.

    Parameters
    ----------
    name
        Name, such as P2DZ.
    poles
        Number of poles, 0 to 3, without those of cement and integrator.
    pair
        U: whether two of the poles are complex.
    cement
        H: whether there is a half-order lag of cement.
    zero
        Z: whether there is a zero.
    delay
        D: whether there is a dead time.
    integrator
        I: whether there is an integrator.

    Examples
    --------
    >>> ChainStructure.from_name("P2DZ").parameters
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
    def from_name(cls, name: str) -> ChainStructure:
        """The structure with this ``name``.

        Raises
        ------
        InputError
            For an unknown name, or a structure that cannot be simulated.

        Notes
        -----
        The order of "UHZDI" is that of the fields. A further letter needs a field, its entry in
        ``parameters`` and ``description``, and its model in ``tcdyn.identification.models``.
        """
        match = re.match(r"^P([0-3])([UHZDI]*)$", name)
        if match is None or len(set(match[2])) < len(match[2]):
            raise InputError(
                f"there is no process model {name!r}",
                expected="P0, P1, P2 or P3 followed by letters of U, H, Z, D, I, such as P2DZ",
            )
        structure = cls(name, int(match[1]), *(letter in match[2] for letter in "UHZDI"))
        if structure.pair and structure.poles < 2:
            raise InputError(f"{name}: complex poles need at least two", remedy="use P2U or P3U")
        if structure.zero and not (structure.poles or structure.cement or structure.integrator):
            raise InputError(f"{name}: a zero without a pole cannot be simulated", remedy="use P1Z")
        return structure

    @property
    def lags(self) -> tuple[str, ...]:
        """Names of its real lags.

        Returns
        -------
        Tp1 to Tp3 as far as there are poles; with a pair only Tp3, or none.
        """
        return tuple(f"Tp{i}" for i in range(3 if self.pair else 1, self.poles + 1))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters without the gain.

        Returns
        -------
        Lags first, then those present of Tw, Zeta, Tz, Tc and Td.
        """
        present = (self.pair, self.pair, self.zero, self.cement, self.delay)
        return (*self.lags, *compress(("Tw", "Zeta", "Tz", "Tc", "Td"), present))

    @property
    def description(self) -> str:
        """The structure in words.

        Examples
        --------
        >>> ChainStructure.from_name("P2D").description
        'two lags and a dead time'
        """
        words = ("a complex pair", "cement", "a zero", "a dead time", "an integrator")
        present = (self.pair, self.cement, self.zero, self.delay, self.integrator)
        return " and ".join([LAG_COUNTS[len(self.lags)], *compress(words, present)])
