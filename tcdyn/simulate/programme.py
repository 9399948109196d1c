"""The sixteen EHL tests: conditions (table 6.1) and published results (tables 7.1 and 7.2).

``tcdyn.simulate.ehl`` draws tests around these values; ``tcdyn.verify`` and
``docs/gallery/test/thesis_tests.py`` compare with them. ``tests/simulate/test_contact.py`` checks
speeds, contacts and the ratio of the heat transfer coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

from tcdyn.core.errors import InputError
from tcdyn.rig.contact import entraining_speed_m_s, sliding_speed_m_s


@dataclass(frozen=True)
class EhlCondition:
    """Conditions of one EHL test, and the results of the thesis for it.

    Parameters
    ----------
    name
        Name of the test, A1 to D4.
    load_N
        Normal load [N].
    pressure_GPa
        Maximum Hertzian pressure [GPa].
    speed_fast_rpm, speed_slow_rpm
        Speeds of the disks [rpm].
    friction_N
        Published friction force [N].
    fast_a_degC, slow_a_degC
        Published steady temperatures of junction a of the disks [degC].
    beta
        Published share of the frictional heat that enters the fast disk.
    h_fast_W_m2K, h_slow_W_m2K
        Published heat transfer coefficients of the running surfaces [W/m2K].
    """

    name: str
    load_N: float
    pressure_GPa: float
    speed_fast_rpm: float
    speed_slow_rpm: float
    friction_N: float
    fast_a_degC: float
    slow_a_degC: float
    beta: float
    h_fast_W_m2K: float
    h_slow_W_m2K: float

    @property
    def sliding_speed_m_s(self) -> float:
        """Sliding speed u_s [m/s]."""
        return sliding_speed_m_s(self.speed_fast_rpm, self.speed_slow_rpm)

    @property
    def entraining_speed_m_s(self) -> float:
        """Entraining speed u_m [m/s]."""
        return entraining_speed_m_s(self.speed_fast_rpm, self.speed_slow_rpm)

    @property
    def power_W(self) -> float:
        """Frictional power F u_s [W]."""
        return self.friction_N * self.sliding_speed_m_s


# Load [N] and maximum Hertzian pressure [GPa] by the number in a test's name (table 6.1).
_LOADS = {1: (850.0, 1.0), 2: (1460.0, 1.2), 3: (1850.0, 1.3), 4: (2320.0, 1.4)}
# Speeds of the fast and the slow disk [rpm] by the letter in a test's name (table 6.1).
_SPEEDS = {
    "A": (3282.0, 774.0),
    "B": (4261.0, 1005.0),
    "C": (5249.0, 1238.0),
    "D": (6555.0, 1546.0),
}
# friction [N], a fast, a slow [degC] (table 7.2, current tests), beta, h_f, h_s [W/m2K] (table 7.1,
# current tests)
_RESULTS = {
    "A1": (10.0, 84.6, 73.0, 0.77, 616, 235),
    "A2": (16.7, 100.8, 82.0, 0.70, 550, 210),
    "A3": (22.9, 114.7, 91.1, 0.69, 617, 235),
    "A4": (29.4, 129.2, 100.6, 0.67, 643, 245),
    "B1": (8.9, 85.5, 73.1, 0.75, 731, 279),
    "B2": (16.2, 108.8, 87.0, 0.70, 714, 272),
    "B3": (21.2, 121.8, 95.8, 0.70, 734, 280),
    "B4": (26.4, 137.6, 106.3, 0.67, 772, 295),
    "C1": (7.7, 88.4, 76.3, 0.73, 609, 232),
    "C2": (14.3, 112.6, 91.8, 0.70, 705, 269),
    "C3": (19.2, 128.0, 101.9, 0.69, 752, 287),
    "C4": (23.9, 142.9, 111.8, 0.67, 730, 279),
    "D1": (7.8, 89.9, 80.5, 0.68, 632, 241),
    "D2": (14.1, 121.0, 102.1, 0.67, 777, 297),
    "D3": (17.8, 136.8, 112.3, 0.66, 746, 285),
    "D4": (22.0, 155.4, 125.2, 0.65, 721, 275),
}


def _condition_of(name: str) -> EhlCondition:
    """Return the test of that name from the tables."""
    load = _LOADS[int(name[1])]
    speeds = _SPEEDS[name[0]]
    return EhlCondition(name, *load, *speeds, *_RESULTS[name])


# All tests by name.
PROGRAMME: dict[str, EhlCondition] = {name: _condition_of(name) for name in _RESULTS}


def ehl_test(name: str) -> EhlCondition:
    """Return the test of that name, A1 to D4.

    Raises
    ------
    InputError
        For any other name.

    Examples
    --------
    >>> ehl_test("D4").load_N, round(ehl_test("D4").sliding_speed_m_s, 1)
    (2320.0, 20.0)
    """
    try:
        return PROGRAMME[name.upper()]
    except KeyError:
        raise InputError(f"no EHL test {name!r}", expected="one of A1 to D4 (table 6.1)") from None
