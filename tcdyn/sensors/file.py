"""What is known of a thermocouple outside the rig, and its file: chain, uncertainty, columns, how it was found."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import pandas as pd
from pydantic import Field, computed_field, model_validator

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, labelled_messages, messages, warning
from tcdyn.core.result import Result
from tcdyn.io.checksum import altered, sealed
from tcdyn.io.write import write_text
from tcdyn.rig.disk import Conditioning
from tcdyn.rig.record import (
    LONGEST_LAG_S,
    ChannelChain,
    InputFile,
    RecordPart,
    moment,
    now_utc,
    read_json,
    square_matrix,
    validated,
)
from tcdyn.rig.static_line import StaticLine

if TYPE_CHECKING:
    from tcdyn.identify import Identified

SCHEMA: Final[Literal["tcdyn.sensor/1"]] = "tcdyn.sensor/1"
OF_IDENTIFY = "tcdyn.identified/"
SHARES = {
    "t50_s": 0.5,
    "t632_s": 1 - float(np.exp(-1)),
    "t90_s": 0.9,
}  # of the step, as VDI/VDE 3522 reports them
MEASURED = (
    "plunge",
    "pair",
    "current",
    "noise",
)  # methods whose lag always has an uncertainty above zero
Method = Literal["stated", "plunge", "pair", "current", "noise", "identify"]


class SensorChains(RecordPart):
    """The chain of each column; ``covariance`` [s^2] is that of their ``lag_s``, in the order of ``columns``."""

    structure: str = Field(min_length=1, max_length=40)
    channels: dict[str, ChannelChain] = Field(min_length=1)
    covariance: list[list[float]]

    @model_validator(mode="after")
    def _sound(self) -> SensorChains:
        u = np.sqrt(np.maximum(np.diag(square_matrix(self.covariance, len(self.channels))), 0.0))
        for (name, channel), own in zip(self.channels.items(), u):
            if abs(own - channel.lag_s.u) > 0.5 * max(own, channel.lag_s.u) + 1e-6:
                raise ValueError(
                    f"covariance: its diagonal gives {own:.4g} s for {name}, lag_s.u is {channel.lag_s.u:.4g} s"
                )
        return self


class SensorFile(Result, RecordPart):
    """A thermocouple, or several that were found together, that any table's ``columns`` may hold.

    ``columns``: names in a table, ``*`` stands for any text; each has its ``chain``. ``times``: by column when the
    response to a step passes 50, 63.2 and 90 %. ``static``: by column, where there is a line. ``fit``: what the method
    says beside. ``conditioning``: the filter that was stated, none unless it was.
    """

    schema_: Literal["tcdyn.sensor/1"] = Field(default=SCHEMA, alias="schema")
    sensor: str = Field(min_length=1, max_length=80)
    created: str = Field(default_factory=now_utc)
    method: Method
    inputs: list[InputFile] = Field(default_factory=list)
    columns: list[str] = Field(min_length=1)
    chain: SensorChains
    conditioning: Conditioning = NO_CONDITIONING
    times: dict[str, dict[str, Estimate]] = Field(default_factory=dict)
    static: dict[str, StaticLine] = Field(default_factory=dict)
    fit: dict[str, Any] = Field(default_factory=dict)
    findings: list[Finding] = Field(default_factory=list)

    @model_validator(mode="before")
    @classmethod
    def _without_words(cls, data: Any) -> Any:
        return (
            {k: v for k, v in data.items() if k != "warnings"} if isinstance(data, dict) else data
        )

    @model_validator(mode="after")
    def _sound(self) -> SensorFile:
        moment(self.created)
        if list(self.chain.channels) != self.columns:
            raise ValueError("columns: must be those of chain.channels, in their order")
        for name, chain in zip(self.columns, self.chains):
            stated = self.chain.channels[name].lag_s
            if abs(chain.lag_s - stated.value) > max(3 * stated.u, 0.01 * chain.lag_s + 1e-4):
                raise ValueError(
                    f"chain.channels.{name}.lag_s: {stated.value:.4g} s, but its lags add to {chain.lag_s:.4g} s"
                )
        return self

    @computed_field  # type: ignore[prop-decorator]
    @property
    def warnings(self) -> list[str]:
        """The findings as sentences."""
        return list(messages(self.findings))

    @property
    def chains(self) -> tuple[Chain, ...]:
        """One chain a column, filter included."""
        kept = [c.model_dump(exclude={"lag_s", "split_u_s"}) for c in self.chain.channels.values()]
        return tuple(Chain(**c, conditioning=self.conditioning) for c in kept)

    @property
    def lag_covariance_s2(self) -> Array:
        """Covariance (M, M) of the columns' lags [s2]."""
        return np.array(self.chain.covariance, dtype=float)

    @property
    def split_u_s(self) -> Array:
        """Standard uncertainty (M,) of how much of each lag is its largest one's [s]."""
        return np.array([c.split_u_s for c in self.chain.channels.values()])

    def summary(self) -> str:
        """Method, lag, times of the step response, and what was noticed."""
        lines = [f"{self.sensor}: {self.method}, {self.chain.structure}"]
        for name, chain in zip(self.columns, self.chains):
            lines.append(
                f"  {name}: lag {self.chain.channels[name].lag_s.text('s')} ({chain.summary()})"
            )
            if times := self.times.get(name):
                said = (
                    f"{k.removesuffix('_s').replace('632', '63.2')} {e.text('s')}"
                    for k, e in times.items()
                )
                lines.append("    " + ", ".join(said))
        for k, v in self.fit.items():
            estimate = isinstance(v, dict) and set(v) == set(Estimate.model_fields)
            lines += (
                [f"  {k}: {Estimate(**v)}"]
                if estimate
                else [f"  {k}: {v:.4g}"]
                if isinstance(v, float)
                else []
            )
        return "\n".join([*lines, *labelled_messages(self.findings)])

    def card(self) -> pd.DataFrame:
        """Lag and times of each column."""
        rows = [
            {
                "column": n,
                "lag [s]": str(c.lag_s),
                **{k: str(e) for k, e in self.times.get(n, {}).items()},
            }
            for n, c in self.chain.channels.items()
        ]
        return pd.DataFrame(rows)

    def to_dict(self) -> dict[str, Any]:
        """The content of the file, with its checksum."""
        return sealed(self.model_dump(mode="json", by_alias=True))


def sensor_file(
    sensor: str,
    chains: Mapping[str, Chain],
    method: Method,
    lag_covariance: Array,
    split_u_s: Sequence[float],
    *,
    structure: str = "",
    times: Mapping[str, Mapping[str, Estimate]] | None = None,
    **more: Any,
) -> SensorFile:
    """The file of the sensor in columns ``chains``: their lags' covariance (M, M) [s2] and how they divide (M,) [s].

    ``times``: those that a method found itself; by first order from the chain otherwise. ``more``: other fields.

    Raises InputError for a lag whose uncertainty is not finite, or is zero where it was measured, and for a lag that no
    file can hold.
    """
    for (name, chain), variance in zip(chains.items(), np.diag(lag_covariance)):
        if not np.isfinite(variance) or (variance <= 0 and method in MEASURED):
            raise undetermined(name)
        _check_longest(name, chain)
    u = np.sqrt(np.maximum(np.diag(lag_covariance), 0.0))
    rows = {
        name: ChannelChain(
            **chain.parameters, lag_s=Estimate.normal(chain.lag_s, own), split_u_s=float(split)
        )
        for (name, chain), own, split in zip(chains.items(), u, split_u_s)
    }
    found = times or {
        n: step_times(c, float(own), float(s))
        for (n, c), own, s in zip(chains.items(), u, split_u_s)
    }
    first = next(iter(chains.values()))
    kept = SensorChains(
        structure=structure or f"P{len(first.taus_s)}",
        channels=rows,
        covariance=np.asarray(lag_covariance).tolist(),
    )
    return SensorFile(
        sensor=sensor,
        method=method,
        columns=list(chains),
        chain=kept,
        conditioning=first.conditioning,
        times={n: dict(t) for n, t in found.items()},
        **more,
    )


def undetermined(column: str = "") -> InputError:
    """The error of a record that leaves the uncertainty of a lag zero or undefined."""
    lag = f"the lag of {column}" if column else "the lag"
    return InputError(
        f"the record does not determine {lag}: its standard uncertainty is zero or undefined",
        expected="noise and a changing temperature in enough rows",
        remedy="log a longer record, at full resolution",
    )


def _check_longest(name: str, chain: Chain) -> None:
    """Raise InputError for a chain with a time that a file cannot hold."""
    pair = chain.pair or (0.0, 0.0)
    longest_s = max(*chain.taus_s, abs(chain.zero_s), chain.delay_s, chain.cement_s, *pair, 0.0)
    if not longest_s < LONGEST_LAG_S:
        expected = f"times below {LONGEST_LAG_S:g} s, about four months"
        raise InputError(f"{name}: a time of {longest_s:.4g} s in its chain", expected=expected)


def step_times(chain: Chain, lag_u_s: float = 0.0, split_u_s: float = 0.0) -> dict[str, Estimate]:
    """When the unit step response first passes 50, 63.2 and 90 % [s]; uncertainty by first order from lag and split.

    >>> round(step_times(Chain(2.0))["t90_s"].value, 3)
    4.605
    """
    if chain.lag_s <= 0:
        return {}
    here = passes(chain)
    longer_s = max(lag_u_s, 1e-3 * chain.lag_s)
    by_lag = (passes(chain.with_lag_shift(longer_s)) - here) * lag_u_s / longer_s
    by_split = passes(chain.with_split_shift(split_u_s)) - here
    return {k: Estimate.normal(t, u) for k, t, u in zip(SHARES, here, np.hypot(by_lag, by_split))}


def lag_and_times(chain: Chain) -> Array:
    """The lag and when the step response passes each of the shares (4,) [s]."""
    return np.array([chain.lag_s, *passes(chain)])


def passes(chain: Chain) -> Array:
    """When the step response passes each of the shares (3,) [s]."""
    t = chain.lag_s * np.linspace(0, 12, 4801)
    step = chain.response(np.ones_like(t), float(t[1]), "zoh", "zero")
    at = [int(np.argmax(step >= share)) for share in SHARES.values()]
    return np.array(
        [np.interp(q, step[k - 1 : k + 1], t[k - 1 : k + 1]) for k, q in zip(at, SHARES.values())]
    )


def stated(
    sensor: str,
    columns: Sequence[str],
    taus_s: Sequence[tuple[float, float]],
    conditioning: Conditioning = NO_CONDITIONING,
    delay_s: tuple[float, float] = (0.0, 0.0),
    **more: Any,
) -> SensorFile:
    """A sensor whose lags (value, standard uncertainty) [s] somebody states: one chain for all ``columns``.

    >>> stated("probe", ["T1"], [(1.5, 0.1), (0.2, 0.0)]).chain.channels["T1"].lag_s.u
    0.1
    """
    taus = sorted(taus_s, reverse=True)
    if not columns or not taus:
        raise InputError(
            "a sensor needs a lag and a column",
            expected="{taus_s}, {column}",
            parameters={"taus_s": "1.5", "column": "T1"},
        )
    for value, u in (*taus, delay_s):
        if not (value == 0 or 1e-6 <= value < LONGEST_LAG_S) or not 0 <= u < LONGEST_LAG_S:
            expected = f"0, or a microsecond to {LONGEST_LAG_S:g} s, its uncertainty not negative and less than that"
            raise InputError(f"a lag of {value:g} +- {u:g} s", expected=expected)
    chain = Chain([t for t, _ in taus], delay_s=delay_s[0], conditioning=conditioning)
    u2 = sum(u * u for _, u in (*taus, delay_s))
    lesser = sum(u * u for _, u in (*taus[1:], delay_s))
    found = [] if u2 > 0 else [warning("sensor.exact", lag_s=chain.lag_s)]
    m = len(columns)
    return sensor_file(
        sensor,
        dict.fromkeys(columns, chain),
        "stated",
        np.full((m, m), u2),
        [lesser**0.5] * m,
        findings=found,
        **more,
    )


def read_sensor(path: str | Path) -> SensorFile:
    """The sensor in a file of ``tcdyn sensor``, or the chain in one of ``tcdyn identify``.

    Raises InputError that names the key for another file.
    """
    where = str(path)
    expected = "a sensor as `tcdyn sensor` writes it, or a model of `tcdyn identify`"
    data = read_json(path, "a sensor file", "tcdyn sensor")
    schema = str(data.get("schema", "")) if isinstance(data, dict) else ""
    if schema.startswith(OF_IDENTIFY):
        from tcdyn.identify import Identified

        try:
            return from_identified(
                Identified.from_json(Path(path).read_text(encoding="utf-8-sig")), Path(path).name
            )
        except InputError as problem:
            raise problem.at(where) from None
        except (KeyError, TypeError, ValueError) as problem:
            raise InputError(f"is damaged ({problem!r})", where=where, expected=expected) from None
    if schema != SCHEMA:
        raise InputError(
            f"schema: {schema[:60]!r} is not known to this version", where=where, expected=expected
        )
    remedy = "do not edit it by hand; write it again with `tcdyn sensor`"
    sensor = validated(SensorFile, data, where, expected, remedy)
    sensor.findings.extend(altered(data, where))
    return sensor


def write_sensor(sensor: SensorFile, path: str | Path) -> Path:
    """Write the file, whole or not at all."""
    return write_text(path, json.dumps(sensor.to_dict(), indent=2, ensure_ascii=False) + "\n")


def from_identified(model: Identified, sensor: str = "") -> SensorFile:
    """The sensor whose chain `tcdyn identify` found, in the column that was its output.

    Uncertainties are those of the model's covariance; a known filter is recognised by its polynomial.
    Raises InputError for a model that is no chain (a zero and pole form, an integrator).
    """
    chain = model.chain(_known_filter(model))
    named = [n for n in ("Tp2", "Tp3", "Tz", "Td", "Tc") if n in model.model.free]
    at = [list(model.model.free).index(n) for n in named]
    signs = np.array([-1.0 if n == "Tz" else 0.5 if n == "Tc" else 1.0 for n in named])
    split = (
        float(np.sqrt(max(signs @ model.covariance[np.ix_(at, at)] @ signs, 0.0))) if named else 0.0
    )
    gain = model.estimates.get("Kp")
    found = list(model.findings)
    if gain is not None and abs(gain.value - 1) > max(3 * gain.u, 1e-3):
        found.append(warning("sensor.gain", subject=model.output_name, gain=gain.value, u=gain.u))
    column = model.output_name
    return sensor_file(
        sensor or model.model.name,
        {column: chain},
        "identify",
        np.array([[model.lag_s.u**2]]),
        [split],
        structure=model.model.name,
        findings=found,
    )


def _known_filter(model: Identified) -> Conditioning:
    """The conditioning filter whose polynomial was the model's known part."""
    from tcdyn.identify import Known  # a room that no other sensor's file needs

    den = np.trim_zeros(np.asarray(model.model.known.den, dtype=float), "b")
    n = len(den) - 1
    if n == 0:
        return NO_CONDITIONING
    cutoff_Hz = float((den[0] / den[n]) ** (1 / n) / (2 * np.pi))
    for shape in ("cascade", "butterworth"):
        tried = Conditioning(cutoff_Hz, n, shape)
        if np.allclose(Known.of(tried).den, den / den[0], rtol=1e-9, atol=0.0):
            return tried
    raise InputError("its known part is no filter that a chain can have", where=model.model.name)
