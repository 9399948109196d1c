"""How well a campaign knows differences, n and trends, over rigs drawn from the stated uncertainties.

`python -m tests.campaign.campaign_study draw FOLDER 30` draws and fits (a minute or two a rig, kept in FOLDER; run it
again to go on); `python -m tests.campaign.campaign_study FOLDER` prints what the kept campaigns show.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from tests.campaign.rigs import drawn


def draw(folder: Path, count: int, first: int = 3000) -> None:
    """Write ``count`` drawn campaigns into ``folder``, those that are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(first, first + count):
        path = folder / f"{seed}.json"
        if not path.exists():
            path.write_text(json.dumps(drawn(seed).to_dict()), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1] == "draw":
        draw(Path(sys.argv[2]), int(sys.argv[3]), *(int(x) for x in sys.argv[4:5]))
