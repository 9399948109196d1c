"""Plunges, the comparison of holes and the oven of the synthetic rig."""

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
    h = 1.0  # Bi = h (R_o - R_bore) / K = 4e-4: remaining gradients are of this order
    heating = heat_radially(
        SETUP, np.array([3e-3]), 20.0, lambda t: 100.0, lambda t, wall: h, 4000.0
    )
    t = np.array([500.0, 2000.0, 4000.0])
    volume = (SETUP.outer_radius_m**2 - SETUP.bore_radius_m**2) / (2 * SETUP.outer_radius_m)
    tau = SETUP.density_kg_m3 * SETUP.specific_heat_J_kgK * volume / h
    assert heating.at(t)[:, 0] == pytest.approx(100 - 80 * np.exp(-t / tau), abs=80 * 4e-4)


def test_early_heating_matches_the_half_space_solution() -> None:
    """Semi-infinite solid with convection (Carslaw and Jaeger), while the heated depth is small
    against the curvature."""
    h = 800.0
    depth = 0.3e-3
    t = np.array([0.02, 0.05])
    heating = heat_radially(SETUP, np.array([depth]), 0.0, lambda t: 1.0, lambda t, wall: h, 1.0)
    alpha = SETUP.diffusivity_m2_s
    k = SETUP.conductivity_W_mK
    x = depth / (2 * np.sqrt(alpha * t))
    g = h * np.sqrt(alpha * t) / k
    half_space = erfc(x) - np.exp(-(x**2)) * erfcx(x + g)
    # Curvature of the surface contributes sqrt(alpha t) / (2 R_o): 1 % at 0.05 s.
    assert heating.at(t)[:, 0] == pytest.approx(half_space, rel=0.015)


def test_oil_has_its_published_viscosity() -> None:
    assert fluid_state("mobil-jet-ii", 100.0).viscosity_m2_s * 1e6 == pytest.approx(5.1, abs=0.05)


def test_water_heats_faster_than_oil() -> None:
    oil, water = (natural_h_W_m2K(f, 20.0, 80.0, 9.53e-3) for f in ("mobil-jet-ii", "water"))
    assert water > 3 * oil


def test_plunge_log_has_the_documented_columns_and_starts_20_s_before_entry() -> None:
    frame, true_values = simulate_plunge("slow", 3, options=SHORT)
    assert list(frame.columns) == [
        "time_s",
        "switch",
        "probe_degC",
        "fluid_degC",
        *(f"{c}_degC" for c in "abcdef"),
    ]
    assert np.allclose(np.diff(frame["time_s"]), 1 / 75, rtol=0, atol=1e-12)
    assert true_values["entry_s"] == pytest.approx(20, abs=0.6)
    assert set(frame["switch"]) == {0.0, 1.0}


def test_junctions_stay_below_the_bath_temperature_in_order_of_depth() -> None:
    _, true_values = simulate_plunge("fast", 3, bath_degC=110.0, options=SHORT)
    last = true_values["traces"].iloc[-1]
    assert 110 > last["e_degC"] > last["a_degC"] > last["b_degC"] > 30


@pytest.mark.study
def test_hand_pressed_switch_scatters_by_150_ms_and_sometimes_bounces() -> None:
    runs = [
        simulate_plunge("fast", seed, options=PlungeOptions(entry_s=3, after_s=2))[1]
        for seed in range(60)
    ]
    switch_delay_s = np.array([r["switch_s"] - r["entry_s"] for r in runs])
    # known to 9 % from 60 samples; three of those
    assert switch_delay_s.std() == pytest.approx(0.15, rel=0.3)
    assert 5 < sum(r["bounces"] > 0 for r in runs) < 35
    assert 15 < sum(r["switch_held"] for r in runs) < 45


def test_bouncing_switch_opens_for_20_ms_and_a_released_switch_opens_after_0_6_s() -> None:
    """Two bounces, 0.04 and 0.08 s after it closes at 1 s. It opens at 1.6 s unless it is held."""
    _, true_values = simulate_plunge("fast", 0, options=PlungeOptions(entry_s=3, after_s=2))
    fields = {k: true_values[k] for k in PlungeTruth.__dataclass_fields__} | {
        "switch_s": 1.0,
        "bounces": 2,
        "duration_s": 5.0,
    }
    for is_held in (True, False):
        columns = bath_columns(
            PlungeTruth(**{**fields, "switch_held": is_held}), CLEAN, np.random.default_rng(0)
        )
        t = np.array([0.9, 1.02, 1.05, 1.07, 1.09, 1.11, 1.5, 1.7, 4.9])
        switch = columns["switch"][np.searchsorted(columns["time_s"], t) - 1]
        assert switch.tolist() == [0, 1, 0, 1, 0, 1, 1, is_held, is_held]


def test_probe_shows_the_entry_before_the_disk() -> None:
    frame, true_values = simulate_plunge("fast", 0, options=SHORT)
    t = frame["time_s"].to_numpy()
    index = int((true_values["entry_s"] + 1.0) * 75)
    assert frame["probe_degC"][index] > 90
    assert frame["a_degC"][index] < 40
    before = frame["probe_degC"][t < true_values["entry_s"] - 0.2]
    # in the air, which the disk lags
    assert before.mean() == pytest.approx(true_values["initial_degC"] + 1.5, abs=0.05)
    assert before.max() < 35


def test_plunge_options_fix_burst_and_scale() -> None:
    options = PlungeOptions(after_s=5, h_scale=1.0, burst=3.0, burst_decay_s=1.2)
    _, true_values = simulate_plunge("fast", 0, options=options)
    assert (true_values["h_scale"], true_values["burst"], true_values["burst_decay_s"]) == (
        1.0,
        3.0,
        1.2,
    )


def test_clean_plunge_lags_the_true_traces_by_the_lag_of_each_channel() -> None:
    rig = draw_truth(2).with_imperfections(CLEAN)
    frame, true_values = simulate_plunge("fast", 2, truth=rig, options=SHORT)
    t = frame["time_s"].to_numpy()
    times = np.arange(42.0, 48.0)
    for channel, lag in true_values["lag_s"].items():
        true_reading = np.interp(times - lag, t, true_values["traces"][f"{channel}_degC"])
        # Half the lag squared times the curvature, 0.01 K/s2 at these times.
        assert np.abs(np.interp(times, t, frame[f"{channel}_degC"]) - true_reading).max() < 5e-3


def test_hole_comparison_shows_one_lagging_hole() -> None:
    frame, true_values = simulate_hole(1)
    assert list(frame.columns) == ["time_s", "switch", "probe_degC", "fluid_degC", *HOLE_COLUMNS]
    lag = true_values["lag_s"]
    assert max(lag["d1p3"], lag["d2p2"]) - lag["ideal_1"] < 0.2
    assert lag["d3p0"] - lag["ideal_1"] > 0.6
    # sampled start temperature and a tenth of the offset
    assert frame["ideal_1_degC"][:500].mean() == pytest.approx(16, abs=1.3)


def test_oven_rows_recover_the_static_lines() -> None:
    """Straight lines of PRT against reading: gain to 0.1 K over the range of 140 K, well inside
    the rounding of holds."""
    frame, true_values = simulate_oven("fast", 3)
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
        # 24 holds of +- 0.1 K: slope known to 0.058 / (sqrt(24) 46) = 2.6e-4, intercept to 0.026 K;
        # four times these.
        assert gain == pytest.approx(true_values["gain"][c], abs=1.1e-3)
        assert offset == pytest.approx(true_values["offset_degC"][c], abs=0.11)


def test_prt_error_stays_within_its_limit() -> None:
    frame, true_values = simulate_oven("slow", 1)
    error = frame["prt_degC"].to_numpy() - true_values["traces"]["true_degC"].to_numpy()
    assert np.abs(error).max() < 0.1 + 0.03  # plus 5 mK of scatter
    assert np.abs(error).max() > 0.05
