"""Checksum of the content of a JSON file, stored in the file, to detect later changes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import jsonable

SEAL = "sha256"  # key of the checksum in the file
ALTERED = "file.altered"  # code of the finding


def sealed(data: Mapping[str, Any]) -> dict[str, Any]:
    """Content of a JSON file, with the checksum of all other keys.

    >>> sealed({"beta": 0.7}) == sealed(sealed({"beta": 0.7}))
    True
    """
    content = _without_checksum(data)
    plain: dict[str, Any] = json.loads(json.dumps(jsonable(content)))
    return {**plain, SEAL: checksum(plain)}


def intact(data: Mapping[str, Any]) -> bool:
    """Whether the content matches its checksum; True if it has none.

    >>> content = sealed({"beta": 0.7})
    >>> intact(content), intact({"beta": 0.7}), intact({**content, "beta": 0.8})
    (True, True, False)
    """
    if SEAL not in data:
        return True
    return checksum(_without_checksum(data)) == data[SEAL]


def altered(data: Mapping[str, Any], where: str) -> list[Finding]:
    """A warning if the content of a file does not match its checksum."""
    if intact(data):
        return []
    return [warning("file.altered", where=Path(where).name)]


def checksum(plain: Mapping[str, Any]) -> str:
    """SHA-256 of a JSON object; the order of keys and line breaks do not matter."""
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _without_checksum(data: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key != SEAL}
