"""Continuous-time model structures by their usual names, and how their parameters enter the coefficients."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Structure, cement_lags
from tcdyn.chain.rational import Factor, Rational, product
from tcdyn.core import Array, Flags
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning

UNITS = {
    "Kp": "",
    "Tp1": "s",
    "Tp2": "s",
    "Tp3": "s",
    "Tw": "s",
    "Zeta": "",
    "Tz": "s",
    "Tc": "s",
    "Td": "s",
}
SILENT = "-"  # the name of what lets nothing through: an input that is left out
POSITIVE = ("Tp1", "Tp2", "Tp3", "Tw", "Zeta", "Tc")
STEP = 1e-30  # of a parameter along the imaginary axis: coefficients are polynomials, so their slopes are exact


@dataclass(frozen=True)
class Known:
    """A known part of the path, multiplied into the model: num(s) over a product of factors; constant terms one."""

    num: tuple[float, ...] = (1.0,)
    factors: tuple[Factor, ...] = ()

    @property
    def den(self) -> tuple[float, ...]:
        """The product of the factors, ascending in s."""
        return tuple(product(f.coefs for f in self.factors).tolist())

    @classmethod
    def ratio(cls, num: Sequence[float], den: Sequence[float]) -> Known:
        """num(s)/den(s), coefficients ascending."""
        if den[0] == 0:
            raise InputError(
                "the known part has a pole at zero", remedy="use the integrator of the model (P1I)"
            )
        scaled = tuple(float(c / den[0]) for c in den)
        return cls(
            tuple(float(c / den[0]) for c in num),
            (Factor(scaled, free=False),) if len(scaled) > 1 else (),
        )

    @classmethod
    def of(cls, part: Known | Conditioning | object | None) -> Known:
        """From a Conditioning, a ``control.TransferFunction`` or a Known."""
        if part is None:
            return cls()
        if isinstance(part, Known):
            return part
        if isinstance(part, Conditioning):
            return cls(factors=tuple(Factor(f, free=False) for f in part.factors))
        system: Any = part
        return cls.ratio(system.num[0][0][::-1], system.den[0][0][::-1])


@dataclass(frozen=True)
class Model:
    """A structure: names of its parameters, which are fixed at what value, and the known part.

    ``kind`` is "process" (Kp, Tp1, Tp2, Tp3, Tw, Zeta, Tz, Tc, Td) or "tf" (b0.., a1.., Td, with
    G = (b0 + b1 s + ..)/(1 + a1 s + ..)). Build with :func:`process`, :func:`transfer` or :func:`chain_model`.
    ``arx``: what disturbs the output comes in before the poles, and they colour it (equation error).
    """

    name: str
    kind: str
    names: tuple[str, ...]
    integrators: int = 0
    known: Known = field(default_factory=Known)
    fixed: Mapping[str, float] = field(default_factory=dict)
    delay_max_s: float | None = None
    offset: str = "free"
    parts: tuple[Model, ...] = ()
    inputs: tuple[str, ...] = ()
    arx: bool = False

    def __post_init__(self) -> None:
        for name in self.fixed:
            if name not in self.names:
                raise InputError(
                    f"{self.name} has no parameter {name!r} to fix", expected=", ".join(self.names)
                )

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(n for n in self.names if n not in self.fixed)

    @property
    def has_delay(self) -> bool:
        """Whether the dead time is estimated."""
        return "Td" in map(bare, self.free)

    @property
    def order(self) -> int:
        """Number of poles that are estimated (a cement layer counts as one)."""
        if self.parts:
            return max(part.order for part in self.parts)
        return sum(1 if n[:2] in ("Tp", "Tc") else 2 if n == "Tw" else 0 for n in self.names) + sum(
            n.startswith("a") for n in self.names
        )

    def positive(self, name: str) -> bool:
        """Whether a parameter lives on the positive axis, where it is searched by its logarithm."""
        return bare(name) in POSITIVE

    def unit(self, name: str) -> str:
        """Unit of a parameter, s or a power of it."""
        name = bare(name)
        if name in UNITS:
            return UNITS[name]
        power = int(name[1:])
        return "" if power == 0 else "s" if power == 1 else f"s^{power}"

    def full(self, theta: Mapping[str, float]) -> dict[str, float]:
        """All parameters by name, the fixed ones filled in."""
        return {n: float(self.fixed[n]) if n in self.fixed else float(theta[n]) for n in self.names}

    @property
    def logarithms(self) -> Flags:
        """Which of the free parameters (P,) are searched by their logarithm."""
        return np.array([self.positive(n) for n in self.free], dtype=bool)

    def theta(self, x: Array) -> dict[str, float]:
        """All parameters by name at x, which begins with the free ones, or their logarithms."""
        return self.full(
            {n: float(np.exp(v) if self.positive(n) else v) for n, v in zip(self.free, x)}
        )

    def vector(self, theta: Mapping[str, float]) -> Array:
        """The free parameters (P,) in x."""
        return np.array(
            [np.log(max(theta[n], 1e-12)) if self.positive(n) else theta[n] for n in self.free],
            float,
        )

    def box(self, lags_s: tuple[float, float], delay_s: float) -> tuple[Array, Array]:
        """Least and largest of the free parameters (P,) in x, of ``lags_s`` and of a dead time up to ``delay_s``."""
        ends: dict[str, Any] = {"Td": (0.0, delay_s), "Zeta": np.log((1e-3, 20.0))}
        rows = [
            ends.get(bare(n), np.log(lags_s) if self.positive(n) else (-np.inf, np.inf))
            for n in self.free
        ]
        table = np.array(rows, dtype=float).reshape(-1, 2)
        return table[:, 0], table[:, 1]

    def branch(self, k: int) -> tuple[Model, dict[str, str]]:
        """What stands behind the ``k``-th input, and the names in this model of its parameters."""
        if not self.parts:
            return self, {n: n for n in self.names}
        part = self.parts[k]
        names = {n: n if n in self.names else f"{n}.{self.inputs[k]}" for n in part.names}
        return replace(
            part, fixed={n: self.fixed[w] for n, w in names.items() if w in self.fixed}
        ), names

    def coefficients(self, p: Mapping[str, Any]) -> tuple[list[Any], list[tuple[Any, ...]]]:
        """Own numerator and own factors below at the parameters ``p``, ascending in s."""
        if self.kind == "tf":
            below = (1.0, *(p[n] for n in self.names if n.startswith("a")))
            return [p[n] for n in self.names if n.startswith("b")], [below]
        factors: list[tuple[Any, ...]] = [(1.0, p[n]) for n in ("Tp1", "Tp2", "Tp3") if n in p]
        if "Tw" in p:
            factors.append((1.0, 2 * p["Zeta"] * p["Tw"], p["Tw"] ** 2))
        if "Tc" in p:
            factors += [(1.0, p["Tc"] * share) for share in cement_lags()]
        return [p["Kp"], p["Kp"] * p["Tz"]] if "Tz" in p else [p["Kp"]], factors

    def rational(self, theta: Mapping[str, float]) -> Rational:
        """The transfer function at ``theta``."""
        p = self.full(theta)
        num, below = self.coefficients(p)
        factors = self.known.factors + tuple(Factor(f) for f in below)
        return Rational(
            np.convolve(num, self.known.num), factors, p.get("Td", 0.0), self.integrators
        )

    def chain_rule(self, theta: Mapping[str, float]) -> Array:
        """d(coefficients)/d(free parameters), shape (rows, P), rows as in ``Realisation`` without the first."""
        at = self.full(theta)

        def column(p: Mapping[str, Any]) -> list[Any]:
            num, below = self.coefficients(p)
            return [
                *np.convolve(num, self.known.num),
                *(c for f in below for c in f[1:]),
                p.get("Td", 0.0),
            ]

        columns = np.array(
            [column({**at, name: at[name] + 1j * STEP}) for name in self.free], dtype=complex
        )
        return columns.reshape(len(self.free), len(column(at))).T.imag / STEP


def bare(name: str) -> str:
    """A parameter's name without that of its input.

    >>> bare("Tp1.heater")
    'Tp1'
    """
    return name.partition(".")[0]


def suffix(name: str) -> str:
    """What :func:`bare` takes off: the dot and the input's name, or nothing."""
    return name[len(bare(name)) :]


def beside(name: str, other: str) -> bool:
    """Whether two parameters stand behind the same input; those that inputs share stand beside all."""
    return suffix(name) in ("", suffix(other))


def process(name: str, **options: Any) -> Model:
    """A process model by its usual name: P0..P3, then any of U (complex poles), H (half-order cement), Z, D, I.

    ``P2DZ`` is Kp (1 + Tz s) exp(-Td s) / ((1 + Tp1 s)(1 + Tp2 s)); ``P2U`` has 1 + 2 Zeta Tw s + (Tw s)^2 below;
    ``H`` divides by cosh(sqrt(Tc s)), a layer of cement of diffusion time Tc; ``I`` divides by s. Among ``options``
    ``fixed`` holds parameters at a value ({"Kp": 1}), ``known`` is multiplied in (see :meth:`Known.of`),
    ``delay_max_s`` bounds the dead time, ``offset`` is "free" (shared by the runs), "per run" or "none".

    >>> process("P2DZ").names
    ('Kp', 'Tp1', 'Tp2', 'Tz', 'Td')
    """
    structure = Structure.of(name)
    names = ("Kp", *structure.parameters)
    return Model(
        name,
        "process",
        names,
        int(structure.integrator),
        Known.of(options.pop("known", None)),
        **options,
    )


def transfer(
    zeros: int, poles: int, *, delay: bool = False, integrator: bool = False, **options: Any
) -> Model:
    """A general transfer function (b0 + .. + b_zeros s^zeros) / (1 + a1 s + .. + a_poles s^poles).

    ``options`` as for :func:`process`, and ``arx``: the poles colour the disturbance too.

    >>> transfer(1, 2, delay=True).names
    ('b0', 'b1', 'a1', 'a2', 'Td')
    """
    if poles < 1 or zeros < 0 or zeros > poles:
        raise InputError(
            f"transfer: {zeros} zeros over {poles} poles",
            expected="0 <= zeros <= poles, poles >= 1",
        )
    name = f"{'ARX' if options.get('arx') else 'TF'}({zeros},{poles}){'D' if delay else ''}{'I' if integrator else ''}"
    names = (
        *(f"b{i}" for i in range(zeros + 1)),
        *(f"a{j + 1}" for j in range(poles)),
        *(("Td",) if delay else ()),
    )
    return Model(
        name, "tf", names, int(integrator), Known.of(options.pop("known", None)), **options
    )


def chain_model(name: str, conditioning: Conditioning = NO_CONDITIONING, **options: Any) -> Model:
    """A measurement chain: process model ``name`` with unit static gain, no offset, times the conditioning
    filter."""
    return process(
        name, **{"fixed": {"Kp": 1.0}, "offset": "none", "known": conditioning, **options}
    )


def several(
    models: Sequence[Model | str], inputs: Sequence[str], *, common: bool = False, **options: Any
) -> Model:
    """One model for each of the ``inputs``, their outputs added; ``common``: with the same poles behind all of them.

    ``options`` as for :func:`process`, ``fixed`` by names such as "Kp.heater"; ``known`` is behind every input.

    >>> several(["P2D", "P1"], ["heater", "fan"]).names
    ('Kp.heater', 'Tp1.heater', 'Tp2.heater', 'Td.heater', 'Kp.fan', 'Tp1.fan')
    >>> several(["P1D", "P1"], ["heater", "fan"], common=True).names
    ('Kp.heater', 'Tp1', 'Td.heater', 'Kp.fan')
    """
    parts = [as_model(m) for m in models]
    known = Known.of(options.pop("known", None))
    name = f"{' + '.join(part.name for part in parts)}{', common poles' * common}"
    if len(parts) != len(inputs) or not parts:
        raise InputError(f"{len(parts)} models for {len(inputs)} inputs", expected="one for each")
    if any(part.integrators or part.parts for part in parts):
        raise InputError(
            f"{name} integrates or holds sums",
            expected="models without integrator (I) behind each input",
        )
    if len(parts) == 1:
        return replace(parts[0], known=known, **options)
    parts = [part if part.name == SILENT else replace(part, known=known) for part in parts]
    shared = (
        [n for n in parts[0].names if (n[0] in "Ta" and n not in ("Tz", "Td")) or n == "Zeta"]
        if common
        else []
    )
    if common and any({*shared} - {*part.names} or part.order != parts[0].order for part in parts):
        raise InputError(
            f"{name}: the models differ in their poles",
            expected="the same lags in each, as P2D and P2Z",
        )
    if any(part.arx for part in parts) and not (common and all(part.arx for part in parts)):
        raise InputError(
            f"{name}: the poles that colour the noise differ",
            remedy="several([..], names, common=True)",
        )
    names = [n if n in shared else f"{n}.{u}" for part, u in zip(parts, inputs) for n in part.names]
    fixed = {
        n if n in shared else f"{n}.{u}": v
        for part, u in zip(parts, inputs)
        for n, v in part.fixed.items()
    }
    fixed |= options.pop("fixed", {})
    joined = tuple(parts)
    unique = tuple(dict.fromkeys(names))
    arx = parts[0].arx
    return Model(
        name, "sum", unique, 0, known, fixed, parts=joined, inputs=tuple(inputs), arx=arx, **options
    )


def as_model(model: Model | str) -> Model:
    """A Model as it is; a name such as "P2D", "TF(1,2)D" or "ARX(2,2)" by :func:`process` or :func:`transfer`."""
    if isinstance(model, Model):
        return model
    if model == SILENT:
        return Model(SILENT, "process", ("Kp",), fixed={"Kp": 0.0})
    if match := re.match(r"^(TF|ARX)\((\d),(\d)\)(D?)(I?)$", model.replace(" ", "")):
        what = {"delay": bool(match[4]), "integrator": bool(match[5])} | (
            {"arx": True} if match[1] == "ARX" else {}
        )
        return transfer(int(match[2]), int(match[3]), **what)
    return process(model)


def as_template(model: Model, like: Model) -> Model:
    """``model`` with the known part, the offset, the bound of the dead time and the fixed gains of ``like``."""
    gains = {n: v for n, v in like.fixed.items() if bare(n) in ("Kp", "b0") and v != 0.0}
    gains = {
        new: v
        for n, v in gains.items()
        for new in ("Kp" + suffix(n), "b0" + suffix(n))
        if new in model.names
    }
    known = model.known if model.parts else like.known
    return replace(
        model,
        known=known,
        offset=like.offset,
        delay_max_s=like.delay_max_s,
        fixed={**model.fixed, **gains},
    )
