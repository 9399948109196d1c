"""How the frictional heat falls across the running track, as ``rig.toml`` states it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

FluxKind = Literal["hertz", "flat", "barus", "table"]


@dataclass(frozen=True)
class FluxProfile:
    """Shape and place of the heat flux across the track; the default is the thesis's (3.32).

    ``hertz``: the parabola of Hertz's pressure; ``flat``: even over the contact's width; ``barus``: heat goes with the
    lubricant's viscosity under Hertz's pressure p, exp(alpha p), summed along rolling; ``table``: ``weight`` at
    ``at_m`` from the centre plane, straight between, nothing outside. ``shift_m``: centre of the flux beside the centre
    plane, positive away from the face that z counts from [m]; ``viscosity_per_Pa``: alpha [1/Pa]; ``pressure_Pa``:
    greatest pressure of the contact, which the load of a test tells.
    """

    kind: FluxKind = "hertz"
    shift_m: float = 0.0
    viscosity_per_Pa: float = 0.0
    pressure_Pa: float = 0.0
    at_m: tuple[float, ...] = ()
    weight: tuple[float, ...] = ()

    @property
    def exponent(self) -> float:
        """alpha p_0: logarithm of how much more viscous the oil is at the greatest pressure [1]."""
        return self.viscosity_per_Pa * self.pressure_Pa

    def under(self, pressure_Pa: float) -> FluxProfile:
        """The profile under a contact's greatest pressure [Pa], which only Barus's heeds.

        >>> FluxProfile("barus", viscosity_per_Pa=1e-8).under(1e9).exponent
        10.0
        """
        return replace(self, pressure_Pa=pressure_Pa) if self.kind == "barus" else self


HERTZ_FLUX = FluxProfile()
