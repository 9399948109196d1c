"""The commands compensate and follow: every format in and out, plunges, the page, other ways, a log
that grows."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.io.endings import MAX_SHEET_ROWS
from tcdyn.io.read import open_table
from tcdyn.rig.log import read_log, write_log
from tcdyn.rig.rigfile import load_rig
from tcdyn.workflows import compensate_log
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.conftest import Campaign


def tcdyn(*words: object) -> int:
    """Run the command in this process, as the entry point does; its exit code."""
    return run(lambda: app([str(w) for w in words]))


def both(campaign: Campaign) -> list[object]:
    return [word for path in campaign.record_paths.values() for word in ("--record", path)]


def fast(campaign: Campaign) -> list[object]:
    return ["--record", campaign.record_paths["fast"]]


@pytest.fixture(scope="module")
def stretch(campaign: Campaign) -> pd.DataFrame:
    """The plunge of the fast disk, seven seconds before the entry and twelve after."""
    frame = pd.read_csv(campaign.files.plunges["fast"][0])
    entry = float(frame.loc[frame["switch"] > 0.5, "time_s"].iloc[0])
    return frame[(frame["time_s"] > entry - 7) & (frame["time_s"] < entry + 12)].reset_index(
        drop=True
    )


@pytest.fixture(scope="module")
def reference(
    campaign: Campaign, stretch: pd.DataFrame, tmp_path_factory: pytest.TempPathFactory
) -> pd.DataFrame:
    """What the function makes of it."""
    log = write_log(stretch, tmp_path_factory.mktemp("reference") / "same.csv")
    return compensate_log(log, {"fast": campaign.records["fast"]}).frame


@pytest.fixture(scope="module")
def whole(campaign: Campaign) -> pd.DataFrame:
    """Test B3, compensated from its first row to its last."""
    return compensate_log(campaign.files.ehl["B3"], campaign.records, campaign.rig).frame


def lvm_text(frame: pd.DataFrame) -> str:
    head = (
        "LabVIEW "
        "Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tNo\n***End_of_Header***\t\n\n"
    )
    n = len(frame.columns)
    head += (
        f"Channels\t{n}\t\n***End_of_Header***\t\nX_Value\t"
        + "\t".join(frame.columns)
        + "\tComment\n"
    )
    return head + "".join(
        "\t" + "\t".join(f"{v:.9g}" for v in row) + "\n" for row in frame.to_numpy()
    )


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("csv", "parquet"),
        ("tdms", "csv"),
        pytest.param("parquet", "tdms", marks=pytest.mark.long),
        pytest.param("lvm", "csv", marks=pytest.mark.long),
    ],
)
def test_every_format_comes_in_and_goes_out_once(
    campaign: Campaign,
    tmp_path: Path,
    stretch: pd.DataFrame,
    reference: pd.DataFrame,
    given: str,
    wanted: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log, out = tmp_path / f"plunge.{given}", tmp_path / f"done.{wanted}"
    if given == "lvm":
        log.write_text(lvm_text(stretch), encoding="utf-8")
    else:
        write_log(stretch, log, {"operator": "someone", "bath": "Mobil Jet II"})
    assert tcdyn("compensate", log, *fast(campaign), "--out", out, "-q") == 0
    done = read_log(out, "immersion", allow_compensated=True)
    assert done.metadata["tcdyn"] == "compensated"
    assert done.metadata["source"] == log.name
    if given != "lvm":
        assert done.metadata["operator"] == "someone"
        assert done.metadata["bath"] == "Mobil Jet II"
    # the same numbers whatever the format; a CSV file has the decimals that its uncertainty needs
    rounding = 0.06 * reference["e_u_K"].min()
    assert np.allclose(done.frame["e_degC"], reference["e_degC"], rtol=0, atol=rounding)
    assert tcdyn("compensate", out, *fast(campaign), "--out", tmp_path / "twice.csv", "-q") == 2
    assert "compensated already" in capsys.readouterr().err
    assert not (tmp_path / "twice.csv").exists()


@pytest.mark.e2e
@pytest.mark.parametrize(
    "wanted",
    ["csv", *(pytest.param(ending, marks=pytest.mark.long) for ending in ("parquet", "tdms"))],
)
def test_a_log_with_stamps_keeps_them_its_start_and_on_request_its_dialect(
    campaign: Campaign,
    tmp_path: Path,
    stretch: pd.DataFrame,
    reference: pd.DataFrame,
    wanted: str,
) -> None:
    start = pd.Timestamp("2026-03-09 23:59:50")
    elapsed_s = stretch["time_s"] - stretch["time_s"].iloc[0]
    instants = start + pd.to_timedelta(elapsed_s, "s")
    stamps = [s.strftime("%d.%m.%Y %H:%M:%S,%f") for s in instants]
    german = stretch.drop(columns="time_s")
    german.insert(0, "time_s", stamps)
    log, out = tmp_path / "plunge.csv", tmp_path / f"done.{wanted}"
    lost = [700, 701]  # rows that the logger did not write
    german.drop(index=lost).to_csv(
        log, sep=";", decimal=",", index=False, encoding="latin-1", lineterminator="\r\n"
    )
    record = {"fast": campaign.records["fast"]}
    compensated = compensate_log(log, record)
    assert compensated.metadata["start_time"] == start.isoformat()
    expected = pd.Series(stamps)
    expected[lost] = ""
    assert compensated.frame["time_stamp"].tolist() == expected.tolist()
    compensated.write(out, dialect="input" if wanted == "csv" else "standard")
    if wanted == "csv":
        back = pd.read_csv(out, sep=";", decimal=",", encoding="latin-1")
        assert back["time_stamp"].fillna("").tolist() == expected.tolist()
        assert b"\r\n" in out.read_bytes()
    done = read_log(out, "immersion", allow_compensated=True)
    assert done.metadata == compensated.metadata
    assert np.allclose(done.frame["time_s"], elapsed_s, rtol=0, atol=1e-5)
    # two samples are missing, and the times of the stamps are rounded to microseconds
    near = np.abs(np.arange(len(stretch)) - 700) < 200
    assert np.allclose(done.frame["e_degC"][~near], reference["e_degC"][~near], rtol=0, atol=0.05)


@pytest.mark.long
@pytest.mark.e2e
def test_a_german_log_gives_a_workbook_or_a_finding_and_a_netcdf_file_with_dates(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame
) -> None:
    start = pd.Timestamp("2026-03-09 23:59:50")
    elapsed_s = stretch["time_s"] - stretch["time_s"].iloc[0]
    instants = start + pd.to_timedelta(elapsed_s.round(3), "s")
    log = tmp_path / "plunge.csv"
    german = stretch.assign(time_s=instants.dt.strftime("%d.%m.%Y %H:%M:%S,%f"))
    german.to_csv(log, sep=";", decimal=",", index=False)
    done = compensate_log(log, {"fast": campaign.records["fast"]})
    findings = {}
    for ending in ("csv", "xlsx", "nc"):
        path, findings[ending] = done.write(tmp_path / f"done.{ending}")
        assert path.exists()
    _, findings["input"] = done.write(tmp_path / "same.csv", dialect="input")
    named = [key for key, found in findings.items() if "table.dialect" in {f.code for f in found}]
    assert named == ["csv"]
    book = pd.read_excel(tmp_path / "done.xlsx", engine="openpyxl")
    assert np.allclose(book["e_u_K"], done.frame["e_u_K"], rtol=0.06)  # its decimals
    assert (book["time_stamp"] - instants).abs().max() <= pd.Timedelta("1us")
    with xr.open_dataset(tmp_path / "done.nc") as data:
        assert np.array_equal(data["e_degC"], done.frame["e_degC"])
        assert data["e_degC"].attrs["ancillary_variables"] == "e_u_K"
        since_s = (data["time"].values - np.datetime64(start, "ns")) / np.timedelta64(1, "s")
        assert np.allclose(since_s, done.frame["time_s"], rtol=0, atol=1e-6)
    size = len(done.frame)
    done_long = replace(done, frame=pd.concat([done.frame] * (MAX_SHEET_ROWS // size + 1)))
    with pytest.raises(InputError, match=r"too many for \.xlsx"):
        done_long.write(tmp_path / "long.xlsx")
    assert not (tmp_path / "long.xlsx").exists()


@pytest.mark.e2e
def test_with_a_delay_a_log_with_stamps_keeps_them_and_its_start(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame
) -> None:
    start = pd.Timestamp("2026-03-09 23:59:58")
    rows = stretch.iloc[330:630]  # the entry is the 525th
    elapsed_s = rows["time_s"] - rows["time_s"].iloc[0]
    stamps = [s.isoformat(sep=" ") for s in start + pd.to_timedelta(elapsed_s, "s")]
    log = tmp_path / "plunge.csv"
    rows.assign(time_s=stamps).to_csv(log, index=False)
    record = {"fast": campaign.records["fast"]}
    done = compensate_table(log, record, tmp_path / "done.csv", rig=campaign.rig, delay_s=1.0)
    assert open_table(done.path).metadata["start_time"] == start.isoformat()
    back = pd.read_csv(done.path)
    assert list(back)[:2] == ["time_s", "time_stamp"]
    assert back["time_stamp"].tolist() == stamps
    assert np.allclose(back["time_s"], elapsed_s, rtol=0, atol=1e-5)
    assert back["e_u_K"].notna().all()
    in_memory = compensate_log(log, record, campaign.rig, delay_s=1.0)
    in_memory.write(tmp_path / "written.csv")
    assert (tmp_path / "written.csv").read_bytes() == done.path.read_bytes()
    assert in_memory.card().equals(done.card())
    assert [*in_memory.as_log().frame] == [*in_memory.raw_log.frame]
    with pytest.raises(InputError, match="has no covariance"):
        in_memory.covariance(1.0, 0.0)
    with pytest.raises(InputError, match="leave one of them out"):
        compensate_log(log, record, campaign.rig, delay_s=1.0, parts=True)
    live = tmp_path / "live.csv"
    follow(log, record, live, campaign.rig, delay_s=1.0, idle_s=0.01, poll_s=0.01)
    assert live.read_bytes() == done.path.read_bytes()


@pytest.mark.long
@pytest.mark.e2e
def test_a_compensated_plunge_is_closer_to_the_truth_and_takes_one_record(
    campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = campaign.files.plunges["fast"][0], tmp_path / "plunge.csv"
    assert tcdyn("compensate", log, *both(campaign), "--out", out, "-q") == 2
    assert "record of the disk that was plunged" in capsys.readouterr().err
    assert tcdyn("compensate", log, *fast(campaign), "--out", out, "-q") == 0
    done, raw = pd.read_csv(out), pd.read_csv(log)
    true = pd.read_parquet(campaign.files.folder / "truth" / f"{log.stem}_traces.parquet")
    for c in "abcdef":
        ours, before = (
            np.sqrt(np.mean((f[f"{c}_degC"] - true[f"{c}_degC"]) ** 2)) for f in (done, raw)
        )
        assert ours < before / 4  # the lag of the record is known to 6 %: at best a sixteenth


@pytest.mark.e2e
def test_a_disk_without_record_stays_as_logged_and_is_named(campaign: Campaign) -> None:
    done = compensate_log(
        campaign.files.ehl["B3"], {"slow": campaign.records["slow"]}, campaign.rig
    )
    assert any(
        w.startswith("no record of the fast disk") and "records=fast.disk.json" in w
        for w in done.warnings
    )
    assert done.frame["fast_e_degC"].equals(done.raw_log.frame["fast_e_degC"])
    assert " s, from the record" in done.metadata["slow_common_lag_s"]


@pytest.mark.e2e
def test_the_page_holds_numbers_and_pictures(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame
) -> None:
    log, page = write_log(stretch, tmp_path / "plunge.csv"), tmp_path / "page.html"
    assert tcdyn("compensate", log, *fast(campaign), "--report", page, "-q") == 0
    assert (tmp_path / "plunge.compensated.csv").exists()
    html = page.read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == 2
    for words in ("remaining shift", "noise gain", "filter design report", "source_sha256"):
        assert words in html


@pytest.mark.long
@pytest.mark.e2e
def test_follow_states_its_delay_and_ends_by_itself(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out, page = (
        write_log(stretch, tmp_path / "plunge.csv"),
        tmp_path / "live.csv",
        tmp_path / "page.html",
    )
    words = ["follow", log, *fast(campaign), "--out", out, "--idle-s", "0.1"]
    assert tcdyn(*words, "--delay-s", "4", "--report", page) in (0, 1)
    output = capsys.readouterr().out
    for part in ("at most 4 s late", "no growth for 0.1 s"):
        assert part in output
    assert "data:image/png;base64," in page.read_text(encoding="utf-8")
    assert (
        pd.read_csv(out)["time_s"].tolist() == stretch["time_s"].tolist()[: len(pd.read_csv(out))]
    )
    state = tmp_path / "state.json"
    assert tcdyn(*words, "--state", state, "--overwrite", "--delay-s", "5", "-q") in (0, 1)
    stored = json.loads(state.read_text(encoding="utf-8"))
    assert (stored["delay_s"], stored["read"]["bytes"]) == (5.0, log.stat().st_size)
    capsys.readouterr()


def test_follow_needs_a_text_output_of_its_own_and_numbers_that_can_be(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = write_log(stretch, tmp_path / "plunge.csv"), tmp_path / "live.csv"
    for given in (
        ["--out", tmp_path / "out.parquet"],
        ["--out", log],
        ["--out", out, "--delay-s", "-1"],
        ["--out", out, "--delay-s", "1e8"],
    ):
        assert tcdyn("follow", log, *fast(campaign), "--idle-s", "0.1", *given, "-q") == 2
        assert capsys.readouterr().err.startswith("tcdyn: ")
    tdms = write_log(stretch, tmp_path / "plunge.tdms")
    assert tcdyn("follow", tdms, *fast(campaign), "--idle-s", "0.1", "--out", out, "-q") == 2
    assert "cannot grow line by line" in capsys.readouterr().err


@pytest.mark.e2e
def test_other_compensators_give_a_second_opinion(
    campaign: Campaign,
    tmp_path: Path,
    stretch: pd.DataFrame,
    reference: pd.DataFrame,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Away from the entry all three agree within what they say of themselves; before use the
    inverse says its price."""
    log, out, page = (
        write_log(stretch, tmp_path / "plunge.csv"),
        tmp_path / "done.csv",
        tmp_path / "page.html",
    )
    late = reference["time_s"] > reference["time_s"].iloc[-1] - 4
    for words in (
        ["--method", "deconvolve", "--criterion", "discrepancy"],
        ["--method", "inverse"],
    ):
        assert (
            tcdyn("compensate", log, *fast(campaign), "--out", out, "--report", page, *words) == 0
        )
        html = page.read_text(encoding="utf-8")
        assert (
            ("Deconvolution uses past and future samples" in html)
            == ("follows up to" in html)
            == ("inverse" not in words)
        )
        assert ("the causal inverse removed a common lag" in html) == ("inverse" in words)
        assert "fast.disk.json, of " in html  # the record by its own name
        done = pd.read_csv(out)
        z = (done["e_degC"] - reference["e_degC"]) / np.hypot(done["e_u_K"], reference["e_u_K"])
        assert np.mean(np.abs(z[late]) < 1.96) > 0.9
    said = capsys.readouterr().out
    assert "noise gain" in said
    assert "remaining shift" in said
    for words in (
        ["--method", "magic"],
        ["--criterion", "gcv"],
        ["--bandwidth-Hz", "2"],
        ["--method", "deconvolve", "--criterion", "magic"],
        ["--method", "noise-only", "--bandwidth-Hz", "2"],
    ):
        assert tcdyn("compensate", log, *fast(campaign), "--out", out, *words) == 2


@pytest.mark.long
@pytest.mark.e2e
def test_the_covariance_over_a_stretch_is_that_of_the_samples(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its diagonal is the file's standard deviation without the static line's part; neighbours move
    together."""
    log, out, cov = (
        write_log(stretch, tmp_path / "plunge.csv"),
        tmp_path / "done.csv",
        tmp_path / "cov.json",
    )
    words = ["compensate", log, *fast(campaign), "--out", out, "--covariance"]
    assert tcdyn(*words, cov, "--covariance-from-s", "22", "--covariance-s", "0.5", "-q") == 0
    found, done = (
        json.loads(cov.read_text(encoding="utf-8")),
        pd.read_csv(out).set_index("time_s"),
    )
    time, c = found["time_s"], np.array(found["covariance_K2"]["e"])
    assert c.shape == (len(time), len(time)) == (38, 38)  # half a second at 75 Hz
    assert np.all(
        np.sqrt(np.diag(c)) < done.loc[time, "e_u_K"] * 1.03
    )  # 3 %: the window's own grid of knots
    assert np.all(np.diag(c, 1) > 0.5 * np.diag(c)[1:])
    channels, of_means = found["channels"], np.array(found["mean_covariance_K2"])
    u = np.sqrt(np.diag(of_means))
    assert channels == list("abcdef")
    assert found["mean_degC"] == pytest.approx(
        [done.loc[time, f"{x}_degC"].mean() for x in channels], abs=1e-4
    )
    assert np.all(
        u < [done.loc[time, f"{x}_u_K"].max() for x in channels]
    )  # noise goes with the mean, no more
    shared = load_rig().common.traceability.reference_u_K
    assert np.all(
        of_means[~np.eye(6, dtype=bool)] > 0.99 * shared**2
    )  # what all have in common moves no difference
    assert found["difference_u_K"][0][1] ** 2 == pytest.approx(
        u[0] ** 2 + u[1] ** 2 - 2 * of_means[0, 1]
    )
    assert tcdyn(*words[:-1], "--components", "-q") == 0
    parts = pd.read_csv(out)
    assert np.all(np.hypot(parts["e_noise_u_K"], parts["e_common_u_K"]) < parts["e_u_K"] * 1.001)
    assert parts["e_common_u_K"].min() >= 0.99 * shared
    assert tcdyn(*words, out, "-q") == 2  # would write over the other output
    assert tcdyn(*words, cov, "-q") == 0  # from the entry on, which is found
    begun, entry = (
        json.loads(cov.read_text(encoding="utf-8"))["time_s"][0],
        7 + stretch["time_s"].iloc[0],
    )
    assert abs(begun - entry) < 0.3
    assert tcdyn(*words, cov, "--covariance-from-s", "22", "--method", "inverse", "-q") == 2
    assert "take the smoother" in capsys.readouterr().err


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent as a POSIX signal")
def test_ctrl_c_ends_it_with_whole_lines_and_a_state_to_go_on_from(
    campaign: Campaign, tmp_path: Path, stretch: pd.DataFrame
) -> None:
    log, out, state = tmp_path / "plunge.csv", tmp_path / "live.csv", tmp_path / "state.json"
    write_log(stretch.iloc[:1000], log)
    with log.open("a", encoding="utf-8") as half:
        half.write("13.3,0,29.")
    words = [
        sys.executable,
        "-m",
        "tcdyn",
        "follow",
        log,
        *fast(campaign),
        "--out",
        out,
        "--state",
        state,
        "--idle-s",
        "100",
    ]
    process = subprocess.Popen(
        [str(w) for w in words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        until = time.monotonic() + 200
        while not (out.exists() and out.read_text(encoding="utf-8").count("\n") > 800):
            assert time.monotonic() < until
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "stopped: 1000 rows read, 1000 written" in said
    assert out.read_text(encoding="utf-8").endswith("\n")
    write_log(stretch, log)
    assert (
        tcdyn(
            "follow", log, *fast(campaign), "--out", out, "--state", state, "--idle-s", "0.1", "-q"
        )
        == 0
    )
    assert pd.read_csv(out)["time_s"].tolist() == stretch["time_s"].tolist()


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize(
    ("first_s", "last_s", "said"),
    [
        (200.0, 350.0, set()),
        pytest.param(0.0, 60.0, {"compensate.unrefined"}, marks=pytest.mark.long),
        (0.0, 29.0, {"compensate.unrefined"}),
    ],
    ids=["begins in contact", "no unloading", "never loaded"],
)
def test_a_part_of_a_test_is_compensated_as_the_whole_is(
    campaign: Campaign,
    whole: pd.DataFrame,
    tmp_path: Path,
    first_s: float,
    last_s: float,
    said: set[str],
) -> None:
    """What both answers have in common, away from the ends, differs by less than their standard
    deviations: the part has the lag of the record where the whole has that of the unloading."""
    table = pd.read_csv(campaign.files.ehl["B3"])
    part = table[(table["time_s"] >= first_s) & (table["time_s"] < last_s)]
    ours = compensate_log(write_log(part, tmp_path / "part.csv"), campaign.records, campaign.rig)
    inner = slice(300, -300)
    away = (ours.frame["fast_e_degC"].to_numpy() - whole["fast_e_degC"].to_numpy()[part.index])[
        inner
    ]
    assert np.mean(np.abs(away) < 2 * ours.frame["fast_e_u_K"].to_numpy()[inner]) > 0.99
    assert {f.code for f in ours.findings} >= said
    if not ours.events_s:
        with pytest.raises(InputError, match="there is none"):
            ours.covariance(0.5)
    assert bool(ours.events_s) == (last_s > 30.0)  # the warm running never loads the disks
    assert "junctions.swapped" not in {f.code for f in ours.findings}
