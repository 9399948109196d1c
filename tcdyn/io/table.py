"""What every reader of a form of file gives: named columns of numbers, piece by piece, on one time grid."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, SampleLocation, warning

PIECE_ROWS = 50_000
SAME = 1e-3  # of a sample: starts closer than this are one start (time stamps are good to a microsecond)


@dataclass(frozen=True)
class Columns:
    """The wanted columns, float64 of shape (N,), NaN where the file has no number; findings say what was done.

    ``place`` tells where the samples of the whole file stand in it. ``stamps`` holds the cells (N,) of columns of clock
    stamps as they are in the file; their ``data`` are seconds since the first stamp.
    """

    data: dict[str, Array]
    place: SampleLocation
    findings: tuple[Finding, ...] = ()
    stamps: dict[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Table:
    """What every reader gives: the columns' names as the file has them, what it says about itself, its pieces.

    ``pieces(wanted, rows)`` gives the wanted columns by their names in the file, about ``rows`` rows at a time, and may
    be asked for again. ``units``: by column, from a row of units below the header.
    """

    where: str
    names: tuple[str, ...]
    metadata: dict[str, str]
    pieces: Callable[[Sequence[str], int], Iterator[Columns]]
    units: Mapping[str, str] = field(default_factory=dict, kw_only=True)


def in_pieces(whole: Columns, wanted: Sequence[str], rows: int = PIECE_ROWS) -> Iterator[Columns]:
    """The wanted of columns that are read already, ``rows`` rows at a time; the findings come with the first."""
    for start in range(0, len(next(iter(whole.data.values()))), rows):
        part = {name: whole.data[name][start : start + rows] for name in wanted}
        stamps = {name: cells[start : start + rows] for name, cells in whole.stamps.items()}
        yield Columns(part, whole.place, () if start else whole.findings, stamps)


def read_whole(table: Table, wanted: Sequence[str]) -> Columns:
    """The wanted columns of the whole file: its pieces joined."""
    parts = list(table.pieces(wanted, PIECE_ROWS))
    return joined(parts, wanted, parts[0].place if parts else SampleLocation(table.where))


def joined(parts: Sequence[Columns], wanted: Sequence[str], place: SampleLocation) -> Columns:
    """The wanted columns of all ``parts``, one below the other, with their findings."""
    data = {
        name: np.concatenate([np.empty(0), *(part.data[name] for part in parts)]) for name in wanted
    }
    clocks = {name for part in parts for name in part.stamps}
    stamps = {
        name: np.concatenate([part.stamps[name] for part in parts if name in part.stamps])
        for name in clocks
    }
    return Columns(data, place, tuple(f for part in parts for f in part.findings), stamps)


def missing(what: str, name: str, names: Collection[str], where: str) -> InputError:
    """The error of a column that is not among ``names``."""
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    return InputError(
        f"{what} {name!r} is missing",
        where=where,
        expected=f"one of {', '.join(map(repr, names))}",
        remedy=f"did you mean {near[0]!r}?" if near else "",
    )


@dataclass(frozen=True)
class Track:
    """One channel: values (N,), its start [s] and sample interval [s]; ``dt_s`` None where nobody wrote it."""

    values: Array
    start_s: float = 0.0
    dt_s: float | None = None

    @property
    def same_as(self) -> tuple[int, float, float | None]:
        """What two tracks must share to be stacked without interpolation (starts to the microsecond)."""
        return len(self.values), round(self.start_s, 6), self.dt_s

    @property
    def end_s(self) -> float:
        """Time of the last sample [s]."""
        return self.start_s + (len(self.values) - 1) * (self.dt_s or 0.0)


def align(
    tracks: Mapping[str, Track], where: str
) -> tuple[Array | None, dict[str, Array], list[Finding]]:
    """Time [s] from the common start (None if no track has one), the channels on it, and what was done.

    Tracks that agree are stacked as they are. Others are cut to the span that all share and put on the grid of the
    fastest: straight lines between samples, two-level channels held. A channel without interval takes the track of
    the others if it has as many samples as they.

    Raises InputError for a channel whose time nobody can know, or when no time is shared.
    """
    found: list[Finding] = []
    timed = {name: t for name, t in tracks.items() if t.dt_s}
    if not timed:
        lengths = {len(t.values) for t in tracks.values()}
        if len(lengths) > 1:
            raise InputError(
                f"channels have {min(lengths)} to {max(lengths)} samples and no time track",
                where=where,
                expected="one length, or wf_increment on each channel",
            )
        return None, {name: t.values for name, t in tracks.items()}, found
    full = dict(tracks)
    for name, track in tracks.items():
        if not track.dt_s:
            twin = next((n for n, t in timed.items() if len(t.values) == len(track.values)), None)
            if twin is None:
                raise InputError(
                    f"channel {name} has no time track (no wf_increment)",
                    where=where,
                    expected=f"as many samples as another channel; it has {len(track.values)}",
                )
            full[name] = Track(track.values, timed[twin].start_s, timed[twin].dt_s)
            found.append(warning("tracks.assumed", subject=name, of=twin))
    if len({t.same_as for t in full.values()}) == 1:
        track = next(iter(full.values()))
        time = np.asarray(np.arange(len(track.values)) * float(track.dt_s or 1.0), dtype=np.float64)
        return time, {name: t.values for name, t in full.items()}, found
    time, data = _onto_grid(full, where)
    late = max(full, key=lambda n: full[n].start_s)
    spread = full[late].start_s - min(t.start_s for t in full.values())
    rates = sorted({round(1 / t.dt_s, 6) for t in full.values() if t.dt_s})
    found.append(warning("tracks.aligned", subject=late, spread_s=spread, rates_Hz=rates))
    return time, data, found


def _onto_grid(tracks: Mapping[str, Track], where: str) -> tuple[Array, dict[str, Array]]:
    begin = max(t.start_s for t in tracks.values())
    end = min(t.end_s for t in tracks.values())
    grid = min(tracks.values(), key=lambda t: t.dt_s or np.inf)
    step = float(grid.dt_s or 1.0)
    first = int(np.ceil((begin - grid.start_s) / step - SAME))
    last = int(np.floor((end - grid.start_s) / step + SAME))
    if last <= first:
        raise InputError(
            "the channels share no time", where=where, expected="overlapping time tracks"
        )
    at = grid.start_s + np.arange(first, last + 1) * step
    data: dict[str, Array] = {}
    for name, track in tracks.items():
        place = np.clip((at - track.start_s) / float(track.dt_s or 1.0), 0, len(track.values) - 1)
        nearest = np.rint(place)
        v = track.values
        place = np.where(np.abs(place - nearest) < SAME, nearest, place)
        held = len(np.unique(v[np.isfinite(v)][:100_000])) <= 2
        data[name] = v[place.astype(int)] if held else np.interp(place, np.arange(len(v)), v)
    return at - at[0], data
