"""Excluded channels, by name or because they are dead: the analysis continues with valid
uncertainties."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.campaign.summary_table import table_row
from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, Severity
from tcdyn.partition.analyse import Partition, analyse
from tcdyn.partition.crosscheck import tensions
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import CombinedFit, joint_fits
from tcdyn.partition.prepare import prepare_test
from tcdyn.partition.steady import disk_line, steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.rig.disk import CHANNELS, DISKS, LEFT_OUT_TEXT, channels_left_out
from tcdyn.rig.rigfile import load_rig
from tcdyn.workflows import beta as stage
from tcdyn.workflows.beta import estimate_beta
from tcdyn.workflows.beta_tables import junctions_table
from tcdyn.workflows.campaign_log import CampaignSettings, analyse_log
from tcdyn.workflows.rig_options import AnalysisOptions
from tests.conftest import Campaign
from tests.partition.study_rigs import StudyRig, study_rig

SETUPS = load_rig().setups

MAX_Z = 2.5  # one rig, six exclusions that share all but one channel: about one independent draw
MAX_WIDENING = 3.0
MIN_WIDENING = 0.98  # of u: the linearisation point moves, too


@pytest.fixture(scope="module")
def study() -> StudyRig:
    """A rig drawn from the uncertainties of its rig file, and a test of it."""
    return study_rig(1000, "B3")


def joint_fit_of(test: EhlTest) -> CombinedFit:
    """Joint fit of both disks, started from the speed law."""
    return joint_fits(test, steady_lines(test, fit_rows(test, 10.0))[1].starts)[1]


@pytest.fixture(scope="module")
def complete(study: StudyRig) -> CombinedFit:
    return joint_fit_of(study.test)


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("channel", CHANNELS)
def test_beta_of_the_joint_fit_is_correct_without_any_one_channel(
    channel: str, study: StudyRig, complete: CombinedFit
) -> None:
    beta = joint_fit_of(study.without(f"fast_{channel}")).estimates["beta"]
    u = complete.estimates["beta"].u
    assert abs(beta.value - study.true_values["beta"]) < MAX_Z * beta.u
    assert MIN_WIDENING * u < beta.u < MAX_WIDENING * u


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("slow_a", marks=pytest.mark.study),
        pytest.param("slow_d", marks=[pytest.mark.study, pytest.mark.long]),
        pytest.param("slow_b", marks=[pytest.mark.study, pytest.mark.long]),
    ],
)
def excluded_analysis(request: pytest.FixtureRequest, study: StudyRig) -> tuple[str, Partition]:
    """Analysis without one channel of the outer row, or of the inner row with either surrogate."""
    return request.param[-1], analyse(study.without(request.param))


@pytest.mark.long
@pytest.mark.study
def test_every_estimator_is_correct_without_one_channel(
    excluded_analysis: tuple[str, Partition], study: StudyRig
) -> None:
    """Within three standard uncertainties, for beta of each estimator and for the common lag."""
    _, p = excluded_analysis
    for estimator, beta in p.beta_by_estimator.items():
        assert abs(beta.value - study.true_values["beta"]) < 3 * beta.u, estimator
    for disk, fit in p.joint.items():
        lag = fit.estimates["lag_s"]
        assert abs(lag.value - study.truth.disk(disk).common_lag_s) < 3 * lag.u


@pytest.mark.long
def test_sensor_check_skips_the_excluded_channel_and_has_no_suspects(
    excluded_analysis: tuple[str, Partition],
) -> None:
    channel, p = excluded_analysis
    assert p.sensors is not None
    assert p.sensors.suspects == ()
    affected = (p.sensors.table["disk"] == "slow") & (
        p.sensors.table[["one", "other"]] == channel
    ).any(axis=1)
    assert affected.sum() == 5
    assert ((p.sensors.table["steady"] == LEFT_OUT_TEXT) == affected).all()
    assert set(p.sensors.depths["slow"].deeper_m) == set(CHANNELS) - {channel}
    deeper = junctions_table(p.sensors.depths).set_index(["disk", "junction"])[
        "deeper than stated [mm]"
    ]
    assert [key for key, text in deeper.items() if text == LEFT_OUT_TEXT] == [("slow", channel)]


@pytest.mark.long
def test_excluded_channel_has_no_compensated_trace_and_a_finding(
    excluded_analysis: tuple[str, Partition],
) -> None:
    channel, p = excluded_analysis
    i = CHANNELS.index(channel)
    empty = np.isnan(p.compensated["slow"].temperature).all(axis=0)
    assert [*np.flatnonzero(empty)] == [i]
    (finding,) = (f for f in p.analysis_findings if f.code == "channel.left_out")
    assert finding.subject == f"slow_{channel}"
    assert finding.severity is Severity.INFO  # the caller requested it
    surrogates = {"a": (), "d": ("f",), "b": ("d", "f")}[channel]
    assert finding.numbers["stand_ins"] == surrogates
    tension_names = [
        (t.nominal.subject, str(t.nominal.numbers.get("channel", t.nominal.numbers.get("name"))))
        for t in tensions(p.test, p.joint, p.combined, p.sensors)
    ]
    assert ("slow", "depth e") in tension_names or ("slow", "e") in tension_names
    assert not [
        name for disk, name in tension_names if disk == "slow" and name.split()[-1] == channel
    ]


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("channel", ["c", "f"])
def test_readings_of_an_excluded_channel_have_no_influence(channel: str, study: StudyRig) -> None:
    """Noise of 100 K in its column, or no such column, gives bit-identical prepared traces."""
    name = f"slow_{channel}"
    frame = study.log.frame
    noise = np.random.default_rng(0).normal(0, 100, len(frame))
    tests = []
    for frame_variant in (
        frame.assign(**{f"{name}_degC": noise}),
        frame.drop(columns=f"{name}_degC"),
    ):
        log = type(study.log)(
            frame_variant, "ehl", study.log.path, study.log.sha256, study.log.dt_s
        )
        tests.append(prepare_test(log, study.rig, study.records, left_out={name: ""}).disks["slow"])
    np.testing.assert_array_equal(tests[0].readings_degC, tests[1].readings_degC)
    np.testing.assert_array_equal(tests[0].static_u_K, tests[1].static_u_K)


@pytest.mark.long
@pytest.mark.study
def test_error_of_a_surrogate_channel_counts_in_both_locations(study: StudyRig) -> None:
    """f reads 0.5 K high and d is excluded: the line moves by the linear shift of the budget within
    2 %."""
    offset_K = 0.5
    test = study.without("fast_d")
    rows = fit_rows(test, 10.0)
    raised = study.log.frame.assign(fast_f_degC=study.log.frame["fast_f_degC"] + offset_K)
    log = type(study.log)(raised, "ehl", study.log.path, study.log.sha256, study.log.dt_s)
    raised_test = prepare_test(log, study.rig, study.records, left_out={"fast_d": ""})
    before, after = (disk_line(t, t.disks["fast"], rows) for t in (test, raised_test))
    h = study.true_values["h_fast"]
    k = [parameter.name for parameter in before.sensitivity.parameters].index("static f")
    u_K = test.disks["fast"].static_u_K[CHANNELS.index("f")]
    expected = offset_K / u_K * before.sensitivity.per_sd[k] @ np.array([1.0, h])
    assert after.line.at(h) - before.line.at(h) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["fast_g"], "no channel 'fast_g'; expected fast_a to fast_f or slow_a to slow_f"),
        (["c"], "no channel 'c'"),
        (
            ["fast_a", "fast_c", "fast_d"],
            "without fast_a, fast_c, fast_d too little is left of the fast disk",
        ),
        (["slow_b", "slow_f"], "two of d, b, f kept"),
        (["slow_d", "slow_f"], "two of d, b, f kept"),
    ],
)
def test_exclusions_that_leave_too_few_channels_raise(
    names: list[str], message: str, campaign: Campaign
) -> None:
    with pytest.raises(InputError, match=message):
        estimate_beta(campaign.files.ehl["B3"], campaign.rig, campaign.records, without=names)
    assert "\n" not in message


def test_two_channels_of_a_disk_may_be_excluded() -> None:
    assert channels_left_out(["fast_a", "fast_d", "slow_b"], SETUPS) == {
        "fast": ("a", "d"),
        "slow": ("b",),
    }


def gap(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Remove the readings within four seconds of unloading."""
    t = frame["time_s"]
    contact = frame["contact"]
    unload_s = float(t[contact > 0.5].iloc[-1])
    return frame.assign(**{name: frame[name].where((t - unload_s).abs() > 4.0)})


DAMAGE: dict[str, Callable[[pd.DataFrame, str], pd.DataFrame]] = {
    "constant": lambda frame, name: frame.assign(**{name: 21.5}),
    "empty": lambda frame, name: frame.assign(**{name: np.nan}),
    "missing": lambda frame, name: frame.drop(columns=name),
    "open": lambda frame, name: frame.assign(**{name: 9999.0}),
    "gap at unloading": gap,
    "does not follow": lambda frame, name: frame.assign(
        **{name: 25.0 + 0.05 * (frame[name] - 25.0)}
    ),
}


@pytest.fixture
def write_damaged(campaign: Campaign, tmp_path: Path) -> Callable[[str, str], Path]:
    """Return a function that writes test B3 with one column damaged."""

    def write(kind: str, name: str) -> Path:
        path = campaign.files.ehl["B3"]
        head = [
            line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")
        ]
        frame = DAMAGE[kind](pd.read_csv(path), name)
        out = tmp_path / "EHL_B3.csv"
        out.write_text("\n".join([*head, frame.to_csv(index=False)]), encoding="utf-8")
        return out

    return write


def excluded_findings(findings: Any) -> list[Finding]:
    return [f for f in findings if f.code == "channel.left_out"]


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("kind", DAMAGE)
def test_unusable_channel_is_excluded_with_a_warning(
    kind: str,
    write_damaged: Callable[[str, str], Path],
    campaign: Campaign,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only the prepared test is checked; the analysis itself is replaced, because other tests run
    it."""
    monkeypatch.setattr(stage, "analyse_corrected", lambda test, _, **__: test)
    name = "slow_c" if kind != "constant" else "slow_f"
    prepared: Any = estimate_beta(
        write_damaged(kind, f"{name}_degC"), campaign.rig, campaign.records
    ).partition
    (finding,) = excluded_findings(prepared.findings)
    assert finding.severity is Severity.WARNING
    assert finding.subject == name
    assert f"{name}_degC" in finding.sentence
    assert "intervals are wider" in finding.sentence
    assert [prepared.disks[d].excluded for d in DISKS] == [(), (name[-1],)]


@pytest.mark.long
@pytest.mark.study
def test_channel_reported_dead_by_the_sensor_check_is_excluded(
    study: StudyRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The channel rises by a sixth of the true rise, which the log reader accepts."""
    frame = study.log.frame.assign(fast_d_degC=25 + (study.log.frame["fast_d_degC"] - 25) / 6)
    log = type(study.log)(frame, "ehl", study.log.path, study.log.sha256, study.log.dt_s)
    monkeypatch.setattr(stage, "read_stage", lambda log, _: (log, 1))
    monkeypatch.setattr(stage, "iter_log", lambda *_, **__: log)
    beta_run = estimate_beta("EHL_B3.csv", study.rig, study.records)
    (finding,) = excluded_findings(beta_run.partition.analysis_findings)
    assert finding.subject == "fast_d"
    assert "channel d is dead" in finding.sentence
    beta = beta_run.partition.combined.estimates["beta"]
    assert abs(beta.value - study.true_values["beta"]) < MAX_Z * beta.u


def test_misnamed_column_raises_with_a_suggestion(
    write_damaged: Callable[[str, str], Path], campaign: Campaign
) -> None:
    path = write_damaged("constant", "fast_c_degC")
    path.write_text(
        path.read_text(encoding="utf-8").replace("fast_c_degC", "Fast C"), encoding="utf-8"
    )
    with pytest.raises(InputError, match="did you mean 'Fast C'"):
        estimate_beta(path, campaign.rig, campaign.records)


def test_dead_channel_beyond_the_limit_raises_with_its_name(
    write_damaged: Callable[[str, str], Path], campaign: Campaign
) -> None:
    with pytest.raises(InputError, match=r"slow_f_degC.*a dead channel"):
        estimate_beta(
            write_damaged("constant", "slow_f_degC"),
            campaign.rig,
            campaign.records,
            without=["slow_d"],
        )


def run_command(*arguments: object) -> int:
    return run(lambda: app([str(argument) for argument in arguments]))


def record_options(campaign: Campaign) -> list[object]:
    return [
        "--rig",
        campaign.files.rig,
        *(w for p in campaign.record_paths.values() for w in ("--record", p)),
    ]


@pytest.mark.long
@pytest.mark.study
def test_gap_at_unloading_gives_a_warning_and_a_finding_in_the_file(
    write_damaged: Callable[[str, str], Path],
    campaign: Campaign,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "beta.json"
    page = tmp_path / "beta.html"
    log = write_damaged("gap at unloading", "fast_a_degC")
    assert (
        run_command("rig", "beta", log, *record_options(campaign), "--out", out, "--report", page)
        == 0
    )
    (finding,) = (
        f
        for f in json.loads(out.read_text(encoding="utf-8"))["findings"]
        if f["code"] == "channel.left_out"
    )
    assert finding["subject"] == "fast_a"
    assert "fast_a is left out" in capsys.readouterr().err
    assert LEFT_OUT_TEXT in page.read_text(encoding="utf-8")
    data = json.loads(out.read_text(encoding="utf-8"))
    beta = data["joint"]["both"]["beta"]
    assert abs(beta["value"] - campaign.truth["tests"]["B3"]["beta"]) < 3 * beta["u"]


@pytest.mark.long
@pytest.mark.e2e
def test_without_option_excludes_channels_on_the_command_line(
    campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    log = campaign.files.ehl["B3"]
    assert run_command("rig", "beta", log, *record_options(campaign), "--without", "fast_x") == 2
    assert "there is no channel 'fast_x'" in capsys.readouterr().err
    assert (
        run_command(
            "rig",
            "campaign",
            log,
            *record_options(campaign),
            "--out",
            "nowhere",
            "--without",
            "fast_x",
        )
        == 2
    )
    assert (
        run_command(
            "rig",
            "beta",
            log,
            *record_options(campaign),
            "--without",
            "fast_c",
            "--without",
            "slow_e",
            "--json",
        )
        == 0
    )
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert [f["subject"] for f in findings if f["code"] == "channel.left_out"] == [
        "fast_c",
        "slow_e",
    ]


@pytest.mark.long
@pytest.mark.study
def test_campaign_row_of_an_excluded_channel_is_nan(campaign: Campaign) -> None:
    settings = CampaignSettings(
        campaign.rig, campaign.records, AnalysisOptions(without=("fast_a",))
    )
    [data] = analyse_log(campaign.files.ehl["B3"], settings)
    assert isinstance(data, dict), data
    row = table_row("EHL_B3", data)
    assert np.isnan(row["fast_a_degC"])
    others = [data["campaign"]["steady_degC"]["fast"][c] for c in CHANNELS if c != "a"]
    assert row["fast_bulk_degC"] == pytest.approx(np.mean(others), rel=1e-12)
    assert settings.fingerprint() != CampaignSettings(campaign.rig, campaign.records).fingerprint()
    (finding,) = (f for f in data["findings"] if f["code"] == "channel.left_out")
    assert finding["numbers"]["kept"] == [c for c in SETUPS["fast"].outer if c != "a"]
