"""Thirty single changes of the physics, each in a copy of the source: do ``tcdyn verify`` or unit
tests detect them?

Run by hand: ``python -m tests.verify.mutations`` (all), with numbers for some, ``--tests`` to run
the named unit tests also if ``verify`` has detected the change.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
COPIED_FOLDERS = ("calibration", "immersion", "tcdyn", "tests")
LIMIT_s = 900.0


@dataclass(frozen=True)
class Mutation:
    """What is changed, in which file, the text before and after, and the unit tests that should see
    it."""

    what: str
    file: str
    old: str
    new: str
    tests: str

    def changed(self, text: str) -> str:
        """The source with the change made; raises ValueError unless the old text occurs exactly
        once."""
        if text.count(self.old) != 1:
            raise ValueError(f"{self.file}: {self.old!r} stands there {text.count(self.old)} times")
        return text.replace(self.old, self.new)


CONTACT = "tcdyn/rig/contact.py"
MODAL = "tcdyn/heat/modal.py"
RIM = "tcdyn/heat/rim.py"
HERTZ_TESTS = "tests/simulate/test_contact.py"
RIM_TESTS = "tests/heat/test_rim_closed_forms.py"
PLUNGE_TESTS = "tests/immersion/test_immersion_radial.py"
OIL_TESTS = "tests/immersion/test_immersion_correlations.py"
STEADY = "tcdyn/partition/steady.py"

MUTATIONS: tuple[Mutation, ...] = (
    Mutation(
        "surface speed without its factor 2",
        CONTACT,
        "return 2.0 * np.pi * speed_rpm",
        "return np.pi * speed_rpm",
        HERTZ_TESTS,
    ),
    Mutation(
        "Hertz: twice the load",
        CONTACT,
        "= 1.5 * load_N * crown",
        "= 3.0 * load_N * crown",
        HERTZ_TESTS,
    ),
    Mutation(
        "Hertz: sign in 1 - nu^2",
        CONTACT,
        "(2.0 * (1.0 - poisson**2))",
        "(2.0 * (1.0 + poisson**2))",
        HERTZ_TESTS,
    ),
    Mutation(
        "press fit without its factor 2",
        CONTACT,
        "/ (2 * square * (outer - inner))",
        "/ (square * (outer - inner))",
        "tests/simulate/test_disk.py",
    ),
    Mutation(
        "exponent of the joint's conductance",
        CONTACT,
        "(pressure_Pa / hardness_Pa) ** 0.693",
        "(pressure_Pa / hardness_Pa) ** 0.963",
        "tests/simulate/test_disk.py",
    ),
    Mutation(
        "running surface: curvature inwards",
        MODAL,
        "(ro + dr / 2) * 2 /",
        "(ro - dr / 2) * 2 /",
        "tests/heat/test_rim_convergence.py",
    ),
    Mutation(
        "washers: half of a face's exchange",
        MODAL,
        "2 * alpha * rim.washer",
        "alpha * rim.washer",
        "tests/heat/test_rim_convergence.py",
    ),
    Mutation(
        "washers' Biot number in the inner row",
        MODAL,
        "biot = rim.washer_W_m2K * w / k",
        "biot = rim.washer_W_m2K * w / (2 * k)",
        "tests/heat/test_rim_profiles.py",
    ),
    Mutation(
        "flux over twice the contact's width",
        MODAL,
        "np.clip(edges / half_width,",
        "np.clip(edges / (2 * half_width),",
        "tests/heat/test_rim_flux.py",
    ),
    Mutation(
        "power spread over the inner radius",
        MODAL,
        "last * outer / (2 * np.pi * ro)",
        "last * outer / (2 * np.pi * ri)",
        RIM_TESTS,
    ),
    Mutation(
        "film warms, not cools",
        MODAL,
        "diagonal[-1] += outer * h",
        "diagonal[-1] -= outer * h",
        RIM_TESTS,
    ),
    Mutation(
        "quartic of the inner row not level at the faces",
        MODAL,
        "t**2 * (3 - 2 * t)",
        "t**2 * (3 - t)",
        "tests/heat/test_rim_profiles.py",
    ),
    Mutation("no radius in the radial coupling", MODAL, "half = r - dr / 2", "half = r", RIM_TESTS),
    Mutation(
        "washer's conductance times its thickness",
        RIM,
        "setup.washer_conductivity_W_mK / setup.washer_thickness_m",
        "setup.washer_conductivity_W_mK * setup.washer_thickness_m",
        "tests/heat/test_rim_engine.py",
    ),
    Mutation(
        "straight line between samples run backwards",
        RIM,
        "drive = ramp * u[1:] + (rise - ramp) * u[:-1]",
        "drive = ramp * u[:-1] + (rise - ramp) * u[1:]",
        "tests/heat/test_rim_bank.py",
    ),
    Mutation(
        "uneven film: sign of its departure",
        "tcdyn/heat/nonuniform.py",
        "* (film - mean)",
        "* (mean - film)",
        "tests/heat/test_rim_nonuniform.py",
    ),
    Mutation(
        "speed law: sign of the slow line's intercept",
        STEADY,
        "return (A * D + chi * B * (1 - C))",
        "return (A * D + chi * B * (1 + C))",
        "tests/partition/test_steady.py",
    ),
    Mutation(
        "Nu of (5.3): local, not mean",
        "immersion/correlations.py",
        "4 / 3 * 0.508",
        "0.508",
        OIL_TESTS,
    ),
    Mutation(
        "Nu of (5.4): wrong exponent",
        "immersion/correlations.py",
        "outer=4 / 9",
        "outer=8 / 27",
        OIL_TESTS,
    ),
    Mutation(
        "Gr: square of the length",
        "immersion/correlations.py",
        "* length**3 /",
        "* length**2 /",
        OIL_TESTS,
    ),
    Mutation(
        "plunged disk holds twice the heat",
        "immersion/cylinder.py",
        "return 2 * ro / (self.heat",
        "return ro / (self.heat",
        PLUNGE_TESTS,
    ),
    Mutation(
        "expansion half as large again",
        "immersion/fluids.py",
        "(self.rho(T - 0.5) - self.rho(T + 0.5))",
        "(self.rho(T - 1.0) - self.rho(T + 0.5))",
        "tests/immersion/test_immersion_fluids.py",
    ),
    Mutation(
        "cut-off taken in rad/s over pi",
        "tcdyn/rig/disk.py",
        "1.0 / (2 * math.pi * self.cutoff_Hz)",
        "1.0 / (math.pi * self.cutoff_Hz)",
        "tcdyn/rig/disk.py",
    ),
    Mutation(
        "terminal's emf taken away",
        "tcdyn/series/thermocouple_types.py",
        "dtype=float) + emf_mV(cold",
        "dtype=float) - emf_mV(cold",
        "tests/series/test_thermocouple_types.py",
    ),
    Mutation(
        "whole disk: half the radial conduction",
        "tcdyn/simulate/mesh.py",
        "2 * np.pi * k / np.log(r[1:]",
        "np.pi * k / np.log(r[1:]",
        "tests/simulate/test_disk.py",
    ),
    Mutation(
        "static line: sign of the offset",
        "tcdyn/rig/static_line.py",
        "np.asarray(logged, dtype=float) + line.offset",
        "np.asarray(logged, dtype=float) - line.offset",
        "tcdyn/rig/static_line.py",
    ),
    Mutation(
        "power held on the wrong side of the parting",
        "tcdyn/partition/window.py",
        "averaged[max(k, 0)] *= fraction",
        "averaged[max(k, 0)] *= 1 - fraction",
        "tests/partition/test_power.py",
    ),
    Mutation(
        "harmonic round the bore: sign of its second solution",
        "tcdyn/partition/angular_harmonic.py",
        "special.iv(n, x) - lost_i / lost_k",
        "special.iv(n, x) + lost_i / lost_k",
        "tests/partition/test_uneven.py",
    ),
    Mutation(
        "effect of a deeper inner row: sign",
        "tcdyn/partition/nuisance.py",
        "depth[p:] += np.tensordot",
        "depth[p:] -= np.tensordot",
        "tests/partition/test_effects.py",
    ),
    Mutation(
        "inverse of a chain: half the bandwidth",
        "tcdyn/smoothing/inverse.py",
        "w = 2 * np.pi * bandwidth_Hz /",
        "w = np.pi * bandwidth_Hz /",
        "tests/smoothing/test_causal.py",
    ),
)


@dataclass(frozen=True)
class Caught:
    """Result of a mutation: the rows of ``verify`` that differ, or how it stopped; whether a unit
    test failed."""

    rows: tuple[str, ...]
    stopped: str
    test_failed: bool | None

    @property
    def by_verify(self) -> bool:
        """Whether ``verify`` would stop a release."""
        return bool(self.rows or self.stopped)

    @property
    def by_any(self) -> bool:
        """Whether either would."""
        return self.by_verify or bool(self.test_failed)


def _run(copy_root: Path, *command: str) -> subprocess.CompletedProcess[str]:
    env = {
        **os.environ,
        "PYTHONPATH": str(copy_root),
        "PYTHONDONTWRITEBYTECODE": "1",
        "MPLBACKEND": "Agg",
    }
    return subprocess.run(
        [sys.executable, "-m", *command],
        cwd=copy_root,
        env=env,
        capture_output=True,
        text=True,
        timeout=LIMIT_s,
        check=False,
    )


def try_mutation(mutation: Mutation | None, copy_root: Path, always_tests: bool = False) -> Caught:
    """Make the mutation in the copy at ``where`` (None: no change), run the checks, and undo it."""
    path = copy_root / (mutation.file if mutation else "pyproject.toml")
    original = path.read_text(encoding="utf-8")
    try:
        if mutation:
            path.write_text(mutation.changed(original), encoding="utf-8")
        process = _run(copy_root, "tcdyn", "verify", "--json")
        try:
            rows = tuple(
                f"{r['source']}: {r['quantity']}"
                for r in json.loads(process.stdout)["rows"]
                if r["verdict"] == "differs"
            )
            stopped = ""
        except json.JSONDecodeError:
            rows = ()
            stopped = (process.stderr.strip().splitlines() or ["no output"])[-1]
        failed = None
        if mutation and (always_tests or not (rows or stopped)):
            failed = _run(
                copy_root, "pytest", "-x", "-q", "-p", "no:cacheprovider", mutation.tests
            ).returncode in (1, 2)
        return Caught(rows, stopped, failed)
    finally:
        path.write_text(original, encoding="utf-8")


def study(chosen: Sequence[int] = (), always_tests: bool = False) -> dict[int, Caught]:
    """Results of all mutations, or of the ``chosen`` numbers counted from one, by number; printed
    as they come."""
    results = {}
    with TemporaryDirectory() as folder:
        copy_root = Path(folder)
        for copied in COPIED_FOLDERS:
            shutil.copytree(
                ROOT / copied, copy_root / copied, ignore=shutil.ignore_patterns("__pycache__")
            )
        shutil.copy(ROOT / "pyproject.toml", copy_root)
        unchanged = try_mutation(None, copy_root)
        if unchanged.by_verify:
            raise ValueError(
                f"the source differs before any change: {unchanged.rows or unchanged.stopped}"
            )
        for number, mutation in enumerate(MUTATIONS, start=1):
            if chosen and number not in chosen:
                continue
            result = try_mutation(mutation, copy_root, always_tests)
            results[number] = result
            detected = result.stopped or f"{len(result.rows)} rows differ"
            unit = {None: "", True: "; unit test fails", False: "; UNIT TEST PASSES"}[
                result.test_failed
            ]
            print(f"{number:2d} {mutation.what} ({mutation.file}): {detected}{unit}", flush=True)
            for line in result.rows[:3]:
                print(f"      {line}", flush=True)
    n_verify = sum(c.by_verify for c in results.values())
    n_any = sum(c.by_any for c in results.values())
    print(f"of {len(results)}: verify {n_verify}, either {n_any}")
    return results


if __name__ == "__main__":
    study([int(a) for a in sys.argv[1:] if a.isdigit()], "--tests" in sys.argv)
