"""Readings of a column of a log of the rig: without codes, impossible values and spikes.

What is a reading is decided by :mod:`tcdyn.series.reading`; spikes of slip rings are found here,
before the chain is known. Used by :mod:`tcdyn.rig.log` and :mod:`tcdyn.rig.oven_log`. Tests:
``tests/rig/test_check_columns.py``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import SampleLocation
from tcdyn.estimation.trace_noise import (
    MAX_MISSING_FRACTION,
    MIN_NOISE_SAMPLES,
    SPIKES,
    find_spikes,
    white_noise_sd,
)
from tcdyn.series.plausible import HIGHEST_DEGC, LOWEST_DEGC, out_of_range
from tcdyn.series.reading import READING, Codes, Kind, reasons_of

# plausible temperatures [degC]; the upper limit is that of type J; the lower was
# chosen by judgement
# a column looks like kelvin if these quantiles of it lie within this range; chosen by judgement
KELVIN_QUANTILES = (0.02, 0.98)
KELVIN_RANGE = (250.0, 800.0)
# larger values of any column are error codes; chosen by judgement


def kind_of_column(name: str) -> Kind:
    """What a canonical column holds.

    >>> kind_of_column("fast_a_degC").value, kind_of_column("load_N").value
    ('temperature', 'input')
    """
    is_temperature = name.endswith("_degC") and name != "setpoint_degC"
    return Kind.TEMPERATURE if is_temperature else Kind.INPUT


def cleaned_column(
    name: str, values: Array, noise_K: float = np.inf, codes: Codes | None = None
) -> Array:
    """Replace codes, impossible values and spikes of a column by NaN.

    Parameters
    ----------
    name
        Name of the column; it is a temperature if it ends with "_degC".
    values
        Column, (N,).
    noise_K
        Noise for the spike rule, see ``spike_noise_K``; infinite for no spikes.
    codes
        Codes of the logger in the complete column; None: those in these values.

    Returns
    -------
    array
        Column, (N,), NaN where the value is no reading.
    """
    kind = kind_of_column(name)
    out = np.where(reasons_of(values, kind, codes) == READING, values, np.nan)
    if kind is Kind.TEMPERATURE:
        out[find_spikes(out, SPIKES["reading"], noise_K)] = np.nan
    return out


def spike_noise_K(
    name: str, sample: Array, rows: NDArray[np.int64], location: SampleLocation
) -> float:
    """Noise [K] of a column for its spike rule, from a decimated sample of it.

    Parameters
    ----------
    name
        Name of the column.
    sample, rows
        Decimated values (M,) and their rows (M,).
    location
        Location in messages, with the sampling interval.

    Returns
    -------
    float
        Infinite where no spikes are searched, or there are too few samples.

    Raises
    ------
    InputError
        For a temperature without numbers, for kelvin, and for values that no thermocouple gives.
    """
    if not name.endswith("_degC"):
        return np.inf
    finite = sample[np.isfinite(sample)]
    if not len(finite):
        raise InputError(
            f"column {name} holds no numbers",
            where=location.where,
            expected="degrees Celsius",
            column=name,
        )
    low, high = np.quantile(finite, KELVIN_QUANTILES)
    if low > KELVIN_RANGE[0] and high < KELVIN_RANGE[1]:
        raise InputError(
            f"column {name} lies between {low:.4g} and {high:.4g}: this looks like kelvin",
            where=location.where,
            expected="degrees Celsius",
            remedy=f"call it {name.removesuffix('degC')}K, in the file or in rig.toml [columns]",
        )
    is_outside = out_of_range(sample)
    if is_outside.mean() > MAX_MISSING_FRACTION:
        i = int(np.argmax(is_outside))
        more = int(is_outside.sum()) - 1
        raise InputError(
            f"{location.at(name, int(rows[i]))}: {sample[i]:.4g} and {more} more values "
            "that no junction has",
            where=location.where,
            expected=f"{LOWEST_DEGC:g} to {HIGHEST_DEGC:g} degC",
            remedy="check the unit and the wiring of this channel",
            column=name,
        )
    good = sample[np.isfinite(sample) & ~is_outside]
    if location.dt_s is None or len(good) < MIN_NOISE_SAMPLES:
        return np.inf
    return float(white_noise_sd(good, 1))
