"""Thermocouples of types E, J, K, N and T on ITS-90: emf from temperature, temperature from emf.

Used by :mod:`tcdyn.rig.opened_log` and :mod:`tcdyn.series.units` for columns in millivolts, and by
``tcdyn verify``. Source of the coefficients: NIST Monograph 175 (ITS-90). Tests:
``tests/series/test_thermocouple_types.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.table import CHUNK_ROWS, Columns, Table

# Rounding error [mV] that is allowed at both ends of the range.
ROUNDING_mV = 1e-7


@dataclass(frozen=True)
class _Reference:
    """Reference function of one type: E [mV] in ascending powers of T [degC].

    Parameters
    ----------
    low_degC, high_degC
        Range. It begins where tables of the inverse begin; below, 0.01 mV are several kelvin.
    join_degC
        Temperature that separates the two polynomials.
    below, above
        Coefficients below and above ``join_degC``.
    bump
        (a0, a1, a2) of the term a0 exp(a1 (T - a2)^2) that type K adds above ``join_degC``.
    """

    low_degC: float
    join_degC: float
    high_degC: float
    below: tuple[float, ...]
    above: tuple[float, ...]
    bump: tuple[float, float, float] = (0.0, 0.0, 0.0)


# NIST ITS-90 Thermocouple Database (Monograph 175)
REFERENCES: dict[str, _Reference] = {
    "E": _Reference(
        -200.0,
        0.0,
        1000.0,
        (
            0.0,
            0.586655087080e-01,
            0.454109771240e-04,
            -0.779980486860e-06,
            -0.258001608430e-07,
            -0.594525830570e-09,
            -0.932140586670e-11,
            -0.102876055340e-12,
            -0.803701236210e-15,
            -0.439794973910e-17,
            -0.164147763550e-19,
            -0.396736195160e-22,
            -0.558273287210e-25,
            -0.346578420130e-28,
        ),
        (
            0.0,
            0.586655087100e-01,
            0.450322755820e-04,
            0.289084072120e-07,
            -0.330568966520e-09,
            0.650244032700e-12,
            -0.191974955040e-15,
            -0.125366004970e-17,
            0.214892175690e-20,
            -0.143880417820e-23,
            0.359608994810e-27,
        ),
    ),
    "J": _Reference(
        -210.0,
        760.0,
        1200.0,
        (
            0.0,
            0.503811878150e-01,
            0.304758369300e-04,
            -0.856810657200e-07,
            0.132281952950e-09,
            -0.170529583370e-12,
            0.209480906970e-15,
            -0.125383953360e-18,
            0.156317256970e-22,
        ),
        (
            0.296456256810e03,
            -0.149761277860e01,
            0.317871039240e-02,
            -0.318476867010e-05,
            0.157208190040e-08,
            -0.306913690560e-12,
        ),
    ),
    "K": _Reference(
        -200.0,
        0.0,
        1372.0,
        (
            0.0,
            0.394501280250e-01,
            0.236223735980e-04,
            -0.328589067840e-06,
            -0.499048287770e-08,
            -0.675090591730e-10,
            -0.574103274280e-12,
            -0.310888728940e-14,
            -0.104516093650e-16,
            -0.198892668780e-19,
            -0.163226974860e-22,
        ),
        (
            -0.176004136860e-01,
            0.389212049750e-01,
            0.185587700320e-04,
            -0.994575928740e-07,
            0.318409457190e-09,
            -0.560728448890e-12,
            0.560750590590e-15,
            -0.320207200030e-18,
            0.971511471520e-22,
            -0.121047212750e-25,
        ),
        (0.118597600000, -0.118343200000e-03, 0.126968600000e03),
    ),
    "N": _Reference(
        -200.0,
        0.0,
        1300.0,
        (
            0.0,
            0.261591059620e-01,
            0.109574842280e-04,
            -0.938411115540e-07,
            -0.464120397590e-10,
            -0.263033577160e-11,
            -0.226534380030e-13,
            -0.760893007910e-16,
            -0.934196678350e-19,
        ),
        (
            0.0,
            0.259293946010e-01,
            0.157101418800e-04,
            0.438256272370e-07,
            -0.252611697940e-09,
            0.643118193390e-12,
            -0.100634715190e-14,
            0.997453389920e-18,
            -0.608632456070e-21,
            0.208492293390e-24,
            -0.306821961510e-28,
        ),
    ),
    "T": _Reference(
        -200.0,
        0.0,
        400.0,
        (
            0.0,
            0.387481063640e-01,
            0.441944343470e-04,
            0.118443231050e-06,
            0.200329735540e-07,
            0.901380195590e-09,
            0.226511565930e-10,
            0.360711542050e-12,
            0.384939398830e-14,
            0.282135219250e-16,
            0.142515947790e-18,
            0.487686622860e-21,
            0.107955392700e-23,
            0.139450270620e-26,
            0.797951539270e-30,
        ),
        (
            0.0,
            0.387481063640e-01,
            0.332922278800e-04,
            0.206182434040e-06,
            -0.218822568460e-08,
            0.109968809280e-10,
            -0.308157587720e-13,
            0.454791352900e-16,
            -0.275129016730e-19,
        ),
    ),
}


def emf_mV(temperature_degC: ArrayLike, thermocouple_type: str = "J") -> Array:
    """Emf E(T) [mV] of a thermocouple with its reference junction at 0 degC.

    Parameters
    ----------
    temperature_degC
        Any shape: -200 (J: -210) to 1000 (E), 1200 (J), 1372 (K), 1300 (N), 400 (T) degC. NaN stays
        NaN.
    thermocouple_type
        Type: E, J, K, N or T.

    Returns
    -------
    emf
        Of the shape of ``temperature_degC``.

    Raises
    ------
    InputError
        The first value out of range, or an unknown type.

    Notes
    -----
    E = sum c_i T^i (ITS-90).

    To add a type, add it to ``REFERENCES``. The emf must rise over its whole range, or the inverse
    fails: ``tests/series/test_thermocouple_types.py``.

    Examples
    --------
    >>> emf_mV([25.0, 100.0]).round(5).tolist(), float(emf_mV(100.0, "K").round(3))
    ([1.27729, 5.26892], 4.096)
    """
    ref = _reference(thermocouple_type)
    t = np.asarray(temperature_degC, dtype=float)
    _check_range(thermocouple_type, t, ref.low_degC, ref.high_degC, "degC")
    return _emf(ref, t)


def temperature_degC(
    measured_mV: ArrayLike,
    cold_junction_degC: ArrayLike = 0.0,
    thermocouple_type: str = "J",
    *,
    outside: Literal["refuse", "inf"] = "refuse",
) -> Array:
    """Temperature T [degC] of the hot junction from the measured emf.

    Parameters
    ----------
    measured_mV
        Measured emf [mV], any shape.
    cold_junction_degC
        One number, or an array of the shape of ``measured_mV``.
    thermocouple_type
        Type: E, J, K, N or T.
    outside
        What to do with values out of range: "refuse" raises an error, "inf" returns infinity.

    Returns
    -------
    temperature
        Of the shape of ``measured_mV``.

    Raises
    ------
    InputError
        The first value out of the range of the type.

    Notes
    -----
    Solves E(T) = measured + E(cold junction): linear interpolation of ``emf_mV`` at every degree,
    then Newton steps, so that both directions agree to 1e-9 degC.

    Examples
    --------
    >>> round(float(temperature_degC(5.26892 - 1.27729, cold_junction_degC=25.0)), 3)
    100.0
    """
    ref = _reference(thermocouple_type)
    e = np.asarray(measured_mV, dtype=float) + emf_mV(cold_junction_degC, thermocouple_type)
    degrees, grid = _inversion_grid(thermocouple_type)
    low_mV = float(grid[0])
    high_mV = float(grid[-1])
    if outside == "refuse":
        _check_range(thermocouple_type, e, low_mV, high_mV, "mV")
    t = np.interp(e, grid, degrees)
    for _ in range(3):
        t = np.clip(t - (_emf(ref, t) - e) / _seebeck_mV_per_K(ref, t), ref.low_degC, ref.high_degC)
    is_outside = (e < low_mV - ROUNDING_mV) | (e > high_mV + ROUNDING_mV)
    return np.asarray(np.where(is_outside, np.copysign(np.inf, e), t))


def convert_columns(table: Table, conversions: Mapping[str, Callable[[Array], Array]]) -> Table:
    """A table with some columns converted as they are read.

    Parameters
    ----------
    table
        The opened file.
    conversions
        Functions of an array, by name in the file.
    """
    if not conversions:
        return table

    def pieces(requested: Sequence[str], rows: int = CHUNK_ROWS) -> Iterator[Columns]:
        """Chunks of the table with the converted columns."""
        for chunk in table.chunks(requested, rows):
            converted = {
                name: conversions[name](values)
                for name, values in chunk.data.items()
                if name in conversions
            }
            yield replace(chunk, data=chunk.data | converted)

    return replace(table, chunks=pieces)


def to_degC(
    unit: str, thermocouple_type: str = "J", cold_junction_degC: Array | float = 0.0
) -> Callable[[Array], Array]:
    """The conversion to degC of a column in another unit.

    Parameters
    ----------
    unit
        "K", "degF" or "mV".
    thermocouple_type
        Type, for mV.
    cold_junction_degC
        Temperature of the reference junction, for mV.

    Returns
    -------
    conversion
        Function of an array; infinite for an emf out of range.

    Examples
    --------
    >>> float(to_degC("K")(np.array(300.0))), float(to_degC("degF")(np.array(212.0)))
    (26.850000000000023, 100.0)
    """
    return {
        "K": lambda x: x - 273.15,
        "degF": lambda x: (x - 32) / 1.8,
        "mV": lambda x: temperature_degC(x, cold_junction_degC, thermocouple_type, outside="inf"),
    }[unit]


def _reference(couple: str) -> _Reference:
    """Reference function of a type; InputError for an unknown one."""
    if couple not in REFERENCES:
        raise InputError(
            f"there is no thermocouple of type {couple!r} here", expected=" or ".join(REFERENCES)
        )
    return REFERENCES[couple]


@lru_cache
def _inversion_grid(couple: str) -> tuple[Array, Array]:
    """Every degree of the range, the start values of Newton's method, and the emf there.

    Returns
    -------
    degrees
        Every degree of the range (N,).
    emf
        (N,) [mV].
    """
    ref = REFERENCES[couple]
    degrees: Array = np.arange(ref.low_degC, ref.high_degC + 1.0, dtype=np.float64)
    return degrees, _emf(ref, degrees)


def _emf(ref: _Reference, t: Array) -> Array:
    """Emf [mV] of temperatures within the range."""
    a0, a1, a2 = ref.bump
    above = polyval(t, ref.above) + a0 * np.exp(a1 * (t - a2) ** 2)
    return np.asarray(np.where(t > ref.join_degC, above, polyval(t, ref.below)))


def _seebeck_mV_per_K(ref: _Reference, t: Array) -> Array:
    """Seebeck coefficient dE/dT of the reference function [mV/K].

    Parameters
    ----------
    ref
        Reference function.
    t
        Temperatures of any shape [degC], within the range of ``ref``.

    Returns
    -------
    seebeck
        Coefficients of the same shape [mV/K].
    """
    a0, a1, a2 = ref.bump
    bump_slope = 2 * a0 * a1 * (t - a2) * np.exp(a1 * (t - a2) ** 2)
    above = polyval(t, polyder(ref.above)) + bump_slope
    return np.asarray(np.where(t > ref.join_degC, above, polyval(t, polyder(ref.below))))


def _check_range(couple: str, values: Array, low: float, high: float, unit: str) -> None:
    """Raise InputError for the first value that is out of range.

    Parameters
    ----------
    couple
        Type, for the message.
    values
        Values of any shape.
    low, high
        Range.
    unit
        Unit of the values, for the message.
    """
    is_outside = (values < low - ROUNDING_mV) | (values > high + ROUNDING_mV)
    if not is_outside.any():
        return
    index = tuple(int(i) for i in np.argwhere(is_outside)[0])
    location = ""
    if index:
        location = f" at index {index[0] if len(index) == 1 else index}"
    raise InputError(
        f"type {couple}: {values[index]:.6g} {unit}{location}",
        expected=f"{low:.6g} to {high:.6g} {unit}",
        remedy="check the unit and the wiring",
    )
