"""What is predicted of a campaign is what its tests then tell: against a campaign of the whole-disk simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tcdyn.campaign import solve_campaign
from tcdyn.campaign.planned import (
    Logging,
    PlannedTest,
    planned_statistics,
    predict_campaign,
    read_plan,
)
from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.verify.published import TABLE_7_3
from tests.campaign.rigs import drawn, true_beta

NAMES = ("A2", "B4", "D3")
NEAR = 0.2  # of u: the issue's own bound


def plan_of(names: tuple[str, ...]) -> list[PlannedTest]:
    """The thesis's tests, as one would plan them."""
    every = {n: ehl_test(n) for n in names}
    return [
        PlannedTest(
            n,
            c.load_N,
            c.friction_N,
            c.speed_fast_rpm,
            c.speed_slow_rpm,
            true_beta(n),
            c.h_fast_W_m2K,
        )
        for n, c in every.items()
    ]


def layout(name: str) -> Rig:
    """The thesis's junctions, Clarke's, and a row drilled nearer to the surface."""
    if name == "thesis":
        return load_rig()
    if name == "clarke":
        return parse_rig({"thermocouples": {"layout": "clarke"}}, "rig.toml")
    nearer = {
        c: {"depth_mm": d, "z_mm": z}
        for c, d, z in (("a", 2.0, 4.765), ("c", 2.0, 2.0), ("e", 1.0, 4.765))
    }
    return parse_rig({"thermocouples": nearer}, "rig.toml")


@pytest.mark.study
@pytest.mark.parametrize("name", ["thesis", "clarke", "nearer"])
def test_the_predicted_uncertainty_is_the_fitted_one(name: str) -> None:
    rig = layout(name)
    planned = predict_campaign(plan_of(NAMES), rig).table()
    done = drawn(11, NAMES, rig=rig)
    for key, own in (("u_beta", "beta"), ("u_beta_within", "beta_within")):
        fitted = np.array([e[own].u for e in solve_campaign(done.kept).estimates])
        assert planned[key].to_numpy(dtype=float) == pytest.approx(fitted, rel=NEAR)


@pytest.mark.study
def test_depths_known_better_tell_beta_better_and_leave_differences_as_they_are() -> None:
    finer = parse_rig({"uncertainty": {"depth_mm": 0.02}}, "rig.toml")
    plan = plan_of(("A2", "D3"))
    usual, fine = predict_campaign(plan, load_rig()), predict_campaign(plan, finer)
    assert fine.posterior.estimates[0]["beta"].u < 0.6 * usual.posterior.estimates[0]["beta"].u
    within = [p.posterior.estimates[0]["beta_within"].u for p in (usual, fine)]
    assert within[1] == pytest.approx(within[0], rel=0.2)


@pytest.mark.study
def test_more_tests_tell_the_exponent_no_worse() -> None:
    plan = plan_of(("A2", "B4", "D3"))
    whole = predict_campaign(plan, load_rig())
    assert whole.u_exponent <= predict_campaign(plan[:1], load_rig()).u_exponent
    assert "u of the exponent n" in whole.summary()


@pytest.mark.parametrize("name", ["A1", "D4"])
def test_a_planned_test_keeps_the_conditions_that_trends_are_sought_over(name: str) -> None:
    """Its ΔT u_s by 0.35 K/W is rough: within a half of the thesis's (table 7.3), which tells its slopes' u as well."""
    at, (one,) = ehl_test(name), plan_of((name,))
    kept = planned_statistics(one, load_rig(), Logging(rate_Hz=25.0, loaded_s=100.0, cooling_s=3.0))
    told = kept.conditions
    assert told["sliding_speed_m_s"] == pytest.approx(at.sliding_speed_m_s, rel=1e-9)
    assert told["entraining_speed_m_s"] == pytest.approx(at.entraining_speed_m_s, rel=1e-9)
    assert told["power_W"] == pytest.approx(at.power_W, rel=1e-9)
    assert told["speed_ratio"] == pytest.approx(4.24, abs=0.001)
    published = TABLE_7_3[list(PROGRAMME).index(name)][0]
    assert told["delta_T_us_K_m_s"] == pytest.approx(published, rel=0.5)
    found = solve_campaign([kept]).estimates[
        0
    ]  # its fit stands on the truth, and so does what its records would say
    assert found["beta"].value == pytest.approx(one.beta, abs=1e-6)
    assert found["h_fast"].value == pytest.approx(one.h_fast_W_m2K, rel=1e-6)
    assert found["h_slow"].value == pytest.approx(
        one.h_fast_W_m2K / told["speed_ratio"] ** (2 / 3), rel=1e-3
    )
    lag_s = 0.54 + 0.12 + load_rig().disk_setup("fast").conditioning.lag_s
    assert found["lag_fast_s"].value == pytest.approx(lag_s, abs=1e-6)


def test_a_plan_is_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(
        "load_N,friction_N,speed_fast_rpm,speed_slow_rpm\n850,9,4261,1005\n2320,26,4261,1005\n",
        encoding="utf-8",
    )
    assert [p.load_N for p in read_plan(path)] == [850, 2320]
    assert (
        run(lambda: app(["design", "--campaign", str(path), "--out", str(tmp_path / "u.csv")])) == 0
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
