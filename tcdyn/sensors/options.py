"""Options of the methods that measure a lag: one dataclass each, for the command and the function.

See :mod:`tcdyn.core.options`. Tests: ``tests/sensors/test_measure.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tcdyn.chain.known_filter import FilterOptions
from tcdyn.core.errors import InputError
from tcdyn.core.options import NumberWithU, number_with_u, option
from tcdyn.sensors.pair import EXPONENT
from tcdyn.sensors.plunge import MEDIUM_S
from tcdyn.sensors.step_structures import JUNCTIONS, Junction
from tcdyn.sensors.surface_h import BoundaryLayer
from tcdyn.series.options import TableOptions

UNIX_LIMIT = 1e12  # largest instant [s]: Unix times may be in milliseconds


@dataclass(frozen=True)
class DipOptions(FilterOptions, TableOptions):
    """How a dip is read and evaluated.

    Attributes
    ----------
    entry_s
        instant of entry on the clock of the table in seconds, with its standard uncertainty:
        12.3+-0.02; with several dips once for each, in their order
    medium_s
        time constant of the temperature step itself in seconds; it is not part of the lag
    medium
        water (0.4 m/s) or air (3 m/s), the reference streams of VDI/VDE 3522
    diameter_mm
        with {medium}: diameter of the sheath
    speed_m_s
        with {medium}: another speed of the stream
    junction
        axis (insulated, in the axis of the sheath) or sheath (welded to it)
    """

    entry_s: NumberWithU | Sequence[NumberWithU] | None = option(None, "Sensor", takes=list[str])
    medium_s: NumberWithU = option(f"{MEDIUM_S[0]:g}+-{MEDIUM_S[1]:g}", "Sensor", takes=str)
    medium: str | None = option(None, "Sensor")
    diameter_mm: float | None = option(None, "Sensor")
    speed_m_s: float | None = option(None, "Sensor")
    junction: Junction = option("axis", "Sensor", choices=JUNCTIONS, takes=str)

    @property
    def entries_s(self) -> list[tuple[float, float]] | None:
        """Instants of entry and their standard uncertainties [s]; None where none is given."""
        if self.entry_s is None:
            return None
        listed: list[Any] = self.entry_s if isinstance(self.entry_s, list) else [self.entry_s]
        return [number_with_u(each, "entry_s", UNIX_LIMIT) for each in listed]

    @property
    def lag_of_medium_s(self) -> tuple[float, float]:
        """Time constant of the temperature step and its standard uncertainty [s]."""
        return number_with_u(self.medium_s, "medium_s")

    @property
    def boundary_layer(self) -> BoundaryLayer | None:
        """The boundary layer of the dip; None without a medium.

        Raises
        ------
        InputError
            If one of medium and diameter is missing, or a speed has no medium.
        """
        if (self.medium is None) != (self.diameter_mm is None):
            raise InputError(
                "{medium} and {diameter_mm} go together",
                remedy="give both, or none",
                parameters={"medium": None, "diameter_mm": None},
            )
        if self.medium is not None and self.diameter_mm is not None:
            return BoundaryLayer(self.medium, 1e-3 * self.diameter_mm, self.speed_m_s)
        if self.speed_m_s is not None:
            raise InputError(
                "{speed_m_s} is given without {medium}",
                remedy="give both, or none",
                parameters={"speed_m_s": None, "medium": None},
            )
        return None


@dataclass(frozen=True)
class PairOptions(TableOptions):
    """How a pair of thermocouples is read and evaluated.

    Attributes
    ----------
    speed
        column of the flow speed v: lags are proportional to v^-n, n about 0.5
    exponent
        with {speed}: n and its standard uncertainty (default: 0.5+-0.1)
    flow_steps_s
        instant of a step of the flow in seconds; lags are constant between steps; repeat for
        several
    bare
        both are bare wires, which have one lag each
    """

    speed: str | None = option(None, "Sensor")
    exponent: NumberWithU | None = option(None, "Sensor", takes=str)
    flow_steps_s: Sequence[float] = option((), "Sensor", name="flow_step_s", takes=list[float])
    bare: bool = option(False, "Sensor")

    @property
    def prior_of_exponent(self) -> tuple[float, float]:
        """Exponent n and its standard uncertainty.

        Raises
        ------
        InputError
            For an exponent without a column of the speed.
        """
        if self.exponent is None:
            return EXPONENT
        if self.speed is None:
            raise InputError(
                "{exponent} is given without {speed}",
                remedy="give both, or none",
                parameters={"exponent": None, "speed": None},
            )
        return number_with_u(self.exponent, "exponent")


@dataclass(frozen=True)
class CurrentOptions(TableOptions):
    """How a loop current step is read and evaluated.

    Attributes
    ----------
    off_only
        use only rows without current, as a thermocouple cannot be read while heated
    """

    off_only: bool = option(False, "Sensor")
