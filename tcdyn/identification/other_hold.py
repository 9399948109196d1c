"""Check of the hold of each input: by its samples, and by a fit under the other hold.

A wrong hold shifts the dead time by half a sample. ``tcdyn.identification.comparison`` uses the
check; ``tests/identify/test_identify_holds.py`` checks both conditions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tcdyn.core.findings import Finding, warning
from tcdyn.identification.holds import Hold, check_hold, is_setpoint
from tcdyn.identification.ladder import Ladder
from tcdyn.identification.recommendation import DECISIVE_BIC
from tcdyn.identification.search import Fit
from tcdyn.identification.setting import bic
from tcdyn.identification.validation import is_undriven

# Half a sample over the standard uncertainty of the dead time, below which a wrong hold does not
# matter: an error of 0.5 u lowers the coverage of a 95 % interval of a normal distribution to 92 %.
MIN_SHIFT_U = 0.5


def check_holds(ladder: Ladder, result: Fit) -> list[Finding]:
    """Return a warning for each input whose hold is probably the other one.

    Parameters
    ----------
    ladder
        The record and the options.
    result
        The fit of the recommended model.

    Returns
    -------
    list of Finding
        "record.other_hold", with the hold of the record, all holds as they should be, and the BIC
        that the other hold gains, or None where the samples of the input decide.

    Notes
    -----
    An input that was set by a computer (:func:`tcdyn.identification.holds.is_setpoint`) is held.
    Where the samples do not decide, the same model is fitted under the other hold. It is reported
    where its BIC is lower by more than ``DECISIVE_BIC`` and its residuals do not follow the input:
    a hold can also replace dynamics that the model lacks. A free dead time takes up the shift, so
    the two fits are equal unless the dead time is near zero.
    """
    data = ladder.data
    findings = []
    for k, (name, hold) in enumerate(zip(data.input_names, data.holds)):
        part = result.identified.by_input[name]
        delay = part.estimates.get("Td")
        is_exact_enough = delay is not None and 0.5 * data.dt_s < MIN_SHIFT_U * delay.u
        if not part.gain or is_exact_enough:
            continue
        other: Hold = "foh" if hold == "zoh" else "zoh"
        holds = (*data.holds[:k], other, *data.holds[k + 1 :])
        is_set, step = is_setpoint(np.concatenate([run.u[:, k] for run in data.runs]))
        if is_set and not step:
            gain = None
            is_wrong = hold == "foh"
        else:
            gain = gain_of_hold(ladder, result, holds)
            is_wrong = gain > DECISIVE_BIC
        if is_wrong:
            findings.append(
                warning(
                    "record.other_hold",
                    subject=name,
                    hold=hold,
                    holds=holds,
                    bic=gain,
                    half_s=0.5 * data.dt_s,
                )
            )
    return findings


def gain_of_hold(ladder: Ladder, result: Fit, holds: tuple[Hold, ...]) -> float:
    """Return the BIC that other holds gain; zero where their residuals follow the input.

    Parameters
    ----------
    ladder
        The record and the options.
    result
        The fit under the holds of the record.
    holds
        The other holds.

    Returns
    -------
    float
        BIC of ``result`` less that of the same model under ``holds``.
    """
    model = result.problem.model
    if result.loss != "linear" or model.arx or not model.free:
        return 0.0
    data = replace(ladder.data, hold=check_hold(holds, len(holds), "hold"))
    start = [result.identified.theta]
    initial = result.problem.initial
    setting = replace(ladder.setting, initial=initial)
    if setting.is_averaged:
        setting = setting.at_likeliest_noise(result)
    same = ladder.fit_model(model, setting, start)
    other = replace(ladder, data=data).fit_model(model, setting, start)
    if same is None or other is None or not is_undriven(other):
        return 0.0
    return bic(same) - bic(other)
