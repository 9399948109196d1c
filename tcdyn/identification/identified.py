"""The identified model: structure, parameters with covariance, origin, and its JSON file.

Fits, plots, sensors and pages use it. Its file is read back by ``read_identified`` and converted by
``tcdyn.sensors.file.from_identified``. ``tests/identify/test_identify_fit.py`` checks that file and
``control`` system give the same model back, ``tests/identify/test_identify_several.py`` the same
for several inputs.
"""

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
from numpy.typing import ArrayLike
from pydantic import ValidationError

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.rational import InitialState, simulate
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import (
    DAMAGED,
    InputError,
    Spelling,
    as_argument,
    first_validation_error,
)
from tcdyn.core.estimate import Estimate, mixture, rounded_texts
from tcdyn.core.findings import Finding, Severity, labelled_messages, warning, warnings_and_errors
from tcdyn.core.labels import common_index
from tcdyn.core.options import options_of
from tcdyn.core.result import Result, estimates_frame, jsonable
from tcdyn.estimation.noise_average import MixturePart
from tcdyn.identification.draws import N_DRAWS, draw_models
from tcdyn.identification.holds import Holds, hold_of_each, hold_text
from tcdyn.identification.models import KnownDynamics, Model, base_name, several, transfer
from tcdyn.identification.responses import Dynamics, percent_times
from tcdyn.io.column_names import column_named
from tcdyn.io.endings import JSON, check_ending
from tcdyn.io.stored import IDENTIFIED, check_schema, read_json
from tcdyn.io.write import write_text
from tcdyn.rig.disk import Conditioning
from tcdyn.series.index import even_interval_s
from tcdyn.tuning import Plant, TuneOptions, Tuning, tune_plant

if TYPE_CHECKING:
    import control

# Version of the file; a change of its keys needs another number and a reader for the old one.
# Keys of the model that are its fields.
MODEL_KEYS = ("name", "kind", "integrators", "fixed", "offset", "delay_max_s")
# Keys of the file that are fields of Identified.
PLAIN_KEYS = (
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
MAX_CORRELATIONS = 6  # correlations of parameters in the summary, the strongest
# p of the test of residuals with the input, below which dynamics are missing, and no disturbance
# model is fitted; chosen by judgement.
DRIVEN_P = 1e-3
# Findings about single parameters, whose uncertainty is that of the draws.
IN_DRAWS = ("fit.undetermined", "fit.open_interval", "fit.twin")
MAX_ZERO_RATIO = 1e-12  # coefficient over the largest, below which it is zero


@dataclass(frozen=True, repr=False)
class Identified(Dynamics, Result):
    """An identified model.

    Parameters
    ----------
    model
        The model structure.
    theta
        All parameters by name.
    covariance
        Covariance (P, P) of the free parameters, in the order of ``model.free``.
    estimates
        The free parameters with their intervals.
    offset
        Added to the output, in its unit.
    noise_sd
        Standard deviation of the noise, in the output's unit.
    hold, dt_s
        Hold and sampling interval [s] of the record; ``dt_s`` is 0 for a model without a record.
        Inputs of different holds have one each.
    input_name, output_name, input_unit, output_unit
        Names and units of the record.
    statistics
        Statistics of the fit, by name.
    sentence
        The conclusion of the validation.
    findings
        Findings about the record and the model.
    timing_u_s
        Standard uncertainty of the time of the output against the inputs [s]; it is in lag, dead
        time and percent times, and not in the covariance.
    parts
        Normal distributions of the free parameters, relative to ``theta``, whose mixture has the
        covariance; none for one normal distribution.
    """

    model: Model
    theta: Mapping[str, float]
    covariance: Array
    estimates: Mapping[str, Estimate]
    offset: float = 0.0
    noise_sd: float = 0.0
    hold: Holds = "foh"
    dt_s: float = 1.0
    input_name: str = "u"
    output_name: str = "y"
    input_unit: str = ""
    output_unit: str = ""
    statistics: Mapping[str, float] = field(default_factory=dict)
    sentence: str = ""
    findings: tuple[Finding, ...] = ()
    timing_u_s: float = 0.0
    parts: tuple[MixturePart, ...] = ()

    @classmethod
    def of(
        cls, model: Model, theta: Mapping[str, float], covariance: Array, **more: Any
    ) -> Identified:
        """Build a model with intervals of normal distributions, or of the mixture of its parts.

        Parameters
        ----------
        model
            The model structure.
        theta
            All parameters by name.
        covariance
            Covariance (P, P) of the free ones.
        more
            Other fields of the class.

        Returns
        -------
        Identified
            The model.
        """
        without = cls(model, theta, covariance, {}, **more)
        unit = np.eye(len(model.free))
        estimates = {
            name: mixture(*without.distribution(theta[name], gradient))
            for name, gradient in zip(model.free, unit)
        }
        return replace(without, estimates=estimates)

    def with_timing(self, u_s: float) -> Identified:
        """Return the model with an uncertainty of the time of the output against the inputs.

        Parameters
        ----------
        u_s
            The standard uncertainty [s], which lag, dead time and percent times then include.
        """
        estimates = {
            name: value.with_error(u_s) if base_name(name) == "Td" else value
            for name, value in self.estimates.items()
        }
        return replace(self, estimates=estimates, timing_u_s=u_s)

    @cached_property
    def by_input(self) -> Mapping[str, Identified]:
        """The model behind each input, by the input's name."""
        free = self.model.free
        models = {}
        holds = hold_of_each(self.hold, len(self.model.inputs))
        for k, input_name in enumerate(self.model.inputs):
            model, names = self.model.branch(k)
            index = [free.index(names[n]) for n in model.free]
            models[input_name] = replace(
                self,
                model=model,
                theta={n: self.theta[full] for n, full in names.items()},
                covariance=self.covariance[np.ix_(index, index)],
                parts=tuple(
                    MixturePart(weight, mean[index], cov[np.ix_(index, index)])
                    for weight, mean, cov in self.parts
                ),
                estimates={n: self.estimates[names[n]] for n in model.free},
                offset=0.0,
                hold=holds[k],
                input_name=input_name,
                statistics={},
                sentence="",
                findings=(),
            )
        return models or {self.input_name: self}

    @property
    def longest_lag_s(self) -> float:
        """The largest lag behind any input [s]; 0 for an integrator, which has none."""
        if self.model.integrators:
            return 0.0
        return max(model.lag_s.value for model in self.by_input.values())

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlations (P, P) of the free parameters' errors."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        names = self.model.free
        return pd.DataFrame(self.covariance / np.outer(sd, sd), index=names, columns=names)

    def simulate(
        self,
        u: ArrayLike | pd.Series | pd.DataFrame,
        dt_s: float | None = None,
        hold: Holds | None = None,
        start: InitialState = "equilibrium",
    ) -> Array | pd.Series:
        """Return the model's output, offset included.

        Parameters
        ----------
        u
            Input (N,), or inputs (N, K).
        dt_s
            Sampling interval [s]; by default that of the index of ``u``, else of the record.
        hold
            Hold of all inputs, or of each; by default that of the record.
        start
            State in which the simulation starts.

        Returns
        -------
        array or Series
            Output (N,) in the output's unit; for a Series or DataFrame a Series of the same index.

        Raises
        ------
        InputError
            For another number of inputs, or a model without a record and no ``dt_s``.
        """
        table = np.asarray(u, dtype=float)
        table = table.reshape(len(table), -1)
        if table.shape[1] != len(self.by_input):
            raise InputError(
                f"{table.shape[1]} inputs", expected=f"{len(self.by_input)}: {self.input_name}"
            )
        index = common_index([u], "simulate")
        if index is not None:
            dt_s = dt_s or even_interval_s(index, "simulate")
        dt = dt_s or self.dt_s
        if not dt:
            raise InputError(
                "the model is of no record", expected="the sampling interval", remedy="give dt_s=.."
            )
        y = np.zeros(len(table))
        holds = hold_of_each(hold or self.hold, table.shape[1])
        for model, column, column_hold in zip(self.by_input.values(), table.T, holds):
            y = y + simulate(model.rational, column, dt, column_hold, start)
        y = y + self.offset
        return y if index is None else pd.Series(y, index, name=self.output_name)

    def transfer_function(self, pade_order: int = 3) -> control.TransferFunction:
        """Return the model as a ``control.TransferFunction``, one entry for each input.

        Dead times become their Pade approximation of ``pade_order``.
        """
        import control

        row = [
            model.rational.transfer_function(pade_order, inputs=name, outputs=self.output_name)
            for name, model in self.by_input.items()
        ]
        return row[0] if len(row) == 1 else control.combine_tf([row])

    def state_space(self, pade_order: int = 3) -> control.StateSpace:
        """The model as a ``control.StateSpace``, without the offset.

        Dead times become their Pade approximation of ``pade_order``.
        """
        import control

        systems = [
            control.ss(model.rational.transfer_function(pade_order))
            for model in self.by_input.values()
        ]
        summation = control.ss([], [], [], np.ones((1, len(systems))))
        system = summation * control.append(*systems)
        return control.ss(system, inputs=list(self.by_input), outputs=[self.output_name])

    def plant(self, input: str | None = None) -> Plant:
        """What a controller controls: the model behind one input, with draws of its parameters.

        Parameters
        ----------
        input
            Name of the input, with or without its unit; needed for several.

        Returns
        -------
        Plant
            The plant.

        Raises
        ------
        InputError
            For another input, and for several without a name.
        """
        names = list(self.by_input)
        if input is None and len(names) > 1:
            raise InputError(
                f"the model has the inputs {', '.join(names)}",
                expected="the name of the one that the controller sets",
                remedy="give {input}",
                parameters={"input": names[0]},
            )
        name = names[0] if input is None else column_named(input, names, "the model")
        branch = self.by_input[name]
        troubles = [
            finding.sentence
            for finding in warnings_and_errors(self.findings)
            if finding.code not in IN_DRAWS
        ]
        if self.statistics.get("p_input", 1.0) < DRIVEN_P and self.sentence:
            troubles.append(self.sentence)
        has_sensor = all(finding.code != "model.without_sensor" for finding in self.findings)
        if not has_sensor:
            troubles.append(
                "The model is the plant without its sensor, and the controller sees the reading: "
                "identify the plant with its sensor."
            )
        draws, redrawn_share = draw_models(branch, N_DRAWS)
        units = self.input_unit.split(", ")
        return Plant(
            rational=branch.rational,
            draws=draws,
            model_name=branch.model.name,
            input_name=name,
            output_name=self.output_name,
            input_unit=units[names.index(name)] if len(units) == len(names) else "",
            output_unit=self.output_unit,
            dt_s=self.dt_s,
            redrawn_share=redrawn_share,
            troubles=tuple(dict.fromkeys(troubles)),
            is_rejected=any(finding.severity is Severity.ERROR for finding in self.findings),
            has_sensor=has_sensor,
        )

    def tune(self, input: str | None = None, **options: Any) -> Tuning:
        """Settings of a PI or PID controller for the model, see :func:`tcdyn.identification.tune`.

        Parameters
        ----------
        input
            Name of the input that the controller sets; needed for several.
        **options
            The fields of :class:`tcdyn.tuning.TuneOptions`.

        Returns
        -------
        Tuning
            Settings, margins and responses, with their ranges over the model's distribution.

        Examples
        --------
        >>> from tcdyn.identification import process
        >>> theta = {"Kp": 2.0, "Tp1": 80.0, "Td": 10.0}
        >>> model = Identified.of(process("P1D"), theta, np.diag([0.01, 16.0, 1.0]))

        >>> model.tune().controller.ideal.gain
        2.0
        """
        return tune_plant(self.plant(input), options_of(TuneOptions, options, "tune"))

    def chain(self, conditioning: Conditioning = NO_CONDITIONING) -> Chain:
        """The identified dynamics as a measurement chain of unit gain.

        Parameters
        ----------
        conditioning
            The filter that was the known factor of the identification.

        Returns
        -------
        Chain
            Lags, zero, dead time and filter, with unit gain.

        Raises
        ------
        InputError
            Where the model is not a chain, or its known factor is another.
        """
        p = self.theta
        if self.model.kind != "process" or self.model.integrators:
            raise InputError(
                f"{self.model.name} is not a chain", expected="a process model without integrator"
            )
        given = KnownDynamics.of(conditioning).den
        identified = self.model.known.den
        same_order = len(given) == len(identified)
        if not same_order or not np.allclose(given, identified, rtol=1e-9, atol=0.0):
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
        """The model as text: parameters, lag, quality of the fit, validation, findings.

        Parameters
        ----------
        spelling
            Spelling of the parameters that findings name.
        """
        m = self.model
        width = max(5, *map(len, m.names))
        if m.inputs:
            width += 2
        origin = f"{hold_text(self.hold)}, dt = {self.dt_s:g} s" if self.dt_s else "given"
        lines = [f"{m.name}: {self.input_name} -> {self.output_name}, {origin}"]
        for name, value, u, low, high, unit in self.card().itertuples(index=False):
            lines.append(f"  {name:{width}s} {value:>12s} +- {u:<9s} [{low}, {high}] {unit}")
        for name, value in m.fixed.items():
            lines.append(f"  {name:{width}s} {value:12.5g} (fixed) {m.unit(name)}")
        correlations = self._correlation_text()
        if correlations:
            lines.append(f"  correlations {correlations}")
        s = self.statistics
        if s:
            lines.append(
                f"  fit {s['fit_percent']:.2f} %, rms {s['rms']:.4g}, AICc {s['aicc']:.1f}, "
                f"BIC {s['bic']:.1f}"
            )
        if self.sentence:
            lines.append(f"  {self.sentence}")
        lines += [f"  {line}" for line in labelled_messages(self.findings, spelling)]
        return "\n".join(lines)

    def _correlation_text(self) -> str:
        """The strongest correlations of the parameters; empty for a model without uncertainty."""
        if not self.covariance.any():
            return ""
        free = self.model.free
        table = self.correlation.to_numpy()
        pairs = sorted(combinations(range(len(free)), 2), key=lambda pair: -abs(table[pair]))
        return ", ".join(
            f"{free[i]}-{free[j]} {table[i, j]:.2f}" for i, j in pairs[:MAX_CORRELATIONS]
        )

    def to_frame(self) -> pd.DataFrame:
        """Free parameters, lag (first moment) and percent times with their 95 % intervals."""
        quantities = dict(self.estimates)
        units = [self.model.unit(name) for name in quantities]
        if not self.model.integrators:
            for model in self.by_input.values():
                if not model.gain:  # an input without effect
                    continue
                suffix = f".{model.input_name}" if self.model.inputs else ""
                times = {"lag": model.lag_s, **percent_times(model)}
                quantities |= {name + suffix: e for name, e in times.items()}
                units += ["s"] * len(times)
        return estimates_frame(quantities, units)

    def card(self) -> pd.DataFrame:
        """The table of :meth:`to_frame` as text, rounded to the uncertainties."""
        rows = []
        for name, value, u, low95, high95, unit in self.to_frame().itertuples():
            low = rounded_texts(low95, u)[0]
            high = rounded_texts(high95, u)[0]
            rows.append((name, *rounded_texts(value, u), low, high, unit))
        columns = ["quantity", "value", "u", "low 95 %", "high 95 %", "unit"]
        return pd.DataFrame(rows, columns=columns)

    def to_json(self) -> str:
        """The complete model as JSON text; :meth:`from_json` reads it."""
        return json.dumps(self.to_dict(), indent=2)

    def write(self, path: str | Path) -> Path:
        """Write the model as a JSON file, which :func:`read_identified` reads.

        Parameters
        ----------
        path
            The file; its ending is .json, as in heater.identified.json.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            For another ending, and a file that cannot be written.
        """
        check_ending(path, JSON)
        return write_text(path, self.to_json() + "\n")

    def to_dict(self) -> dict[str, Any]:
        """The model as in its JSON file.

        Notes
        -----
        The keys are a file format: ``MODEL_KEYS`` and ``PLAIN_KEYS`` name the fields that are
        copied, and :meth:`from_json` reads the same keys. ``tests/identify/test_identify_fit.py``
        fails where they disagree.
        """
        m = self.model
        model: dict[str, Any] = {key: getattr(m, key) for key in MODEL_KEYS}
        if m.inputs:
            model["inputs"] = m.inputs
            model["parts"] = [
                {"name": part.name, "kind": part.kind, "names": part.names} for part in m.submodels
            ]
        model["parameters"] = m.names
        model["known"] = {"num": m.known.num, "den": m.known.den}
        if m.known.delay_s:
            model["known"]["delay_s"] = m.known.delay_s
        lag: Any = None
        if not m.integrators:
            lags = {name: part.lag_s for name, part in self.by_input.items()}
            lag = lags if m.inputs else self.lag_s
        return jsonable(
            {
                "schema": IDENTIFIED.schema,
                "model": model,
                **{key: getattr(self, key) for key in PLAIN_KEYS},
                "units": {n: m.unit(n) for n in m.names},
                "lag_s": lag,
                "input": {"name": self.input_name, "unit": self.input_unit},
                "output": {"name": self.output_name, "unit": self.output_unit},
                "timing_u_s": self.timing_u_s,
                "parts": [part._asdict() for part in self.parts],
                "warnings": self.warnings,
                "findings": [f.to_dict() for f in self.findings],
            }
        )

    @classmethod
    def from_json(cls, text: str) -> Identified:
        """The model that :meth:`to_json` wrote.

        Raises
        ------
        InputError
            Where the text is something else.
        """
        try:
            content = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"the identified model is not JSON ({error})") from error
        return cls.from_dict(content)

    @classmethod
    def from_dict(cls, content: Any) -> Identified:
        """The model from the content of its JSON file, as :meth:`to_dict` gives it.

        Raises
        ------
        InputError
            Where the content is something else.
        """
        check_schema(content, "", IDENTIFIED)
        try:
            return cls._from_dict(content)
        except InputError:
            raise
        except DAMAGED as problem:
            reason = repr(problem)
            if isinstance(problem, ValidationError):
                reason = first_validation_error(problem)
            raise InputError(
                f"the identified model is damaged ({reason})",
                expected=IDENTIFIED.expected,
                remedy="write it again with `tcdyn identify`",
            ) from None

    @classmethod
    def _from_dict(cls, content: Mapping[str, Any]) -> Identified:
        """The model from the dictionary that :meth:`to_dict` made, also that of version 0.1."""
        model = _model_from_dict(content["model"])
        size = len(model.free)
        fields = {key: content[key] for key in PLAIN_KEYS}
        if not isinstance(content["hold"], str):
            fields["hold"] = tuple(content["hold"])
        fields["covariance"] = np.array(content["covariance"], dtype=float).reshape(size, size)
        fields["estimates"] = {n: Estimate(**e) for n, e in content["estimates"].items()}
        fields["statistics"] = {
            name: np.nan if value is None else value
            for name, value in content["statistics"].items()
        }
        if "findings" in content:
            findings = [Finding.from_dict(f) for f in content["findings"]]
        else:  # a file of version 0.1
            findings = [warning("from_file", text=message) for message in content["warnings"]]
        return cls(
            model=model,
            **fields,
            input_name=content["input"]["name"],
            input_unit=content["input"]["unit"],
            output_name=content["output"]["name"],
            output_unit=content["output"]["unit"],
            findings=tuple(findings),
            timing_u_s=content.get("timing_u_s", 0.0),
            parts=tuple(
                MixturePart(
                    part["weight"],
                    np.array(part["mean"], dtype=float),
                    np.array(part["covariance"], dtype=float).reshape(size, size),
                )
                for part in content.get("parts", ())
            ),
        )


def _model_from_dict(content: Mapping[str, Any]) -> Model:
    """The model structure in the "model" key of a file."""
    stored = content["known"]
    known = KnownDynamics.ratio(stored["num"], stored["den"])
    known = replace(known, delay_s=stored.get("delay_s", 0.0))
    submodels = [
        Model(part["name"], part["kind"], tuple(part["names"]), known=known)
        for part in content.get("parts", ())
    ]
    return Model(
        **{key: content[key] for key in MODEL_KEYS},
        names=tuple(content["parameters"]),
        inputs=tuple(content.get("inputs", ())),
        submodels=tuple(submodels),
        known=known,
    )


@with_named_arguments
def read_identified(path: str | Path) -> Identified:
    """Read the model in a JSON file that ``tcdyn identify`` wrote.

    Raises
    ------
    InputError
        Where the file cannot be read or is no identified model.

    Examples
    --------
    >>> import tempfile
    >>> from tcdyn.identification import process
    >>> model = Identified.of(process("P1"), {"Kp": 2.0, "Tp1": 0.8}, np.diag([1e-4, 1e-4]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "model.identified.json"
    ...     _ = path.write_text(model.to_json(), encoding="utf-8")
    ...     read_identified(path).theta["Tp1"]
    0.8
    """
    content = read_json(path, IDENTIFIED)
    try:
        return Identified.from_dict(content)
    except InputError as problem:
        raise problem.at(str(path)) from None


@with_named_arguments
def from_control(
    system: control.TransferFunction | control.StateSpace, delay_s: float | Sequence[float] = 0.0
) -> Identified:
    """A continuous ``control`` system of one output as an :class:`Identified`, without uncertainty.

    ``compare(data, from_control(g), "P2D")`` compares it unchanged;
    ``fit(data, g.model, start=g.theta)`` starts from it.

    Parameters
    ----------
    system
        The system. Inputs without labels (u[0], u[1]) are those of the data by their position.
    delay_s
        Dead time [s] behind each input, or behind all, which such a system does not hold.

    Returns
    -------
    Identified
        The model with a covariance of zeros; ``dt_s`` is 0.

    Raises
    ------
    InputError
        For a discrete or unstable system, several outputs, no static gain, or more zeros than
        poles.

    Examples
    --------
    >>> import control
    >>> model = from_control(control.tf([1.0], [0.75, 1.0]), delay_s=0.12)
    >>> round(model.lag_s.value, 2)
    0.87
    """
    import control

    where = "from_control"
    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise InputError(
            f"is a {type(system).__name__}",
            where=where,
            expected="a TransferFunction or StateSpace",
        )
    is_discrete = system.isdtime(strict=True)
    if is_discrete or system.noutputs != 1:
        raise InputError(
            "is discrete in time" if is_discrete else f"has {system.noutputs} outputs",
            where=where,
            expected="a continuous system of one output",
            remedy="take system[0, :]",
        )
    delays = np.broadcast_to(np.asarray(delay_s, dtype=float), (system.ninputs,))
    if not (np.isfinite(delays) & (delays >= 0)).all():
        raise InputError(f"delay_s is {delay_s}", where=where, expected="seconds, zero or more")
    submodels = []
    values = []
    for k, delay in enumerate(delays.tolist()):
        single = system[0, k] if system.ninputs > 1 else system
        if isinstance(single, control.StateSpace):
            single = control.ss2tf(single).minreal(1e-9)
        num = _ascending_coefficients(single.num)
        den = _ascending_coefficients(single.den)
        submodel, theta = _from_ratio(num, den, delay, f"input {k + 1}", where)
        submodels.append(submodel)
        values.append(theta)
    names = tuple(map(str, system.input_labels))
    model = submodels[0] if len(submodels) == 1 else several(submodels, names)
    theta = {}
    for k, submodel_theta in enumerate(values):
        theta |= {full: submodel_theta[n] for n, full in model.branch(k)[1].items()}
    no_covariance = np.zeros((len(theta), len(theta)))
    return Identified.of(model, theta, no_covariance, dt_s=0.0, input_name=", ".join(names))


def _ascending_coefficients(coefficients: Any) -> Array:
    """Return the coefficients of a polynomial of a ``control`` system, ascending in s."""
    return np.trim_zeros(np.asarray(coefficients[0][0], dtype=float), "f")[::-1]


def _from_ratio(
    num: Array, den: Array, delay_s: float, label: str, where: str
) -> tuple[Model, dict[str, float]]:
    """Return model and parameters of a transfer function num/den with a dead time.

    Parameters
    ----------
    num, den
        Coefficients, ascending in s.
    delay_s
        Dead time [s].
    label, where
        Input and function that errors name.

    Returns
    -------
    model
        The structure.
    theta
        Its parameters by name.

    Raises
    ------
    InputError
        For a static gain of zero, unstable poles, or more zeros than poles.
    """
    if not len(num) or abs(num[0]) < MAX_ZERO_RATIO * np.max(np.abs(num)):
        raise InputError(
            f"{label} has a static gain of zero",
            where=where,
            expected="a lag relative to it",
        )
    integrates = bool(abs(den[0]) < MAX_ZERO_RATIO * np.max(np.abs(den)))
    if integrates:
        den = den[1:]
    poles = np.polynomial.polynomial.polyroots(den)
    if len(den) < 2 or len(num) > len(den) or np.any(poles.real >= 0):
        raise InputError(
            f"{label} has {len(num) - 1} zeros over the poles {np.round(poles, 6).tolist()} 1/s",
            where=where,
            expected="poles in the left half plane (one at zero may be beside them), no more "
            "zeros than poles",
        )
    model = transfer(len(num) - 1, len(den) - 1, delay=bool(delay_s), integrator=integrates)
    values = [*(num / den[0]), *(den[1:] / den[0])]
    if delay_s:
        values.append(delay_s)
    return model, dict(zip(model.names, values))
