"""Sampled input-output data: inputs and outputs of one or several runs, with hold and units.

All of ``tcdyn.identification`` works on it; ``tcdyn.identification.recordings`` builds it from
tables. The arrays are read-only. ``tests/identify/test_identify_data.py`` checks slicing, merging
and the errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike
from scipy import signal
from scipy.ndimage import maximum_filter1d

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, unique
from tcdyn.core.labels import common_index, labels_of, seconds_of_index
from tcdyn.core.result import Result
from tcdyn.identification.holds import (
    Hold,
    Holds,
    check_hold,
    hold_of_each,
    hold_text,
    select_holds,
    timing_u_s,
)
from tcdyn.io.column_names import column_named
from tcdyn.series.index import even_interval_s
from tcdyn.series.report import SeriesReport

# Jump over the range of the integer type, above which it is an overflow (chosen by judgement).
MIN_WRAP_SHARE = 0.8
# Order, and cutoff over the new Nyquist frequency, of the Butterworth filter before decimation. It
# acts twice: -96 dB at 1.5 times the Nyquist frequency.
ANTI_ALIAS = (4, 0.5)
# Rounding error of positions [samples].
POSITION_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Run:
    """One recording without interruption.

    Parameters
    ----------
    u, y
        Inputs (N, n_inputs) and outputs (N, n_outputs).
    start_s
        Time of the first sample [s].
    name
        Name of the run.
    epoch
        Clock time at 0 s; None if the times are no clock times.
    """

    u: Array
    y: Array
    start_s: float = 0.0
    name: str = ""
    epoch: pd.Timestamp | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        self.u.flags.writeable = False
        self.y.flags.writeable = False

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.y)


@dataclass(frozen=True, repr=False)
class IOData(Result):
    """Inputs and outputs of one or several runs at one sampling interval.

    Parameters
    ----------
    runs
        The recordings.
    dt_s
        Sampling interval [s].
    hold
        The input between samples: held (``zoh``, set by a computer) or a straight line (``foh``,
        anything physical); one for all inputs, or a tuple with one for each. A wrong hold shifts
        the dead time by half a sample.
    input_names, output_names, input_units, output_units
        Names and units of the columns.
    name
        Name of the record.
    findings
        Findings about the record.
    reading
        What was understood of the table of each run; empty for arrays.
    timing_u_s
        Standard uncertainty of the time of the output against the inputs [s]; zero where the hold
        is stated, see :func:`tcdyn.identification.holds.timing_u_s`.

    Notes
    -----
    NaN means "not measured". It stays in the data.

    Examples
    --------
    >>> data = IOData.from_arrays([0.0, 1, 1, 1], [0.0, 0.1, 0.5, 0.8], dt_s=0.5, hold="zoh")
    >>> data[0.5:1.5].n_samples
    3
    >>> len(data.merge(data).runs)
    2
    """

    runs: tuple[Run, ...]
    dt_s: float
    hold: Holds
    input_names: tuple[str, ...] = ("u",)
    output_names: tuple[str, ...] = ("y",)
    input_units: tuple[str, ...] = ("",)
    output_units: tuple[str, ...] = ("",)
    name: str = ""
    findings: tuple[Finding, ...] = ()
    reading: tuple[SeriesReport, ...] = ()
    timing_u_s: float = 0.0

    @classmethod
    def from_arrays(
        cls,
        u: ArrayLike | pd.Series | pd.DataFrame,
        y: ArrayLike | pd.Series | pd.DataFrame,
        dt_s: float | None = None,
        *,
        hold: Holds | Literal["auto"] = "auto",
        start_s: float = 0.0,
        input_names: Sequence[str] = (),
        output_names: Sequence[str] = (),
        input_units: Sequence[str] = (),
        output_units: Sequence[str] = (),
        name: str = "",
    ) -> IOData:
        """One run from arrays.

        Parameters
        ----------
        u, y
            Inputs (N,) or (N, n_inputs), and outputs (N,) or (N, n_outputs). Of a Series or
            DataFrame the names are used, and of its index the times.
        dt_s
            Sampling interval [s]; None: from the index.
        hold
            The input between samples: "zoh", "foh", one of them for each input, or "auto": "zoh"
            for each input that stays constant and jumps as if set by a computer. A stated hold
            says that the columns of a row belong to one instant; with "auto" lag and dead time are
            uncertain by half a row on either side.
        start_s
            Time of the first sample [s], if there is no index with times.
        input_names, output_names, input_units, output_units
            Names and units of the columns.
        name
            Name of the record.

        Returns
        -------
        IOData
            The data. The arrays are copies.

        Raises
        ------
        InputError
            For unequal lengths or indices, an unusable ``dt_s`` or hold, infinite values or an
            integer overflow.

        Examples
        --------
        >>> index = pd.date_range("2026-03-01 10:00", periods=4, freq="500ms")
        >>> heater = pd.Series([0.0, 1, 1, 1], index, name="heater")
        >>> data = IOData.from_arrays(heater, [0.0, 0.1, 0.5, 0.8], hold="zoh")
        >>> data.dt_s, data.to_frame().index.equals(index), list(data.to_frame())
        (0.5, True, ['heater', 'y'])
        """
        where = name or "IOData"
        index = common_index([u, y], where)
        epoch = None
        if index is not None:
            index_dt_s = even_interval_s(index, where)
            dt_s = dt_s or index_dt_s
            if isinstance(index, pd.DatetimeIndex):
                epoch = index[0]
            elif index_dt_s is not None:
                start_s = float(seconds_of_index(index)[0])
        input_names = tuple(input_names) or labels_of(u)
        output_names = tuple(output_names) or labels_of(y)
        if dt_s is None:
            raise InputError(
                "the sampling interval is not given",
                where=where,
                expected="dt_s in seconds, or Series with times in their index",
            )
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise InputError(
                f"dt_s is {dt_s}", where=where, expected="a sampling interval in seconds above zero"
            )
        inputs = checked_columns(u, input_names, "input", where)
        outputs = checked_columns(y, output_names, "output", where)
        if len(inputs) != len(outputs):
            raise InputError(
                f"the input has {len(inputs)} samples, the output {len(outputs)}",
                where=where,
                expected="equal lengths",
            )
        n_inputs = inputs.shape[1]
        n_outputs = outputs.shape[1]
        input_names = tuple(input_names) or default_names("u", n_inputs)
        if len(input_names) != n_inputs:
            raise InputError(
                f"{len(input_names)} names of inputs", where=where, expected=f"{n_inputs}"
            )
        holds, findings = select_holds(hold, input_names, inputs, float(dt_s))
        return cls(
            runs=(Run(inputs, outputs, float(start_s), name, epoch),),
            dt_s=float(dt_s),
            hold=check_hold(holds, n_inputs, where),
            input_names=input_names,
            output_names=tuple(output_names) or default_names("y", n_outputs),
            input_units=tuple(input_units) or ("",) * n_inputs,
            output_units=tuple(output_units) or ("",) * n_outputs,
            name=name,
            findings=tuple(findings),
            timing_u_s=timing_u_s(hold, float(dt_s)),
        )

    def summary(self) -> str:
        """Names, runs, number of samples and of missing values, and findings, as text."""
        inputs = ", ".join(self.input_names)
        outputs = ", ".join(self.output_names)
        line = (
            f"{inputs} -> {outputs}: {len(self.runs)} run(s), {self.n_samples} samples every "
            f"{self.dt_s:g} s, input {hold_text(self.hold)}"
        )
        if self.n_missing:
            line += f", {self.n_missing} output values missing"
        return "\n".join([line, *(f"  {f.sentence}" for f in self.findings)])

    def to_dict(self) -> dict[str, Any]:
        """Names, units, sampling and length of each run; the samples are in ``runs``."""
        return {
            "name": self.name,
            "inputs": dict(zip(self.input_names, self.input_units)),
            "outputs": dict(zip(self.output_names, self.output_units)),
            "dt_s": self.dt_s,
            "hold": self.hold,
            "runs": [{"name": r.name, "start_s": r.start_s, "samples": r.n} for r in self.runs],
            "missing": self.n_missing,
            "findings": [f.to_dict() for f in self.findings],
        }

    @property
    def holds(self) -> tuple[Hold, ...]:
        """The hold of each input."""
        return hold_of_each(self.hold, len(self.input_names))

    @property
    def n_samples(self) -> int:
        """Samples in all runs together."""
        return sum(run.n for run in self.runs)

    @property
    def duration_s(self) -> float:
        """Length of the longest run [s]."""
        return max(run.n for run in self.runs) * self.dt_s

    @property
    def n_missing(self) -> int:
        """Number of output values that were not measured."""
        return int(sum(np.isnan(run.y).sum() for run in self.runs))

    def merge(self, *others: IOData) -> IOData:
        """These runs and those of ``others``, each with its own start; they are not concatenated.

        Parameters
        ----------
        *others
            Data with the same sampling interval, hold and names of the columns.

        Returns
        -------
        IOData
            All runs, with the findings of all data.

        Raises
        ------
        InputError
            Where sampling interval, hold or names of the columns differ.

        Notes
        -----
        ``tests/identify/test_identify_data.py`` guards it.
        """
        names = (self.input_names, self.output_names)
        for other in others:
            same_sampling = np.isclose(other.dt_s, self.dt_s, rtol=1e-6)
            same_names = (other.input_names, other.output_names) == names
            if not (same_sampling and other.holds == self.holds and same_names):
                raise InputError(
                    f"merge: {other.name or 'the second data set'} has dt_s {other.dt_s}, hold "
                    f"{other.hold}, columns {other.input_names} -> {other.output_names}",
                    expected=f"dt_s {self.dt_s}, hold {self.hold}, "
                    f"{self.input_names} -> {self.output_names}",
                    remedy="same names, and the same interval by .resample(dt_s); with hold zoh "
                    "resample both, to an interval longer than either: both are then foh",
                )
        runs = list(self.runs)
        findings = list(self.findings)
        for other in others:
            runs += other.runs
            findings += other.findings
        return replace(self, runs=tuple(runs), findings=tuple(unique(findings)))

    def resample(self, dt_s: float) -> IOData:
        """The data at another sampling interval.

        Parameters
        ----------
        dt_s
            New sampling interval [s].

        Returns
        -------
        IOData
            The data on the new grid, which starts with each run.

        Raises
        ------
        InputError
            For an interval that is not above zero, or longer than half of a run.

        Notes
        -----
        To a longer interval, inputs and outputs pass the same low-pass filter without phase shift
        (``ANTI_ALIAS``), which leaves the transfer function between them unchanged. The filtered
        input is continuous, so the hold becomes "foh"; a held input enters by its value in the
        middle of each jump. What a straight line between samples leaves out changes a lag by about
        dt_s^2/(12 lag): choose at most a twentieth of the lag. To a shorter interval, outputs are
        interpolated linearly, inputs by their hold.

        A new sample is NaN where an old one within a new interval is. Runs are filtered over their
        gaps, which are interpolated linearly.

        Examples
        --------
        >>> data = IOData.from_arrays(np.zeros(100), np.arange(100.0), dt_s=0.1)
        >>> data.resample(0.4).runs[0].y[5, 0].round(3)
        np.float64(20.0)
        """
        shortest_s = min(run.n for run in self.runs) * self.dt_s
        if not 0 < dt_s <= shortest_s / 2:
            raise InputError(
                f"resample: dt_s is {dt_s}",
                where=self.name or "IOData",
                expected=f"above 0 and at most half of the shortest run, {shortest_s / 2:g} s",
            )
        is_longer = dt_s > self.dt_s
        runs = []
        for run in self.runs:
            count = int(np.floor((run.n - 1) * self.dt_s / dt_s + 1e-9)) + 1
            position = np.asarray(np.arange(count) * dt_s / self.dt_s, dtype=float)
            y = [_resample_column(column, position, "foh") for column in run.y.T]
            u = [_resample_column(column, position, h) for column, h in zip(run.u.T, self.holds)]
            runs.append(replace(run, u=np.column_stack(u), y=np.column_stack(y)))
        hold: Holds = "foh" if is_longer else self.hold
        return replace(self, runs=tuple(runs), dt_s=float(dt_s), hold=hold)

    def detrend(
        self, order: int = 1, signals: Literal["both", "inputs", "outputs"] = "both"
    ) -> IOData:
        """The data without a polynomial in time, which is fitted to each column of each run.

        Parameters
        ----------
        order
            Order of the polynomial: 0 removes the mean, 1 a straight line.
        signals
            Columns from which it is removed.

        Returns
        -------
        IOData
            The data.

        Notes
        -----
        A straight line also holds slow dynamics: ``fit(data, model, baseline="trend")`` estimates
        the drift together with the model and is more accurate.

        Examples
        --------
        >>> data = IOData.from_arrays(np.ones(50), 3 + 0.5 * np.arange(50.0), dt_s=0.1)
        >>> float(abs(data.detrend().runs[0].y).max()) < 1e-9
        True
        """
        runs = []
        for run in self.runs:
            u = run.u if signals == "outputs" else _subtract_polynomials(run.u, order)
            y = run.y if signals == "inputs" else _subtract_polynomials(run.y, order)
            runs.append(replace(run, u=u, y=y))
        return replace(self, runs=tuple(runs))

    def between(self, start_s: float | None = None, end_s: float | None = None) -> IOData:
        """Return the samples of a time interval of every run; empty runs are dropped.

        Parameters
        ----------
        start_s, end_s
            Ends of the interval [s], both included; None for no limit.

        Returns
        -------
        IOData
            The data.

        Raises
        ------
        InputError
            Where no sample is in the interval.
        """
        runs = []
        for run in self.runs:
            first = 0
            end = run.n
            if start_s is not None:
                first = max(0, int(np.ceil((start_s - run.start_s) / self.dt_s - 1e-9)))
            if end_s is not None:
                end = int(np.floor((end_s - run.start_s) / self.dt_s + 1e-9)) + 1
            if first < min(end, run.n):
                first_s = run.start_s + first * self.dt_s
                rows = slice(first, end)
                runs.append(replace(run, u=run.u[rows], y=run.y[rows], start_s=first_s))
        if not runs:
            raise InputError(
                f"no sample lies between {start_s} s and {end_s} s", where=self.name or "IOData"
            )
        return replace(self, runs=tuple(runs))

    def __getitem__(self, window: slice) -> IOData:
        """``data[2.0:10.0]``: slicing in seconds, both ends included."""
        return self.between(window.start, window.stop)

    def run(self, index: int) -> IOData:
        """Return the data of ``runs[index]`` only."""
        return replace(self, runs=(self.runs[index],))

    def select(
        self, input: str | Sequence[str] | None = None, output: str | Sequence[str] | None = None
    ) -> IOData:
        """Return some of the inputs and outputs, by name.

        Parameters
        ----------
        input, output
            Names of the columns; None for all of them.

        Returns
        -------
        IOData
            The data, without the findings about other columns.

        Raises
        ------
        InputError
            For a name that is not a column.
        """
        inputs = indices_of(input, self.input_names, "input")
        outputs = indices_of(output, self.output_names, "output")
        input_names = tuple(self.input_names[k] for k in inputs)
        output_names = tuple(self.output_names[k] for k in outputs)
        runs = [
            replace(run, u=run.u[:, inputs].copy(), y=run.y[:, outputs].copy()) for run in self.runs
        ]
        kept = (*input_names, *output_names)
        others = {*self.input_names, *self.output_names}.difference(kept)
        findings = [f for f in self.findings if f.subject not in others]
        holds = tuple(self.holds[k] for k in inputs)
        return replace(
            self,
            runs=tuple(runs),
            hold=check_hold(holds, len(inputs), self.name or "IOData"),
            input_names=input_names,
            output_names=output_names,
            input_units=tuple(self.input_units[k] for k in inputs),
            output_units=tuple(self.output_units[k] for k in outputs),
            findings=tuple(findings),
        )

    @property
    def outputs(self) -> Array:
        """Outputs of all runs in a row (N, n_outputs)."""
        return np.concatenate([run.y for run in self.runs])

    def with_outputs(self, y: Array) -> IOData:
        """Return the data with other outputs (N, n_outputs), those of all runs in a row."""
        parts = np.split(y, np.cumsum([run.n for run in self.runs])[:-1])
        runs = [replace(run, y=part) for run, part in zip(self.runs, parts)]
        return replace(self, runs=tuple(runs))

    def times_s(self, index: int = 0) -> Array:
        """Return the times (N,) [s] of the samples of one run."""
        run = self.runs[index]
        return np.asarray(run.start_s + np.arange(run.n) * self.dt_s)

    def index_of(self, index: int = 0) -> pd.Index[Any]:
        """Return the times (N,) of one run as an index: clock times if known, else [s]."""
        time_s = self.times_s(index)
        epoch = self.runs[index].epoch
        if epoch is None:
            return pd.Index(time_s, name="time_s")
        steps = pd.to_timedelta(np.rint(1e9 * time_s).astype(np.int64), unit="ns")
        return pd.DatetimeIndex(epoch + steps, name="time").as_unit(epoch.unit)

    def to_frame(self) -> pd.DataFrame:
        """Inputs and outputs over the time.

        Returns
        -------
        DataFrame
            One column for each input and output; their units are in ``attrs["units"]``. The index
            is a DatetimeIndex where the clock times are known, else the time [s] as floats; with
            several runs it is a MultiIndex of run and time.
        """
        names = [*self.input_names, *self.output_names]
        frames = {
            run.name or k: pd.DataFrame(np.hstack([run.u, run.y]), self.index_of(k), names)
            for k, run in enumerate(self.runs)
        }
        frame = next(iter(frames.values()))
        if len(frames) > 1:
            frame = pd.concat(frames, names=["run"])
        units = dict(zip(names, [*self.input_units, *self.output_units]))
        frame.attrs = {"units": {name: unit for name, unit in units.items() if unit}}
        return frame


def as_iodata(data: Any) -> IOData:
    """Return the data of a fit: IOData as they are, or those of (u, y, dt_s).

    Parameters
    ----------
    data
        IOData; or a tuple of inputs, outputs and sampling interval [s], where Series with times in
        their index need no interval. The hold is selected from the samples.

    Returns
    -------
    IOData
        The data.

    Raises
    ------
    InputError
        For anything else, with the function that makes IOData of it.

    Notes
    -----
    ``tests/identify/test_identify_frames.py`` guards it.
    """
    if isinstance(data, IOData):
        return data
    if isinstance(data, tuple | list) and len(data) in (2, 3):
        return IOData.from_arrays(*data)
    remedy = "make them with IOData.from_arrays(u, y, dt_s), or give a tuple (u, y, dt_s)"
    if isinstance(data, pd.DataFrame):
        remedy = "make them with from_frame(frame, input=.., output=..)"
    elif isinstance(data, str | PathLike):
        remedy = "read them with from_csv(path, input=.., output=..)"
    raise InputError(f"the data are a {type(data).__name__}", expected="IOData", remedy=remedy)


def _resample_column(column: Array, position: Array, hold: Hold) -> Array:
    """Return a column at other positions, filtered against aliasing where they are sparser.

    Parameters
    ----------
    column
        Samples (N,), NaN where missing.
    position
        Positions (M,) in samples, uniform from 0.
    hold
        The signal between samples.

    Returns
    -------
    array
        Values (M,), NaN where samples are missing; where it was filtered, also next to them.
    """
    missing = np.isnan(column)
    if missing.all():
        return np.full(len(position), np.nan)
    index = np.arange(len(column))
    values = np.interp(index, index[~missing], column[~missing])
    ratio = position[1]
    if ratio > 1:
        if hold == "zoh":
            values[1:] = 0.5 * (values[1:] + values[:-1])
        order, cutoff = ANTI_ALIAS
        sections = signal.butter(order, cutoff / ratio, output="sos")
        values = signal.sosfiltfilt(sections, values, padlen=min(len(values) - 1, int(30 * ratio)))
        missing = maximum_filter1d(missing, 2 * int(ratio) + 1)
    if hold == "zoh" and ratio <= 1:
        return np.asarray(column[(position + POSITION_TOLERANCE).astype(int)])
    out = np.interp(position, index, values)
    out[np.interp(position, index, missing) > POSITION_TOLERANCE] = np.nan
    return out


def _subtract_polynomials(table: Array, order: int) -> Array:
    """Return columns (N, K) without their polynomials of an order; NaN is left out of the fit."""
    index = np.arange(len(table))
    columns = []
    for values in table.T:
        finite = np.isfinite(values)
        line = Polynomial.fit(index[finite], values[finite], order)
        columns.append(values - line(index))
    return np.column_stack(columns)


def default_names(letter: str, count: int) -> tuple[str, ...]:
    """Return the names of columns without names: u, or u1, u2, .."""
    if count == 1:
        return (letter,)
    return tuple(f"{letter}{k}" for k in range(1, count + 1))


def indices_of(
    requested: str | Sequence[str] | None, names: tuple[str, ...], role: str
) -> list[int]:
    """Return the positions of columns among the names.

    Parameters
    ----------
    requested
        One name or several; None for all.
    names
        Names of all columns.
    role
        "input" or "output", for the error.

    Returns
    -------
    list of int
        Positions in the order of the request.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if requested is None:
        return list(range(len(names)))
    each = [requested] if isinstance(requested, str) else list(requested)
    columns = [column_named(name, names, "the record", role=role) for name in each]
    return [names.index(name) for name in columns]


def checked_columns(values: ArrayLike, names: Sequence[str], role: str, where: str) -> Array:
    """Return a float copy of columns after checks of type, shape, range and overflow.

    Parameters
    ----------
    values
        Values (N,) or (N, columns).
    names
        Names of the columns, for errors; may be too few.
    role, where
        "input" or "output", and the record, for errors.

    Returns
    -------
    array
        Values (N, columns).

    Raises
    ------
    InputError
        For values that are no numbers, infinite values, other shapes, or an integer overflow.
    """
    raw = np.asarray(values)
    if raw.dtype.kind not in "iufb":
        raise InputError(f"the {role} holds {raw.dtype} values", where=where, expected="numbers")
    if raw.ndim == 1:
        raw = raw[:, None]
    if raw.ndim != 2:
        raise InputError(
            f"the {role} has {raw.ndim} dimensions", where=where, expected="(N,) or (N, columns)"
        )
    table = np.array(raw, dtype=float)
    n_columns = table.shape[1]
    for k in range(n_columns):
        label = role if n_columns == 1 else f"{role} {k + 1}"
        if k < len(names):
            label = names[k]
        infinite = np.flatnonzero(np.isinf(table[:, k]))
        if len(infinite):
            raise InputError(
                f"column {label} is infinite in row {infinite[0]}",
                where=where,
                remedy="mark missing values as NaN",
            )
        check_wrap(table[:, k], label, where)
    return table


def check_wrap(values: Array, label: str, where: str) -> None:
    """Raise InputError for integers that jump by the 16- or 32-bit range: an overflow.

    Parameters
    ----------
    values
        One column (N,).
    label, where
        Column and record, for the error.

    Raises
    ------
    InputError
        Where the column overflowed.

    Notes
    -----
    A smaller ``MIN_WRAP_SHARE`` takes large steps of real integer data for an overflow.
    ``tests/identify/test_identify_closed_forms.py`` checks both.
    """
    finite = values[np.isfinite(values)]
    if len(finite) < 2 or np.any(finite != np.round(finite)):
        return
    jump = np.abs(np.diff(finite))
    for bits in (16, 32):
        full_range = 2.0**bits
        wraps = np.flatnonzero((jump > MIN_WRAP_SHARE * full_range) & (jump < full_range))
        low = 0.0 if finite.min() >= 0 else -full_range / 2
        high = low + full_range - 1
        if len(wraps) and finite.min() >= low and finite.max() <= high:
            first = wraps[0]
            raise InputError(
                f"column {label} jumps by {jump[first]:.0f} at sample {first + 1}: a {bits}-bit "
                "integer overflowed",
                where=where,
                remedy=f"unwrap it (add {int(full_range)} after each wrap) or convert to float "
                "before scaling",
            )
