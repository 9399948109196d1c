"""The checksum that a file carries of its own content: a digit that was changed afterwards is noticed on reading."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import jsonable

SEAL = "sha256"
ALTERED = "file.altered"


def sealed(data: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a file as JSON holds it, with the checksum of all the rest of it.

    >>> sealed({"beta": 0.7}) == sealed(sealed({"beta": 0.7}))
    True
    """
    plain: dict[str, Any] = json.loads(
        json.dumps(jsonable({k: v for k, v in data.items() if k != SEAL}))
    )
    return {**plain, SEAL: checksum(plain)}


def intact(data: Mapping[str, Any]) -> bool:
    """Whether the content is what was written, as far as it carries a checksum.

    >>> intact(sealed({"beta": 0.7})), intact({"beta": 0.7}), intact({**sealed({"beta": 0.7}), "beta": 0.8})
    (True, True, False)
    """
    return SEAL not in data or checksum({k: v for k, v in data.items() if k != SEAL}) == data[SEAL]


def altered(data: Mapping[str, Any], where: str) -> list[Finding]:
    """That a file is not what was written, to be looked at by whoever uses it; nothing where it is."""
    return [] if intact(data) else [warning("file.altered", where=Path(where).name)]


def checksum(plain: Mapping[str, Any]) -> str:
    """SHA-256 of a JSON object, whatever the order of its keys and its line breaks."""
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
