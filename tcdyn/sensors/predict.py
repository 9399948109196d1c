"""Lag of a thermocouple in a stream before it is bought: prediction with its uncertainty.

Radial conduction (``tcdyn.sensors.layers``) and correlations of the surface coefficient
(``tcdyn.sensors.medium``) are propagated over the priors of ``tcdyn.sensors.construction``.
``python -m tests.sensors.predict_study`` compares the results with tables of makers;
``tests/sensors/test_predict.py`` checks the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tcdyn.chain.law import FlowLaw, TableLaw
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.options import options_of
from tcdyn.core.threads import one_blas_thread
from tcdyn.sensors.construction import CORE_W_MK, WIRE, DrawnSensors, drawn_sensors
from tcdyn.sensors.file import SHARES, SensorFile, specified_sensor
from tcdyn.sensors.layers import Responses
from tcdyn.sensors.medium import Surroundings
from tcdyn.sensors.options import PredictOptions
from tcdyn.sensors.surface_h import DIAMETER_RANGE_M

# Step of the logarithm of the speed with which the exponent of h is taken.
SPEED_STEP = 0.01
# Standard uncertainty of that exponent: the local slope of Churchill and Bernstein differs from
# Hilpert's 0.466 (Re 40 to 4000) and 0.618 (to 40 000) by 0.05 on average (test_predict.py).
EXPONENT_U = 0.05
# Radiation over h, and natural over forced convection, from which the lag is given as a table: a
# power of the speed is wrong then. By judgement; test_predict.py compares laws with predictions.
RADIATION_SHARE = 0.02
NATURAL_SHARE = 0.5
# Ratio of one speed of the table to the next, so that straight lines between them are within 2 % of
# a root of the speed; speeds on either side of the prediction, a factor of 58; relative standard
# uncertainty of its lags beside that of the lag, ``EXPONENT_U`` at twice the speed
TABLE_RATIO = 1.5
TABLE_STEPS = 10
TABLE_U_REL = 0.035
QUANTITY = "speed_m_s"  # name of the flow in the law of a file
# Numbers of frequencies of the phase and of the integral of the noise: finer grids change both by
# less than 0.1 %.
PHASE_POINTS = 200
NOISE_POINTS = 400
# Length over which exposed wires lead heat from the sheath, over its diameter, beyond which there
# is a warning: usual wires are exposed by about one diameter. By judgement.
EXPOSED_LENGTH = 0.5
# Relative standard uncertainty above which there is a warning; by judgement: with more, another
# construction is as likely.
ROUGH_U = 0.4
# Diameters of the makers' tables with which the constructions were compared [mm]
# (`python -m tests.sensors.predict_study`)
DESIGNS_MM = (0.5, 8.0)
LIMITS = ("the surface coefficient and the speed", "the construction, which the maker can state")


@with_named_arguments
@one_blas_thread
def predict_sensor(
    diameter_mm: float,
    medium: str,
    *,
    name: str = "sensor",
    columns: Sequence[str] = ("*",),
    **options: Any,
) -> SensorFile:
    """Lag, t50, t63.2 and t90 of a sheathed thermocouple in a stream, before it is bought.

    Parameters
    ----------
    diameter_mm
        Diameter of the sheath [mm].
    medium
        water, air, oil, or a table of properties (.csv).
    name
        Name of the sensor.
    columns
        Columns of a table to which the file applies.
    options
        The fields of :class:`tcdyn.sensors.options.PredictOptions`, such as ``speed_m_s=0.4``,
        ``junction="grounded"``, ``T_degC=300`` and ``well_mm=10``.

    Returns
    -------
    SensorFile
        A stated sensor. Each time has its standard uncertainty u and its 95 % interval; the keys
        ``U_...`` of ``fit`` are the expanded uncertainties (k = 2).

    Raises
    ------
    InputError
        For a size, speed or temperature that is not possible.

    Notes
    -----
    The priors of the construction, the correlation, the speed and the diameter are drawn by a
    designed sample; results are means and standard deviations over it, and repeat.

    The law of the flow has the local exponent of h, and as inner share what is left of the lag
    without heat capacity over h and area. Where radiation is more than a twentieth of h, or natural
    convection more than half of the forced one, it is a table of lags against the speed.

    ``fastest_Hz`` is the largest f for which the noise that an exact inverse of the sensor leaves
    in the band up to f is not above ``accuracy_K``: the integral of 2 s^2 dt / |G|^2 from 0 to f
    is its square, with white noise s in rows every dt (Bendat and Piersol, Random Data, section
    6.1: the spectrum of an output is that of the input times the squared gain).
    :mod:`tcdyn.smoothing.resolution` asks for the time whose means a record determines; that needs
    the intensity of the temperature, which is not known before the record.

    Examples
    --------
    >>> probe = predict_sensor(3.0, "water", speed_m_s=0.4)
    >>> print(probe.lag_s.text("s"))
    1.12 +- 0.34 s (95 %: 0.57 to 1.84)
    >>> probe.law.quantity
    'speed_m_s'
    """
    settings = options_of(PredictOptions, options, "predict_sensor")
    low, high = (1e3 * limit for limit in DIAMETER_RANGE_M)
    if not low < diameter_mm < high:
        raise InputError(
            f"{{diameter_mm}} is {diameter_mm:g}",
            expected=f"{low:g} to {high:g} mm",
            parameters={"diameter_mm": None},
        )
    speed_m_s, speed_u_m_s = settings.speed
    surroundings = Surroundings(medium, speed_m_s, settings.T_degC)
    well = settings.well(diameter_mm)
    drawn = drawn_sensors(diameter_mm, settings.junction, surroundings, speed_u_m_s, well)
    lag = estimate_over(drawn.responses.lags_s)
    times = {key: estimate_over(drawn.responses.times_s(share)) for key, share in SHARES.items()}
    fit: dict[str, Any] = {
        "lag_s": lag.model_dump(),
        "limited_by": _limited_by(drawn),
        **{f"U_{key}": 2 * estimate.u for key, estimate in (("lag_s", lag), *times.items())},
        "diameter_mm": float(diameter_mm),
        "junction": settings.junction,
        "medium": medium,
        "speed_m_s": speed_m_s,
        "T_degC": settings.T_degC,
        "h_W_m2K": estimate_over(drawn.h_W_m2K).model_dump(),
    }
    fit |= _use(drawn.responses, settings)
    probe = specified_sensor(
        name,
        list(columns),
        [(lag.value, lag.u)],
        is_bare=settings.junction == "exposed",
        law=_law(drawn, surroundings),
        lags=dict.fromkeys(columns, lag),
        times=dict.fromkeys(columns, times),
        fit=fit,
    )
    found = [*surroundings.findings(), *_exposed_findings(diameter_mm, drawn, settings)]
    if speed_m_s == 0:
        found.append(info("predict.still", medium=medium))
    smallest_mm, largest_mm = DESIGNS_MM
    if not smallest_mm <= diameter_mm <= largest_mm:
        found.append(
            warning(
                "predict.size",
                diameter_mm=diameter_mm,
                smallest_mm=smallest_mm,
                largest_mm=largest_mm,
            )
        )
    largest_u = max(estimate.u / estimate.value for estimate in (lag, *times.values()))
    if largest_u > ROUGH_U:
        found.append(warning("predict.rough", percent=100 * largest_u))
    return probe.model_copy(update={"findings": [*probe.findings, *found]})


def estimate_over(values: Array) -> Estimate:
    """Mean, standard deviation and 95 % interval over a sample (B,).

    >>> print(estimate_over(np.array([1.0, 2.0, 3.0])))
    2.00 +- 0.82 (95 %: 1.05 to 2.95)
    """
    low95, high95 = np.quantile(values, [0.025, 0.975])
    mean = float(np.mean(values))
    return Estimate(value=mean, u=float(np.std(values)), low95=float(low95), high95=float(high95))


def _limited_by(drawn: DrawnSensors) -> str:
    """What contributes more to the uncertainty of the lag: h, or all else."""
    lags = np.log(drawn.responses.lags_s)
    by_h = float(np.corrcoef(lags, np.log(drawn.h_W_m2K))[0, 1]) ** 2
    return LIMITS[0] if by_h > 0.5 else LIMITS[1]


def _law(drawn: DrawnSensors, surroundings: Surroundings) -> FlowLaw | TableLaw | None:
    """How the lag follows the speed; None at rest.

    A power of the speed where the flow makes nearly all of h, and otherwise a table: radiation adds
    to h at any speed, and natural convection replaces the flow at low ones.
    """
    speed = surroundings.speed_m_s
    if speed <= 0:
        return None
    d = float(np.median(drawn.surface_m))
    natural = float(surroundings.natural_W_m2K(d))
    is_radiating = surroundings.radiation_W_m2K() > RADIATION_SHARE * surroundings.h_W_m2K(d)
    if is_radiating or natural > NATURAL_SHARE * surroundings.forced_W_m2K(d):
        return _table_law(drawn, surroundings, d)
    step = np.exp(np.array([-SPEED_STEP, SPEED_STEP]))
    forced = surroundings.forced_W_m2K(d, speed * step)
    exponent = float(np.diff(np.log(forced))[0] / (2 * SPEED_STEP))
    least = float(f"{speed * (natural / float(forced.mean())) ** (1 / exponent):.2g}")
    inner = 1 - drawn.responses.film_s / drawn.responses.lags_s
    share = float(np.clip(inner.mean(), 0.0, 1.0))
    return FlowLaw(
        speed, exponent, EXPONENT_U, share, float(inner.std()), least=least, quantity=QUANTITY
    )


def _table_law(drawn: DrawnSensors, surroundings: Surroundings, diameter_m: float) -> TableLaw:
    """Lags at other speeds: the part of the lag by h is the heat capacity over h and area."""
    speed = surroundings.speed_m_s
    steps = range(-TABLE_STEPS, TABLE_STEPS + 1)
    speeds = [speed * TABLE_RATIO**step for step in steps]
    h = surroundings.h_W_m2K(diameter_m, np.array(speeds))
    thinner = float(surroundings.h_W_m2K(diameter_m)) / h
    film_s = float(drawn.responses.film_s.mean())
    inner_s = float(drawn.responses.lags_s.mean()) - film_s
    lags_s = (inner_s + film_s * thinner).tolist()
    return TableLaw(speed, speeds, lags_s, TABLE_U_REL, quantity=QUANTITY)


def _use(responses: Responses, settings: PredictOptions) -> dict[str, Any]:
    """What the lag means for a ramp, a frequency, and a record with noise."""
    out: dict[str, Any] = {}
    if settings.ramp_K_s:
        out["ramp_K_s"] = settings.ramp_K_s
        behind = estimate_over(responses.lags_s * abs(settings.ramp_K_s))
        out["ramp_error_K"] = behind.model_dump()
    if settings.at_Hz:
        grid = np.linspace(0.0, settings.at_Hz, PHASE_POINTS)
        amplitudes = np.array([responses.at_Hz(f) for f in grid])
        phase_deg = np.degrees(np.unwrap(np.angle(amplitudes), axis=0)[-1])
        out["at_Hz"] = settings.at_Hz
        out["amplitude_share"] = estimate_over(np.abs(amplitudes[-1])).model_dump()
        out["phase_deg"] = estimate_over(phase_deg).model_dump()
    if settings.noise_K:
        accuracy_K = settings.accuracy_K or settings.noise_K
        fastest = fastest_Hz(responses, settings.noise_K, settings.row_s, accuracy_K)
        out |= {
            "noise_K": settings.noise_K,
            "every_s": settings.row_s,
            "accuracy_K": accuracy_K,
            "fastest_Hz": estimate_over(fastest).model_dump(),
            "fastest_period_s": estimate_over(1 / fastest).model_dump(),
        }
    return out


def fastest_Hz(responses: Responses, noise_K: float, row_s: float, accuracy_K: float) -> Array:
    """Largest frequency (B,) up to which the noise of an exact inverse is within an accuracy.

    Parameters
    ----------
    responses
        The sensors.
    noise_K
        Standard deviation of the white noise of a row [K].
    row_s
        Time from row to row [s].
    accuracy_K
        The accuracy [K].

    Returns
    -------
    array
        Frequencies [Hz], at most half of the sampling rate.

    Examples
    --------
    Without a lag the noise of half of the band is 1/sqrt(2) of that of a row.

    >>> no_lag = Responses(np.full((1, 1), 1e-9), np.ones((1, 1)), np.zeros(1))
    >>> fastest_Hz(no_lag, 0.1, 0.5, 0.1 / 2**0.5).round(3)
    array([0.5])
    """
    nyquist_Hz = 0.5 / row_s
    slowest_Hz = min(1e-4 / float(responses.lags_s.max()), 1e-4 * nyquist_Hz)
    grid = np.append(0.0, np.geomspace(slowest_Hz, nyquist_Hz, NOISE_POINTS))
    gains = np.array([np.abs(responses.at_Hz(f)) for f in grid])
    density = 2 * noise_K**2 * row_s / np.maximum(gains, 1e-12) ** 2
    steps = np.diff(grid)[:, None] * 0.5 * (density[1:] + density[:-1])
    variance = np.vstack([np.zeros(gains.shape[1]), np.cumsum(steps, axis=0)])
    target = accuracy_K**2
    return np.array([np.interp(target, of_one, grid) for of_one in variance.T])


def _exposed_findings(
    diameter_mm: float, drawn: DrawnSensors, settings: PredictOptions
) -> list[Finding]:
    """A warning where exposed wires lead much heat from the sheath.

    A wire of conductivity k and diameter d leads heat over the length sqrt(k d / (4 h)) (fin).
    """
    if settings.junction != "exposed":
        return []
    wire_mm = diameter_mm * sum(WIRE) / 2
    h = float(np.median(drawn.h_W_m2K))
    length_mm = 1e3 * (sum(CORE_W_MK) / 2 * 1e-3 * wire_mm / (4 * h)) ** 0.5
    if length_mm < EXPOSED_LENGTH * diameter_mm:
        return []
    return [warning("predict.exposed", length_mm=length_mm)]
