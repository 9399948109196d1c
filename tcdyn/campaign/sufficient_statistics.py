"""What an analysed test hands over to its campaign: rows of numbers, sealed with the answer that
they came with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.compare import OF_A_LOG
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.io.checksum import SEAL, checksum, intact
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig

SCHEMA = "tcdyn.kept/1"
ANALYSE_AGAIN = "analyse its log again: tcdyn beta LOG --out FILE"
QUANTITIES = ("beta", "ln h fast", "ln h slow", "lag fast", "lag slow")


@dataclass(frozen=True)
class Loading:
    """An unmeasured quantity of one test, in standard uncertainties, by what all tests of the rig
    share.

    It is ``shared`` @ (shared quantities, each standard normal) + ``own`` x a standard normal of
    this test alone.
    """

    shared: Mapping[str, float]
    own: float = 0.0


@dataclass(frozen=True)
class SufficientStatistics:
    """One test's data about its optimum, without any prior: rows @ (x - centre) = right, errors of
    unit variance.

    x (P,) of ``names``: first ``QUANTITIES`` (lags in s), then what nobody measured, in standard
    uncertainties; what ``loading`` does not mention is wholly shared by the rig under its own name.
    ``lag_prior_s``, ``lag_u_s``: of each disk's mean lag by its record; ``rig``: fingerprint of rig
    and records; ``units``: what a standard uncertainty is in SI or of itself, where that is one
    number; ``conditions``: numbers that trends are sought over.
    """

    name: str
    rig: str
    names: tuple[str, ...]
    centre: Array
    rows: Array
    right: Array
    loading: Mapping[str, Loading]
    lag_prior_s: Mapping[str, float]
    lag_u_s: Mapping[str, float]
    units: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """As ``beta.json`` keeps it under "kept"; eight digits."""
        return {
            "schema": SCHEMA,
            "rig_sha256": self.rig,
            "names": list(self.names),
            "centre": _eight_digits_each(self.centre),
            "rows": [_eight_digits_each(row) for row in self.rows],
            "right": _eight_digits_each(self.right),
            "loading": [
                {
                    "name": name,
                    "shared": [*each.shared],
                    "by": _eight_digits_each(each.shared.values()),
                    "own": _eight_digits(each.own),
                }
                for name, each in self.loading.items()
            ],
            "lag": {
                d: {
                    "prior_s": _eight_digits(self.lag_prior_s[d]),
                    "u_s": _eight_digits(self.lag_u_s[d]),
                }
                for d in DISKS
            },
            "units": {"names": [*self.units], "sizes": _eight_digits_each(self.units.values())},
            "conditions": {k: _eight_digits(v) for k, v in self.conditions.items()},
        }

    @classmethod
    def from_dict(cls, name: str, data: Mapping[str, Any]) -> SufficientStatistics:
        """Read back; raises InputError for another schema or numbers that do not belong
        together.
        """
        if data.get("schema") != SCHEMA:
            raise InputError(
                f"what it keeps for a campaign has the schema {data.get('schema')!r}",
                where=name,
                expected=SCHEMA,
                remedy=ANALYSE_AGAIN,
            )
        try:
            statistics = cls(
                name=name,
                rig=str(data["rig_sha256"]),
                names=tuple(data["names"]),
                centre=np.array(data["centre"], dtype=float),
                rows=np.array(data["rows"], dtype=float),
                right=np.array(data["right"], dtype=float),
                loading={
                    each["name"]: Loading(
                        dict(zip(each["shared"], map(float, each["by"]), strict=True)), each["own"]
                    )
                    for each in data["loading"]
                },
                lag_prior_s={d: float(data["lag"][d]["prior_s"]) for d in DISKS},
                lag_u_s={d: float(data["lag"][d]["u_s"]) for d in DISKS},
                units=dict(
                    zip(data["units"]["names"], map(float, data["units"]["sizes"]), strict=True)
                ),
                conditions={k: float(v) for k, v in data["conditions"].items()},
            )
            size = len(statistics.names)
            consistent = statistics.rows.shape == (
                len(statistics.right),
                size,
            ) and statistics.centre.shape == (size,)
            consistent &= statistics.names[: len(QUANTITIES)] == QUANTITIES
            consistent &= bool(
                np.isfinite(statistics.rows).all() and np.isfinite(statistics.right).all()
            )
        except (KeyError, TypeError, ValueError, AttributeError):
            consistent = False
        if not consistent:
            raise InputError(
                "what it keeps for a campaign is not whole", where=name, remedy=ANALYSE_AGAIN
            )
        return statistics


def _eight_digits(x: float) -> float:
    return float(f"{float(x):.8g}")


def _eight_digits_each(numbers: Iterable[float]) -> list[float]:
    return [_eight_digits(x) for x in numbers]


def checked(data: Any, where: str) -> dict[str, Any]:
    """The same content, if it is what was written; raises InputError, naming the file, if a digit
    of it is another.

    >>> from tcdyn.io.checksum import sealed
    >>> checked({**sealed({"beta": 0.7}), "beta": 0.8}, "D4.beta.json")
    Traceback (most recent call last): tcdyn.core.errors.InputError: D4.beta.json: its content is
    not what was written: the checksum does not fit...
    """
    if not isinstance(data, dict) or SEAL not in data:
        raise InputError(
            "holds no checksum",
            where=where,
            expected="a beta.json of this version",
            remedy=ANALYSE_AGAIN,
        )
    if not intact(data):
        raise InputError(
            "its content is not what was written: the checksum does not fit",
            where=where,
            remedy=ANALYSE_AGAIN,
        )
    return data


def rig_fingerprint(
    rig: Rig, records: Mapping[str, DiskRecord], disks: Sequence[str] = DISKS
) -> str:
    """Checksum of all that tests of one rig have in common: rig.toml but for what is a log's, lines
    and chains.
    """
    tables = {d: rig.tables(d).model_dump(mode="json", exclude=OF_A_LOG) for d in ("", *DISKS)}
    if missing := [d for d in disks if d not in records]:
        raise InputError(
            f"no record of the {missing[0]} disk",
            remedy="add {records}",
            parameters={"records": f"{missing[0]}.disk.json"},
        )
    record_data = {
        d: records[d].model_dump(mode="json", include={"static", "chain", "conditioning"})
        for d in disks
    }
    return checksum({"tables": tables, "records": record_data})
