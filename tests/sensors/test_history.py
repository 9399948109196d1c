"""The lag of one sensor against date: changes are noticed, shared uncertainty is no noise, and
input that cannot be used is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.chain import FlowLaw
from tcdyn.core.errors import InputError
from tcdyn.plots import draw
from tcdyn.rig.record import InputFile
from tcdyn.sensors import SensorFile, sensor_history, specified_sensor
from tcdyn.sensors.change import find_change
from tcdyn.sensors.history import FALSE_ALARM_RATE
from tcdyn.workflows import history_of_logs
from tests.cli.test_main_job import tcdyn as run_cli
from tests.sensors.history_study import Kind, judge, write_log

DAYS = 7.0 * np.arange(52)


def measured(
    lag_s: float, u_s: float, date: str = "", method: str = "noise", **fit: Any
) -> SensorFile:
    """A sensor file as a method writes it, of a log that began at ``date``."""
    sensor = specified_sensor("pipe", ["T1"], [(lag_s, u_s)], is_bare=True)
    reading = [{"start_time": date}]
    return sensor.model_copy(update={"method": method, "fit": fit, "reading": reading})


def yearly(change: float, u: float = 0.02, seed: int = 1, **fit: Any) -> list[SensorFile]:
    """Twelve monthly measurements of a sensor that changes by ``change`` from first to last."""
    rng = np.random.default_rng(seed)
    lags = 2 * (1 + change * np.arange(12) / 11) * np.exp(u * rng.standard_normal(12))
    dates = [f"2025-{month:02d}-10T09:00:00" for month in range(1, 13)]
    return [measured(lag, u * lag, date, **fit) for lag, date in zip(lags, dates)]


def test_without_a_spread_the_line_is_that_of_weighted_least_squares() -> None:
    rng = np.random.default_rng(3)
    u = rng.uniform(0.3, 0.6, 52)  # far above any spread that the residuals allow
    log_lag = 1e-3 * DAYS + 1e-3 * rng.standard_normal(52)
    found = find_change(DAYS, log_lag, u**2)
    slope = np.polyfit(DAYS, log_lag, 1, w=1 / u)[0]
    assert found.per_year.value == pytest.approx(365.25 * slope, rel=0.02)


def test_the_order_of_the_measurements_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    log_lag = rng.normal(0, 0.03, 52)
    order = rng.permutation(52)
    first = find_change(DAYS, log_lag, np.full(52, 4e-4))
    other = find_change(DAYS[order], log_lag[order], np.full(52, 4e-4))
    assert other.total.value == pytest.approx(first.total.value)
    assert other.p_value == first.p_value


def test_a_sensor_that_slows_is_noticed_and_a_steady_one_is_not() -> None:
    slower = sensor_history(yearly(0.2))
    (finding,) = slower.findings
    assert finding.code == "history.changed"
    assert slower.groups[0].change is not None
    assert slower.groups[0].change.total.contains(0.2)
    assert "slows" in finding.sentence
    assert not sensor_history(yearly(0.0)).findings
    assert "becomes faster" in sensor_history(yearly(-0.2)).findings[0].sentence


def test_two_measurements_of_one_hour_give_a_wide_interval() -> None:
    found = find_change(np.array([0.0, 0.04]), np.log([1.0, 1.1]), np.full(2, 1e-4))
    assert found.total.low95 < 0 < found.total.high95
    assert found.p_value > FALSE_ALARM_RATE
    assert np.isfinite(find_change(np.array([0.0, 1.0]), np.zeros(2), np.full(2, 1e6)).total.u)


def test_a_step_is_dated() -> None:
    rng = np.random.default_rng(5)
    log_lag = 0.1 * (DAYS > 180) + 0.02 * rng.standard_normal(52)
    found = find_change(DAYS, log_lag, np.full(52, 4e-4))
    assert found.p_value <= FALSE_ALARM_RATE
    assert found.step_probability > 0.9
    assert found.step_range_days[0] <= 180 <= found.step_range_days[1]
    assert found.step.contains(np.expm1(0.1))


def test_shared_uncertainty_is_no_noise_of_a_change() -> None:
    """The same lags, of which 20 % may be wrong in all alike: the change is as certain."""
    plain = yearly(0.2)
    shared = [
        measured(
            each.lag_s.value,
            float(np.hypot(each.lag_s.u, 0.4)),
            each.reading[0]["start_time"],
            tail_u_s=0.4,
        )
        for each in plain
    ]
    of_plain = sensor_history(plain).groups[0].change
    of_shared = sensor_history(shared).groups[0].change
    assert of_plain is not None
    assert of_shared is not None
    assert of_shared.total.u == pytest.approx(of_plain.total.u, rel=1e-6)
    assert "all share" in sensor_history(shared).summary()


def test_measurements_under_other_conditions_are_not_compared() -> None:
    in_water = [measured(1.0, 0.02, f"2025-0{m}-01", "plunge") for m in (1, 2, 3)]
    for each in in_water:
        each.fit.update({"medium": "water", "speed_m_s": 0.4})
    law = FlowLaw(at=2.0, exponent=0.5, exponent_u=0.1, inner_share=0.2, inner_share_u=0.1)
    of_flow = [measured(3.0, 0.02, f"2025-0{m}-01", "pair") for m in (4, 5)]
    of_flow = [each.model_copy(update={"law": law}) for each in of_flow]
    one = [measured(9.0, 0.02, "2025-08-01", "current")]
    history = sensor_history([*in_water, *of_flow, *one])
    assert [group.name for group in history.groups] == [
        "plunge in water at 0.4 m/s",
        "pair at flow = 2",
        "current",
    ]
    assert [finding.code for finding in history.findings] == ["history.groups"]
    assert history.groups[2].change is None
    assert "not compared" in history.summary()


def test_of_several_dips_the_mean_is_used() -> None:
    mean = {"value": 1.9, "u": 0.05, "low95": 1.8, "high95": 2.0}
    dips = [measured(2.0, 0.3, date, mean_lag_s=mean) for date in ("2025-01-01", "2025-06-01")]
    assert sensor_history(dips).measurements[0].lag_s.u == 0.05


@pytest.mark.parametrize(
    ("sensors", "options", "text"),
    [
        ([], {}, "0 measurements"),
        ([measured(1, 0.1, "2025-01-01")], {}, "1 measurements"),
        ([measured(1, 0.1)] * 2, {}, "have no date.*give dates"),
        ([measured(1, 0.1, "2025-01-01")] * 2, {}, "have the date 2025-01-01"),
        ([measured(1, 0.1)] * 2, {"dates": ["2025-01-01"]}, "given 1 times for 2"),
        ([measured(1, 0.1)] * 2, {"dates": ["May", "June"]}, "dates is 'May'"),
        (
            [measured(1, 0.1, "2025-01-01"), measured(1, 0.1, method="stated")],
            {},
            "stated, not measured",
        ),
        ([measured(1, 0.1, "2025-01-01")] * 2, {"column": "T2"}, "T2"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    sensors: list[SensorFile], options: dict[str, Any], text: str
) -> None:
    with pytest.raises(InputError, match=text):
        sensor_history(sensors, **options)


def test_files_of_other_columns_and_of_several_are_refused() -> None:
    first = measured(1, 0.1, "2025-01-01")
    other = specified_sensor("x", ["T2"], [(1, 0.1)]).model_copy(update={"method": "noise"})
    with pytest.raises(InputError, match=r"T2.*T1"):
        sensor_history([first, other])
    both = specified_sensor("x", ["T1", "T2"], [(1, 0.1)]).model_copy(update={"method": "pair"})
    with pytest.raises(InputError, match="columns T1, T2"):
        sensor_history([both, both], dates=["2025-01-01", "2025-02-01"])
    chosen = sensor_history([both, both], dates=["2025-01-01", "2025-02-01"], column="T2")
    assert chosen.column == "T2"


def test_one_log_that_is_given_twice_is_refused() -> None:
    source = [{"file": "a.csv", "sha256": "0" * 64}]
    inputs = [InputFile.model_validate(each) for each in source]
    sensor = measured(1, 0.1).model_copy(update={"inputs": inputs})
    twice = [sensor, sensor.model_copy(update={"sensor": "other"})]
    with pytest.raises(InputError, match="different measurements"):
        sensor_history(twice, files=["a", "b"], dates=["2025-01-01", "2025-02-01"])


def test_the_command_writes_table_result_and_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [each.write(tmp_path / f"{k:02d}.json") for k, each in enumerate(yearly(0.2))]
    outputs = {name: tmp_path / name for name in ("lag.png", "history.csv", "history.json")}
    command = ["sensor", "history", *files, "--picture", outputs["lag.png"]]
    assert run_cli(*command, "--out", outputs["history.csv"]) == 0
    printed = capsys.readouterr()
    assert "dates of the first row of each log" in printed.out
    assert "the sensor slows" in printed.err
    table = pd.read_csv(outputs["history.csv"])
    assert list(table.columns[:3]) == ["date", "lag_s", "lag_u_s"]
    assert len(table) == 12
    assert outputs["lag.png"].stat().st_size > 10_000
    assert run_cli("sensor", "history", tmp_path / "0*.json", "--out", outputs["history.json"]) == 0
    content = json.loads(outputs["history.json"].read_text())
    assert content["groups"][0]["measurements"] == 10
    assert run_cli(*command[:4], "--date", "2025-01-01") == 2
    assert "--date is given 1 times for 2" in capsys.readouterr().err
    assert run_cli(*command[:4], "--unit", "degF") == 2
    assert "--unit is given without --method" in capsys.readouterr().err
    assert run_cli(*command[:4], "--method", "noise", "--junction", "grounded") == 2
    assert "--junction with --method noise" in capsys.readouterr().err


def test_logs_are_measured_and_one_that_cannot_be_used_is_left_out(tmp_path: Path) -> None:
    dates = pd.to_datetime(["2025-01-01", "2025-07-01"])
    logs = [
        write_log(tmp_path / f"{k}.csv", date, lag_s, k)
        for k, (date, lag_s) in enumerate(zip(dates, (1.0, 1.5)))
    ]
    logs.append(tmp_path / "2.csv")
    logs[-1].write_text("time_s,T1_degC\n0,20\n1,20\n2,20\n")
    history = history_of_logs(logs, "noise", "T1")
    assert [each.file for each in history.measurements] == ["0.csv", "1.csv"]
    assert [f"{each.date:%Y-%m-%d}" for each in history.measurements] == [
        "2025-01-01",
        "2025-07-01",
    ]
    assert history.findings[0].code == "history.failed"
    assert history.groups[0].change is not None
    assert history.groups[0].change.total.contains(0.5)
    with pytest.raises(InputError, match="1 logs"):
        history_of_logs(logs[:1], "noise", "T1")
    with pytest.raises(InputError, match="given 1 times for 2 logs"):
        history_of_logs(logs[:2], "noise", "T1", dates=["2025-01-01"])


def test_the_picture_has_bars_and_a_line_for_each_group() -> None:
    files = yearly(0.2)
    axes = draw(
        sensor_history([*files[:6], *(f.model_copy(update={"method": "pair"}) for f in files[6:])])
    )
    assert len(axes.containers) == 2
    assert axes.get_ylabel() == "lag of T1 [s]"


@pytest.mark.e2e
def test_few_false_alarms_and_intervals_that_hold() -> None:
    """120 steady histories: of a rate of 5 %, more than 14 alarms have a probability of 0.2 %."""
    steady = judge(Kind("steady", 8, irregular=True), 120, 11)
    slope = judge(Kind("slope", 8, irregular=True, slope=0.1), 60, 12)
    assert steady[:, 0].sum() <= 14
    assert min(steady[:, 1].mean(), slope[:, 1].mean()) > 0.87
