"""Every call of every command refused once: ``python -m tests.cli.refusal_study [most calls of a
command] [names]``.

A line a command: calls refused, how many of them it ended by with its sentence, and what was wrong.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from tests.cli.fault_commands import (
    LONG,
    QUICK,
    Trial,
    computed_once,
    files_of_campaign,
    small_files,
    whole_truth,
)
from tests.cli.fault_world import ARRAYS, FILES, PROBLEMS
from tests.cli.test_main_job import tcdyn
from tests.conftest import small_campaign


def main(most: int, names: list[str]) -> None:
    """A line a command."""
    base = Path(tempfile.mkdtemp(prefix="faults"))
    campaign = small_campaign(base)
    tcdyn("simulate", "hole", "--out", base / "hole.csv", "--quiet")
    world = {**small_files(base), "hole": base / "hole.csv"}
    world |= files_of_campaign(campaign.files, campaign.record_paths, base)
    for name, command in {**QUICK, **LONG}.items():
        if names and name not in names:
            continue
        for homes, kinds in ((FILES, list(PROBLEMS)), (ARRAYS, ["memory"])):
            folder = base / f"{name}{len(kinds)}".replace(" ", "_")
            folder.mkdir()
            started = time.monotonic()
            with computed_once(command.once if homes is FILES else ()):
                few = most if homes is FILES else 6
                tried, ended, wrong = whole_truth(Trial(command, world, folder), kinds, homes, few)
            what = "files" if homes is FILES else "arrays"
            said = f"{name}, {what}: {tried} refused, {ended} told, {len(wrong)} wrong"
            print(
                f"{said}, {time.monotonic() - started:.0f} s", *wrong[:10], sep="\n  ", flush=True
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60, sys.argv[2:])
