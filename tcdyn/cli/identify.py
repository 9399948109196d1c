"""Commands ``tcdyn identify`` (input-output data) and ``tcdyn response`` (frequency response).

The models and fits are :mod:`tcdyn.identification`. Tests:
``tests/identify/test_identify_results.py``.
"""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from tcdyn.cli.common import (
    Reporter,
    as_option,
    check_choice,
    check_outputs,
    count_progress,
    default_output_path,
    number_option,
    options_from_docstring,
    source_entry,
    write_json,
)
from tcdyn.core.errors import InputError
from tcdyn.io.endings import JSON, PAGE
from tcdyn.series.options import ReadingOptions

if TYPE_CHECKING:
    from tcdyn.identification import Model

# Infos about how the table was read, which are no part of a result.
ABOUT_READING = ("time.taken", "series.averages")


@options_from_docstring
def identify(
    data: Path,
    input: Annotated[list[str], typer.Option("--input", "-u")],
    output: Annotated[list[str], typer.Option("--output", "-y")],
    run: str | None = None,
    resample_s: Annotated[float | None, number_option(1e-9, 1e9)] = None,
    hold: list[str] | None = None,
    model: Annotated[list[str] | None, typer.Option("--model", "-m")] = None,
    gain: Annotated[float | None, number_option(-1e12, 1e12)] = None,
    cutoff_Hz: Annotated[float | None, number_option(1e-6, 1e9)] = None,
    poles: Annotated[int, typer.Option(min=1)] = 2,
    shape: str = "cascade",
    no_offset: bool = False,
    initial: str | None = None,
    noise: str = "auto",
    baseline: str = "auto",
    input_noise: str = "auto",
    check: bool = True,
    robust: bool = False,
    held_out: Annotated[float, number_option(0, 1, ends=False)] = 0.3,
    narx: bool = False,
    out: Path | None = None,
    report: Path | None = None,
    *,
    reading: ReadingOptions,
    reporter: Reporter,
) -> None:
    """Identify the dynamics between two columns: compare models, validate them, recommend one.

    Several inputs share one model, each with its own dead time. Several outputs get one model each,
    and a joint table.

    Example: tcdyn identify step.csv --input probe_degC --output a_degC --model P1D --model P2D
    --report step.html

    Parameters
    ----------
    data
        Table with one row for each sample: CSV, LVM, TDMS or Parquet.
    input
        Column of the input; repeat for several.
    output
        Column of the output; repeat for several.
    run
        Column whose values distinguish the runs.
    resample_s
        Resample uneven times to this interval in seconds.
    hold
        Input between samples: foh (straight line) or zoh (constant); repeat for each input
        (default: zoh for each input that was set in steps).
    model
        Model to compare, such as P1D, P2D or TF(1,2); repeat for several; for several inputs P1D+P2
        (one for each) or P1D (for all). Default: process models of one to three lags with or
        without dead time, zero, complex pair and integrator, under one model of the disturbance;
        with several inputs those that have an effect.
    gain
        Fix the static gain Kp at this value (process models).
    cutoff_Hz
        Cutoff of a known low-pass filter after the sensor [Hz]; it is not part of the lags.
    poles
        Poles of that filter.
    shape
        Shape of that filter: cascade (of first-order lags) or butterworth.
    no_offset
        The output has no offset.
    initial
        Initial state of each run: equilibrium, level (in equilibrium with another level of the
        input, which is estimated), zero or estimated (default: equilibrium, or what explains the
        start better).
    noise
        Noise of the output: white, slow (first-order, averaged over), ar, arma; auto: chosen from
        the data.
    baseline
        Baseline of the output: none, trend (a linear drift), walk (a random walk) or auto.
    input_noise
        Standard deviation of the noise of a measured input, in its unit; 0: none; auto: estimated
        from its samples.
    check
        Stop if the output moves before its input, or if the input is computed from the output.
    robust
        Use the Huber loss, against outliers.
    held_out
        Fraction of the record for validation (held-out part).
    narx
        Also test, by simulation and by NARX, whether the lag depends on the level.
    out
        JSON to write (default: DATA.identified.json).
    report
        HTML report to write (default: next to the JSON).
    """
    from tcdyn.chain import NO_CONDITIONING
    from tcdyn.identification import compare, from_csv, joint_table, read_identified
    from tcdyn.identification.disturbance import Baseline, NoiseName
    from tcdyn.identification.problem import Initial
    from tcdyn.report.dynamics import write_identify_report
    from tcdyn.rig.disk import FILTER_SHAPES, Conditioning

    if gain is not None and abs(gain) < 1e-12:
        raise InputError(
            f"--gain is {gain:g}",
            expected="a static gain other than 0",
        )
    holds = tuple(hold or ["auto"])
    for each in holds:
        check_choice("--hold", each, ("foh", "zoh") if len(holds) > 1 else ("auto", "foh", "zoh"))
    check_choice("--shape", shape, FILTER_SHAPES)
    check_choice("--noise", noise, get_args(NoiseName))
    check_choice("--baseline", baseline, get_args(Baseline))
    fit_settings: dict[str, Any] = {} if initial is None else {"initial": initial}
    fit_settings["input_noise"] = (
        "auto" if input_noise == "auto" else _standard_deviation(input_noise)
    )
    if (noise, baseline) != ("auto", "auto"):
        fit_settings |= {"noise": noise, "baseline": baseline}
    if initial is not None:
        check_choice("--initial", initial, get_args(Initial))
    inputs = _columns("--input", input)
    outputs = _columns("--output", output)
    if len(inputs) > 1 and (narx or gain is not None):
        raise InputError(
            f"{'--narx' if narx else '--gain'} with {len(inputs)} inputs",
            expected="one input",
            remedy="leave it out",
        )
    if narx:  # an error before the work
        from tcdyn.identification.narx import frols_with_polynomials

        frols_with_polynomials()
    base = out or default_output_path(data, ".identified.json")
    json_files = _files_of_outputs(base, outputs)
    if report:
        pages = _files_of_outputs(report, outputs)
    else:
        pages = {y: path.with_suffix(".html") for y, path in json_files.items()}
    for y in outputs:
        outputs_of_one = {"out": (json_files[y], JSON), "report": (pages[y], PAGE)}
        check_outputs([data], reporter.overwrite, **outputs_of_one)
    record = from_csv(
        data,
        input=inputs,
        output=outputs,
        run=run,
        resample_s=resample_s,
        hold=holds if len(holds) > 1 else holds[0],  # type: ignore[arg-type]
        **asdict(reading),
    )
    inputs = list(record.input_names)  # with the units that the file states
    filter_ = NO_CONDITIONING
    if cutoff_Hz is not None:
        filter_ = Conditioning(cutoff_Hz, poles, shape)  # type: ignore[arg-type]
    model_settings = {"offset": "none" if no_offset else "free", "known": filter_}
    fixed = {} if gain is None else {"Kp": gain}
    model_list = [_model(name, inputs, fixed, model_settings) for name in model or ()]
    fit_settings |= {
        "like": _model("P1", inputs[:1], fixed, model_settings),
        "loss": "huber" if robust else "linear",
        "check": check,
    }
    comparisons = {}
    contents = {}
    for y in outputs:
        one_output = record.select(output=y)
        with count_progress(len(model_list) or None, reporter.is_silent) as progress:
            comparison = compare(
                one_output, model_list, held_out=held_out, progress=progress, **fit_settings
            )
        comparisons[y] = comparison
        reporter.summary(comparison.summary(as_option))
        reporter.text(comparison.lag_removal_advice(filter_))
        content = comparison.best.identified.to_dict()
        content["averaged"] = comparison.averaged
        content["source"] = source_entry(data)
        content["reading"] = [each.to_dict() for each in record.reading]
        level_dependence = ""
        if narx:
            from tcdyn.identification.narx import temperature_dependence

            dependence = temperature_dependence(one_output, held_out=held_out)
            content["narx"] = dependence.to_dict()
            level_dependence = dependence.sentence
            reporter.text(level_dependence)
        write_json(json_files[y], content)
        read_identified(json_files[y])
        write_identify_report(pages[y], one_output, comparison, filter_, level_dependence, data)
        contents[y] = content
        reporter.text(f"wrote {json_files[y]} and {pages[y]}")
    reporter.json(lambda: contents[outputs[0]] if len(outputs) == 1 else contents)
    if len(outputs) > 1:
        reporter.text(joint_table(comparisons).to_string(index=False))
    of_best = [f for comparison in comparisons.values() for f in comparison.best.findings]
    guesses = [f for f in record.findings if f.code in ABOUT_READING and f not in of_best]
    reporter.finish(
        data.name,
        [*guesses, *of_best],
        [comparison.conclusion for comparison in comparisons.values()],
    )


@options_from_docstring
def response(
    data: Path,
    column: Annotated[list[str], typer.Option()],
    frequency: str = "frequency_Hz",
    form: str | None = None,
    frequency_unit: str | None = None,
    phase_unit: str | None = None,
    uncertainty: str | None = None,
    coherence: str | None = None,
    averages: Annotated[float | None, number_option(1, 1e12)] = None,
    model: Annotated[list[str] | None, typer.Option("--model", "-m")] = None,
    out: Path | None = None,
    *,
    reporter: Reporter,
) -> None:
    """Fit transfer functions to a measured frequency response.

    Of the fits without a warning, the one with the lowest BIC is written, unless another is better
    by a BIC of 10. The units are those of the header, such as w_rad_s, f (mHz), Magnitude (dB) and
    phase_deg, or of a row of units below it.

    Example: tcdyn response bode.csv --frequency f_Hz --column gain_dB --column phase_deg
    --form dB --coherence g2 --averages 20

    Parameters
    ----------
    data
        Table with one row for each frequency: CSV, LVM, TDMS or Parquet.
    column
        Column of the magnitude, then column of the phase; give it twice.
    frequency
        Column of the frequency.
    form
        Content of the two columns: magnitude or dB, each with the phase, or complex (real,
        imaginary). Default: that of the header, else magnitude.
    frequency_unit
        Unit of the frequency, if its header does not state it: Hz, mHz, kHz, rad/s.
    phase_unit
        Unit of the phase, if its header does not state it: deg, rad.
    uncertainty
        Column of the standard uncertainty of real and imaginary part.
    coherence
        Column of the coherence, instead of --uncertainty.
    averages
        Number of averages of that coherence.
    model
        Model to compare, such as P1D, P2D or TF(1,2); repeat for several (default: ten processes,
        P1 to P3D).
    out
        JSON to write (default: DATA.identified.json).
    """
    import pandas as pd

    from tcdyn.identification import (
        CANDIDATES,
        Response,
        best_response_fit,
        fit_response,
        read_identified,
    )

    if form is not None:
        check_choice("--form", form, ("magnitude", "dB", "complex"))
    pair = _columns("--column", column)
    if len(pair) != 2:
        raise InputError(
            f"--column is given {len(pair)} times", expected="twice: magnitude, then phase"
        )
    path = out or default_output_path(data, ".identified.json")
    check_outputs([data], reporter.overwrite, out=(path, JSON))
    measured = Response.read(
        data,
        frequency,
        (pair[0], pair[1]),
        form=form,
        frequency_unit=frequency_unit,
        phase_unit=phase_unit,
        u=uncertainty,
        coherence=coherence,
        averages=averages,
    )
    names = model or CANDIDATES
    fits = sorted(
        (fit_response(measured, name) for name in names),
        key=lambda fit: round(fit.statistics["bic"], 6),
    )  # among equals the first one named
    best = best_response_fit(fits)
    best = replace(best, input_name=frequency, output_name=" and ".join(pair))
    lowest_bic = fits[0].statistics["bic"]
    test = "white" if measured.unknown_uncertainty else "misfit"
    rows = [
        (
            fit.model.name,
            fit.statistics["fit_percent"],
            fit.statistics[f"p_{test}"],
            abs(fit.statistics["bic"] - lowest_bic),
        )
        for fit in fits
    ]
    table = pd.DataFrame(rows, columns=["model", "fit [%]", f"{test} p", "BIC above best"]).round(3)
    content = best.to_dict() | {"source": source_entry(data)}
    write_json(path, content)
    read_identified(path)
    reporter.json(lambda: content)
    reporter.summary(best.summary(as_option))
    reporter.text(f"\n{table.to_string(index=False)}\nwrote {path}")
    reporter.finish(data.name, best.findings)


def _columns(option: str, names: list[str]) -> list[str]:
    """The names of columns, checked.

    Parameters
    ----------
    option
        Name of the option, for the message.
    names
        What the user wrote.

    Raises
    ------
    InputError
        An empty or a repeated name.
    """
    if not all(names) or len(set(names)) < len(names):
        raise InputError(f"{option} is {' and '.join(names)}", expected="different columns")
    return names


def _files_of_outputs(path: Path, outputs: list[str]) -> dict[str, Path]:
    """File of each output.

    With several outputs its name contains that of the output.

    Parameters
    ----------
    path
        File that the user named.
    outputs
        Columns of the outputs.

    Returns
    -------
    files
        By output.

    Raises
    ------
    InputError
        If the names of two outputs differ only in characters that a file name cannot have, or in
        upper and lower case, which are the same on Windows.
    """
    if not path.name:
        raise InputError(f"{path} is a folder", expected="a file to write")
    if len(outputs) == 1:
        return {outputs[0]: path}
    stem, dot, ending = path.name.partition(".")
    files = {}
    for output in outputs:
        safe_name = re.sub(r"[^A-Za-z0-9_-]+", "_", output)
        files[output] = path.with_name(f"{stem}.{safe_name}{dot if ending else ''}{ending}")
    if len({file.name.casefold() for file in files.values()}) < len(outputs):
        raise InputError(
            f"the files of two outputs have one name ({', '.join(outputs)})",
            expected="names that differ in letters or digits",
            remedy="identify them one after the other, each with its own --out",
        )
    return files


def _standard_deviation(text: str) -> float:
    """The number of --input-noise."""
    try:
        sd = float(text)
    except ValueError:
        sd = float("nan")
    if sd != 0 and not 1e-12 <= sd <= 1e12:
        raise InputError(
            f"--input-noise is {text!r:.60}",
            expected="a standard deviation in the input's unit, or auto",
        )
    return sd


def _model(
    name: str, inputs: list[str], fixed: dict[str, float], model_settings: dict[str, Any]
) -> Model:
    """The named model with the constraints of the command.

    With several inputs, one model for all, or models separated by plus signs, one for each input.

    Parameters
    ----------
    name
        Name of a model, or several joined by plus signs.
    inputs
        Columns of the inputs.
    fixed
        Values of fixed parameters; those that the model does not have are left out.
    model_settings
        "offset" and "known" of the model.
    """
    from tcdyn.identification import KnownDynamics, several
    from tcdyn.identification.models import as_model

    parts = [part.strip() for part in name.split("+")]
    if len(inputs) > 1:
        return several(parts if len(parts) > 1 else parts * len(inputs), inputs, **model_settings)
    if len(parts) > 1:
        raise InputError(
            f"--model {name} names {len(parts)} parts", expected="one model for one input"
        )
    model = as_model(name)
    used = {name: value for name, value in fixed.items() if name in model.names}
    return replace(
        model,
        fixed={**model.fixed, **used},
        offset=model_settings["offset"],
        known=KnownDynamics.of(model_settings["known"]),
    )
