"""Touch log: the touched column is found, and differences from the stated order are reported.

Truth: patches heated on a half space, as sums of continuous point sources (Carslaw and Jaeger
1959, section 10.4), behind first-order lags; separate from the library's own patch model.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from scipy.special import erfc

from tcdyn.cli.app import app, run
from tcdyn.core.errors import InputError
from tcdyn.sensors.touch import AMBIGUOUS_SHARE, find_touches

# depth and z [mm], angle [deg] of the junctions of the thesis's disks
PLACES = {
    "a": (3.0, 4.765, 0.0),
    "b": (6.0, 4.765, 180.0),
    "c": (3.0, 2.0, 195.0),
    "d": (6.0, 2.0, 165.0),
    "e": (1.25, 4.765, 15.0),
    "f": (6.0, 7.53, 345.0),
}
COLUMNS = [f"slow_{c}" for c in PLACES]
RADIUS_MM, PATCH_MM = 38.1, 1.0
CONDUCTIVITY, DIFFUSIVITY = 41.0, 41.0 / (7850 * 470)  # [W/mK], [m2/s]
RATE_HZ, GAP_S, LAG_S, NOISE_K = 75.0, 12.0, 0.65, 0.12


def point_source(t: np.ndarray, distance_m: float) -> np.ndarray:
    """Rise from one watt that enters the surface at a point from t = 0 on [K]."""
    after = np.maximum(t, 1e-9)
    rise = erfc(distance_m / np.sqrt(4 * DIFFUSIVITY * after))
    return np.where(t > 0, rise / (2 * np.pi * CONDUCTIVITY * distance_m), 0.0)


def touch_log(order: str, rng: np.random.Generator, beside_mm: float) -> dict[str, np.ndarray]:
    """Readings of six junctions while an iron of about 7 W touches them for about 2 s each.

    ``beside_mm``: standard deviation of each coordinate of the place. The truth is in "start_s".
    """
    t = np.arange(0.0, 10.0 + GAP_S * len(order) + 10.0, 1 / RATE_HZ)
    starts = 10.0 + GAP_S * np.arange(len(order)) + rng.uniform(-1, 1, len(order))
    rises = {c: np.zeros(len(t)) for c in PLACES}
    for start, touched in zip(starts, order):
        duration = rng.uniform(1.5, 2.5)
        watts = rng.uniform(4.0, 10.0)
        _, z_mm, angle = PLACES[touched]
        centre = np.array([RADIUS_MM * np.deg2rad(angle), z_mm]) + rng.normal(0, beside_mm, 2)
        for c, (depth_mm, z, junction_angle) in PLACES.items():
            turn = RADIUS_MM * np.deg2rad(junction_angle) - centre[0]
            half_turn = np.pi * RADIUS_MM
            along = (turn + half_turn) % (2 * half_turn) - half_turn
            for phase in np.arange(6) * np.pi / 3:
                beside = along + PATCH_MM * np.cos(phase)
                across = z - centre[1] + PATCH_MM * np.sin(phase)
                distance_m = 1e-3 * float(np.linalg.norm([depth_mm, beside, across]))
                heating = point_source(t - start, distance_m)
                cooling = point_source(t - start - duration, distance_m)
                rises[c] += watts / 6 * (heating - cooling)
    out = {"time_s": t, "start_s": starts}
    for c, rise in rises.items():
        share = 1 - np.exp(-1 / (RATE_HZ * LAG_S * rng.uniform(0.85, 1.15)))
        lagged = lfilter([share], [1, share - 1], rise)
        out[f"slow_{c}"] = 21.0 + 0.003 * t + lagged + rng.normal(0, NOISE_K, len(t))
    return out


def found(log: dict[str, np.ndarray], order: str = "", columns: list[str] = COLUMNS) -> Any:
    """The touches of a log whose stated order is ``order``."""
    readings = np.column_stack([log[c] for c in columns])
    return find_touches(log["time_s"], readings, columns, order=[f"slow_{c}" for c in order])


def test_each_touch_is_found_with_its_column_and_time() -> None:
    log = touch_log("dbacfe", np.random.default_rng(1), 0.5)
    result = found(log, "dbacfe")
    assert [t.column for t in result.touches] == [f"slow_{c}" for c in "dbacfe"]
    assert result.findings == ()
    # heat reaches 6 mm within half a second, and the lag is 0.65 s
    delays = np.array([t.time_s for t in result.touches]) - log["start_s"]
    assert ((delays > -0.6) & (delays < 1.5)).all()
    assert result.summary().endswith("6 touches, 6 as stated")


def test_interchanged_columns_are_named() -> None:
    log = touch_log("abcdef", np.random.default_rng(2), 0.5)
    log["slow_a"], log["slow_c"] = log["slow_c"], log["slow_a"]
    result = found(log, "abcdef")
    assert [f.code for f in result.findings] == ["touch.other"] * 2
    pairs = [(f.numbers["stated"], f.numbers["column"]) for f in result.findings]
    assert pairs == [("slow_a", "slow_c"), ("slow_c", "slow_a")]
    assert all(f.numbers["exchanged"] for f in result.findings)


def test_columns_shifted_by_one_are_not_called_interchanged() -> None:
    log = touch_log("abc", np.random.default_rng(3), 0.5)
    log["slow_a"], log["slow_b"], log["slow_c"] = log["slow_b"], log["slow_c"], log["slow_a"]
    result = found(log, "abc")
    others = [f for f in result.findings if f.code == "touch.other"]
    assert len(others) == 3
    assert not any(f.numbers["exchanged"] for f in others)


@pytest.mark.parametrize("reading", [21.0, np.nan])
def test_column_that_does_not_respond_is_named(reading: float) -> None:
    log = touch_log("abcdef", np.random.default_rng(4), 0.5)
    log["slow_e"] = np.full_like(log["slow_e"], reading)
    result = found(log, "abcdef")
    silent = [f for f in result.findings if f.code == "touch.silent"]
    assert [f.numbers["columns"] for f in silent] == [("slow_e",)]
    assert "slow_e" not in [t.column for t in result.touches]


def test_a_column_that_falls_when_it_is_touched_is_reported() -> None:
    """A thermocouple of reversed polarity falls as much as it should rise."""
    log = touch_log("abc", np.random.default_rng(4), 0.0)
    sound = found(log, "abc")
    assert not {f.code for f in sound.findings} & {"touch.fall"}
    start = log["slow_b"][0]
    reversed_b = {**log, "slow_b": 2 * start - log["slow_b"]}
    falls = [f for f in found(reversed_b, "abc").findings if f.code == "touch.fall"]
    assert [f.numbers["column"] for f in falls] == ["slow_b"]
    assert "polarity is reversed" in falls[0].sentence


def test_touch_between_two_sensors_is_unclear() -> None:
    log = touch_log("ab", np.random.default_rng(5), 0.5)
    rng = np.random.default_rng(6)
    columns = ["slow_a", "twin"]
    log["twin"] = 21.0 + 0.9 * (log["slow_a"] - 21.0) + rng.normal(0, NOISE_K, len(log["slow_a"]))
    result = found(log, columns=columns)
    assert result.findings[0].code == "touch.unclear"
    assert result.touches[0].second_share == pytest.approx(0.9, abs=0.05)


def test_noise_alone_is_no_touch() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(40_000) / RATE_HZ
    result = find_touches(t, 21.0 + rng.normal(0, 0.5, (len(t), 6)), COLUMNS)
    assert result.touches == ()
    assert [f.code for f in result.findings] == ["touch.silent"]


@pytest.mark.parametrize(
    ("columns", "changes", "message"),
    [
        (["slow_a"], {}, "two or more"),
        (COLUMNS, {"order": ["fast_a"]}, "fast_a is not among the columns"),
        (COLUMNS, {"touch_s": 0.01}, "at least two"),
    ],
)
def test_unusable_requests_are_refused(
    columns: list[str], changes: dict[str, Any], message: str
) -> None:
    t = np.arange(100) / RATE_HZ
    with pytest.raises(InputError, match=message):
        find_touches(t, np.zeros((100, len(columns))), columns, **changes)


@pytest.mark.e2e
def test_command_reports_touches_that_differ_from_the_stated_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = touch_log("ca", np.random.default_rng(8), 0.5)
    path = tmp_path / "touch.csv"
    frame = pd.DataFrame({"time_s": log["time_s"], **{f"{c}_degC": log[c] for c in COLUMNS}})
    frame.to_csv(path, index=False, float_format="%.4f")
    picture = tmp_path / "touch.png"
    words = ["sensor", "touch", str(path), "--column", "slow_*", "--order"]
    assert run(lambda: app([*words, "slow_c", "--order", "slow_a", "--picture", str(picture)])) == 0
    out = capsys.readouterr().out
    assert "2 touches, 2 as stated" in out
    assert picture.stat().st_size > 10_000
    assert run(lambda: app([*words, "slow_a", "--order", "slow_c", "--strict"])) == 1
    err = capsys.readouterr().err
    assert "slow_c_degC responded, stated was slow_a_degC" in err


@pytest.mark.long
@pytest.mark.study
@pytest.mark.parametrize(("beside_mm", "seed", "most_wrong"), [(1.0, 2026, 0.0), (2.0, 2027, 0.01)])
def test_wrong_columns_are_rare_or_unclear_beside_the_junctions(
    beside_mm: float, seed: int, most_wrong: float
) -> None:
    """``beside_mm``: standard deviation of each coordinate of the touched place."""
    rng = np.random.default_rng(seed)
    n_logs = 300
    wrong = unclear = 0
    for _ in range(n_logs):
        order = rng.permutation(list(PLACES))
        result = found(touch_log("".join(order), rng, beside_mm))
        assert len(result.touches) == len(order)
        for touch, c in zip(result.touches, order):
            is_unclear = touch.second_share > AMBIGUOUS_SHARE
            unclear += is_unclear
            wrong += touch.column != f"slow_{c}" and not is_unclear
    count = n_logs * len(PLACES)
    print(f"{beside_mm} mm beside, {count} touches: {wrong} wrong, {unclear} unclear")
    assert wrong <= most_wrong * count
    assert unclear < 0.1 * count
