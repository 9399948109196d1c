"""Steps of the model selection: neighbours, the setting that all models share, ties, averages."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from identify_cases import PLAIN
from scipy.signal import lfilter

from tcdyn.core.estimate import Estimate, mixture
from tcdyn.identification import IOData, compare, fit
from tcdyn.identification.ladder import (
    Ladder,
    best_fit,
    neighbours,
    select_structures,
)
from tcdyn.identification.model_average import average_gain_and_lag
from tcdyn.identification.models import as_model, process
from tcdyn.identification.needless import needless_elements, overdamped_models
from tcdyn.identification.recommendation import TIE_BIC
from tcdyn.identification.search import Fit
from tcdyn.identification.setting import Setting

N = 300
DT_S = 0.1
TRUTH = {"Kp": 2.0, "Tp1": 0.8, "Td": 0.3}
Disturbance = Callable[[np.random.Generator], np.ndarray]


def one_lag(u: np.ndarray, gain: float, tau_s: float, delay_samples: int) -> np.ndarray:
    """Exact response of a lag behind a dead time to ``u``, held between samples."""
    a = np.exp(-DT_S / tau_s)
    delayed = np.concatenate([np.full(delay_samples, u[0]), u])[: len(u)]
    return gain * (lfilter([0.0, 1 - a], [1.0, -a], delayed - u[0]) + u[0])


def levels(rng: np.random.Generator, hold: int) -> np.ndarray:
    """Levels 0 and 1 (N,), held for ``hold`` samples; the second is not the first."""
    drawn = rng.integers(0, 2, -(-N // hold)).astype(float)
    drawn[1] = 1 - drawn[0]
    return np.repeat(drawn, hold)[:N]


def record(seed: int, disturbance: Disturbance = lambda rng: np.zeros(N)) -> IOData:
    """One lag and a dead time of three samples; white noise of 0.05 and a disturbance."""
    rng = np.random.default_rng(seed)
    u = levels(rng, 15)
    y = one_lag(u, 2.0, 0.8, 3) + 0.05 * rng.normal(size=N) + disturbance(rng)
    return IOData.from_arrays(u, y, DT_S, hold="zoh")


def ladder(data: IOData, **options: Any) -> Ladder:
    """The selection on ``data`` without the checks of the record."""
    options = {"check": False, "input_noise": 0.0, **options}
    return Ladder(data, process("P1"), options, lambda name, number, count: None)


STRUCTURES = [
    f"P{n}{delay}{pair}{zero}{last}"
    for n in (1, 2, 3)
    for delay in ("", "D")
    for pair in ("", "U")
    for zero in ("", "Z")
    for last in ("", "I", "H")
    if not (pair and (n == 1 or last))
]


@pytest.mark.parametrize("name", STRUCTURES)
def test_neighbours_are_other_models_of_which_the_model_is_a_neighbour_too(name: str) -> None:
    names = neighbours(name)
    assert len(set(names)) == len(names)
    for other in names:
        assert as_model(other).name == other
        # one parameter more or less, but a pair has those of two lags
        difference = len(as_model(other).free) - len(as_model(name).free)
        assert abs(difference) == (0 if ("U" in other) != ("U" in name) else 1), other
        assert name in neighbours(other)
    assert name not in names


def test_neighbour_of_no_effect_is_one_lag_with_a_dead_time() -> None:
    assert neighbours("-") == ["P1D"]


def test_setting_of_a_caller_has_only_what_the_caller_gave() -> None:
    assert Setting.of({}).is_averaged
    assert Setting.of({"initial": "zero"}) == Setting("zero", "slow", "auto")
    assert Setting.of({"noise": "white"}) == Setting("equilibrium", "white", "none")
    assert Setting.of({"baseline": "walk"}) == Setting("equilibrium", "arma", "walk")
    assert Setting.of({"baseline": "trend"}) == Setting("equilibrium", "slow", "trend")
    assert Setting.of({}).with_white_noise == Setting("equilibrium", "white", "none")


def fake_fit(bic: float, size: int) -> Fit:
    """A fit with this BIC and this number of parameters."""
    identified = SimpleNamespace(statistics={"bic": bic})
    return cast(Fit, SimpleNamespace(identified=identified, problem=SimpleNamespace(size=size)))


def test_smaller_model_is_the_best_only_within_the_tie() -> None:
    large = fake_fit(-100.0, 6)
    tied = fake_fit(-100.0 + 0.9 * TIE_BIC, 4)
    tied_and_worse = fake_fit(-100.0 + 0.95 * TIE_BIC, 4)
    small = fake_fit(-100.0 + 1.1 * TIE_BIC, 3)
    assert best_fit([small, tied_and_worse, large, tied]) is tied
    assert best_fit([small, large]) is large


DISTURBANCES: dict[str, Disturbance] = {
    "none": lambda rng: np.zeros(N),
    "drift": lambda rng: np.linspace(0, 1.5, N),
    "start off equilibrium": lambda rng: 1.5 * np.exp(-DT_S * np.arange(N) / 0.8),
    "random walk": lambda rng: np.cumsum(0.05 * rng.normal(size=N)),
    "first-order noise": lambda rng: lfilter([0.1], [1.0, -0.9], rng.normal(size=N)),
}


@pytest.mark.parametrize("kind", list(DISTURBANCES))
def test_truth_is_within_the_uncertainty_and_the_start_is_that_of_the_record(kind: str) -> None:
    result = fit(record(11, DISTURBANCES[kind]), "P1D", check=False, input_noise=0.0)
    is_moving = kind == "start off equilibrium"
    assert result.problem.initial == ("estimated" if is_moving else "equilibrium")
    for name, value in TRUTH.items():
        # 4 standard uncertainties: 1 in 16 000
        u = result.estimates[name].u
        assert result.estimates[name].value == pytest.approx(value, abs=4 * u), name


def test_size_of_a_drift_and_probability_of_a_random_walk_are_those_of_the_record() -> None:
    options = {"noise": "slow", "initial": "equilibrium", "check": False, "input_noise": 0.0}
    drift, walk = (
        fit(record(11, DISTURBANCES[kind]), "P1D", **options).identified.statistics
        for kind in ("drift", "random walk")
    )
    # the first is 1.5 of a range of 4.5, 30 standard deviations of the noise
    assert drift["wave"] == pytest.approx(1.5 / 4.5, abs=0.15)
    assert walk["p_walk"] > 0.5


def test_structures_are_compared_under_a_disturbance_without_the_dynamics_of_a_poor_model() -> None:
    """Two lags: the disturbance that is likely with one lag is a slow one."""
    rng = np.random.default_rng(2)
    u = levels(rng, 15)
    y = one_lag(one_lag(u, 2.0, 0.8, 3), 1.0, 0.5, 0) + 0.05 * rng.normal(size=N)
    fits, setting = select_structures(ladder(IOData.from_arrays(u, y, DT_S, hold="zoh")))
    assert best_fit(list(fits.values())).problem.model.name == "P2D"
    assert setting.likely is not None
    # noise of less than a sample; one lag leaves a quarter of the swing for several samples
    assert setting.likely.noise.time_constant < 2.0


@pytest.mark.study
def test_drift_is_not_taken_for_a_lag() -> None:
    """The drift of 1.5 is three quarters of the gain."""
    for seed in range(3):
        comparison = compare(record(seed, DISTURBANCES["drift"]))
        assert comparison.best.problem.n_waves
        gain = comparison.averaged["u"]["gain"]
        assert gain.value == pytest.approx(2.0, abs=4 * gain.u), seed


@pytest.mark.long
@pytest.mark.study
def test_selected_structure_is_the_true_one_in_most_of_twenty_records() -> None:
    names = [compare(record(seed)).recommended for seed in range(20)]
    # a superfluous parameter lowers BIC where its squared t value exceeds ln 300: 2 % each
    assert names.count("P1D") >= 15


def two_inputs(seed: int, effect: float) -> IOData:
    """The heater of :func:`record` and a fan with the gain ``effect`` and a lag of 0.4 s."""
    rng = np.random.default_rng(seed)
    u = np.column_stack([levels(rng, 15), levels(rng, 11)])
    y = one_lag(u[:, 0], 2.0, 0.8, 3) + one_lag(u[:, 1], effect, 0.4, 0)
    y = y + 0.05 * rng.normal(size=N)
    return IOData.from_arrays(u, y, DT_S, hold="zoh", input_names=["heater", "fan"])


@pytest.mark.study
@pytest.mark.parametrize("effect", [0.0, -1.0])
def test_input_without_effect_is_dropped_and_one_with_an_effect_is_not(effect: float) -> None:
    selection = ladder(two_inputs(3, effect), **PLAIN)
    fits, setting = select_structures(selection)
    assert setting == Setting("equilibrium", "white", "none")
    model = best_fit(list(fits.values())).problem.model
    assert model.submodels[0].name == "P1D"
    assert model.submodels[1].name == ("P1" if effect else "-")


def test_mixture_of_estimates_has_the_moments_of_its_samples() -> None:
    rng = np.random.default_rng(4)
    weights = np.array([1.0, 0.2, 0.05])
    estimates = [Estimate.normal(2.0, 0.1), Estimate.normal(2.4, 0.3), Estimate.normal(1.0, 0.2)]
    drawn = rng.choice(3, 200_000, p=weights / weights.sum())
    means = np.array([e.value for e in estimates])[drawn]
    samples = means + np.array([e.u for e in estimates])[drawn] * rng.normal(size=len(drawn))
    average = mixture(estimates, weights.tolist())
    # tolerance: five standard errors of 200,000 samples
    assert average.value == pytest.approx(samples.mean(), abs=5 * samples.std() / 447)
    assert average.u == pytest.approx(samples.std(), rel=0.02)
    # tolerance: three standard errors of a quantile, at a density of 0.03 and more
    ends = np.quantile(samples, [0.025, 0.975])
    assert [average.low95, average.high95] == pytest.approx(ends.tolist(), abs=0.035)
    assert mixture(estimates[:1], [1.0]) is estimates[0]


def test_average_over_models_weights_them_by_bic() -> None:
    data = record(6)
    options = {"intervals": "quadratic", "check": False, "input_noise": 0.0, **PLAIN}
    first, second, integrator = (fit(data, name, **options) for name in ("P1D", "P2D", "P1I"))

    fits = {"P1D": first, "P2D": second, "P1I": integrator}

    def table(*bic: float) -> pd.DataFrame:
        """Table with BIC of the models."""
        return pd.DataFrame({"model": list(fits), "BIC": bic})

    averaged = average_gain_and_lag(table(-50.0, -47.0, -50.0), fits, "P1D")["u"]
    weights = np.exp([0.0, -1.5])
    for quantity, estimates in (
        ("gain", [f.estimates["Kp"] for f in (first, second)]),
        ("lag_s", [f.identified.lag_s for f in (first, second)]),
    ):
        expected = mixture(estimates, weights.tolist())
        assert averaged[quantity].value == pytest.approx(expected.value, rel=1e-9)
        assert averaged[quantity].u == pytest.approx(expected.u, rel=1e-6)
    # exp(-5) is below a hundredth
    alone = average_gain_and_lag(table(-50.0, -40.0, -50.0), fits, "P1D")["u"]
    assert alone["lag_s"].value == first.identified.lag_s.value
    assert alone["gain"].u == pytest.approx(first.estimates["Kp"].u, rel=1e-6)
    assert average_gain_and_lag(table(-50.0, -47.0, -50.0), fits, "P1I") == {}


def test_real_pair_of_poles_behind_any_input_is_left_out_where_two_lags_fit() -> None:
    def fake(*damping: float, findings: tuple[str, ...] = ()) -> Fit:
        """A fit with the damping behind each input; 0 for lags."""
        parts = {f"u{k}": SimpleNamespace(theta={"Zeta": z}) for k, z in enumerate(damping)}
        identified = SimpleNamespace(by_input=parts)
        return cast(Fit, SimpleNamespace(identified=identified, findings=findings))

    fits = {
        "P1D + P2U": fake(0.0, 1.3),
        "P1D + P2": fake(0.0, 0.0),
        "P2DU + P2U": fake(0.4, 1.3),  # nothing with two lags behind the second input
        "P2U": fake(1.1),
        "P2": fake(0.0, findings=("undetermined",)),
    }
    assert overdamped_models(fits) == ["P1D + P2U"]


def test_elements_are_left_out_where_lags_are_about_as_likely() -> None:
    lags = fake_fit(-100.0, 6)
    assert needless_elements({"P2D": lags, "P1DH": fake_fit(-105.0, 6)}) == ["P1DH"]
    assert needless_elements({"P2D": lags, "P1DH": fake_fit(-130.0, 6)}) == []
    assert needless_elements({"P1DH": fake_fit(-105.0, 6)}) == []
    assert needless_elements({"P2D": lags, "P2DU": fake_fit(-104.0, 6)}) == ["P2DU"]
    assert needless_elements({"P2D": lags, "P2DU": fake_fit(-120.0, 6)}) == []
    two = {"P1 + P2": lags, "P1 + P2U": fake_fit(-101.0, 6), "P2U + P1": fake_fit(-90.0, 6)}
    assert needless_elements(two) == ["P1 + P2U"]


def test_models_of_a_comparison_share_their_start_and_the_summary_gives_the_average() -> None:
    comparison = compare(record(12, DISTURBANCES["drift"]), "P1D", "P1", initial="equilibrium")
    assert comparison.best.problem.n_waves
    assert {f.problem.initial for f in comparison.fits.values()} == {"equilibrium"}
    gain = comparison.averaged["u"]["gain"]
    assert gain.value == pytest.approx(2.0, abs=4 * gain.u)
    assert f"gain {gain.text()}" in comparison.summary()
    assert comparison.to_dict()["averaged"]["u"]["gain"]["value"] == gain.value
