"""The state-space model of a record: its points, process noise, prior, and likelihood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from tcdyn.chain import NO_CONDITIONING, Chain, sensors
from tcdyn.smoothing import Intensity
from tcdyn.smoothing.corner import corner_rad_s
from tcdyn.smoothing.record import Record, record_of
from tcdyn.smoothing.state_space import (
    channel_ranges,
    likelihood,
    point_models,
    points_of,
    ramp_prior,
    slope_prior_sd,
    steps_of,
)

DT, N = 0.1, 60


def stretch(seed: int = 0, lost: tuple[int, ...] = (), delay_s: float = 0.0) -> Record:
    rng = np.random.default_rng(seed)
    x = 20 + 5 * np.sin(np.arange(N) * DT / 2)
    chain = Chain((0.3,), delay_s=delay_s, conditioning=NO_CONDITIONING)
    y = chain.response(x, DT) + 0.1 * rng.standard_normal(N)
    y[list(lost)] = np.nan
    return record_of(y, DT, chain, noise_sd=0.1)


def dense(of: Record, noise_var: float, q: float) -> tuple[float, float]:
    """Log likelihood of the good samples, and their squares over ``noise_var``, per degree of
    freedom: all samples as one normal vector.

    The process noise of a step is integrated by the midpoint rule over 200 parts.
    """
    (s,) = of.sensors
    mean, factor = ramp_prior(
        s, float(of.y[of.weight[:, 0] > 0, 0][0]), float(channel_ranges(of)[0]), DT, q
    )
    slope_var = slope_prior_sd(s, float(channel_ranges(of)[0]), DT) ** 2
    a = expm(s.drift * DT)
    part_s = DT / 200
    columns = [expm(s.drift * (k + 0.5) * part_s)[:, 1] for k in range(200)]
    noise = q * part_s * sum(np.outer(column, column) for column in columns)
    values, vectors = np.linalg.eigh(noise)
    noise_root = vectors * np.sqrt(np.maximum(values, 0.0))
    rows, centre = [], []
    state, blocks = mean, [factor]
    for k in range(N):
        if k:
            state, blocks = a @ state, [*(a @ b for b in blocks), noise_root]
        if round(k * DT, 9) in of.events_s:
            jump = np.zeros((len(mean), 1))
            jump[1] = np.sqrt(slope_var)
            blocks.append(jump)
        centre.append(float(s.output @ state))
        rows.append(np.concatenate([s.output @ b for b in blocks]))
    table = np.zeros((N, len(rows[-1])))
    for k, row in enumerate(rows):
        table[k, : len(row)] = row
    seen = of.weight[:, 0] > 0
    spread = table[seen] @ table[seen].T + noise_var * np.eye(seen.sum())
    y, m = of.y[seen, 0], np.array(centre)[seen]
    ln = float(multivariate_normal(m, spread).logpdf(y)) + 0.5 * seen.sum() * np.log(2 * np.pi)
    return ln, float((y - m) @ np.linalg.solve(spread, y - m)) / (seen.sum() - 2 - len(of.events_s))


@pytest.mark.parametrize(("lost", "events"), [((), ()), ((10, 11, 30), ()), ((), (2.5,))])
def test_the_likelihood_is_that_of_all_samples_together(
    lost: tuple[int, ...], events: tuple[float, ...]
) -> None:
    of = replace(stretch(0, lost), events_s=events)
    for noise_var, q in ((0.01, 1.0), (0.01, 30.0), (0.04, 1.0), (0.0025, 0.1)):
        value, ratio = likelihood(of, np.array([noise_var]), [[Intensity.constant(q)]])
        log_likelihood, expected = dense(of, noise_var, q)
        # the noise of the dense model is integrated to one part in 10,000
        assert float(value[0, 0]) == pytest.approx(log_likelihood, abs=1e-3)
        assert float(ratio[0, 0]) == pytest.approx(expected, rel=1e-4)


def test_the_corner_is_where_the_signal_sinks_into_the_noise() -> None:
    """Without a lag w^4 = q/R; behind a long one w^6 = q/(R tau^2)."""
    ratio = np.array([1e-2, 1.0, 1e4])
    none, long = (
        corner_rad_s(Chain(taus, conditioning=NO_CONDITIONING), ratio) for taus in ((), (1e3,))
    )
    assert none == pytest.approx(
        ratio**0.25, rel=2e-3
    )  # straight lines between 400 points of eight decades
    assert long == pytest.approx((ratio / 1e6) ** (1 / 6), rel=2e-3)


@pytest.mark.parametrize(("delay_s", "alternate"), [(0.0, False), (0.3, False), (0.25, True)])
def test_points_are_samples_readings_and_events(delay_s: float, alternate: bool) -> None:
    of = stretch(1, delay_s=delay_s)
    event = 2.53
    points = points_of(of, [event, 2.0, 99.0], of.sensors[0])
    sample_s = np.arange(N) * DT
    expected = np.unique(np.round([*sample_s, *(sample_s - delay_s), event], 9))
    assert points.time_s == pytest.approx(expected, abs=1e-12)
    assert {event, 2.0} <= set(points.time_s)  # the very times, not those of a sample
    assert points.time_s[points.sample] == pytest.approx(sample_s, abs=1e-12)
    assert points.time_s[points.reading] == pytest.approx(sample_s - delay_s, abs=1e-12)
    steps_s = points.step_s[points.kind[:-1]]
    assert steps_s == pytest.approx(np.diff(points.time_s), abs=1e-12)
    _, (model,) = point_models(of, 0, 0.01, [Intensity.constant(1.0)], 1.0)
    assert model.period == (2 if alternate else 1)


@pytest.mark.parametrize("step_s", [1e-4, 0.1, 30.0])
@pytest.mark.parametrize("chain", [Chain(()), Chain((0.5, 0.01)), Chain((1.0,), cement_s=0.05)])
def test_process_noise_of_a_step_is_the_integral_over_it(chain: Chain, step_s: float) -> None:
    (s,) = sensors([chain])
    transition, level_noise, slope_noise = steps_of(s, step_s)
    assert transition == pytest.approx(expm(s.drift * step_s), rel=1e-9, abs=1e-12)
    for i, found in ((0, level_noise), (1, slope_noise)):
        exact, _ = quad_vec(
            lambda t, i=i: np.outer(expm(s.drift * t)[:, i], expm(s.drift * t)[:, i]),
            0.0,
            step_s,
            epsabs=1e-40,
            epsrel=1e-10,
        )
        size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        assert (np.abs(found - exact) <= 1e-6 * size + 1e-300).all()


def test_before_a_record_level_and_slope_are_as_unknown_as_ten_of_its_ranges() -> None:
    """The slope: ten ranges in the chain's lag and four samples."""
    of = stretch(0)
    (s,) = of.sensors
    mean, factor = ramp_prior(s, 20.0, 3.0, DT, 0.0)
    cov = factor @ factor.T
    slope_sd = 30.0 / (0.3 + 4 * DT)
    assert slope_prior_sd(s, 3.0, DT) == pytest.approx(slope_sd)
    assert float(s.output @ mean) == pytest.approx(20.0)
    assert float(mean[0]) == pytest.approx(20.0)
    assert cov[0, 0] == pytest.approx(30.0**2)
    assert cov[1, 1] == pytest.approx(slope_sd**2)
    # a ramp comes 0.3 s late
    assert float(s.output @ cov @ s.output) == pytest.approx(30.0**2 + (0.3 * slope_sd) ** 2)
