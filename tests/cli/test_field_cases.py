"""Files as loggers and users write them, with the command that a user would type.

Each case stands for a class of fault that was met in a file from the field. The records are closed
forms or single steps of a difference equation, made here. The classes themselves have their tests
in the folder of their package; these commands show that a user gets there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tcdyn.core import Array
from tests.cli.test_main_job import tcdyn

pytestmark = pytest.mark.e2e

Lines = list[str]


def table(header: str, *columns: Any, separator: str = ",") -> Lines:
    """The lines of a text table."""
    return [header, *(separator.join(map(str, row)) for row in zip(*columns))]


def stepped(
    rows: int, dt_s: float, taus_s: tuple[float, ...], shares: tuple[float, ...] = (1.0,)
) -> tuple[Array, list[str]]:
    """Times and readings of a step by 63 K after a tenth of the rows, by parallel lags."""
    time_s = dt_s * np.arange(rows)
    since = np.maximum(time_s - dt_s * (rows // 10), 0.0)
    response = sum(share * (1 - np.exp(-since / tau)) for tau, share in zip(taus_s, shares))
    noise = np.random.default_rng(7).normal(0, 0.02, rows)
    return time_s, [f"{reading:.3f}" for reading in 21 + 63 * response + noise]


def heated(
    rows: int = 1200, dt_s: float = 0.5, gain: float = 1.5, tau_s: float = 18.0, start: float = 0.0
) -> tuple[Array, Array, Array]:
    """Time, heater and temperature of a plant of one lag; ``start`` is its distance from rest."""
    rng = np.random.default_rng(3)
    heater = np.repeat(rng.choice([30.0, 60.0], rows // 50 + 1), 50)[:rows]
    y = np.empty(rows)
    y[0] = gain * heater[0] + start
    keep = np.exp(-dt_s / tau_s)
    for k in range(1, rows):
        y[k] = keep * y[k - 1] + (1 - keep) * gain * heater[k - 1]
    return dt_s * np.arange(rows), heater, (y + rng.normal(0, 0.2, rows)).round(3)


def kiln(rows: int = 1200) -> tuple[Array, Array, Array]:
    """Time, gas [degC] and readings of a sensor of 25 s, rows every second."""
    time_s = np.arange(rows, dtype=float)
    gas = 790 + 50 * np.sin(2 * np.pi * time_s / 400) + 10 * np.tanh((time_s - 600) / 20)
    y = np.empty(rows)
    y[0] = gas[0] - 50 * 2 * np.pi / 400 * 25  # lags behind from the start
    keep = np.exp(-1 / 25)
    for k in range(1, rows):
        y[k] = keep * y[k - 1] + (1 - keep) * 0.5 * (gas[k] + gas[k - 1])
    return time_s, gas, (y + np.random.default_rng(5).normal(0, 0.3, rows)).round(2)


def stamps(times_s: Array, form: str, start: str = "2021-11-26 10:00:00") -> list[str]:
    """Clock times in a form of ``strftime``; %f has three digits."""
    clock = pd.Timestamp(start) + pd.to_timedelta(times_s, unit="s")
    milliseconds = [f"{when.microsecond // 1000:03d}" for when in clock]
    return [when.strftime(form.replace("%f", digits)) for when, digits in zip(clock, milliseconds)]


def in_stamps(form: str, start: str = "2021-11-26 10:00:00") -> Lines:
    """A dip of 2 s with clock times."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    return table("Timestamp,T1 (°C)", stamps(time_s, form, start), reading)


def two_paths() -> Lines:
    """A sensor with a slow second heat path: 0.95 of the step in 2 s, 0.05 in 20 s."""
    time_s, reading = stepped(1200, 0.1, (2.0, 20.0), (0.95, 0.05))
    return table("time_s,T1_degC", time_s.round(1), reading)


def in_minutes() -> Lines:
    """A dip of 120 s whose header spells the unit of time."""
    time_s, reading = stepped(1200, 1.0, (120.0,))
    return table("Time (minutes),T1_degC", (time_s / 60).round(5), reading)


def in_a_row_of_units() -> Lines:
    """A dip of 2 s with the units below the header."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    return ["Time,T1", "min,degC", *table("", (time_s / 60).round(6), reading)[1:]]


def slow_sensor() -> Lines:
    """A dip of 900 s."""
    time_s, reading = stepped(1500, 5.0, (900.0,))
    return table("time_s,T1_degC", time_s, reading)


def whole_seconds() -> Lines:
    """Rows every 0.1 s on a clock of whole seconds, a dip of 1 s."""
    time_s, reading = stepped(200, 0.1, (1.0,))
    return table("Time,T1_degC", stamps(np.floor(time_s + 1e-9), "%H:%M:%S"), reading)


def quoted() -> Lines:
    """A header with commas inside quotes, below a title."""
    time_s, reading = stepped(900, 1.0, (18.0,))
    rows = table(
        '"#","Date Time, GMT+02:00","Temp, °C (LGR S/N: 2043)"',
        range(1, len(time_s) + 1),
        stamps(time_s, "%m/%d/%y %I:%M:%S %p"),
        reading,
    )
    return ['"Plot Title: kiln"', *rows]


def thousands() -> Lines:
    """Readings such as 1.013,03 in a file with semicolons."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    continental = [
        f"{900 + float(value):,.2f}".translate(str.maketrans(",.", ".,")) for value in reading
    ]
    times = [f"{value:.1f}".replace(".", ",") for value in time_s]
    return table("Zeit [s];T1", times, continental, separator=";")


def plant(header: str, scale: float = 1.0) -> Lines:
    """A plant of 18 s; the unit of time is in the header."""
    time_s, heater, y = heated()
    return table(header, scale * time_s, heater, y)


def plant_with_a_gap() -> Lines:
    """A plant whose logger stopped overnight."""
    time_s, heater, y = heated()
    later_s = np.where(np.arange(len(time_s)) < 600, time_s, time_s + 86_400)
    clock = pd.Timestamp("2021-11-26 10:00:00") + pd.to_timedelta(later_s, unit="s")
    return table("time,heater,T1", clock, heater, y)


def plant_off_equilibrium() -> Lines:
    """A plant that starts 60 K from rest."""
    return table("time_s,heater,T1", *heated(start=60.0))


def clipped_plant() -> Lines:
    """A plant whose logger ends at 75."""
    time_s, heater, y = heated()
    return table("time_s,heater,T1", time_s, heater, np.minimum(y, 75.0))


def slow_output() -> Lines:
    """A plant whose temperature is repeated in ten rows."""
    time_s, heater, y = heated(rows=3000, dt_s=0.1, tau_s=6.0)
    row = np.arange(len(y))
    return table("time_s,heater,T1", time_s.round(1), heater, y[row // 10 * 10])


def closed_loop() -> Lines:
    """A constant set point, a PI controller and disturbances: the input answers the output."""
    rng = np.random.default_rng(2)
    rows = 3000
    y = np.full(rows, 60.0)
    heater = np.full(rows, 20.0)
    integral = 20.0
    state = 60.0
    disturbance = 0.0
    for k in range(1, rows):
        disturbance = 0.98 * disturbance + rng.normal(0, 0.2)
        state += (20 + 2 * heater[max(k - 6, 0)] - state) / 60
        y[k] = state + disturbance
        error = 60.0 - y[k]
        integral += 0.4 * error / 60
        heater[k] = 0.4 * error + integral
    return table("time_s,heater,T1", np.arange(rows, dtype=float), heater.round(4), y.round(4))


def integrator() -> Lines:
    """A plant that integrates: 0.01 K/s for each unit."""
    rng = np.random.default_rng(4)
    rows = 800
    heater = np.repeat(rng.choice([0.0, 50.0], rows // 60 + 1), 60)[:rows]
    y = 20 + 0.01 * np.concatenate([[0.0], np.cumsum(heater - 25)[:-1]])
    y = y + rng.normal(0, 0.02, rows)
    return table("time_s,heater,T1", np.arange(rows, dtype=float), heater, y.round(4))


def named_twice() -> Lines:
    """An output whose name stands twice."""
    time_s, heater, y = heated()
    return table("time_s,heater,T1,T1", time_s, heater, y, y + 5)


def kiln_with(change: Callable[[Array], Any]) -> Lines:
    """The kiln's log after a change of its readings."""
    time_s, _, y = kiln()
    return table("Time [s],TC1 (°C)", time_s, change(y))


def often_zero(y: Array) -> Array:
    """Three of ten readings are 0."""
    return np.where(np.random.default_rng(1).random(len(y)) < 0.3, 0.0, y)


def often_open(y: Array) -> Array:
    """Each second reading is 2300 for 200 s."""
    row = np.arange(len(y))
    return np.where((row >= 500) & (row < 700) & (row % 2 == 0), 2300.0, y)


def one_overload(y: Array) -> list[str]:
    """One cell is an overload code."""
    return ["9.9E37" if k == 700 else str(value) for k, value in enumerate(y)]


def kiln_with_text() -> Lines:
    """Date, comment, and a channel that is not connected."""
    time_s, _, y = kiln()
    date = ["26.11.2021"] * len(y)
    clock = stamps(time_s, "%H:%M:%S")
    comment = ["door open" if k == 30 else "" for k in range(len(y))]
    return table("Date,Time,TC1 (°C),Comment,TC8", date, clock, y, comment, ["OVLD"] * len(y))


def two_days() -> Lines:
    """A kiln on one day, and the room a day later."""
    time_s, _, y = kiln(600)
    room = 20 + 0.001 * time_s + np.random.default_rng(2).normal(0, 0.3, 600)
    times = stamps(np.concatenate([time_s, time_s + 86_400]), "%Y-%m-%d %H:%M:%S")
    return table("Time,TC1 (°C)", times, [*y, *room.round(2)])


def quarter_hours() -> Lines:
    """Rows every 15 min, a step, and an hour that a change of the clock doubles."""
    local = pd.date_range("2018-10-27 22:00", periods=96, freq="15min", tz="UTC")
    clock = local.tz_convert("Europe/Berlin").strftime("%Y-%m-%d %H:%M:%S")
    rows = sorted(zip(clock, np.where(np.arange(96) < 50, 20.0, 35.0) + 0.01 * np.arange(96)))
    return table("Time,TC1 (°C)", *zip(*rows))


def pair_held() -> Lines:
    """Sensors of 0.2 and 0.8 s; the second has a new value in each fifth row."""
    rng = np.random.default_rng(9)
    rows = 3000
    window = np.exp(-np.arange(200) / 25)
    fluid = 530 + np.convolve(rng.normal(0, 8, rows), window / np.sqrt(window @ window))[:rows]
    readings = []
    for tau in (0.2, 0.8):
        y = np.empty(rows)
        y[0] = fluid[0]
        keep = np.exp(-0.02 / tau)
        for k in range(1, rows):
            y[k] = keep * y[k - 1] + (1 - keep) * 0.5 * (fluid[k] + fluid[k - 1])
        readings.append((y + rng.normal(0, 0.02, rows)).round(2))
    held = readings[1][np.arange(rows) // 5 * 5]
    return table("time_s,fine,coarse", (0.02 * np.arange(rows)).round(3), readings[0], held)


def with_words(*words: str) -> Lines:
    """A dip of 2 s in which 12 readings are words, of an unlisted program."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    for k in range(12):
        reading[200 + 15 * k] = words[k % len(words)]
    return table("time_s,T1_degC", time_s.round(1), reading)


def open_at_first() -> Lines:
    """A dip of 2 s behind 60 rows in which the sensor was not connected."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    return table("time_s,T1_degC", time_s.round(1), [*["not connected"] * 20, *reading[20:]])


def with_flags() -> Lines:
    """A dip of 2 s in which 12 readings have a mark: another notation."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    for k in range(200, 212):
        reading[k] += "*"
    return table("time_s,T1_degC", time_s.round(1), reading)


def counted(name: str, start: int, per_second: float, size: int = 2**62) -> Lines:
    """A dip of 2 s on a counter of a few bits."""
    time_s, reading = stepped(400, 0.1, (2.0,))
    counter = (start + np.rint(per_second * time_s).astype(np.int64)) % size
    return table(f"{name},T1_degC", counter, reading)


def coarse_beside_fine() -> Lines:
    """A dip of 2 s with lost rows, a clock in steps of 2 s and a counter of milliseconds."""
    time_s, reading = stepped(1600, 0.025, (2.0,))
    rows = np.sort(np.random.default_rng(2).choice(1600, 500, replace=False))
    clock = stamps(time_s[rows] // 2 * 2, "%Y-%m-%d %H:%M:%S")
    counter = 5000 + np.rint(1000 * time_s[rows]).astype(int)
    return table("timestamp,device_ms,T1_degC", clock, counter, np.array(reading)[rows])


@dataclass(frozen=True)
class Case:
    """A file, a command, and what must come of it.

    Parameters
    ----------
    lines
        Makes the lines of the file.
    words
        The command with {log} for the file and {out} for the result.
    codes
        Exit codes that are right.
    values
        By path in the JSON result: the true value and the largest relative error.
    message
        Regular expression that the messages match.
    """

    lines: Callable[[], Lines]
    words: str
    codes: tuple[int, ...] = (0,)
    values: dict[str, tuple[float, float]] = field(default_factory=dict)
    message: str = ""


PLUNGE = "sensor plunge {log} --column T1 --out {out}"
IDENTIFY = "identify {log} -u heater -y T1 --out {out}"
P1_MODEL = IDENTIFY + " --model P1"
COMPENSATE = "compensate {log} --sensor {sensor} --out {csv}"
LAG = "fit.lag_s.value"

CASES = {
    "two heat paths": Case(
        two_paths, PLUNGE, (0, 1), {"times.T1_degC.t632_s.value": (2.157, 0.06)}
    ),
    "minutes in the header": Case(
        in_minutes, PLUNGE + " --time 'Time (minutes)'", values={LAG: (120.0, 0.01)}
    ),
    "row of units": Case(in_a_row_of_units, PLUNGE, values={LAG: (2.0, 0.01)}),
    "slow sensor": Case(slow_sensor, PLUNGE, values={LAG: (900.0, 0.01)}),
    "clock of whole seconds": Case(whole_seconds, PLUNGE, (0, 1), {LAG: (1.0, 0.06)}),
    "quoted header": Case(
        quoted, "sensor plunge {log} --column 'Temp*' --out {out}", (0, 1), {LAG: (18.0, 0.02)}
    ),
    "thousands": Case(
        thousands, PLUNGE + " --time 'Zeit [s]' --unit degC", values={LAG: (2.0, 0.01)}
    ),
    "milliseconds": Case(
        lambda: plant("Time [ms],heater,T1", 1000.0),
        IDENTIFY + " --time 'Time [ms]' --model P1",
        values={"estimates.Tp1.value": (18.0, 0.02)},
    ),
    "time without a unit": Case(
        lambda: plant("Time,heater,T1", 1000.0), IDENTIFY, (2,), message="time.unit"
    ),
    "a night without rows": Case(
        plant_with_a_gap, IDENTIFY, (0, 1), {"estimates.Tp1.value": (18.0, 0.03)}
    ),
    "start off equilibrium": Case(
        plant_off_equilibrium, P1_MODEL, (0, 1), {"estimates.Kp.value": (1.5, 0.01)}
    ),
    "clipped output": Case(clipped_plant, P1_MODEL, (0, 1), message="limit of its range|clipped"),
    "repeated output": Case(
        slow_output,
        P1_MODEL,
        values={"estimates.Tp1.value": (6.0, 0.02)},
        message="T1 has a new value in 10 % of the rows",
    ),
    "closed loop": Case(closed_loop, IDENTIFY, (1, 2), message="closed loop"),
    "integrator": Case(integrator, P1_MODEL, (0, 1), message="if the plant integrates"),
    "integrator, as the message says": Case(
        integrator,
        IDENTIFY + " --model P1I --baseline trend",
        (0, 1),
        {"estimates.Kp.value": (0.01, 0.001)},
    ),
    "named twice": Case(named_twice, IDENTIFY, (2,), message="stands twice"),
    "text beside the readings": Case(
        kiln_with_text, "compensate {log} --sensor {sensor} --out {csv}"
    ),
    "pair, held values": Case(
        pair_held,
        "sensor pair {log} --column fine --column coarse --bare --out {out}",
        values={"times.fine.t632_s.value": (0.2, 0.02), "times.coarse.t632_s.value": (0.8, 0.01)},
        message="coarse has a new value in 20 % of the rows",
    ),
    "stamps with slashes": Case(
        lambda: in_stamps("%Y/%m/%d %H:%M:%S.%f"), PLUNGE, values={LAG: (2.0, 0.01)}
    ),
    "stamps with an offset": Case(
        lambda: in_stamps("%Y-%m-%dT%H:%M:%S.%f+02:00"), PLUNGE, values={LAG: (2.0, 0.01)}
    ),
    "stamps with am and pm": Case(
        lambda: in_stamps("%m/%d/%Y %I:%M:%S.%f %p", "2015-05-18 11:59:50"),
        PLUNGE,
        values={LAG: (2.0, 0.01)},
    ),
    "stamps with names of months": Case(
        lambda: in_stamps("%d-%b-%Y %H:%M:%S.%f"), PLUNGE, values={LAG: (2.0, 0.01)}
    ),
    "one word for no reading": Case(
        lambda: with_words("nicht bereit"),
        PLUNGE,
        (0, 1),
        {LAG: (2.0, 0.06)},
        r"12 cell\(s\).*'nicht bereit' \(12\)",
    ),
    "three words for no reading": Case(
        lambda: with_words("unavailable", "Pt Created", "Err:502"),
        PLUNGE,
        (0, 1),
        {LAG: (2.0, 0.06)},
        r"'unavailable' \(4\), 'Pt Created' \(4\), 'Err:502' \(4\)",
    ),
    "words in the first rows": Case(
        open_at_first, PLUNGE, (0, 1), {LAG: (2.0, 0.06)}, r"'not connected' \(20\)"
    ),
    "readings with a mark": Case(
        with_flags, PLUNGE, (2,), message=r"row 202.*is no number \(12 of 400 cells\)"
    ),
    "a counter of 16 bits": Case(
        lambda: counted("t_ms", 60_000, 1000.0, 2**16), PLUNGE, (2,), message="add 65536"
    ),
    "a counter of 32 bits": Case(
        lambda: counted("micros", 4_294_000_000, 1e6, 2**32), PLUNGE, (2,), message="at 2.32"
    ),
    "a counter of microseconds": Case(
        lambda: counted("micros", 4000, 1e6), PLUNGE, values={LAG: (2.0, 0.01)}
    ),
    "a clock of 12 hours": Case(
        lambda: in_stamps("%Y-%m-%d %I:%M:%S.%f", "2021-11-26 23:59:50"),
        PLUNGE,
        (2,),
        message="clock of 12 hours without AM and PM",
    ),
    "a finer column beside": Case(
        coarse_beside_fine, PLUNGE, (2,), message="another column of time.*--time device_ms"
    ),
    "a finer column beside, as the message says": Case(
        coarse_beside_fine, PLUNGE + " --time device_ms", values={LAG: (2.0, 0.01)}
    ),
    "stamps as numbers": Case(
        lambda: in_stamps("%Y%m%d%H%M%S.%f"), PLUNGE, values={LAG: (2.0, 0.01)}
    ),
    "stamps without zeros": Case(
        lambda: in_stamps("%-d.%-m.%Y %-H:%-M:%S.%f", "2021-01-06 08:05:50"),
        PLUNGE,
        values={LAG: (2.0, 0.01)},
    ),
    "stamps with milliseconds after a colon": Case(
        lambda: in_stamps("%H:%M:%S:%f"), PLUNGE, values={LAG: (2.0, 0.01)}
    ),
}


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor of 25 s."""
    path = tmp_path_factory.mktemp("sensor") / "s.json"
    assert tcdyn("sensor", "new", "--tau-s", "25+-1", "--column", "TC*", "--out", path) == 0
    return path


def run(words: str, **files: Path) -> int:
    """The exit code of a command; quoted words stay together."""
    quoted_or_plain = re.findall(r"'([^']*)'|(\S+)", words)
    given = [(quoted or plain).format(**files) for quoted, plain in quoted_or_plain]
    return tcdyn(*given)


def value_at(content: Any, path: str) -> float:
    """A number of a JSON result; keys may hold dots."""
    if not path:
        return float(content)
    for key in content:
        if path == key or path.startswith(key + "."):
            return value_at(content[key], path[len(key) + 1 :])
    raise KeyError(f"{path} in {list(content)}")


@pytest.mark.parametrize("name", CASES)
def test_a_command_of_a_user(
    name: str, sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = CASES[name]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(case.lines()) + "\n", encoding="utf-8")
    out = tmp_path / "out.json"
    code = run(case.words, log=log, out=out, sensor=sensor, csv=tmp_path / "o.csv")
    printed = capsys.readouterr()
    assert code in case.codes, printed.err
    assert "Traceback" not in printed.err
    assert re.search(case.message, printed.out + printed.err), printed.err
    for path, (true, share) in case.values.items():
        estimate = value_at(json.loads(out.read_text(encoding="utf-8")), path)
        assert estimate == pytest.approx(true, rel=share), path


@pytest.mark.parametrize("change", [np.array, often_zero, often_open, one_overload])
def test_a_kiln_s_gas_lies_within_its_band(
    change: Callable[[Array], Any], sensor: Path, tmp_path: Path
) -> None:
    log = tmp_path / "log.csv"
    log.write_text("\n".join(kiln_with(change)) + "\n", encoding="utf-8")
    out = tmp_path / "o.csv"
    assert run(
        "compensate {log} --sensor {sensor} --out {out}", log=log, sensor=sensor, out=out
    ) in (0, 1)
    made = pd.read_csv(out, comment="#")
    gas = kiln()[1]
    temperature = made["TC1 (°C)"].to_numpy()
    band = made.filter(regex="_u_K$").iloc[:, 0].to_numpy()
    known = np.isfinite(temperature)
    assert known.mean() > 0.8
    assert np.mean(np.abs(temperature - gas)[known] < 2 * band[known]) > 0.9
    assert np.sqrt(np.mean((temperature - gas)[known] ** 2)) < 2.0


def test_a_day_without_rows_stays_a_day(sensor: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("\n".join(two_days()) + "\n", encoding="utf-8")
    out = tmp_path / "o.csv"
    assert (
        run("compensate {log} --sensor {sensor} --out {out}", log=log, sensor=sensor, out=out) == 0
    )
    made = pd.read_csv(out, comment="#")
    temperature = made["TC1 (°C)"].to_numpy()
    assert np.all(temperature[:600] > 700)
    assert np.all(np.abs(temperature[600:] - 20.3) < 5)


def test_rows_every_quarter_of_an_hour_are_slow(
    sensor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.csv"
    log.write_text("\n".join(quarter_hours()) + "\n", encoding="utf-8")
    assert run(COMPENSATE, log=log, sensor=sensor, csv=tmp_path / "o.csv") in (0, 1)
    assert "the interval of 900 s" in capsys.readouterr().err


def test_a_reading_a_minute_and_then_one_a_second_have_a_sound_u(
    sensor: Path, tmp_path: Path
) -> None:
    """The first reading had u = 0."""
    time_s = np.concatenate([np.arange(0, 600, 60), np.arange(600, 900)])
    rise = -60.0 * np.expm1(-np.maximum(time_s - 603.5, 0.0) / 25.0)
    noise = np.random.default_rng(2).normal(0, 0.03, len(time_s))
    log = tmp_path / "log.csv"
    log.write_text("\n".join(table("time_s,TC1_degC", time_s, 21 + rise + noise)))
    out = tmp_path / "o.csv"
    assert run(COMPENSATE, log=log, sensor=sensor, csv=out) in (0, 1)
    band = pd.read_csv(out, comment="#").filter(regex="_u_K$").iloc[:, 0]
    assert band.min() > 0.1 * band.median()
