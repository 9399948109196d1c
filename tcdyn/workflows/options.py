"""Options of the flows that compensate: one dataclass each, for the command and the function.

What an option means is written here once; see :mod:`tcdyn.core.options`. Tests:
``tests/core/test_option_classes.py`` and ``tests/cli/test_options.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.io.write import DIALECTS, DialectName
from tcdyn.rig.record import MAX_LAG_S
from tcdyn.series.options import TableOptions

# Longest time without new rows [s]: twelve days; beyond it a number is a mistake.
LONGEST_WAIT_S = 1e6


@dataclass(frozen=True)
class OutputOptions(Options):
    """How a compensated table is written.

    Attributes
    ----------
    dialect
        of CSV: standard (UTF-8, commas, decimal points) or input (separator, decimal mark, encoding
        and line ends of the log)
    comments
        of CSV: metadata as lines '# key: value' above the header, instead of in OUT.meta.json
    """

    dialect: DialectName = option("standard", "Output", choices=DIALECTS, takes=str)
    comments: bool = option(False, "Output")


@dataclass(frozen=True)
class LogOptions(TableOptions):
    """How any table is read for its sensors.

    Attributes
    ----------
    columns
        with {sensor}: column of the sensor, instead of the one in its file; repeat for several
    """

    columns: Sequence[str] = option((), "Sensor", name="column", takes=list[str])


@dataclass(frozen=True)
class FrameOptions(LogOptions):
    """How a table is compensated.

    Attributes
    ----------
    rate
        also write the rate of change of each result and its standard uncertainty
    follows
        with a sensor whose lag follows the flow: the column of the flow, or QUANTITY=COLUMN
        (default: the column with the name of the quantity); none: the lag stays that of its file
    follows_u
        standard uncertainty of that column, in its unit or in %: one error of the whole log
    accuracy
        accuracy of the readings, as limits of one error of the whole log: "0.5 K", "1.5 %", "0.5 K
        + 0.1 %"; of one column COLUMN=ACCURACY; repeat for several
    components
        also write the components of each _u_K: _noise_u_K (differs from row to row), _record_u_K
        (one error of the column in the whole log) and _common_u_K (one error of all columns)
    """

    rate: bool = option(False, "Output")
    follows: str = option("", "Sensor")
    follows_u: float | str = option("", "Sensor", takes=str)
    accuracy: float | str | Sequence[str] | Mapping[str, float | str] = option(
        (), "Sensor", takes=list[str]
    )
    components: bool = option(False, "Output")


@dataclass(frozen=True)
class MeansOptions(FrameOptions):
    """How a whole table is compensated, row by row or as means.

    Attributes
    ----------
    means
        instead of rows, means over this many seconds with their standard uncertainty; auto: over
        the shortest time whose means are determined
    """

    means: float | str | None = option(None, "Output", takes=str)

    def __post_init__(self) -> None:
        """Check that means have no rates.

        Raises
        ------
        InputError
            For the rate of change of means.
        """
        super().__post_init__()
        if self.means is not None and self.rate:
            raise InputError(
                "{rate} with {means}",
                remedy="leave one of them out: a mean has no rate of change",
                parameters={"rate": True, "means": None},
            )


@dataclass(frozen=True)
class DelayedOptions(OutputOptions, FrameOptions):
    """How a table is compensated row by row, and written.

    Attributes
    ----------
    delay_s
        compensate each row only with the rows that are there this long after it [s]: the rows that
        tcdyn follow gives
    """

    delay_s: float | None = option(None, "Advanced", low=0, high=MAX_LAG_S)


@dataclass(frozen=True)
class CompensateOptions(DelayedOptions, MeansOptions):
    """How a table is compensated and written."""

    def __post_init__(self) -> None:
        """Check that means have all rows.

        Raises
        ------
        InputError
            For means with a delay.
        """
        super().__post_init__()
        if self.means is not None and self.delay_s is not None:
            raise InputError(
                "{means} with {delay_s}",
                remedy="leave one of them out: means are those of the whole log",
                parameters={"means": None, "delay_s": None},
            )


@dataclass(frozen=True)
class FollowOptions(DelayedOptions):
    """How a log is compensated while it grows.

    Attributes
    ----------
    delay_s
        how long after a row it is compensated, with the rows that are there then [s] (default: two
        lags, at least 2 s)
    idle_s
        end after this time without new rows [s]
    """

    idle_s: float = option(30.0, "Advanced", low=0, high=LONGEST_WAIT_S)
