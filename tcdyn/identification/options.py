"""Options of ``tcdyn identify``: one dataclass, for the command and for the function.

See :mod:`tcdyn.core.options` and :mod:`tcdyn.workflows.identify`. Tests:
``tests/identify/test_identify_results.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from tcdyn.chain.known_filter import FilterOptions
from tcdyn.core.arguments import described
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.identification.disturbance import Baseline, NoiseName
from tcdyn.identification.problem import Initial
from tcdyn.series.options import ReadingOptions

# Largest number that is no mistake in any unit, and least size of a gain.
LARGEST = 1e12
LEAST_GAIN = 1e-12
HOLDS = ("auto", "foh", "zoh")


@dataclass(frozen=True)
class RecordOptions(ReadingOptions):
    """How input-output data are read from a table.

    Attributes
    ----------
    run
        column whose values distinguish the runs
    resample_s
        resample uneven times to this interval [s]
    hold
        input between samples: foh (straight line) or zoh (constant); repeat for each input
        (default: zoh for each input that was set in steps)
    """

    run: str | None = option()
    resample_s: float | None = option(low=1e-9, high=1e9)
    hold: str | Sequence[str] | None = option(choices=HOLDS, takes=list[str])

    @property
    def holds(self) -> Any:
        """The hold of all inputs, or a tuple with that of each.

        Raises
        ------
        InputError
            For "auto" as the hold of one of several inputs.
        """
        if self.hold is None or isinstance(self.hold, str):
            return self.hold or "auto"
        holds = tuple(self.hold)
        if len(holds) == 1:
            return holds[0]
        if "auto" in holds:
            raise InputError(
                "{hold} is 'auto' for one of several inputs",
                expected="foh or zoh for each",
                parameters={"hold": None},
            )
        return holds


@dataclass(frozen=True)
class IdentifyOptions(FilterOptions, RecordOptions):
    """How models are compared.

    Attributes
    ----------
    model
        model to compare, such as P1D, P2D or TF(1,2); repeat for several; for several inputs P1D+P2
        (one for each) or P1D (for all). Default: process models of one to three lags with or
        without dead time, zero, complex pair and integrator, under one model of the disturbance;
        with several inputs those that have an effect
    sensor
        sensor that measures the output: *.sensor.json, or its lag [s] such as 25+-1; the result is
        the plant without it (default: the models contain the sensor)
    gain
        fix the static gain Kp at this value (process models)
    no_offset
        the output has no offset
    initial
        initial state of each run: equilibrium, level (in equilibrium with another level of the
        input, which is estimated), zero or estimated (default: equilibrium, or what explains the
        start better)
    noise
        noise of the output: white, ar, arma, or slow (auto): averaged over white and slow noise
    baseline
        baseline of the output: none, trend (a linear drift), walk (a random walk), or auto: with
        slow noise averaged over slow waves, else none
    input_noise
        standard deviation of the noise of a measured input, in its unit; 0: none; auto: estimated
        from its samples
    check
        stop if the output moves before its input, or if the input is computed from the output
    robust
        use the Huber loss, against outliers
    held_out
        fraction of the record for validation (held-out part)
    narx
        also test, by simulation and by NARX, whether the lag depends on the level
    """

    model: str | Sequence[str] = option((), "Model", short="-m", takes=list[str])
    sensor: Any = option(None, "Sensor", takes=Path)
    gain: float | None = option(None, "Model", low=-LARGEST, high=LARGEST)
    no_offset: bool = option(False, "Model")
    initial: Initial | None = option(None, "Model", choices=get_args(Initial), takes=str)
    noise: NoiseName = option("auto", "Model", choices=get_args(NoiseName), takes=str)
    baseline: Baseline = option("auto", "Model", choices=get_args(Baseline), takes=str)
    input_noise: float | str = option("auto", "Model", takes=str)
    check: bool = option(True, "Advanced")
    robust: bool = option(False, "Model")
    held_out: float = option(0.3, "Model", low=0, high=1, ends=False)
    narx: bool = option(False, "Advanced")

    def __post_init__(self) -> None:
        """Check the options, and that the gain is not zero.

        Raises
        ------
        InputError
            For a value that is not allowed.
        """
        super().__post_init__()
        if self.gain is not None and abs(self.gain) < LEAST_GAIN:
            raise InputError(
                f"{{gain}} is {self.gain:g}",
                expected="a static gain other than 0",
                parameters={"gain": None},
            )

    @property
    def models(self) -> list[str]:
        """Names of the models to compare."""
        return [self.model] if isinstance(self.model, str) else list(self.model)

    @property
    def input_noise_sd(self) -> float | Literal["auto"]:
        """Standard deviation of the noise of the input, or "auto".

        Raises
        ------
        InputError
            For another text or number.
        """
        if self.input_noise == "auto":
            return "auto"
        try:
            sd = float(self.input_noise)
        except ValueError:
            sd = float("nan")
        if sd != 0 and not 1 / LARGEST <= sd <= LARGEST:
            raise InputError(
                f"{{input_noise}} is {described(self.input_noise)}",
                expected="a standard deviation in the input's unit, or auto",
                parameters={"input_noise": None},
            )
        return sd

    @property
    def fit_settings(self) -> dict[str, Any]:
        """Options of :func:`tcdyn.identification.fit` that do not depend on the record."""
        settings: dict[str, Any] = {"input_noise": self.input_noise_sd, "check": self.check}
        settings["loss"] = "huber" if self.robust else "linear"
        if self.initial is not None:
            settings["initial"] = self.initial
        if (self.noise, self.baseline) != ("auto", "auto"):
            settings |= {"noise": self.noise, "baseline": self.baseline}
        return settings


@dataclass(frozen=True)
class ResponseOptions(Options):
    """How a frequency response is read and fitted.

    Attributes
    ----------
    frequency
        column of the frequency
    form
        content of the two columns: magnitude or dB, each with the phase, or complex (real,
        imaginary); default: that of the header, else magnitude
    frequency_unit
        unit of the frequency, if its header does not state it: Hz, mHz, kHz, rad/s
    phase_unit
        unit of the phase, if its header does not state it: deg, rad
    uncertainty
        column of the standard uncertainty of real and imaginary part
    coherence
        column of the coherence, instead of {uncertainty}
    averages
        number of averages of that coherence
    model
        model to compare, such as P1D, P2D or TF(1,2); repeat for several (default: ten processes,
        P1 to P3D)
    sheet
        sheet of an .xlsx workbook, if it has several with tables
    variable
        variable of a .mat file with the table, such as log or log.data
    """

    frequency: str = option("frequency_Hz")
    form: str | None = option(choices=("magnitude", "dB", "complex"))
    frequency_unit: str | None = option()
    phase_unit: str | None = option()
    uncertainty: str | None = option()
    coherence: str | None = option()
    averages: float | None = option(low=1, high=LARGEST)
    sheet: str | None = option()
    variable: str | None = option()
    model: str | Sequence[str] = option((), "Model", short="-m", takes=list[str])

    @property
    def models(self) -> list[str]:
        """Names of the models to compare; empty: the usual ones."""
        return [self.model] if isinstance(self.model, str) else list(self.model)
