"""Whether the readings contradict the law that a lag follows.

A wrong lag that is constant cannot be seen in one record: the temperature that is estimated
explains what the lag does not. A law of a lag can: if it is wrong, the temperature seems to move
more where the quantity is high or low. So it does if it really moves more there: the warning says
both. Records with sudden changes are not tested. Used by :mod:`tcdyn.smoothing.smoother`.
Guarded by ``tests/smoothing/test_law_check.py``; ``tests/smoothing/flow_study.py`` counts false
alarms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tcdyn.core import Array
from tcdyn.core.findings import Finding, warning
from tcdyn.smoothing.followed_flow import FollowedFlow
from tcdyn.smoothing.process_noise import segment
from tcdyn.smoothing.record import FollowedLag
from tcdyn.smoothing.roughness import refine, select_channels
from tcdyn.smoothing.state_space import Smoothed, likelihood, smooth_record

# Strengths of the law that are compared: its logarithm times these. 0: the lag does not follow.
STRENGTHS = (0.0, 0.5, 1.5, 2.0, 3.0)
# Natural logarithm of the likelihood ratio beyond which the law is contradicted
# (`python -m tests.smoothing.flow_study`, seeds 95401 and 95601: 2 and 0 alarms in 200 records
# whose law was right)
CONTRADICTED = 7.0
# Standard uncertainties of the law within which it is not compared with another one
WITHIN_U = 2.0
# Rows of the record that are compared at most, where the lag varies most. A matter of time only
MOST_ROWS = 4000
# Variation of the lag by its law from which the law matters: one standard deviation of its
# logarithm. Below it no strength changes the likelihood
LEAST_VARIATION = 0.03


def law_findings(fit: Smoothed, flow: FollowedFlow, names: Sequence[str]) -> list[Finding]:
    """A warning for each channel whose readings contradict the law of its lag.

    Parameters
    ----------
    fit
        The smoothed record.
    flow
        The lags of its channels.
    names
        Names of the channels (M,).
    """
    findings = []
    for channel, law in enumerate(flow.laws):
        if law is None:
            continue
        rows = _rows_of_most_variation(np.log(flow.factor[:, channel]))
        if np.std(np.log(flow.factor[rows, channel])) < LEAST_VARIATION:
            continue
        if _has_changes(fit, channel, rows):
            continue
        u = flow.strength_u(channel)
        stated = [1 - WITHIN_U * u, 1.0, 1 + WITHIN_U * u] if u > 0 else [1.0]
        others = [each for each in STRENGTHS if abs(each - 1) > WITHIN_U * u]
        if not others:
            continue
        values = _log_likelihoods(fit, flow, channel, rows, [*stated, *others])
        of_stated = float(values[: len(stated)].max())
        best = int(np.argmax(values[len(stated) :]))
        gain = float(values[len(stated) + best]) - of_stated
        if gain > CONTRADICTED:
            finding = warning(
                "trace.law",
                subject=names[channel],
                quantity=law.quantity,
                strength=others[best],
                log_ratio=gain,
            )
            findings.append(finding)
    return findings


def _has_changes(fit: Smoothed, channel: int, rows: slice) -> bool:
    """Whether sudden changes were found in some rows: where they are depends on the law."""
    start_s = fit.record.dt_s * rows.start
    end_s = fit.record.dt_s * rows.stop
    changes = fit.intensities[channel].changes
    return any(start_s <= change.start_s < end_s for change in changes)


def _rows_of_most_variation(log_factor: Array) -> slice:
    """The rows (at most ``MOST_ROWS``) in which the lag varies most."""
    starts = range(0, len(log_factor), MOST_ROWS)
    blocks = [slice(start, min(start + MOST_ROWS, len(log_factor))) for start in starts]
    return max(blocks, key=lambda rows: float(np.std(log_factor[rows])) * (rows.stop - rows.start))


def _log_likelihoods(
    fit: Smoothed, flow: FollowedFlow, channel: int, rows: slice, strengths: Sequence[float]
) -> Array:
    """Log likelihood of some rows of a channel for some strengths of its law.

    Parameters
    ----------
    fit, flow
        As in ``law_findings``.
    channel
        Index of the channel.
    rows
        The rows.
    strengths
        Strengths (K,).

    Notes
    -----
    The intensities are estimated again for each, in the same segments, so that no law has more
    freedom than another.
    """
    is_channel = np.arange(len(fit.intensities)) == channel
    of_channel = select_channels(fit.record, is_channel)
    part = segment(of_channel, rows.start, rows.stop, of_channel.events_s)
    noise_var = fit.noise_var[is_channel]
    intensity = fit.intensities[channel].continued(rows.start * fit.record.dt_s)
    values = []
    for strength in strengths:
        lag_s = flow.lag_with_strength(channel, strength)[rows]
        record = replace(part, followed=(FollowedLag.of(lag_s, part.sensors[0]),))
        refined = refine(smooth_record(record, noise_var, [intensity]), 0)
        value, _ = likelihood(record, noise_var, [[refined.intensities[0]]])
        values.append(float(value[0, 0]))
    return np.array(values)
