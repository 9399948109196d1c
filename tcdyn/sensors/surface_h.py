"""The boundary layer about a plunged sensor: h of a cylinder across a stream, and the lag in another stream."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate

U_REL = 0.15  # of the correlation, 1 sd: it fits measurements to some 20 to 30 %
RHO_C = (
    3.6e6,
    0.15,
)  # volumetric heat capacity of sheath and powder [J/m3K], its relative standard uncertainty


@dataclass(frozen=True)
class Stream:
    """A fluid that flows across the sensor, at 25 degC: conductivity, kinematic viscosity, Prandtl number, speed."""

    k_W_mK: float
    nu_m2_s: float
    prandtl: float
    speed_m_s: float

    def h_W_m2K(self, diameter_m: float) -> float:
        """Mean h of a cylinder across the stream (Churchill and Bernstein 1977), for Re Pr above 0.2.

        Nu = 0.3 + 0.62 Re^1/2 Pr^1/3 [1 + (0.4/Pr)^2/3]^-1/4 [1 + (Re/282000)^5/8]^4/5

        >>> round(STREAMS["water"].h_W_m2K(3e-3)), round(STREAMS["air"].h_W_m2K(3e-3))
        (8381, 105)
        """
        re = self.speed_m_s * diameter_m / self.nu_m2_s
        pr = self.prandtl
        nu = (
            0.3
            + 0.62
            * re**0.5
            * pr ** (1 / 3)
            / (1 + (0.4 / pr) ** (2 / 3)) ** 0.25
            * (1 + (re / 282e3) ** 0.625) ** 0.8
        )
        return nu * self.k_W_mK / diameter_m


# the two reference streams of response times: water at 0.4 m/s and air at 3 m/s (VDI/VDE 3522)
STREAMS = {"water": Stream(0.607, 0.893e-6, 6.1, 0.4), "air": Stream(0.0261, 15.7e-6, 0.71, 3.0)}


@dataclass(frozen=True)
class Film:
    """Which stream a sensor of this diameter [m] stood in; ``speed_m_s`` where it was not the reference's."""

    medium: str
    diameter_m: float
    speed_m_s: float | None = None

    def __post_init__(self) -> None:
        if self.medium not in STREAMS:
            raise InputError(f"medium {self.medium!r}", expected=" or ".join(STREAMS))
        if not 1e-5 < self.diameter_m < 0.2 or not (
            self.speed_m_s is None or 0 < self.speed_m_s < 200
        ):
            raise InputError(
                f"diameter {1e3 * self.diameter_m:g} mm, speed {self.speed_m_s} m/s",
                expected="0.01 to 200 mm, 0 to 200 m/s",
            )

    @property
    def stream(self) -> Stream:
        """The stream, at the speed that was stated."""
        own = STREAMS[self.medium]
        return own if self.speed_m_s is None else replace(own, speed_m_s=self.speed_m_s)

    def to_fit(self, lag: Estimate) -> dict[str, object]:
        """What goes into a sensor file: h, and the lag in either reference stream by the film's part of it.

        A film adds rho c d/(4 h) to the lag of a long cylinder: lag' = lag + rho c d/4 (1/h' - 1/h).
        """
        h = self.stream.h_W_m2K(self.diameter_m)
        out: dict[str, object] = {
            "medium": self.medium,
            "speed_m_s": self.stream.speed_m_s,
            "diameter_mm": 1e3 * self.diameter_m,
            "h_W_m2K": Estimate.normal(h, U_REL * h).model_dump(),
        }
        for name, other in STREAMS.items():
            if other == self.stream:
                continue
            there = other.h_W_m2K(self.diameter_m)
            per = RHO_C[0] * self.diameter_m / 4
            more = per * (1 / there - 1 / h)
            u = hypot(per / there * U_REL, per / h * U_REL, more * RHO_C[1], lag.u)
            out[f"lag_{name}_s"] = Estimate.normal(lag.value + more, u).model_dump()
        return out
