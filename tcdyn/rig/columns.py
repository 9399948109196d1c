"""Canonical columns of each kind of log, and the matching of the names in a file to them.

Used by every reader of logs. A new column of a kind of log is added to ``LAYOUTS``, and to the page
of the manual on columns and keys. The similarity of names (cut-offs of ``difflib``) only affects
what a message suggests. Tests: ``tests/rig/test_logger_conventions.py`` and
``tests/io/test_file_formats.py``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Literal

from tcdyn.core.errors import InputError
from tcdyn.io.column_names import column_named, same_columns
from tcdyn.io.times import without_time_unit
from tcdyn.io.unit_names import without_unit
from tcdyn.rig.disk import CHANNELS, DISKS

Kind = Literal["oven", "immersion", "ehl", "hole"]


@dataclass(frozen=True)
class Layout:
    """Columns of one kind of log.

    Parameters
    ----------
    name
        The kind in sentences, with its article.
    columns
        Canonical columns in order.
    optional
        Columns that may be missing.
    """

    name: str
    columns: tuple[str, ...]
    optional: tuple[str, ...] = ()

    def with_junctions(self, junctions: Collection[str]) -> Layout:
        """The layout for a rig whose junctions have the columns ``junctions``."""
        default = {*DISK_CHANNELS, *EHL_CHANNELS}
        first = next((i for i, c in enumerate(self.columns) if c in default), None)
        if first is None:
            return self
        before = self.columns[:first]
        after = tuple(c for c in self.columns[first:] if c not in default)
        return replace(self, columns=(*before, *junctions, *after))

    @property
    def required(self) -> tuple[str, ...]:
        """The columns that must be there."""
        return tuple(c for c in self.columns if c not in self.optional)


def junction_columns(channels: Iterable[str], disk: str = "") -> tuple[str, ...]:
    """Columns of the junctions of a disk; in EHL logs they start with the name of the disk.

    Parameters
    ----------
    channels
        Names of the junctions.
    disk
        Name of the disk, for EHL logs; empty: no prefix.

    Returns
    -------
    tuple of str
        Names of the columns, in the same order.

    Examples
    --------
    >>> junction_columns("ab"), junction_columns(["t1"], "fast")
    (('a_degC', 'b_degC'), ('fast_t1_degC',))
    """
    prefix = f"{disk}_" if disk else ""
    return tuple(f"{prefix}{channel}_degC" for channel in channels)


DISK_CHANNELS = junction_columns(CHANNELS)  # of the thesis's disks
EHL_CHANNELS = tuple(name for disk in DISKS for name in junction_columns(CHANNELS, disk))
# Columns that are switches: entry of a plunge, contact of the disks.
SWITCHES = ("switch", "contact")
# Temperatures that are not of a junction or of the PRT.
ROOM_AND_BATH = ("ambient_degC", "oil_degC", "probe_degC", "fluid_degC")
# Columns of an EHL log that are not temperatures, without the torque.
EHL_RUNNING = ("load_N", "friction_N", "contact", "speed_fast_rpm", "speed_slow_rpm")
# torque of a shaft: friction times the radius of the disk
TORQUE_COLUMNS = tuple(f"torque_{disk}_Nm" for disk in DISKS)
# units that the name of a temperature may end in, instead of degC
UNITS = ("K", "degF", "mV")

# Columns of each kind of log, with those of the junctions of the default disks.
LAYOUTS: dict[str, Layout] = {
    "oven": Layout(
        "an oven log",
        ("time_s", "repeat", "setpoint_degC", "prt_degC", *DISK_CHANNELS),
        ("time_s", "repeat", "setpoint_degC"),
    ),
    "immersion": Layout(
        "an immersion log",
        ("time_s", "switch", "probe_degC", "fluid_degC", *DISK_CHANNELS),
        ("switch", "probe_degC"),
    ),
    "ehl": Layout(
        "an EHL log",
        ("time_s", *EHL_RUNNING, *TORQUE_COLUMNS, *EHL_CHANNELS, "ambient_degC", "oil_degC"),
        ("oil_degC", "contact", *TORQUE_COLUMNS),
    ),
    "hole": Layout(
        "a hole-comparison log",
        ("time_s", "switch", "probe_degC", "fluid_degC"),
        ("switch", "probe_degC", "fluid_degC"),
    ),
}
# Most names that a question in a message holds; more are listed only. Chosen by judgement.
MAX_NAMES_IN_QUESTION = 3
# Columns in degC that are not junctions.
NOT_JUNCTIONS = (*ROOM_AND_BATH, "prt_degC", "setpoint_degC")
# Canonical columns of all kinds of log.
KNOWN_COLUMNS = tuple(dict.fromkeys(name for layout in LAYOUTS.values() for name in layout.columns))


def is_junction_column(name: str) -> bool:
    """Whether a column is the temperature of a junction: not of a room, a bath, a probe or the PRT.

    >>> is_junction_column("fast_a_degC"), is_junction_column("oil_degC")
    (True, False)
    """
    return name.endswith("_degC") and not is_air(name) and name not in NOT_JUNCTIONS


def junction_columns_in(columns: Iterable[Hashable]) -> list[str]:
    """The columns of junctions among those of a log."""
    return [name for name in map(str, columns) if is_junction_column(name)]


def is_air(name: str) -> bool:
    """Whether a column is the temperature of a room, a bath, a free probe or the air near a disk.

    >>> is_air("oil_degC"), is_air("ambient_north_degC"), is_air("a_degC")
    (True, True, False)
    """
    return name in ROOM_AND_BATH or (name.startswith("ambient_") and name.endswith("_degC"))


def find_column(
    canonical: str, mapping: Mapping[str, str], names: Collection[str]
) -> tuple[str, str] | None:
    """The column of a file for a canonical name, and its unit; None if there is none.

    The mapped name comes first, with or without the unit of the column, then the canonical name,
    then both for the other units of a temperature.

    Parameters
    ----------
    canonical
        Canonical name.
    mapping
        Canonical name (in any unit) to name in the file.
    names
        Names in the file.

    Examples
    --------
    >>> find_column("fast_a_degC", {"fast_a_mV": "TC1"}, ["TC1"])
    ('TC1', 'mV')
    >>> find_column("fast_a_degC", {}, ["fast_a_K"])
    ('fast_a_K', 'K')
    >>> find_column("load_N", {"load_N": "Kraft"}, ["Kraft [N]"])
    ('Kraft [N]', 'N')
    """
    stem, _, canonical_unit = canonical.rpartition("_")
    units = (canonical_unit, *UNITS) if canonical_unit == "degC" else (canonical_unit,)
    for unit in units:
        name = f"{stem}_{unit}" if stem else canonical
        for candidate in (mapping.get(name), name):
            if candidate is not None and candidate in names:
                return candidate, unit
        if name in mapping:
            stem_of = without_time_unit if canonical == "time_s" else without_unit
            same = same_columns(mapping[name], names, stem_of)
            if len(same) > 1:
                raise InputError(
                    f"{mapping[name]!r} may be {' or '.join(map(repr, same))}",
                    where="rig.toml [columns]",
                    expected="one of them, with its unit",
                )
            if same:
                return same[0], unit
    return None


def in_all_units(names: Iterable[str]) -> tuple[str, ...]:
    """The names, those of temperatures in every unit in which one may be logged."""
    result: list[str] = []
    for name in names:
        if not name.endswith("_degC"):
            result.append(name)
            continue
        stem = name.removesuffix("degC")
        result += [stem + unit for unit in ("degC", *UNITS)]
    return tuple(result)


def recognise(names: Iterable[str], layouts: Mapping[str, Layout] = LAYOUTS) -> str | None:
    """The kind of log with these column names, or None; the kind "hole" is never guessed.

    Parameters
    ----------
    names
        Names in the file.
    layouts
        Layouts of the rig.

    Notes
    -----
    All required columns decide; otherwise at least two typical columns. "ehl" is tried first,
    because an EHL log holds most columns.

    Examples
    --------
    >>> recognise(["repeat", "prt_degC", *junction_columns("abcdef")])
    'oven'
    """
    available = set(names)
    for kind in ("ehl", "oven", "immersion"):
        if set(layouts[kind].required) <= available:
            return kind
    first = next((c for c in layouts["ehl"].columns if c.startswith("fast_")), "")
    typical = {
        "ehl": {"load_N", "friction_N", "contact", first},
        "oven": {"prt_degC", "setpoint_degC"},
        "immersion": {"switch", "fluid_degC", "probe_degC"},
    }
    score = {kind: len(columns & available) for kind, columns in typical.items()}
    best = max(score, key=lambda kind: score[kind])
    return best if score[best] >= 2 else None


def match_columns(
    names: tuple[str, ...],
    kind: str,
    where: str,
    mapping: Mapping[str, str] | None = None,
    without: Collection[str] = (),
    replaced: Collection[str] = (),
    air: Mapping[str, str] | None = None,
    layouts: Mapping[str, Layout] = LAYOUTS,
) -> dict[str, str]:
    """Match the canonical columns of a kind of log to the names in a file.

    A temperature may be there in another unit. An EHL log without friction may hold the torque of a
    shaft instead, under its own name. In a hole-comparison log every further column that ends in
    ``_degC`` is a channel.

    Parameters
    ----------
    names
        Column names of the file.
    kind
        Kind of log.
    where
        Name of the file, for messages.
    mapping
        ``[columns]`` of rig.toml: canonical name to name in the file. The file may use the
        canonical name instead.
    without
        Columns that are not read.
    replaced
        Columns that may be missing, because the rig file gives their values.
    air
        Name to name in the file of further required columns, the channels of ``[ambient]``.
    layouts
        Layouts of the logs of the rig, see ``Layout.with_junctions``.

    Returns
    -------
    Canonical name to name in the file, in canonical order.

    Raises
    ------
    InputError
        A duplicate or missing column, an unknown key in the mapping, or a file of another kind.
    """
    layout = layouts[kind]
    mapping = mapping or {}
    _check_mapping(mapping)
    wanted = tuple(c for c in layout.columns if c not in without)
    if kind == "hole":
        used = set(mapping.values()) | set(wanted)
        wanted += tuple(n for n in dict.fromkeys(names) if n.endswith("_degC") and n not in used)
    matched: dict[str, str] = {}
    for canonical in wanted:
        match = find_column(canonical, mapping, names)
        if match is not None:
            _check_once(names, match[0], where)
            matched[canonical] = match[0]
    if "time_s" not in matched and "time" in names:
        _check_once(names, "time", where)
        matched = {"time_s": "time", **matched}
    torques = [c for c in TORQUE_COLUMNS if c in matched]
    needless = {*without, *replaced}
    if torques:
        needless.add("friction_N")
    missing = [c for c in layout.required if c not in matched and c not in needless]
    if kind != "hole":
        missing += _misnamed_switches(layout, names, matched, mapping, without)
    if kind == "ehl":
        matched |= _air_columns(air or {}, names, where)
        for torque in torques["friction_N" not in matched :]:
            del matched[torque]
    if missing:
        available = set(matched) | set(names)
        raise _missing_columns(missing, names, available, kind, where, mapping, layouts)
    channels = [c for c in matched if c.endswith("_degC") and c not in layout.columns]
    if kind == "hole" and len(channels) < 2:
        raise InputError(
            f"has {len(channels)} thermocouple column(s)",
            where=where,
            expected="at least two columns whose names end in _degC",
            remedy="rename the columns or map them in rig.toml [columns]",
        )
    return matched


def _check_mapping(mapping: Mapping[str, str]) -> None:
    """Raise InputError for a key that is no canonical column, and no temperature."""
    temperature_endings = tuple(f"_{unit}" for unit in ("degC", *UNITS))
    for key in mapping:
        if key in KNOWN_COLUMNS or key.endswith(temperature_endings):
            continue
        close = get_close_matches(key, KNOWN_COLUMNS, n=1, cutoff=0.6)
        remedy = (
            f"did you mean {close[0]!r}?" if close else f"the names are {', '.join(KNOWN_COLUMNS)}"
        )
        raise InputError(
            f"{key!r} is not a canonical column",
            where="rig.toml [columns]",
            expected='canonical name = "name in the log file"',
            remedy=remedy,
        )


def _misnamed_switches(
    layout: Layout,
    names: Collection[str],
    matched: Mapping[str, str],
    mapping: Mapping[str, str],
    without: Collection[str],
) -> list[str]:
    """Optional switches without a column that are mapped, or similar to a name in the file.

    Parameters
    ----------
    layout
        Layout of the kind of log.
    names
        Names in the file.
    matched
        Canonical name to name in the file, of the columns that were found.
    mapping
        ``[columns]`` of the rig file.
    without
        Columns that are not read.
    """
    unused = [n for n in names if n not in matched.values()]
    switches = [
        c
        for c in SWITCHES
        if c in layout.columns and c not in (*layout.required, *matched, *without)
    ]
    return [c for c in switches if c in mapping or suggestion(c, unused)]


def _air_columns(air: Mapping[str, str], names: Collection[str], where: str) -> Mapping[str, str]:
    """Check that the file holds the columns of ``[ambient]``; return them.

    Parameters
    ----------
    air
        Name after reading to name in the file.
    names
        Names in the file.
    where
        Name of the file, for messages.
    """
    role = "the column of rig.toml [ambient]"
    return {name: column_named(column, names, where, role=role) for name, column in air.items()}


def normalised_name(name: str) -> str:
    """A name in lower case without brackets, units, degree signs and separators.

    >>> normalised_name("Fast A [°C]"), normalised_name("fast_a_degC")
    ('fasta', 'fasta')
    """
    text = _words(name)
    return re.sub(r"_(deg_?c|deg|degc|celsius|c|s|sec|seconds|n|rpm)$", "", text).replace("_", "")


def _words(name: str) -> str:
    """The words of a name in lower case, separated by underscores; brackets are left out."""
    text = re.sub(r"[\[(].*?[\])]", "", name.lower()).replace("°", "deg")
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def suggestion(missing: str, names: Iterable[str]) -> str | None:
    """The name in the file that is most similar to ``missing``, or None if none is similar.

    Parameters
    ----------
    missing
        Canonical name.
    names
        Names in the file.

    Notes
    -----
    The cut-off 0.75 of ``difflib`` is chosen by judgement; a lower one suggests wrong names.
    """
    by_key: dict[str, str] = {}
    for name in names:
        by_key.setdefault(normalised_name(name), name)
        # a final "c" may be degrees Celsius, or junction c
        by_key.setdefault(_words(name).replace("_", ""), name)
    key = normalised_name(missing)
    if key in by_key:
        return by_key[key]
    close = get_close_matches(key, by_key, n=1, cutoff=0.75)
    return by_key[close[0]] if close else None


def _check_once(names: tuple[str, ...], name: str, where: str) -> None:
    """Raise InputError for a column that occurs more than once.

    Parameters
    ----------
    names
        Names in the file.
    name
        Name to check.
    where
        Name of the file, for messages.
    """
    if names.count(name) > 1:
        columns = [str(i + 1) for i, n in enumerate(names) if n == name]
        raise InputError(
            f"column {name!r} occurs {len(columns)} times (columns {', '.join(columns)})",
            where=where,
            expected="each column once",
            remedy="delete or rename the copies",
        )


def _missing_columns(
    missing: list[str],
    names: tuple[str, ...],
    available: set[str],
    kind: str,
    where: str,
    mapping: Mapping[str, str],
    layouts: Mapping[str, Layout],
) -> InputError:
    """The error for missing columns, with the most likely cause and what to write.

    Parameters
    ----------
    missing
        Canonical names that are missing.
    names
        Names in the file.
    available
        Names in the file and canonical names that were found.
    kind
        Kind of log.
    where
        Name of the file, for messages.
    mapping
        ``[columns]`` of the rig file.
    layouts
        Layouts of the rig.
    """
    layout = layouts[kind]
    other = recognise(available, layouts)
    if other is not None and other != kind:
        is_complete = set(layouts[other].required) <= available
        if len(missing) >= 2 or is_complete:
            return InputError(
                f"this looks like {LAYOUTS[other].name} (it lacks {_first_names(missing)})",
                where=where,
                expected=layout.name,
                remedy=f"give {layout.name} here",
            )
    candidates = [n for n in names if n not in layout.columns]
    similar: dict[str, str] = {}
    for column in missing:
        name = suggestion(column, (n for n in candidates if n not in similar.values()))
        if name:
            similar[column] = name
    if similar:
        remedy = _remedy_with_suggestions(missing, similar, candidates)
    elif missing == ["time_s"]:
        remedy = (
            "name it ({time}), or give the sampling interval ({dt_s}); the file has "
            f"{', '.join(map(repr, names))}"
        )
    else:
        pronoun = "it" if len(missing) == 1 else "them"
        remedy = (
            f"map {pronoun} in rig.toml [columns], such as {missing[0]} = 'its name in the file'; "
            f"the file has {', '.join(map(repr, names))}"
        )
    verb = "column is" if len(missing) == 1 else "columns are"
    what = f"{', '.join(missing)}: {verb} missing"
    mapped = [
        f"{column} = {mapping[column]!r} is mapped, but the file has no such column"
        for column in missing
        if column in mapping
    ]
    if len(mapped) > MAX_NAMES_IN_QUESTION:
        mapped = [mapped[0], "so it is with the others"]
    if mapped:
        what += f" ({'; '.join(mapped)})"
    only_channels = not similar and kind == "ehl" and all(m.startswith(DISKS) for m in missing)
    unknown = [repr(n) for n in candidates if n not in KNOWN_COLUMNS]
    if only_channels and unknown:
        question = " or ".join(unknown[:MAX_NAMES_IN_QUESTION])
        what += f" (is it {question}? then map it in rig.toml [columns])"
    return InputError(
        what,
        where=where,
        expected=layout.name,
        remedy=remedy,
        parameters={"time": "COLUMN", "dt_s": "SECONDS"},
        column=missing[0] if only_channels else "",
    )


def _first_names(names: list[str]) -> str:
    """The first names, and how many more there are."""
    text = ", ".join(names[:MAX_NAMES_IN_QUESTION])
    if len(names) > MAX_NAMES_IN_QUESTION:
        text += f" and {len(names) - MAX_NAMES_IN_QUESTION} more"
    return text


def _remedy_with_suggestions(
    missing: list[str], similar: Mapping[str, str], candidates: list[str]
) -> str:
    """What to write for the missing columns that have a similar name in the file.

    Parameters
    ----------
    missing
        Canonical names that are missing.
    similar
        Similar name in the file, by canonical name.
    candidates
        Names in the file that are no canonical names of this kind of log.
    """
    pairs = ", ".join(f'{column} = "{name}"' for column, name in similar.items())
    question = "the names below"
    if len(similar) <= MAX_NAMES_IN_QUESTION:
        question = ", ".join(map(repr, similar.values()))
    remedy = f"did you mean {question}? write {pairs} in rig.toml [columns]"
    if len(similar) == len(missing):
        return remedy
    without_match = [column for column in missing if column not in similar]
    remedy += f"; nothing in the file looks like {', '.join(without_match)}"
    unused = [name for name in candidates if name not in similar.values()]
    if unused:
        remedy += f" (not used so far: {', '.join(map(repr, unused))})"
    return remedy
