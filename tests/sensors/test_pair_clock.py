"""A pair of sensors on two loggers: the delay that drifts is named with its rate.

The records of ``pair_clock_study`` are sums of sines at exact times.
"""

from __future__ import annotations

import pytest

from tests.sensors.pair_clock_study import pair_of, rate_of


@pytest.mark.parametrize("rate", [1e-4, -3e-4])
def test_the_rate_of_two_clocks_is_found_within_its_uncertainty(rate: float) -> None:
    found = rate_of(pair_of(1, rate))
    assert found is not None
    rate_ppm, u_ppm = found
    assert abs(rate_ppm - 1e6 * rate) < 3 * u_ppm
    assert u_ppm < 30


@pytest.mark.parametrize("noise", ["white", "ar", "drift"])
def test_one_clock_gives_no_warning(noise: str) -> None:
    assert rate_of(pair_of(0, noise=noise)) is None


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("noise", ["white", "ar", "drift"])
def test_false_alarms_are_rare(noise: str) -> None:
    alarms = sum(rate_of(pair_of(seed, noise=noise)) is not None for seed in range(60))
    # at 1e-3, two of 60 have a probability of 0.2 %
    assert alarms <= 1


@pytest.mark.parametrize("change", [0.1, 0.3])
def test_lags_that_change_along_the_record_are_no_clock(change: float) -> None:
    assert rate_of(pair_of(0, change=change)) is None
