"""Identification of continuous-time models with dead time from sampled input-output data.

>>> import numpy as np
>>> from tcdyn.identify import IOData, fit, process
>>> from tcdyn.identify import simulate
>>> u = np.repeat([20.0, 80.0, 20.0], 60)
>>> y = simulate(process("P1D").rational({"Kp": 1.0, "Tp1": 0.75, "Td": 0.12}), u, 0.05, "zoh")
>>> round(fit(IOData.from_arrays(u, y, 0.05, hold="zoh"), "P1D").identified.theta["Tp1"], 4)
0.75

>>> data = IOData.from_arrays(u, y + np.random.default_rng(0).normal(0, 0.2, len(y)), 0.05, hold="zoh")
>>> found = fit(data, "P1D")
>>> profile(found, "Tp1")[0].covers(0.75), validate(found).dynamics_missing
(True, False)
>>> fresh = IOData.from_arrays(u, y + np.random.default_rng(1).normal(0, 0.2, len(y)), 0.05, hold="zoh")
>>> confirm(found, fresh).dynamics_missing, round(held_out_score(found, fresh)[1], 1)
(False, 99.2)
>>> {name: round(t.value, 2) for name, t in percent_times(found.identified).items()}
{'t50': 0.64, 't63.2': 0.87, 't90': 1.85}
>>> [round(-1 / root.value.real, 2) for root in roots_of(found.identified)]
[0.75]
>>> step_band(found.identified, np.array([0.0, 10.0])).value.round(2)
array([0., 1.])
>>> bode_band(found.identified, np.array([0.01])).magnitude_dB.value.round(2)
array([-0.01])
>>> joint_table({"y": compare(data, "P1", "P1D")})["model"].tolist()
['P1D']
>>> import control
>>> known = from_control(control.tf([1.0], [0.75, 1.0]), delay_s=0.12)
>>> compare(data, known, "P1").recommended
'TF(0,1)D as given'
>>> chain_model("P2").names, chain_model("P2").known == Known()
(('Kp', 'Tp1', 'Tp2'), True)
"""

from tcdyn.chain.rational import simulate
from tcdyn.identify.comparison import CANDIDATES, Comparison, compare, joint_table
from tcdyn.identify.fit import fit
from tcdyn.identify.frequency import Response, fit_response
from tcdyn.identify.heldout import held_out_score
from tcdyn.identify.identified import Identified, from_control, read_identified
from tcdyn.identify.intervals import profile
from tcdyn.identify.iodata import IOData, Run
from tcdyn.identify.models import Known, Model, chain_model, process, several, transfer
from tcdyn.identify.responses import bode_band, percent_times, roots_of, step_band
from tcdyn.identify.search import Fit
from tcdyn.identify.tables import from_csv, from_frame
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
