"""Errors, findings, messages, estimates, parallel map; and the array types of all packages."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
