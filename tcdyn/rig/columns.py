"""The canonical columns of each kind of log, and how the names in a file are matched to them."""

from __future__ import annotations

import re
from collections.abc import Collection, Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Literal

from tcdyn.core.errors import InputError
from tcdyn.rig.disk import CHANNELS, DISKS

Kind = Literal["oven", "immersion", "ehl", "hole"]


@dataclass(frozen=True)
class Layout:
    """What one kind of log is called in sentences, its columns in canonical order, and those that may be missing."""

    name: str
    columns: tuple[str, ...]
    optional: tuple[str, ...] = ()

    def holding(self, couples: Collection[str]) -> Layout:
        """The same log of a rig whose junctions' columns are ``couples``."""
        known = {*DISK_CHANNELS, *EHL_CHANNELS}
        at = next((k for k, c in enumerate(self.columns) if c in known), len(self.columns))
        kept = [
            tuple(c for c in part if c not in known)
            for part in (self.columns[:at], self.columns[at:])
        ]
        return (
            replace(self, columns=(*kept[0], *couples, *kept[1]))
            if len(self.columns) > at
            else self
        )

    @property
    def required(self) -> tuple[str, ...]:
        """The columns that must be there."""
        return tuple(c for c in self.columns if c not in self.optional)


def couples(channels: Iterable[str], disk: str = "") -> tuple[str, ...]:
    """The columns of a disk's junctions: in EHL logs after the disk's name.

    >>> couples("ab"), couples(["t1"], "fast")
    (('a_degC', 'b_degC'), ('fast_t1_degC',))
    """
    return tuple(f"{disk}_{c}_degC" if disk else f"{c}_degC" for c in channels)


DISK_CHANNELS = couples(CHANNELS)  # of the thesis's disks
EHL_CHANNELS = tuple(name for disk in DISKS for name in couples(CHANNELS, disk))
SWITCHES = ("switch", "contact")
ROOM_AND_BATH = ("ambient_degC", "oil_degC", "probe_degC", "fluid_degC")
EHL_RUNNING = ("load_N", "friction_N", "contact", "speed_fast_rpm", "speed_slow_rpm")
TORQUES = tuple(
    f"torque_{disk}_Nm" for disk in DISKS
)  # of a shaft: friction times the disk's radius
UNITS = ("K", "degF", "mV")  # that a temperature's name may end in, in place of degC

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
        ("time_s", *EHL_RUNNING, *TORQUES, *EHL_CHANNELS, "ambient_degC", "oil_degC"),
        ("oil_degC", "contact", *TORQUES),
    ),
    "hole": Layout(
        "a hole-comparison log",
        ("time_s", "switch", "probe_degC", "fluid_degC"),
        ("switch", "probe_degC", "fluid_degC"),
    ),
}
FEW = 3  # names that a question may hold; more stand in the lines to write only
NOT_JUNCTIONS = (*ROOM_AND_BATH, "prt_degC", "setpoint_degC")
KNOWN = tuple(dict.fromkeys(name for layout in LAYOUTS.values() for name in layout.columns))


def is_couple(name: str) -> bool:
    """Whether a column is a junction's: a temperature that is neither the room's nor a bath's, a probe's or the PRT's.

    >>> is_couple("fast_a_degC"), is_couple("oil_degC")
    (True, False)
    """
    return name.endswith("_degC") and not is_air(name) and name not in NOT_JUNCTIONS


def couples_in(columns: Iterable[Hashable]) -> list[str]:
    """The junctions' columns among those of a log."""
    return [name for name in map(str, columns) if is_couple(name)]


def is_air(name: str) -> bool:
    """Whether a column is the temperature of a room, a bath, a free probe, or one of the channels about a disk.

    >>> is_air("oil_degC"), is_air("ambient_north_degC"), is_air("a_degC")
    (True, True, False)
    """
    return name in ROOM_AND_BATH or (name.startswith("ambient_") and name.endswith("_degC"))


def named(
    canonical: str, mapping: Mapping[str, str], names: Collection[str]
) -> tuple[str, str] | None:
    """The column of a file that is ``canonical``, and its unit: as mapped, by its own name, or by that in another unit.

    >>> named("fast_a_degC", {"fast_a_mV": "TC1"}, ["TC1"]), named("fast_a_degC", {}, ["fast_a_K"])
    (('TC1', 'mV'), ('fast_a_K', 'K'))
    """
    stem, _, unit = canonical.rpartition("_")
    for own in (unit, *(UNITS if unit == "degC" else ())):
        for candidate in (
            mapping.get(f"{stem}_{own}" if stem else canonical),
            f"{stem}_{own}" if stem else canonical,
        ):
            if candidate is not None and candidate in names:
                return candidate, own
    return None


def in_other_units(names: Iterable[str]) -> tuple[str, ...]:
    """The names with those of temperatures in every unit that one may be logged in."""
    return tuple(
        n.removesuffix("degC") + u
        for n in names
        for u in (("degC", *UNITS) if n.endswith("_degC") else ("",))
    )


def recognise(names: Iterable[str], layouts: Mapping[str, Layout] = LAYOUTS) -> str | None:
    """The kind of log that these column names make, or None; the hole kind is never guessed.

    >>> recognise(["repeat", "prt_degC", "a_degC", "b_degC", "c_degC", "d_degC", "e_degC", "f_degC"])
    'oven'
    """
    have = set(names)
    for kind in ("ehl", "oven", "immersion"):
        if set(layouts[kind].required) <= have:
            return kind
    first = next((c for c in layouts["ehl"].columns if c.startswith("fast_")), "")
    signs = {
        "ehl": {"load_N", "friction_N", "contact", first},
        "oven": {"prt_degC", "setpoint_degC"},
    }
    signs["immersion"] = {"switch", "fluid_degC", "probe_degC"}
    score = {kind: len(sign & have) for kind, sign in signs.items()}
    best = max(score, key=lambda kind: score[kind])
    return best if score[best] >= 2 else None


def match_columns(
    names: tuple[str, ...],
    kind: str,
    where: str,
    mapping: Mapping[str, str] | None = None,
    without: Collection[str] = (),
    stated: Collection[str] = (),
    air: Mapping[str, str] | None = None,
    layouts: Mapping[str, Layout] = LAYOUTS,
) -> dict[str, str]:
    """Canonical name -> name in the file, in canonical order.

    ``mapping`` is rig.toml's ``[columns]``. A mapped name that the file lacks is no error while the canonical name
    itself is there; a temperature may be there in another unit. ``without``: columns that are left unread. ``stated``:
    columns that need not be there; ``air``: name -> name in the file of channels that must be there, too. Where an EHL
    log has no friction a shaft's torque stands for it, under its own name. For the hole kind every further column
    ending in ``_degC`` is a channel. ``layouts``: of the rig's logs, see ``Layout.holding``.

    Raises InputError for a duplicate or missing column, an unknown mapping key, or a file of another kind.
    """
    layout = layouts[kind]
    mapping = mapping or {}
    for key in mapping:
        if key not in KNOWN and not key.endswith(tuple(f"_{unit}" for unit in ("degC", *UNITS))):
            close = get_close_matches(key, KNOWN, n=1, cutoff=0.6)
            raise InputError(
                f"{key!r} is not a canonical column",
                where="rig.toml [columns]",
                expected='canonical name = "name in the log file"',
                remedy=f"did you mean {close[0]!r}?"
                if close
                else f"the names are {', '.join(KNOWN)}",
            )
    chosen: dict[str, str] = {}
    wanted = tuple(c for c in layout.columns if c not in without)
    if kind == "hole":
        taken = set(mapping.values()) | set(wanted)
        wanted += tuple(n for n in dict.fromkeys(names) if n.endswith("_degC") and n not in taken)
    for canonical in wanted:
        if (found := named(canonical, mapping, names)) is not None:
            _check_once(names, found[0], where)
            chosen[canonical] = found[0]
    if "time_s" not in chosen and "time" in names:
        _check_once(names, "time", where)
        chosen = {"time_s": "time", **chosen}
    torques = [c for c in TORQUES if c in chosen]
    needless = {*without, *stated, *(["friction_N"] if torques else ())}
    missing = [c for c in layout.required if c not in chosen and c not in needless]
    free = [n for n in names if n not in chosen.values()]
    maybe = [
        c
        for c in SWITCHES
        if c in layout.columns and c not in (*layout.required, *chosen, *without)
    ]
    missing += [c for c in maybe if kind != "hole" and (c in mapping or suggestion(c, free))]
    if kind == "ehl":
        for name, column in (air or {}).items():
            if column not in names:
                raise InputError(
                    f"has no column {column!r}, which rig.toml [ambient] names",
                    where=where,
                    expected=f"one of {', '.join(map(repr, names))}",
                )
            chosen[name] = column
        for torque in torques["friction_N" not in chosen :]:
            del chosen[torque]
    if missing:
        raise _missing(missing, names, set(chosen) | set(names), kind, where, mapping, layouts)
    channels = [c for c in chosen if c.endswith("_degC") and c not in layout.columns]
    if kind == "hole" and len(channels) < 2:
        raise InputError(
            f"has {len(channels)} thermocouple column(s)",
            where=where,
            expected="at least two columns whose names end in _degC",
            remedy="rename the columns or map them in rig.toml [columns]",
        )
    return chosen


def normalised(name: str) -> str:
    """A name with case, unit brackets, degree signs and separators taken away, to find near misses.

    >>> normalised("Fast A [°C]"), normalised("fast_a_degC")
    ('fasta', 'fasta')
    """
    text = _words(name)
    return re.sub(r"_(deg_?c|deg|degc|celsius|c|s|sec|seconds|n|rpm)$", "", text).replace("_", "")


def _words(name: str) -> str:
    text = re.sub(r"[\[(].*?[\])]", "", name.lower()).replace("°", "deg")
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def suggestion(missing: str, names: Iterable[str]) -> str | None:
    """The name in the file that most looks like ``missing``, if any looks like it at all."""
    by_key: dict[str, str] = {}
    for name in names:
        by_key.setdefault(normalised(name), name)
        by_key.setdefault(
            _words(name).replace("_", ""), name
        )  # a last "c" may be degrees or junction c
    key = normalised(missing)
    if key in by_key:
        return by_key[key]
    close = get_close_matches(key, by_key, n=1, cutoff=0.75)
    return by_key[close[0]] if close else None


def _check_once(names: tuple[str, ...], name: str, where: str) -> None:
    if names.count(name) > 1:
        at = [i + 1 for i, n in enumerate(names) if n == name]
        raise InputError(
            f"column {name!r} stands {len(at)} times (columns {', '.join(map(str, at))})",
            where=where,
            expected="each column once",
            remedy="delete or rename the copies",
        )


def _missing(
    missing: list[str],
    names: tuple[str, ...],
    have: set[str],
    kind: str,
    where: str,
    mapping: Mapping[str, str],
    layouts: Mapping[str, Layout],
) -> InputError:
    layout = layouts[kind]
    looks = recognise(have, layouts)
    if (
        looks is not None
        and looks != kind
        and (len(missing) >= 2 or set(layouts[looks].required) <= have)
    ):
        lacks = ", ".join(missing[:FEW]) + (
            f" and {len(missing) - FEW} more" if len(missing) > FEW else ""
        )
        return InputError(
            f"this looks like {LAYOUTS[looks].name} (it lacks {lacks})",
            where=where,
            expected=layout.name,
            remedy=f"give {layout.name} here",
        )
    free = [n for n in names if n not in layout.columns]
    near: dict[str, str] = {}
    for m in missing:
        like = suggestion(m, (n for n in free if n not in near.values()))
        near |= {m: like} if like else {}
    mapped = [
        f"{m} = {mapping[m]!r} is mapped, but the file has no such column"
        for m in missing
        if m in mapping
    ]
    mapped = [*mapped[:1], "so it is with the others"] if len(mapped) > FEW else mapped
    if near:
        pairs = ", ".join(f'{m} = "{s}"' for m, s in near.items())
        asked = ", ".join(map(repr, near.values())) if len(near) <= FEW else "the names below"
        remedy = f"did you mean {asked}? write {pairs} in rig.toml [columns]"
        if len(near) < len(missing):
            unused = [n for n in free if n not in near.values()]
            remedy += (
                f"; nothing in the file looks like {', '.join(m for m in missing if m not in near)}"
            )
            remedy += f" (not used so far: {', '.join(map(repr, unused))})" if unused else ""
    else:
        them = "it" if len(missing) == 1 else "them"
        remedy = f"map {them} in rig.toml [columns], such as {missing[0]} = 'its name in the file'"
        remedy += f"; the file has {', '.join(map(repr, names))}"
    is_are = "column is" if len(missing) == 1 else "columns are"
    what = f"{', '.join(missing)}: {is_are} missing" + (f" ({'; '.join(mapped)})" if mapped else "")
    alone = not near and kind == "ehl" and all(m.startswith(DISKS) for m in missing)
    if alone and (strange := [repr(n) for n in free if n not in KNOWN]):
        what += f" (is it {' or '.join(strange[:FEW])}? then map it in rig.toml [columns])"
    return InputError(
        what, where=where, expected=layout.name, remedy=remedy, column=missing[0] if alone else ""
    )
