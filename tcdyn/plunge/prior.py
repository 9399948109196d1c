"""What is assumed of a plunge before its data are seen: every prior with its width, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.rig import UncertaintyTable


@dataclass(frozen=True)
class PlungePriors:
    """Medians and standard deviations of the nuisance parameters; a lag has a flat prior above zero.

    Logarithmic widths are of ln(parameter). ``burst``: h is multiplied by 1 + A exp(-(t/tau)^p) after entry.
    """

    h_scale_log: float = 0.10  # per run, about 1
    h_exponent: float = 0.02  # per run: extra power of the temperature difference in h, about 0
    burst_median: float = 1.5
    burst_log: float = 0.7
    burst_time_median_s: float = 1.2
    burst_time_log: float = 0.5
    burst_shape_log: float = 0.3  # p, about 1
    entry_scale: float = 1.0  # times the entry event's own u
    initial_K: float = 5.0  # of the disk's temperature before entry, about the readings' mean
    bath_K: float = 0.5  # offset of the bath thermometer
    conductivity_log: float = 0.03
    depth_m: float = 1e-4
    static_offset_K: float = 0.05  # per channel, left over from the static line
    static_gain: float = 5e-4  # per channel, likewise
    shape_logit: float = 0.0  # logit of 4 tau1 tau2 / lag^2: centre
    shape_logit_common: float = 1.5
    shape_logit_channel: float = 0.7

    @classmethod
    def for_rig(cls, table: UncertaintyTable) -> PlungePriors:
        """The defaults, with steel and depths as uncertain as the rig file's [uncertainty] says.

        A plunge sees K and rho c only together: what the fit frees as the conductivity carries both.
        """
        steel = float(np.hypot(table.conductivity_rel, table.heat_capacity_rel))
        return cls(conductivity_log=max(steel, 1e-6), depth_m=max(table.depth_mm * 1e-3, 1e-9))

    def describe(self) -> list[tuple[str, str]]:
        """Each prior as (parameter, sentence), for tables."""
        return [
            ("h scale, per run", f"lognormal about 1, sd {100 * self.h_scale_log:.0f} %"),
            ("extra exponent of h, per run", f"normal about 0, sd {self.h_exponent:g}"),
            ("burst size A, per run", f"lognormal about {self.burst_median:g}, sd of ln {self.burst_log:g}"),
            (
                "burst time, per run",
                f"lognormal about {self.burst_time_median_s:g} s, sd of ln {self.burst_time_log:g}",
            ),
            ("burst shape, per run", f"lognormal about 1 (exponential), sd of ln {self.burst_shape_log:g}"),
            ("entry time, per run", f"normal about the event, sd {self.entry_scale:g} times its u"),
            ("initial temperature, per run", f"normal about the readings, sd {self.initial_K:g} K"),
            ("bath offset, per run", f"normal about 0, sd {self.bath_K:g} K"),
            (
                "conductivity over heat capacity",
                f"lognormal about the rig file's, sd {100 * self.conductivity_log:.1f} %",
            ),
            ("junction depth, per channel", f"normal about the rig file's, sd {1e3 * self.depth_m:.2f} mm"),
            ("static offset, per channel", f"normal about 0, sd {self.static_offset_K:g} K"),
            ("static gain, per channel", f"normal about 1, sd {self.static_gain:g}"),
            (
                "split of the lag over two stages",
                f"logit of 4 tau1 tau2 / (tau1 + tau2)^2: normal about {self.shape_logit:g}, sd "
                f"{self.shape_logit_common:g} in common and {self.shape_logit_channel:g} per channel",
            ),
            ("lag, per channel", "flat above zero"),
        ]
