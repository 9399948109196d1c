"""Identification of continuous-time models with dead time from sampled input-output data.

Fit and simulate:

>>> import numpy as np
>>> from tcdyn.identification import IOData, fit, process, simulate
>>> u = np.repeat([20.0, 80.0, 20.0], 60)
>>> truth = process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12})
>>> y = simulate(truth, u, 0.05, "zoh")
>>> round(fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P1D").identified.theta["Tp1"], 4)
0.75

Its lag with an interval, and its times of the step response:

>>> result = fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P1D", noise="white")
>>> list(result.to_frame().index)
['Kp', 'Tp1', 'Td', 'lag', 't50', 't63.2', 't90']
>>> chain_model("P2").known == KnownDynamics()
True
"""

from tcdyn.chain.rational import simulate
from tcdyn.identification.comparison import (
    CANDIDATES,
    Comparison,
    compare,
    identify,
    joint_table,
)
from tcdyn.identification.experiment import prbs_input, step_input
from tcdyn.identification.fitting import fit
from tcdyn.identification.frequency import Response, best_response_fit, fit_response
from tcdyn.identification.grey_box import FunctionFit, fit_function
from tcdyn.identification.heldout import held_out_score
from tcdyn.identification.identified import Identified, from_control, read_identified
from tcdyn.identification.intervals import profile
from tcdyn.identification.iodata import IOData, Run
from tcdyn.identification.models import (
    KnownDynamics,
    Model,
    chain_model,
    process,
    several,
    transfer,
)
from tcdyn.identification.nonparametric import impulse_response, spectral_estimate
from tcdyn.identification.prediction import Prediction, predict
from tcdyn.identification.recordings import from_csv, from_frame
from tcdyn.identification.responses import bode_band, percent_times, roots_of, step_band
from tcdyn.identification.search import Fit
from tcdyn.identification.tuning import tune
from tcdyn.identification.validation import Validation, confirm, validate
from tcdyn.tuning import Tuning

__all__ = [
    "CANDIDATES",
    "Comparison",
    "Fit",
    "FunctionFit",
    "IOData",
    "Identified",
    "KnownDynamics",
    "Model",
    "Prediction",
    "Response",
    "Run",
    "Tuning",
    "Validation",
    "best_response_fit",
    "bode_band",
    "chain_model",
    "compare",
    "confirm",
    "fit",
    "fit_function",
    "fit_response",
    "from_control",
    "from_csv",
    "from_frame",
    "held_out_score",
    "identify",
    "impulse_response",
    "joint_table",
    "percent_times",
    "prbs_input",
    "predict",
    "process",
    "profile",
    "read_identified",
    "roots_of",
    "several",
    "simulate",
    "spectral_estimate",
    "step_band",
    "step_input",
    "transfer",
    "tune",
    "validate",
]
