"""Several dips of one sensor: coverage of lag, percent times, exponent and inner share.

`python -m tests.sensors.dips_study dips [SETS] [SEED]` prints for 2 to 8 dips how often lag and t90
of one further dip, and of the mean of many dips, are inside their 95 % intervals; the rms of
departure over u; and how often a dip is reported to depart from the others, where none does and
where the first has times that are 30 % longer. The dips are drawn as numbers by code of its own:
the scale of a dip is log-normal with a standard deviation of 5 %. The errors of the four times of a
dip are correlated, and their size differs between dips.

`python -m tests.sensors.dips_study flows [SENSORS] [SEED]` prints the same for the lag at the flow
of the result, exponent, inner share, and the lag at other flows by the law of the file: inside the
range, and a factor of two beyond its slower and its faster end. One dip at each of two or three
flows, and three at each of two, of layered sensors by finite volumes
(``tests.sensors.layered_world``), with a spread of 3 %. Errors of lags and of the inner part are
over the lag. The true exponent is that of the film coefficient between the lowest and the highest
flow, and the true inner part is the lag for a film coefficient without limit.

`python -m tests.sensors.dips_study contradiction [SETS] [SEED]` prints how often dips that follow
the law are reported to contradict it, and dips whose lag rises with the flow.

`python -m tests.sensors.dips_study grid` prints what half of the points of the grids of exponent
and inner share change.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tcdyn.chain import Chain
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.sensors import SensorFile, dip_flows, sensor_file
from tcdyn.sensors.dip_flows import DipFlows, flow_effects
from tcdyn.sensors.dips import pool_dips
from tcdyn.sensors.file import SHARES
from tcdyn.sensors.plunge import plunge_sensor
from tcdyn.sensors.random_effects import with_one_spread
from tests.sensors.layered_world import MEDIA, layered, plunge_record, surface_h

SPREAD = 0.05
# Lag, t50, t63.2 and t90 of the sensor [s], and standard deviation of their errors over that of the
# lag: the crossings in the rise are better determined than the first moment
TRUE_S = np.array([1.0, 0.72, 1.0, 2.2])
ERROR_RATIOS = np.array([1.0, 0.6, 0.4, 0.7])
CORRELATION = 0.9  # of the errors within a dip
FLOW_SPREAD = 0.03
DIPS_OF_FLOWS = ((2, 1), (3, 1), (2, 3))  # number of flows, and of dips at each
OUTLIER = 1.3


@dataclass(frozen=True)
class DrawnDips:
    """Estimates of lag, t50, t63.2 and t90 of each dip, and their true values of a further dip."""

    quantities: list[list[Estimate]]
    further_s: Array


def drawn_dips(rng: np.random.Generator, count: int, spread: float = SPREAD) -> DrawnDips:
    """Dips of a sensor with the times ``TRUE_S``; the noise of each dip is drawn.

    The relative standard uncertainty of its lag is 0.5 to 8 %.
    """
    scale = np.exp(spread * rng.standard_normal(count + 1))
    lag_u = np.exp(rng.uniform(np.log(0.005), np.log(0.08), count))
    relative_u = lag_u[:, None] * ERROR_RATIOS
    common = rng.standard_normal((count, 1))
    own = rng.standard_normal((count, 4))
    error = np.sqrt(CORRELATION) * common + np.sqrt(1 - CORRELATION) * own
    values = TRUE_S * scale[:-1, None] * np.exp(relative_u * error)
    quantities = [
        [Estimate.normal(y, y * u) for y, u in zip(values[:, q], relative_u[:, q])]
        for q in range(4)
    ]
    return DrawnDips(quantities, TRUE_S * scale[-1])


def as_file(times: Sequence[Estimate]) -> SensorFile:
    """The file of one dip with this lag, t50, t63.2 and t90."""
    lag = times[0]
    return sensor_file(
        "s",
        {"T": Chain([0.9 * lag.value, 0.1 * lag.value])},
        "plunge",
        np.array([[lag.u**2]]),
        [0.1 * lag.u],
        times={"T": dict(zip(SHARES, times[1:]))},
        fit={"lag_s": lag.model_dump(), "step_K": 50.0},
    )


def coverage_of_dips(sets: int, seed: int, count: int, spread: float = SPREAD) -> Array:
    """Whether the 95 % intervals hold the truth (4, sets).

    Those of lag and t90 of one further dip, then of lag and t90 of the mean of many dips.
    """
    rng = np.random.default_rng([seed, count])
    rows = []
    for _ in range(sets):
        drawn = drawn_dips(rng, count, spread)
        pooled = with_one_spread(drawn.quantities, [0.0] * 4)
        further = [pooled[q].next_estimate() for q in (0, 3)]
        mean = [pooled[q].mean_estimate() for q in (0, 3)]
        truths = [*drawn.further_s[[0, 3]], *TRUE_S[[0, 3]]]
        rows.append([e.contains(truth) for e, truth in zip([*further, *mean], truths)])
    return np.array(rows).T


def departures(sets: int, seed: int, count: int, factor: float = 1.0) -> float:
    """Share of sets in which a dip is reported, the times of the first multiplied by a factor."""
    rng = np.random.default_rng([seed, count, 1])
    reported = 0
    for _ in range(sets):
        drawn = drawn_dips(rng, count)
        dips = [list(each) for each in zip(*drawn.quantities)]
        dips[0] = [time.scaled(factor) for time in dips[0]]
        pooled = pool_dips([as_file(times) for times in dips])
        reported += "sensor.dip_departs" in [finding.code for finding in pooled.findings]
    return reported / sets


def report_dips(sets: int = 400, seed: int = 1) -> None:
    """Print the table of dips at one flow."""
    for count in range(2, 9):
        held = 100 * coverage_of_dips(sets, seed, count).mean(axis=1)
        line = (
            f"{count} dips: further dip: lag {held[0]:.1f} %, t90 {held[1]:.1f} %; mean: lag "
            f"{held[2]:.1f} %, t90 {held[3]:.1f} %"
        )
        if count > 2:
            none = 100 * departures(sets // 2, seed, count)
            one = 100 * departures(sets // 2, seed, count, OUTLIER)
            line += f"; reported: none departs {none:.1f} %, one departs {one:.1f} %"
        print(line, flush=True)


@dataclass(frozen=True)
class FlowTruth:
    """A layered sensor in a medium at any speed."""

    medium: str
    shape: tuple[float, float, float, float]
    gap_m: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> FlowTruth:
        """Sensor of 1 to 6 mm in water, oil or air."""
        diameter_m = float(np.exp(rng.uniform(np.log(1e-3), np.log(6e-3))))
        gap_m = float(min(rng.uniform(10e-6, 60e-6), diameter_m / 40)) if rng.random() < 0.5 else 0
        shape = (
            diameter_m,
            rng.uniform(0.15, 0.35),
            rng.uniform(0.10, 0.16),
            rng.uniform(1.5, 5.0),
        )
        return cls(str(rng.choice(["water", "oil", "air"])), shape, gap_m)

    def h(self, speed: float) -> float:
        """Film coefficient [W/m2K]."""
        return surface_h(self.medium, self.shape[0], speed)

    def lag_s(self, speed: float) -> float:
        """True lag [s]."""
        return layered(*self.shape, self.h(speed), self.gap_m).lag_s

    def inner_s(self) -> float:
        """True lag without a film [s]."""
        return layered(*self.shape, 1e9, self.gap_m).lag_s

    def dip(self, speed: float, factor: float, rng: np.random.Generator) -> SensorFile:
        """Result of a dip at this speed, of a sensor all of whose times have a factor."""
        sensor = layered(*self.shape, self.h(speed), self.gap_m)
        scaled = type(sensor)(factor * sensor.taus_s, sensor.shares, sensor.heated)
        record = plunge_record(scaled, rng, entry_known=rng.random() < 0.5)
        return plunge_sensor(record.time_s, record.y_degC, "T", entry_s=record.entry_s)


def judge_flows(
    index: int, seed: int, n_flows: int, each: int
) -> list[tuple[float, float, float, float]] | None:
    """Value, truth, u and unit of each result of a sensor, from some dips at each flow.

    Lag at the flow of the result, exponent, inner share, inner part; lag by the law of the file at
    a flow inside, at half of the lowest and at twice the highest flow.
    """
    rng = np.random.default_rng([seed, n_flows, each, index])
    sensor = FlowTruth.drawn(rng)
    low, high = MEDIA[sensor.medium][3:]
    ratio = np.exp(rng.uniform(np.log(3), np.log(10)))
    lowest = np.exp(rng.uniform(np.log(2 * low), np.log(high / (2 * ratio))))
    speeds = np.repeat(lowest * ratio ** np.linspace(0, 1, n_flows), each)
    scale = np.exp(FLOW_SPREAD * rng.standard_normal(len(speeds)))
    try:
        dips = [sensor.dip(v, f, rng) for v, f in zip(speeds, scale)]
        flows = DipFlows("v", tuple(speeds.tolist()))
        pooled = pool_dips(dips, flows=flows)
    except InputError:
        return None
    at = flows.at
    exponent = np.log(sensor.h(speeds[-1]) / sensor.h(speeds[0])) / np.log(ratio)
    lag_s = sensor.lag_s(at)
    estimates = [Estimate(**pooled.fit[k]) for k in ("exponent", "inner_share", "inner_s")]
    mean = Estimate(**pooled.fit["mean_lag_s"])
    inner_s = sensor.inner_s()
    truths = [exponent, inner_s / lag_s, inner_s]
    rows = [(mean.value, lag_s, mean.u, lag_s)]
    units = (1.0, 1.0, lag_s)
    rows += [(e.value, truth, e.u, unit) for e, truth, unit in zip(estimates, truths, units)]
    if pooled.law is None:
        return rows
    chain = pooled.chains[0]
    lag = pooled.chain.channels["T"].lag_s
    for speed in (lowest * ratio**0.25, lowest / 2, 2 * lowest * ratio):
        lag_there = chain.lag_s + sum(chain.taus_s) * (pooled.law.factor(speed) - 1)
        changes = sum(chain.taus_s) * pooled.law.factor_u(speed)
        u = np.hypot(lag.u * lag_there / chain.lag_s, np.sqrt(np.sum(changes**2)))
        true_s = sensor.lag_s(speed)
        rows.append((float(lag_there), true_s, float(u), true_s))
    return rows


FLOW_NAMES = (
    "lag at the flow of the result (mean)",
    "exponent",
    "inner share",
    "inner part",
    "lag at a flow between",
    "lag at half the lowest flow",
    "lag at twice the highest flow",
)


def report_flows(sensors: int = 20, seed: int = 1) -> None:
    """Print the table of dips at several flows."""
    for n_flows, count in DIPS_OF_FLOWS:
        made = [judge_flows(index, seed, n_flows, count) for index in range(sensors)]
        rows = [each for each in made if each is not None]
        with_law = [each for each in rows if len(each) == len(FLOW_NAMES)]
        print(
            f"{n_flows} flows, {count} dips at each: {len(rows)} of {sensors} sensors, "
            f"{len(with_law)} with a law"
        )
        for k, name in enumerate(FLOW_NAMES):
            of_name = np.array([each[k] for each in rows if len(each) > k])
            value, truth, u, unit = of_name.T
            z = (value - truth) / u
            error = (value - truth) / unit
            print(
                f"  {name}: covered {100 * np.mean(np.abs(z) < 1.96):.0f} %, rms of departure over "
                f"u {np.sqrt(np.mean(z**2)):.2f}, rms error {np.sqrt(np.mean(error**2)):.3f}, "
                f"mean error {np.mean(error):+.3f}, median u {np.median(u / unit):.3f}",
                flush=True,
            )


def contradictions(sets: int, seed: int, spread: float, exponent: float, each: int) -> float:
    """Share of sets that contradict the law: film of this exponent, some dips at each flow."""
    rng = np.random.default_rng([seed, each])
    reported = 0
    flows = np.repeat([1.0, 4.0], each)
    for _ in range(sets):
        n = exponent + 0.1 * rng.standard_normal()
        share = rng.uniform(0, 0.95)
        lag = share + (1 - share) * flows**-n
        u = np.exp(rng.uniform(np.log(0.005), np.log(0.03), len(flows)))
        y = lag * np.exp(np.hypot(spread, u) * rng.standard_normal(len(flows)))
        dips = [Estimate.normal(v, v * s) for v, s in zip(y, u)]
        reported += flow_effects(dips, DipFlows("v", tuple(flows.tolist())), 0.0).contradicts
    return reported / sets


def report_contradictions(sets: int = 200, seed: int = 1) -> None:
    """Print how often the law is contradicted."""
    for each in (1, 3):
        for spread in (0.02, 0.05, 0.1):
            right = 100 * contradictions(sets, seed, spread, 0.5, each)
            wrong = 100 * contradictions(sets, seed, spread, -0.5, each)
            print(
                f"{each} dips at each of two flows, spread {100 * spread:.0f} %: contradicted "
                f"{right:.1f} %, if the lag rises with the flow {wrong:.1f} %"
            )


def report_grid(sets: int = 20, seed: int = 1) -> None:
    """Print the largest relative change of u by half as many points of the grids."""
    rng = np.random.default_rng(seed)
    points = (dip_flows.N_EXPONENTS, dip_flows.N_SHARES)
    changes = []
    for _ in range(sets):
        u = rng.uniform(0.002, 0.03)
        values = np.array([1.0, rng.uniform(0.4, 0.9)]) * np.exp(u * rng.standard_normal(2))
        dips = [Estimate.normal(v, v * u) for v in values]
        found = []
        for factor in (1, 2):
            dip_flows.N_EXPONENTS, dip_flows.N_SHARES = (n // factor for n in points)
            effects = flow_effects(dips, DipFlows("v", (1.0, 4.0)), 0.0)
            lag = effects.lag_at(2.0).mean_estimate()
            found.append([lag.u, effects.exponent.u, effects.inner_share.u])
        changes.append(np.abs(np.divide(found[1], found[0]) - 1))
    dip_flows.N_EXPONENTS, dip_flows.N_SHARES = points
    lag, exponent, share = 100 * np.max(changes, axis=0)
    print(f"u of lag {lag:.2f} %, exponent {exponent:.2f} %, inner share {share:.2f} %")


REPORTS: dict[str, Callable[..., None]] = {
    "dips": report_dips,
    "flows": report_flows,
    "contradiction": report_contradictions,
    "grid": report_grid,
}

if __name__ == "__main__":
    kind, *numbers = sys.argv[1:]
    REPORTS[kind](*map(int, numbers))
