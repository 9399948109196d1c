"""The comparison of models on a part of a large record gives what that on all rows gives."""

from __future__ import annotations

import numpy as np
import pytest

import tcdyn.identification.large_records as large
from tcdyn.identification import IOData, compare, fit
from tests.identify.bare_cases import NOISE_K, fine_response, levels

# from the simulator's step of 5 ms: a lag of 574 samples, so that blocks of a few rows are short
DT_S = 0.005
HOLD = 200  # samples of a level


def finely_sampled(n: int, seed: int, hold: str = "zoh") -> IOData:
    """Case A sampled a hundred times faster than its shorter lag, white noise."""
    rng = np.random.default_rng(seed)
    u = levels(rng, n, HOLD)
    y = fine_response(u) + NOISE_K * rng.normal(size=n)
    return IOData.from_arrays(u, y, DT_S, hold=hold)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_block_means_of_a_ramp_and_its_response_stay_on_the_same_line(hold):
    """A ramp passes a lag and a dead time as itself, later by their sum; so do its means."""
    later = 0.5 if hold == "zoh" else 0.0  # a held ramp is half a sample late
    t = np.arange(23.0)
    means = large.block_means(IOData.from_arrays(t, t - 3.0 - later, 1.0, hold=hold), 5)
    assert means.hold == "foh"
    assert (means.dt_s, means.n_samples) == (5.0, 4)
    delay = (means.runs[0].u - means.runs[0].y)[1:]  # before the first row, the input is constant
    np.testing.assert_allclose(delay, 3.0)


def test_a_block_with_a_gap_is_missing_and_windows_with_excitation_are_taken(monkeypatch):
    monkeypatch.setattr(large, "MAX_SEARCH_ROWS", 50)
    monkeypatch.setattr(large, "LEAD_IN_ROWS", 8)
    u = np.zeros(400)
    u[210:230] = 1.0
    y = np.arange(400.0)
    y[212] = np.nan
    data = IOData.from_arrays(u, y, 0.5, start_s=7.0, hold="foh")
    means = large.block_means(data, 4)
    assert np.flatnonzero(np.isnan(means.runs[0].y)).tolist() == [53]
    window = large.most_excited(data)
    (run,) = window.runs
    assert (run.n, run.start_s) == (58, 7.0 + 192 * 0.5)
    assert run.u.sum() == 20.0
    assert np.flatnonzero(np.isnan(run.y)).tolist() == [*range(8), 20]


def test_a_gap_of_a_night_does_not_make_a_record_large():
    """Two parts of a record, a day apart, each with its own response."""
    u = np.repeat(np.random.default_rng(3).choice([20.0, 60.0], 20), 30)
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = y[k - 1] + (0.6 * u[k - 1] - y[k - 1]) * (1 - np.exp(-0.5 / 18))
    night = np.full(2 * 86_400, np.nan)
    data = IOData.from_arrays(
        np.concatenate([u, night, u]), np.concatenate([y, night, y]) + 40.0, 0.5, hold="zoh"
    )
    (part,) = compare(data, ["P1"]).fits["P1"].identified.by_input.values()
    assert part.lag_s.value == pytest.approx(18.0, abs=0.01)
    assert part.gain == pytest.approx(0.6, abs=1e-4)


def test_windows_lie_outside_a_gap(monkeypatch):
    monkeypatch.setattr(large, "MAX_SEARCH_ROWS", 50)
    u = np.concatenate([np.arange(100.0), np.full(300, np.nan), np.zeros(100)])
    window = large.most_excited(IOData.from_arrays(u, u, 0.5, hold="foh"))
    assert all(np.isfinite(run.u).all() for run in window.runs)


def test_a_large_record_is_fitted_to_all_rows(monkeypatch):
    monkeypatch.setattr(large, "MAX_SEARCH_ROWS", 1000)
    data = finely_sampled(8000, 71)
    names: list[str] = []
    options = {"noise": "white", "initial": "equilibrium"}
    result = compare(data, "P2D", progress=lambda name, *_: names.append(name), **options)
    assert "P2D, all rows" in names
    assert result.best.problem.n_measured == 8000
    block = result.reason.numbers["block"]
    assert 4 <= block <= 7  # 2.87 s over 100 rows of 5 ms is 5.7
    assert result.reason.numbers["share"] == pytest.approx(1000 * block / 8000)
    lag_s = result.averaged["u"]["lag_s"]
    assert abs(lag_s.value - 2.87) < 3 * lag_s.u


def test_a_fit_to_block_means_gives_the_parameters_of_the_fit_to_all_rows():
    data = finely_sampled(20_000, 91)
    options = {"noise": "white", "initial": "equilibrium", "intervals": "quadratic", "check": False}
    rows = fit(data, "P2D", **options).estimates
    means = fit(large.block_means(data, 5), "P2D", **options).estimates
    for name, estimate in rows.items():
        assert abs(means[name].value - estimate.value) < 0.3 * estimate.u


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("seed", [81, 82, 83])
def test_a_decimated_search_gives_the_structure_and_the_estimates_of_the_full_one(
    monkeypatch, seed
):
    data = finely_sampled(20_000, seed)
    decimated = compare(data)
    assert decimated.reason.numbers["block"] == 2
    monkeypatch.setattr(large, "MAX_SEARCH_ROWS", data.n_samples)
    full = compare(data)
    assert "block" not in full.reason.numbers
    assert decimated.recommended == full.recommended == "P2D"
    for name in ("gain", "lag_s"):
        estimate = full.averaged["u"][name]
        assert abs(decimated.averaged["u"][name].value - estimate.value) < 0.3 * estimate.u
