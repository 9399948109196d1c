"""Events that the readings show, by one score: against the likelihood, and in simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.smoothing import Intensity, smooth
from tcdyn.smoothing.events import (
    SIZES,
    Event,
    Kind,
    Search,
    detect_events,
    evidence,
    weigh_events,
)
from tcdyn.smoothing.noise_levels import Change
from tcdyn.smoothing.process_noise import channel_spans, segment_levels, smearing_time_s
from tcdyn.smoothing.record import Start, record_of
from tcdyn.smoothing.roughness import refine
from tcdyn.smoothing.state_space import (
    Smoothed,
    channel_ranges,
    likelihood,
    smooth_record,
    state_at,
)

DT_S = 0.1
ROWS = 600
NOISE_K = 0.05
LAG_S = 2.0
TIME_S = DT_S * np.arange(ROWS)


def readings(temperature: Array, seed: int, parts: int = 20) -> Array:
    """Readings every ``parts`` samples, by the recursion of a lag over a fine grid.

    Before the record the temperature has followed the line through its first two samples.
    """
    share = np.exp(-DT_S / parts / LAG_S)
    y = np.empty(len(temperature))
    rate = (temperature[1] - temperature[0]) / (DT_S / parts)
    y[0] = temperature[0] - LAG_S * rate
    for k in range(1, len(y)):
        y[k] = share * y[k - 1] + (1 - share) * temperature[k - 1]
    rows = y[::parts]
    return rows + NOISE_K * np.random.default_rng(seed).standard_normal(len(rows))


def found_in(y: Array) -> tuple[Smoothed, list[Event]]:
    """The smoothed record and its events."""
    record = record_of(y, DT_S, Chain(LAG_S))
    intensities, noise_var = segment_levels(record, record.noise_sd**2, record.noise_known)
    fit = smooth_record(record, noise_var, intensities)
    fit, events_s = detect_events(fit, Search(lambda other: refine(other, 0)))
    return weigh_events(refine(fit), events_s)


@pytest.mark.parametrize("kind", Kind)
def test_the_evidence_is_the_difference_of_the_likelihoods(kind: Kind) -> None:
    """With and without the jump in the model, at a time that is a sample and one that is not."""
    y = np.stack([readings(20 + np.sin(0.005 * np.arange(2000) + c), c) for c in (0, 1)], axis=1)
    record = record_of(y, DT_S, Chain((1.5, 0.5)), noise_sd=NOISE_K)
    noise_var = np.full(2, NOISE_K**2)
    quiet = smooth_record(record, noise_var, [Intensity((0.0,), (0.2,), level_noise=(0.01,))] * 2)
    # a known start: else an event makes others before the record more probable
    start = Start(*state_at(quiet, 0), channel_ranges(record), ROWS)
    record = replace(record, start=start)
    for at_s in (3.0, 4.23):
        plain = Intensity((0.0,), (0.2,), (Change(at_s),), level_noise=(0.01,))
        fit = smooth_record(record, noise_var, [plain] * 2)
        index = np.flatnonzero(np.abs(fit.times_s - at_s) < 1e-9)
        found = evidence(fit, index)[0, :, kind]
        lag_s = smearing_time_s(record)
        for c, span_K in enumerate(channel_spans(record, noise_var)):
            sd = SIZES * span_K
            changes = [
                Change(
                    at_s,
                    level_sd=s if kind in (Kind.JUMP, Kind.JUMP_AND_KINK) else 0.0,
                    slope_sd=s / lag_s if kind in (Kind.KINK, Kind.JUMP_AND_KINK) else 0.0,
                    reading_sd=s if kind is Kind.STEP else 0.0,
                )
                for s in sd.tolist()
            ]
            proposals = [plain, *(replace(plain, changes=(b,)) for b in changes)]
            value = likelihood(record, noise_var, [proposals] * 2)[0][c]
            assert found[c] == pytest.approx(value[1:] - value[0], abs=1e-5)


@pytest.mark.e2e
def test_a_pulse_is_two_jumps_and_their_times_lie_in_their_intervals() -> None:
    fine_s = DT_S / 20 * np.arange(20 * ROWS)
    z = []
    for seed in range(4):
        start_s = 25.0 + 0.037 * seed
        pulse = (fine_s >= start_s) & (fine_s < start_s + 0.8)
        fit, events = found_in(readings(20 + 15.0 * pulse, seed))
        assert len(events) == 2
        for event, at_s in zip(events, (start_s, start_s + 0.8)):
            jumps = event.kind_probability[0, [Kind.JUMP, Kind.JUMP_AND_KINK]]
            assert jumps.sum() > 0.9
            z.append((event.at_s - at_s) / event.u_s)
        truth = 20 + 15.0 * pulse[::20]
        samples = fit.at_samples()
        away = np.min([np.abs(TIME_S - e.at_s) for e in events], axis=0) > 0.3
        error = (samples.temperature[:, 0] - truth)[away]
        assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(np.abs(z) < 2.6) > 0.8


def test_a_step_of_the_reading_is_no_pulse_of_the_temperature() -> None:
    """Behind a lag of 2 s a step of the reading in one row would be a pulse of 80 K."""
    for seed in range(3):
        temperature = 60 + 5 * np.sin(DT_S / 20 * np.arange(20 * ROWS) / 8 + seed)
        y = readings(temperature, seed)
        y[400:] += 4.0
        fit, (event,) = found_in(y)
        assert event.kind_probability[0, Kind.STEP] > 0.99
        assert TIME_S[399] < event.at_s < TIME_S[400] + 0.01
        truth = temperature[::20] + 4.0 * (np.arange(ROWS) >= 400)
        error = fit.at_samples().temperature[:, 0] - truth
        assert np.abs(error).max() < 0.6


def test_a_square_wave_is_jumps_and_not_a_rough_temperature() -> None:
    fine_s = DT_S / 20 * np.arange(20 * ROWS)
    temperature = 20 + 10.0 * (np.floor((fine_s + 0.713) / 3.0) % 2)
    fit, events = found_in(readings(temperature, 5))
    edges_s = 3.0 * np.arange(1, 21) - 0.713
    inside_s = edges_s[edges_s < TIME_S[-10]]
    assert len(events) >= len(inside_s)
    found_s = np.array([event.at_s for event in events])
    distance_s = np.min(np.abs(found_s[:, None] - inside_s), axis=0)
    assert distance_s.max() < 0.1
    assert np.sqrt(np.mean((fit.at_samples().temperature[:, 0] - temperature[::20]) ** 2)) < 2.0


@pytest.mark.parametrize("name", ["rough", "sine", "ramp", "noise"])
def test_a_temperature_without_events_has_none(name: str) -> None:
    rng = np.random.default_rng(6)
    fine = np.arange(20 * ROWS)
    walk = np.cumsum(rng.standard_normal(len(fine))) * np.sqrt(DT_S / 20)
    temperature = {
        "rough": 20 + walk,
        "sine": 20 + 5 * np.sin(DT_S / 20 * fine),
        "ramp": 20 + 0.001 * fine,
        "noise": np.full(len(fine), 20.0),
    }[name]
    _, events = found_in(readings(temperature, 7))
    assert events == []


def test_rounding_is_no_step_of_the_reading_and_no_wave() -> None:
    """Steps of 0.5 K over noise of 0.05 K, in a heating and in a slow wave."""
    fine_s = DT_S / 20 * np.arange(20 * ROWS)
    for seed in range(3):
        heating = 20 - 15 * np.expm1(-np.maximum(fine_s - 12.3, 0.0) / 6.0)
        wave = 60 + 5 * np.sin(fine_s / 8 + seed)
        for temperature in (heating, wave):
            y = np.round(readings(temperature, seed) / 0.5) * 0.5
            result = smooth(y, DT_S, Chain(LAG_S))
            codes = {finding.code for finding in result.findings}
            assert not codes & {"trace.step", "trace.steps", "noise.wave"}
            error = np.abs(result.temperature[:, 0] - temperature[::20])
            assert np.mean(error < 1.96 * result.sd[:, 0]) > 0.9
            assert np.median(result.sd) < 1.0


def cooling(at_s: float, seed: int) -> tuple[Array, Array]:
    """A temperature (N,) that falls by 40 K within 15 s from a time on, and its readings (N,)."""
    fine_s = DT_S / 20 * np.arange(20 * ROWS)
    temperature = 80 + 40 * np.expm1(-np.maximum(fine_s - at_s, 0.0) / 15.0)
    return temperature[::20], readings(temperature, seed)


@pytest.mark.parametrize("listed_s", [20.0, 40.0])
def test_a_listed_event_at_a_wrong_time_is_named_and_the_right_one_is_found(
    listed_s: float,
) -> None:
    truth, y = cooling(30.02, 3)
    done = smooth(y, DT_S, Chain(LAG_S, conditioning=NO_CONDITIONING), events_s=[listed_s])
    assert [finding.code for finding in done.findings] == ["trace.events"]
    assert [event.kind() for event in done.detected] == ["kink"]
    assert abs(done.detected[0].at_s - 30.02) < 3 * done.detected[0].u_s + DT_S
    assert np.mean(np.abs(done.temperature[:, 0] - truth) < 1.96 * done.sd[:, 0]) > 0.9


@pytest.mark.parametrize("rows_late", [-1.0, 0.0, 1.0])
def test_a_listed_event_may_be_a_row_early_or_late(rows_late: float) -> None:
    truth, y = cooling(30.02, 4)
    at_s = 30.02 + rows_late * DT_S
    done = smooth(y, DT_S, Chain(LAG_S, conditioning=NO_CONDITIONING), events_s=[at_s])
    error = np.abs(done.temperature[:, 0] - truth)
    assert np.max(error / done.sd[:, 0]) < 6
    assert np.mean(error < 1.96 * done.sd[:, 0]) > 0.88


def test_a_listed_event_outside_the_record_is_said() -> None:
    _, y = cooling(30.02, 5)
    done = smooth(y, DT_S, Chain(LAG_S, conditioning=NO_CONDITIONING), events_s=[1e4])
    assert [finding.code for finding in done.findings] == ["trace.event_outside"]


def test_a_temperature_that_settles_within_two_lags_is_a_kink_and_no_jump() -> None:
    fine_s = DT_S / 20 * np.arange(20 * ROWS)
    since_s = np.maximum(fine_s - 30.01, 0.0)
    temperature = 80 + 20 * np.expm1(-since_s / (2 * LAG_S)) + 20 * np.expm1(-since_s / 30.0)
    for seed in range(3):
        fit, events = found_in(readings(temperature, seed))
        assert [int(np.argmax(event.kind_probability[0])) for event in events] == [Kind.KINK]
        error = np.abs(fit.at_samples().temperature[:, 0] - temperature[::20])
        assert np.max(error / fit.at_samples().sd[:, 0]) < 6
