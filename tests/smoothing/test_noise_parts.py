"""Noise of a logger and bursts, part by part: spectra in closed form, parts of a window against
plain regressions."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from tcdyn.chain import Chain
from tcdyn.chain.bursts import (
    LENGTHS,
    LONGEST_S,
    MIN_HEIGHT_SD,
    _burst_mask,
    _filtered_pulses,
    _pulse_shapes,
    _PulseSearch,
    _searched_near_suspects,
    _window_of,
    _WindowModel,
)
from tcdyn.chain.logger_noise import (
    LoggerNoise,
    _alias_frequency,
    _fit_levels,
    _mains_at,
    _power_gain,
    estimate_logger_noise,
    noise_power_ratio,
)
from tcdyn.chain.rational import (
    Factor,
    Rational,
    impulse_rows,
    newton_form,
    polynomial_product,
    realise,
    simulate_rows,
    spectral_factor,
    steady_state,
)
from tcdyn.rig.disk import Conditioning

DT = 1 / 75
ONE, TWO = Conditioning(4.0, 1), Conditioning(4.0, 2)


def test_a_filter_of_one_pole_passes_an_arctangent_of_white_noise() -> None:
    f = np.array([0.0, 4.0, 12.0])
    assert _power_gain(f, ONE) == pytest.approx([1.0, 0.5, 0.1])
    assert noise_power_ratio(ONE, DT) == pytest.approx(
        4.0 / 37.5 * np.arctan(37.5 / 4.0), rel=2e-2
    )  # 400 points


@pytest.mark.parametrize(("before", "after"), [(0.8, 0.2), (0.999, 0.001), (1.0, 0.0), (0.2, 0.8)])
@pytest.mark.parametrize("filter_", [ONE, TWO])
def test_a_spectral_factor_has_the_spectrum_of_both_noises_as_far_as_samples_show(
    before: float, after: float, filter_: Conditioning
) -> None:
    ladder, f = polynomial_product(filter_.factors), np.linspace(0.0, 20.0, 30)
    sections = spectral_factor(before, after, ladder, 5 / DT)
    s = 2j * np.pi * f
    told = np.abs(polyval(s, polynomial_product(sections))) ** 2
    exact = before + after * np.abs(polyval(s, ladder)) ** 2
    assert len(polynomial_product(sections)) == len(ladder)
    assert all(np.all(np.roots(c[::-1]).real < 0) for c in sections)
    near = (
        1e-9 if after > 0.1 else 0.35 * after + 0.36
    )  # a root put at five times the rate: (2 pi 20/375)^2 each
    assert told == pytest.approx(exact, rel=near)


def test_levels_of_a_spectrum_that_fits_are_found_and_none_is_negative() -> None:
    f = np.linspace(0.5, 30, 200)
    shapes = np.stack([np.ones(200), _power_gain(f, TWO), f**-4.0], axis=1)
    levels, cost = _fit_levels(shapes @ [0.3, 2.0, 0.5], shapes)
    assert levels == pytest.approx([0.3, 2.0, 0.5], rel=1e-6)
    assert cost == pytest.approx(float(np.sum(np.log(shapes @ [0.3, 2.0, 0.5]) + 1)))
    assert _fit_levels(shapes @ [0.3, 0.0, 0.5], shapes)[0] == pytest.approx(
        [0.3, 0.0, 0.5], abs=1e-9
    )


def test_mains_are_seen_where_the_sampling_folds_them() -> None:
    assert _alias_frequency(50.0, 75.0) == pytest.approx(25.0)
    assert _alias_frequency(60.0, 75.0) == pytest.approx(15.0)
    assert _alias_frequency(10.0, 75.0) == pytest.approx(10.0)
    assert _mains_at(25.2, 75.0) == [50.0]
    assert _mains_at(14.8, 75.0) == [60.0]
    assert _mains_at(20.0, 75.0) == []
    hum = LoggerNoise(
        np.zeros(1), np.ones(1), np.ones(1), ONE, hum_lines=((25.0, np.array([0.4])),), rate_Hz=75.0
    )
    assert hum.aliasing_u_K == pytest.approx([0.5 * 0.4 / np.sqrt(2)])  # 150 Hz comes to rest
    assert replace(
        hum, rate_Hz=80.0, hum_lines=((30.0, np.array([0.4])),)
    ).aliasing_u_K == pytest.approx([0.0])  # 50: none


def test_a_wave_has_its_frequency_and_its_amplitude() -> None:
    rng, t = np.random.default_rng(0), np.arange(9000) * DT
    y = 0.3 * np.sin(2 * np.pi * 11.0 * t)[:, None] * [1.0, 2.0] + 0.05 * rng.standard_normal(
        (9000, 2)
    )
    found = estimate_logger_noise([y], DT, TWO, np.full(2, 0.05))
    ((f, amplitude),) = found.hum_lines
    assert f == pytest.approx(11.0, abs=0.02)
    assert amplitude == pytest.approx(
        [0.3, 0.6], rel=0.06
    )  # from medians of spectra of 8 s, to a few per cent
    assert not found.is_coloured
    assert found.after_filter_K == pytest.approx([0.05, 0.05], rel=0.1)
    told = found.with_channels(np.array([True, False, True]), np.array([9.0, 0.7, 9.0]))
    assert told.after_filter_K == pytest.approx(
        [found.after_filter_K[0], 0.7, found.after_filter_K[1]]
    )
    assert told.hum_lines[0][1] == pytest.approx([amplitude[0], 0.0, amplitude[1]])


def test_a_trace_made_white_is_filtered_by_what_the_chain_is_divided_by() -> None:
    """A/N of the trace, and C B A/N = C/N of the chain: a wave through both is the same."""
    sections = spectral_factor(0.9, 0.1, polynomial_product(TWO.factors), 5 / DT)
    noise = LoggerNoise(np.ones(1), np.ones(1), np.ones(1), TWO, sections)
    chain = Chain((0.5,), conditioning=TWO)
    f = np.array([0.5, 3.0])
    s = 2j * np.pi * f
    ratio = polyval(s, polynomial_product(TWO.factors)) / polyval(s, polynomial_product(sections))
    assert noise.whitened_chain(chain).frequency_response(f) == pytest.approx(
        chain.frequency_response(f) * ratio
    )
    other = Chain((0.5,), conditioning=ONE)
    assert noise.whitened_chain(other).frequency_response(f) == pytest.approx(
        other.frequency_response(f) * ratio
    )
    assert noise.whitened_chain(chain).conditioning.lag_s == TWO.lag_s
    t = np.arange(3000) * DT
    y = np.sin(2 * np.pi * 0.5 * t)[:, None].copy()
    y[1000] = np.nan
    white = noise.whiten(y, DT)[:, 0]
    exact = np.abs(ratio[0]) * np.sin(2 * np.pi * 0.5 * t + np.angle(ratio[0]))
    late = (t > 5) & (np.abs(np.arange(3000) - 1000) > 60)
    assert white[late] == pytest.approx(exact[late], abs=2e-3)  # straight lines between samples
    assert np.flatnonzero(np.isnan(white)).tolist() == [1000]


def test_two_parts_explain_what_a_regression_on_both_does() -> None:
    rng = np.random.default_rng(1)
    units = rng.normal(size=(40, 7))
    units /= np.linalg.norm(units, axis=0)
    alike = units.T @ units - np.eye(7)
    parts = _WindowModel(
        units, units, np.clip(units.T @ units, -0.999, 0.999), np.ones(7), np.zeros((40, 0)), 4
    )
    assert np.abs(alike).max() < 0.999
    window = rng.normal(size=40)
    told = units.T @ window

    def explained(pair: tuple[int, int]) -> float:
        fitted = units[:, list(pair)] @ np.linalg.lstsq(units[:, list(pair)], window, rcond=None)[0]
        return float(fitted @ fitted)

    pairs = {pair: explained(pair) for pair in combinations(range(7), 2)}
    most, i, k = parts._best_pair(told, told**2, slice(0, 7))
    best = max(pairs, key=pairs.__getitem__)
    assert tuple(sorted((i, k))) == best
    assert most == pytest.approx(pairs[best])
    others = {pair: v for pair, v in pairs.items() if min(pair) >= 4}
    assert parts._best_pair(told, told**2, slice(4, 7), 4)[0] == pytest.approx(max(others.values()))
    share, cross = parts.weights
    assert (share[2, 2], cross[2, 2]) == (0.5, 0.0)  # a part with itself: what it does alone


def test_pulses_are_those_of_the_filter_and_parts_hold_no_cubic() -> None:
    """Held for n samples behind one pole: 1 - e^(-t/tau), then falling; without a filter a box."""
    tau = 1 / (2 * np.pi * 4.0)
    pulses = list(_filtered_pulses(DT, ONE))
    assert len(pulses) == sum(n * DT <= LONGEST_S for n in LENGTHS)
    t = np.arange(len(pulses[3])) * DT
    rise = 1 - np.exp(-t / tau)
    exact = np.where(t <= 5 * DT, rise, (1 - np.exp(-5 * DT / tau)) * np.exp(-(t - 5 * DT) / tau))
    assert LENGTHS[3] == 5
    assert pulses[3] == pytest.approx(exact, abs=1e-12)
    assert pulses[3][-1] < 1e-3  # eight of the lag
    boxes = list(_filtered_pulses(DT, Conditioning(4.0, 0)))
    assert boxes[0].tolist() == [1.0, 1.0, 0.0][: len(boxes[0])]
    sought, shapes, beside = _pulse_shapes(DT, ONE)
    assert [p.tolist() for p in sought] == [p.tolist() for p in pulses]
    size = len(pulses[3]) + 2 * beside
    first, x = shapes.shape[1] // 2 - size // 2, np.linspace(-1, 1, size)
    rest = shapes[3, first : first + size]
    assert np.linalg.norm(shapes, axis=1) == pytest.approx(1.0)
    assert np.linalg.norm(rest) == pytest.approx(1.0)  # zero elsewhere
    assert [float(rest @ x**k) for k in range(4)] == pytest.approx([0.0] * 4, abs=1e-12)
    parts = _window_of([pulses[3], pulses[5]], 90, 12, DT, 0.5)
    x = np.linspace(-1, 1, 90)
    assert np.abs(np.stack([x**k for k in range(4)]) @ parts.units).max() < 1e-9
    assert np.linalg.norm(parts.units, axis=0) == pytest.approx(1.0)
    assert np.flatnonzero(parts.shapes[:, 0])[0] >= 3  # a quarter of what stands beside a pulse
    assert np.abs(parts.shapes[:, parts.pulses :]).max() == 0.0


def find_bursts(
    y: np.ndarray, dt_s: float, noise_sd: float, filter_: Conditioning, lag_s: float
) -> np.ndarray:
    """The mask of the bursts in one trace (N,); no other channel is a witness."""
    search = _PulseSearch.of(y, dt_s, noise_sd, filter_)
    return _burst_mask(search, lag_s, np.zeros(len(y), dtype=bool))


@pytest.mark.parametrize("length", [4, 20])
def test_a_burst_moves_the_samples_that_its_pulse_stands_in(length: int) -> None:
    """A height of 40 standard deviations before a filter of 4 Hz; a tail of less than half of one
    is kept."""
    pulse = np.zeros(900)
    pulse[400 : 400 + length] = 40.0
    t = np.arange(900) * DT
    tau = 1 / (2 * np.pi * 4.0)
    moved = np.zeros(900)
    for k in range(1, 900):
        moved[k] = pulse[k - 1] + (moved[k - 1] - pulse[k - 1]) * np.exp(-DT / tau)
    y = 50 + 3 * np.sin(t) + 0.1 * (moved + np.random.default_rng(2).standard_normal(900))
    found = find_bursts(y, DT, 0.1, ONE, 0.6)
    assert found[moved > 3].all()
    assert np.count_nonzero(found & (moved < 0.2)) <= 4  # an edge of a sample or two on either side
    assert not find_bursts(y - 0.1 * moved, DT, 0.1, ONE, 0.6).any()


def test_newton_s_form_and_what_a_constant_input_has_kept_up() -> None:
    """s^2 + 2 s + 3 on 1, 1/phi_1, 1/(phi_1 phi_2); an integrator behind a lag ramps one lag
    late."""
    poles = np.array([-2.0, -0.5])
    c, direct = newton_form(np.array([[3.0, 2.0, 1.0]]), poles)
    s = np.array([0.3, 1.1 + 0.4j])
    phi = [1 - s / p for p in poles]
    exact = (3 + 2 * s + s**2) / (phi[0] * phi[1])
    assert direct[0, 0] + c[0, 0] / phi[0] + c[0, 1] / (phi[0] * phi[1]) == pytest.approx(exact)
    system = realise(Rational(np.array([2.0]), (Factor((1.0, 0.5)),), 0.0, 1), False)
    xa, xb = steady_state(system, 3.0)
    rows = system.C @ xa, system.C @ xb
    assert rows[0].real == pytest.approx([2 * 3 * -0.5])
    assert rows[1].real == pytest.approx([6.0])
    late = simulate_rows(system, np.full(30, 3.0), 0.1, 0.35, "foh", "equilibrium")[0]
    assert late == pytest.approx(6.0 * (np.arange(30) * 0.1 - 0.35 - 0.5))
    decay = impulse_rows(realise(Rational(np.array([2.0]), (Factor((1.0, 0.5)),)), False), 20, 0.1)[
        0
    ]
    assert decay == pytest.approx(2 / 0.5 * np.exp(-np.arange(20) * 0.1 / 0.5))


def test_the_screen_does_not_change_what_bursts_are_detected() -> None:
    """Pulses of all lengths from 5 to 60 standard deviations: with all shapes, and with the
    screen."""
    rng = np.random.default_rng(7)
    y = 0.1 * np.cumsum(rng.standard_normal((6000, 3)), axis=0) * 0.1
    y += rng.standard_normal(y.shape)
    for k, pulse in enumerate([*_filtered_pulses(DT, ONE)] * 2):
        start = 150 + 190 * k
        y[start : start + len(pulse), k % 3] += rng.uniform(5, 60) * rng.choice([-1, 1]) * pulse
    searches = [_PulseSearch.of(x, DT, 1.0, ONE) for x in y.T]
    screened = _searched_near_suspects(searches)
    for exact, quick in zip(searches, screened):
        assert exact is not None
        assert quick is not None
        assert quick.near is not None
        assert np.mean(quick.near) > 0.05
        assert quick.initial_score[quick.near] == pytest.approx(
            exact.initial_score[quick.near], abs=1e-9
        )
        assert exact.initial_score[~quick.near].max(initial=0.0) < MIN_HEIGHT_SD
        isolated = np.ones(len(y), dtype=bool)
        assert np.array_equal(_burst_mask(exact, 0.5, isolated), _burst_mask(quick, 0.5, isolated))


def test_the_screen_spares_most_of_a_record_without_bursts() -> None:
    y = np.random.default_rng(8).standard_normal((20000, 4))
    (quick, *_) = _searched_near_suspects([_PulseSearch.of(x, DT, 1.0, ONE) for x in y.T])
    assert quick is not None
    assert quick.near is not None
    assert np.mean(quick.near) < 0.05
    assert len(quick.screen) < len(quick.shapes) / 2
