"""The fixed-interval smoother against dense Gaussian algebra, against simulated truth, and at its limits."""

import numpy as np
import pytest

from calibration.disk import Conditioning
from calibration.errors import InputError
from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.compensate import Intensity, smooth

DT = 0.05
RISE_S = 5.0


def exponential_rise(n=800, dt=DT, fine=20):
    """Case B of the anchors: truth (n,), and what a lag of 1 s makes of it."""
    t = np.arange(n * fine) * dt / fine
    x = 25 + 155 * (1 - np.exp(-np.maximum(t - RISE_S, 0) / 3))
    return x[::fine], Chain((1.0,), conditioning=NO_CONDITIONING).response(x, dt / fine)[::fine]


def dense_smoother(y, dt, chain, noise_sd, q):
    """Generalised least squares with N x N matrices: slopes that jump on every knot, chain by its own simulation."""
    n = len(y)
    columns = [np.ones(n), np.arange(n) * dt]
    columns += [np.maximum(np.arange(n) - k, 0) * dt for k in range(1, n)]
    x_of = np.stack(columns, axis=1)
    run_in = 400
    long = [np.ones(n + run_in), (np.arange(n + run_in) - run_in) * dt]
    long += [np.maximum(np.arange(n + run_in) - run_in - k, 0) * dt for k in range(1, n)]
    y_of = chain.response(np.stack(long, axis=1), dt)[run_in:]
    slow = -chain.lag_s  # a ramp followed for ever lags by lag_s; the run-in starts it in equilibrium with its level
    y_of[:, 1] = np.arange(n) * dt + slow
    precision = np.diag(np.r_[0.0, 0.0, np.full(n - 1, 1 / (q * dt))])
    cov = np.linalg.inv(y_of.T @ y_of / noise_sd**2 + precision)
    return x_of @ (cov @ (y_of.T @ y) / noise_sd**2), np.sqrt(np.diag(x_of @ cov @ x_of.T))


@pytest.mark.parametrize(
    "chain",
    [
        Chain((1.0,), conditioning=NO_CONDITIONING),
        Chain((0.6, 0.1), zero_s=0.05, conditioning=Conditioning(4.0, 2, "butterworth")),
        Chain((0.5,), delay_s=0.0, conditioning=Conditioning(4.0, 2)),
    ],
)
def test_smoother_equals_dense_least_squares_inside_the_record(chain):
    """Away from the start, where the priors on the chain's past differ; tolerance: condition of the dense inverse."""
    rng = np.random.default_rng(1)
    y = np.cumsum(rng.standard_normal(160)) * 0.3 + 0.1 * rng.standard_normal(160)
    q = 1e6  # so high that every cell is one sample long
    mean, sd = dense_smoother(y, DT, chain, 0.1, q)
    ours = smooth(y, DT, chain, noise_sd=0.1, intensity=q)
    inside = slice(100, 160)
    assert np.allclose(ours.temperature[inside, 0], mean[inside], atol=2e-4 * np.max(sd))
    assert np.allclose(ours.sd[inside, 0], sd[inside], rtol=2e-4)


def test_delay_shifts_the_record_exactly():
    """A dead time of a whole number of samples is a shift of the time axis, nothing else."""
    _, y = exponential_rise()
    y = y + 0.2 * np.random.default_rng(0).standard_normal(len(y))
    plain = smooth(y, DT, Chain((1.0,), conditioning=NO_CONDITIONING), noise_sd=0.2, intensity=30.0)
    late = smooth(y, DT, Chain((1.0,), delay_s=0.2, conditioning=NO_CONDITIONING), noise_sd=0.2, intensity=30.0)
    assert np.allclose(late.temperature[200:-40], plain.temperature[204:-36], atol=1e-3)
    assert late.sd[-1, 0] > 1.5 * plain.sd[-1, 0]  # its last 0.2 s are extrapolated


def test_known_event_makes_the_transient_sharp():
    x, y = exponential_rise()
    y = y[:, None] + 0.2 * np.random.default_rng(0).standard_normal((len(y), 4))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    ours = smooth(y, DT, chain, events_s=(RISE_S,))
    error = ours.temperature - x[:, None]
    assert np.sqrt(np.mean(error[60:740] ** 2)) < 0.15  # half of what is possible without the event, 0.25
    assert np.mean(np.abs(error) < 1.96 * ours.sd) > 0.93


def test_missing_samples_stay_local_and_widen_the_band():
    _, y = exponential_rise()
    y = y + 0.2 * np.random.default_rng(0).standard_normal(len(y))
    chain = Chain((1.0,), conditioning=NO_CONDITIONING)
    whole = smooth(y, DT, chain, noise_sd=0.2, intensity=Intensity.constant(5.0))
    gap = y.copy()
    gap[400:440] = np.nan
    holed = smooth(gap, DT, chain, noise_sd=0.2, intensity=Intensity.constant(5.0))
    far = np.r_[0:300, 540:800]
    assert np.allclose(holed.temperature[far], whole.temperature[far], atol=0.01)  # 1/10 of the standard deviation
    assert holed.sd[420, 0] > 2 * whole.sd[420, 0]
    assert np.all(np.isfinite(holed.temperature))


def test_shapes_that_do_not_agree_are_refused():
    with pytest.raises(InputError, match="2 channels but 1 chains"):
        smooth(np.zeros((50, 2)), DT, [Chain((1.0,))])
