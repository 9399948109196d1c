"""EHL logs of the synthetic rig: formats, the thesis's temperatures, events, reproducibility."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions, draw_test, simulate_ehl
from tcdyn.simulate.implicit import integrate, steady_state
from tcdyn.simulate.mesh import build_system
from tcdyn.simulate.programme import PROGRAMME, ehl_test
from tcdyn.simulate.truth import CLEAN, draw_truth

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
def short() -> tuple[pd.DataFrame, dict[str, Any]]:
    return simulate_ehl("B3", 1, options=SHORT)


@pytest.fixture(scope="module")
def clean() -> tuple[pd.DataFrame, dict[str, Any]]:
    return simulate_ehl("B3", 1, draw_truth(1).with_imperfections(CLEAN), SHORT)


def test_log_has_the_columns_and_the_rate_of_the_format(
    short: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    frame, truth = short
    assert list(frame.columns) == COLUMNS
    assert list(truth["traces"].columns) == COLUMNS
    assert np.allclose(np.diff(frame["time_s"]), 1 / 75, rtol=0, atol=1e-12)
    assert set(frame["contact"]) == {0.0, 1.0}
    assert np.isfinite(frame.to_numpy()).all()


def test_the_truth_s_friction_is_the_mean_of_the_last_five_seconds_of_full_load(
    short: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    truth = short[1]
    t = truth["traces"]["time_s"].to_numpy()
    friction = truth["traces"]["friction_N"].to_numpy()
    parts = truth["unload_s"] - truth["parting_s"]
    last = [f for at, f in zip(t, friction) if parts - 5.0 + truth["parting_s"] <= at < parts]
    assert len(last) == pytest.approx((5.0 - truth["parting_s"]) * 75, abs=1)
    assert truth["friction_N"] == pytest.approx(sum(last) / len(last), rel=1e-12)
    assert min(last) > 0.99 * truth["friction_N"]


def test_the_same_seed_writes_the_same_log_and_another_does_not(
    short: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    again, _ = simulate_ehl("B3", 1, options=SHORT)
    other, _ = simulate_ehl("B3", 2, options=SHORT)
    pd.testing.assert_frame_equal(again, short[0])
    assert not np.allclose(other["fast_a_degC"], again["fast_a_degC"])


def last_above(t: np.ndarray, values: np.ndarray, level: float) -> float:
    return float(t[np.flatnonzero(values > level)[-1]])


@pytest.mark.parametrize("seed", range(5))
def test_switch_load_and_friction_agree_on_the_parting_within_a_twentieth_of_a_second(
    seed: int,
) -> None:
    frame, truth = simulate_ehl("C2", seed, options=SHORT)
    t = frame["time_s"].to_numpy()
    ends = [
        last_above(t, frame["contact"].to_numpy(), 0.5),
        last_above(t, frame["load_N"].to_numpy(), 0.5 * truth["load_N"]),
        last_above(t, frame["friction_N"].to_numpy(), 0.5 * truth["friction_N"]),
    ]
    assert np.abs(np.array(ends) - truth["unload_s"]).max() < 0.05  # the work order's bound
    assert abs(truth["unload_s"] * 75 - round(truth["unload_s"] * 75)) > 1e-6  # not on a sample


def test_speeds_and_power_are_those_of_the_table(
    clean: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    frame, truth = clean
    assert (frame["speed_fast_rpm"] == 4261).all()
    assert truth["sliding_speed_m_s"] == ehl_test("B3").sliding_speed_m_s
    assert truth["h_fast"] / truth["h_slow"] == pytest.approx(4.24 ** truth["exponent"], rel=1e-12)


def test_clean_log_differs_from_the_truth_by_the_chain_alone(
    clean: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    """Late in a slow phase a trace is nearly a ramp, so log(t) = true(t - lag), but for curvature."""
    frame, truth = clean
    t = frame["time_s"].to_numpy()
    at = np.arange(22.0, 24.0, 0.1)
    for disk in ("fast", "slow"):
        for channel, lag in truth["lag_s"][disk].items():
            name = f"{disk}_{channel}_degC"
            early = np.interp(at - lag, t, truth["traces"][name])
            assert np.abs(np.interp(at, t, frame[name]) - early).max() < 1e-2  # 0.03 K/s2


def test_raw_trace_is_degrees_wrong_just_after_unloading(
    clean: tuple[pd.DataFrame, dict[str, Any]],
) -> None:
    frame, truth = clean
    t = frame["time_s"].to_numpy()
    after = (t > truth["unload_s"]) & (t < truth["unload_s"] + 1)
    wrong = (frame["fast_e_degC"] - truth["traces"]["fast_e_degC"]).to_numpy()[after]
    assert wrong.max() > 1.5


def test_steady_temperatures_look_like_table_7_2() -> None:
    """Thermocouple a of both disks in all 16 tests, at the steady state of the drawn rig, within 10 degC."""
    rig = draw_truth(0)
    for condition in PROGRAMME.values():
        drawn = draw_test(rig, condition, 0)
        warm = drawn.ambient_degC + 0.005 * condition.power_W
        for name, share, h, measured in (
            ("fast", drawn.beta, drawn.h_fast_W_m2K, condition.fast_a_degC),
            ("slow", 1 - drawn.beta, drawn.h_slow_W_m2K, condition.slow_a_degC),
        ):
            system = build_system(rig.disk(name), h, drawn.half_width_m, STUDY_MESH)
            power = share * drawn.friction_N * condition.sliding_speed_m_s
            a = (system.sample @ steady_state(system, power, warm))[system.channels.index("a")]
            assert a == pytest.approx(measured, abs=10), f"{condition.name} {name}"


def test_options_fix_what_they_name() -> None:
    rig = draw_truth(4, exponent=0.7)
    drawn = draw_test(
        rig, ehl_test("D4"), 4, EhlOptions(beta=0.68, h_fast_W_m2K=740.0, friction_N=20.0)
    )
    assert (drawn.beta, drawn.h_fast_W_m2K, drawn.friction_N) == (0.68, 740.0, 20.0)
    assert drawn.h_slow_W_m2K == pytest.approx(740.0 / 4.24**0.7, rel=1e-12)


def test_uncertain_rigs_scatter_as_rig_toml_states() -> None:
    rigs = [draw_truth(seed, uncertain=True) for seed in range(300)]
    nominal = draw_truth(0).fast.setup

    def scatter(values: list[float]) -> float:
        return float(np.std(values))

    # 300 draws know a standard deviation to 4 %; three of those.
    near = {"rel": 0.13}
    depth = [r.fast.setup.junctions["e"].depth_m - nominal.junctions["e"].depth_m for r in rigs]
    assert scatter(depth) == pytest.approx(0.1e-3, **near)
    assert scatter([r.fast.setup.conductivity_W_mK / 41 for r in rigs]) == pytest.approx(
        0.03, **near
    )
    assert scatter([r.slow.setup.specific_heat_J_kgK / 470 for r in rigs]) == pytest.approx(
        0.02, **near
    )
    washer = [
        r.fast.setup.washer_conductivity_W_mK / nominal.washer_conductivity_W_mK for r in rigs
    ]
    assert scatter(washer) == pytest.approx(0.2, **near)
    assert scatter([r.half_width_scale for r in rigs]) == pytest.approx(0.03, **near)
    assert scatter([r.friction_scale for r in rigs]) == pytest.approx(0.01, **near)
    exponents = [r.speed_exponent for r in rigs]
    assert min(exponents) >= 0.571
    assert max(exponents) <= 0.8
    assert scatter(exponents) == pytest.approx((0.8 - 0.571) / np.sqrt(12), **near)


@pytest.mark.study
@pytest.mark.parametrize(
    ("test", "fast_a", "slow_a"), [("A1", 85, 73), ("B3", 122, 96), ("D4", 155, 125)]
)
def test_full_length_tests_end_near_the_thesis(test: str, fast_a: float, slow_a: float) -> None:
    for seed in (1, 2):
        _, truth = simulate_ehl(test, seed, options=EhlOptions(mesh=STUDY_MESH))
        assert truth["steady_degC"]["fast_a"] == pytest.approx(fast_a, abs=10)
        assert truth["steady_degC"]["slow_a"] == pytest.approx(slow_a, abs=10)


def test_braked_speeds_fall_to_1_e_and_the_disks_cool_more_slowly() -> None:
    rig = draw_truth(1).with_imperfections(CLEAN)
    kept, braked = (simulate_ehl("B3", 1, rig, replace(SHORT, brake_s=b))[1] for b in (None, 3.0))
    traces = braked["traces"]
    off = braked["unload_s"]
    t = traces["time_s"].to_numpy()
    for column in ("speed_fast_rpm", "speed_slow_rpm"):
        share = traces[column].to_numpy() / traces[column].iloc[0]
        assert (share[t < off] == 1).all()
        assert np.interp(off + 3.0, t, share) == pytest.approx(
            np.exp(-1), abs=1e-5
        )  # straight between samples
    warmer = traces["fast_e_degC"].to_numpy() - kept["traces"]["fast_e_degC"].to_numpy()
    assert np.abs(warmer[t < off]).max() < 1e-9
    assert (np.diff(warmer[t > off + 1.0]) > 0).all()


@pytest.mark.parametrize("film_air_K", [0.0, 7.0])
def test_another_film_in_the_same_system_is_the_system_of_that_film(film_air_K: float) -> None:
    """The iterated stages against a factorisation of the very matrix: equal to the iteration's tolerance."""
    rig = draw_truth(1).with_film_air(film_air_K)
    one, half = (build_system(rig.fast, h, 1.6e-3, STUDY_MESH) for h in (700.0, 350.0))
    start = steady_state(one, 500.0, 60.0)
    level = lambda value: lambda t: np.full_like(t, value)  # noqa: E731
    ends = [
        integrate(system, level(500.0), level(60.0), (0.0, 20.0), start, h_share=level(share)).state
        for system, share in ((one, 0.5), (half, 1.0))
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


def test_a_disk_that_loses_heat_by_its_film_alone_comes_to_the_film_s_own_air() -> None:
    disk = draw_truth(1).with_film_air(7.0).slow
    alone = replace(
        disk, setup=replace(disk.setup, washer_conductivity_W_mK=0.0), bore_conductance_W_m2K=1e-9
    )
    system = build_system(alone, 700.0, 1.6e-3, STUDY_MESH)
    assert system.sample @ steady_state(system, 0.0, 60.0) == pytest.approx(
        67.0, abs=1e-6
    )  # 1e-9 of the film's


def test_disks_that_touch_again_are_heated_and_the_log_shows_it() -> None:
    rig = draw_truth(1).with_imperfections(CLEAN)
    frame, truth = simulate_ehl("B3", 1, rig, replace(SHORT, again_s=((0.2, 1.0), (0.1, 3.0))))
    t = frame["time_s"].to_numpy()
    off = truth["unload_s"]
    for column, level in (("friction_N", truth["friction_N"]), ("load_N", truth["load_N"])):
        # a trapezium of 0.2 s with ramps of 0.01 s, sampled at 75 Hz: to half a sample at each end
        for start, length in ((1.0, 0.2), (3.0, 0.1)):
            near = (t > off + start - 0.1) & (t < off + start + 0.4)
            assert frame[column][near].sum() / 75 == pytest.approx(
                level * (length - 0.01), abs=level / 75
            )
    pulses = np.flatnonzero(np.diff(frame["contact"]) > 0)
    assert t[pulses[1:]] - off == pytest.approx([1.0, 3.0], abs=1 / 75)
