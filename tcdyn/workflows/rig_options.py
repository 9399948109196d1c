"""Options of calibration, heat partition and campaign: one dataclass each, also for the commands.

See :mod:`tcdyn.core.options`. Tests: ``tests/cli/test_rig_options.py`` and
``tests/cli/test_campaign_command.py``.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from tcdyn.chain import STRUCTURES
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.partition.analyse import WINDOW_S
from tcdyn.partition.operating_conditions import BearingFile, read_bearing

# More worker processes than any machine of a laboratory has cores; beyond it a number is a mistake.
MOST_WORKERS = 256
# Longest cooling fit [s]: twelve days; beyond it a number is a mistake.
LONGEST_WINDOW_S = 1e6
# Standard uncertainties [K] that are no mistake: tolerance class 3 at -200 degC has one of 1.5 K.
LARGEST_READING_U_K = 50.0
UNLIMITED = float("inf")


@dataclass(frozen=True)
class AnalysisOptions(Options):
    """How a test of the two-disk rig is analysed.

    Attributes
    ----------
    bearing
        CSV of a pure-rolling test with the columns load_N, friction_N, speed_slow_rpm; half of its
        friction is added to that of the test
    without
        channel not to use, such as fast_c; repeat for several
    window_s
        length of the cooling fit [s]
    seed
        seed of the Monte Carlo of the uncertainty budget
    """

    bearing: BearingFile | str | Path | None = option(None, "Two-disk rig", takes=Path)
    without: Sequence[str] = option((), "Two-disk rig", takes=list[str])
    window_s: float = option(WINDOW_S, "Advanced", low=0, high=LONGEST_WINDOW_S, ends=False)
    seed: int = option(0, "Advanced", low=0, high=UNLIMITED)

    @property
    def bearing_path(self) -> Path | None:
        """File of the pure-rolling test; None without one."""
        bearing = self.bearing
        if bearing is None or isinstance(bearing, BearingFile):
            return None
        return Path(bearing)

    @property
    def bearing_file(self) -> BearingFile | None:
        """The pure-rolling test; None without one.

        Raises
        ------
        InputError
            For a file that cannot be read.
        """
        if self.bearing is None or isinstance(self.bearing, BearingFile):
            return self.bearing
        return read_bearing(self.bearing)


@dataclass(frozen=True)
class BetaOptions(AnalysisOptions):
    """How a log is analysed on its own.

    Attributes
    ----------
    sensor_check
        exclude dead channels, stop if channels are swapped, warn of misplaced junctions
    profiles
        write the likelihood profiles of the joint fits into beta.json; the report always has them
    stage
        analyse one of several loadings in the log, from 1 (default: all)
    """

    sensor_check: bool = option(True, "Advanced")
    profiles: bool = option(False, "Output")
    stage: int | None = option(None, "Two-disk rig", low=1, high=UNLIMITED)


@dataclass(frozen=True)
class CampaignOptions(AnalysisOptions):
    """How the logs of a campaign are analysed and compared.

    Attributes
    ----------
    curve
        CSV of a model curve to compare with beta: one of delta_T_us_K_m_s, load_N,
        sliding_speed_m_s, entraining_speed_m_s; beta; u_beta if known; repeat for several
    compare
        table of other tests to compare with, such as a campaign.csv: load_N, sliding_speed_m_s and
        friction_N, fast_bulk_degC or other columns of campaign.csv
    interchanged
        of two logs of one test: a junction whose channel was interchanged with that of another one
        between them, such as slow_a; give it twice; compares the temperature maps (section 6.4.2.4)
    workers
        worker processes (default: 2 if there are two cores)
    dask
        address of a Dask scheduler, e.g. tcp://host:8786; its workers must have the logs under the
        same paths
    """

    curve: Sequence[str | Path] = option((), "Two-disk rig", takes=list[Path])
    compare: str | Path | None = option(None, "Two-disk rig", takes=Path)
    interchanged: Sequence[str] = option((), "Two-disk rig", takes=list[str])
    workers: int | None = option(None, "Advanced", low=1, high=MOST_WORKERS)
    dask: str | None = option(None, "Advanced")

    def __post_init__(self) -> None:
        """Check the options, and those that depend on each other.

        Raises
        ------
        InputError
            For a value that is not allowed, processes beside Dask, and another number of
            interchanged junctions than two.
        """
        super().__post_init__()
        if self.dask is not None and self.workers is not None:
            raise InputError(
                "{workers} is given with {dask}",
                expected="one of them",
                parameters={"workers": None, "dask": None},
            )
        if len(self.interchanged) not in (0, 2):
            raise InputError(
                f"{{interchanged}} has {len(self.interchanged)} junction(s)",
                expected="two junctions, such as slow_a and slow_c",
                parameters={"interchanged": None},
            )

    @property
    def compared_files(self) -> list[Path]:
        """Files that the tests are compared with."""
        files = [*self.curve, *([] if self.compare is None else [self.compare])]
        return [Path(file) for file in files]

    @property
    def of_analysis(self) -> AnalysisOptions:
        """How each log is analysed, with the pure-rolling test read.

        Raises
        ------
        InputError
            For a file of that test that cannot be read.
        """
        options = {each.name: getattr(self, each.name) for each in fields(AnalysisOptions)}
        return AnalysisOptions(**{**options, "bearing": self.bearing_file})

    @property
    def n_workers(self) -> int:
        """Number of worker processes; with one, the logs are analysed in this process."""
        if self.dask is not None:
            return 1
        return self.workers or min(2, os.cpu_count() or 1)


@dataclass(frozen=True)
class CalibrateOptions(Options):
    """How a disk is calibrated.

    Attributes
    ----------
    reading_u_K
        without an oven log: standard uncertainty of a logged reading [K], such as 0.9 for a
        tolerance of 1.5 K
    prt_u_degC
        standard uncertainty of each reading of the oven's PRT relative to itself [K], if it was
        stated apart from its certificate; the certificate's part is that of the rig file
    structure
        chain structure: P1 (one lag), P2 (two), P3 (three), P1D or P2D (with a dead time), P2Z
        (with a zero: a slow tail); the others are fitted for comparison
    correlation
        natural convection: mcadams, similarity or churchill-chu-laminar
    """

    reading_u_K: float | None = option(None, "Input", low=0, high=LARGEST_READING_U_K)
    prt_u_degC: float = option(0.0, "Advanced", low=0, high=LARGEST_READING_U_K)
    structure: str = option("P2", "Advanced", choices=STRUCTURES)
    correlation: str = option("churchill-chu-laminar", "Advanced")
