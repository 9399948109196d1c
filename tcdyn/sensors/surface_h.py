"""Boundary layer of a plunged sensor: h of a cylinder in crossflow, and the lag in another stream.

``tcdyn.sensors.plunge`` writes its results to the sensor file, ``tcdyn sensor`` builds it from the
options. ``tests/sensors/test_sensor_plunge.py`` compares h with Hilpert's numbers and checks the
uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate

U_REL = 0.15  # relative standard uncertainty of the correlation: it fits measurements to 20 to 30 %
# Volumetric heat capacity of sheath and powder [J/m3K], and its relative standard uncertainty; by
# judgement.
RHO_C_J_M3K = 3.6e6
RHO_C_U_REL = 0.15
# Possible diameters [m] and largest speed [m/s]; chosen by judgement, so that another unit is
# recognised.
DIAMETER_RANGE_M = (1e-5, 0.2)
MAX_SPEED_M_S = 200.0


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
        Nu = 0.3 + 0.62 Re^1/2 Pr^1/3 [1 + (0.4/Pr)^2/3]^-1/4 [1 + (Re/282000)^5/8]^4/5

        Examples
        --------
        >>> round(STREAMS["water"].h_W_m2K(3e-3)), round(STREAMS["air"].h_W_m2K(3e-3))
        (8381, 105)
        """
        re = self.speed_m_s * diameter_m / self.nu_m2_s
        pr = self.prandtl
        laminar = 0.62 * re**0.5 * pr ** (1 / 3) / (1 + (0.4 / pr) ** (2 / 3)) ** 0.25
        nusselt = 0.3 + laminar * (1 + (re / 282e3) ** 0.625) ** 0.8
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

    Raises
    ------
    InputError
        For an unknown medium, or a diameter or speed that is not possible.
    """

    medium: str
    diameter_m: float
    speed_m_s: float | None = None

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
            "h_W_m2K": Estimate.normal(h, U_REL * h).model_dump(),
        }
        heat_J_m2K = RHO_C_J_M3K * self.diameter_m / 4
        for name, other in STREAMS.items():
            if other == self.stream:
                continue
            other_h = other.h_W_m2K(self.diameter_m)
            change_s = heat_J_m2K * (1 / other_h - 1 / h)
            change_u_s = hypot(
                heat_J_m2K / other_h * U_REL, heat_J_m2K / h * U_REL, change_s * RHO_C_U_REL
            )
            out[f"lag_{name}_s"] = lag.shifted(change_s).with_error(change_u_s).model_dump()
        return out
