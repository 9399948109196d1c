"""Predicted uncertainties of a planned campaign against those of a simulated campaign."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.campaign import planned, solve_campaign
from tcdyn.campaign.planned import (
    Logging,
    PlannedTest,
    planned_statistics,
    predict_campaign,
    read_plan,
)
from tcdyn.cli.app import app, run
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.verify.published import TABLE_7_3
from tests.campaign.rigs import draw_campaign, true_beta

NAMES = ("A2", "B4", "D3")
TOLERANCE_REL = 0.2  # of u: the required agreement


def plan_of(names: tuple[str, ...]) -> list[PlannedTest]:
    """The tests of the thesis as planned tests."""
    conditions = {name: ehl_test(name) for name in names}
    return [
        PlannedTest(
            name,
            test.load_N,
            test.friction_N,
            test.speed_fast_rpm,
            test.speed_slow_rpm,
            true_beta(name),
            test.h_fast_W_m2K,
        )
        for name, test in conditions.items()
    ]


def layout(name: str) -> Rig:
    """Junctions of the thesis, those of Clarke, or a row nearer to the surface."""
    if name == "thesis":
        return load_rig()
    if name == "clarke":
        return parse_rig({"thermocouples": {"layout": "clarke"}}, "rig.toml")
    junctions = {
        c: {"depth_mm": d, "z_mm": z}
        for c, d, z in (("a", 2.0, 4.765), ("c", 2.0, 2.0), ("e", 1.0, 4.765))
    }
    return parse_rig({"thermocouples": junctions}, "rig.toml")


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("name", ["thesis", "clarke", "nearer"])
def test_predicted_uncertainty_matches_the_fitted_one(name: str) -> None:
    rig = layout(name)
    planned = predict_campaign(plan_of(NAMES), rig).table()
    campaign = draw_campaign(11, NAMES, rig=rig)
    for key, quantity in (("u_beta", "beta"), ("u_beta_within", "beta_within")):
        fitted = np.array([e[quantity].u for e in solve_campaign(campaign.tests).estimates])
        assert planned[key].to_numpy(dtype=float) == pytest.approx(fitted, rel=TOLERANCE_REL)


@pytest.mark.study
def test_smaller_depth_uncertainty_reduces_u_of_beta_but_not_of_differences() -> None:
    rig = parse_rig({"uncertainty": {"depth_mm": 0.02}}, "rig.toml")
    plan = plan_of(("A2", "D3"))
    nominal = predict_campaign(plan, load_rig())
    precise = predict_campaign(plan, rig)
    assert precise.posterior.estimates[0]["beta"].u < 0.6 * nominal.posterior.estimates[0]["beta"].u
    u_within = [p.posterior.estimates[0]["beta_within"].u for p in (nominal, precise)]
    assert u_within[1] == pytest.approx(u_within[0], rel=0.2)


@pytest.mark.study
def test_more_tests_do_not_increase_u_of_the_exponent() -> None:
    plan = plan_of(("A2", "B4", "D3"))
    prediction = predict_campaign(plan, load_rig())
    assert prediction.u_exponent <= predict_campaign(plan[:1], load_rig()).u_exponent
    assert "u of the exponent n" in prediction.summary()


@pytest.mark.parametrize("name", ["A1", "D4"])
def test_planned_test_has_the_conditions_that_trends_use(name: str) -> None:
    """Delta T u_s from 0.35 K/W is approximate: within half of the value in table 7.3, as is u of
    its slopes."""
    reference_test = ehl_test(name)
    (planned,) = plan_of((name,))
    statistics = planned_statistics(
        planned, load_rig(), Logging(rate_Hz=25.0, loaded_s=100.0, cooling_s=3.0)
    )
    conditions = statistics.conditions
    assert conditions["sliding_speed_m_s"] == pytest.approx(
        reference_test.sliding_speed_m_s, rel=1e-9
    )
    assert conditions["entraining_speed_m_s"] == pytest.approx(
        reference_test.entraining_speed_m_s, rel=1e-9
    )
    assert conditions["power_W"] == pytest.approx(reference_test.power_W, rel=1e-9)
    assert conditions["speed_ratio"] == pytest.approx(4.24, abs=0.001)
    published = TABLE_7_3[list(PROGRAMME).index(name)][0]
    assert conditions["delta_T_us_K_m_s"] == pytest.approx(published, rel=0.5)
    # the fit and the record priors are at the true values
    estimates = solve_campaign([statistics]).estimates[0]
    assert estimates["beta"].value == pytest.approx(planned.beta, abs=1e-6)
    assert estimates["h_fast"].value == pytest.approx(planned.h_fast_W_m2K, rel=1e-6)
    assert estimates["h_slow"].value == pytest.approx(
        planned.h_fast_W_m2K / conditions["speed_ratio"] ** (2 / 3), rel=1e-3
    )
    lag_s = 0.54 + 0.12 + load_rig().disk_setup("fast").conditioning.lag_s
    assert estimates["lag_fast_s"].value == pytest.approx(lag_s, abs=1e-6)


def test_no_two_channels_of_a_planned_test_have_the_same_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seeds = []
    noise_of = planned._reproducible_noise

    def recorded(count: int, seed: int) -> Array:
        """The noise; its seed is stored."""
        seeds.append(seed)
        return noise_of(count, seed)

    monkeypatch.setattr(planned, "_reproducible_noise", recorded)
    planned_statistics(plan_of(("A2",))[0], load_rig(), Logging())
    assert len(seeds) == 13  # ambient and twelve junctions
    assert len(set(seeds)) == len(seeds)


@pytest.mark.e2e
def test_plan_is_read_from_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(
        "load_N,friction_N,speed_fast_rpm,speed_slow_rpm\n850,9,4261,1005\n2320,26,4261,1005\n",
        encoding="utf-8",
    )
    assert [p.load_N for p in read_plan(path)] == [850, 2320]
    assert (
        run(
            lambda: app(
                ["rig", "design", "--campaign", str(path), "--out", str(tmp_path / "u.csv")]
            )
        )
        == 0
    )
    assert "2 planned tests" in capsys.readouterr().out
    assert (
        (tmp_path / "u.csv")
        .read_text(encoding="utf-8")
        .startswith("test,u_beta_alone,u_beta,u_beta_within")
    )
    path.write_text(
        "load_N,friction_N,speed_fast_rpm,speed_slow_rpm\n850,900,4261,1005\n", encoding="utf-8"
    )
    with pytest.raises(InputError, match="row 2 is no test"):
        read_plan(path)
