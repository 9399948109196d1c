"""A hundred kills of each long command: what it left is old or whole, and the next run goes on from
it.

``python -m tests.cli.kill_study [moments] [commands]`` prints a line a command. Half of the moments
are the calls that open, write, flush and rename files; the others are spread over the run, most
over its last part, where it writes.

``tests.cli.signal_study`` sends signals that a command can handle.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.cli.fault_commands import LONG, Trial, computed_once, files_of_campaign, small_files
from tests.cli.fault_world import Machine, content, torn
from tests.conftest import small_campaign

KILLED = ("calibrate", "beta", "compensate --record", "campaign")


def dead() -> BaseException:
    """Nothing is left to clean up."""
    os.kill(os.getpid(), signal.SIGKILL)
    return SystemExit()


def killed(trial: Trial, at: int = 0, after_s: float | None = None) -> bool:
    """The command in a process of its own, killed at file call ``at`` or after so long; whether it
    was in time."""
    trial.reset()
    child = os.fork()
    if not child:
        try:
            trial.go_on(Machine(trial.folder, at, dead) if at else None)
        finally:
            os._exit(0)
    if after_s is not None:
        time.sleep(after_s)
        os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def kills(trial: Trial, moments: int, whole_run: int = 0) -> tuple[int, int, list[str]]:
    """Kills that came in time, hidden files they left, and what was wrong; ``whole_run``: so many
    of the moments are spread over a run that computes everything, the others over one that only
    reads and writes."""
    wrong: list[str] = []
    started = time.monotonic()
    whole = trial.run()
    times = [(False, s) for s in np.linspace(0.0, time.monotonic() - started, whole_run)]
    done = hidden = 0
    with computed_once(trial.once):
        sound = trial.run()
        _, calls = trial.refused(0, "EIO")
        started = time.monotonic()
        assert (whole.code, sound.files) == (sound.code, trial.run().files)
        length = time.monotonic() - started
        turns = np.unique(
            np.linspace(1, len(calls), min((moments - whole_run) // 2, len(calls))).astype(int)
        ).tolist()
        times += [
            (True, length * s**0.5) for s in np.linspace(0.0, 1.0, moments - whole_run - len(turns))
        ]
        todo = [
            *((True, at, None) for at in turns),
            *((quick, 0, s) for quick, s in times if quick),
        ]
        for _, at, after_s in todo:
            done += killed(trial, at, after_s)
            hidden += judged(trial, sound.files, wrong, f"call {at}" if at else f"{after_s:.3f} s")
        if (
            trial.go_on().files.items() - hidden_in(trial) != sound.files.items()
        ):  # from what the last kill left
            wrong.append("the next run ends otherwise")
    for _, after_s in [x for x in times if not x[0]]:
        done += killed(trial, 0, float(after_s))
        hidden += judged(trial, whole.files, wrong, f"{after_s:.2f} s of the whole run")
    return done, hidden, wrong


def hidden_in(trial: Trial) -> set[tuple[str, bytes]]:
    """Temporary files that a kill left."""
    return {
        (name, data)
        for name, data in content(trial.folder).items()
        if Path(name).name.startswith(".")
    }


def judged(trial: Trial, sound: dict[str, bytes], wrong: list[str], when: str) -> int:
    """Add to ``wrong`` what a kill spoilt; how many hidden files it left."""
    now, left = content(trial.folder), hidden_in(trial)
    wrong += [
        f"killed at {when}: {said}"
        for said in torn(trial.before, sound, dict(now.items() - left), trial.grows)
    ]
    return len(left)


def main(moments: int, names: list[str]) -> None:
    """A line a command."""
    base = Path(tempfile.mkdtemp(prefix="kills"))
    campaign = small_campaign(base)
    world = {**small_files(base), **files_of_campaign(campaign.files, campaign.record_paths, base)}
    for name in names or KILLED:
        folder = base / name.replace(" ", "_")
        folder.mkdir()
        started = time.monotonic()
        done, hidden, wrong = kills(Trial(LONG[name], world, folder), moments, moments // 20)
        print(
            f"{name}: {moments} moments, {done} in time, {hidden} hidden files left, "
            f"{len(wrong)} wrong, {time.monotonic() - started:.0f} s",
            *wrong[:20],
            sep="\n  ",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100, sys.argv[2:])
