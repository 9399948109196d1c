"""Options as a dataclass: types, limits, choices, unknown names, numbers with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tcdyn.core.arguments import UnknownKeywordError
from tcdyn.core.errors import InputError
from tcdyn.core.options import (
    NumberWithU,
    Options,
    number_with_u,
    option,
    options_of,
    split_docstring,
    texts_of,
)


@dataclass(frozen=True)
class Rows(Options):
    """How rows are read.

    Attributes
    ----------
    dt_s
        sampling interval
    unit
        unit of the readings
    """

    dt_s: float | None = option(None, low=1e-3, high=10)
    unit: str = option("K", choices=("K", "degC"))


@dataclass(frozen=True)
class Fit(Rows):
    """How a model is fitted.

    Attributes
    ----------
    order
        order of the model
    share
        share for validation
    robust
        Huber loss
    out
        file to write
    knots_s
        instants of the knots
    lag_s
        lag with its standard uncertainty
    """

    order: int = option(2, "Model", low=1, high=float("inf"))
    share: float = option(0.3, "Model", low=0, high=1, ends=False)
    robust: bool = option(False, "Model")
    out: Path | None = option(None, "Output")
    knots_s: Sequence[float] = option((), "Model", low=0, high=100, takes=list[float])
    lag_s: NumberWithU = option("1+-0.1", "Sensor", takes=str)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"dt_s": 2},  # an int is a number
        {"dt_s": np.float64(2.0)},
        {"dt_s": None},
        {"dt_s": 1e-3},  # the ends are allowed
        {"dt_s": 10.0},
        {"order": np.int64(1)},
        {"order": 10**9},
        {"share": 0.999},
        {"robust": True},
        {"out": "a.csv"},
        {"out": Path("a.csv")},
        {"unit": "degC"},
        {"knots_s": (0.0, 100.0)},
        {"lag_s": (1.0, 0.1)},
    ],
)
def test_values_of_the_type_within_the_limits_are_kept(given: dict[str, Any]) -> None:
    made = Fit(**given)
    assert all(getattr(made, name) is value for name, value in given.items())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dt_s": "2"}, "dt_s is '2'; expected float or None"),
        ({"dt_s": True}, "dt_s is True; expected float or None"),
        ({"dt_s": [1.0] * 100}, "dt_s is a list; expected float or None"),
        ({"dt_s": 0.0}, "dt_s is 0; expected 0.001 to 10"),
        ({"dt_s": float("nan")}, "dt_s is nan; expected 0.001 to 10"),
        ({"order": 1.5}, "order is 1.5; expected int"),
        ({"order": 0}, "order is 0; expected at least 1"),
        ({"order": None}, "order is None; expected int"),
        ({"share": 1}, "share is 1; expected above 0 and below 1"),
        ({"robust": 1}, "robust is 1; expected bool"),
        ({"out": 3}, "out is 3; expected Path or None"),
        ({"unit": 3}, "unit is 3; expected str"),
        ({"unit": "F"}, "unit is 'F'; expected K or degC"),
        ({"knots_s": [1.0, 101.0]}, "knots_s is 101; expected 0 to 100"),
    ],
)
def test_another_value_is_refused_with_what_was_expected(
    given: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        Fit(**given)
    assert str(caught.value) == message
    (name,) = given
    assert caught.value.message(lambda each, value: f"--{each}").startswith(f"--{name} is ")


def test_a_long_text_is_shortened_in_the_message() -> None:
    with pytest.raises(InputError) as caught:
        Fit(dt_s="x" * 500)  # type: ignore[arg-type]
    assert len(str(caught.value)) < 100


def test_stated_are_the_options_that_differ_from_their_defaults() -> None:
    assert Fit().stated == {}
    assert Fit(order=2, unit="K").stated == {}
    made = Fit(order=3, knots_s=[1.0], dt_s=0.5)
    assert made.stated == {"dt_s": 0.5, "order": 3, "knots_s": [1.0]}
    assert Fit(**made.stated) == made


def test_keyword_arguments_become_options() -> None:
    assert options_of(Fit, {"order": 3, "dt_s": 1.0}, "fit") == Fit(dt_s=1.0, order=3)
    with pytest.raises(InputError, match=r"^order is 0; expected at least 1$"):
        options_of(Fit, {"order": 0}, "fit")


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("knots", "did you mean 'knots_s'?"),
        ("Order", "did you mean 'order'?"),
        ("zzz", "they are dt_s, knots_s, lag_s, order, out, robust, share, unit"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest_one(name: str, remedy: str) -> None:
    with pytest.raises(UnknownKeywordError) as caught:
        options_of(Fit, {name: 1}, "fit")
    assert str(caught.value) == f"fit() got an unexpected keyword argument {name!r}; {remedy}"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (2, (2.0, 0.0)),
        (-2.5, (-2.5, 0.0)),
        ("2", (2.0, 0.0)),
        ("2+-0.5", (2.0, 0.5)),
        (" 2 +/- 0.5 ", (2.0, 0.5)),
        ("2 ± 0.5", (2.0, 0.5)),
        ("1e3+-1e-3", (1000.0, 0.001)),
        ((2, 0.5), (2.0, 0.5)),
        ([2, 0.5], (2.0, 0.5)),
        ("2+-", (2.0, 0.0)),
        (1e9, (1e9, 0.0)),
    ],
)
def test_a_number_with_its_uncertainty(value: Any, expected: tuple[float, float]) -> None:
    assert number_with_u(value, "lag_s") == expected


@pytest.mark.parametrize(
    "value",
    ["", "x", "2+-x", "2+-0.5+-1", "2+--0.5", "nan", "2+-nan", "inf", 1.1e9, (1, 2, 3), None, {}],
)
def test_another_text_is_no_number_with_its_uncertainty(value: Any) -> None:
    with pytest.raises(InputError) as caught:
        number_with_u(value, "lag_s")
    assert str(caught.value).startswith("lag_s is ")
    assert "expected a number" in str(caught.value)


def test_the_limit_of_a_number_can_be_another_one() -> None:
    assert number_with_u(1e12, "entry_s", 1e12) == (1e12, 0.0)
    with pytest.raises(InputError, match="within 10"):
        number_with_u(11, "lag_s", 10)


def test_the_texts_of_a_class_are_those_of_its_bases_too() -> None:
    texts = texts_of(Fit)
    assert texts["dt_s"] == "sampling interval"
    assert texts["lag_s"] == "lag with its standard uncertainty"
    assert {*texts} - {""} == {
        "dt_s",
        "unit",
        "order",
        "share",
        "robust",
        "out",
        "knots_s",
        "lag_s",
    }


def test_the_text_of_a_docstring_without_sections() -> None:
    assert split_docstring(test_the_texts_of_a_class_are_those_of_its_bases_too)[0] == ""
    assert split_docstring(Rows)[0] == "How rows are read."
