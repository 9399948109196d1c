"""Identification of continuous-time models with dead time from sampled input-output data.

>>> import numpy as np
>>> from tcdyn.identify import IOData, fit, process
>>> from tcdyn.identify import simulate
>>> u = np.repeat([20.0, 80.0, 20.0], 60)
>>> y = simulate(process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12}), u, 0.05, "zoh")
>>> round(fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P1D").identified.theta["Tp1"], 4)
0.75
"""

from tcdyn.chain.rational import simulate
from tcdyn.identify.choose import CANDIDATES, Comparison, compare, held_out_score, joint_table
from tcdyn.identify.data import IOData, Run
from tcdyn.identify.data.tables import from_csv, from_frame
from tcdyn.identify.fit import fit
from tcdyn.identify.frequency import Response, fit_response
from tcdyn.identify.identified import Identified, from_control, read_identified
from tcdyn.identify.intervals import profile
from tcdyn.identify.models import Known, Model, chain_model, process, several, transfer
from tcdyn.identify.responses import bode_band, percent_times, roots_of, step_band
from tcdyn.identify.search import Fit
from tcdyn.identify.validate import Validation, confirm, validate

__all__ = [
    "CANDIDATES",
    "Comparison",
    "Fit",
    "IOData",
    "Identified",
    "Known",
    "Model",
    "Response",
    "Run",
    "Validation",
    "bode_band",
    "chain_model",
    "compare",
    "confirm",
    "fit",
    "fit_response",
    "from_control",
    "from_csv",
    "from_frame",
    "held_out_score",
    "joint_table",
    "percent_times",
    "process",
    "profile",
    "read_identified",
    "roots_of",
    "several",
    "simulate",
    "step_band",
    "transfer",
    "validate",
]
