"""Sufficient statistics of one test for the campaign posterior, and their checksum.

``tcdyn.campaign.compress`` makes them, ``beta.json`` stores them, ``tcdyn.campaign.posterior``
solves them. Guarded by ``tests/campaign/test_posterior.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.compare import LOG_TABLES
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import DAMAGED, InputError
from tcdyn.io.checksum import CHECKSUM_KEY, checksum, matches_checksum
from tcdyn.rig.disk import DISKS
from tcdyn.rig.record import DiskRecord
from tcdyn.rig.rigfile import Rig

# Schema of the block "kept" of ``beta.json``; change it with the content.
SCHEMA = "tcdyn.kept/1"
# Remedy of every error about such a block.
ANALYSE_AGAIN = "analyse its log again: tcdyn rig beta LOG --out FILE"
# Keys of rig.toml, as table.key, that version 0.2 did not have and that the physics depends on.
KEYS_SINCE_0_2 = ("uncertainty.steel_of_one_disk_rel",)
# Parameters of every test, first in ``SufficientStatistics.names``; the lags in s.
QUANTITIES = ("beta", "ln h fast", "ln h slow", "lag fast", "lag slow")


@dataclass(frozen=True)
class Loading:
    """Factor loading of one nuisance parameter of a test, in standard uncertainties.

    The parameter is ``shared`` @ (quantities common to all tests of the rig, each standard normal)
    + ``specific`` x a standard normal of this test.

    Parameters
    ----------
    shared
        Loading of each quantity that is common to all tests, by name.
    specific
        Loading of the part that is specific to the test.
    """

    shared: Mapping[str, float]
    specific: float = 0.0


@dataclass(frozen=True)
class SufficientStatistics:
    """Likelihood of one test, linear about its optimum, without any prior.

    Attributes
    ----------
    name, rig
        Name of the test; fingerprint of rig.toml and records.
    names
        The P parameters: first ``QUANTITIES`` (lags in s), then the nuisance parameters in
        standard uncertainties. A nuisance parameter without an entry in ``loading`` is common to
        all tests of the rig, under its own name.
    centre
        Parameters at the optimum, shape (P,).
    rows, rhs
        rows @ (x - centre) = right, with errors of unit variance. Shapes (M, P) and (M,).
    loading
        Factor loading of nuisance parameters that are not fully common.
    lag_prior_s, lag_u_s
        Mean lag of each disk by its record, and its standard uncertainty.
    units
        One standard uncertainty of a nuisance parameter (SI unit or relative), where that is a
        single number.
    conditions
        Test conditions; trends of beta are fitted over them.
    """

    name: str
    rig: str
    names: tuple[str, ...]
    centre: Array
    rows: Array
    rhs: Array
    loading: Mapping[str, Loading]
    lag_prior_s: Mapping[str, float]
    lag_u_s: Mapping[str, float]
    units: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """The block "kept" of ``beta.json``, numbers with eight digits."""
        return {
            "schema": SCHEMA,
            "rig_sha256": self.rig,
            "names": list(self.names),
            "centre": _eight_digits_each(self.centre),
            "rows": [_eight_digits_each(row) for row in self.rows],
            "right": _eight_digits_each(self.rhs),
            "loading": [
                {
                    "name": name,
                    "shared": [*each.shared],
                    "by": _eight_digits_each(each.shared.values()),
                    "own": _eight_digits(each.specific),
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
        """Read the block "kept" of ``beta.json``.

        Parameters
        ----------
        name
            Name of the test.
        data
            The block.

        Raises
        ------
        InputError
            Another schema, or numbers that do not belong together.

        Notes
        -----
        The keys are those of ``to_dict``; change both and ``SCHEMA`` together.
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
                rhs=np.array(data["right"], dtype=float),
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
                len(statistics.rhs),
                size,
            ) and statistics.centre.shape == (size,)
            consistent &= statistics.names[: len(QUANTITIES)] == QUANTITIES
            consistent &= bool(
                np.isfinite(statistics.rows).all() and np.isfinite(statistics.rhs).all()
            )
        except DAMAGED:
            consistent = False
        if not consistent:
            raise InputError(
                "what it keeps for a campaign is not whole", where=name, remedy=ANALYSE_AGAIN
            )
        return statistics


def _eight_digits(x: float) -> float:
    """The number rounded to eight significant digits."""
    return float(f"{float(x):.8g}")


def _eight_digits_each(numbers: Iterable[float]) -> list[float]:
    """Each number rounded to eight significant digits."""
    return [_eight_digits(x) for x in numbers]


@with_named_arguments
def verify_checksum(data: Any, where: str) -> dict[str, Any]:
    """The content of a ``beta.json`` after its checksum has been verified.

    Parameters
    ----------
    data
        Content of the file.
    where
        Name of the file, for messages.

    Raises
    ------
    InputError
        If the file holds no checksum or was changed. The message names the file ``where``.

    Examples
    --------
    >>> from tcdyn.io.checksum import with_checksum
    >>> verify_checksum({**with_checksum({"beta": 0.7}), "beta": 0.8}, "D4.beta.json")
    Traceback (most recent call last):
    tcdyn.core.errors.InputError: D4.beta.json: its content is not what was written: the checksum...
    """
    if not isinstance(data, dict) or CHECKSUM_KEY not in data:
        raise InputError(
            "holds no checksum",
            where=where,
            expected="a beta.json of this version",
            remedy=ANALYSE_AGAIN,
        )
    if not matches_checksum(data):
        raise InputError(
            "its content is not what was written: the checksum does not fit",
            where=where,
            remedy=ANALYSE_AGAIN,
        )
    return data


@with_named_arguments
def rig_fingerprint(
    rig: Rig,
    records: Mapping[str, DiskRecord],
    disks: Sequence[str] = DISKS,
    later_keys: Sequence[str] = (),
) -> str:
    """Checksum of everything that all tests of one rig have in common.

    It covers rig.toml without the keys that belong to a log, the static lines, the chains and the
    conditioning filters.

    Parameters
    ----------
    rig
        The rig.
    records
        Record of each disk.
    disks
        Disks whose records are needed.
    later_keys
        Keys of rig.toml, as table.key, that are left out: ``KEYS_SINCE_0_2`` gives the fingerprint
        of version 0.2.

    Raises
    ------
    InputError
        A record is missing.

    Notes
    -----
    Anything that is added to it makes all stored results belong to another rig.
    ``tests/campaign/test_posterior.py`` checks that only the physics changes it.
    """
    tables = {d: rig.tables(d).model_dump(mode="json", exclude=LOG_TABLES) for d in ("", *DISKS)}
    for key in later_keys:
        table, _, name = key.partition(".")
        for content in tables.values():
            del content[table][name]
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
