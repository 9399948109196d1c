"""Options of the methods that measure a lag: one dataclass each, for the command and the function.

See :mod:`tcdyn.core.options`. Tests: ``tests/sensors/test_measure.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tcdyn.chain.known_filter import FilterOptions
from tcdyn.chain.law import AnyLaw, FlowLaw, TableLaw, TemperatureLaw
from tcdyn.core.errors import InputError
from tcdyn.core.options import NumberWithU, Options, number_with_u, option
from tcdyn.sensors.construction import (
    FILLINGS,
    JUNCTION_WORDS,
    SPEED_U_REL,
    Filling,
    JunctionWord,
    Well,
)
from tcdyn.sensors.dip_flows import DipFlows
from tcdyn.sensors.medium import Surroundings
from tcdyn.sensors.pair import EXPONENT, INNER_SHARE, MIN_SHARE_SD, NO_SHARE
from tcdyn.sensors.plunge import MEDIUM_S
from tcdyn.sensors.step_structures import JUNCTIONS, Junction
from tcdyn.sensors.surface_h import BoundaryLayer
from tcdyn.series.options import TableOptions

MOST_FLOW = 1e9  # beyond it a flow is a mistake
UNIX_LIMIT = 1e12  # largest instant [s]: Unix times may be in milliseconds


def quantity_and_value(at: str) -> tuple[str, float]:
    """The quantity that a lag follows, and a value of it, from a text.

    Parameters
    ----------
    at
        The text.

    Raises
    ------
    InputError
        For a text without one of them.

    Examples
    --------
    >>> quantity_and_value("speed_m_s=2")
    ('speed_m_s', 2.0)
    """
    quantity, is_given, value = (part.strip() for part in str(at).partition("="))
    if not is_given or not quantity:
        raise InputError(
            f"{{at}} is {at!r}",
            expected="a quantity and its value, such as speed_m_s=2",
            parameters={"at": None},
        )
    return quantity, number_with_u(value, "at")[0]


def _check_without_at(stated: Mapping[str, Any], names: Sequence[str]) -> None:
    """Check that none of some options is given, as there is no ``at``.

    Parameters
    ----------
    stated
        The options that are given.
    names
        Those that need ``at``.

    Raises
    ------
    InputError
        For one of them.
    """
    for name in names:
        if name in stated:
            raise InputError(
                f"{{{name}}} without {{at}}",
                remedy="give both, or none",
                parameters={name: None, "at": None},
            )


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
        with {medium}: another speed of the stream in m/s, with its standard uncertainty: 0.4+-0.05
    to_medium
        with {medium}: also the lag in this medium: water, air, oil, or a table of properties (.csv)
    to_speed_m_s
        with {to_medium}: its speed in m/s with its standard uncertainty; 0 is natural convection
    to_T_degC
        with {to_medium}: its temperature in degC
    at
        flow of the dip, or another quantity that the film follows: speed_m_s=2; with several dips
        once for each, in their order, and the dips determine the law of the lag
    exponent
        with {at}: exponent of the film, with its standard uncertainty (default 0.5+-0.1)
    inner_share
        with {at}: share of the lag that does not follow, with its standard uncertainty (default
        0.2+-0.1 with one dip; with several anything from 0 to 0.95)
    junction
        insulated (in the axis), grounded (welded to the sheath) or exposed (bare)
    """

    entry_s: NumberWithU | Sequence[NumberWithU] | None = option(None, "Sensor", takes=list[str])
    medium_s: NumberWithU = option(f"{MEDIUM_S[0]:g}+-{MEDIUM_S[1]:g}", "Sensor", takes=str)
    medium: str | None = option(None, "Sensor")
    diameter_mm: float | None = option(None, "Sensor")
    speed_m_s: NumberWithU | None = option(None, "Sensor", takes=str)
    to_medium: str | None = option(None, "Sensor")
    to_speed_m_s: NumberWithU | None = option(None, "Sensor", takes=str)
    to_T_degC: float = option(25.0, "Sensor", low=-100, high=1200)
    at: str | Sequence[str] | None = option(None, "Sensor", takes=list[str])
    exponent: NumberWithU = option("", "Sensor", takes=str)
    inner_share: NumberWithU = option("", "Sensor", takes=str)
    junction: Junction = option("insulated", "Sensor", choices=JUNCTIONS, takes=str)

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
            if self.speed_m_s is None:
                return BoundaryLayer(self.medium, 1e-3 * self.diameter_mm)
            speed_m_s, u = number_with_u(self.speed_m_s, "speed_m_s")
            return BoundaryLayer(self.medium, 1e-3 * self.diameter_mm, speed_m_s, u)
        if self.speed_m_s is not None:
            raise InputError(
                "{speed_m_s} is given without {medium}",
                remedy="give both, or none",
                parameters={"speed_m_s": None, "medium": None},
            )
        return None

    @property
    def flows(self) -> DipFlows | None:
        """Flow of each dip; None without ``at``.

        Raises
        ------
        InputError
            For dips of different quantities, dips that are all at one flow, and options that need
            ``at`` or exclude it.
        """
        if not self.at:
            _check_without_at(self.stated, ("exponent", "inner_share"))
            return None
        if self.medium is not None or self.diameter_mm is not None:
            raise InputError(
                "{at} with {medium} or {diameter_mm}",
                expected="the law of a flow, or the film in a reference stream",
                parameters={"at": None, "medium": None, "diameter_mm": None},
            )
        texts = [self.at] if isinstance(self.at, str) else list(self.at)
        quantities, values = zip(*(quantity_and_value(text) for text in texts))
        if len(set(quantities)) > 1:
            raise InputError(
                f"{{at}} names {' and '.join(dict.fromkeys(quantities))}",
                expected="one quantity, in one unit",
                parameters={"at": None},
            )
        exponent = number_with_u(self.exponent or EXPONENT, "exponent")
        share = None
        if self.inner_share != "":
            share = number_with_u(self.inner_share, "inner_share")
        flows = DipFlows(quantities[0], values, exponent, share)
        flows.check_range()
        return flows

    @property
    def other_stream(self) -> tuple[Surroundings, float] | None:
        """The other stream and the relative standard uncertainty of its speed; None without one.

        Raises
        ------
        InputError
            If one of medium and speed is missing, or the medium of the dip.
        """
        if self.to_medium is None and self.to_speed_m_s is None:
            return None
        if self.to_medium is None or self.to_speed_m_s is None or self.medium is None:
            raise InputError(
                "{medium}, {to_medium} and {to_speed_m_s} go together",
                remedy="give all, or none",
                parameters={"medium": None, "to_medium": None, "to_speed_m_s": None},
            )
        speed_m_s, u = number_with_u(self.to_speed_m_s, "to_speed_m_s")
        relative_u = u / speed_m_s if u and speed_m_s else SPEED_U_REL
        return Surroundings(self.to_medium, speed_m_s, self.to_T_degC), relative_u


@dataclass(frozen=True)
class LawOptions(Options):
    """How a lag that is stated follows another quantity.

    Attributes
    ----------
    at
        the lag follows a flow or another quantity: its name, as its column is usually named, and
        its value at which the lag holds: speed_m_s=2
    exponent
        with {at}: exponent of the film, with its standard uncertainty (default 0.5+-0.1)
    inner_share
        with {at}: share of the lag that does not follow, with its standard uncertainty (default
        0.2+-0.1 of a flow, else 0)
    least_flow
        with {at}: flow below which natural convection keeps the lag from rising
    per_degree
        with {at}, such as T_degC=20: share by which the lag falls per degree, with its standard
        uncertainty: 0.02+-0.005
    lag_table
        with {at}: lags measured at values of the quantity: 1:30,2:20,4:15; without {tau_s} the lag
        is that of the table
    """

    at: str = option("", "Sensor")
    exponent: NumberWithU = option("", "Sensor", takes=str)
    inner_share: NumberWithU = option("", "Sensor", takes=str)
    least_flow: float = option(0.0, "Sensor", low=0, high=MOST_FLOW)
    per_degree: NumberWithU = option("", "Sensor", takes=str)
    lag_table: str = option("", "Sensor")

    @property
    def law(self) -> AnyLaw | None:
        """The law; None without ``at``.

        Raises
        ------
        InputError
            For an ``at`` that is no quantity with its value, options of two laws, and options of a
            law without ``at``.
        """
        of_flow = [name for name in ("exponent", "least_flow") if name in self.stated]
        others = [name for name in ("per_degree", "lag_table") if name in self.stated]
        given = [*of_flow[:1], *others]
        if not self.at:
            _check_without_at(self.stated, tuple(self.stated))
            return None
        if len(given) > 1:
            raise InputError(
                f"{{{given[0]}}} and {{{given[1]}}}",
                expected="one law of the lag",
                parameters=dict.fromkeys(given),
            )
        quantity, at = quantity_and_value(self.at)
        default_share = NO_SHARE if others else INNER_SHARE
        share, share_u = number_with_u(self.inner_share or default_share, "inner_share")
        if self.per_degree:
            fall, fall_u = number_with_u(self.per_degree, "per_degree")
            return TemperatureLaw(at, fall, fall_u, share, share_u, quantity)
        if self.lag_table:
            values, lags_s = self._table()
            return TableLaw(at, values, lags_s, 0.0, share, share_u, quantity)
        n, n_u = number_with_u(self.exponent or EXPONENT, "exponent")
        return FlowLaw(at, n, n_u, share, share_u, self.least_flow, quantity)

    @property
    def lags_of_table(self) -> list[str]:
        """The lag of a table at the value where it holds [s], as a text; none of other laws."""
        law = self.law
        return [f"{law.lag_s:.6g}"] if isinstance(law, TableLaw) else []

    def _table(self) -> tuple[list[float], list[float]]:
        """Values and lags [s] of the table."""
        pairs = [entry.partition(":") for entry in self.lag_table.split(",")]
        try:
            return [float(value) for value, _, _ in pairs], [float(lag) for _, _, lag in pairs]
        except ValueError:
            raise InputError(
                f"{{lag_table}} is {self.lag_table!r}",
                expected="values and lags in s, such as 1:30,2:20,4:15",
                parameters={"lag_table": None},
            ) from None


@dataclass(frozen=True)
class PairOptions(TableOptions):
    """How a pair of thermocouples is read and evaluated.

    Attributes
    ----------
    speed
        column of the flow speed v: the film part of each lag is proportional to v^-n, n about 0.5
    exponent
        with {speed}: n and its standard uncertainty (default: 0.5+-0.1)
    inner_share
        with {speed}: share of each lag that does not follow the speed, and its standard uncertainty
        (default: 0.2+-0.1, of bare wires 0)
    flow_steps_s
        instant of a step of the flow in seconds; lags are constant between steps; repeat for
        several
    bare
        both are bare wires, which have one lag each
    """

    speed: str | None = option(None, "Sensor")
    exponent: NumberWithU | None = option(None, "Sensor", takes=str)
    inner_share: NumberWithU | None = option(None, "Sensor", takes=str)
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

    @property
    def prior_of_inner_share(self) -> tuple[float, float] | None:
        """Inner share and its standard uncertainty; None: that of the method.

        Raises
        ------
        InputError
            For a share without a column of the speed, and one outside 0 to 1.
        """
        if self.inner_share is None:
            return None
        share, u = number_with_u(self.inner_share, "inner_share")
        if self.speed is None or not 0 <= share < 1:
            raise InputError(
                "{inner_share} without {speed}" if self.speed is None else "{inner_share}",
                expected="a share of 0 to 1, with the column of the speed",
                parameters={"inner_share": None, "speed": None},
            )
        return share, max(u, MIN_SHARE_SD)


@dataclass(frozen=True)
class CurrentOptions(TableOptions):
    """How a loop current step is read and evaluated.

    Attributes
    ----------
    off_only
        use only rows without current, as a thermocouple cannot be read while heated
    """

    off_only: bool = option(False, "Sensor")


@dataclass(frozen=True)
class PredictOptions(Options):
    """Sensor and surroundings of a lag that is predicted, and what it is used for.

    Attributes
    ----------
    junction
        insulated (in the axis), grounded (welded to the sheath) or exposed (bare, outside of it)
    speed_m_s
        speed of the medium in m/s with its standard uncertainty, such as 0.4+-0.05 (default of the
        uncertainty: 7 %); 0 is natural convection
    T_degC
        temperature of the medium in degC
    well_mm
        the sensor is in a well of this outer diameter
    well_bore_mm
        with {well_mm}: bore of the well (default: 1.08 to 1.2 times the diameter of the sensor)
    well_filling
        with {well_mm}: what is between sensor and well: air, oil or paste
    ramp_K_s
        also the error while the medium changes by so many K/s
    at_Hz
        also amplitude and phase of the reading at this frequency
    noise_K
        with {every_s}: also the fastest change that can be compensated with this noise of a row
    every_s
        with {noise_K}: time from row to row in seconds
    accuracy_K
        with {noise_K}: noise that a compensated temperature may have (default: that of a row)
    """

    junction: JunctionWord = option("insulated", "Sensor", choices=JUNCTION_WORDS, takes=str)
    speed_m_s: NumberWithU = option(0.0, "Sensor", takes=str)
    T_degC: float = option(25.0, "Sensor", low=-100, high=1200)
    well_mm: float | None = option(None, "Sensor", low=0.1, high=200)
    well_bore_mm: float | None = option(None, "Sensor", low=0.1, high=200)
    well_filling: Filling = option("air", "Sensor", choices=FILLINGS, takes=str)
    ramp_K_s: float | None = option(None, "Output", name="ramp", low=-1e6, high=1e6)
    at_Hz: float | None = option(None, "Output", low=1e-9, high=1e6)
    noise_K: float | None = option(None, "Output", low=1e-9, high=1e6)
    every_s: float | None = option(None, "Output", low=1e-6, high=1e6)
    accuracy_K: float | None = option(None, "Output", low=1e-9, high=1e6)

    @property
    def speed(self) -> tuple[float, float]:
        """Speed and its standard uncertainty [m/s]."""
        speed_m_s, u = number_with_u(self.speed_m_s, "speed_m_s")
        return speed_m_s, u or SPEED_U_REL * abs(speed_m_s)

    @property
    def row_s(self) -> float:
        """Time from row to row [s].

        Raises
        ------
        InputError
            Without it.
        """
        if self.every_s is None:
            raise InputError(
                "{noise_K} without {every_s}",
                remedy="give both, or none",
                parameters={"noise_K": None, "every_s": None},
            )
        return self.every_s

    def well(self, diameter_mm: float) -> Well | None:
        """The well around a sensor; None without one.

        Raises
        ------
        InputError
            For a well into which the sensor does not fit, of an exposed junction, and for a bore or
            a filling without a well.
        """
        if self.well_mm is None:
            for name in ("well_bore_mm", "well_filling"):
                if name in self.stated:
                    raise InputError(
                        f"{{{name}}} without {{well_mm}}",
                        remedy="give both, or none",
                        parameters={name: None, "well_mm": None},
                    )
            return None
        if self.junction == "exposed":
            raise InputError(
                "an exposed junction in a well",
                expected="an insulated or grounded one",
                parameters={"junction": "insulated"},
            )
        well = Well(self.well_mm, self.well_bore_mm, self.well_filling)
        well.check(diameter_mm)
        return well
