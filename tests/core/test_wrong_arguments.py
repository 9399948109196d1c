"""Arguments of other types: every public function names them in one line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tcdyn.core.errors import InputError
from tcdyn.identification import from_csv, from_frame
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow

MODULES = (
    "tcdyn",
    "tcdyn.chain",
    "tcdyn.smoothing",
    "tcdyn.identification",
    "tcdyn.sensors",
    "tcdyn.workflows",
    "tcdyn.campaign",
)
# They make a folder, or a campaign, of anything that has a path.
LEFT_OUT = {"run_demo", "simulate_campaign"}
VALUES: dict[str, Any] = {
    "None": None,
    "a number": 3,
    "a list": [1, 2],
    "a dict": {"a": 1},
    "texts": pd.DataFrame({"a": ["x", "y"]}),
    "three dimensions": np.ones((2, 2, 2)),
    "a text": "no such thing",
}
T = 0.05 * np.arange(600)
TABLE = pd.DataFrame({"time_s": T, "u": np.sign(np.sin(T)), "T1 [°C]": 20 + np.sin(T)})


def public_functions() -> dict[str, Callable[..., Any]]:
    """The public functions by name, each once."""
    functions: dict[str, Callable[..., Any]] = {
        "compensate_table": compensate_table,
        "follow": follow,
        "Response.read": tcdyn.identification.Response.read,
        "IOData.from_arrays": tcdyn.IOData.from_arrays,
    }
    for module_name in MODULES:
        module = import_module(module_name)
        for name in module.__all__:
            item = getattr(module, name)
            if inspect.isfunction(item) and name not in LEFT_OUT:
                functions.setdefault(name, item)
    return functions


def call_with(function: Callable[..., Any], value: Any) -> None:
    """Call a function with one value for everything that it needs."""
    parameters = inspect.signature(function).parameters.values()
    needed = [p for p in parameters if p.default is p.empty and p.kind < p.VAR_POSITIONAL]
    keywords = [p.name for p in parameters if p.default is p.empty and p.kind is p.KEYWORD_ONLY]
    count = max(len(needed), 1)
    function(*[value] * count, **dict.fromkeys(keywords, value))


@pytest.mark.parametrize("name", public_functions())
def test_arguments_of_a_wrong_type_are_named_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    function = public_functions()[name]
    problems: list[Exception] = []
    for value in VALUES.values():
        try:
            call_with(function, value)
        except (InputError, TypeError) as problem:
            problems.append(problem)
    for each in problems:
        assert "\n" not in str(each)
        assert isinstance(each, InputError) or f"{function.__name__}()" in str(each)
    assert len(problems) >= 4  # a number or a text may be meant


def needed_by(function: Callable[..., Any]) -> list[str]:
    """Names of the arguments that a function needs."""
    packed = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if p.default is p.empty and p.kind not in packed]


def passes_keywords_on(function: Callable[..., Any]) -> bool:
    """Whether a function takes any keywords, for another one."""
    parameters = inspect.signature(function).parameters.values()
    return any(p.kind is p.VAR_KEYWORD for p in parameters)


@pytest.mark.parametrize(
    "name", [n for n, function in public_functions().items() if not passes_keywords_on(function)]
)
def test_a_misspelt_keyword_is_named(name: str) -> None:
    function = public_functions()[name]
    with pytest.raises(TypeError, match=rf"{function.__name__}\(\).*'time_unti'"):
        function(time_unti="s", **dict.fromkeys(needed_by(function)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tcdyn.inspect(TABLE, time_unti="s"), "did you mean 'time_unit'"),
        (lambda: from_frame(TABLE, input="u", output="T1", tme="time_s"), "did you mean 'time'"),
        (lambda: from_csv("a.csv", input="u", output="y", tme="t"), "did you mean 'time'"),
        (lambda: tcdyn.sensor_from_dip(TABLE, "T1", untis="K"), "did you mean 'unit'"),
        (lambda: tcdyn.sensor_from_pair(TABLE, ("T1", "u"), untis="K"), "did you mean 'unit'"),
        (lambda: tcdyn.sensor_from_current(TABLE, "T1", "u", tim="t"), "did you mean 'time'"),
        (
            lambda: tcdyn.sensor_from_noise(TABLE, "T1", cold_junctions=0.0),
            "did you mean 'cold_junction'",
        ),
        (lambda: compensate_table("a.csv", 2.0, "b.csv", colum="T"), "did you mean 'columns'"),
        (lambda: follow("a.csv", 2.0, "b.csv", tim="t"), "did you mean 'time'"),
        (lambda: tcdyn.compensate_frame(TABLE, 2.0, wher="a=b"), "did you mean 'where'"),
        (lambda: tcdyn.view("log.csv", untt="K"), "did you mean 'unit'"),
        (lambda: tcdyn.identify(TABLE, input="u", output="T1", nois="white"), "'noise'"),
        (lambda: tcdyn.smooth(T, 0.05, tcdyn.Chain(1.0), unit=["K"]), "did you mean 'units'"),
    ],
)
def test_the_nearest_keyword_is_proposed(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tcdyn.compensate_frame(TABLE, 2.0, columns=5), "columns is 5; expected the name"),
        (lambda: tcdyn.compensate_frame(TABLE, 2.0, columns=[None]), "columns holds None"),
        (lambda: tcdyn.compensate_frame([1, 2], 2.0), "data is a list"),
        (lambda: tcdyn.inspect(TABLE, columns={"T1": 1}), "columns is a dict"),
        (lambda: tcdyn.inspect(TABLE, time=3), "time is 3; expected str or None"),
        (lambda: tcdyn.sensor_from_pair(TABLE, columns=3), "columns is 3"),
        (lambda: tcdyn.sensor_from_dip(TABLE, column=3), "column"),
        (lambda: tcdyn.sensor_from_dip((T, T, T)), "3 arrays of the shapes"),
        (lambda: from_frame(TABLE, input=3, output="T1"), "input is 3; expected str or Sequence"),
        (lambda: tcdyn.identify(TABLE, input=["u", None], output="T1"), "input column .* NoneType"),
        (lambda: tcdyn.identify(TABLE), "no input or no output"),
        (lambda: tcdyn.view("log.csv", None), "sensors is None"),
        (lambda: follow("log.csv", 25, None), "out is None"),
        (lambda: tcdyn.read_sensor(None), "path is None; expected str or Path"),
    ],
)
def test_one_wrong_argument_among_others_is_named(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
