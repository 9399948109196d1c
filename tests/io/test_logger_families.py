"""Files of many logger families: times and values are those of an independent reader, or a clear
error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.series.units import units_of
from tests.io.logger_families import FILES, SOURCES, Array, LoggerFile, first_degC
from tests.series.reading import read_columns
from tests.series.reading import source_of as open_source


def read(file: LoggerFile, path: Path) -> tuple[Array, list[Array]]:
    """Times since the first row [s] and columns [degC], as every command reads them."""
    source = open_source(path, None, file.columns, file.time_unit)
    units, _ = units_of(file.columns, "", file.couple, file.cold, source.table.units)
    time_s, values, _ = read_columns(path, file.columns, units, source.time, file.time_unit)
    return time_s - time_s[0], [values[name] for name in file.columns]


def test_there_are_sixty_files_of_at_least_twelve_families_each_with_its_source() -> None:
    assert len(FILES) >= 60
    assert len({file.name for file in FILES}) == len(FILES)
    assert {file.family for file in FILES} == set(SOURCES)
    assert len(SOURCES) >= 12


@pytest.mark.parametrize("file", FILES, ids=[file.name for file in FILES])
def test_a_file_of_a_logger_gives_the_times_and_values_of_an_independent_reader(
    tmp_path: Path, file: LoggerFile
) -> None:
    path = file.write(tmp_path)
    if file.refusal:
        with pytest.raises(InputError, match=file.refusal):
            read(file, path)
        return
    expected_s, expected = file.read(path)
    time_s, values = read(file, path)
    span_s = expected_s[-1]
    # the interval is the mean of all steps, so times differ by rounding only
    assert time_s == pytest.approx(expected_s, abs=1e-6 * span_s + file.interval_u * span_s)
    for column, expected_column in zip(values, expected, strict=True):
        assert column == pytest.approx(expected_column, abs=1e-9, nan_ok=True)


def test_the_independent_readers_give_the_closed_form(tmp_path: Path) -> None:
    """Rounding to 0.01 in the unit of the file; one file is offset and scaled by ten."""
    checked = 0
    for number, file in enumerate(FILES):
        folder = tmp_path / str(number)
        folder.mkdir()
        if file.refusal or "thousands" in file.case or "volts" in file.case:
            continue
        _, values = file.read(file.write(folder))
        known = np.isfinite(values[0])
        assert values[0][known] == pytest.approx(first_degC()[known], abs=0.006)
        checked += 1
    assert checked >= 55
