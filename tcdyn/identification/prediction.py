"""Prediction of the output some samples ahead, with the noise model of a fit.

``tests/identify/test_identify_interop.py`` compares the errors with their theoretical variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.result import Result
from tcdyn.identification.iodata import IOData
from tcdyn.identification.search import Fit
from tcdyn.identification.validation import fit_nuisance_parameters, fit_percent


@dataclass(frozen=True, repr=False)
class Prediction(Result):
    """Predicted outputs.

    Parameters
    ----------
    output
        Output of each run (N,) in its unit, NaN where an input is missing.
    fit_percent
        NRMSE fit percent; 100 is perfect, 0 as bad as the mean.
    steps
        Number of samples ahead; None for a simulation.
    data
        Data of the prediction.
    """

    output: tuple[Array, ...]
    fit_percent: float
    steps: int | None
    data: IOData

    def summary(self) -> str:
        """Kind of the prediction and its fit percent, as text."""
        kind = "simulation" if self.steps is None else f"prediction {self.steps} sample(s) ahead"
        return f"{kind}: fit {self.fit_percent:.2f} %"

    def to_dict(self) -> dict[str, Any]:
        """Kind and fit percent; the samples are in :meth:`to_frame`."""
        return {"steps": self.steps, "fit_percent": self.fit_percent, "data": self.data.to_dict()}

    def to_frame(self) -> pd.DataFrame:
        """Measured and predicted output, with the index of the data."""
        name = self.data.output_names[0]
        frame = self.data.to_frame()[[name]]
        predicted = f"{name}_predicted"
        unit = self.data.output_units[0]
        frame.attrs = {"units": {name: unit, predicted: unit} if unit else {}}
        return frame.assign(**{predicted: np.concatenate(self.output)})


@with_named_arguments
def predict(fit: Fit, data: IOData, steps: int | None = 1) -> Prediction:
    """Predict the output from the inputs, and from the output ``steps`` samples before.

    Parameters
    ----------
    fit
        The fit.
    data
        Data with the inputs and the output of the fit.
    steps
        Number of samples ahead, 1 or more; None for a simulation, which uses no output.

    Returns
    -------
    Prediction
        Predicted output of each run, and fit percent.

    Raises
    ------
    InputError
        For ``steps`` below 1, or data that the model cannot use.

    Notes
    -----
    With the noise n = H(q) e = sum h_i e(t - i) of the fit, the prediction is the simulation plus
    n(t) - sum_{i < steps} h_i e(t - i) (Ljung, System Identification, 2nd ed. 1999, eq. 3.29). The
    innovations e begin with zero noise at the start of a run and after a gap. Where the output is
    missing, the prediction is the simulation. Offsets and initial states are fitted to ``data``.

    Examples
    --------
    >>> from tcdyn.identification import fit, process, simulate
    >>> u = np.repeat([0.0, 1.0, 0.0, 1.0], 100)
    >>> y = simulate(process("P1").rational({"Kp": 2.0, "Tp1": 0.8}), u, 0.1, "zoh")
    >>> noise = lfilter([0.1], [1.0, -0.95], np.random.default_rng(0).standard_normal(400))
    >>> data = IOData.from_arrays(u, y + noise, 0.1, hold="zoh")
    >>> result = fit(data, "P1", noise=(1, 0))
    >>> predict(result, data, 1).fit_percent > predict(result, data, None).fit_percent + 10
    True
    """
    if steps is not None and steps < 1:
        raise InputError(f"predict: steps is {steps}", expected="1 or more, or None")
    if not isinstance(fit, Fit):
        raise InputError(
            f"predict: a {type(fit).__name__}", expected="the result of fit, with a linear model"
        )
    problem, x = fit_nuisance_parameters(fit, data)
    outputs = problem.outputs(x)
    rows = problem.evaluate(x)
    assert outputs is not None  # the model is stable, it was fitted
    assert rows is not None
    noise = -rows[0]
    predicted_noise = np.zeros(len(noise))
    if steps is not None:
        ar = [1.0, *fit.noise.ar]
        ma = [1.0, *fit.noise.ma]
        pulse = lfilter(ma, ar, np.eye(1, steps)[0])
        for s in problem.residual_slices:
            innovation = lfilter(ar, ma, noise[s])
            predicted_noise[s] = noise[s] - lfilter(pulse, [1.0], innovation)
    predicted = [np.full(run.n, np.nan) for run in data.runs]
    noise_of_segments = problem.by_segment(predicted_noise)
    for segment, (y, _), segment_noise in zip(problem.segments, outputs, noise_of_segments):
        y = y.copy()
        y[segment.measured] += segment_noise
        predicted[segment.run][segment.first : segment.first + len(y)] = y
    percent = fit_percent(problem, noise - predicted_noise)
    return Prediction(tuple(predicted), percent, steps, data)
