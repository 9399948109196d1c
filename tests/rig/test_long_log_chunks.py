"""Long logs read in chunks: the same table in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter

from tcdyn.core.errors import InputError
from tcdyn.io import read as files
from tcdyn.io import rows as row_check
from tcdyn.rig import log as reading
from tcdyn.rig.log import iter_log, read_log, write_log
from tests.rig.log_cases import csv_text, ehl_frame, immersion_frame, lvm_text, write


def read_in_chunks(path, kind, rows):
    """The chunks as one frame, and all messages."""
    log = iter_log(path, kind, rows=rows)
    chunks = list(log)
    assert len(chunks) > 1
    assert [p.first for p in chunks] == np.cumsum(
        [0, *(len(p.frame) for p in chunks[:-1])]
    ).tolist()
    assert sum(len(p.frame) for p in chunks) == log.rows
    messages = [f.sentence for source in (log, *chunks) for f in source.findings]
    return pd.concat([p.frame for p in chunks], ignore_index=True), messages


def assert_chunks_equal_full_log(path, kind="ehl", rows=700):
    """Reading in chunks gives the same numbers to the last bit, and the same messages, as reading
    at once."""
    full_log = read_log(path, kind)
    from_chunks, messages = read_in_chunks(path, kind, rows)
    assert list(from_chunks.columns) == list(full_log.frame.columns)
    assert np.array_equal(from_chunks.to_numpy(), full_log.frame.to_numpy(), equal_nan=True)
    assert sorted(messages) == sorted(full_log.warnings)
    return full_log


@pytest.mark.parametrize("ending", ["csv", "parquet", "tdms", "lvm"])
def test_chunks_join_to_the_full_log(tmp_path, ending):
    frame = ehl_frame()
    path = tmp_path / f"log.{ending}"
    if ending == "lvm":
        write(tmp_path, "log.lvm", lvm_text(frame))
    else:
        write_log(frame, path)
    assert assert_chunks_equal_full_log(path).warnings == ()


def set_values(rows, column, value):
    """A function that sets the column to the value in these rows."""

    def change(frame):
        return frame.assign(
            **{column: frame[column].where(~frame.index.isin(np.atleast_1d(rows)), value)}
        )

    return change


def jittered(frame):
    """The frame with jittered time stamps."""
    jitter_s = np.random.default_rng(2).uniform(-0.3, 0.3, len(frame)) / 75
    return frame.assign(time_s=frame["time_s"] + jitter_s)


def with_clock_time(frame):
    """The frame with clock times across midnight."""
    stamp = pd.Timestamp("2015-03-09 23:59:40") + pd.to_timedelta(frame["time_s"], unit="s")
    return frame.assign(time_s=stamp.dt.strftime("%H:%M:%S.%f"))


FORMS = {
    "contact in volts": lambda f: f.assign(contact=5 * f["contact"]),
    "contact as text": lambda f: f.assign(contact=np.where(f["contact"] > 0, "on", "off")),
    "contact missing in places": set_values([400, 1100, 2300], "contact", np.nan),
    "clock time through midnight": with_clock_time,
    "three decimals of a second": lambda f: f.assign(time_s=f["time_s"].round(3)),
    "two decimals of a second": lambda f: f.assign(time_s=f["time_s"].round(2)),
    "jittered time": jittered,
    "time that starts late": lambda f: f.assign(time_s=f["time_s"] + 86400.0),
    "a time missing": set_values([1500], "time_s", np.nan),
    "rows lost, rounded time": lambda f: f.assign(time_s=f["time_s"].round(3)).drop(
        index=[*range(690, 705), 1400]
    ),
    "constant ambient": lambda f: f.assign(ambient_degC=22.0),
    "oil bath constant for 9 s": set_values(range(600, 1275), "oil_degC", 60.0),
    "a coarse logger": lambda f: f.assign(
        **{n: (f[n] / 0.2).round() * 0.2 for n in f if n.endswith("_degC")}
    ),
    "values missing for 0.45 s at a chunk boundary": set_values(
        range(680, 714), "fast_e_degC", np.nan
    ),
    "spikes next to missing values": lambda f: set_values([681, 715], "fast_e_degC", 200.0)(
        set_values(range(682, 714), "fast_e_degC", np.nan)(f)
    ),
    "impossible values": set_values([3, 699, 700, 2999], "slow_b_degC", 1e30),
    "infinite values": set_values([1399, 1400], "slow_b_degC", np.inf),
    "load missing": set_values(range(700, 760), "load_N", np.nan),
    "text among numbers": lambda f: set_values([5, 2345], "fast_c_degC", "---")(
        f.astype({"fast_c_degC": object})
    ),
    "text late in the log": lambda f: set_values([2345], "friction_N", "overload")(
        f.astype({"friction_N": object})
    ),
    "junctions e and b swapped": lambda f: f.rename(
        columns={"fast_e_degC": "fast_b_degC", "fast_b_degC": "fast_e_degC"}
    ),
    "no oil": lambda f: f.drop(columns="oil_degC"),
}


@pytest.mark.e2e
@pytest.mark.parametrize("rows", [250, 700])
@pytest.mark.parametrize("form", FORMS)
def test_chunks_equal_the_full_log_in_any_form(tmp_path, form, rows):
    path = tmp_path / "log.csv"
    FORMS[form](ehl_frame()).to_csv(path, index=False)
    assert_chunks_equal_full_log(path, rows=rows)


@pytest.mark.e2e
@pytest.mark.parametrize(("separator", "decimal"), [(";", ","), ("\t", ","), ("\t", ".")])
def test_dialects_are_read_in_chunks(tmp_path, separator, decimal):
    assert_chunks_equal_full_log(
        write(tmp_path, "log.csv", csv_text(ehl_frame(), separator, decimal, head="Operator;A\n\n"))
    )


def test_time_stamps_and_text_of_parquet_are_read_in_chunks(tmp_path):
    frame = ehl_frame()
    stamp = pd.Timestamp("2015-03-09 23:59:40") + pd.to_timedelta(frame["time_s"], unit="s")
    contact_text = frame["contact"].map({0.0: "off", 1.0: "on"})
    frame.assign(time_s=stamp.dt.round("us"), contact=contact_text).to_parquet(
        tmp_path / "log.parquet"
    )
    assert_chunks_equal_full_log(tmp_path / "log.parquet")


def test_tdms_with_time_stamps_or_channels_of_several_rates_is_read_in_chunks(tmp_path):
    frame = immersion_frame()
    stamp = (
        np.datetime64("2015-03-09T23:59:40")
        + (frame["time_s"] * 1e6).round().astype("timedelta64[us]")
    ).to_numpy()
    path = tmp_path / "log.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("log", n, stamp if n == "time_s" else frame[n].to_numpy())
                for n in frame
            ]
        )
    assert_chunks_equal_full_log(path, "immersion")
    with TdmsWriter(path) as writer:
        for name in frame.columns[1:]:
            step = 2 if name == "fluid_degC" else 1
            track = {"wf_increment": step / 75}
            writer.write_segment(
                [ChannelObject("log", name, frame[name].to_numpy()[::step], properties=track)]
            )
    assert len(read_log(path, "immersion").frame) > 2990
    assert_chunks_equal_full_log(path, "immersion")


@pytest.mark.e2e
@pytest.mark.parametrize(
    "form", ["spikes next to missing values", "contact in volts", "text among numbers"]
)
def test_log_longer_than_its_sample_in_memory_gives_the_same_numbers(tmp_path, monkeypatch, form):
    monkeypatch.setattr(reading, "MAX_ROWS_IN_MEMORY", 1000)
    monkeypatch.setattr(reading, "MAX_VALUES_IN_MEMORY", 10_000)
    path = tmp_path / "log.csv"
    FORMS[form](ehl_frame()).to_csv(path, index=False)
    from_chunks, _ = read_in_chunks(path, "ehl", 300)
    assert np.array_equal(
        from_chunks.to_numpy(), read_log(path, "ehl").frame.to_numpy(), equal_nan=True
    )


INVALID_LOGS = {
    "a channel that freezes": (set_values(range(1000, 2000), "fast_d_degC", 60.0), "stays at"),
    "a dead channel": (lambda f: f.assign(slow_b_degC=21.5), "slow_b_degC.*dead"),
    "room and junction exchanged": (
        lambda f: f.assign(slow_b_degC=f["ambient_degC"], ambient_degC=f["slow_b_degC"]),
        "ambient_degC changes .* and slow_b_degC .*look exchanged",
    ),
    "too many spikes": (
        set_values(range(0, 3000, 15), "fast_d_degC", 300.0),
        "% of the samples are spikes",
    ),
    "kelvin": (lambda f: f.assign(fast_c_degC=f["fast_c_degC"] + 273.15), "fast_c_degC.*kelvin"),
    "millivolts": (
        lambda f: f.assign(fast_c_degC=0.05 * f["fast_c_degC"]),
        "fast_c_degC.*millivolts",
    ),
    "load in kilonewtons": (lambda f: f.assign(load_N=f["load_N"] / 1000), "kilonewtons"),
    "five levels": (lambda f: f.assign(contact=np.arange(len(f)) % 5 / 4), "different values"),
    "a long gap": (set_values(range(1000, 1100), "fast_e_degC", np.nan), "100 values in a row"),
    "load missing for long": (set_values(range(1000, 1200), "load_N", np.nan), "7 % of the column"),
    "text instead of numbers": (
        lambda f: f.assign(fast_c_degC=["warm", "50.1"] * (len(f) // 2)),
        "dead channel",
    ),
}


@pytest.mark.e2e
@pytest.mark.parametrize("form", INVALID_LOGS)
def test_invalid_logs_raise_before_the_last_chunk(tmp_path, form):
    change, message = INVALID_LOGS[form]
    path = tmp_path / "log.csv"
    change(ehl_frame()).to_csv(path, index=False)
    with pytest.raises(InputError, match=message):
        read_log(path, "ehl")
    chunks = []
    with pytest.raises(InputError, match=message):
        chunks.extend(iter_log(path, "ehl", rows=300))
    assert sum(len(p.frame) for p in chunks) < 3000


@pytest.mark.e2e
@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(gap_start=st.integers(100, 2800), lost=st.integers(1, 20), spike=st.integers(100, 2800))
def test_gaps_and_spikes_at_any_chunk_boundary_are_found(tmp_path, gap_start, lost, spike):
    frame = ehl_frame()
    frame.loc[spike, "fast_e_degC"] = 400.0
    path = write_log(frame.drop(index=range(gap_start, gap_start + lost)), tmp_path / "log.csv")
    full_frame = read_log(path, "ehl").frame
    from_chunks, _ = read_in_chunks(path, "ehl", 400)
    assert np.array_equal(from_chunks.to_numpy(), full_frame.to_numpy(), equal_nan=True)


@pytest.mark.parametrize("rows", [400, 1000])
def test_checks_of_the_complete_test_run_at_its_end(tmp_path, rows):
    for frame, kind, message in (
        (ehl_frame().iloc[:2000], "ehl", "no unloading"),
        (immersion_frame().assign(switch=0.0), "immersion", "never moves"),
        (ehl_frame().iloc[::-1], "ehl", "backward"),
    ):
        path = write_log(frame, tmp_path / "log.csv")
        with pytest.raises(InputError, match=message):
            list(iter_log(path, kind, rows=rows))


def test_chunks_can_be_iterated_twice_and_findings_name_the_location(tmp_path):
    frame = set_values([700, 1000], "fast_e_degC", 150.0)(ehl_frame())
    log = iter_log(write_log(frame, tmp_path / "log.csv"), "ehl", rows=700)
    first, second = (list(log) for _ in range(2))
    assert sum(len(chunk.frame) for chunk in first) == len(frame)
    assert max(len(chunk.frame) for chunk in first) <= 2 * 700 < len(frame)
    assert all(
        a.frame.equals(b.frame) and a.findings == b.findings
        for a, b in zip(first, second, strict=True)
    )
    (spikes,) = (f for chunk in first for f in chunk.findings)
    assert (spikes.code, spikes.severity, spikes.subject) == (
        "spikes.removed",
        "info",
        "fast_e_degC",
    )
    assert spikes.numbers == {"count": 2, "row": 702, "time_s": pytest.approx(700 / 75)}
    assert spikes.where.endswith("log.csv")


def test_log_without_rows_raises(tmp_path):
    path = write_log(ehl_frame().iloc[:0], tmp_path / "log.csv")
    with pytest.raises(InputError, match="no table"):
        iter_log(path, "ehl")


def test_oven_logs_are_not_read_in_chunks(tmp_path):
    with pytest.raises(InputError, match="whole"):
        iter_log(tmp_path / "x.csv", "oven")


PEAK = """
import sys
from tcdyn.rig.log import iter_log
rows = sum(len(chunk.frame) for chunk in iter_log(sys.argv[1], "ehl"))
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(rows, int(peak.split()[1]) // 1024)
"""


@pytest.mark.long
@pytest.mark.study
@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="peak memory is read from Linux's /proc"
)
def test_gigabyte_log_is_read_in_bounded_memory(tmp_path):
    size = 0
    path = tmp_path / "long.csv"
    k = 0
    frame = ehl_frame(60_000).round(4)
    step = len(frame) / 75
    text = "\n".join(
        ",".join(map(str, row)) for row in frame.drop(columns="time_s").to_numpy().tolist()
    ).split("\n")
    with open(path, "w") as stream:
        stream.write(",".join(frame.columns) + "\n")
        while size < 1e9:
            times = k * step + np.arange(len(text)) / 75
            block = "\n".join(f"{t:.6f},{values}" for t, values in zip(times.tolist(), text)) + "\n"
            size = size + stream.write(block)
            k = k + 1
    out = subprocess.run(
        [sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True
    )
    rows, peak_MB = map(int, out.stdout.split())
    assert rows == k * len(frame)
    # the numbers of the log alone are 900 MB, the interpreter and its libraries 130 MB. Up to
    # ``MAX_VALUES_IN_MEMORY`` values are kept until the log is known to be longer
    assert peak_MB < 800, peak_MB


@pytest.mark.parametrize("size", [16, 4096, 1 << 20])
def test_row_numbers_do_not_depend_on_the_block_size(size, tmp_path, monkeypatch):
    """An invalid row is named by its line for any block boundary; blank lines count as lines, not
    as rows."""
    monkeypatch.setattr(row_check, "COUNT_BYTES", size)
    lines = csv_text(ehl_frame(3000)).splitlines()
    valid = read_log(
        write(tmp_path, "x.csv", "\n".join([*lines[:900], "", *lines[900:]]) + "\n"), "ehl"
    )
    assert len(valid.frame) == len(lines) - 1
    for change, message in (
        (lambda x: x.rpartition(",")[0], "fields"),
        (lambda x: x[:-1] + "\x00", "zero bytes"),
    ):
        invalid = [*lines[:2000], change(lines[2000]), *lines[2001:]]
        with pytest.raises(InputError, match=rf"row 2001 .*{message}"):
            read_log(write(tmp_path, "x.csv", "\n".join(invalid) + "\n"), "ehl")
    with pytest.raises(InputError, match=rf"row {len(lines)}, the last, has 1 of .* truncated"):
        read_log(write(tmp_path, "x.csv", "\n".join([*lines[:-1], lines[-1].split(",")[0]])), "ehl")


def test_short_log_is_joined_once_and_a_long_one_on_request(tmp_path, monkeypatch):
    path = write_log(ehl_frame(), tmp_path / "log.csv")
    log = iter_log(path, "ehl", rows=700)
    modified = log.to_log().frame
    modified.loc[5, "fast_a_degC"] = -1.0
    assert modified.loc[5, "fast_a_degC"] == -1.0 != log.to_log().frame.loc[5, "fast_a_degC"]
    assert np.shares_memory(*(log.to_log().frame["fast_b_degC"].to_numpy() for _ in range(2)))
    rows = np.array([3, 4, 900, 1500])
    selection = log.to_log(rows)
    assert np.array_equal(
        selection.frame.to_numpy(), log.to_log().frame.to_numpy()[rows], equal_nan=True
    )
    assert selection.sha256 == log.to_log().sha256 == files.sha256_of_file(path)
    monkeypatch.setattr(reading, "MAX_ROWS_IN_MEMORY", 1000)
    monkeypatch.setattr(reading, "MAX_VALUES_IN_MEMORY", 10_000)
    long_log = iter_log(path, "ehl", rows=700)
    assert not np.shares_memory(
        *(long_log.to_log().frame["fast_b_degC"].to_numpy() for _ in range(2))
    )
    assert long_log.to_log().frame.equals(log.to_log().frame)
