"""Lags found in place: two sensors in one gas, a current through the sensor, the process's own
noise."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Severity
from tcdyn.sensors import read_sensor
from tcdyn.sensors.conduction import SECOND_TO_ALL, conduction_chain, inner_lags
from tcdyn.sensors.current import (
    CORE_HEAT,
    MODES,
    _Mixture,
    current_sensor,
    cylinder_modes,
    sample_density,
)
from tcdyn.sensors.noise import _lags, mean_periodogram, noise_sensor
from tcdyn.sensors.pair import _lag_findings, pair_sensor
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.layered_study import KINDS
from tests.sensors.layered_world import AIR_K, MEDIA, drawn, layered
from tests.sensors.sensor_study import DRAWS, noise
from tests.sensors.sensor_world import (
    FINE,
    Sheath,
    fluctuating,
    lagged,
    two_in_a_gas,
    write,
    written,
)


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "draws", "most"),
    [("pair", 4, 0.1), ("flow", 2, 0.1), ("current", 2, 0.2), ("noise", 2, 0.2)],
)
def test_the_lag_lies_in_its_interval(kind: str, draws: int, most: float) -> None:
    """Few draws; 200 of each are in `python -m tests.sensors.sensor_study KIND`."""
    found = [one for seed in range(draws) for one in DRAWS[kind](1000 + seed)]
    assert np.mean([e.contains(v) for e, v in found]) >= 0.7
    assert max(abs(e.value / v - 1) for e, v in found) < most
    assert max(abs(e.value - v) / e.u for e, v in found) < 4.5


@pytest.mark.study
def test_noise_on_both_does_not_bias_the_pair_where_plain_regression_is_wrong() -> None:
    """16 records of large noise: the mean of the short lag within 3 of its standard errors;
    regression far off."""
    taus, lags, plain = (0.15, 0.5), [], []
    for seed in range(16):
        t, a, b, _ = two_in_a_gas(seed, taus, 0.02, 1500, (1.0, 1.0))
        lags.append(pair_sensor(t, a, b, ("A", "B"), bare=True).chain.channels["A"].lag_s)
        da, db = np.gradient(a, t), np.gradient(b, t)  # b - a = tau1 a' - tau2 b'
        plain.append(np.linalg.lstsq(np.column_stack([da, -db]), b - a, rcond=None)[0][0])
    value, u = np.array([e.value for e in lags]), np.array([e.u for e in lags])
    assert abs(value.mean() - 0.15) < 3 * u.mean() / 4
    assert abs(np.mean(plain) - 0.15) > 0.05


def test_a_slow_fluid_tells_the_difference_of_the_lags_only_and_that_is_said() -> None:
    t, a, b, _ = two_in_a_gas(3, (0.15, 0.5), 0.02, 1500, (1.0, 1.0), slow_s=(60.0, 200.0))
    made = pair_sensor(t, a, b, ("A", "B"), bare=True)
    (found,) = [f for f in made.findings if f.code == "sensor.pair_difference"]
    assert abs(found.numbers["difference_s"] + 0.35) < 4 * found.numbers["u_s"] < 1.0
    assert found.severity is Severity.WARNING


@pytest.mark.parametrize(
    ("u_s", "severity"), [(0.1, Severity.WARNING), (0.2, Severity.ERROR), (30.0, Severity.ERROR)]
)
def test_a_lag_below_its_uncertainty_is_no_result(u_s: float, severity: Severity) -> None:
    """Lags of 0.15 and 0.5 s with one error in common: their difference is known to 1 ms."""
    data = SimpleNamespace(dt_s=0.01)
    covariance = np.full((2, 2), u_s**2) + 1e-6 * np.eye(2)
    lags = np.array([0.15, 0.5])
    (found,) = _lag_findings(data, lags, (covariance, covariance), 1.0, ("A", "B"))  # type: ignore[arg-type]
    assert found.code == "sensor.pair_difference"
    assert found.severity is severity
    assert found.numbers["u_s"] == pytest.approx(2e-6**0.5)


def test_an_unknown_construction_is_not_called_a_slow_fluid() -> None:
    """Lags of 0.15 and 0.5 s that the fluid determines to 1 ms, and the construction to 0.06 s."""
    data = SimpleNamespace(dt_s=0.01)
    by_fluid = 1e-6 * np.eye(2)
    with_construction = by_fluid + np.full((2, 2), 0.06**2)
    lags = np.array([0.15, 0.5])
    (found,) = _lag_findings(data, lags, (by_fluid, with_construction), 1.0, ("A", "B"))  # type: ignore[arg-type]
    assert found.code == "sensor.pair_construction"
    assert found.subject == "A"
    assert found.numbers["percent"] == pytest.approx(78, abs=1)


def test_two_fluids_are_told_and_one_trace_twice_is_refused() -> None:
    t, a, _, _ = two_in_a_gas(4, (0.15, 0.5), 0.02, 1500, (0.3, 0.3))
    _, _, b, _ = two_in_a_gas(5, (0.15, 0.5), 0.02, 1500, (0.3, 0.3))
    assert {"sensor.pair_misfit"} <= {
        f.code for f in pair_sensor(t, a, b, ("A", "B"), bare=True).findings
    }
    with pytest.raises(InputError, match="the same within noise"):
        pair_sensor(t, a, a.copy(), ("A", "B"))
    with pytest.raises(InputError, match="not above zero"):
        pair_sensor(t, a, b, ("A", "B"), speed=np.zeros(len(t)))
    with pytest.raises(InputError, match="rows"):
        pair_sensor(t, a, b, ("A", "B"), changes_s=[t[20]])
    for count in (0, 1, 3):
        with pytest.raises(InputError, match=f"B holds {count} numbers"):
            pair_sensor(t, a, np.where(np.arange(len(b)) < count, b, np.nan), ("A", "B"))


@pytest.mark.parametrize(("gain", "offset_K"), [(1.01, 0.0), (0.985, -2.0)])
def test_gain_and_offset_between_the_sensors_of_a_pair_do_not_shift_the_lags(
    gain: float, offset_K: float
) -> None:
    t, a, b, _ = two_in_a_gas(1, (0.15, 0.5), 0.02, 1500, (0.3, 0.3))
    made = pair_sensor(t, a, 300 + gain * (b - 300) + offset_K, ("A", "B"), bare=True)
    for column, true_s in (("A", 0.15), ("B", 0.5)):
        lag = made.chain.channels[column].lag_s
        assert lag.contains(true_s)
        assert lag.u < 0.01 * true_s
    assert Estimate(**made.fit["gain"]).contains(gain)
    (finding,) = made.findings
    assert finding.code == "sensor.pair_gain"


def test_a_pair_whose_gain_the_record_does_not_determine_names_it_as_the_limit() -> None:
    """A fluid of one frequency has one ratio of amplitudes and one difference of phase."""
    fine = np.arange(1500 * FINE) * (0.02 / FINE)
    x = 300 + 20 * np.sin(2.0 * fine)
    noise_K = 0.3 * np.random.default_rng(0).standard_normal((2, 1500))
    a, b = (lagged(x, (tau,), 0.02 / FINE)[::FINE] for tau in (0.15, 0.5))
    made = pair_sensor(fine[::FINE], a + noise_K[0], b + noise_K[1], ("A", "B"), bare=True)
    assert made.fit["limited_by"].startswith("the gain")
    for column, true_s in (("A", 0.15), ("B", 0.5)):
        assert made.chain.channels[column].lag_s.contains(true_s)
    assert Estimate(**made.fit["gain"]).u == pytest.approx(0.01)


def test_bins_of_negligible_power_are_not_fitted() -> None:
    """Two lags: with 40 of 998 bins the spectrum falls to a four-hundredth."""
    _, y = fluctuating(0, (1.0, 0.5), 0.02, 20_000, 1e-6)
    bins = mean_periodogram(y - y.mean(), 2000, 0.02)
    w = bins.w / 0.02
    power = 1 / ((1 + w**2) * (1 + (0.5 * w) ** 2))
    assert power[-1] / power[0] == pytest.approx(3e-3, rel=0.5)
    _, loud = fluctuating(0, (1.0, 0.5), 0.02, 20_000, 2.0)
    assert len(mean_periodogram(loud - loud.mean(), 2000, 0.02).w) == 2000 // 2 - 3


@pytest.mark.study
def test_noise_of_layered_sensors_with_a_quiet_logger_is_not_biased() -> None:
    """Six draws with noise of the logger of a thousandth of the fluctuations."""
    errors = []
    for k in range(6):
        rng = np.random.default_rng(7100 + k)
        sensor = drawn(rng, list(MEDIA)[k % 3])
        dt = sensor.times_s()[1] / 15
        lead = int(20 * sensor.lag_s / dt)
        x = rng.standard_normal((15_000 + lead) * FINE)
        y = sensor.follow(x, dt / FINE)[lead * FINE :: FINE]
        y = y / np.std(y) + 1e-3 * rng.standard_normal(len(y))
        lag = Estimate(**noise_sensor(np.arange(len(y)) * dt, y, "T").fit["lag_s"])
        errors.append((lag.value - sensor.lag_s) / lag.u)
    assert abs(np.mean(errors)) < 1.5
    assert np.max(np.abs(errors)) < 4


def test_the_modes_of_a_cylinder_add_to_its_lag() -> None:
    """The modes that are left out are short; a slender sensor has a single mode."""
    tau, _ = cylinder_modes(np.log([2.0, 1.5, 0.6, 0.2, 0.3]))
    assert len(tau) == MODES
    assert np.sum(tau) == pytest.approx(2.0, rel=0.006)
    slender, _ = cylinder_modes(np.log([2.0, 0.002, 0.5, 0.2, 0.3]))
    assert slender[0] == pytest.approx(2.0, rel=0.003)


@pytest.mark.study
def test_an_answer_that_does_not_tell_the_plunge_is_said_to() -> None:
    """Much noise: the uncertainty is large, and a finding says so. The core does not conduct well,
    other than that of the model."""
    rng = np.random.default_rng(14)
    probe = Sheath.drawn(rng)
    t, y, power = probe.heated(rng, 0.08)
    made = current_sensor(t, y, np.sqrt(power), "T")
    (said,) = [f for f in made.findings if f.code == "sensor.conversion_wide"]
    assert said.severity.value == "warning"
    lag = Estimate(**made.fit["lag_s"])
    assert abs(lag.value - probe.lag_s) < 3 * lag.u
    with pytest.raises(InputError, match="within ten times"):
        current_sensor(t, y + 10 * rng.standard_normal(len(y)), np.sqrt(power), "T")


@pytest.mark.long
def test_the_unit_of_the_current_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    t, y, power = Sheath.drawn(rng).heated(rng, 0.005)
    lags = [
        current_sensor(t, y, scale * np.sqrt(power), "T").fit["lag_s"] for scale in (1.0, 1e300)
    ]
    assert lags[0] == lags[1]


@pytest.mark.long
@pytest.mark.study
def test_a_thermocouple_that_is_read_only_without_current_gives_the_same_lag() -> None:
    rng = np.random.default_rng(2)
    probe = Sheath.drawn(rng)
    t, y, power = probe.heated(rng, 0.005)
    both = Estimate(**current_sensor(t, y, np.sqrt(power), "T").fit["lag_s"])
    y = np.where(power > 0.5, 500.0, y)  # what the current writes into the reading
    cooling = Estimate(**current_sensor(t, y, np.sqrt(power), "T", off_only=True).fit["lag_s"])
    assert cooling.contains(probe.lag_s)
    assert abs(cooling.value - both.value) < both.u
    with pytest.raises(InputError, match="does not switch"):
        current_sensor(t, y, np.ones(len(t)), "T")


def test_a_second_lag_that_goes_to_nothing_is_none() -> None:
    """Draw 62 of the study: the fit of two lags ends with 1e-95 s for one of them."""
    [(lag, true)] = noise(62)
    assert lag.contains(true)


def test_of_two_lags_the_longer_is_told_first_and_one_of_a_millionth_is_not_told() -> None:
    assert _lags(np.log([0.3, 2.0])) == pytest.approx([2.0, 0.3])
    assert _lags(np.log([2.0, 2.1e-6])) == pytest.approx([2.0, 2.1e-6])
    assert _lags(np.log([2.0, 1.9e-6])) == pytest.approx([2.0])


@pytest.mark.study
def test_noise_tells_when_its_conditions_do_not_hold() -> None:
    t, y = fluctuating(1, (1.0,), 0.1, 12_000, 0.05)
    calm = noise_sensor(t, y, "T")
    assert {f.code for f in calm.findings} <= {"sensor.noise_driving"}
    louder = noise_sensor(t, 50 + (y - 50) * np.linspace(0.2, 2, len(y)), "T")
    assert "sensor.noise_unsteady" in {f.code for f in louder.findings}
    hum = noise_sensor(t, y + 0.6 * np.sin(2 * np.pi * 0.9 * t), "T")
    assert "sensor.noise_misfit" in {f.code for f in hum.findings}
    rng = np.random.default_rng(
        3
    )  # a fluid slower than white: the answer is longer, and one trace cannot know
    x = lagged(lagged(rng.standard_normal(15_000 * FINE), (0.5,), 0.1 / FINE), (1.0,), 0.1 / FINE)[
        2000 * FINE :: FINE
    ]
    slow = noise_sensor(t[: len(x)], 50 + x / x.std() + 0.02 * rng.standard_normal(len(x)), "T")
    assert Estimate(**slow.fit["lag_s"]).value > 1.25
    (said,) = [f for f in slow.findings if f.code == "sensor.noise_driving"]
    assert said.severity.value == "warning"
    assert "may be the fluid's" in said.sentence
    with pytest.raises(InputError, match="lags long"):
        noise_sensor(t[:1000], y[:1000], "T")
    with pytest.raises(InputError, match="512"):
        noise_sensor(t[:100], y[:100], "T")


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(("kind", "silent"), [("current", 1), ("noise", 1), ("pair", 2)])
def test_layered_sensors_lie_in_their_intervals_or_there_is_a_warning(
    kind: str, silent: int
) -> None:
    """Six draws each; more are in `python -m tests.sensors.layered_study KIND`."""
    misses = 0
    for k in range(6):
        case = KINDS[kind](np.random.default_rng(400 + k), list(MEDIA)[k % 3], False)
        held = all(estimate.contains(true) for estimate, true in case.pairs.values())
        warned = any(f.severity.value == "warning" for f in case.made.findings)
        misses += not held and not warned
    assert misses <= silent


@pytest.mark.study
@pytest.mark.parametrize("medium", list(MEDIA))
def test_noise_of_a_slow_fluid_is_refused_with_the_reason(medium: str) -> None:
    with pytest.raises(InputError, match="too slow for this method") as refused:
        KINDS["slow"](np.random.default_rng(5000), medium, False)
    assert "time constant of" in str(refused.value)


@pytest.mark.parametrize(("h", "gap_m"), [(300.0, 0.0), (3000.0, 0.0), (3000.0, 20e-6)])
def test_inner_lags_add_to_nearly_those_of_layered_sensors(h: float, gap_m: float) -> None:
    """Within a quarter, which is the standard uncertainty that the methods give them."""
    taus = layered(3e-3, 0.2, 0.12, 3.0, h, gap_m).taus_s
    assert np.sum(inner_lags(taus[1])) == pytest.approx(np.sum(taus[1:]), rel=0.25)
    chain = conduction_chain(taus[0], taus[1])
    assert chain.lag_s == pytest.approx(taus[0] + SECOND_TO_ALL * taus[1])
    assert conduction_chain(2.0, 0.0).taus_s == (2.0,)


@pytest.mark.long
@pytest.mark.e2e
def test_the_commands_write_files_that_compensate_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t, a, b, speed = two_in_a_gas(6, (0.15, 0.5), 0.02, 1500, (0.3, 0.3), 3.0)
    log = write(tmp_path / "gas.csv", time_s=np.round(t, 3), A_degC=a, B_K=b + 273.15, v=speed)
    out = tmp_path / "pair.sensor.json"
    assert (
        run_cli(
            "sensor", "pair", log, "--column", "A", "--column", "B", "--speed", "v", "--out", out
        )
        == 0
    )
    assert "warning: " in capsys.readouterr().err  # they change
    assert read_sensor(out).fit["exponent"]["value"] == pytest.approx(0.5, abs=0.1)
    assert run_cli("sensor", "pair", log, "--column", "A", "--out", out) == 2
    assert (
        run_cli(
            "sensor",
            "pair",
            log,
            "--column",
            "A",
            "--column",
            "B",
            "--flow-step-s",
            "15",
            "--out",
            out,
        )
        == 0
    )
    assert run_cli("compensate", log, "--sensor", out, "--out", tmp_path / "o.csv", "--quiet") == 0
    done = written(tmp_path / "o.csv")
    late = t > 20
    assert (
        np.median(np.abs(done["A_degC"] - done["B_K"] + 273.15)[late])
        < np.median(np.abs(a - b)[late]) / 2
    )
    rng = np.random.default_rng(7)
    probe = Sheath.drawn(rng)
    t, y, power = probe.heated(rng, 0.005)
    log = write(tmp_path / "lcsr.csv", time_s=t, R_degC=20 + y, I_mA=40 * np.sqrt(power))
    capsys.readouterr()
    assert (
        run_cli(
            "sensor",
            "current",
            log,
            "--column",
            "R",
            "--current",
            "I_mA",
            "--out",
            out,
            "--overwrite",
            "--json",
        )
        == 0
    )
    said = json.loads(capsys.readouterr().out)
    assert Estimate(**said["fit"]["lag_s"]).contains(probe.lag_s)
    t, y = fluctuating(8, (1.0,), 0.1, 8000, 0.05)
    log = write(tmp_path / "noise.csv", time_s=np.round(t, 3), T_degC=y)
    assert run_cli("sensor", "noise", log, "--column", "T", "--out", out, "--overwrite", "-q") == 0
    assert read_sensor(out).method == "noise"


@pytest.mark.parametrize(
    ("biot", "wall", "heated", "gap"),
    [(5.0, 0.3, 0.2, 0.01), (0.8, 1.2, 0.3, 0.5), (20.0, 0.5, 0.5, 3.0)],
)
def test_modes_of_a_heated_cylinder_are_those_of_layered_sensors(
    biot: float, wall: float, heated: float, gap: float
) -> None:
    """Core and sheath conduct a million times as well; the insulation's k is 2 W/mK."""
    diameter, k, stored = 2e-3, 2.0, 2e6
    outer, inner = diameter / 2, 0.75 * diameter / 2
    made = layered(
        diameter,
        0.75 * heated,
        0.125,
        k,
        biot * k / outer,
        gap * AIR_K * inner / k,
        k_core=1e6 * k,
        k_sheath=1e6 * k,
        capacity=(CORE_HEAT * stored, stored, wall * stored / (outer**2 / inner**2 - 1)),
        refine=2,
    )
    assert made.lag_s == pytest.approx(made.taus_s.sum(), rel=1e-4)  # poles only
    tau, share = cylinder_modes(np.log([made.lag_s, biot, wall, heated, gap]))
    assert tau[:4] == pytest.approx(made.taus_s[:4], rel=5e-3)
    assert share[:4] == pytest.approx(made.heated[:4], rel=2e-2)


def test_a_density_far_narrower_than_its_proposal_is_sampled_whole() -> None:
    """Five correlated normal variables, of which the proposal knows the variances only."""
    sd = 0.05

    def log_density(x: Array) -> float:
        deviations = np.append(x[0], np.diff(x) / sd)
        return -0.5 * float(deviations @ deviations)

    proposal = _Mixture(np.zeros((1, 5)), np.eye(5)[None], np.ones(1))
    samples, weights = sample_density(log_density, proposal)
    mean = weights @ samples
    deviation = np.sqrt(weights @ (samples - mean) ** 2)
    assert np.abs(mean).max() < 0.4  # about 100 independent samples: 4 standard errors
    assert deviation == pytest.approx(np.ones(5), rel=0.3)


@pytest.mark.e2e
def test_a_sheathed_sensor_whose_posterior_is_curved_has_a_lag() -> None:
    """All weight of the importance sampling is on one sample."""
    path = Path(__file__).resolve().parents[2].parent / "shared" / "cases" / "files2" / "81.csv"
    if not path.exists():
        pytest.skip("the shared cases are not here")
    time_s, reading, current = np.genfromtxt(path, delimiter=",", skip_header=1).T
    made = current_sensor(time_s, reading, current, "R")
    lag = Estimate(**made.fit["lag_s"])
    # 36 000 steps of a Markov chain: 68.8 +- 3.0 s, and 3.7 s for the model
    assert lag.value == pytest.approx(68.8, abs=3.0)
    assert lag.u == pytest.approx(4.7, rel=0.3)
