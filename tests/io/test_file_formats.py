"""One log in every form a laboratory has gives one and the same table."""

from __future__ import annotations

import gzip
import io
import threading
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter

from tcdyn.core.errors import InputError
from tcdyn.io import read
from tcdyn.rig.columns import LAYOUTS, match_columns
from tcdyn.rig.log import read_log, write_log
from tcdyn.rig.rigfile import parse_rig
from tests.rig.log_cases import (
    FRAMES,
    csv_text,
    ehl_frame,
    immersion_frame,
    lvm_text,
    oven_frame,
    write,
)

FRAME = ehl_frame()


def same(path, kind="ehl", frame=FRAME, rig=None):
    log = read_log(path, kind, rig)
    assert list(log.frame.columns) == list(frame.columns)
    assert np.array_equal(
        log.frame.to_numpy(), frame.to_numpy()
    )  # to the last digit: nothing may be rounded
    return log


@pytest.mark.parametrize("ending", ["csv", "parquet", "tdms"])
@pytest.mark.parametrize("kind", ["ehl", "immersion", "oven", "hole"])
def test_a_written_log_reads_back_to_the_last_digit_with_its_metadata(tmp_path, kind, ending):
    frame = FRAMES[kind]()
    path = write_log(frame, tmp_path / f"log.{ending}", {"operator": "A: B", "bath": "oil"})
    log = same(path, kind, frame)
    assert log.metadata["operator"] == "A: B"
    assert log.warnings == ()


def test_lvm_tdms_csv_and_parquet_forms_of_one_log_are_identical(tmp_path):
    same(write(tmp_path, "log.lvm", lvm_text(FRAME)))
    for ending in ("csv", "parquet", "tdms"):
        same(write_log(FRAME, tmp_path / f"log.{ending}"))


def test_no_other_thread_reads_text(tmp_path, monkeypatch):
    """A thread of pyarrow that still needs Python at the end of a program aborts it."""
    threads = set()

    class Stream(io.BytesIO):
        def read(self, size=-1):
            threads.add(threading.get_ident())
            return super().read(size)

    path = write(tmp_path, "log.csv", csv_text(FRAME))
    monkeypatch.setattr(read, "open_text", lambda dialect: Stream(dialect.path.read_bytes()))
    same(path)
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("rows", [1, 40, 100_000])
def test_cells_with_line_breaks_are_read_in_blocks_of_any_size(tmp_path, monkeypatch, rows):
    monkeypatch.setattr(read, "LEAST_BLOCK_BYTES", 64)
    lines = [f'{k},{20 + k},"first\n""{k}"" last"\n' for k in range(500)]
    path = write(tmp_path, "log.csv", "time_s,T_degC,note\n" + "".join(lines) + ",,\n,,\n")
    table = read.open_table(path)
    chunks = list(table.chunks(["time_s", "T_degC"], rows))
    assert (len(chunks) > 100) == (rows == 1)
    read_back = np.concatenate([chunk.data["T_degC"] for chunk in chunks])
    assert np.array_equal(read_back, 20.0 + np.arange(500))


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("semicolon and decimal comma", csv_text(FRAME, ";", ",")),
        ("semicolon and decimal point", csv_text(FRAME, ";")),
        ("tabs", csv_text(FRAME, "\t")),
        ("tabs and decimal comma", csv_text(FRAME, "\t", ",")),
        ("byte order mark", "\ufeff" + csv_text(FRAME)),
        ("windows line ends", csv_text(FRAME).replace("\n", "\r\n")),
        ("title lines", csv_text(FRAME, head="EHL test D4\nroom 12, disk pair 3\n\n")),
        ("header block", csv_text(FRAME, ";", ",", head="Operator;A\nDate;2015-03-09\nRate;75\n")),
        ("excel's own first line", csv_text(FRAME, ";", head="sep=;\n")),
        (
            "units row",
            csv_text(FRAME, units=",".join(["s", "N", "N", "-", "rpm", "rpm"] + ["°C"] * 14)),
        ),
        ("blank last lines", csv_text(FRAME) + "\n\n"),
        ("no last line end", csv_text(FRAME).rstrip("\n")),
        ("quoted header", csv_text(FRAME.rename(columns=lambda c: f'"{c}"'))),
        ("spaces after separators", csv_text(FRAME).replace(",", ", ")),
        ("trailing separator", csv_text(FRAME).replace("\n", ",\n")),
    ],
)
def test_the_dialects_people_have_are_one_table(tmp_path, name, text):
    same(write(tmp_path, "log.csv", text))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "cp1252", "utf-8-sig"])
def test_encodings_are_one_table(tmp_path, encoding):
    units = ",".join(["s", "N", "N", "-", "rpm", "rpm"] + ["°C"] * 14)
    text = csv_text(FRAME, units=units).encode(encoding)
    same(write(tmp_path, "log.csv", text))


def test_a_compressed_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(gzip.compress(b"time_s,T_degC\n0,1\n"))
    with pytest.raises(InputError, match="a compressed file; decompress it first"):
        read.open_table(path)


def test_a_header_of_several_hundred_kilobytes_is_found(tmp_path: Path) -> None:
    names = ["time_s", *(f"{'channel' * 20}_{k}_degC" for k in range(2000))]
    row = ",".join(["0.123456789"] * len(names))
    path = tmp_path / "wide.csv"
    path.write_text("\n".join([",".join(names), row, row, row]) + "\n", encoding="utf-8")
    assert read.open_table(path).names == tuple(names)


def test_a_parquet_file_without_rows_is_refused(tmp_path: Path) -> None:
    pd.DataFrame({"time_s": [0.0], "T_degC": [20.0]})[:0].to_parquet(tmp_path / "log.parquet")
    with pytest.raises(InputError, match="no rows"):
        read.open_table(tmp_path / "log.parquet")


@pytest.mark.parametrize(
    ("separator", "decimal"), [("\t", "."), ("\t", ","), (";", ","), (",", ".")]
)
def test_lvm_dialects_are_one_table(tmp_path, separator, decimal):
    same(write(tmp_path, "log.lvm", lvm_text(FRAME, separator, decimal)))


def test_lvm_without_x_column_takes_its_time_from_delta_x(tmp_path):
    frame = immersion_frame()
    names = list(frame.columns[1:])
    tabs = "\t"
    head = [
        "LabVIEW Measurement",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "X_Columns\tNo",
        "***End_of_Header***",
        "",
    ]
    head += ["Channels\t" + str(len(names)), "X0\t" + tabs.join(["0"] * len(names))]
    head += [
        "Delta_X\t" + tabs.join([repr(1 / 75)] * len(names)),
        "***End_of_Header***",
        tabs.join(["X_Value", *names]),
    ]
    rows = [tabs + tabs.join(repr(float(v)) for v in row) for row in frame[names].to_numpy()]
    log = read_log(write(tmp_path, "p.lvm", "\n".join(head + rows) + "\n"), "immersion")
    assert np.array_equal(log.frame[names].to_numpy(), frame[names].to_numpy())
    assert log.frame["time_s"].to_numpy() == pytest.approx(frame["time_s"].to_numpy(), abs=1e-9)


def test_clock_time_counts_seconds_from_the_first_row_through_midnight(tmp_path):
    frame = immersion_frame()
    stamp = pd.Timestamp("2015-03-09 23:59:40") + pd.to_timedelta(frame["time_s"], unit="s")
    text = csv_text(frame).split("\n")
    rows = [
        s.strftime("%H:%M:%S.%f") + "," + line.split(",", 1)[1] for s, line in zip(stamp, text[1:])
    ]
    path = write(tmp_path, "p.csv", "\n".join([text[0].replace("time_s", "time"), *rows]) + "\n")
    log = read_log(path, "immersion")
    # the stamps are cut to a microsecond
    assert log.frame["time_s"].to_numpy() == pytest.approx(frame["time_s"].to_numpy(), abs=2e-6)
    assert any("midnight" in w for w in log.warnings)


def test_rounded_time_stamps_are_even_sampling(tmp_path):
    frame = immersion_frame()
    log = read_log(
        write_log(frame.assign(time_s=frame["time_s"].round(3)), tmp_path / "p.csv"), "immersion"
    )
    assert log.dt_s == pytest.approx(1 / 75, rel=1e-6)  # 0.5 ms rounding over 40 s averages out
    steps = np.diff(
        log.frame["time_s"]
    )  # whoever takes the interval from the times must get the same
    assert np.median(steps) == pytest.approx(1 / 75, rel=1e-6)
    assert np.abs(log.frame["time_s"] - frame["time_s"]).max() < 0.5e-3  # the rounding itself
    assert log.warnings == ()


@pytest.mark.e2e
def test_stamps_of_two_decimals_are_even_where_a_sample_is_lost_too(tmp_path):
    """75 Hz written as 0.01, 0.03, 0.04 s: steps of 10 and 20 ms, which is no jitter."""
    frame = immersion_frame()
    coarse = frame.assign(time_s=frame["time_s"].round(2))
    log = read_log(write_log(coarse, tmp_path / "p.csv"), "immersion")
    assert log.dt_s == pytest.approx(1 / 75, rel=1e-5)
    assert np.abs(log.frame["time_s"] - frame["time_s"]).max() < 1e-3
    assert any("few decimals" in w for w in log.warnings)
    holed = read_log(write_log(coarse.drop(index=1500), tmp_path / "lost.csv"), "immersion").frame
    assert np.flatnonzero(holed["e_degC"].isna()).tolist() == [1500]
    assert np.array_equal(holed["e_degC"].drop(index=1500), frame["e_degC"].drop(index=1500))


def tdms(path, tracks):
    channels = []
    for name, (values, properties) in tracks.items():
        channels.append(
            ChannelObject("log", name, np.asarray(values, dtype=float), properties=properties)
        )
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)
    return path


def test_tdms_channels_with_their_own_tracks_give_the_same_time(tmp_path):
    frame = immersion_frame()
    tracks = {
        n: (frame[n], {"wf_increment": 1 / 75, "wf_start_offset": 0.0}) for n in frame.columns[1:]
    }
    log = read_log(tdms(tmp_path / "p.tdms", tracks), "immersion")
    assert np.array_equal(log.frame.to_numpy()[:, 1:], frame.to_numpy()[:, 1:])


def test_tdms_channels_that_start_later_are_put_where_they_belong(tmp_path):
    frame = immersion_frame()
    tracks = {
        n: (frame[n], {"wf_increment": 1 / 75, "wf_start_offset": 0.0}) for n in frame.columns[1:]
    }
    start = np.datetime64("2015-03-09T12:00:00.000000")
    for _, properties in tracks.values():
        properties["wf_start_time"] = start
    late = 30
    tracks["e_degC"] = (
        frame["e_degC"][late:],
        {
            "wf_increment": 1 / 75,
            "wf_start_time": start + np.timedelta64(400, "ms"),
            "wf_start_offset": 0.0,
        },
    )
    log = read_log(tdms(tmp_path / "p.tdms", tracks), "immersion")
    # 30 samples at 75 Hz are the 0.4 s: the channel lines up with the others again
    assert log.frame["e_degC"].to_numpy() == pytest.approx(
        frame["e_degC"].to_numpy()[late:], abs=1e-9
    )
    assert log.frame["switch"].to_numpy() == pytest.approx(frame["switch"].to_numpy()[late:], abs=0)
    assert any("start up to 0.4 s apart" in w for w in log.warnings)


def test_a_slow_tdms_channel_is_interpolated_onto_the_fast_ones(tmp_path):
    frame = immersion_frame()
    tracks = {n: (frame[n], {"wf_increment": 1 / 75}) for n in frame.columns[1:]}
    ramp = 100 + 0.01 * np.arange(0, 3000, 75) / 75
    tracks["fluid_degC"] = (ramp, {"wf_increment": 1.0})
    log = read_log(tdms(tmp_path / "p.tdms", tracks), "immersion")
    assert log.frame["fluid_degC"].to_numpy() == pytest.approx(
        100 + 0.01 * log.frame["time_s"].to_numpy(), abs=1e-9
    )
    assert any("rates 1, 75 Hz" in w for w in log.warnings)


def test_a_tdms_channel_without_time_track_takes_the_others_and_says_so(tmp_path):
    frame = immersion_frame()
    tracks = {n: (frame[n], {"wf_increment": 1 / 75}) for n in frame.columns[1:]}
    tracks["probe_degC"] = (frame["probe_degC"], {})
    log = read_log(tdms(tmp_path / "p.tdms", tracks), "immersion")
    assert any("probe_degC has no time track" in w for w in log.warnings)
    tracks["probe_degC"] = (frame["probe_degC"][:-100], {})
    with pytest.raises(InputError, match="no time track"):
        read_log(tdms(tmp_path / "q.tdms", tracks), "immersion")


def test_columns_are_mapped_by_the_rig_file_and_near_misses_are_named(tmp_path):
    frame = oven_frame()
    path = write_log(frame.rename(columns={"prt_degC": "PRT [°C]"}), tmp_path / "oven.csv")
    with pytest.raises(InputError, match=r'did you mean .PRT \[°C\]..* write prt_degC = "PRT'):
        read_log(path, "oven")
    rig = parse_rig({"columns": {"prt_degC": "PRT [°C]"}}, "rig.toml")
    same(path, "oven", frame, rig)
    with pytest.raises(InputError, match="did you mean 'prt_degC'"):
        read_log(path, "oven", parse_rig({"columns": {"prt_deg": "PRT [°C]"}}, "rig.toml"))


def test_one_name_for_a_thermocouple_serves_the_logs_of_both_disks_and_of_one(tmp_path):
    names = {f"{c}_degC": f"TC {c} langsam" for c in "abcdef"}
    rig = parse_rig({"columns": {f"slow_{name}": own for name, own in names.items()}}, "rig.toml")
    frame = oven_frame()
    path = write_log(frame.rename(columns=names), tmp_path / "oven.csv")
    pd.testing.assert_frame_equal(
        read_log(path, "oven", rig, "slow").frame, read_log_frame(tmp_path, frame)
    )
    with pytest.raises(
        InputError, match="a_degC, b_degC"
    ):  # another disk's names are not taken for it
        read_log(path, "oven", rig, "fast")


def read_log_frame(folder, frame):
    """An oven log under tcdyn's own names."""
    return read_log(write_log(frame, folder / "plain.csv"), "oven").frame


def test_an_extra_column_is_fine_and_oil_may_be_missing(tmp_path):
    log = same(write_log(FRAME.assign(humidity=40.0), tmp_path / "a.csv"))
    assert [(f.code, f.numbers["names"]) for f in log.findings] == [
        ("columns.unused", ("humidity",))
    ]
    log = read_log(write_log(FRAME.drop(columns="oil_degC"), tmp_path / "b.csv"), "ehl")
    assert any("oil_degC is missing" in w for w in log.warnings)


@pytest.mark.parametrize("given", ["oven", "immersion", "ehl"])
@pytest.mark.parametrize("wanted", ["oven", "immersion", "ehl"])
def test_the_wrong_kind_of_log_is_named(tmp_path, given, wanted):
    path = write_log(FRAMES[given](), tmp_path / "log.csv")
    if given == wanted:
        assert read_log(path, wanted).kind == wanted
    else:
        word = {"oven": "an oven log", "immersion": "an immersion log", "ehl": "an EHL log"}[given]
        with pytest.raises(InputError, match=f"this looks like {word}"):
            read_log(path, wanted)


@pytest.mark.parametrize("ending", ["csv", "parquet", "tdms"])
def test_a_compensated_log_is_refused_a_second_time(tmp_path, ending):
    path = write_log(FRAME, tmp_path / f"log.{ending}", {"tcdyn": "compensated"})
    with pytest.raises(InputError, match="compensated already"):
        read_log(path, "ehl")
    assert len(read_log(path, "ehl", allow_compensated=True).frame) == len(FRAME)


@pytest.mark.parametrize("momentary", [True, False])
def test_a_held_and_a_momentary_switch_are_both_fine(tmp_path, momentary):
    path = write_log(immersion_frame(momentary=momentary), tmp_path / "p.csv")
    assert read_log(path, "immersion").warnings == ()


def test_lvm_with_an_x_column_for_each_channel_is_aligned(tmp_path):
    frame = immersion_frame()
    names = list(frame.columns[1:])
    head = [
        "LabVIEW Measurement",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "X_Columns\tMulti",
        "***End_of_Header***",
        "",
    ]
    head += [
        f"Channels\t{len(names)}",
        "***End_of_Header***",
        "\t".join(f"X_Value\t{n}" for n in names) + "\tComment",
    ]
    rows = [
        "\t".join(f"{t!r}\t{float(v)!r}" for v in row)
        for t, row in zip(frame["time_s"].tolist(), frame[names].to_numpy())
    ]
    log = read_log(write(tmp_path, "p.lvm", "\n".join(head + rows) + "\n"), "immersion")
    assert np.array_equal(log.frame[names].to_numpy(), frame[names].to_numpy())
    assert log.frame["time_s"].to_numpy() == pytest.approx(frame["time_s"].to_numpy(), abs=1e-9)


def test_lvm_segments_follow_one_another(tmp_path):
    frame = immersion_frame()
    first, second = lvm_text(frame[:1000]), lvm_text(frame[1000:])
    text = first + "\n" + second[second.index("Channels") :]
    same(write(tmp_path, "p.lvm", text), "immersion", frame)
    other = second[second.index("Channels") :].replace("probe_degC", "probe")
    with pytest.raises(InputError, match="different channels"):
        read_log(write(tmp_path, "q.lvm", first + "\n" + other), "immersion")


def test_parquet_columns_of_other_types_become_numbers(tmp_path):
    frame = immersion_frame()
    stamp = pd.Timestamp("2015-03-09 12:00:00") + pd.to_timedelta(
        np.arange(len(frame)) * 13_333_333, unit="ns"
    )
    typed = frame.rename(columns={"time_s": "time"}).assign(
        time=stamp,
        switch=frame["switch"] > 0.5,
        probe_degC=frame["probe_degC"].astype(np.float32),
        fluid_degC=frame["fluid_degC"].map(repr),
    )
    typed.to_parquet(tmp_path / "p.parquet")
    log = read_log(tmp_path / "p.parquet", "immersion")
    assert log.frame["fluid_degC"].equals(frame["fluid_degC"])
    assert log.frame["switch"].equals(frame["switch"])
    assert log.dt_s == pytest.approx(1 / 75, rel=1e-6)  # nanosecond stamps
    assert log.frame["probe_degC"].to_numpy() == pytest.approx(
        frame["probe_degC"].to_numpy(), rel=1e-7
    )  # float32


def test_excel_words_for_on_and_off_are_a_switch(tmp_path):
    frame = immersion_frame()
    text = csv_text(frame).split("\n")
    rows = [text[0]]
    for line in text[1:-1]:
        time, switch, rest = line.split(",", 2)
        rows.append(f"{time},{'TRUE' if switch == '1.0' else 'FALSE'},{rest}")
    same(write(tmp_path, "p.csv", "\n".join(rows) + "\n"), "immersion", frame)


def test_filled_joins_missing_samples_by_straight_lines(tmp_path):
    frame = immersion_frame()
    gap = frame.copy()
    gap.loc[1000:1002, "a_degC"] = np.nan
    log = read_log(write_log(gap, tmp_path / "p.csv"), "immersion")
    assert log.frame["a_degC"].isna().sum() == 3
    expected = np.linspace(frame["a_degC"][999], frame["a_degC"][1003], 5)
    assert log.interpolate_missing()["a_degC"][999:1004].to_numpy() == pytest.approx(
        expected, abs=1e-12
    )
    assert log.channels == ("a_degC", "b_degC", "c_degC", "d_degC", "e_degC", "f_degC")


def test_every_missing_column_is_named_and_each_near_miss_is_offered_once() -> None:
    """Thirteen columns renamed: all thirteen are listed, twelve with the line to write, the other
    with what is left."""
    required = LAYOUTS["ehl"].required
    channels = [c for c in required if c.startswith(("fast_", "slow_"))]
    renamed = {
        c: "TC " + c.removesuffix("_degC").replace("_", " ").title() + " [°C]" for c in channels
    }
    names = tuple(renamed.get(c, c) for c in required if c != "load_N")
    with pytest.raises(InputError) as caught:
        match_columns((*names, "Kraft"), "ehl", "D4.csv")
    said = str(caught.value)
    assert ", ".join(["load_N", *channels]) in said
    for canonical, name in renamed.items():
        assert f'{canonical} = "{name}"' in said
    assert "nothing in the file looks like load_N (not used so far: 'Kraft')" in said


def test_missing_values_are_told_beside_spikes_with_the_place_of_the_longest_run(tmp_path):
    frame = ehl_frame()
    frame.loc[[300, 900], "fast_e_degC"] = 400.0
    frame.loc[[500, *range(2233, 2267)], "fast_e_degC"] = np.nan  # 0.45 s about the parting
    log = read_log(write_log(frame, tmp_path / "log.csv"), "ehl")
    assert any("fast_e_degC, row 302" in w and "2 spike(s)" in w for w in log.warnings)
    assert any(
        "fast_e_degC, row 2235 (29.7733 s): 34 values in a row are missing (0.45 s); 35 in all" in w
        for w in log.warnings
    )
