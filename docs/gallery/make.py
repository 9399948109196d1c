"""All pictures of the gallery, or those named: `python docs/gallery/make.py [furnace kiln ..]`, into docs/_pictures."""

from __future__ import annotations

import argparse
import runpy
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent


def scripts() -> list[Path]:
    """The scripts, each of which makes the picture of its name."""
    return [path for path in sorted(HERE.glob("*.py")) if path.stem not in ("common", "make")]


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    import common

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="scripts; all without any")
    parser.add_argument("--out", type=Path, default=common.OUT)
    asked = parser.parse_args()
    common.OUT = asked.out
    for path in scripts():
        if not asked.names or path.stem in asked.names:
            start = time.perf_counter()
            runpy.run_path(str(path))
            print(f"{path.stem}: {time.perf_counter() - start:.1f} s", flush=True)
