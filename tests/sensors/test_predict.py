"""Prediction of a lag before a sensor is bought: its physics, its uncertainty, and its file."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import ht
import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq
from scipy.special import j0, j1

import tcdyn
from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors import construction, predict_sensor, read_sensor
from tcdyn.sensors.construction import JUNCTION_WORDS, drawn_sensors, eccentric_m2K_W
from tcdyn.sensors.layers import Layer, Responses, layered_responses
from tcdyn.sensors.medium import AIR, FilmPriors, Surroundings, nusselt_cross_flow
from tcdyn.sensors.predict import EXPONENT_U, fastest_Hz
from tcdyn.sensors.surface_h import RHO_C_J_M3K, RHO_C_U_REL, BoundaryLayer
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors import predict_study
from tests.sensors.layered_world import layered

ONE = np.ones(1)
D_M = 3e-3


def sheathed(refine: int, h: float = 8000.0, gap_m: float = 10e-6) -> Responses:
    """A sheathed sensor of 3 mm."""
    layers = [
        Layer(0.25 * D_M / 2 * ONE, 30 * ONE, 3.8e6 * ONE, 3 * refine),
        Layer(0.74 * D_M / 2 * ONE, 2.5 * ONE, 2.7e6 * ONE, 8 * refine, gap_m / 0.03 * ONE),
        Layer(D_M / 2 * ONE, 15 * ONE, 3.9e6 * ONE, 3 * refine),
    ]
    return layered_responses(layers, h * ONE)


def test_a_homogeneous_cylinder_has_the_roots_of_bessel_functions() -> None:
    """x J1(x) = Bi J0(x), tau = R^2 / (a x^2) (Carslaw and Jaeger 1959, section 7.7)."""
    radius_m, k, heat, h = 2e-3, 10.0, 3.5e6, 6000.0
    biot = h * radius_m / k
    root = brentq(lambda x: x * j1(x) - biot * j0(x), 1e-3, 2.4)
    solved = layered_responses([Layer(radius_m * ONE, k * ONE, heat * ONE, 24)], h * ONE)
    assert solved.taus_s.max() == pytest.approx(radius_m**2 * heat / (k * root**2), rel=1e-3)
    # first moment of the mean: rho c R/(2 h) + rho c R^2/(8 k)
    lag_s = heat * radius_m / (2 * h) + heat * radius_m**2 / (8 * k)
    assert solved.lags_s[0] == pytest.approx(lag_s, rel=1e-3)


def test_layers_agree_with_finite_volumes_and_converge_with_second_order() -> None:
    fine = layered(D_M, 0.25, 0.13, 2.5, 8000.0, 10e-6, refine=4)
    solved = sheathed(4)
    assert solved.lags_s[0] == pytest.approx(fine.lag_s, rel=1e-3)
    times_s = [solved.times_s(share)[0] for share in (0.5, 1 - np.exp(-1), 0.9)]
    assert times_s == pytest.approx(fine.times_s(), rel=1e-3)
    lags_s = [sheathed(refine).lags_s[0] for refine in (1, 2, 4)]
    assert (lags_s[0] - lags_s[1]) / (lags_s[1] - lags_s[2]) == pytest.approx(4.0, rel=0.2)
    assert lags_s[0] == pytest.approx(lags_s[2], rel=1e-3)  # the elements that are used


def test_the_film_part_is_that_by_which_the_lag_changes_with_h() -> None:
    first, second = sheathed(2, 500.0), sheathed(2, 1000.0)
    assert first.lags_s - second.lags_s == pytest.approx(first.film_s - second.film_s, rel=1e-6)
    assert (first.taus_s.max(axis=1) >= first.film_s).all()  # a law needs it


def test_the_coefficients_are_those_of_ht() -> None:
    for re, pr in ((120.0, 0.71), (25e3, 4.0), (2e5, 60.0)):
        theirs = ht.conv_external.Nu_cylinder_Churchill_Bernstein(Re=re, Pr=pr)
        assert float(nusselt_cross_flow(re, pr)) == pytest.approx(theirs, rel=1e-9)
    air = AIR.at(26.85)  # Incropera, table A.4, at 300 K
    assert (air.k_W_mK, air.nu_m2_s, air.prandtl) == pytest.approx((26.3e-3, 15.89e-6, 0.707), 0.02)
    hot = AIR.at(726.85)  # at 1000 K
    assert (hot.k_W_mK, hot.nu_m2_s, hot.prandtl) == pytest.approx((66.7e-3, 121.9e-6, 0.726), 0.04)


def test_without_a_flow_natural_convection_is_left_and_a_gas_adds_radiation() -> None:
    still, slow, fast = (Surroundings("air", speed, 500.0) for speed in (0.0, 1e-4, 5.0))
    natural = still.natural_W_m2K(D_M)
    assert still.h_W_m2K(D_M) == pytest.approx(natural + still.radiation_W_m2K())
    assert slow.h_W_m2K(D_M) == pytest.approx(still.h_W_m2K(D_M), rel=0.01)
    assert fast.h_W_m2K(D_M) > 2 * still.h_W_m2K(D_M)
    black = still.radiation_W_m2K(FilmPriors(emissivity=1.0))
    assert black == pytest.approx(4 * 5.670374e-8 * 773.15**3)
    assert Surroundings("water", 0.0).radiation_W_m2K() == 0
    film_degC = 35.0  # half of the 20 K above the air
    ra = 9.80665 * 20 * D_M**3 / 308.15 / float(AIR.nu(np.array(film_degC))) ** 2
    pr = float(AIR.at(film_degC).prandtl)
    theirs = ht.conv_free_immersed.Nu_horizontal_cylinder_Churchill_Chu(pr, ra)
    k = float(AIR.k(np.array(film_degC)))
    assert Surroundings("air", 0.0).natural_W_m2K(D_M) == pytest.approx(theirs * k / D_M, rel=1e-3)


def test_a_well_is_between_centred_and_touching() -> None:
    inner_m, bore_m, k = 3e-3 * ONE, 3.5e-3 * ONE, 0.026 * ONE
    centred = eccentric_m2K_W(inner_m, bore_m, 0 * ONE, k)
    assert centred == pytest.approx(3e-3 * np.log(3.5 / 3) / 0.026)
    assert eccentric_m2K_W(inner_m, bore_m, 0.97 * ONE, k)[0] < 0.3 * centred[0]
    bare = predict_sensor(6.0, "water", speed_m_s=0.4).lag_s.value
    lags_s = [
        predict_sensor(6.0, "water", speed_m_s=0.4, well_mm=10.0, well_filling=each).lag_s.value
        for each in ("paste", "oil", "air")
    ]
    assert bare < lags_s[0] < lags_s[1] < lags_s[2]


@pytest.mark.parametrize("junction", JUNCTION_WORDS)
def test_the_uncertainty_is_at_most_40_per_cent(junction: str) -> None:
    for medium, speed, T in (("water", 0.4, 25.0), ("air", 2.0, 25.0), ("oil", 0.2, 60.0)):
        for d in (0.5, 3.0, 8.0):
            probe = predict_sensor(d, medium, junction=junction, speed_m_s=speed, T_degC=T)
            for each in (probe.lag_s, *probe.times["*"].values()):
                assert 0.1 < each.u / each.value <= 0.4
                assert each.low95 < each.value < each.high95
            assert probe.fit["U_lag_s"] == pytest.approx(2 * probe.lag_s.u)


def test_more_samples_change_little(monkeypatch: pytest.MonkeyPatch) -> None:
    few = predict_sensor(3.0, "water", speed_m_s=0.4).lag_s
    again = predict_sensor(3.0, "water", speed_m_s=0.4).lag_s
    monkeypatch.setattr(construction, "SAMPLES", 4096)
    many = predict_sensor(3.0, "water", speed_m_s=0.4).lag_s
    assert few == again
    assert (few.value, few.u) == pytest.approx((many.value, many.u), rel=0.03)


def test_the_heat_capacity_of_the_conversion_is_that_of_the_priors() -> None:
    drawn = drawn_sensors(3.0, "insulated", Surroundings("water", 0.4), 0.03)
    heat = drawn.responses.film_s * drawn.h_W_m2K * 4 / drawn.surface_m
    assert heat.mean() == pytest.approx(RHO_C_J_M3K, rel=0.02)
    assert heat.std() / heat.mean() == pytest.approx(RHO_C_U_REL, rel=0.1)


def test_the_law_has_the_local_slope_and_a_film_that_the_chain_can_have() -> None:
    probe = predict_sensor(3.0, "air", speed_m_s=2.0)
    assert probe.law is not None
    (chain,) = probe.chains
    assert probe.law.first_lag_s(chain, probe.law.factor([2.0])) == pytest.approx(chain.lag_s)
    for speed in (0.5, 1.0, 4.0, 8.0):
        lag_s = chain.lag_s * float(probe.law.factor(speed))
        there = predict_sensor(3.0, "air", speed_m_s=speed).lag_s.value
        assert lag_s == pytest.approx(there, rel=0.08)
    assert predict_sensor(3.0, "air").law is None


def test_the_exponent_is_within_its_uncertainty_of_hilpert_s() -> None:
    reynolds = np.geomspace(50, 3e4, 40)
    own = np.gradient(np.log(nusselt_cross_flow(reynolds, 0.71)), np.log(reynolds))
    hilpert = np.where(reynolds < 4000, 0.466, 0.618)
    assert np.sqrt(np.mean((own - hilpert) ** 2)) == pytest.approx(EXPONENT_U, abs=0.02)


def test_ramp_frequency_and_fastest_change_follow_from_one_lag() -> None:
    """An exposed junction is one lag: |G| = 1/sqrt(1 + (w tau)^2), phase -arctan(w tau)."""
    probe = predict_sensor(
        3.0, "water", junction="exposed", speed_m_s=0.4, ramp_K_s=-10.0, at_Hz=2.0
    )
    lag_s = probe.lag_s.value
    assert Estimate(**probe.fit["ramp_error_K"]).value == pytest.approx(10 * lag_s)
    turn = 4 * np.pi * lag_s
    amplitude = Estimate(**probe.fit["amplitude_share"])
    assert amplitude.value == pytest.approx((1 + turn**2) ** -0.5, rel=0.05)
    phase_deg = Estimate(**probe.fit["phase_deg"]).value
    assert phase_deg == pytest.approx(-np.degrees(np.arctan(turn)), rel=0.05)


def test_the_noise_of_the_inverse_up_to_the_fastest_change_is_the_accuracy() -> None:
    """2 s^2 dt (f + (2 pi tau)^2 f^3 / 3) = accuracy^2 for one lag; and as simulated."""
    tau_s, noise_K, row_s = 2.0, 0.05, 0.1
    one_lag = Responses(np.full((1, 1), tau_s), np.ones((1, 1)), np.zeros(1))
    (f,) = fastest_Hz(one_lag, noise_K, row_s, noise_K)
    variance = 2 * noise_K**2 * row_s * (f + (2 * np.pi * tau_s) ** 2 * f**3 / 3)
    assert variance == pytest.approx(noise_K**2, rel=0.01)
    noise = noise_K * np.random.default_rng(3).standard_normal(2**16)
    spectrum = np.fft.rfft(noise)
    grid = np.fft.rfftfreq(len(noise), row_s)
    inverse = np.where(grid <= f, 1 / np.abs(Chain(tau_s).frequency_response(grid)), 0.0)
    inverted = np.fft.irfft(spectrum * inverse)
    assert np.std(inverted) == pytest.approx(noise_K, rel=0.05)
    assert fastest_Hz(one_lag, noise_K, row_s, 1e6)[0] == pytest.approx(0.5 / row_s)


def test_tables_of_makers_are_inside_nine_times_in_ten_and_the_wrong_speed_never() -> None:
    required = predict_study.sab_entries("insulated", predict_study.SAB_SIZES_MM)
    entries = [*required, *predict_study.other_entries()]
    inside = [entry.is_inside for entry in entries]
    assert len(entries) == 34
    assert np.mean(inside) >= 0.9
    assert max(entry.predicted.u / entry.predicted.value for entry in entries) <= 0.4
    slow = predict_study.sab_entries("insulated", predict_study.SAB_SIZES_MM, "0.2")
    assert [e.is_inside for e in slow if e.medium == "air"] == 6 * [False]


def air_of_dip(lag_s: float, h_air: float, h_water: float) -> float:
    """Lag in air by the formula."""
    return lag_s + RHO_C_J_M3K * D_M / 4 * (1 / h_air - 1 / h_water)


def dip() -> tuple[Array, Array]:
    """A dip of 1.2 and 0.2 s in 60 K."""
    t = 0.02 * np.arange(1000)
    bath = np.where(t < 4.01, 20.0, 80.0)
    noise = np.random.default_rng(1).normal(0, 0.05, len(t))
    return t, Chain([1.2, 0.2]).response(bath, 0.02, hold="zoh") + noise


@pytest.mark.e2e
def test_a_dip_in_water_gives_lag_and_times_in_air() -> None:
    probe = tcdyn.sensor_from_dip(
        dip(), medium="water", diameter_mm=3, speed_m_s=0.4, to_medium="air", to_speed_m_s="2+-0.1"
    )
    there = Estimate(**probe.fit["to_lag_s"])
    h_air = float(Surroundings("air", 2.0).h_W_m2K(D_M))
    h_water = BoundaryLayer("water", D_M, 0.4).stream.h_W_m2K(D_M)
    own = Estimate(**probe.fit["lag_s"]).value
    assert there.value == pytest.approx(air_of_dip(own, h_air, h_water), rel=1e-6)
    assert 0.1 < there.u / there.value < 0.25
    times_s = [Estimate(**probe.fit[f"to_{key}"]) for key in ("t50_s", "t632_s", "t90_s")]
    for time, share in zip(times_s, (0.5, 1 - np.exp(-1), 0.9)):  # nearly one lag
        assert time.value == pytest.approx(-np.log(1 - share) * there.value, rel=0.03)
        assert time.u >= there.u * time.value / there.value * 0.99
    same = BoundaryLayer("water", D_M, 0.4).in_other(
        there, dict.fromkeys(("t90_s",), times_s[2]), Surroundings("water", 0.4), 0.0
    )
    assert Estimate(**same["to_lag_s"]).value == pytest.approx(there.value, rel=0.02)  # type: ignore[arg-type]


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"to_medium": "air"}, "to_speed_m_s go together"),
        ({"to_speed_m_s": 2}, "to_speed_m_s go together"),
        ({"medium": "water", "diameter_mm": 3, "to_medium": "mud", "to_speed_m_s": 2}, "mud"),
        ({"medium": "air", "diameter_mm": 8, "to_medium": "water", "to_speed_m_s": 1}, "its film"),
    ],
)
def test_a_stream_that_is_not_possible_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        tcdyn.sensor_from_dip(dip(), **options)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((3.0, "mud"), {}, "medium is 'mud'"),
        ((0.0, "air"), {}, "diameter_mm is 0"),
        ((3.0, "air"), {"speed_m_s": -1}, "speed_m_s is -1"),
        ((3.0, "air"), {"speed_m_s": 400}, "0 to 200 m/s"),
        ((3.0, "air"), {"junction": "tip"}, "insulated or grounded or exposed"),
        ((3.0, "air"), {"well_bore_mm": 4}, "well_bore_mm without well_mm"),
        ((3.0, "air"), {"well_mm": 3}, "well_mm is 3"),
        ((3.0, "air"), {"well_mm": 6, "well_bore_mm": 2}, "well_bore_mm is 2"),
        ((3.0, "air"), {"well_mm": 6, "junction": "exposed"}, "exposed junction in a well"),
        ((3.0, "air"), {"noise_K": 0.1}, "noise_K without every_s"),
        ((3.0, "air"), {"T_degC": 5000.0}, "T_degC is 5000"),
    ],
)
def test_what_is_not_possible_is_refused(
    arguments: tuple[float, str], options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        predict_sensor(*arguments, **options)


def test_warnings_name_what_the_prediction_does_not_cover() -> None:
    def codes(*arguments: object, **options: object) -> list[str]:
        return [f.code for f in predict_sensor(*arguments, **options).findings]  # type: ignore[arg-type]

    assert codes(3.0, "water", speed_m_s=0.4) == []
    assert codes(3.0, "water", speed_m_s=0.4, T_degC=150) == ["predict.no_liquid"]
    assert codes(3.0, "oil", speed_m_s=0.4, T_degC=300) == ["fluid.extrapolated"]
    assert codes(3.0, "air", speed_m_s=2, junction="exposed") == ["predict.exposed"]
    assert codes(3.0, "water", speed_m_s=0.4, junction="exposed") == []
    assert codes(8.0, "water", speed_m_s=2, junction="grounded") == ["predict.rough"]


def test_a_table_of_properties_is_a_medium(tmp_path: Path) -> None:
    path = tmp_path / "glycol.csv"
    path.write_text(
        "T_degC,rho_kg_m3,c_J_kgK,k_W_mK,nu_m2_s\n0,1070,3300,0.4,8e-6\n80,1030,3600,0.42,1e-6\n"
    )
    glycol = predict_sensor(3.0, str(path), speed_m_s=0.4).lag_s.value
    water = predict_sensor(3.0, "water", speed_m_s=0.4).lag_s.value
    assert water < glycol < 2 * water


def test_the_command_writes_a_file_that_compensate_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "probe.sensor.json"
    words = "sensor predict --diameter-mm 3 --junction insulated --medium air --speed-m-s 2 "
    words += f"--ramp 5 --at-Hz 0.01 --noise-K 0.05 --every-s 1 --out {out}"
    assert run_cli(*words.split()) == 0
    assert "ramp_error_K" in capsys.readouterr().out
    probe = read_sensor(out)
    assert (probe.method, probe.law is not None) == ("stated", True)
    assert json.loads(out.read_text())["fit"]["junction"] == "insulated"
    t = np.arange(400.0)
    flow = np.where(t < 200, 2.0, 6.0)
    lag_s = probe.lag_s.value
    reading = Chain(lag_s).response(50 + 10 * np.sin(t / 40), 1.0, initial="equilibrium")
    reading += np.random.default_rng(2).normal(0, 0.05, len(t))
    table = pd.DataFrame({"time_s": t, "T1_degC": reading, "speed_m_s": flow})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the lag does not follow the flow in this record
        done = tcdyn.compensate_frame(table, probe)
    assert "T1_u_K" in done
    assert "speed_m_s" in done


@pytest.mark.parametrize(("T_degC", "speed"), [(1000.0, 10.0), (400.0, 10.0), (25.0, 0.2)])
def test_the_law_is_that_of_a_prediction_at_another_speed(T_degC: float, speed: float) -> None:
    """Radiation adds to h, and natural convection replaces the flow: no power of the speed."""
    here = predict_sensor(3.0, "air", speed_m_s=2.0, T_degC=T_degC)
    there = predict_sensor(3.0, "air", speed_m_s=speed, T_degC=T_degC)
    assert here.law is not None
    ratio = there.lag_s.value / here.lag_s.value
    assert float(here.law.factor(speed)) == pytest.approx(ratio, rel=0.05)


def test_water_at_rest_near_its_largest_density_is_no_special_case() -> None:
    lags_s = [predict_sensor(3.0, "water", T_degC=T).lag_s.value for T in (2.0, 3.98, 6.0)]
    assert lags_s == sorted(lags_s, reverse=True)
    assert lags_s[0] < 1.2 * lags_s[-1]


@pytest.mark.parametrize(("medium", "T_degC"), [("water", 500.0), ("oil", 1000.0)])
def test_a_liquid_far_beyond_its_properties_is_refused(medium: str, T_degC: float) -> None:
    with pytest.raises(InputError, match="T_degC"):
        predict_sensor(3.0, medium, speed_m_s=1.0, T_degC=T_degC)


def test_the_name_of_a_medium_may_be_in_capitals() -> None:
    named = predict_sensor(3.0, "Oil", speed_m_s=0.4).lag_s
    assert named == predict_sensor(3.0, "oil", speed_m_s=0.4).lag_s


def test_a_still_medium_and_an_unusual_diameter_are_told() -> None:
    """An inch typed as millimetres, and a speed that was forgotten."""
    codes = {f.code for f in predict_sensor(0.125, "water", speed_m_s="1").findings}
    assert "predict.size" in codes
    assert "predict.still" not in codes
    still = predict_sensor(3.0, "air")
    assert [f.sentence for f in still.findings if f.code == "predict.still"]
    assert "predict.size" not in {f.code for f in still.findings}
