"""The law of a lag that follows a flow."""

from __future__ import annotations

import numpy as np
import pytest

from tcdyn.chain import Chain
from tcdyn.chain.law import FlowLaw, TableLaw, TemperatureLaw
from tcdyn.core.errors import InputError

LAW = FlowLaw(at=2.0, exponent=0.5, exponent_u=0.1, inner_share=0.2, inner_share_u=0.05, least=0.3)


def test_the_lag_falls_with_a_power_of_the_flow_and_has_a_limit_at_rest() -> None:
    plain = FlowLaw(at=2.0, exponent=0.5, inner_share=0.2)
    assert plain.factor([2.0, 8.0, 0.5]) == pytest.approx([1.0, 0.2 + 0.8 / 2, 0.2 + 0.8 * 2])
    assert LAW.factor(2.0) == pytest.approx(1.0)
    at_rest = 0.2 + 0.8 * (0.3 / (2.0**3 + 0.3**3) ** (1 / 3)) ** -0.5
    assert LAW.factor(0.0) == pytest.approx(at_rest)


@pytest.mark.parametrize("flow", [0.1, 0.3, 1.0, 2.0, 9.0])
def test_changes_by_uncertainties_are_derivatives(flow: float) -> None:
    of_exponent, of_share, of_flow = LAW.factor_u(flow, 0.2)
    small = 1e-6

    def factor(exponent: float = 0.5, share: float = 0.2, at: float = flow) -> float:
        law = FlowLaw(at=2.0, exponent=exponent, inner_share=share, least=0.3)
        return float(law.factor(at))

    now = factor()
    assert of_exponent == pytest.approx((factor(0.5 + small) - now) / small * 0.1, rel=1e-4)
    assert of_share == pytest.approx((factor(share=0.2 + small) - now) / small * 0.05, rel=1e-4)
    assert of_flow == pytest.approx((factor(at=flow + small) - now) / small * 0.2, rel=1e-4)


def test_only_the_film_in_the_largest_lag_follows() -> None:
    chain = Chain((8.0, 2.0), delay_s=0.5)
    assert LAW.first_lag_s(chain, LAW.factor(2.0)) == pytest.approx(8.0)
    # a film of 8 s that is halved
    half = 0.2 + 0.8 / 2
    assert LAW.first_lag_s(chain, np.array(half)) == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: FlowLaw(at=0.0, exponent=0.5), "a flow of 0"),
        (lambda: FlowLaw(at=1.0, exponent=2.0), "an exponent of 2"),
        (lambda: FlowLaw(at=1.0, exponent=0.5, inner_share=1.0), "an inner share of 1"),
        (lambda: FlowLaw(at=1.0, exponent=0.5, exponent_u=-0.1), "an uncertainty of -0.1"),
        (lambda: LAW.factor([1.0, -0.1]), "a flow of -0.1"),
        (lambda: FlowLaw(at=1.0, exponent=0.5).factor(0.0), "at which the lag has no limit"),
        (lambda: LAW.first_lag_s(Chain((5.0, 5.0)), np.ones(1)), "an inner share of at least 0.5"),
        (lambda: LAW.first_lag_s(Chain((5.0, 1.0), zero_s=0.5), np.ones(1)), "a chain with a zero"),
        (lambda: FlowLaw(at=np.inf, exponent=0.5), "a flow of inf"),
        (lambda: FlowLaw(at=1.0, exponent=0.5, exponent_u=np.nan), "an uncertainty of nan"),
        (lambda: FlowLaw(at=1.0, exponent=0.5, inner_share_u=np.nan), "inner share of nan"),
        (lambda: FlowLaw(at=1.0, exponent=0.5, least=np.nan), "a least flow of nan"),
        (lambda: TableLaw(1.0, (1.0, 2.0), (5.0, np.nan)), "2 values"),
        (lambda: TemperatureLaw(20.0, np.nan), "per degree"),
        (lambda: TemperatureLaw(20.0, 3.0), "0.03 for 3 %"),
        (lambda: TemperatureLaw(20.0, 0.1, -1.0), "per degree"),
        (lambda: TemperatureLaw(20.0, 0.1, inner_share=-0.1), "an inner share"),
        (lambda: TableLaw(1.0, (1.0,), (5.0,)), "1 values, 1 lags"),
        (lambda: TableLaw(1.0, (1.0, 1.0), (5.0, 4.0)), "2 values"),
        (lambda: TableLaw(1.0, (1.0, 2.0), (5.0, 0.0)), "2 values"),
        (lambda: TableLaw(3.0, (1.0, 2.0), (5.0, 4.0)), "the lag holds at 3"),
    ],
)
def test_what_is_not_possible_is_said(make, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_a_lag_that_falls_with_a_temperature() -> None:
    law = TemperatureLaw(at=20.0, per_degree=0.03, per_degree_u=0.004, inner_share=0.1)
    assert law.factor([20.0, 30.0, -40.0]) == pytest.approx(
        [1.0, 0.1 + 0.9 * np.exp(-0.3), 0.1 + 0.9 * np.exp(1.8)]
    )
    of_law, _, of_temperature = law.factor_u(30.0, 0.5)
    small = 1e-6

    def factor(per_degree: float = 0.03, at: float = 30.0) -> float:
        return float(TemperatureLaw(20.0, per_degree, inner_share=0.1).factor(at))

    now = factor()
    assert of_law == pytest.approx((factor(0.03 + small) - now) / small * 0.004, rel=1e-4)
    assert of_temperature == pytest.approx((factor(at=30 + small) - now) / small * 0.5, rel=1e-4)


def test_a_lag_from_a_table_is_linear_between_its_values_and_constant_beyond() -> None:
    law = TableLaw(2.0, [1, 2, 4], [30, 20, 15], u_rel=0.1, quantity="rpm")
    assert law.factor([0.5, 1.0, 1.5, 3.0, 9.0]) == pytest.approx([1.5, 1.5, 1.25, 0.875, 0.75])
    of_law, of_share, of_value = law.factor_u([2.0, 4.0, 3.0, 9.0], 0.2)
    assert of_law == pytest.approx([0.0, -0.025, -0.0125, -0.025])
    assert not of_share.any()
    assert of_value == pytest.approx([-0.125 * 0.2, 0.0, -0.125 * 0.2, 0.0])
    assert "30 s at 1, 20 s at 2, 15 s at 4" in law.summary()
