"""The result: settings of a controller, its margins and responses with their ranges.

``tcdyn.tuning.tune`` makes it. Tests: ``tests/tuning/test_tune_model.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd

from tcdyn.core.errors import Spelling, as_argument
from tcdyn.core.findings import Finding, labelled_messages
from tcdyn.core.result import Result, json_text, jsonable
from tcdyn.io.endings import CSV_OR_JSON, check_ending
from tcdyn.io.metadata import RESULTS
from tcdyn.io.write import write_log, write_text
from tcdyn.tuning.forms import Controller, Form
from tcdyn.tuning.plant import Plant
from tcdyn.tuning.reduction import ReducedModel
from tcdyn.tuning.responses import Responses

SCHEMA = "tcdyn.tuning/1"
# Names and units of the margins and of the numbers of the responses, in the order of the table.
MARGIN_TEXTS = {
    "gain_margin": "gain margin",
    "phase_margin_deg": "phase margin [deg]",
    "ms": "largest sensitivity Ms",
    "mt": "largest complementary sensitivity Mt",
}
RESPONSE_TEXTS = {
    "rise_s": "set point: rise time 10 to 90 % [s]",
    "settling_s": "set point: settling time 2 % [s]",
    "overshoot_percent": "set point: overshoot [%]",
    "load_peak": "load: largest deviation",
    "load_iae": "load: integral of |deviation|",
}
UNITS = {"phase_margin_deg": "deg", "rise_s": "s", "settling_s": "s", "overshoot_percent": "%"}


@dataclass(frozen=True)
class Spread:
    """A number of a loop with the model, and over the draws from its distribution.

    Attributes
    ----------
    value
        With the model.
    low95, high95
        2.5 % and 97.5 % quantile of the draws; NaN without draws.
    worst
        The worst of the draws; NaN without draws.
    """

    value: float
    low95: float = nan
    high95: float = nan
    worst: float = nan

    @property
    def texts(self) -> tuple[str, str, str]:
        """Texts of the value, the range and the worst value."""
        if self.low95 != self.low95:
            return _text(self.value), "", ""
        return _text(self.value), f"{_text(self.low95)} to {_text(self.high95)}", _text(self.worst)


@dataclass(frozen=True, repr=False)
class Tuning(Result):
    """Settings of a controller for an identified model, with margins and responses.

    Attributes
    ----------
    plant
        The plant and its draws.
    rule
        "simc" or "robust".
    kind
        "pi" or "pid".
    controller
        The settings.
    reduced
        Model from which SIMC settings follow; None of the rule robust.
    tau_c_s
        Time constant of the closed loop [s], of SIMC; None of the rule robust.
    max_ms
        Limit of the sensitivity, of the rule robust; None of SIMC.
    margins
        Gain margin, phase margin [deg], Ms and Mt, by name.
    times
        Numbers of the responses, by name.
    responses
        Responses with the model (first row) and with the draws.
    unstable_share
        Share of the draws whose loop is unstable.
    findings
        Findings.
    """

    plant: Plant
    rule: str
    kind: str
    controller: Controller
    reduced: ReducedModel | None
    tau_c_s: float | None
    max_ms: float | None
    margins: Mapping[str, Spread]
    times: Mapping[str, Spread]
    responses: Responses
    unstable_share: float
    findings: tuple[Finding, ...] = ()

    @property
    def action(self) -> str:
        """ "reverse" where the controller output falls as the reading rises, else "direct"."""
        return "reverse" if self.controller.ki > 0 else "direct"

    @property
    def gain_unit(self) -> str:
        """Unit of the gain of the controller, input unit per output unit."""
        return _quotient(self.plant.unit_of_input, self.plant.unit_of_output)

    @property
    def forms(self) -> Mapping[str, Form]:
        """Ideal and series form, by name; without a series form where its zeros are complex."""
        series = self.controller.series
        ideal = {"ideal": self.controller.ideal}
        return ideal if series is None else {**ideal, "series": series}

    def headline(self) -> str:
        """Rule and settings in one line."""
        c = self.controller
        text = f"{self.kind.upper()} by {self.rule}: Kp {c.kp:.4g}, Ki {c.ki:.4g}"
        if c.kd:
            text += f", Kd {c.kd:.4g}"
        return f"{text} ({self.gain_unit}, s), Ms {self.margins['ms'].texts[0]}"

    def summary(self, spelling: Spelling = as_argument) -> str:
        """Settings in each form, margins, responses and findings as text.

        Parameters
        ----------
        spelling
            Spelling of the parameters that findings name.
        """
        lines = [self.headline(), *self._design_lines(), "", *self._form_lines()]
        if self.controller.sample_s:
            lines += ["", f"  called every {self.controller.sample_s:g} s:"]
            lines += [f"    {line}" for line in self.controller.difference_equation()]
        table = self._table()
        lines += ["", *(f"  {line}" for line in table.to_string(index=False).split("\n"))]
        lines += [f"  {line}" for line in self._remarks()]
        return "\n".join([*lines, *labelled_messages(self.findings, spelling)])

    def _design_lines(self) -> list[str]:
        """What is controlled, the sign of the loop, and the reduced model."""
        plant = self.plant
        opposite = "falls" if self.action == "reverse" else "rises"
        lines = [
            f"  {plant.input_name} sets {plant.output_name}, model {plant.model_name}; "
            f"{self.action} acting: {plant.input_name} {opposite} as {plant.output_name} rises"
        ]
        reduced = self.reduced
        if reduced is not None:
            gain_unit = _quotient(plant.unit_of_output, plant.unit_of_input)
            if reduced.is_integrating:
                text = f"integrator {reduced.gain:.4g} {gain_unit}/s"
            else:
                text = f"gain {reduced.gain:.4g} {gain_unit}, lag {reduced.tau1_s:.4g} s"
            if reduced.tau2_s:
                text += f", second lag {reduced.tau2_s:.4g} s"
            half = ", half a sample included" if self.controller.sample_s else ""
            lines.append(
                f"  reduced model: {text}, effective dead time {reduced.dead_time_s:.4g} s{half}; "
                f"tau_c {self.tau_c_s:.4g} s"
            )
        else:
            lines.append(f"  largest integral gain with Ms at most {self.max_ms:g}")
        return lines

    def _form_lines(self) -> list[str]:
        """Settings of the three forms, with units."""
        c = self.controller
        gains = (f"Kp {c.kp:.5g}", f"Ki {c.ki:.5g} 1/s", f"Kd {c.kd:.5g} s")
        rows = [("parallel", "Kp + Ki/s + Kd s/(1 + Tf s)", *gains)]
        formulas = {
            "ideal": ("Kp (1 + 1/(Ti s) + Td s/(1 + Tf s))", "Kp"),
            "series": ("Kc (1 + 1/(Ti s)) (1 + Td s)/(1 + Tf s)", "Kc"),
        }
        for name, form in self.forms.items():
            formula, gain = formulas[name]
            times = (f"Ti {form.integral_s:.5g} s", f"Td {form.derivative_s:.5g} s")
            rows.append((name, formula, f"{gain} {form.gain:.5g}", *times))
        widths = [max(len(row[k]) for row in rows) for k in range(5)]
        lines = ["  ".join(["", *(t.ljust(w) for t, w in zip(row, widths))]) for row in rows]
        lines.append(f"  gains in {self.gain_unit} (Ki: that per second, Kd: that times a second)")
        if self.plant.unit_of_input == "%":
            band = 100 / abs(c.kp)
            lines.append(f"  proportional band 100 %/Kp: {band:.4g} {self.plant.unit_of_output}")
        if c.setpoint_weight != 1:
            lines.append(
                f"  weight of the set point in the proportional part: {c.setpoint_weight:g}"
            )
        if c.kd:
            lines.append(
                f"  Tf {c.filter_s:.5g} s: time constant of the filter of the derivative, which "
                "acts on the reading only"
            )
        return lines

    def _table(self) -> pd.DataFrame:
        """Margins and responses as text."""
        deviation = _quotient(self.plant.unit_of_output, self.plant.unit_of_input)
        rows = []
        for name, spread in {**self.margins, **self.times}.items():
            text = {**MARGIN_TEXTS, **RESPONSE_TEXTS}[name]
            if name == "load_peak":
                text += f" [{deviation}]"
            if name == "load_iae":
                text += f" [{deviation} s]"
            rows.append((text, *spread.texts))
        columns = ["", "model", "95 % of draws", "worst"]
        width = max(len(row[0]) for row in rows)
        frame = pd.DataFrame(rows, columns=columns)
        frame[""] = frame[""].str.ljust(width)
        return frame if self.plant.draws else frame[columns[:2]]

    def _remarks(self) -> list[str]:
        """What the numbers refer to."""
        remarks = ["per unit step; limits of the controller output are not simulated"]
        if self.plant.draws:
            percent = 100 * self.unstable_share
            remarks.append(
                f"{len(self.plant.draws)} draws from the distribution of the model's parameters, "
                f"{percent:.2g} % of them unstable"
            )
        return remarks

    def to_frame(self) -> pd.DataFrame:
        """One row for each setting and each number of the loop, with its range over the draws."""
        c = self.controller
        gain = self.gain_unit
        deviation = _quotient(self.plant.unit_of_output, self.plant.unit_of_input)
        settings = {
            "Kp": (c.kp, gain),
            "Ki": (c.ki, f"{gain}/s"),
            "Kd": (c.kd, f"{gain} s"),
            "Tf": (c.filter_s, "s"),
        }
        for name, form in self.forms.items():
            settings[f"{name} gain"] = (form.gain, gain)
            settings[f"{name} Ti"] = (form.integral_s, "s")
            settings[f"{name} Td"] = (form.derivative_s, "s")
        units = {**UNITS, "load_peak": deviation, "load_iae": f"{deviation} s"}
        rows = [(name, value, nan, nan, nan, unit) for name, (value, unit) in settings.items()]
        for name, spread in {**self.margins, **self.times}.items():
            numbers = (spread.value, spread.low95, spread.high95, spread.worst)
            rows.append((name, *numbers, units.get(name, "")))
        columns = ["quantity", "value", "low95", "high95", "worst", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index("quantity")

    def to_dict(self) -> dict[str, Any]:
        """Settings, margins, numbers of the responses and findings; infinite numbers are null."""
        c = self.controller
        settings: dict[str, Any] = {
            "gain_unit": self.gain_unit,
            "setpoint_weight": c.setpoint_weight,
            "parallel": {"Kp": c.kp, "Ki_per_s": c.ki, "Kd_s": c.kd, "Tf_s": c.filter_s},
        }
        for name, form in self.forms.items():
            gain = "Kp" if name == "ideal" else "Kc"
            settings[name] = {
                gain: form.gain,
                "Ti_s": form.integral_s,
                "Td_s": form.derivative_s,
                "Tf_s": c.filter_s,
            }
        if c.sample_s:
            settings["sampled"] = {
                "sample_s": c.sample_s,
                "error_factor": c.kp,
                "integral_factor": c.ki * c.sample_s,
                "derivative_memory": c.derivative_memory,
                "derivative_factor": c.derivative_factor,
                "equations": c.difference_equation(),
            }
        content = {
            "schema": SCHEMA,
            "rule": self.rule,
            "controller": self.kind,
            "action": self.action,
            "model": self.plant.model_name,
            "input": {"name": self.plant.input_name, "unit": self.plant.unit_of_input},
            "output": {"name": self.plant.output_name, "unit": self.plant.unit_of_output},
            "reduced_model": self.reduced,
            "tau_c_s": self.tau_c_s,
            "max_ms": self.max_ms,
            "settings": settings,
            "margins": self.margins,
            "responses": self.times,
            "draws": len(self.plant.draws),
            "redrawn_share": self.plant.redrawn_share,
            "unstable_share": self.unstable_share,
            "findings": [finding.to_dict() for finding in self.findings],
        }
        plain = jsonable(content)
        assert isinstance(plain, dict)
        return plain

    def write(self, path: str | Path) -> Path:
        """Write the table (.csv), or all of the result (.json).

        Parameters
        ----------
        path
            File to write.

        Raises
        ------
        InputError
            For another ending.
        """
        target = Path(path)
        check_ending(target, CSV_OR_JSON)
        if target.suffix.lower() == ".json":
            return write_text(target, json_text(self.to_dict()))
        return write_log(self.to_frame().reset_index(), target, {"tcdyn": RESULTS})


def _text(number: float) -> str:
    """A number of the table with three digits."""
    if not isfinite(number):
        return "none" if number > 0 else "unstable"
    return f"{number:.3g}" if abs(number) < 1000 else f"{number:.0f}"


def _quotient(numerator: str, denominator: str) -> str:
    """Unit of a quotient.

    >>> _quotient("%", "K"), _quotient("input unit", "K")
    ('%/K', '(input unit)/K')
    """
    texts = [
        f"({text})" if " " in text or "/" in text else text for text in (numerator, denominator)
    ]
    return "/".join(texts)
