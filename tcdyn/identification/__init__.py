"""Identification of continuous-time models with dead time from sampled input-output data.

Fit and simulate:

>>> import numpy as np
>>> from tcdyn.identification import IOData, fit, process, simulate
>>> u = np.repeat([20.0, 80.0, 20.0], 60)
>>> truth = process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12})
>>> y = simulate(truth, u, 0.05, "zoh")
>>> round(fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P1D").identified.theta["Tp1"], 4)
0.75

Intervals, validation and confirmation by new data:

>>> noise = np.random.default_rng(0).normal(0, 0.2, len(y))
>>> data = IOData.from_arrays(u, y + noise, 0.05, hold="zoh")
>>> result = fit(data, "P1D")
>>> estimate, is_closed = profile(result, "Tp1")
>>> estimate.contains(0.75)
True
>>> validate(result).dynamics_missing
False
>>> noise = np.random.default_rng(1).normal(0, 0.2, len(y))
>>> new_data = IOData.from_arrays(u, y + noise, 0.05, hold="zoh")
>>> confirm(result, new_data).dynamics_missing
False
>>> round(held_out_score(result, new_data)[1], 1)
99.2

Responses:

>>> {name: round(t.value, 2) for name, t in percent_times(result.identified).items()}
{'t50': 0.64, 't63.2': 0.87, 't90': 1.85}
>>> [round(-1 / root.value.real, 2) for root in roots_of(result.identified)]
[0.75]
>>> step_band(result.identified, np.array([0.0, 10.0])).value.round(2)
array([0., 1.])
>>> bode_band(result.identified, np.array([0.01])).magnitude_dB.value.round(2)
array([-0.01])

Comparison of models:

>>> joint_table({"y": compare(data, "P1", "P1D")})["model"].tolist()
['P1D']
>>> import control
>>> existing = from_control(control.tf([1.0], [0.75, 1.0]), delay_s=0.12)
>>> compare(data, existing, "P1").recommended
'TF(0,1)D as given'
>>> chain_model("P2").names
('Kp', 'Tp1', 'Tp2')
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
from tcdyn.identification.fit import fit
from tcdyn.identification.frequency import Response, fit_response
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
from tcdyn.identification.responses import bode_band, percent_times, roots_of, step_band
from tcdyn.identification.search import Fit
from tcdyn.identification.tables import from_csv, from_frame
from tcdyn.identification.validate import Validation, confirm, validate

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
    "Validation",
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
    "validate",
]
