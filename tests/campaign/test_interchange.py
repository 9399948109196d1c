"""Two maps before and after an interchange of channels: the errors of the channels are
recovered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tcdyn.campaign import compare_maps
from tcdyn.core.errors import InputError

JUNCTIONS = {
    "fast": {"a": 151.0, "b": 139.0, "c": 147.0, "d": 136.0, "e": 158.0, "f": 136.5},
    "slow": {"a": 122.0, "b": 116.0, "c": 120.5, "d": 114.0, "e": 126.0, "f": 114.5},
}


def two_maps(rng: np.random.Generator, error_K: dict[str, float]) -> list[Any]:
    """Maps before and after slow_a and slow_c were interchanged, with 0.2 K repeatability each.

    ``error_K``: error of the channels with which slow_a and slow_c were logged before. The second
    test has 3 % more friction and an ambient that is 1.5 K warmer.
    """
    maps = []
    for test in range(2):
        readings: dict[str, dict[str, float | None]] = {}
        for disk, junctions in JUNCTIONS.items():
            readings[disk] = {}
            for c, level in junctions.items():
                scaled = level if test == 0 else 61.5 + 1.03 * (level - 60.0)
                readings[disk][c] = scaled + 0.2 * float(rng.normal())
        first, second = ("a", "c") if test == 0 else ("c", "a")
        readings["slow"]["a"] += error_K[first]
        readings["slow"]["c"] += error_K[second]
        maps.append(readings)
    return maps


@pytest.mark.parametrize("errors", [{"a": 0.0, "c": 0.0}, {"a": -1.3, "c": 1.6}])
def test_interval_of_the_channels_errors_covers_the_truth(errors: dict[str, float]) -> None:
    rng = np.random.default_rng(12)
    n = 600
    covered = 0
    errors_found = []
    for _ in range(n):
        result = compare_maps(*two_maps(rng, errors), ("slow_a", "slow_c"))
        covered += result.channels_K.contains(errors["a"] - errors["c"])
        errors_found.append(result.channels_K.value)
    # three standard deviations of a share of 95 % from 600 draws, and of their mean
    assert abs(covered / n - 0.95) < 3 * np.sqrt(0.95 * 0.05 / n)
    expected = pytest.approx(errors["a"] - errors["c"], abs=3 * np.std(errors_found) / n**0.5)
    assert np.mean(errors_found) == expected


def test_conclusion_names_the_channels_only_if_they_differ() -> None:
    rng = np.random.default_rng(5)
    kept = compare_maps(*two_maps(rng, {"a": 0.0, "c": 0.0}), ("slow_a", "slow_c"))
    changed = compare_maps(*two_maps(rng, {"a": -1.3, "c": 1.6}), ("slow_a", "slow_c"))
    assert (kept.is_channel_error, changed.is_channel_error) == (False, True)
    assert "no error of the channels" in kept.summary()
    assert changed.to_dict()["channels_K"]["value"] == pytest.approx(-2.9, abs=0.5)


@pytest.mark.parametrize(
    ("junctions", "message"),
    [
        (("slow_a", "slow_g"), "no temperature of slow_g"),
        (("slow_a", "slow_a"), "named twice"),
        (("slow_a", "fast_b"), "no temperature of fast_b"),
    ],
)
def test_unknown_junctions_are_refused(junctions: tuple[str, str], message: str) -> None:
    before, after = two_maps(np.random.default_rng(1), {"a": 0.0, "c": 0.0})
    after["fast"]["b"] = None  # left out
    with pytest.raises(InputError, match=message):
        compare_maps(before, after, junctions)


def test_too_few_other_junctions_are_refused() -> None:
    slow = {c: JUNCTIONS["slow"][c] for c in "abcde"}
    with pytest.raises(InputError, match="3 other junctions"):
        compare_maps({"slow": slow}, {"slow": slow}, ("slow_a", "slow_c"))
