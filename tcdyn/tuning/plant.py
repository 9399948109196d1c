"""The plant of a loop: a transfer function, draws from its distribution, names and units.

``tcdyn.identification`` makes it from an identified model. Tests:
``tests/tuning/test_tune_model.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

from tcdyn.chain.rational import Rational
from tcdyn.io.unit_names import TEMPERATURES, unit_in, written_unit

# Unit of a difference of two temperatures.
DIFFERENCE_UNITS = {"degC": "K", "K": "K", "degF": "degF"}


@dataclass(frozen=True)
class Plant:
    """What is controlled.

    Attributes
    ----------
    rational
        The transfer function.
    draws
        Transfer functions drawn from the distribution of its parameters; empty without one.
    model_name
        Name of the model structure.
    input_name, output_name
        What the controller sets, and what it reads.
    input_unit, output_unit
        Their units; where empty, those in the names.
    dt_s
        Sampling interval of the record [s]; 0 without a record.
    redrawn_share
        Share of draws that were impossible (a negative lag or dead time, or unstable without a
        controller), and so were drawn again.
    troubles
        Why the model is not to be relied on.
    is_rejected
        Whether its identification found no model good enough.
    has_sensor
        Whether the model contains the sensor of the output, so that its output is the reading.
    """

    rational: Rational
    draws: tuple[Rational, ...] = ()
    model_name: str = "plant"
    input_name: str = "u"
    output_name: str = "y"
    input_unit: str = ""
    output_unit: str = ""
    dt_s: float = 0.0
    redrawn_share: float = 0.0
    troubles: tuple[str, ...] = ()
    is_rejected: bool = False
    has_sensor: bool = True

    @property
    def unit_of_input(self) -> str:
        """Unit of the input; "input unit" where none is known.

        >>> from tcdyn.chain import Chain
        >>> Plant(Chain([1.0]).rational, input_name="heater_percent").unit_of_input
        '%'
        """
        text = self.input_unit or unit_in(self.input_name)
        return written_unit(text) or text or "input unit"

    @property
    def unit_of_output(self) -> str:
        """Unit of a difference of the output; "output unit" where none is known.

        >>> from tcdyn.chain import Chain
        >>> Plant(Chain([1.0]).rational, output_name="T1_degC").unit_of_output
        'K'
        """
        text = self.output_unit or unit_in(self.output_name)
        return DIFFERENCE_UNITS.get(text, written_unit(text) or text or "output unit")

    @property
    def is_temperature(self) -> bool:
        """Whether the output is a temperature."""
        return (self.output_unit or unit_in(self.output_name)) in TEMPERATURES
