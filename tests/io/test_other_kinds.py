"""Files of other kinds are refused by name, in every command, on one line without their content."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table
from tcdyn.rig.log import read_log
from tests.cli.test_main_job import tcdyn


def database(path: Path) -> None:
    """A database with two tables, one of which has a line break in its name."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE readings (time_s REAL, T_degC REAL)")
        connection.execute('CREATE TABLE "no\ntes" (text TEXT)')
        connection.execute("INSERT INTO readings VALUES (0, 20), (1, 21)")
        connection.commit()


def hdf5(path: Path) -> None:
    """First bytes of an HDF5 file, with bytes that no terminal should get."""
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 20)


def mat_7_3(path: Path) -> None:
    """First bytes of a MATLAB file of version 7.3."""
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + bytes(range(256)))


def netcdf(path: Path) -> None:
    """First bytes of a NetCDF file of 64 bits."""
    path.write_bytes(b"CDF\x05" + bytes(range(256)) * 20)


def octave(path: Path) -> None:
    """A text file of Octave."""
    path.write_text("# Created by Octave 8.4.0\n# name: T\n# type: matrix\n# rows: 2\n20\n21\n")


def old_excel(path: Path) -> None:
    """First bytes of an old workbook."""
    content = bytes(range(256)) + "Workbook".encode("utf-16-le")
    path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + content)


KINDS: dict[str, tuple[Callable[[Path], None], str]] = {
    "log.db": (database, "SQLite database with the tables"),
    "log.sqlite": (database, "'readings'"),
    "log.h5": (hdf5, "HDF5"),
    "log.hdf5": (hdf5, "HDF5"),
    "log.nc": (netcdf, "NetCDF"),
    "log.mat": (mat_7_3, r"version 7\.3"),
    "other.mat": (octave, "text file of Octave"),
    "log.csv": (hdf5, "HDF5"),
    "log.xls": (old_excel, r"old Excel workbook \(\.xls\)"),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_file_of_another_kind_is_named(tmp_path: Path, name: str) -> None:
    write, words = KINDS[name]
    path = tmp_path / name
    write(path)
    with pytest.raises(InputError, match=words) as caught:
        open_table(path)
    assert str(caught.value).isprintable()


def test_a_damaged_database_is_named_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / "log.db"
    database(path)
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(InputError, match="this is an SQLite database"):
        open_table(path)


def new_sensor(path: Path) -> int:
    """State a sensor; the exit code."""
    return tcdyn("sensor", "new", "--tau-s", "2+-0.1", "--column", "T_degC", "--out", path)


# Arguments of each command that reads a table, with LOG for the file.
COMMANDS = (
    ("identify", "LOG", "--input", "u", "--output", "T_degC"),
    ("inspect", "LOG"),
    ("response", "LOG", "--frequency", "f_Hz", "--column", "m", "--column", "p"),
    ("sensor", "plunge", "LOG", "--column", "T_degC", "--out", "OUT.sensor.json"),
    ("view", "LOG", "--out", "OUT.html"),
    ("compensate", "LOG", "--sensor", "SENSOR", "--out", "OUT.csv"),
    ("follow", "LOG", "--sensor", "SENSOR", "--out", "OUT.csv", "--idle-s", "1"),
)


@pytest.mark.parametrize("name", KINDS)
def test_a_log_of_the_rig_of_another_kind_is_named(tmp_path: Path, name: str) -> None:
    write, words = KINDS[name]
    write(tmp_path / name)
    with pytest.raises(InputError, match=words):
        read_log(tmp_path / name, "ehl")


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["log.db", "log.h5", "log.mat", "log.xls"])
@pytest.mark.parametrize("command", COMMANDS, ids=[" ".join(c[:2]) for c in COMMANDS])
def test_each_command_names_the_kind_on_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: tuple[str, ...], name: str
) -> None:
    write, words = KINDS[name]
    write(tmp_path / name)
    sensor = tmp_path / "K.sensor.json"
    assert new_sensor(sensor) == 0
    capsys.readouterr()
    places = {"LOG": str(tmp_path / name), "SENSOR": str(sensor)}
    arguments = [places.get(each, each) for each in command]
    arguments = [each.replace("OUT", str(tmp_path / "out")) for each in arguments]
    code = tcdyn(*arguments)
    message = capsys.readouterr().err
    assert code == 2, message
    if command[0] == "follow" and name == "log.mat":
        words = "cannot grow"  # said of every .mat, also before the file exists
    assert re.search(words, message), message
    assert len(message.splitlines()) == 1, message
    assert message.strip().isprintable()


@pytest.mark.parametrize("name", ["log.xlsx", "log.mat", "log.parquet"])
def test_a_file_that_cannot_grow_is_refused_before_it_exists(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    sensor = tmp_path / "K.sensor.json"
    assert new_sensor(sensor) == 0
    capsys.readouterr()
    out = tmp_path / "out.csv"
    code = tcdyn("follow", tmp_path / name, "--sensor", sensor, "--out", out)
    assert code == 2
    assert "cannot grow" in capsys.readouterr().err
    assert not out.exists()
