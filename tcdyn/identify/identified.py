"""An identified model: structure, parameters with their covariance, what it was made from; bands of its responses."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.rational import Start, simulate
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate, rounded
from tcdyn.core.findings import Finding, labelled_messages, warning
from tcdyn.core.result import Result, jsonable
from tcdyn.core.spelling import Spelling, as_argument
from tcdyn.identify.iodata import Hold
from tcdyn.identify.models import Known, Model, several, transfer
from tcdyn.identify.responses import Dynamics, percent_times
from tcdyn.rig.disk import Conditioning

if TYPE_CHECKING:
    import control

SCHEMA = "tcdyn.identified/1"
MODEL = (
    "name",
    "kind",
    "integrators",
    "fixed",
    "offset",
    "delay_max_s",
)  # of the model, as they stand in the file
PLAIN = (
    "theta",
    "estimates",
    "covariance",
    "offset",
    "noise_sd",
    "hold",
    "dt_s",
    "statistics",
    "sentence",
)
SHOWN = 6  # correlations of parameters in the summary, the strongest


@dataclass(frozen=True)
class Identified(Dynamics, Result):
    """``theta`` all parameters by name; ``covariance`` (P, P) of the free ones in the order of ``model.free``.

    ``offset`` is added to the output; ``statistics`` holds what the table prints; ``sentence`` what validation said.
    Of a model that is of no record ``dt_s`` is 0.
    """

    model: Model
    theta: Mapping[str, float]
    covariance: Array
    estimates: Mapping[str, Estimate]
    offset: float = 0.0
    noise_sd: float = 0.0
    hold: Hold = "foh"
    dt_s: float = 1.0
    input_name: str = "u"
    output_name: str = "y"
    input_unit: str = ""
    output_unit: str = ""
    statistics: Mapping[str, float] = field(default_factory=dict)
    sentence: str = ""
    findings: tuple[Finding, ...] = ()

    @classmethod
    def of(
        cls, model: Model, theta: Mapping[str, float], covariance: Array, **more: Any
    ) -> Identified:
        """With the intervals of normal distributions of this ``covariance`` (P, P); ``more``: other fields."""
        u = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        estimates = {n: Estimate.normal(theta[n], own) for n, own in zip(model.free, u)}
        return cls(model, theta, covariance, estimates, **more)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know."""
        return tuple(f.sentence for f in self.findings)

    @cached_property
    def parts(self) -> Mapping[str, Identified]:
        """The model behind each input, by the input's name."""
        found = {}
        free = self.model.free
        for k, name in enumerate(self.model.inputs):
            part, names = self.model.branch(k)
            at = [free.index(names[n]) for n in part.free]
            found[name] = replace(
                self,
                model=part,
                theta={n: self.theta[w] for n, w in names.items()},
                covariance=self.covariance[np.ix_(at, at)],
                estimates={n: self.estimates[names[n]] for n in part.free},
                offset=0.0,
                input_name=name,
                statistics={},
                sentence="",
                findings=(),
            )
        return found or {self.input_name: self}

    @property
    def longest_lag_s(self) -> float:
        """The largest lag behind any input [s]; 0 of an integrator, which has none."""
        return (
            0.0 if self.model.integrators else max(part.lag_s.value for part in self.parts.values())
        )

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlations (P, P) of the free parameters' errors."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        names = self.model.free
        return pd.DataFrame(self.covariance / np.outer(sd, sd), index=names, columns=names)

    def simulate(
        self,
        u: Array,
        dt_s: float | None = None,
        hold: Hold | None = None,
        start: Start = "equilibrium",
    ) -> Array:
        """The model's output, offset included, for an input (N,), or inputs (N, K), sampled every ``dt_s`` [s] (as
        identified)."""
        table = np.asarray(u, dtype=float).reshape(len(u), -1)
        if table.shape[1] != len(self.parts):
            raise InputError(
                f"{table.shape[1]} inputs", expected=f"{len(self.parts)}: {self.input_name}"
            )
        if not (dt := dt_s or self.dt_s):
            raise InputError(
                "the model is of no record", expected="the sampling interval", remedy="give dt_s=.."
            )
        each = zip(self.parts.values(), table.T)
        y = sum(simulate(m.rational, v, dt, hold or self.hold, start) for m, v in each)
        return np.asarray(y + self.offset)

    def transfer_function(self, pade_order: int = 3) -> control.TransferFunction:
        """The model as a ``control.TransferFunction``, a row of one entry for each input; dead times by their Pade form
        of ``pade_order``."""
        import control

        named = self.parts.items()
        row = [
            m.rational.transfer_function(pade_order, inputs=n, outputs=self.output_name)
            for n, m in named
        ]
        return row[0] if len(row) == 1 else control.combine_tf([row])

    def state_space(self, pade_order: int = 3) -> control.StateSpace:
        """The model as a ``control.StateSpace``, the offset left out; dead times by their Pade form of
        ``pade_order``."""
        import control

        each = [control.ss(m.rational.transfer_function(pade_order)) for m in self.parts.values()]
        added = control.ss([], [], [], np.ones((1, len(each)))) * control.append(*each)
        return control.ss(added, inputs=list(self.parts), outputs=[self.output_name])

    def chain(self, conditioning: Conditioning = NO_CONDITIONING) -> Chain:
        """The identified dynamics as a measurement chain of unit gain; ``conditioning`` was the known part."""
        p = self.theta
        if self.model.kind != "process" or self.model.integrators:
            raise InputError(
                f"{self.model.name} is not a chain", expected="a process model without integrator"
            )
        given = Known.of(conditioning).den
        own = self.model.known.den
        if len(given) != len(own) or not np.allclose(given, own, rtol=1e-9, atol=0.0):
            raise InputError(
                f"{self.model.name} was identified with another known part",
                remedy="pass the same conditioning",
            )
        return Chain(
            taus_s=tuple(p[n] for n in ("Tp1", "Tp2", "Tp3") if n in p),
            zero_s=p.get("Tz", 0.0),
            delay_s=p.get("Td", 0.0),
            conditioning=conditioning,
            pair=(p["Tw"], p["Zeta"]) if "Tw" in p else None,
            cement_s=p.get("Tc", 0.0),
        )

    def summary(self, spelling: Spelling = as_argument) -> str:
        """The table people read: parameters, the lag, how well it fits, what validation said and was noticed.

        ``spelling``: of the parameters that findings name.
        """
        m = self.model
        s = self.statistics
        wide = max(5, *map(len, m.names)) + 2 * bool(m.inputs)
        how = f"{self.hold.upper()}, dt = {self.dt_s:g} s" if self.dt_s else "given"
        lines = [f"{m.name}: {self.input_name} -> {self.output_name}, {how}"]
        for name, value, u, low, high, unit in self.card().itertuples(index=False):
            lines.append(f"  {name:{wide}s} {value:>12s} +- {u:<9s} [{low}, {high}] {unit}")
        lines += [
            f"  {name:{wide}s} {value:12.5g} (fixed) {m.unit(name)}"
            for name, value in m.fixed.items()
        ]
        table = self.correlation.to_numpy()[: len(m.free) * bool(self.covariance.any())]
        pairs = sorted(combinations(range(len(table)), 2), key=lambda ij: -abs(table[ij]))[:SHOWN]
        said = ", ".join(f"{m.free[i]}-{m.free[j]} {table[i, j]:.2f}" for i, j in pairs)
        lines += [f"  correlations {said}"] if said else []
        if s:
            lines += [
                f"  fit {s['fit_percent']:.2f} %, rms {s['rms']:.4g}, AICc {s['aicc']:.1f}, BIC {s['bic']:.1f}"
            ]
        lines += [f"  {self.sentence}"] if self.sentence else []
        return "\n".join(
            [*lines, *(f"  {line}" for line in labelled_messages(self.findings, spelling))]
        )

    def card(self) -> pd.DataFrame:
        """Free parameters, lag (first moment) and percent times, one row each, with their 95 % intervals."""
        rows = [(name, e, self.model.unit(name)) for name, e in self.estimates.items()]
        for m in self.parts.values() if not self.model.integrators else ():
            if not m.gain:  # an input that is left out
                continue
            end = f".{m.input_name}" if self.model.inputs else ""
            rows += [
                (name + end, e, "s") for name, e in {"lag": m.lag_s, **percent_times(m)}.items()
            ]
        digits = [
            (name, *rounded(e.value, e.u), *(rounded(x, e.u)[0] for x in (e.low95, e.high95)), unit)
            for name, e, unit in rows
        ]
        return pd.DataFrame(
            digits, columns=["quantity", "value", "u", "low 95 %", "high 95 %", "unit"]
        )

    def to_json(self) -> str:
        """The model as JSON text, complete: :meth:`from_json` gives it back."""
        return json.dumps(self.to_dict(), indent=2)

    def to_dict(self) -> dict[str, Any]:
        """The model as its file holds it."""
        m = self.model
        model: dict[str, Any] = {k: getattr(m, k) for k in MODEL}
        if m.inputs:
            model |= {
                "inputs": m.inputs,
                "parts": [{"name": p.name, "kind": p.kind, "names": p.names} for p in m.parts],
            }
        known = {"num": m.known.num, "den": m.known.den}
        lags = {name: part.lag_s for name, part in self.parts.items() if not m.integrators}
        kept: dict[str, Any] = {
            "schema": SCHEMA,
            "model": {**model, "parameters": m.names, "known": known},
            **{k: getattr(self, k) for k in PLAIN},
            "units": {n: m.unit(n) for n in m.names},
            "lag_s": None if m.integrators else lags if m.inputs else self.lag_s,
            "input": {"name": self.input_name, "unit": self.input_unit},
            "output": {"name": self.output_name, "unit": self.output_unit},
            "warnings": self.warnings,
            "findings": [f.to_dict() for f in self.findings],
        }
        return jsonable(kept)

    @classmethod
    def from_json(cls, text: str) -> Identified:
        """The model that :meth:`to_json` wrote; InputError when the text is something else."""
        try:
            d: dict[str, Any] = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"is not JSON ({error})", where="identified model") from error
        if not isinstance(d, dict) or d.get("schema") != SCHEMA:
            expected = f"schema {SCHEMA}"
            remedy = "tcdyn identify writes it"
            raise InputError("is not an identified model", expected=expected, remedy=remedy)
        m = d["model"]
        known = Known.ratio(m["known"]["num"], m["known"]["den"])
        parts = tuple(
            Model(p["name"], p["kind"], tuple(p["names"]), known=known) for p in m.get("parts", ())
        )
        own: dict[str, Any] = {
            "names": tuple(m["parameters"]),
            "inputs": tuple(m.get("inputs", ())),
            "parts": parts,
        }
        model = Model(**{k: m[k] for k in MODEL}, **own, known=known)
        size = len(model.free)
        parsed = {
            "covariance": np.array(d["covariance"], dtype=float).reshape(size, size),
            "estimates": {n: Estimate(**e) for n, e in d["estimates"].items()},
            "statistics": {k: (np.nan if v is None else v) for k, v in d["statistics"].items()},
        }
        findings = [Finding.from_dict(f) for f in d.get("findings", [])]
        if "findings" not in d:  # of version 0.1
            findings = [warning("said", text=text) for text in d["warnings"]]
        return cls(
            model=model,
            **{**{k: d[k] for k in PLAIN}, **parsed},
            **{
                f"{side}_{what}": d[side][what]
                for side in ("input", "output")
                for what in ("name", "unit")
            },
            findings=tuple(findings),
        )


def read_identified(path: str | Path) -> Identified:
    """The model in a JSON file written by ``tcdyn identify``."""
    try:
        return Identified.from_json(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path)) from error


def from_control(
    system: control.TransferFunction | control.StateSpace, delay_s: float | Sequence[float] = 0.0
) -> Identified:
    """A continuous ``control`` system of one output as an :class:`Identified`, without uncertainty.

    ``compare(data, from_control(g), "P2D")`` compares it as it stands; ``fit(data, g.model, start=g.theta)`` begins at
    it. ``delay_s`` is the dead time behind each input, or behind all, which such a system does not hold; inputs without
    labels (u[0], u[1]) are those of the data by their place. Raises InputError for a discrete or unstable system,
    several outputs, no static gain, or more zeros than poles.
    """
    import control

    where = "from_control"
    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise InputError(
            f"is a {type(system).__name__}",
            where=where,
            expected="a TransferFunction or StateSpace",
        )
    if system.isdtime(strict=True) or system.noutputs != 1:
        what = (
            "is discrete in time"
            if system.isdtime(strict=True)
            else f"has {system.noutputs} outputs"
        )
        raise InputError(
            what,
            where=where,
            expected="a continuous system of one output",
            remedy="take system[0, :]",
        )
    delays = np.broadcast_to(np.asarray(delay_s, dtype=float), (system.ninputs,))
    if not (np.isfinite(delays) & (delays >= 0)).all():
        raise InputError(f"delay_s is {delay_s}", where=where, expected="seconds, zero or more")
    parts = []
    values = []
    for k, delay in enumerate(delays):
        one = system[0, k] if system.ninputs > 1 else system
        ratio = control.ss2tf(one).minreal(1e-9) if isinstance(one, control.StateSpace) else one
        num, den = (
            np.trim_zeros(np.asarray(c[0][0], dtype=float), "f")[::-1]
            for c in (ratio.num, ratio.den)
        )
        if not len(num) or abs(num[0]) < 1e-12 * np.max(np.abs(num)):
            raise InputError(
                f"input {k + 1} has a static gain of zero",
                where=where,
                expected="a lag relative to it",
            )
        integrates = abs(den[0]) < 1e-12 * np.max(np.abs(den))
        den = den[1:] if integrates else den
        poles = np.polynomial.polynomial.polyroots(den)
        if len(den) < 2 or len(num) > len(den) or np.any(poles.real >= 0):
            raise InputError(
                f"input {k + 1} has {len(num) - 1} zeros over the poles {np.round(poles, 6).tolist()} 1/s",
                where=where,
                expected="poles in the left half plane (one at zero may be beside them), no more zeros than poles",
            )
        part = transfer(
            max(len(num) - 1, 0), len(den) - 1, delay=bool(delay), integrator=bool(integrates)
        )
        above = num / den[0]
        below = den[1:] / den[0]
        parts.append(part)
        values.append(dict(zip(part.names, [*above, *below, *([float(delay)] if delay else [])])))
    names = tuple(map(str, system.input_labels))
    model = parts[0] if len(parts) == 1 else several(parts, names)
    theta = {
        w: float(values[k][n]) for k in range(len(parts)) for n, w in model.branch(k)[1].items()
    }
    return Identified.of(
        model, theta, np.zeros((len(theta),) * 2), dt_s=0.0, input_name=", ".join(names)
    )
