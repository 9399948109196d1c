"""Boundary layer of a plunged sensor: h of a cylinder in crossflow, and the lag in another stream.

``tcdyn.sensors.plunge`` writes its results to the sensor file, ``tcdyn sensor`` builds it from the
options. ``tests/sensors/test_sensor_plunge.py`` compares h with Hilpert's numbers and checks the
uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot, log

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors.file import SHARES
from tcdyn.sensors.medium import MAX_SPEED_M_S, Surroundings, nusselt_cross_flow

U_REL = 0.15  # relative standard uncertainty of the correlation: it fits measurements to 20 to 30 %
# Volumetric heat capacity of core, powder and sheath [J/m3K], and its relative standard
# uncertainty: mean and standard deviation over the priors of ``tcdyn.sensors.construction``,
# with what a radial model leaves out (test_predict.py).
RHO_C_J_M3K = 3.25e6
RHO_C_U_REL = 0.09
# Largest standard uncertainty of a time in another stream by the form of the response, over the
# lag; by judgement.
TIMES_U = 0.1
# Possible diameters [m]; chosen by judgement, so that another unit is recognised.
DIAMETER_RANGE_M = (1e-5, 0.2)


@dataclass(frozen=True)
class Stream:
    """A fluid in crossflow at 25 degC.

    Attributes
    ----------
    k_W_mK
        Conductivity [W/mK].
    nu_m2_s
        Kinematic viscosity [m2/s].
    prandtl
        Prandtl number.
    speed_m_s
        Speed [m/s].
    """

    k_W_mK: float
    nu_m2_s: float
    prandtl: float
    speed_m_s: float

    def h_W_m2K(self, diameter_m: float) -> float:
        """Return the mean h of a cylinder in crossflow [W/m2K] (Churchill and Bernstein 1977).

        Parameters
        ----------
        diameter_m
            Diameter of the cylinder [m].

        Returns
        -------
        float
            Heat transfer coefficient; valid for Re Pr above 0.2.

        Notes
        -----
        See :func:`tcdyn.sensors.medium.nusselt_cross_flow`.

        Examples
        --------
        >>> round(STREAMS["water"].h_W_m2K(3e-3)), round(STREAMS["air"].h_W_m2K(3e-3))
        (8381, 105)
        """
        reynolds = self.speed_m_s * diameter_m / self.nu_m2_s
        nusselt = float(nusselt_cross_flow(reynolds, self.prandtl))
        return nusselt * self.k_W_mK / diameter_m


# The two reference streams of response times: water at 0.4 m/s and air at 3 m/s (VDI/VDE 3522).
STREAMS = {"water": Stream(0.607, 0.893e-6, 6.1, 0.4), "air": Stream(0.0261, 15.7e-6, 0.71, 3.0)}


@dataclass(frozen=True)
class BoundaryLayer:
    """Boundary layer of a sensor in a stream.

    Attributes
    ----------
    medium
        "water" or "air".
    diameter_m
        Diameter of the sensor [m].
    speed_m_s
        Speed [m/s]; None for the reference speed.
    speed_u_m_s
        Standard uncertainty of the speed [m/s].

    Raises
    ------
    InputError
        For an unknown medium, or a diameter or speed that is not possible.
    """

    medium: str
    diameter_m: float
    speed_m_s: float | None = None
    speed_u_m_s: float = 0.0

    def __post_init__(self) -> None:
        """Check medium, diameter and speed.

        Raises
        ------
        InputError
            Where one of them is not possible.
        """
        if self.medium not in STREAMS:
            raise InputError(f"medium {self.medium!r}", expected=" or ".join(STREAMS))
        low, high = DIAMETER_RANGE_M
        possible_speed = self.speed_m_s is None or 0 < self.speed_m_s < MAX_SPEED_M_S
        if not low < self.diameter_m < high or not possible_speed:
            raise InputError(
                f"diameter {1e3 * self.diameter_m:g} mm, speed {self.speed_m_s} m/s",
                expected="0.01 to 200 mm, 0 to 200 m/s",
            )

    @property
    def stream(self) -> Stream:
        """The stream, at the specified speed."""
        reference = STREAMS[self.medium]
        if self.speed_m_s is None:
            return reference
        return replace(reference, speed_m_s=self.speed_m_s)

    @property
    def h_u_rel(self) -> float:
        """Relative standard uncertainty of h: correlation, and speed with the power 0.5."""
        return hypot(U_REL, 0.5 * self.speed_u_m_s / self.stream.speed_m_s)

    def to_fit(self, lag: Estimate) -> dict[str, object]:
        """Return the content of ``fit`` in a sensor file: h, and the lag in the other streams.

        Parameters
        ----------
        lag
            Lag in this stream [s].

        Returns
        -------
        dict
            Values by key.

        Notes
        -----
        The boundary layer adds rho c d/(4 h) to the lag of a long cylinder: lag' = lag + rho c d/4
        (1/h' - 1/h).

        The four sources of the uncertainty are h of both streams, the heat capacity and the lag.
        ``RHO_C_J_M3K`` and the properties of ``STREAMS`` may be changed;
        ``tests/sensors/test_sensor_plunge.py`` checks the sum of the sources.
        """
        h = self.stream.h_W_m2K(self.diameter_m)
        out: dict[str, object] = {
            "medium": self.medium,
            "speed_m_s": self.stream.speed_m_s,
            "diameter_mm": 1e3 * self.diameter_m,
            "h_W_m2K": Estimate.normal(h, self.h_u_rel * h).model_dump(),
        }
        heat_J_m2K = RHO_C_J_M3K * self.diameter_m / 4
        for name, other in STREAMS.items():
            if other == self.stream:
                continue
            other_h = other.h_W_m2K(self.diameter_m)
            change_s = heat_J_m2K * (1 / other_h - 1 / h)
            change_u_s = hypot(
                heat_J_m2K / other_h * U_REL,
                heat_J_m2K / h * self.h_u_rel,
                change_s * RHO_C_U_REL,
            )
            out[f"lag_{name}_s"] = lag.shifted(change_s).with_error(change_u_s).model_dump()
        return out

    def in_other(
        self, lag: Estimate, times: Mapping[str, Estimate], to: Surroundings, to_speed_u: float
    ) -> dict[str, object]:
        """Return the content of ``fit`` in a sensor file: lag and times in any other stream.

        Parameters
        ----------
        lag, times
            Lag, and t50, t63.2 and t90 by their keys, in this stream [s].
        to
            The other stream, or a medium at rest.
        to_speed_u
            Relative standard uncertainty of its speed.

        Returns
        -------
        dict
            Values by key: ``to_medium``, ``to_lag_s``, ``to_t50_s`` and so on.

        Raises
        ------
        InputError
            Where the lag there is not above zero within its uncertainty: the sensor in this stream
            has less lag than its film alone.

        Notes
        -----
        lag' = lag + rho c d/4 (1/h' - 1/h), see :meth:`to_fit`. The film in this stream is taken
        from this formula, so that of water to air hardly anything but h' counts.

        What the film adds is one lag. The share of the lag that is added has the times of one lag,
        -ln(1 - q) lag'; the rest keeps the ratio of its times to the lag. Where the film becomes
        thinner, all of the times keep it. The difference from the other of both is taken as two
        standard uncertainties, at most ``TIMES_U`` of the lag.

        Examples
        --------
        >>> film = BoundaryLayer("water", 3e-3, 0.4)
        >>> there = film.in_other(Estimate.normal(1.2, 0.05), {}, Surroundings("air", 2.0), 0.07)
        >>> print(Estimate(**there["to_lag_s"]).text("s"))
        27.9 +- 4.8 s
        """
        h = self.stream.h_W_m2K(self.diameter_m)
        to_h = float(to.h_W_m2K(self.diameter_m))
        heat_J_m2K = RHO_C_J_M3K * self.diameter_m / 4
        change_s = heat_J_m2K * (1 / to_h - 1 / h)
        to_h_u = hypot(U_REL, 0.5 * to_speed_u)  # h goes with the root of the speed
        change_u_s = hypot(
            heat_J_m2K / to_h * to_h_u, heat_J_m2K / h * self.h_u_rel, change_s * RHO_C_U_REL
        )
        there = lag.shifted(change_s).with_error(change_u_s)
        if there.value <= 0:
            raise InputError(
                f"a lag of {lag.text('s')} in {self.medium} is less than its film, "
                f"{heat_J_m2K / h:.2g} s",
                expected="a diameter and a speed that belong to this sensor and this dip",
                parameters={"diameter_mm": None, "speed_m_s": None},
            )
        fit: dict[str, object] = {
            "to_medium": to.medium,
            "to_speed_m_s": to.speed_m_s,
            "to_T_degC": to.T_degC,
            "to_h_W_m2K": Estimate.normal(to_h, to_h_u * to_h).model_dump(),
            "to_lag_s": there.model_dump(),
        }
        new = max(change_s, 0.0) / there.value
        for key, time in times.items():
            ratio = time.value / lag.value
            one_lag = -log(1 - SHARES[key])
            to_ratio = (1 - new) * ratio + new * one_lag
            other = 0.5 * abs(to_ratio - (one_lag if new == 0 else ratio))
            fit[f"to_{key}"] = (
                there.scaled(to_ratio).with_error(min(other, TIMES_U) * there.value).model_dump()
            )
        return fit
