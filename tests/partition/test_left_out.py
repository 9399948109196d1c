"""A channel left out, by name or because it is dead: the analysis goes on, and its intervals stay honest."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, Severity
from tcdyn.partition.analyse import Partition, analyse
from tcdyn.partition.crosscheck import tensions
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import BothFit, joint_fits
from tcdyn.partition.steady import disk_line, steady_lines
from tcdyn.partition.window import fit_rows
from tcdyn.rig.disk import CHANNELS, DISKS, LEFT_OUT_TEXT, channels_left_out
from tcdyn.rig.rigfile import load_rig
from tcdyn.workflows import beta as stage
from tcdyn.workflows.beta import estimate_beta, prepare_test
from tcdyn.workflows.beta_tables import junctions_table
from tcdyn.workflows.campaign_log import CampaignSettings, analyse_log
from tcdyn.workflows.campaign_table import table_row
from tests.conftest import Campaign
from tests.partition.study_rigs import StudyRig, study_rig

SETUPS = load_rig().setups

WORST_Z = 2.5  # one rig, six ways to leave one out that share all but one channel: about one draw
MOST_WIDER = 3.0
AS_GOOD = 0.98  # of u: the point about which a fit is linear moves, too


@pytest.fixture(scope="module")
def made() -> StudyRig:
    """A drawn rig, off by what its rig file states, and a test of it."""
    return study_rig(1000, "B3")


def both_of(test: EhlTest) -> BothFit:
    """The joint fit of both disks, from the speed law's start."""
    return joint_fits(test, steady_lines(test, fit_rows(test, 10.0))[1].starts)[1]


@pytest.fixture(scope="module")
def complete(made: StudyRig) -> BothFit:
    return both_of(made.test)


@pytest.mark.study
@pytest.mark.parametrize("channel", CHANNELS)
def test_beta_of_both_disks_holds_without_any_one_channel(
    channel: str, made: StudyRig, complete: BothFit
) -> None:
    found = both_of(made.without(f"fast_{channel}")).estimates["beta"]
    u = complete.estimates["beta"].u
    assert abs(found.value - made.told["beta"]) < WORST_Z * found.u
    assert AS_GOOD * u < found.u < MOST_WIDER * u


@pytest.fixture(
    scope="module", params=["slow_a", "slow_d", pytest.param("slow_b", marks=pytest.mark.study)]
)
def whole(request: pytest.FixtureRequest, made: StudyRig) -> tuple[str, Partition]:
    """All ways to beta without a channel of the outer row, and without one of the inner row by either stand-in."""
    return request.param[-1], analyse(made.without(request.param))


@pytest.mark.study
def test_every_way_to_beta_holds_without_a_channel(
    whole: tuple[str, Partition], made: StudyRig
) -> None:
    """Within three standard uncertainties: five ways of three runs; and the lag as well."""
    _, p = whole
    for way, e in p.beta_by_estimator.items():
        assert abs(e.value - made.told["beta"]) < 3 * e.u, way
    for disk, fit in p.joint.items():
        lag = fit.estimates["lag_s"]
        assert abs(lag.value - made.truth.disk(disk).common_lag_s) < 3 * lag.u


def test_the_sensor_map_goes_on_without_the_channel_and_accuses_nobody(
    whole: tuple[str, Partition],
) -> None:
    channel, p = whole
    assert p.sensors is not None
    assert p.sensors.suspects == ()
    touched = (p.sensors.table["disk"] == "slow") & (
        p.sensors.table[["one", "other"]] == channel
    ).any(axis=1)
    assert touched.sum() == 5
    assert ((p.sensors.table["steady"] == LEFT_OUT_TEXT) == touched).all()
    assert set(p.sensors.depths["slow"].deeper_m) == set(CHANNELS) - {channel}
    placed = junctions_table(p.sensors.depths).set_index(["disk", "junction"])[
        "deeper than stated [mm]"
    ]
    assert [place for place, said in placed.items() if said == LEFT_OUT_TEXT] == [("slow", channel)]


def test_what_is_left_out_has_no_compensated_trace_and_is_told(
    whole: tuple[str, Partition],
) -> None:
    channel, p = whole
    i = CHANNELS.index(channel)
    empty = np.isnan(p.compensated["slow"].temperature).all(axis=0)
    assert [*np.flatnonzero(empty)] == [i]
    (told,) = (f for f in p.analysis_findings if f.code == "channel.left_out")
    assert told.subject == f"slow_{channel}"
    assert told.severity is Severity.INFO  # it was asked for
    stands_in = {"a": (), "d": ("f",), "b": ("d", "f")}[channel]
    assert told.numbers["stand_ins"] == stands_in
    pulled = [
        (t.nominal.subject, str(t.nominal.numbers.get("channel", t.nominal.numbers.get("name"))))
        for t in tensions(p.test, p.joint, p.both, p.sensors)
    ]
    assert ("slow", "depth e") in pulled or ("slow", "e") in pulled
    assert not [name for disk, name in pulled if disk == "slow" and name.split()[-1] == channel]


@pytest.mark.parametrize("channel", ["c", "f"])
def test_nothing_that_a_channel_left_out_reads_is_looked_at(channel: str, made: StudyRig) -> None:
    """Its column full of noise of 100 K, or not there: the same prepared traces to the last bit."""
    name = f"slow_{channel}"
    frame = made.log.frame
    noise = np.random.default_rng(0).normal(0, 100, len(frame))
    tests = []
    for changed in (frame.assign(**{f"{name}_degC": noise}), frame.drop(columns=f"{name}_degC")):
        log = type(made.log)(changed, "ehl", made.log.path, made.log.sha256, made.log.dt_s)
        tests.append(prepare_test(log, made.rig, made.records, left_out={name: ""}).disks["slow"])
    np.testing.assert_array_equal(tests[0].readings_degC, tests[1].readings_degC)
    np.testing.assert_array_equal(tests[0].static_u_K, tests[1].static_u_K)


@pytest.mark.study
def test_an_error_of_a_stand_in_counts_in_both_its_places(made: StudyRig) -> None:
    """f half a kelvin too high, with d left out: the line moves as the budget's linear shift says, within 2 %."""
    high_K = 0.5
    test = made.without("fast_d")
    rows = fit_rows(test, 10.0)
    raised = made.log.frame.assign(fast_f_degC=made.log.frame["fast_f_degC"] + high_K)
    log = type(made.log)(raised, "ehl", made.log.path, made.log.sha256, made.log.dt_s)
    moved = prepare_test(log, made.rig, made.records, left_out={"fast_d": ""})
    before, after = (disk_line(t, t.disks["fast"], rows) for t in (test, moved))
    h = made.told["h_fast"]
    k = [what.name for what in before.sensitivity.parameters].index("static f")
    u_K = test.disks["fast"].static_u_K[CHANNELS.index("f")]
    said = high_K / u_K * before.sensitivity.per_sd[k] @ np.array([1.0, h])
    assert after.line.at(h) - before.line.at(h) == pytest.approx(said, rel=0.02)


@pytest.mark.parametrize(
    ("names", "said"),
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
def test_what_cannot_be_left_out_is_refused_in_one_sentence(
    names: list[str], said: str, campaign: Campaign
) -> None:
    with pytest.raises(InputError, match=said):
        estimate_beta(campaign.files.ehl["B3"], campaign.rig, campaign.records, without=names)
    assert "\n" not in said


def test_two_of_a_disk_may_be_left_out_where_the_rest_still_tells() -> None:
    assert channels_left_out(["fast_a", "fast_d", "slow_b"], SETUPS) == {
        "fast": ("a", "d"),
        "slow": ("b",),
    }


def gap(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Eight seconds about the parting without readings."""
    t, contact = frame["time_s"], frame["contact"]
    off = float(t[contact > 0.5].iloc[-1])
    return frame.assign(**{name: frame[name].where((t - off).abs() > 4.0)})


DAMAGE: dict[str, Callable[[pd.DataFrame, str], pd.DataFrame]] = {
    "constant": lambda frame, name: frame.assign(**{name: 21.5}),
    "empty": lambda frame, name: frame.assign(**{name: np.nan}),
    "missing": lambda frame, name: frame.drop(columns=name),
    "open": lambda frame, name: frame.assign(**{name: 9999.0}),
    "gap at the parting": gap,
    "does not follow": lambda frame, name: frame.assign(
        **{name: 25.0 + 0.05 * (frame[name] - 25.0)}
    ),
}


@pytest.fixture
def damaged(campaign: Campaign, tmp_path: Path) -> Callable[[str, str], Path]:
    """Writes test B3 with one column damaged."""

    def write(kind: str, name: str) -> Path:
        path = campaign.files.ehl["B3"]
        head = [
            line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")
        ]
        frame = DAMAGE[kind](pd.read_csv(path, comment="#"), name)
        out = tmp_path / "EHL_B3.csv"
        out.write_text("\n".join([*head, frame.to_csv(index=False)]), encoding="utf-8")
        return out

    return write


def lost(findings: Any) -> list[Finding]:
    return [f for f in findings if f.code == "channel.left_out"]


@pytest.mark.study
@pytest.mark.parametrize("kind", DAMAGE)
def test_a_lost_channel_is_left_out_with_a_finding(
    kind: str,
    damaged: Callable[[str, str], Path],
    campaign: Campaign,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Up to the analysis, which other tests run: what it is given."""
    monkeypatch.setattr(stage, "analyse", lambda test, **_: test)
    name = "slow_c" if kind != "constant" else "slow_f"
    given: Any = estimate_beta(
        damaged(kind, f"{name}_degC"), campaign.rig, campaign.records
    ).partition
    (found,) = lost(given.findings)
    assert found.severity is Severity.WARNING
    assert found.subject == name
    assert f"{name}_degC" in found.sentence
    assert "intervals are wider" in found.sentence
    assert [given.disks[d].excluded for d in DISKS] == [(), (name[-1],)]


@pytest.mark.study
def test_a_channel_that_the_sensor_map_finds_dead_is_left_out(
    made: StudyRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It rises by a sixth of what the others do: the reader lets it pass."""
    frame = made.log.frame.assign(fast_d_degC=25 + (made.log.frame["fast_d_degC"] - 25) / 6)
    log = type(made.log)(frame, "ehl", made.log.path, made.log.sha256, made.log.dt_s)
    monkeypatch.setattr(stage, "read_stage", lambda log, _: (log, 1))
    monkeypatch.setattr(stage, "iter_log", lambda *_, **__: log)
    found = estimate_beta("EHL_B3.csv", made.rig, made.records)
    (told,) = lost(found.partition.analysis_findings)
    assert told.subject == "fast_d"
    assert "channel d is dead" in told.sentence
    beta = found.partition.both.estimates["beta"]
    assert abs(beta.value - made.told["beta"]) < WORST_Z * beta.u


def test_a_column_of_another_name_is_asked_about_not_left_out(
    damaged: Callable[[str, str], Path], campaign: Campaign
) -> None:
    path = damaged("constant", "fast_c_degC")
    path.write_text(
        path.read_text(encoding="utf-8").replace("fast_c_degC", "Fast C"), encoding="utf-8"
    )
    with pytest.raises(InputError, match="did you mean 'Fast C'"):
        estimate_beta(path, campaign.rig, campaign.records)


def test_a_dead_channel_too_many_stops_the_analysis_by_its_own_name(
    damaged: Callable[[str, str], Path], campaign: Campaign
) -> None:
    with pytest.raises(InputError, match=r"slow_f_degC.*a dead channel"):
        estimate_beta(
            damaged("constant", "slow_f_degC"), campaign.rig, campaign.records, without=["slow_d"]
        )


def tcdyn(*words: object) -> int:
    return run(lambda: app([str(w) for w in words]))


def records(campaign: Campaign) -> list[object]:
    return [
        "--rig",
        campaign.files.rig,
        *(w for p in campaign.record_paths.values() for w in ("--record", p)),
    ]


@pytest.mark.study
def test_a_gap_at_the_parting_leaves_exit_code_1_and_a_finding_in_the_file(
    damaged: Callable[[str, str], Path],
    campaign: Campaign,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, page = tmp_path / "beta.json", tmp_path / "beta.html"
    log = damaged("gap at the parting", "fast_a_degC")
    assert tcdyn("beta", log, *records(campaign), "--out", out, "--report", page) == 1
    (found,) = (
        f
        for f in json.loads(out.read_text(encoding="utf-8"))["findings"]
        if f["code"] == "channel.left_out"
    )
    assert found["subject"] == "fast_a"
    assert "fast_a is left out" in capsys.readouterr().err
    assert LEFT_OUT_TEXT in page.read_text(encoding="utf-8")
    data = json.loads(out.read_text(encoding="utf-8"))
    beta = data["joint"]["both"]["beta"]
    assert abs(beta["value"] - campaign.truth["tests"]["B3"]["beta"]) < 3 * beta["u"]


@pytest.mark.e2e
def test_without_names_channels_on_the_command_line(
    campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    log = campaign.files.ehl["B3"]
    assert tcdyn("beta", log, *records(campaign), "--without", "fast_x") == 2
    assert "there is no channel 'fast_x'" in capsys.readouterr().err
    assert (
        tcdyn("campaign", log, *records(campaign), "--out", "nowhere", "--without", "fast_x") == 2
    )
    assert (
        tcdyn(
            "beta", log, *records(campaign), "--without", "fast_c", "--without", "slow_e", "--json"
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)["findings"]
    assert [f["subject"] for f in found if f["code"] == "channel.left_out"] == ["fast_c", "slow_e"]


@pytest.mark.study
def test_a_campaign_without_a_channel_has_no_number_for_it(campaign: Campaign) -> None:
    settings = CampaignSettings(campaign.rig, campaign.records, without=("fast_a",))
    [data] = analyse_log(campaign.files.ehl["B3"], settings)
    assert isinstance(data, dict), data
    row = table_row("EHL_B3", data)
    assert np.isnan(row["fast_a_degC"])
    others = [data["campaign"]["steady_degC"]["fast"][c] for c in CHANNELS if c != "a"]
    assert row["fast_bulk_degC"] == pytest.approx(np.mean(others), rel=1e-12)
    assert settings.fingerprint() != CampaignSettings(campaign.rig, campaign.records).fingerprint()
    (found,) = (f for f in data["findings"] if f["code"] == "channel.left_out")
    assert found["numbers"]["kept"] == [c for c in SETUPS["fast"].outer if c != "a"]
