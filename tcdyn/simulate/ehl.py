"""Simulation of an EHL test: warm running, loading, unloading and cooling of both disks.

``tcdyn.simulate.campaign`` and the tests use it. A test is drawn around its published values
(``draw_test``), the disks are solved by finite volumes (``tcdyn.simulate.implicit``), and the log
is made from the solution (``tcdyn.simulate.measure``). ``tests/simulate/test_ehl.py`` guards it.
Amplitudes of drift and noise are chosen by judgement unless a comment says more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from tcdyn.core import Array
from tcdyn.rig.contact import hertz_contact
from tcdyn.rig.disk import DISKS
from tcdyn.simulate.harmonics import harmonic_system, unevenness_effects
from tcdyn.simulate.implicit import Solution, Stepping, integrate, steady_state
from tcdyn.simulate.measure import log_disk, quantise, sample_times
from tcdyn.simulate.mesh import DiskMesh, DiskSystem
from tcdyn.simulate.programme import EhlCondition, ehl_test
from tcdyn.simulate.truth import DiskTruth, RigTruth, draw_truth, rng_for

# a contact after the unloading comes and goes in this time [s]; chosen by judgement
RECONTACT_RISE_S = 0.01
STUDY_MESH = DiskMesh(radial=32, axial=40)  # 3 times faster than the default, 0.02 K from it


@dataclass(frozen=True)
class EhlOptions:
    """Times of a test [s] and values to fix; None leaves a value to the random draw.

    Parameters
    ----------
    load_on_s, unload_s, duration_s
        Nominal loading, unloading and end of the log.
    parting_s
        Duration of the fall of the friction, centred at the unloading.
    loading_ramp_s
        Duration of the rise of the friction.
    ambient_degC
        Nominal ambient temperature, to which up to 0.7 K is added [degC].
    brake_s
        From the unloading both speeds fall to 1/e in this time.
    again_s
        Contacts after the unloading: (duration, time after the unloading).
    beta
        Share of the frictional heat that enters the fast disk; None draws it.
    h_fast_W_m2K
        Heat transfer coefficient of the fast disk under load [W/m2K]; None draws it.
    friction_N
        Friction force [N]; None draws it.
    mesh
        Cells of the disks.
    stepping
        Step sizes of the time integration.
    """

    load_on_s: float = 50.0
    unload_s: float = 1050.0
    duration_s: float = 1400.0
    parting_s: float = 0.02
    loading_ramp_s: float = 0.3
    ambient_degC: float = 60.5
    brake_s: float | None = None
    again_s: tuple[tuple[float, float], ...] = ()
    beta: float | None = None
    h_fast_W_m2K: float | None = None
    friction_N: float | None = None
    mesh: DiskMesh = field(default_factory=DiskMesh)
    stepping: Stepping = field(default_factory=Stepping)


@dataclass(frozen=True)
class EhlTruth:
    """True values of one test.

    Parameters
    ----------
    test
        Nominal conditions of the test.
    beta
        Share of the frictional heat that enters the fast disk.
    h_fast_W_m2K, h_slow_W_m2K
        Heat transfer coefficients of the running surfaces under load [W/m2K].
    half_width_m
        Half the width of the running track [m].
    pressure_Pa
        Maximum pressure of the contact [Pa].
    friction_N
        Nominal level of the friction, before drift [N].
    load_on_s, unload_s
        Start of the loading, and middle of the unloading [s].
    parting_s, loading_ramp_s
        Durations of the fall and of the rise of the friction [s].
    ambient_degC
        Ambient temperature before drift [degC].
    phases
        Six phases of the drifts, as shares of a period. Friction uses the first two, ambient the
        next two, oil the fifth; the last is spare.
    drift
        Whether friction, ambient and oil temperature vary.
    speed_exponent
        n of h ~ u^n.
    brake_s
        Time constant of the speeds from the unloading on [s]; None for constant speeds.
    again_s
        Contacts after the unloading: (duration, time after the unloading) [s].

    Notes
    -----
    The solver must know every kink of friction and speed: a new one belongs in ``breaks_s`` too, at
    the end, because ``contact_share`` reads its first four entries. ``tests/simulate/test_ehl.py``
    checks contacts that come back.
    """

    test: EhlCondition
    beta: float
    h_fast_W_m2K: float
    h_slow_W_m2K: float
    half_width_m: float
    pressure_Pa: float  # maximum of the contact
    friction_N: float  # nominal level, before drift
    load_on_s: float
    unload_s: float
    parting_s: float
    loading_ramp_s: float
    ambient_degC: float
    phases: tuple[float, ...]
    drift: bool
    speed_exponent: float
    brake_s: float | None = None
    again_s: tuple[tuple[float, float], ...] = ()

    @property
    def breaks_s(self) -> tuple[float, ...]:
        """Times at which friction or speed has a kink, those of loading and unloading first [s]."""
        half_ramp = 0.5 * self.parting_s
        breaks = [
            self.load_on_s,
            self.load_on_s + self.loading_ramp_s,
            self.unload_s - half_ramp,
            self.unload_s + half_ramp,
        ]
        if self.brake_s is not None:
            breaks.append(self.unload_s)
        for start, end in self.recontact_intervals_s:
            breaks += [start, start + RECONTACT_RISE_S, end - RECONTACT_RISE_S, end]
        return tuple(breaks)

    @property
    def recontact_intervals_s(self) -> tuple[tuple[float, float], ...]:
        """Start and end of the contacts after the unloading [s]."""
        intervals = []
        for duration, delay in self.again_s:
            start = self.unload_s + delay
            intervals.append((start, start + duration))
        return tuple(intervals)

    def contact_share(self, t: Array) -> Array:
        """Return 1 while the disks are loaded and 0 while they are separated, with linear ramps.

        Parameters
        ----------
        t
            Times (N,) [s].

        Returns
        -------
        array
            Share of the full load (N,).
        """
        load_start, load_end, unload_start, unload_end = self.breaks_s[:4]
        rise = np.clip((t - load_start) / max(load_end - load_start, 1e-12), 0, 1)
        fall = np.clip((t - unload_start) / max(unload_end - unload_start, 1e-12), 0, 1)
        share = rise * (1 - fall)
        for start, end in self.recontact_intervals_s:
            recontact = np.clip(np.minimum(t - start, end - t) / RECONTACT_RISE_S, 0, 1)
            share = np.maximum(share, recontact)
        return share

    def speed_share(self, t: Array) -> Array:
        """Return the speeds relative to those under load.

        Parameters
        ----------
        t
            Times (N,) [s].

        Returns
        -------
        array
            1 until the unloading, then exp(-time/brake_s) where the disks are braked (N,).
        """
        if self.brake_s is None:
            return np.ones_like(t)
        return np.exp(-np.clip(t - self.unload_s, 0, None) / self.brake_s)

    def h_share(self, t: Array) -> Array:
        """Return h of either disk relative to that under load, h ~ u^n.

        Parameters
        ----------
        t
            Times (N,) [s].

        Returns
        -------
        array
            Relative heat transfer coefficient (N,).

        Notes
        -----
        ``tcdyn.simulate.ehl.draw_test`` uses the same exponent for the ratio of the two disks.
        """
        return self.speed_share(t) ** self.speed_exponent

    def friction_at(self, t: Array) -> Array:
        """Return the true friction force [N].

        Parameters
        ----------
        t
            Times (N,) [s].

        Returns
        -------
        array
            Friction (N,) [N]. With ``drift`` it has a running-in of 4 % that decays with 150 s,
            and two sines of 0.4 and 0.3 %.

        Notes
        -----
        Amplitudes and periods are chosen by judgement and may be changed; the committed logs of
        ``tests/behaviour`` change with them.
        """
        level = np.full_like(t, self.friction_N)
        if self.drift:
            run_in = 0.04 * np.exp(-np.clip(t - self.load_on_s, 0, None) / 150.0)
            slow = 0.004 * np.sin(2 * np.pi * (t / 310.0 + self.phases[0]))
            fast = 0.003 * np.sin(2 * np.pi * (t / 97.0 + self.phases[1]))
            level = level * (1 + run_in + (slow + fast))
        return level * self.contact_share(t)

    def ambient_at(self, t: Array) -> Array:
        """Return the true ambient temperature [degC].

        Parameters
        ----------
        t
            Times (N,) [s].

        Returns
        -------
        array
            Ambient temperature (N,) [degC]. With ``drift`` it has two sines of 0.3 and 0.1 K, and
            it follows the frictional power, 5 mK for each watt, with a lag of 260 s.

        Notes
        -----
        Amplitudes, periods and the lag are chosen by judgement and may be changed; the committed
        logs of ``tests/behaviour`` change with them.
        """
        ambient = np.full_like(t, self.ambient_degC)
        if self.drift:
            slow = 0.3 * np.sin(2 * np.pi * (t / 900.0 + self.phases[2]))
            fast = 0.1 * np.sin(2 * np.pi * (t / 333.0 + self.phases[3]))
            warming_K = 0.005 * self.friction_N * self.test.sliding_speed_m_s
            share = _first_order(t, self.load_on_s, self.unload_s, 260.0)
            ambient = ambient + slow + fast + warming_K * share
        return ambient


def draw_test(
    truth: RigTruth, test: EhlCondition, seed: int, options: EhlOptions | None = None
) -> EhlTruth:
    """Draw the true values of one test around its published results (table 7.1).

    Parameters
    ----------
    truth
        True values of the rig.
    test
        Conditions of the test and published results.
    seed
        Seed; the draws depend on it and on the name of the test only.
    options
        Times and fixed values; a fixed value replaces its draw.

    Returns
    -------
    EhlTruth
        The true values. Loading and unloading are off the sample grid by up to 0.5 s.

    Notes
    -----
    Standard deviations: beta 0.01 (clipped to 0.64 to 0.78), h 4 %, friction 1 %. h of the slow
    disk follows from that of the fast disk by the speed law. All values are drawn before options
    replace some, so that one option does not change the other draws. Keep the order of the draws:
    another order changes all logs of ``tests/behaviour``.
    """
    o = options or EhlOptions()
    rng = rng_for(seed, "test", test.name)
    beta = float(np.clip(test.beta + 0.01 * rng.standard_normal(), 0.64, 0.78))
    h_fast = float(test.h_fast_W_m2K * (1 + 0.04 * np.clip(rng.standard_normal(), -2, 2)))
    load_shift, unload_shift = rng.uniform(-0.5, 0.5, 2)
    friction = float(test.friction_N * (1 + 0.01 * rng.standard_normal()))
    ambient = o.ambient_degC + float(rng.uniform(-0.7, 0.7))
    phases = tuple(float(p) for p in rng.uniform(0, 1, 6))
    if o.h_fast_W_m2K is not None:
        h_fast = o.h_fast_W_m2K
    setup = truth.fast.setup
    contact = hertz_contact(test.load_N, setup.outer_radius_m, setup.crown_radius_m)
    return EhlTruth(
        test=test,
        beta=o.beta if o.beta is not None else beta,
        h_fast_W_m2K=h_fast,
        h_slow_W_m2K=h_fast / truth.gear_ratio**truth.speed_exponent,
        half_width_m=contact.major_m * truth.half_width_scale,
        pressure_Pa=contact.pressure_Pa,
        friction_N=o.friction_N if o.friction_N is not None else friction,
        load_on_s=o.load_on_s + float(load_shift),
        unload_s=o.unload_s + float(unload_shift),
        parting_s=o.parting_s,
        loading_ramp_s=o.loading_ramp_s,
        ambient_degC=ambient,
        phases=phases,
        drift=truth.imperfections.drift,
        speed_exponent=truth.speed_exponent,
        brake_s=o.brake_s,
        again_s=o.again_s,
    )


def _first_order(t: Array, on_s: float, off_s: float, tau_s: float) -> Array:
    """Return the response of a first-order lag to 1 from ``on_s`` to ``off_s``, else 0.

    Parameters
    ----------
    t
        Times (N,) [s].
    on_s, off_s
        Start and end of the input [s].
    tau_s
        Time constant [s].

    Returns
    -------
    array
        Response (N,), from 0 to 1.
    """
    rise = 1 - np.exp(-np.clip(t - on_s, 0, None) / tau_s)
    fall = 1 - np.exp(-np.clip(t - off_s, 0, None) / tau_s)
    return rise - fall


def simulate_ehl(
    test: str | EhlCondition = "B3",
    seed: int = 0,
    truth: RigTruth | None = None,
    options: EhlOptions | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Simulate one EHL test on the synthetic rig.

    Parameters
    ----------
    test
        Name of a test of the programme (A1 to D4), or its conditions.
    seed
        Seed of the random draws; each kind of draw and each disk has its own stream.
    truth
        The true rig; by default ``draw_truth(seed)``.
    options
        Times and fixed values.

    Returns
    -------
    frame
        The log: canonical EHL columns, 75 Hz.
    truth
        True values (beta, h_fast, h_slow, load_on_s, unload_s, friction_N, ...)
        and ``"traces"``, a DataFrame of the true junction temperatures, ambient, oil, friction and
        contact in the columns of the log.
    """
    condition = ehl_test(test) if isinstance(test, str) else test
    rig = truth or draw_truth(seed)
    o = options or EhlOptions()
    test_truth = draw_test(rig, condition, seed, o)
    t = sample_times(o.duration_s)
    columns, traces = _condition_channels(
        t, test_truth, rig, rng_for(seed, "conditions", condition.name)
    )
    unevenness: dict[str, Any] = {}
    for name in DISKS:
        rng = rng_for(seed, "measure", condition.name, name)
        log, true, unevenness[name] = _simulate_disk(rig, name, test_truth, o, rng)
        for k, channel in enumerate(sorted(rig.disk(name).channels)):
            columns[f"{name}_{channel}_degC"] = log[:, k]
            traces[f"{name}_{channel}_degC"] = true[:, k]
    last = ["ambient_degC", "oil_degC"]
    order = [c for c in columns if c not in last] + last
    frame = pd.DataFrame(columns)[order]
    trace_frame = pd.DataFrame(traces)[order]
    values = _true_scalars(test_truth, rig, trace_frame)
    return frame, {**values, "unevenness": unevenness, "traces": trace_frame}


def heat_share_and_h(test_truth: EhlTruth, name: str) -> tuple[float, float]:
    """Return the share of the frictional heat of a disk and its h under load [W/m2K].

    Parameters
    ----------
    test_truth
        True values of the test.
    name
        "fast" or "slow".

    Returns
    -------
    share
        beta for the fast disk, 1 - beta for the slow one.
    h
        Heat transfer coefficient of the running surface under load [W/m2K].
    """
    if name == "fast":
        return test_truth.beta, test_truth.h_fast_W_m2K
    return 1 - test_truth.beta, test_truth.h_slow_W_m2K


def _simulate_disk(
    rig: RigTruth, name: str, test_truth: EhlTruth, options: EhlOptions, rng: np.random.Generator
) -> tuple[Array, Array, dict[str, Any]]:
    """Simulate and log one disk.

    Parameters
    ----------
    rig
        True values of the rig.
    name
        "fast" or "slow".
    test_truth
        True values of the test.
    options
        Options of the simulation.
    rng
        Random numbers of the logger of this disk.

    Returns
    -------
    logged, true
        Logged and true channels (N, channels) [degC], channels in alphabetical order.
    unevenness
        Effect of the uneven press fit at the start of the unloading
        (``tcdyn.simulate.harmonics.unevenness_effects``).
    """
    disk = rig.disk(name)
    share, h = heat_share_and_h(test_truth, name)
    _, solution = disk_run(disk, test_truth, share, h, options, options.duration_s)
    n_channels = len(disk.channels)

    def junctions_at(t: Array) -> Array:
        """Return the true junction temperatures (M, channels) [degC] at times ``t`` (M,)."""
        return solution.at(t)[:, :n_channels]

    imperfections = rig.imperfections
    log, true = log_disk(junctions_at, options.duration_s, disk, rng, imperfections, spikes=True)
    unloading_start = np.array([test_truth.breaks_s[2]])
    return log, true, unevenness_effects(disk, solution.at(unloading_start)[0])


def disk_run(
    disk: DiskTruth,
    test_truth: EhlTruth,
    share: float,
    h: float,
    options: EhlOptions,
    until_s: float,
) -> tuple[DiskSystem, Solution]:
    """Simulate one disk from the start of its test to ``until_s``.

    Parameters
    ----------
    disk
        True values of the disk.
    test_truth
        True values of the test.
    share
        Share of the frictional heat that enters the disk.
    h
        Heat transfer coefficient of the running surface under load [W/m2K].
    options
        Mesh and steps of the solution.
    until_s
        End of the solution [s].

    Returns
    -------
    system
        The equations of the disk.
    solution
        Its readings over time.

    Notes
    -----
    The disk starts in the steady state without friction at its first ambient temperature. The heat
    of the contact is a line source at the surface; its share is the same at all times.
    """
    flux = disk.setup.flux.at_pressure(test_truth.pressure_Pa)
    loaded_disk = replace(disk, setup=replace(disk.setup, flux=flux))
    system = harmonic_system(loaded_disk, h, test_truth.half_width_m, options.mesh)

    def power(t: Array) -> Array:
        """Return the heat that enters the disk (N,) [W] at times ``t`` (N,)."""
        return (
            share
            * test_truth.test.sliding_speed_m_s
            * test_truth.speed_share(t)
            * test_truth.friction_at(t)
        )

    ambient = float(test_truth.ambient_at(np.zeros(1))[0])
    start = steady_state(system, 0.0, ambient)
    breaks = sorted({b for b in test_truth.breaks_s if 0 < b < until_s})
    edges = (0.0, *breaks, until_s)
    solution = integrate(
        system, power, test_truth.ambient_at, edges, start, options.stepping, test_truth.h_share
    )
    return system, solution


def _condition_channels(
    t: Array, test_truth: EhlTruth, rig: RigTruth, rng: np.random.Generator
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the channels of the log that are no temperatures of the disks, logged and true.

    Parameters
    ----------
    t
        Times of the samples (N,) [s].
    test_truth
        True values of the test.
    rig
        True values of the rig; its imperfections decide which errors are added.
    rng
        Random numbers of these channels.

    Returns
    -------
    logged
        Columns of the log (N,): time, load, friction, contact, speeds, ambient, oil.
    true
        The same columns without errors.

    Notes
    -----
    Logged friction is ``friction_scale`` times the true one; load and friction have a zero error
    and pass 16 bits. Load, friction and contact are shifted by up to 0.02 s each. Noise, zero
    errors and shifts are chosen by judgement. All random numbers are drawn even where an error is
    switched off, so that the other errors stay the same. ``tests/simulate/test_ehl.py`` checks that
    load, friction and contact agree within a twentieth of a second.
    """
    errors = rig.imperfections
    delay_s = rng.uniform(-0.02, 0.02, 4) if errors.timing else np.zeros(4)
    noise = rng.standard_normal((6, len(t))) * (1.0 if errors.noise else 0.0)
    zero_errors = [4.0, 0.08] if errors.static else [0.0, 0.0]
    zero_load, zero_friction = rng.uniform(-1, 1, 2) * zero_errors

    def digitised(values: Array, full_scale: float) -> Array:
        """Return ``values`` as a 16-bit converter of +- ``full_scale`` reads them."""
        return quantise(values, -full_scale, full_scale) if errors.quantise else values

    load_N = test_truth.test.load_N
    true = {
        "time_s": t,
        "load_N": load_N * test_truth.contact_share(t),
        "friction_N": test_truth.friction_at(t),
        "contact": _inside_intervals(
            t, [(test_truth.load_on_s, test_truth.unload_s), *test_truth.recontact_intervals_s]
        ),
        "speed_fast_rpm": test_truth.test.speed_fast_rpm * test_truth.speed_share(t),
        "speed_slow_rpm": test_truth.test.speed_slow_rpm * test_truth.speed_share(t),
        "ambient_degC": test_truth.ambient_at(t),
        "oil_degC": _oil_temperature(t, test_truth, errors.drift),
    }
    load = load_N * test_truth.contact_share(t - delay_s[0])
    friction = rig.friction_scale * test_truth.friction_at(t - delay_s[1])
    switch_on_s = test_truth.load_on_s + 0.5 * abs(delay_s[2])
    switch_off_s = test_truth.unload_s + delay_s[3]
    logged = {
        "time_s": t,
        "load_N": digitised(load + zero_load + 6.0 * noise[0], 5000.0),
        "friction_N": digitised(friction + zero_friction + 0.15 * noise[1], 100.0),
        "contact": _inside_intervals(
            t, [(switch_on_s, switch_off_s), *test_truth.recontact_intervals_s]
        ),
        "speed_fast_rpm": np.round(true["speed_fast_rpm"] + 1.5 * noise[2], 1),
        "speed_slow_rpm": np.round(true["speed_slow_rpm"] + 0.5 * noise[3], 1),
        "ambient_degC": true["ambient_degC"] + rig.ambient_bias_K + 0.1 * noise[4],
        "oil_degC": true["oil_degC"] + 0.1 * noise[5],
    }
    return logged, true


def _oil_temperature(t: Array, test_truth: EhlTruth, drift: bool) -> Array:
    """Return the true temperature of the oil [degC].

    Parameters
    ----------
    t
        Times (N,) [s].
    test_truth
        True values of the test.
    drift
        Whether it varies; otherwise it is 60 degC.

    Returns
    -------
    array
        Temperature of the oil (N,) [degC].
    """
    oil = np.full(len(t), 60.0)
    if not drift:
        return oil
    slow = 0.4 * np.sin(2 * np.pi * (t / 700.0 + test_truth.phases[4]))
    return oil + slow + 0.2 * test_truth.contact_share(t)


def _inside_intervals(t: Array, intervals: Sequence[tuple[float, float]]) -> Array:
    """Return 1 inside any of the intervals, else 0.

    Parameters
    ----------
    t
        Times (N,) [s].
    intervals
        Start and end of each [s].

    Returns
    -------
    array
        0.0 or 1.0 (N,).
    """
    return np.any([(t >= start) & (t < stop) for start, stop in intervals], axis=0).astype(float)


def _true_scalars(test_truth: EhlTruth, rig: RigTruth, traces: pd.DataFrame) -> dict[str, Any]:
    """Return the true values of a test for the truth file.

    Parameters
    ----------
    test_truth
        True values of the test.
    rig
        True values of the rig.
    traces
        True values in the columns of the log.

    Returns
    -------
    dict
        Values by key. Means are those of the last 5 s before the unloading.

    Notes
    -----
    The keys are those of ``truth.json``, which tests and ``tcdyn.verify`` read.
    ``tests/simulate/test_ehl.py`` checks that the mean covers full load only.
    """
    t = traces["time_s"].to_numpy()
    is_steady = (t < test_truth.unload_s - test_truth.parting_s) & (t >= test_truth.unload_s - 5.0)
    mean = {c.removesuffix("_degC"): float(traces.loc[is_steady, c].mean()) for c in traces.columns}
    unloading_start = np.array([test_truth.breaks_s[2]])
    return {
        "test": test_truth.test.name,
        "beta": test_truth.beta,
        "h_fast": test_truth.h_fast_W_m2K,
        "h_slow": test_truth.h_slow_W_m2K,
        "exponent": rig.speed_exponent,
        "half_width_m": test_truth.half_width_m,
        "load_N": test_truth.test.load_N,
        "friction_N": mean["friction_N"],
        "friction_at_unloading_N": float(test_truth.friction_at(unloading_start)[0]),
        "sliding_speed_m_s": test_truth.test.sliding_speed_m_s,
        "entraining_speed_m_s": test_truth.test.entraining_speed_m_s,
        "load_on_s": test_truth.load_on_s,
        "unload_s": test_truth.unload_s,
        "parting_s": test_truth.parting_s,
        "brake_s": test_truth.brake_s,
        "again_s": test_truth.again_s,
        "ambient_degC": mean["ambient"],
        "steady_degC": {c: value for c, value in mean.items() if c.startswith(("fast_", "slow_"))},
        "common_lag_s": {d: rig.disk(d).common_lag_s for d in DISKS},
        "lag_s": {d: rig.disk(d).lags_s for d in DISKS},
    }
