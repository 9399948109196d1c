"""Schemas of the disk record: the one written now, the ones still read, and how they become the new one."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any, Final, Literal

from calibration.errors import InputError

SCHEMA: Final[Literal["tcdyn.disk/1"]] = "tcdyn.disk/1"


def upgraded(data: Any, where: str) -> dict[str, Any]:
    """The record's data in today's schema. Raises InputError for another file or an unknown schema."""
    if not isinstance(data, dict):
        raise InputError("is no disk record", where=where, expected="a JSON object with the key schema")
    schema = data.get("schema")
    if schema is None:
        raise InputError("schema: the key is missing", where=where, expected=repr(SCHEMA))
    seen = 0
    while schema != SCHEMA:
        step = _UPGRADES.get(schema) if isinstance(schema, str) else None
        if step is None or seen > len(_UPGRADES):
            raise InputError(
                f"schema: {str(schema)[:60]!r} is not known to this version",
                where=where,
                expected=f"{SCHEMA!r} or an older one ({', '.join(_UPGRADES)})",
                remedy="update tcdyn" if str(schema).startswith("tcdyn.disk/") else "give a disk record",
            )
        try:
            data = step(deepcopy(data))
        except (KeyError, TypeError, ValueError, AttributeError) as problem:
            raise InputError(f"schema {schema!r}: {problem!r} cannot be brought up to date", where=where) from None
        schema, seen = data["schema"], seen + 1
    return data


def _from_0(data: dict[str, Any]) -> dict[str, Any]:
    """Schema 0 knew static lines only: slope, intercept, their standard errors and the range, no covariance."""
    static = {}
    for name, old in data.pop("static").items():
        u_gain, u_offset = float(old.pop("u_slope", 0.0)), float(old.pop("u_intercept", 0.0))
        low, high = old.pop("range_degC", (20.0, 160.0))
        middle = 0.5 * (float(low) + float(high))
        mixed = -u_gain * min(middle * u_gain, u_offset)
        static[name] = {
            "gain": old.pop("slope"),
            "offset": old.pop("intercept"),
            "covariance": [[u_gain**2, mixed], [mixed, u_offset**2]],
            "range_degC": [low, high],
            **old,
        }
    note = "read from schema tcdyn.disk/0: correlation of gain and offset assumed, no chain"
    return {**data, "schema": SCHEMA, "static": static, "warnings": [*data.get("warnings", []), note]}


_UPGRADES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {"tcdyn.disk/0": _from_0}
