"""Stored JSON files that tcdyn reads again: their kinds, the schemas that are read, and the errors.

The key ``schema`` of a file is a name and a number, such as ``tcdyn.disk/2``. The number changes
with the meaning of a key. A reader calls ``read_json`` and ``check_schema``, and converts the
content of an earlier schema itself. Guarded by ``tests/stored/test_stored_files.py``, which reads a
file of each kind and version.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tcdyn.core.errors import InputError
from tcdyn.io.read import check_no_device

SCHEMA_KEY = "schema"
LONGEST_QUOTED = 60  # characters of an unknown schema in a message; by judgement
_SCHEMA = re.compile(r"(?P<name>tcdyn\.[a-z]+)/(?P<number>[0-9]{1,6})")


@dataclass(frozen=True)
class StoredKind:
    """A kind of stored file.

    Attributes
    ----------
    text
        What it is, for messages.
    name
        Name of its schema.
    numbers
        Numbers of the schemas that this version reads; it writes the last.
    files
        Usual names of such files.
    writer
        Command that writes them.
    remedy
        What to do with a file of an earlier schema that is not read.
    """

    text: str
    name: str
    numbers: tuple[int, ...]
    files: str
    writer: str
    remedy: str = "read it with the version of tcdyn that wrote it"

    @property
    def schema(self) -> str:
        """The schema that this version writes."""
        return f"{self.name}/{self.numbers[-1]}"

    @property
    def expected(self) -> str:
        """Kind and schemas, for messages.

        >>> DISK.expected
        'a disk record of schema tcdyn.disk/1 or tcdyn.disk/2'
        """
        schemas = " or ".join(f"{self.name}/{number}" for number in self.numbers)
        return f"{self.text} of schema {schemas}"

    @property
    def give_it(self) -> str:
        """What to do instead of giving another file.

        >>> DISK.give_it
        'give the *.disk.json that `tcdyn rig calibrate` wrote'
        """
        return f"give the {self.files} that `{self.writer}` wrote"


DISK = StoredKind("a disk record", "tcdyn.disk", (1, 2), "*.disk.json", "tcdyn rig calibrate")
SENSOR = StoredKind("a sensor file", "tcdyn.sensor", (1,), "*.sensor.json", "tcdyn sensor")
IDENTIFIED = StoredKind(
    "an identified model", "tcdyn.identified", (1,), "*.identified.json", "tcdyn identify"
)
BETA = StoredKind("the result of a test", "tcdyn.beta", (1,), "*.beta.json", "tcdyn rig beta")
CAMPAIGN = StoredKind(
    "the result of a campaign", "tcdyn.campaign", (1,), "campaign.json", "tcdyn rig campaign"
)
STATE = StoredKind(
    "the state of a followed log",
    "tcdyn.follow",
    (13,),
    "file",
    "tcdyn follow",
    remedy="continue the run with the version of tcdyn that wrote it",
)
KINDS = (DISK, SENSOR, IDENTIFIED, BETA, CAMPAIGN, STATE)


def read_json(path: str | Path, kind: StoredKind) -> Any:
    """Read a JSON file; a repeated key is an error.

    Parameters
    ----------
    path
        The file.
    kind
        What the file should be, for messages.

    Returns
    -------
    content
        The parsed JSON.

    Raises
    ------
    InputError
        No such file, or no JSON.
    """
    check_no_device(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        return json.loads(text, object_pairs_hook=_without_repeated_keys)
    except FileNotFoundError:
        raise InputError(
            "no such file", where=str(path), remedy=f"`{kind.writer}` writes one"
        ) from None
    except (OSError, ValueError, RecursionError) as problem:
        raise InputError(
            f"not readable as JSON ({problem})",
            where=str(path),
            expected=kind.text,
            remedy=kind.give_it,
        ) from None


def check_schema(content: Any, where: str, *kinds: StoredKind) -> StoredKind:
    """Check that the content of a stored file has a schema that is read.

    Parameters
    ----------
    content
        The parsed JSON.
    where
        Name of the file, for messages.
    kinds
        Kinds that are expected, the usual one first.

    Returns
    -------
    kind
        The kind of the file.

    Raises
    ------
    InputError
        For another kind of file, and for a schema of a later or earlier version.

    Examples
    --------
    >>> check_schema({"schema": "tcdyn.disk/1"}, "fast.disk.json", DISK).text
    'a disk record'
    >>> check_schema({"schema": "tcdyn.disk/3"}, "fast.disk.json", DISK)
    Traceback (most recent call last):
    tcdyn.core.errors.InputError: fast.disk.json: is a disk record of schema tcdyn.disk/3, which...
    """
    usual = kinds[0]
    expected = ", or ".join(kind.expected for kind in kinds)
    if not isinstance(content, dict) or SCHEMA_KEY not in content:
        raise InputError(
            f"is not {usual.text}: it has no key {SCHEMA_KEY}",
            where=where,
            expected=expected,
            remedy=usual.give_it,
        )
    schema = str(content[SCHEMA_KEY])
    match = _SCHEMA.fullmatch(schema)
    known = [kind for kind in KINDS if match is not None and kind.name == match["name"]]
    if match is None or not known:
        raise InputError(
            f"is not {usual.text}: its {SCHEMA_KEY} is {schema[:LONGEST_QUOTED]!r}",
            where=where,
            expected=expected,
            remedy=usual.give_it,
        )
    kind = known[0]
    if kind not in kinds:
        raise InputError(
            f"is {kind.text} of schema {schema}",
            where=where,
            expected=expected,
            remedy=usual.give_it,
        )
    number = int(match["number"])
    if number in kind.numbers:
        return kind
    is_later = number > kind.numbers[-1]
    raise InputError(
        f"is {kind.text} of schema {schema}, which "
        f"{'a later' if is_later else 'an earlier'} version of tcdyn wrote",
        where=where,
        expected=expected,
        remedy="update tcdyn" if is_later else kind.remedy,
    )


def _without_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; ValueError for a repeated key."""
    names = [key for key, _ in pairs]
    for key in names:
        if names.count(key) > 1:
            raise ValueError(f"key {key!r} occurs twice")
    return dict(pairs)
