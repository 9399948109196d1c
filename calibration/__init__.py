"""The disk, its log files, and what each channel reads when nothing changes; and the array types of all packages."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # shapes stand in the docstrings
Flags = NDArray[np.bool_]
