"""What loading or unloading in an EHL test will tell of the lags: the friction's step is known, its answer lags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.disk import CHANNELS, INNER_ROW, OUTER_ROW, DiskSetup
from immersion.cylinder import Cylinder
from immersion.radial import simulate_plunge_model
from tcdyn.chain import Chain
from tcdyn.conduction.bank import Switch, lag_bank, node_rates
from tcdyn.conduction.modal import rim_gains
from tcdyn.conduction.rim import Mesh, Rim, points_of
from tcdyn.design.prediction import Prediction, from_covariances, information
from tcdyn.plunge.parameters import stages

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StepPlan:
    """One planned step of load: heat into this disk [W], window after the step, u of its instant, and so on."""

    kind: Literal["unloading", "loading"] = "unloading"
    power_W: float = 100.0
    h_W_m2K: float = 700.0
    half_width_m: float = 1.0e-3
    window_s: float = 5.0
    rate_Hz: float = 75.0
    noise_K: float = 0.12
    instant_u_s: float = 0.01
    power_log_u: float = 1.0  # heat partition: all but unknown
    h_log_u: float = 0.3
    offset_K: float = 0.3  # of each outer channel against the boundary row
    conductivity_log_u: float = 0.03
    depth_u_m: float = 1e-4
    alike_s: float = 0.05  # prior sd of a channel's lag about the common one


def predict_step(plan: StepPlan, setup: DiskSetup, *, lag_s: float = 0.65, logit: float = 0.0) -> Prediction:
    """Expected uncertainty of the lags from one step of load, by Fisher information of the rim model.

    In the commuted form the inner row's lagged readings drive the rim, so a lag common to all channels acts on the
    friction's share alone, whose instant the contact switch tells. Free: lags, their split, power into the disk, h,
    conductivity, outer depths, offsets, and the step's instant. Before the step the disk is steady at ``power_W`` (or
    cold); its inner row follows by radial conduction.
    """
    signals = _Signals(plan, setup, lag_s, logit)
    jac, noise = signals.jacobian(), plan.noise_K
    outer = len(OUTER_ROW)
    shared = jac.shape[1]
    prior = np.concatenate(
        [
            np.full(6, np.inf),
            [1.5, plan.power_log_u, plan.h_log_u, plan.conductivity_log_u, plan.instant_u_s],
            np.full(outer, plan.depth_u_m),
            np.full(outer, plan.offset_K),
        ]
    )
    alike = (np.eye(6) - 1 / 6) / plan.alike_s  # rows added to the data: channels of one disk are much alike
    extra = np.zeros((6, shared))
    extra[:, :6] = alike * noise
    covariance = information([np.vstack([jac, extra])], noise, 0, shared, np.zeros(0), prior)
    others = {"u_power_rel": float(np.sqrt(covariance[7, 7])), "u_h_rel": float(np.sqrt(covariance[8, 8]))}
    label = f"{plan.kind}, {plan.power_W:g} W, {plan.window_s:g} s"
    return from_covariances(label, plan.kind, [covariance[:6, :6]], others)


class _Signals:
    """Traces of the outer row for given parameters, and their derivatives."""

    def __init__(self, plan: StepPlan, setup: DiskSetup, lag_s: float, logit: float) -> None:
        self.plan, self.setup, self.lag_s, self.logit = plan, setup, lag_s, logit
        self.dt = 1 / plan.rate_Hz
        self.before = int(round(2.0 * plan.rate_Hz))
        self.t = (np.arange(self.before + int(plan.window_s * plan.rate_Hz)) - self.before) * self.dt
        self.inner = self._inner()
        rates = node_rates(self.dt)
        first, last = (1.0, 0.0) if plan.kind == "unloading" else (0.0, 1.0)
        step = np.where(self.t < 0, first, last)
        switch = (Switch(self.before - 1, 1.0, first, last),)
        self.inputs = np.column_stack([step, self.inner, np.zeros(len(step))])
        self.banks = [lag_bank(step, self.dt, rates, hold="zoh", switches=switch)]
        self.banks += [lag_bank(self.inputs[:, i], self.dt, rates) for i in (1, 2, 3, 4)]
        self.rates = rates

    def _inner(self) -> Array:
        """Inner row d, b, f (N, 3) about the surroundings: steady then cooling, or cold then warming [K]."""
        p, s = self.plan, self.setup
        flux = p.power_W / (2 * np.pi * s.outer_radius_m * s.width_m)
        depths = [s.junctions[c].depth_m for c in INNER_ROW]
        rise = simulate_plunge_model(
            Cylinder.from_setup(s),
            depths,
            lambda T, F, t: np.full_like(T, p.h_W_m2K),
            0.0,
            flux / p.h_W_m2K,
            p.window_s,
        ).at(self.t, 0.0)
        return flux / p.h_W_m2K - rise if p.kind == "unloading" else rise

    def parts(self, ln_h: float, ln_k: float, shift_m: Array) -> tuple[Array, Array]:
        """True outer traces (N, 3): the share of the power, and that of the boundary row (3, N, 3)."""
        s, p = self.setup, self.plan
        rim = Rim.from_setup(s, conductivity_W_mK=s.conductivity_W_mK * float(np.exp(ln_k)))
        points = [(d + float(m), z) for (d, z), m in zip(points_of(s, "".join(OUTER_ROW)), shift_m)]
        g = rim_gains(rim, p.h_W_m2K * float(np.exp(ln_h)), points, p.half_width_m, self.rates, mesh=Mesh(33, 53))
        each = [self.banks[i] @ g.gains[i].T + self.inputs[:, i : i + 1] * g.direct[i] for i in range(4)]
        return p.power_W * each[0], np.array(each[1:])

    def chained(self, x: Array, lag_s: float, logit: float) -> Array:
        taus, delay, _ = stages("P2", lag_s, logit)
        return Chain(taus, delay_s=delay, conditioning=self.setup.conditioning).response(x, self.dt)

    def jacobian(self) -> Array:
        """Readings of a, c, e stacked (3 N, P) by lags a..f, split, ln power, ln h, ln K, instant, depths, offsets."""
        n, zero = len(self.t), np.zeros(3)
        power, row = self.parts(0.0, 0.0, zero)
        total = power + row.sum(axis=0)
        columns: list[Array] = []
        step = 1e-3
        by_lag = (
            self.chained(total, self.lag_s + step, self.logit) - self.chained(total, self.lag_s - step, self.logit)
        ) / (2 * step)
        for channel in CHANNELS:
            block = np.zeros((n, 3))
            if channel in OUTER_ROW:
                k = OUTER_ROW.index(channel)
                block[:, k] = by_lag[:, k]
            else:  # its reading, taken for less lagged than it is, enters the rim late
                block = np.gradient(
                    self.chained(row[INNER_ROW.index(channel)], self.lag_s, self.logit), self.dt, axis=0
                )
            columns.append(block)
        # a split common to all channels acts on the power's share alone, as a common lag does
        columns.append(
            (self.chained(power, self.lag_s, self.logit + step) - self.chained(power, self.lag_s, self.logit - step))
            / (2 * step)
        )
        columns.append(self.chained(power, self.lag_s, self.logit))

        def total_at(ln_h: float, ln_k: float, shift: Array) -> Array:
            a, b = self.parts(ln_h, ln_k, shift)
            return self.chained(a + b.sum(axis=0), self.lag_s, self.logit)

        for ln_h, ln_k in ((0.02, 0.0), (0.0, 0.02)):
            columns.append((total_at(ln_h, ln_k, zero) - total_at(-ln_h, -ln_k, zero)) / 0.04)
        columns.append(-np.gradient(self.chained(power, self.lag_s, self.logit), self.dt, axis=0))
        deeper = (total_at(0.0, 0.0, np.full(3, 2e-5)) - total_at(0.0, 0.0, np.full(3, -2e-5))) / 4e-5
        for k in range(3):
            only = np.zeros((n, 3))
            only[:, k] = deeper[:, k]
            columns.append(only)
        for k in range(3):
            only = np.zeros((n, 3))
            only[:, k] = 1.0
            columns.append(only)
        return np.column_stack([c.T.ravel() for c in columns])
