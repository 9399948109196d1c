"""The disk, its log files, and what each channel reads when nothing changes; and the one array type of the house."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]  # shapes stand in the docstrings
    Flags = NDArray[np.bool_]


def __getattr__(name: str) -> Any:
    """The types of arrays, with numpy, where they are asked for: a command's help is told without."""
    if name not in ("Array", "Flags"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import numpy as np
    from numpy.typing import NDArray

    globals().update(Array=NDArray[np.float64], Flags=NDArray[np.bool_])
    return globals()[name]
