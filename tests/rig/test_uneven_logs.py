"""Irregular time stamps: readings at even times, missing samples in their place, and whether
samples or stamps strayed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from tcdyn.chain import Chain
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.log import Log, read_log
from tcdyn.series import fit_clock, real_share
from tcdyn.smoothing import smooth
from tests.rig.log_cases import immersion_frame

RIG_FILTER = Conditioning(cutoff_Hz=4.0, poles=2)

DT = 1 / 75
SECONDS = 40.0
KINK_S = 20.0037
DENSE = 40
JITTER = 0.35  # of an interval
JITTER_KINDS = ("samples, evenly spread", "samples, normal", "steps between samples", "stamps only")


def junction(t: np.ndarray) -> np.ndarray:
    """A slow trend, and a fall by 12 K with a time constant of 1 s."""
    return (
        100 + 0.02 * t + np.sin(2 * np.pi * t / 60) - 12 * (1 - np.exp(-np.maximum(t - KINK_S, 0)))
    )


def lagged(x: np.ndarray, tau_s: float, dt_s: float) -> np.ndarray:
    """A first-order lag by the trapezoidal rule, from rest."""
    a = dt_s / (2 * tau_s + dt_s)
    return lfilter([a, a], [1, 2 * a - 1], x - x[0]) + x[0]


def sampling_and_stamp_times(jitter_kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """True sampling times, and the time stamps of the log [s]."""
    rng = np.random.default_rng(seed)
    even = 0.2 + np.arange(int((SECONDS - 1) / DT)) * DT
    uniform_jitter = JITTER * rng.uniform(-1, 1, len(even))
    if jitter_kind == "samples, normal":
        jittered = np.sort(even + DT * JITTER * rng.standard_normal(len(even)))
    elif jitter_kind == "steps between samples":
        jittered = 0.2 + np.cumsum(DT * (1 + uniform_jitter))
        jittered = jittered[jittered < SECONDS - 0.5]
    else:
        jittered = even + DT * uniform_jitter
    return (even, jittered) if jitter_kind == "stamps only" else (jittered, jittered)


def read_jittered_log(
    folder, jitter_kind: str, seed: int = 0, noise_K: float = 0.15, lost: float = 0.01
) -> Log:
    """This junction through 0.55 s, 0.12 s and the 4 Hz filter in channel e, weaker in the others,
    read from a file."""
    fine = np.arange(int((SECONDS + 1) / DT) * DENSE) * DT / DENSE
    y = junction(fine)
    for tau_s in (0.55, 0.12, 1 / (8 * np.pi), 1 / (8 * np.pi)):
        y = lagged(y, tau_s, DT / DENSE)
    even = 0.2 + np.arange(int((SECONDS - 1) / DT)) * DT
    sampled_s, stamp_s = (
        (even, even) if jitter_kind == "even" else sampling_and_stamp_times(jitter_kind, seed)
    )
    rng = np.random.default_rng([seed, 1])
    frame = immersion_frame(len(sampled_s))
    for gain, channel in zip((0.7, 0.5, 0.7, 0.5, 1.0, 0.5), "abcdef"):
        read = np.interp(sampled_s, fine, y)
        frame[f"{channel}_degC"] = (
            100 + gain * (read - 100) + noise_K * rng.standard_normal(len(sampled_s))
        )
    frame["probe_degC"] = (
        20
        + 100 * (1 - np.exp(-np.maximum(sampled_s - 5.0, 0) / 0.3))
        + 0.1 * rng.standard_normal(len(sampled_s))
    )
    frame["fluid_degC"] = 120.0 + 0.01 * rng.standard_normal(len(sampled_s))
    is_logged = rng.random(len(sampled_s)) >= (0.0 if jitter_kind == "even" else lost)
    is_logged[:2] = is_logged[-2:] = True
    frame["time_s"] = stamp_s
    frame["extra"] = is_logged  # additional columns are ignored
    path = folder / f"{seed}.csv"
    frame[is_logged].to_csv(path, index=False, float_format="%.6f")
    return read_log(path, "immersion")


def jitter_numbers(log: Log) -> dict[str, float]:
    """Numbers of the finding on irregular stamps."""
    return next(f.numbers for f in log.findings if f.code == "series.strays")


def test_lost_samples_are_missing_at_their_times_and_nowhere_else(tmp_path):
    log = read_jittered_log(tmp_path, "samples, evenly spread")
    rng = np.random.default_rng([0, 1])
    for _ in range(8):
        rng.standard_normal(len(log.frame))
    is_logged = rng.random(len(log.frame)) >= 0.01
    is_logged[:2] = is_logged[-2:] = True
    assert np.array_equal(log.frame["e_degC"].notna(), is_logged)
    # at its ends the line through 2900 stamps with a sd of 2.7 ms is known to twice 2.7 ms /
    # sqrt(2900)
    assert np.abs(
        log.frame["time_s"] - 0.2 - np.arange(len(is_logged)) * DT
    ).max() < 4 * 2 * 2.7e-3 / np.sqrt(2900)


@pytest.mark.parametrize("jitter_kind", JITTER_KINDS)
def test_readings_show_whether_samples_or_only_stamps_strayed(tmp_path, jitter_kind):
    """With 5 mK of noise the slopes of 6 K/s at the kink show 16 mK of displacement in each
    sample."""
    log = read_jittered_log(tmp_path, jitter_kind, noise_K=0.005)
    percent = jitter_numbers(log)["percent"]
    assert percent < 10 if jitter_kind == "stamps only" else percent > 90


def test_real_share_of_the_jitter_does_not_depend_on_the_unit_of_the_readings():
    """Stamps of 3 ms rms, half of it real; the noise is about as informative as the prior on the
    stamps."""
    rng = np.random.default_rng(0)
    n = 2000
    t = np.arange(n) * DT
    jitter_s = 0.003 * rng.standard_normal(n)
    y = 100 + 10 * np.sin(2 * np.pi * t / 5) + 0.05 * rng.standard_normal(n)
    y += 0.5 * jitter_s * 4 * np.pi * np.cos(2 * np.pi * t / 5)
    clock = fit_clock(t + jitter_s)
    shares = [real_share(clock, [k * y]).value for k in (1.0, 1e-3, 1e3)]
    assert shares == pytest.approx([shares[0]] * 3, rel=1e-9)
    assert 0.2 < shares[0] < 0.8


def compensate_four_logs(folder, jitter_kind: str) -> tuple[float, float]:
    """Mean square error [K2] of six junctions about a kink, and coverage of the 95 % band; four
    samples."""
    errors = []
    covered = []
    gain = np.array([0.7, 0.5, 0.7, 0.5, 1.0, 0.5])
    for seed in range(4):
        log = read_jittered_log(folder, jitter_kind, seed)
        y = log.frame[[f"{c}_degC" for c in "abcdef"]].to_numpy()
        t = log.frame["time_s"].to_numpy()
        assert np.diff(t) == pytest.approx(log.dt_s, abs=1.1e-6)  # six decimals
        result = smooth(
            y, log.dt_s, Chain((0.55, 0.12), conditioning=RIG_FILTER), events_s=(KINK_S - t[0],)
        )
        in_window = (t > KINK_S - 1) & (t < KINK_S + 5)
        error = result.temperature[in_window] - 100 - gain * (junction(t)[in_window, None] - 100)
        errors.append(np.mean(error**2))
        covered.append(np.mean(np.abs(error) < 1.96 * result.sd[in_window]))
    return float(np.mean(errors)), float(np.mean(covered))


@pytest.fixture(scope="module")
def even_clock_error(tmp_path_factory) -> float:
    """The error with an even clock and every sample."""
    return compensate_four_logs(tmp_path_factory.mktemp("even"), "even")[0]


@pytest.mark.long
@pytest.mark.e2e
@pytest.mark.parametrize("jitter_kind", JITTER_KINDS)
def test_compensation_loses_little_accuracy_with_jitter_and_lost_samples(
    tmp_path, even_clock_error, jitter_kind
):
    """The error is within 1.3 times that of an even clock (24 channels: their ratio is known to
    some 10 %)."""
    error, coverage = compensate_four_logs(tmp_path, jitter_kind)
    assert error < 1.3**2 * even_clock_error
    assert coverage > 0.9


def test_irregular_stamps_give_one_rate_for_any_start_time():
    _, stamps = sampling_and_stamp_times("samples, evenly spread", 0)
    from_zero, a_day_later = (fit_clock(start_s + stamps) for start_s in (0.0, 86_400.0))
    assert from_zero.strays
    assert a_day_later.interval_s == pytest.approx(from_zero.interval_s, rel=1e-9)
    # the ends stray by a fifth of an interval, of 2900
    assert from_zero.interval_s == pytest.approx(DT, rel=1e-4)
    assert np.array_equal(a_day_later.index, from_zero.index)
    assert a_day_later.even_s == pytest.approx(86_400.0 + from_zero.even_s, abs=1e-6)


def test_two_sampling_rates_in_one_log_raise(tmp_path):
    frame = immersion_frame()
    path = tmp_path / "two.csv"
    pd.concat([frame[:1500], frame[1500::3]]).to_csv(path, index=False)
    with pytest.raises(InputError, match="uneven"):
        read_log(path, "immersion")
