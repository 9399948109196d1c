"""Damaged files, each with what must be said of it; a builder returns the path of the file it
wrote."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from tcdyn.io.write import write_log
from tcdyn.series.thermocouple_types import emf_mV
from tests.rig.log_cases import (
    csv_text,
    ehl_frame,
    hole_frame,
    immersion_frame,
    lvm_text,
    oven_frame,
    write,
)

REFUSED, FLAGGED = "refused", "flagged"


@dataclass(frozen=True)
class Damage:
    """A kind of log, how it is damaged, whether it must be refused or flagged, and what the words
    must hold."""

    name: str
    kind: str
    fate: str
    words: str
    build: Callable[[Path], Path]


def _edited(frame: pd.DataFrame, change: Callable[[pd.DataFrame], object]) -> pd.DataFrame:
    frame = frame.copy()
    changed = change(frame)
    return changed if isinstance(changed, pd.DataFrame) else frame


def _csv(kind: str, change: Callable[[pd.DataFrame], object]) -> Callable[[Path], Path]:
    make = {"ehl": ehl_frame, "immersion": immersion_frame, "oven": oven_frame, "hole": hole_frame}[
        kind
    ]
    return lambda folder: write_log(_edited(make(), change), folder / "log.csv")


def _text(
    kind: str, change: Callable[[str], str | bytes], name: str = "log.csv"
) -> Callable[[Path], Path]:
    make = {"ehl": ehl_frame, "immersion": immersion_frame, "oven": oven_frame}[kind]
    return lambda folder: write(folder, name, change(csv_text(make())))


def _set(rows: object, column: str, value: object) -> Callable[[pd.DataFrame], None]:
    def change(frame: pd.DataFrame) -> None:
        frame.loc[rows, column] = value  # type: ignore[index]

    return change


def _map(
    column: str, function: Callable[[pd.Series], object]
) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda frame: frame.assign(**{column: function(frame[column])})


def _all_degC(
    function: Callable[[np.ndarray], np.ndarray],
) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda f: f.assign(**{c: function(f[c].to_numpy()) for c in f if c.endswith("_degC")})


def _line(number: int, change: Callable[[str], str]) -> Callable[[str], str]:
    def edit(text: str) -> str:
        lines = text.split("\n")
        lines[number - 1] = change(lines[number - 1])
        return "\n".join(lines)

    return edit


def _binary(ending: str, change: Callable[[bytes], bytes]) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        whole = write_log(ehl_frame(), folder / f"whole.{ending}").read_bytes()
        return write(folder, f"log.{ending}", change(whole))

    return build


def _lvm(change: Callable[[str], str]) -> Callable[[Path], Path]:
    return lambda folder: write(folder, "log.lvm", change(lvm_text(immersion_frame())))


def _bytes(name: str, content: bytes) -> Callable[[Path], Path]:
    return lambda folder: write(folder, name, content)


def _swap(one: str, other: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda f: f.rename(columns={one: other, other: one})


def _folder(folder: Path) -> Path:
    (folder / "log.csv").mkdir()
    return folder / "log.csv"


def _tdms_huge_length(raw: bytes) -> bytes:
    place = raw.index(b"time_s")
    return raw[: place - 4] + (0xFFFFFFF0).to_bytes(4, "little") + raw[place:]


def _tdms_huge_values(raw: bytes) -> bytes:
    count = (3000).to_bytes(8, "little")
    return raw.replace(count, (1 << 40).to_bytes(8, "little"))


def _tdms_zero_metadata(raw: bytes) -> bytes:
    return raw[:28] + bytes(len(raw) - 28)


def _tdms_many_objects(raw: bytes) -> bytes:
    return raw[:28] + (0xFFFFFFFF).to_bytes(4, "little") + bytes(1 << 20)


def _nan(frame: pd.DataFrame, column: str, start: int, stop: int) -> pd.DataFrame:
    frame.loc[start : stop - 1, column] = np.nan
    return frame


ROW_1000 = r"row 100\d"
CORPUS: tuple[Damage, ...] = (
    # files that are no logs
    Damage("no file", "ehl", REFUSED, "no such file", lambda d: d / "none.csv"),
    Damage("a folder", "ehl", REFUSED, "folder", _folder),
    Damage("empty", "ehl", REFUSED, "empty", _bytes("log.csv", b"")),
    Damage("only line ends", "ehl", REFUSED, "empty", _bytes("log.csv", b"\n\n\r\n")),
    Damage("only zero bytes", "ehl", REFUSED, "empty", _bytes("log.csv", bytes(100_000))),
    Damage(
        "random bytes",
        "ehl",
        REFUSED,
        "zero byte|no table",
        _bytes("log.csv", np.random.default_rng(0).bytes(5000)),
    ),
    Damage(
        "prose",
        "ehl",
        REFUSED,
        "no table",
        _bytes("log.csv", b"Dear all,\nplease find attached, as said,\n"),
    ),
    Damage(
        "a picture's name changed",
        "ehl",
        REFUSED,
        "zero byte",
        _bytes("log.csv", b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"),
    ),
    Damage(
        "a spreadsheet",
        "ehl",
        REFUSED,
        "not readable as an Excel workbook",
        _bytes("log.csv", b"PK\x03\x04" + bytes(200)),
    ),
    Damage(
        "header only", "ehl", REFUSED, "no table", _text("ehl", lambda t: t.split("\n")[0] + "\n")
    ),
    Damage("no header", "ehl", REFUSED, "no header", _text("ehl", lambda t: t.split("\n", 1)[1])),
    Damage("three rows", "ehl", REFUSED, "only 3 rows", _csv("ehl", lambda f: f.iloc[:3])),
    Damage("JSON", "ehl", REFUSED, "no table", _bytes("log.csv", b'{"time_s": [0, 1, 2]}')),
    # rows and fields
    Damage(
        "cut in the middle of a row",
        "ehl",
        REFUSED,
        "truncated",
        _text("ehl", lambda t: t[: len(t) // 2]),
    ),
    Damage(
        "last row short",
        "ehl",
        REFUSED,
        "truncated",
        _text("ehl", lambda t: t.rstrip("\n").rsplit(",", 3)[0] + "\n"),
    ),
    Damage(
        "a row with a field less",
        "ehl",
        REFUSED,
        "row 1000 has 19",
        _text("ehl", _line(1000, lambda r: r.rsplit(",", 1)[0])),
    ),
    Damage(
        "a row with a field more",
        "ehl",
        REFUSED,
        "row 1000 has 21",
        _text("ehl", _line(1000, lambda r: r + ",1")),
    ),
    Damage(
        "zero bytes in a row",
        "ehl",
        REFUSED,
        "row 1000",
        _text("ehl", _line(1000, lambda r: r[:20] + "\0" + r[21:])),
    ),
    Damage(
        "a second header in the middle",
        "ehl",
        FLAGGED,
        "row 1000.*word instead of a reading",
        _text("ehl", lambda t: _line(1000, lambda r: t.split("\n")[0])(t)),
    ),
    Damage(
        "a word in a cell",
        "ehl",
        FLAGGED,
        "row 1000.*'oops'",
        _text("ehl", _line(1000, lambda r: r.rsplit(",", 1)[0] + ",oops")),
    ),
    Damage(
        "decimal commas in a comma file",
        "ehl",
        REFUSED,
        "fields|no table|header",
        _text("ehl", lambda t: t.split("\n")[0] + "\n" + t.split("\n", 1)[1].replace(".", ",")),
    ),
    Damage(
        "a column of words",
        "ehl",
        REFUSED,
        "no number|no numbers|no table",
        _text(
            "ehl", lambda t: re.sub(r",[^,\n]+\n", ",warm\n", t).replace(",warm", ",oil_degC", 1)
        ),
    ),
    Damage(
        "mixed encodings",
        "ehl",
        FLAGGED,
        "row 1000",
        _text(
            "ehl", lambda t: _line(1000, lambda r: r.rsplit(",", 1)[0] + ",20°")(t).encode("cp1252")
        ),
    ),
    # columns
    Damage(
        "a column missing",
        "ehl",
        REFUSED,
        "friction_N: column is missing",
        _csv("ehl", lambda f: f.drop(columns="friction_N")),
    ),
    Damage(
        "a column twice",
        "ehl",
        REFUSED,
        "2 times",
        _text("ehl", lambda t: t.replace("fast_b_degC", "fast_a_degC", 1)),
    ),
    Damage(
        "a column twice in the oven",
        "oven",
        REFUSED,
        "2 times",
        _text("oven", lambda t: t.replace("b_degC", "a_degC", 1)),
    ),
    Damage(
        "a column name misspelt",
        "ehl",
        REFUSED,
        "did you mean 'fricton_N'",
        _csv("ehl", lambda f: f.rename(columns={"friction_N": "fricton_N"})),
    ),
    Damage(
        "an oven log as a plunge",
        "immersion",
        REFUSED,
        "looks like an oven log",
        _csv("oven", lambda f: f),
    ),
    Damage(
        "a plunge as an EHL log",
        "ehl",
        REFUSED,
        "looks like an immersion log",
        _csv("immersion", lambda f: f),
    ),
    # time
    Damage(
        "a time repeats and one is lost",
        "ehl",
        FLAGGED,
        "1 row.* have the time of the row before, first in row 1001",
        _csv("ehl", lambda f: _set(1000, "time_s", f["time_s"][999])(f)),
    ),
    Damage(
        "time runs backward",
        "ehl",
        REFUSED,
        "backward at row 1001 below the header",
        _csv("ehl", _set(1000, "time_s", 3.0)),
    ),
    Damage(
        "rows shuffled",
        "ehl",
        REFUSED,
        "backward",
        _csv("ehl", lambda f: f.sample(frac=1, random_state=0)),
    ),
    Damage("rows reversed", "ehl", REFUSED, "backward", _csv("ehl", lambda f: f.iloc[::-1])),
    Damage(
        "rows twice",
        "ehl",
        REFUSED,
        "stamps are repeated",
        _csv("ehl", lambda f: f.loc[f.index.repeat(2)]),
    ),
    Damage(
        "a hole of 3 s",
        "ehl",
        REFUSED,
        "3.0.* s are missing",
        _csv("ehl", lambda f: f.drop(index=range(1000, 1225))),
    ),
    Damage(
        "five samples lost",
        "ehl",
        FLAGGED,
        r"5 sample.* have no row in the table",
        _csv("ehl", lambda f: f.drop(index=range(1000, 1005))),
    ),
    Damage(
        "time in milliseconds",
        "ehl",
        REFUSED,
        "milliseconds",
        _csv("ehl", _map("time_s", lambda t: 1000 * t)),
    ),
    Damage(
        "the rate changes",
        "ehl",
        REFUSED,
        "uneven",
        _csv("ehl", lambda f: pd.concat([f[:1000], f[1000::7]])),
    ),
    Damage(
        "times missing",
        "ehl",
        REFUSED,
        "no time in row 1001 below the header",
        _csv("ehl", lambda f: _nan(f, "time_s", 1000, 1020)),
    ),
    Damage(
        "one time missing",
        "ehl",
        FLAGGED,
        "1 missing time",
        _csv("ehl", lambda f: _nan(f, "time_s", 1000, 1001)),
    ),
    # temperatures
    Damage(
        "one channel in kelvin",
        "ehl",
        REFUSED,
        "fast_c_degC.*kelvin",
        _csv("ehl", _map("fast_c_degC", lambda x: x + 273.15)),
    ),
    Damage(
        "all in kelvin",
        "immersion",
        REFUSED,
        "kelvin",
        _csv("immersion", _all_degC(lambda x: x + 273.15)),
    ),
    Damage(
        "one channel in millivolts",
        "immersion",
        REFUSED,
        "a_degC.*millivolts",
        _csv("immersion", _map("a_degC", emf_mV)),
    ),
    Damage("all in millivolts", "ehl", REFUSED, "millivolts", _csv("ehl", _all_degC(emf_mV))),
    Damage(
        "a warm rig in fahrenheit",
        "ehl",
        REFUSED,
        "Fahrenheit",
        _csv("ehl", lambda f: _all_degC(lambda x: 1.8 * (x + 35) + 32)(f)),
    ),
    Damage(
        "oven in kelvin",
        "oven",
        REFUSED,
        "kelvin",
        _csv(
            "oven", lambda f: f.assign(**{f"{c}_degC": f[f"{c}_degC"] + 273.15 for c in "abcdef"})
        ),
    ),
    Damage(
        "oven channel in millivolts",
        "oven",
        REFUSED,
        "b_degC.*millivolts",
        _csv("oven", _map("b_degC", emf_mV)),
    ),
    Damage(
        "oven channel in fahrenheit",
        "oven",
        REFUSED,
        "b_degC.*Fahrenheit",
        _csv("oven", _map("b_degC", lambda x: 1.8 * x + 32)),
    ),
    Damage(
        "oven rows of one channel shuffled",
        "oven",
        REFUSED,
        "does not follow",
        _csv("oven", _map("b_degC", lambda x: x.sample(frac=1, random_state=0).to_numpy())),
    ),
    Damage(
        "oven at one temperature",
        "oven",
        REFUSED,
        "rows over",
        _csv("oven", lambda f: f[f["setpoint_degC"] == 60]),
    ),
    Damage(
        "oven channel dead",
        "oven",
        REFUSED,
        "dead|follow",
        _csv("oven", _map("b_degC", lambda x: 21.0 + 0 * x)),
    ),
    Damage(
        "an oven value missing", "oven", FLAGGED, "missing", _csv("oven", _set(5, "c_degC", np.nan))
    ),
    Damage(
        "a dead channel",
        "ehl",
        REFUSED,
        "slow_b_degC.*dead",
        _csv("ehl", _map("slow_b_degC", lambda x: 21.5 + 0 * x)),
    ),
    Damage(
        "a channel that stays cold",
        "ehl",
        REFUSED,
        "slow_b_degC.*dead",
        _csv("ehl", _map("slow_b_degC", lambda x: 25 + 0.02 * (x - 25))),
    ),
    Damage(
        "a channel that freezes",
        "ehl",
        REFUSED,
        "stays at",
        _csv("ehl", lambda f: _set(slice(1000, 2000), "fast_d_degC", 60.0)(f)),
    ),
    Damage(
        "an open couple",
        "ehl",
        REFUSED,
        "fast_a_degC",
        _csv("ehl", _map("fast_a_degC", lambda x: 1372.0 + 0 * x)),
    ),
    Damage(
        "spikes",
        "ehl",
        FLAGGED,
        "fast_e_degC.*2 spike",
        _csv("ehl", lambda f: _set([700, 1000], "fast_e_degC", 150.0)(f)),
    ),
    Damage(
        "a huge value",
        "ehl",
        FLAGGED,
        "drop-out codes",
        _csv("ehl", _set(1000, "fast_e_degC", 1e30)),
    ),
    Damage(
        "an infinite value",
        "ehl",
        FLAGGED,
        "drop-out codes",
        _csv("ehl", _set(1000, "fast_e_degC", np.inf)),
    ),
    Damage(
        "one value missing",
        "ehl",
        FLAGGED,
        f"fast_e_degC, {ROW_1000}.*missing",
        _csv("ehl", _set(1000, "fast_e_degC", np.nan)),
    ),
    Damage(
        "a long run missing",
        "ehl",
        REFUSED,
        f"fast_e_degC, {ROW_1000}.*100 values",
        _csv("ehl", lambda f: _nan(f, "fast_e_degC", 1000, 1100)),
    ),
    Damage(
        "a tenth missing",
        "ehl",
        REFUSED,
        "fast_e_degC.*%",
        _csv("ehl", lambda f: _set(slice(0, 2999, 10), "fast_e_degC", np.nan)(f)),
    ),
    Damage(
        "an empty channel",
        "ehl",
        REFUSED,
        "no numbers",
        _csv("ehl", _map("fast_e_degC", lambda x: np.nan * x)),
    ),
    Damage(
        "junctions e and b swapped",
        "ehl",
        FLAGGED,
        "swapped",
        _csv("ehl", _swap("fast_e_degC", "fast_b_degC")),
    ),
    Damage(
        "a noisy channel",
        "ehl",
        FLAGGED,
        "noise",
        _csv(
            "ehl", _map("slow_f_degC", lambda x: x + np.random.default_rng(0).normal(0, 3, len(x)))
        ),
    ),
    # switches, loads, speeds
    Damage("no unloading", "ehl", REFUSED, "no unloading", _csv("ehl", lambda f: f.iloc[:2000])),
    Damage(
        "no contact at all",
        "ehl",
        FLAGGED,
        "in every row: the switch is not used",
        _csv("ehl", _map("contact", lambda x: 0 * x)),
    ),
    Damage(
        "contact inverted",
        "ehl",
        FLAGGED,
        "inverted",
        _csv("ehl", _map("contact", lambda x: 1 - x)),
    ),
    Damage(
        "contact inverted, and no friction to say so",
        "ehl",
        REFUSED,
        "inverted",
        _csv("ehl", lambda f: f.assign(contact=1 - f["contact"], friction_N=5.0)),
    ),
    Damage(
        "contact pressed at the parting only",
        "ehl",
        REFUSED,
        "momentary",
        _csv(
            "ehl",
            _map("contact", lambda x: (np.arange(len(x)) > 2249) * (np.arange(len(x)) < 2275)),
        ),
    ),
    Damage(
        "contact in five levels",
        "ehl",
        REFUSED,
        "different values",
        _csv("ehl", lambda f: f.assign(contact=np.arange(len(f)) % 5 / 4)),
    ),
    Damage(
        "contact in volts",
        "ehl",
        FLAGGED,
        "levels 0 and 5",
        _csv("ehl", _map("contact", lambda x: 5 * x)),
    ),
    Damage(
        "contact bounces",
        "ehl",
        FLAGGED,
        "bounces",
        _csv("ehl", _set([376, 378, 380], "contact", 0.0)),
    ),
    Damage(
        "load in kilonewtons",
        "ehl",
        REFUSED,
        "kilonewtons",
        _csv("ehl", _map("load_N", lambda x: x / 1000)),
    ),
    Damage(
        "a dead load cell",
        "ehl",
        REFUSED,
        "dead cell",
        _csv("ehl", _map("load_N", lambda x: 0 * x + 3.0)),
    ),
    Damage(
        "speeds swapped",
        "ehl",
        REFUSED,
        "swapped",
        _csv("ehl", _swap("speed_fast_rpm", "speed_slow_rpm")),
    ),
    Damage(
        "standing still",
        "ehl",
        REFUSED,
        "rpm",
        _csv("ehl", lambda f: f.assign(speed_fast_rpm=0.0, speed_slow_rpm=0.0)),
    ),
    Damage(
        "friction's sign", "ehl", FLAGGED, "negative", _csv("ehl", _map("friction_N", lambda x: -x))
    ),
    Damage(
        "load missing for a while",
        "ehl",
        FLAGGED,
        "load_N",
        _csv("ehl", lambda f: _nan(f, "load_N", 1000, 1040)),
    ),
    Damage(
        "the switch never moves",
        "immersion",
        REFUSED,
        "never moves",
        _csv("immersion", _map("switch", lambda x: 0 * x)),
    ),
    Damage(
        "the switch is always on",
        "immersion",
        REFUSED,
        "never moves",
        _csv("immersion", _map("switch", lambda x: 0 * x + 1)),
    ),
    Damage(
        "the switch bounces",
        "immersion",
        FLAGGED,
        "bounces",
        _csv("immersion", _set([376, 378, 380], "switch", 0.0)),
    ),
    # other forms
    Damage(
        "TDMS truncated", "ehl", REFUSED, "truncated|TDMS", _binary("tdms", lambda b: b[:-1000])
    ),
    Damage(
        "TDMS cut in its metadata",
        "ehl",
        REFUSED,
        "TDMS|no channels|column",
        _binary("tdms", lambda b: b[:200]),
    ),
    Damage(
        "TDMS of zeros", "ehl", REFUSED, "TDMS|no channels", _binary("tdms", _tdms_zero_metadata)
    ),
    Damage(
        "TDMS with endless objects",
        "ehl",
        REFUSED,
        "TDMS|no channels",
        _binary("tdms", _tdms_many_objects),
    ),
    Damage(
        "TDMS with an endless name",
        "ehl",
        REFUSED,
        "TDMS|missing|time track",
        _binary("tdms", _tdms_huge_length),
    ),
    Damage(
        "TDMS that promises terabytes",
        "ehl",
        REFUSED,
        "TDMS|damaged|truncated",
        _binary("tdms", _tdms_huge_values),
    ),
    Damage(
        "TDMS of noise",
        "ehl",
        REFUSED,
        "TDMS|no channels",
        _binary("tdms", lambda b: b[:4] + np.random.default_rng(1).bytes(4000)),
    ),
    Damage("Parquet truncated", "ehl", REFUSED, "Parquet", _binary("parquet", lambda b: b[:-200])),
    Damage(
        "Parquet with a hole",
        "ehl",
        REFUSED,
        "Parquet",
        _binary("parquet", lambda b: b[:5000] + bytes(20_000) + b[25_000:]),
    ),
    Damage(
        "Parquet that is CSV", "ehl", REFUSED, "Parquet", _text("ehl", lambda t: t, "log.parquet")
    ),
    Damage(
        "LVM whose header never ends",
        "immersion",
        REFUSED,
        "header never ends",
        _lvm(lambda t: t.replace("***End_of_Header***", "")),
    ),
    Damage("LVM truncated", "immersion", REFUSED, "truncated", _lvm(lambda t: t[:-60])),
    Damage(
        "LVM without rows",
        "immersion",
        REFUSED,
        "no rows",
        _lvm(lambda t: t[: t.index("Comment") + 8]),
    ),
    Damage(
        "LVM with the other decimal mark",
        "immersion",
        REFUSED,
        "no number",
        _lvm(lambda t: t.replace("Separator\t.", "Separator\t,")),
    ),
    # names
    Damage(
        "a path in a column name",
        "ehl",
        REFUSED,
        "load_N",
        _csv("ehl", lambda f: f.rename(columns={"load_N": "../../load_N"})),
    ),
    Damage(
        "a line end in the file name",
        "ehl",
        REFUSED,
        "no unloading",
        lambda d: write_log(ehl_frame().iloc[:2000], d / "a\nb.csv"),
    ),
    Damage(
        "a zero byte in the path",
        "ehl",
        REFUSED,
        "not readable|no such file",
        lambda d: Path(os.fspath(d) + "/a\0b.csv"),
    ),
)
