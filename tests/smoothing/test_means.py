"""Rows that are means over a time before them, against dense algebra and an own simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import cho_factor, cho_solve, expm
from scipy.signal import lfilter

from tcdyn.chain import Chain, sensors
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.smoothing import Intensity, smooth
from tcdyn.smoothing.inverse import invert
from tcdyn.smoothing.record import record_of
from tcdyn.smoothing.state_space import channel_ranges, likelihood, ramp_prior, smooth_record
from tcdyn.workflows.frames import compensate_frame
from tests.cli.test_main_job import tcdyn

DT_S = 0.5
ROWS = 14
PARTS = 40
NOISE_K = 0.05


def readings() -> Array:
    rng = np.random.default_rng(4)
    time_s = DT_S * np.arange(ROWS)
    return 20 + 0.5 * time_s + NOISE_K * rng.standard_normal(ROWS)


def dense(
    y: Array, lags_s: tuple[float, ...], mean_s: float, delay_s: float, level: float, slope: float
) -> tuple[Array, Array, float]:
    """Temperatures at the rows, their sd, and the log likelihood: all instants as one vector.

    The instants divide a row into ``PARTS``; the mean is Simpson's sum over them.
    """
    step_s = DT_S / PARTS
    first_s = -delay_s - mean_s
    count = round((DT_S * (ROWS - 1) - first_s) / step_s) + 1
    (plain,) = sensors([Chain(lags_s)])
    sensor = replace(plain, lag_s=Chain(lags_s, delay_s=delay_s, mean_s=mean_s).lag_s)
    n = len(sensor.drift)
    range_K = float(np.ptp(y))
    state, factor = ramp_prior(sensor, float(y[0]), range_K, DT_S, slope, level)
    flow = expm(sensor.drift * step_s)
    middle = expm(sensor.drift * 0.5 * step_s)
    noise = np.sqrt(step_s) * middle[:, :2] * np.sqrt([level, slope])
    table = np.zeros((count, n, n + 2 * count))
    centre = np.zeros((count, n))
    table[0, :, :n] = factor
    centre[0] = state
    for k in range(1, count):
        table[k] = np.einsum("ij,jm->im", flow, table[k - 1])
        table[k, :, n + 2 * k : n + 2 * k + 2] = noise
        centre[k] = flow @ centre[k - 1]
    row_at = np.round((DT_S * np.arange(ROWS) - first_s) / step_s).astype(int)
    read_at = row_at - round(delay_s / step_s)
    width = round(mean_s / step_s)
    weights = np.ones(width + 1)
    weights[1:-1:2] = 4.0
    weights[2:-1:2] = 2.0
    weights /= weights.sum()
    of_mean = np.zeros((ROWS, count))
    for row, at in enumerate(read_at):
        of_mean[row, at - width : at + 1] = weights
    reads = of_mean @ np.einsum("j,kjm->km", sensor.output, table)
    expected = of_mean @ (centre @ sensor.output)
    spread = reads @ reads.T + NOISE_K**2 * np.eye(ROWS)
    solved = cho_factor(spread)
    departure = y - expected
    temperature = table[row_at, 0]
    mean = centre[row_at, 0] + temperature @ reads.T @ cho_solve(solved, departure)
    gain = temperature @ reads.T
    covariance = temperature @ temperature.T - gain @ cho_solve(solved, gain.T)
    value = -0.5 * departure @ cho_solve(solved, departure) - np.log(np.diag(solved[0])).sum()
    return mean, np.sqrt(np.diag(covariance)), float(value)


@pytest.mark.parametrize(
    ("mean_s", "delay_s"),
    [(DT_S, 0.0), (0.4 * DT_S, 0.0), (3 * DT_S, 0.0), (DT_S, 0.3 * DT_S), (0.4 * DT_S, 0.7 * DT_S)],
)
@pytest.mark.parametrize("lags_s", [(0.8,), (0.4, 0.1), ()])
def test_means_agree_with_dense_algebra(
    mean_s: float, delay_s: float, lags_s: tuple[float, ...]
) -> None:
    level, slope = 0.5, 2.0
    y = readings()
    record = record_of(y, DT_S, Chain(lags_s, delay_s=delay_s, mean_s=mean_s), noise_sd=NOISE_K)
    assert channel_ranges(record) == pytest.approx(np.ptp(y))
    q = Intensity((0.0,), (slope,), level_noise=(level,))
    noise_var = np.array([NOISE_K**2])
    found = smooth_record(record, noise_var, [q]).at_samples()
    value = float(likelihood(record, noise_var, [[q]])[0][0, 0])
    mean, sd, expected = dense(y, lags_s, mean_s, delay_s, level, slope)
    assert found.temperature[:, 0] == pytest.approx(mean, abs=0.01 * sd.min())
    assert found.sd[:, 0] == pytest.approx(sd, rel=2e-3)
    assert value == pytest.approx(expected, abs=0.02)


def logged(seed: int, mean_s: float, lag_s: float, dt_s: float = 0.5) -> tuple[Array, Array, Array]:
    """Times, temperatures and rows of a logger that samples every 2 ms and writes means."""
    rng = np.random.default_rng(seed)
    step_s = 0.002
    time_s = step_s * np.arange(100_000)
    phases = rng.uniform(0, 2 * np.pi, 3)
    waves = zip((5.0, 2.0, 0.5), (0.04, 0.09, 0.16), phases)
    temperature = 20 + sum(a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in waves)
    share = np.exp(-step_s / lag_s)
    lagged = temperature[0] + lfilter([1 - share], [1, -share], temperature - temperature[0])
    total = np.concatenate([[0.0], np.cumsum(lagged)])
    count = round(mean_s / step_s)
    at = np.arange(5000, len(time_s), round(dt_s / step_s))
    rows = (total[at + 1] - total[at + 1 - count]) / count
    return time_s[at], temperature[at], rows + 0.02 * rng.standard_normal(len(at))


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("mean_s", [0.3, 0.5, 1.5])
def test_temperatures_behind_a_mean_are_found_with_an_honest_band(mean_s: float) -> None:
    """Without the mean the same rows are late by half of its time, and their bands wrong."""
    inside, error, ignored = [], [], []
    for seed in range(4):
        _, truth, rows = logged(seed, mean_s, 0.8)
        result = smooth(rows, 0.5, Chain(0.8, mean_s=mean_s))
        departure = result.temperature[:, 0] - truth
        inside.append(np.mean(np.abs(departure) < 1.96 * result.sd[:, 0]))
        error.append(np.sqrt(np.mean(departure**2)))
        ignored.append(np.std(smooth(rows, 0.5, Chain(0.8)).temperature[:, 0] - truth))
    assert np.mean(inside) > 0.9
    assert np.mean(error) < 0.4 * np.mean(ignored)


@pytest.mark.e2e
def test_the_temperature_behind_means_of_uneven_rows_is_that_at_their_stamps() -> None:
    """Their readings are moved to even times; the temperature changes by 0.4 K in a deviation."""
    rng = np.random.default_rng(8)
    row_s, mean_s, lag_s = 0.5, 0.5, 0.8
    inside = []
    for seed in range(3):
        step_s = 0.002
        _, fine, _ = logged(seed, step_s, lag_s, step_s)
        share = np.exp(-step_s / lag_s)
        lagged = fine[0] + lfilter([1 - share], [1, -share], fine - fine[0])
        total = np.concatenate([[0.0], np.cumsum(lagged)])
        width = round(mean_s / step_s)
        even = np.arange(1000, len(fine) - 1000, round(row_s / step_s))
        at = even + rng.integers(-60, 61, len(even))
        rows = (total[at + 1] - total[at + 1 - width]) / width
        rows = rows + 0.02 * rng.standard_normal(len(rows))
        late_s = (at - even) * step_s
        result = smooth(rows, row_s, Chain(lag_s, mean_s=mean_s), late_s=late_s)
        departure = result.temperature[:, 0] - fine[at]
        inside.append(np.mean(np.abs(departure) < 1.96 * result.sd[:, 0]))
    assert np.mean(inside) > 0.9


@pytest.mark.e2e
def test_a_mean_over_other_times_is_refused_and_a_tiny_one_is_an_instant() -> None:
    _, _, rows = logged(0, 0.5, 0.8)
    nearly = smooth(rows, 0.5, Chain(0.8, mean_s=0.503))
    exact = smooth(rows, 0.5, Chain(0.8, mean_s=0.5))
    assert np.array_equal(nearly.temperature, exact.temperature)
    tiny = smooth(rows, 0.5, Chain(0.8, mean_s=1e-7))
    assert np.array_equal(tiny.temperature, smooth(rows, 0.5, Chain(0.8)).temperature)
    with pytest.raises(InputError, match=r"mean over 0.7 s, but rows are 0.5 s apart"):
        smooth(rows, 0.5, Chain(0.8, mean_s=0.7))
    with pytest.raises(InputError, match="which are 20 rows"):
        smooth(rows, 0.5, Chain(0.8, mean_s=10.0))
    with pytest.raises(InputError, match="no transfer function of finite order"):
        invert(rows, 0.5, Chain(0.8, mean_s=0.5), bandwidth_Hz=0.5)


def probe(folder: Path) -> Path:
    """A sensor file of a lag of 0.8 s."""
    path = folder / "probe.sensor.json"
    new = ["sensor", "new", "--tau-s", "0.8+-0.01", "--column", "T_degC", "--out", path]
    assert tcdyn(*new, "--quiet") == 0
    return path


def test_a_table_of_means_is_compensated_from_the_command_line_and_from_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time_s, truth, rows = logged(1, 0.5, 0.8)
    path = tmp_path / "log.csv"
    pd.DataFrame({"time_s": time_s, "T_degC": rows}).to_csv(path, index=False)
    out = tmp_path / "out.csv"
    call = ["compensate", path, "--sensor", probe(tmp_path), "--averages-s", 0.5]
    capsys.readouterr()
    assert tcdyn(*call, "--out", out, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    codes = {finding["code"] for finding in printed["findings"]}
    assert "sensor.means" in codes
    assert "series.averages" not in codes
    meta = json.loads(out.with_name("out.csv.meta.json").read_text(encoding="utf-8"))
    assert meta["metadata"]["averages_s"] == "0.5"
    made = pd.read_csv(out)
    assert np.mean(np.abs(made["T_degC"] - truth) < 1.96 * made["T_u_K"]) > 0.9
    table = pd.DataFrame({"time_s": time_s, "T_degC": rows})
    with pytest.warns(UserWarning, match="is long for a lag"):
        again = compensate_frame(table, (0.8, 0.01), averages_s=0.5)
    assert again["T_degC"].to_numpy() == pytest.approx(made["T_degC"].to_numpy(), abs=1e-3)
    with pytest.raises(InputError, match="the logger's, not the sensor's"):
        compensate_frame(table, Chain(0.8, mean_s=0.5))


@pytest.mark.e2e
def test_means_with_a_delay_continue_from_block_to_block(tmp_path: Path) -> None:
    """Followed while it grows, in two runs, a table of means has the rows of a single run."""
    time_s, truth, rows = logged(2, 0.5, 0.8)
    table = pd.DataFrame({"time_s": time_s, "T_degC": rows})
    path = tmp_path / "log.csv"
    common = ["--sensor", probe(tmp_path), "--averages-s", 0.5, "--delay-s", 8, "--quiet"]
    table.to_csv(path, index=False)
    whole = tmp_path / "whole.csv"
    assert tcdyn("compensate", path, *common, "--out", whole) == 0
    made = pd.read_csv(whole)
    assert np.mean(np.abs(made["T_degC"] - truth) < 1.96 * made["T_u_K"]) > 0.9
    live = tmp_path / "live.csv"
    grown = tmp_path / "grown.csv"
    follow = ["follow", grown, *common, "--out", live, "--state", tmp_path / "s.json"]
    for count in (90, len(table)):
        table[:count].to_csv(grown, index=False)
        assert tcdyn(*follow, "--idle-s", 0.2) == 0
    assert pd.read_csv(live)["T_degC"].to_numpy() == pytest.approx(made["T_degC"].to_numpy())


@pytest.mark.parametrize("command", ["compensate", "compensate with a delay", "follow"])
def test_a_mean_that_does_not_fit_the_rows_ends_without_an_output(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    time_s, _, rows = logged(3, 0.5, 0.8)
    path = tmp_path / "log.csv"
    pd.DataFrame({"time_s": time_s, "T_degC": rows}).to_csv(path, index=False)
    more = {"compensate with a delay": ["--delay-s", 8], "follow": ["--idle-s", 0.2]}
    out = tmp_path / "out.csv"
    call = [command.split()[0], path, "--sensor", probe(tmp_path), "--averages-s", 0.7]
    assert tcdyn(*call, *more.get(command, []), "--out", out) == 2
    printed = capsys.readouterr().err
    assert "each row is a mean over 0.7 s, but rows are 0.5 s apart" in printed
    assert "a whole number of rows" in printed
