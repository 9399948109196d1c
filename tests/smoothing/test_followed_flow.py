"""Lags that follow a flow: against a constant lag, and sheaths by finite volumes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.law import FlowLaw, TemperatureLaw
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.smoothing import smooth
from tests.smoothing.flow_study import judge

DT_S = 0.5
ROWS = 300
LAW = FlowLaw(at=2.0, exponent=0.5, inner_share=0.2)
STEEP = TemperatureLaw(20.0, -0.5, inner_share=0.2)
CHAIN = Chain((8.0, 2.0), conditioning=NO_CONDITIONING)


def readings(chain: Chain, seed: int = 1) -> Array:
    """Readings of two sines."""
    t = DT_S * np.arange(ROWS)
    truth = 60 + 10 * np.sin(t / 6) + 3 * np.sin(t / 2.5)
    return chain.response(truth, DT_S) + 0.05 * np.random.default_rng(seed).standard_normal(ROWS)


@pytest.mark.parametrize(("flow", "first_s"), [(2.0, 8.0), (8.0, 4.0), (0.5, 16.0)])
def test_at_a_constant_flow_it_is_the_chain_with_that_lag(flow: float, first_s: float) -> None:
    """The lag of 10 s at the flow of the law is uncertain by 2 %: so is that at any flow."""
    constant = Chain((first_s, 2.0), conditioning=NO_CONDITIONING)
    y = readings(constant)
    expected = smooth(y, DT_S, constant, lag_covariance=[[(0.02 * (first_s + 2.0)) ** 2]])
    found = smooth(
        y, DT_S, CHAIN, laws=LAW, flow=np.full(ROWS, flow), lag_covariance=[[(0.02 * 10.0) ** 2]]
    )
    # the lag is rounded to a quarter of a percent
    difference = np.abs(found.temperature - expected.temperature) / expected.sd
    assert difference.max() < 0.5
    assert found.sd == pytest.approx(expected.sd, rel=0.05)


def test_an_uncertain_law_widens_the_band_where_the_flow_differs() -> None:
    y = readings(CHAIN)
    flow = np.where(np.arange(ROWS) < ROWS // 2, 2.0, 8.0)
    vague = FlowLaw(at=2.0, exponent=0.5, exponent_u=0.1, inner_share=0.2)
    sharp_sd = smooth(y, DT_S, CHAIN, laws=LAW, flow=flow).sd[:, 0]
    vague_sd = smooth(y, DT_S, CHAIN, laws=vague, flow=flow).sd[:, 0]
    same, other = slice(20, ROWS // 2 - 40), slice(ROWS // 2 + 20, ROWS - 20)
    assert vague_sd[same] == pytest.approx(sharp_sd[same], rel=0.02)
    assert np.median(vague_sd[other]) > 2 * np.median(sharp_sd[other])


def test_only_the_channels_with_a_law_follow() -> None:
    y = readings(CHAIN)
    flow = np.full(ROWS, 8.0)
    alone = smooth(y, DT_S, CHAIN).temperature[:, 0]
    both = smooth(np.stack([y, y], axis=1), DT_S, CHAIN, laws=[None, LAW], flow=flow)
    assert both.temperature[:, 0] == pytest.approx(alone, abs=0.02)
    assert np.abs(both.temperature[:, 1] - alone).max() > 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"laws": LAW}, "laws of the lags without a flow"),
        ({"flow": np.ones(ROWS)}, "laws of the lags without a flow"),
        ({"laws": [LAW, LAW], "flow": np.ones(ROWS)}, "2 laws for 1 channels"),
        ({"laws": LAW, "flow": np.ones(5)}, "a flow of shape"),
        ({"laws": LAW, "flow": np.full(ROWS, np.nan)}, "the flow is missing in row 0"),
        ({"laws": LAW, "flow": np.ones(ROWS), "flow_u": np.nan}, "an uncertainty of the flow"),
        ({"laws": LAW, "flow": np.ones(ROWS), "flow_u": np.ones(5)}, r"of shape \(5,\)"),
        ({"laws": LAW, "flow": np.ones(ROWS), "flow_u": -1.0}, "at least -1"),
        (
            {"laws": TemperatureLaw(20.0, -0.5, inner_share=0.2), "flow": np.full(ROWS, 9000.0)},
            "gives a lag of inf",
        ),
    ],
)
def test_what_does_not_belong_together_is_said(arguments: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        smooth(readings(CHAIN), DT_S, CHAIN, **arguments)


@pytest.mark.e2e
@pytest.mark.parametrize("name", ["steps by four", "turbulence", "down to zero"])
def test_sheaths_in_a_changing_flow_are_covered(name: str, draws: Callable[[int], int]) -> None:
    found = np.array([judge(name, k, 95100) for k in range(draws(8))])
    cover, square, _, of_constant, _, contradicted = found.T
    assert cover.mean() > 0.9
    assert contradicted.sum() <= 1
    assert np.sqrt(square.mean()) < np.sqrt(of_constant.mean()) / 3


def test_a_flow_of_each_row_holds_at_the_row() -> None:
    """Readings at the rows of a flow that is linear between them: half a row matters."""
    fine = 40
    rng = np.random.default_rng(3)
    t = DT_S / fine * np.arange(ROWS * fine)
    truth = 60 + 10 * np.sin(t / 6) + 3 * np.sin(t / 2.5)
    flow = 5 + 3 * np.sin(2 * np.pi * t / 8)
    law = FlowLaw(at=2.0, exponent=0.6)
    rate = 1 / (10 * law.factor(flow))
    reading = np.empty(len(t))
    reading[0] = truth[0]
    for k in range(1, len(t)):
        share = np.exp(-0.5 * (rate[k] + rate[k - 1]) * DT_S / fine)
        middle = 0.5 * (truth[k] + truth[k - 1])
        reading[k] = share * reading[k - 1] + (1 - share) * middle
    y = reading[::fine] + 0.02 * rng.standard_normal(ROWS)
    chain = Chain((10.0,), conditioning=NO_CONDITIONING)
    inside = slice(20, -20)
    errors = []
    for shift in (0, fine):  # the flow of the row itself, and that of the next one
        column = np.roll(flow, -shift)[::fine]
        result = smooth(y, DT_S, chain, laws=law, flow=column)
        errors.append(np.std((result.temperature[:, 0] - truth[::fine])[inside]))
    assert errors[0] < 0.5 * errors[1]
