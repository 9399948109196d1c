"""An identified model: structure, parameters with their covariance, what it was made from; bands of its responses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from calibration import Array
from calibration.disk import Conditioning
from calibration.errors import InputError
from calibration.estimate import Z95, Estimate, rounded
from calibration.finding import Finding, look
from calibration.result import Result, jsonable
from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.rational import Rational, Start, realise, simulate, simulate_rows
from tcdyn.identify.data import Hold
from tcdyn.identify.models import Known, Model

if TYPE_CHECKING:
    import control

SCHEMA = "tcdyn.identified/1"
MODEL = ("name", "kind", "integrators", "fixed", "offset", "delay_max_s")  # of the model, as they stand in the file
PLAIN = ("theta", "estimates", "covariance", "offset", "noise_sd", "hold", "dt_s", "statistics", "sentence")
SHOWN = 6  # correlations of parameters in the summary, the strongest
PERCENT_TIMES = {"t50": 0.5, "t63.2": 1 - float(np.exp(-1)), "t90": 0.9}


@dataclass(frozen=True)
class Identified(Result):
    """``theta`` all parameters by name; ``covariance`` (P, P) of the free ones in the order of ``model.free``.

    ``offset`` is added to the output; ``statistics`` holds what the table prints; ``sentence`` what validation said.
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

    @cached_property
    def lag_s(self) -> Estimate:
        """First moment of the impulse response [s], the known part's own included, with its interval.

        Td + sum of a_1 - b_1/b_0, and by the chain rule of the coefficients its derivatives with the free parameters.
        """
        g = self.rational
        row = [g.num[1] / g.num[0] ** 2, -1.0 / g.num[0]] if len(g.num) > 1 else []
        row += [0.0] * (len(g.num) - len(row))
        for f in g.factors:
            row += [1.0, *[0.0] * (len(f.coefs) - 2)] if f.free else []
        slopes = np.asarray([*row, 1.0] @ self.model.chain_rule(self.theta))
        return Estimate.normal(g.lag_s, float(self.u_of(slopes[:, None])[0]))

    def u_of(self, slopes: Array) -> Array:
        """Standard uncertainties (N,) of quantities with these ``slopes`` (P, N) by the free parameters."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("pn,pq,qn->n", slopes, self.covariance, slopes), 0.0)))

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlations (P, P) of the free parameters' errors."""
        sd, names = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300)), self.model.free
        return pd.DataFrame(self.covariance / np.outer(sd, sd), index=names, columns=names)

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
        """The identified dynamics as a measurement chain of unit gain; ``conditioning`` was the known part."""
        p = self.theta
        if self.model.kind != "process" or self.model.integrators:
            raise InputError(f"{self.model.name} is not a chain", expected="a process model without integrator")
        given, own = Known.of(conditioning).den, self.model.known.den
        if len(given) != len(own) or not np.allclose(given, own, rtol=1e-9, atol=0.0):
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
        """The table people read: parameters, the lag, how well it fits, what validation said and was noticed."""
        m, s = self.model, self.statistics
        lines = [f"{m.name}: {self.input_name} -> {self.output_name}, {self.hold.upper()}, dt = {self.dt_s:g} s"]
        for name, value, u, low, high, unit in self.card().itertuples(index=False):
            lines.append(f"  {name:5s} {value:>12s} +- {u:<9s} [{low}, {high}] {unit}")
        lines += [f"  {name:5s} {value:12.5g} (fixed) {m.unit(name)}" for name, value in m.fixed.items()]
        table = self.correlation.to_numpy()
        pairs = sorted(combinations(range(len(table)), 2), key=lambda ij: -abs(table[ij]))[:SHOWN]
        said = ", ".join(f"{m.free[i]}-{m.free[j]} {table[i, j]:.2f}" for i, j in pairs)
        lines += [f"  correlations {said}"] if said else []
        if s:
            lines += [f"  fit {s['fit_percent']:.2f} %, rms {s['rms']:.4g}, AICc {s['aicc']:.1f}, BIC {s['bic']:.1f}"]
        lines += [f"  {self.sentence}"] if self.sentence else []
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])

    def card(self) -> pd.DataFrame:
        """Free parameters, lag (first moment) and percent times, one row each, with their 95 % intervals."""
        rows = [(name, e, self.model.unit(name)) for name, e in self.estimates.items()]
        if not self.model.integrators:
            rows += [(name, e, "s") for name, e in {"lag": self.lag_s, **percent_times(self)}.items()]
        digits = [
            (name, *rounded(e.value, e.u), *(rounded(x, e.u)[0] for x in (e.low95, e.high95)), unit)
            for name, e, unit in rows
        ]
        return pd.DataFrame(digits, columns=["quantity", "value", "u", "low 95 %", "high 95 %", "unit"])

    def to_json(self) -> str:
        """The model as JSON text, complete: :meth:`from_json` gives it back."""
        return json.dumps(self.to_dict(), indent=2)

    def to_dict(self) -> dict[str, Any]:
        """The model as its file holds it."""
        m = self.model
        known = {"num": m.known.num, "den": m.known.den}
        kept: dict[str, Any] = {
            "schema": SCHEMA,
            "model": {**{k: getattr(m, k) for k in MODEL}, "parameters": m.names, "known": known},
            **{k: getattr(self, k) for k in PLAIN},
            "units": {n: m.unit(n) for n in m.names},
            "lag_s": self.lag_s if not m.integrators else None,
            "input": {"name": self.input_name, "unit": self.input_unit},
            "output": {"name": self.output_name, "unit": self.output_unit},
            "warnings": self.warnings,
            "findings": [f.to_dict() for f in self.findings],
        }
        return dict(jsonable(kept))

    @classmethod
    def from_json(cls, text: str) -> Identified:
        """The model that :meth:`to_json` wrote; InputError when the text is something else."""
        try:
            d: dict[str, Any] = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"is not JSON ({error})", where="identified model") from error
        if not isinstance(d, dict) or d.get("schema") != SCHEMA:
            expected, remedy = f"schema {SCHEMA}", "tcdyn identify writes it"
            raise InputError("is not an identified model", expected=expected, remedy=remedy)
        m = d["model"]
        known = Known.ratio(m["known"]["num"], m["known"]["den"])
        model = Model(**{k: m[k] for k in MODEL}, names=tuple(m["parameters"]), known=known)
        size = len(model.free)
        parsed = {
            "covariance": np.array(d["covariance"], dtype=float).reshape(size, size),
            "estimates": {n: Estimate(**e) for n, e in d["estimates"].items()},
            "statistics": {k: (np.nan if v is None else v) for k, v in d["statistics"].items()},
        }
        findings = [Finding.from_dict(f) for f in d.get("findings", [])]
        if "findings" not in d:  # of version 0.1
            findings = [look("said", text=text) for text in d["warnings"]]
        return cls(
            model=model,
            **{**{k: d[k] for k in PLAIN}, **parsed},
            **{f"{side}_{what}": d[side][what] for side in ("input", "output") for what in ("name", "unit")},
            findings=tuple(findings),
        )


def read_identified(path: str | Path) -> Identified:
    """The model in a JSON file written by ``tcdyn identify``."""
    try:
        return Identified.from_json(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path)) from error


@dataclass(frozen=True)
class Band:
    """``value`` over ``x`` with standard uncertainty ``u``; the 95 % band is value -+ 1.96 u."""

    x: Array
    value: Array
    u: Array

    @property
    def low95(self) -> Array:
        """Lower edge."""
        return np.asarray(self.value - Z95 * self.u)

    @property
    def high95(self) -> Array:
        """Upper edge."""
        return np.asarray(self.value + Z95 * self.u)


@dataclass(frozen=True)
class BodeBand:
    """Magnitude [dB] and phase [deg] over frequency [Hz]."""

    magnitude_dB: Band
    phase_deg: Band


def step_rows(model: Identified, time_s: Array) -> tuple[Array, Array]:
    """Unit step response (N,) at even times ``time_s`` from 0, its derivatives by the free parameters (P, N)."""
    g, dt = model.rational, float(time_s[1] - time_s[0])
    rows = simulate_rows(realise(g), np.ones(len(time_s)), dt, g.delay_s, "zoh", "zero")
    return rows[0], model.model.chain_rule(model.theta).T @ rows[1:]


def step_times(model: Identified, count: int = 1200) -> Array:
    """An even time grid [s] that holds the whole step response."""
    g = model.rational
    slowest = max((float(1 / np.min(np.abs(f.poles.real))) for f in g.factors), default=1.0)
    return np.linspace(0.0, g.delay_s + 8 * slowest, count + 1)


def step_band(model: Identified, time_s: Array | None = None) -> Band:
    """The unit step response with its band, by first-order propagation of the covariance."""
    t = step_times(model, 400) if time_s is None else np.asarray(time_s, dtype=float)
    y, j = step_rows(model, t)
    return Band(t, y, model.u_of(j))


def percent_times(model: Identified) -> dict[str, Estimate]:
    """t50, t63.2 and t90 [s]: when the unit step response first passes that share of its end value (VDI/VDE 3522).

    dt_q = -d(y/K)/dtheta / slope at the crossing. Raises InputError for an integrating model, which has no end value.
    """
    if model.model.integrators:
        raise InputError(f"{model.model.name} integrates: its step response has no final value")
    t = step_times(model, 4000)
    y, j = step_rows(model, t)
    share = y / model.gain
    derivative = (j - np.outer(model.model.chain_rule(model.theta)[0], share)) / model.gain
    slope = np.gradient(share, t)
    out = {}
    for name, q in PERCENT_TIMES.items():
        i = max(int(np.argmax(share >= q)), 1)
        at = float(np.interp(q, share[i - 1 : i + 1], t[i - 1 : i + 1]))
        steep = max(float(np.interp(at, t, slope)), 1e-12)
        slopes = -np.array([[np.interp(at, t, row)] for row in derivative]) / steep
        out[name] = Estimate.normal(at, float(model.u_of(slopes)[0]))
    return out


def bode_band(model: Identified, frequency_Hz: Array | None = None) -> BodeBand:
    """Magnitude and phase with their bands; by default two decades either side of the slowest corner.

    d(20 lg|G|) = 20/ln 10 Re(dG/G), d(phase) = Im(dG/G).
    """
    g = model.rational
    if frequency_Hz is None:
        corner = 1 / (2 * np.pi * max(g.lag_s, model.dt_s)) if not g.integrators else 0.1 / model.dt_s
        frequency_Hz = np.geomspace(corner / 100, min(corner * 100, 0.5 / model.dt_s), 200)
    f = np.asarray(frequency_Hz, dtype=float)
    value = g.frequency_response(f)
    relative = model.model.chain_rule(model.theta).T @ (g.frequency_sensitivity(f) / value)
    return BodeBand(
        Band(f, 20 * np.log10(np.abs(value)), model.u_of(20 / np.log(10) * relative.real)),
        Band(f, np.degrees(np.unwrap(np.angle(value))), model.u_of(np.degrees(relative.imag))),
    )
