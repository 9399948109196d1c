"""MATLAB files read as tables; the expected values are those that were saved."""

from __future__ import annotations

import random
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from tcdyn.core.errors import InputError
from tcdyn.io import matlab
from tcdyn.io.read import Part, open_table, read_all_rows
from tcdyn.io.table import Columns, Table
from tcdyn.series import ReadingOptions
from tcdyn.series.source import open_source

TIME_s = np.arange(50) * 0.2
T1 = 20 + np.sin(TIME_s)
T2 = 30 + np.cos(TIME_s)
HEADER = b"MATLAB 5.0 MAT-file, by hand".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def save(path: Path, variables: dict[str, Any], **options: Any) -> Path:
    """Write variables with scipy, compressed as MATLAB does."""
    savemat(path, variables, **{"do_compression": True, **options})
    return path


def read(path: Path, variable: str | None = None) -> tuple[Table, Columns]:
    """The table of a file and all its columns."""
    table = open_table(path, part=Part(variable=variable))
    return table, read_all_rows(table, table.names)


def message_of(path: Path) -> str:
    """The message with which a file is refused; empty for one that is read."""
    try:
        read(path)
    except InputError as problem:
        return str(problem)
    return ""


def check_log(path: Path, names: tuple[str, ...], variable: str | None = None) -> Table:
    """Check that a file has time, T1 and T2 under these names."""
    table, columns = read(path, variable)
    assert table.names == names
    for name, values in zip(names, (TIME_s, T1, T2)):
        np.testing.assert_array_equal(columns.data[name], values)
    assert columns.location.row(0) == 1
    return table


@pytest.mark.parametrize("options", [{}, {"do_compression": False}, {"format": "4"}])
def test_vectors_at_the_top_level_are_a_table(tmp_path: Path, options: dict[str, Any]) -> None:
    variables = {"time_s": TIME_s[:, None], "T1": T1[None, :], "T2": T2[:, None], "fs": 5.0}
    if options.get("format") == "4":
        options = {**options, "do_compression": False}
    table = check_log(save(tmp_path / "log.mat", variables, **options), ("time_s", "T1", "T2"))
    assert table.metadata["fs"] == "5.0" or table.metadata["fs"] == "5"


def test_a_struct_of_vectors_is_a_table(tmp_path: Path) -> None:
    log = {"time_s": TIME_s, "T1": T1, "T2": T2, "operator": "AB", "short": np.arange(7.0)}
    path = save(tmp_path / "log.mat", {"log": log, "gain": 3.0})
    table = check_log(path, ("time_s", "T1", "T2"))
    assert table.metadata == {"operator": "AB"}
    check_log(path, ("time_s", "T1", "T2"), "log")
    check_log(path, ("time_s", "T1", "T2"), "log.T1")


def test_a_struct_in_a_struct_is_named_with_a_point(tmp_path: Path) -> None:
    runs = {f"run{k}": {"time_s": TIME_s, "T1": T1 + k, "T2": T2} for k in range(2)}
    path = save(tmp_path / "log.mat", {"day": runs})
    with pytest.raises(
        InputError, match=r"2 tables.*'day.run0' \(50 x 3\), 'day.run1'.*variable=day.run0"
    ):
        open_table(path)
    check_log(path, ("time_s", "T1", "T2"), "day.run0")
    source = open_source(path, options=ReadingOptions(variable="day.run1"))
    assert source.table.where.endswith("variable day.run1")
    with pytest.raises(InputError, match=r"no table in a variable 'day.run7'.*'day.run0'"):
        open_table(path, part=Part(variable="day.run7"))


@pytest.mark.parametrize("kind", ["cell", "char", "rows"])
def test_a_matrix_has_the_names_beside_it(tmp_path: Path, kind: str) -> None:
    matrix = np.column_stack([TIME_s, T1, T2])
    names: Any = np.array(["time_s", "T1", "T2"], dtype=object)
    if kind == "char":
        names = np.array(["time_s", "T1    ", "T2    "])
    if kind == "rows":
        matrix = matrix.T
    path = save(tmp_path / "log.mat", {"s": {"data": matrix, "colheaders": names}})
    check_log(path, ("time_s", "T1", "T2"))
    check_log(path, ("time_s", "T1", "T2"), "s.data")


def test_a_matrix_beside_a_vector_of_times_gets_numbers(tmp_path: Path) -> None:
    path = save(tmp_path / "log.mat", {"t": TIME_s, "T": np.column_stack([T1, T2])})
    check_log(path, ("t", "T_1", "T_2"))


def test_a_matrix_without_names_has_numbered_columns(tmp_path: Path) -> None:
    path = save(tmp_path / "log.mat", {"M": np.column_stack([TIME_s, T1, T2])})
    check_log(path, ("column 1", "column 2", "column 3"))
    with pytest.raises(InputError, match=r"no time column found.*time=COLUMN"):
        open_source(path)
    source = open_source(path, options=ReadingOptions("column 1", "s"))
    time_s, _ = next(source.timed_chunks(["column 2"]))
    np.testing.assert_array_equal(time_s, TIME_s)
    source = open_source(path, options=ReadingOptions(dt_s=0.2))
    assert source.table.names[1:] == ("column 1", "column 2", "column 3")


def test_an_array_of_structs_is_a_table_of_their_fields(tmp_path: Path) -> None:
    kinds = [("time_s", object), ("T1", object), ("T2", object)]
    records = np.array(list(zip(TIME_s, T1, T2)), dtype=kinds)
    check_log(save(tmp_path / "log.mat", {"log": records}), ("time_s", "T1", "T2"))


def test_texts_are_stamps_or_words(tmp_path: Path) -> None:
    stamps = np.array([f"2024-03-11 09:59:{k:02d}" for k in range(50)], dtype=object)
    words = np.array(["heat" if k < 9 else "" for k in range(50)], dtype=object)
    path = save(tmp_path / "log.mat", {"Time": stamps, "T1": T1, "phase": words})
    table, columns = read(path)
    assert table.clock_columns == ("Time",)
    np.testing.assert_array_equal(columns.data["Time"], np.arange(50))
    assert list(columns.stamps["phase"][:2]) == ["heat", "heat"]


def test_days_of_datenum_are_not_taken_for_seconds(tmp_path: Path) -> None:
    days = 739322.5 + TIME_s / 86400
    path = save(tmp_path / "log.mat", {"t": days, "T1": T1})
    source = open_source(path)
    with pytest.raises(InputError, match="time_unit=days"):
        next(source.timed_chunks(["T1"]))
    source = open_source(path, options=ReadingOptions(time_unit="days"))
    time_s, _ = next(source.timed_chunks(["T1"]))
    # days of the year 2024 have steps of 1e-10 days, which is 10 us
    np.testing.assert_allclose(time_s - time_s[0], TIME_s, atol=2e-5)


def test_integers_and_logicals_are_numbers(tmp_path: Path) -> None:
    counts = np.arange(50, dtype=np.int16)
    path = save(tmp_path / "log.mat", {"time_s": TIME_s, "n": counts, "on": counts > 5})
    data = read(path)[1].data
    np.testing.assert_array_equal(data["n"], np.arange(50))
    np.testing.assert_array_equal(data["on"], np.arange(50) > 5)


def test_a_file_without_a_table_is_refused(tmp_path: Path) -> None:
    for variables in ({"a": 1.0}, {"z": TIME_s + 1j}, {"c": np.array([{"a": 1}], dtype=object)}):
        with pytest.raises(InputError, match="holds no table"):
            open_table(save(tmp_path / "log.mat", variables))


def element(kind: int, content: bytes) -> bytes:
    """A data element of a MATLAB file."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def array(class_number: int, name: str, sizes: tuple[int, ...], *contents: bytes) -> bytes:
    """An array of a MATLAB file."""
    parts = [element(6, struct.pack("<II", class_number, 0))]
    if sizes:
        parts.append(element(5, struct.pack(f"<{len(sizes)}i", *sizes)))
    parts.append(element(1, name.encode()))
    return element(14, b"".join([*parts, *contents]))


def vector(name: str, values: np.ndarray) -> bytes:
    """A vector of doubles."""
    return array(6, name, (len(values), 1), element(9, values.astype("<f8").tobytes()))


def matlab_object(name: str, class_name: str) -> bytes:
    """An object of MATLAB, as ``save`` writes it."""
    metadata = array(13, "", (6, 1), element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    texts = [element(1, text.encode()) for text in ("MCOS", class_name)]
    return array(17, name, (), *texts, metadata)


def write(path: Path, *elements: bytes) -> Path:
    """Write a MATLAB file by hand, each second variable compressed."""
    packed = []
    for k, each in enumerate(elements):
        content = zlib.compress(each)
        is_packed = k % 2 == 1
        packed.append(struct.pack("<II", 15, len(content)) + content if is_packed else each)
    path.write_bytes(HEADER + b"".join(packed))
    return path


@pytest.mark.parametrize(
    ("class_name", "line"),
    [
        ("table", r"writetable\(x, 'log.csv'\)"),
        ("timetable", r"writetimetable\(x, 'log.csv'\)"),
        ("datetime", r"x = posixtime\(x\); save\('log_v7.mat', '-v7'\)"),
        ("duration", r"x = seconds\(x\)"),
        ("Simulink.SimulationData.Dataset", r"writetable\(T, 'log.csv'\)"),
    ],
)
def test_objects_of_matlab_are_refused_with_the_line_that_converts_them(
    tmp_path: Path, class_name: str, line: str
) -> None:
    path = write(tmp_path / "log.mat", vector("T1", T1), matlab_object("x", class_name))
    with pytest.raises(InputError, match=rf"'x' is a {class_name} of MATLAB.*in MATLAB: {line}"):
        open_table(path)
    # who names the other variable, with a sampling interval, can use it
    assert check_dt(path, "T1") == ("time_s", "T1")


def check_dt(path: Path, variable: str) -> tuple[str, ...]:
    """Names of the columns with a sampling interval."""
    return open_source(path, options=ReadingOptions(dt_s=0.2, variable=variable)).table.names


def test_an_object_beside_a_table_does_no_harm(tmp_path: Path) -> None:
    path = write(
        tmp_path / "log.mat",
        matlab_object("note", "string"),
        matlab_object("T", "table"),
        vector("time_s", TIME_s),
        vector("T1", T1),
        vector("T2", T2),
    )
    check_log(path, ("time_s", "T1", "T2"))
    with pytest.raises(InputError, match="'T' is a table of MATLAB"):
        open_table(path, part=Part(variable="T"))


def test_a_time_that_is_an_object_in_a_struct_is_named(tmp_path: Path) -> None:
    names = [name.ljust(8, "\0") for name in ("time", "T1")]
    fields = element(1, "".join(names).encode())
    length = struct.pack("<HHi", 5, 4, 8)
    log = array(2, "log", (1, 1), length, fields, matlab_object("", "datetime"), vector("", T1))
    path = write(tmp_path / "log.mat", log)
    with pytest.raises(InputError, match=r"'log.time' is a datetime.*posixtime\(log.time\)"):
        open_table(path)


def test_version_7_3_is_refused_with_the_line_that_converts_it(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")
    with pytest.raises(
        InputError, match=r"7\.3 \(HDF5\).*save\('log_v7.mat', '-struct', 's', '-v7'\)"
    ):
        open_table(path)


def test_a_variable_that_unpacks_to_too_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path / "log.mat", {"time_s": np.zeros(300_000), "T1": np.zeros(300_000)})
    assert path.stat().st_size < 1 << 14
    monkeypatch.setattr(matlab, "MAX_BYTES", 1 << 20)
    with pytest.raises(InputError, match="has more than"):
        open_table(path)


@pytest.mark.parametrize("class_number", [1, 2, 4, 6])
def test_an_array_that_promises_more_than_it_has_is_refused(
    tmp_path: Path, class_number: int
) -> None:
    big = array(class_number, "x", (2**31 - 1, 3), element(9, b""))
    with pytest.raises(InputError, match="promises 6442450941 elements in"):
        open_table(write(tmp_path / "log.mat", vector("time_s", TIME_s), big))


@pytest.mark.parametrize("options", [{}, {"do_compression": False}, {"format": "4"}])
def test_damaged_files_give_no_traceback(tmp_path: Path, options: dict[str, Any]) -> None:
    log = {"time_s": TIME_s, "T1": T1, "names": np.array(["a", "bc"], dtype=object)}
    variables: dict[str, Any] = {"time_s": TIME_s, "T1": T1, "log": log, "word": "text"}
    if options.get("format") == "4":
        variables.pop("log")
        options = {**options, "do_compression": False}
    path = save(tmp_path / "log.mat", variables, **options)
    sound = path.read_bytes()
    rng = random.Random(5)
    for variant in range(200):
        content = bytearray(sound)
        if variant % 4 == 0:
            del content[rng.randrange(1, len(content)) :]
        else:
            for _ in range(rng.randrange(1, 6)):
                content[rng.randrange(len(content))] = rng.randrange(256)
        path.write_bytes(content)
        assert message_of(path).isprintable()


def test_truncated_files_are_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "log.mat", {"time_s": TIME_s, "T1": T1})
    content = path.read_bytes()
    for size in (140, 300, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(InputError, match="truncated"):
            open_table(path)
