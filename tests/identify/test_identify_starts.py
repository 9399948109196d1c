"""Where searches begin: in any unit, from closed forms, and as the correlation of the columns says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tcdyn.chain.rational import Factor, Rational, realise, simulate_rows
from tcdyn.identify import IOData, fit, process, several, simulate
from tcdyn.identify.causality import lead_correlation
from tcdyn.identify.forward_selection import successors, warm_start, warm_starts
from tcdyn.identify.models import as_model, base_name
from tcdyn.identify.search import distinct_starts, first_moment, make_problem, time_parameters
from tcdyn.identify.starting_values import (
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
    """Two lags behind a dead time, 180 samples; times in ``unit``, both columns ``size`` times as large."""
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
def test_starts_are_the_same_in_seconds_and_minutes_in_kelvin_and_millikelvin(name: str) -> None:
    unit = 1 / 60
    model = as_model(name)
    plain, other = (
        make_problem(record(*how), model, "equilibrium") for how in ((), (unit, 1000.0))
    )
    found = starts(plain)
    moved = starts(other)
    assert len(found) == len(moved) > 0
    for x, z in zip(found, moved):
        theta = in_unit(plain.theta(x), unit)
        if name == "P1I":  # a gain over time
            theta["Kp"] /= unit
        assert other.theta(z) == pytest.approx(
            theta, rel=1e-4, abs=1e-7
        )  # least squares of either scaling round
    assert np.isclose(
        first_moment(other, moved[0]), unit * first_moment(plain, found[0]), rtol=1e-4
    )
    assert [len(distinct_starts(p, x)) for p, x in ((plain, found), (other, moved))] == [
        len(distinct_starts(plain, found))
    ] * 2


@pytest.mark.parametrize(
    ("was", "larger"),
    [
        ("P1", "P1D"),
        ("P1", "P2Z"),
        ("P1", "P1Z"),
        ("P2", "P2DU"),
        ("P3", "P3U"),
        ("P1D", "P3DU"),
        ("TF(0,1)", "TF(1,3)D"),
    ],
)
def test_a_larger_model_begins_at_the_same_place_in_any_unit(was: str, larger: str) -> None:
    have = {
        n: 2.0 if n in ("Kp", "b0") else 0.3 * (k + 1) for k, n in enumerate(as_model(was).names)
    }
    part = as_model(larger)
    unit = 1 / 60
    begun = warm_start(as_model(was), have, part, 0.7)
    moved = warm_start(as_model(was), in_unit(have, unit), part, 0.7 * unit)
    assert moved == pytest.approx(in_unit(begun, unit), rel=1e-12)  # rounding only
    assert set(begun) == set(part.names)
    if larger == "P1D":
        assert begun["Td"] < 0.5 * 0.7  # a dead time as large as the lag would be another model


@pytest.mark.parametrize("name", ["P1D", "P2D", "P3D", "P1HD", "P2H"])
@pytest.mark.parametrize("pattern", [1, 2])
def test_a_lag_is_shared_out_and_none_of_it_is_lost(name: str, pattern: int) -> None:
    model = process(name)
    theta = share_lag(model, 1.3, 0.4, pattern)
    total = model.rational({n: theta[n] for n in model.names}).lag_s
    late = theta["Td"] if not model.has_delay else 0.0
    assert total + late == pytest.approx(1.3 + 0.4, rel=2e-3)  # cement as its first lags


def test_poles_of_a_transfer_function_become_lags_and_a_pair() -> None:
    den = np.polynomial.polynomial.polymul([1.0, 2 * 0.3 * 0.5, 0.25], [1.0, 4.0])
    theta = from_poles(as_model("P3DUZ"), np.array([2.0, 0.6]), den, 0.7)
    truth = {"Kp": 2.0, "Tz": 0.3, "Td": 0.7, "Tw": 0.5, "Zeta": 0.3, "Tp3": 4.0}
    assert theta == pytest.approx(truth, rel=1e-9)
    lags = from_poles(as_model("P2"), np.array([1.0]), np.array([1.0, 5.0, 4.0]), 0.0)
    assert (lags["Tp1"], lags["Tp2"]) == pytest.approx(
        (4.0, 1.0), rel=2e-3
    )  # equal ones are set apart by 1e-3
    same = from_poles(as_model("P2"), np.array([1.0]), np.array([1.0, 2.0, 1.0]), 0.0)
    assert same["Tp2"] > same["Tp1"] * 1.0005
    given = from_poles(as_model("TF(1,2)D"), np.array([1.0, 0.5]), np.array([1.0, 5.0, 4.0]), 0.2)
    assert given == {"b0": 1.0, "b1": 0.5, "a0": 1.0, "a1": 5.0, "a2": 4.0, "Td": 0.2}


@pytest.mark.parametrize(("name", "late"), [("P1D", 0.4), ("P2D", 0.2), ("P2DU", 0.2)])
def test_half_a_dead_time_is_lent_to_the_lags_where_there_are_two_and_no_pair_is_much_later(
    name: str, late: float
) -> None:
    assert share_lag(process(name), 1.3, 0.4, 1)["Td"] == pytest.approx(late)
    for pattern in range(3):
        theta = share_lag(process("P2U"), 1.3, 0.0, pattern)
        assert 2 * theta["Zeta"] * theta["Tw"] < 1.5 * 1.3


def test_what_is_new_of_a_transfer_function_is_a_pole_of_the_size_asked_for_with_a_zero_upon_it() -> (
    None
):
    theta = warm_start(as_model("TF(0,1)"), {"b0": 2.0, "a1": 5.0}, as_model("TF(1,3)"), 0.7)
    assert [theta[n] for n in ("b0", "b1")] == pytest.approx([2.0, 2.0 * 0.7])
    assert [theta[n] for n in ("a1", "a2", "a3")] == pytest.approx(
        [6.4, 2 * 3.5 + 0.49, 5 * 0.49]
    )  # (1+5s)(1+.7s)^2


@pytest.mark.parametrize(
    ("name", "larger"),
    [
        ("P1Z", ["P1DZ", "P2Z", "P2UZ"]),
        ("P2Z", ["P2DZ", "P3Z", "P2UZ", "TF(2,2)"]),
        ("P3D", ["P3DZ", "P3DU", "TF(0,4)D", "TF(1,4)D"]),
        ("P3DZ", ["P3DUZ", "TF(2,3)D", "TF(1,4)D", "TF(2,4)D"]),
        ("TF(5,6)D", ["TF(6,6)D"]),
    ],
)
def test_a_step_of_the_search_adds_one_thing(name: str, larger: list[str]) -> None:
    assert [m.name for m in successors(as_model(name))] == larger


def test_what_is_new_is_begun_in_lags_of_what_was_there_whatever_their_unit() -> None:
    begun = []
    for unit in (1.0, 1 / 60):
        start = {"Kp": 2.0, "Tp1": 1.3 * unit}
        small = fit(
            record(unit), "P1", start=start, check=False, intervals="quadratic", input_noise=0.0
        )
        begun.append([in_unit(theta, 1 / unit) for theta in warm_starts(small, as_model("P2"))])
    assert len(begun[0]) == 3  # a tenth of the lag, the lag, ten of it
    for one, other in zip(*begun):
        assert other == pytest.approx(one, rel=1e-4)
    assert [theta["Tp2"] for theta in begun[0]] == pytest.approx(
        [f * begun[0][0]["Tp1"] for f in (0.1, 1.0, 10.0)]
    )


def test_at_the_truth_the_regression_with_filtered_columns_leaves_nothing() -> None:
    """A y_f = B u_f + offset, both filtered by 1/A; without noise the instruments are nearly its columns."""
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
    posed = make_problem(
        IOData.from_arrays(u, y, DT, hold="foh"), as_model("TF(1,2)"), "equilibrium"
    )
    target, phi, z = regression(posed, den, num, 0.0)
    assert phi.shape == z.shape == (len(y), 5)
    assert phi @ [2.0, 0.8, 1.3, 0.36, 7.0] == pytest.approx(target, abs=1e-9)
    for k in (
        2,
        3,
    ):  # but for the straight lines between samples that the filter takes the output for
        assert np.corrcoef(z[:, k], phi[:, k])[0, 1] > 0.99


def test_unstable_poles_are_mirrored_and_those_on_the_axis_moved_off_it() -> None:
    unstable = np.polynomial.polynomial.polymul([1.0, -0.5], [1.0, 2.0])
    assert stabilise(unstable) == pytest.approx([1.0, 2.5, 1.0], rel=1e-12)  # (1 + s/2)(1 + 2 s)
    ringing = stabilise(np.array([1.0, 0.0, 0.25]))
    assert ringing == pytest.approx([1.0, 0.0, 0.25], abs=1e-5)
    assert ringing[1] > 0


@pytest.mark.parametrize("late", [0, 7, -4])
def test_what_a_lag_explains_is_the_squared_correlation_at_every_shift(late: int) -> None:
    rng = np.random.default_rng(late + 10)
    u = rng.normal(size=90).cumsum()
    truth = simulate_rows(
        realise(Rational(np.ones(1), (Factor((1.0, 0.5)),)), False),
        u,
        DT,
        0.0,
        "foh",
        "equilibrium",
    )
    y = (
        3.0
        + 2.0 * np.interp(np.arange(90) - late, np.arange(90), truth[0])
        + 0.2 * rng.normal(size=90)
    )
    posed = make_problem(IOData.from_arrays(u, y, DT, hold="foh"), process("P1D"), "equilibrium")
    found = lag_correlation(posed, np.array([0.2, 0.5]), 12, 6)
    for row, tau in zip(found, (0.2, 0.5)):
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
    assert np.argmax(found[1]) == 6 + late


def test_the_straight_line_is_taken_out_and_the_level_left() -> None:
    data = record()
    run = data.runs[0]
    drift = 0.3 * DT * np.arange(len(run.y))
    u = run.u.copy()
    u[50:60] = np.nan  # cut in two
    y = (7.0 + drift)[:, None]
    posed = make_problem(
        replace(data, runs=(replace(run, u=u, y=y),)), process("P1"), "equilibrium"
    )
    first, second = remove_run_slopes(posed).segments
    mean = 7.0 + np.r_[drift[:50], drift[60:]].mean()
    for segment in (first, second):
        assert segment.y[segment.measured] == pytest.approx(
            np.full(segment.measured.sum(), mean), abs=1e-9
        )


def test_gain_and_offset_come_of_a_regression_at_given_lags_and_a_known_past_is_a_sample_of_it() -> (
    None
):
    u = record().runs[0].u[:, 0]
    truth = {"Kp": -1.7, "Tp1": 0.9}
    y = simulate(process("P1").rational(truth), u, DT, "foh") + 4.0
    posed = make_problem(IOData.from_arrays(u, y, DT, hold="foh"), process("P1"), "equilibrium")
    cost, x = solve_linear_parameters(posed, {"Kp": 9.0, "Tp1": 0.9})
    assert posed.theta(x) == pytest.approx(truth, rel=1e-9)
    assert x[-1] == pytest.approx(4.0, abs=1e-9)
    assert cost < 1e-18 * float(y @ y)
    noisy = replace(posed, input_sds=(0.5,), noise_sd=0.1)
    cost, x = solve_linear_parameters(noisy, {"Kp": 9.0, "Tp1": 0.9})
    assert x[-1] == pytest.approx(0.0, abs=1e-9)  # the past is the first sample, as it is
    free = replace(posed, model=process("P1", fixed={"Kp": 1.0, "Tp1": 0.9}, offset="none"))
    answer = free.evaluate(free.vector({}))
    assert answer is not None
    assert solve_linear_parameters(free, {})[0] == pytest.approx(float(answer[0] @ answer[0]))


def test_a_lead_explains_what_follows_the_input_and_nothing_of_what_goes_before_it() -> None:
    """Of white noise what is to come cannot be told from what was: 0.02 by chance, 3 of 400 samples and a few lags."""
    u = np.random.default_rng(3).normal(size=400)
    y = simulate(
        process("P2Z").rational({"Kp": 1.0, "Tp1": 0.5, "Tp2": 0.2, "Tz": 1.5}), u, DT, "foh"
    )
    posed, ahead = (
        make_problem(IOData.from_arrays(u, moved, DT, hold="foh"), process("P1D"), "equilibrium")
        for moved in (y, np.r_[y[8:], np.full(8, y[-1])])
    )
    assert lead_correlation(posed) > 0.99
    assert lead_correlation(ahead, 8) > 0.99
    assert lead_correlation(ahead) < 0.1
    assert lead_correlation(posed, 8) < 0.1 + lead_correlation(posed, 12)


def test_starts_apart_by_less_than_a_part_of_their_lags_are_one() -> None:
    posed = make_problem(record(), process("P2"), "equilibrium")
    lags = [(1.0, 0.5), (1.1, 0.5), (1.0, 1.2), (4.0, 0.5), (0.1, 0.1), (9.0, 9.0)]
    ranked = [posed.vector({"Kp": 1.0, "Tp1": a, "Tp2": b}) for a, b in lags]
    chosen = [tuple(np.round(time_parameters(posed, x), 6)) for x in distinct_starts(posed, ranked)]
    assert chosen == [(1.0, 0.5), (1.0, 1.2), (4.0, 0.5), (0.1, 0.1)]


def test_each_of_several_inputs_is_begun_with_what_the_others_do_taken_out() -> None:
    rng = np.random.default_rng(5)
    a, b = (np.repeat(rng.choice([0.0, 1.0], -(-200 // k)), k)[:200] for k in (20, 13))
    parts = (("P1D", {"Kp": 2.0, "Tp1": 1.5, "Td": 0.6}, a), ("P1", {"Kp": -1.0, "Tp1": 0.5}, b))
    y = 3.0 + sum(simulate(process(n).rational(t), u, DT, "foh") for n, t, u in parts)
    data = IOData.from_arrays(np.stack([a, b], 1), y, DT, hold="foh", input_names=["a", "b"])
    posed = make_problem(data, several(["P1D", "P1"], ["a", "b"]), "equilibrium")
    theta = posed.theta(starts(posed)[0])
    assert (theta["Kp.a"], theta["Kp.b"]) == pytest.approx(
        (2.0, -1.0), rel=0.15
    )  # lags of a row of a factor 1.5
    assert theta["Td.a"] == pytest.approx(0.6, abs=0.3)  # of a lag of 1.5 s
