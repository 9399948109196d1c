"""Options for a known filter behind the sensor, for ``identify`` and the commands of ``sensor``."""

from __future__ import annotations

from dataclasses import dataclass

from tcdyn.chain.chain import NO_CONDITIONING
from tcdyn.core.errors import InputError
from tcdyn.core.options import Options, option
from tcdyn.rig.disk import FILTER_SHAPES, Conditioning, FilterShape

MAX_POLES = 6  # as in the rig file
DEFAULT_POLES = 2


@dataclass(frozen=True)
class FilterOptions(Options):
    """A known low-pass filter behind the sensor.

    Attributes
    ----------
    cutoff_Hz
        cutoff of a known low-pass filter behind the sensor [Hz]; it is not part of the lags
        (default: no filter)
    poles
        poles of that filter (default: 2)
    shape
        shape of that filter: cascade (of first-order lags, the default) or butterworth
    """

    cutoff_Hz: float | None = option(None, "Advanced", low=1e-6, high=1e9)
    poles: int | None = option(None, "Advanced", low=1, high=MAX_POLES)
    shape: str | None = option(None, "Advanced", choices=FILTER_SHAPES)

    @property
    def conditioning(self) -> Conditioning:
        """The filter; ``NO_CONDITIONING`` without one.

        Raises
        ------
        InputError
            For poles or a shape without a cutoff.
        """
        if self.cutoff_Hz is not None:
            shape: FilterShape = self.shape or "cascade"  # type: ignore[assignment]
            return Conditioning(self.cutoff_Hz, self.poles or DEFAULT_POLES, shape)
        for name in ("poles", "shape"):
            if getattr(self, name) is not None:
                raise InputError(
                    f"{{{name}}} is given without {{cutoff_Hz}}",
                    remedy="give both, or none",
                    parameters={name: None, "cutoff_Hz": None},
                )
        return NO_CONDITIONING
