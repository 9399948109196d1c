"""Records whose noise or dynamics remember longer than the record, or less than one sample.

``python -m tests.identify.long_memory_study 0 300`` looks for further ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.chain.rational import Factor, Rational, realise, simulate, step_matrices
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification import (
    IOData,
    bode_band,
    compare,
    fit,
    from_control,
    process,
    spectral_estimate,
    step_band,
)
from tcdyn.identification.disturbance import spectral_factor


@pytest.fixture(autouse=True)
def no_numerical_warnings() -> Iterator[None]:
    """An overflow or an invalid number fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def flexible_arm(n: int, seed: int) -> tuple[Array, Array]:
    """Torque, a multisine of one period, and acceleration of an arm with two light resonances."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    top = n // 4
    u = sum(np.cos(2 * np.pi * k * t / n - np.pi * k * k / top) for k in range(1, top))
    y = np.zeros(n)
    for frequency, damping in ((0.3, 3e-3), (1.1, 1e-3)):
        radius = np.exp(-damping * frequency)
        poles = [1.0, -2 * radius * np.cos(frequency), radius**2]
        y += lfilter([1.0, -2.0, 1.0], poles, np.tile(u, 3))[-n:]
    y += 0.01 * np.std(y) * lfilter([1.0], [1.0, -0.999], rng.normal(size=n))
    return u + 0.05 * np.std(u) * rng.normal(size=n), y


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["P2DH", "P3D"])
def test_input_noise_behind_a_flexible_arm_is_averaged_over(name: str) -> None:
    """Poles of the half-order element are much faster than a sample: the outer coefficients of the
    noise's spectrum are so small that their ratio overflows."""
    u, y = flexible_arm(120, 43)
    sd = 0.2 * float(np.std(u))
    result = fit(
        IOData.from_arrays(u, y, 1.0, hold="foh"),
        name,
        input_noise=sd,
        noise="slow",
        baseline="none",
        check=False,
    )
    assert np.isfinite(list(result.identified.theta.values())).all()


@pytest.mark.parametrize("smallest", [0.0, 1e-320, 1e-308, 1e-30])
def test_a_spectral_factor_ignores_what_a_fast_pole_leaves(smallest: float) -> None:
    factor = spectral_factor(np.array([smallest, 0.5, 1.25, 0.5, smallest]))
    assert factor is not None
    assert factor == pytest.approx([1.0, 0.5])


@pytest.mark.parametrize(
    "spectrum", [[0.0, 0.0, 0.0], [np.nan, 1.0, np.nan], [1.0, np.inf, 1.0], [1.0, 2.0, 1.0]]
)
def test_no_spectral_factor_of_a_spectrum_that_has_none(spectrum: list[float]) -> None:
    factor = spectral_factor(np.array(spectrum))
    if factor is not None:  # a double zero on the unit circle is inside it by rounding
        assert abs(factor[1]) == pytest.approx(1.0, abs=1e-6)
        assert spectrum[0] == 1.0


@pytest.mark.parametrize("gain", [1.0, 1e12, 1e30])
def test_one_step_of_the_state_space_keeps_its_poles_at_any_gain(gain: float) -> None:
    """The exponential of a matrix with couplings of the size of the gain loses the small ones."""
    pair = Factor((1.0, 2e-5, 1e-4))
    system = realise(Rational(np.array([gain, -gain]), (pair,)))
    phi = step_matrices(system, 1.0)[0]
    expected = np.exp(pair.poles)
    assert np.diag(phi) == pytest.approx(np.tile(expected, 2), rel=1e-6)


def test_a_double_integrator_under_heavy_noise_is_fitted_without_an_overflow() -> None:
    rng = np.random.default_rng(69)
    u = (np.abs(np.arange(60) - 20) < 2).astype(float)
    noise = lfilter([1.0], [1.0, -0.95], rng.normal(size=60))
    y = 1e9 * (np.cumsum(np.cumsum(u)) + noise)
    result = fit(IOData.from_arrays(u, y, 1.0, hold="zoh"), "P2ZU", baseline="walk", check=False)
    assert result.identified.summary()


@pytest.mark.e2e
@pytest.mark.parametrize("kind", ["double walk", "two slow lags", "exact sine"])
def test_noise_of_long_memory_is_fitted(kind: str) -> None:
    rng = np.random.default_rng(5)
    n = 80
    u = np.repeat(rng.choice([0.0, 1.0], 8), 10)
    noise = {
        "double walk": 0.01 * np.cumsum(np.cumsum(rng.normal(size=n))),
        "two slow lags": 0.01 * lfilter([1.0], np.poly([0.99999, 0.9999]), rng.normal(size=n)),
        "exact sine": np.sin(0.05 * np.arange(n)),
    }[kind]
    y = lfilter([0.0, 0.2], [1.0, -0.8], u) + noise
    y[[30, 50]] = np.nan  # gaps, after which the noise is stationary
    data = IOData.from_arrays(u, y, 1.0, hold="zoh")
    result = fit(data, "P1", noise="arma", baseline="none", check=False)
    assert np.isfinite(result.identified.covariance).all()


def heated() -> IOData:
    """A record of a first-order lag with a dead time."""
    u = np.repeat([20.0, 80.0, 20.0, 50.0], 60)
    truth = process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12})
    y = simulate(truth, u, 0.05, "zoh") + np.random.default_rng(0).normal(0, 0.1, len(u))
    return IOData.from_arrays(u, y, 0.05, hold="zoh")


@pytest.mark.e2e
def test_given_models_are_compared_printed_and_drawn() -> None:
    data = heated()
    fits = [fit(data, name).identified for name in ("P1D", "P2")]
    truth = from_control(control.tf([1.0], [0.75, 1.0]), delay_s=0.12)
    entries = {
        "given": fits,
        "control first": [truth, "P1"],
        "control alone": [truth],
    }
    for name, models in entries.items():
        comparison = compare(data, *models) if name == "given" else compare(data, list(models))
        assert str(comparison).startswith("<Comparison")
        assert comparison.summary()
        best = comparison.best.identified
        if best.covariance.size == 0:  # all parameters are fixed
            assert np.all(step_band(best).u == 0)
            assert np.all(bode_band(best).magnitude_dB.u == 0)
            assert best.to_frame()["u"].eq(0).all()
    assert compare(data, list(fits)).best.identified.model.name == "P1D as given"


def test_the_spectral_estimate_of_a_single_step_is_printed_or_refused_with_its_cause() -> None:
    n = 400
    u = (np.arange(n) > 100).astype(float)
    y = lfilter([0.0, 0.2], [1.0, -0.8], u)
    response = spectral_estimate(IOData.from_arrays(u, y, 1.0, hold="zoh"))
    assert str(response)
    constant = np.full(n, 3.0)
    for output in (constant, constant + np.random.default_rng(1).normal(size=n)):
        data = IOData.from_arrays((np.arange(n) > 398).astype(float), output, 1.0, hold="zoh")
        with pytest.raises(InputError, match="no frequency"):
            spectral_estimate(data)
