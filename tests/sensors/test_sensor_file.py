"""A sensor file and any table: units, stretches, unknown columns, and bands that hold the lag's
uncertainty."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import Chain
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding
from tcdyn.identification import IOData, fit, process
from tcdyn.io import read as files
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.static_line import StaticLine
from tcdyn.sensors import channels as channel_module
from tcdyn.sensors import compensation as engine
from tcdyn.sensors import read_sensor, segments, specified_sensor, step_times, write_sensor
from tcdyn.series import Context
from tcdyn.series.series import clock_of
from tcdyn.series.thermocouple_types import emf_mV
from tcdyn.series.units import uncertainty_column
from tcdyn.smoothing import smooth
from tcdyn.smoothing.process_noise import spectral_level
from tcdyn.workflows import compensate_table as pipeline
from tcdyn.workflows.compensate_table import compensate_table
from tcdyn.workflows.follow import follow
from tests.benchmarks.tables import run_compensate
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.sensor_world import lagged, logged, write, written

PROBE = specified_sensor("probe", ["T1"], [(1.5, 0.1)])


def held(
    table: pd.DataFrame, name: str, u: str, x: np.ndarray, skip: int = 5
) -> tuple[float, float]:
    """Error rms and how much of it the 95 % band holds."""
    away = (table[name].to_numpy() - x)[skip:-skip]
    return float(np.sqrt(np.mean(away**2))), float(
        np.mean(np.abs(away) < 1.96 * table[u].to_numpy()[skip:-skip])
    )


def test_a_file_says_what_was_stated_and_comes_back(tmp_path: Path) -> None:
    sensor = specified_sensor("s", ["T*", "gas"], [(0.2, 0.02), (1.5, 0.1)], delay_s=(0.05, 0.01))
    again = read_sensor(write_sensor(sensor, tmp_path / "s.sensor.json"))
    assert again == sensor
    assert again.chains[0] == Chain([1.5, 0.2], delay_s=0.05)
    lag = again.chain.channels["gas"].lag_s
    assert (lag.value, lag.u) == pytest.approx((1.75, np.sqrt(0.1**2 + 0.02**2 + 0.01**2)))
    assert again.lag_covariance_s2 == pytest.approx(
        np.full((2, 2), lag.u**2)
    )  # one sensor: one error for both columns
    assert again.split_u_s == pytest.approx(np.hypot(0.02, 0.01))
    assert not again.findings


def test_percent_times_of_one_lag_are_those_of_the_exponential() -> None:
    times = step_times(Chain(2.0), 0.1)
    for name, share in (("t50_s", 0.5), ("t632_s", 1 - np.exp(-1)), ("t90_s", 0.9)):
        assert times[name].value == pytest.approx(-2.0 * np.log(1 - share), rel=1e-4)
        assert times[name].u == pytest.approx(-0.1 * np.log(1 - share), rel=0.01)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "tcdyn.sensor/9"}, "a later version"),
        ({"columns": ["T2"]}, "columns"),
        ({"chain": {"structure": "P1", "channels": {}, "covariance": []}}, "channels"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_damaged_file_is_refused_by_its_key(
    tmp_path: Path, change: dict[str, object], said: str
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(PROBE.to_dict() | change), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_sensor(path)


@pytest.mark.study
def test_every_unit_gives_the_same_answer_in_its_own_unit_and_other_columns_stay(
    tmp_path: Path,
) -> None:
    t, x, y = logged((1.5,), 0.1, 1200, 0.1, 1)
    cold = 20 + t / 100
    log = write(
        tmp_path / "log.csv",
        **{
            "Time [ms]": np.round(1000 * t),
            "a_degC": y,
            "b [K]": y + 273.15,
            "c (°F)": 1.8 * y + 32,
            "d_mV": emf_mV(y, "K") - emf_mV(cold, "K"),
            "e": y,
            "cj": cold,
            "power_W": 3.0 * t,
        },
    )
    sensor = specified_sensor("all", ["a", "b", "c", "d", "e"], [(1.5, 0.05)], is_bare=True)
    done = compensate_table(log, [sensor], tmp_path / "out.csv", couple="K", cold_junction="cj")
    out = written(done.path)
    assert list(out) == [
        "Time [ms]",
        *("a_logged_degC", "a_degC", "a_u_K"),
        *("b_logged [K]", "b [K]", "b_u_K"),
        *("c_logged (°F)", "c (°F)", "c_u_degF"),
        *("d_logged_mV", "d_degC", "d_u_K"),
        *("e_logged", "e", "e_u_K"),
        "cj",
        "power_W",
    ]
    assert np.allclose(out["d_logged_mV"], emf_mV(y, "K") - emf_mV(cold, "K"), rtol=4e-16, atol=0)
    rms, share = held(out, "a_degC", "a_u_K", x)
    assert rms < 0.1 < 0.93 < share
    for same, u in (
        (out["b [K]"] - 273.15, "b_u_K"),
        ((out["c (°F)"] - 32) / 1.8, "c_u_degF"),
        (out["d_degC"], "d_u_K"),
    ):
        assert same.to_numpy() == pytest.approx(
            out["a_degC"].to_numpy(), abs=4e-3
        )  # rounded cells of the log and of the output
        # two digits of u are written
        assert out[u].median() == pytest.approx(
            out["a_u_K"].median() * (1.8 if "F" in u else 1), rel=0.03
        )
    assert np.allclose(
        out["power_W"], 3.0 * t, rtol=4e-16, atol=0
    )  # pandas < 3.1: one last place off
    codes = {f.code: f for f in done.findings}
    assert codes["sensor.carried"].numbers["columns"] == ("cj", "power_W")
    assert codes["sensor.unit_assumed"].subject == "e"
    with pytest.raises(InputError, match="compensated already"):
        compensate_table(done.path, [sensor], tmp_path / "again.csv")


def test_the_reference_junction_is_found_by_its_name_without_a_unit(tmp_path: Path) -> None:
    t, x, y = logged((1.5,), 0.1, 400, 0.1, 1)
    log = write(
        tmp_path / "log.csv",
        time_s=t,
        T_mV=emf_mV(y, "K") - emf_mV(20 + t / 100, "K"),
        CJ_degC=20 + t / 100,
    )
    sensor = specified_sensor("s", ["T"], [(1.5, 0.05)])
    out = written(
        compensate_table(log, [sensor], tmp_path / "out.csv", couple="K", cold_junction="CJ").path
    )
    assert held(out, "T_degC", "T_u_K", x)[0] < 0.3
    log = write(tmp_path / "log.csv", time_s=t, T_mV=y, CJ_degC=t, CJ_K=t)
    with pytest.raises(InputError, match="'CJ' may be 'CJ_degC' or 'CJ_K'"):
        compensate_table(log, [sensor], tmp_path / "out.csv", couple="K", cold_junction="CJ")


@pytest.mark.e2e
def test_a_clock_or_a_unit_that_contradicts_the_rest_is_told(tmp_path: Path) -> None:
    t, _, y = logged((1.5,), 0.1, 400, 0.1, 1)
    log = write(
        tmp_path / "log.csv", **{"Elapsed (ms)": np.round(t, 2), "T [F]": 1.8 * y + 32}
    )  # really seconds
    sensor = specified_sensor("s", ["T"], [(1.5, 0.05)])
    done = compensate_table(log, [sensor], tmp_path / "out.csv", unit="degC")
    said = {f.code: f.sentence for f in done.findings}
    assert (
        "lasts 0.0399 s, less than the lag of 1.5 s: is its time in another unit?"
        in said["sensor.brief"]
    )
    assert (
        "taken in degC, as requested, although its name states another unit"
        in said["sensor.unit_contradicted"]
    )
    log = write(tmp_path / "log.csv", time_s=t, T=1.8 * y + 32)
    assert compensate_table(log, [sensor], tmp_path / "out.csv", unit="F").findings == ()


@pytest.mark.study
def test_the_band_holds_the_lag_s_uncertainty() -> None:
    """16 sensors drawn from their stated lags, 1.5 +- 0.15 and 0.3 +- 0.03 s: the 95 % bands hold,
    pointwise.

    One lag is one error for all of a record: 16 of them scatter the share by 0.03.
    """
    shares, without = [], []
    rng = np.random.default_rng(5)
    sensor = specified_sensor("s", ["y"], [(1.5, 0.15), (0.3, 0.03)])
    known = {"lag_covariance": sensor.lag_covariance_s2, "split_u_s": sensor.split_u_s}
    for seed in range(16):
        taus = (1.5 + 0.15 * rng.standard_normal(), 0.3 + 0.03 * rng.standard_normal())
        _, x, y = logged(taus, 0.1, 300, 0.05, seed)
        for kept, more in ((shares, known), (without, {})):
            done = smooth(y, 0.1, sensor.chains, noise_sd=0.05, events_s=(10.0,), **more)  # type: ignore[arg-type]
            kept.append(np.mean(np.abs(done.temperature[:, 0] - x) < 1.96 * done.sd[:, 0]))
    assert np.mean(shares) > 0.88
    assert np.mean(without) < 0.6


@pytest.mark.study
def test_a_table_in_stretches_is_the_table_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    t, x, y = logged((0.5,), 0.05, 5000, 0.1, 2)
    log = write(tmp_path / "long.csv", time_s=np.round(t, 3), T1_degC=y, n=np.arange(len(t)))
    sensor = specified_sensor("s", ["T1"], [(0.5, 0.02)])
    whole = written(compensate_table(log, [sensor], tmp_path / "whole.csv").path)
    monkeypatch.setattr(segments, "SEGMENT_ROWS", 1000)
    monkeypatch.setattr(segments, "MARGIN_ROWS", 10)
    monkeypatch.setattr(segments, "FLOOR", 0.01)
    monkeypatch.setattr(channel_module, "MAX_VALUES", 1500)
    parts = written(compensate_table(log, [sensor], tmp_path / "parts.csv").path)
    assert np.array_equal(parts["n"], np.arange(len(t)))  # each row once
    away = np.abs(parts["T1_degC"] - whole["T1_degC"]) / whole["T1_u_K"]
    assert away.max() < 2.0  # noise level and intensity are each stretch's own
    assert (
        min(held(parts, "T1_degC", "T1_u_K", x)[1], held(whole, "T1_degC", "T1_u_K", x)[1]) > 0.92
    )
    parquet = compensate_table(log, [sensor], tmp_path / "parts.parquet").path
    assert pd.read_parquet(parquet)["T1_degC"].to_numpy() == pytest.approx(
        parts["T1_degC"].to_numpy(),
        abs=5.1e-4,  # the decimals of the CSV file
    )
    pq_log = tmp_path / "long.parquet"
    pd.read_csv(log).to_parquet(pq_log, row_group_size=700)
    monkeypatch.setattr(files, "BLOCK_BYTES", 1 << 16)  # read in other pieces: not a digit changes
    again = written(compensate_table(pq_log, [sensor], tmp_path / "again.csv").path)
    assert np.array_equal(again["T1_degC"], parts["T1_degC"])
    assert np.array_equal(again["T1_u_K"], parts["T1_u_K"])


def test_stretches_with_their_neighbours_give_what_the_whole_table_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one noise and one intensity, fast and slow: all rows as those of the table in memory.

    The tolerance is exp(-10), what margins leave of an error, times a standard deviation of 0.1 K.
    """
    monkeypatch.setattr(segments, "SEGMENT_ROWS", 1000)
    monkeypatch.setattr(segments, "MARGIN_ROWS", 10)
    monkeypatch.setattr(segments, "FLOOR", 1.0)  # noise variances per second cubed: 0.01 K2/s3
    monkeypatch.setattr(pipeline, "PROGRESS_ROWS", 1)
    t, _, y = logged((0.5,), 0.05, 9000, 0.1, 2)
    log = write(tmp_path / "long.csv", time_s=np.round(t, 3), T1_degC=y)
    for intensity in (10.0, 0.01):
        given = partial(smooth, noise_sd=0.1, intensity=intensity)

        def smooth_as_given(*positional: Any, given: Any = given, **more: Any) -> Any:
            return given(*positional, **{**more, **given.keywords})

        monkeypatch.setattr(engine, "smooth", smooth_as_given)
        told = []
        done = compensate_table(
            log,
            [specified_sensor("s", ["T1"], [(0.5, 0.02)], is_bare=True)],
            tmp_path / "out.parquet",  # without rounding
            progress=told.append,
        )
        assert len(told) >= 4
        whole = given(y, 0.05, Chain(0.5), lag_covariance=[[0.02**2]])
        out = pd.read_parquet(done.path)
        inside = slice(
            200, -200
        )  # where the table ends, what a trace may do is taken from the part that is there
        for name, one in (("T1_degC", whole.temperature), ("T1_u_K", whole.sd)):
            # margins of ten memories leave exp(-10) of an error of 0.1 K at their ends
            assert np.abs(out[name] - one[:, 0])[inside].max() < 5e-6
            assert np.abs(out[name] - one[:, 0]).max() < 1e-4


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(
    ("dt_s", "tau_s", "rows", "columns"),
    [(1.0, 8.0, 100, 1), (1e-4, 0.01, 4000, 3), (0.1, 1.0, 150, 40)],
)
def test_rates_rows_and_channels(
    tmp_path: Path, dt_s: float, tau_s: float, rows: int, columns: int
) -> None:
    made = [logged((tau_s,), dt_s, rows, 0.1, k) for k in range(columns)]
    log = write(
        tmp_path / "log.csv",
        t=np.round(made[0][0], 9),
        **{f"T{k}": y for k, (_, _, y) in enumerate(made)},
    )
    out = written(
        compensate_table(
            log, [specified_sensor("s", ["T*"], [(tau_s, 0.02 * tau_s)])], tmp_path / "out.csv"
        ).path
    )
    assert len(out) == rows
    shares = [held(out, f"T{k}", f"T{k}_u_K", x)[1] for k, (_, x, _) in enumerate(made)]
    assert np.mean(shares) > 0.9


@pytest.mark.e2e
def test_a_long_silence_and_lost_rows_are_bridged_or_parted(tmp_path: Path) -> None:
    t, x, y = logged((0.5,), 0.05, 4000, 0.05, 3)
    kept = ((t < 40) | (t > 120)) & (np.arange(len(t)) % 50 != 7)
    log = write(tmp_path / "gap.csv", time_s=np.round(t[kept], 3), T1_degC=y[kept])
    out = written(
        compensate_table(
            log, [specified_sensor("s", ["T1"], [(0.5, 0.02)])], tmp_path / "out.csv"
        ).path
    )
    assert len(out) == kept.sum()
    assert held(out, "T1_degC", "T1_u_K", x[kept])[1] > 0.92


@pytest.mark.parametrize("dt_s", [0.05, 2.5])
def test_the_interval_of_a_table_with_lost_rows_is_that_of_its_rows(dt_s: float) -> None:
    row = np.flatnonzero(np.arange(400) % 50 > 3)
    _, grid, (found,) = clock_of(7.0 + dt_s * row, Context("here"))
    assert grid.interval_s == pytest.approx(dt_s, rel=1e-12)
    assert (grid.index == row - row[0]).all()
    assert (found.code, found.numbers["places"]) == ("series.lost", 7)


def test_steps_that_do_not_add_up_put_each_row_where_its_time_is() -> None:
    t = np.concatenate([np.arange(300.0), 300.0 + 1.02 * np.arange(300)])
    _, clock, _ = clock_of(t, Context("here"))
    away = t - clock.even_s
    assert clock.interval_s == pytest.approx(t[-1] / 599)
    assert np.abs(away).max() <= 0.5 * clock.interval_s + 1e-9


class OnePiece:
    """A table that comes in one piece."""

    def __init__(self, time_s: Array) -> None:
        self.time_s = time_s

    def read_chunks(
        self, columns: Sequence[str]
    ) -> Iterator[tuple[Array, dict[str, Array], tuple[Finding, ...]]]:
        yield self.time_s, {name: np.zeros(len(self.time_s)) for name in columns}, ()


@pytest.mark.parametrize(
    ("lag_s", "silence_s", "parted"),
    [
        (0.5, 4.5, False),
        (0.5, 5.5, True),
        (2.0, 19.0, False),
        (2.0, 21.0, True),
        (0.1, 2.5, False),
        (0.1, 3.5, True),
    ],
)
def test_a_silence_parts_where_it_is_longer_than_ten_lags_and_sixty_rows(
    lag_s: float, silence_s: float, parted: bool
) -> None:
    t = 0.05 * np.arange(400.0)
    t[200:] += silence_s
    stretches = list(segments.read_segments(OnePiece(t), ["x"], lag_s))
    assert np.concatenate([s.time_s[s.keep] for s in stretches]) == pytest.approx(t)
    assert [len(s.time_s) for s in stretches] == ([200, 200] if parted else [400])


@pytest.mark.e2e
def test_a_clock_of_few_decimals_and_a_dead_column_are_told(tmp_path: Path) -> None:
    t, x, y = logged((1.5,), 0.1, 1000, 0.1, 4)
    log = write(
        tmp_path / "coarse.csv", time_s=np.floor(t), T1_degC=y, T2_degC=np.full(len(t), 20.0)
    )
    done = compensate_table(
        log, [specified_sensor("s", ["T1", "T2"], [(1.5, 0.1)])], tmp_path / "out.csv"
    )
    out = written(done.path)
    assert {"series.few_decimals", "sensor.left"} <= {f.code for f in done.findings}
    assert out["T2_degC"].isna().all()
    assert held(out, "T1_degC", "T1_u_K", x)[1] > 0.9


@pytest.mark.parametrize(
    "filter_", [Conditioning(4.0, 2), Conditioning(2.5, 3, "butterworth"), Conditioning(1.0, 1)]
)
def test_the_filter_that_identify_knew_is_that_of_the_sensor(
    filter_: Conditioning, tmp_path: Path
) -> None:
    u = np.repeat([0.0, 1.0, 0.0, 1.0], 150)
    y = Chain((0.8, 0.3), conditioning=filter_).response(u, 0.05, hold="zoh")
    y = np.ravel(y) + 1e-3 * np.random.default_rng(1).standard_normal(len(u))
    data = IOData.from_arrays(u, y, 0.05, hold="zoh", output_names=["T1_degC"])
    path = tmp_path / "m.identified.json"
    path.write_text(fit(data, process("P2", known=filter_)).identified.to_json(), encoding="utf-8")
    (chain,) = read_sensor(path).chains
    assert (chain.conditioning.poles, chain.conditioning.shape) == (filter_.poles, filter_.shape)
    assert chain.conditioning.cutoff_Hz == pytest.approx(filter_.cutoff_Hz)
    assert np.allclose(chain.taus_s, (0.8, 0.3), rtol=0.02)


@pytest.mark.study
def test_a_model_of_identify_is_a_sensor(tmp_path: Path) -> None:
    t, x, y = logged((1.5, 0.3), 0.1, 1500, 0.05, 5)
    found = fit(
        IOData.from_arrays(x, y, 0.1, input_names=["ref"], output_names=["T1_degC"]), "P2"
    ).identified
    path = tmp_path / "m.identified.json"
    path.write_text(found.to_json(), encoding="utf-8")
    sensor = read_sensor(path)
    assert sensor.method == "identify"
    assert abs(sensor.chains[0].lag_s - 1.8) < 3 * sensor.chain.channels["T1_degC"].lag_s.u < 0.1
    log = write(tmp_path / "log.csv", time_s=np.round(t, 3), T1_degC=y, ref=x)
    out = written(compensate_table(log, [sensor], tmp_path / "out.csv").path)
    assert held(out, "T1_degC", "T1_u_K", x)[1] > 0.9


@pytest.mark.e2e
def test_a_growing_table_is_followed(tmp_path: Path) -> None:
    t, x, y = logged((1.5,), 0.1, 1500, 0.1, 6)
    log = write(tmp_path / "grow.csv", **{"time": np.round(t, 3), "T1 [K]": y + 273.15, "other": t})
    run = follow(
        log,
        [PROBE],
        tmp_path / "live.csv",
        delay_s=15.0,
        idle_s=0.0,
        sleep=lambda _: None,
    )
    out = written(tmp_path / "live.csv")
    assert run.rows_written == len(out) == 1500
    assert list(out) == ["time", "T1_logged [K]", "T1 [K]", "T1_u_K", "other"]
    rms, share = held(out.assign(x=out["T1 [K]"] - 273.15), "x", "T1_u_K", x, 50)
    assert rms < 0.5 < 0.92 < share


@pytest.mark.long
@pytest.mark.e2e
def test_a_growing_table_in_other_units_gives_the_answers_of_one_in_degrees_celsius(
    tmp_path: Path,
) -> None:
    t, _, y = logged((1.5,), 0.1, 600, 0.1, 6)
    line = StaticLine(
        gain=1.02, offset=-3.0, covariance=((1e-8, 0.0), (0.0, 1e-4)), range_degC=(-50.0, 900.0)
    )
    cold = 20 + t / 100
    # an event is weighed in all channels together, so there are as many of them here
    plain = write(tmp_path / "plain.csv", time_s=np.round(t, 3), T1=y, b=y, c=y)
    other = write(
        tmp_path / "other.csv",
        **{
            "Time [ms]": np.round(1000 * t),
            "T1": 1.8 * y + 32,
            "b_K": y + 273.15,
            "c_mV": emf_mV(y, "K") - emf_mV(cold, "K"),
            "cj": cold,
        },
    )

    def answers(log: Path, names: list[str], **options: object) -> pd.DataFrame:
        sensor = specified_sensor("s", names, [(1.5, 0.1)], static=dict.fromkeys(names, line))
        out = log.with_suffix(".live.csv")
        state = {
            "options": options,
            "delay_s": 20.0,
            "idle_s": 0.0,
            "sleep": lambda _: None,
        }
        run = follow(log, [sensor], out, state=tmp_path / f"{log.stem}.json", **state)  # type: ignore[arg-type]
        assert not options or {f.code for f in run.findings} <= {"sensor.carried"}
        return written(out)

    alone = answers(plain, ["T1", "b", "c"])
    done = answers(other, ["T1", "b", "c"], unit={"T1": "degF"}, couple="K", cold_junction="cj")
    results = ["T1", "T1_u_degF", "b_logged_K", "b_K", "b_u_K", "c_logged_mV", "c_degC", "c_u_K"]
    assert list(done) == ["Time [ms]", "T1_logged", *results, "cj"]
    assert done["Time [ms]"].to_numpy() == pytest.approx(1000 * alone["time_s"].to_numpy())
    x, u = alone["T1"].to_numpy(), alone["T1_u_K"].to_numpy()
    for name, back, per_K in (
        ("T1", 1.8 * x + 32, 1.8),
        ("b_K", x + 273.15, 1.0),
        ("c_degC", x, 1.0),
    ):
        assert done[name].to_numpy() == pytest.approx(back, abs=1e-4), name
        assert done[
            uncertainty_column(name) if name != "T1" else "T1_u_degF"
        ].to_numpy() == pytest.approx(per_K * u, abs=1e-4)


def test_what_is_said_of_colour_is_true_without_a_filter() -> None:
    n = LoggerNoise(
        np.array([0.2]), np.array([0.1]), np.array([0.3]), Conditioning(5.0, 1), ((1.0, 0.1),)
    )
    assert "as by a lag of 0.032 s" in n.findings("T1")[0].sentence
    two = replace(n, shaping=Conditioning(4.0, 2)).findings("T1")[0].sentence
    assert "through the conditioning filter" in two


def test_waves_of_few_samples_are_no_spikes() -> None:
    t = np.arange(1000.0)
    wave = 2 * np.pi / 13 * t
    y = 500 + 3.8 * np.sin(wave) + 0.1 * np.random.default_rng(1).standard_normal(1000)
    y[500] += 20.0
    found = smooth(y, 1.0, Chain(5.0))
    assert not found.findings
    assert found.flags[500, 0]
    assert found.flags.astype(bool).mean() < 0.005


BAD = {
    "no such column": ({}, ["--column", "T7"], "T7"),
    "no time": ({}, ["--time", "seconds"], "seconds"),
    "backward time": ({"time_s": -1}, [], "runs backward"),
    "millivolts of no type": ({}, ["--unit", "mV"], "--couple"),
    "an unknown unit": ({}, ["--unit", "R"], "degC, K"),
    "a rig's option": ({}, ["--method", "noise-only"], "--method with --sensor"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed, options, said = BAD[case]
    t, _, y = logged((1.5,), 0.1, 200, 0.1, 7)
    columns = {"time_s": t, "T1_degC": y}
    log = write(
        tmp_path / "log.csv",
        **columns | {name: sign * columns[name] for name, sign in changed.items()},
    )
    sensor = write_sensor(PROBE, tmp_path / "p.sensor.json")
    out = tmp_path / "out.csv"
    assert run_cli("compensate", log, "--sensor", sensor, "--out", out, *options) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.replace("... compensating, from row 1\n", "").strip().count("\n") == 0
    assert not out.exists()


@pytest.mark.e2e
def test_the_commands_write_a_file_and_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t, x, y = logged((1.5,), 0.1, 600, 0.1, 8)
    log, probe = (
        write(tmp_path / "log.csv", time_s=np.round(t, 3), T1_degC=y),
        tmp_path / "p.sensor.json",
    )
    assert run_cli("sensor", "new", "--tau-s", "1.5+-0.1", "--column", "T1", "--out", probe) == 0
    assert (
        run_cli("compensate", log, "--sensor", probe, "--out", tmp_path / "out.csv", "--json") == 0
    )
    said = json.loads(capsys.readouterr().out.partition("sensor.json\n")[2])
    assert said["rows"] == 600
    assert held(written(tmp_path / "out.csv"), "T1_degC", "T1_u_K", x)[1] > 0.9
    assert (
        run_cli("sensor", "new", "--tau-s", "1.5", "--column", "T1", "--out", probe, "--overwrite")
        == 0
    )  # no uncertainty: a warning
    assert "without an uncertainty" in capsys.readouterr().err
    assert run_cli("sensor", "new", "--tau-s", "fast", "--column", "T1", "--out", probe) == 2
    assert run_cli("sensor", "show", probe) == 0
    assert run_cli("compensate", log, "--out", tmp_path / "o.csv") == 2


def test_a_long_swing_that_stands_in_one_line_of_the_spectrum_is_followed() -> None:
    """20 K at 0.015 Hz behind 1.5 s: all it does lies below where bends matter; the noise decides
    nothing."""
    t, levels = np.arange(0, 500, 0.1), []
    for seed in range(5):
        x = 100 + 20 * np.sin((t + seed) / 10.5)
        y = lagged(x, (1.5,), 0.1) + 0.1 * np.random.default_rng(seed).standard_normal(len(t))
        levels.append(spectral_level(y, 0.1, Chain(1.5), 0.01))
    assert max(levels) < 2 * min(
        levels
    )  # three of five were a million times less, and the swing was taken for none
    done = smooth(y, 0.1, 1.5)
    assert (
        np.sqrt(np.mean((done.temperature[:, 0] - x)[50:-50] ** 2)) < 0.1
    )  # the noise of a reading


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_million_rows_need_no_more_memory_than_three_hundred_thousand(
    tmp_path: Path, ending: str
) -> None:
    """All buffers are in use by then: 225 MB at 100,000 rows, 283 at 300,000, 277 at 600,000."""
    few = run_compensate(tmp_path, 300_000, 1, 75.0, ending)
    many = run_compensate(tmp_path, 1_000_000, 1, 75.0, ending)
    assert (few[0], many[0]) == (0, 0)
    assert many[2] < min(few[2] + 60, 450)  # MB
    out = tmp_path / f"out{ending}"
    assert len(pd.read_parquet(out) if ending == ".parquet" else written(out)) == 1_000_000


@pytest.mark.parametrize("is_parquet", [False, True])
def test_dates_and_times_are_not_listed_as_columns_without_a_sensor(
    tmp_path: Path, is_parquet: bool
) -> None:
    """A column called T may be a temperature."""
    t = np.arange(60)
    stamps = pd.Timestamp("2025-11-26 10:00:00") + pd.to_timedelta(t, unit="s")
    table = pd.DataFrame({"Datum": stamps.strftime("%d.%m.%Y"), "Zeit": stamps.strftime("%X")})
    if is_parquet:
        table = pd.DataFrame({"logged": stamps, "Zeit": t})
    table["Elapsed [ms]"] = 1000 * t
    table["T1_degC"] = 20 + 0.1 * np.sin(t)
    table["T"] = 21.0 + 0.01 * np.cos(t)
    table["power_W"] = 3.5
    log = tmp_path / ("log.parquet" if is_parquet else "log.csv")
    if is_parquet:
        table.to_parquet(log)
    else:
        table.to_csv(log, index=False, sep=";")
    sensor = specified_sensor("s", ["T1"], [(3.0, 0.1)])
    done = compensate_table(log, [sensor], tmp_path / "out.csv", time="Zeit")
    (carried,) = [f for f in done.findings if f.code == "sensor.carried"]
    assert carried.numbers["columns"] == ("T", "power_W")
