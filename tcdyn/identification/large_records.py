"""The part of a large record on which structures are compared: block means, and a time window.

``tcdyn.identification.comparison`` compares models on this record and fits the recommended one to
all rows. ``tests/identify/test_identify_large.py`` compares it with the search on all rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification.fitting import fit
from tcdyn.identification.heldout import SCORING_OPTIONS
from tcdyn.identification.holds import check_hold
from tcdyn.identification.iodata import IOData, Run
from tcdyn.identification.ladder import Ladder
from tcdyn.identification.search import Fit

# Rows that are searched at most: 20 to 40 fits of 10^4 rows take 3 CPU s with white noise and 15
# with coloured noise (tests/benchmarks/large_records.py).
MAX_SEARCH_ROWS = 10_000
# Lag over the length of a block. The input between two means is not a straight line; the error
# falls with the square of this ratio. At 28 it made a zero significant in case A (swing 50 K, noise
# 0.5 K, 40 of BIC in 10^4 blocks); at 100 it is 160 times smaller in variance.
MIN_LAG_BLOCKS = 100.0
# Rows before a window whose inputs are used and whose outputs are not: the response to what was
# before them has decayed. Blocks are chosen such that this is about ten lags.
LEAD_IN_ROWS = 1000


@dataclass(frozen=True)
class SearchRecord:
    """A record for the comparison of models.

    Parameters
    ----------
    data
        The record.
    block
        Rows of the original record in each of its rows.
    is_window
        Whether it leaves out rows.
    """

    data: IOData
    block: int = 1
    is_window: bool = False


def search_record(ladder: Ladder) -> SearchRecord:
    """Return the record on which the structures are compared.

    Parameters
    ----------
    ladder
        The complete record and the options.

    Returns
    -------
    SearchRecord
        The record itself, up to ``MAX_SEARCH_ROWS`` measured rows. Else means over blocks as long
        as the lag permits, and of these the windows in which the inputs move most.

    Notes
    -----
    The mean over a block commutes with a linear system, so gain, lags and dead time stay. A robust
    loss needs the rows themselves: outliers would spread over their blocks.
    """
    data = ladder.data
    if data.n_samples - data.n_missing <= MAX_SEARCH_ROWS:  # a gap such as a night does not count
        return SearchRecord(data)
    longest_block = -(-data.n_samples // MAX_SEARCH_ROWS)
    block = 1
    if ladder.options.get("loss", "linear") == "linear":
        lag_blocks = coarse_lag_s(ladder, longest_block) / (MIN_LAG_BLOCKS * data.dt_s)
        block = int(np.clip(lag_blocks, 1, longest_block))
    means = block_means(data, block)
    window = most_excited(means)
    return SearchRecord(window, block, window.n_samples < means.n_samples)


def coarse_lag_s(ladder: Ladder, block: int) -> float:
    """Return the shortest lag [s] behind any input, of P1D models fitted to block means.

    Parameters
    ----------
    ladder
        The complete record and the options.
    block
        Rows of a block.

    Returns
    -------
    float
        The first moment; 0 where it cannot be fitted.
    """
    means = block_means(ladder.data, block)
    model = ladder.model(["P1D"] * len(means.input_names))
    options = {"noise": "white", "baseline": "none", "initial": "equilibrium", "check": False}
    ladder.announce("lag for the length of blocks")
    try:
        coarse = fit(means, model, **{**SCORING_OPTIONS, **options})
    except InputError:
        return 0.0
    lags = [part.lag_s.value for part in coarse.identified.by_input.values() if part.gain]
    return float(min(lags, default=0.0))


def block_means(data: IOData, block: int) -> IOData:
    """Return the means over blocks of rows, with a straight line between the inputs.

    Parameters
    ----------
    data
        The record.
    block
        Rows of a block.

    Returns
    -------
    IOData
        The record, with means at the time of the first row of each block. A block without a gap has
        a value, any other is NaN.

    Notes
    -----
    A held input has its mean in the middle between two rows, half a row later than its row. The
    mean of a row and the one before is in the middle of the row itself.
    """
    if block == 1:
        return data
    is_held = np.array([hold == "zoh" for hold in data.holds])
    runs = []
    for run in data.runs:
        n = run.n // block * block
        if n == 0:
            continue
        before = np.concatenate([run.u[:1], run.u[:-1]])
        u = np.where(is_held, 0.5 * (run.u + before), run.u)
        runs.append(
            Run(_block_means(u[:n], block), _block_means(run.y[:n], block), run.start_s, run.name)
        )
    dt_s = block * data.dt_s
    hold = check_hold("foh", len(data.input_names), "block_means")
    return replace(data, runs=tuple(runs), dt_s=dt_s, hold=hold)


def _block_means(table: Array, block: int) -> Array:
    """Return the means (N/block, K) over blocks of rows of a table (N, K)."""
    return np.asarray(table.reshape(-1, block, table.shape[1]).mean(axis=1))


def most_excited(data: IOData) -> IOData:
    """Return windows of the runs, those in which the inputs vary most, of enough rows together.

    Parameters
    ----------
    data
        The record.

    Returns
    -------
    IOData
        The record with at least ``MAX_SEARCH_ROWS`` rows where it has as many, in runs of at most
        that length. A window that starts within a run has up to ``LEAD_IN_ROWS`` rows before it, in
        which the output is NaN.
    """
    if data.n_samples <= MAX_SEARCH_ROWS:
        return data
    variance = np.nanvar(np.concatenate([run.u for run in data.runs]), axis=0)
    windows = []
    scores = []
    for run in data.runs:
        for start in range(0, run.n, MAX_SEARCH_ROWS):
            first = max(0, min(start, run.n - MAX_SEARCH_ROWS))
            rows = slice(first, start + MAX_SEARCH_ROWS)
            share_measured = np.isfinite(run.y[rows]).mean()
            if share_measured == 0 or np.isnan(run.u[rows]).all(axis=0).any():
                continue
            changes = np.nanvar(run.u[rows], axis=0) / np.where(variance > 0, variance, np.inf)
            scores.append(float(share_measured * changes.sum()))
            windows.append((run, rows))
    taken = []
    n_rows = 0
    for index in np.argsort(scores, kind="stable")[::-1]:
        run, rows = windows[index]
        lead_in = min(rows.start, LEAD_IN_ROWS)
        wide = slice(rows.start - lead_in, rows.stop)
        y = run.y[wide].copy()
        y[:lead_in] = np.nan
        taken.append(Run(run.u[wide], y, run.start_s + wide.start * data.dt_s, run.name))
        n_rows += len(y) - lead_in
        if n_rows >= MAX_SEARCH_ROWS:
            break
    return replace(data, runs=tuple(taken))


def fit_all_rows(ladder: Ladder, best: Fit, record: SearchRecord) -> Fit:
    """Fit the recommended model to all rows.

    Parameters
    ----------
    ladder
        The complete record and the options.
    best
        The fit of the model to the record of the search, where the fit starts.
    record
        The record of the search.

    Returns
    -------
    Fit
        The fit, with quadratic intervals.

    Notes
    -----
    The noise of single rows is another one than that of block means, for which :func:`fit` selects
    it anew. At such lengths a profile likelihood costs minutes and changes the intervals little. A
    record of which the search has seen windows only starts from a free state.
    """
    model = best.problem.model
    ladder.announce(f"{model.name}, all rows")
    options = {
        "initial": "estimated" if record.is_window else best.problem.initial,
        **ladder.options,
        **SCORING_OPTIONS,
    }
    return fit(ladder.data, model, **options, start=best.identified.theta)
