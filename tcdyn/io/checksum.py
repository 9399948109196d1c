"""Checksum of the content of a JSON file, stored in the file, to detect later changes.

Used for disk records, sensor files, beta.json and the results of a campaign. It detects editing by
hand, not forgery: it has no key. The form of the text in ``checksum`` must stay, or all files that
exist are reported as altered. Guarded by ``tests/io/test_checksum.py``, which pins the digest of
an object and checks stored records, and by ``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tcdyn.core.findings import Finding, warning
from tcdyn.core.result import jsonable

CHECKSUM_KEY = "sha256"  # key of the checksum in the file
ALTERED_CODE = "file.altered"  # code of the finding


def with_checksum(data: Mapping[str, Any]) -> dict[str, Any]:
    """Content of a JSON file, with the checksum of all other keys.

    Parameters
    ----------
    data
        Content; an earlier checksum is replaced.

    Returns
    -------
    content
        The content as it will be read from the file, with the checksum. Arrays are lists; NaN and
        infinity are None (``tcdyn.core.result.jsonable``).

    Examples
    --------
    >>> with_checksum({"beta": 0.7}) == with_checksum(with_checksum({"beta": 0.7}))
    True
    """
    content = _without_checksum(data)
    plain: dict[str, Any] = json.loads(json.dumps(jsonable(content)))
    return {**plain, CHECKSUM_KEY: checksum(plain)}


def matches_checksum(data: Mapping[str, Any]) -> bool:
    """Whether the content matches its checksum.

    Parameters
    ----------
    data
        Content as read from a JSON file.

    Returns
    -------
    matches
        Also True if there is no checksum.

    Examples
    --------
    >>> content = with_checksum({"beta": 0.7})
    >>> changed = {**content, "beta": 0.8}
    >>> matches_checksum(content), matches_checksum({"beta": 0.7}), matches_checksum(changed)
    (True, True, False)
    """
    if CHECKSUM_KEY not in data:
        return True
    return checksum(_without_checksum(data)) == data[CHECKSUM_KEY]


def checksum_findings(data: Mapping[str, Any], where: str) -> list[Finding]:
    """A warning if the content of a file does not match its checksum.

    Parameters
    ----------
    data
        Content of the file.
    where
        Path of the file; its name is in the message.

    Returns
    -------
    findings
        One warning, or none if the content matches or has no checksum.
    """
    if matches_checksum(data):
        return []
    return [warning("file.altered", where=Path(where).name)]


def checksum(plain: Mapping[str, Any]) -> str:
    """SHA-256 of a JSON object; the order of keys and line breaks do not matter.

    Parameters
    ----------
    plain
        What ``json.loads`` can return: no arrays. :func:`with_checksum` converts other content, so
        that NaN does not occur here either.

    Returns
    -------
    digest
        64 hexadecimal digits.
    """
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def _without_checksum(data: Mapping[str, Any]) -> dict[str, Any]:
    """The content without the key of the checksum."""
    return {key: value for key, value in data.items() if key != CHECKSUM_KEY}
