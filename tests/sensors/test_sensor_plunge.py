"""A bare sensor plunged by code of its own: nobody knows when, and the surroundings step with a lag
of their own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors import read_sensor
from tcdyn.sensors.plunge import _radiation_findings, plunge_sensor
from tcdyn.sensors.step import find_step
from tcdyn.sensors.step_fits import residual_noise, white_noise_K
from tcdyn.sensors.step_structures import Junction
from tcdyn.sensors.surface_h import (
    RHO_C_J_M3K,
    RHO_C_U_REL,
    STREAMS,
    U_REL,
    BoundaryLayer,
    Stream,
)
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.layered_world import MEDIA, drawn, plunge_record
from tests.sensors.sensor_world import FINE, Array, lagged, write


def plunged(
    taus_s: tuple[float, ...],
    dt_s: float,
    n: int,
    noise_K: float,
    seed: int,
    medium_s: float | None = None,
) -> tuple[Array, Array, float]:
    """Time, reading and the entry [s]; the medium's own lag is drawn from 0.02 +- 0.02 s unless
    told."""
    rng = np.random.default_rng(seed)
    fine = np.arange(n * FINE) * (dt_s / FINE)
    entry = n * dt_s / 6 + rng.uniform(0, dt_s)
    own = abs(0.02 + 0.02 * rng.standard_normal()) if medium_s is None else medium_s
    x = np.where(fine < entry, 20.0, 90.0)
    return (
        fine[::FINE],
        lagged(x, (own, *taus_s), dt_s / FINE)[::FINE] + noise_K * rng.standard_normal(n),
        entry,
    )


def truth(taus_s: tuple[float, ...]) -> list[float]:
    """Lag, t50, t63.2, t90 [s] on a fine grid."""
    t = np.arange(0, 12 * sum(taus_s), 1e-3 * sum(taus_s))
    step = lagged(np.r_[0.0, np.ones(len(t) - 1)], taus_s, float(t[1]))
    return [sum(taus_s), *(float(np.interp(q, step, t)) for q in (0.5, 1 - np.exp(-1), 0.9))]


@pytest.mark.parametrize(("noise_K", "down"), [(0.02, False), (0.2, False), (0.2, True)])
def test_a_step_begins_where_the_reading_leaves_its_noise(noise_K: float, down: bool) -> None:
    _, y, entry = plunged((1.5,), 0.05, 500, noise_K, 0, 0.01)
    step = find_step(110.0 - y if down else y, 0.05)
    assert entry - 0.2 < step.entry_s < entry + 0.3
    assert step.before_degC == pytest.approx(90.0 if down else 20.0, abs=0.1)
    assert step.size_K == pytest.approx(-70.0 if down else 70.0, abs=0.2)
    assert step.rise_s == pytest.approx(1.5, abs=0.3)


def baths(changes: tuple[tuple[float, float], ...], noise_K: float) -> tuple[Array, Array]:
    """Time and reading of lags of 1.5 and 0.3 s that move to the bath of each (instant [s],
    degC)."""
    fine = np.arange(500 * FINE) * (0.05 / FINE)
    x = np.full(len(fine), 20.0)
    for instant_s, temperature in changes:
        x[fine >= instant_s] = temperature
    noise = noise_K * np.random.default_rng(1).standard_normal(500)
    return fine[::FINE], lagged(x, (0.02, 1.5, 0.3), 0.05 / FINE)[::FINE] + noise


@pytest.mark.parametrize("noise_K", [0.02, 2.0])
@pytest.mark.parametrize(
    ("changes", "entry_s", "size_K"),
    [
        (((4.02, 90.0), (16.3, 20.0)), 4.02, 70.0),  # taken out again
        (((4.02, 90.0), (12.3, 30.0)), 4.02, 70.0),
        (((2.02, 300.0), (17.3, 20.0)), 2.02, 280.0),
        (((4.02, 90.0), (12.3, 20.0), (18.0, 90.0)), 4.02, 70.0),  # two dips in one record
    ],
)
def test_the_step_is_the_first_of_several_and_ends_before_the_next(
    changes: tuple[tuple[float, float], ...], entry_s: float, size_K: float, noise_K: float
) -> None:
    _, y = baths(changes, noise_K)
    step = find_step(y, 0.05)
    assert step.entry_s == pytest.approx(entry_s, abs=0.5)
    assert step.size_K == pytest.approx(size_K, abs=3.0)
    assert step.has_next_event
    assert 0.05 * step.last == pytest.approx(changes[1][0], abs=0.6)


@pytest.mark.e2e
def test_a_sensor_that_is_taken_out_again_and_outliers_do_not_hide_the_step() -> None:
    t, y = baths(((4.02, 90.0), (16.3, 20.0)), 0.1)
    y[[30, 140]] += [400.0, -40.0]
    made = plunge_sensor(t, y, "T1")
    numbers = {f.code: f.numbers for f in made.findings}
    assert numbers["sensor.spikes"]["count"] == 2
    assert numbers["sensor.next_event"]["time_s"] == pytest.approx(16.3, abs=0.2)
    assert made.chain.channels["T1"].lag_s.value == pytest.approx(1.8, rel=0.12)


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("splash_s", [0.1, 0.3])
def test_a_splash_before_the_step_is_not_taken_for_it(splash_s: float) -> None:
    """The slope of the splash is that of the step; the sensor settles again in 8 s."""
    t, y = baths(((2.02, 90.0), (2.02 + splash_s, 20.0), (10.02, 90.0)), 0.05)
    step = find_step(y, 0.05)
    assert step.entry_s == pytest.approx(10.02, abs=0.2)
    assert step.size_K == pytest.approx(70.0, abs=1.0)
    made = plunge_sensor(t, y, "T1")
    alone = plunge_sensor(*baths(((10.02, 90.0),), 0.05), "T1").chain.channels["T1"].lag_s
    lag = made.chain.channels["T1"].lag_s
    assert abs(lag.value - alone.value) < 2.5 * lag.u
    codes = {f.code for f in made.findings}
    assert codes & {"sensor.earlier_event", "sensor.misfit"}


@pytest.mark.e2e
def test_a_lag_that_changes_within_the_dip_is_that_at_its_end() -> None:
    """A bead whose surface h rises by 30 % with its temperature: the lag falls to 1.1 / 1.3 s.

    Its film follows the temperature, not the time, so that the interval is too narrow.
    """
    dt_s, step_s = 0.02, 0.002
    t = dt_s * np.arange(1500)
    z, reached = 0.0, []
    for fine_s in step_s * np.arange(1500 * 10):
        if fine_s > 5.03:
            z += step_s * (1 - z) * (1 + 0.3 * z) / 1.1
        reached.append(z)
    share = np.array(reached)[::10]
    y = 22 + 63 * share + 0.03 * np.random.default_rng(1).standard_normal(len(t))
    made = plunge_sensor(t, y, "T1")
    t90_s = float(np.interp(0.9, share, t)) - 5.03
    assert made.times["T1"]["t90_s"].contains(t90_s)
    lag = made.chain.channels["T1"].lag_s
    assert lag.value == pytest.approx(1.1 / 1.3, rel=0.03)


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("hum_K", [0.5, 2.0])
def test_hum_of_the_mains_does_not_end_the_step(hum_K: float) -> None:
    """At 1 kHz the hum is much larger than the differences between rows."""
    t, y, _ = plunged((1.0,), 0.001, 12_000, 0.05, 3)
    made = plunge_sensor(t, y + hum_K * np.sin(2 * np.pi * 50 * t + 1), "T1")
    lag = made.chain.channels["T1"].lag_s
    assert abs(lag.value - 1.0) < 2.5 * lag.u
    assert lag.u < 0.05


def test_a_step_into_a_furnace_is_a_warning_and_one_into_water_is_not() -> None:
    for last_degC, warns in ((900.0, True), (350.0, True), (100.0, False)):
        codes = [f.code for f in _radiation_findings("T", 20.0, last_degC)]
        assert codes == ["sensor.radiation"] * warns, last_degC
    assert _radiation_findings("T", 900.0, 20.0)  # taken out
    assert not _radiation_findings("T", 880.0, 900.0)  # a small step
    (found,) = _radiation_findings("T", 20.0, 900.0)
    assert found.numbers["ratio"] == pytest.approx(3.01, abs=0.01)


def test_noise_is_not_estimated_across_gaps() -> None:
    """Blocks of six rows every 90 rows, on an oscillation; or each tenth row of noise alone."""
    t = np.arange(9000)
    y = 10 * np.sin(2 * np.pi * t / 300) + 0.1 * np.random.default_rng(0).standard_normal(len(t))
    y[t % 90 >= 9] = np.nan
    y[t % 9 >= 6] = np.nan
    assert white_noise_K(y) == pytest.approx(0.1, rel=0.15)
    every_tenth = np.where(
        t % 10 == 0, 0.1 * np.random.default_rng(0).standard_normal(9000), np.nan
    )
    assert white_noise_K(every_tenth) == pytest.approx(0.1, rel=0.15)


@pytest.mark.e2e
def test_an_entry_may_be_on_the_unix_clock(tmp_path: Path) -> None:
    t, y, entry = plunged((1.5, 0.3), 0.05, 500, 0.1, 4)
    start_s = 1_764_000_000.0
    log = write(tmp_path / "dip.csv", time_s=start_s + np.round(t, 3), T1_degC=y)
    out = tmp_path / "p.sensor.json"
    words = ("sensor", "plunge", log, "--column", "T1", "--out", out)
    assert run_cli(*words, "--entry-s", f"{start_s + entry:.3f}+-0.01") == 0
    assert read_sensor(out).fit["entry_s"] == pytest.approx(start_s + entry, abs=0.1)


@pytest.mark.parametrize(
    "words",
    [
        ("plunge", "--column", "T1", "--poles", "3"),
        ("plunge", "--column", "T1", "--shape", "butterworth"),
        ("pair", "--column", "T1", "--exponent", "0.5+-0.1", "--column", "T2"),
    ],
)
def test_an_option_that_would_have_no_effect_is_refused(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t, y, _ = plunged((1.5, 0.3), 0.05, 500, 0.1, 4)
    log = write(tmp_path / "dip.csv", time_s=np.round(t, 3), T1_degC=y, T2_degC=y)
    assert run_cli("sensor", words[0], log, *words[1:]) == 2
    assert f"{words[3]} is given without" in capsys.readouterr().err


@pytest.mark.study
@pytest.mark.parametrize(
    ("taus_s", "dt_s", "n", "noise_K"),
    [((1.5, 0.3), 0.05, 500, 0.1), ((1.5,), 0.05, 500, 0.1), ((0.3, 0.05), 0.01, 600, 0.2)],
)
def test_lag_and_percent_times_lie_in_their_intervals(
    taus_s: tuple[float, ...], dt_s: float, n: int, noise_K: float
) -> None:
    """Three plunges each; 200 a case are in `python -m tests.sensors.sensor_study plunge`."""
    held = []
    for seed in range(3):
        t, y, entry = plunged(taus_s, dt_s, n, noise_K, seed)
        made = plunge_sensor(t, y, "T1")
        got = [Estimate(**made.fit["lag_s"]), *made.times["T1"].values()]
        held += [e.contains(v) for e, v in zip(got, truth(taus_s))]
        assert all(abs(e.value / v - 1) < 0.2 for e, v in zip(got, truth(taus_s)))
        assert abs(made.fit["entry_s"] - entry) < 0.15 * sum(taus_s)
    assert np.mean(held) > 0.7


@pytest.mark.e2e
def test_a_known_entry_narrows_the_lag_and_a_slow_medium_is_no_part_of_it() -> None:
    t, y, entry = plunged((1.5, 0.1), 0.02, 800, 0.2, 1, medium_s=0.2)
    known = plunge_sensor(t, y, "T1", medium_s=(0.2, 0.02), entry_s=(entry, 0.001))
    lag = known.chain.channels["T1"].lag_s
    assert abs(lag.value - 1.6) < 3 * lag.u < 0.15  # 0.02 s of the medium's is left
    wrong = plunge_sensor(t, y, "T1", medium_s=(0.0, 1e-3), entry_s=(entry, 0.001))
    assert wrong.chain.channels["T1"].lag_s.value > 1.75  # the medium's lag taken for the sensor's


def test_a_response_before_the_specified_entry_is_a_warning_with_both_instants() -> None:
    """No dead time explains a specified instant that is 3 s late: 10 times its standard
    uncertainty."""
    t, y, entry = plunged((4.0, 0.5), 0.1, 600, 0.1, 5)
    made = plunge_sensor(t, y, "T1", entry_s=(entry + 3.0, 0.3))
    (conflict,) = [f for f in made.findings if f.code == "sensor.entry_conflict"]
    assert conflict.severity.value == "warning"
    assert conflict.numbers["specified_s"] == pytest.approx(entry + 3.0)
    assert conflict.numbers["fitted_s"] < entry + 2.1


@pytest.mark.e2e
@pytest.mark.parametrize("specified_u_s", [0.02, 0.3])
def test_a_dead_time_after_the_specified_entry_is_part_of_the_times_and_a_warning(
    specified_u_s: float,
) -> None:
    """Nothing moves for 3 s after the entry; the clock may also be wrong, which the message
    says."""
    t, y, entry = plunged((4.0,), 0.1, 600, 0.1, 5)
    made = plunge_sensor(t, y, "T1", entry_s=(entry - 3.0, specified_u_s))
    (finding,) = [f for f in made.findings if f.severity.value == "warning"]
    assert finding.code == "sensor.dead_time"
    assert "If the specified instant is wrong" in finding.sentence
    t63 = made.times["T1"]["t632_s"]
    assert abs(t63.value - 7.0) < 3 * t63.u < 1.2
    assert made.chain.channels["T1"].delay_s == pytest.approx(3.0, abs=3 * specified_u_s + 0.1)


def two_paths(share: float, slow_s: float, drift_K: float, seed: int, last_s: float) -> Array:
    """Time and reading of 2 s with a second path beside it, in closed form, in a bath that drifts
    (2, N)."""
    t = np.arange(0, last_s, 0.05)
    since = np.clip(t - 6.013, 0, None)
    response = 1 - (1 - share) * np.exp(-since / 2.0) - share * np.exp(-since / slow_s)
    noise = 0.05 * np.random.default_rng(seed).standard_normal(len(t))
    return np.array([t, 20 + 60 * response + drift_K * t / last_s + noise])


@pytest.mark.e2e
@pytest.mark.parametrize(("share", "slow_s", "drift_K"), [(0.05, 20.0, 0.0), (0.2, 8.0, 1.0)])
def test_a_slow_second_heat_path_is_part_of_t90(
    share: float, slow_s: float, drift_K: float
) -> None:
    """The record lasts five of its time constants; a drift of the bath is not taken for it."""
    t, y = two_paths(share, slow_s, drift_K, 3, 6 + 5 * slow_s)
    made = plunge_sensor(t, y, "T1")
    (path,) = [f for f in made.findings if f.code == "sensor.slow_path"]
    assert path.numbers["percent"] == pytest.approx(100 * share, rel=0.1)
    fine = np.linspace(0, 10 * slow_s, 200_001)
    rise = 1 - (1 - share) * np.exp(-fine / 2.0) - share * np.exp(-fine / slow_s)
    t90 = made.times["T1"]["t90_s"]
    assert t90.contains(float(np.interp(0.9, rise, fine)))
    assert t90.u < 0.03 * t90.value


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("drift_K", [-1.0, 0.0, 1.0])
def test_a_drift_of_the_bath_is_no_second_path(drift_K: float) -> None:
    for seed in range(4):
        t, y = two_paths(0.0, 1.0, drift_K, seed, 60.0)
        made = plunge_sensor(t, y, "T1")
        assert not made.fit.get("slow_share")
        assert made.times["T1"]["t90_s"].value == pytest.approx(2 * np.log(10), rel=0.05)


@pytest.mark.e2e
def test_a_second_event_ends_the_record() -> None:
    """The sensor is taken out after 60 s: the part before it gives the lag."""
    t, y = two_paths(0.0, 1.0, 0.0, 1, 90.0)
    y = np.where(t < 60, y, 80 - 40 * (1 - np.exp(-np.clip(t - 60, 0, None) / 5.0)))
    lag = plunge_sensor(t, y, "T1").chain.channels["T1"].lag_s
    assert abs(lag.value - 2.0) < 3 * lag.u < 0.2


@pytest.mark.e2e
def test_a_lag_as_short_as_the_medium_s_is_a_warning() -> None:
    t, y, _ = plunged((0.03,), 0.005, 400, 0.1, 1, medium_s=0.06)
    made = plunge_sensor(t, y, "T1")
    assert "sensor.medium" in {f.code for f in made.findings}


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("medium", list(MEDIA))
@pytest.mark.parametrize("known", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("junction", ["insulated", "grounded"])
def test_the_times_of_layered_sensors_lie_in_their_intervals(
    medium: str, known: bool, junction: Junction
) -> None:
    """Six sensors each; many are in `python -m tests.sensors.layered_study plunge` and `sheath`."""
    held = []
    for seed in range(6):
        rng = np.random.default_rng(7000 + seed)
        sensor = drawn(rng, medium, at_sheath=junction == "grounded")
        record = plunge_record(sensor, rng, entry_known=known)
        made = plunge_sensor(
            record.time_s, record.y_degC, "T1", entry_s=record.entry_s, junction=junction
        )
        got = [Estimate(**made.fit["lag_s"]), *made.times["T1"].values()]
        held += [e.contains(v) for e, v in zip(got, sensor.truth())]
    # a junction at the sheath in water is read through several paths at once
    assert np.mean(held) >= (0.66 if junction == "insulated" else 0.45)


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("specified_u_s", [0.0, 0.001, 0.02, 0.2])
def test_a_specified_entry_that_is_right_is_no_warning(specified_u_s: float) -> None:
    """Off by its own standard uncertainty at most; a medium as specified."""
    for seed in range(3):
        t, y, entry = plunged((1.5, 0.3), 0.05, 500, 0.1, seed)
        off = specified_u_s * (seed - 1)
        made = plunge_sensor(t, y, "T1", entry_s=(entry + off, specified_u_s))
        assert "sensor.entry_conflict" not in {f.code for f in made.findings}


@pytest.mark.e2e
@pytest.mark.parametrize(("dt_s", "slow"), [(0.05, False), (1.7, True)])
def test_rows_slower_than_the_lag_are_a_warning(dt_s: float, slow: bool) -> None:
    t, y, _ = plunged((1.5,), dt_s, 500, 0.05, 4)
    made = plunge_sensor(t, y, "T1")
    assert ("sensor.slow" in {f.code for f in made.findings}) == slow


def test_rows_much_slower_than_the_lag_are_a_warning() -> None:
    t, y, _ = plunged((1.5,), 4.0, 500, 0.05, 4)
    made = plunge_sensor(t, y, "T1")
    assert made.chain.channels["T1"].lag_s.contains(1.5)
    assert "sensor.slow" in {f.code for f in made.findings}


def test_a_record_that_begins_after_the_entry_is_a_warning() -> None:
    t, y, entry = plunged((1.5,), 0.05, 500, 0.05, 4)
    late = int((entry + 0.3) / 0.05)
    made = plunge_sensor(t[late:], y[late:], "T1")
    assert "sensor.no_rows_before" in {f.code for f in made.findings}


@pytest.mark.e2e
def test_an_exact_entry_that_is_too_late_is_a_warning() -> None:
    t, y, entry = plunged((1.5, 0.2), 0.05, 500, 0.05, 4)
    made = plunge_sensor(t, y, "T1", entry_s=(entry + 0.15, 0.0))
    assert "sensor.entry_conflict" in {f.code for f in made.findings}


@pytest.mark.e2e
def test_a_slow_path_that_has_not_settled_is_a_warning() -> None:
    """3 % of the step with 100 s in a record of 60 s."""
    t, y = two_paths(0.03, 100.0, 0.0, 3, 60.0)
    made = plunge_sensor(t, y, "T1")
    assert {f.code for f in made.findings} & {"sensor.slow_or_drift", "sensor.cut_off"}


def test_a_small_step_at_a_high_temperature_begins_where_it_does() -> None:
    """Its limit is a share of the change, and not of the temperature."""
    t = 0.05 * np.arange(1200)
    noise = np.random.default_rng(0).normal(0, 0.002, len(t))
    y = 900 + 4 * (1 - np.exp(-np.maximum(t - 10, 0) / 2)) + noise
    assert abs(find_step(y, 0.05).entry_s - 10) < 0.15


def test_no_step_a_step_that_is_cut_off_and_few_samples_are_refused() -> None:
    t, y, _ = plunged((1.5,), 0.05, 500, 0.1, 2)
    with pytest.raises(InputError, match="no step"):
        plunge_sensor(t, 20 + 0.1 * np.random.default_rng(0).standard_normal(500), "T1")
    with pytest.raises(InputError, match="not over"):
        plunge_sensor(t[:105], y[:105], "T1")
    with pytest.raises(InputError, match="samples"):
        plunge_sensor(t[:20], y[:20], "T1")
    with pytest.raises(InputError, match="only 0 samples"):
        plunge_sensor(t, np.full(len(t), np.nan), "T1")


@pytest.mark.study
def test_what_is_no_chain_of_lags_is_told() -> None:
    t, y, _ = plunged((1.5,), 0.05, 500, 0.05, 3)
    made = plunge_sensor(t, y + 8 * np.exp(-(((t - 9) / 0.8) ** 2)), "T1")
    assert "sensor.misfit" in {f.code for f in made.findings}


def test_h_across_a_stream_agrees_with_hilpert_s_numbers_and_the_film_moves_the_lag() -> None:
    """Hilpert's table, Nu = C Re^m Pr^(1/3): 0.683 Re^0.466 for 40 < Re < 4000; the two fits differ
    by up to 20 %."""
    for name, d in (("water", 3e-3), ("air", 3e-3), ("air", 6e-3)):
        s = STREAMS[name]
        re = s.speed_m_s * d / s.nu_m2_s
        assert 40 < re < 4000
        assert s.h_W_m2K(d) == pytest.approx(
            0.683 * re**0.466 * s.prandtl ** (1 / 3) * s.k_W_mK / d, rel=0.2
        )
    fit = BoundaryLayer("water", 3e-3).to_fit(Estimate.normal(2.0, 0.05))
    assert isinstance(fit["lag_air_s"], dict)
    assert 15 < fit["lag_air_s"]["value"] < 35  # 3 mm: rho c d/4 = 2400 J/m2K over h of 105 W/m2K
    with pytest.raises(InputError, match="water or air"):
        BoundaryLayer("oil", 3e-3)


@pytest.mark.parametrize(("medium", "speed"), [("water", 0.1), ("air", 20.0), ("air", None)])
def test_the_uncertainty_in_another_stream_is_that_of_its_four_sources(
    medium: str, speed: float | None
) -> None:
    """Each moved by a thousandth of its uncertainty in lag + rho c d/4 (1/h' - 1/h)."""
    film, lag = BoundaryLayer(medium, 3e-3, speed), Estimate.normal(2.0, 0.05)
    own = film.stream
    assert (own.k_W_mK, own.speed_m_s) == (STREAMS[medium].k_W_mK, speed or 3.0)
    fit = film.to_fit(lag)
    best = np.array([own.h_W_m2K(3e-3), 0.0, RHO_C_J_M3K, 2.0])
    told = 0
    for name, stream in STREAMS.items():
        if name == medium and speed is None:
            assert f"lag_{name}_s" not in fit
            continue
        best[1] = stream.h_W_m2K(3e-3)

        def there(of: Array) -> float:
            return float(of[3] + of[2] * 3e-3 / 4 * (1 / of[1] - 1 / of[0]))

        u = np.append(np.array([U_REL, U_REL, RHO_C_U_REL]) * best[:3], 0.05)
        moves = [there(best + 1e-3 * u * side) for side in np.eye(4)]
        found = fit[f"lag_{name}_s"]
        assert isinstance(found, dict)
        assert found["value"] == pytest.approx(there(best), rel=1e-9)
        assert found["u"] == pytest.approx(
            1e3 * np.linalg.norm(np.array(moves) - there(best)), rel=1e-3
        )  # curved
        told += 1
    assert told == 1 + (speed is not None)
    assert fit["diameter_mm"] == pytest.approx(3.0)
    h = fit["h_W_m2K"]
    assert isinstance(h, dict)
    assert (h["value"], h["u"]) == pytest.approx((best[0], 0.15 * best[0]))


def test_an_uncertain_speed_makes_h_uncertain() -> None:
    """h goes with the root of the speed."""
    fit = BoundaryLayer("water", 3e-3, 0.4, 0.16).to_fit(Estimate.normal(2.0, 0.05))
    h = fit["h_W_m2K"]
    assert isinstance(h, dict)
    assert h["u"] / h["value"] == pytest.approx(np.hypot(0.15, 0.2))


def test_h_across_a_stream_is_known_where_the_correlation_s_bracket_is_known() -> None:
    """At Pr = 0.4 and Re = 282 000 its brackets are 2 and 2: Nu = 0.3 + 0.62 Re^1/2 Pr^1/3 2^(4/5 -
    1/4)."""
    nu = 0.3 + 0.62 * 282e3**0.5 * 0.4 ** (1 / 3) * 2**0.55
    assert Stream(0.5, 1e-5, 0.4, 28.2).h_W_m2K(0.1) == pytest.approx(nu * 0.5 / 0.1, rel=1e-12)


@pytest.mark.parametrize(
    ("diameter_m", "speed"), [(0.3, None), (5e-6, None), (3e-3, 0.0), (3e-3, 250.0)]
)
def test_a_film_of_impossible_size_or_speed_is_refused(
    diameter_m: float, speed: float | None
) -> None:
    with pytest.raises(InputError, match=f"diameter {1e3 * diameter_m:g} mm"):
        BoundaryLayer("air", diameter_m, speed)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t, y, _ = plunged((1.5, 0.3), 0.05, 500, 0.1, 4)
    log, out = (
        write(tmp_path / "dip.csv", time_s=np.round(t, 3), T1_K=y + 273.15),
        tmp_path / "p.sensor.json",
    )
    words = ("sensor", "plunge", log, "--column", "T1", "--out", out)
    assert run_cli(*words, "--medium", "water", "--diameter-mm", "3", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert Estimate(**said["times"]["T1_K"]["t90_s"]).contains(truth((1.5, 0.3))[3])
    assert said["fit"]["h_W_m2K"]["value"] == pytest.approx(8381, rel=0.01)
    assert read_sensor(out).inputs[0].file == "dip.csv"
    assert "h_W_m2K: 8400 +- 1300" in read_sensor(out).summary()
    assert "lag_air_s: " in read_sensor(out).summary()
    assert run_cli(*words, "--medium", "water") == 2
    assert run_cli("sensor", "plunge", log, "--column", "T9", "--out", out) == 2
    assert "T9" in capsys.readouterr().err


@pytest.mark.parametrize("size_K", [0.01, 30.0])
def test_the_colour_of_residuals_is_told_in_any_unit(size_K: float) -> None:
    rng = np.random.default_rng(4)
    white = size_K * rng.standard_normal(400)
    coloured = lfilter([1.0], [1.0, -0.8], white)
    found, level = residual_noise(coloured, 3)
    assert (found.ar[0], level / size_K) == pytest.approx((-0.8, 1.0), abs=0.15)
    none, level = residual_noise(white, 3)
    assert none.white
    assert level / size_K == pytest.approx(1.0, abs=0.15)


@pytest.mark.e2e
def test_a_bare_wire_has_hardly_a_tail() -> None:
    """One lag, whose entry is not known: the prior of the tail decides how short it may be."""
    t, y, _ = plunged((0.5,), 0.02, 600, 0.05, 4, medium_s=0.02)
    lags = {
        word: plunge_sensor(t, y, "T1", junction=word).chain.channels["T1"].lag_s
        for word in ("insulated", "exposed")
    }
    assert lags["exposed"].contains(0.5)
    assert lags["exposed"].u <= lags["insulated"].u
