"""Profile of the frictional heat flux across the running track, as in ``rig.toml``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

FluxKind = Literal["hertz", "flat", "barus", "table"]


@dataclass(frozen=True)
class FluxProfile:
    """Profile of the heat flux across the track; the default is the thesis's (3.32).

    Parameters
    ----------
    kind
        "hertz": the parabola of Hertz's pressure; "flat": constant over the width of the contact;
        "barus": proportional to the viscosity of the lubricant under Hertz's pressure p, exp(alpha
        p), summed along rolling; "table": linear interpolation of ``weight``, zero outside.
    shift_m
        Distance of the centre of the flux from the centre plane, positive away from the face at z =
        0.
    viscosity_per_Pa
        alpha [1/Pa].
    pressure_Pa
        Maximum pressure of the contact; it follows from the load of a test.
    at_m, weight
        Positions from the centre plane and weights of a table.
    """

    kind: FluxKind = "hertz"
    shift_m: float = 0.0
    viscosity_per_Pa: float = 0.0
    pressure_Pa: float = 0.0
    at_m: tuple[float, ...] = ()
    weight: tuple[float, ...] = ()

    @property
    def exponent(self) -> float:
        """alpha p_0: logarithm of the relative viscosity of the oil at the maximum pressure [1]."""
        return self.viscosity_per_Pa * self.pressure_Pa

    def at_pressure(self, pressure_Pa: float) -> FluxProfile:
        """The profile at the maximum pressure of a contact [Pa]; only "barus" depends on it.

        >>> FluxProfile("barus", viscosity_per_Pa=1e-8).at_pressure(1e9).exponent
        10.0
        """
        return replace(self, pressure_Pa=pressure_Pa) if self.kind == "barus" else self


HERTZ_FLUX = FluxProfile()
