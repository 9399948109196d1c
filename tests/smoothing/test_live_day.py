"""A day of a log with spikes, bursts and unloadings followed live: bounded, true to its band, written to its end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.rig.disk import Conditioning
from tcdyn.smoothing import LiveSmoother, smooth
from tcdyn.workflows.follow import FollowRun, follow
from tcdyn.workflows.live import LiveSettings
from tests.smoothing.live_world import (
    FILTER_POLES,
    FILTER_S,
    NAMES,
    NOISE_K,
    OVER,
    TAUS_S,
    World,
    lagged,
    record,
    world,
)

B = Conditioning(cutoff_Hz=4.0, poles=2)

SETTLED_S = 5.0


def followed(
    made: World | pd.DataFrame, folder: Path, settings: LiveSettings
) -> tuple[FollowRun, pd.DataFrame]:
    log, out = folder / "log.csv", folder / "out.csv"
    (made.log() if isinstance(made, World) else made).to_csv(log, index=False)
    run = follow(
        log, {"fast": record()}, out, None, settings, idle_s=0.01, poll_s=0.02, overwrite=True
    )
    return run, pd.read_csv(out)


def errors(made: World, done: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Errors [K] and the stated sd [K], (N, 6), after the first seconds."""
    error = done[NAMES].to_numpy() - made.true[:, None]
    sd = done[[n.replace("_degC", "_u_K") for n in NAMES]].to_numpy()
    settled = made.time_s > SETTLED_S
    return error[settled], sd[settled]


def hold(made: World, run: FollowRun, done: pd.DataFrame, behind_s: float) -> None:
    """No row is lost; no error is above 6 sd, nor, behind, above 5 K."""
    assert run.rows_written == len(done) == len(made.time_s)
    error, sd = errors(made, done)
    assert np.all(np.abs(error) < 6 * sd)
    assert np.mean(np.abs(error) < 1.96 * sd) > 0.95
    if behind_s:
        assert np.max(np.abs(error)) < 5.0
        assert np.sqrt(np.mean(error**2)) < 2 * NOISE_K


@pytest.mark.study
@pytest.mark.parametrize(
    ("before", "behind_s"),
    [(0.0, 0.5), (0.97, 0.5), (0.97, 0.0)],
    ids=["white", "coloured", "live"],
)
def test_a_day_in_short_is_followed_within_its_band_to_its_end(
    before: float, behind_s: float, tmp_path: Path
) -> None:
    """Four minutes at 75 Hz with the three unloadings of a day, 36 bursts and 72 lone outliers."""
    made = world(240.0, before, 7, bursts_s=40.0)
    hold(made, *followed(made, tmp_path, LiveSettings(behind_s=behind_s)), behind_s)


@pytest.mark.parametrize("before", [0.0, 0.97], ids=["white", "before the filter"])
def test_behind_it_is_the_batch_smoother_within_the_stated_band(
    before: float, tmp_path: Path
) -> None:
    """A minute without bursts: the two differ by what the batch alone has seen, of which half a second is little."""
    made = world(60.0, before, 3, bursts_s=1e9)
    made = replace(
        made, time_s=made.time_s[:2200], true=made.true[:2200], readings=made.readings[:2200]
    )  # two kinks
    run, done = followed(
        made, tmp_path, LiveSettings(behind_s=0.5, noise_K=None if before else NOISE_K)
    )
    batch = smooth(
        made.readings,
        1 / 75,
        Chain(TAUS_S, conditioning=B),
        noise_sd=None if before else NOISE_K,
        intensity=30.0,
    )
    live, sd = (
        done[[n.replace("_degC", end) for n in NAMES]].to_numpy() for end in ("_degC", "_u_K")
    )
    z = ((live - batch.temperature) / sd)[375:]
    assert np.max(np.abs(z)) < 6.0
    assert np.mean(np.abs(z) < 1.0) > 0.95
    assert run.ended.startswith("no growth")


@pytest.mark.study
@pytest.mark.parametrize("behind", [0, 37])
def test_small_bursts_and_one_upon_another_are_within_the_band(behind: int) -> None:
    """200 channels at rest, each with a burst of 0.5 to 1 K or one of 1.5 to 3 K that steps up or down on its way."""
    rng, fine, m = np.random.default_rng(0), 1 / 75 / OVER, 200
    y = np.zeros((450 * OVER, m))
    for c in range(m):
        first, last = (int(s / fine) for s in (3.0, 3.0 + rng.uniform(0.05, 0.35)))
        y[first:last, c] = rng.uniform(0.5, 1.0) if c % 2 else rng.uniform(1.5, 3.0)
        if not c % 2:
            y[(first + last) // 2 : last, c] += rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 2.0)
    for _ in range(FILTER_POLES):
        y = lagged(y, FILTER_S, fine)
    y = 80 + y[::OVER] + NOISE_K * rng.standard_normal((450, m))
    live = LiveSmoother.from_chains(
        [Chain(TAUS_S, conditioning=B)] * m, 1 / 75, NOISE_K, 30.0, behind
    )
    _, x, sd, _ = live.run(live.initial_state(y[0]), y)
    assert np.max(np.abs(x - 80) / sd) < 6.0
    assert np.mean(np.abs(x - 80)[behind:] < 1.96 * sd[behind:]) > 0.95


EVENTS = {  # what the temperature does from t = 0 on, by size [K] and time [s]
    "kink": lambda t, size, tau: size * (1 - np.exp(-t / tau)),
    "jump": lambda t, size, tau: size * np.ones_like(t),
    "splash": lambda t, size, tau: size * np.exp(-t / tau),
}


@pytest.mark.parametrize("before", [0.0, 0.97], ids=["white", "before the filter"])
def test_half_a_second_behind_jumps_and_kinks_are_within_the_band(before: float) -> None:
    """Kinks of 12 K in 0.05 to 5 s, jumps of 10 and 30 K, a splash of 30 K: at their instants, too."""
    kinds = [("kink", 12.0, tau) for tau in (0.05, 0.2, 0.5, 1.0, 5.0)] + [
        ("jump", size, 0.0) for size in (10.0, 30.0)
    ]
    kinds = [kind for kind in [*kinds, ("splash", 30.0, 0.5)] for _ in range(8)]
    rng, fine, m, rows = np.random.default_rng(21), 1 / 75 / OVER, len(kinds), 900
    t = np.arange(rows * OVER)[:, None] * fine - rng.uniform(5.0, 5.3, m)
    x = np.stack(
        [80 + (c >= 0) * EVENTS[k](np.maximum(c, 0.0), *v) for c, (k, *v) in zip(t.T, kinds)],
        axis=1,
    )
    y = x.copy()
    for tau in TAUS_S:
        y = lagged(y, tau, fine)
    y += (
        before * NOISE_K * np.sqrt(4 * FILTER_S / fine) * rng.standard_normal(y.shape)
    )  # sum of squares of t exp(-t)
    for _ in range(FILTER_POLES):
        y = lagged(y, FILTER_S, fine)
    after = np.sqrt(1 - before**2) * NOISE_K
    y, x, t = y[::OVER] + after * rng.standard_normal((rows, m)), x[::OVER], t[::OVER]
    live = LiveSmoother.from_chains(
        [Chain(TAUS_S, conditioning=B)] * m, 1 / 75, after, 30.0, 38, before * NOISE_K
    )
    _, found, sd, _ = live.run(live.initial_state(y[0]), y)
    error, sd, near = (found[38:] - x[:-38])[300:], sd[338:], np.abs(t[300:-38] - 0.75) < 1.25
    assert np.max(np.abs(error) / sd) < 6.0
    assert np.mean((np.abs(error) < 1.96 * sd)[near]) > 0.95
    assert np.sqrt(np.mean(error[t[300:-38] > 0.15] ** 2)) < 1.0


def test_a_lag_that_divides_otherwise_than_the_record_says_is_within_the_band(
    tmp_path: Path,
) -> None:
    """Unloadings by 30 K and a record that takes nearly all of the lag for one: 2.8 sd, were that not counted."""
    made = world(20.0, 0.0, 5, bursts_s=1e9, drops_K=(30.0,))
    made.log().to_csv(tmp_path / "log.csv", index=False)
    records = {"fast": record(split_s=-0.06)}
    follow(
        tmp_path / "log.csv",
        records,
        tmp_path / "out.csv",
        None,
        LiveSettings(0.5),
        idle_s=0.01,
        poll_s=0.02,
    )
    error, sd = errors(made, pd.read_csv(tmp_path / "out.csv"))
    assert np.max(np.abs(error) / sd) < 2.0


def test_gaps_and_clocks_that_jump_are_told_and_the_rest_is_as_good(tmp_path: Path) -> None:
    """Two seconds and then an hour are missing, the clock goes back for a while: nothing raises, no row that counts is
    lost, and ten lags later the answers are those of a log without it."""
    made = world(60.0, 0.97, 4, bursts_s=1e9)
    log = made.log()
    hour = log["time_s"] >= 40.0
    log.loc[hour, "time_s"] += 3600.0
    log.loc[3500:3520, "time_s"] -= 30.0
    log = log.drop(index=range(1500, 1650))
    run, done = followed(log, tmp_path, LiveSettings())
    assert [f.code for f in run.findings if f.code != "follow.spikes"] == [
        "follow.backward",
        "follow.gaps",
    ]
    told = {f.code: f.numbers for f in run.findings}
    assert told["follow.gaps"] == {"count": 2, "longest_s": pytest.approx(3600, abs=0.1)}
    assert told["follow.backward"] == {"count": 21}
    assert len(done) == len(log) - 21
    _, whole = followed(made, tmp_path, LiveSettings())
    after = done["time_s"] > 3650.0
    same = whole.set_index("time_s").loc[(done["time_s"][after] - 3600.0).round(4)]
    assert np.max(np.abs(done.loc[after, NAMES].to_numpy() - same[NAMES].to_numpy())) < 1e-3


def test_the_noise_model_goes_on_exactly_from_a_state_file(tmp_path: Path) -> None:
    """Stopped in the middle of a log whose noise is coloured: the same rows as in one go, to the last digit written."""
    text = world(30.0, 0.97, 5, bursts_s=5.0).log().to_csv(index=False)
    log, whole, parts, state = (
        tmp_path / n for n in ("log.csv", "whole.csv", "parts.csv", "state.json")
    )
    for share in (0.5, 1.0):
        log.write_text(text[: int(share * len(text))], encoding="utf-8")
        follow(
            log,
            {"fast": record()},
            parts,
            None,
            LiveSettings(0.3),
            state=state,
            idle_s=0.01,
            poll_s=0.02,
        )
    follow(log, {"fast": record()}, whole, None, LiveSettings(0.3), idle_s=0.01, poll_s=0.02)
    assert parts.read_text(encoding="utf-8") == whole.read_text(encoding="utf-8")
    assert "noise_before_filter_K: 0.1" in whole.read_text(encoding="utf-8")


@pytest.mark.parametrize("size", [3.0, 30.0, 1000.0])
def test_whatever_a_reading_does_the_answer_stays_in_the_range_that_the_chain_allows(
    size: float,
) -> None:
    """Readings that leap at random for a second: no answer leaves the readings by more than five times their range."""
    rng = np.random.default_rng(0)
    y = 80 + NOISE_K * rng.standard_normal((1500, 20))
    y[600:675] += size * rng.standard_normal((75, 20)) * (rng.random((75, 20)) < 0.5)
    live = LiveSmoother.from_chains([Chain(TAUS_S, conditioning=B)] * 20, 1 / 75, NOISE_K, 30.0)
    _, x, sd, _ = live.run(live.initial_state(y[0]), y)
    assert np.all(np.isfinite(x) & np.isfinite(sd))
    assert np.max(np.abs(x - 80)) < 6 * np.max(np.abs(y - 80))
    assert np.max(np.abs(x - 80)[:600]) < 5.0
    assert np.max((np.abs(x - 80) / sd)[900:]) < 6.0  # four lags later it is over
