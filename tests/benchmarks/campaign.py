"""Time of a campaign against the number of logs and of workers: python -m
tests.benchmarks.campaign [logs]."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from tcdyn.rig.record import read_record, write_record
from tcdyn.rig.rigfile import load_rig
from tcdyn.simulate.campaign import simulate_campaign
from tcdyn.simulate.ehl import STUDY_MESH, EhlOptions
from tcdyn.workflows import calibrate_disk
from tcdyn.workflows.campaign import run_campaign


def main(count: int = 4) -> None:
    """Baseline: one log on one worker. The table must not depend on the number of workers."""
    folder = Path(tempfile.mkdtemp())
    options = EhlOptions(load_on_s=30.0, unload_s=330.0, duration_s=350.0, mesh=STUDY_MESH)
    files = simulate_campaign(folder, 1, ("B3",), ehl_options=options)
    rig = load_rig(files.rig)
    records = {}
    for d in ("fast", "slow"):
        record = calibrate_disk(rig, d, files.ovens[d], files.plunges[d], ["mobil-jet-ii"]).record
        records[d] = read_record(write_record(record, folder / f"{d}.disk.json"))
    logs = [folder / f"EHL_{k}.csv" for k in range(count)]
    for log in logs:
        shutil.copy(files.ehl["B3"], log)
    run_campaign(logs[:1], rig, records, folder / "warm")
    tables = {}
    base = 0.0
    for name, chosen_logs, workers in (
        ("1 log, 1 worker", logs[:1], 1),
        ("all, 1 worker", logs, 1),
        ("all, 2 workers", logs, 2),
    ):
        start = perf_counter()
        tables[name] = run_campaign(
            chosen_logs, rig, records, folder / name.replace(" ", ""), workers=workers
        ).table
        took = perf_counter() - start
        base = base or took
        print(
            f"{name:16s} {len(chosen_logs):3d} logs  {took:7.2f} s  {took / base:5.2f} x baseline"
        )
    assert tables["all, 1 worker"].round(8).equals(tables["all, 2 workers"].round(8))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
