"""The README's pictures, made from a demo folder: `tcdyn demo --out demo && python docs/pictures.py demo docs`."""

from __future__ import annotations

import sys
from pathlib import Path

from calibration.disk import DISKS
from calibration.record import read_record
from calibration.rig import load_rig
from tcdyn.pipeline import estimate_beta
from tcdyn.plots import partition as draw
from tcdyn.plots.style import figure


def main(demo: Path, out: Path) -> None:
    """Traces at unloading, and the steady lines with every way's point."""
    records = {d: read_record(demo / f"{d}.disk.json") for d in DISKS}
    log = next(p for p in sorted(demo.glob("EHL_*.csv")) if "." not in p.stem)
    run = estimate_beta(log, load_rig(demo / "rig.toml"), records)
    unloading, axes = figure(1, 2, height_in=4.2)
    for disk, ax in zip(DISKS, axes):
        draw.draw_unloading(run.partition, disk, ax)
    unloading.savefig(out / "unloading.png", dpi=110)
    lines, (ax,) = figure(height_in=4.4)
    draw.draw_lines(run.partition, ax)
    lines.savefig(out / "lines.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
