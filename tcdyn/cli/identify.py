"""Commands ``tcdyn identify`` (input-output data) and ``tcdyn response`` (frequency response).

The models and fits are :mod:`tcdyn.identification`. Tests:
``tests/identify/test_identify_results.py``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tcdyn.cli.common import (
    Reporter,
    as_option,
    check_outputs,
    count_progress,
    default_output_path,
    options_from_docstring,
    source_entries,
    source_entry,
    write_json,
)
from tcdyn.cli.tables import files_of_tables
from tcdyn.core.errors import InputError
from tcdyn.core.findings import unique
from tcdyn.identification.options import IdentifyOptions, ResponseOptions
from tcdyn.io.endings import JSON, PAGE

if TYPE_CHECKING:
    import pandas as pd

    from tcdyn.identification import Identified


@options_from_docstring
def identify(
    data: Annotated[list[Path], typer.Argument(metavar="DATA...")],
    input: Annotated[list[str], typer.Option("--input", "-u", rich_help_panel="Input")],
    output: Annotated[list[str], typer.Option("--output", "-y", rich_help_panel="Input")],
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    report: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    *,
    options: IdentifyOptions,
    reporter: Reporter,
) -> None:
    """Identify the dynamics between two columns: compare models, validate them, recommend one.

    Several inputs share one model, each with its own dead time. Several outputs get one model each,
    and a joint table.

    Example: tcdyn identify furnace.csv --input heater --output T1

    Chosen models and a report: tcdyn identify step.csv --input probe_degC --output a_degC --model
    P1D --model P2D --report step.html

    Several runs, a file each: tcdyn identify run1.csv run2.csv --input heater --output T1

    Parameters
    ----------
    data
        table with one row for each sample: CSV, LVM, TDMS, Parquet, .xlsx or .mat; several files, a
        folder or a pattern are runs
    input
        column of the input, with or without its unit; repeat for several
    output
        column of the output; repeat for several
    out
        JSON to write (default: DATA.identified.json)
    report
        HTML report to write (default: next to the JSON)
    """
    from tcdyn.identification import joint_table, read_identified
    from tcdyn.report.dynamics import write_identify_report
    from tcdyn.workflows.identify import IdentifiedOutput
    from tcdyn.workflows.identify import identify as identify_table

    paths, left_out = files_of_tables(data)
    json_files = _files_of_outputs(out or default_output_path(paths[0], ".identified.json"), output)
    pages = {y: path.with_suffix(".html") for y, path in json_files.items()}
    if report:
        pages = _files_of_outputs(report, output)
    for y in output:
        outputs_of_one = {"out": (json_files[y], JSON), "report": (pages[y], PAGE)}
        check_outputs(paths, reporter.overwrite, **outputs_of_one)
    contents = {}

    def write(y: str, found: IdentifiedOutput) -> None:
        """Write and report what was identified for an output."""
        comparison = found.comparison
        reporter.summary(comparison.summary(as_option))
        reporter.text(comparison.lag_removal_advice(found.known_filter))
        reporter.text(found.level_dependence)
        contents[y] = {**found.to_dict(), **source_entries(paths)}
        write_json(json_files[y], contents[y])
        read_identified(json_files[y])
        write_identify_report(
            pages[y], found.record, comparison, found.known_filter, found.level_dependence, paths[0]
        )
        reporter.text(f"wrote {json_files[y]} and {pages[y]}")

    results = identify_table(
        paths[0] if len(paths) == 1 else paths,
        input,
        output,
        progress=lambda count: count_progress(count or None, reporter.is_silent),
        done=write,
        **options.stated,
    )
    reporter.json(lambda: contents[output[0]] if len(output) == 1 else contents)
    comparisons = {y: found.comparison for y, found in results.items()}
    if len(output) > 1:
        reporter.text(joint_table(comparisons).to_string(index=False))
    findings = unique([finding for found in results.values() for finding in found.findings])
    conclusions = [comparison.conclusion for comparison in comparisons.values()]
    reporter.finish(paths[0].name, [*left_out, *findings], conclusions)


@options_from_docstring
def response(
    data: Path,
    column: Annotated[list[str], typer.Option(rich_help_panel="Input")],
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    *,
    options: ResponseOptions,
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
        table with one row for each frequency: CSV, LVM, TDMS or Parquet
    column
        column of the magnitude, then column of the phase; give it twice
    out
        JSON to write (default: DATA.identified.json)
    """
    from tcdyn.identification import (
        CANDIDATES,
        Response,
        best_response_fit,
        fit_response,
        read_identified,
    )

    if len(column) != 2 or column[0] == column[1]:
        raise InputError(
            f"--column is {' and '.join(column)}", expected="twice: magnitude, then phase"
        )
    path = out or default_output_path(data, ".identified.json")
    check_outputs([data], reporter.overwrite, out=(path, JSON))
    measured = Response.read(
        data,
        options.frequency,
        (column[0], column[1]),
        form=options.form,
        frequency_unit=options.frequency_unit,
        phase_unit=options.phase_unit,
        u=options.uncertainty,
        coherence=options.coherence,
        averages=options.averages,
        sheet=options.sheet,
        variable=options.variable,
    )
    names = options.models or CANDIDATES
    fits = sorted(
        (fit_response(measured, name) for name in names),
        key=lambda fit: round(fit.statistics["bic"], 6),
    )  # among equals the first one named
    best = best_response_fit(fits)
    best = replace(best, input_name=options.frequency, output_name=" and ".join(column))
    content = best.to_dict() | {"source": source_entry(data)}
    write_json(path, content)
    read_identified(path)
    table = _table_of_fits(fits, "white" if measured.unknown_uncertainty else "misfit")
    reporter.json(lambda: content)
    reporter.summary(best.summary(as_option))
    reporter.text(f"\n{table.to_string(index=False)}\nwrote {path}")
    reporter.finish(data.name, best.findings)


def _table_of_fits(fits: Sequence[Identified], test: str) -> pd.DataFrame:
    """One row for each fit to a frequency response.

    Parameters
    ----------
    fits
        The fits, the lowest BIC first.
    test
        Name of the test of the residuals whose p value is shown.
    """
    import pandas as pd

    lowest_bic = fits[0].statistics["bic"]
    rows = [
        (
            fit.model.name,
            fit.statistics["fit_percent"],
            fit.statistics[f"p_{test}"],
            abs(fit.statistics["bic"] - lowest_bic),
        )
        for fit in fits
    ]
    return pd.DataFrame(rows, columns=["model", "fit [%]", f"{test} p", "BIC above best"]).round(3)


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
