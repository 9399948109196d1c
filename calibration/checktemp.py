"""Is a temperature a temperature: degrees Celsius, alive, with few gaps and spikes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from calibration.errors import InputError
from calibration.noise import white_noise_sd
from calibration.table import FloatArray, RowNumbers

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


def runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts and lengths of the runs of True.

    >>> runs(np.array([False, True, True, False, True]))
    (array([1, 4]), array([2, 1]))
    """
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    starts = np.flatnonzero(edges == 1)
    return starts, np.flatnonzero(edges == -1) - starts


def check_temperature(
    values: FloatArray, name: str, place: Place, *, junction: bool = True
) -> tuple[FloatArray, list[str]]:
    """The channel with impossible values and spikes as NaN, and what was noticed.

    ``junction`` False (ambient, oil, bath) allows a channel that does not change, with a note.

    Raises InputError for kelvin, a dead or frozen channel, values no thermocouple gives, long runs of NaN.
    """
    notes: list[str] = []
    out = values.copy()
    _check_empty(out, name, place)
    _check_kelvin(out, name, place)
    finite = np.isfinite(out)
    with np.errstate(invalid="ignore"):
        wild = np.isinf(out) | (finite & ((out < COLDEST_DEGC) | (out > HOTTEST_DEGC)))
    if wild.any():
        i = int(np.argmax(wild))
        if wild.mean() > MOST_MISSING:
            raise InputError(
                f"{place.at(name, i)}: {out[i]:.4g} and {int(wild.sum()) - 1} more values that no junction has",
                where=place.where,
                expected=f"{COLDEST_DEGC:g} to {HOTTEST_DEGC:g} degC",
                remedy="check the unit and the wiring of this channel",
            )
        notes.append(
            f"{place.at(name, i)}: {int(wild.sum())} impossible value(s) such as {out[i]:.4g}; taken as missing"
        )
        out[wild] = np.nan
    if place.dt_s is None:
        return out, notes
    _check_frozen(out, name, place, junction, notes)
    spikes = find_spikes(out)
    if spikes.any():
        i = int(np.argmax(spikes))
        share = float(spikes.mean())
        if share > MOST_MISSING:
            raise InputError(
                f"{place.at(name, i)}: {100 * share:.0f} % of the samples are spikes",
                where=place.where,
                remedy="check the slip ring and the wiring of this channel",
            )
        notes.append(f"{place.at(name, i)}: {int(spikes.sum())} spike(s); taken as missing")
        out[spikes] = np.nan
    _check_gaps(out, name, place, notes)
    return out, notes


def find_spikes(values: FloatArray) -> NDArray[np.bool_]:
    """Samples more than 8 standard deviations of the noise (and 0.5 K) from the median of the 7 around them.

    A ramp or a clean step is no spike: the median follows both. NaN is never one.
    """
    index = np.flatnonzero(np.isfinite(values))
    out = np.zeros(len(values), dtype=bool)
    if len(index) < 15:
        return out
    x = values[index]
    step = np.diff(x)
    limit = max(SPIKE_SIGMAS * float(white_noise_sd(x, 1)), SPIKE_FLOOR_K)
    if not (np.abs(step) > 0.5 * limit).any():
        return out
    out[index] = np.abs(x - median_filter(x, 7, mode="nearest")) > limit
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
                remedy="convert with calibration.typej.temperature_degC",
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


def _check_frozen(x: FloatArray, name: str, place: Place, junction: bool, notes: list[str]) -> None:
    finite = x[np.isfinite(x)]
    if np.ptp(finite) == 0.0:
        if junction:
            raise InputError(
                f"column {name} is {finite[0]:.6g} in every row: a dead channel",
                where=place.where,
                remedy="check its wiring",
            )
        notes.append(f"column {name} is {finite[0]:.6g} in every row")
        return
    same = np.diff(x) == 0.0
    starts, lengths = runs(same)
    if not len(lengths) or place.dt_s is None:
        return
    k = int(np.argmax(lengths))
    rest = same.sum() - lengths[k]
    if lengths[k] * place.dt_s > FROZEN_S and rest < 0.5 * max(len(same) - lengths[k], 1):
        text = f"{place.at(name, int(starts[k]))}: stays at {x[starts[k]]:.6g} for {lengths[k] * place.dt_s:.3g} s"
        if junction:
            raise InputError(text + ": a dead channel", where=place.where, remedy="check its wiring, or cut the log")
        notes.append(text)


def _check_gaps(x: FloatArray, name: str, place: Place, notes: list[str]) -> None:
    missing = np.isnan(x)
    if not missing.any() or place.dt_s is None:
        return
    starts, lengths = runs(missing)
    k = int(np.argmax(lengths))
    longest = float(lengths[k] * place.dt_s)
    if longest > max(LONGEST_NAN_S, 3 * place.dt_s) or missing.mean() > MOST_MISSING:
        raise InputError(
            f"{place.at(name, int(starts[k]))}: {int(lengths[k])} values in a row are missing ({longest:.3g} s), "
            f"{100 * missing.mean():.2g} % of the channel",
            where=place.where,
            expected=f"runs of at most {LONGEST_NAN_S} s and {100 * MOST_MISSING:.0f} % in all",
            remedy="cut the log there, or repair the channel",
        )
    if not any("spike" in note or "impossible" in note for note in notes):
        i = int(starts[0])
        notes.append(f"{place.at(name, i)}: {int(missing.sum())} value(s) missing, the longest run {longest:.2g} s")
