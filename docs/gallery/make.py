"""Draw the figures of the gallery into docs/_pictures: `python docs/gallery/make.py [furnace kiln ..]`, default all."""

from __future__ import annotations

import argparse
import runpy
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent


def scripts() -> list[Path]:
    """The scripts; each draws the figure of its name."""
    return [path for path in sorted(HERE.glob("*.py")) if path.stem not in ("common", "make")]


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    import common

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="scripts; default: all")
    parser.add_argument("--out", type=Path, default=common.OUT)
    arguments = parser.parse_args()
    common.OUT = arguments.out
    for path in scripts():
        if not arguments.names or path.stem in arguments.names:
            start = time.perf_counter()
            runpy.run_path(str(path))
            print(f"{path.stem}: {time.perf_counter() - start:.1f} s", flush=True)
