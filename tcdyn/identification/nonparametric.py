"""Estimates without a model: impulse response by least squares, frequency response by spectra.

``tests/identify/test_identify_interop.py`` compares both with closed forms.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Z95
from tcdyn.estimation import is_full_rank
from tcdyn.identification.frequency import Response
from tcdyn.identification.intervals import innovation_covariance
from tcdyn.identification.iodata import IOData
from tcdyn.identification.segments import (
    MIN_SEGMENT_SAMPLES,
    row_slices,
    split_segments,
    true_intervals,
)

N_WINDOWS = 8  # default windows without overlap; chosen by judgement
# Largest frequency over the sampling rate: above, the images of a held input change the response
# of a first-order lag by more than (0.1/0.9)^2, about 1 %.
MAX_FREQUENCY_SHARE = 0.1
# Squared correlation of neighbouring Hann windows that overlap by half (Welch 1967).
OVERLAP_CORRELATION = 1 / 36


@with_named_arguments
def impulse_response(data: IOData, n: int) -> pd.DataFrame:
    """Impulse response of each input by least squares (a finite impulse response model).

    Parameters
    ----------
    data
        One output, one or several inputs.
    n
        Number of samples; the response must have ended after them.

    Returns
    -------
    DataFrame
        Columns input, time_s, value, u, low95, high95. The values are in the output's over the
        input's unit and second; their sum times ``dt_s`` is the gain.

    Raises
    ------
    InputError
        Where the record is too short, or the inputs do not determine ``n`` values.

    Notes
    -----
    y(t) = offset + dt_s sum_i g_i u(t - i), with an offset for each run. The values are those of a
    held input over a sample. The covariance is robust where the residuals are correlated.

    Examples
    --------
    >>> u = np.random.default_rng(0).choice([0.0, 1.0], 500)
    >>> y = 3.0 * np.concatenate([[0.0, 0.0], u[:-2]])  # gain 3, dead time of two samples
    >>> data = IOData.from_arrays(u, y, dt_s=0.5, hold="zoh")
    >>> (impulse_response(data, 4)["value"] * data.dt_s).round().astype(int).tolist()
    [0, 0, 3, 0]
    """
    tables = []
    outputs = []
    run_numbers = []
    flags = []
    for segment in split_segments(data):
        if len(segment.y) < n:
            continue
        windows = sliding_window_view(segment.inputs, n, axis=0)[:, :, ::-1]
        measured = segment.measured[n - 1 :]
        tables.append(windows.reshape(len(windows), -1)[measured])
        outputs.append(segment.y[n - 1 :][measured])
        run_numbers += [segment.run] * int(measured.sum())
        flags.append(np.append(measured, False))
    runs = np.array(run_numbers)
    count = len(runs)
    n_unknown = n * len(data.input_names) + len(set(run_numbers))
    where = data.name or "impulse_response"
    if count < n_unknown + MIN_SEGMENT_SAMPLES:
        raise InputError(
            f"{count} samples with {n} inputs before them, for {n_unknown} unknowns",
            where=where,
            remedy="choose a smaller n",
        )
    offsets = runs[:, None] == np.unique(runs)
    table = np.hstack([np.vstack(tables) * data.dt_s, offsets.astype(float)])
    output = np.concatenate(outputs)
    if not is_full_rank(table.T @ table):
        raise InputError(
            f"the input does not determine {n} values",
            where=where,
            expected="an input that switches at irregular times, such as that of prbs_input",
            remedy="choose a smaller n",
        )
    values = np.linalg.lstsq(table, output)[0]
    residual = output - table @ values
    no_prior = np.zeros(n_unknown)
    slices = row_slices(np.concatenate(flags))
    covariance, _ = innovation_covariance(residual, table, slices, data.dt_s, no_prior)
    n_values = n * len(data.input_names)
    value = values[:n_values]
    u = np.sqrt(np.diag(covariance))[:n_values]
    return pd.DataFrame(
        {
            "input": np.repeat(data.input_names, n),
            "time_s": np.tile(np.arange(n) * data.dt_s, len(data.input_names)),
            "value": value,
            "u": u,
            "low95": value - Z95 * u,
            "high95": value + Z95 * u,
        }
    )


@with_named_arguments
def spectral_estimate(data: IOData, window_s: float | None = None) -> Response:
    """Frequency response from averaged spectra, with its uncertainty from the coherence.

    Parameters
    ----------
    data
        One input and one output.
    window_s
        Length of a window [s], many times the lag; by default an eighth of the longest run.

    Returns
    -------
    Response
        The response at frequencies whose estimates are independent;
        :func:`tcdyn.identification.fit_response` fits a model to it, and
        ``part_uncertainty()`` is its standard uncertainty.

    Raises
    ------
    InputError
        For several inputs or outputs, fewer than two windows without a gap, or no frequency at
        which the output follows the input, as in the record of a single step.

    Notes
    -----
    H1 = S_uy/S_uu over Hann windows that overlap by half (``scipy.signal.csd``), divided by the
    response of the hold. Every second frequency up to ``MAX_FREQUENCY_SHARE`` of the sampling rate
    is used: the estimates between them are correlated. The number of independent averages of K
    windows is K/(1 + 2 (1 - 1/K)/36) (Welch, IEEE Trans. Audio Electroacoust. 15 (1967), 70-73).
    Frequencies at which the coherence is not significant (5 %) are left out. Windows that are not
    much longer than the lag make the response too small.

    Examples
    --------
    >>> from tcdyn.identification import fit_response, process, simulate
    >>> u = np.repeat(np.random.default_rng(0).choice([0.0, 1.0], 1000), 8)
    >>> y = simulate(process("P1").rational({"Kp": 2.0, "Tp1": 0.8}), u, 0.1, "zoh")
    >>> response = spectral_estimate(IOData.from_arrays(u, y, 0.1, hold="zoh"))
    >>> round(fit_response(response, "P1").theta["Tp1"], 2)
    0.8
    """
    where = data.name or "spectral_estimate"
    if len(data.input_names) != 1 or len(data.output_names) != 1:
        raise InputError(
            f"{len(data.input_names)} inputs and {len(data.output_names)} outputs",
            where=where,
            expected="one of each",
            remedy="choose them: data.select(input=.., output=..)",
        )
    length_s = data.duration_s / N_WINDOWS if window_s is None else window_s
    length = max(int(length_s / data.dt_s), MIN_SEGMENT_SAMPLES)
    blocks = []
    for segment in split_segments(data):
        for block in true_intervals(segment.measured):
            if block.stop - block.start >= length:
                blocks.append((segment.u[block], segment.y[block]))
    step = length - length // 2
    counts = [(len(u) - length) // step + 1 for u, _ in blocks]
    n_windows = sum(counts)
    if n_windows < 2:
        raise InputError(
            f"{n_windows} windows of {length_s:g} s without a gap",
            where=where,
            expected="two or more",
            remedy="give a shorter window_s",
        )
    spectra = {}
    for name, first, second in (("uu", 0, 0), ("uy", 0, 1), ("yy", 1, 1)):
        each = [signal.csd(b[first], b[second], 1 / data.dt_s, nperseg=length) for b in blocks]
        frequency_Hz = each[0][0]
        spectra[name] = np.average([s for _, s in each], axis=0, weights=counts)
    averages = n_windows / (1 + 2 * (1 - 1 / n_windows) * OVERLAP_CORRELATION)
    power = np.real(spectra["uu"] * spectra["yy"])
    has_power = power > 0  # not where the input or the output is constant in every window
    coherence = np.zeros_like(power)
    coherence[has_power] = np.abs(spectra["uy"][has_power]) ** 2 / power[has_power]
    coherence = np.minimum(coherence, 1 - 1e-12)  # a record without noise
    is_used = has_power & (frequency_Hz <= MAX_FREQUENCY_SHARE / data.dt_s)
    is_used[0] = False
    is_used[1::2] = False
    is_used &= coherence > 1 - 0.05 ** (1 / (averages - 1))
    if not is_used.any():
        raise InputError(
            f"the output follows the input significantly at no frequency in {n_windows} windows "
            f"of {length_s:g} s",
            where=where,
            expected="an input that moves in most windows; a single step moves in one",
            remedy="fit a model to the record itself",
        )
    ratio = spectra["uy"][is_used] / spectra["uu"][is_used]
    response = ratio / hold_response(frequency_Hz[is_used], data)
    return Response.of(
        frequency_Hz[is_used],
        magnitude=np.abs(response),
        phase_deg=np.angle(response, deg=True),
        coherence=coherence[is_used],
        averages=averages,
        name=where,
    )


def hold_response(frequency_Hz: Array, data: IOData) -> Array:
    """Return the response of the hold of the input, relative to a continuous input.

    Parameters
    ----------
    frequency_Hz
        Frequencies (F,).
    data
        The record, with its sampling interval and the hold of its first input.

    Returns
    -------
    response
        Dimensionless (F,); one at zero frequency.

    Notes
    -----
    With sinc x = sin(pi x)/(pi x) and x = f dt: sinc(x) exp(-i pi x) for the zero-order hold, which
    delays by dt/2, and sinc(x)^2 for the first-order hold between neighbouring samples, which does
    not delay. ``tests/identify/test_identify_interop.py`` compares it with the integrals of both
    hold functions and checks that the spectral estimates with both holds agree.
    """
    cycles = frequency_Hz * data.dt_s
    if data.holds[0] == "foh":
        return np.asarray(np.sinc(cycles) ** 2)
    return np.asarray(np.sinc(cycles) * np.exp(-1j * np.pi * cycles))
