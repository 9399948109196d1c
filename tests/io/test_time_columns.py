"""Which column is the time, and stamps that are times of arrival."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv
from tcdyn.io.times import find_time_column, is_time_name
from tests.sensors.sensor_world import Array
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source


@pytest.mark.parametrize("name", ["t", "t [s]", "T [s]", "T/ms", "TIME", "Time", "t_min"])
def test_names_of_a_time(name: str) -> None:
    assert is_time_name(name)


@pytest.mark.parametrize("name", ["T", "T [degC]", "T_min", "T_s", "T_d", "T1", "T (K)"])
def test_names_of_a_temperature(name: str) -> None:
    assert not is_time_name(name)


def test_the_time_is_t_and_not_the_temperature() -> None:
    assert find_time_column(["T", "P", "t"], "log.csv").name == "t"
    assert find_time_column(["T", "P", "t"], "log.csv", unit_row={"T": "K", "t": "s"}).name == "t"
    assert find_time_column(["T", "P"], "log.csv", unit_row={"T": "s"}).name == "T"
    with pytest.raises(InputError):
        find_time_column(["T", "P"], "log.csv")


@pytest.mark.parametrize(
    ("names", "is_guess"),
    [(["t", "P"], True), (["time_s", "P"], False), (["time", "clock", "P"], True)],
)
def test_a_guess_of_the_time_column_is_reported(names: list[str], is_guess: bool) -> None:
    clock = find_time_column(names, "log.csv")
    assert [(f.code, f.subject) for f in clock.findings()] == (
        [("time.taken", names[0])] if is_guess else []
    )
    assert not find_time_column(names, "log.csv", requested=names[0]).findings()


def write_table(path: Path, time_s: Array) -> Path:
    """A table with these stamps."""
    rows = [f"{t:.4f},{20 + k % 7},{k % 2}" for k, t in enumerate(time_s)]
    path.write_text("\n".join(["time_s,T1_degC,u", *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("rows_of_burst", [2, 5, 10, 50])
@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_stamps_in_bursts_are_refused(tmp_path: Path, rows_of_burst: int, spread: float) -> None:
    rng = np.random.default_rng(0)
    inside_s = 0.002 * (1 + spread * rng.uniform(-1, 1, (12, rows_of_burst)))
    arrival_s = 5.0 * np.arange(1, 13)[:, None] + rng.uniform(0, 0.1, (12, 1))
    path = write_table(tmp_path / "log.csv", (arrival_s + np.cumsum(inside_s, axis=1)).ravel())
    with pytest.raises(InputError, match="arrival"):
        read_columns(open_source(path), ["T1_degC"])
    with pytest.raises(InputError, match="arrival"):
        from_csv(path, input="u", output="T1_degC")


@pytest.mark.parametrize(
    "time_s",
    [
        np.arange(120.0) / 4,
        np.delete(np.arange(120.0), np.arange(9, 120, 10)),  # every tenth row is lost
        np.sort(np.arange(120.0) + 0.3 * np.random.default_rng(1).standard_normal(120)),
        # slow rows, and fast ones around an event
        np.r_[60.0 * np.arange(20), 1200 + np.arange(100.0), 1300 + 60.0 * np.arange(20)],
    ],
)
def test_other_uneven_stamps_are_no_bursts(tmp_path: Path, time_s: Array) -> None:
    path = write_table(tmp_path / "log.csv", time_s)
    next(open_source(path).read_chunks(["T1_degC"]))
