"""The record of a calibrated disk: static line and chain of each channel, and their origin.

Written by ``tcdyn rig calibrate``; read by every command that needs a calibrated disk. The keys are
those of the JSON file: a new key needs a default, or records of earlier versions cannot be read.
Tests: ``tests/rig/test_record.py``.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from copy import deepcopy
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
import pandas as pd
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    computed_field,
    model_serializer,
    model_validator,
)

from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, first_validation_error, utf8
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, labelled_messages, messages, warning
from tcdyn.core.result import Result, estimate_columns, json_text
from tcdyn.io.checksum import CHECKSUM_KEY, checksum_findings, with_checksum
from tcdyn.io.column_names import column_named
from tcdyn.io.endings import JSON, check_ending
from tcdyn.io.stored import DISK, check_schema, read_json
from tcdyn.io.write import write_text
from tcdyn.rig.disk import Conditioning, DiskSetup
from tcdyn.rig.rigfile import RigTables
from tcdyn.rig.static_line import StaticLine, lines_frame, lines_table
from tcdyn.rig.tables import STRICT

# Schema of the records that this version writes.
SCHEMA: Final[Literal["tcdyn.disk/2"]] = "tcdyn.disk/2"
SCHEMA_0_1 = "tcdyn.disk/1"  # of version 0.1: two lags a channel, tau1_s and tau2_s
_Model = TypeVar("_Model", bound=BaseModel)
# Longest lag [s]: about four months, slower than any building; a longer time is in another unit.
MAX_LAG_S = 1e7
# A lag may differ from the sum of its parameters by this [s] or by 3 u. Chosen by judgement.
LAG_TOLERANCE_S = 0.02


class StrictModel(BaseModel):
    """A part of a JSON file with fixed keys; unknown keys are errors."""

    model_config = ConfigDict(**STRICT, populate_by_name=True)


class InputFile(StrictModel):
    """A file that the record was made from, with its SHA-256."""

    file: str
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")

    @classmethod
    def of_path(cls, path: Path, sha256: str) -> InputFile:
        """The file at ``path``, by its name without the folder, and the SHA-256 of its bytes."""
        return cls(file=utf8(path.name), sha256=sha256)


Lag = Annotated[float, Field(ge=0, lt=MAX_LAG_S)]
Positive = Annotated[float, Field(gt=0, lt=MAX_LAG_S)]


class ChannelChain(StrictModel):
    """The chain of one channel in a record: the parameters [s] of ``tcdyn.Chain`` without filter B.

    Parameters
    ----------
    taus_s, zero_s, delay_s, pair, cement_s, is_stated
        Parameters of the chain, by their names in ``tcdyn.Chain``.
    lag_s
        First moment of the chain, including the filter B.
    split_u_s
        Standard uncertainty of the share of ``lag_s`` that belongs to the largest lag.
    """

    taus_s: tuple[Lag, ...]
    zero_s: float = Field(default=0.0, gt=-MAX_LAG_S, lt=MAX_LAG_S)
    delay_s: Lag = 0.0
    pair: tuple[Positive, Positive] | None = None
    cement_s: Lag = 0.0
    is_stated: bool = False
    lag_s: Estimate
    split_u_s: Lag = 0.0

    @model_serializer(mode="wrap")
    def _without_usual(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The fields; ``is_stated`` only where it holds, so that other files stay as they were."""
        data = dict(serialize(self))
        if not data.get("is_stated"):
            data.pop("is_stated", None)
        return data


class ChainRecord(StrictModel):
    """The dynamic part of a record.

    Parameters
    ----------
    structure
        Name of the chain's structure.
    channels
        Chain of each channel.
    covariance
        Covariance [s^2] of the ``lag_s`` of the channels, in the order of their names.
    common_lag_s
        Mean of the lags.
    differential_lag_s
        Lag minus common lag, for each channel.
    """

    structure: str = Field(min_length=1, max_length=40)
    channels: dict[str, ChannelChain]
    covariance: list[list[float]]
    common_lag_s: Estimate
    differential_lag_s: dict[str, Estimate]

    def table(self) -> pd.DataFrame:
        """One row a channel: lag with uncertainty and 95 % interval, and lag minus common lag."""
        rows = [
            {
                "channel": name,
                "lag [s]": channel.lag_s.text_without_interval(),
                "95 % [s]": channel.lag_s.interval_text,
                "minus common lag [s]": self.differential_lag_s[name].text_without_interval(),
            }
            for name, channel in sorted(self.channels.items())
        ]
        return pd.DataFrame(rows)

    @model_validator(mode="after")
    def _check_consistency(self) -> ChainRecord:
        """Check channels, covariance, common and differential lags against each other."""
        if not self.channels:
            raise ValueError("channels: holds no channel")
        if set(self.differential_lag_s) != set(self.channels):
            raise ValueError("differential_lag_s: must name the channels of the chain")
        matrix = square_matrix(self.covariance, len(self.channels))
        mean_s = float(np.mean([channel.lag_s.value for channel in self.channels.values()]))
        _check_lag(self.common_lag_s, mean_s, "common_lag_s: {} s, but the lags' mean is {} s")
        for name, u in zip(sorted(self.channels), np.sqrt(np.maximum(np.diag(matrix), 0.0))):
            lag = self.channels[name].lag_s
            if abs(u - lag.u) > 0.5 * max(u, lag.u) + 1e-6:
                raise ValueError(
                    f"covariance: its diagonal gives {u:.4g} s for {name}, but lag_s.u is "
                    f"{lag.u:.4g} s"
                )
            _check_lag(
                self.differential_lag_s[name],
                lag.value - mean_s,
                f"differential_lag_s.{name}: {{}} s, but lag - mean is {{}} s",
            )
        return self


class DiskRecord(Result, StrictModel):
    """The calibration of one disk; ``setup`` holds the rig tables it was calibrated with."""

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
    def _findings_from_warnings(cls, data: Any) -> Any:
        """Findings of an old file that holds sentences only; the sentences are kept unchanged."""
        if not isinstance(data, dict) or "warnings" not in data:
            return data
        data = dict(data)
        sentences = data.pop("warnings")
        if not isinstance(sentences, list) or not all(isinstance(x, str) for x in sentences):
            raise ValueError("warnings: must be a list of sentences")
        data.setdefault("findings", [warning("from_file", text=sentence) for sentence in sentences])
        return data

    @model_validator(mode="after")
    def _check_consistency(self) -> DiskRecord:
        """Check the names of the channels, the date, and each lag against its parameters.

        Raises
        ------
        ValueError
            Otherwise; pydantic makes it an error of the record.

        Notes
        -----
        The lag is the first moment of the chain: dead time, time constants minus zero, the
        contribution of a pair, half of the cement, and the conditioning filter. It must agree with
        ``tcdyn.chain.Chain.lag_s``. Test: ``tests/rig/test_record.py``.
        """
        if not self.static:
            raise ValueError("static: holds no channel")
        self._check_names("static", self.static)
        if self.chain:
            self._check_names("chain.channels", self.chain.channels)
        try:
            parse_time(self.created)
        except ValueError:
            raise ValueError(f"created: {self.created!r} is no date (ISO 8601)") from None
        channels = self.chain.channels if self.chain else {}
        for name, channel in channels.items():
            pair_s = 2 * channel.pair[0] * channel.pair[1] if channel.pair else 0.0
            sensor_s = channel.delay_s + sum(channel.taus_s) - channel.zero_s
            sensor_s += pair_s + channel.cement_s / 2
            _check_lag(
                channel.lag_s,
                sensor_s + self.conditioning.lag_s,
                f"chain.channels.{name}.lag_s: {{}} s, but its lags add to {{}} s",
            )
        return self

    def _check_names(self, key: str, names: Iterable[str]) -> None:
        """Raise ValueError for a channel that the disk does not have.

        Parameters
        ----------
        key
            Key of the table, for the message.
        names
            Names of channels.
        """
        unknown = sorted(set(names) - set(self.setup.thermocouples))
        if unknown:
            known = sorted(self.setup.thermocouples)
            raise ValueError(
                f"{key}.{unknown[0]}: no such channel; they are {known[0]} to {known[-1]}"
            )

    @computed_field  # type: ignore[prop-decorator]
    @property
    def warnings(self) -> list[str]:
        """All findings as sentences."""
        return list(messages(self.findings))

    def __getitem__(self, channel: str) -> ChannelChain:
        """The chain of a channel, such as "a", with its lag.

        Raises
        ------
        InputError
            For a record without a chain, and for a channel that it does not have.
        """
        where = f"the record of the {self.disk} disk"
        if self.chain is None:
            raise InputError("there is no chain, and so no lag", where=where)
        return self.chain.channels[column_named(channel, self.chain.channels, where)]

    @property
    def created_text(self) -> str:
        """Date, and the author if known."""
        if not self.created_by:
            return self.created
        return f"{self.created} by {self.created_by}"

    def disk_setup(self) -> DiskSetup:
        """The disk in SI units, as it was calibrated."""
        return self.setup.disk_setup(self.disk)

    def summary(self) -> str:
        """Disk, date, files, lags and findings."""
        files = ", ".join(item.file for item in self.inputs) or "no files named"
        lines = [f"disk {self.disk}, calibrated {self.created_text}, from {files}"]
        if self.chain is None:
            lines.append("no chain: it can correct steady readings only")
        else:
            common = self.chain.common_lag_s.text("s")
            lines.append(
                f"chain {self.chain.structure}: common lag {common}; differences between channels:"
            )
            differences = sorted(self.chain.differential_lag_s.items())
            lines.append("  " + ", ".join(f"{c} {lag.text('s')}" for c, lag in differences))
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def to_frame(self) -> pd.DataFrame:
        """Numbers of static line and lag, one row a channel."""
        table = lines_frame(self.static)
        if self.chain is None:
            return table
        lags = {
            name: {
                **estimate_columns("lag", "s", channel.lag_s),
                **estimate_columns("differential_lag", "s", self.chain.differential_lag_s[name]),
            }
            for name, channel in self.chain.channels.items()
        }
        return table.join(pd.DataFrame.from_dict(lags, orient="index"))

    def card(self) -> pd.DataFrame:
        """Static line and lag of each channel."""
        table = lines_table(self.static)
        if self.chain is None:
            return table
        return table.merge(self.chain.table(), "left", "channel").fillna("")

    def to_dict(self) -> dict[str, Any]:
        """The content of the record's file, with its checksum."""
        return with_checksum(self.model_dump(mode="json", by_alias=True))

    def to_json(self) -> str:
        """The record as JSON text."""
        return json_text(self.to_dict())


def now_utc() -> str:
    """The present time (UTC, ISO 8601) as records write it."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def parse_time(text: str) -> datetime:
    """The time that ``created`` gives; without a time zone it is UTC."""
    time = datetime.fromisoformat(text)
    return time if time.tzinfo else time.replace(tzinfo=UTC)


@with_named_arguments
def write_record(record: DiskRecord, path: str | Path) -> Path:
    """Write the record as JSON; an interrupted write leaves the old file.

    Parameters
    ----------
    record
        The record.
    path
        File to write.

    Returns
    -------
    path
        The same path.

    Raises
    ------
    InputError
        For an ending other than .json.

    Examples
    --------
    >>> record = read_record("fast.disk.json")  # doctest: +SKIP
    >>> write_record(record, "copy.disk.json").name  # doctest: +SKIP
    'copy.disk.json'
    """
    check_ending(path, JSON)
    return write_text(path, record.to_json())


@with_named_arguments
def read_record(path: str | Path) -> DiskRecord:
    """Read a record, also one of version 0.1.

    Parameters
    ----------
    path
        File of a record.

    Raises
    ------
    InputError
        An unknown schema, a missing or unknown key, or an impossible value; the message names the
        key.

    Examples
    --------
    >>> read_record("fast.disk.json").disk  # doctest: +SKIP
    'fast'
    """
    return parse_record(read_json(path, DISK), str(path))


def parse_record(data: Any, where: str) -> DiskRecord:
    """Check a record that is already parsed JSON.

    A checksum that does not fit the content is a finding.

    Parameters
    ----------
    data
        The parsed JSON.
    where
        Name of the file, for messages.

    Returns
    -------
    record
        The record, with a finding for a wrong checksum.

    Raises
    ------
    InputError
        As ``read_record``.
    """
    check_schema(data, where, DISK)
    record = validate_model(
        DiskRecord,
        _from_0_1(data) if data["schema"] == SCHEMA_0_1 else data,
        where,
        "a record as `tcdyn rig calibrate` writes it",
        "do not edit records by hand; calibrate again",
    )
    record.findings.extend(checksum_findings(data, where))
    return record


def validate_model(
    model: type[_Model], data: Any, where: str, expected: str, remedy: str
) -> _Model:
    """Check data against a model; its checksum is left out.

    Parameters
    ----------
    model
        Class of the result.
    data
        Parsed JSON.
    where
        Name of the file, for messages.
    expected, remedy
        Texts of the message.

    Raises
    ------
    InputError
        The first wrong key.
    """
    if isinstance(data, dict):
        data = {key: value for key, value in data.items() if key != CHECKSUM_KEY}
    try:
        return model.model_validate(data)
    except ValidationError as problem:
        raise InputError(
            first_validation_error(problem), where=where, expected=expected, remedy=remedy
        ) from None


def _from_0_1(data: dict[str, Any]) -> dict[str, Any]:
    """A record of version 0.1 in the present schema: its two lags become a list."""
    data = {**deepcopy(data), "schema": SCHEMA}
    # wrong content is reported later, by key
    with suppress(TypeError, KeyError, AttributeError):
        for channel in data["chain"]["channels"].values():
            channel["taus_s"] = [channel.pop("tau1_s"), channel.pop("tau2_s", 0.0)]
    return data


def _check_lag(lag: Estimate, computed_s: float, message: str) -> None:
    """Raise ValueError where a lag contradicts the value computed from other keys.

    Parameters
    ----------
    lag
        Lag as written.
    computed_s
        Value that follows from other keys [s].
    message
        Text with places for both values.

    Notes
    -----
    ``LAG_TOLERANCE_S`` allows for rounding by hand; 3 u is the other limit.
    """
    if abs(computed_s - lag.value) > max(LAG_TOLERANCE_S, 3 * lag.u):
        raise ValueError(message.format(f"{lag.value:.4g}", f"{computed_s:.4g}"))


def square_matrix(rows: list[list[float]], size: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A covariance matrix from its rows.

    Parameters
    ----------
    rows
        Rows of the matrix.
    size
        Number of rows and columns.

    Returns
    -------
    matrix
        (size, size).

    Raises
    ------
    ValueError
        Wrong size, not symmetric or not positive semidefinite, to 1e-6 of the largest entry.
    """
    if len(rows) != size or any(len(row) != size for row in rows):
        raise ValueError(f"covariance: must be {size} x {size}, one row a channel")
    matrix = np.array(rows, dtype=float)
    scale = float(np.abs(matrix).max()) or 1.0
    if np.abs(matrix - matrix.T).max() > 1e-6 * scale:
        raise ValueError("covariance: must be symmetric")
    if np.linalg.eigvalsh(matrix).min() < -1e-6 * scale:
        raise ValueError("covariance: must be positive semidefinite")
    return matrix
