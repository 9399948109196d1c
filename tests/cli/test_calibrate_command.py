"""`tcdyn rig calibrate` as people meet it: said once, digits that match, structures compared, a
page one reads."""

from __future__ import annotations

import contextlib
import io
import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibration.decisions import FIT_TO_USE, channel_verdicts
from tcdyn.core.errors import InputError
from tcdyn.report.certificate import certificate_verdict
from tcdyn.rig.record import read_record
from tcdyn.workflows import calibrate_disk
from tcdyn.workflows.calibrate import CalibrationRun
from tests.cli.test_main_job import tcdyn
from tests.conftest import Campaign
from tests.report.test_browser import BROWSER, FLAGS


@dataclass(frozen=True)
class Said:
    """One run of the command on a plunge whose switch bounces."""

    out: str
    err: str
    record: dict
    page: str


@pytest.fixture(scope="module")
def said(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Said:
    folder = tmp_path_factory.mktemp("calibrate")
    plunge = pd.read_csv(campaign.files.plunges["fast"][0])
    entry = int(plunge.index[plunge["switch"] > 0.5][0])
    plunge.loc[[entry + 2, entry + 4, entry + 7], "switch"] = 0
    plunge.to_csv(folder / "bouncing.csv", index=False)
    out, page = folder / "fast.disk.json", folder / "fast.html"
    with (
        contextlib.redirect_stdout(io.StringIO()) as said,
        contextlib.redirect_stderr(io.StringIO()) as warned,
    ):
        code = tcdyn(
            "rig",
            "calibrate",
            "--rig",
            campaign.files.rig,
            "--disk",
            "fast",
            "--oven",
            campaign.files.ovens["fast"],
            "--immersion",
            folder / "bouncing.csv",
            "--structure",
            "P1",
            "--out",
            out,
            "--report",
            page,
        )
    assert code == 0
    return Said(
        said.getvalue(),
        warned.getvalue(),
        json.loads(out.read_text("utf-8")),
        page.read_text("utf-8").replace("\u00a0", " "),
    )


@pytest.mark.long
@pytest.mark.e2e
def test_a_bouncing_switch_is_told_once_and_in_one_wording(said: Said) -> None:
    told = [w for w in said.record["warnings"] if "bounc" in w]
    assert told == [
        "bouncing.csv: the entry switch bounced within a second; its first closing was taken"
    ]
    assert said.err.count("the entry switch bounced") == 1
    assert (
        "the entry switch bounced" not in said.out
    )  # warnings go to standard error, and not a second time to the summary
    assert said.page.count("the entry switch bounced") == 1


@pytest.mark.long
def test_digits_around_plus_minus_match(said: Said) -> None:
    pairs = re.findall(r"(-?[\d.]+) \+- ([\d.]+)", said.out)
    assert len(pairs) >= 14  # the common lag twice, six channels with two each
    for value, u in pairs:
        assert len(value.partition(".")[2]) == len(u.partition(".")[2]), (value, u)
        assert len(u.replace(".", "").lstrip("0")) == 2, (value, u)


def test_intervals_of_lags_are_explained_where_they_stand(said: Said) -> None:
    assert re.search(
        r"95 % [\d.]+ to [\d.]+ s\n +\(a lag's interval may reach further up than down", said.out
    )
    assert "interval may reach further up than down" in said.page


def test_structures_travel_with_record_summary_and_certificate(said: Said) -> None:
    found = said.record["fit"]["structures"]
    assert found["chosen"] == "P1"
    assert {c["structure"] for c in found["candidates"]} == {"P1", "P2", "P1D", "P2D", "P2Z", "P3"}
    assert sum(c["probability"] for c in found["candidates"]) == pytest.approx(1.0)
    assert said.out.count(found["sentence"]) + said.err.count(found["sentence"]) == 1
    assert said.page.lower().replace("±", "+-").count(found["sentence"].lower()) == 1
    assert found["u_common_lag_after_s"] == pytest.approx(
        said.record["chain"]["common_lag_s"]["u"], rel=1e-6
    )
    assert "Which chain structure" in said.page
    assert "one lag and a dead time" in said.page


def test_the_certificate_of_simulated_logs_is_marked_and_names_no_login(said: Said) -> None:
    """The plunge was saved by another program, without metadata; the oven log has its own."""
    head = said.page[said.page.index("<h1>") : said.page.index("</h1>")]
    assert "simulated" in head
    assert "draft, not a calibration certificate" in head
    assert "oven_fast.csv is simulated" in said.err
    assert said.record["created_by"] == ""
    assert "Authorised by" not in said.page


def test_the_certificate_gives_its_verdict_once_and_first(said: Said) -> None:
    page = said.page
    assert page.count("6 of 6 thermocouples fit to use") == 1
    order = [
        page.index(w)
        for w in (
            "thermocouples fit to use",
            "<h2>Results",
            "<h2>Budget",
            "<h2>Budget: lags",
            "<summary>Lags",
        )
    ]
    assert order == sorted(order)
    assert (
        page.count("data:image/png") == 6
    )  # one message each: lags, budget, plunge, what is left, errors, residuals
    assert not re.search(
        r"<td[^>]*>-?\d+\.\d{5,}\s*</td>", page
    )  # no number without its uncertainty runs to five digits


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_the_certificate_opens_and_prints_without_console_errors(
    said: Said, tmp_path: Path
) -> None:
    page, printed = tmp_path / "fast.html", tmp_path / "fast.pdf"
    page.write_text(said.page, encoding="utf-8")
    done = subprocess.run(
        [
            str(BROWSER),
            *FLAGS,
            "--enable-logging=stderr",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--no-pdf-header-footer",
            f"--print-to-pdf={printed}",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "CONSOLE" not in done.stderr
    assert (
        2 <= printed.read_bytes().count(b"/Type /Page\n") <= 6
    )  # some pages of A4, not one and not a book


@pytest.mark.e2e
def test_an_unknown_structure_names_the_known_ones(
    campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    f = campaign.files
    code = tcdyn(
        "rig",
        "calibrate",
        "--rig",
        f.rig,
        "--disk",
        "fast",
        "--oven",
        f.ovens["fast"],
        "--immersion",
        f.plunges["fast"][0],
        "--structure",
        "P9",
        "--quiet",
    )
    assert code == 2
    assert "expected P1 or P2 or P1D or P2D or P2Z or P3" in capsys.readouterr().err


@pytest.mark.e2e
def test_a_wrong_fluid_and_another_disk_s_plunge_are_named_as_such(campaign: Campaign) -> None:
    from tcdyn.workflows import calibrate_disk

    f = campaign.files
    plunges = [f.plunges["fast"][0], f.plunges["slow"][1]]
    fluids = ["mobil-jet-ii", "water"]
    told = calibrate_disk(campaign.rig, "fast", f.ovens["fast"], plunges, fluids).warnings
    first, second = (p.name for p in plunges)
    assert any(
        w.startswith(f"{second}: h comes out") and w.endswith("is the fluid the right one?")
        for w in told
    )
    assert not any(w.startswith(f"{first}: h comes out") for w in told)
    assert any("plunge of another disk" in w for w in told)


@pytest.mark.e2e
def test_a_plunge_given_twice_is_refused_since_it_would_count_as_two(
    campaign: Campaign, tmp_path: Path
) -> None:
    from shutil import copy

    from tcdyn.core.errors import InputError
    from tcdyn.workflows import calibrate_disk

    f = campaign.files
    again = copy(f.plunges["fast"][0], tmp_path / "another_name.csv")
    with pytest.raises(InputError, match=f"same samples as {f.plunges['fast'][0].name}"):
        calibrate_disk(
            campaign.rig, "fast", f.ovens["fast"], [f.plunges["fast"][0], again], ["mobil-jet-ii"]
        )


@pytest.mark.long
@pytest.mark.e2e
def test_an_oven_log_of_the_other_disk_is_named_as_such(campaign: Campaign) -> None:
    from tcdyn.workflows import calibrate_disk

    f = campaign.files
    told = calibrate_disk(
        campaign.rig, "fast", f.ovens["slow"], f.plunges["fast"], ["mobil-jet-ii"]
    ).warnings
    assert any("is the oven log of the disk that was plunged (fast)" in w for w in told)
    own = calibrate_disk(
        campaign.rig, "fast", f.ovens["fast"], f.plunges["fast"], ["mobil-jet-ii"]
    ).warnings
    assert not any("is the oven log of the disk" in w for w in own)


@pytest.mark.long
@pytest.mark.e2e
def test_missing_samples_stay_missing_and_a_plunge_hotter_than_the_oven_is_told(
    campaign: Campaign, calibrations: dict[str, CalibrationRun], tmp_path: Path
) -> None:
    from tcdyn.workflows import calibrate_disk

    f = campaign.files
    oven, plunge = pd.read_csv(f.ovens["fast"]), pd.read_csv(f.plunges["fast"][1])
    oven[oven["setpoint_degC"] < 90].to_csv(tmp_path / "oven.csv", index=False)
    entry = int(plunge.index[plunge["switch"] > 0.5][0])
    plunge.loc[entry + 40 : entry + 69, "e_degC"] = float("nan")
    plunge.to_csv(tmp_path / "P2.csv", index=False)
    run = calibrate_disk(
        campaign.rig, "fast", tmp_path / "oven.csv", [tmp_path / "P2.csv"], ["mobil-jet-ii"]
    )
    assert pd.DataFrame(run.plunges[0].readings_degC).isna().sum().tolist() == [0, 0, 0, 0, 30, 0]
    told = [w for w in run.warnings if "extrapolate" in w]
    assert len(told) == 1  # one sentence for the six channels
    assert re.match(
        r"P2\.csv: a, b, c, d, e, f read 2\d to 9\d degC, calibrated from \d+ to (79|80|81) degC",
        told[0],
    )
    own = calibrations["fast"].warnings
    assert not any("extrapolate" in w for w in own)


@pytest.mark.parametrize("fluids", [[], ["water"] * 2, ["water"] * 4])
def test_fluids_are_given_once_or_once_for_each_plunge(
    campaign: Campaign, fluids: list[str]
) -> None:
    from tcdyn.core.errors import InputError
    from tcdyn.workflows import calibrate_disk

    f = campaign.files
    with pytest.raises(
        InputError, match=rf"{len(fluids)} fluids for 3 plunge\(s\); expected one fluid for all"
    ):
        calibrate_disk(campaign.rig, "fast", f.ovens["fast"], [f.plunges["fast"][0]] * 3, fluids)


@pytest.mark.e2e
def test_a_plunge_saved_again_in_another_dialect_is_still_the_same_plunge(
    campaign: Campaign, tmp_path: Path
) -> None:
    f = campaign.files
    plunges = [f.plunges["fast"][0], tmp_path / "again.csv"]
    pd.read_csv(plunges[0]).round(2).to_csv(plunges[1], index=False, sep=";", decimal=",")
    with pytest.raises(InputError, match="holds the same samples as"):
        calibrate_disk(campaign.rig, "fast", f.ovens["fast"], plunges, ["mobil-jet-ii"])


@pytest.mark.e2e
def test_swapped_channels_of_a_plunge_give_no_record(campaign: Campaign, tmp_path: Path) -> None:
    """It gave a common lag of seconds and sixteen warnings; the reader had seen the swap."""
    f = campaign.files
    names = {"a_degC": "b_degC", "b_degC": "a_degC"}
    pd.read_csv(f.plunges["fast"][0]).rename(columns=names).to_csv(tmp_path / "P1.csv", index=False)
    with pytest.raises(InputError, match=r"a_degC and b_degC.*swapped"):
        calibrate_disk(
            campaign.rig, "fast", f.ovens["fast"], [tmp_path / "P1.csv"], ["mobil-jet-ii"]
        )


@pytest.mark.long
@pytest.mark.e2e
def test_a_noisy_channel_is_not_called_fit_to_use(campaign: Campaign, tmp_path: Path) -> None:
    """The log's finding spoke of column e_degC; whoever looked for "channel e:" called all six fit
    to use."""
    f = campaign.files
    rng = np.random.default_rng(4)
    plunges = [tmp_path / "noisy_1.csv", tmp_path / "noisy_2.csv"]
    for path, own in zip(plunges, f.plunges["fast"]):
        plunge = pd.read_csv(own)
        plunge["e_degC"] += 2.0 * rng.standard_normal(len(plunge))
        plunge.to_csv(path, index=False)
    out, page = tmp_path / "fast.disk.json", tmp_path / "fast.html"
    given = [a for p in plunges for a in ("--immersion", p)]
    code = tcdyn(
        "rig",
        "calibrate",
        "--rig",
        f.rig,
        "--disk",
        "fast",
        "--oven",
        f.ovens["fast"],
        *given,
        "--structure",
        "P1",
        "--out",
        out,
        "--report",
        page,
        "--quiet",
        "--strict",
    )
    assert code == 1
    record = read_record(out)
    noisy = [found for found in record.findings if found.code == "noise.high"]
    assert {found.channels for found in noisy} == {("e",)}
    assert certificate_verdict(record).startswith(
        "Disk fast: 5 of 6 thermocouples fit to use, not e;"
    )
    assert {c for c, said in channel_verdicts(record).items() if said != FIT_TO_USE} == {"e"}
    assert "5 of 6 thermocouples fit to use, not e;" in page.read_text(encoding="utf-8")
