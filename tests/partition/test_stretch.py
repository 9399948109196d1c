"""A log that ends too early raises an error that gives the longest possible window."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.partition.window import fit_rows


def test_short_log_raises_with_the_longest_possible_window() -> None:
    log = SimpleNamespace(
        time_s=np.arange(0.0, 102.72, 0.01), events=SimpleNamespace(unload_s=100.0, load_on_s=10.0)
    )
    with pytest.raises(InputError, match=r"ends 2\.71 s after .* at least 5 s .*window_s=2\.7,"):
        fit_rows(log, 5.0)  # type: ignore[arg-type]
