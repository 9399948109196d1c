"""Measuring chain, noise, spikes and quantisation of the simulator have the stated true values."""

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.simulate.measure import (
    BITS,
    RANGE_degC,
    add_logger_errors,
    chain_poles,
    chain_responses,
    log_disk,
    quantise,
    spike_train,
)
from tcdyn.simulate.truth import CLEAN, Imperfections, draw_truth

FILTERS = [
    Conditioning(4.0, 2),
    Conditioning(4.0, 3, "butterworth"),
    Conditioning(2.0, 4, "butterworth"),
    Conditioning(poles=0),
]


def test_unknown_filter_shape_raises_in_chain_and_simulator() -> None:
    """Neither the chain nor the simulator takes it for a cascade."""
    with pytest.raises(InputError, match="shape 'bessel'"):
        Conditioning(4.0, 2, "bessel")
    unknown_shape = Conditioning(4.0, 2)
    object.__setattr__(unknown_shape, "shape", "bessel")
    with pytest.raises(InputError, match="shape 'bessel'"):
        chain_poles(0.5, 0.1, unknown_shape)


@pytest.mark.parametrize("conditioning", FILTERS)
def test_ramp_is_delayed_by_exactly_the_lag(conditioning: Conditioning) -> None:
    t = np.arange(0, 20 * 300 + 1) / 300
    fine = np.repeat((3.0 * t)[:, None], 2, axis=1)
    out = chain_responses(fine, 1 / 300, 4, [(0.5, 0.1, conditioning), (0.7, 0.15, conditioning)])
    lag = t[-1] - out[-1] / 3.0
    expected = np.array([0.6, 0.85]) + conditioning.lag_s
    assert np.abs(lag - expected).max() < 1e-9  # exact for a ramp; the transient is e^-28


@pytest.mark.parametrize("conditioning", FILTERS)
def test_simulated_chain_agrees_with_the_transfer_function_of_the_library(
    conditioning: Conditioning,
) -> None:
    rng = np.random.default_rng(1)
    u = np.cumsum(rng.standard_normal(4001))
    simulated = chain_responses(u[:, None], 1 / 300, 4, [(0.5, 0.1, conditioning)])[:, 0]
    library_response = Chain((0.5, 0.1), conditioning=conditioning).response(u, 1 / 300)[::4]
    # two exact discretisations; round-off of the polynomials
    assert np.abs(simulated - library_response).max() < 1e-8 * np.abs(u).max()


def test_chain_has_unit_static_gain() -> None:
    level = np.full((4001, 1), 1.0)
    out = chain_responses(level, 1 / 300, 4, [(0.5, 0.1, Conditioning(4.0, 3, "butterworth"))])
    assert out == pytest.approx(1.0, abs=1e-12)


def test_clean_log_of_a_ramp_lags_each_channel_by_its_true_lag() -> None:
    disk = draw_truth(5).fast
    log, true_traces = log_disk(
        lambda t: np.repeat(t[:, None], 6, axis=1),
        30.0,
        disk,
        np.random.default_rng(0),
        CLEAN,
        spikes=True,
    )
    assert np.abs(true_traces[-1] - log[-1] - list(disk.lags_s.values())).max() < 1e-9


def test_static_line_converts_the_log_back_to_degrees() -> None:
    disk = draw_truth(5).slow
    read = np.random.default_rng(0).uniform(20, 160, (50, 6))
    only_static = Imperfections(noise=False, spikes=False, quantise=False)
    log = add_logger_errors(read, disk, np.random.default_rng(0), only_static, spikes=False)
    for k, channel in enumerate(disk.channels.values()):
        assert np.allclose(channel.gain * log[:, k] + channel.offset_degC, read[:, k], atol=1e-12)


def test_noise_has_the_stated_standard_deviation() -> None:
    disk = draw_truth(2).fast
    log = add_logger_errors(
        np.full((20000, 6), 80.0),
        disk,
        np.random.default_rng(0),
        Imperfections(static=False),
        spikes=False,
    )
    expected_sd = [c.noise_K for c in disk.channels.values()]
    assert np.all((np.array(expected_sd) >= 0.12) & (np.array(expected_sd) <= 0.15))
    # 6 sigma of 20000 samples, and 0.1 % from quantisation
    assert log.std(axis=0) == pytest.approx(expected_sd, rel=0.03)


def test_sixteen_bit_quantisation_rounds_by_half_a_step_and_clips() -> None:
    values = np.linspace(-150, 800, 5001)
    step = (RANGE_degC[1] - RANGE_degC[0]) / (2**BITS - 1)
    inside = (values > RANGE_degC[0]) & (values < RANGE_degC[1])
    out = quantise(values)
    assert np.abs(out - values)[inside].max() <= 0.5 * step * (1 + 1e-9)
    assert (out.min(), out.max()) == pytest.approx(RANGE_degC)


def test_spikes_have_the_stated_rate_and_height() -> None:
    train = spike_train(np.random.default_rng(0), 75 * 2000, 0.03)
    starts = np.sum((train[1:] != 0) & (train[:-1] == 0))
    assert starts == pytest.approx(60, abs=31)  # Poisson, four standard deviations
    assert np.abs(train[train != 0]).min() > 0.1  # two of opposite sign may overlap
    assert np.abs(train).max() > 5


def test_fast_shaft_has_more_spikes() -> None:
    truth = draw_truth(0)
    slow = max(c.spikes_per_s for c in truth.slow.channels.values())
    assert min(c.spikes_per_s for c in truth.fast.channels.values()) > slow
