"""The options of the reader are in every command that reads rows over time, and mean the same.

Each is given on a tiny file; the report of the reader must be the same in all commands.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.rig.log import read_log
from tcdyn.series import ReadingOptions, TableOptions
from tcdyn.workflows.campaign_log import CampaignSettings
from tests.cli.test_main_job import tcdyn
from tests.cli.test_options import ALL, options
from tests.conftest import Campaign

OPTIONS = {"--time", "--time-unit", "--dt-s", "--where", "--on-change", "--averages-s"}
READERS = [
    "compensate",
    "follow",
    "view",
    "inspect",
    "identify",
    "sensor plunge",
    "sensor pair",
    "sensor current",
    "sensor noise",
    "sensor touch",
    "sensor history",
    "rig calibrate",
    "rig beta",
    "rig campaign",
    "rig holes",
]
N = 240


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of two channels with a stamp in milliseconds that has no unit, and a sensor."""
    folder = tmp_path_factory.mktemp("reading")
    k = np.arange(N)
    rise = np.where(k > 40, -np.expm1(-np.maximum(k - 40, 0) / 15), 0.0)
    noise = np.random.default_rng(5).normal(0, 0.03, (2, N))
    parts = []
    for name, lag, own in (("CH 1", 1.0, noise[0]), ("CH 2", 0.5, noise[1])):
        cells = {"clk": 500 * k + 1_000, "channel": name, "step": np.where(k >= 40, 1.0, 0.0)}
        parts.append(pd.DataFrame({**cells, "T_degC": 20 + 60 * lag * rise + own}))
    table = pd.concat(parts).sort_values("clk", kind="stable")
    table.to_csv(folder / "log.csv", index=False)
    new = ["sensor", "new", "--tau-s", "7.5+-0.1", "--column", "T_degC"]
    assert tcdyn(*new, "--out", folder / "s.json", "--quiet") == 0
    return folder


def calls(folder: Path) -> dict[str, list[Any]]:
    """A call of each command that reads one table, without options of the reader."""
    log = folder / "log.csv"
    sensor = ["--sensor", folder / "s.json", "--out", folder / "out.csv"]
    identify = ["-u", "step", "-y", "T_degC", "-m", "P1", "--out", folder / "i.json"]
    return {
        "compensate": ["compensate", log, *sensor],
        "compensate with a delay": ["compensate", log, *sensor, "--delay-s", 20],
        "follow": ["follow", log, *sensor, "--idle-s", 0.2],
        "inspect": ["inspect", log, "--column", "T_degC"],
        "identify": ["identify", log, *identify],
        "sensor plunge": ["sensor", "plunge", log, "--column", "T_degC"],
    }


GIVEN = {
    "a clock": ["--time", "clk", "--time-unit", "ms"],
    "an interval": ["--dt-s", "0.5"],
    "a mean": ["--time", "clk", "--time-unit", "ms", "--averages-s", "0.25"],
}


@pytest.mark.parametrize("name", READERS)
def test_every_command_that_reads_rows_has_the_options(name: str) -> None:
    assert options(name) >= OPTIONS


def test_no_other_command_has_them() -> None:
    others = [name for name in ALL if name not in READERS and "--time" in options(name)]
    assert others == []


@pytest.mark.e2e
@pytest.mark.parametrize("given", GIVEN)
def test_the_report_is_the_same_in_every_command(
    folder: Path, given: str, capsys: pytest.CaptureFixture[str]
) -> None:
    reports = {}
    for name, call in calls(folder).items():
        selected = [*call, "--where", "channel=CH 1", *GIVEN[given], "--json", "--overwrite"]
        assert tcdyn(*selected) == 0, name
        printed = capsys.readouterr()
        content = json.loads(printed.out)
        report = content["reading"][0] if name in LISTS else content["reading"]
        reports[name] = {key: report[key] for key in SAME} | {
            "readings": report["columns"]["T_degC"]["readings"]
        }
    first = reports["compensate"]
    assert first["rows"] == N
    assert first["interval_s"] == pytest.approx(0.5)
    assert first["averages_s"] == (0.25 if given == "a mean" else None)
    assert all(report == first for report in reports.values()), reports


LISTS = {"identify", "sensor plunge"}
SAME = ("rows", "samples", "interval_s", "duration_s", "rows_lost", "time", "averages_s")


@pytest.mark.e2e
def test_rows_that_are_means_are_an_info_in_every_command(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, call in calls(folder).items():
        words = [*call, "--where", "channel=CH 2", "--dt-s", 0.5, "--averages-s", 3, "--overwrite"]
        tcdyn(*words)
        printed = capsys.readouterr().err
        is_removed = name.startswith(("compensate", "follow"))
        told = ", which is removed with the lag" if is_removed else ": half of this, 1.5 s"
        if name == "sensor plunge":
            told = ", as specified: the lag is that of the sensor without this mean"
        assert f"mean over the 3 s before it{told}" in printed, name
        assert printed.count("mean over the 3 s") == 1, name


WRONG = {
    "--dt-s 0": "--dt-s is 0; expected 1e-10 to 1e+10",
    "--averages-s -1": "--averages-s is -1; expected 1e-10 to 1e+10",
    "--on-change -0.5": "--on-change is -0.5; expected a dead band",
    "--where CH": "--where CH; expected COLUMN=VALUE",
    "--where chanel=1": "did you mean 'channel'?",
    "--where channel=CH": "expected 'CH 1', 'CH 2'",
    "--time clock": "'clock'",
    "--time-unit parsec": "parsec",
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_value_gives_one_sentence(
    folder: Path, wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    option, _, value = wrong.partition(" ")
    for name, call in calls(folder).items():
        words = [option, value, "--overwrite", "--quiet"]
        if option != "--time":
            words += ["--time", "clk"]
        if option not in ("--time-unit", "--dt-s"):
            words += ["--time-unit", "ms"]
        assert tcdyn(*call, *words) == 2, name
        said = [line for line in capsys.readouterr().err.splitlines() if "tcdyn:" in line]
        assert len(said) == 1, (name, said)
        assert WRONG[wrong] in said[0], name
        used = set(re.findall(r"(?<=\s)--[a-z][\w-]+", said[0]))
        assert used <= options(name.partition(" with")[0]), (name, said)


def test_the_refusal_without_a_time_names_options_that_exist(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, call in calls(folder).items():
        assert tcdyn(*call, "--quiet", "--overwrite") == 2, name
        assert "--time COLUMN" in capsys.readouterr().err


@pytest.fixture(scope="module")
def renamed(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An immersion log whose clock is in milliseconds under another name, with a second unit."""
    path = tmp_path_factory.mktemp("rig") / "plunge.csv"
    table = pd.read_csv(campaign.files.plunges["fast"][0])
    table["clk"] = 1000 * table.pop("time_s")
    other = table.assign(unit_no=2, **{name: 25.0 for name in table if name.endswith("degC")})
    both = pd.concat([table.assign(unit_no=1), other]).sort_values("clk", kind="stable")
    both.to_csv(path, index=False)
    return path


def test_a_log_of_the_rig_is_read_as_the_rig_says(campaign: Campaign, renamed: Path) -> None:
    reading = ReadingOptions("clk", "ms", where="unit_no=1")
    log = read_log(renamed, "immersion", campaign.rig.with_reading(reading), "fast")
    plain = read_log(campaign.files.plunges["fast"][0], "immersion", campaign.rig, "fast")
    assert log.frame["a_degC"].equals(plain.frame["a_degC"])
    assert log.reading is not None
    assert plain.reading is not None
    assert log.reading.interval_s == pytest.approx(plain.reading.interval_s)


def test_a_log_of_the_rig_without_a_time_is_refused_with_the_options(
    campaign: Campaign, renamed: Path
) -> None:
    with pytest.raises(InputError, match=r"time=COLUMN.*dt_s=SECONDS"):
        read_log(renamed, "immersion", campaign.rig, "fast")


@pytest.mark.e2e
def test_a_calibration_reads_its_plunges_by_the_options(
    campaign: Campaign, renamed: Path, tmp_path: Path
) -> None:
    rig = ["--rig", campaign.files.rig, "--disk", "fast", "--reading-u-K", 0.1]
    words = ["rig", "calibrate", *rig, "--immersion", renamed, "--structure", "P1", "--quiet"]
    assert tcdyn(*words, "--out", tmp_path / "refused.json") == 2
    reading = ["--time", "clk", "--time-unit", "ms", "--where", "unit_no=1"]
    assert tcdyn(*words, *reading, "--out", tmp_path / "a.json") == 0
    words[words.index(renamed)] = campaign.files.plunges["fast"][0]
    assert tcdyn(*words, "--out", tmp_path / "b.json") == 0
    chains = [
        json.loads((tmp_path / name).read_text())["chain"]["common_lag_s"]["value"]
        for name in ("a.json", "b.json")
    ]
    assert chains[0] == pytest.approx(chains[1], rel=1e-6)


@pytest.mark.e2e
def test_a_log_of_the_rig_is_followed_as_the_options_say(
    campaign: Campaign, tmp_path: Path
) -> None:
    table = pd.read_csv(campaign.files.ehl["B3"])
    table = table[table["time_s"] < 20.0]
    table["clk"] = 1000 * table.pop("time_s")
    log = tmp_path / "ms.csv"
    table.to_csv(log, index=False)
    records = [word for path in campaign.record_paths.values() for word in ("--record", path)]
    reading = ["--time", "clk", "--time-unit", "ms", "--quiet"]
    delay = ["--delay-s", 2]
    followed, delayed = tmp_path / "f.csv", tmp_path / "d.csv"
    assert tcdyn("compensate", log, *delay, "--out", delayed, *records, *reading) == 0
    follow = ["follow", log, *delay, "--idle-s", 0.2, "--out", followed]
    assert tcdyn(*follow, *records) == 2
    assert tcdyn(*follow, *records, *reading) == 0
    assert len(pd.read_csv(followed)) == len(pd.read_csv(delayed)) == len(table)


def test_a_stored_result_of_a_campaign_is_not_used_for_other_options(campaign: Campaign) -> None:
    plain = CampaignSettings(campaign.rig, campaign.records)
    other = campaign.rig.with_reading(ReadingOptions(dt_s=0.1))
    assert plain.fingerprint() != CampaignSettings(other, campaign.records).fingerprint()


def test_the_options_of_a_table_are_those_of_the_reader_and_its_units() -> None:
    reading = TableOptions(time="t", dt_s=0.5, unit=["K"])
    assert reading.rows == ReadingOptions("t", dt_s=0.5)
    with pytest.raises(InputError, match="expected 1e-10"):
        TableOptions(averages_s=0.0)
