"""The checksum that a file carries of its own content: a digit that was changed afterwards is noticed on reading."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from calibration.errors import InputError
from calibration.result import jsonable

SEAL = "sha256"


def sealed(data: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a file as JSON holds it, with the checksum of all the rest of it.

    >>> sealed({"beta": 0.7}) == sealed(sealed({"beta": 0.7}))
    True
    """
    plain: dict[str, Any] = json.loads(json.dumps(jsonable({k: v for k, v in data.items() if k != SEAL})))
    return {**plain, SEAL: checksum(plain)}


def check_seal(data: Mapping[str, Any], where: str, remedy: str) -> None:
    """Raise InputError, naming the file, if it carries a checksum and a digit of the rest of it is another.

    >>> check_seal({**sealed({"beta": 0.7}), "beta": 0.8}, "D4.beta.json", "run beta again")
    Traceback (most recent call last):
    calibration.errors.InputError: D4.beta.json: its content is not what was written: the checksum does not fit...
    """
    if SEAL in data and checksum({k: v for k, v in data.items() if k != SEAL}) != data[SEAL]:
        raise InputError("its content is not what was written: the checksum does not fit", where=where, remedy=remedy)


def checksum(plain: Mapping[str, Any]) -> str:
    """SHA-256 of a JSON object, whatever the order of its keys and its line breaks."""
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
