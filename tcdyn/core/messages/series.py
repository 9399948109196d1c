"""Messages about the rows of a table: times, gaps, and values that are no readings.

A function here makes the text of one finding whose wording depends on its numbers; its arguments
are the fields of the finding (see ``tcdyn.core.messages``).
"""

from __future__ import annotations

from typing import Any

from tcdyn.core.messages.phrases import Message

# Relative standard uncertainty of a sampling rate [%] from which a message states it: the lags have
# the same, and below it is small against the other contributions. No result depends on it.
NOTABLE_RATE_U_PERCENT = 1.0


def _few_decimals(subject: str, rate_Hz: float, percent: float = 0.0, **_: Any) -> str:
    """Message of ``series.few_decimals``.

    ``rate_Hz`` is the estimated sampling rate, ``percent`` its relative standard uncertainty.
    """
    text = (
        f"column {subject}: the clock has few decimals: rows are taken as evenly sampled at "
        f"{rate_Hz:.5g} Hz"
    )
    if percent > NOTABLE_RATE_U_PERCENT:
        text += f". This rate has a standard uncertainty of {percent:.2g} %, and so have the lags"
    return text


def _range(subject: str, count: int, value: float, unit: str = "degC", **_: Any) -> str:
    """Message of ``series.range``; ``value`` is the first of ``count`` such values, in ``unit``."""
    return (
        f"column {subject}: {count} value(s) such as {value:.4g} {unit or 'degC'} are beyond the "
        "range of a thermocouple (-273 to 3000 degC); they are left out: check the wiring"
    )


def _codes(subject: str, count: int, value: float, unit: str = "", **_: Any) -> str:
    """Message of ``series.codes``; ``value`` is the first of ``count`` such values, in ``unit``."""
    written = f"{value:.4g} {unit}".strip()
    return (
        f"column {subject}: {count} value(s) such as {written} are overload or drop-out codes of "
        "the logger; they are left out: check the wiring"
    )


def _averages(averages_s: float, **_: Any) -> str:
    """Message of ``series.averages``: each row is a mean over ``averages_s``."""
    return (
        f"each row is a mean over the {averages_s:g} s before it: half of this, "
        f"{averages_s / 2:g} s, is a delay of the logger, which a lag that is measured with such "
        "rows contains. `compensate` and `follow` remove it beside the lag of the sensor alone"
    )


def _on_change(subject: str, count: int, dead_band: float, unit: str = "", **_: Any) -> str:
    """Message of ``series.on_change``; ``count`` is the number of rows of the column."""
    change = f"{dead_band:.3g} {unit}".strip()
    return (
        f"column {subject}: its {count} rows were written when the reading had changed by "
        f"{change}; between two rows it is taken as within this dead band, which the uncertainty "
        "of the results does not include"
    )


def _strays(
    subject: str, rate_Hz: float, stray_s: float, percent: float, is_told: bool = True, **_: Any
) -> str:
    """Message of ``series.strays``.

    ``percent`` is the share of the scatter ``stray_s`` that is real; ``is_told``: by the readings.
    """
    text = (
        f"column {subject}: the time stamps deviate from even sampling at {rate_Hz:.5g} Hz by "
        f"{stray_s:.2g} s (1 sd); "
    )
    if is_told:
        return (
            f"{text}according to the readings, {percent:.0f} % of this are real shifts of the "
            "sampling instants, and are corrected"
        )
    return (
        f"{text}the readings do not tell how much of this are real shifts of the sampling "
        f"instants; {percent:.0f} % are corrected"
    )


SERIES: dict[str, Message] = {
    "series.averages": _averages,
    "series.named_mean": "column {subject}: its name says that rows are means: state over what "
    "time with --averages-s, {interval_s:.4g} if over all of the interval. A lag that is measured "
    "without it contains half of that time",
    "series.few_decimals": _few_decimals,
    "series.filled_time": "column {subject}: {count} missing time(s), first in row {row} below the "
    "header, are interpolated from the rows before and after",
    "series.repeated_time": "column {subject}: {count} row(s) have the time of the row before, "
    "first in row {row} below the header; rows with one time are averaged",
    "series.strays": _strays,
    "series.uneven": "column {subject}: rows were taken at times that deviate from even sampling "
    "at {rate_Hz:.5g} Hz by {stray_s:.2g} s (1 sd): readings cannot be shifted to even times "
    "exactly, and the times of the results have this uncertainty",
    "series.lost": "column {subject}: {count} sample(s) have no row in the table, at {places} "
    "place(s), first after {first_s:.6g} s; no reading was left out there",
    "series.on_change": _on_change,
    "series.held": "column {subject}: its {count} values were written when they changed: between "
    "two of them it has the first",
    "series.range": _range,
    "series.codes": _codes,
    "series.repeats": "column {subject} has a new value in {percent:.3g} % of the rows (every "
    "{interval_s:.3g} s on average) and is repeated in the others: only its new values are used, "
    "as read at the time of their row",
}
