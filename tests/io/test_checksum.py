"""Checksums of JSON files: their form must stay, or every file that exists counts as altered."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tcdyn.io.checksum import (
    CHECKSUM_KEY,
    checksum,
    checksum_findings,
    matches_checksum,
    with_checksum,
)

RECORDS = sorted((Path(__file__).parents[1] / "behaviour" / "data").glob("*.disk.json"))


def test_digest_of_a_small_object_stays() -> None:
    """SHA-256 of the text {"a":[1,2.5,null],"b":"\u00b0C"} in UTF-8, by ``sha256sum``."""
    content = {"b": "\u00b0C", "a": [1, 2.5, None]}
    assert checksum(content) == "a7f3587638e4eb202d67cb18e4290e3c6c6e0b016646a60da18f0a06f7b1bb05"


def test_there_are_stored_records() -> None:
    assert [path.name for path in RECORDS] == ["fast.disk.json", "slow.disk.json"]


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.name)
def test_stored_record_matches_its_checksum(path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    assert CHECKSUM_KEY in content
    assert matches_checksum(content)
    altered = {**content, "created": "1999-01-01"}
    assert [f.code for f in checksum_findings(altered, "x.json")] == ["file.altered"]


def test_arrays_are_lists_and_nan_is_null_before_the_checksum() -> None:
    content = with_checksum({"lag_s": np.array([0.5, np.nan])})
    assert content["lag_s"] == [0.5, None]
    assert content[CHECKSUM_KEY] == checksum({"lag_s": [0.5, None]})
