"""Whether a followed log grows faster than its rows are compensated.

Used by :mod:`tcdyn.workflows.follow`. Guarded by ``tests/smoothing/test_follow_pace.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

# Time between two looks [s], and number of looks in a row with more waiting rows than at the one
# before from which the run falls behind: half a minute. By judgement; it changes no result.
LOOK_EVERY_S = 10.0
MORE_TIMES = 3


@dataclass
class Pace:
    """Rows that wait to be compensated, from look to look.

    Attributes
    ----------
    tell
        Called with the number of waiting rows when a run begins to fall behind.
    looked_at_s
        When it looked last [s of ``time.monotonic``]; None: not yet.
    waiting
        Number of rows that waited then.
    more_times
        Number of looks in a row with more waiting rows than at the one before.
    most
        Largest number of waiting rows at a look at which the run was behind; 0: it never was.
    """

    tell: Callable[[int], None]
    looked_at_s: float | None = None
    waiting: int = 0
    more_times: int = 0
    most: int = 0

    def look(self, now_s: float, waiting: int) -> None:
        """Look at the rows that wait.

        Parameters
        ----------
        now_s
            The time [s of ``time.monotonic``].
        waiting
            Number of rows in the log that the output does not have.
        """
        if self.looked_at_s is not None and now_s - self.looked_at_s < LOOK_EVERY_S:
            return
        is_first = self.looked_at_s is None
        self.looked_at_s = now_s
        self.more_times = self.more_times + 1 if waiting > self.waiting and not is_first else 0
        self.waiting = waiting
        if self.more_times < MORE_TIMES:
            return
        if self.more_times == MORE_TIMES:
            self.tell(waiting)
        self.most = max(self.most, waiting)
