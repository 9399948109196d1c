"""Options of the flows that compensate: one dataclass each, for the command and the function.

What an option means is written here once; see :mod:`tcdyn.core.options`. Tests:
``tests/core/test_option_classes.py`` and ``tests/cli/test_options.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
        (default: the column with the name of the quantity)
    """

    rate: bool = option(False, "Output")
    follows: str = option("", "Sensor")


@dataclass(frozen=True)
class CompensateOptions(OutputOptions, FrameOptions):
    """How a table is compensated and written.

    Attributes
    ----------
    delay_s
        compensate each row only with the rows that are there this long after it [s]: the rows that
        tcdyn follow gives
    """

    delay_s: float | None = option(None, "Advanced", low=0, high=MAX_LAG_S)


@dataclass(frozen=True)
class FollowOptions(CompensateOptions):
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
