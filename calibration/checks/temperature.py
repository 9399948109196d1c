"""Is a temperature a temperature: degrees Celsius, alive, with few gaps and spikes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from calibration.checks.tally import Tally
from calibration.checks.thin import thinned
from calibration.errors import InputError
from calibration.files.table import FloatArray, RowNumbers
from calibration.noise import white_noise_sd

COLDEST_DEGC, HOTTEST_DEGC = -60.0, 760.0  # type J's range at the hot end
LONGEST_NAN_S = 0.5
MOST_MISSING = 0.05  # fraction of a channel
FROZEN_S = 10.0
SPIKE_SIGMAS = 8.0
SPIKE_FLOOR_K = 0.5


@dataclass(frozen=True)
class Place:
    """Where samples stand: file, rows and times, for sentences."""

    where: str
    rows: RowNumbers
    time_s: FloatArray | None = None
    dt_s: float | None = None

    def at(self, column: str, index: int) -> str:
        """Column, row and, in a trace, time of a sample."""
        text = f"column {column}, row {self.rows.of(index)}"
        if self.time_s is not None:
            text += f" ({self.time_s[index]:.6g} s)"
        return text


class TemperatureCheck:
    """A temperature column that comes in pieces: cleaned piece by piece, judged at the end.

    ``sample`` is the column, thinned where it is long: its kelvin and the noise that tells a spike are seen there.
    ``junction`` False (ambient, oil, bath) allows a channel that does not change, with a note.

    Raises InputError for an empty column and for kelvin.
    """

    def __init__(self, name: str, sample: FloatArray, place: Place, junction: bool = True) -> None:
        self.name, self.place, self.junction = name, place, junction
        _check_empty(sample, name, place)
        _check_kelvin(sample, name, place)
        self.limit = spike_limit(np.where(_wild(sample), np.nan, sample)) if place.dt_s is not None else np.inf
        self.wild, self.spikes, self.absent, self.missing, self.same = Tally(), Tally(), Tally(), Tally(), Tally()
        self.seen, self.last, self.low, self.high = 0, np.nan, np.inf, -np.inf

    def clean(self, values: FloatArray) -> FloatArray:
        """The samples (N,) with impossible values and spikes as NaN; a spike needs three neighbours on each side."""
        out = np.where(_wild(values), np.nan, values)
        if np.isfinite(self.limit):
            out[find_spikes(out, self.limit)] = np.nan
        return out

    def see(self, values: FloatArray, cleaned: FloatArray) -> None:
        """Count what happened to the next samples (N,)."""
        at, wild, absent, missing = self.seen, _wild(values), np.isnan(values), np.isnan(cleaned)
        self.seen += len(values)
        self.wild.see(wild, values, at)
        self.absent.see(absent, values, at)
        self.missing.see(missing, values, at)
        self.spikes.see(missing & ~absent & ~wild, values, at)
        real = np.concatenate([[self.last], np.where(wild, np.nan, values)])
        self.same.see(np.diff(real) == 0.0, real[:-1], at - 1)
        self.last = float(real[-1])
        self.low, self.high = (
            float(np.fmin.reduce(real, initial=self.low)),
            float(np.fmax.reduce(real, initial=self.high)),
        )

    def judge(self) -> list[str]:
        """What was noticed. Raises InputError for a dead or frozen channel, values no thermocouple gives, long gaps."""
        name, place, notes = self.name, self.place, list[str]()
        if self.wild.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{place.at(name, self.wild.first)}: {self.wild.value:.4g} and {self.wild.count - 1} more values "
                "that no junction has",
                where=place.where,
                expected=f"{COLDEST_DEGC:g} to {HOTTEST_DEGC:g} degC",
                remedy="check the unit and the wiring of this channel",
            )
        if self.wild.count:
            notes.append(
                f"{place.at(name, self.wild.first)}: {self.wild.count} impossible value(s) such as "
                f"{self.wild.value:.4g}; taken as missing"
            )
        if place.dt_s is None:
            return notes
        self._judge_frozen(place.dt_s, notes)
        if self.spikes.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{place.at(name, self.spikes.first)}: {100 * self.spikes.count / self.seen:.0f} % of the samples "
                "are spikes",
                where=place.where,
                remedy="check the slip ring and the wiring of this channel",
            )
        if self.spikes.count:
            notes.append(f"{place.at(name, self.spikes.first)}: {self.spikes.count} spike(s); taken as missing")
        self._judge_gaps(place.dt_s, notes)
        return notes

    def _judge_frozen(self, dt_s: float, notes: list[str]) -> None:
        same, name, place = self.same, self.name, self.place
        if self.low == self.high:
            text = f"column {name} is {self.low:.6g} in every row"
            if self.junction:
                raise InputError(text + ": a dead channel", where=place.where, remedy="check its wiring")
            notes.append(text)
            return
        others = self.seen - 1 - same.length
        if same.length * dt_s > FROZEN_S and same.count - same.length < 0.5 * max(others, 1):
            text = f"{place.at(name, same.start)}: stays at {same.held:.6g} for {same.length * dt_s:.3g} s"
            if self.junction:
                raise InputError(
                    text + ": a dead channel", where=place.where, remedy="check its wiring, or cut the log"
                )
            notes.append(text)

    def _judge_gaps(self, dt_s: float, notes: list[str]) -> None:
        longest = self.missing.length * dt_s
        if longest > max(LONGEST_NAN_S, 3 * dt_s) or self.missing.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{self.place.at(self.name, self.missing.start)}: {self.missing.length} values in a row are missing "
                f"({longest:.3g} s), {100 * self.missing.count / self.seen:.2g} % of the channel",
                where=self.place.where,
                expected=f"runs of at most {LONGEST_NAN_S} s and {100 * MOST_MISSING:.0f} % in all",
                remedy="cut the log there, or repair the channel",
            )
        gap = self.absent
        if gap.count:
            some = "1 value is" if gap.length == 1 else f"{gap.length} values in a row are"
            more = f"; {gap.count} in all, this run the longest" if gap.count > gap.length else ""
            notes.append(f"{self.place.at(self.name, gap.start)}: {some} missing ({gap.length * dt_s:.2g} s){more}")


class PlainCheck:
    """A column of numbers without a limit of its own, in pieces: cleaned piece by piece, judged at the end."""

    def __init__(self, name: str, place: Place) -> None:
        self.name, self.place, self.seen, self.bad = name, place, 0, Tally()

    def clean(self, values: FloatArray) -> FloatArray:
        """The samples (N,) with those missing or beyond a million as NaN."""
        with np.errstate(invalid="ignore"):
            return np.where(np.abs(values) <= 1e6, values, np.nan)

    def see(self, values: FloatArray, cleaned: FloatArray) -> None:
        """Count what happened to the next samples (N,)."""
        self.bad.see(np.isnan(cleaned), values, self.seen)
        self.seen += len(values)

    def judge(self) -> list[str]:
        """What was noticed. Raises InputError when more than a twentieth is missing."""
        bad, place = self.bad, self.place.at(self.name, self.bad.first)
        if bad.count > MOST_MISSING * self.seen:
            raise InputError(
                f"{place}: {bad.value:.4g}; {100 * bad.count / self.seen:.0f} % of the column is missing or impossible",
                where=self.place.where,
            )
        return [f"{place}: {bad.count} value(s) missing or impossible; taken as missing"] if bad.count else []


def check_temperature(
    values: FloatArray, name: str, place: Place, *, junction: bool = True
) -> tuple[FloatArray, list[str]]:
    """A whole column (N,) with impossible values and spikes as NaN, and what was noticed; see ``TemperatureCheck``."""
    check = TemperatureCheck(name, thinned(values), place, junction)
    cleaned = check.clean(values)
    check.see(values, cleaned)
    return cleaned, check.judge()


def spike_limit(values: FloatArray) -> float:
    """How far [K] a sample of ``values (N,)`` may lie from its neighbours: 8 standard deviations of noise, or 0.5 K.

    Infinite where fewer than 15 samples tell the noise.
    """
    x = values[np.isfinite(values)]
    return max(SPIKE_SIGMAS * float(white_noise_sd(x, 1)), SPIKE_FLOOR_K) if len(x) >= 15 else np.inf


def find_spikes(values: FloatArray, limit_K: float) -> NDArray[np.bool_]:
    """Samples of ``values (N,)`` further than ``limit_K`` from the median of the 7 around them.

    A ramp or a clean step is no spike: the median follows both. NaN is never one.
    """
    index = np.flatnonzero(np.isfinite(values))
    out = np.zeros(len(values), dtype=bool)
    x = values[index]
    if (np.abs(np.diff(x)) > 0.5 * limit_K).any():  # otherwise four of seven cannot stand that far away
        out[index] = np.abs(x - median_filter(x, 7, mode="nearest")) > limit_K
    return out


def noise_sd(values: FloatArray) -> float:
    """White noise [K] of a trace from its second differences (median, so that events do not count)."""
    x = values[np.isfinite(values)]
    if len(x) < 10:
        return 0.0
    return float(white_noise_sd(x, 2, centred=False))


def check_group(columns: dict[str, FloatArray], place: Place, reference_degC: float | None) -> list[str]:
    """Channels of one disk against one another: millivolts, and one that does not follow the rest.

    ``reference_degC`` is the median of a bath or room temperature known to be in degC. Raises InputError.
    """
    high = {n: float(np.nanquantile(v, 0.99)) for n, v in columns.items()}
    low = {n: float(np.nanquantile(v, 0.01)) for n, v in columns.items()}
    warm = sorted(high.values())[len(high) // 2]
    for name, value in high.items():
        others = max(warm, reference_degC if reference_degC is not None else 0.0)
        if value < 16.0 and low[name] > -5.0 and (others > value + 8.0 or warm < 16.0):
            raise InputError(
                f"column {name} stays between {low[name]:.3g} and {value:.3g}: this looks like millivolts",
                where=place.where,
                expected="degrees Celsius",
                remedy="convert with calibration.lines.typej.temperature_degC",
            )
    rise = {n: high[n] - low[n] for n in columns}
    usual = sorted(rise.values())[len(rise) // 2]
    for name, value in rise.items():
        if usual > 10.0 and value < 0.1 * usual:
            raise InputError(
                f"column {name} changes by {value:.3g} degC, the others by {usual:.3g}: a dead channel",
                where=place.where,
                remedy="check its wiring, or leave the channel out by repairing the disk",
            )
    noise = {n: noise_sd(v) for n, v in columns.items()} if place.dt_s is not None else {}
    calm = sorted(noise.values())[len(noise) // 2] if noise else 0.0
    return [
        f"column {name}: noise {value:.2g} degC, the others' is {calm:.2g}"
        for name, value in noise.items()
        if value > 4.0 * calm + 0.1
    ]


def _check_empty(x: FloatArray, name: str, place: Place) -> None:
    if np.isnan(x).all():
        raise InputError(f"column {name} holds no numbers", where=place.where, expected="degrees Celsius")


def _check_kelvin(x: FloatArray, name: str, place: Place) -> None:
    low, high = np.nanquantile(x, [0.02, 0.98])
    if low > 250.0 and high < 800.0:
        raise InputError(
            f"column {name} lies between {low:.4g} and {high:.4g}: this looks like kelvin",
            where=place.where,
            expected="degrees Celsius",
            remedy="subtract 273.15",
        )


def _wild(x: FloatArray) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        return np.asarray((x < COLDEST_DEGC) | (x > HOTTEST_DEGC))
