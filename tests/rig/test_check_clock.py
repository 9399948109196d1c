"""Stamps that stray from even sampling: readings at even times, lost samples where they were, and who strayed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.rig.check_clock import Sampling, check_time, scale_jitter
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.log import Log, read_log
from tcdyn.smoothing import smooth
from tests.rig.log_cases import immersion_frame

RIG_FILTER = Conditioning(cutoff_Hz=4.0, poles=2)

DT = 1 / 75
SECONDS = 40.0
KINK_S = 20.0037
DENSE = 40
STRAY = 0.35  # of an interval
WORLDS = ("samples, evenly spread", "samples, normal", "steps between samples", "stamps only")


def junction(t: np.ndarray) -> np.ndarray:
    """A slow trend, and 12 K given off with a time constant of 1 s."""
    return (
        100 + 0.02 * t + np.sin(2 * np.pi * t / 60) - 12 * (1 - np.exp(-np.maximum(t - KINK_S, 0)))
    )


def lagged(x: np.ndarray, tau_s: float, dt_s: float) -> np.ndarray:
    """A first-order lag by the trapezoidal rule, begun at rest."""
    a = dt_s / (2 * tau_s + dt_s)
    return lfilter([a, a], [1, 2 * a - 1], x - x[0]) + x[0]


def stray(world: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """When samples are taken, and when the log says so [s]."""
    rng = np.random.default_rng(seed)
    even = 0.2 + np.arange(int((SECONDS - 1) / DT)) * DT
    flat = STRAY * rng.uniform(-1, 1, len(even))
    if world == "samples, normal":
        true = np.sort(even + DT * STRAY * rng.standard_normal(len(even)))
    elif world == "steps between samples":
        true = 0.2 + np.cumsum(DT * (1 + flat))
        true = true[true < SECONDS - 0.5]
    else:
        true = even + DT * flat
    return (even, true) if world == "stamps only" else (true, true)


def logged(folder, world: str, seed: int = 0, noise_K: float = 0.15, lost: float = 0.01) -> Log:
    """That junction behind 0.55 s, 0.12 s and the 4 Hz filter in channel e, weaker in the others, read from a file."""
    fine = np.arange(int((SECONDS + 1) / DT) * DENSE) * DT / DENSE
    y = junction(fine)
    for tau_s in (0.55, 0.12, 1 / (8 * np.pi), 1 / (8 * np.pi)):
        y = lagged(y, tau_s, DT / DENSE)
    even = 0.2 + np.arange(int((SECONDS - 1) / DT)) * DT
    taken, stamped = (even, even) if world == "even" else stray(world, seed)
    rng = np.random.default_rng([seed, 1])
    frame = immersion_frame(len(taken))
    for part, channel in zip((0.7, 0.5, 0.7, 0.5, 1.0, 0.5), "abcdef"):
        read = np.interp(taken, fine, y)
        frame[f"{channel}_degC"] = (
            100 + part * (read - 100) + noise_K * rng.standard_normal(len(taken))
        )
    frame["probe_degC"] = (
        20
        + 100 * (1 - np.exp(-np.maximum(taken - 5.0, 0) / 0.3))
        + 0.1 * rng.standard_normal(len(taken))
    )
    frame["fluid_degC"] = 120.0 + 0.01 * rng.standard_normal(len(taken))
    kept = rng.random(len(taken)) >= (0.0 if world == "even" else lost)
    kept[:2] = kept[-2:] = True
    frame["time_s"] = stamped
    frame["kept"] = kept  # an extra column is nobody's
    path = folder / f"{seed}.csv"
    frame[kept].to_csv(path, index=False, float_format="%.6f")
    return read_log(path, "immersion")


def strays(log: Log) -> dict[str, float]:
    return next(f.numbers for f in log.findings if f.code == "time.strays")


def test_lost_samples_are_missing_where_they_were_and_nowhere_else(tmp_path):
    log = logged(tmp_path, "samples, evenly spread")
    rng = np.random.default_rng([0, 1])
    for _ in range(8):
        rng.standard_normal(len(log.frame))
    kept = rng.random(len(log.frame)) >= 0.01
    kept[:2] = kept[-2:] = True
    assert np.array_equal(log.frame["e_degC"].notna(), kept)
    # at its ends the line through 2900 stamps of 2.7 ms (1 sd) is good to twice 2.7 ms / sqrt(2900)
    assert np.abs(
        log.frame["time_s"] - 0.2 - np.arange(len(kept)) * DT
    ).max() < 4 * 2 * 2.7e-3 / np.sqrt(2900)


@pytest.mark.parametrize("world", WORLDS)
def test_the_readings_tell_whether_samples_strayed_or_stamps_only(tmp_path, world):
    """With 5 mK of noise the slopes of 6 K/s at the kink show 16 mK of displacement, sample by sample."""
    log = logged(tmp_path, world, noise_K=0.005)
    percent = strays(log)["percent"]
    assert percent < 10 if world == "stamps only" else percent > 90


def test_which_share_is_real_does_not_depend_on_the_unit_of_the_readings():
    """Stamps of 10 ms rms, half of it real, beside noise that tells about as much as the trust in the stamps."""
    rng = np.random.default_rng(0)
    n = 2000
    t = np.arange(n) * DT
    late = 0.01 * rng.standard_normal(n)
    y = 100 + 10 * np.sin(2 * np.pi * t / 5) + 0.2 * rng.standard_normal(n)
    y += 0.5 * late * 4 * np.pi * np.cos(2 * np.pi * t / 5)
    sampling = Sampling(t, DT, np.arange(n, dtype=np.int32), (), late)
    found = [
        scale_jitter(sampling, pd.DataFrame({"a_degC": k * y})).jitter_s[7] / late[7]
        for k in (1.0, 1e-3, 1e3)
    ]
    assert found == pytest.approx([found[0]] * 3, rel=1e-9)
    assert 0.2 < found[0] < 0.8


def compensated(folder, world: str) -> tuple[float, float]:
    """Mean square error [K2] of six junctions about a kink, and how much of it the 95 % band holds; four draws."""
    errors = []
    held = []
    part = np.array([0.7, 0.5, 0.7, 0.5, 1.0, 0.5])
    for seed in range(4):
        log = logged(folder, world, seed)
        y = log.frame[[f"{c}_degC" for c in "abcdef"]].to_numpy()
        t = log.frame["time_s"].to_numpy()
        assert np.diff(t) == pytest.approx(log.dt_s, abs=1.1e-6)  # six decimals
        done = smooth(
            y, log.dt_s, Chain((0.55, 0.12), conditioning=RIG_FILTER), events_s=(KINK_S - t[0],)
        )
        near = (t > KINK_S - 1) & (t < KINK_S + 5)
        away = done.temperature[near] - 100 - part * (junction(t)[near, None] - 100)
        errors.append(np.mean(away**2))
        held.append(np.mean(np.abs(away) < 1.96 * done.sd[near]))
    return float(np.mean(errors)), float(np.mean(held))


@pytest.fixture(scope="module")
def even(tmp_path_factory) -> float:
    """That error with an even clock and every sample."""
    return compensated(tmp_path_factory.mktemp("even"), "even")[0]


@pytest.mark.e2e
@pytest.mark.parametrize("world", WORLDS)
def test_compensation_loses_little_where_stamps_stray_and_samples_are_lost(tmp_path, even, world):
    """The error is within 1.3 times that of an even clock (24 channels: their ratio is good to some 10 %)."""
    error, held = compensated(tmp_path, world)
    assert error < 1.3**2 * even
    assert held > 0.9


def test_stamps_that_stray_tell_one_rate_whenever_the_clock_was_begun():
    _, stamps = stray("samples, evenly spread", 0)
    soon, late = (
        check_time(start_s + stamps, SampleLocation("log.csv")) for start_s in (0.0, 86_400.0)
    )
    assert soon.jitter_s is not None
    assert late.dt_s == pytest.approx(soon.dt_s, rel=1e-9)
    assert soon.dt_s == pytest.approx(DT, rel=1e-4)  # ends stray by a fifth of an interval of 2900
    assert np.array_equal(late.grid, soon.grid)
    assert late.time_s == pytest.approx(86_400.0 + soon.time_s, abs=1e-6)


def test_two_rates_in_one_log_are_refused(tmp_path):
    frame = immersion_frame()
    path = tmp_path / "two.csv"
    pd.concat([frame[:1500], frame[1500::3]]).to_csv(path, index=False)
    with pytest.raises(InputError, match="uneven"):
        read_log(path, "immersion")
