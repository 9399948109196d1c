"""Commands ``tcdyn simulate`` (logs of the synthetic rig) and ``tcdyn demo`` (all stages).

The synthetic rig is :mod:`tcdyn.simulate`, the demo :mod:`tcdyn.workflows.demo`. The true values
are written to separate files, which no estimator reads. Tests: ``tests/simulate``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from tcdyn.cli.common import (
    HIGHEST_DEGC,
    LOWEST_DEGC,
    Disk,
    Reporter,
    Verbose,
    check_folder,
    check_outputs,
    count_progress,
    default_output_path,
    options_from_docstring,
    stage_progress,
)
from tcdyn.cli.record import rich_table
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.io.endings import CSV, JSON, PAGE, TABLE
from tcdyn.simulate.bath import FLUIDS, FluidName
from tcdyn.workflows.rig_options import MOST_WORKERS, UNLIMITED

if TYPE_CHECKING:
    import pandas as pd

    from tcdyn.simulate.truth import BoreContact, RigTruth

app = typer.Typer(
    name="simulate",
    help="Write logs of the synthetic rig, with the true values in files next to them.",
    no_args_is_help=True,
    add_completion=False,
)

Out = Annotated[Path, typer.Option(help="CSV file to write", rich_help_panel="Output")]
OutFolder = Annotated[Path, typer.Option(rich_help_panel="Output")]


@dataclass(frozen=True)
class DrawnRig(Options):
    """Options for the rig that is drawn at random.

    Attributes
    ----------
    seed
        seed of the random numbers; the same seed gives the same rig and the same file
    rig
        rig.toml; without it the defaults are used
    """

    seed: int = option(0, "Advanced", low=0, high=UNLIMITED)
    rig: Path | None = option(None, "Two-disk rig")


@dataclass(frozen=True)
class SimulatedRig(DrawnRig):
    """Options for the rig whose logs are simulated.

    Attributes
    ----------
    uncertain
        random steel, depths, washers and so on, within the uncertainties of rig.toml
    clean
        no noise, spikes, static errors, drift or quantisation; only the dynamics
    """

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


@dataclass(frozen=True)
class SimulatedPlunge(SimulatedRig):
    """Options for a plunge that is simulated.

    Attributes
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

    bath_degC: float = option(110.0, "Input", low=LOWEST_DEGC, high=HIGHEST_DEGC)
    fluid: FluidName = option("mobil-jet-ii", "Input", choices=FLUIDS, takes=str)
    duration_s: float = option(140.0, "Input", low=10, high=3600)
    plunge: int = option(1, "Input", low=1, high=UNLIMITED)


@app.command()
@options_from_docstring
def immersion(
    out: Out, disk: Disk = "fast", *, simulated: SimulatedPlunge, reporter: Reporter
) -> None:
    """Simulate a plunge of one disk into a hot bath.

    Example: tcdyn simulate immersion --out P1.csv --bath-degC 110 --fluid mobil-jet-ii
    """
    from tcdyn.simulate.plunge import PlungeOptions, simulate_plunge

    truth = simulated.for_log(out, reporter)
    frame, truth_values = simulate_plunge(
        disk,
        simulated.seed,
        simulated.fluid,
        simulated.bath_degC,
        simulated.plunge,
        truth,
        PlungeOptions(after_s=simulated.duration_s),
    )
    _write(out, reporter, frame, truth_values)


@app.command()
@options_from_docstring
def hole(out: Out, *, simulated: SimulatedRig, reporter: Reporter) -> None:
    """Simulate the comparison of holes of section 5.4.

    Clamped and cemented junctions are plunged into hot water.

    Example: tcdyn simulate hole --out hole.csv
    """
    from tcdyn.simulate.plunge import simulate_hole

    truth = simulated.for_log(out, reporter)
    _write(out, reporter, *simulate_hole(simulated.seed, truth))


@dataclass(frozen=True)
class SimulatedTest(Options):
    """Options for an EHL test that is simulated.

    Attributes
    ----------
    test
        test A1 to D4 (table 6.1)
    beta
        true heat partition (default: random)
    uneven
        bore contact around the disk: 0.5@30 conducts 1 + 0.5 cos(angle - 30 deg) times its mean,
        fast:0.5@30 for one disk; repeat for several
    """

    test: str = option("B3", "Input")
    beta: float | None = option(None, "Input", low=0, high=1)
    uneven: Sequence[str] = option((), "Two-disk rig", takes=list[str])

    @property
    def bore_contacts_by_disk(self) -> dict[str, BoreContact]:
        """Bore contact of each disk; disks without a text are left out.

        Raises
        ------
        InputError
            For a text that is none of a bore contact.
        """
        return bore_contacts(self.uneven)


@dataclass(frozen=True)
class SimulatedUnloading(SimulatedTest):
    """Options for the end of an EHL test that is simulated.

    Attributes
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

    unloading_s: float = option(0.02, "Input", low=0.001, high=10)
    brake_s: float | None = option(None, "Input", low=0.1, high=1e6)
    again: Sequence[str] = option((), "Input", takes=list[str])
    film_air_K: float = option(0.0, "Two-disk rig", low=-50, high=50)


@app.command()
@options_from_docstring
def ehl(
    out: Out, *, options: SimulatedUnloading, simulated: SimulatedRig, reporter: Reporter
) -> None:
    """Simulate an EHL test of both disks: warm running, loading, unloading, cooling.

    Example: tcdyn simulate ehl --out D4.csv --test D4 --beta 0.65 --unloading-s 1.5 --brake-s 3
    --again 0.2@1 --uneven slow:0.5@30
    """
    from tcdyn.simulate.ehl import EhlOptions, simulate_ehl

    truth = simulated.for_log(out, reporter)
    truth = truth.with_uneven(options.bore_contacts_by_disk).with_film_air(options.film_air_K)
    times = EhlOptions(
        beta=options.beta,
        parting_s=options.unloading_s,
        brake_s=options.brake_s,
        again_s=tuple(_contact_again(text) for text in options.again),
    )
    _write(out, reporter, *simulate_ehl(options.test, simulated.seed, truth, times))


@dataclass(frozen=True)
class SimulatedCampaign(SimulatedRig):
    """Options for a campaign that is simulated.

    Attributes
    ----------
    test
        test A1 to D4, or all (default B3); repeat for several
    bath_degC
        bath temperature of a plunge; repeat for several
    workers
        worker processes on this machine
    """

    test: Sequence[str] = option((), "Input", takes=list[str])
    bath_degC: Sequence[float] = option(
        (), "Input", low=LOWEST_DEGC, high=HIGHEST_DEGC, takes=list[float]
    )
    workers: int = option(1, "Advanced", low=1, high=MOST_WORKERS)


@app.command()
@options_from_docstring
def campaign(out: OutFolder, *, simulated: SimulatedCampaign, reporter: Reporter) -> None:
    """Simulate a complete campaign: rig.toml, oven logs, plunge logs, EHL tests and truth/.

    Example: tcdyn simulate campaign --out lab --test B3 --test D4 --seed 7

    Parameters
    ----------
    out
        folder to write
    """
    from tcdyn.core.parallel import worker_processes_end
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.simulate.campaign import ALL_TESTS, DEFAULT_PLUNGES, PlannedPlunge, simulate_campaign

    check_folder(out)
    tests = tuple(simulated.test or ("B3",))
    if "all" in tests:
        tests = ALL_TESTS
    plunges = tuple(map(PlannedPlunge, simulated.bath_degC)) or DEFAULT_PLUNGES
    with (
        worker_processes_end() if simulated.workers > 1 else nullcontext(),
        count_progress(None, reporter.is_silent) as progress,
    ):
        files = simulate_campaign(
            out,
            simulated.seed,
            tests,
            plunges,
            rig=load_rig(simulated.rig),
            truth=simulated.truth(),
            n_jobs=simulated.workers,
            progress=progress,
        )
    reporter.json(lambda: files)
    reporter.summary(files.summary())


@dataclass(frozen=True)
class DemoOptions(Options):
    """Options of the demonstration.

    Attributes
    ----------
    seed
        random seed; each seed is another rig
    test
        test of table 6.1 (default B3); repeat for several
    """

    seed: int = option(1, "Advanced", low=0, high=UNLIMITED)
    test: Sequence[str] = option((), "Input", takes=list[str])


@options_from_docstring
def demo(
    out: OutFolder = Path("demo"),
    verbose: Verbose = False,
    *,
    options: DemoOptions,
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
    """
    from tcdyn.report.beta import write_beta_report
    from tcdyn.report.sources import source_table
    from tcdyn.workflows import run_demo

    tests = tuple(options.test or ("B3",))
    _check_demo_folder(out, tests, reporter.overwrite)
    with stage_progress(reporter.is_silent, verbose) as progress:
        run = run_demo(out, options.seed, tests, progress=progress)
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
    console.print(rich_table(run.card(), f"simulated campaign, seed {options.seed}"))
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


def _check_bore(disk: str) -> None:
    """Raise InputError for a bore of a disk that the rig does not have."""
    from tcdyn.rig.disk import DISKS

    if disk not in DISKS:
        raise InputError(f"the disk of --uneven is {disk!r}", expected=" or ".join(DISKS))


def bore_contacts(values: Sequence[str]) -> dict[str, BoreContact]:
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
    for value in values:
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
            _check_bore(disk)
        contact = BoreContact(share, angle_deg)
        for name in [disk] if disk else DISKS:
            contacts[name] = contact
    return contacts
