"""Plunges, the hole comparison and the oven of the synthetic rig."""

import numpy as np
import pytest
from scipy.special import erfc, erfcx

from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.bath import fluid_state, heat_radially, natural_h_W_m2K
from tcdyn.simulate.measure import simulate_oven
from tcdyn.simulate.plunge import (
    HOLE_COLUMNS,
    PlungeOptions,
    PlungeTruth,
    bath_columns,
    simulate_hole,
    simulate_plunge,
)
from tcdyn.simulate.truth import CLEAN, draw_truth

SETUP = load_rig().disk_setup("fast")
SHORT = PlungeOptions(after_s=30.0)


def test_plunge_at_small_biot_number_is_a_single_exponential() -> None:
    h = 1.0  # Bi = h (R_o - R_bore) / K = 4e-4: gradients of that order remain
    heating = heat_radially(
        SETUP, np.array([3e-3]), 20.0, lambda t: 100.0, lambda t, wall: h, 4000.0
    )
    t = np.array([500.0, 2000.0, 4000.0])
    volume = (SETUP.outer_radius_m**2 - SETUP.bore_radius_m**2) / (2 * SETUP.outer_radius_m)
    tau = SETUP.density_kg_m3 * SETUP.specific_heat_J_kgK * volume / h
    assert heating.at(t)[:, 0] == pytest.approx(100 - 80 * np.exp(-t / tau), abs=80 * 4e-4)


def test_early_heating_is_that_of_a_half_space() -> None:
    """Carslaw and Jaeger's semi-infinite solid with convection, while heat is nearer the surface than its curvature."""
    h = 800.0
    depth = 0.3e-3
    t = np.array([0.02, 0.05])
    heating = heat_radially(SETUP, np.array([depth]), 0.0, lambda t: 1.0, lambda t, wall: h, 1.0)
    alpha = SETUP.diffusivity_m2_s
    k = SETUP.conductivity_W_mK
    x = depth / (2 * np.sqrt(alpha * t))
    g = h * np.sqrt(alpha * t) / k
    half_space = erfc(x) - np.exp(-(x**2)) * erfcx(x + g)
    # Curvature of the surface enters as sqrt(alpha t) / (2 R_o): 1 % at 0.05 s.
    assert heating.at(t)[:, 0] == pytest.approx(half_space, rel=0.015)


def test_oil_has_its_published_viscosity() -> None:
    assert fluid_state("mobil-jet-ii", 100.0).viscosity_m2_s * 1e6 == pytest.approx(5.1, abs=0.05)


def test_water_heats_faster_than_oil() -> None:
    oil, water = (natural_h_W_m2K(f, 20.0, 80.0, 9.53e-3) for f in ("mobil-jet-ii", "water"))
    assert water > 3 * oil


def test_log_has_the_columns_of_the_format_and_starts_twenty_seconds_before_entry() -> None:
    frame, truth = simulate_plunge("slow", 3, options=SHORT)
    assert list(frame.columns) == [
        "time_s",
        "switch",
        "probe_degC",
        "fluid_degC",
        *(f"{c}_degC" for c in "abcdef"),
    ]
    assert np.allclose(np.diff(frame["time_s"]), 1 / 75, rtol=0, atol=1e-12)
    assert truth["entry_s"] == pytest.approx(20, abs=0.6)
    assert set(frame["switch"]) == {0.0, 1.0}


def test_disks_reach_no_bath_but_follow_each_other_in_order_of_depth() -> None:
    _, truth = simulate_plunge("fast", 3, bath_degC=110.0, options=SHORT)
    last = truth["traces"].iloc[-1]
    assert 110 > last["e_degC"] > last["a_degC"] > last["b_degC"] > 30


@pytest.mark.study
def test_hand_pressed_switch_scatters_by_a_seventh_of_a_second_and_sometimes_bounces() -> None:
    runs = [
        simulate_plunge("fast", seed, options=PlungeOptions(entry_s=3, after_s=2))[1]
        for seed in range(60)
    ]
    off = np.array([r["switch_s"] - r["entry_s"] for r in runs])
    assert off.std() == pytest.approx(0.15, rel=0.3)  # 60 draws know it to 9 %; three of those
    assert 5 < sum(r["bounces"] > 0 for r in runs) < 35
    assert 15 < sum(r["switch_held"] for r in runs) < 45


def test_a_bouncing_switch_opens_for_a_fiftieth_of_a_second_each_time_and_one_let_go_after_0_6_s() -> (
    None
):
    """Two bounces, 0.04 and 0.08 s after it closes at 1 s; opened again at 1.6 s unless it is held."""
    _, truth = simulate_plunge("fast", 0, options=PlungeOptions(entry_s=3, after_s=2))
    told = {k: truth[k] for k in PlungeTruth.__dataclass_fields__} | {
        "switch_s": 1.0,
        "bounces": 2,
        "duration_s": 5.0,
    }
    for held in (True, False):
        columns = bath_columns(
            PlungeTruth(**{**told, "switch_held": held}), CLEAN, np.random.default_rng(0)
        )
        t = np.array([0.9, 1.02, 1.05, 1.07, 1.09, 1.11, 1.5, 1.7, 4.9])
        seen = columns["switch"][np.searchsorted(columns["time_s"], t) - 1]
        assert seen.tolist() == [0, 1, 0, 1, 0, 1, 1, held, held]


def test_probe_shows_the_entry_sooner_than_the_disk() -> None:
    frame, truth = simulate_plunge("fast", 0, options=SHORT)
    t = frame["time_s"].to_numpy()
    at = int((truth["entry_s"] + 1.0) * 75)
    assert frame["probe_degC"][at] > 90
    assert frame["a_degC"][at] < 40
    before = frame["probe_degC"][t < truth["entry_s"] - 0.2]
    assert before.mean() == pytest.approx(
        truth["initial_degC"] + 1.5, abs=0.05
    )  # in the air, which the disk lags
    assert before.max() < 35


def test_entry_burst_and_scale_are_what_the_options_say() -> None:
    options = PlungeOptions(after_s=5, h_scale=1.0, burst=3.0, burst_decay_s=1.2)
    _, truth = simulate_plunge("fast", 0, options=options)
    assert (truth["h_scale"], truth["burst"], truth["burst_decay_s"]) == (1.0, 3.0, 1.2)


def test_clean_plunge_lags_the_truth_by_each_channel_s_lag() -> None:
    rig = draw_truth(2).with_imperfections(CLEAN)
    frame, truth = simulate_plunge("fast", 2, truth=rig, options=SHORT)
    t = frame["time_s"].to_numpy()
    at = np.arange(42.0, 48.0)
    for channel, lag in truth["lag_s"].items():
        early = np.interp(at - lag, t, truth["traces"][f"{channel}_degC"])
        # Half the lag squared times the curvature, 0.01 K/s2 that late.
        assert np.abs(np.interp(at, t, frame[f"{channel}_degC"]) - early).max() < 5e-3


def test_hole_comparison_shows_one_hole_lagging() -> None:
    frame, truth = simulate_hole(1)
    assert list(frame.columns) == ["time_s", "switch", "probe_degC", "fluid_degC", *HOLE_COLUMNS]
    lag = truth["lag_s"]
    assert max(lag["d1p3"], lag["d2p2"]) - lag["ideal_1"] < 0.2
    assert lag["d3p0"] - lag["ideal_1"] > 0.6
    assert frame["ideal_1_degC"][:500].mean() == pytest.approx(
        16, abs=1.3
    )  # drawn start and a tenth of offset


def test_oven_rows_recover_the_static_lines() -> None:
    """Straight lines through PRT against reading: gain to 0.1 K over the 140 K range, well inside rounding of holds."""
    frame, truth = simulate_oven("fast", 3)
    assert list(frame.columns) == [
        "repeat",
        "setpoint_degC",
        "prt_degC",
        *(f"{c}_degC" for c in "abcdef"),
    ]
    assert sorted(set(frame["repeat"])) == [1, 2, 3]
    assert sorted(set(frame["setpoint_degC"])) == list(range(20, 161, 20))
    for c in "abcdef":
        gain, offset = np.polyfit(frame[f"{c}_degC"], frame["prt_degC"], 1)
        # 24 holds of +- 0.1 K: slope known to 0.058 / (sqrt(24) 46) = 2.6e-4, intercept to 0.026 K; four of those.
        assert gain == pytest.approx(truth["gain"][c], abs=1.1e-3)
        assert offset == pytest.approx(truth["offset_degC"][c], abs=0.11)


def test_prt_is_never_further_off_than_its_limit() -> None:
    frame, truth = simulate_oven("slow", 1)
    wrong = frame["prt_degC"].to_numpy() - truth["traces"]["true_degC"].to_numpy()
    assert np.abs(wrong).max() < 0.1 + 0.03  # and 5 mK of scatter
    assert np.abs(wrong).max() > 0.05
