"""Structure-aware mutations of valid input files, and absurd options, run through the command in
this process.

``tests/cli/test_fuzz.py`` runs a fixed number; `python -m tests.cli.fuzz COUNT SEED` more of them.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tcdyn.io.checksum import CHECKSUM_KEY, with_checksum
from tcdyn.simulate.campaign import simulate_campaign
from tcdyn.simulate.ehl import EhlOptions
from tests.cli.fault_commands import QUICK, small_files
from tests.cli.test_main_job import tcdyn
from tests.cli.test_options import ALL
from tests.conftest import RECORDS

SECONDS = 120  # after which a command hangs
# Rows of a table that are kept, for speed: every N-th of a log that a command needs from its start
# to its end, else the first ones; sound inputs end with 0 or 1 (``test_fuzz.py``).
ROWS = 250
FIRST_ROWS = {"steady": 4000, "oven": 10_000}
EVERY_NTH_ROW = {"ehl": 8, "plunge": 10}
# Commands by the inputs that are mutated: of ``QUICK``, and further ones.
WORDS = {
    **{
        name: QUICK[name].words
        for name in (
            "compensate --sensor",
            "compensate to Parquet",
            "follow --sensor",
            "sensor show",
            "sensor plunge",
            "sensor pair",
            "sensor noise",
            "sensor current",
            "sensor touch",
            "response",
            "identify",
            "rig",
            "transducer",
            "spot",
            "record show",
            "record diff",
            "record check",
            "round fit",
        )
    },
    "sensor show, identified": "sensor show {identified}",
    "compensate, identified": "compensate {table} --sensor {identified} --column T1_degC --out "
    "o.csv",
    "follow, state": "follow {table} --sensor {sensor} --out {followed} --state {state} "
    "--delay-s 2 --idle-s 0",
    "compensate --record": "compensate {plunge} --record {fast} --out o.csv",
    "beta --record": "rig beta {ehl} --record {fast} --record {slow} --rig {rig} --out o.json",
    "calibrate": "rig calibrate --rig {rig} --disk fast --oven {oven} --immersion {plunge} "
    "--out o.json",
}
# Cells of a table, and values of a JSON or TOML file.
CELLS = (
    *("", " ", "nan", "NaN", "inf", "-inf", "1e400", "-1e308", "1e-320", "0", "-0.0", "-273.16"),
    *("1e9", "9" * 400, "0x10", "1_0", "1,5", "1.2.3", "--", "N/A", "OVLD", "#DIV/0!", "true"),
    *("2024-13-45 99:99:99", "2024-02-30T10:00:00Z", "12:61", "\x00", "\x1b[31m", "\u0085"),
    *('"', '"a', "'", ";", "\t", "é", "\ud83d\ude00", "a" * 5000, "=1+1", "..", "%s", "{0}"),
    *("time_s", "T1_degC", "T1_degC [K]", "*", "[", "\\", "-1", "1e15", "0.1"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 1e308, -1e308, 1e-320, 10**400, float("nan"), float("inf")),
    *("", "a", "a" * 5000, "\x00", "\ud800", "2024-13-45", "*", "T1_degC", "tcdyn.sensor/1"),
    *([], [[]], [None], {}, {"": {}}, [1, 2, 3], {"value": 1, "u": -1}, [[1e308] * 3] * 3),
)
SCALES = (-1, 0, 0.5, 0.9, 1.1, 3, 100, 1e6, 1e-6, 1e300)  # of a number
NUMBER_IN_TEXT = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?![\w.])")
OPTION_VALUES = (
    *("", " ", "0", "-1", "1", "2.5", "nan", "inf", "-inf", "1e400", "1e308", "-1e308", "1e-320"),
    *(
        "1+-",
        "+-1",
        "1+-nan",
        "1+-1+-1",
        "1+--1",
        "1.5+-0.1",
        "a",
        "é",
        "\x1b[31m",
        "a,b",
        ",",
        "*",
    ),
    *(
        "T1_degC",
        "T1_degC,T2_degC",
        "T1=K",
        "=K",
        "T1_degC=mV",
        "K",
        "mV",
        "u",
        "time_s",
        "ms",
        "auto",
    ),
    *(
        "P1",
        "P9",
        "P2D",
        "P2(",
        "fast",
        "both",
        "x" * 3000,
        "../..",
        "/",
        ".",
        "\udcff",
        "{0}",
        "%d",
    ),
    *(
        "water",
        "air",
        "insulated",
        "zoh",
        "cascade",
        "standard",
        "input",
        "9" * 30,
        "12:00",
        "2024-01-01",
    ),
)
# Commands that read no file of the user, or take minutes on sound input.
LEFT_OUT = {
    "demo",
    "verify",
    "rig campaign",
    "simulate campaign",
    "simulate ehl",
    "rig design",
}


class Hang(BaseException):
    """A command did not end in time."""


@dataclass(frozen=True)
class Outcome:
    """Exit code of a command, what it printed on standard error, and its words."""

    code: int | str
    error: str
    words: tuple[str, ...]

    @property
    def is_sound(self) -> bool:
        """Whether it ended as a command should."""
        return self.code in (0, 1, 2) and "Traceback" not in self.error


@dataclass(frozen=True)
class World:
    """Valid inputs by name, and a folder of the run."""

    files: dict[str, Path]
    folder: Path

    @classmethod
    def made(cls, folder: Path) -> World:
        """Write all inputs; tables are cut to few rows."""
        files = small_files(folder)
        options = EhlOptions(load_on_s=30.0, unload_s=60.0, duration_s=80.0)
        campaign = simulate_campaign(folder / "campaign", 3, ("B3",), ehl_options=options)
        files |= {
            "rig": campaign.rig,
            "oven": campaign.ovens["fast"],
            "plunge": campaign.plunges["fast"][0],
            "ehl": campaign.ehl["B3"],
        }
        for name, path in files.items():
            if path.suffix == ".csv":
                header, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
                if name in EVERY_NTH_ROW:
                    kept = rows[:: EVERY_NTH_ROW[name]]
                else:
                    kept = rows[: FIRST_ROWS.get(name, ROWS)]
                path.write_text("".join([header, *kept]), encoding="utf-8")
        for disk in ("fast", "slow"):
            files[disk] = Path(shutil.copy(RECORDS / f"{disk}.disk.json", folder))
        files["identified"] = folder / "i.identified.json"
        words = (
            "--input",
            "u",
            "--output",
            "T1_degC",
            "--model",
            "P1",
            "--report",
            folder / "i.html",
        )
        tcdyn("identify", files["table"], *words, "--out", files["identified"], "-q")
        files |= {"followed": folder / "f.csv", "state": folder / "f.state.json"}
        words = ("--out", files["followed"], "--state", files["state"], "--delay-s", "2")
        tcdyn("follow", files["table"], "--sensor", files["sensor"], *words, "--idle-s", "0", "-q")
        return cls(files, folder / "run")

    def given(self, words: list[str], changed: dict[str, bytes]) -> list[str]:
        """The words with paths of inputs, some of them changed, and of outputs in the folder."""
        given = []
        for word in words:
            if word.startswith("{") and word[1:-1] in self.files:
                name = word[1:-1]
                path = self.folder / self.files[name].name
                path.write_bytes(changed.get(name, self.files[name].read_bytes()))
                given.append(str(path))
            else:
                given.append(str(self.folder / word) if word in OUTPUTS else word)
        return given

    def run(self, words: list[str], changed: dict[str, bytes]) -> Outcome:
        """Run a command whose words name inputs as {name}, some of them changed."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        given = self.given(words, changed)
        out, err = io.StringIO(), io.StringIO()
        code: int | str
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), time_limit():
            try:
                code = tcdyn(*given)
            except BaseException as problem:
                code = type(problem).__name__
                traceback.print_exc()
        return Outcome(code, err.getvalue(), tuple(given))


OUTPUTS = ("o.csv", "o.json", "o.parquet", "o.png", "o.html", "o")


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Raise Hang after ``SECONDS``."""

    def stop(*_: object) -> None:
        raise Hang

    previous = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


def mutated(data: bytes, ending: str, edits: list[tuple[int, int, int]]) -> bytes:
    """The content of a file after some edits, each of three numbers: kind, place, value."""
    if ending == ".json":
        return mutated_json(data, edits)
    for edit in edits:
        data = mutated_text(data, *edit)
    return data


def mutated_text(data: bytes, kind: int, place: int, value: int) -> bytes:
    """One edit of a table or a TOML file."""
    lines = data.split(b"\n")
    k = place % len(lines)
    cell = CELLS[value % len(CELLS)].encode("utf-8", "surrogatepass")
    separator = b"=" if b" = " in data else b","
    cells = lines[k].split(separator)
    c = value % len(cells)

    def column(change: bytes | None) -> None:
        """Replace or remove the cell of one column in all rows."""
        for j, line in enumerate(lines):
            row = line.split(separator)
            if c < len(row):
                row[c : c + 1] = [] if change is None else [change]
            lines[j] = separator.join(row)

    def exchange(a: int, b: int) -> None:
        lines[a], lines[b] = lines[b], lines[a]

    def scaled(text: bytes) -> bytes:
        """The first number of a text multiplied, nothing else changed."""
        scale = SCALES[value % len(SCALES)]
        return NUMBER_IN_TEXT.sub(lambda found: b"%g" % (float(found[0]) * scale), text, count=1)

    kinds = 26
    match kind % kinds:
        case 0 | 1 | 2 | 3:
            cells[c] = cell
            lines[k] = separator.join(cells)
        case 4:
            del lines[k]
        case 5:
            lines.insert(k, lines[value % len(lines)])
        case 6:
            exchange(k, value % len(lines))
        case 7:
            column(None)
        case 8:
            column(cell)
        case 9:
            lines[0] = separator.join([cell, *lines[0].split(separator)[1:]])
        case 10:
            return data[: place % (len(data) + 1)]
        case 11:
            at = place % (len(data) + 1)
            return data[:at] + cell + data[at:]
        case 12:
            at = place % max(len(data), 1)
            return data[:at] + bytes([value % 256]) + data[at + 1 :]
        case 13:
            return data.replace(b",", (b";", b"\t", b" ", b"|", b",,")[value % 5])
        case 14:
            return data.replace(b".", b",").replace(b",", b";", value % 3)
        case 15:
            return (b"\xef\xbb\xbf", b"\xff\xfe", b"\x1f\x8b", b"PAR1", b"TDSm", b"PK\x03\x04")[
                value % 6
            ] + data
        case 16:
            return data.decode("utf-8", "replace").encode(
                ("utf-16", "utf-32", "cp1252")[value % 3], "replace"
            )
        case 17:
            return data + data
        case 18:
            lines[k:] = sorted(lines[k:])
        case 19 | 20:
            cells[-1] = scaled(cells[-1])
            lines[k] = separator.join(cells)
        case 21 | 22:
            cells[c] = scaled(cells[c])
            lines[k] = separator.join(cells)
        case 23 if separator == b",":
            for j, line in enumerate(lines[1:], 1):
                row = line.split(separator)
                if c < len(row):
                    row[c] = scaled(row[c])
                lines[j] = separator.join(row)
        case 24 if separator == b",":  # a channel that is stuck from row k
            for j in range(k + 1, len(lines)):
                row = lines[j].split(separator)
                if c < min(len(row), len(cells)):
                    row[c] = cells[c]
                lines[j] = separator.join(row)
        case _:
            lines = lines[: 1 + value % 30]
    return b"\n".join(lines)


def mutated_json(data: bytes, edits: list[tuple[int, int, int]]) -> bytes:
    """Some edits of a JSON file; the checksum is made to fit in half of the cases."""
    try:
        content = json.loads(data)
    except ValueError:
        return data
    for kind, place, value in edits:
        if kind % 8 == 7:
            return mutated_text(json.dumps(content).encode(), 10 + kind // 8 % 3, place, value)
        places = list(_places(content))
        if not places:
            break
        parent, key = places[place % len(places)]
        match kind % 8:
            case 0:
                del parent[key]
            case 1 if isinstance(parent, dict):
                parent[str(VALUES[value % len(VALUES)])] = deepcopy(parent[key])
            case 2:
                other, other_key = places[value % len(places)]
                parent[key] = deepcopy(other[other_key])
            case 3 | 4 if isinstance(parent[key], int | float):
                parent[key] = parent[key] * SCALES[value % len(SCALES)]
            case _:
                parent[key] = deepcopy(VALUES[value % len(VALUES)])
    if edits and edits[0][2] % 2 and isinstance(content, dict) and CHECKSUM_KEY in content:
        with contextlib.suppress(Exception):
            content = with_checksum(content)
    return json.dumps(content).encode()


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Every container of a JSON value, with each of its keys."""
    if isinstance(content, dict | list):
        for key in list(content) if isinstance(content, dict) else range(len(content)):
            yield content, key
            yield from _places(content[key])


def fuzzed_input(
    world: World, command: str, which: int, edits: list[tuple[int, int, int]]
) -> Outcome:
    """Run a command with one of its inputs mutated."""
    words = WORDS[command].split()
    names = [w[1:-1] for w in words if w.startswith("{") and w != "{followed}"]
    name = names[which % len(names)]
    path = world.files[name]
    return world.run(words, {name: mutated(path.read_bytes(), path.suffix, edits)})


COMMANDS = tuple(name for name in ALL if name not in LEFT_OUT)


def absurd_options(world: World, command: str, choices: list[tuple[int, int]]) -> Outcome:
    """Run a command with its arguments, and options with values that may be absurd."""
    words = command.split()
    parameters = [p for p in ALL[command].params if p.name != "help"]
    named = [p for p in parameters if p.param_type_name == "option"]
    files = list(world.files)

    def value(parameter: Any, number: int) -> str:
        """A value for a parameter: an input or an output for a path, else any text."""
        is_path = "Path" in parameter.bare_type()
        if is_path and parameter.name in ("out", "report", "csv", "covariance", "state"):
            return OUTPUTS[number % len(OUTPUTS)]
        if is_path and number % 4:
            return f"{{{files[number % len(files)]}}}"
        text = OPTION_VALUES[number % len(OPTION_VALUES)]
        return "missing" if is_path and ("/" in text or not text.strip() or text == ".") else text

    number = sum(b for _, b in choices)
    for parameter in parameters:
        if parameter not in named:
            words.append(value(parameter, number))
        elif parameter.required:
            words += [parameter.opts[0], value(parameter, number // 7)]
    for which, number in choices:
        option = named[which % len(named)]
        if option.name in ("workers", "dask", "open_"):
            continue
        words.append(option.opts[0])
        if not option.is_flag:
            words.append(value(option, number))
    if command == "follow":
        words += ["--idle-s", "0"]
    if command == "view":
        words.append("--no-open")
    return world.run(words, {})


def main(count: int, seed: int, kind: str) -> None:
    """Run mutated inputs or absurd options, and print the exit codes and what is not sound."""
    rng = np.random.default_rng(seed)
    codes = Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        world = World.made(Path(folder))
        for _ in range(count):
            numbers = rng.integers(0, 1 << 30, (rng.integers(1, 4), 3)).tolist()
            if kind == "inputs":
                command = str(rng.choice(list(WORDS)))
                edits = [tuple(row) for row in numbers]
                done = fuzzed_input(world, command, int(rng.integers(100)), edits)  # type: ignore[arg-type]
            else:
                command = str(rng.choice(COMMANDS))
                edits = [(a, b) for a, b, _ in numbers]
                done = absurd_options(world, command, edits)  # type: ignore[arg-type]
            codes[str(done.code)] += 1
            if not done.is_sound:
                lines = [
                    line for line in done.error.splitlines() if "File" in line or "rror" in line
                ]
                print(command, edits, done.code, done.words, *lines[-6:], sep="\n  ", flush=True)
    print(f"{count} {kind} from seed {seed}: exit codes {dict(codes)}")


if __name__ == "__main__":
    main(int(sys.argv[2]), int(sys.argv[3]), sys.argv[1])
