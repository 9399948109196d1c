"""What nobody measured in a test: how well it is known, and what it does to the readings that the rim predicts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import signal

from calibration import Array
from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW
from tcdyn.chain import discretised
from tcdyn.conduction.rim import lag_bank
from tcdyn.partition.prepare import EhlTest
from tcdyn.partition.window import GRADIENT_STEP_M, OUTER, DiskWindow, Perturbation
from tcdyn.traces import DiskTraces

MATERIAL_STEP = 0.01
MATERIALS = ("conductivity", "heat_capacity", "washer", "half_width")
NAMES = {"heat_capacity": "heat capacity", "half_width": "half-width"}
SMOOTH_RATE_S = 0.5
SPLIT_SD_S = 0.03  # a plunge hardly tells how a channel's lag is split in two
MODEL_K = 0.03  # what rim and mesh leave unexplained at a junction, against whole-disk solutions


@dataclass(frozen=True)
class Unmeasured:
    """Something not measured: ``source`` is its line of the budget; ``shared``: both disks have it in common."""

    name: str
    source: str
    shared: bool = False

    def of(self, disk: str) -> tuple[str, str]:
        """Whose it is, both disks' or one's, and its name."""
        return "both" if self.shared else disk, self.name


@dataclass(frozen=True)
class Effects:
    """``change`` (Q, R, P): what the readings show more than predicted by one standard uncertainty of each [K]."""

    of: tuple[Unmeasured, ...]
    change: Array


@dataclass(frozen=True)
class FitShift:
    """Error of fitted numbers by one standard uncertainty of what nobody measured, and their noise.

    ``per_sd`` (Q, k): how far the fit is off when the true disk departs by one standard uncertainty from the stated
    one, in the units of the fitted numbers: (intercept, slope) of a steady line, (share, h [W/m2K]) of a cooling fit,
    (share, h, lag [s]) of a joint fit; ``noise`` (k, k) covariance.
    """

    of: tuple[Unmeasured, ...]
    per_sd: Array
    noise: Array


Row = tuple[Unmeasured, float, Array]


@dataclass(frozen=True)
class Prediction(ABC):
    """What R windows of a, c, e (and more) should show about one share and h [W/m2K], and what they show if it is off.

    ``rest`` and ``power`` (R, P): without frictional heat, and per share of one; ``lasting`` (5, 3): answer of the
    outer row to a lasting unit of power, d, b, f, ambient.
    """

    share: float
    h_W_m2K: float
    rest: Array
    power: Array
    lasting: Array
    depth_step_m: float

    @property
    def base(self) -> Array:
        """The predicted readings, (R, P) [degC]."""
        return self.rest + self.share * self.power

    @property
    @abstractmethod
    def lasts(self) -> Array | float:
        """How much of a lasting error the windows show, (R,)."""

    @abstractmethod
    def answer(self, p: Perturbation) -> tuple[Array, Array]:
        """``rest`` and ``power`` of a disk that departs from its statement by ``p``."""

    @abstractmethod
    def through(self, i: int, error: Array | float) -> Array:
        """Answer (R, 3) of the outer row to an ``error`` of input ``i`` of power, d, b, f, ambient."""

    @abstractmethod
    def rate(self, channel: str) -> Array:
        """How fast ``channel`` rises [K/s]."""

    @property
    @abstractmethod
    def gradient(self) -> Array:
        """Rise of temperature with radius at d, b, f, (.., 3) [K/m]."""

    def moved(self, p: Perturbation) -> Array:
        """What is shown more if the disk departs from its statement by ``p``."""
        rest, power = self.answer(p)
        return np.asarray(rest + self.share * power - self.base)

    def reading(self, name: str, error: Array | float) -> Array:
        """What is shown more than predicted if channel ``name``, or the ambient, reads ``error`` [K] too high."""
        out = np.zeros_like(self.base)
        if name in OUTER_ROW:
            out[:, OUTER_ROW.index(name)] = error
        else:
            out[:, :3] = -self.through(1 + (*INNER_ROW, "ambient").index(name), error)
        return out

    def deeper(self, channel: str) -> Array:
        """What is shown more per metre by which ``channel`` lies deeper than stated.

        A junction of the inner row reads too low for the model's inner radius by the gradient times its error.
        """
        if channel in INNER_ROW:
            return -self.reading(channel, self.gradient[:, INNER_ROW.index(channel)])
        return self.moved(Perturbation(depth_m=depths(OUTER_ROW, channel, self.depth_step_m))) / self.depth_step_m


def depths(row: tuple[str, ...], channel: str, deeper_m: float) -> tuple[float, float, float]:
    """Departures of a row's three depths when ``channel`` alone lies deeper.

    >>> depths(("a", "c", "e"), "c", 1e-4)
    (0.0, 0.0001, 0.0)
    """
    one, two, three = (deeper_m if c == channel else 0.0 for c in row)
    return one, two, three


def stated(at: Prediction, disk: DiskTraces, static_u_K: Array, lag_u_s: Array) -> Iterator[Row]:
    """What every disk states: static lines, depths and differential lags of six channels, steel, washer, half-width of
    the contact and ambient, each to ``disk.uncertainty`` and to the given ones (6,)."""
    u = disk.uncertainty
    for c, static, lag in zip(CHANNELS, static_u_K, lag_u_s):
        yield Unmeasured(f"static {c}", "static lines"), float(static), at.reading(c, at.lasts)
        yield Unmeasured(f"depth {c}", "junction depth"), u.depth_mm * 1e-3, at.deeper(c)
        yield Unmeasured(f"lag {c}", "chain"), float(lag), at.reading(c, -at.rate(c))
    for key in MATERIALS:
        step: dict[str, Any] = {key: MATERIAL_STEP}
        change = at.moved(Perturbation(**step)) / MATERIAL_STEP
        name = NAMES.get(key, key)
        yield Unmeasured(name, name, True), float(getattr(u, f"{key}_rel")), change
    yield Unmeasured("ambient", "ambient", True), u.ambient_K, -at.reading("ambient", at.lasts)


def gathered(rows: Iterable[Row]) -> Effects:
    """The rows of an uncertainty above zero."""
    told = [(what, sd * change) for what, sd, change in rows if sd > 0]
    return Effects(tuple(what for what, _ in told), np.stack([change for _, change in told]))


@dataclass(frozen=True)
class WindowPrediction(Prediction):
    """The outer row over a stretch of a test, (R, 3)."""

    window: DiskWindow
    dt_s: float
    lasts = 1.0

    def answer(self, p: Perturbation) -> tuple[Array, Array]:
        """See ``Prediction``."""
        return self.window.rim.answer(self.h_W_m2K, p)

    def through(self, i: int, error: Array | float) -> Array:
        """See ``Prediction``; an ``error`` (N,) of the samples goes through the filters of the rim."""
        if isinstance(error, float):
            return np.broadcast_to(error * self.lasting[i], self.base.shape)
        g, mean, rates = self.window.rim.gains(self.h_W_m2K), self.window.blocks.mean, self.window.rim.rates_1_s
        bank = mean(lag_bank(error, self.dt_s, rates))
        return np.asarray(mean(error)[:, None] * g.direct[i] + bank @ g.gains[i].T)

    @cached_property
    def gradient(self) -> Array:
        """See ``Prediction``; (N, 3), from the model itself, worked out on block means and held between them."""
        rest, power = self.window.rim.rise(self.h_W_m2K)
        columns = (rest + self.share * power).T
        return np.column_stack([self._sampled(r) for r in columns]) / GRADIENT_STEP_M

    @cached_property
    def _rates(self) -> Array:
        return np.asarray(np.gradient(self.base, self.window.blocks.time_s, axis=0))

    def rate(self, channel: str) -> Array:
        """See ``Prediction``; of the model (R,) for the outer row, of the smoothed reading (N,) for the inner."""
        if channel in OUTER_ROW:
            return self._rates[:, OUTER_ROW.index(channel)]
        width = max(int(round(SMOOTH_RATE_S / self.dt_s)), 1)
        padded = np.pad(self.window.readings[:, CHANNELS.index(channel)], width, mode="edge")
        smooth = np.convolve(padded, np.ones(width) / width, mode="same")[width:-width]
        return np.asarray(np.gradient(smooth, self.dt_s))

    def other_split(self, channel: str, disk: DiskTraces) -> Array:
        """Change of an outer reading per second moved from its first lag to its second, their sum kept.

        (1 + tau1 s)(1 + tau2 s) grows by delta (tau1 - tau2) s^2, so the reading loses
        delta (tau1 - tau2) s^2 / ((1 + tau1 s)(1 + tau2 s)) of itself.
        """
        taus = sorted(disk.mean_chain.taus_s, reverse=True)
        tau1, tau2 = max(taus[0], 5e-3), max(taus[1] if len(taus) > 1 else 0.0, 2 * self.dt_s)
        whole = self._sampled(self.base[:, OUTER_ROW.index(channel)])
        b, a = discretised([tau1 - tau2, 0.0, 0.0], np.polymul([tau1, 1.0], [tau2, 1.0]), self.dt_s)
        lost = signal.lfilter(b, a, whole, zi=signal.lfilter_zi(b, a) * whole[0])[0]
        return self.reading(channel, -self.window.blocks.mean(np.asarray(lost)))

    def _sampled(self, of_blocks: Array) -> Array:
        return np.interp(self.window.time_s, self.window.blocks.time_s, of_blocks)


def prediction(test: EhlTest, window: DiskWindow, share: float, h_W_m2K: float) -> WindowPrediction:
    """The outer row of ``window`` about a point of the plane."""
    lasting = window.rim.gains(h_W_m2K).static
    return WindowPrediction(share, h_W_m2K, *window.rim.answer(h_W_m2K), lasting, 0.05e-3, window, test.dt_s)


def effects(test: EhlTest, disk: DiskTraces, window: DiskWindow, share: float, h_W_m2K: float) -> Effects:
    """All that nobody measured, about the point (share, h), as the fits of one disk see it.

    To what ``stated`` holds come the friction, the instant of parting, and how each lag of the outer row is split.
    """
    at = prediction(test, window, share, h_W_m2K)
    static = disk.static_u_K.copy()
    static[OUTER] = np.hypot(static[OUTER], MODEL_K)
    late = -share * np.gradient(at.power, window.blocks.time_s, axis=0)
    return gathered(
        [
            *stated(at, disk, static, differential_lag_u_s(disk.lag_covariance_s2)),
            (Unmeasured("parting", "parting", True), test.events.unload_u_s, late),
            (Unmeasured("friction", "friction", True), disk.uncertainty.friction_rel, share * at.power),
            *((Unmeasured(f"split {c}", "chain"), SPLIT_SD_S, at.other_split(c, disk)) for c in OUTER_ROW),
        ]
    )


def differential_lag_u_s(covariance_s2: Array) -> Array:
    """Standard uncertainty of each channel's lag less the mean of all, from their covariance; (M, M) -> (M,)."""
    return np.sqrt(np.clip(np.diag(with_common_u(covariance_s2, 0.0)), 0.0, None))


def with_common_u(covariance_s2: Array, common_u_s: float) -> Array:
    """Covariance (M, M) of lags whose differences are known as ``covariance_s2`` says and their mean to ``common_u_s``.

    >>> with_common_u(np.full((2, 2), 0.25), 0.1).round(4)
    array([[0.01, 0.01],
           [0.01, 0.01]])
    """
    centre = np.eye(len(covariance_s2)) - 1.0 / len(covariance_s2)
    return np.asarray(centre @ covariance_s2 @ centre.T + common_u_s**2)
