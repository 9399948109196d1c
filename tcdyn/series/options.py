"""How the rows of a table are read: the options that every command and function shares.

Tests: ``tests/cli/test_reading_options.py`` and ``tests/series/test_source.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option

# Intervals beyond which a number is a mistake: faster than any logger, and 300 years.
SHORTEST_S = 1e-10
LONGEST_S = 1e10


@dataclass(frozen=True)
class ReadingOptions(Options):
    """How the rows of a table are read, where the table does not say it itself.

    Attributes
    ----------
    time
        column of the time, if its name does not say so
    time_unit
        its unit (s, ms, us, ns, min, h, days, HHMM or HHMMSS), if its name does not state it
    dt_s
        sampling interval of the rows [s]; without {time} no column of time is read
    where
        only the rows with this cell, as COLUMN=VALUE: one channel of a table of several
    on_change
        rows are written when a reading has changed by this dead band, in its unit; it is recognised
        from the readings if it is not given
    averages_s
        each row is the mean of the readings over this time before it [s]; compensate and follow
        remove the mean of a table: over a part of a row, or over 1 to 12 rows
    sheet
        sheet of an .xlsx workbook, if it has several with tables
    variable
        variable of a .mat file with the table, such as log or log.data
    """

    time: str | None = option()
    time_unit: str | None = option()
    dt_s: float | None = option(low=SHORTEST_S, high=LONGEST_S)
    where: str | None = option()
    on_change: float | None = option()
    averages_s: float | None = option(low=SHORTEST_S, high=LONGEST_S)
    sheet: str | None = option()
    variable: str | None = option()

    def __post_init__(self) -> None:
        """Check the options, and that a condition has a column and a value.

        Raises
        ------
        InputError
            For an interval, a dead band or an averaging time that is not positive, and for a
            condition without "=".
        """
        super().__post_init__()
        if self.on_change is not None and not 0 <= self.on_change < float("inf"):
            raise InputError(
                f"{{on_change}} is {self.on_change:g}",
                expected="a dead band, or 0 for a reading that is held",
                parameters={"on_change": None},
            )
        if self.where is not None and not self.condition[0]:
            raise InputError(
                f"{{where}} {self.where}",
                expected="COLUMN=VALUE",
                parameters={"where": None},
            )

    @property
    def condition(self) -> tuple[str, str]:
        """Column and cell of ``where``; two empty texts without "=".

        >>> ReadingOptions(where="Channel = CH 1").condition
        ('Channel', 'CH 1')
        """
        column, equals, value = (self.where or "").partition("=")
        if not equals:
            return "", ""
        return column.strip(), value.strip()

    @property
    def rows(self) -> ReadingOptions:
        """The options of the rows alone, without those of a class that has more.

        >>> TableOptions("t", unit="K").rows == ReadingOptions("t")
        True
        """
        return ReadingOptions(
            **{each.name: getattr(self, each.name) for each in fields(ReadingOptions)}
        )


@dataclass(frozen=True)
class TableOptions(ReadingOptions):
    """How the rows of a table are read, and the units of its columns.

    Attributes
    ----------
    unit
        of a table: degC, K, degF, mV, or another quantity's such as ppm, %RH, Pa or V, if the names
        do not state it; T1=K for one column
    couple
        with mV: thermocouple type E, J, K, N or T (ITS-90), or none for another voltage
    cold_junction
        with mV: temperature of the reference junction in degC, or its column
    """

    unit: str | Sequence[str] | Mapping[str, str] = option("", takes=list[str])
    couple: str = option("", takes=str)
    cold_junction: float | str = option(0.0, takes=str)

    @property
    def units(self) -> str | dict[str, str]:
        """The unit of all columns, or units by column.

        Raises
        ------
        InputError
            For a unit of all columns beside other units.

        Examples
        --------
        >>> TableOptions(unit=["T1=K", "T2=mV"]).units, TableOptions(unit=["K"]).units
        ({'T1': 'K', 'T2': 'mV'}, 'K')
        """
        if isinstance(self.unit, Mapping):
            return dict(self.unit)
        texts = [self.unit] if isinstance(self.unit, str) else list(self.unit)
        parts = [text.rpartition("=") for text in texts]
        units_of_all = [unit for name, _, unit in parts if not name]
        if not units_of_all:
            return {name: unit for name, _, unit in parts}
        if len(parts) > 1:
            raise InputError(
                "{unit} is given more than once",
                expected="one for all columns, or T1=K for each",
                parameters={"unit": None},
            )
        return units_of_all[0]

    @property
    def cold(self) -> float | str:
        """Temperature of the reference junction [degC], or its column.

        >>> TableOptions(cold_junction="25").cold, TableOptions(cold_junction="cj").cold
        (25.0, 'cj')
        """
        try:
            return float(self.cold_junction)
        except ValueError:
            return self.cold_junction
