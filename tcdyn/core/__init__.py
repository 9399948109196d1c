"""Errors, findings, messages, estimates with their uncertainty, parallel work; and the array types of all packages."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
