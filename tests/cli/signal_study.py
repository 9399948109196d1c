"""Signals to stop at random moments: SIGINT, SIGTERM, SIGHUP, to the command or its process group.

``python -m tests.cli.signal_study workers COUNT SEED``: ``campaign --workers 2`` leaves no process,
no shared memory and no temporary file. ``python -m tests.cli.signal_study commands COUNT SEED``:
other commands end with their exit code, without a traceback and without a part of an output.
``tests/cli/test_signals.py`` runs a few of them.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.cli.fault_world import content, torn
from tests.cli.fuzz import WORDS, World

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SHARED_MEMORY = Path("/dev/shm")
START = "from tcdyn.cli.start import command; command()"  # as the installed command
STOPPED = "tcdyn: stopped; nothing half-written was kept\n"
PATIENCE_S = 30.0  # in which a command must have ended, and its workers
COMMANDS = (
    *("compensate --sensor", "compensate --record", "beta --record", "follow --sensor"),
    *("identify", "calibrate", "sensor pair", "sensor current"),
)
FOLLOW_S = "1.5"  # without new rows, after which ``follow`` ends
LOGS = 4  # of a campaign


@dataclass
class Ended:
    """How a command ended after a signal, what was wrong; whether a worker printed a traceback."""

    code: int
    error: str
    wrong: list[str] = field(default_factory=list)
    has_message_of_worker: bool = False


def stopped(
    words: list[str], folder: Path, after_s: float, number: int, is_group: bool
) -> tuple[Ended, set[int]]:
    """Start a command, send it a signal after some time, and wait for its end.

    Returns how it ended, and the processes that it had started.
    """
    for each in SIGNALS:  # the command inherits that they are ignored, as in a background job
        if signal.getsignal(each) is signal.SIG_IGN:
            signal.signal(each, signal.SIG_DFL)
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    environment = {**os.environ, "TMPDIR": str(temporary), "PYTHONFAULTHANDLER": "1"}
    with open(folder / "stderr", "wb") as error:
        run = subprocess.Popen(
            [sys.executable, "-c", START, *words],
            stdout=subprocess.DEVNULL,
            stderr=error,
            env=environment,
            start_new_session=True,
        )
    time.sleep(after_s)
    started = processes_of_session(run.pid)
    if run.poll() is None:
        if is_group:
            os.killpg(run.pid, number)
        else:
            run.send_signal(number)
    wrong = []
    try:
        code = run.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        run.send_signal(signal.SIGABRT)  # faulthandler prints what it waits for
        code = run.wait()
        os.killpg(run.pid, signal.SIGKILL)
        to_whom = "the group" if is_group else "the command"
        wrong.append(
            f"does not end within {PATIENCE_S} s after {signal.Signals(number).name} to {to_whom} "
            f"at {after_s:.2f} s"
        )
    text = (folder / "stderr").read_text(encoding="utf-8")
    (folder / "stderr").unlink()
    has_message = False
    if "--workers" in words and is_group and STOPPED in text and text != STOPPED:
        # Processes of joblib that were just starting (SIGINT), or that count the shared memory and
        # do not ignore SIGHUP, print their own traceback; the command itself prints only one line.
        has_message = "Traceback" in text
        text = STOPPED
    # Python itself ends by the signal before the command has begun and after it has ended
    if code not in (0, 1, 130, -number):
        wrong.append(f"exit code {code}: {text[-3000:]}")
    if "Traceback" in text:
        wrong.append(f"a traceback: {text[-600:]}")
    if code == 130 and not text.endswith(STOPPED):
        wrong.append(f"said {text[-300:]!r}")
    until = time.monotonic() + PATIENCE_S
    while processes_of_session(run.pid) and time.monotonic() < until:
        time.sleep(0.1)
    remaining = processes_of_session(run.pid)
    if remaining:
        wrong.append(f"{len(remaining)} processes remain")
        for pid in remaining:
            os.kill(pid, signal.SIGKILL)
    names = [path.name for path in temporary.iterdir()]
    if names:
        wrong.append(f"temporary files remain: {names}")
        shutil.rmtree(temporary)
    else:
        temporary.rmdir()
    return Ended(code, text, wrong, has_message), {run.pid, *started}


def processes_of_session(session: int) -> set[int]:
    """Processes of a session that have not ended."""
    found = set()
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            state, _, _, of_session = (
                (entry / "stat").read_text(encoding="utf-8").rpartition(") ")[2].split()[:4]
            )
        except OSError:  # it has ended
            continue
        if int(of_session) == session and state != "Z":
            found.add(int(entry.name))
    return found


def shared_memory_of(processes: set[int]) -> list[str]:
    """Names in the shared memory that contain the number of one of the processes."""
    names = []
    for path in SHARED_MEMORY.iterdir():
        parts = set(path.name.replace("_", "-").split("-"))
        if parts & {str(pid) for pid in processes}:
            names.append(path.name)
    return names


def campaign_words(world: World, folder: Path) -> list[str]:
    """A campaign of several logs in two worker processes."""
    logs = []
    for k in range(LOGS):
        logs.append(str(shutil.copy(world.files["ehl"], folder / f"log{k}.csv")))
    records = []
    for disk in ("fast", "slow"):
        records += ["--record", str(world.files[disk])]
    rig = ["--rig", str(world.files["rig"])]
    return ["rig", "campaign", *logs, *rig, *records, "--out", str(folder / "o"), "--workers", "2"]


def stopped_campaign(world: World, folder: Path, rng: np.random.Generator, most_s: float) -> Ended:
    """One campaign that is stopped at a random moment."""
    folder.mkdir()
    words = campaign_words(world, folder)
    number = SIGNALS[rng.integers(len(SIGNALS))]
    after_s = rng.uniform(0.2, most_s)
    done, processes = stopped(words, folder, after_s, number, bool(rng.integers(2)))
    names = shared_memory_of(processes)
    if names:
        done.wrong.append(f"{len(names)} entries of shared memory remain: {names[:3]}")
    partial = [str(path) for path in folder.rglob(".*")]
    if partial:
        done.wrong.append(f"partial files remain: {partial}")
    shutil.rmtree(folder)
    return done


class StoppedCommand:
    """A command whose result and duration without a signal are known."""

    def __init__(self, world: World, name: str) -> None:
        """Run it once."""
        self.world = world
        self.name = name
        self.words = WORDS[name].split()
        if name.startswith("follow"):
            self.words[self.words.index("--idle-s") + 1] = FOLLOW_S
        started = time.monotonic()
        run = subprocess.run(
            [sys.executable, "-c", START, *self._given()], capture_output=True, text=True
        )
        assert run.returncode in (0, 1), run.stderr
        self.duration_s = time.monotonic() - started
        self.sound = content(world.folder)

    def _given(self) -> list[str]:
        """The words with inputs in an empty folder."""
        shutil.rmtree(self.world.folder, ignore_errors=True)
        self.world.folder.mkdir()
        return self.world.given(self.words, {})

    def stop(self, rng: np.random.Generator) -> Ended:
        """Run it and stop it at a random moment."""
        words = self._given()
        before = content(self.world.folder)
        number = SIGNALS[rng.integers(len(SIGNALS))]
        after_s = rng.uniform(0.1, 1.05 * self.duration_s)
        done, _ = stopped(words, self.world.folder, after_s, number, bool(rng.integers(2)))
        grows = "o.csv" if self.name.startswith("follow") else ""
        done.wrong += torn(before, self.sound, content(self.world.folder), grows)
        return done


def main(kind: str, count: int, seed: int) -> None:
    """Print the exit codes, and what was wrong."""
    rng = np.random.default_rng(seed)
    codes = Counter[str]()
    n_wrong = 0
    n_messages = 0
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        world = World.made(base)
        commands: dict[str, StoppedCommand] = {}
        most_s = 0.0
        if kind == "workers":
            started = time.monotonic()
            folder = base / "whole"
            folder.mkdir()
            words = campaign_words(world, folder)
            run = subprocess.run([sys.executable, "-c", START, *words], capture_output=True)
            assert run.returncode in (0, 1), run.stderr
            most_s = time.monotonic() - started
        for k in range(count):
            if kind == "workers":
                what = "campaign"
                done = stopped_campaign(world, base / f"trial{k}", rng, most_s)
            else:
                what = COMMANDS[k % len(COMMANDS)]
                if what not in commands:
                    commands[what] = StoppedCommand(world, what)
                done = commands[what].stop(rng)
            codes[str(done.code)] += 1
            n_messages += done.has_message_of_worker
            if done.wrong:
                n_wrong += 1
                print(f"trial {k}, {what}:", *done.wrong, sep="\n  ", flush=True)
    print(f"{count} signals, {kind}, seed {seed}: exit codes {dict(codes)}, {n_wrong} wrong")
    print(f"{n_messages} times a process of joblib printed a traceback")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
