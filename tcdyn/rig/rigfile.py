"""The rig file ``rig.toml``: its tables, checked key by key, with a default for every key.

Used by every command. The tables themselves are in :mod:`tcdyn.rig.tables`; this module merges the
common tables with those of each disk, checks them and writes them. A new key needs a default and a
row on the page of the manual on keys (a test compares them). Tests: ``tests/rig/test_rigfile.py``.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Hashable, Mapping
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

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, first_validation_error
from tcdyn.core.findings import CHANNEL_NAME
from tcdyn.core.result import Result
from tcdyn.io.read import check_no_device
from tcdyn.rig.columns import junction_columns
from tcdyn.rig.disk import DISKS, Conditioning, DiskSetup, Junction
from tcdyn.rig.press_fit import NO_FIT, PressFit
from tcdyn.rig.steel import SteelSlopes
from tcdyn.rig.tables import (
    CHANNELS,
    DEFAULT_LAYOUT,
    NO_FLUX,
    OWN_LAYOUT,
    AmbientChannels,
    Constant,
    ConstantName,
    ContactTable,
    DiskTable,
    JunctionTable,
    LoggerTable,
    RigTable,
    SurfaceFlux,
    TraceabilityTable,
    UncertaintyTable,
    WasherTable,
    air_columns,
    inner_row,
    layout_junctions,
)
from tcdyn.series.options import ReadingOptions

# A key of more than 32 parts: tomllib needs time with the square of the depth.
DEEP_KEY = re.compile(r"""(?:\.[ \t]*["'\w-]+[ \t]*){32}""")
# Remedies of error messages.
SHOW_REMEDY = "`tcdyn rig check` lists every key with its default"
WRITE_REMEDY = "`tcdyn rig check > rig.toml` writes one"


class RigTables(RigTable):
    """All tables that describe one disk and its test."""

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
    def _add_layout_junctions(cls, data: Any) -> Any:
        """Replace ``thermocouples.layout`` by the junctions of that layout."""
        if not isinstance(data, dict) or not isinstance(data.get("thermocouples"), dict):
            return data
        listed = dict(data["thermocouples"])
        has_other_names = bool(set(listed) - {"layout", *CHANNELS})
        default = OWN_LAYOUT if has_other_names else DEFAULT_LAYOUT
        junctions = layout_junctions(listed.pop("layout", default))
        return {**data, "thermocouples": _merge(junctions, listed)}

    @model_validator(mode="after")
    def _check_junctions(self) -> RigTables:
        """Check names and positions of the junctions, and the sectors of the press fit."""
        if not self.thermocouples:
            raise ValueError(
                "thermocouples: none is listed; expected one or more, such as "
                "t1 = { depth_mm, z_mm }"
            )
        for name in self.thermocouples:
            if not CHANNEL_NAME.fullmatch(name):
                raise ValueError(
                    f"thermocouples: {name!r} is no name of a junction; expected a letter, or "
                    "letters and a number, such as t1; what logs call it goes to [columns]"
                )
        self.fit.sectors(self.disk.bore_radius_mm)
        wall_mm = self.disk.outer_radius_mm - self.disk.bore_radius_mm
        for name, junction in self.thermocouples.items():
            if junction.depth_mm >= wall_mm:
                raise ValueError(
                    f"thermocouples.{name}: depth_mm {junction.depth_mm} lies inside the bore"
                )
            if junction.z_mm >= self.disk.width_mm:
                raise ValueError(
                    f"thermocouples.{name}: z_mm {junction.z_mm} lies outside the width"
                )
        return self

    @model_validator(mode="after")
    def _check_columns(self) -> RigTables:
        """Each junction has its own column, in EHL logs (both disks) and in other logs."""
        for prefixes in (DISKS, ("",)):
            junction_of: dict[str, str] = {}
            names = [n for prefix in prefixes for n in junction_columns(self.thermocouples, prefix)]
            for name in names:
                column = self.columns.get(name, name)
                other = junction_of.setdefault(column, name)
                if other != name:
                    raise ValueError(
                        f"columns: {column!r} is named for two junctions, {other} and {name}; "
                        "give each its own column"
                    )
        return self

    @field_serializer("thermocouples")
    def _write_junctions(self, junctions: dict[str, JunctionTable]) -> dict[str, Any]:
        """Junctions other than a to f are written with the layout "own": the table lists all."""
        tables = {name: junction.model_dump() for name, junction in junctions.items()}
        if set(tables) == set(CHANNELS):
            return tables
        return {"layout": OWN_LAYOUT, **tables}

    def disk_setup(self, name: str) -> DiskSetup:
        """The disk of these tables in the units of the models.

        Parameters
        ----------
        name
            Name that the disk gets: "fast", "slow", or "" for the common tables.

        Returns
        -------
        setup
            The disk.

        Notes
        -----
        Lengths of the disk, the washers and the junctions are converted from mm to m. Angles stay
        in degrees, and ``press_fit`` stays in the units of the file. A new key of [disk] that the
        models use is also added here.
        """
        d = self.disk
        junctions = {
            channel: Junction(t.depth_mm * 1e-3, t.z_mm * 1e-3, t.angle_deg)
            for channel, t in sorted(self.thermocouples.items())
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
            washer_conductivity_W_mK=self.washer.conductivity_W_mK,
            washer_thickness_m=self.washer.thickness_mm * 1e-3,
            junctions=junctions,
            inner=inner_row(
                {c: x.depth_m for c, x in junctions.items()},
                {c: x.z_m for c, x in junctions.items()},
            ),
            conditioning=self.conditioning,
            flux=self.contact.flux,
            surface=self.surface,
            press_fit=self.fit,
            steel=SteelSlopes(
                d.conductivity_slope_per_K, d.specific_heat_slope_per_K, d.reference_degC
            ),
        )


class Rig(Result, BaseModel):
    """A rig: the common tables, those of the fast and the slow disk, and how its logs are read.

    Attributes
    ----------
    common, fast, slow
        The tables.
    reading
        How the rows of a log are read, where the log does not say it itself; no part of a rig file.
    """

    model_config = ConfigDict(frozen=True)

    common: RigTables
    fast: RigTables
    slow: RigTables
    reading: ReadingOptions = Field(default=ReadingOptions(), exclude=True, repr=False)

    def with_reading(self, reading: ReadingOptions) -> Rig:
        """The rig whose logs are read so."""
        return self.model_copy(update={"reading": reading})

    def summary(self) -> str:
        """Size, steel and conditioning of each disk, one line each."""
        contact = self.common.contact
        lines = [f"gear ratio {contact.gear_ratio:g}, h ~ u^{contact.speed_exponent:g}"]
        for name in DISKS:
            disk = self.tables(name).disk
            conditioning = self.tables(name).conditioning
            lines.append(
                f"{name}: {2 * disk.outer_radius_mm:g} mm diameter, {disk.width_mm:g} mm wide, "
                f"bore {2 * disk.bore_radius_mm:g} mm, {disk.conductivity_W_mK:g} W/mK, "
                f"{disk.density_kg_m3:g} kg/m3, {disk.specific_heat_J_kgK:g} J/kgK, "
                f"conditioning {conditioning.cutoff_Hz:g} Hz x {conditioning.poles}"
            )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """All tables with their values: common, fast, slow."""
        return self.model_dump(mode="json")

    def tables(self, disk: str) -> RigTables:
        """The tables of ``disk``: "fast", "slow", or "" for the common ones; else InputError."""
        tables = {"fast": self.fast, "slow": self.slow, "": self.common}
        if disk not in tables:
            raise InputError(f"the rig has no disk {disk!r}", expected=" or ".join(DISKS))
        return tables[disk]

    def columns(self, disk: str | None = None) -> dict[str, str]:
        """``[columns]`` for a log of ``disk``: canonical name to name in the file.

        ``fast_a_degC``, mapped for EHL logs, is also the ``a_degC`` of oven and plunge logs of the
        fast disk, unless ``a_degC`` is mapped itself.

        Parameters
        ----------
        disk
            Name of the disk; None: EHL logs.

        Examples
        --------
        >>> rig = parse_rig({"columns": {"fast_a_degC": "TC1 fast"}}, "rig.toml")
        >>> rig.columns("fast")["a_degC"]
        'TC1 fast'
        """
        mapped = dict(self.tables(disk or "").columns)
        if not disk:
            return mapped
        prefix = f"{disk}_"
        of_disk = {k.removeprefix(prefix): v for k, v in mapped.items() if k.startswith(prefix)}
        return of_disk | mapped

    def replaced_columns(self) -> tuple[str, ...]:
        """Columns that an EHL log may lack: ``[constants]`` or ``[ambient]`` replaces them.

        Returns
        -------
        names
            Canonical names.
        """
        columns = tuple(self.common.constants)
        if all(self.tables(disk).ambient.columns for disk in DISKS):
            columns += ("ambient_degC",)
        return columns

    def air_columns(self) -> dict[str, str]:
        """Columns of the air near either disk: name after reading to name in the file."""
        return air_columns([self.fast.ambient, self.slow.ambient])

    def junction_columns(self, kind: str, disk: str | None = None) -> tuple[str, ...]:
        """Columns of the junctions in a log.

        Parameters
        ----------
        kind
            Kind of log; "ehl" has the columns of both disks.
        disk
            Disk of another log; None: the common tables.

        Returns
        -------
        names
            In the order of the names of the junctions.
        """
        if kind != "ehl":
            return junction_columns(sorted(self.tables(disk or "").thermocouples))
        columns: list[str] = []
        for name in DISKS:
            columns += junction_columns(sorted(self.tables(name).thermocouples), name)
        return tuple(columns)

    def disk_setup(self, disk: str) -> DiskSetup:
        """The disk in SI units."""
        return self.tables(disk).disk_setup(disk)

    @property
    def setups(self) -> dict[str, DiskSetup]:
        """Both disks in SI units."""
        return {d: self.disk_setup(d) for d in DISKS}


@with_named_arguments
def load_rig(path: str | Path | None = None) -> Rig:
    """Read ``rig.toml``; without a path, the defaults of the design.

    Parameters
    ----------
    path
        The file; None: the defaults.

    Raises
    ------
    InputError
        An unreadable file, an unknown key, or a value out of its range.

    Examples
    --------
    >>> round(load_rig().disk_setup("fast").diffusivity_m2_s * 1e5, 2)
    1.11
    """
    if path is None:
        return parse_rig({}, "rig.toml")
    check_no_device(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        if DEEP_KEY.search(text):
            raise ValueError("a key of more than 32 parts")
        data = tomllib.loads(text)
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), remedy=WRITE_REMEDY) from None
    except (OSError, ValueError, RecursionError) as problem:
        what = f"not readable as TOML ({str(problem)[:200]})"
        raise InputError(
            what, where=str(path), expected="a rig file", remedy=WRITE_REMEDY
        ) from None
    return parse_rig(data, str(path))


def parse_rig(data: dict[str, Any], where: str) -> Rig:
    """Check the tables of a rig file that is already a dict.

    Parameters
    ----------
    data
        Tables as parsed.
    where
        Name of the file, for messages.

    Raises
    ------
    InputError
        An unknown key, or a value out of its range.
    """
    common = {key: value for key, value in data.items() if key not in DISKS}
    overrides = {"common": {}, "fast": data.get("fast", {}), "slow": data.get("slow", {})}
    tables: dict[str, RigTables] = {}
    for name, override in overrides.items():
        if not isinstance(override, dict):
            raise InputError(f"[{name}] must be a table", where=where)
        if "constants" in override:
            raise InputError(
                f"[{name}.constants]: a test has one set of constants",
                where=where,
                remedy="write [constants]",
            )
        try:
            tables[name] = RigTables.model_validate(_merge(common, override))
        except ValidationError as problem:
            what = first_validation_error(problem, name)
            raise InputError(what, where=where, remedy=SHOW_REMEDY) from None
    return Rig(common=tables["common"], fast=tables["fast"], slow=tables["slow"])


def _merge(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with the values of ``override``, table by table.

    A table with the layout "own" replaces the other one completely.

    Parameters
    ----------
    base, override
        Tables; the second has precedence.
    """
    merged = {**base, **override}
    for key, value in override.items():
        old = base.get(key)
        if not isinstance(old, dict) or not isinstance(value, dict):
            continue
        if value.get("layout") != OWN_LAYOUT:
            merged[key] = _merge(old, value)
    return merged


def changed_keys(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Keys of two sets of rig tables whose values differ: (key, value before, value after).

    Parameters
    ----------
    before, after
        Rig tables as dicts.

    Returns
    -------
    changes
        In the order of ``before``; keys that only ``after`` has are not listed.

    Examples
    --------
    >>> old = {"disk": {"width_mm": 9.53, "bore": 1}}
    >>> changed_keys(old, {"disk": {"width_mm": 10.0, "bore": 1}})
    [('[disk] width_mm', 9.53, 10.0)]
    """
    old = _flat_values(before)
    new = _flat_values(after)
    changes: list[tuple[str, Any, Any]] = []
    for key, value in old.items():
        if value != new.get(key):
            table, _, name = str(key).partition(".")
            changes.append((f"[{table}] {name}", value, new.get(key)))
    return changes


def _flat_values(tables: Mapping[str, Any]) -> dict[Hashable, Any]:
    """All values by "table.key"."""
    return pd.json_normalize(dict(tables)).to_dict("records")[0]


# Comments at the end of the common tables of a rig file that is printed.
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
    """The rig as TOML text, every key with its value: the output of ``tcdyn rig check``."""
    lines: list[str] = ["# tcdyn rig file: every key, with the value in force"]
    common = rig.common.model_dump()
    for table, values in common.items():
        lines += _toml_table(table, values)
    if not common["columns"]:
        lines += HINTS
    for disk in DISKS:
        for table, values in rig.tables(disk).model_dump().items():
            changed = {k: v for k, v in values.items() if common[table].get(k) != v}
            if changed and "layout" in values:
                changed = values
            if changed:
                lines += _toml_table(f"{disk}.{table}", changed)
    return "\n".join(lines) + "\n"


def _toml_table(name: str, values: dict[str, Any]) -> list[str]:
    """Lines of a table: a blank line, its name and its keys."""
    return ["", f"[{name}]", *(f"{key} = {_toml_value(value)}" for key, value in values.items())]


def _toml_value(value: Any) -> str:
    """Write a value as TOML: a table inline, a list, text, a number or a boolean."""
    if isinstance(value, dict):
        pairs = ", ".join(f"{key} = {_toml_value(item)}" for key, item in value.items())
        return f"{{ {pairs} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml_value, value))}]"
    return json.dumps(value, ensure_ascii=False)  # text, numbers and booleans are as in TOML
