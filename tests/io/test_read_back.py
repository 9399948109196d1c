"""Whatever is written is read back, in every dialect; whatever bytes come, the answer is a log or
one sentence."""

from __future__ import annotations

import numpy as np
import pandas as pd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tcdyn.core.errors import InputError
from tcdyn.io.read import open_table, read_all_rows
from tcdyn.rig.log import read_log, write_log
from tests.rig.log_cases import csv_text, immersion_frame, oven_frame, write

CALM = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
CELLS = st.floats(allow_nan=True, allow_infinity=False, width=64)
SOUND_OVEN = csv_text(oven_frame()).encode()
SOUND_PLUNGE = csv_text(immersion_frame(200)).encode()


@CALM
@given(
    values=arrays(np.float64, st.tuples(st.integers(2, 30), st.integers(2, 5)), elements=CELLS),
    ending=st.sampled_from(["csv", "parquet", "tdms"]),
)
def test_any_numbers_survive_any_form(tmp_path, values, ending):
    values[0, :] = 0.5  # the first row decides what the header is
    values[-1, 0] = 0.5  # rows of separators only at the end of a file are not read
    frame = pd.DataFrame(values, columns=[f"name_{i}" for i in range(values.shape[1])])
    table = open_table(write_log(frame, tmp_path / f"x.{ending}"), frame.columns)
    names = [n for n in table.names if n.startswith("name_")]
    back = read_all_rows(table, names).data
    for name in frame:
        assert np.array_equal(back[name], frame[name].to_numpy(), equal_nan=True)


@CALM
@given(
    values=arrays(np.float64, st.tuples(st.integers(2, 30), st.integers(2, 5)), elements=CELLS),
    separator=st.sampled_from([";", "\t", ","]),
    decimal=st.sampled_from([".", ","]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    end=st.sampled_from(["\n", "\r\n"]),
    title=st.sampled_from(["", "EHL test\n", "Operator;A\nDate;9.3.2015\n", "# room: 12\n"]),
)
def test_any_numbers_survive_any_dialect(
    tmp_path, values, separator, decimal, encoding, end, title
):
    if separator == ",":
        decimal = "."
    values[0, :] = 0.5
    frame = pd.DataFrame(values, columns=[f"name_{i}" for i in range(values.shape[1])])
    text = csv_text(frame, separator, decimal, head=title).replace("\n", end)
    table = open_table(write(tmp_path, "x.csv", text.encode(encoding)), list(frame.columns))
    assert table.names == tuple(frame.columns)
    back = read_all_rows(table, table.names).data
    for name in frame:
        assert np.array_equal(back[name], frame[name].to_numpy(), equal_nan=True)


def log_or_sentence(path, kind):
    """Either a log, or an InputError of one line."""
    try:
        return read_log(path, kind)
    except InputError as problem:
        said = str(problem)
    assert "\n" not in said
    return None


@CALM
@given(
    raw=st.binary(max_size=400),
    name=st.sampled_from(["x.csv", "x.lvm", "x.tdms", "x.parquet", "x"]),
)
def test_any_bytes_end_in_a_log_or_a_sentence(tmp_path, raw, name):
    assert log_or_sentence(write(tmp_path, name, raw), "immersion") is None


@CALM
@given(text=st.text(max_size=300), kind=st.sampled_from(["oven", "immersion", "ehl", "hole"]))
def test_any_text_ends_in_a_sentence(tmp_path, text, kind):
    assert log_or_sentence(write(tmp_path, "x.csv", text.encode("utf-8", "replace")), kind) is None


@CALM
@given(
    at=st.floats(0.0, 1.0),
    raw=st.binary(min_size=1, max_size=6),
    kind=st.sampled_from(["oven", "immersion"]),
)
def test_a_sound_log_with_bytes_overwritten_is_never_wrong_without_a_flag(tmp_path, at, raw, kind):
    sound = SOUND_OVEN if kind == "oven" else SOUND_PLUNGE
    start = int(at * (len(sound) - len(raw)))
    damaged = sound[:start] + raw + sound[start + len(raw) :]
    log = log_or_sentence(write(tmp_path, "x.csv", damaged), kind)
    if log is None or log.warnings:
        return
    # digits may have changed: then the file is as good as another, but it must still be a table of
    # that length
    assert len(log.frame) in (24, 200)
    assert np.isfinite(log.frame.to_numpy()).all()


@CALM
@given(cut=st.floats(0.0, 1.0), kind=st.sampled_from(["oven", "immersion"]))
def test_a_log_cut_anywhere_is_refused_or_ends_with_a_whole_row(tmp_path, cut, kind):
    sound = SOUND_OVEN if kind == "oven" else SOUND_PLUNGE
    kept = sound[: int(cut * len(sound))]
    log = log_or_sentence(write(tmp_path, "x.csv", kept), kind)
    if log is None or any("line end" in w for w in log.warnings):
        return
    full = oven_frame() if kind == "oven" else immersion_frame(200)
    assert np.array_equal(log.frame.to_numpy(), full.to_numpy()[: len(log.frame)])
