"""Settings of a controller for an identified model, or for its file.

The rules, margins and responses are in :mod:`tcdyn.tuning`. Tests:
``tests/tuning/test_tune_model.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tcdyn.core.arguments import check_type, with_named_arguments
from tcdyn.identification.identified import Identified, read_identified
from tcdyn.identification.search import Fit
from tcdyn.tuning import Tuning


@with_named_arguments
def tune(model: Identified | Fit | str | Path, input: str | None = None, **options: Any) -> Tuning:
    """Settings of a PI or PID controller for an identified model.

    Parameters
    ----------
    model
        The model, a fit, or the file that ``tcdyn identify`` wrote.
    input
        Name of the input that the controller sets; needed for several.
    **options
        The fields of :class:`tcdyn.tuning.TuneOptions`: ``rule`` ("simc" or "robust"),
        ``controller`` ("pi" or "pid"), ``tau_c_s``, ``max_ms``, ``derivative_filter``,
        ``setpoint_weight``, ``sample_s``.

    Returns
    -------
    Tuning
        Settings, margins and responses, with their ranges over the model's distribution.

    Raises
    ------
    InputError
        For a model for which the rule has no settings, and another file.

    Notes
    -----
    SIMC settings follow from a model of first or second order, margins and responses from the
    complete model with its exact dead time. The ranges are those of 500 models, drawn from the
    distribution of the parameters; they do not contain a wrong structure of the model. The
    controller output has no limits.

    Examples
    --------
    >>> import numpy as np
    >>> from tcdyn.identification import process
    >>> theta = {"Kp": 2.0, "Tp1": 80.0, "Td": 10.0}
    >>> model = Identified.of(process("P1D"), theta, np.diag([0.01, 16.0, 1.0]))
    >>> tuning = tune(model, sample_s=1.0)
    >>> round(tuning.controller.ideal.gain, 3), round(tuning.margins["ms"].value, 2)
    (1.905, 1.6)
    """
    check_type("model", model, (Identified, Fit, str, Path), "an identified model, or its file")
    if isinstance(model, str | Path):
        model = read_identified(model)
    return model.tune(input, **options)
