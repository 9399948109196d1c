"""``tcdyn identify DATA.csv --input u --output y``: any input-output table to a model, with validation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from calibration.disk import FILTER_SHAPES, Conditioning
from calibration.errors import InputError
from calibration.files.write import write_text
from calibration.words import SPOKEN
from tcdyn.chain import NO_CONDITIONING
from tcdyn.cli.common import Json, Quiet, bounded, check_choice, counted, dump, in_options, say, spare_inputs, within
from tcdyn.identify import CANDIDATES, compare, from_csv, read_identified
from tcdyn.identify.disturbance import BASELINES, NOISES


def identify(
    data: Annotated[Path, typer.Argument(help="Table, one row a sample: CSV, LVM, TDMS or Parquet.")],
    input: Annotated[str, typer.Option("--input", "-u", help="Column of the input.")],
    output: Annotated[str, typer.Option("--output", "-y", help="Column of the output.")],
    run: Annotated[str | None, typer.Option(help="Column whose values separate the recordings.")] = None,
    time: Annotated[
        str | None, typer.Option(help="Time column in seconds; time_s, time or t is found by itself.")
    ] = None,
    dt_s: Annotated[
        float | None, typer.Option("--dt", help="Sampling interval in seconds where there is no time.")
    ] = None,
    resample_s: Annotated[
        float | None, typer.Option("--resample", help="Put uneven times on a grid of so many seconds.")
    ] = None,
    hold: Annotated[str, typer.Option(help="Input between samples: foh (straight line) or zoh (held).")] = "foh",
    models: Annotated[str, typer.Option(help="Models to compare, such as P1D,P2D,TF(1,2).")] = ",".join(CANDIDATES),
    gain: Annotated[
        float | None,
        typer.Option(help="Hold the static gain Kp at this value (process models).", callback=within(-1e12, 1e12)),
    ] = None,
    cutoff_hz: Annotated[
        float | None,
        bounded(
            "--cutoff-Hz",
            "A known low-pass filter behind the sensor [Hz]: it is no part of the lags.",
            0,
            1e9,
            ends=False,
        ),
    ] = None,
    poles: Annotated[int, typer.Option(min=1, help="Poles of that filter.")] = 2,
    shape: Annotated[
        str, typer.Option(help="Shape of that filter: cascade (of single lags) or butterworth.")
    ] = "cascade",
    no_offset: Annotated[bool, typer.Option("--no-offset", help="The output has no offset.")] = False,
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
        str, typer.Option(help="What lies beneath the output: none, trend (a straight drift), walk (random) or auto.")
    ] = "auto",
    input_noise: Annotated[
        str,
        typer.Option(
            help="Noise of a measured input, its sd in the input's unit; 0: none; auto: from its own samples."
        ),
    ] = "auto",
    check: Annotated[bool, typer.Option(help="Refuse an output that moves before its input.")] = True,
    robust: Annotated[bool, typer.Option("--robust", help="Huber's loss, against spikes.")] = False,
    held_out: Annotated[
        float,
        typer.Option(help="Share of the record kept for the held-out score.", callback=within(0, 1, ends=False)),
    ] = 0.3,
    narx: Annotated[
        bool, typer.Option("--narx", help="Also ask, by simulation and by NARX, whether the lag depends on the level.")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", help="JSON to write (default: DATA.identified.json).")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="HTML to write (default: beside it).")] = None,
    json_: Json = False,
    quiet: Quiet = False,
) -> None:
    """Identify the dynamics between two columns: compare models, recommend one, say what its residuals say.

    Example: tcdyn identify step.csv --input probe_degC --output a_degC --models P1D,P2D --report step.html
    """
    if gain == 0:
        raise InputError("--gain is 0", expected="a static gain other than 0: nothing of the input would be seen")
    check_choice("--hold", hold, ("foh", "zoh"))
    check_choice("--shape", shape, FILTER_SHAPES)
    check_choice("--noise", noise, NOISES)
    check_choice("--baseline", baseline, BASELINES)
    begun: dict[str, Any] = {} if initial is None else {"initial": initial}
    begun["input_noise"] = "auto" if input_noise == "auto" else standard_deviation(input_noise)
    if (noise, baseline) != ("auto", "auto"):
        begun |= {"noise": noise, "baseline": baseline}
    if initial is not None:
        check_choice("--initial", initial, ("equilibrium", "zero", "estimated"))
    json_path = out or data.with_suffix(".identified.json")
    html_path = report or json_path.with_suffix(".html")
    spare_inputs([data], out=json_path, report=html_path)
    record = from_csv(data, input=input, output=output, run=run, time=time, dt_s=dt_s, resample_s=resample_s, hold=hold)
    fixed = {} if gain is None else {"Kp": gain}
    filter_ = NO_CONDITIONING if cutoff_hz is None else Conditioning(cutoff_hz, poles, shape)  # type: ignore[arg-type]
    structures = [
        structure(name.strip(), fixed, no_offset, filter_) for name in re.split(r",(?![^(]*\))", models) if name.strip()
    ]
    loss = "huber" if robust else "linear"
    with counted(len(structures), quiet or json_) as progress:
        comparison = compare(record, structures, held_out=held_out, progress=progress, loss=loss, check=check, **begun)
    if not (quiet or json_):
        typer.echo(in_options(comparison.summary(), SPOKEN))
        say(comparison.removal(filter_))
    content = comparison.best.identified.to_dict()
    level = ""
    if narx:
        from tcdyn.identify.narx import temperature_dependence

        dependence = temperature_dependence(record, held_out=held_out)
        content["narx"], level = dependence.to_dict(), dependence.sentence
        say(level, quiet or json_)
    from tcdyn.report.dynamics import write_identify_report

    write_text(json_path, dump(content))
    read_identified(json_path)
    write_identify_report(html_path, record, comparison, filter_, level)
    if json_:
        print(dump(content), end="")
        return
    say(f"wrote {json_path} and {html_path}", quiet)


def standard_deviation(text: str) -> float:
    """The number behind --input-noise."""
    try:
        sd = float(text)
    except ValueError:
        sd = float("nan")
    if not 0 <= sd < float("inf"):
        raise InputError(f"--input-noise is {text!r}", expected="a standard deviation in the input's unit, or auto")
    return sd


def structure(name: str, fixed: dict[str, float], no_offset: bool, filter_: Conditioning) -> Any:
    """The named model with the command's constraints."""
    from dataclasses import replace

    from tcdyn.identify.models import Known, as_model

    model = as_model(name)
    kept = {k: v for k, v in fixed.items() if k in model.names}
    offset = "none" if no_offset else model.offset
    return replace(model, fixed={**model.fixed, **kept}, offset=offset, known=Known.of(filter_))
