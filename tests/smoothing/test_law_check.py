"""A law of a lag that the readings contradict is named; one that is right is not."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn import Chain
from tcdyn.chain import NO_CONDITIONING, FlowLaw
from tcdyn.core import Array
from tcdyn.core.findings import Finding
from tcdyn.smoothing import smooth
from tests.smoothing.flow_study import DT_S, FINE, ROWS, film_of, lags_of, reading_of

FILM_S, INNER_S = 8.0, 1.5
LARGEST_S, REST_S = lags_of(FILM_S, INNER_S)
SHARE = 1 - FILM_S / (LARGEST_S + REST_S)
CHAIN = Chain((LARGEST_S, REST_S), conditioning=NO_CONDITIONING)


@pytest.fixture(scope="module")
def record() -> tuple[Array, Array]:
    """Readings of a cylinder behind a film with the exponent 0.5, and the flow."""
    t = DT_S / FINE * np.arange(ROWS * FINE)
    flow = np.where(t // 25 % 2 == 0, 2.0, 8.0)
    truth = 60 + 10 * np.sin(t / 6) + 4 * np.sin(t / 2.5)
    readings = reading_of(truth, film_of(flow, 0.5), FILM_S, INNER_S, DT_S / FINE)
    noise_K = 0.05 * np.random.default_rng(2).standard_normal(ROWS)
    return readings[::FINE] + noise_K, flow[::FINE]


def found(readings: Array, flow: Array, exponent: float, u: float = 0.05) -> list[Finding]:
    law = FlowLaw(2.0, exponent, u, SHARE, 0.05, quantity="v_m_s")
    result = smooth(readings, DT_S, CHAIN, laws=law, flow=flow)
    return [finding for finding in result.findings if finding.code == "trace.law"]


def test_the_right_law_is_not_contradicted(record: tuple[Array, Array]) -> None:
    assert not found(*record, 0.5)


def test_a_lag_that_follows_although_the_law_says_no(record: tuple[Array, Array]) -> None:
    readings, flow = record
    other = np.roll(flow, 25)
    (finding,) = found(readings, other, 0.5)
    assert finding.numbers["strength"] == 0
    assert "does not follow v_m_s at all" in finding.sentence


def test_an_exponent_that_is_twice_as_large(record: tuple[Array, Array]) -> None:
    (finding,) = found(*record, 1.0)
    assert finding.numbers["strength"] == 0.5
    assert "0.5 times as large" in finding.sentence


def test_a_law_is_not_contradicted_within_its_uncertainty(record: tuple[Array, Array]) -> None:
    assert not found(*record, 0.75, 0.25)


def test_a_flow_that_hardly_changes_shows_nothing(record: tuple[Array, Array]) -> None:
    readings, flow = record
    assert not found(readings, np.full_like(flow, 2.0), 1.0)
