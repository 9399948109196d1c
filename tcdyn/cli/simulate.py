"""Commands ``tcdyn simulate`` (logs of the synthetic rig) and ``tcdyn demo`` (all stages).

The synthetic rig is :mod:`tcdyn.simulate`, the demo :mod:`tcdyn.workflows.demo`. The true values
are written to separate files, which no estimator reads. Tests: ``tests/simulate``.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from tcdyn.cli.common import (
    Disk,
    Reporter,
    Verbose,
    check_choice,
    check_folder,
    check_outputs,
    count_progress,
    default_output_path,
    number_option,
    options_from_docstring,
    stage_progress,
)
from tcdyn.cli.record import rich_table
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.io.endings import CSV, JSON, PAGE, TABLE

if TYPE_CHECKING:
    import pandas as pd

    from tcdyn.simulate.truth import BoreContact, RigTruth

app = typer.Typer(
    name="simulate",
    help="Write logs of the synthetic rig, with the true values in files next to them.",
    no_args_is_help=True,
    add_completion=False,
)

Out = Annotated[Path, typer.Option(help="CSV file to write")]
Seed = Annotated[
    int, typer.Option(min=0, help="random seed; the same seed gives the same rig and the same file")
]
Test = Annotated[str, typer.Option(help="test A1 to D4 (table 6.1)")]
Beta = Annotated[
    float | None,
    number_option(0, 1, help="true heat partition (default: random)"),
]
RigPath = Annotated[Path | None, typer.Option(help="rig.toml (default: the default values)")]
Uneven = Annotated[
    list[str] | None,
    typer.Option(
        help="bore contact around the disk: 0.5@30 conducts 1 + 0.5 cos(angle - 30 deg) times its "
        "mean, fast:0.5@30 for one disk; repeat for several"
    ),
]
Clean = Annotated[
    bool,
    typer.Option(help="no noise, spikes, static errors, drift or quantisation; only the dynamics"),
]


@dataclass(frozen=True)
class SimulatedRig(Options):
    """Options for the rig whose logs are simulated.

    Attributes
    ----------
    seed
        seed of the random numbers
    rig
        rig.toml; without it the defaults are used
    uncertain
        random steel, depths, washers and so on, within the uncertainties of rig.toml
    clean
        no noise, spikes, static errors, drift or quantisation; only the dynamics
    """

    seed: int = option(0, "Advanced", low=0, high=float("inf"))
    rig: Path | None = option(None, "Input")
    uncertain: bool = option(False, "Advanced")
    clean: bool = option(False, "Advanced")

    def truth(self) -> RigTruth:
        """The true values of the rig."""
        from tcdyn.rig.rigfile import load_rig
        from tcdyn.simulate.truth import CLEAN, draw_truth

        truth = draw_truth(self.seed, load_rig(self.rig), uncertain=self.uncertain)
        return truth.with_imperfections(CLEAN) if self.clean else truth

    def for_log(self, out: Path, reporter: Reporter) -> RigTruth:
        """The true values for a log that is written to ``out``.

        A simulated log may be replaced by another one.

        Parameters
        ----------
        out
            CSV to write.
        reporter
            Output of the command.

        Raises
        ------
        InputError
            Another ending, or a file that is an input.
        """
        overwrite = reporter.overwrite or _is_simulated(out)
        truth_json, traces = _truth_files(out)
        check_outputs(
            [self.rig], overwrite, out=(out, CSV), truth=(truth_json, JSON), traces=(traces, TABLE)
        )
        return self.truth()


@app.command()
@options_from_docstring
def oven(out: Out, disk: Disk = "fast", *, simulated: SimulatedRig, reporter: Reporter) -> None:
    """Simulate the oven calibration of one disk, 20 to 160 degC, three repeats.

    Example: tcdyn simulate oven --out oven_fast.csv --disk fast --seed 7
    """
    from tcdyn.simulate.measure import simulate_oven

    truth = simulated.for_log(out, reporter)
    _write(out, reporter, *simulate_oven(disk, simulated.seed, truth))


@app.command()
@options_from_docstring
def immersion(
    out: Out,
    disk: Disk = "fast",
    bath_degC: Annotated[float, number_option(-60, 400)] = 110.0,
    fluid: str = "mobil-jet-ii",
    duration_s: Annotated[float, number_option(10, 3600)] = 140.0,
    plunge: Annotated[int, typer.Option(min=1)] = 1,
    *,
    simulated: SimulatedRig,
    reporter: Reporter,
) -> None:
    """Simulate a plunge of one disk into a hot bath.

    Example: tcdyn simulate immersion --out P1.csv --bath-degC 110 --fluid mobil-jet-ii

    Parameters
    ----------
    bath_degC
        temperature of the bath
    fluid
        mobil-jet-ii or water
    duration_s
        length of the log after the entry in seconds
    plunge
        number of the plunge; each is another plunge of the same rig
    """
    from tcdyn.simulate.bath import FLUIDS
    from tcdyn.simulate.plunge import PlungeOptions, simulate_plunge

    check_choice("--fluid", fluid, FLUIDS)
    truth = simulated.for_log(out, reporter)
    options = PlungeOptions(after_s=duration_s)
    frame, truth_values = simulate_plunge(
        disk,
        simulated.seed,
        fluid,  # type: ignore[arg-type]
        bath_degC,
        plunge,
        truth,
        options,
    )
    _write(out, reporter, frame, truth_values)


@app.command()
@options_from_docstring
def hole(out: Out, seed: Seed = 0, clean: Clean = False, *, reporter: Reporter) -> None:
    """Simulate the comparison of holes of section 5.4.

    Clamped and cemented junctions are plunged into hot water.

    Example: tcdyn simulate hole --out hole.csv
    """
    from tcdyn.simulate.plunge import simulate_hole

    _write(
        out, reporter, *simulate_hole(seed, SimulatedRig(seed, clean=clean).for_log(out, reporter))
    )


@app.command()
@options_from_docstring
def ehl(
    out: Out,
    test: Test = "B3",
    beta: Beta = None,
    unloading_s: Annotated[float, number_option(0.001, 10)] = 0.02,
    brake_s: Annotated[float | None, number_option(0.1, 1e6)] = None,
    again: list[str] | None = None,
    uneven: Uneven = None,
    film_air_K: Annotated[float, number_option(-50, 50)] = 0.0,
    *,
    simulated: SimulatedRig,
    reporter: Reporter,
) -> None:
    """Simulate an EHL test of both disks: warm running, loading, unloading, cooling.

    Example: tcdyn simulate ehl --out D4.csv --test D4 --beta 0.65 --unloading-s 1.5 --brake-s 3
    --again 0.2@1 --uneven slow:0.5@30

    Parameters
    ----------
    unloading_s
        time in seconds in which load and friction fall to zero; 1.5 in figure 4.20
    brake_s
        time in seconds after the unloading in which both speeds fall to 1/e
    again
        another contact after the unloading: length@time after it, in seconds; repeat for several
    film_air_K
        temperature of the air at the running surfaces, above the ambient [K]
    """
    from tcdyn.simulate.ehl import EhlOptions, simulate_ehl

    truth = (
        simulated.for_log(out, reporter)
        .with_uneven(bore_contacts(uneven))
        .with_film_air(film_air_K)
    )
    options = EhlOptions(
        beta=beta,
        parting_s=unloading_s,
        brake_s=brake_s,
        again_s=tuple(_contact_again(text) for text in again or ()),
    )
    _write(out, reporter, *simulate_ehl(test, simulated.seed, truth, options))


@app.command()
@options_from_docstring
def campaign(
    out: Annotated[Path, typer.Option()],
    test: list[str] | None = None,
    bath_degC: Annotated[list[float] | None, number_option(-60, 400)] = None,
    workers: Annotated[int, typer.Option(min=1, max=256)] = 1,
    *,
    simulated: SimulatedRig,
    reporter: Reporter,
) -> None:
    """Simulate a complete campaign: rig.toml, oven logs, plunge logs, EHL tests and truth/.

    Example: tcdyn simulate campaign --out lab --test B3 --test D4 --seed 7

    Parameters
    ----------
    out
        folder to write
    test
        test A1 to D4, or all (default B3); repeat for several
    bath_degC
        bath temperature of a plunge; repeat for several
    workers
        worker processes on this machine
    """
    from tcdyn.core.parallel import worker_processes_end
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.simulate.campaign import ALL_TESTS, DEFAULT_PLUNGES, PlannedPlunge, simulate_campaign

    check_folder(out)
    tests = tuple(test or ("B3",))
    if "all" in tests:
        tests = ALL_TESTS
    plunges = tuple(PlannedPlunge(b) for b in bath_degC) if bath_degC else DEFAULT_PLUNGES
    with (
        worker_processes_end() if workers > 1 else nullcontext(),
        count_progress(None, reporter.is_silent) as progress,
    ):
        files = simulate_campaign(
            out,
            simulated.seed,
            tests,
            plunges,
            rig=load_rig(simulated.rig),
            truth=simulated.truth(),
            n_jobs=workers,
            progress=progress,
        )
    reporter.json(lambda: files)
    reporter.summary(files.summary())


@options_from_docstring
def demo(
    out: Path = Path("demo"),
    seed: Annotated[int, typer.Option(min=0)] = 1,
    test: list[str] | None = None,
    verbose: Verbose = False,
    *,
    reporter: Reporter,
) -> None:
    """Simulate a campaign, run all stages on its logs and write the report.

    The folder gets logs, records, compensated traces, beta.json and report.html. As the campaign is
    simulated, the true value is printed next to every result. No stage reads it.

    Example: tcdyn demo --out demo --seed 4 --test A1 --test D4

    Parameters
    ----------
    out
        folder to write
    seed
        random seed; each seed is another rig
    test
        test of table 6.1 (default B3); repeat for several
    """
    from tcdyn.report.beta import write_beta_report
    from tcdyn.report.sources import source_table
    from tcdyn.workflows import run_demo

    tests = tuple(test or ("B3",))
    _check_demo_folder(out, tests, reporter.overwrite)
    with stage_progress(reporter.is_silent, verbose) as progress:
        run = run_demo(out, seed, tests, progress=progress)
        progress("writing the report")
        truths = {
            name: float(
                run.comparison.query(f"quantity == '{name} beta, speed law'")["truth"].iloc[0]
            )
            for name in run.tests
        }
        partitions = {n: b.partition for n, b in run.tests.items()}
        files = [out / f"{disk}.disk.json" for disk in next(iter(run.tests.values())).records]
        sources = source_table([*run.tests.values()], files, out / "rig.toml")
        report = write_beta_report(out / "report.html", partitions, truths, sources)
    reporter.json(lambda: {**run.to_dict(), "report": report})
    if reporter.is_silent:
        return
    console = Console()
    console.print(rich_table(run.card(), f"simulated campaign, seed {seed}"))
    for name, beta in run.tests.items():
        console.print(f"{name}: {beta.partition.crosscheck.sentence}", highlight=False)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)


def _check_demo_folder(out: Path, tests: tuple[str, ...], overwrite: bool) -> None:
    """Check that the demo replaces no result but those of an earlier demo in the folder.

    Parameters
    ----------
    out
        Folder to write.
    tests
        Tests to simulate.
    overwrite
        Whether results may be replaced that were made from other logs than those in the folder.

    Raises
    ------
    InputError
        For an unknown test, a folder that cannot be one, and a file that may not be replaced.
    """
    from tcdyn.rig.disk import DISKS
    from tcdyn.simulate.programme import ehl_test

    check_folder(out)
    logs = [out / f"oven_{disk}.csv" for disk in DISKS]
    results = {f"record_{disk}": (out / f"{disk}.disk.json", JSON) for disk in DISKS}
    for test in tests:
        name = ehl_test(test).name
        logs.append(out / f"EHL_{name}.csv")
        results[f"beta_{name}"] = (out / f"EHL_{name}.beta.json", JSON)
        results[f"compensated_{name}"] = (out / f"EHL_{name}.compensated.csv", CSV)
    results["report"] = (out / "report.html", PAGE)
    check_outputs(logs, overwrite, **results)


def _write(out: Path, reporter: Reporter, frame: pd.DataFrame, truth: dict[str, Any]) -> None:
    """Write a simulated log with its true values, and report the files.

    Parameters
    ----------
    out
        CSV of the log; the true values have its name with other endings.
    reporter
        Output of the command.
    frame
        The log.
    truth
        True values, with the table "traces".
    """
    from tcdyn.io.write import removed_on_failure
    from tcdyn.simulate.campaign import write_json, write_log, write_traces

    truth_json, traces = _truth_files(out)
    with removed_on_failure(truth_json, traces):
        write_json(truth, truth_json)
        write_traces(truth["traces"], traces)
        write_log(frame, out)
    reporter.json(lambda: {"log": out, "rows": len(frame), "truth": truth_json, "traces": traces})
    reporter.text(
        f"wrote {out} ({len(frame)} rows); true values in {truth_json.name} and {traces.name}"
    )


def _is_simulated(path: Path) -> bool:
    """Whether a file is a simulated log, by its metadata."""
    from tcdyn.io.metadata import SIMULATED_KEY
    from tcdyn.io.read import open_table

    try:
        return SIMULATED_KEY in open_table(path).metadata
    except InputError:
        return False


def _truth_files(out: Path) -> tuple[Path, Path]:
    """Files of the true values, and of the true traces, of a log."""
    return default_output_path(out, ".truth.json"), default_output_path(out, ".truth.parquet")


def _contact_again(text: str) -> tuple[float, float]:
    """Length of a later contact, and its time after the unloading [s].

    Parameters
    ----------
    text
        Value of ``--again``, such as "0.2@1".

    Returns
    -------
    length_s, after_s
        Both positive.

    Raises
    ------
    InputError
        Another text, or numbers out of range.
    """
    length, _, after = text.partition("@")
    try:
        length_s = float(length)
        after_s = float(after)
    except ValueError:
        length_s = after_s = math.nan
    if not (0.02 <= length_s <= 1e5 and 0.05 <= after_s <= 1e5):
        raise InputError(
            f"--again is {text!r:.60}",
            expected="length@time after the unloading in seconds, at least 0.02@0.05",
            remedy="for example --again 0.2@1",
        )
    return length_s, after_s


def bore_contacts(values: list[str] | None) -> dict[str, BoreContact]:
    """Bore contact of each disk, from the values of ``--uneven``.

    Parameters
    ----------
    values
        Texts such as "0.5@30" or "fast:0.5@30".

    Returns
    -------
    contacts
        By disk; disks without a text are left out.

    Raises
    ------
    InputError
        Another text.
    """
    from tcdyn.rig.disk import DISKS
    from tcdyn.simulate.truth import BoreContact

    contacts: dict[str, BoreContact] = {}
    for value in values or ():
        disk, _, numbers = value.rpartition(":")
        amplitude, _, angle = numbers.partition("@")
        try:
            share = float(amplitude)
            angle_deg = float(angle)
        except ValueError:
            raise InputError(
                f"--uneven {value!r}", expected="amplitude@degrees, such as 0.5@30 or fast:0.5@30"
            ) from None
        if disk:
            check_choice("the disk of --uneven", disk, DISKS)
        contact = BoreContact(share, angle_deg)
        for name in [disk] if disk else DISKS:
            contacts[name] = contact
    return contacts
