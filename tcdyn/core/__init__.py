"""Errors, findings, messages, estimates, parallel map; and the array types of all packages.

The lowest layer: the other packages import it, and it imports none of them. ``errors``
has the error for unusable input, ``findings`` and ``messages`` what the library reports,
``estimate`` numbers with uncertainty, ``result`` the base class of results, ``parallel`` and
``threads`` the use of processors. The tests are in ``tests/core``; ``tests/test_contracts.py``
guards the layer.
"""

import numpy as np
from numpy.typing import NDArray

# Array of floats, and of Booleans (a mask), of any shape.
Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
