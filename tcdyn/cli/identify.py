"""``tcdyn identify DATA.csv --input u --output y``: any input-output table to a model, with validation."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tcdyn.cli.common import (
    Reporter,
    as_option,
    check_choice,
    check_outputs,
    count_progress,
    dump,
    exit_status,
    in_range,
    number_option,
    option_groups,
)
from tcdyn.core.errors import InputError

if TYPE_CHECKING:
    from tcdyn.identify import Model


@option_groups
def identify(
    data: Annotated[
        Path, typer.Argument(help="Table, one row a sample: CSV, LVM, TDMS or Parquet.")
    ],
    input: Annotated[
        str, typer.Option("--input", "-u", help="Column of the input; several with commas: a,b.")
    ],
    output: Annotated[
        str, typer.Option("--output", "-y", help="Column of the output; several with commas.")
    ],
    run: Annotated[
        str | None, typer.Option(help="Column whose values separate the recordings.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(
            help="Time column; time_s, Time (ms), t and the like are found by themselves."
        ),
    ] = None,
    time_unit: Annotated[
        str | None,
        typer.Option(
            "--time-unit", help="Unit of the time, where its header does not say it: s, ms, min."
        ),
    ] = None,
    dt_s: Annotated[
        float | None,
        number_option("--dt", "Sampling interval in seconds where there is no time.", 1e-9, 1e9),
    ] = None,
    resample_s: Annotated[
        float | None,
        number_option("--resample", "Put uneven times on a grid of so many seconds.", 1e-9, 1e9),
    ] = None,
    hold: Annotated[
        str,
        typer.Option(
            help="Input between samples: foh (straight line), zoh (held); auto: held where it was set."
        ),
    ] = "auto",
    models: Annotated[
        str,
        typer.Option(
            help="Models to compare, such as P1D,P2D,TF(1,2); of several inputs P1D+P2, one for each, or P1D for all. "
            "grow: from one lag on, orders, dead times, zeros and inputs are added until the criterion stops."
        ),
    ] = "grow",
    gain: Annotated[
        float | None,
        typer.Option(
            help="Hold the static gain Kp at this value (process models).",
            callback=in_range(-1e12, 1e12),
        ),
    ] = None,
    cutoff_hz: Annotated[
        float | None,
        number_option(
            "--cutoff-Hz",
            "A known low-pass filter behind the sensor [Hz]: it is no part of the lags.",
            1e-6,
            1e9,
        ),
    ] = None,
    poles: Annotated[int, typer.Option(min=1, help="Poles of that filter.")] = 2,
    shape: Annotated[
        str, typer.Option(help="Shape of that filter: cascade (of single lags) or butterworth.")
    ] = "cascade",
    no_offset: Annotated[
        bool, typer.Option("--no-offset", help="The output has no offset.")
    ] = False,
    initial: Annotated[
        str | None,
        typer.Option(
            help="Start of each run: equilibrium, zero or estimated. Without it equilibrium, and estimated where a run "
            "starts off it."
        ),
    ] = None,
    noise: Annotated[
        str,
        typer.Option(
            help="Noise of the output: white, slow (first-order, averaged over), ar, arma; auto: as the data ask."
        ),
    ] = "auto",
    baseline: Annotated[
        str,
        typer.Option(
            help="What lies beneath the output: none, trend (a straight drift), walk (random) or auto."
        ),
    ] = "auto",
    input_noise: Annotated[
        str,
        typer.Option(
            help="Noise of a measured input, its sd in the input's unit; 0: none; auto: from its own samples."
        ),
    ] = "auto",
    check: Annotated[
        bool,
        typer.Option(
            help="Refuse an output that moves before its input, and an input computed from the output."
        ),
    ] = True,
    robust: Annotated[bool, typer.Option("--robust", help="Huber's loss, against spikes.")] = False,
    held_out: Annotated[
        float,
        typer.Option(
            help="Share of the record kept for the held-out score.",
            callback=in_range(0, 1, ends=False),
        ),
    ] = 0.3,
    narx: Annotated[
        bool,
        typer.Option(
            "--narx",
            help="Also ask, by simulation and by NARX, whether the lag depends on the level.",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="JSON to write (default: DATA.identified.json).")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="HTML to write (default: beside it).")
    ] = None,
    *,
    reporter: Reporter,
) -> None:
    """Identify the dynamics between two columns: compare models, recommend one, say what its residuals say.

    Several inputs share one model, each with its own dead time; several outputs get a model each, and a joint table.

    Example: tcdyn identify step.csv --input probe_degC --output a_degC --models P1D,P2D --report step.html
    """
    from tcdyn.chain import NO_CONDITIONING
    from tcdyn.identify import compare, from_csv, joint_table, read_identified
    from tcdyn.identify.disturbance import BASELINES, NOISES
    from tcdyn.io.write import write_text
    from tcdyn.rig.disk import FILTER_SHAPES, Conditioning

    if gain is not None and abs(gain) < 1e-12:
        raise InputError(
            f"--gain is {gain:g}",
            expected="a static gain other than 0: nothing else shows the input",
        )
    check_choice("--hold", hold, ("auto", "foh", "zoh"))
    check_choice("--shape", shape, FILTER_SHAPES)
    check_choice("--noise", noise, NOISES)
    check_choice("--baseline", baseline, BASELINES)
    begun: dict[str, Any] = {} if initial is None else {"initial": initial}
    begun["input_noise"] = "auto" if input_noise == "auto" else standard_deviation(input_noise)
    if (noise, baseline) != ("auto", "auto"):
        begun |= {"noise": noise, "baseline": baseline}
    if initial is not None:
        check_choice("--initial", initial, ("equilibrium", "zero", "estimated"))
    inputs = columns("--input", input)
    outputs = columns("--output", output)
    if len(inputs) > 1 and (narx or gain is not None):
        raise InputError(
            f"{'--narx' if narx else '--gain'} with {len(inputs)} inputs",
            expected="one input",
            remedy="leave it out",
        )
    base = out or data.with_suffix(".identified.json")
    jsons = {
        y: base if len(outputs) == 1 else base.with_name(of_output(base.name, y)) for y in outputs
    }
    pages = {y: path.with_suffix(".html") for y, path in jsons.items()}
    if report:
        pages = {
            y: report if len(outputs) == 1 else report.with_name(of_output(report.name, y))
            for y in outputs
        }
    for y in outputs:
        check_outputs([data], out=jsons[y], report=pages[y])
    record = from_csv(
        data,
        input=inputs,
        output=outputs,
        run=run,
        time=time,
        time_unit=time_unit,
        dt_s=dt_s,
        resample_s=resample_s,
        hold=hold,
    )
    filter_ = NO_CONDITIONING if cutoff_hz is None else Conditioning(cutoff_hz, poles, shape)  # type: ignore[arg-type]
    asked = {"offset": "none" if no_offset else "free", "known": filter_}
    fixed = {} if gain is None else {"Kp": gain}
    structures = (
        []
        if models.strip() == "grow"
        else [structure(n, inputs, fixed, asked) for n in names_of(models)]
    )
    begun |= {
        "like": structure("P1", inputs[:1], fixed, asked),
        "loss": "huber" if robust else "linear",
        "check": check,
    }
    found = {}
    contents = {}
    for y in outputs:
        one = record.select(output=y)
        with count_progress(len(structures) or None, reporter.is_silent) as progress:
            found[y] = comparison = compare(
                one, structures, held_out=held_out, progress=progress, **begun
            )
        reporter.text(f"{comparison.summary(as_option)}\n{comparison.removal(filter_)}")
        content = comparison.best.identified.to_dict()
        level = ""
        if narx:
            from tcdyn.identify.narx import temperature_dependence

            dependence = temperature_dependence(one, held_out=held_out)
            content["narx"], level = dependence.to_dict(), dependence.sentence
            reporter.text(level)
        from tcdyn.report.dynamics import write_identify_report

        write_text(jsons[y], dump(content))
        read_identified(jsons[y])
        write_identify_report(pages[y], one, comparison, filter_, level, data)
        contents[y] = content
        reporter.text(f"wrote {jsons[y]} and {pages[y]}")
    reporter.json(lambda: contents[outputs[0]] if len(outputs) == 1 else contents)
    if len(outputs) > 1:
        reporter.text(joint_table(found).to_string(index=False))
    exit_status(data.name, [f for c in found.values() for f in (c.verdict, *c.best.findings)])


@option_groups
def response(
    data: Annotated[
        Path, typer.Argument(help="Table, one row a frequency: CSV, LVM, TDMS or Parquet.")
    ],
    columns_: Annotated[
        str, typer.Option("--columns", help="Magnitude and phase in degrees: two columns, a,b.")
    ],
    frequency: Annotated[str, typer.Option(help="Column of the frequency in Hz.")] = "frequency_Hz",
    form: Annotated[
        str,
        typer.Option(
            help="What --columns hold: magnitude or dB, each with the phase, or complex (real, imaginary)."
        ),
    ] = "magnitude",
    u: Annotated[
        str | None,
        typer.Option("--u", help="Column of the uncertainty (1 sd) of real and imaginary part."),
    ] = None,
    coherence: Annotated[
        str | None, typer.Option(help="Column of the coherence, in place of --u.")
    ] = None,
    averages: Annotated[
        float | None, typer.Option(help="Averages of that coherence.", callback=in_range(1, 1e12))
    ] = None,
    models: Annotated[
        str | None,
        typer.Option(
            help="Models to compare, such as P1D,P2D,TF(1,2) (default: ten processes, P1 to P3D)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="JSON to write (default: DATA.identified.json).")
    ] = None,
    *,
    reporter: Reporter,
) -> None:
    """Fit transfer functions to a measured frequency response; of those without a warning, the least BIC is written.

    Example: tcdyn response bode.csv --frequency f_Hz --columns gain_dB,phase_deg --form dB --coherence g2 --averages 20
    """
    import pandas as pd

    from tcdyn.core.findings import warnings_and_errors
    from tcdyn.identify import CANDIDATES, Response, fit_response, read_identified
    from tcdyn.io.write import write_text

    check_choice("--form", form, ("magnitude", "dB", "complex"))
    both = columns("--columns", columns_)
    if len(both) != 2:
        raise InputError(f"--columns is {columns_!r}", expected="two columns with a comma between")
    path = out or data.with_suffix(".identified.json")
    check_outputs([data], out=path)
    measured = Response.read(
        data, frequency, (both[0], both[1]), form=form, u=u, coherence=coherence, averages=averages
    )
    names = names_of(models) if models else CANDIDATES
    fits = sorted(
        (fit_response(measured, name) for name in names),
        key=lambda f: round(f.statistics["bic"], 6),
    )  # of equals the first named
    best = next((f for f in fits if not warnings_and_errors(f.findings)), fits[0])
    best = replace(best, input_name=frequency, output_name=" and ".join(both))
    least = fits[0].statistics["bic"]
    rows = [
        (
            f.model.name,
            *(f.statistics[k] for k in ("fit_percent", "p_misfit")),
            abs(f.statistics["bic"] - least),
        )
        for f in fits
    ]
    table = pd.DataFrame(rows, columns=["model", "fit [%]", "misfit p", "BIC above best"]).round(3)
    write_text(path, dump(best.to_dict()))
    read_identified(path)
    reporter.json(best.to_dict)
    reporter.text(f"{best.summary(as_option)}\n\n{table.to_string(index=False)}\nwrote {path}")
    exit_status(data.name, best.findings)


def columns(option: str, text: str) -> list[str]:
    """The names between the commas; InputError for an empty or a repeated one."""
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise InputError(
            f"{option} is {text!r}", expected="a column, or different ones between commas"
        )
    return names


def of_output(name: str, output: str) -> str:
    """The file's name with that of the output before its endings."""
    stem, _, ending = name.partition(".")
    return f"{stem}.{re.sub(r'[^A-Za-z0-9_-]+', '_', output)}{'.' + ending if ending else ''}"


def names_of(models: str) -> list[str]:
    """The models between the commas that stand in no bracket."""
    return [name.strip() for name in re.split(r",(?![^(]*\))", models) if name.strip()]


def standard_deviation(text: str) -> float:
    """The number behind --input-noise."""
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


def structure(
    name: str, inputs: list[str], fixed: dict[str, float], asked: dict[str, Any]
) -> Model:
    """The named model with the command's constraints: behind each input, or of several between plus signs one behind
    each."""
    from tcdyn.identify import Known, several
    from tcdyn.identify.models import as_model

    parts = [part.strip() for part in name.split("+")]
    if len(inputs) > 1:
        return several(parts if len(parts) > 1 else parts * len(inputs), inputs, **asked)
    if len(parts) > 1:
        raise InputError(f"--models {name} names {len(parts)} parts", expected="one, for one input")
    model = as_model(name)
    kept = {k: v for k, v in fixed.items() if k in model.names}
    return replace(
        model, fixed={**model.fixed, **kept}, offset=asked["offset"], known=Known.of(asked["known"])
    )
