"""Type J thermocouples (iron against constantan): millivolts and degrees Celsius on ITS-90, both ways."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import InputError

LOW_DEGC, HIGH_DEGC = -210.0, 1200.0
_JOIN_DEGC = 760.0

# NIST ITS-90 Thermocouple Database (Monograph 175), type J: E [mV] in ascending powers of T [degC]
_EMF_BELOW = (
    0.0,
    0.503811878150e-01,
    0.304758369300e-04,
    -0.856810657200e-07,
    0.132281952950e-09,
    -0.170529583370e-12,
    0.209480906970e-15,
    -0.125383953360e-18,
    0.156317256970e-22,
)
_EMF_ABOVE = (
    0.296456256810e03,
    -0.149761277860e01,
    0.317871039240e-02,
    -0.318476867010e-05,
    0.157208190040e-08,
    -0.306913690560e-12,
)
# the same source's inverse, T [degC] in powers of E [mV], good to 0.05 degC: where Newton's steps start
_INVERSE: tuple[tuple[float, tuple[float, ...]], ...] = (
    (
        0.0,
        (
            0.0,
            1.9528268e01,
            -1.2286185e00,
            -1.0752178e00,
            -5.9086933e-01,
            -1.7256713e-01,
            -2.8131513e-02,
            -2.3963370e-03,
            -8.3823321e-05,
        ),
    ),
    (
        42.919,
        (0.0, 1.978425e01, -2.001204e-01, 1.036969e-02, -2.549687e-04, 3.585153e-06, -5.344285e-08, 5.099890e-10),
    ),
    (np.inf, (-3.11358187e03, 3.00543684e02, -9.94773230e00, 1.70276630e-01, -1.43033468e-03, 4.73886084e-06)),
)
Outside = Literal["refuse", "nan"]


def emf_mV(temperature_degC: ArrayLike, *, outside: Outside = "refuse") -> NDArray[np.float64]:
    """E(T) [mV] of a type J couple with its reference junction at 0 degC; E = sum c_i T^i (ITS-90).

    ``temperature_degC`` of any shape [degC], -210 to 1200; NaN stays NaN. Values outside are refused, or become
    NaN with ``outside="nan"``. Raises InputError that names the first value outside.

    >>> emf_mV([25.0, 100.0]).round(5).tolist()
    [1.27729, 5.26892]
    """
    t = _checked(temperature_degC, LOW_DEGC, HIGH_DEGC, "degC", outside)
    below = np.polynomial.polynomial.polyval(t, _EMF_BELOW)
    above = np.polynomial.polynomial.polyval(t, _EMF_ABOVE)
    return np.asarray(np.where(t > _JOIN_DEGC, above, below))


def sensitivity_mV_K(temperature_degC: ArrayLike, *, outside: Outside = "refuse") -> NDArray[np.float64]:
    """dE/dT [mV/K], the Seebeck coefficient of type J; same shape and range as ``emf_mV``.

    >>> round(float(sensitivity_mV_K(0.0)), 4)
    0.0504
    """
    t = _checked(temperature_degC, LOW_DEGC, HIGH_DEGC, "degC", outside)
    poly = np.polynomial.polynomial
    below = poly.polyval(t, poly.polyder(np.array(_EMF_BELOW)))
    above = poly.polyval(t, poly.polyder(np.array(_EMF_ABOVE)))
    return np.asarray(np.where(t > _JOIN_DEGC, above, below))


def temperature_degC(
    measured_mV: ArrayLike, cold_junction_degC: ArrayLike = 0.0, *, outside: Outside = "refuse"
) -> NDArray[np.float64]:
    """T [degC] of the hot junction from the measured emf [mV]: E(T) = measured + E(cold junction).

    Any shapes that broadcast. NIST's inverse polynomial, then Newton steps on ``emf_mV`` itself, so that both ways
    agree to 1e-9 degC. Raises InputError that names the first value outside -210 to 1200 degC.

    >>> round(float(temperature_degC(5.26892 - 1.27729, cold_junction_degC=25.0)), 3)
    100.0
    """
    reference = np.asarray(cold_junction_degC, dtype=float)
    total = np.asarray(measured_mV, dtype=float) + (emf_mV(reference) if np.any(reference != 0.0) else 0.0)
    low, high = (float(emf_mV(t)) for t in (LOW_DEGC, HIGH_DEGC))
    e = _checked(total, low, high, "mV", outside)
    start = np.full_like(e, np.nan)
    floor = -np.inf
    for ceiling, coefficients in _INVERSE:
        here = (e > floor) & (e <= ceiling)
        start = np.where(here, np.polynomial.polynomial.polyval(e, coefficients), start)
        floor = ceiling
    t = np.clip(start, LOW_DEGC, HIGH_DEGC)
    for _ in range(3):
        t = np.clip(t - (emf_mV(t) - e) / sensitivity_mV_K(t), LOW_DEGC, HIGH_DEGC)
    return np.asarray(t)


def _checked(values: ArrayLike, low: float, high: float, unit: str, outside: Outside) -> NDArray[np.float64]:
    x = np.asarray(values, dtype=float)
    slack = 1e-9 * (high - low)
    bad = (x < low - slack) | (x > high + slack)
    if not bad.any():
        return x
    if outside == "nan":
        return np.where(bad, np.nan, x)
    first = tuple(int(i) for i in np.argwhere(bad)[0])
    raise InputError(
        f"type J: {x[first]:.6g} {unit}" + (f" at index {first[0] if len(first) == 1 else first}" if first else ""),
        expected=f"{low:.6g} to {high:.6g} {unit}",
        remedy="check the unit and the wiring",
    )
