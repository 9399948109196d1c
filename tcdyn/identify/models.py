"""Continuous-time model structures by their usual names, and how their parameters enter the coefficients."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calibration.disk import Conditioning
from calibration.errors import InputError
from tcdyn.chain import NO_CONDITIONING, cement_lags, conditioning_polynomials
from tcdyn.chain.factors import Array, Factor, Rational

UNITS = {"Kp": "", "Tp1": "s", "Tp2": "s", "Tp3": "s", "Tw": "s", "Zeta": "", "Tz": "s", "Tc": "s", "Td": "s"}
POSITIVE = ("Tp1", "Tp2", "Tp3", "Tw", "Zeta", "Tc")
PATTERN = re.compile(r"^P([0-3])([UHZDI]*)$")


@dataclass(frozen=True)
class Known:
    """A known part of the path, multiplied into the model: num(s)/den(s), ascending, unit constant terms."""

    num: tuple[float, ...] = (1.0,)
    den: tuple[float, ...] = (1.0,)

    @classmethod
    def conditioning(cls, b: Conditioning) -> Known:
        """The conditioning filter B(s)."""
        num, den = conditioning_polynomials(b)
        return cls(tuple(num[::-1] / den[-1]), tuple(den[::-1] / den[-1]))

    @classmethod
    def of(cls, part: Known | Conditioning | object | None) -> Known:
        """From a Conditioning, a ``control.TransferFunction`` or a Known."""
        if part is None:
            return cls()
        if isinstance(part, Known):
            return part
        if isinstance(part, Conditioning):
            return cls.conditioning(part)
        system: Any = part
        num, den = np.array(system.num[0][0], dtype=float), np.array(system.den[0][0], dtype=float)
        if den[-1] == 0:
            raise InputError("the known part has a pole at zero", remedy="use the integrator of the model (P1I)")
        return cls(tuple(num[::-1] / den[-1]), tuple(den[::-1] / den[-1]))


@dataclass(frozen=True)
class Model:
    """A structure: names of its parameters, which are fixed at what value, and the known part.

    ``kind`` is "process" (Kp, Tp1, Tp2, Tp3, Tw, Zeta, Tz, Tc, Td) or "tf" (b0.., a1.., Td, with
    G = (b0 + b1 s + ..)/(1 + a1 s + ..)). Build with :func:`process`, :func:`transfer` or :func:`chain_model`.
    """

    name: str
    kind: str
    names: tuple[str, ...]
    integrators: int = 0
    known: Known = field(default_factory=Known)
    fixed: Mapping[str, float] = field(default_factory=dict)
    delay_max_s: float | None = None
    offset: str = "free"

    def __post_init__(self) -> None:
        for name in self.fixed:
            if name not in self.names:
                raise InputError(f"{self.name} has no parameter {name!r} to fix", expected=", ".join(self.names))

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(n for n in self.names if n not in self.fixed)

    @property
    def has_delay(self) -> bool:
        """Whether the dead time is estimated."""
        return "Td" in self.free

    @property
    def order(self) -> int:
        """Number of poles that are estimated (a cement layer counts as one)."""
        return sum(1 if n[:2] in ("Tp", "Tc") else 2 if n == "Tw" else 0 for n in self.names) + sum(
            n.startswith("a") for n in self.names
        )

    def positive(self, name: str) -> bool:
        """Whether a parameter lives on the positive axis, where it is searched by its logarithm."""
        return name in POSITIVE

    def unit(self, name: str) -> str:
        """Unit of a parameter, s or a power of it."""
        if name in UNITS:
            return UNITS[name]
        power = int(name[1:])
        return "" if power == 0 else "s" if power == 1 else f"s^{power}"

    def full(self, theta: Mapping[str, float]) -> dict[str, float]:
        """All parameters by name, the fixed ones filled in."""
        return {n: float(self.fixed[n]) if n in self.fixed else float(theta[n]) for n in self.names}

    def rational(self, theta: Mapping[str, float]) -> Rational:
        """The transfer function at ``theta``."""
        p = self.full(theta)
        known = np.asarray(self.known.den)
        fixed = (Factor.polynomial(known, free=False),) if len(known) > 1 else ()
        if self.kind == "tf":
            num = np.array([p[n] for n in self.names if n.startswith("b")])
            den = np.array([1.0, *(p[n] for n in self.names if n.startswith("a"))])
            factors: tuple[Factor, ...] = (Factor.polynomial(den),)
        else:
            num = np.array([p["Kp"], p["Kp"] * p["Tz"]] if "Tz" in p else [p["Kp"]])
            factors = tuple(Factor.lag(p[n]) for n in ("Tp1", "Tp2", "Tp3") if n in p)
            if "Tw" in p:
                factors += (Factor.polynomial(np.array([1.0, 2 * p["Zeta"] * p["Tw"], p["Tw"] ** 2])),)
            if "Tc" in p:
                factors += tuple(Factor.lag(p["Tc"] * c) for c in cement_lags())
        return Rational(np.convolve(num, self.known.num), fixed + factors, p.get("Td", 0.0), self.integrators)

    def chain_rule(self, theta: Mapping[str, float]) -> Array:
        """d(coefficients)/d(free parameters), shape (rows, P), rows as in ``Realisation`` without the first."""
        p = self.full(theta)
        columns = []
        for name in self.free:
            num, den, delay = self.derivative(name, p)
            columns.append(np.concatenate([np.convolve(num, self.known.num), den, [delay]]))
        return np.array(columns).T

    def derivative(self, name: str, p: Mapping[str, float]) -> tuple[Array, Array, float]:
        """d(own numerator), d(free denominator coefficients), d(delay) by one parameter."""
        if self.kind == "tf":
            bs = [n for n in self.names if n.startswith("b")]
            avs = [n for n in self.names if n.startswith("a")]
            return (
                np.array([float(n == name) for n in bs]),
                np.array([float(n == name) for n in avs]),
                float(name == "Td"),
            )
        num = np.zeros(2 if "Tz" in p else 1)
        if name == "Kp":
            num[:] = [1.0, p["Tz"]] if "Tz" in p else [1.0]
        if name == "Tz":
            num[1] = p["Kp"]
        den = [float(name == n) for n in ("Tp1", "Tp2", "Tp3") if n in p]
        if "Tw" in p:
            both = {"Tw": [2 * p["Zeta"], 2 * p["Tw"]], "Zeta": [2 * p["Tw"], 0.0]}
            den += both.get(name, [0.0, 0.0])
        if "Tc" in p:
            den += [c * (name == "Tc") for c in cement_lags()]
        return num, np.array(den), float(name == "Td")

    def with_fixed(self, **values: float) -> Model:
        """The same structure with more parameters held at a value."""
        return replace(self, fixed={**self.fixed, **values})


def process(
    name: str,
    *,
    fixed: Mapping[str, float] | None = None,
    known: Known | Conditioning | object | None = None,
    delay_max_s: float | None = None,
    offset: str = "free",
) -> Model:
    """A process model by its usual name: P0..P3, then any of U (complex poles), H (half-order cement), Z, D, I.

    ``P2DZ`` is Kp (1 + Tz s) exp(-Td s) / ((1 + Tp1 s)(1 + Tp2 s)); ``P2U`` has 1 + 2 Zeta Tw s + (Tw s)^2 below;
    ``H`` divides by cosh(sqrt(Tc s)), a layer of cement of diffusion time Tc; ``I`` divides by s. ``fixed`` holds
    parameters at a value ({"Kp": 1}), ``known`` is multiplied in, ``offset`` is "free" (shared by the runs),
    "per run" or "none".

    >>> process("P2DZ").names
    ('Kp', 'Tp1', 'Tp2', 'Tz', 'Td')
    """
    match = PATTERN.match(name)
    if match is None or len(set(match[2])) < len(match[2]):
        raise InputError(
            f"there is no process model {name!r}",
            expected="P0, P1, P2 or P3 followed by letters of U, H, Z, D, I, such as P2DZ",
        )
    poles, letters = int(match[1]), match[2]
    if "U" in letters and poles < 2:
        raise InputError(f"{name}: complex poles need at least two", remedy="use P2U or P3U")
    if poles == 0 and "H" not in letters and "I" not in letters and "Z" in letters:
        raise InputError(f"{name}: a zero without a pole cannot be simulated", remedy="use P1Z")
    if "U" in letters:
        names = ("Kp", "Tw", "Zeta") + (("Tp3",) if poles == 3 else ())
    else:
        names = ("Kp", *(f"Tp{i + 1}" for i in range(poles)))
    names += tuple(n for letter, n in (("H", "Tc"), ("Z", "Tz"), ("D", "Td")) if letter in letters)
    order = {n: i for i, n in enumerate(UNITS)}
    return Model(
        name=name,
        kind="process",
        names=tuple(sorted(names, key=lambda n: order[n])),
        integrators=int("I" in letters),
        known=Known.of(known),
        fixed=dict(fixed or {}),
        delay_max_s=delay_max_s,
        offset=offset,
    )


def transfer(
    zeros: int,
    poles: int,
    *,
    delay: bool = False,
    integrator: bool = False,
    fixed: Mapping[str, float] | None = None,
    known: Known | Conditioning | object | None = None,
    delay_max_s: float | None = None,
    offset: str = "free",
) -> Model:
    """A general transfer function (b0 + .. + b_zeros s^zeros) / (1 + a1 s + .. + a_poles s^poles).

    >>> transfer(1, 2, delay=True).names
    ('b0', 'b1', 'a1', 'a2', 'Td')
    """
    if poles < 1 or zeros < 0 or zeros > poles:
        raise InputError(f"transfer: {zeros} zeros over {poles} poles", expected="0 <= zeros <= poles, poles >= 1")
    names = tuple(f"b{i}" for i in range(zeros + 1)) + tuple(f"a{j + 1}" for j in range(poles))
    return Model(
        name=f"TF({zeros},{poles}){'D' if delay else ''}{'I' if integrator else ''}",
        kind="tf",
        names=names + (("Td",) if delay else ()),
        integrators=int(integrator),
        known=Known.of(known),
        fixed=dict(fixed or {}),
        delay_max_s=delay_max_s,
        offset=offset,
    )


def chain_model(name: str, conditioning: Conditioning = NO_CONDITIONING, **options: object) -> Model:
    """A measurement chain: process model ``name`` with unit static gain, no offset, times the conditioning
    filter."""
    settings = {"fixed": {"Kp": 1.0}, "offset": "none", "known": conditioning, **options}
    return process(name, **settings)  # type: ignore[arg-type]


def as_model(model: Model | str) -> Model:
    """A Model as it is; a name such as "P2D" or "TF(1,2)D" by :func:`process` or :func:`transfer`."""
    if isinstance(model, Model):
        return model
    match = re.match(r"^TF\((\d),(\d)\)(D?)(I?)$", model.replace(" ", ""))
    if match:
        return transfer(int(match[1]), int(match[2]), delay=bool(match[3]), integrator=bool(match[4]))
    return process(model)
