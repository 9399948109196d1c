"""Files that people have, with what their maker knows of them: clock, gaps, readings and reasons.

Each command must read the same from each file (``tests/series/test_one_answer.py``). The logs are
those of :mod:`tests.series.corpus_logs`; the layouts follow ``tests/io/logger_families.py``. A cell
that is no reading has one reason:

- ``empty``: a blank cell;
- ``word``: text instead of a number;
- ``code``: one value, exactly repeated, that stands for no reading;
- ``range``: other values that no thermocouple has;
- ``repeat``: a value that the logger holds until a slower channel has a new one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import xlsxwriter
from nptdms import ChannelObject, TdmsWriter
from pyarrow import parquet as pq
from scipy.io import savemat

from tests.series.corpus_logs import (
    INTERVAL_RTOL,
    Log,
    clock,
    make_log,
    put,
    repeated,
    seconds,
    slow,
    some_rows,
    truth_of,
)

FINE, COARSE, INPUT = "T_fine_degC", "T_coarse_degC", "u"
ISO = "%Y-%m-%d %H:%M:%S"
ISO_MS = "%Y-%m-%d %H:%M:%S.{ms}"
Writer = Callable[[Path], Path]
# What a log of the rig may have, see ``tcdyn.rig.log.RIG_POLICY`` and ``tcdyn.rig.check_columns``.
RIG_LONGEST_INTERVAL_S = 1.0
RIG_LONGEST_GAP_S = 0.5
RIG_LONGEST_GAP_INTERVALS = 3
RIG_MISSING_SHARE = 0.05


@dataclass(frozen=True)
class CorpusFile:
    """A file and what its maker knows of it.

    Attributes
    ----------
    kind, name
        What is special about it, and its name.
    write
        Writes the file into a folder, and returns its path.
    truth
        See ``tests.series.corpus_logs.truth_of``.
    columns, input
        Both columns of temperature, the fine sensor first, and the column of the heater.
    options
        What the user states: ``time`` and ``time_unit``.
    grows
        Whether it is a text that grows line by line, so that it can be followed.
    time
        Name of the time column, which the rig file states; empty for a file whose time has no
        column of its own.
    refused
        Why each command must refuse the file; empty: each must read it.
    """

    kind: str
    name: str
    write: Writer
    truth: dict[str, Any]
    columns: tuple[str, str] = (FINE, COARSE)
    input: str = INPUT
    options: dict[str, str] = field(default_factory=dict)
    grows: bool = True
    time: str = "time_s"
    refused: str = ""


@dataclass(frozen=True)
class RigLog:
    """A file as a log of the rig.

    Attributes
    ----------
    path, kind
        The file and its kind, for ``tcdyn.rig.log.read_log``.
    rig
        Text of the rig file that names its columns.
    columns
        Canonical name of each column of temperature, by its name in the file.
    """

    path: Path
    kind: str
    rig: str
    columns: dict[str, str]


FILES: list[CorpusFile] = []


def text_file(
    lines: Sequence[str], encoding: str = "utf-8", end: str = "\n", file: str = "log.csv"
) -> Writer:
    """Writer of a text file."""

    def write(folder: Path) -> Path:
        path = folder / file
        path.write_bytes((end.join(lines) + end).encode(encoding))
        return path

    return write


def rows_of(*columns: Sequence[str], separator: str = ",", decimal: str = ".") -> list[str]:
    """One line a row; a decimal mark other than the point is put into cells of numbers."""
    lines = []
    for cells in zip(*columns, strict=True):
        if decimal != ".":
            cells = tuple(_with_mark(cell, decimal) for cell in cells)
        lines.append(separator.join(cells))
    return lines


def _with_mark(cell: str, decimal: str) -> str:
    """A cell with this decimal mark, if it is a number with a point."""
    digits = cell.replace(".", "", 1).removeprefix("-")
    return cell.replace(".", decimal) if digits.isdigit() else cell


def quoted(texts: Sequence[str]) -> list[str]:
    """Texts in quotes."""
    return [f'"{text}"' for text in texts]


def add(
    kind: str, name: str, log: Log, write: Writer, *, start_s: float = 0.0, **rest: Any
) -> None:
    """Add a file to ``FILES``; ``start_s`` is the time of its first sample, ``rest`` the fields."""
    fine, coarse = rest.get("columns", (FINE, COARSE))
    truth = truth_of(log, {"fine": fine, "coarse": coarse}, start_s)
    FILES.append(CorpusFile(kind, name, write, truth, **rest))


def add_csv(
    kind: str,
    name: str,
    log: Log,
    times: Sequence[str] | None = None,
    time: str = "time_s",
    *,
    names: tuple[str, str] = (FINE, COARSE),
    input: str = INPUT,
    above: Sequence[str] = (),
    below: Sequence[str] = (),
    separator: str = ",",
    decimal: str = ".",
    start_s: float = 0.0,
    options: dict[str, str] | None = None,
    encoding: str = "utf-8",
    end: str = "\n",
    file: str = "log.csv",
    grows: bool = True,
    refused: str = "",
) -> None:
    """Add a table of text with the time in its first column.

    Parameters
    ----------
    kind, name, log
        As for ``add``.
    times, time
        Cells and name of the time column; None: seconds with three decimals.
    names, input
        Names of the columns.
    above, below
        Lines above the header, and lines between header and rows.
    separator, decimal
        Marks of the file.
    start_s, options, grows, refused
        As for ``add``.
    encoding, end, file
        As for ``text_file``.
    """
    times = seconds(log, 3, start_s) if times is None else times
    lines = [
        *above,
        separator.join([time, *names, input]),
        *below,
        *rows_of(times, *_cells(log), separator=separator, decimal=decimal),
    ]
    unquoted = tuple(name.strip('"') for name in names)
    add(
        kind,
        name,
        log,
        text_file(lines, encoding, end, file),
        start_s=start_s,
        columns=unquoted,
        input=input.strip('"'),
        options=options or {},
        grows=grows,
        refused=refused,
        time=time.strip('"'),
    )


def _cells(log: Log) -> tuple[tuple[str, ...], ...]:
    """Cells of both sensors and of the heater."""
    return log.cells["fine"], log.cells["coarse"], log.cells["u"]


def _plain() -> None:
    for k, (interval_s, digits) in enumerate(((1.0, 0), (0.5, 1), (0.25, 2), (0.1, 1), (0.05, 2))):
        log = make_log(400, interval_s, 100 + k)
        add_csv("plain", f"rows every {interval_s:g} s", log, seconds(log, digits))
    log = make_log(900, 1 / 75, 106)
    add_csv("plain", "75 Hz with six decimals", log, seconds(log, 6))
    log = make_log(300, 0.2, 107)
    add_csv("plain", "a clock that starts late, tabs", log, start_s=1234.5, separator="\t")


def _jitter() -> None:
    for k, percent in enumerate((2, 5, 10, 17)):
        log = make_log(600, 0.1, 200 + k, jitter=percent / 100)
        add_csv("jitter of the samples", f"samples stray by {percent} %", log, seconds(log, 4))
        log = make_log(600, 0.1, 210 + k, stamp_jitter=percent / 100)
        add_csv("jitter of the stamps", f"stamps stray by {percent} %", log, seconds(log, 4))
    log = make_log(800, 0.05, 220, jitter=0.05, lost=0.01)
    add_csv("jitter of the samples", "samples stray by 5 %, 1 % lost", log, seconds(log, 4))
    log = make_log(800, 0.05, 221, stamp_jitter=0.10, lost=0.01)
    add_csv("jitter of the stamps", "stamps stray by 10 %, 1 % lost", log, seconds(log, 4))
    log = make_log(500, 1.0, 222, stamp_jitter=0.05)
    add_csv("jitter of the stamps", "stamps of a clock", log, clock(log, ISO_MS), "timestamp")


def _rounded() -> None:
    kind = "rounded stamps"
    log = make_log(900, 1 / 75, 300, tick_s=1e-3, cut=False)
    add_csv(kind, "75 Hz in ms", log)
    log = make_log(900, 1 / 75, 301, tick_s=1e-2, cut=False)
    add_csv(kind, "75 Hz in 0.01 s", log, seconds(log, 2))
    log = make_log(900, 1 / 75, 302, tick_s=1e-3, cut=False, lost=0.01)
    add_csv(kind, "75 Hz in ms, 1 % lost", log)
    log = make_log(600, 1 / 30, 303, tick_s=1e-2)
    add_csv(kind, "30 Hz cut to 0.01 s", log, seconds(log, 2))
    log = make_log(400, 1.5, 304, tick_s=1.0)
    add_csv(kind, "a row every 1.5 s in whole seconds", log, seconds(log, 0))
    kind = "whole-second stamps"
    for k, rate_Hz in enumerate((2, 5, 10)):
        log = make_log(100 * rate_Hz, 1 / rate_Hz, 310 + k, tick_s=1.0)
        add_csv(kind, f"{rate_Hz} Hz in whole seconds", log, seconds(log, 0))
    log = make_log(900, 0.1, 313, tick_s=1.0)
    add_csv(kind, "10 Hz, stamps with a date", log, clock(log, ISO), "timestamp")
    log = make_log(600, 0.2, 314, tick_s=1.0)
    times = [f"{1710151190 + stamp:.0f}" for stamp in log.stamp_s]
    add_csv(
        kind,
        "5 Hz, seconds since 1970",
        log,
        times,
        "epoch_s",
        start_s=1710151190.0,
        options={"time": "epoch_s"},
    )
    log = make_log(900, 0.1, 315, tick_s=1.0, gaps=[(500, 80)])
    add_csv(kind, "10 Hz in whole seconds, a gap of 80 rows", log, seconds(log, 0))
    log = make_log(600, 0.5, 316, tick_s=5.0)
    add_csv(kind, "a batch of ten rows has the stamp of its arrival", log, seconds(log, 0))
    log = make_log(1000, 1 / 9.7, 317, tick_s=1.0)
    add_csv(kind, "9.7 Hz in whole seconds", log, seconds(log, 0))


def _lost() -> None:
    for k, (share, interval_s, digits) in enumerate(
        ((0.01, 0.1, 1), (0.01, 1.0, 0), (0.05, 0.1, 1), (0.05, 1.0, 0))
    ):
        log = make_log(600, interval_s, 400 + k, lost=share)
        name = f"{share:.0%} of rows every {interval_s:g} s"
        add_csv("lost rows", name, log, seconds(log, digits))
    log = make_log(600, 0.1, 404, lost=0.05, stamp_jitter=0.02)
    add_csv("lost rows", "5 % lost, stamps stray by 2 %", log, seconds(log, 4))
    log = make_log(600, 1.0, 405, lost=0.02)
    add_csv("lost rows", "2 % lost, stamps with a date", log, clock(log, ISO), "timestamp")
    log = make_log(700, 0.1, 410, gaps=[(400, 80)])
    add_csv("one gap", "80 rows of 0.1 s", log, seconds(log, 1))
    log = make_log(1000, 1 / 75, 411, tick_s=1e-3, cut=False, gaps=[(600, 80)])
    add_csv("one gap", "80 rows at 75 Hz in ms", log)
    log = make_log(700, 0.1, 412, gaps=[(420, 80)], jitter=0.05)
    add_csv("one gap", "80 rows, samples stray by 5 %", log, seconds(log, 4))
    log = make_log(600, 1.0, 413, gaps=[(380, 80)])
    add_csv("one gap", "80 rows of a clock", log, clock(log, "%d.%m.%Y %H:%M:%S"), "Datum Uhrzeit")
    # longer than ten lags: ``compensate`` and ``follow`` divide the log there
    log = make_log(1100, 0.1, 417, gaps=[(500, 300)], stamp_jitter=0.05)
    add_csv("one gap", "300 rows, stamps stray by 5 %", log, seconds(log, 4))
    log = make_log(1200, 0.1, 418, gaps=[(600, 300)], tick_s=1.0)
    add_csv("one gap", "300 rows of 10 Hz in whole seconds", log, seconds(log, 0))
    log = make_log(1200, 1 / 75, 419, gaps=[(500, 5)], tick_s=1e-3, cut=False, wander=0.1)
    add_csv("several gaps", "5 rows at 75 Hz in ms, a clock that wanders", log)
    log = make_log(700, 0.1, 414, gaps=[(260, 3), (350, 25), (500, 60)])
    add_csv("several gaps", "3, 25 and 60 rows", log, seconds(log, 1))
    log = make_log(700, 0.2, 415, gaps=[(250, 8), (420, 40)], lost=0.01)
    add_csv("several gaps", "8 and 40 rows, 1 % lost", log, seconds(log, 1))
    log = make_log(800, 0.05, 416, gaps=[(300, 5), (400, 6), (650, 4)])
    add_csv("several gaps", "4 to 6 rows of 0.05 s", log, seconds(log, 2))


def _repeated() -> None:
    kind = "repeated rows"
    for k, share in enumerate((0.005, 0.08)):
        log = make_log(600, 0.1, 500 + k)
        log = repeated(log, some_rows(log, share, 500 + k))
        add_csv(kind, f"{share:.1%} of the rows twice", log, seconds(log, 1))
    log = repeated(make_log(500, 0.1, 502), range(300, 340))
    add_csv(kind, "forty rows in sequence twice", log, seconds(log, 1))
    log = make_log(500, 1.0, 503)
    log = repeated(log, some_rows(log, 0.02, 503))
    add_csv(kind, "2 % twice, stamps with a date", log, clock(log, ISO), "timestamp")
    log = make_log(600, 0.1, 504, lost=0.01)
    log = repeated(log, some_rows(log, 0.01, 504))
    add_csv(kind, "1 % twice, 1 % lost", log, seconds(log, 1))


def _cells_without_readings() -> None:
    log = make_log(500, 0.1, 600)
    log = put(log, "fine", some_rows(log, 0.02, 600), "", "empty")
    add_csv("blank cells", "2 % of one column", log, seconds(log, 1))
    log = make_log(500, 0.5, 601)
    for column, seed in (("fine", 1), ("coarse", 2)):
        log = put(log, column, some_rows(log, 0.03, seed), "", "empty")
    add_csv("blank cells", "3 % of both columns, semicolons", log, seconds(log, 1), separator=";")
    log = put(make_log(500, 0.1, 602), "coarse", range(30), "", "empty")
    add_csv("blank cells", "before the first value of a column", log, seconds(log, 1))
    log = put(make_log(700, 0.1, 603), "fine", range(400, 460), "", "empty")
    add_csv("blank cells", "sixty in a row", log, seconds(log, 1))
    for k, (word, share) in enumerate(
        (("OVLD", 0.01), ("Err", 0.02), ("--.---", 0.02), ("#N/A", 0.01), ("unavailable", 0.04))
    ):
        log = make_log(500, 0.2, 610 + k)
        reason = "empty" if word == "#N/A" else "word"
        log = put(log, "fine", some_rows(log, share, 610 + k), word, reason)
        add_csv("words", f"{share:.0%} {word}", log, seconds(log, 1))
    log = put(make_log(500, 0.2, 616), "coarse", range(350, 420), "BURNOUT", "word")
    add_csv("words", "BURNOUT for seventy rows", log, seconds(log, 1))
    log = make_log(500, 0.2, 617)
    rows = some_rows(log, 0.02, 617)
    log = put(log, "fine", rows[::2], "OVLD", "word")
    log = put(log, "fine", rows[1::2], "", "empty")
    add_csv("words", "OVLD and blank cells", log, seconds(log, 1))
    for k, (code, share) in enumerate(
        (("85.00", 0.02), ("-127.00", 0.01), ("9999.00", 0.02), ("0.00", 0.04), ("9.9E+37", 0.01))
    ):
        log = make_log(600, 0.5, 620 + k)
        log = put(log, "fine", some_rows(log, share, 620 + k), code, "code")
        add_csv("codes", f"{share:.0%} {code}", log, seconds(log, 1))
    # a code at the start of a record cannot be told from its first temperature
    log = put(make_log(600, 0.5, 626), "fine", range(6), "85.00", "")
    add_csv("codes", "85 for the first six rows after power on", log, seconds(log, 1))
    log = make_log(600, 0.5, 627)
    for column, seed in (("fine", 5), ("coarse", 6)):
        log = put(log, column, some_rows(log, 0.01, seed), "-127.00", "code")
    add_csv("codes", "-127 in both columns", log, seconds(log, 1))
    log = make_log(600, 0.2, 630)
    for k, row in enumerate(some_rows(log, 0.01, 630)):
        log = put(log, "fine", [row], f"{(-1) ** k * (3200 + 417 * k):.2f}", "range")
    add_csv("out of range", "readings beyond a thermocouple, each another", log, seconds(log, 1))


def _slow() -> None:
    for k, every in enumerate((2, 5, 10)):
        column = "fine" if every == 5 else "coarse"
        log = slow(make_log(800, 0.1, 700 + k), column, every, held=True)
        name = f"a new value every {every} rows"
        add_csv("slow column, held", name, log, seconds(log, 1))
    for k, every in enumerate((5, 10, 30)):
        log = slow(make_log(1200, 1.0, 710 + k), "coarse", every, held=False)
        name = f"a value every {every} rows"
        add_csv("slow column, blanks", name, log, seconds(log, 0))
    log = slow(make_log(1200, 1.0, 714), "coarse", 10, held=True)
    add_csv("slow column, held", "every ten rows of a clock", log, clock(log, ISO), "time")
    log = make_log(900, 1.0, 715)
    sparse = [row for row in range(170) if row % 10]
    log = put(log, "fine", sparse, "", "empty")
    add_csv("slow column, blanks", "sparse first, then each row", log, seconds(log, 0))
    # rows every 10 s while nothing happens, and every second after the step
    log = make_log(900, 1.0, 716, gaps=[(first + 1, 9) for first in range(0, 160, 10)])
    add_csv("several gaps", "rows every 10 s first, then every second", log, seconds(log, 0))


def _wandering() -> None:
    log = make_log(900, 0.1, 800, wander=0.3, stamp_jitter=0.02)
    add_csv("wandering clock", "a slow wave of 0.3 intervals", log, seconds(log, 4))
    log = make_log(900, 0.1, 801, wander=1.0)
    add_csv("wandering clock", "a slow wave of 1 interval", log, seconds(log, 4))
    log = make_log(700, 0.1, 802, loop=0.05)
    add_csv("wandering clock", "a loop that waits, steps scatter by 5 %", log, seconds(log, 4))
    log = make_log(700, 0.25, 803, loop=0.15)
    add_csv("wandering clock", "a loop that waits, steps scatter by 15 %", log, seconds(log, 4))


def _zeroless(moment: datetime) -> str:
    """A date and a clock without leading zeros in front of hours and minutes."""
    return (
        f"{moment.month}/{moment.day}/{moment.year} "
        f"{moment.hour}:{moment.minute}:{moment.second:02}"
    )


def _date_alone(moment: datetime) -> str:
    """A stamp that is a date alone at midnight."""
    text = moment.strftime(ISO)
    return text.removesuffix(" 00:00:00")


def _stamp_forms() -> None:
    kind = "forms of stamps"
    late = "2024-03-11 23:59:00"
    log = make_log(400, 1.0, 900)
    add_csv(
        kind,
        "12-hour clock through noon",
        log,
        clock(log, "%m/%d/%Y %I:%M:%S %p", late),
        "Date Time",
    )
    log = make_log(400, 1.0, 901)
    add_csv(
        kind, "a clock without a date through midnight", log, clock(log, "%H:%M:%S", late), "Time"
    )
    log = make_log(400, 1.0, 902)
    add_csv(kind, "midnight as a date alone", log, clock(log, _date_alone, late), "DateTime")
    log = make_log(400, 0.25, 903)
    add_csv(
        kind,
        "isoformat leaves out zeros of the fraction",
        log,
        clock(log, lambda m: m.isoformat()),
        "timestamp",
    )
    log = make_log(400, 1.0, 904)
    add_csv(
        kind,
        "hours and minutes without leading zeros",
        log,
        clock(log, _zeroless, "2022-04-13 08:01:00"),
        "Time",
    )
    log = make_log(400, 1.0, 905)
    add_csv(kind, "HHMMSS as a number through an hour", log, clock(log, "%H%M%S"), "Time_HHMMSS")
    log = make_log(400, 0.5, 906)
    add_csv(
        kind, "offset of local time", log, clock(log, "%Y-%m-%dT%H:%M:%S.{ms}+01:00"), "timestamp"
    )
    log = make_log(400, 1.0, 907)
    add_csv(kind, "UTC as Z", log, clock(log, "%Y-%m-%dT%H:%M:%SZ"), "time")
    log = make_log(400, 0.25, 908)
    times = [f"{1710151190000 + 1000 * stamp:.0f}" for stamp in log.stamp_s]
    add_csv(
        kind,
        "milliseconds since 1970",
        log,
        times,
        "epoch_ms",
        start_s=1710151190.0,
        options={"time": "epoch_ms"},
    )
    log = make_log(400, 1.0, 909)
    times = [f"{1710151190 + stamp:.0f}" for stamp in log.stamp_s]
    add_csv(kind, "seconds since 1970 in a column Time", log, times, "Time", start_s=1710151190.0)
    log = make_log(400, 0.1, 910)
    add_csv(
        kind,
        "milliseconds since power on",
        log,
        seconds(log, 0, 5.0, 1e-3),
        "Time (ms)",
        start_s=5.0,
    )
    log = make_log(400, 0.5, 911)
    add_csv(kind, "minutes", log, seconds(log, 6, 0.0, 60.0), "Time [min]")
    log = make_log(400, 1.0, 912)
    times = [f"{int(s) // 60:02}:{int(s) % 60:02}.5" for s in log.stamp_s]
    add_csv(kind, "a stopwatch of minutes and seconds", log, times, "Time", start_s=0.5)
    log = make_log(600, 0.1, 913)
    pc_clock = [f"2024-05-01 10:{int(s) // 60:02}:{int(s) % 60 // 2 * 2:02}" for s in log.stamp_s]
    millis = [f"{123456 + 1000 * s:.0f}" for s in log.stamp_s]
    header = f"timestamp,millis,{FINE},{COARSE},u"
    lines = [header, *rows_of(pc_clock, millis, *_cells(log))]
    options = {"time": "millis", "time_unit": "ms"}
    add(
        kind,
        "a coarse clock and milliseconds",
        log,
        text_file(lines),
        start_s=123.456,
        options=options,
        time="millis",
    )


def _names_and_units() -> None:
    kind = "names"
    log = make_log(300, 0.2, 1000)
    add_csv(kind, "brackets as in LabVIEW arrays", log, names=("Temp[0]", "Temp[1]"))
    log = make_log(300, 0.2, 1001)
    names = ('"Temp, °C (S/N: 2043, LBL: fine)"', '"Temp, °C (S/N: 2044, LBL: coarse)"')
    add_csv(kind, "commas in quoted names", log, names=names)
    log = make_log(300, 0.2, 1002)
    add_csv(
        kind,
        "names with spaces and degree signs",
        log,
        time="Time [s]",
        names=("Oven fine (°C)", "Oven coarse (°C)"),
        input="Heater (%)",
    )
    log = make_log(300, 0.2, 1003)
    add_csv(
        kind,
        "German names, decimal comma",
        log,
        time="Zeit [s]",
        names=("Fühler dünn [°C]", "Fühler dick [°C]"),
        input="Heizung [%]",
        separator=";",
        decimal=",",
    )
    log = make_log(300, 0.2, 1004)
    add_csv(kind, "points in names", log, names=("plc.oven.t1", "plc.oven.t2"), input="plc.heater")
    kind = "units"
    log = make_log(300, 0.2, 1010, unit="K")
    add_csv(kind, "kelvin in the names", log, names=("T_fine_K", "T_coarse_K"))
    log = make_log(300, 0.2, 1011, unit="degF")
    add_csv(kind, "Fahrenheit in the names", log, names=("T fine (°F)", "T coarse (°F)"))
    log = make_log(300, 1.0, 1012, unit="K", digits=3)
    add_csv(
        kind,
        "a row of units in brackets, kelvin",
        log,
        seconds(log, 0),
        "Time",
        names=("Fine", "Coarse"),
        below=["[s],[K],[K],[%]"],
    )
    log = make_log(300, 0.5, 1013, unit="degF")
    add_csv(
        kind,
        "a row of units, Fahrenheit",
        log,
        seconds(log, 1),
        "Time",
        names=("Fine", "Coarse"),
        below=["s,degF,degF,%"],
    )


def _loggers() -> None:
    """Layouts of loggers and programs, see ``tests.io.logger_families.SOURCES``."""
    kind = "loggers"
    log = make_log(400, 1.0, 1100)
    number = [str(k) for k in range(log.rows)]
    fine, coarse, u = _cells(log)
    top = '"TOA5","kiln","CR1000","1031","CR1000.Std.32","CPU:kiln.CR1","4062","Table1"'
    head = [
        '"TIMESTAMP","RECORD","TC(1)","TC(2)","Heater"',
        '"TS","RN","Deg C","Deg C","%"',
        '"","","Smp","Smp","Smp"',
    ]
    lines = [top, *head, *rows_of(quoted(clock(log, ISO)), number, fine, coarse, u)]
    add(
        kind,
        "Campbell TOA5",
        log,
        text_file(lines, end="\r\n", file="log.dat"),
        columns=("TC(1)", "TC(2)"),
        input="Heater",
        time="TIMESTAMP",
    )
    log = put(make_log(400, 0.1, 1101), "fine", [150, 151, 290], '"NAN"', "empty")
    fine, coarse, u = _cells(log)
    lines = [top, *head, *rows_of(quoted(clock(log, ISO_MS)), number, fine, coarse, u)]
    add(
        kind,
        "Campbell TOA5, NAN in quotes",
        log,
        text_file(lines, file="log.dat"),
        columns=("TC(1)", "TC(2)"),
        input="Heater",
        time="TIMESTAMP",
    )
    log = make_log(400, 1.0, 1102)
    fine, coarse, u = _cells(log)
    names = ("Temp, °C (LGR S/N: 2043, LBL: fine)", "Temp, °C (LGR S/N: 2043, LBL: coarse)")
    header = ",".join(quoted(["#", "Date Time, GMT+02:00", *names, "Heater, %"]))
    lines = [
        '"Plot Title: kiln"',
        header,
        *rows_of(number, clock(log, "%m/%d/%y %I:%M:%S %p"), fine, coarse, u),
    ]
    add(
        kind,
        "Onset HOBOware",
        log,
        text_file(lines, "utf-8-sig"),
        columns=names,
        input="Heater, %",
        time="Date Time, GMT+02:00",
    )
    log = make_log(400, 0.5, 1103)
    fine, coarse, u = _cells(log)
    lines = [
        "Sweep #,Time,Chan 201 (C),Chan 202 (C),Chan 203 (VDC)",
        *rows_of(number, clock(log, "%m/%d/%Y %H:%M:%S:{ms}"), fine, coarse, u),
    ]
    add(
        kind,
        "Keysight: milliseconds behind a colon",
        log,
        text_file(lines),
        columns=("Chan 201 (C)", "Chan 202 (C)"),
        input="Chan 203 (VDC)",
        time="Time",
    )
    log = make_log(400, 0.1, 1104)
    fine, coarse, u = _cells(log)
    block = [
        '"File name","WAVE0001.CSV","V 1.00"',
        '"Title comment",""',
        '"Ch","Mode","Range","Comment"',
        '"CH-1","Tc","2000 C",""',
        '"CH-2","Tc","2000 C",""',
    ]
    times = [f"{stamp:.9E}" for stamp in log.stamp_s]
    readings = [[f" {float(cell):.5E}" for cell in cells] for cells in (fine, coarse, u)]
    lines = [*block, '"Time","CH-1[C]","CH-2[C]","CH-3[V]"', *rows_of(times, *readings)]
    add(
        kind,
        "Hioki: a block of settings, the E format",
        log,
        text_file(lines),
        columns=("CH-1[C]", "CH-2[C]"),
        input="CH-3[V]",
        time="Time",
    )
    log = make_log(400, 1.0, 1105)
    fine, coarse, u = _cells(log)
    block = [
        "YREC",
        "Manual Sample Data\tVersion 1.02.00",
        "Model\tDX2000",
        "Ch\t0001\t0002\t0003",
        "Tag\tOven\tBath\tHeater",
        "Unit\tC\tC\t%",
    ]
    lines = [*block, *rows_of(clock(log, "%Y/%m/%d %H:%M:%S"), fine, coarse, u, separator="\t")]
    add(
        kind,
        "Yokogawa: tags and units above the rows",
        log,
        text_file(lines, end="\r\n"),
        columns=("Oven", "Bath"),
        input="Heater",
        time="Tag",
    )
    log = make_log(400, 0.1, 1106)
    fine, coarse, u = _cells(log)
    block = [
        "Vendor,GRAPHTEC Corporation",
        "Model,GL240",
        "Sampling interval,100ms",
        "Start time,2024-03-11,09:59:50",
        "AMP Settings",
        "CH,Signal name,Input,Range,Filter,Span",
        "Data",
    ]
    head = ["Number,Date&Time,ms,CH1,CH2,CH3", "NO.,Time,ms,degC,degC,V"]
    parts = [f"{round(1000 * stamp) % 1000}" for stamp in log.stamp_s]
    lines = [
        *block,
        *head,
        *rows_of(number, clock(log, "%Y/%m/%d %H:%M:%S"), parts, fine, coarse, u),
    ]
    add(
        kind,
        "Graphtec: milliseconds in a column of their own",
        log,
        text_file(lines),
        columns=("CH1", "CH2"),
        input="CH3",
        time="",
    )
    log = make_log(300, 2.0, 1107)
    fine, coarse, u = _cells(log)
    lines = [
        '"","Oven Ave. (C)","Bath Ave. (C)","Heater (%)"',
        *rows_of(quoted(clock(log, "%Y-%m-%dT%H:%M:%S-07:00")), fine, coarse, u),
    ]
    add(
        kind,
        "PicoLog: no name above the stamps",
        log,
        text_file(lines),
        columns=("Oven Ave. (C)", "Bath Ave. (C)"),
        input="Heater (%)",
        time="",
    )
    log = make_log(300, 10.0, 1108)
    add_csv(
        kind,
        "Siemens: a block of text above, decimal comma",
        log,
        clock(log, "%d.%m.%Y %H:%M:%S"),
        "Zeitstempel",
        names=("Vorlauf [°C]", "Rücklauf [°C]"),
        input="Stellgrad [%]",
        above=["Anlage;Ofen 3", "Geräteadresse;0.2.150", "Abfrageintervall;10"],
        separator=";",
        decimal=",",
        encoding="cp1252",
        end="\r\n",
    )
    log = make_log(400, 0.25, 1109)
    fine, coarse, u = _cells(log)
    rows = rows_of(seconds(log, 0, 0.0, 1e-3), fine, coarse, u, separator="\t")
    lines = ["Name\tOven", "File\tscope.csv", "", "Time [ms]\tOven\tBath\tHeater", *rows]
    add(
        kind,
        "Beckhoff TwinCAT Scope",
        log,
        text_file(lines),
        columns=("Oven", "Bath"),
        input="Heater",
        time="Time [ms]",
    )
    log = make_log(400, 1.0, 1110)
    fine, coarse, u = _cells(log)
    night = "2024-03-11 23:57:00"
    lines = [
        "Fecha;Hora;Horno 1 (°C);Horno 2 (°C);Potencia (%)",
        *rows_of(
            clock(log, "%d/%m/%Y", night),
            clock(log, "%H:%M:%S", night),
            fine,
            coarse,
            u,
            separator=";",
            decimal=",",
        ),
    ]
    add(
        kind,
        "Excel: date and time apart, through midnight",
        log,
        text_file(lines),
        columns=("Horno 1 (°C)", "Horno 2 (°C)"),
        input="Potencia (%)",
        time="",
    )
    log = make_log(400, 0.5, 1111)
    add_csv(
        kind,
        "Excel: UTF-16 and tabs, minutes, kelvin",
        make_log(400, 0.5, 1111, unit="K"),
        seconds(log, 6, 0.0, 60.0),
        "Zeit [min]",
        names=("Ofen [K]", "Bad [K]"),
        separator="\t",
        decimal=",",
        encoding="utf-16",
        grows=False,
    )
    log = make_log(300, 15.0, 1112)
    number = [str(k) for k in range(log.rows)]
    fine, coarse, u = _cells(log)
    lines = [
        "created_at,entry_id,field1,field2,field3",
        *rows_of(clock(log, "%Y-%m-%d %H:%M:%S UTC"), number, fine, coarse, u),
    ]
    add(
        kind,
        "ThingSpeak: UTC behind the stamps",
        log,
        text_file(lines),
        columns=("field1", "field2"),
        input="field3",
        time="created_at",
    )
    log = make_log(400, 0.5, 1113)
    times = [f"{stamp:g} sec" for stamp in log.stamp_s]
    add_csv(kind, "MATLAB: durations with their unit", log, times, "RowTimes")
    log = put(make_log(400, 0.1, 1114), "coarse", [90, 91, 200], "NA", "empty")
    fine, coarse, u = _cells(log)
    lines = [
        '"";"t";"T1";"T2";"u"',
        *rows_of(
            quoted([str(k) for k in range(log.rows)]),
            seconds(log, 1),
            fine,
            coarse,
            u,
            separator=";",
            decimal=",",
        ),
    ]
    add(kind, "R: write.csv2, NA", log, text_file(lines), columns=("T1", "T2"), time="t")
    log = make_log(400, 0.2, 1115)
    add_csv(
        kind,
        "metadata above the header",
        log,
        above=["# operator: AB", "# place: kiln 3", "# start_time: 2024-03-11T09:59:50"],
    )
    log = make_log(400, 0.2, 1116)
    lines = [f"time_s,{FINE},{COARSE},u,"]
    lines += [row + "," for row in rows_of(seconds(log), *_cells(log))]
    add(kind, "a separator at the end of each line", log, text_file(lines))
    _binary_and_lvm()


def _binary_and_lvm() -> None:
    """LVM, TDMS, Parquet, workbooks and MATLAB files."""
    kind = "formats"
    for name, decimal, separator, word in (
        ("LVM, tabs", ".", "\t", "Tab"),
        ("LVM, semicolons and decimal commas", ",", ";", "Semicolon"),
    ):
        log = make_log(400, 0.2, 1200 + len(name))
        head = {
            "Writer_Version": "2",
            "Reader_Version": "2",
            "Separator": word,
            "Decimal_Separator": decimal,
            "Multi_Headings": "No",
            "X_Columns": "One",
            "Time_Pref": "Relative",
            "Date": "2024/03/11",
            "Time": "09:59:50",
        }
        top = [
            "LabVIEW Measurement",
            *[f"{key}{separator}{value}" for key, value in head.items()],
            "***End_of_Header***",
            "",
        ]
        segment = [
            separator.join(["Channels", "3"]),
            separator.join(["Samples", "400", "400", "400"]),
            "***End_of_Header***",
        ]
        rows = rows_of(seconds(log, 6), *_cells(log), separator=separator, decimal=decimal)
        lines = [
            *top,
            *segment,
            separator.join(["X_Value", FINE, COARSE, "u", "Comment"]),
            *[row + separator for row in rows],
        ]
        add(
            kind,
            name,
            log,
            text_file(lines, end="\r\n", file="log.lvm"),
            grows=False,
            time="X_Value",
        )
    log = make_log(600, 0.1, 1210)
    add(kind, "TDMS with a time track", log, _tdms(log, "track"), grows=False, time="")
    log = make_log(600, 0.5, 1211, lost=0.01)
    add(kind, "TDMS with stamps, 1 % lost", log, _tdms(log, "stamps"), grows=False, time="Time")
    log = make_log(600, 1.0, 1212)
    add(kind, "Parquet with stamps", log, _parquet(log, "timestamp"), grows=False, time="timestamp")
    log = make_log(600, 0.25, 1213, lost=0.01)
    log = put(log, "fine", some_rows(log, 0.02, 1213), "", "empty")
    add(
        kind,
        "Parquet with milliseconds, blanks and lost rows",
        log,
        _parquet(log, "Time [ms]"),
        grows=False,
        time="Time [ms]",
    )
    log = make_log(600, 0.5, 1215, lost=0.01)
    log = put(log, "fine", some_rows(log, 0.02, 1215), "", "empty")
    add(
        kind,
        "a sheet of Excel with dates, blanks and lost rows",
        log,
        _workbook(log),
        grows=False,
        time="Zeit",
    )
    log = make_log(600, 0.1, 1216, lost=0.01)
    add(kind, "a struct of MATLAB", log, _mat(log), grows=False)
    log = make_log(800, 1 / 75, 1214, jitter=0.05)
    add(
        kind,
        "Parquet with seconds, samples stray by 5 %",
        log,
        _parquet(log, "time_s"),
        grows=False,
    )


def _refused() -> None:
    """Files of which no clock can be read."""
    kind = "no clock"
    log = make_log(400, 0.5, 1300)
    batch_s = 10.0
    arrivals = [
        f"{batch_s * (sample // 20 + 1) + 0.002 * (sample % 20):.4f}" for sample in log.sample
    ]
    add_csv(kind, "batches of twenty, stamps 2 ms apart", log, arrivals, refused="arrival times")
    log = make_log(400, 1.0, 1301)
    times = [f"{1.710151190e12 + 1000 * stamp:.5E}" for stamp in log.stamp_s]
    name = "milliseconds since 1970 with six digits"
    add_csv(kind, name, log, times, "timestamp_ms", refused="all rows have one time")
    log = make_log(400, 10.0, 1302)
    times = seconds(log, 0)
    add_csv(kind, "rows every 10 in no unit", log, times, "Time", refused="the unit is not clear")


def _tdms(log: Log, time: str) -> Writer:
    """Writer of a TDMS file whose time is a track of each channel, or a channel of stamps."""
    start = np.datetime64("2024-03-11T09:59:50.000000")
    named = {FINE: log.values("fine"), COARSE: log.values("coarse"), INPUT: log.values("u")}
    track = {"wf_increment": log.interval_s, "wf_start_time": start, "wf_start_offset": 0.0}

    def write(folder: Path) -> Path:
        properties = track if time == "track" else {}
        channels = [ChannelObject("Log", n, v, properties=properties) for n, v in named.items()]
        if time == "stamps":
            steps = np.round(1e6 * log.stamp_s).astype("timedelta64[us]")
            channels.insert(0, ChannelObject("Log", "Time", start + steps))
        path = folder / "log.tdms"
        with TdmsWriter(path) as writer:
            writer.write_segment(channels)
        return path

    return write


def _parquet(log: Log, time: str) -> Writer:
    """Writer of a Parquet file with a column of stamps, milliseconds or seconds."""
    if time == "timestamp":
        start = pd.Timestamp("2024-03-11 09:59:50", tz="Europe/Berlin")
        times: Any = start + pd.to_timedelta(np.round(1e6 * log.stamp_s), unit="us")
    elif time == "Time [ms]":
        times = np.round(1e3 * log.stamp_s).astype(np.int64)
    else:
        times = log.stamp_s
    named = {time: times, FINE: log.values("fine"), COARSE: log.values("coarse")}
    named[INPUT] = log.values("u")

    def write(folder: Path) -> Path:
        path = folder / "log.parquet"
        pq.write_table(pa.table(named), path)
        return path

    return write


def _workbook(log: Log) -> Writer:
    """Writer of a workbook whose time is dates of Excel, below a title."""

    def write(folder: Path) -> Path:
        path = folder / "log.xlsx"
        book = xlsxwriter.Workbook(path)
        book.set_properties({"created": datetime(2024, 3, 11)})
        sheet = book.add_worksheet("Log")
        stamp = book.add_format({"num_format": "dd.mm.yyyy hh:mm:ss.000"})
        sheet.write(0, 0, "kiln 3")
        sheet.write_row(2, 0, ["Zeit", FINE, COARSE, INPUT])
        start = datetime(2024, 3, 11, 9, 59, 50)
        for k, stamp_s in enumerate(log.stamp_s):
            instant = start + timedelta(milliseconds=round(1e3 * stamp_s))
            sheet.write_datetime(k + 3, 0, instant, stamp)
        for column, name in enumerate(("fine", "coarse", "u"), 1):
            for k, value in enumerate(log.values(name)):
                if np.isfinite(value):
                    sheet.write_number(k + 3, column, value)
        book.close()
        return path

    return write


def _mat(log: Log) -> Writer:
    """Writer of a MATLAB file with a struct of vectors."""
    values = {FINE: log.values("fine"), COARSE: log.values("coarse"), INPUT: log.values("u")}

    def write(folder: Path) -> Path:
        path = folder / "log.mat"
        columns = {name: column[:, None] for name, column in values.items()}
        variables = {"log": {"time_s": log.stamp_s[:, None], **columns}, "fs": 10.0}
        savemat(path, variables, do_compression=True)
        content = path.read_bytes()
        text = b"MATLAB 5.0 MAT-file, without the date of today"
        path.write_bytes(text.ljust(116) + content[116:])
        return path

    return write


def as_rig_log(file: CorpusFile, path: Path) -> RigLog | None:
    """A file as an immersion log of a rig with two junctions; None where the rig refuses its like.

    Parameters
    ----------
    file
        The file.
    path
        Where it was written.

    Returns
    -------
    RigLog or None
        The columns are named in the rig file: T_fine and T_coarse are the junctions ``t1`` and
        ``t2``, and T_coarse is also the fluid. None: rows slower than 1 Hz, equal stamps, a gap
        or a run of cells without readings above 0.5 s, or too many cells without readings, or a
        time that has no column to name.
    """
    truth = file.truth
    interval_s = truth["interval_s"]
    longest = max(RIG_LONGEST_GAP_S / interval_s, RIG_LONGEST_GAP_INTERVALS)
    # an estimate of 1 s may be longer
    longest_s = interval_s * (1 + truth["interval_rtol"] - INTERVAL_RTOL)
    if longest_s > RIG_LONGEST_INTERVAL_S or not file.time:
        return None
    if any(gap["rows"] + 1 > longest for gap in truth.get("gaps", ())):
        return None
    for column in truth["columns"].values():
        if truth["rows"] - column["readings"] > RIG_MISSING_SHARE * truth["rows"]:
            return None
    fine, coarse = file.columns
    names = {"time_s": file.time}
    for canonical, column in (("t1", fine), ("t2", coarse), ("fluid", coarse)):
        names[f"{canonical}_{truth['columns'][column]['unit']}"] = column
    lines = ["[columns]", *[f"{key} = {_toml_text(name)}" for key, name in names.items()]]
    lines += ["[thermocouples]", "t1 = { depth_mm = 3.0, z_mm = 2.0 }"]
    lines += ["t2 = { depth_mm = 6.0, z_mm = 2.0 }"]
    return RigLog(path, "immersion", "\n".join(lines) + "\n", {fine: "t1_degC", coarse: "t2_degC"})


def _toml_text(text: str) -> str:
    """A text as a value of a TOML file."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


_plain()
_jitter()
_rounded()
_lost()
_repeated()
_cells_without_readings()
_slow()
_wandering()
_stamp_forms()
_names_and_units()
_loggers()
_refused()
