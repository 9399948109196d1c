"""An identified model: structure, parameters with their covariance, and what it was identified from. Data only."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from calibration.arrays import Array
from calibration.disk import Conditioning
from calibration.errors import InputError
from calibration.estimate import Estimate, rounded
from calibration.finding import Finding, note
from calibration.result import Result, jsonable
from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.rational import Rational, Start, simulate
from tcdyn.identify.data import Hold
from tcdyn.identify.models import Known, Model

if TYPE_CHECKING:
    import control

SCHEMA = "tcdyn.identified/1"


@dataclass(frozen=True)
class Identified(Result):
    """``theta`` all parameters by name; ``covariance`` (P, P) of the free ones in the order of ``model.free``.

    ``offset`` is added to the output; ``statistics`` holds what the table prints; ``sentence`` what validation
    said.
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

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know."""
        return tuple(f.sentence for f in self.findings)

    @property
    def rational(self) -> Rational:
        """The transfer function as factors, the known part included."""
        return self.model.rational(self.theta)

    @property
    def gain(self) -> float:
        """Static gain (of the part before the integrator)."""
        return float(self.rational.num[0])

    @property
    def lag_s(self) -> Estimate:
        """First moment of the impulse response [s], the known part's own included, with its interval."""
        return Estimate.normal(self.lag_at(self.theta), float(np.sqrt(max(self.propagate(self.lag_gradient()), 0.0))))

    def lag_at(self, theta: Mapping[str, float]) -> float:
        """First moment at other parameters: Td + sum of a_1 - b_1/b_0."""
        return self.model.rational(theta).lag_s

    def lag_gradient(self) -> Array:
        """d(lag_s)/d(free parameters), by the chain rule of the coefficients."""
        g, rule = self.rational, self.model.chain_rule(self.theta)
        row = np.zeros(rule.shape[0])
        q = len(g.num)
        if q > 1:
            row[0], row[1] = g.num[1] / g.num[0] ** 2, -1.0 / g.num[0]
        at = q
        for f in g.factors:
            if f.free:
                row[at] = 1.0
                at += len(f.coefs) - 1
        row[-1] = 1.0
        return np.asarray(row @ rule)

    def propagate(self, gradient: Array) -> float:
        """Variance of a quantity with that gradient by the free parameters."""
        return float(gradient @ self.covariance @ gradient)

    def simulate(
        self, u: Array, dt_s: float | None = None, hold: Hold | None = None, start: Start = "equilibrium"
    ) -> Array:
        """The model's output, offset included, for an input (N,) sampled every ``dt_s`` [s] (as identified)."""
        y = simulate(self.rational, np.asarray(u, dtype=float), dt_s or self.dt_s, hold or self.hold, start)
        return y + self.offset

    def transfer_function(self, pade_order: int = 3) -> control.TransferFunction:
        """The model as a ``control.TransferFunction``; the dead time by its Pade form of ``pade_order``."""
        return self.rational.transfer_function(pade_order, inputs=self.input_name, outputs=self.output_name)

    def chain(self, conditioning: Conditioning = NO_CONDITIONING) -> Chain:
        """The identified dynamics as a measurement chain of unit gain; ``conditioning`` is the filter that was the
        known part."""
        p = self.theta
        if self.model.kind != "process" or self.model.integrators:
            raise InputError(f"{self.model.name} is not a chain", expected="a process model without integrator")
        if Known.of(conditioning).den != self.model.known.den:
            raise InputError(
                f"{self.model.name} was identified with another known part", remedy="pass the same conditioning"
            )
        return Chain(
            taus_s=tuple(p[n] for n in ("Tp1", "Tp2", "Tp3") if n in p),
            zero_s=p.get("Tz", 0.0),
            delay_s=p.get("Td", 0.0),
            conditioning=conditioning,
            pair=(p["Tw"], p["Zeta"]) if "Tw" in p else None,
            cement_s=p.get("Tc", 0.0),
        )

    def summary(self) -> str:
        """The parameters with their standard uncertainties, the lag and what validation said."""
        m = self.model
        lines = [f"{m.name}: {self.input_name} -> {self.output_name}, {self.hold.upper()}, dt = {self.dt_s:g} s"]
        lines += [f"  {n} {e.text(m.unit(n))}" for n, e in self.estimates.items()]
        lines += [] if m.integrators else [f"  lag (first moment) {self.lag_s.text('s')}"]
        said = [self.sentence] if self.sentence else []
        return "\n".join([*lines, *(f"  {s}" for s in said), *(f"  warning: {w}" for w in self.warnings)])

    def card(self) -> pd.DataFrame:
        """Free parameters, one row each."""
        rows = []
        for name, e in self.estimates.items():
            value, u = rounded(e.value, e.u)
            low, high = (rounded(end, e.u)[0] for end in (e.low95, e.high95))
            row = {"parameter": name, "value": value, "u": u, "low 95 %": low, "high 95 %": high}
            rows.append({**row, "unit": self.model.unit(name)})
        return pd.DataFrame(rows)

    def to_json(self) -> str:
        """The model as JSON text, complete: :meth:`from_json` gives it back."""
        return json.dumps(self.to_dict(), indent=2)

    def to_dict(self) -> dict[str, Any]:
        """The model as its file holds it."""
        m = self.model
        plain = jsonable(
            {
                "schema": SCHEMA,
                "model": {
                    "name": m.name,
                    "kind": m.kind,
                    "parameters": list(m.names),
                    "integrators": m.integrators,
                    "known": {"num": list(m.known.num), "den": list(m.known.den)},
                    "fixed": dict(m.fixed),
                    "offset": m.offset,
                    "delay_max_s": m.delay_max_s,
                },
                "theta": dict(self.theta),
                "units": {n: m.unit(n) for n in m.names},
                "estimates": {n: e.model_dump() for n, e in self.estimates.items()},
                "covariance": self.covariance.tolist(),
                "lag_s": self.lag_s.model_dump() if not m.integrators else None,
                "offset": self.offset,
                "noise_sd": self.noise_sd,
                "hold": self.hold,
                "dt_s": self.dt_s,
                "input": {"name": self.input_name, "unit": self.input_unit},
                "output": {"name": self.output_name, "unit": self.output_unit},
                "statistics": {k: (v if np.isfinite(v) else None) for k, v in self.statistics.items()},
                "sentence": self.sentence,
                "warnings": list(self.warnings),
                "findings": [f.to_dict() for f in self.findings],
            }
        )
        return dict(plain)

    @classmethod
    def from_json(cls, text: str) -> Identified:
        """The model that :meth:`to_json` wrote; InputError when the text is something else."""
        try:
            d: dict[str, Any] = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"is not JSON ({error})", where="identified model") from error
        if not isinstance(d, dict) or d.get("schema") != SCHEMA:
            raise InputError(
                "is not an identified model", expected=f"schema {SCHEMA}", remedy="tcdyn identify writes it"
            )
        m = d["model"]
        model = Model(
            name=m["name"],
            kind=m["kind"],
            names=tuple(m["parameters"]),
            integrators=m["integrators"],
            known=Known.ratio(m["known"]["num"], m["known"]["den"]),
            fixed=m["fixed"],
            delay_max_s=m["delay_max_s"],
            offset=m["offset"],
        )
        return cls(
            model=model,
            theta=d["theta"],
            covariance=np.array(d["covariance"], dtype=float).reshape(len(model.free), len(model.free)),
            estimates={n: Estimate(**e) for n, e in d["estimates"].items()},
            offset=d["offset"],
            noise_sd=d["noise_sd"],
            hold=d["hold"],
            dt_s=d["dt_s"],
            input_name=d["input"]["name"],
            output_name=d["output"]["name"],
            input_unit=d["input"]["unit"],
            output_unit=d["output"]["unit"],
            statistics={k: (np.nan if v is None else v) for k, v in d["statistics"].items()},
            sentence=d["sentence"],
            findings=tuple(map(Finding.from_dict, d["findings"])) if "findings" in d else said(d["warnings"]),
        )


def said(sentences: list[str]) -> tuple[Finding, ...]:
    """Findings of a file from before there were any."""
    return tuple(note("said", text=text) for text in sentences)


def read_identified(path: str | Path) -> Identified:
    """The model in a JSON file written by ``tcdyn identify``."""
    try:
        return Identified.from_json(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path)) from error
