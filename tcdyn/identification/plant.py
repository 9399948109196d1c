"""The plant without its sensor: identification behind a sensor whose lag is known with its u.

The sensor is a known factor of every model (:class:`tcdyn.identification.models.KnownDynamics`).
What the uncertainty of the sensor does to the parameters follows from fits behind other sensors
within it. ``tcdyn.identification.compare`` uses it; ``tests/identify/test_plant.py`` checks
recovery, and ``tests/identify/plant_study.py`` coverage with simulations of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.arguments import described
from tcdyn.core.errors import InputError
from tcdyn.core.findings import info
from tcdyn.core.options import parse_number_with_u
from tcdyn.identification.identified import Identified
from tcdyn.identification.models import KnownDynamics, Model, behind_known
from tcdyn.identification.search import Fit
from tcdyn.rig.record import ChannelChain

# Fraction of its lag that a sensor keeps where its u is as large as the lag: a lag is positive.
MIN_LAG_SHARE = 0.05
EXPECTED = (
    "a lag in seconds (25, (25, 1) or '25+-1'), a Chain, a KnownSensor, or a column of a sensor "
    "file, as read_sensor('probe.sensor.json')['T1']"
)

# Fit of a model near the parameters of another fit and under its setting; None where it fails.
FitNear = Callable[[Model, Fit], Fit | None]


@dataclass(frozen=True)
class KnownSensor:
    """A sensor whose dynamics are known with an uncertainty.

    Parameters
    ----------
    chain
        Its transfer function, with the filter behind it.
    lag_u_s
        Standard uncertainty of its lag [s].
    split_u_s
        Standard uncertainty of its largest time constant at fixed lag [s].

    Examples
    --------
    >>> KnownSensor.of("25+-1").chain.lag_s
    25.0
    """

    chain: Chain
    lag_u_s: float = 0.0
    split_u_s: float = 0.0

    @classmethod
    def of(cls, given: Any) -> KnownSensor:
        """Return the sensor that a caller gave.

        Parameters
        ----------
        given
            A lag [s] with or without its standard uncertainty, a chain, a column of a sensor file,
            or a KnownSensor. A lag that is a number is divided as ``tcdyn sensor new`` does.

        Raises
        ------
        InputError
            For something else.
        """
        if isinstance(given, KnownSensor):
            return given
        if isinstance(given, Chain):
            return cls(given)
        if isinstance(given, ChannelChain):
            parameters = given.model_dump(exclude={"lag_s", "split_u_s"})
            return cls(Chain(**parameters), given.lag_s.u, given.split_u_s)
        number = parse_number_with_u(given) if isinstance(given, str) else given
        pair = number if isinstance(number, tuple | list) else (number, 0.0)
        try:
            lag_s, u_s = (float(value) for value in pair)
        except (TypeError, ValueError):
            raise InputError(f"sensor is {described(given)}", expected=EXPECTED) from None
        if not (0 < lag_s < np.inf and 0 <= u_s < np.inf):
            raise InputError(
                f"sensor is a lag of {lag_s:g} s with u = {u_s:g} s",
                expected="a lag above zero and a standard uncertainty of zero or more",
            )
        return cls(Chain(lag_s, is_stated=True), u_s)

    @property
    def known(self) -> KnownDynamics:
        """Its transfer function as a known factor."""
        return KnownDynamics.of(self.chain)

    def alternatives(self) -> list[tuple[float, Chain]]:
        """Return other sensors within the uncertainty, and their weights.

        Returns
        -------
        list of tuple
            The weights make the sum of squared differences from ``chain`` the variance: a half for
            each of two chains one standard uncertainty away, and the probability of each division
            of a lag of which only the sum is known.
        """
        others = []
        share = self.lag_u_s / self.chain.lag_s if self.chain.lag_s else 0.0
        if share:
            for factor in (1 + share, max(1 - share, MIN_LAG_SHARE)):
                others.append((0.5, _slower(self.chain, factor)))
        if self.split_u_s and len(self.chain.taus_s) > 1:
            for shift_s in (self.split_u_s, -self.split_u_s):
                others.append((0.5, self.chain.with_split_shift(shift_s)))
        if self.chain.is_stated:
            others += self.chain.divided()[1:]
        return others


def _slower(chain: Chain, factor: float) -> Chain:
    """The chain with all times of the sensor multiplied by a factor; its filter stays."""
    pair = None if chain.pair is None else (factor * chain.pair[0], chain.pair[1])
    return replace(
        chain,
        taus_s=tuple(factor * tau for tau in chain.taus_s),
        zero_s=factor * chain.zero_s,
        delay_s=factor * chain.delay_s,
        cement_s=factor * chain.cement_s,
        pair=pair,
    )


def without_sensor(result: Fit, sensor: KnownSensor, plant: Model, fit_near: FitNear) -> Fit:
    """Return the fit with the plant as its identified model.

    Parameters
    ----------
    result
        Fit of the plant behind the sensor, which is a known factor of the model.
    sensor
        The sensor.
    plant
        The model without the sensor.
    fit_near
        Fits the plant behind another sensor.

    Returns
    -------
    Fit
        With the model of the plant; its problem and residuals are those of the reading.

    Notes
    -----
    The covariance is V + sum_k w_k d_k d_k', with V that of the fit and d_k the change of the
    parameters behind the sensor k of :meth:`KnownSensor.alternatives` of weight w_k: the law of
    propagation of uncertainty (GUM, 5.1.2), with derivatives over one standard uncertainty.
    """
    identified = replace(result.identified, model=plant)
    changes = sensor_changes(result, sensor, plant, fit_near)
    finding = info(
        "model.without_sensor",
        subject=identified.output_name,
        lag_s=sensor.chain.lag_s,
        u_s=sensor.lag_u_s,
    )
    identified = _widened(identified, changes)
    findings = (*identified.findings, finding)
    return replace(result, identified=replace(identified, findings=findings))


def sensor_changes(result: Fit, sensor: KnownSensor, plant: Model, fit_near: FitNear) -> Array:
    """Return the changes (K, P) of the free parameters behind other sensors, times root weights.

    Parameters
    ----------
    result, sensor, plant, fit_near
        As in :func:`without_sensor`.
    """
    alternatives = sensor.alternatives()
    free = plant.free
    reference = fit_near(behind_known(plant, sensor.known), result) if alternatives else None
    rows = []
    for weight, chain in alternatives:
        other = fit_near(behind_known(plant, KnownDynamics.of(chain)), result)
        if reference is None or other is None:
            continue
        new = other.identified.theta
        old = reference.identified.theta
        rows.append(np.sqrt(weight) * np.array([new[name] - old[name] for name in free]))
    return np.array(rows).reshape(len(rows), len(free))


def _widened(identified: Identified, changes: Array) -> Identified:
    """The model with independent changes (K, P) of its parameters in its covariance."""
    further = changes.T @ changes
    u = np.sqrt(np.diag(further))
    return replace(
        identified,
        covariance=identified.covariance + further,
        parts=tuple(
            part._replace(covariance=part.covariance + further) for part in identified.parts
        ),
        estimates={
            name: estimate.with_error(float(error)) if error else estimate
            for (name, estimate), error in zip(identified.estimates.items(), u)
        },
    )
