"""Columns that a logger repeats until their sensor has a new value, and outputs that are blank.

The records come from a lag and a dead time, in steps of a twentieth of a row. ``python -m
tests.identify.test_identify_repeats COUNT`` prints the coverage over more records.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.core import Array
from tcdyn.estimation.arma import NoiseModel
from tcdyn.identification import Fit, compare, fit, from_frame
from tests.cli.test_main_job import tcdyn

DT_S = 0.1
LAG_s = 3.0
DEAD_s = 1.0
STEPS = 20  # of the simulation in one row
ROWS = 4000


def response(u: Array, held: bool) -> Array:
    """A first-order lag after a dead time, at the rows of the input."""
    rows = np.arange(len(u) * STEPS) / STEPS
    fine = np.repeat(u, STEPS) if held else np.interp(rows, np.arange(len(u)), u)
    delay = round(DEAD_s / DT_S * STEPS)
    late = np.concatenate([np.full(delay, fine[0]), fine])[: len(fine)]
    driving = late[:-1] if held else 0.5 * (late[:-1] + late[1:])
    y = np.empty(len(fine))
    y[0] = late[0]
    keep = np.exp(-DT_S / STEPS / LAG_s)
    for k in range(1, len(fine)):
        y[k] = keep * y[k - 1] + (1 - keep) * driving[k - 1]
    return y[::STEPS]


def heater(rng: np.random.Generator) -> Array:
    """A heater that is switched at random times, multiples of 15 s."""
    return np.repeat(rng.choice([20.0, 80.0], ROWS // 150 + 1), 150)[:ROWS]


def fluid(rng: np.random.Generator) -> Array:
    """A fluid whose temperature changes within some seconds."""
    window = np.exp(-np.arange(300) / 30)
    return 50 + np.convolve(np.cumsum(rng.normal(0, 1, ROWS)), window / window.sum())[:ROWS]


def repeated(values: Array, period: int, first: int = 0) -> Array:
    """A column with a new value at row ``first`` and every ``period`` rows."""
    row = np.arange(len(values))
    return np.asarray(values[np.maximum((row - first) // period * period + first, 0)])


def at_random_rows(values: Array, share: float, rng: np.random.Generator) -> Array:
    """A column with new values at a share of the rows, at random."""
    is_new = rng.random(len(values)) < share
    is_new[0] = True
    return np.asarray(values[np.maximum.accumulate(np.where(is_new, np.arange(len(values)), 0))])


def table(u: Array, y: Array) -> pd.DataFrame:
    """The record with rounded values."""
    time_s = DT_S * np.arange(len(u))
    return pd.DataFrame({"time_s": time_s.round(3), "u_degC": u.round(3), "T_degC": y.round(3)})


def record(kind: str, seed: int) -> pd.DataFrame:
    """A record of one kind."""
    rng = np.random.default_rng(seed)
    held = kind.startswith("heater")
    u = heater(rng) if held else fluid(rng)
    y = response(u, held) + rng.normal(0, 0.05, ROWS)
    if not held:
        u = u + rng.normal(0, 0.05, ROWS)
    match kind.partition(", ")[2]:
        case "every 5 rows":
            y = repeated(y, 5, 2)
        case "every 20 rows":
            y = repeated(y, 20)
        case "at random rows":
            y = at_random_rows(y, 0.2, rng)
        case "blank":
            y = np.where(np.arange(ROWS) % 5 == 1, y, np.nan)
        case "both every 5 rows":
            u, y = repeated(u, 5), repeated(y, 5)
        case "input every 10 rows":
            u = repeated(u, 10)
        case _:
            raise ValueError(kind)
    return table(u, y)


def lag_error(result: Fit) -> tuple[float, float]:
    """Error of lag plus dead time, and its standard uncertainty [s]."""
    theta = result.identified.theta
    position = [result.identified.model.free.index(name) for name in ("Tp1", "Td")]
    variance = result.identified.covariance[np.ix_(position, position)].sum()
    return theta["Tp1"] + theta["Td"] - LAG_s - DEAD_s, float(np.sqrt(variance))


KINDS = [
    "heater, every 5 rows",
    "heater, every 20 rows",
    "heater, at random rows",
    "fluid, every 5 rows",
    "fluid, at random rows",
    "fluid, blank",
    "fluid, both every 5 rows",
]


@pytest.mark.e2e
@pytest.mark.parametrize("kind", KINDS)
def test_repeated_values_are_left_out(kind: str) -> None:
    data = from_frame(record(kind, 1), input="u_degC", output="T_degC")
    codes = {finding.code for finding in data.findings}
    assert ("series.repeats" in codes) is ("blank" not in kind)
    error_s, u_s = lag_error(fit(data, "P1D"))
    assert abs(error_s) < 4 * u_s
    assert 0.0005 < u_s < 0.02


def coverage(kind: str, count: int) -> tuple[int, float]:
    """Number of ``count`` records whose 95 % interval holds the truth, and the rms error [s]."""
    inside = 0
    squares = []
    for seed in range(100, 100 + count):
        data = from_frame(record(kind, seed), input="u_degC", output="T_degC")
        error_s, u_s = lag_error(fit(data, "P1D"))
        inside += abs(error_s) < 1.96 * u_s
        squares.append(error_s**2)
    return inside, float(np.sqrt(np.mean(squares)))


@pytest.mark.study
@pytest.mark.long
def test_the_intervals_hold_the_lag() -> None:
    assert sum(coverage(kind, 8)[0] for kind in KINDS) >= 48


@pytest.mark.e2e
def test_a_comparison_finds_the_model_of_a_slow_output() -> None:
    data = from_frame(record("fluid, every 5 rows", 5), input="u_degC", output="T_degC")
    result = compare(data, ["P1", "P1D", "P2D"])
    assert result.recommended == "P1D"
    assert abs(result.best.identified.lag_s.value - LAG_s - DEAD_s) < 0.02


def test_a_coarse_logger_a_set_output_and_a_noisefree_plant_are_no_slow_columns() -> None:
    rng = np.random.default_rng(4)
    u = heater(rng)
    y = response(u, held=True)
    quiet = y.copy()
    quiet[quiet < 20.001] = 20.0
    for output in (np.round(y + rng.normal(0, 0.1, ROWS), 0), quiet):
        data = from_frame(table(u, output), input="u_degC", output="T_degC")
        assert data.n_missing == 0
    exchanged = from_frame(table(u, y), input="T_degC", output="u_degC")
    assert exchanged.n_missing == 0


def test_a_staircase_that_was_set_keeps_its_rows() -> None:
    rng = np.random.default_rng(6)
    u = np.repeat(rng.uniform(20, 80, ROWS // 20), 20)
    y = response(u, held=True) + rng.normal(0, 0.05, ROWS)
    data = from_frame(table(u, y), input="u_degC", output="T_degC")
    assert (data.holds, data.findings) == (("zoh",), ())
    assert data.dt_s == pytest.approx(DT_S)


def test_a_slow_input_beside_an_output_that_is_not_is_taken_as_the_user_says() -> None:
    frame = record("fluid, input every 10 rows", 8)
    data = from_frame(frame, input="u_degC", output="T_degC")
    assert (data.holds, [f.code for f in data.findings]) == (("zoh",), ["record.slow_input"])
    assert "give hold=foh" in data.findings[0].sentence
    assert not from_frame(frame, input="u_degC", output="T_degC", hold="zoh").findings
    measured = from_frame(frame, input="u_degC", output="T_degC", hold="foh")
    assert measured.dt_s == pytest.approx(10 * DT_S)
    error_s, u_s = lag_error(fit(measured, "P1D"))
    assert abs(error_s) < max(4 * u_s, (10 * DT_S) ** 2 / 12 / LAG_s)


def test_noise_that_starts_at_rest_is_stationary_after_a_gap() -> None:
    """A sample alone after a gap has the variance of the noise, 1/(1 - 0.8^2) of the innovation."""
    noise = NoiseModel((-0.8,), starts_at_rest=True)
    slices = [slice(0, 2), slice(2, 3)]
    whitened = noise.whiten(np.ones(3), slices)
    assert whitened == pytest.approx([1.0, 0.2, 0.6])
    assert noise.log_determinant(slices) == pytest.approx(-np.log(0.36))


@pytest.mark.e2e
def test_the_command_reports_a_slow_column(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record("heater, every 5 rows", 2).to_csv(tmp_path / "log.csv", index=False)
    words = ("identify", tmp_path / "log.csv", "--input", "u_degC", "--output", "T_degC")
    assert tcdyn(*words, "--model", "P1D", "--out", tmp_path / "model.json") == 0
    message = "T_degC has a new value in 20 % of the rows (every 0.5 s on average)"
    assert message in capsys.readouterr().err
    codes = [f["code"] for f in json.loads((tmp_path / "model.json").read_text())["findings"]]
    assert "series.repeats" in codes


if __name__ == "__main__":
    for each in KINDS:
        print(each, *coverage(each, int(sys.argv[1])), flush=True)
