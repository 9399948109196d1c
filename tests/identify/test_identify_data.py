"""Reading of data, and errors for invalid data."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from identify_cases import PLAIN, case_a
from nptdms import ChannelObject, TdmsWriter
from scipy.signal import lfilter

from tcdyn.core.errors import InputError
from tcdyn.identification import IOData, compare, fit, from_csv, from_frame, process, simulate
from tcdyn.identification.causality import check_causality
from tcdyn.identification.search import make_problem


def table(n: int = 200) -> pd.DataFrame:
    """The first ``n`` samples of case A as a table."""
    data = case_a("PRBS", 0)
    return pd.DataFrame(
        {"time_s": data.times_s()[:n], "u": data.runs[0].u[:n, 0], "y": data.runs[0].y[:n, 0]}
    )


def test_slicing_is_in_seconds_and_includes_both_ends():
    section = case_a("PRBS", 0)[2.0:5.0]
    assert section.n_samples == 61
    assert section.runs[0].start_s == pytest.approx(2.0)


def test_merged_runs_remain_separate():
    first = case_a("PRBS", 0)
    second = case_a("PRBS", 1)
    merged = first.merge(second)
    assert [r.n for r in merged.runs] == [800, 800]
    # concatenated, the level jump at the seam would be fitted as dynamics; merged, both runs have
    # one dead time
    result = fit(merged, "P2D", **PLAIN)
    assert result.identified.theta["Td"] == pytest.approx(0.37, abs=4 * result.estimates["Td"].u)
    assert len(result.problem.segments) == 2


def test_data_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        case_a("PRBS", 0).runs[0].u[0] = 1.0


def test_merge_of_different_holds_raises():
    with pytest.raises(InputError, match="hold"):
        case_a("PRBS", 0).merge(case_a("plunge", 0))


def test_run_column_separates_recordings():
    frame = pd.concat([table().assign(run="a"), table().assign(run="b")])
    assert [r.name for r in from_frame(frame, input="u", output="y", run="run").runs] == ["a", "b"]


def test_missing_rows_become_a_gap_and_the_fit_remains_unbiased():
    frame = table(800).drop(index=range(300, 330))
    data = from_frame(frame, input="u", output="y", hold="zoh")
    assert data.n_samples == 800
    assert data.n_missing == 30
    result = fit(data, "P2D", initial="estimated", noise="white", baseline="none")
    assert result.estimates["Tp1"].value == pytest.approx(2.0, abs=4 * result.estimates["Tp1"].u)


def test_rounded_time_stamps_do_not_drift():
    t = np.round(np.arange(7500) / 75, 3)
    frame = pd.DataFrame({"t": t, "u": np.sin(t), "y": np.sin(t)})
    assert from_frame(frame, input="u", output="y").dt_s == pytest.approx(1 / 75, rel=1e-4)


def test_semicolons_and_decimal_commas_are_read(tmp_path):
    path = tmp_path / "euro.csv"
    path.write_text("t;u;y\n0,0;1,5;2,5\n0,5;1,5;2,5\n1,0;3,5;2,75\n", encoding="utf-8")
    data = from_csv(path, input="u", output="y")
    assert data.dt_s == 0.5
    assert data.runs[0].u[2, 0] == 3.5


def uneven_time() -> None:
    frame = table()
    frame["time_s"] += np.random.default_rng(0).uniform(-0.024, 0.024, len(frame))
    from_frame(frame, input="u", output="y")


def backward_time() -> None:
    frame = table()
    frame.loc[50, "time_s"] = 0.0
    from_frame(frame, input="u", output="y")


def exchanged_columns() -> None:
    data = case_a("PRBS", 0)
    fit(IOData.from_arrays(data.runs[0].y, data.runs[0].u, 0.05, hold="zoh"), "P1D")


def early_output() -> None:
    data = case_a("plunge", 0)
    u = data.runs[0].u[:, 0]
    fit(
        IOData.from_arrays(np.concatenate([np.full(60, u[0]), u[:-60]]), data.runs[0].y, 0.05),
        "P1D",
    )


def overflowed_counter() -> None:
    counts = (np.arange(60) * 1000).astype(np.int64)
    IOData.from_arrays(((counts + 2**15) % 2**16 - 2**15).astype(np.int16), np.zeros(60), 0.1)


BAD = {
    "constant input": (
        lambda: fit(IOData.from_arrays(np.ones(100), np.arange(100.0), 0.1)),
        "constant",
    ),
    "two samples": (
        lambda: fit(IOData.from_arrays([0.0, 1.0], [0.0, 0.5], 0.1)),
        "2 measured samples",
    ),
    "NaN everywhere": (
        lambda: fit(IOData.from_arrays(np.arange(50.0), np.full(50, np.nan), 0.1)),
        "NaN everywhere",
    ),
    "NaN input": (
        lambda: fit(IOData.from_arrays(np.full(50, np.nan), np.arange(50.0), 0.1)),
        "NaN everywhere",
    ),
    "NaN in turns": (
        lambda: fit(
            IOData.from_arrays(
                np.where(np.arange(50) % 2, np.arange(50.0), np.nan), np.arange(50.0), 0.1
            )
        ),
        "column u has no 8 samples in a row.*logged only when it changes",
    ),
    "uneven time": (uneven_time, "not evenly spaced"),
    "backward time": (backward_time, "runs backward"),
    "exchanged columns": (exchanged_columns, "before the input"),
    "output before input": (early_output, "before the input"),
    "integer overflow": (overflowed_counter, "16-bit integer overflowed"),
    "infinite": (lambda: IOData.from_arrays([0.0, np.inf], [0.0, 1.0], 0.1), "infinite"),
    "infinite second": (
        lambda: IOData.from_arrays(np.array([[0.0, 0.0], [0.0, np.inf]]), [0.0, 1.0], 0.1),
        "column input 2 is infinite in row 1",
    ),
    "text": (lambda: IOData.from_arrays(["a", "b"], [0.0, 1.0], 0.1), "numbers"),
    "lengths": (lambda: IOData.from_arrays([0.0, 1.0], [0.0], 0.1), "equal lengths"),
    "no such column": (lambda: from_frame(table(), input="x", output="y"), "missing"),
    "hold": (lambda: IOData.from_arrays([0.0], [0.0], 0.1, hold="linear"), "hold"),
    "dead output": (
        lambda: fit(IOData.from_arrays(np.arange(60.0) % 7, np.ones(60), 0.1)),
        "never moves",
    ),
    "no such model": (lambda: fit(case_a("PRBS", 0), "P4"), "no process model"),
    "no interval": (
        lambda: from_frame(table(), input="u", output="y", resample_s=0.0),
        "interval is 0 s",
    ),
    "interval of a nanosecond": (
        lambda: from_frame(table(), input="u", output="y", resample_s=1e-9),
        "at most 5e\\+07",
    ),
    "held dead time alone": (lambda: fit(case_a("PRBS", 0), "P0D"), "add a lag"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_data_raise_one_clear_message(name):
    call, message = BAD[name]
    with pytest.raises(InputError, match=message):
        call()


def test_lead_is_not_mistaken_for_an_output_that_precedes_the_input():
    from tcdyn.identification import process, simulate

    u = case_a("PRBS", 2).runs[0].u[:, 0]
    y = simulate(process("P1Z").rational({"Kp": 1.0, "Tp1": 0.3, "Tz": 0.9}), u, 0.05, "zoh")
    y = y + 0.3 * np.random.default_rng(0).normal(size=len(y))
    result = fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P1Z", **PLAIN)
    assert result.identified.theta["Tz"] == pytest.approx(0.9, abs=4 * result.estimates["Tz"].u)


def test_table_without_column_names_is_distinguished_from_a_missing_column(tmp_path):
    for text in (
        "0,0,299.53\n1,0,299.6\n",
        "0;299,53\n1;299,6\n",
        "0\t299.53\t\n1\t299.6\t\n2\t299.7\t\n",  # a separator ends each line
    ):
        (tmp_path / "bare.csv").write_text(text)
        with pytest.raises(InputError, match=r"row 1 is numbers.*names into the first row"):
            from_csv(tmp_path / "bare.csv", input="u", output="y")


def test_runs_may_be_named_by_text(tmp_path):
    frame = pd.concat([table().assign(run="warm"), table().assign(run="cold")])
    frame.to_csv(tmp_path / "two.csv", index=False)
    assert [
        r.name for r in from_csv(tmp_path / "two.csv", input="u", output="y", run="run").runs
    ] == ["warm", "cold"]


def test_missing_time_column_error_names_the_options_of_function_and_command():
    with pytest.raises(InputError, match=r"time=COLUMN.*dt_s=SECONDS"):
        from_frame(table()[["u", "y"]], input="u", output="y")


def test_run_that_starts_off_equilibrium_is_reported():
    # a lag of 20 s under a constant input, starting 50 units below equilibrium, then one step of
    # the input
    t = np.arange(0.0, 400.0)
    u = np.where(t < 200, 1.0, 0.0)
    y = np.where(t < 200, 10 - 50 * np.exp(-t / 20), 10 * np.exp(-(t - 200) / 20))
    y = y + np.random.default_rng(0).normal(0, 0.1, len(t))
    data = IOData.from_arrays(u, y, 1.0)
    assert "initial=estimated" in fit(data, "P1", **PLAIN).identified.sentence
    assert (
        "initial=estimated"
        not in fit(
            data, "P1", initial="estimated", noise="white", baseline="none"
        ).identified.sentence
    )
    settled = IOData.from_arrays(u[200 - 20 :], y[200 - 20 :], 1.0)
    assert "initial=estimated" not in fit(settled, "P1", **PLAIN).identified.sentence


def test_matlab_excel_and_labview_tables_give_the_same_record(tmp_path):
    """Columns separated by spaces, German Excel with its encoding, and TDMS hold the same samples
    as plain CSV."""
    frame = table().rename(columns={"y": "y_°C"})
    plain = from_frame(frame, input="u", output="y_°C")
    matlab = tmp_path / "m.dat"
    excel = tmp_path / "e.csv"
    labview = tmp_path / "l.tdms"
    matlab.write_text(frame.to_string(index=False, float_format="%.17g"), encoding="utf-8")
    frame.to_csv(excel, sep=";", decimal=",", index=False, encoding="cp1252")
    with TdmsWriter(labview) as writer:
        writer.write_segment(
            [ChannelObject("Messung", name, frame[name].to_numpy()) for name in frame]
        )
    for path in (matlab, excel, labview):
        read = from_csv(path, input="u", output="y_°C")
        # pandas < 3.1 may differ in the last digit
        assert np.allclose(read.runs[0].y, plain.runs[0].y, rtol=4e-16, atol=0)
        assert read.dt_s == pytest.approx(plain.dt_s)
    for path in (matlab, labview):
        with pytest.raises(InputError, match="did you mean 'y_°C'"):
            from_csv(path, input="u", output="y_C")


def single_step(tau_s: float, noise: float = 0.2) -> IOData:
    """Response of one lag to a step of 60 at 4 s, by its closed form; 30 s at 75 Hz."""
    t = np.arange(2250) / 75
    y = 20 + 60 * (1 - np.exp(-np.clip(t - 4, 0, None) / tau_s))
    y = y + noise * np.random.default_rng(3).normal(size=len(t))
    return IOData.from_arrays(20 + 60.0 * (t > 4), y, 1 / 75, hold="zoh")


@pytest.mark.study
def test_lag_between_the_trial_lags_is_not_mistaken_for_a_leading_output():
    """The trial lags are a factor of 2.6 apart; the 25 lags here lie between them. With exchanged
    columns all records are rejected."""
    for tau in np.geomspace(0.3, 6, 25):
        data = single_step(float(tau))
        fit(data, "P1", intervals="quadratic", **PLAIN)
        run = data.runs[0]
        with pytest.raises(InputError, match=r"before the input.*closed loop.*check=False"):
            fit(IOData.from_arrays(run.y, run.u, 1 / 75), "P1", intervals="quadratic")


def record_with_gaps(n: int = 600) -> IOData:
    """One lag of 20 s. The input changes every 30 s, and ten rows are lost in each response."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([0.0, 10.0], n // 30), 30)
    y = simulate(
        process("P1").rational({"Kp": 1.0, "Tp1": 20.0}), u, 1.0, "zoh"
    ) + 0.05 * rng.normal(size=n)
    frame = pd.DataFrame({"time_s": np.arange(n) * 1.0, "u": u, "y": y})
    lost = [k + i for k in np.flatnonzero(np.diff(u)) for i in range(4, 14)]
    return from_frame(frame.drop(index=lost), input="u", output="y", hold="zoh")


@pytest.mark.e2e
def test_segment_after_lost_rows_has_its_own_initial_state():
    """With equilibrium at the start of each segment the gain is 0.8 and the lag 16 s, with a
    stated uncertainty of one percent."""
    result = fit(record_with_gaps(), "P1", **PLAIN)
    assert sum(result.problem.has_free_state) == len(result.problem.segments) - 1
    for name, true_value in (("Kp", 1.0), ("Tp1", 20.0)):
        assert result.estimates[name].value == pytest.approx(
            true_value, abs=4 * result.estimates[name].u
        )
    assert result.estimates["Tp1"].u < 0.2
    # the state of each held-out segment is estimated, too, from samples that are not scored
    shared = compare(record_with_gaps(), ["P1"], **PLAIN)
    assert shared.table["held_out_rms"].iloc[0] == pytest.approx(0.05, rel=0.2)


def test_dead_time_carries_the_input_across_a_gap():
    """The change of the input, its last sample before the gap, leaves the dead time after the
    gap."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([0.0, 10.0], 30), 50)
    plant = process("P1D").rational({"Kp": 1.0, "Tp1": 20.0, "Td": 6.3})
    y = simulate(plant, u, 1.0, "zoh") + 0.05 * rng.normal(size=len(u))
    u[np.flatnonzero(np.diff(u)) + 2] = np.nan
    result = fit(IOData.from_arrays(u, y, 1.0, hold="zoh"), "P1D", **PLAIN)
    for name, true_value in (("Kp", 1.0), ("Tp1", 20.0), ("Td", 6.3)):
        assert result.estimates[name].value == pytest.approx(
            true_value, abs=4 * result.estimates[name].u
        )


@pytest.mark.e2e
def test_offset_per_run_is_shared_by_all_segments_of_the_run():
    result = fit(
        record_with_gaps().merge(record_with_gaps()), process("P1", offset="per run"), **PLAIN
    )
    assert len({offset.start for offset, _ in result.problem.offset_and_state_slices}) == 2
    assert result.estimates["Kp"].value == pytest.approx(1.0, abs=4 * result.estimates["Kp"].u)


def test_held_out_run_is_simulated_from_its_own_initial_state():
    """Two runs begin at the same clock time, one above its equilibrium and one below."""
    runs = []
    for seed, offset in ((0, 6.0), (1, -8.0)):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([0.0, 1.0], 14), 30)
        y = simulate(process("P1").rational({"Kp": 3.0, "Tp1": 10.0}), u, 0.5, "zoh")
        y = y + offset * np.exp(-0.05 * np.arange(len(u))) + 0.05 * rng.normal(size=len(u))
        runs.append(IOData.from_arrays(u, y, 0.5, hold="zoh"))
    comparison = compare(
        runs[0].merge(runs[1]), ["P1"], initial="estimated", noise="white", baseline="none"
    )
    # the noise, from 400 samples
    assert comparison.table["held_out_rms"].iloc[0] == pytest.approx(0.05, rel=0.2)


def test_columns_may_be_named_without_their_unit(tmp_path):
    t = np.arange(60.0)
    bath = np.where(t % 20 < 10, 20.0, 60.0)
    frame = pd.DataFrame({"time_s": t, "bath_degC": bath, "T1 (°C)": bath + t / 100})
    path = tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    for data in (
        from_csv(path, input="bath", output="T1"),
        from_frame(frame, input="bath", output=["T1"]),
    ):
        assert (data.input_names, data.output_names) == (("bath_degC",), ("T1 (°C)",))
        assert data.select(output="T1").n_samples == 60
    with pytest.raises(InputError, match="output column 'T2' is missing"):
        from_frame(frame, input="bath", output="T2")


def test_a_held_input_at_uneven_times_keeps_the_instants_of_its_steps() -> None:
    """The input changes at rows every 1 to 6 s; lag 60 s, dead time 8 s."""
    rng = np.random.default_rng(3)
    times = np.round(np.cumsum(rng.uniform(1.0, 6.0, 1100)), 1)
    levels = rng.choice([0.0, 30.0, 100.0], 40)[(times // 100).astype(int)]
    fine = 0.1 * np.arange(round(times[-1] / 0.1) + 1)
    held = levels[np.clip(np.searchsorted(times, fine - 8.0, side="right") - 1, 0, None)]
    share = 1 - np.exp(-0.1 / 60.0)
    y = lfilter([0.0, share], [1.0, share - 1], held - held[0]) + held[0]
    output = np.interp(times, fine, y) + 0.1 * rng.standard_normal(len(times))
    frame = pd.DataFrame({"time_s": times, "u": levels, "T_degC": output})
    data = from_frame(frame, input="u", output="T_degC", resample_s=3.5)
    assert data.hold == "zoh"
    model = fit(data, "P1D").identified
    assert abs(model.estimates["Td"].value - 8.0) < 0.3
    assert abs(model.lag_s.value - 68.0) < 0.3


def test_runs_of_a_switched_and_of_a_constant_input_share_one_hold() -> None:
    rng = np.random.default_rng(3)
    switched = np.repeat(rng.choice([0.0, 1.0], 10), 10)
    moving = np.cumsum(rng.normal(size=100))
    frames = [
        pd.DataFrame({"time_s": 0.5 * np.arange(100), "u": u, "y": u, "run": name})
        for name, u in (("a", switched), ("b", moving), ("c", np.zeros(100)))
    ]
    options: Any = {"input": "u", "output": "y", "run": "run"}
    assert len(from_frame(pd.concat(frames), **options).runs) == 3
    assert from_frame(pd.concat(frames), **options, hold="zoh").hold == "zoh"


def test_a_held_out_run_of_constant_input_is_scored_from_another_level() -> None:
    data = record_with_gaps()
    held_out = IOData.from_arrays(np.zeros(60), 20 + np.exp(-0.1 * np.arange(60)), data.dt_s)
    named = replace(held_out, input_names=data.input_names, output_names=data.output_names)
    options: Any = {"initial": "level", "noise": "white", "baseline": "none"}
    comparison = compare(data, "P1", held_out=replace(named, hold=data.hold), **options)
    assert np.isfinite(comparison.best_row["held_out_rms"])


def test_a_shift_at_the_end_of_the_search_does_not_count_beside_other_inputs() -> None:
    """The best shift of the exchanged columns is the largest that is tried for a lag of 6 s."""
    for tau_s, is_at_end in ((6.0, True), (1.0, False)):
        run = single_step(tau_s).runs[0]
        exchanged = IOData.from_arrays(run.y, run.u, 1 / 75)
        problem = make_problem(exchanged, process("P1D"), "equilibrium")
        with pytest.raises(InputError, match="before the input"):
            check_causality(problem, "record")
        if is_at_end:
            check_causality(problem, "record", has_other_inputs=True)
        else:
            with pytest.raises(InputError, match="before the input"):
                check_causality(problem, "record", has_other_inputs=True)
