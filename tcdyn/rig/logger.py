"""Tables of ``rig.toml`` about logs: the logger, constants, and the channels of the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field

from tcdyn.rig.strict import STRICT

ConstantName = Literal["load_N", "speed_fast_rpm", "speed_slow_rpm", "ambient_degC"]


@dataclass(frozen=True)
class Constant:
    """[constants] load_N = { value = 2320, u = 20 }: replaces a column that is not in the log.

    ``value`` under load, over the last 150 s before the unloading, with its standard uncertainty
    ``u``, both in the unit in which the name ends.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    value: float
    u: Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class LoggerTable:
    """[logger]; ``millivolts``: columns of junctions hold the emf of type ``couple``, not degC."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    millivolts: bool = False
    couple: Literal["E", "J", "K", "N", "T"] = "J"
    cold_junction_degC: Annotated[float, Field(ge=-50, le=100)] = 0.0


@dataclass(frozen=True)
class AmbientChannels:
    """[ambient]: columns of T_A, the air at the running ``surface`` and behind the ``faces``."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    surface: tuple[str, ...] = ()
    faces: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns, without repeats."""
        return tuple(dict.fromkeys((*self.surface, *self.faces)))


def air_name(column: str) -> str:
    """The name of a column of ``[ambient]`` after reading.

    >>> air_name("Oil jet 2"), air_name("air_3_degC")
    ('ambient_Oil jet 2_degC', 'ambient_air_3_degC')
    """
    return f"ambient_{column.removesuffix('_degC').removeprefix('ambient_')}_degC"


def air_columns(channels: Sequence[AmbientChannels]) -> dict[str, str]:
    """Columns of the air of all disks: name after reading to name in the file."""
    return {air_name(column): column for table in channels for column in table.columns}
