"""The record of a calibrated disk: what each channel reads at rest, how late it is, and where that came from."""

from __future__ import annotations

import getpass
import json
from contextlib import suppress
from copy import deepcopy
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError, computed_field, model_validator

from tcdyn.core.errors import InputError, first_wrong
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, labelled_messages, messages, warning
from tcdyn.core.result import Result, json_text
from tcdyn.io.checksum import SEAL, altered, sealed
from tcdyn.io.write import write_text
from tcdyn.rig.disk import Conditioning, DiskSetup
from tcdyn.rig.rigfile import RigTables
from tcdyn.rig.static_line import StaticLine, lines_table
from tcdyn.rig.strict import STRICT

SCHEMA: Final[Literal["tcdyn.disk/2"]] = "tcdyn.disk/2"
OF_0_1 = "tcdyn.disk/1"  # two lags a channel, tau1_s and tau2_s
_Model = TypeVar("_Model", bound=BaseModel)
LONGEST_LAG_S = (
    1e7  # about four months, slower than any building; beyond it a time is in another unit
)
LAG_TOLERANCE_S = (
    0.02  # a lag and its own parameters may differ by this or 3 u before they contradict
)


class RecordPart(BaseModel):
    """What stands in a file of known keys: no other key is taken."""

    model_config = ConfigDict(**STRICT, populate_by_name=True)


class InputFile(RecordPart):
    """One file that the record was made from."""

    file: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


Lag = Annotated[float, Field(ge=0, lt=LONGEST_LAG_S)]
Positive = Annotated[float, Field(gt=0, lt=LONGEST_LAG_S)]


class ChannelChain(RecordPart):
    """What stands in the file of one channel's ``tcdyn.Chain``: its parameters [s] by their names there, B left out.

    ``lag_s`` is the chain's first moment, the filter B included; ``split_u_s``: standard uncertainty of how much of
    it is the largest lag's.
    """

    taus_s: tuple[Lag, ...]
    zero_s: float = Field(default=0.0, gt=-LONGEST_LAG_S, lt=LONGEST_LAG_S)
    delay_s: Lag = 0.0
    pair: tuple[Positive, Positive] | None = None
    cement_s: Lag = 0.0
    lag_s: Estimate
    split_u_s: Lag = 0.0


class ChainRecord(RecordPart):
    """The dynamic part; ``covariance`` [s^2] is that of the channels' ``lag_s`` in the order of their names."""

    structure: str = Field(min_length=1, max_length=40)
    channels: dict[str, ChannelChain]
    covariance: list[list[float]]
    common_lag_s: Estimate
    differential_lag_s: dict[str, Estimate]

    def table(self) -> pd.DataFrame:
        """One row a channel: lag with uncertainty and 95 % interval, and how far it is off the common lag."""
        apart = self.differential_lag_s
        rows = [
            (c, x.lag_s.plain(), x.lag_s.interval, apart[c].plain())
            for c, x in sorted(self.channels.items())
        ]
        return pd.DataFrame(
            rows, columns=["channel", "lag [s]", "95 % [s]", "minus common lag [s]"]
        )

    @model_validator(mode="after")
    def _sound(self) -> ChainRecord:
        if not self.channels:
            raise ValueError("channels: holds no channel")
        if set(self.differential_lag_s) != set(self.channels):
            raise ValueError("differential_lag_s: must name the channels of the chain")
        matrix = square_matrix(self.covariance, len(self.channels))
        common = float(np.mean([channel.lag_s.value for channel in self.channels.values()]))
        _agrees(self.common_lag_s, common, "common_lag_s: {} s, but the lags' mean is {} s")
        for name, u in zip(sorted(self.channels), np.sqrt(np.maximum(np.diag(matrix), 0.0))):
            lag = self.channels[name].lag_s
            rest = self.differential_lag_s[name]
            if abs(u - lag.u) > 0.5 * max(u, lag.u) + 1e-6:
                raise ValueError(
                    f"covariance: its diagonal gives {u:.4g} s for {name}, but lag_s.u is {lag.u:.4g} s"
                )
            _agrees(
                rest,
                lag.value - common,
                f"differential_lag_s.{name}: {{}} s, but lag - mean is {{}} s",
            )
        return self


class DiskRecord(Result, RecordPart):
    """Everything known of one calibrated disk; ``setup`` holds the rig tables it was calibrated with."""

    schema_: Literal["tcdyn.disk/2"] = Field(default=SCHEMA, alias="schema")
    disk: str = Field(min_length=1, max_length=80)
    created: str
    created_by: str = ""
    inputs: list[InputFile] = Field(default_factory=list)
    static: dict[str, StaticLine]
    chain: ChainRecord | None = None
    conditioning: Conditioning = Conditioning()
    fit: dict[str, Any] = Field(default_factory=dict)
    findings: list[Finding] = Field(default_factory=list)
    setup: RigTables = RigTables()

    @model_validator(mode="before")
    @classmethod
    def _findings(cls, data: Any) -> Any:
        """Findings of a file that has sentences only, each kept as it stands."""
        if not isinstance(data, dict) or "warnings" not in data:
            return data
        data = dict(data)
        old = data.pop("warnings")
        if not isinstance(old, list) or not all(isinstance(sentence, str) for sentence in old):
            raise ValueError("warnings: must be a list of sentences")
        data.setdefault("findings", [warning("said", text=sentence) for sentence in old])
        return data

    @model_validator(mode="after")
    def _sound(self) -> DiskRecord:
        for key, names in (
            ("static", self.static),
            ("chain.channels", self.chain.channels if self.chain else {}),
        ):
            if not names and key == "static":
                raise ValueError(f"{key}: holds no channel")
            if strange := sorted(set(names) - set(self.setup.thermocouples)):
                known = sorted(self.setup.thermocouples)
                raise ValueError(
                    f"{key}.{strange[0]}: no such channel; they are {known[0]} to {known[-1]}"
                )
        try:
            moment(self.created)
        except ValueError:
            raise ValueError(f"created: {self.created!r} is no date (ISO 8601)") from None
        if self.chain is not None:
            for name, c in self.chain.channels.items():
                pair_s = 2 * c.pair[0] * c.pair[1] if c.pair else 0.0
                own_s = c.delay_s + sum(c.taus_s) - c.zero_s + pair_s + c.cement_s / 2
                lag_s = own_s + self.conditioning.lag_s
                _agrees(
                    c.lag_s,
                    lag_s,
                    f"chain.channels.{name}.lag_s: {{}} s, but its lags add to {{}} s",
                )
        return self

    @computed_field  # type: ignore[prop-decorator]
    @property
    def warnings(self) -> list[str]:
        """The findings as sentences, notes among them."""
        return list(messages(self.findings))

    @property
    def made(self) -> str:
        """When it was made and, where that is known, by whom."""
        return f"{self.created} by {self.created_by}" if self.created_by else self.created

    def disk_setup(self) -> DiskSetup:
        """The disk in SI units, as it was calibrated."""
        return self.setup.setup(self.disk)

    def summary(self) -> str:
        """Disk, day, files, common lag and warnings, in a few lines."""
        files = ", ".join(item.file for item in self.inputs) or "no files named"
        lines = [f"disk {self.disk}, calibrated {self.made}, from {files}"]
        if self.chain is None:
            lines.append("no chain: it can correct steady readings only")
        else:
            common = self.chain.common_lag_s.text("s")
            lines.append(
                f"chain {self.chain.structure}: common lag {common}; differences between channels:"
            )
            rest = self.chain.differential_lag_s
            lines.append("  " + ", ".join(f"{c} {rest[c].text('s')}" for c in sorted(rest)))
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def card(self) -> pd.DataFrame:
        """Static line and lag of each channel."""
        table = lines_table(self.static)
        return (
            table
            if self.chain is None
            else table.merge(self.chain.table(), "left", "channel").fillna("")
        )

    def to_dict(self) -> dict[str, Any]:
        """The content of the record's file, with its checksum."""
        return sealed(self.model_dump(mode="json", by_alias=True))

    def to_json(self) -> str:
        """The record as JSON text."""
        return json_text(self.to_dict())


def now_utc() -> str:
    """The moment as the record writes it."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def user_name() -> str:
    """Who runs this, for ``created_by``; empty where the system does not say."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return ""


def moment(text: str) -> datetime:
    """The moment that ``created`` names; without a zone it is taken as UTC."""
    found = datetime.fromisoformat(text)
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def write_record(record: DiskRecord, path: str | Path) -> Path:
    """Write the record as JSON, whole or not at all."""
    return write_text(path, record.to_json())


def read_record(path: str | Path) -> DiskRecord:
    """Read a record, one of version 0.1, too.

    Raises InputError that names the key for an unknown schema, a missing or unknown key, or a value that cannot be.
    """
    return parse_record(
        read_json(path, "a disk record", "tcdyn calibrate", "*.disk.json"), str(path)
    )


def read_json(path: str | Path, expected: str, writer: str, called: str = "file") -> Any:
    """What a JSON file holds, no key twice; InputError that says what was ``expected`` and which command writes it."""
    try:
        return json.loads(Path(path).read_text(encoding="utf-8-sig"), object_pairs_hook=_no_twins)
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), remedy=f"`{writer}` writes one") from None
    except (OSError, ValueError, RecursionError) as problem:
        remedy = f"give the {called} that `{writer}` wrote"
        raise InputError(
            f"not readable as JSON ({problem})", where=str(path), expected=expected, remedy=remedy
        ) from None


def parse_record(data: Any, where: str) -> DiskRecord:
    """Check a record that is already parsed JSON; ``where`` names it in errors, and in a finding if its content is not
    what its checksum says."""
    if not isinstance(data, dict):
        raise InputError(
            "is no disk record", where=where, expected="a JSON object with the key schema"
        )
    if "schema" not in data:
        raise InputError("schema: the key is missing", where=where, expected=repr(SCHEMA))
    schema = str(data["schema"])
    if schema not in (SCHEMA, OF_0_1):
        remedy = "update tcdyn" if schema.startswith("tcdyn.disk/") else "give a disk record"
        expected = f"{SCHEMA!r} or {OF_0_1!r}"
        raise InputError(
            f"schema: {schema[:60]!r} is not known to this version",
            where=where,
            expected=expected,
            remedy=remedy,
        )
    made = _from_0_1(data) if schema == OF_0_1 else data
    remedy = "do not edit records by hand; calibrate again"
    record = validated(DiskRecord, made, where, "a record as `tcdyn calibrate` writes it", remedy)
    record.findings.extend(altered(data, where))
    return record


def validated(model: type[_Model], data: Any, where: str, expected: str, remedy: str) -> _Model:
    """``data``, its checksum left out, as a ``model``; InputError that names the first key that is wrong."""
    plain = {k: v for k, v in data.items() if k != SEAL} if isinstance(data, dict) else data
    try:
        return model.model_validate(plain)
    except ValidationError as problem:
        raise InputError(
            first_wrong(problem), where=where, expected=expected, remedy=remedy
        ) from None


def _from_0_1(data: dict[str, Any]) -> dict[str, Any]:
    """A record of version 0.1 in today's schema: its two lags are a list."""
    data = {**deepcopy(data), "schema": SCHEMA}
    with suppress(
        TypeError, KeyError, AttributeError
    ):  # what is not as it should be is found by key
        for channel in data["chain"]["channels"].values():
            channel["taus_s"] = [channel.pop("tau1_s"), channel.pop("tau2_s", 0.0)]
    return data


def _no_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [key for key, _ in pairs]
    for key in names:
        if names.count(key) > 1:
            raise ValueError(f"key {key!r} stands twice")
    return dict(pairs)


def _agrees(stated: Estimate, found_s: float, words: str) -> None:
    if abs(found_s - stated.value) > max(LAG_TOLERANCE_S, 3 * stated.u):
        raise ValueError(words.format(f"{stated.value:.4g}", f"{found_s:.4g}"))


def square_matrix(rows: list[list[float]], size: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Rows of a covariance as an array (size, size); ValueError for one that is none."""
    if len(rows) != size or any(len(row) != size for row in rows):
        raise ValueError(f"covariance: must be {size} x {size}, one row a channel")
    matrix = np.array(rows, dtype=float)
    scale = float(np.abs(matrix).max()) or 1.0
    if np.abs(matrix - matrix.T).max() > 1e-6 * scale:
        raise ValueError("covariance: must be symmetric")
    if np.linalg.eigvalsh(matrix).min() < -1e-6 * scale:
        raise ValueError("covariance: must be positive semidefinite")
    return matrix
