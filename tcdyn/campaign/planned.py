"""Expected uncertainty of beta, n and trends of a planned campaign, before any test is run.

Each planned test is the response of the rim model to the planned conditions, without noise. Its fit
is linear there, and its sufficient statistics are solved as a campaign. The whole disk is not
simulated: the temperature of the disk, its cooling and the noise are specified.

``tcdyn rig design`` calls it. The shape of the cooling and the constants below are approximations;
only expected uncertainties depend on them. Guarded by ``tests/campaign/test_planned.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtr, chdtrc

from tcdyn.campaign.compress import compress_likelihood
from tcdyn.campaign.exponent import speed_law
from tcdyn.campaign.posterior import (
    Posterior,
    determined_dof,
    shared_sensitivity,
    solve_campaign,
)
from tcdyn.campaign.sufficient_statistics import SufficientStatistics
from tcdyn.campaign.trends import trends
from tcdyn.chain import Chain
from tcdyn.chain.logger_noise import LoggerNoise
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import minimise
from tcdyn.io.read import read_numbers
from tcdyn.partition.angular_harmonic import UNKNOWN_HARMONIC
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import JOINT_WINDOW_S, disk_block, joint_problem
from tcdyn.partition.specified import with_surface_air
from tcdyn.partition.steady import with_linear_steel
from tcdyn.rig.columns import junction_columns
from tcdyn.rig.contact import (
    Events,
    equivalent_radius_m,
    half_width_m,
    hertz_contact,
    surface_speed_m_s,
)
from tcdyn.rig.disk import DISKS
from tcdyn.rig.rigfile import Rig
from tcdyn.rig.static_line import StaticLine, static_u
from tcdyn.smoothing.traces import DiskTraces

# Columns of a plan that are needed, and those with defaults in ``PlannedTest``.
COLUMNS = ("load_N", "friction_N", "speed_fast_rpm", "speed_slow_rpm")
OPTIONAL_COLUMNS = ("beta", "h_fast_W_m2K")
# Heat loss [W/K] from the row d, b, f through bore and faces to the surroundings, in steady state.
# Chosen by judgement.
BODY_LOSS_W_K = 1.8
# Excess temperature at d and f over that at b; chosen by judgement.
EDGE_EXCESS_RATIO = 0.995
# Delay [s] with which the inner row responds to the unloading; chosen by judgement.
INNER_ROW_DELAY_S = 0.3
# Share of the disk's heat capacity that cools with the row d, b, f; chosen by judgement.
COOLING_MASS_SHARE = 0.86
# Static line that every planned channel has; chosen by judgement.
STATIC_LINE = StaticLine(
    gain=1.0,
    offset=0.0,
    covariance=((1.4e-7, -1.1e-5), (-1.1e-5, 1.2e-3)),
    range_degC=(20.0, 160.0),
)
# Chain of a planned channel after a plunge test [s]: its two lags, the standard uncertainty of the
# common lag, and that of each channel about it. Chosen by judgement.
LAGS_S = (0.54, 0.12)
COMMON_LAG_U_S = 0.05
CHANNEL_LAG_U_S = 0.008
# Seeds of the noise of the ambient temperature, and of the first junction of the first disk; the
# seeds of the next disk begin SEEDS_PER_DISK later, so that every channel has its own.
AMBIENT_SEED = 7
JUNCTION_SEED = 40
SEEDS_PER_DISK = 10


@dataclass(frozen=True)
class PlannedTest:
    """Conditions of one planned EHL test.

    Parameters
    ----------
    name
        Name of the test.
    load_N, friction_N
        Load and friction under load.
    speed_fast_rpm, speed_slow_rpm
        Speeds of the shafts.
    beta, h_fast_W_m2K
        Expected share of the heat, and expected coefficient of the fast disk.
    """

    name: str
    load_N: float
    friction_N: float
    speed_fast_rpm: float
    speed_slow_rpm: float
    beta: float = 0.70
    h_fast_W_m2K: float = 700.0


@dataclass(frozen=True)
class Logging:
    """How planned tests are logged.

    Parameters
    ----------
    rate_Hz
        Sampling rate.
    noise_K, friction_noise_N
        Noise of one sample.
    loaded_s, cooling_s, before_s
        Duration of the load, of the cooling, and before the load.
    ambient_degC
        Temperature of the air.
    """

    rate_Hz: float = 75.0
    noise_K: float = 0.13
    friction_noise_N: float = 0.15
    loaded_s: float = 300.0
    cooling_s: float = 15.0
    before_s: float = 20.0
    ambient_degC: float = 60.0


@dataclass(frozen=True)
class PlannedCampaign:
    """Expected result of planned tests.

    Parameters
    ----------
    posterior
        Their joint posterior.
    u_beta_single
        Standard uncertainty of beta of each test solved by itself.
    """

    posterior: Posterior = field(repr=False)
    u_beta_single: tuple[float, ...]

    def table(self) -> pd.DataFrame:
        """Expected uncertainties, one row a test.

        Standard uncertainty of beta of the test by itself, in the campaign, and within it; that of
        h relative.
        """
        rows = []
        for name, estimate, u_single in zip(
            self.posterior.test_names, self.posterior.estimates, self.u_beta_single
        ):
            h = {f"u_h_{d}_rel": estimate[f"h_{d}"].u / estimate[f"h_{d}"].value for d in DISKS}
            rows.append(
                {
                    "test": name,
                    "u_beta_alone": u_single,
                    "u_beta": estimate["beta"].u,
                    "u_beta_within": estimate["beta_within"].u,
                    **h,
                }
            )
        return pd.DataFrame(rows)

    @property
    def u_exponent(self) -> float:
        """Standard uncertainty of n by all tests."""
        return speed_law(self.posterior).exponent.u

    @property
    def slopes(self) -> list[tuple[str, tuple[str, ...], float]]:
        """Standard uncertainty of the slope of every line of beta.

        Returns
        -------
        (variable, further variables of the same line, standard uncertainty) of each slope.
        """
        return [
            (name, tuple(a for a in t.against if a != name), slope.u)
            for t in trends(_with_equal_beta(self.posterior))
            for name, slope in zip(t.against, t.slopes)
        ]

    def summary(self) -> str:
        """The uncertainties in a few lines."""
        table = self.table()
        worst = {k: float(table[k].max()) for k in ("u_beta_alone", "u_beta", "u_beta_within")}
        lines = [
            f"{len(table)} planned tests, largest u of beta: {worst['u_beta_alone']:.4f} for a "
            f"test alone, {worst['u_beta']:.4f} absolute in the campaign, "
            f"{worst['u_beta_within']:.5f} within it",
            f"u of the exponent n: {self.u_exponent:.3f}",
        ]
        for name, alongside, u in self.slopes:
            lines.append(
                "u of the slope of beta over "
                f"{name}{f' beside {alongside[0]}' if alongside else ''}: {u:.2g}"
            )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The expected uncertainties as data."""
        return {
            "tests": self.table().to_dict("records"),
            "u_exponent": self.u_exponent,
            "slopes": [{"against": a, "beside": list(b), "u": u} for a, b, u in self.slopes],
        }


def _with_equal_beta(posterior: Posterior) -> Posterior:
    """The posterior with every beta equal: only the uncertainty of the slopes is of interest."""
    answers = posterior.values.copy()
    answers[:, 0] = answers[:, 0].mean()
    return replace(posterior, values=answers)


def read_plan(path: str | Path) -> tuple[PlannedTest, ...]:
    """Read planned tests from a table.

    Parameters
    ----------
    path
        Table with a row for each test: load_N, friction_N, speed_fast_rpm, speed_slow_rpm, and beta
        and h_fast_W_m2K if they are expected to be other than 0.7 and 700.

    Returns
    -------
    The tests, named "test 1" and so on.

    Raises
    ------
    InputError
        A missing column, no row, or a row that is no possible test.
    """
    values = read_numbers(path, COLUMNS, OPTIONAL_COLUMNS)
    rows = [{k: float(v[i]) for k, v in values.items()} for i in range(len(values["load_N"]))]
    for i, row in enumerate(rows, 2):
        sound = (
            0 < row["friction_N"] < row["load_N"]
            and row["speed_fast_rpm"] > row["speed_slow_rpm"] > 0
        )
        possible = 0 < row.get("beta", 0.5) < 1 and row.get("h_fast_W_m2K", 1.0) > 0
        if not (sound and possible):
            raise InputError(
                f"row {i} is no test",
                where=str(path),
                expected="friction below load, the fast shaft the faster, beta between 0 and "
                "1, h above 0",
            )
    if not rows:
        raise InputError("no planned test", where=str(path), expected="a row for each")
    return tuple(PlannedTest(f"test {i}", **row) for i, row in enumerate(rows, 1))


@one_blas_thread
def predict_campaign(
    plan: Sequence[PlannedTest], rig: Rig, logging: Logging | None = None
) -> PlannedCampaign:
    """Expected uncertainties of all planned tests together.

    Parameters
    ----------
    plan
        The planned tests.
    rig
        The rig, with its junctions and uncertainties.
    logging
        How the tests are logged; the defaults if None.
    """
    tests = [planned_statistics(planned, rig, logging or Logging()) for planned in plan]
    u_single = tuple(expected_widening(solve_campaign([k])).estimates[0]["beta"].u for k in tests)
    return PlannedCampaign(expected_widening(solve_campaign(tests)), u_single)


def expected_widening(posterior: Posterior) -> Posterior:
    """Widen a posterior by the expected square of Birge's ratio.

    The ratio is ``tcdyn.campaign.posterior.birge_ratio_squared``, for as many degrees of freedom as
    the data determine of the shared quantities.
    """
    widened = expected_ratio_squared(determined_dof(posterior.shared_covariance))
    sensitivity = shared_sensitivity(posterior.reduced_tests, posterior.shared)
    added = (
        (widened - posterior.inflation) * sensitivity @ posterior.shared_covariance @ sensitivity.T
    )
    return replace(posterior, covariance=posterior.covariance + added, inflation=widened)


def expected_ratio_squared(dof: float) -> float:
    """Return the expected square of Birge's ratio, which is at least one.

    Notes
    -----
    E max(1, X/v) = P(X < v) + P(Y > v). X is chi-squared with v degrees of freedom, Y has v + 2.

    Examples
    --------
    >>> round(expected_ratio_squared(2), 4)
    1.3679
    """
    return float(chdtr(dof, dof) + chdtrc(dof + 2, dof))


def planned_statistics(plan: PlannedTest, rig: Rig, logging: Logging) -> SufficientStatistics:
    """Sufficient statistics of a planned test whose fit is at the truth.

    Parameters
    ----------
    plan
        The planned test.
    rig
        The rig.
    logging
        How the test is logged.

    Notes
    -----
    The data of each disk are the model's response to the planned readings of the inner row, so that
    the residual is zero. The optimum is evaluated there without a step (``limit=0``).
    ``tests/campaign/test_planned.py`` compares with the uncertainty of a fit to simulated logs.
    """
    radius, crown = zip(*((s.outer_radius_m, s.crown_radius_m) for s in map(rig.disk_setup, DISKS)))
    u_fast, u_slow = (
        surface_speed_m_s(rpm, r)
        for rpm, r in zip((plan.speed_fast_rpm, plan.speed_slow_rpm), radius)
    )
    contact = rig.common.contact
    u = rig.common.uncertainty
    dt = 1 / logging.rate_Hz
    unload_s = logging.before_s + logging.loaded_s
    t: Array = np.arange(0.0, unload_s + logging.cooling_s, dt, dtype=np.float64)
    power = plan.friction_N * (u_fast - u_slow)
    h = {
        "fast": plan.h_fast_W_m2K,
        "slow": plan.h_fast_W_m2K / (u_fast / u_slow) ** contact.speed_exponent,
    }
    share = {"fast": plan.beta, "slow": 1 - plan.beta}
    events = Events(logging.before_s, unload_s + 0.4 * dt, 0.01, 0.02, (unload_s + 0.4 * dt,))
    test = EhlTest(
        time_s=t,
        dt_s=dt,
        events=events,
        power_W=np.where((t >= logging.before_s) & (t < events.unload_s), power, 0.0),
        ambient_degC=logging.ambient_degC + 0.1 * _reproducible_noise(len(t), AMBIENT_SEED),
        load_N=plan.load_N,
        friction_N=plan.friction_N,
        speed_ratio=u_fast / u_slow,
        sliding_speed_m_s=u_fast - u_slow,
        entraining_speed_m_s=0.5 * (u_fast + u_slow),
        half_width_m=half_width_m(
            plan.load_N, equivalent_radius_m(*radius), equivalent_radius_m(*crown)
        ),
        speed_exponent=contact.speed_exponent,
        exponent_half_range=0.5 * (u.speed_exponent_high - u.speed_exponent_low),
        disks={
            d: _planned_traces(
                d, rig, plan.load_N, t, events.unload_s, share[d] * power, h[d], logging
            )
            for d in DISKS
        },
        findings=(),
        friction_noise_N=logging.friction_noise_N,
    )
    test = with_linear_steel(with_surface_air(test))
    theta = [
        np.array([share[d], np.log(h[d]), np.log(sum(LAGS_S)), np.log(LAGS_S[1])]) for d in DISKS
    ]
    window_s = min(JOINT_WINDOW_S, float(t[-1] - events.unload_s))
    blocks = []
    for d, start in zip(DISKS, theta):
        block = disk_block(test, test.disks[d], start, window_s, "modal", LAGS_S[1])
        response = block.model(start)
        assert response is not None
        blocks.append(
            replace(block, y=response[0], prior_lag_s=sum(LAGS_S) + block.remaining_lag_s)
        )
    problem = joint_problem(blocks)
    best = minimise(problem, np.pad(np.concatenate(theta), (0, problem.size - 8)), limit=0)
    hotter_K = (
        0.35 * (2 * plan.beta - 1) * power
    )  # roughly, the fast disk's surface: by its greater share, 0.35 K/W
    conditions = {"delta_T_us_K_m_s": hotter_K * test.sliding_speed_m_s}
    return compress_likelihood(
        plan.name,
        "planned",
        test,
        blocks,
        best,
        dict.fromkeys(DISKS, UNKNOWN_HARMONIC),
        **conditions,
    )


def _reproducible_noise(count: int, seed: int) -> Array:
    """White noise of unit variance, the same in each call with the same seed.

    Parameters
    ----------
    count
        Number of samples.
    seed
        Seed of the generator. Any seed does: the fits only estimate the level of the noise. Two
        channels must not have the same, because their noise is independent.

    Returns
    -------
    Noise, (count,).
    """
    return np.random.default_rng(seed).standard_normal(count)


def _planned_traces(
    disk: str,
    rig: Rig,
    load_N: float,
    t: Array,
    unload_s: float,
    power_W: float,
    h_W_m2K: float,
    logging: Logging,
) -> DiskTraces:
    """Readings of a planned disk.

    The inner row is at its steady excess until the unloading, then it cools with the disk.

    Parameters
    ----------
    disk
        The disk.
    rig
        The rig.
    load_N
        Load.
    t
        Time, (N,) [s].
    unload_s
        Instant of the unloading [s].
    power_W
        Heat into this disk [W].
    h_W_m2K
        Heat-transfer coefficient of the running surface.
    logging
        How the test is logged.
    """
    setup = rig.disk_setup(disk)
    u = rig.tables(disk).uncertainty
    contact = hertz_contact(load_N, setup.outer_radius_m, setup.crown_radius_m)
    setup = replace(setup, flux=setup.flux.at_pressure(contact.pressure_Pa))
    surface = 2 * np.pi * setup.outer_radius_m * setup.width_m
    volume = np.pi * (setup.outer_radius_m**2 - setup.bore_radius_m**2) * setup.width_m
    out_W_K = h_W_m2K * surface + BODY_LOSS_W_K
    tau = COOLING_MASS_SHARE * volume * setup.density_kg_m3 * setup.specific_heat_J_kgK / out_W_K
    since = np.clip(t - unload_s, 0.0, None)
    fall = (tau * np.exp(-since / tau) - INNER_ROW_DELAY_S * np.exp(-since / INNER_ROW_DELAY_S)) / (
        tau - INNER_ROW_DELAY_S
    )
    excess = power_W / out_W_K * fall
    chain = Chain(LAGS_S, conditioning=setup.conditioning)
    lagged = chain.response(excess, 1 / logging.rate_Hz)
    count = len(setup.channels)
    y = np.empty((len(t), count))
    first_seed = JUNCTION_SEED + SEEDS_PER_DISK * DISKS.index(disk)
    for k, c in enumerate(setup.channels):
        ratio = EDGE_EXCESS_RATIO if c in setup.inner and c != setup.edge else 1.0
        y[:, k] = (
            logging.ambient_degC
            + ratio * lagged
            + logging.noise_K * _reproducible_noise(len(t), first_seed + k)
        )
    level = np.full(count, logging.noise_K)
    noise = LoggerNoise(
        np.zeros_like(level), level, level, setup.conditioning, rate_Hz=logging.rate_Hz
    )
    return DiskTraces(
        columns=junction_columns(setup.channels, disk),
        lines=(STATIC_LINE,) * count,
        chains=(chain,) * count,
        lag_covariance_s2=COMMON_LAG_U_S**2 + CHANNEL_LAG_U_S**2 * np.eye(count),
        split_u_s=np.zeros(count),
        name=disk,
        setup=setup,
        readings_degC=y,
        missing=np.zeros(y.shape, dtype=bool),
        noise=noise,
        rounding_K=np.zeros(count),
        static_u_K=np.asarray(static_u(STATIC_LINE, y[t < unload_s][-1])),
        uncertainty=u,
        inner_offset_K=np.zeros((len(t), len(setup.inner))),
    )
