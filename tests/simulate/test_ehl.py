"""EHL logs of the synthetic rig: formats, temperatures of the thesis, events, reproducibility."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import cumulative_trapezoid

from tcdyn.cli.app import app, run
from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions, draw_test, simulate_ehl
from tcdyn.simulate.implicit import integrate, steady_state
from tcdyn.simulate.mesh import build_system
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.simulate.truth import CLEAN, RigTruth, draw_truth

SHORT = EhlOptions(load_on_s=5.0, unload_s=25.0, duration_s=35.0, mesh=STUDY_MESH)
COLUMNS = [
    "time_s",
    "load_N",
    "friction_N",
    "contact",
    "speed_fast_rpm",
    "speed_slow_rpm",
    *(f"fast_{c}_degC" for c in "abcdef"),
    *(f"slow_{c}_degC" for c in "abcdef"),
    "ambient_degC",
    "oil_degC",
]


@pytest.fixture(scope="module")
def short_test() -> tuple[pd.DataFrame, dict[str, Any]]:
    return simulate_ehl("B3", 1, options=SHORT)


@pytest.fixture(scope="module")
def clean_test() -> tuple[pd.DataFrame, dict[str, Any]]:
    return simulate_ehl("B3", 1, draw_truth(1).with_imperfections(CLEAN), SHORT)


def test_log_has_the_documented_columns_and_sampling_rate(
    short_test: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    frame, true_values = short_test
    assert list(frame.columns) == COLUMNS
    assert list(true_values["traces"].columns) == COLUMNS
    assert np.allclose(np.diff(frame["time_s"]), 1 / 75, rtol=0, atol=1e-12)
    assert set(frame["contact"]) == {0.0, 1.0}
    assert np.isfinite(frame.to_numpy()).all()


def test_true_friction_is_the_mean_of_the_last_five_seconds_of_full_load(
    short_test: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    true_values = short_test[1]
    t = true_values["traces"]["time_s"].to_numpy()
    friction = true_values["traces"]["friction_N"].to_numpy()
    unload_rel_s = true_values["unload_s"] - true_values["parting_s"]
    last = [
        f
        for time, f in zip(t, friction)
        if unload_rel_s - 5.0 + true_values["parting_s"] <= time < unload_rel_s
    ]
    assert len(last) == pytest.approx((5.0 - true_values["parting_s"]) * 75, abs=1)
    assert true_values["friction_N"] == pytest.approx(sum(last) / len(last), rel=1e-12)
    assert min(last) > 0.99 * true_values["friction_N"]


def test_same_seed_gives_the_same_log_and_another_seed_does_not(
    short_test: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    repeated, _ = simulate_ehl("B3", 1, options=SHORT)
    other_seed, _ = simulate_ehl("B3", 2, options=SHORT)
    pd.testing.assert_frame_equal(repeated, short_test[0])
    assert not np.allclose(other_seed["fast_a_degC"], repeated["fast_a_degC"])


def last_above(t: np.ndarray, values: np.ndarray, level: float) -> float:
    """Time of the last value above the level."""
    return float(t[np.flatnonzero(values > level)[-1]])


@pytest.mark.e2e
@pytest.mark.parametrize("seed", range(5))
def test_switch_load_and_friction_agree_on_the_unloading_time_within_50_ms(
    seed: int,
) -> None:
    frame, true_values = simulate_ehl("C2", seed, options=SHORT)
    t = frame["time_s"].to_numpy()
    event_times = [
        last_above(t, frame["contact"].to_numpy(), 0.5),
        last_above(t, frame["load_N"].to_numpy(), 0.5 * true_values["load_N"]),
        last_above(t, frame["friction_N"].to_numpy(), 0.5 * true_values["friction_N"]),
    ]
    # the bound of the specification
    assert np.abs(np.array(event_times) - true_values["unload_s"]).max() < 0.05
    # not on a sample
    assert abs(true_values["unload_s"] * 75 - round(true_values["unload_s"] * 75)) > 1e-6


def test_speeds_and_heat_transfer_coefficients_match_the_programme(
    clean_test: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    frame, true_values = clean_test
    assert (frame["speed_fast_rpm"] == 4261).all()
    assert true_values["sliding_speed_m_s"] == ehl_test("B3").sliding_speed_m_s
    assert true_values["h_fast"] / true_values["h_slow"] == pytest.approx(
        4.24 ** true_values["exponent"], rel=1e-12
    )


def test_clean_log_differs_from_the_true_traces_only_by_the_chain(
    clean_test: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    """Late in a slow phase a trace is nearly a ramp, so log(t) = true(t - lag) except for
    curvature."""
    frame, true_values = clean_test
    t = frame["time_s"].to_numpy()
    times = np.arange(22.0, 24.0, 0.1)
    for disk in ("fast", "slow"):
        for channel, lag in true_values["lag_s"][disk].items():
            name = f"{disk}_{channel}_degC"
            true_reading = np.interp(times - lag, t, true_values["traces"][name])
            assert np.abs(np.interp(times, t, frame[name]) - true_reading).max() < 1e-2  # 0.03 K/s2


def test_raw_trace_is_wrong_by_degrees_just_after_unloading(
    clean_test: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    frame, true_values = clean_test
    t = frame["time_s"].to_numpy()
    after = (t > true_values["unload_s"]) & (t < true_values["unload_s"] + 1)
    error = (frame["fast_e_degC"] - true_values["traces"]["fast_e_degC"]).to_numpy()[after]
    assert error.max() > 1.5


def test_steady_temperatures_agree_with_table_7_2() -> None:
    """Thermocouple a of both disks in all 16 tests at the steady state of the sampled rig, within
    10 degC."""
    rig = draw_truth(0)
    for condition in PROGRAMME.values():
        sampled = draw_test(rig, condition, 0)
        warm = sampled.ambient_degC + 0.005 * condition.power_W
        for name, heat_share, h, measured in (
            ("fast", sampled.beta, sampled.h_fast_W_m2K, condition.fast_a_degC),
            ("slow", 1 - sampled.beta, sampled.h_slow_W_m2K, condition.slow_a_degC),
        ):
            system = build_system(rig.disk(name), h, sampled.half_width_m, STUDY_MESH)
            power = heat_share * sampled.friction_N * condition.sliding_speed_m_s
            a = (system.sample @ steady_state(system, power, warm))[system.channels.index("a")]
            assert a == pytest.approx(measured, abs=10), f"{condition.name} {name}"


def test_options_fix_the_quantities_they_name() -> None:
    rig = draw_truth(4, exponent=0.7)
    sampled = draw_test(
        rig, ehl_test("D4"), 4, EhlOptions(beta=0.68, h_fast_W_m2K=740.0, friction_N=20.0)
    )
    assert (sampled.beta, sampled.h_fast_W_m2K, sampled.friction_N) == (0.68, 740.0, 20.0)
    assert sampled.h_slow_W_m2K == pytest.approx(740.0 / 4.24**0.7, rel=1e-12)


def test_uncertain_rigs_scatter_with_the_uncertainties_of_the_rig_file() -> None:
    rigs = [draw_truth(seed, uncertain=True) for seed in range(300)]
    nominal = draw_truth(0).fast.setup

    def scatter(values: list[float]) -> float:
        return float(np.std(values))

    # A standard deviation from 300 samples is known to 4 %; three of those.
    tolerance = {"rel": 0.13}
    depth = [r.fast.setup.junctions["e"].depth_m - nominal.junctions["e"].depth_m for r in rigs]
    assert scatter(depth) == pytest.approx(0.1e-3, **tolerance)
    assert scatter([r.fast.setup.conductivity_W_mK / 41 for r in rigs]) == pytest.approx(
        0.03, **tolerance
    )
    assert scatter([r.slow.setup.specific_heat_J_kgK / 470 for r in rigs]) == pytest.approx(
        0.02, **tolerance
    )
    washer = [
        r.fast.setup.washer_conductivity_W_mK / nominal.washer_conductivity_W_mK for r in rigs
    ]
    assert scatter(washer) == pytest.approx(0.2, **tolerance)
    assert scatter([r.half_width_scale for r in rigs]) == pytest.approx(0.03, **tolerance)
    assert scatter([r.friction_scale for r in rigs]) == pytest.approx(0.01, **tolerance)
    exponents = [r.speed_exponent for r in rigs]
    assert min(exponents) >= 0.571
    assert max(exponents) <= 0.8
    assert scatter(exponents) == pytest.approx((0.8 - 0.571) / np.sqrt(12), **tolerance)


@pytest.mark.study
@pytest.mark.parametrize(
    ("test", "fast_a", "slow_a"), [("A1", 85, 73), ("B3", 122, 96), ("D4", 155, 125)]
)
def test_full_length_tests_end_near_the_temperatures_of_the_thesis(
    test: str, fast_a: float, slow_a: float
) -> None:
    for seed in (1, 2):
        _, true_values = simulate_ehl(test, seed, options=EhlOptions(mesh=STUDY_MESH))
        assert true_values["steady_degC"]["fast_a"] == pytest.approx(fast_a, abs=10)
        assert true_values["steady_degC"]["slow_a"] == pytest.approx(slow_a, abs=10)


def test_braked_speeds_decay_exponentially_and_the_disks_cool_more_slowly() -> None:
    rig = draw_truth(1).with_imperfections(CLEAN)
    unbraked, braked = (
        simulate_ehl("B3", 1, rig, replace(SHORT, brake_s=b))[1] for b in (None, 3.0)
    )
    traces = braked["traces"]
    unload_s = braked["unload_s"]
    t = traces["time_s"].to_numpy()
    for column in ("speed_fast_rpm", "speed_slow_rpm"):
        speed_ratio = traces[column].to_numpy() / traces[column].iloc[0]
        assert (speed_ratio[t < unload_s] == 1).all()
        # linear between samples
        assert np.interp(unload_s + 3.0, t, speed_ratio) == pytest.approx(np.exp(-1), abs=1e-5)
    warmer = traces["fast_e_degC"].to_numpy() - unbraked["traces"]["fast_e_degC"].to_numpy()
    assert np.abs(warmer[t < unload_s]).max() < 1e-9
    assert (np.diff(warmer[t > unload_s + 1.0]) > 0).all()


@pytest.mark.e2e
def test_slow_unloading_cools_as_the_mean_of_sudden_unloadings_during_it() -> None:
    """The disks are linear in the friction, and a linear fall is the mean of steps at all its
    instants: the response to the removed heat is a running mean over the fall (figure 4.20)."""
    rig = draw_truth(1).with_imperfections(CLEAN)
    loaded, sudden, slow = (
        simulate_ehl("B3", 1, rig, replace(SHORT, **changes))[1]["traces"]
        for changes in ({"unload_s": 60.0}, {"parting_s": 0.001}, {"parting_s": 1.5})
    )
    t = loaded["time_s"].to_numpy()
    for column in ("fast_e_degC", "slow_a_degC"):
        fall = (loaded[column] - sudden[column]).to_numpy()
        integral = cumulative_trapezoid(fall, t, initial=0.0)
        later = t[t < 34.0]
        expected = np.interp(later + 0.75, t, integral) - np.interp(later - 0.75, t, integral)
        slow_fall = (loaded[column] - slow[column]).to_numpy()[t < 34.0]
        # 1 % of the fall at its steepest: the step of the solver within the ramp
        np.testing.assert_allclose(slow_fall, expected / 1.5, atol=0.01 * fall.max())


def test_command_writes_a_friction_that_falls_linearly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def short(test: str, seed: int, truth: RigTruth, o: EhlOptions) -> Any:
        return simulate_ehl(test, seed, truth, replace(SHORT, parting_s=o.parting_s))

    monkeypatch.setattr("tcdyn.simulate.ehl.simulate_ehl", short)
    out = tmp_path / "B3.csv"
    words = ["simulate", "ehl", "--out", str(out), "--clean", "--unloading-s", "1.5", "-q"]
    assert run(lambda: app(words)) == 0
    truth = json.loads(out.with_suffix(".truth.json").read_text(encoding="utf-8"))
    log = pd.read_csv(out)
    since = log["time_s"] - truth["unload_s"]
    expected = truth["friction_N"] * np.clip(0.5 - since / 1.5, 0.0, 1.0)
    near = since > -3.0
    # the written log has four decimals
    np.testing.assert_allclose(log["friction_N"][near], expected[near], atol=1e-4)


@pytest.mark.parametrize("film_air_K", [0.0, 7.0])
def test_scaled_surface_coefficient_equals_a_system_built_with_it(film_air_K: float) -> None:
    """The iterated stages against a factorisation of the scaled matrix: equal to the tolerance of
    the iteration."""
    rig = draw_truth(1).with_film_air(film_air_K)
    full, halved = (build_system(rig.fast, h, 1.6e-3, STUDY_MESH) for h in (700.0, 350.0))
    start = steady_state(full, 500.0, 60.0)
    constant = lambda value: lambda t: np.full_like(t, value)  # noqa: E731
    final_states = [
        integrate(
            system,
            constant(500.0),
            constant(60.0),
            (0.0, 20.0),
            start,
            h_share=constant(heat_share),
        ).state
        for system, heat_share in ((full, 0.5), (halved, 1.0))
    ]
    np.testing.assert_allclose(final_states[0], final_states[1], atol=1e-6)


def test_disk_cooled_only_at_its_surface_reaches_the_temperature_of_its_air() -> None:
    disk = draw_truth(1).with_film_air(7.0).slow
    insulated = replace(
        disk, setup=replace(disk.setup, washer_conductivity_W_mK=0.0), bore_conductance_W_m2K=1e-9
    )
    system = build_system(insulated, 700.0, 1.6e-3, STUDY_MESH)
    # 1e-9 of the conductance of the surface
    readings = system.sample @ steady_state(system, 0.0, 60.0)
    assert readings == pytest.approx(67.0, abs=1e-6)


def test_repeated_contacts_heat_the_disks_and_appear_in_the_log() -> None:
    rig = draw_truth(1).with_imperfections(CLEAN)
    frame, true_values = simulate_ehl(
        "B3", 1, rig, replace(SHORT, again_s=((0.2, 1.0), (0.1, 3.0)))
    )
    t = frame["time_s"].to_numpy()
    unload_s = true_values["unload_s"]
    for column, level in (
        ("friction_N", true_values["friction_N"]),
        ("load_N", true_values["load_N"]),
    ):
        # a trapezium of 0.2 s with ramps of 0.01 s, sampled at 75 Hz: to half a sample at each end
        for start, length in ((1.0, 0.2), (3.0, 0.1)):
            tolerance = (t > unload_s + start - 0.1) & (t < unload_s + start + 0.4)
            assert frame[column][tolerance].sum() / 75 == pytest.approx(
                level * (length - 0.01), abs=level / 75
            )
    pulses = np.flatnonzero(np.diff(frame["contact"]) > 0)
    assert t[pulses[1:]] - unload_s == pytest.approx([1.0, 3.0], abs=1 / 75)
