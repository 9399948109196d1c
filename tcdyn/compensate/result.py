"""What a compensator returns: temperature, a standard deviation made of named parts, flags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from calibration import Array
from calibration.estimate import with_u
from calibration.finding import Finding, sentences
from calibration.result import Result, jsonable
from tcdyn.compensate.cells import Intensity


@dataclass(frozen=True)
class Compensated(Result):
    """A compensated record; all arrays (N, M), one column a channel.

    ``temperature`` [degC] at the junction at ``time_s``; ``sd`` [K] its standard deviation, from ``sd_noise`` (noise
    and regularisation), ``lag_sensitivity`` [K/s] times the uncertainty of each lag, and ``static_u`` [K].
    ``slope`` [K/s]; ``noise_sd (M,)`` [K]; ``intensity (M,)`` [K2/s3], the median over the record; ``flags``: bits
    MISSING, SPIKE, STUCK, SATURATED; ``method`` in words; ``events_s``: pairs of time and its standard uncertainty [s];
    ``intensities``: as functions of time, one a channel (smoother only).
    """

    temperature: Array
    sd: Array
    sd_noise: Array
    slope: Array
    lag_sensitivity: Array
    static_u: Array
    lag_covariance: Array
    noise_sd: Array
    intensity: Array
    flags: NDArray[np.uint8]
    time_s: Array
    method: str
    findings: tuple[Finding, ...] = ()
    events_s: tuple[tuple[float, float], ...] = ()
    intensities: tuple[Intensity, ...] = ()

    @classmethod
    def of(
        cls,
        temperature: Array,
        sd_noise: Array,
        slope: Array,
        lag_sensitivity: Array,
        lag_covariance: ArrayLike | None,
        static_u: ArrayLike | None,
        dt_s: float,
        **rest: Any,
    ) -> Compensated:
        """With the whole standard deviation, sd^2 = sd_noise^2 + (lag_sensitivity u(lag))^2 + static_u^2.

        ``lag_covariance`` (M, M) and ``static_u`` (a number, (M,) or (N, M)) are zero when left out; ``rest``: the
        fields that are left.
        """
        n, m = temperature.shape
        lags: Array = np.zeros((m, m)) if lag_covariance is None else np.asarray(lag_covariance, dtype=np.float64)
        line = np.broadcast_to(np.asarray(0.0 if static_u is None else static_u, dtype=np.float64), (n, m))
        total = np.asarray(np.sqrt(sd_noise**2 + lag_sensitivity**2 * np.diag(lags) + line**2), dtype=np.float64)
        time = np.asarray(np.arange(n) * dt_s, dtype=np.float64)
        return cls(temperature, total, sd_noise, slope, lag_sensitivity, line, lags, time_s=time, **rest)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was noticed, in words."""
        return sentences(self.findings)

    def common_sd(self) -> Array:
        """Part of ``sd`` (N, M) that comes from the lag common to all channels, hence moves them together [K]."""
        m = len(self.lag_covariance)
        mean_u = float(np.sqrt(max(np.sum(self.lag_covariance), 0.0))) / m
        return np.abs(self.lag_sensitivity) * mean_u

    def summary(self, names: Sequence[str] = ()) -> str:
        """A few lines for people; ``names`` of the channels, their numbers from 1 without."""
        return "\n".join([*self.lines(names), *self.warnings])

    def lines(self, names: Sequence[str] = ()) -> list[str]:
        """The summary without its warnings."""
        lines = [f"{self.method}: {self.temperature.shape[0]} samples, {self.temperature.shape[1]} channels"]
        for c in range(self.temperature.shape[1]):
            flagged = int(np.count_nonzero(self.flags[:, c]))
            lines.append(
                f"  channel {names[c] if names else c + 1}: noise {self.noise_sd[c]:.3g} K, "
                f"standard deviation {np.median(self.sd[:, c]):.3g} K typical, {np.max(self.sd[:, c]):.3g} K at most, "
                f"{flagged} samples flagged"
            )
        common = float(np.max(self.common_sd()))
        if common > 0:
            lines.append(f"  the lag common to all channels moves them together by up to {common:.2g} K (1 sd)")
        return [*lines, *(f"  slope free to jump at {with_u(t, u, 's')}" for t, u in self.events_s)]

    def to_dict(self) -> dict[str, Any]:
        """What the answer is worth, channel by channel; the samples are in the arrays."""
        return {
            "method": self.method,
            "samples": len(self.time_s),
            "channels": jsonable(self.card()),
            "common_sd_max_K": float(np.max(self.common_sd())),
            "events_s": [{"value": t, "u": u} for t, u in self.events_s],
            "warnings": list(self.warnings),
        }

    def card(self) -> pd.DataFrame:
        """Noise, typical and largest standard deviation and flagged samples of each channel."""
        return pd.DataFrame(
            {
                "channel": range(self.temperature.shape[1]),
                "noise_sd_K": self.noise_sd,
                "sd_median_K": np.median(self.sd, axis=0),
                "sd_max_K": np.max(self.sd, axis=0),
                "flagged": np.count_nonzero(self.flags, axis=0),
            }
        )
