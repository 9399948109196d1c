"""A campaign: one table from many logs, whoever works on it; resumable; one bad log does not stop
the others."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign.summary_table import COLUMNS, table_columns, trend_table
from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.io.checksum import with_checksum
from tcdyn.partition.operating_conditions import read_bearing
from tcdyn.partition.prepare import prepare_test
from tcdyn.report.beta import write_beta_report
from tcdyn.report.campaign import write_campaign_report
from tcdyn.rig.log import read_log
from tcdyn.workflows import campaign_log as stage
from tcdyn.workflows.beta import BetaRun
from tcdyn.workflows.campaign import CampaignRun, run_campaign
from tcdyn.workflows.campaign_log import CampaignSettings
from tests.conftest import Campaign

STAMP = '<span class="stamp">simulated'  # mark beside the title of a page


def tcdyn(*words: object) -> int:
    return run(lambda: app([str(w) for w in words]))


def records(campaign: Campaign) -> list[object]:
    return [
        "--rig",
        campaign.files.rig,
        *(w for p in campaign.record_paths.values() for w in ("--record", p)),
    ]


def run_again(logs: list[Path], campaign: Campaign, out: Path, **options: Any) -> CampaignRun:
    """Analyse logs with the rig and the records of the campaign."""
    return run_campaign(logs, campaign.rig, campaign.records, out, **options)


@pytest.fixture(scope="module")
def bad_log(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bad") / "EHL_bad.csv"
    lines = campaign.files.ehl["B3"].read_text(encoding="utf-8").splitlines()[:12000]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def done(
    campaign: Campaign, bad_log: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, int]:
    out = tmp_path_factory.mktemp("out")
    code = tcdyn(
        "rig",
        "campaign",
        bad_log,
        campaign.files.ehl["B3"],
        *records(campaign),
        "--out",
        out,
        "--workers",
        1,
        "-q",
    )
    return out, code


@pytest.mark.long
@pytest.mark.e2e
def test_a_failing_log_has_its_sentence_in_the_table_and_the_others_go_on(
    done: tuple[Path, int],
) -> None:
    out, code = done
    assert code == 1
    table = pd.read_csv(out / "campaign.csv", keep_default_na=False)
    assert list(table.columns) == table_columns()
    assert list(table["test"]) == ["bad", "B3"]
    assert "no unloading" in table["error"][0] or "unload" in table["error"][0]
    assert table["beta"][0] == ""
    assert table["error"][1] == ""
    assert not (out / "EHL_bad.beta.json").exists()


@pytest.mark.long
@pytest.mark.e2e
def test_the_row_says_what_beta_json_says(done: tuple[Path, int], campaign: Campaign) -> None:
    out, _ = done
    data = json.loads((out / "EHL_B3.beta.json").read_text(encoding="utf-8"))
    row = pd.read_csv(out / "campaign.csv").iloc[1]
    assert row["beta"] == pytest.approx(data["steady"]["beta"]["value"], rel=1e-7)
    assert row["u_lag_joint_slow_s"] == pytest.approx(data["joint"]["slow"]["lag_s"]["u"], rel=1e-7)
    assert row["friction_coefficient"] == pytest.approx(row["friction_N"] / row["load_N"], rel=1e-7)
    steady = data["campaign"]["steady_degC"]["fast"]
    assert row["fast_bulk_degC"] == pytest.approx(np.mean(list(steady.values())), rel=1e-7)
    assert row["beta"] == pytest.approx(
        campaign.truth["tests"]["B3"]["beta"], abs=0.03
    )  # never beyond, issue 6


@pytest.mark.long
@pytest.mark.e2e
def test_the_page_of_one_good_test_has_its_answers_and_no_picture_of_a_single_point(
    done: tuple[Path, int],
) -> None:
    html = (done[0] / "campaign.html").read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == 0
    assert "EHL_bad.csv" in html
    assert "β of each test, all estimates" in html


@pytest.mark.long
@pytest.mark.e2e
def test_a_campaign_of_simulated_logs_says_so_on_its_page_and_on_the_terminal(
    done: tuple[Path, int], campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    out, _ = done
    assert STAMP in (out / "campaign.html").read_text(encoding="utf-8")
    log = campaign.files.ehl["B3"]
    tcdyn("rig", "campaign", log, *records(campaign), "--out", out, "--workers", 1)
    said = capsys.readouterr()
    assert "simulated" in said.out
    assert "simulated" in said.err
    again = run_again([log], campaign, out)
    assert again.simulated == ("EHL_B3",)
    assert [f.code for f in again.findings].count("campaign.simulated") == 1
    (outcome,) = again.outcomes
    assert outcome.data is not None
    findings = [f for f in outcome.data["findings"] if f["code"] != "log.simulated"]
    measured = replace(
        again, outcomes=(replace(outcome, data={**outcome.data, "findings": findings}),)
    )
    assert measured.simulated == ()
    page = write_campaign_report(out / "measured.html", measured)
    assert STAMP not in page.read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.e2e
def test_a_single_simulated_test_says_so_on_its_page_and_on_the_terminal(
    beta_run: BetaRun, tmp_path: Path
) -> None:
    partition = beta_run.partition
    assert "log.simulated" in [finding.code for finding in partition.analysis_findings]
    page = write_beta_report(tmp_path / "beta.html", {"B3": partition})
    assert "EHL_B3.csv is simulated" in page.read_text(encoding="utf-8").replace("\u00a0", " ")


@pytest.mark.long
@pytest.mark.e2e
def test_finished_logs_are_not_analysed_again(
    done: tuple[Path, int], campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise InputError("called")

    monkeypatch.setattr(stage, "estimate_beta", refuse)
    log, before = campaign.files.ehl["B3"], (done[0] / "EHL_B3.beta.json").read_bytes()
    again = run_again([log], campaign, done[0])
    assert again.n_from_earlier_run == 1
    assert not again.failed
    assert (done[0] / "EHL_B3.beta.json").read_bytes() == before
    for changed in ({"window_s": 4.0}, {"seed": 1}):
        assert run_again([log], campaign, done[0], **changed).failed  # it was asked for again


@pytest.mark.long
@pytest.mark.e2e
def test_an_altered_answer_is_not_kept(
    done: tuple[Path, int], campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        stage, "estimate_beta", lambda *_, **__: (_ for _ in ()).throw(InputError("called"))
    )
    text = (done[0] / "EHL_B3.beta.json").read_text(encoding="utf-8")
    (tmp_path / "EHL_B3.beta.json").write_text(
        text.replace('"load_N": 18', '"load_N": 19', 1), encoding="utf-8"
    )
    again = run_again([campaign.files.ehl["B3"]], campaign, tmp_path)
    assert [o.error for o in again.failed] == ["called"]
    assert [f.code for f in again.findings] == ["campaign.altered"]


@pytest.mark.long
@pytest.mark.e2e
def test_an_answer_stands_in_for_its_log_if_it_is_whole_and_of_this_rig(
    done: tuple[Path, int], campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "EHL_B3.beta.json"
    shutil.copy(done[0] / kept.name, kept)
    other = tmp_path / "EHL_B4.beta.json"
    shutil.copy(kept, other)
    out = tmp_path / "o"
    code = tcdyn("rig", "campaign", kept, other, *records(campaign), "--out", out, "-q")
    capsys.readouterr()
    assert code == (0 if json.loads(kept.read_text(encoding="utf-8"))["status"] == "sound" else 1)
    whole = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    assert whole["order"] == ["EHL_B3", "EHL_B4"]
    assert (out / "table.tex").exists()
    assert "all tests as one measurement" in (out / "campaign.html").read_text(encoding="utf-8")
    data = json.loads(kept.read_text(encoding="utf-8"))
    data["kept"]["right"][0] += 1e-7
    other.write_text(json.dumps(data), encoding="utf-8")
    assert tcdyn("rig", "campaign", kept, other, *records(campaign), "--out", out, "-q") == 2
    assert "EHL_B4.beta.json: its content is not what was written" in capsys.readouterr().err
    other.write_text(kept.read_text(encoding="utf-8")[:5000], encoding="utf-8")
    assert tcdyn("rig", "campaign", other, *records(campaign), "--out", out, "-q") == 2
    assert "EHL_B4.beta.json: not readable as JSON" in capsys.readouterr().err
    rig = tmp_path / "rig.toml"
    rig.write_text("[disk]\nconductivity_W_mK = 43.0\n", encoding="utf-8")
    given = [*records(campaign)[2:], "--rig", rig]
    assert tcdyn("rig", "campaign", kept, *given, "--out", out, "-q") == 2
    assert "EHL_B3.beta.json: was analysed with another rig.toml" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.e2e
def test_map_has_the_error_of_a_channel_as_it_is_in_the_log(
    campaign: Campaign, tmp_path: Path
) -> None:
    """The estimated harmonic around the disk takes over such errors, and the map is without it."""
    log = pd.read_csv(campaign.files.ehl["B3"])
    path = tmp_path / "EHL_B3.csv"
    log.assign(slow_a_degC=log["slow_a_degC"] + 1.5, slow_c_degC=log["slow_c_degC"] - 1.0).to_csv(
        path, index=False
    )
    (data,) = stage.analyse_log(path, CampaignSettings(campaign.rig, campaign.records))
    assert isinstance(data, dict)
    readings = data["campaign"]["map_degC"]
    true = pd.read_parquet(campaign.files.folder / "truth" / "EHL_B3_traces.parquet")
    unload_s = campaign.truth["tests"]["B3"]["unload_s"]
    last = (true["time_s"] > unload_s - 10.0) & (true["time_s"] < unload_s - 0.5)
    for disk, junctions in readings.items():
        for c, reading in junctions.items():
            error_K = {"slow_a": 1.5, "slow_c": -1.0}.get(f"{disk}_{c}", 0.0)
            # static lines and the drift over the steady segment
            truth_degC = true.loc[last, f"{disk}_{c}_degC"].mean()
            assert reading - truth_degC == pytest.approx(error_K, abs=0.5), f"{disk}_{c}"


@pytest.mark.long
@pytest.mark.e2e
def test_interchanged_channels_are_compared_by_the_maps_of_both_tests(
    done: tuple[Path, int], campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The channels of slow_a and slow_c have errors of 1.2 and -0.6 K, exchanged in test B4."""
    data = json.loads((done[0] / "EHL_B3.beta.json").read_text(encoding="utf-8"))
    files = []
    rng = np.random.default_rng(4)
    for name, errors in (("B3", {"a": 1.2, "c": -0.6}), ("B4", {"a": -0.6, "c": 1.2})):
        changed = json.loads(json.dumps(data))
        for disk, junctions in changed["campaign"]["map_degC"].items():
            for c in junctions:
                junctions[c] += 0.05 * rng.normal() + (errors.get(c, 0.0) if disk == "slow" else 0)
        files.append(tmp_path / f"EHL_{name}.beta.json")
        files[-1].write_text(json.dumps(with_checksum(changed)), encoding="utf-8")
    words = [
        *records(campaign),
        "--out",
        tmp_path / "o",
        "--interchanged",
        "slow_a",
        "--interchanged",
        "slow_c",
    ]
    assert tcdyn("rig", "campaign", *files, *words) in (0, 1)
    assert "The channels differ" in capsys.readouterr().out
    stored = json.loads((tmp_path / "o" / "campaign.json").read_text(encoding="utf-8"))
    channels = stored["interchange"]["channels_K"]
    assert channels["low95"] < 1.8 < channels["high95"]
    assert channels["u"] < 0.1
    page = (tmp_path / "o" / "campaign.html").read_text(encoding="utf-8")
    assert "Channels of slow_a and slow_c interchanged" in page
    capsys.readouterr()
    assert tcdyn("rig", "campaign", files[0], *words) == 2
    assert "1 of 1 tests can be compared" in capsys.readouterr().err
    assert tcdyn("rig", "campaign", *files, *words[:-1], "slow_a") == 2
    assert "expected two junctions" in capsys.readouterr().err


@pytest.mark.long
def test_another_log_of_the_same_name_is_analysed_again(
    done: tuple[Path, int], campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        stage, "estimate_beta", lambda *_, **__: (_ for _ in ()).throw(InputError("called"))
    )
    other = tmp_path / "EHL_B3.csv"
    other.write_bytes(campaign.files.ehl["B3"].read_bytes() + b"\n")
    assert [o.error for o in run_again([other], campaign, done[0]).failed] == ["called"]


@pytest.mark.long
def test_all_logs_bad_is_exit_2_and_still_a_table(
    campaign: Campaign, bad_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = tmp_path / "EHL_none.csv"
    assert (
        tcdyn(
            "rig",
            "campaign",
            bad_log,
            missing,
            *records(campaign),
            "--out",
            tmp_path / "o",
            "--workers",
            1,
            "-q",
        )
        == 2
    )
    table = pd.read_csv(tmp_path / "o" / "campaign.csv")
    assert table["error"].notna().all()
    assert (tmp_path / "o" / "campaign.html").exists()
    for name in ("campaign.csv", "campaign.html"):
        (tmp_path / "o" / name).write_text("of an earlier run", encoding="utf-8")
    capsys.readouterr()
    assert (
        tcdyn(
            "rig",
            "campaign",
            bad_log,
            missing,
            *records(campaign),
            "--out",
            tmp_path / "o",
            "--workers",
            1,
        )
        == 2
    )
    assert "campaign.csv" not in capsys.readouterr().out  # which names what was written
    kept = {
        (tmp_path / "o" / name).read_text(encoding="utf-8")
        for name in ("campaign.csv", "campaign.html")
    }
    assert kept == {"of an earlier run"}


@pytest.mark.long
@pytest.mark.e2e
def test_bad_requests_get_one_sentence(
    campaign: Campaign,
    bad_log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tcdyn.core.parallel.CONNECT_S", 0.5)
    out = ["--out", tmp_path / "o", "-q"]
    assert tcdyn("rig", "campaign", bad_log, bad_log, *records(campaign), *out) == 2
    assert "two logs are called EHL_bad" in capsys.readouterr().err
    assert (
        tcdyn("rig", "campaign", bad_log, *records(campaign), *out, "--dask", "tcp://127.0.0.1:9")
        == 2
    )
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
    assert tcdyn("rig", "campaign", bad_log, "--record", campaign.record_paths["fast"], *out) == 2
    assert not (tmp_path / "o" / "EHL_bad.beta.json").exists()


def bearing_csv(path: Path) -> Path:
    rows = [
        (load, 2.0 + 1e-3 * load + 1e-3 * rpm, rpm)
        for rpm in (774, 1005, 1546)
        for load in (800, 1500, 2320)
    ]
    pd.DataFrame(rows, columns=["load_N", "friction_N", "speed_slow_rpm"]).to_csv(path, index=False)
    return path


def test_half_of_the_bearings_friction_is_added(campaign: Campaign, tmp_path: Path) -> None:
    """Figure 2.25: the pure-rolling test measured the bearings of both shafts (section 2.10)."""
    bearing = read_bearing(bearing_csv(tmp_path / "bearing.csv"))
    log = read_log(campaign.files.ehl["B3"], "ehl", campaign.rig)
    bare = prepare_test(log, campaign.rig, campaign.records)
    more = prepare_test(log, campaign.rig, campaign.records, bearing.friction_added)
    added = 0.5 * (2.0 + 1e-3 * bare.load_N + 1e-3 * 1005)
    # the log's speed differs from the nominal 1005 rpm by less than 1 %: 0.005 N
    assert more.friction_N - bare.friction_N == pytest.approx(added, abs=0.006)
    loaded = (bare.time_s > bare.events.load_on_s + 5) & (bare.time_s < bare.events.unload_s - 5)
    gain = (more.power_W - bare.power_W)[loaded].mean() / bare.sliding_speed_m_s
    assert gain == pytest.approx(added, rel=0.01)  # the load wanders by less
    assert (more.power_W[bare.time_s > bare.events.unload_s + 1] == 0).all()


def test_bearing_friction_outside_its_test_is_flagged(tmp_path: Path) -> None:
    bearing = read_bearing(bearing_csv(tmp_path / "bearing.csv"))
    assert not bearing.friction_added(1500.0, 1005.0).findings
    assert [f.code for f in bearing.friction_added(5000.0, 1005.0).findings] == [
        "bearing.extrapolated"
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("load_N,friction_N\n800,2\n", "speed_slow_rpm is missing"),
        ("load_N,friction_N,speed_slow_rpm\n800,x,774\n", "friction_N, row 2: no number"),
        ("load_N,friction_N,speed_slow_rpm\n800,2,774\n", "at least 3 loads"),
    ],
)
def test_bad_bearing_files_get_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bearing.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_bearing(path)


def synthetic_table() -> pd.DataFrame:
    """Two speeds, four loads, temperatures exactly linear in the load."""
    rows = []
    for speed in (10.05, 20.1):
        for load in (850.0, 1460.0, 1850.0, 2320.0):
            row: dict[str, Any] = dict.fromkeys(table_columns(), 0.1)
            row |= {"test": "X", "error": "", "load_N": load, "sliding_speed_m_s": speed}
            row |= {"fast_bulk_degC": 50 + 0.03 * load, "friction_N": 0.01 * load}
            row |= {"delta_T_us_K_m_s": load / 5, "beta": 0.8 - 2e-4 * load / 5}
            rows.append(row)
    return pd.DataFrame(rows, columns=table_columns())


def test_trend_lines_are_those_of_the_data() -> None:
    lines = trend_table(synthetic_table()).set_index(["quantity", "tests"])
    for speed in ("10.1 m/s", "20.1 m/s"):
        assert lines.loc[("fast_bulk_degC", speed), "slope"] == pytest.approx(0.03)
        assert lines.loc[("fast_bulk_degC", speed), "intercept"] == pytest.approx(50)
    two = synthetic_table().query("load_N < 1500")
    assert trend_table(two).empty  # two loads a speed: no line, whatever the scatter
    assert len(COLUMNS) + 6 + sum(e for _, e in COLUMNS.values()) == len(table_columns())


@pytest.mark.long
@pytest.mark.e2e
def test_two_loadings_in_one_log_are_two_tests(campaign: Campaign, tmp_path: Path) -> None:
    one = pd.read_csv(campaign.files.ehl["B3"])
    later = one.assign(time_s=one["time_s"] + one["time_s"].iloc[-1] + 1 / 75)
    log = tmp_path / "EHL_B3.csv"
    pd.concat([one, later]).to_csv(log, index=False, float_format="%.6f")
    out = tmp_path / "o"
    run_ = run_again([log], campaign, out)
    assert [o.name for o in run_.outcomes] == ["EHL_B3.1", "EHL_B3.2"]
    assert not run_.failed
    assert run_.joined is not None
    a, b = (e["beta"] for e in run_.joined.posterior.estimates)
    assert abs(a.value - b.value) < 0.2 * a.u
    assert run_again([log], campaign, out).n_from_earlier_run == 2
    tcdyn("rig", "beta", log, *records(campaign), "--out", tmp_path / "beta.json", "-q")
    assert (tmp_path / "beta.1.json").exists()
    assert (tmp_path / "beta.2.json").exists()
    assert tcdyn("rig", "beta", log, *records(campaign), "--stage", 3, "-q") == 2


@pytest.mark.long
@pytest.mark.e2e
def test_the_table_is_the_same_whoever_works_on_it(campaign: Campaign, tmp_path: Path) -> None:
    distributed = pytest.importorskip("dask.distributed")
    logs = []
    for name in ("EHL_one.csv", "EHL_two.csv"):
        shutil.copy(campaign.files.ehl["B3"], tmp_path / name)
        logs.append(tmp_path / name)
    tables = []
    for folder, workers in (("w1", 1), ("w2", 2)):
        run_again(logs, campaign, tmp_path / folder, workers=workers)
        tables.append((tmp_path / folder / "campaign.csv").read_bytes())
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0"
    ) as local:
        run_again(logs, campaign, tmp_path / "dask", dask=local.scheduler_address)
    tables.append((tmp_path / "dask" / "campaign.csv").read_bytes())
    assert tables[0] == tables[1] == tables[2]
