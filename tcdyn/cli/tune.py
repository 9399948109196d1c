"""Command ``tcdyn tune``: settings of a PI or PID controller for an identified model.

Tests: ``tests/tuning/test_tune_command.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tcdyn.cli.common import (
    OptionalPicture,
    Reporter,
    as_option,
    check_outputs,
    options_from_docstring,
    save_picture,
    source_entry,
    write_json,
)
from tcdyn.io.endings import CSV_OR_JSON, PICTURE
from tcdyn.tuning.options import TuneOptions


@options_from_docstring
def tune(
    model: Annotated[Path, typer.Argument(metavar="MODEL")],
    input: Annotated[str | None, typer.Option("--input", "-u", rich_help_panel="Input")] = None,
    picture: OptionalPicture = None,
    out: Annotated[Path | None, typer.Option(rich_help_panel="Output")] = None,
    *,
    chosen: TuneOptions,
    reporter: Reporter,
) -> None:
    """Compute settings of a PI or PID controller from an identified model.

    Prints Kp, Ki and Kd, the ideal and the series form, margins, and responses to set point and
    load, each with its range over the models that the record permits. Limits of the controller
    output are not considered.

    Example: tcdyn tune heater.identified.json --controller pid --sample-s 1 --picture tune.png

    Parameters
    ----------
    model
        *.identified.json of tcdyn identify
    input
        column that the controller sets, of a model with several inputs
    out
        settings to write: a table (.csv), or all of the result (.json)
    """
    from tcdyn.core.options import options_of
    from tcdyn.identification import read_identified
    from tcdyn.tuning import tune_plant

    check_outputs([model], reporter.overwrite, picture=(picture, PICTURE), out=(out, CSV_OR_JSON))
    plant = read_identified(model).plant(input)
    result = tune_plant(plant, options_of(TuneOptions, chosen.stated, "tune"))
    content = {**result.to_dict(), "source": source_entry(model)}
    if out is not None and out.suffix.lower() == ".json":
        write_json(out, content)
    elif out is not None:
        result.write(out)
    if picture is not None:
        from tcdyn.plots.tune import tuning_figure

        save_picture(tuning_figure(result), picture)
    reporter.json(lambda: content)
    reporter.summary(result.summary(as_option))
    reporter.files(picture=picture, settings=out)
    reporter.finish(model.name, result.findings)
