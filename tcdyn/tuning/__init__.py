"""Settings of PI and PID controllers from identified models, with the uncertainty of the model.

>>> from tcdyn.chain import Chain
>>> tuning = tune_plant(Plant(Chain([8.0], delay_s=1.0).rational), TuneOptions(rule="robust"))
>>> round(tuning.margins["ms"].value, 2)
1.4
"""

from tcdyn.tuning.forms import Controller, Form
from tcdyn.tuning.options import TuneOptions
from tcdyn.tuning.plant import Plant
from tcdyn.tuning.result import Spread, Tuning
from tcdyn.tuning.tune import tune_plant

__all__ = ["Controller", "Form", "Plant", "Spread", "TuneOptions", "Tuning", "tune_plant"]
