"""Options of the settings of a controller, for the command and the functions.

See :mod:`tcdyn.core.options`. Tests: ``tests/tuning/test_tune_command.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option

DEFAULT_MAX_MS = 1.4


@dataclass(frozen=True)
class TuneOptions(Options):
    """Which rule, which controller, and how fast.

    Attributes
    ----------
    rule
        simc (Skogestad 2003: the closed loop gets a time constant), or robust (the largest integral
        gain for which the largest sensitivity stays below {max_ms})
    controller
        pi or pid
    tau_c_s
        time constant of the closed loop [s], for the rule simc (default: the effective dead time,
        at least the sampling interval of the record)
    max_ms
        limit of the largest sensitivity, for the rule robust (default: 1.4; usual values are 1.2 to
        2)
    derivative_filter
        derivative time of the series form over the time constant of its filter
    setpoint_weight
        weight of the set point in the proportional part, 0 to 1; less than 1 reduces the overshoot
        after a step of the set point, and changes no margin
    sample_s
        sampling interval of the controller [s]; prints the difference equation (default:
        continuous)
    """

    rule: str = option("simc", "Model", choices=("simc", "robust"))
    controller: str = option("pi", "Model", choices=("pi", "pid"))
    tau_c_s: float | None = option(None, "Model", low=0, high=1e9, ends=False)
    max_ms: float | None = option(None, "Model", low=1, high=10, ends=False)
    derivative_filter: float = option(10.0, "Advanced", low=1, high=1e3)
    setpoint_weight: float = option(1.0, "Advanced", low=0, high=1)
    sample_s: float | None = option(None, "Model", low=0, high=1e9, ends=False)

    def __post_init__(self) -> None:
        """Check every field, and that the options belong to the rule.

        Raises
        ------
        InputError
            For a value beyond the limits, and an option of the other rule.
        """
        super().__post_init__()
        other = "max_ms" if self.rule == "simc" else "tau_c_s"
        if getattr(self, other) is not None:
            rule = "robust" if self.rule == "simc" else "simc"
            raise InputError(
                f"{{{other}}} belongs to the rule {rule}, and the rule is {self.rule}",
                remedy="give {rule}, or leave it out",
                parameters={other: None, "rule": rule},
            )
