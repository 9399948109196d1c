"""Joint fits of a test in rounds: fit, diagnose, adjust, and fit again.

A round fits what :class:`FitState` assumes. Its result may show that an assumption must change: the
air of a disk that slows down follows its speed, or the temperature around a disk is uneven. Each
adjustment is made once, so that there are at most ``MAX_ROUNDS`` rounds; a finding gives the reason
for each. Used by :mod:`tcdyn.partition.analyse` for tests with one or both disks. Guarded by
``tests/partition/test_uneven.py``, ``tests/partition/test_stated_fit.py`` (studies) and the
behaviour suite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from tcdyn.core import Array
from tcdyn.core.findings import Finding, info
from tcdyn.heat.rim import Profile
from tcdyn.partition.angular_harmonic import AngularHarmonic, harmonic_K
from tcdyn.partition.cooling import with_slowing_air_offset
from tcdyn.partition.events import EhlTest
from tcdyn.partition.joint import CombinedFit, DiskFit, StartPoints, joint_fits
from tcdyn.partition.press_fit import press_fit_priors
from tcdyn.partition.steady import DiskLine, SpeedLawPoint, steady_lines

# The first fit, one with the air of slowing disks, and one with the harmonics.
MAX_ROUNDS = 3


@dataclass(frozen=True)
class FitState:
    """What a round of the joint fits assumes.

    Parameters
    ----------
    test
        The test with the priors of the harmonics; no harmonic is subtracted.
    start
        Share and h [W/m2K] of each disk to start from.
    air_follows_speed
        Whether the air of slowing disks was adjusted to the fitted share and h.
    harmonics
        Prior of the harmonic of each disk, once a fit showed one or a press fit gives one.
    press_fits
        Those of them that come from a press fit of rig.toml.
    findings
        Reasons for the rounds, and press fits that the data contradict.
    """

    test: EhlTest
    start: StartPoints
    air_follows_speed: bool = False
    harmonics: Mapping[str, AngularHarmonic] = field(default_factory=dict)
    press_fits: Mapping[str, AngularHarmonic] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    @property
    def fitted_test(self) -> EhlTest:
        """The test that the joint fits get: nominal harmonics of press fits are subtracted."""
        if self.press_fits:
            return remove_harmonics(self.test, self.harmonics)
        return self.test


@dataclass(frozen=True)
class MainFits:
    """Results of steady lines and joint fits.

    Parameters
    ----------
    test
        The test without the estimated harmonics, with their remaining uncertainty.
    fitted_test
        The test of the joint fits: only the nominal harmonics of a stated press fit are subtracted.
    lines, speed
        Steady line of each disk, and the speed law's point.
    joint, combined
        Joint fit of each disk, and of all disks together.
    findings
        Findings of the fits.
    """

    test: EhlTest
    fitted_test: EhlTest
    lines: Mapping[str, DiskLine]
    speed: SpeedLawPoint
    joint: Mapping[str, DiskFit]
    combined: CombinedFit
    findings: tuple[Finding, ...]


def fit_in_rounds(
    test: EhlTest,
    rows: slice,
    joint_s: float,
    profile: Profile = "modal",
    weights: Array | None = None,
) -> MainFits:
    """Joint fits, repeated as long as a fit shows that an assumption must change.

    Parameters
    ----------
    test
        The corrected test, with one or both disks.
    rows
        Rows for the steady lines.
    joint_s
        Length of the cooling of the joint fits [s].
    profile
        Profile of the inner boundary along z.
    weights
        Weights of the outer row for the steady lines, (P,); equal unless given.

    Raises
    ------
    InputError
        If a steady line does not rise with h, or share and h cannot be separated.
    """
    _, speed = steady_lines(test, rows, profile, weights)
    state = FitState(test, speed.starts)
    for _ in range(MAX_ROUNDS):
        joint, combined = joint_fits(state.fitted_test, state.start, joint_s, profile)
        state, must_repeat = _adjust(state, joint, combined)
        if not must_repeat:
            break
    expected = expected_harmonics(combined.harmonics, state.press_fits)
    corrected = without_harmonics(state.test, combined.harmonics, expected)
    lines, speed = steady_lines(corrected, rows, profile, weights)
    uneven = [harmonic.finding(d) for d, harmonic in combined.harmonics.items()]
    findings = (*state.findings, *(finding for finding in uneven if finding is not None))
    return MainFits(corrected, state.fitted_test, lines, speed, joint, combined, findings)


def _adjust(
    state: FitState, joint: Mapping[str, DiskFit], combined: CombinedFit
) -> tuple[FitState, bool]:
    """Change what a fit contradicts.

    Parameters
    ----------
    state
        What the fits assumed.
    joint, combined
        The fits.

    Returns
    -------
    state
        The state with one adjustment at most.
    must_repeat
        Whether the fits must be repeated with it.
    """
    points = {d: (fit.share, fit.h_W_m2K) for d, fit in joint.items()}
    if state.test.relative_speed and not state.air_follows_speed:
        adjusted = replace(
            state,
            test=with_slowing_air_offset(state.test, points),
            start=points,
            air_follows_speed=True,
            findings=(*state.findings, info("fits.repeated", reason="slowing")),
        )
        return adjusted, True
    if state.harmonics:
        return state, False
    estimated = combined.harmonics
    corrected = without_harmonics(state.test, estimated, expected_harmonics(estimated, {}))
    press_fits, contradicted = press_fit_priors(corrected, combined.estimates, estimated)
    findings = (*state.findings, *contradicted)
    expected = expected_harmonics(estimated, press_fits)
    if not press_fits and not any_significant(expected):
        return replace(state, findings=findings), False
    adjusted = replace(
        state,
        test=replace(state.test, harmonics=expected),
        start=points,
        harmonics=expected,
        press_fits=press_fits,
        findings=(*findings, info("fits.repeated", reason="harmonic")),
    )
    return adjusted, True


def expected_harmonics(
    estimated: Mapping[str, AngularHarmonic], press_fits: Mapping[str, AngularHarmonic]
) -> dict[str, AngularHarmonic]:
    """Priors of the harmonics for a further fit: by press fits, else by the fit before.

    Parameters
    ----------
    estimated
        Harmonic of each disk by the fit before.
    press_fits
        Prior of each disk with a press fit in rig.toml; may be empty.
    """
    return {d: press_fits.get(d, harmonic.prior_for_refit) for d, harmonic in estimated.items()}


def any_significant(expected: Mapping[str, AngularHarmonic]) -> bool:
    """Whether a harmonic is significant, so that a further fit is needed.

    Parameters
    ----------
    expected
        Prior of each disk's harmonics, from :func:`expected_harmonics`. Only that of a significant
        harmonic has a second one.
    """
    return any(harmonic.second_harmonic_u_K > 0 for harmonic in expected.values())


def without_harmonics(
    test: EhlTest, estimated: Mapping[str, AngularHarmonic], expected: Mapping[str, AngularHarmonic]
) -> EhlTest:
    """The test without the estimated harmonics, and with their remaining uncertainty.

    Parameters
    ----------
    test
        The test.
    estimated
        Harmonics by the joint fit.
    expected
        Their priors, which hold the uncertainty of second harmonic and angles.
    """
    remaining = {
        d: replace(
            estimated[d],
            second_harmonic_u_K=harmonic.second_harmonic_u_K,
            angle_level_K=harmonic.angle_level_K,
        )
        for d, harmonic in expected.items()
    }
    return remove_harmonics(test, remaining)


def remove_harmonics(test: EhlTest, harmonics: Mapping[str, AngularHarmonic]) -> EhlTest:
    """The test with circumferential harmonics subtracted from the readings.

    Parameters
    ----------
    test
        The test.
    harmonics
        The harmonic of each disk; the returned test holds them.

    Notes
    -----
    The harmonic is late by the common lag of the disk. ``tests/partition/test_stated_fit.py`` and
    ``tests/partition/test_uneven.py`` (studies) check what was subtracted.
    """
    disks = {}
    for d, disk in test.disks.items():
        since_s = test.time_s - test.events.unload_s - disk.common_lag_s
        corrected = disk.readings_degC - harmonic_K(harmonics[d], disk.setup, since_s)
        disks[d] = replace(disk, readings_degC=corrected)
    return replace(test, disks=disks, harmonics=harmonics)
