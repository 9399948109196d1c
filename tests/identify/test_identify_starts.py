"""Start values of a search: independent of units, equal to closed forms, and in line with the
correlation of the columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.identification import IOData, fit, process, several, simulate
from tcdyn.identification.causality import lead_correlation
from tcdyn.identification.models import as_model, base_name
from tcdyn.identification.search import distinct_starts, first_moment, make_problem, time_parameters
from tcdyn.identification.starting_values import (
    free_start_correlation,
    from_poles,
    lag_correlation,
    regression,
    remove_run_slopes,
    share_lag,
    solve_linear_parameters,
    stabilise,
    starts,
)

DT = 0.1
STRUCTURES = ("P0D", "P1D", "P2DZ", "P3DU", "P1I", "TF(1,2)")


def record(unit: float = 1.0, size: float = 1.0) -> IOData:
    """Two lags and a dead time, 180 samples. Times are in ``unit``; both columns are scaled by
    ``size``."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 15), 12)
    y = simulate(
        process("P2D").rational({"Kp": 2.0, "Tp1": 0.9, "Tp2": 0.4, "Td": 0.2}), u, DT, "foh"
    )
    return IOData.from_arrays(
        size * u, size * (y + 5 + 0.01 * rng.normal(size=180)), unit * DT, hold="foh"
    )


def in_unit(theta: dict[str, float], unit: float) -> dict[str, float]:
    """Parameters with their times in ``unit``."""
    power = {
        n: int(n[1:]) if n[0] in "ab" else 1 if n[0] == "T" else 0 for n in map(base_name, theta)
    }
    return {n: v * unit ** power[base_name(n)] for n, v in theta.items()}


@pytest.mark.parametrize("name", STRUCTURES)
def test_starts_do_not_depend_on_the_units_of_time_and_amplitude(name: str) -> None:
    unit = 1 / 60
    model = as_model(name)
    reference, scaled = (
        make_problem(record(*arguments), model, "equilibrium") for arguments in ((), (unit, 1000.0))
    )
    plain_starts = starts(reference)
    scaled_starts = starts(scaled)
    assert len(plain_starts) == len(scaled_starts) > 0
    for x, z in zip(plain_starts, scaled_starts):
        theta = in_unit(reference.theta(x), unit)
        if name == "P1I":  # a gain over time
            theta["Kp"] /= unit
        # tolerance: rounding of the least squares in the two scalings
        assert scaled.theta(z) == pytest.approx(theta, rel=1e-4, abs=1e-7)
    assert np.isclose(
        first_moment(scaled, scaled_starts[0]),
        unit * first_moment(reference, plain_starts[0]),
        rtol=1e-4,
    )
    assert [
        len(distinct_starts(p, x)) for p, x in ((reference, plain_starts), (scaled, scaled_starts))
    ] == [len(distinct_starts(reference, plain_starts))] * 2


@pytest.mark.parametrize("name", ["P1D", "P2D", "P3D", "P1HD", "P2H"])
@pytest.mark.parametrize("pattern", [1, 2])
def test_share_lag_preserves_the_total_lag(name: str, pattern: int) -> None:
    model = process(name)
    theta = share_lag(model, 1.3, 0.4, pattern)
    total = model.rational({n: theta[n] for n in model.names}).lag_s
    delay = theta["Td"] if not model.has_delay else 0.0
    assert total + delay == pytest.approx(1.3 + 0.4, rel=2e-3)  # cement as its first lags


def test_poles_of_a_transfer_function_become_lags_and_a_complex_pair() -> None:
    den = np.polynomial.polynomial.polymul([1.0, 2 * 0.3 * 0.5, 0.25], [1.0, 4.0])
    theta = from_poles(as_model("P3DUZ"), np.array([2.0, 0.6]), den, 0.7)
    expected = {"Kp": 2.0, "Tz": 0.3, "Td": 0.7, "Tw": 0.5, "Zeta": 0.3, "Tp3": 4.0}
    assert theta == pytest.approx(expected, rel=1e-9)
    lags = from_poles(as_model("P2"), np.array([1.0]), np.array([1.0, 5.0, 4.0]), 0.0)
    # share_lag separates equal lags by 1e-3
    assert (lags["Tp1"], lags["Tp2"]) == pytest.approx((4.0, 1.0), rel=2e-3)
    equal_lags = from_poles(as_model("P2"), np.array([1.0]), np.array([1.0, 2.0, 1.0]), 0.0)
    assert equal_lags["Tp2"] > equal_lags["Tp1"] * 1.0005
    coefficients = from_poles(
        as_model("TF(1,2)D"), np.array([1.0, 0.5]), np.array([1.0, 5.0, 4.0]), 0.2
    )
    assert coefficients == {"b0": 1.0, "b1": 0.5, "a0": 1.0, "a1": 5.0, "a2": 4.0, "Td": 0.2}


@pytest.mark.parametrize(("name", "delay"), [("P1D", 0.4), ("P2D", 0.2), ("P2DU", 0.2)])
def test_share_lag_gives_half_the_dead_time_to_two_lags_and_bounds_the_delay_of_a_pair(
    name: str, delay: float
) -> None:
    assert share_lag(process(name), 1.3, 0.4, 1)["Td"] == pytest.approx(delay)
    for pattern in range(3):
        theta = share_lag(process("P2U"), 1.3, 0.0, pattern)
        assert 2 * theta["Zeta"] * theta["Tw"] < 1.5 * 1.3


def test_regression_with_filtered_columns_has_no_residual_at_the_true_parameters() -> None:
    """A y_f = B u_f + offset, both filtered by 1/A. Without noise the instruments nearly equal the
    columns."""
    den = np.array([1.0, 1.3, 0.36])
    num = np.array([2.0, 0.8])
    u = record().runs[0].u[:, 0]
    y = (
        simulate(
            as_model("TF(1,2)").rational({"b0": 2.0, "b1": 0.8, "a1": 1.3, "a2": 0.36}),
            u,
            DT,
            "foh",
        )
        + 7.0
    )
    problem = make_problem(
        IOData.from_arrays(u, y, DT, hold="foh"), as_model("TF(1,2)"), "equilibrium"
    )
    target, phi, z = regression(problem, den, num, 0.0)
    assert phi.shape == z.shape == (len(y), 5)
    assert phi @ [2.0, 0.8, 1.3, 0.36, 7.0] == pytest.approx(target, abs=1e-9)
    # not exactly 1: the filter joins the samples of the output by straight lines
    for k in (2, 3):
        assert np.corrcoef(z[:, k], phi[:, k])[0, 1] > 0.99


def test_stabilise_mirrors_unstable_poles_and_moves_poles_off_the_imaginary_axis() -> None:
    unstable = np.polynomial.polynomial.polymul([1.0, -0.5], [1.0, 2.0])
    assert stabilise(unstable) == pytest.approx([1.0, 2.5, 1.0], rel=1e-12)  # (1 + s/2)(1 + 2 s)
    ringing = stabilise(np.array([1.0, 0.0, 0.25]))
    assert ringing == pytest.approx([1.0, 0.0, 0.25], abs=1e-5)
    assert ringing[1] > 0


@pytest.mark.parametrize("delay", [0, 7, -4])
def test_lag_correlation_equals_the_signed_squared_correlation_at_every_shift(delay: int) -> None:
    rng = np.random.default_rng(delay + 10)
    u = rng.normal(size=90).cumsum()
    expected = simulate_rows(
        realise(Rational(np.ones(1), (Factor((1.0, 0.5)),)), False),
        u,
        DT,
        0.0,
        "foh",
        "equilibrium",
    )
    y = (
        3.0
        + 2.0 * np.interp(np.arange(90) - delay, np.arange(90), expected[0])
        + 0.2 * rng.normal(size=90)
    )
    problem = make_problem(IOData.from_arrays(u, y, DT, hold="foh"), process("P1D"), "equilibrium")
    result = lag_correlation(problem, np.array([0.2, 0.5]), 12, 6)
    for row, tau in zip(result, (0.2, 0.5)):
        lagged = simulate_rows(
            realise(Rational(np.ones(1), (Factor((1.0, tau)),)), False),
            u,
            DT,
            0.0,
            "foh",
            "equilibrium",
        )[0]
        for k, value in enumerate(row):
            shift = k - 6
            pair = (
                (lagged[-shift:], y[:shift])
                if shift < 0
                else (np.r_[np.full(shift, u[0]), lagged[: 90 - shift]], y)
            )
            r = np.corrcoef(*pair)[0, 1]
            assert value == pytest.approx(np.sign(r) * r**2, abs=1e-9)
    assert np.argmax(result[1]) == 6 + delay


def test_remove_run_slopes_removes_the_straight_line_and_keeps_the_level() -> None:
    data = record()
    run = data.runs[0]
    drift = 0.3 * DT * np.arange(len(run.y))
    u = run.u.copy()
    u[50:60] = np.nan  # cut in two
    y = (7.0 + drift)[:, None]
    problem = make_problem(
        replace(data, runs=(replace(run, u=u, y=y),)), process("P1"), "equilibrium"
    )
    first, second = remove_run_slopes(problem).segments
    mean = 7.0 + np.r_[drift[:50], drift[60:]].mean()
    for segment in (first, second):
        assert segment.y[segment.measured] == pytest.approx(
            np.full(segment.measured.sum(), mean), abs=1e-9
        )


def test_gain_and_offset_at_given_lags_are_a_linear_regression() -> None:
    u = record().runs[0].u[:, 0]
    expected = {"Kp": -1.7, "Tp1": 0.9}
    y = simulate(process("P1").rational(expected), u, DT, "foh") + 4.0
    problem = make_problem(IOData.from_arrays(u, y, DT, hold="foh"), process("P1"), "equilibrium")
    cost, x = solve_linear_parameters(problem, {"Kp": 9.0, "Tp1": 0.9})
    assert problem.theta(x) == pytest.approx(expected, rel=1e-9)
    assert x[-1] == pytest.approx(4.0, abs=1e-9)
    assert cost < 1e-18 * float(y @ y)
    noisy = replace(problem, input_sds=(0.5,), noise_sd=0.1)
    cost, x = solve_linear_parameters(noisy, {"Kp": 9.0, "Tp1": 0.9})
    assert x[-1] == pytest.approx(0.0, abs=1e-9)  # the past equals the first sample
    free = replace(problem, model=process("P1", fixed={"Kp": 1.0, "Tp1": 0.9}, offset="none"))
    evaluation = free.evaluate(free.vector({}))
    assert evaluation is not None
    assert solve_linear_parameters(free, {})[0] == pytest.approx(
        float(evaluation[0] @ evaluation[0])
    )


def test_lead_correlation_is_high_only_when_the_output_precedes_the_input() -> None:
    """White noise has no predictable future: the correlation by chance is 0.02, from 3 of 400
    samples and a few lags."""
    u = np.random.default_rng(3).normal(size=400)
    y = simulate(
        process("P2Z").rational({"Kp": 1.0, "Tp1": 0.5, "Tp2": 0.2, "Tz": 1.5}), u, DT, "foh"
    )
    problem, leading = (
        make_problem(IOData.from_arrays(u, output, DT, hold="foh"), process("P1D"), "equilibrium")
        for output in (y, np.r_[y[8:], np.full(8, y[-1])])
    )
    assert lead_correlation(problem) > 0.99
    assert lead_correlation(leading, 8) > 0.99
    assert lead_correlation(leading) < 0.1
    assert lead_correlation(problem, 8) < 0.1 + lead_correlation(problem, 12)


def test_distinct_starts_drop_starts_whose_lags_nearly_coincide() -> None:
    problem = make_problem(record(), process("P2"), "equilibrium")
    lags = [(1.0, 0.5), (1.1, 0.5), (1.0, 1.2), (4.0, 0.5), (0.1, 0.1), (9.0, 9.0)]
    ranked = [problem.vector({"Kp": 1.0, "Tp1": a, "Tp2": b}) for a, b in lags]
    chosen = [
        tuple(np.round(time_parameters(problem, x), 6)) for x in distinct_starts(problem, ranked)
    ]
    assert chosen == [(1.0, 0.5), (1.0, 1.2), (4.0, 0.5), (0.1, 0.1)]


def test_starts_with_several_inputs_remove_the_effect_of_the_other_inputs() -> None:
    rng = np.random.default_rng(5)
    a, b = (np.repeat(rng.choice([0.0, 1.0], -(-200 // k)), k)[:200] for k in (20, 13))
    components = (
        ("P1D", {"Kp": 2.0, "Tp1": 1.5, "Td": 0.6}, a),
        ("P1", {"Kp": -1.0, "Tp1": 0.5}, b),
    )
    y = 3.0 + sum(simulate(process(n).rational(t), u, DT, "foh") for n, t, u in components)
    data = IOData.from_arrays(np.stack([a, b], 1), y, DT, hold="foh", input_names=["a", "b"])
    problem = make_problem(data, several(["P1D", "P1"], ["a", "b"]), "equilibrium")
    theta = problem.theta(starts(problem)[0])
    # the grid of lags has a ratio of 1.5
    assert (theta["Kp.a"], theta["Kp.b"]) == pytest.approx((2.0, -1.0), rel=0.15)
    assert theta["Td.a"] == pytest.approx(0.6, abs=0.3)  # tolerance: a fifth of the lag of 1.5 s


def test_correlation_with_a_free_start_equals_the_regression_with_a_decay() -> None:
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([0.0, 1.0], 15), 8)
    t = 0.5 * np.arange(len(u))
    y = rng.normal(size=len(u)) + 5 * np.exp(-t / 4.0)
    data = IOData.from_arrays(u, y, 0.5, hold="zoh")
    problem = make_problem(data, process("P1D"), "estimated")
    lag_s, shift = 3.0, 4
    score = free_start_correlation(problem, np.array([lag_s]), 6)[0, shift]
    a = np.exp(-0.5 / lag_s)
    x = lfilter([0.0, 1 - a], [1.0, -a], np.append(np.zeros(shift), u - u[0])[: len(u)])
    table = np.column_stack([x, np.ones(len(u)), np.exp(-t / lag_s)])
    weights = np.linalg.lstsq(table, y, rcond=None)[0]
    left = y - table @ weights
    centred = y - y.mean()
    r2 = 1 - left @ left / (centred @ centred)
    assert score == pytest.approx(np.sign(weights[0]) * r2, rel=1e-9)  # the sign of the gain


@pytest.mark.parametrize("step_at", [90, 130])
def test_a_late_step_off_equilibrium_has_its_lag(step_at: int) -> None:
    """An input that is constant at first has no correlation with the output at long shifts."""
    n = 200
    u = np.where(np.arange(n) >= step_at, 1.0, 0.0)
    a = np.exp(-0.5 / 4.0)
    y = lfilter([0.0, 1 - a], [1.0, -a], u) + 3 * a ** np.arange(n)
    y = y + 0.02 * np.random.default_rng(step_at).normal(size=n)
    result = fit(IOData.from_arrays(u, y, 0.5, hold="zoh"), "P1D", noise="white", baseline="none")
    assert result.problem.initial in ("level", "estimated")  # the same for one lag
    assert result.estimates["Tp1"].contains(4.0)
    assert result.estimates["Td"].contains(0.0)
