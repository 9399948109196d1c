"""Sampled input-output data: one value that carries its hold, its units and its runs, kept apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, unique
from tcdyn.core.result import Result

Hold = Literal["zoh", "foh"]


@dataclass(frozen=True)
class Run:
    """One uninterrupted recording: ``u`` (N, n_inputs), ``y`` (N, n_outputs), first sample at ``start_s``."""

    u: Array
    y: Array
    start_s: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        self.u.flags.writeable = False
        self.y.flags.writeable = False

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.y)


@dataclass(frozen=True)
class IOData(Result):
    """Inputs and outputs of one or several runs at one sampling interval.

    ``hold`` says what the input did between samples: held (``zoh``, a computer's output) or a straight line
    (``foh``, anything physical). A wrong hold shifts the dead time by half a sample. NaN means "not measured" and
    is kept.

    >>> data = IOData.from_arrays([0.0, 1, 1, 1], [0.0, 0.1, 0.5, 0.8], dt_s=0.5, hold="zoh")
    >>> data[0.5:1.5].n_samples
    3
    >>> len(data.merge(data).runs)
    2
    """

    runs: tuple[Run, ...]
    dt_s: float
    hold: Hold
    input_names: tuple[str, ...] = ("u",)
    output_names: tuple[str, ...] = ("y",)
    input_units: tuple[str, ...] = ("",)
    output_units: tuple[str, ...] = ("",)
    name: str = ""
    findings: tuple[Finding, ...] = ()

    @classmethod
    def from_arrays(
        cls,
        u: ArrayLike,
        y: ArrayLike,
        dt_s: float,
        *,
        hold: Hold = "foh",
        start_s: float = 0.0,
        input_names: Sequence[str] = (),
        output_names: Sequence[str] = (),
        input_units: Sequence[str] = (),
        output_units: Sequence[str] = (),
        name: str = "",
    ) -> IOData:
        """One run from ``u`` (N,) or (N, n_inputs) and ``y`` (N,) or (N, n_outputs), sampled every ``dt_s`` [s].

        Raises InputError for unequal lengths, an unusable ``dt_s`` or hold, infinite or wrapped-around values.
        """
        where = name or "IOData"
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise InputError(
                f"dt_s is {dt_s}", where=where, expected="a sampling interval in seconds above zero"
            )
        check_hold(hold, where)
        ua = columns(u, input_names, "input", where)
        ya = columns(y, output_names, "output", where)
        if len(ua) != len(ya):
            raise InputError(
                f"the input has {len(ua)} samples, the output {len(ya)}",
                where=where,
                expected="equal lengths",
            )
        ni = ua.shape[1]
        no = ya.shape[1]
        return cls(
            runs=(Run(ua, ya, float(start_s), name),),
            dt_s=float(dt_s),
            hold=hold,
            input_names=tuple(input_names) or numbered("u", ni),
            output_names=tuple(output_names) or numbered("y", no),
            input_units=tuple(input_units) or ("",) * ni,
            output_units=tuple(output_units) or ("",) * no,
            name=name,
        )

    def summary(self) -> str:
        """Names, runs, samples and what is missing."""
        said = f"{', '.join(self.input_names)} -> {', '.join(self.output_names)}: {len(self.runs)} run(s), "
        said += f"{self.n_samples} samples every {self.dt_s:g} s, input {self.hold.upper()}"
        said += f", {self.missing} output values missing" if self.missing else ""
        return "\n".join([said, *(f"  {f.sentence}" for f in self.findings)])

    def to_dict(self) -> dict[str, Any]:
        """Names, units, sampling and length of each run; the samples are in ``runs``."""
        return {
            "name": self.name,
            "inputs": dict(zip(self.input_names, self.input_units)),
            "outputs": dict(zip(self.output_names, self.output_units)),
            "dt_s": self.dt_s,
            "hold": self.hold,
            "runs": [{"name": r.name, "start_s": r.start_s, "samples": r.n} for r in self.runs],
            "missing": self.missing,
            "findings": [f.to_dict() for f in self.findings],
        }

    @property
    def n_samples(self) -> int:
        """Samples in all runs together."""
        return sum(run.n for run in self.runs)

    @property
    def duration_s(self) -> float:
        """Length of the longest run [s]."""
        return max(run.n for run in self.runs) * self.dt_s

    @property
    def missing(self) -> int:
        """How many output values were not measured."""
        return int(sum(np.isnan(run.y).sum() for run in self.runs))

    def merge(self, *others: IOData) -> IOData:
        """These runs and those of ``others``, each still with its own start; never one after the other in time."""
        for other in others:
            same = (np.isclose(other.dt_s, self.dt_s, rtol=1e-6), other.hold == self.hold)
            if not all(same) or (other.input_names, other.output_names) != (
                self.input_names,
                self.output_names,
            ):
                raise InputError(
                    f"merge: {other.name or 'the second data set'} has dt_s {other.dt_s}, hold {other.hold}, columns "
                    f"{other.input_names} -> {other.output_names}",
                    expected=f"dt_s {self.dt_s}, hold {self.hold}, {self.input_names} -> {self.output_names}",
                    remedy="resample or rename one of them first",
                )
        findings = tuple(unique(f for each in (self, *others) for f in each.findings))
        return replace(self, runs=sum((o.runs for o in others), self.runs), findings=findings)

    def between(self, start_s: float | None = None, end_s: float | None = None) -> IOData:
        """The samples with start_s <= time <= end_s of every run; runs left empty are dropped."""
        kept = []
        for run in self.runs:
            first = (
                0
                if start_s is None
                else max(0, int(np.ceil((start_s - run.start_s) / self.dt_s - 1e-9)))
            )
            last = (
                run.n
                if end_s is None
                else int(np.floor((end_s - run.start_s) / self.dt_s + 1e-9)) + 1
            )
            if first < min(last, run.n):
                kept.append(
                    Run(
                        run.u[first:last],
                        run.y[first:last],
                        run.start_s + first * self.dt_s,
                        run.name,
                    )
                )
        if not kept:
            raise InputError(
                f"no sample lies between {start_s} s and {end_s} s", where=self.name or "IOData"
            )
        return replace(self, runs=tuple(kept))

    def __getitem__(self, window: slice) -> IOData:
        """``data[2.0:10.0]``: slicing in seconds, both ends included."""
        return self.between(window.start, window.stop)

    def run(self, index: int) -> IOData:
        """One run alone."""
        return replace(self, runs=(self.runs[index],))

    def select(
        self, input: str | Sequence[str] | None = None, output: str | Sequence[str] | None = None
    ) -> IOData:
        """Some of the inputs and outputs, by name; all of them where no name is given."""
        i = indices_of(input, self.input_names, "input")
        o = indices_of(output, self.output_names, "output")
        names = {self.input_names[k] for k in i} | {self.output_names[k] for k in o}
        return replace(
            self,
            runs=tuple(replace(r, u=r.u[:, i].copy(), y=r.y[:, o].copy()) for r in self.runs),
            input_names=tuple(self.input_names[k] for k in i),
            output_names=tuple(self.output_names[k] for k in o),
            input_units=tuple(self.input_units[k] for k in i),
            output_units=tuple(self.output_units[k] for k in o),
            findings=tuple(f for f in self.findings if f.subject in names),
        )

    def times_s(self, index: int = 0) -> Array:
        """Time of every sample of one run [s]."""
        return np.asarray(self.runs[index].start_s + np.arange(self.runs[index].n) * self.dt_s)


def numbered(letter: str, count: int) -> tuple[str, ...]:
    """Names of columns that have none: u, or u1, u2, .."""
    return (letter,) if count == 1 else tuple(f"{letter}{k}" for k in range(1, count + 1))


def check_hold(hold: Hold, where: str) -> Hold:
    """The hold as it is; InputError for one that there is not."""
    if hold not in ("zoh", "foh"):
        expected = "'zoh' (input held between samples) or 'foh' (straight line)"
        raise InputError(f"hold is {hold!r}", where=where, expected=expected)
    return hold


def indices_of(asked: str | Sequence[str] | None, names: tuple[str, ...], role: str) -> list[int]:
    """Positions of ``asked`` among ``names``; all of them when None."""
    wanted = names if asked is None else (asked,) if isinstance(asked, str) else tuple(asked)
    for name in wanted:
        if name not in names:
            raise InputError(
                f"there is no {role} named {name!r}", expected=f"one of {', '.join(names)}"
            )
    return [names.index(name) for name in wanted]


def columns(values: ArrayLike, names: Sequence[str], role: str, where: str) -> Array:
    """Two-dimensional float copy of ``values`` after the checks that only the raw numbers allow."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "iufb":
        raise InputError(f"the {role} holds {raw.dtype} values", where=where, expected="numbers")
    raw = raw[:, None] if raw.ndim == 1 else raw
    if raw.ndim != 2:
        raise InputError(
            f"the {role} has {raw.ndim} dimensions", where=where, expected="(N,) or (N, columns)"
        )
    out = np.array(raw, dtype=float)
    for k in range(out.shape[1]):
        label = names[k] if k < len(names) else f"{role} {k + 1}" if out.shape[1] > 1 else role
        if np.isinf(out[:, k]).any():
            row = int(np.flatnonzero(np.isinf(out[:, k]))[0])
            raise InputError(
                f"column {label} is infinite in row {row}",
                where=where,
                remedy="mark missing values as NaN",
            )
        check_wrap(out[:, k], label, where)
    return out


def check_wrap(values: Array, label: str, where: str) -> None:
    """Refuse whole-number columns that jump by a full 16- or 32-bit range: the logger's integer overflowed."""
    finite = values[np.isfinite(values)]
    if len(finite) < 2 or np.any(finite != np.round(finite)):
        return
    jump = np.abs(np.diff(finite))
    for bits in (16, 32):
        full = 2.0**bits
        hit = np.flatnonzero((jump > 0.8 * full) & (jump < full))
        low, high = (0.0, full - 1) if finite.min() >= 0 else (-full / 2, full / 2 - 1)
        if len(hit) and finite.min() >= low and finite.max() <= high:
            raise InputError(
                f"column {label} jumps by {jump[hit[0]]:.0f} at sample {hit[0] + 1}: a {bits}-bit integer overflowed",
                where=where,
                remedy=f"unwrap it (add {int(full)} after each wrap) or convert to float before scaling",
            )
