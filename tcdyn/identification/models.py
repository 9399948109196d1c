"""Continuous-time model structures with dead time: process models and transfer functions.

Structures are named as usual (P1D, P2DZ, TF(1,2)D, ARX(1,2)). Each knows how its parameters enter
the coefficients of the transfer function. All of ``tcdyn.identification`` uses them;
``tcdyn.chain.ChainStructure`` reads the names of process models.
``tests/identify/test_identify_fit.py`` recovers every structure,
``tests/identify/test_identify_several.py`` sums of several inputs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Chain, ChainStructure, cement_lags
from tcdyn.chain.rational import Factor, Rational, polynomial_product
from tcdyn.core import Array, Flags
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.rig.disk import Conditioning

# Units of the parameters of process models.
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
NO_MODEL = "-"  # name of the model of an input without effect
# Parameters that are positive; the search uses their logarithm.
POSITIVE = ("Tp1", "Tp2", "Tp3", "Tw", "Zeta", "Tc")
# Imaginary step of a parameter: coefficients are polynomials, so that their derivatives are exact.
COMPLEX_STEP = 1e-30
DAMPING_BOUNDS = (1e-3, 20.0)  # of Zeta, chosen by judgement
MIN_POSITIVE = 1e-12  # smallest value of a parameter that is searched by its logarithm


@dataclass(frozen=True)
class KnownDynamics:
    """A known factor of the transfer function, num(s) over a product of factors.

    Parameters
    ----------
    num
        Numerator, ascending in s; the constant term is one for a filter.
    factors
        Denominator factors of constant term one, not estimated.
    delay_s
        Dead time [s].
    """

    num: tuple[float, ...] = (1.0,)
    factors: tuple[Factor, ...] = ()
    delay_s: float = 0.0

    @property
    def den(self) -> tuple[float, ...]:
        """The product of the factors, ascending in s."""
        return tuple(polynomial_product(f.coefs for f in self.factors).tolist())

    @classmethod
    def ratio(cls, num: Sequence[float], den: Sequence[float]) -> KnownDynamics:
        """Build the factor num(s)/den(s).

        Parameters
        ----------
        num, den
            Coefficients, ascending in s; both are divided by ``den[0]``.

        Returns
        -------
        KnownDynamics
            The factor.

        Raises
        ------
        InputError
            For a pole at zero.
        """
        if den[0] == 0:
            raise InputError(
                "the known part has a pole at zero", remedy="use the integrator of the model (P1I)"
            )
        numerator = tuple(float(c / den[0]) for c in num)
        denominator = tuple(float(c / den[0]) for c in den)
        if len(denominator) == 1:
            return cls(numerator)
        return cls(numerator, (Factor(denominator, free=False),))

    @classmethod
    def of(cls, part: KnownDynamics | Conditioning | object | None) -> KnownDynamics:
        """From a Conditioning, a Chain, a ``control.TransferFunction`` or a KnownDynamics."""
        if part is None:
            return cls()
        if isinstance(part, KnownDynamics):
            return part
        if isinstance(part, Conditioning):
            return cls(factors=tuple(Factor(f, free=False) for f in part.factors))
        if isinstance(part, Chain):
            rational = part.rational
            factors = tuple(replace(f, free=False) for f in rational.factors)
            return cls(tuple(np.asarray(rational.num, dtype=float)), factors, rational.delay_s)
        system: Any = part
        return cls.ratio(system.num[0][0][::-1], system.den[0][0][::-1])

    def times(self, other: KnownDynamics) -> KnownDynamics:
        """Return the product of two known factors."""
        num = tuple(np.convolve(self.num, other.num).tolist())
        return KnownDynamics(num, self.factors + other.factors, self.delay_s + other.delay_s)


@dataclass(frozen=True)
class Model:
    """A model structure. Build it with :func:`process`, :func:`transfer` or :func:`chain_model`.

    Parameters
    ----------
    name
        Usual name of the structure.
    kind
        "process" (parameters Kp, Tp1, Tp2, Tp3, Tw, Zeta, Tz, Tc, Td), "tf" (b0.., a1.., Td, with
        G = (b0 + b1 s + ..)/(1 + a1 s + ..)), or "sum" of one model for each input.
    names
        Names of the parameters.
    integrators
        Number of integrators.
    known
        Known factor of the transfer function.
    fixed
        Parameters that are not estimated, with their values.
    delay_max_s
        Upper bound of the dead time [s].
    offset
        "free" (shared by the runs), "per run" or "none".
    submodels
        Of a sum, the model of each input.
    inputs
        Of a sum, the names of the inputs.
    arx
        Whether the disturbance enters before the poles, so that they colour it (equation error).

    Notes
    -----
    A new parameter of process models needs an entry in ``UNITS``, perhaps in ``POSITIVE``, a term
    in :meth:`coefficients`, a name in ``tcdyn.chain.ChainStructure`` and starting values in
    ``tcdyn.identification.starting_values.share_lag``. A positive one that is no lag needs a branch
    in :meth:`bounds` too; otherwise it gets the bounds of a lag without a message.
    ``tests/identify/test_identify_fit.py`` then must recover it without a start.
    """

    name: str
    kind: str
    names: tuple[str, ...]
    integrators: int = 0
    known: KnownDynamics = field(default_factory=KnownDynamics)
    fixed: Mapping[str, float] = field(default_factory=dict)
    delay_max_s: float | None = None
    offset: str = "free"
    submodels: tuple[Model, ...] = ()
    inputs: tuple[str, ...] = ()
    arx: bool = False

    def __post_init__(self) -> None:
        """Check that the fixed parameters exist.

        Raises
        ------
        InputError
            For a fixed parameter that the model does not have.
        """
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
        return "Td" in map(base_name, self.free)

    @property
    def order(self) -> int:
        """Number of estimated poles (a cement layer counts as one); the largest of a sum."""
        if self.submodels:
            return max(model.order for model in self.submodels)
        order = 0
        for name in self.names:
            if name[:2] in ("Tp", "Tc") or name.startswith("a"):
                order += 1
            elif name == "Tw":
                order += 2
        return order

    def is_positive(self, name: str) -> bool:
        """Whether a parameter is positive; the search then uses its logarithm."""
        return base_name(name) in POSITIVE

    def unit(self, name: str) -> str:
        """Unit in time of a parameter: s, a power of it, or "".

        The gain and the coefficients b also have the unit of output over input.
        """
        name = base_name(name)
        if name in UNITS:
            return UNITS[name]
        power = int(name[1:])
        if power == 0:
            return ""
        return "s" if power == 1 else f"s^{power}"

    def all_parameters(self, theta: Mapping[str, float]) -> dict[str, float]:
        """All parameters by name: the fixed ones, and the others from ``theta``."""
        return {n: float(self.fixed[n] if n in self.fixed else theta[n]) for n in self.names}

    @property
    def is_logarithm(self) -> Flags:
        """Which of the free parameters (P,) the search represents by their logarithm."""
        return np.array([self.is_positive(n) for n in self.free], dtype=bool)

    def natural_scale(self, x: Array) -> Array:
        """Return d(natural parameter)/dx (P,): the parameter for a logarithm, else one."""
        return np.exp(np.where(self.is_logarithm, x, 0.0))

    def theta(self, x: Array) -> dict[str, float]:
        """Return all parameters by name at a vector x.

        Parameters
        ----------
        x
            Vector that starts with the free parameters, positive ones as logarithms.

        Returns
        -------
        dict
            Natural parameters, the fixed ones included.
        """
        free = {n: float(np.exp(v) if self.is_positive(n) else v) for n, v in zip(self.free, x)}
        return self.all_parameters(free)

    def as_x(self, name: str, value: float) -> float:
        """Return the value of a parameter as in x: the logarithm of a positive one.

        Positive parameters below ``MIN_POSITIVE`` are set to it.
        """
        return float(np.log(max(value, MIN_POSITIVE))) if self.is_positive(name) else value

    def vector(self, theta: Mapping[str, float]) -> Array:
        """Return the free parameters as in x (:meth:`as_x`).

        The inverse of :meth:`theta`.

        Parameters
        ----------
        theta
            Parameters by name.

        Returns
        -------
        array
            The vector (P,).
        """
        return np.array([self.as_x(n, theta[n]) for n in self.free], dtype=float)

    def bounds(self, lags_s: tuple[float, float], delay_s: float) -> tuple[Array, Array]:
        """Lower and upper bounds of the free parameters (P,) as in x.

        Parameters
        ----------
        lags_s
            Shortest and longest lag [s].
        delay_s
            Longest dead time [s].

        Returns
        -------
        lower, upper
            Bounds (P,), infinite where there is none; logarithms where :meth:`is_positive`.

        Notes
        -----
        The dead time is between 0 and ``delay_s``, Zeta in ``DAMPING_BOUNDS``, every other positive
        parameter in ``lags_s``; the others have no bounds. ``DAMPING_BOUNDS`` may change. What is a
        logarithm must agree with :meth:`theta` and :meth:`vector`. Guarded by
        ``test_sum_of_models_has_order_bounds_and_scale_per_input`` in
        ``tests/identify/test_identify_closed_forms.py`` (lag, dead time and gain; not Zeta).
        """
        rows: list[tuple[float, ...]] = []
        for name in self.free:
            if base_name(name) == "Td":
                rows.append((0.0, delay_s))
            elif base_name(name) == "Zeta":
                rows.append(tuple(np.log(DAMPING_BOUNDS)))
            elif self.is_positive(name):
                rows.append(tuple(np.log(lags_s)))
            else:
                rows.append((-np.inf, np.inf))
        table = np.array(rows, dtype=float).reshape(-1, 2)
        return table[:, 0], table[:, 1]

    def branch(self, k: int) -> tuple[Model, dict[str, str]]:
        """Return the model of one input, and the names of its parameters in this model.

        Parameters
        ----------
        k
            Number of the input; ignored for a model of one input.

        Returns
        -------
        model
            The model of that input.
        names
            By the name in that model, the name in this one.
        """
        if not self.submodels:
            return self, {n: n for n in self.names}
        model = self.submodels[k]
        names = {n: n if n in self.names else f"{n}.{self.inputs[k]}" for n in model.names}
        fixed = {n: self.fixed[full] for n, full in names.items() if full in self.fixed}
        return replace(model, fixed=fixed), names

    def coefficients(self, theta: Mapping[str, Any]) -> tuple[list[Any], list[tuple[Any, ...]]]:
        """Return numerator and denominator factors without the known ones.

        Parameters
        ----------
        theta
            All parameters by name; complex values are allowed.

        Returns
        -------
        num
            Numerator coefficients, ascending in s.
        factors
            Denominator factors, each ascending in s with constant term one.

        Notes
        -----
        The coefficients must be polynomials of the parameters: :meth:`chain_rule` differentiates
        them by a complex step. The lags come first and in the order of their names, on which
        ``tcdyn.identification.level_lag.LevelLagProblem.output_change`` relies.
        """
        if self.kind == "tf":
            denominator = (1.0, *(theta[n] for n in self.names if n.startswith("a")))
            return [theta[n] for n in self.names if n.startswith("b")], [denominator]
        factors: list[tuple[Any, ...]] = [
            (1.0, theta[n]) for n in ("Tp1", "Tp2", "Tp3") if n in theta
        ]
        if "Tw" in theta:
            factors.append((1.0, 2 * theta["Zeta"] * theta["Tw"], theta["Tw"] ** 2))
        if "Tc" in theta:
            factors += [(1.0, theta["Tc"] * share) for share in cement_lags()]
        if "Tz" in theta:
            return [theta["Kp"], theta["Kp"] * theta["Tz"]], factors
        return [theta["Kp"]], factors

    def rational(self, theta: Mapping[str, float]) -> Rational:
        """Return the transfer function at ``theta``, the known factor included."""
        p = self.all_parameters(theta)
        num, free_factors = self.coefficients(p)
        factors = self.known.factors + tuple(Factor(f) for f in free_factors)
        delay_s = p.get("Td", 0.0) + self.known.delay_s
        return Rational(np.convolve(num, self.known.num), factors, delay_s, self.integrators)

    def chain_rule(self, theta: Mapping[str, float]) -> Array:
        """Return the derivatives of all coefficients with the free parameters.

        The rows are those of ``Realisation`` without the first.

        Parameters
        ----------
        theta
            Parameters by name.

        Returns
        -------
        array
            Derivatives (rows, P). The rows are those of ``Realisation`` without the first:
            numerator, free factors, dead time.

        Notes
        -----
        The imaginary step has no subtraction and so no rounding error.
        ``tests/identify/test_identify_results.py`` compares the frequency sensitivities, which are
        multiplied by it, with central differences.
        """
        parameters = self.all_parameters(theta)

        def coefficients(theta: Mapping[str, Any]) -> list[Any]:
            """Return all coefficients in the order of the rows."""
            num, factors = self.coefficients(theta)
            below = [c for factor in factors for c in factor[1:]]
            return [*np.convolve(num, self.known.num), *below, theta.get("Td", 0.0)]

        columns = []
        for name in self.free:
            complex_step = {**parameters, name: parameters[name] + 1j * COMPLEX_STEP}
            columns.append(coefficients(complex_step))
        table = np.array(columns, dtype=complex)
        n_rows = len(coefficients(parameters))
        return table.reshape(len(self.free), n_rows).T.imag / COMPLEX_STEP


def behind_known(model: Model, known: KnownDynamics) -> Model:
    """Return the model with a further known factor behind each input."""
    submodels = [
        part if part.name == NO_MODEL else behind_known(part, known) for part in model.submodels
    ]
    return replace(model, known=model.known.times(known), submodels=tuple(submodels))


def with_known(model: Model, known: KnownDynamics) -> Model:
    """Return the model with another known factor in place of its own behind each input."""
    submodels = [
        part if part.name == NO_MODEL else with_known(part, known) for part in model.submodels
    ]
    return replace(model, known=known, submodels=tuple(submodels))


def base_name(name: str) -> str:
    """A parameter's name without that of its input.

    >>> base_name("Tp1.heater")
    'Tp1'
    """
    return name.partition(".")[0]


def input_suffix(name: str) -> str:
    """The dot and the input's name at the end of a parameter's name, or nothing."""
    return name[len(base_name(name)) :]


def same_input(name: str, other: str) -> bool:
    """Whether two parameters belong to the same input; shared ones belong to every input."""
    return input_suffix(name) in ("", input_suffix(other))


@with_named_arguments
def process(name: str, **options: Any) -> Model:
    """A process model by its usual name: P0..P3, then any of U, H, Z, D, I.

    Parameters
    ----------
    name
        P and the number of lags. U: complex pair of poles. H: half-order cement layer. Z: zero.
        D: dead time. I: integrator.
    options
        ``fixed``: parameters that are not estimated, with their values ({"Kp": 1}).
        ``known``: a known factor (see :meth:`KnownDynamics.of`).
        ``delay_max_s``: upper bound of the dead time [s].
        ``offset``: "free" (shared by the runs), "per run" or "none".

    Returns
    -------
    Model
        The structure.

    Raises
    ------
    InputError
        For a name that is no process model.

    Notes
    -----
    ``P2DZ`` is Kp (1 + Tz s) exp(-Td s) / ((1 + Tp1 s)(1 + Tp2 s)). ``P2U`` has the denominator
    1 + 2 Zeta Tw s + (Tw s)^2. ``H`` divides by cosh(sqrt(Tc s)), a layer of cement of diffusion
    time Tc. ``I`` divides by s.

    Examples
    --------
    >>> process("P2DZ").names
    ('Kp', 'Tp1', 'Tp2', 'Tz', 'Td')
    """
    structure = ChainStructure.from_name(name)
    names = ("Kp", *structure.parameters)
    known = KnownDynamics.of(options.pop("known", None))
    return Model(name, "process", names, int(structure.integrator), known, **options)


@with_named_arguments
def transfer(
    zeros: int, poles: int, *, delay: bool = False, integrator: bool = False, **options: Any
) -> Model:
    """A transfer function (b0 + .. + b_zeros s^zeros) / (1 + a1 s + .. + a_poles s^poles).

    Parameters
    ----------
    zeros, poles
        Degrees of numerator and denominator.
    delay
        Whether it has a dead time Td.
    integrator
        Whether it is divided by s.
    options
        As for :func:`process`, and ``arx``: the poles colour the disturbance too.

    Returns
    -------
    Model
        The structure.

    Raises
    ------
    InputError
        For other than 0 <= zeros <= poles, poles >= 1.

    Examples
    --------
    >>> transfer(1, 2, delay=True).names
    ('b0', 'b1', 'a1', 'a2', 'Td')
    """
    if poles < 1 or zeros < 0 or zeros > poles:
        raise InputError(
            f"transfer: {zeros} zeros over {poles} poles",
            expected="0 <= zeros <= poles, poles >= 1",
        )
    kind = "ARX" if options.get("arx") else "TF"
    name = f"{kind}({zeros},{poles}){'D' if delay else ''}{'I' if integrator else ''}"
    names = [f"b{i}" for i in range(zeros + 1)]
    names += [f"a{j + 1}" for j in range(poles)]
    if delay:
        names.append("Td")
    known = KnownDynamics.of(options.pop("known", None))
    return Model(name, "tf", tuple(names), int(integrator), known, **options)


@with_named_arguments
def chain_model(name: str, conditioning: Conditioning = NO_CONDITIONING, **options: Any) -> Model:
    """Return the model of a measurement chain: unit gain and no offset.

    Parameters
    ----------
    name
        Name of the process model.
    conditioning
        Conditioning filter, the known factor.
    options
        As for :func:`process`; they replace these defaults.

    Returns
    -------
    Model
        The structure.

    Examples
    --------
    >>> chain_model("P2").names
    ('Kp', 'Tp1', 'Tp2')
    """
    defaults = {"fixed": {"Kp": 1.0}, "offset": "none", "known": conditioning}
    return process(name, **{**defaults, **options})


@with_named_arguments
def several(
    models: Sequence[Model | str], inputs: Sequence[str], *, common: bool = False, **options: Any
) -> Model:
    """The sum of one model for each input.

    Parameters
    ----------
    models
        The model of each input.
    inputs
        The names of the inputs.
    common
        Whether all inputs share the same poles.
    options
        As for :func:`process`; ``fixed`` by names such as "Kp.heater"; ``known`` applies to every
        input.

    Returns
    -------
    Model
        The sum; for one model that model itself.

    Raises
    ------
    InputError
        For another number of inputs, models with integrators or sums, or poles that cannot be
        common.

    Examples
    --------
    >>> several(["P2D", "P1"], ["heater", "fan"]).names
    ('Kp.heater', 'Tp1.heater', 'Tp2.heater', 'Td.heater', 'Kp.fan', 'Tp1.fan')
    >>> several(["P1D", "P1"], ["heater", "fan"], common=True).names
    ('Kp.heater', 'Tp1', 'Td.heater', 'Kp.fan')
    """
    submodels = [as_model(m) for m in models]
    known = KnownDynamics.of(options.pop("known", None))
    name = " + ".join(model.name for model in submodels)
    if common:
        name += ", common poles"
    if len(submodels) != len(inputs) or not submodels:
        raise InputError(
            f"{len(submodels)} models for {len(inputs)} inputs", expected="one for each"
        )
    if any(model.integrators or model.submodels for model in submodels):
        raise InputError(
            f"{name} integrates or holds sums",
            expected="models without integrator (I) behind each input",
        )
    if len(submodels) == 1:
        return replace(submodels[0], known=known, **options)
    submodels = [m if m.name == NO_MODEL else replace(m, known=known) for m in submodels]
    shared = _pole_parameters(submodels[0]) if common else []
    first = submodels[0]
    if common and any(set(shared) - set(m.names) or m.order != first.order for m in submodels):
        raise InputError(
            f"{name}: the models differ in their poles",
            expected="the same lags in each, as P2D and P2Z",
        )
    if any(m.arx for m in submodels) and not (common and all(m.arx for m in submodels)):
        raise InputError(
            f"{name}: the poles that colour the noise differ",
            remedy="several([..], names, common=True)",
        )
    names: list[str] = []
    fixed: dict[str, float] = {}
    for model, input_name in zip(submodels, inputs):
        full = {n: n if n in shared else f"{n}.{input_name}" for n in model.names}
        names += full.values()
        fixed |= {full[n]: value for n, value in model.fixed.items()}
    fixed |= options.pop("fixed", {})
    return Model(
        name,
        "sum",
        tuple(dict.fromkeys(names)),
        0,
        known,
        fixed,
        submodels=tuple(submodels),
        inputs=tuple(inputs),
        arx=first.arx,
        **options,
    )


def _pole_parameters(model: Model) -> list[str]:
    """Names of the parameters that determine the poles."""
    names = [n for n in model.names if n[0] in "Ta" and n not in ("Tz", "Td")]
    return [n for n in model.names if n in names or n == "Zeta"]


def as_model(model: Model | str) -> Model:
    """A Model as it is; a name ("P2D", "TF(1,2)D", "ARX(2,2)") as the model of that name.

    Raises
    ------
    InputError
        For a name of no model.
    """
    if isinstance(model, Model):
        return model
    if model == NO_MODEL:
        return Model(NO_MODEL, "process", ("Kp",), fixed={"Kp": 0.0})
    match = re.match(r"^(TF|ARX)\((\d),(\d)\)(D?)(I?)$", model.replace(" ", ""))
    if match is None and not model.startswith("P"):
        raise InputError(
            f"there is no model {model!r}",
            expected="a process model such as P1D or P2DZ, TF(zeros,poles) or ARX(zeros,poles), "
            "with D for a dead time, such as TF(1,2)D",
            remedy="for an output error model OE use TF, whose noise is that of the output",
        )
    if match is None:
        return process(model)
    options = {"arx": True} if match[1] == "ARX" else {}
    return transfer(
        int(match[2]), int(match[3]), delay=bool(match[4]), integrator=bool(match[5]), **options
    )


def as_template(model: Model, like: Model) -> Model:
    """Return a model with the known factor, offset, dead-time bound and fixed gains of another.

    Parameters
    ----------
    model
        The model.
    like
        The other one.

    Returns
    -------
    Model
        The model.
    """
    gains = {}
    for name, value in like.fixed.items():
        if base_name(name) not in ("Kp", "b0") or value == 0.0:
            continue
        for gain in ("Kp", "b0"):
            full = gain + input_suffix(name)
            if full in model.names:
                gains[full] = value
    return replace(
        model,
        known=model.known if model.submodels else like.known,
        offset=like.offset,
        delay_max_s=like.delay_max_s,
        fixed={**model.fixed, **gains},
    )
