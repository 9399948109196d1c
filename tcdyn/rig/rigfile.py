"""``rig.toml``: what people write about their rig, checked key by key, with a default for every key."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_serializer,
    model_validator,
)

from tcdyn.core.errors import InputError, first_wrong
from tcdyn.core.findings import CHANNEL_NAME
from tcdyn.core.result import Result
from tcdyn.rig.columns import couples
from tcdyn.rig.disk import DISKS, Conditioning, DiskSetup, Junction
from tcdyn.rig.layout import CHANNELS, DEFAULT_LAYOUT, OWN_LAYOUT, inner_row, layout_junctions
from tcdyn.rig.logger import AmbientChannels, Constant, ConstantName, LoggerTable, air_columns
from tcdyn.rig.press_fit import NO_FIT, PressFit
from tcdyn.rig.steel import SteelSlopes
from tcdyn.rig.surface_flux import NO_FLUX, SurfaceFlux
from tcdyn.rig.tables import (
    ContactTable,
    DiskTable,
    JunctionTable,
    RigTable,
    UncertaintyTable,
    WasherTable,
)
from tcdyn.rig.traceability import TraceabilityTable

DEEP_KEY = re.compile(r"""(?:\.[ \t]*["'\w-]+[ \t]*){32}""")


class RigTables(RigTable):
    """Everything that describes one disk and its test."""

    disk: DiskTable = DiskTable()
    washer: WasherTable = WasherTable()
    thermocouples: dict[str, JunctionTable] = Field(
        default_factory=lambda: {
            c: JunctionTable(**x) for c, x in layout_junctions(DEFAULT_LAYOUT).items()
        }
    )
    contact: ContactTable = ContactTable()
    surface: SurfaceFlux = NO_FLUX
    fit: PressFit = NO_FIT
    conditioning: Conditioning = Conditioning()
    logger: LoggerTable = LoggerTable()
    uncertainty: UncertaintyTable = UncertaintyTable()
    traceability: TraceabilityTable = TraceabilityTable()
    constants: dict[ConstantName, Constant] = Field(default_factory=dict)
    ambient: AmbientChannels = AmbientChannels()
    columns: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _fill_junctions(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("thermocouples"), dict):
            said = dict(data["thermocouples"])
            others = set(said) - {"layout", *CHANNELS}
            places = layout_junctions(said.pop("layout", OWN_LAYOUT if others else DEFAULT_LAYOUT))
            data = {**data, "thermocouples": _merge(places, said)}
        return data

    @model_validator(mode="after")
    def _junctions_inside(self) -> RigTables:
        if not self.thermocouples:
            raise ValueError(
                "thermocouples: none is listed; expected one or more, such as t1 = { depth_mm, z_mm }"
            )
        for name in self.thermocouples:
            if not CHANNEL_NAME.fullmatch(name):
                wanted = "a letter, or letters and a number, such as t1; what logs call it goes to [columns]"
                raise ValueError(
                    f"thermocouples: {name!r} is no name of a junction; expected {wanted}"
                )
        self.fit.sectors(self.disk.bore_radius_mm)
        wall = self.disk.outer_radius_mm - self.disk.bore_radius_mm
        for name, junction in self.thermocouples.items():
            if junction.depth_mm >= wall:
                raise ValueError(
                    f"thermocouples.{name}: depth_mm {junction.depth_mm} lies inside the bore"
                )
            if junction.z_mm >= self.disk.width_mm:
                raise ValueError(
                    f"thermocouples.{name}: z_mm {junction.z_mm} lies outside the width"
                )
        return self

    @model_validator(mode="after")
    def _a_column_for_each(self) -> RigTables:
        for prefixes in (DISKS, ("",)):
            taken: dict[str, str] = {}
            for name in (n for prefix in prefixes for n in couples(self.thermocouples, prefix)):
                column = self.columns.get(name, name)
                if (other := taken.setdefault(column, name)) != name:
                    both = f"{column!r} is named for two junctions, {other} and {name}"
                    raise ValueError(f"columns: {both}; give each its own column")
        return self

    @field_serializer("thermocouples")
    def _all_there_are(self, junctions: dict[str, JunctionTable]) -> dict[str, Any]:
        """A table of others than a to f says that it lists all."""
        told = {c: j.model_dump() for c, j in junctions.items()}
        return told if set(told) == set(CHANNELS) else {"layout": OWN_LAYOUT, **told}

    def setup(self, name: str) -> DiskSetup:
        """The disk in SI units."""
        d = self.disk
        w = self.washer
        j = self.thermocouples
        junctions = {
            k: Junction(j[k].depth_mm * 1e-3, j[k].z_mm * 1e-3, j[k].angle_deg) for k in sorted(j)
        }
        return DiskSetup(
            name=name,
            outer_radius_m=d.outer_radius_mm * 1e-3,
            bore_radius_m=d.bore_radius_mm * 1e-3,
            width_m=d.width_mm * 1e-3,
            crown_radius_m=d.crown_radius_mm * 1e-3,
            conductivity_W_mK=d.conductivity_W_mK,
            density_kg_m3=d.density_kg_m3,
            specific_heat_J_kgK=d.specific_heat_J_kgK,
            washer_conductivity_W_mK=w.conductivity_W_mK,
            washer_thickness_m=w.thickness_mm * 1e-3,
            junctions=junctions,
            inner=inner_row(
                {c: x.depth_m for c, x in junctions.items()},
                {c: x.z_m for c, x in junctions.items()},
            ),
            conditioning=self.conditioning,
            flux=self.contact.flux,
            surface=self.surface,
            fit=self.fit,
            steel=SteelSlopes(
                d.conductivity_slope_per_K, d.specific_heat_slope_per_K, d.reference_degC
            ),
        )


class Rig(Result, BaseModel):
    """A rig: the tables of each disk, and the two disks' common contact."""

    model_config = ConfigDict(frozen=True)

    common: RigTables
    fast: RigTables
    slow: RigTables

    def summary(self) -> str:
        """The disks in a line each: size, steel, bandwidth of the conditioning."""
        lines = [
            f"gear ratio {self.common.contact.gear_ratio:g}, h ~ u^{self.common.contact.speed_exponent:g}"
        ]
        for disk in ("fast", "slow"):
            t = self.tables(disk)
            d = t.disk
            filter_ = t.conditioning
            lines.append(
                f"{disk}: {2 * d.outer_radius_mm:g} mm diameter, {d.width_mm:g} mm wide, bore {2 * d.bore_radius_mm:g} "
                f"mm, {d.conductivity_W_mK:g} W/mK, {d.density_kg_m3:g} kg/m3, {d.specific_heat_J_kgK:g} J/kgK, "
                f"conditioning {filter_.cutoff_Hz:g} Hz x {filter_.poles}"
            )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Every table of the rig file as it is in force: common, fast, slow."""
        return self.model_dump(mode="json")

    def tables(self, disk: str) -> RigTables:
        """The tables of ``disk``, "fast" or "slow"; the common ones for "". InputError for any other name."""
        tables = {"fast": self.fast, "slow": self.slow, "": self.common}
        if disk not in tables:
            raise InputError(f"the rig has no disk {disk!r}", expected=" or ".join(DISKS))
        return tables[disk]

    def columns(self, disk: str | None = None) -> dict[str, str]:
        """``[columns]`` as a log of ``disk`` needs it: ``fast_a_degC``, mapped for EHL logs, names the fast disk's
        ``a_degC`` in oven and plunge logs too, unless ``a_degC`` is mapped itself.

        >>> parse_rig({"columns": {"fast_a_degC": "TC1 fast"}}, "rig.toml").columns("fast")["a_degC"]
        'TC1 fast'
        """
        mapped = dict(self.tables(disk or "").columns)
        start = f"{disk}_"
        return {
            k.removeprefix(start): v for k, v in mapped.items() if disk and k.startswith(start)
        } | mapped

    def stated(self) -> tuple[str, ...]:
        """Columns that an EHL log need not hold, their values being stated in ``[constants]`` or ``[ambient]``."""
        told = all(self.tables(d).ambient.columns for d in ("fast", "slow"))
        return (*self.common.constants, *(("ambient_degC",) if told else ()))

    def air_columns(self) -> dict[str, str]:
        """Name in a log that was read -> name in the file, of the columns that tell the air about either disk."""
        return air_columns([self.fast.ambient, self.slow.ambient])

    def couples(self, kind: str, disk: str | None = None) -> tuple[str, ...]:
        """The junctions' columns of a log of ``kind``: those of both disks in an EHL log, else those of ``disk``."""
        if kind == "ehl":
            return tuple(n for d in DISKS for n in couples(sorted(self.tables(d).thermocouples), d))
        return couples(sorted(self.tables(disk or "").thermocouples))

    def disk_setup(self, disk: str) -> DiskSetup:
        """The disk in SI units."""
        return self.tables(disk).setup(disk)

    @property
    def setups(self) -> dict[str, DiskSetup]:
        """Both disks in SI units."""
        return {d: self.disk_setup(d) for d in DISKS}


def load_rig(path: str | Path | None = None) -> Rig:
    """Read ``rig.toml``; without a path, the defaults of the design.

    Raises InputError for an unreadable file, an unknown key or a value out of its range.

    >>> round(load_rig().disk_setup("fast").diffusivity_m2_s * 1e5, 2)
    1.11
    """
    if path is None:
        return parse_rig({}, "rig.toml")
    try:
        if DEEP_KEY.search(
            text := Path(path).read_text(encoding="utf-8-sig")
        ):  # parsed in the square of its depth
            raise ValueError("a key of more than 32 parts")
        data = tomllib.loads(text)
    except FileNotFoundError:
        raise InputError(
            "no such file", where=str(path), remedy="`tcdyn rig --show > rig.toml` writes one"
        ) from None
    except (OSError, ValueError, RecursionError) as problem:
        what = f"not readable as TOML ({str(problem)[:200]})"
        remedy = "`tcdyn rig --show > rig.toml` writes one"
        raise InputError(what, where=str(path), expected="a rig file", remedy=remedy) from None
    return parse_rig(data, str(path))


def parse_rig(data: dict[str, Any], where: str) -> Rig:
    """Check the tables of a rig file that is already a dict; ``where`` names it in errors."""
    common = {k: v for k, v in data.items() if k not in ("fast", "slow")}
    built: dict[str, RigTables] = {}
    for name, override in (
        ("common", {}),
        ("fast", data.get("fast", {})),
        ("slow", data.get("slow", {})),
    ):
        if not isinstance(override, dict):
            raise InputError(f"[{name}] must be a table", where=where)
        if "constants" in override:
            raise InputError(
                f"[{name}.constants]: a test has one set of constants",
                where=where,
                remedy="write [constants]",
            )
        try:
            built[name] = RigTables.model_validate(_merge(common, override))
        except ValidationError as problem:
            said = first_wrong(problem, name)
            remedy = "`tcdyn rig --show` lists every key with its default"
            raise InputError(said, where=where, remedy=remedy) from None
    return Rig(**built)


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with the values of ``over``, table within table; one of its own layout stands in place of the other."""
    pairs = {k: (base.get(k), v) for k, v in over.items()}
    whole = {
        k: (a, b) for k, (a, b) in pairs.items() if isinstance(a, dict) and isinstance(b, dict)
    }
    return {
        **base,
        **over,
        **{k: _merge(a, b) for k, (a, b) in whole.items() if b.get("layout") != OWN_LAYOUT},
    }


def changed_keys(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Keys of two sets of rig tables whose values differ: (key, value before, value after).

    >>> changed_keys({"disk": {"width_mm": 9.53, "bore": 1}}, {"disk": {"width_mm": 10.0, "bore": 1}})
    [('[disk] width_mm', 9.53, 10.0)]
    """
    one, other = (pd.json_normalize(dict(d)).to_dict("records")[0] for d in (before, after))
    names = {key: "[{}] {}".format(*str(key).split(".", 1)) for key in one}
    return [
        (names[key], value, other.get(key)) for key, value in one.items() if value != other.get(key)
    ]


HINTS = [
    "# names in your logs, where they differ from tcdyn's, such as",
    '# fast_a_degC = "TC1 fast"',
    "",
    "# what your logs do not hold goes into [constants], such as",
    "# load_N = { value = 2320.0, u = 20.0 }",
    "",
    "# what holds for one disk only goes below, such as",
    "# [slow.disk]",
    "# conductivity_W_mK = 43.0",
]


def rig_toml(rig: Rig) -> str:
    """The rig as TOML text, every key with its value: what ``tcdyn rig --show`` prints."""
    lines: list[str] = ["# tcdyn rig file: every key, with the value in force"]
    body = rig.common.model_dump()
    for table, values in body.items():
        lines += _toml_table(table, values)
    lines += HINTS if not body["columns"] else []
    for disk in ("fast", "slow"):
        own = rig.tables(disk).model_dump()
        for table, values in own.items():
            changed = {k: v for k, v in values.items() if body[table].get(k) != v}
            if changed:
                changed = values if "layout" in values else changed
                lines += _toml_table(f"{disk}.{table}", changed)
    return "\n".join(lines) + "\n"


def _toml_table(name: str, values: dict[str, Any]) -> list[str]:
    return ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in values.items())]


def _toml_value(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{k} = {_toml_value(v)}' for k, v in value.items())} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml_value, value))}]"
    return json.dumps(value, ensure_ascii=False)  # text, numbers, truths: as in TOML
